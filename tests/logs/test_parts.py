"""Several files are one dive: the parts of a bag, and files named together, whole or damaged, in any order."""

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recorded_parts import Choice, write_part
from small_logs import DVL_MESSAGES, IMU_MESSAGES, START_NS, changed, small_log, written

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats.recording import bag_parts, open_recording


def between(start_s: float, end_s: float) -> Choice:
    return lambda _, time_s: start_s <= time_s < end_s


PARTS = {"b.mcap": between(0.0, 2.0), "a.mcap": between(2.0, 3.5), "c.mcap": between(3.5, 9.0)}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    folder = tmp_path / "bag"
    folder.mkdir()
    for name, chosen in PARTS.items():
        write_part(folder / name, chosen)
    return folder


@pytest.fixture
def whole(tmp_path: Path) -> Dive:
    path = tmp_path / "whole.mcap"
    path.write_bytes(written())
    return read_dive(path, Config())


def describe(folder: Path, listed: str) -> None:
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:{listed}\n"
    )


def assert_same(dive: Dive, whole: Dive) -> None:
    np.testing.assert_array_equal(dive.imu.time_ns, whole.imu.time_ns)
    np.testing.assert_array_equal(dive.imu.specific_force_b, whole.imu.specific_force_b)
    np.testing.assert_array_equal(dive.dvl.velocity_d, whole.dvl.velocity_d)


def counts(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


# Bags


def test_a_bag_is_one_dive_however_its_parts_are_listed(bag: Path, whole: Dive) -> None:
    unlisted = read_dive(bag, Config())
    describe(bag, "\n  - b.mcap\n  - 'a.mcap'\n  - c.mcap")
    dive = read_dive(bag, Config())
    for one in (dive, unlisted):
        assert_same(one, whole)
        assert one.name == "bag"
        assert {channel.topic: channel.messages for channel in one.channels} == {
            "/imu": IMU_MESSAGES,
            "/dvl": DVL_MESSAGES,
        }
        assert counts(one)["joined_files"] == 3
        assert "imu_out_of_order" not in counts(one)
    assert dive.sha256 == unlisted.sha256


def test_a_bag_that_is_not_whole_is_refused(bag: Path) -> None:
    describe(bag, "\n  - b.mcap\n  - lost.mcap")
    with pytest.raises(
        LogError, match=r"metadata\.yaml: lists lost\.mcap, which is not there"
    ) as raised:
        read_dive(bag, Config())
    assert f"{bag}/*.mcap --one-dive" in raised.value.hint
    describe(bag, "\n  - a.mcap\n  - b.mcap")
    with pytest.raises(
        LogError, match=r"metadata\.yaml: does not list c\.mcap, which is in the folder"
    ):
        read_dive(bag, Config())
    for text in (
        "something: else\n",
        "[1, 2]",
        "rosbag2_bagfile_information: {relative_file_paths: []}",
    ):
        (bag / "metadata.yaml").write_text(text)
        with pytest.raises(LogError, match=r"metadata\.yaml: lists no files"):
            read_dive(bag, Config())


def test_names_in_a_list_may_be_quoted_or_json(tmp_path: Path) -> None:
    names = ["it's.mcap", "two words.mcap"]
    for name in names:
        (tmp_path / name).touch()
    for listed in (
        "\n  - 'it''s.mcap'\n  - two words.mcap\n  duration: 3",
        '\n    - "it\'s.mcap"\n    - "two words.mcap"',
    ):
        describe(tmp_path, listed)
        assert [part.name for part in bag_parts(tmp_path)] == names
    (tmp_path / "metadata.yaml").write_text(
        json.dumps({"rosbag2_bagfile_information": {"relative_file_paths": names}})
    )
    assert [part.name for part in bag_parts(tmp_path)] == names


def test_a_part_that_is_compressed_as_a_whole_is_unpacked(bag: Path, whole: Dive) -> None:
    plain = (bag / "c.mcap").rename(bag / "aside")
    packed = bag / "c.mcap.zstd"
    packed.write_bytes(zstandard.compress(plain.read_bytes()))
    for _ in ("without metadata", "with metadata"):
        assert_same(read_dive(bag, Config()), whole)
        describe(bag, "\n  - b.mcap\n  - a.mcap\n  - c.mcap.zstd")
    packed.write_bytes(b"nothing")
    plain.rename(bag / "c.mcap")  # what the user has unpacked
    assert_same(read_dive(bag, Config()), whole)


def test_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"is a folder without \.mcap or \.db3 or \.bag files"):
        bag_parts(tmp_path)


