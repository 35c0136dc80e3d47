"""A measurement of a user's own aids a filter, compiled or as it is, and stands in the tables."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap_ros2.writer import Writer
from own_sensors import BEACON, RANGE_SD_M

from insdvl_replay.core.config import (
    Config,
    Depth,
    Evaluation,
    Filter,
    Heading,
    Position,
    Span,
    Topic,
)
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import is_used
from insdvl_replay.core.runtime import plain
from insdvl_replay.core.words import Consistency, Whiteness
from insdvl_replay.logs.write import write_dive
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors


def replayed(word: str, duration_s: float = 200.0) -> Replay:
    dive = simulate_dive(
        "lawnmower", seed=4, duration_s=duration_s, grade="mems", imu_rate_hz=50.0
    )
    mine = Filter(aiding=("velocity", word), gate_probability=0.999)
    mems, filters = load_config("mems"), {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    config = Config(
        noise=mems.noise, initial=mems.initial, filters=filters, evaluation=Evaluation(starts=1)
    )
    return replay_dive(dive, config)


def test_it_is_met_evaluated_and_shown() -> None:
    replay = replayed("own_sensors:Speed")
    met = next(one for one in replay.histories[1].innovations if one.measurement == "speed")
    assert met.used.mean() > 0.99
    assert 0.7 < met.nis.mean() < 1.3
    row = next(row for row in replay.tables.consistency if row.measurement == "speed")
    assert row.used == int(met.used.sum())
    assert not [note for note in replay.notes if note.code == "user_measurement_plain"]


@pytest.mark.parametrize("name", ["PlainSpeed", "ImportingSpeed"])
@pytest.mark.nightly
def test_what_cannot_be_compiled_gives_the_same_and_says_so(name: str) -> None:
    compiled, plain = replayed("own_sensors:Speed", 20.0), replayed(f"own_sensors:{name}", 20.0)
    np.testing.assert_allclose(
        plain.histories[1].velocity_n, compiled.histories[1].velocity_n, rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(plain.histories[1].sd, compiled.histories[1].sd, rtol=1e-9)
    (note,) = [note for note in plain.notes if note.code == "user_measurement_plain"]
    assert name in note.text


def test_readings_of_one_component_need_no_second_axis() -> None:
    flat, uneven, even = (
        replayed(f"own_sensors:{name}", 20.0).histories[1] for name in ("Flat", "Uneven", "Speed")
    )
    np.testing.assert_array_equal(flat.velocity_n, uneven.velocity_n)
    assert np.abs(flat.velocity_n - even.velocity_n).max() > 1e-4


def test_what_its_author_has_compiled_is_compiled_with_the_filter() -> None:
    jitted, given = replayed("own_sensors:JittedSpeed", 20.0), replayed("own_sensors:Speed", 20.0)
    np.testing.assert_array_equal(jitted.histories[1].velocity_n, given.histories[1].velocity_n)
    assert not [note for note in jitted.notes if note.code == "user_measurement_plain"]


@pytest.mark.parametrize(
    ("word", "values"),
    [
        ("nowhere_at_all:Speed", "'nowhere_at_all'"),
        ("own_sensors:Three", "'three_x'"),
        ("own_sensors:Six", r"\(101,\) .*\(101, 6\), .*\(k,\) .*\(k, s\)"),
        ("own_sensors:Leaving", r"\d+ .*own_sensors.py: SystemExit: no file of ranges"),
        ("own_sensors:NoPrediction", r"predict\(ins, z, H\)"),
        ("own_sensors:NoReadings", r"readings\(self, dive\)"),
        ("own_sensors:WithArguments", "'sd'"),
        (
            "own_sensors:OtherTopic",
            r"readings\(self, dive\) .*\d+ .*own_sensors.py: KeyError: 'sped'",
        ),
        ("own_sensors:Unreturned", "NoneType.* UserReadings"),
        ("own_sensors:NoNumbers", "2 of 101 .*7"),
        ("own_sensors:Misspelt", r"predict\(ins, z, H\) .*\d+ .*own_sensors.py: NameError"),
    ],
)
def test_what_is_none_is_reported_with_its_name(word: str, values: str) -> None:
    with pytest.raises(ConfigError, match=f"{word}.*{values}"):
        replayed(word, 20.0)


def test_a_module_that_is_no_python_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "no_python.py").write_text("x = (\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"no_python:X .*SyntaxError: .*line 1"):
        replayed("no_python:X", 20.0)


def test_a_module_that_leaves_as_it_is_imported_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_script.py").write_text("import sys\n\nsys.exit()\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"a_script:X .*SystemExit"):
        replayed("a_script:X", 20.0)


def test_one_that_ends_early_is_reported_by_its_name() -> None:
    notes = [
        note for note in replayed("own_sensors:Silent").notes if note.code == "paddle_wheel_silent"
    ]
    assert [re.findall(r"\d+", note.text) for note in notes] == [["140", "200", "60"]]


# --- Several in one filter.

DEEP, BOW, PLAIN_BOW = "own_sensors:Deep", "own_sensors:Bow", "own_sensors:PlainBow"


@pytest.fixture(scope="module")
def with_depth() -> Dive:
    """A dive whose depth and heading were measured, each at times of its own."""
    sensors = {"depth": SensorErrors(0.05, 4.0), "heading": SensorErrors(1.0, 1.0)}
    return simulate_dive(
        "lawnmower", seed=4, duration_s=200.0, grade="mems", imu_rate_hz=50.0, sensors=sensors
    )


def aided(end_s: float | None = None, **filters: tuple[str, ...]) -> Config:
    mems = load_config("mems")
    settings = {
        name: Filter(aiding=aiding, states=("position",)) for name, aiding in filters.items()
    }
    return Config(
        noise=mems.noise, initial=mems.initial, filters=settings, evaluation=Evaluation(starts=1),
        depth=Depth(sd_m=0.05, surface_height_m=0.0), heading=Heading(sd_deg=1.0), span=Span(end_s=end_s),
    )  # fmt: skip


def assert_same(history: History, expected: History) -> None:
    np.testing.assert_allclose(history.velocity_n, expected.velocity_n, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(history.mat_nb, expected.mat_nb, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        history.position[:, 2], expected.position[:, 2], rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(history.sd, expected.sd, rtol=1e-9)
    for own, built_in in zip(history.innovations, expected.innovations, strict=True):
        np.testing.assert_array_equal(own.time_ns, built_in.time_ns)
        np.testing.assert_allclose(own.nis, built_in.nis, rtol=1e-6, atol=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("words", "own", "end_s"),
    [
        (("velocity", "depth", "heading"), ("velocity", DEEP, BOW), 200.0),
        (("heading", "velocity", "depth"), (BOW, "velocity", DEEP), 200.0),
        (("velocity", "heading", "depth"), ("velocity", PLAIN_BOW, DEEP), 40.0),
    ],
)
def test_two_give_what_the_sensors_give_that_the_tool_has(
    with_depth: Dive, words: tuple[str, ...], own: tuple[str, ...], end_s: float
) -> None:
    """The tool's own depth estimates its zero; without this state it predicts what the class does."""
    config = aided(end_s, built_in=words, mine=own)
    prepared = prepare_dive(with_depth, config)
    built_in, mine = prepared.filters
    built_in = replace(
        built_in, states=mine.states, more_sd=mine.more_sd, more_density=mine.more_density
    )
    timeline = prepared_timeline(with_depth, prepared)
    assert_same(run_one(mine, prepared, timeline), run_one(built_in, prepared, timeline))


