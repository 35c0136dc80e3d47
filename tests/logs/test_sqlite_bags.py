"""Bags in SQLite, as rosbags writes them: the same columns as from MCAP, nothing written, and what is wrong told."""

import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import other_bags
import pytest
from recorded_parts import write_part
from rosbags import rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from small_logs import SPAN_S, written

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.definitions import definition_text, full_name
from insdvl_replay.logs.formats.log_file import UnusableFileError
from insdvl_replay.logs.formats.recording import open_recording


@pytest.fixture(scope="module")
def iron(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return other_bags.ros2_bag(tmp_path_factory.mktemp("bags") / "iron")


@pytest.fixture
def part(iron: Path, tmp_path: Path) -> Path:
    """A .db3 file that may be changed."""
    return Path(shutil.copy(iron / "iron.db3", tmp_path / "dive.db3"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Dive:
    path = tmp_path_factory.mktemp("whole") / "dive.mcap"
    path.write_bytes(written())
    return read_dive(path, Config())


def refusal(path: Path) -> str:
    """Give the sentence with which a file is refused; nothing if it is read."""
    try:
        read_dive(path, Config())
    except LogError as error:
        return error.message
    return ""


def assert_same(one: Dive, other: Dive) -> None:
    for role in ("imu", "dvl"):
        expected = vars(getattr(other, role))
        for name, values in vars(getattr(one, role)).items():
            np.testing.assert_array_equal(values, expected[name], err_msg=f"{role}.{name}")


def test_both_versions_give_the_columns_of_the_mcap(
    iron: Path, whole: Dive, tmp_path: Path
) -> None:
    humble = other_bags.ros2_bag(tmp_path / "humble", humble=True)
    for path in (iron, iron / "iron.db3", humble, humble / "humble.db3"):
        dive = read_dive(path, Config())
        assert_same(dive, whole)
        assert dive.name == path.stem
        assert {one.topic: (one.type_name, one.messages) for one in dive.channels} == {
            one.topic: (one.type_name, one.messages) for one in whole.channels
        }
        builtin = [note.text for note in dive.notes if note.code == "builtin_definition"]
        assert len(builtin) == (2 if "humble" in str(path) else 0)
    (tmp_path / "dive.mcap").write_bytes(written())
    one, other = (
        inspect_log(iron, Config(), deep=True),
        inspect_log(tmp_path / "dive.mcap", Config(), deep=True),
    )
    assert (one.topics, one.roles) == (other.topics, other.roles)
    assert (one.log.duration_s, one.log.messages) == (other.log.duration_s, other.log.messages)
    assert one.log.library == "rosbag2 of rosbags"
    assert not one.notes


def test_parts_of_both_kinds_are_one_dive(whole: Dive, tmp_path: Path) -> None:
    """The recorder was told to change its storage between two parts."""
    folder = tmp_path / "bag"
    folder.mkdir()
    write_part(folder / "b.mcap", lambda topic, at_s: at_s >= 2.0)
    first = write_part(tmp_path / "first.mcap", lambda topic, at_s: at_s < 2.0)
    shutil.copy(other_bags.ros2_bag(tmp_path / "a", log=first.read_bytes()) / "a.db3", folder)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths:\n  - a.db3\n  - b.mcap\n"
    )
    dive = read_dive(folder, Config())
    assert_same(dive, whole)
    assert {note.code: note.count for note in dive.notes}["joined_files"] == 2
    (folder / "c.db3").write_bytes(b"")
    with pytest.raises(LogError, match=r"metadata\.yaml: does not list c\.db3"):
        read_dive(folder, Config())


def test_messages_that_are_compressed_one_by_one_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    writer = rosbag2.Writer(folder, version=9)
    writer.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        for topic in ("/imu", "/dvl"):
            writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
    assert "each message is compressed separately" in refusal(folder)


def test_nothing_is_written_where_nothing_may_be(iron: Path, whole: Dive, tmp_path: Path) -> None:
    """Also where somebody else holds the lock of the file."""
    part = Path(shutil.copy(iron / "iron.db3", tmp_path / "dive with ?#%.db3"))
    before = part.read_bytes()
    with closing(sqlite3.connect(part)) as other:
        other.execute("BEGIN EXCLUSIVE")
        assert_same(read_dive(part, Config()), whole)
        other.rollback()
    assert [path.name for path in tmp_path.iterdir()] == [part.name]
    assert part.read_bytes() == before


def test_what_is_next_to_the_file_is_not_ignored(part: Path, whole: Dive) -> None:
    for ending in ("-wal", "-journal"):
        beside = part.with_name(f"{part.name}{ending}")
        beside.write_bytes(bytes(8))
        assert_same(read_dive(part, Config()), whole)
        beside.write_bytes(b"\x37\x7f\x06\x82")
        with pytest.raises(
            LogError, match=rf"dive\.db3: is not complete: dive\.db3{ending}"
        ) as raised:
            read_dive(part, Config(), allow_damaged=True)
        assert "sqlite3" in raised.value.hint
        beside.unlink()


def test_the_hint_about_a_journal_helps(part: Path, whole: Dive) -> None:
    """Messages that are only in the log of changes, as a recorder leaves them that was killed."""
    copy = part.with_name("copy.db3")
    with closing(sqlite3.connect(part, isolation_level=None)) as recorder:
        recorder.execute("PRAGMA journal_mode = WAL")
        recorder.execute(
            "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages WHERE id < 9"
        )
        for ending in ("", "-wal"):
            shutil.copy(f"{part}{ending}", f"{copy}{ending}")
    with pytest.raises(LogError, match="is not complete") as raised:
        read_dive(copy, Config())
    statement = raised.value.hint.split("'")[1]
    with closing(sqlite3.connect(copy, isolation_level=None)) as tool:
        tool.execute(statement)
    found = sum(channel.messages for channel in open_recording(copy).channels)
    assert found == sum(channel.messages for channel in whole.channels) + 8


def test_a_file_that_was_cut_is_refused(part: Path) -> None:
    data = part.read_bytes()
    for size, allow_damaged in ((50, False), (len(data) - 1, True)):
        part.write_bytes(data[:size])
        with pytest.raises(
            LogError, match=r"dive\.db3: is damaged: it has \d+ bytes where its header says"
        ) as raised:
            read_dive(part, Config(), allow_damaged=allow_damaged)
        assert ".recover" in raised.value.hint


def test_a_part_that_is_damaged_costs_the_others_nothing(part: Path, tmp_path: Path) -> None:
    part.write_bytes(part.read_bytes()[:-4096])
    whole = write_part(tmp_path / "whole.mcap", lambda topic, at_s: True)
    dive = read_dive([part, whole], Config(), allow_damaged=True)
    [note] = [note for note in dive.notes if note.code == "log_damaged"]
    assert "dive.db3: is damaged" in note.text
    assert dive.imu.time_ns.size == pytest.approx(SPAN_S * 100 + 1)


def test_pages_that_contradict_each_other_are_found(part: Path) -> None:
    data = bytearray(part.read_bytes())
    page = struct.unpack(">H", data[16:18])[0]
    for number in range(1, len(data) // page):
        part.write_bytes(data[: number * page] + b"\xff" * 64 + data[number * page + 64 :])
        assert "dive.db3: is damaged: SQLite says '" in refusal(part)


RECURSION = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
ENDLESS = f"{RECURSION} SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(9) AS data FROM n"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("DROP TABLE messages", "without the table 'messages'"),
        (
            f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS}",
            "without the table 'messages'",
        ),
        ("ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(900000000))", ""),
        (
            "ALTER TABLE messages DROP COLUMN data; ALTER TABLE messages ADD data AS (zeroblob(9))",
            "without the table 'messages'",
        ),
        ("CREATE VIRTUAL TABLE other USING fts4(x)", ""),
        (
            "UPDATE messages SET topic_id = 77 WHERE id = 9",
            "1 message is of topic 77, which is not defined",
        ),
        (
            "UPDATE messages SET timestamp = 'noon' WHERE id = 9",
            "1 row of the table 'messages' is damaged",
        ),
        (
            "UPDATE messages SET data = 5 WHERE id < 9",
            "8 rows of the table 'messages' are damaged",
        ),
        ("UPDATE topics SET type = x'ff00fe', name = 3.5", "has no IMU"),
        (
            "UPDATE topics SET serialization_format = 'ros2_telepathy'",
            "are encoded as ros2_telepathy",
        ),
        (
            "UPDATE message_definitions SET encoding = 'unknown', encoded_message_definition = ''",
            "",
        ),
        (
            "UPDATE message_definitions SET encoded_message_definition = 9",
            "'9' in the schema is no field",
        ),
    ],
)
def test_tables_that_are_not_those_of_a_bag_end_in_a_sentence(
    part: Path, change: str, said: str
) -> None:
    with closing(sqlite3.connect(part)) as base:
        base.executescript(change)
    assert said in (found := refusal(part))
    assert bool(said) == bool(found)