# Damage


def test_an_empty_last_part_costs_nothing_but_itself(bag: Path, whole: Dive) -> None:
    (bag / "d.mcap").touch()
    with pytest.raises(LogError, match=r"d\.mcap: is empty \(0 bytes\)") as raised:
        read_dive(bag, Config())
    assert raised.value.hint == "--allow-damaged uses the 5.0 s and 525 messages that can be read"
    dive = read_dive(bag, Config(), allow_damaged=True)
    assert_same(dive, whole)
    [note] = [note for note in dive.notes if note.severity == "warning"]
    assert note.code == "log_damaged"
    assert "d.mcap: is empty (0 bytes); the whole file is lost" in note.text


def test_parts_that_are_all_empty_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").touch()
    with pytest.raises(LogError, match=r"a\.mcap: is empty"):
        read_dive(tmp_path, Config(), allow_damaged=True)


def test_the_hint_of_a_damaged_part_counts_the_whole_dive(bag: Path) -> None:
    data = (bag / "a.mcap").read_bytes()
    (bag / "a.mcap").write_bytes(data[:-8])
    with pytest.raises(LogError, match=r"a\.mcap: is damaged at byte") as raised:
        read_dive(bag, Config())
    assert raised.value.hint == "--allow-damaged uses the 5.0 s and 525 messages that can be read"
    blocker, *_ = inspect_log(bag, Config()).blockers
    assert blocker.hint == raised.value.hint
    assert "log_damaged" in counts(read_dive(bag, Config(), allow_damaged=True))


# Files named together


def test_the_order_of_files_does_not_matter(bag: Path, whole: Dive) -> None:
    a, b, c = (bag / name for name in ("a.mcap", "b.mcap", "c.mcap"))
    dives = [read_dive(paths, Config()) for paths in ((a, b, c), (c, a, b), (b, c, a, a))]
    for dive in dives:
        assert_same(dive, whole)
        assert dive.name == "a"
        assert dive.notes == dives[0].notes
    assert {dive.sha256 for dive in dives} == {read_dive(bag, Config()).sha256}


def test_files_by_sensor_are_one_dive(tmp_path: Path, whole: Dive) -> None:
    imu = write_part(tmp_path / "imu.mcap", lambda topic, _: topic == "/imu")
    dvl = write_part(tmp_path / "dvl.mcap", lambda topic, _: topic == "/dvl")
    dive = read_dive([imu, dvl], Config())
    assert_same(dive, whole)
    assert dive.name == "dvl"
    assert counts(dive)["files_overlap"] == 1


def test_messages_in_two_files_are_used_once_and_counted(tmp_path: Path, whole: Dive) -> None:
    first = write_part(tmp_path / "first.mcap", between(0.0, 3.0))
    second = write_part(tmp_path / "second.mcap", between(2.0, 9.0))
    dive = read_dive([second, first], Config())
    assert_same(dive, whole)
    repeated = {
        note.text.split(":")[0]: note.count
        for note in dive.notes
        if note.code == "messages_repeated"
    }
    assert repeated == {"/imu": 100, "/dvl": 5}
    assert "imu_out_of_order" not in counts(dive)
    [overlap] = [note for note in dive.notes if note.code == "files_overlap"]
    assert "by up to 0.99" in overlap.text