def test_a_column_that_a_filter_does_not_have_is_refused(with_depth: Dive) -> None:
    """Compiled code would write it somewhere else."""
    config = aided(20.0, baseline=("velocity",), mine=("velocity", DEEP))
    mine = msgspec.structs.replace(config.filters["mine"], states=())
    config = msgspec.structs.replace(config, filters={**config.filters, "mine": mine})
    with pytest.raises(
        ConfigError, match=r"Deep: predict\(ins, z, H\) .*\d+ .*IndexError"
    ) as refusal:
        prepare_dive(with_depth, config)
    assert re.search(
        r'filters\.mine .*12 .*\(1,\) .*\(1, 12\); .*12 .*14: states = \["position"\]',
        refusal.value.hint,
    )


@pytest.mark.parametrize(
    ("word", "values"),
    [
        (DEEP, None),
        (BOW, None),
        (PLAIN_BOW, None),
        ("own_sensors:Speed", None),
        ("own_sensors:DeepTwice", None),
        ("own_sensors:WrongSign", r"H\[0, 14\] .*-1,.* 1"),
        ("own_sensors:NoJacobian", "H .*"),
    ],
)
def test_a_jacobian_that_contradicts_its_prediction_is_reported(
    with_depth: Dive, word: str, values: str | None
) -> None:
    prepared = prepare_dive(
        with_depth, aided(20.0, baseline=("velocity",), mine=("velocity", word))
    )
    found = [note.text for note in prepared.notes if note.code == "user_measurement_jacobian"]
    assert len(found) == (values is not None)
    assert all(
        word in text and "filters.mine" in text and re.search(values or "", text) for text in found
    )


