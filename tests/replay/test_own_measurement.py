"""A measurement of a user's own aids a filter, compiled or as it is, and stands in the tables."""

from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer
from own_sensors import BEACON, RANGE_SD_M

from insdvl_replay.core.config import Config, Evaluation, Filter, Position, Topic
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs.writing.dive_log import write_dive
from insdvl_replay.replay import Replay, replay_dive, replay_log
from insdvl_replay.sim.dive import simulate_dive


def replayed(word: str, duration_s: float = 200.0) -> Replay:
    dive = simulate_dive("lawnmower", seed=4, duration_s=duration_s, grade="mems", imu_rate_hz=50.0)
    mine = Filter(aiding=("velocity", word), gate_probability=0.999)
    mems, filters = load_config("mems"), {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    config = Config(noise=mems.noise, initial=mems.initial, filters=filters, evaluation=Evaluation(starts=1))
    return replay_dive(dive, config)


def test_it_is_met_judged_and_shown() -> None:
    replay = replayed("own_sensors:Speed")
    met = next(one for one in replay.histories[1].innovations if one.measurement == "speed")
    assert met.used.mean() > 0.99
    assert 0.7 < met.nis.mean() < 1.3
    row = next(row for row in replay.tables.consistency if row.measurement == "speed")
    assert row.used == int(met.used.sum())
    assert not [note for note in replay.notes if note.code == "own_measurement_plain"]


def test_what_cannot_be_compiled_gives_the_same_and_says_so() -> None:
    compiled, plain = replayed("own_sensors:Speed", 20.0), replayed("own_sensors:PlainSpeed", 20.0)
    np.testing.assert_allclose(plain.histories[1].velocity_n, compiled.histories[1].velocity_n, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(plain.histories[1].sd, compiled.histories[1].sd, rtol=1e-9)
    (note,) = [note for note in plain.notes if note.code == "own_measurement_plain"]
    assert "PlainSpeed cannot be compiled" in note.text


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("nowhere_at_all:Speed", "cannot be imported: No module named 'nowhere_at_all'"),
        ("own_sensors:Nothing", "is not in own_sensors"),
        ("own_sensors:NOT_A_CLASS", "is no class derived from OwnMeasurement"),
        ("own_sensors:Three", "has the name 'three_x', which is no word for a row of a table"),
        ("own_sensors:Flat", r"of shapes \(101,\) and \(101,\)"),
        ("own_sensors:Late", "has no reading between the start of the replay and its end"),
    ],
)
def test_what_is_none_is_told_in_a_sentence(word: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        replayed(word, 20.0)


# --- A topic of the log.

BEACONS = Topic(topic="/usbl/range", values="range", latency_s=0.2)


def from_centre_m(position: Floats) -> Floats:
    """Place positions on the ellipsoid, by its definition."""
    latitude, longitude, height_m = np.moveaxis(np.asarray(position), -1, 0)
    squared = 0.00669437999014
    normal_m = 6378137.0 / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
    across_m = (normal_m + height_m) * np.cos(latitude)
    up_m = (normal_m * (1.0 - squared) + height_m) * np.sin(latitude)
    return np.stack([across_m * np.cos(longitude), across_m * np.sin(longitude), up_m], axis=-1)


def dive_with_a_beacon(folder: Path) -> list[Path]:
    """A dive, and beside it, as a second part, what a range to a beacon was measured to be, stamped too late."""
    dive = simulate_dive("lawnmower", seed=4, duration_s=600.0, grade="mems", imu_rate_hz=50.0)
    assert dive.reference is not None
    write_dive(folder / "dive.mcap", dive)
    rng = np.random.default_rng(1)
    rows = np.arange(1, len(dive.reference.time_ns), 10)
    range_m = np.linalg.norm(from_centre_m(dive.reference.position[rows]) - from_centre_m(np.array(BEACON)), axis=1)
    range_m += RANGE_SD_M * rng.standard_normal(len(rows))
    with (folder / "ranges.mcap").open("wb") as stream:
        writer = Writer(stream)
        definition = "std_msgs/Header header\nfloat64 range\n" + "=" * 80 + (
            "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
        ) + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"  # fmt: skip
        schema = writer.register_msgdef("usbl_msgs/msg/Range", definition)
        for time_ns, metres in zip((dive.reference.time_ns[rows] + 200_000_000).tolist(), range_m, strict=True):
            stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
            header = {"stamp": stamp, "frame_id": "usbl"}
            writer.write_message("/usbl/range", schema, {"header": header, "range": float(metres)}, time_ns, time_ns)
        writer.finish()
    return [folder / "dive.mcap", folder / "ranges.mcap"]


def ranged(**changes: object) -> Config:
    mems = load_config("mems")
    filters = {
        "baseline": Filter(aiding=("velocity",), states=("position",)),
        "mine": Filter(aiding=("velocity", "own_sensors:Range"), states=("position",)),
    }
    settings = {"noise": mems.noise, "initial": mems.initial, "filters": filters, "topics": {"beacon": BEACONS}}
    return Config(evaluation=Evaluation(starts=1), position=Position(), **(settings | changes))  # type: ignore[arg-type]


def test_a_topic_of_the_log_aids_by_a_class_of_ones_own(tmp_path: Path) -> None:
    replay = replay_log(dive_with_a_beacon(tmp_path), ranged())
    met = next(one for one in replay.histories[1].innovations if one.measurement == "range")
    assert met.used.all()
    assert 0.8 < met.nis.mean() < 1.2
    rms_m = {
        name: float(np.sqrt(np.mean(errors.position_error_ned_m[:, :2] ** 2))) for name, errors in replay.errors.items()
    }
    assert rms_m["mine"] < 0.5 * rms_m["baseline"]
    assert [channel.role for channel in replay.dive.channels if channel.topic == "/usbl/range"] == ["topics.beacon"]


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        (Topic(topic="/usbl/rnge", values="range"), r"no messages on topic '/usbl/rnge' \(topics.beacon.topic\)"),
        (Topic(topic="/usbl/range", values="rnge"), "rnge"),
    ],
)
def test_a_topic_that_is_named_wrong_is_told(tmp_path: Path, topic: Topic, reason: str) -> None:
    with pytest.raises(LogError, match=reason):
        replay_log(dive_with_a_beacon(tmp_path), ranged(topics={"beacon": topic}))


def test_topics_are_settings_that_are_written_and_read_again(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('[topics.beacon]\ntopic = "/usbl/range"\nvalues = "range"\nlatency_s = 0.2\n')
    config = load_config(file=file)
    assert config.topics == {"beacon": BEACONS}
    file.write_text(render_toml(config))
    assert load_config(file=file) == config
    with pytest.raises(ConfigError, match=r"topics\.beacon: lacks values"):
        load_config(overrides=['topics.beacon.topic="/usbl/range"'])
    with pytest.raises(ConfigError, match="the topic's name 'a-b' is not a letter"):
        load_config(overrides=['topics.a-b.topic="/x"', 'topics.a-b.values="y"'])
