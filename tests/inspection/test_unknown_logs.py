"""A log with topics nobody has seen before is replayed from what `inspect` prints, and from nothing else."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import unknown_logs
from frames import frames
from mcap.writer import Writer
from unknown_logs import decided

from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.tables import Tables
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.inspection.probed_topics import FieldMatch
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats.fields import check_path
from insdvl_replay.preparation.replay import replay_log

START = {"initial.heading_deg": "30.0", "initial.latitude_deg": "32.8"}


@pytest.fixture(scope="module")
def turning() -> Dive:
    return unknown_logs.plain_dive("figure-eight", imu_rate_hz=50.0)


@pytest.fixture(scope="module")
def straight() -> Dive:
    """No swing that would tell the unit of the gyros."""
    return unknown_logs.plain_dive("straight")


def assert_same_tables(found: Tables, expected: Tables) -> None:
    for name, table in frames(expected).items():
        columns = [column for column in table.columns if column != "log"]
        pd.testing.assert_frame_equal(
            frames(found)[name][columns], table[columns], rtol=1e-6, atol=1e-9
        )


@pytest.mark.parametrize(
    ("write", "answers"),
    [
        (unknown_logs.nested_cdr, {"imu.angular_rate_unit": '"rad/s"'}),
        (
            unknown_logs.bare_json,
            {"imu.angular_rate_unit": '"deg/s"', "imu.axes": '"flu"', "dvl.axes": '"frd"'},
        ),
        (unknown_logs.protobuf, {"imu.angular_rate_unit": '"rad/s"', "dvl.axes": '"frd"'}),
    ],
)
def test_dive_in_unknown_types_gives_the_tables_of_known_ones(
    write: Callable[[Path, Dive], None], answers: dict[str, str], straight: Dive, tmp_path: Path
) -> None:
    log, known, file = (
        tmp_path / "unknown.mcap",
        tmp_path / "known.mcap",
        tmp_path / "vehicle.toml",
    )
    write(log, straight)
    inventory = inspect_log(log, load_config())
    assert [blocker.message for blocker in inventory.remaining] == []
    file.write_text(decided(inventory, START | answers))
    unknown_logs.known_types(known, straight)
    start = [f"{key}={value}" for key, value in START.items()]
    # Without a file the settings are those of the paper, whose start is as uncertain as they say.
    as_by_file = ["initial.source=level", "initial.uncertainty=source"]
    expected = replay_log(known, load_config(overrides=[*as_by_file, *start]))
    assert_same_tables(replay_log(log, load_config(file=file)).tables, expected.tables)


def as_flu(vector: np.ndarray) -> np.ndarray:
    return vector * [1.0, -1.0, -1.0]


def on_its_side(vector: np.ndarray) -> np.ndarray:
    """x forward, y down, z to port."""
    return vector[..., [0, 2, 1]] * [1.0, 1.0, -1.0]


@pytest.mark.parametrize(
    ("turn", "axes", "scale"),
    [
        pytest.param(as_flu, "flu", 1.0, marks=pytest.mark.nightly),
        (as_flu, "flu", 0.6),
        pytest.param(on_its_side, "+x-z+y", 1.0, marks=pytest.mark.nightly),
    ],
)
def test_trials_find_units_axes_and_scale(
    turn: Callable[[np.ndarray], np.ndarray],
    axes: str,
    scale: float,
    turning: Dive,
    tmp_path: Path,
) -> None:
    log = tmp_path / "unknown.mcap"
    scaled = replace(turning.imu, angular_rate_b=scale * turning.imu.angular_rate_b)
    unknown_logs.turned(log, replace(turning, imu=scaled), turn)
    config = find_settings([[log]], Given(load_config())).config
    assert (config.imu.axes, config.imu.angular_rate_unit, config.imu.specific_force_unit) == (
        axes,
        "deg/s",
        "g",
    )
    assert config.imu.angular_rate_scale == pytest.approx(scale, abs=0.01)
    assert (config.dvl.velocity_unit, config.dvl.stamp) == ("mm/s", "stamp_ms")
    read, known = replay_log(log, config).velocities, tmp_path / "known.mcap"
    write_dive(known, turning)
    truth = replay_log(known, load_config()).velocities
    count = min(len(read.velocity_b), len(truth.velocity_b))
    # This vehicle never slips sideways: a DVL on its back measures the same.
    np.testing.assert_allclose(
        read.velocity_b[-count:, 0], truth.velocity_b[-count:, 0], atol=0.02
    )


def test_fields_without_telling_names_are_listed_with_what_they_hold(
    straight: Dive, tmp_path: Path
) -> None:
    """Three single numbers that nothing is known of: the list and the comma form lead to a replay."""
    log, file = tmp_path / "unknown.mcap", tmp_path / "vehicle.toml"
    unknown_logs.nameless_json(log, straight)
    inventory = inspect_log(log, load_config())
    for field in (
        '"one", 15001 messages',
        '"alpha", median',
        '"epsilon", median -9.8',
        '"east", median',
    ):
        assert re.search(rf"#   +{field}", inventory.configuration)
    fields = {
        "imu.topic": '"one"', "imu.specific_force": '"gamma, delta, epsilon"', "imu.angular_rate": '"zeta, eta, alpha"',
        "dvl.topic": '"two"', "dvl.velocity": '"east, west, south"',
    }  # fmt: skip
    file.write_text(decided(inventory, START | fields))
    assert not inspect_log(log, load_config(file=file), deep=True).blockers


def test_beams_with_names_of_their_own_are_proposed(straight: Dive, tmp_path: Path) -> None:
    log, file = tmp_path / "unknown.mcap", tmp_path / "vehicle.toml"
    unknown_logs.numbered_beams(log, straight)
    inventory = inspect_log(log, load_config())
    assert {"dvl.beam_tilt_deg", "dvl.beam_azimuth_deg"} <= set(inventory.decisions)
    file.write_text(decided(inventory, START | {"dvl.beam_tilt_deg": "25.0"}))
    config = load_config(file=file)
    assert config.dvl.beam_velocity == "vel_beam_1, vel_beam_2, vel_beam_3, vel_beam_4"
    assert config.dvl.beam_azimuth_deg == (45.0, 135.0, 225.0, 315.0)
    assert not inspect_log(log, config, deep=True).blockers


def test_proposal_follows_the_topic_that_is_named(straight: Dive, tmp_path: Path) -> None:
    log = tmp_path / "unknown.mcap"
    unknown_logs.nested_cdr(log, straight)
    configuration = inspect_log(log, load_config(overrides=['dvl.topic="/box"'])).configuration
    imu, _, dvl = configuration.partition("[dvl]")
    assert '"/dvl/track", 150 messages' in imu
    assert '"/box", 15001 messages' in dvl
    assert "/dvl/track" not in dvl


def test_what_is_set_already_is_not_proposed_again(straight: Dive, tmp_path: Path) -> None:
    log = tmp_path / "unknown.mcap"
    unknown_logs.nested_cdr(log, straight)
    known = [
        'dvl.velocity="v, u, w"',
        "dvl.velocity_unit=cm/s",
        "dvl.axes=flu",
        "dvl.lever_arm_m=[1.0, 0.0, 0.0]",
    ]
    dvl = inspect_log(log, load_config(overrides=known)).configuration.partition("[dvl]")[2]
    assert 'topic = "/dvl/track"' in dvl
    assert not re.search(r"(?m)^(velocity|velocity_unit|axes|lever_arm_m) =", dvl)


def test_forces_alone_are_no_imu(tmp_path: Path) -> None:
    log = tmp_path / "unknown.mcap"
    with log.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("shake", "json", 0)
        for i in range(100):
            writer.add_message(
                channel, i, b'{"accel": [0.0, 0.0, 9.8], "raw_accel": [0.0, 0.0, 1.0]}', i
            )
        writer.finish()
    configuration = inspect_log(log, load_config()).configuration
    assert '"shake", 100 messages' in configuration
    assert not re.search(r"(?m)^topic", configuration)


def test_flags_of_good_pings_are_proposed_by_name(straight: Dive, tmp_path: Path) -> None:
    log = tmp_path / "unknown.mcap"
    unknown_logs.nested_cdr(log, straight)
    inventory = inspect_log(log, load_config())
    assert re.search(
        r"# 'lock' is named so and marks 0 of \d+ pings\nvalid = \"lock\"", inventory.configuration
    )


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("imu.angular_rate=gyroscope", "'gyroscope'"),
        ("imu.angular_rate=gamma", "'gamma' .*1 .*3 "),
        ("imu.angular_rate=name", "'name' .*text"),
    ],
)
def test_errors_about_fields_list_those_there_are(
    setting: str, named: str, straight: Dive, tmp_path: Path
) -> None:
    log = tmp_path / "unknown.mcap"
    unknown_logs.nameless_json(log, straight)
    known = [
        'imu.topic="one"',
        'imu.specific_force="gamma, delta, epsilon"',
        "dvl.topic=two",
        "dvl.velocity=east",
    ]
    with pytest.raises(LogError, match=named) as raised:
        read_dive(log, load_config(overrides=[*known, setting]))
    assert "gamma (number), delta (number), epsilon (number), zeta (number)" in raised.value.hint
    assert '"p, q, r"' in raised.value.hint
    assert "name (" not in raised.value.hint


def test_of_many_fields_those_named_alike_are_listed() -> None:
    known = {f"temperature_{i}": "float32" for i in range(100)} | {
        "gyro_rate": "float64",
        "note": "string",
    }
    with pytest.raises(LogError) as raised:
        check_path("gyro", known, "acme/msg/Imu")
    assert "'gyro_rate'" in raised.value.hint
    assert "gyro_rate (float64) and 77 more" in raised.value.hint


@pytest.mark.parametrize(
    ("size", "unit"),
    [(9.8, "m/s2"), (1.01, "g"), (990.0, "mg"), (3.0, ""), (0.0, "")],
    ids=lambda value: str(value),
)
def test_a_vector_of_the_size_of_gravity_has_a_unit(size: float, unit: str) -> None:
    median = np.array([0.0, 0.0, -size])
    assert FieldMatch("a", median, size, size).force_unit == unit
    assert FieldMatch("a[*]", median, size, size).force_unit == "", "beams"