def test_two_dives_at_the_same_time_are_not_read_as_one(tmp_path: Path, whole: Dive) -> None:
    first = write_part(tmp_path / "first.mcap", between(0.0, 9.0))
    for shift_ns in (0, 5_000_000, 3_000_000_000):
        imu, dvl = (
            replace(columns, time_ns=columns.time_ns + shift_ns)
            for columns in (whole.imu, whole.dvl)
        )
        other = tmp_path / f"other_{shift_ns}.mcap"
        write_dive(
            other, replace(whole, imu=replace(imu, angular_rate_b=-imu.angular_rate_b), dvl=dvl)
        )
        with pytest.raises(
            LogError, match=r"/imu: in the \d\.\d{3} s in which the files overlap"
        ) as raised:
            read_dive([first, other], Config())
        assert "without --one-dive" in raised.value.hint


def test_schemas_may_differ_from_file_to_file(tmp_path: Path, whole: Dive) -> None:
    older = write_part(tmp_path / "older.mcap", between(0.0, 2.5))
    newer = write_part(
        tmp_path / "newer.mcap", between(2.5, 9.0), b"# as of a later release\nuint8 MORE=1\n"
    )
    assert_same(read_dive([newer, older], Config()), whole)


def test_a_file_that_is_not_there_is_refused_even_if_damage_is_allowed(bag: Path) -> None:
    with pytest.raises(LogError, match=r"typo\.mcap: cannot be read: No such file"):
        read_dive([bag / "a.mcap", bag / "typo.mcap"], Config(), allow_damaged=True)


def test_run_replays_files_as_one_dive(bag: Path, tmp_path: Path) -> None:
    level = ["initial.source=level", "initial.heading_deg=0", "initial.latitude_deg=60"]
    settings = [word for setting in level for word in ("--set", setting)]
    files = [str(bag / name) for name in ("c.mcap", "a.mcap", "b.mcap")]
    assert (
        run_command_line(["run", *files, "--one-dive", "-o", str(tmp_path / "out"), *settings])
        == 0
    )
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"]
    report = json.loads((tmp_path / "out" / "a" / "report.json").read_text())
    assert report["log"]["sha256"] == open_recording(bag).sha256()
    [joined] = [note for note in report["notes"] if note["code"] == "joined_files"]
    assert joined["text"] == "read as one dive: b.mcap, a.mcap, c.mcap"


# Channels


def test_channels_of_one_topic_are_merged_before_their_order_is_evaluated(
    tmp_path: Path, whole: Dive
) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(small_log("zstd"))
    dive = read_dive(path, Config())
    assert_same(dive, whole)
    assert not {"imu_out_of_order", "dvl_out_of_order", "messages_repeated"} & counts(dive).keys()


# Chunks that nobody needs


def test_damage_in_a_chunk_that_no_role_needs_is_found(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    stream = BytesIO()
    writer = Writer(stream, chunk_size=1000, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    camera = writer.register_channel(
        "/camera", "cdr", writer.register_schema("a/msg/Image", "ros2msg", b"uint8[] data")
    )
    writer.add_message(
        camera, START_NS, b"\0\1\0\0" + b"dim and green, as the sea is" * 40, START_NS
    )
    ids = dict[str, int]()
    for schema, channel, message in make_reader(BytesIO(written())).iter_messages():
        assert schema
        if channel.topic not in ids:
            schema_id = writer.register_schema(schema.name, "ros2msg", schema.data)
            ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
        writer.add_message(
            ids[channel.topic], message.log_time, message.data, message.publish_time
        )
    writer.finish()
    data = stream.getvalue()
    path.write_bytes(data)
    read_dive(path, Config())
    path.write_bytes(changed(data, data.index(b"dim and green"), b"D"))
    with pytest.raises(LogError, match=r"is damaged at byte \d+: .*chunk"):
        read_dive(path, Config())