def test_messages_that_are_gone_are_counted(part: Path) -> None:
    """One by one, and where none is left."""
    with closing(sqlite3.connect(part, isolation_level=None)) as base:
        base.execute("DELETE FROM messages WHERE id BETWEEN 100 AND 109")
    [note] = [note for note in read_dive(part, Config()).notes if note.code == "log_summary"]
    assert note.text == "the messages of dive.db3 are numbered up to 525, but 515 were found"
    assert note.count == 10
    with closing(sqlite3.connect(part, isolation_level=None)) as base:
        base.execute("DELETE FROM messages")
    with pytest.raises(LogError, match="it has no messages at all"):
        read_dive(part, Config())
    assert open_recording(part).parts[0].span_ns is None


def test_an_sqlite_file_is_known_by_its_bytes_not_by_its_name(part: Path, whole: Dive) -> None:
    renamed = part.rename(part.with_name("dive.mcap"))
    assert_same(read_dive(renamed, Config()), whole)
    renamed.write_bytes(b"#ROSBAG V1.1\n" + bytes(40))
    with pytest.raises(LogError, match=r"is a bag of ROS 1 before 2010") as raised:
        read_dive(renamed, Config())
    assert not isinstance(raised.value, UnusableFileError)


@pytest.mark.nightly
def test_real_dives_give_the_columns_of_their_mcap(snapir: Path, tmp_path: Path) -> None:
    log = snapir / "snapir_05.mcap"
    expected = read_dive(log, Config())
    assert expected.reference is not None
    for humble in (False, True):
        folder = other_bags.ros2_bag(
            tmp_path / f"humble_{humble}", log=log.read_bytes(), humble=humble
        )
        dive = read_dive(folder, Config())
        assert_same(dive, expected)
        assert dive.reference is not None
        for name, values in vars(expected.reference).items():
            if isinstance(values, np.ndarray):
                np.testing.assert_array_equal(vars(dive.reference)[name], values, err_msg=name)


def test_the_definition_of_ds_sensor_msgs_is_that_of_its_publisher() -> None:
    """By the checksum that ROS 1 makes of it, as it stands in what rosmsg generated for others."""
    store, name = get_typestore(Stores.ROS1_NOETIC), "ds_sensor_msgs/msg/Dvl"
    first, *others = definition_text(name).split(f"{'=' * 80}\n")
    texts = {name: first} | {
        one.partition("\n")[0].removeprefix("MSG: "): one.partition("\n")[2] for one in others
    }
    for type_name, text in texts.items():
        types = get_types_from_msg(text, full_name(type_name))
        store.register(
            {one: fields for one, fields in types.items() if one not in store.fielddefs}
        )
    assert store.generate_msgdef(name)[1] == "2a3b47c6dbf3a5cd6beadbe10a71f170"