@pytest.mark.nightly
def test_several_are_evaluated_each_by_its_name(with_depth: Dive) -> None:
    replay = replay_dive(
        with_depth,
        aided(baseline=("velocity",), both=("velocity", DEEP, BOW), one=(BOW, "velocity")),
    )
    for name, readings in (("deep", 800), ("bow", 200)):
        row = next(
            row
            for row in replay.tables.consistency
            if (row.filter, row.measurement) == ("both", name)
        )
        assert (row.used, row.verdict, row.whiteness) == (
            readings,
            Consistency.CONSISTENT,
            Whiteness.WHITE,
        )
    measured = {
        history.filter: [met.measurement for met in history.innovations]
        for history in replay.histories
    }
    assert measured == {
        "baseline": ["velocity"],
        "both": ["velocity", "deep", "bow"],
        "one": ["bow", "velocity"],
    }
    assert not [note for note in replay.notes if note.code == "user_measurement_plain"]


@pytest.mark.nightly
def test_a_filter_next_to_one_that_cannot_be_compiled_is(
    with_depth: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran_plain = []
    monkeypatch.setattr(
        "insdvl_replay.nav.filter.plain", lambda run: ran_plain.append(run) or plain(run)
    )
    config = aided(40.0, slow=("velocity", PLAIN_BOW, DEEP), fast=("velocity", BOW, DEEP))
    prepared = prepare_dive(with_depth, config)
    timeline = prepared_timeline(with_depth, prepared)
    slow, fast = (run_one(filter_, prepared, timeline) for filter_ in prepared.filters)
    assert len(ran_plain) == 1
    assert_same(slow, fast)


@pytest.mark.parametrize(
    ("aiding", "names"),
    [
        (
            ("own_sensors:Speed", "own_sensors:OtherSpeed"),
            "filters.mine .*own_sensors:Speed .*:OtherSpeed.*'speed'",
        ),
        (("own_sensors:FirstOfSpeed",), "FirstOfSpeed .*'speed_c1'"),
        ((DEEP, "own_sensors:BuiltIn"), "BuiltIn .*'depth'"),
    ],
)
def test_names_of_rows_that_are_taken_are_refused(
    with_depth: Dive, aiding: tuple[str, ...], names: str
) -> None:
    config = aided(
        20.0, baseline=("velocity",), mine=("velocity", *aiding), other=("velocity", aiding[0])
    )
    with pytest.raises(ConfigError, match=names):
        replay_dive(with_depth, config)


def test_components_have_rows_and_no_vote(with_depth: Dive) -> None:
    replay = replay_dive(
        with_depth, aided(20.0, baseline=("velocity",), mine=("velocity", "own_sensors:DeepTwice"))
    )
    rows = [row.measurement for row in replay.tables.consistency if row.filter == "mine"]
    of_mine = [row for row in rows if row.startswith("deep_twice")]
    assert of_mine == ["deep_twice", "deep_twice_c1", "deep_twice_c2"]
    assert [row for row in of_mine if is_used(row)] == ["deep_twice"]


@pytest.mark.nightly
def test_two_of_one_name_are_in_two_filters(with_depth: Dive) -> None:
    words = {
        "baseline": ("velocity",),
        "mine": ("own_sensors:Speed",),
        "other": ("own_sensors:OtherSpeed",),
    }
    replay = replay_dive(with_depth, aided(20.0, **words))
    assert_same(replay.histories[1], replay.histories[2])


def test_a_word_that_is_twice_or_is_not_known_is_reported_with_its_place() -> None:
    own = '"own_sensors:Speed"'
    with pytest.raises(ConfigError, match=r"filters\.mine\.aiding\[1\] 'own_sensors:Speed'"):
        load_config(overrides=[f"filters.mine.aiding=[{own},{own}]"])
    with pytest.raises(ConfigError, match=r"filters\.mine\.aiding\[1\] 'velocty'"):
        load_config(overrides=[f'filters.mine.aiding=[{own},"velocty"]'])


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
    range_m = np.linalg.norm(
        from_centre_m(dive.reference.position[rows]) - from_centre_m(np.array(BEACON)), axis=1
    )
    range_m += RANGE_SD_M * rng.standard_normal(len(rows))
    with (folder / "ranges.mcap").open("wb") as stream:
        writer = Writer(stream)
        definition = "std_msgs/Header header\nfloat64 range\n" + "=" * 80 + (
            "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
        ) + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"  # fmt: skip
        schema = writer.register_msgdef("usbl_msgs/msg/Range", definition)
        for time_ns, metres in zip(
            (dive.reference.time_ns[rows] + 200_000_000).tolist(), range_m, strict=True
        ):
            stamp = {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}
            header = {"stamp": stamp, "frame_id": "usbl"}
            writer.write_message(
                "/usbl/range", schema, {"header": header, "range": float(metres)}, time_ns, time_ns
            )
        writer.finish()
    return [folder / "dive.mcap", folder / "ranges.mcap"]


def ranged(**changes: object) -> Config:
    mems = load_config("mems")
    filters = {
        "baseline": Filter(aiding=("velocity",), states=("position",)),
        "mine": Filter(aiding=("velocity", "own_sensors:Range"), states=("position",)),
    }
    settings = {
        "noise": mems.noise,
        "initial": mems.initial,
        "filters": filters,
        "topics": {"beacon": BEACONS},
    }
    return Config(evaluation=Evaluation(starts=1), position=Position(), **(settings | changes))  # type: ignore[arg-type]


@pytest.mark.nightly
def test_a_topic_of_the_log_aids_by_a_class_of_ones_own(tmp_path: Path) -> None:
    replay = replay_log(dive_with_a_beacon(tmp_path), ranged())
    met = next(one for one in replay.histories[1].innovations if one.measurement == "range")
    assert met.used.all()
    assert 0.8 < met.nis.mean() < 1.2
    rms_m = {
        name: float(np.sqrt(np.mean(errors.position_error_ned_m[:, :2] ** 2)))
        for name, errors in replay.errors.items()
    }
    assert rms_m["mine"] < 0.5 * rms_m["baseline"]
    assert [
        channel.role for channel in replay.dive.channels if channel.topic == "/usbl/range"
    ] == ["topics.beacon"]


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        (Topic(topic="/usbl/rnge", values="range"), r"'/usbl/rnge' \(topics.beacon.topic\)"),
        (Topic(topic="/usbl/range", values="rnge"), "rnge"),
    ],
)
def test_a_topic_that_is_named_wrong_is_reported(
    tmp_path: Path, topic: Topic, reason: str
) -> None:
    with pytest.raises(LogError, match=reason):
        replay_log(dive_with_a_beacon(tmp_path), ranged(topics={"beacon": topic}))


def test_topics_are_settings_that_are_written_and_read_again(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('[topics.beacon]\ntopic = "/usbl/range"\nvalues = "range"\nlatency_s = 0.2\n')
    config = load_config(file=file)
    assert config.topics == {"beacon": BEACONS}
    file.write_text(render_toml(config))
    assert load_config(file=file) == config
    with pytest.raises(ConfigError, match=r"topics\.beacon: .*values"):
        load_config(overrides=['topics.beacon.topic="/usbl/range"'])
    with pytest.raises(ConfigError, match="'a-b'"):
        load_config(overrides=['topics.a-b.topic="/x"', 'topics.a-b.values="y"'])
