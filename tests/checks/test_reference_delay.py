"""The delay of a reference against the IMU: how well it is found, when it is told, and what tells nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.checks.reference_delay import (
    reference_delay,
    with_reference_delay,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns, nanoseconds
from insdvl_replay.core.dive_record import LATE_S
from insdvl_replay.core.words import DelayStatus, Verdict
from insdvl_replay.geometry.rotation import mat_from_vector
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

RATES_HZ = (1.0, 5.0, 20.0)
ATTITUDE_SD_DEG = 0.1
VELOCITY_SD_MPS = 0.01


@pytest.fixture(scope="module")
def turning() -> dict[float, Dive]:
    """Return the same dive, whose pings are late by 0.12 s, with references of several rates."""
    return {
        rate_hz: simulate_dive(
            "figure-eight", seed=3, grade="mems", reference_rate_hz=rate_hz, dvl_delay_s=0.12
        )
        for rate_hz in RATES_HZ
    }


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def later(reference: ReferenceColumns, delay_s: float) -> ReferenceColumns:
    return replace(reference, time_ns=reference.time_ns + nanoseconds(delay_s))


def noisy(reference: ReferenceColumns, seed: int) -> ReferenceColumns:
    draw = np.random.default_rng(seed)
    shape = reference.velocity_n.shape
    turned = mat_from_vector(np.radians(ATTITUDE_SD_DEG) * draw.standard_normal(shape))
    velocity_n = reference.velocity_n + VELOCITY_SD_MPS * draw.standard_normal(shape)
    return replace(reference, mat_nb=reference.mat_nb @ turned, velocity_n=velocity_n)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("delay_s", [0.2, 0.05, 0.005, 0.0, -0.1, 1.3, 2.0])
def test_delay_of_an_exact_reference_is_found_to_a_millisecond(
    turning: dict[float, Dive], rate_hz: float, delay_s: float
) -> None:
    dive = turning[rate_hz]
    found = reference_delay(dive.imu, later(reference_of(dive), delay_s))
    assert found.delay_s == pytest.approx(delay_s, abs=1e-3)
    assert found.status == DelayStatus.DETERMINED
    assert found.is_late == (abs(delay_s) > LATE_S)


@pytest.mark.parametrize(
    "rate_hz",
    [RATES_HZ[0], *(pytest.param(rate_hz, marks=pytest.mark.nightly) for rate_hz in RATES_HZ[1:])],
)
def test_delay_of_a_noisy_reference_is_within_its_standard_error(
    turning: dict[float, Dive], rate_hz: float
) -> None:
    dive = turning[rate_hz]
    false_alarms = 0
    for seed in range(10):
        reference = noisy(reference_of(dive), seed)
        for delay_s in (0.0, 0.2, 0.05):
            found = reference_delay(dive.imu, later(reference, delay_s))
            assert found.delay_s is not None
            assert found.sd_s is not None
            assert abs(found.delay_s - delay_s) < 3.0 * found.sd_s
            assert found.sd_s < 0.012
            if delay_s:
                assert found.is_late
            else:
                false_alarms += found.is_late
    assert false_alarms == 0


def test_few_blocks_make_the_standard_error_no_smaller_than_the_errors() -> None:
    """Of a minute and a half with errors that stay for some seconds, as the drift of another filter does."""
    dive = simulate_dive(
        "figure-eight", seed=3, duration_s=90.0, imu_rate_hz=20.0, reference_rate_hz=2.0
    )
    reference = reference_of(dive)
    rows = len(reference.time_ns)
    unknown = np.full_like(reference.velocity_n, np.nan)
    delays_s = []
    sds_s = []
    for seed in range(20):
        draw = np.random.default_rng(seed)
        change = 5e-4 * draw.standard_normal((rows, 3))[np.arange(rows) // 10]
        mat_nb = reference.mat_nb @ mat_from_vector(np.cumsum(change, axis=0))
        drifting = replace(reference, mat_nb=mat_nb, velocity_n=unknown)
        turns = reference_delay(dive.imu, drifting).by_turns
        assert turns is not None
        delays_s.append(turns.delay_s)
        sds_s.append(turns.sd_s)
    size_s = np.sqrt(np.mean(np.square(delays_s)))
    assert 1.0 < np.mean(sds_s) / size_s < 2.0


def test_accelerations_tell_the_delay_of_a_velocity_that_is_later_than_the_attitude() -> None:
    dive = simulate_dive(
        "calibration", seed=3, duration_s=300.0, grade="fog", reference_rate_hz=20.0
    )
    reference = reference_of(dive)
    rows = 6  # of 0.05 s
    velocity_n = np.roll(reference.velocity_n, rows, axis=0)
    mixed = replace(reference, velocity_n=velocity_n).rows(slice(rows, None))
    found = with_reference_delay(replace(dive, reference=mixed, notes=()), Config())
    assert found.reference_delay is not None
    assert found.reference_delay.status == DelayStatus.CONTRADICTORY
    assert found.reference_delay.by_turns is not None
    assert found.reference_delay.by_turns.delay_s == pytest.approx(0.0, abs=2e-3)
    assert found.reference_delay.delay_s == pytest.approx(0.3, abs=0.01)
    assert [note.code for note in found.notes] == ["reference_late"]
    assert "its changes of velocity +0.30" in found.notes[0].text


@pytest.mark.parametrize("scenario", ["straight", "static"])
def test_a_vehicle_that_does_not_turn_tells_nothing(scenario: str) -> None:
    dive = simulate_dive(scenario, seed=3, grade="mems")
    for delay_s in (0.0, 0.3):
        found = reference_delay(dive.imu, later(noisy(reference_of(dive), 1), delay_s))
        assert found.status == DelayStatus.LITTLE_MOTION
        assert not found.is_late


def test_without_attitude_or_reference_nothing_is_said(turning: dict[float, Dive]) -> None:
    dive = turning[5.0]
    assert reference_delay(dive.imu, None).status == DelayStatus.NO_REFERENCE
    assert (
        reference_delay(dive.imu, reference_of(dive).without_attitude()).status
        == DelayStatus.NO_ATTITUDE
    )


def test_jumps_turned_axes_and_pauses_of_the_imu_do_not_matter(turning: dict[float, Dive]) -> None:
    dive = turning[5.0]
    reference = later(reference_of(dive), 0.05)
    turn = mat_from_vector(np.array([0.0, 0.0, np.pi / 2.0]))
    jumped = reference.mat_nb.copy()
    jumped[500::300] = jumped[500::300] @ mat_from_vector(np.array([0.0, 0.0, 0.2]))
    time_ns = dive.imu.time_ns
    away = (time_ns > time_ns[0] + nanoseconds(200.0)) & (
        time_ns < time_ns[0] + nanoseconds(205.0)
    )
    changed = {
        "turned": (dive.imu, replace(reference, mat_nb=reference.mat_nb @ turn)),
        "jumped": (dive.imu, replace(reference, mat_nb=jumped)),
        "paused": (dive.imu.rows(~away), reference),
    }
    for name, (imu, other) in changed.items():
        assert reference_delay(imu, other).delay_s == pytest.approx(0.05, abs=2e-3), name


@pytest.mark.parametrize(
    ("delay_s", "late"), [(0.2, "0.200 +- 0.003 s late"), (-0.1, "0.100 +- 0.003 s early")]
)
def test_note_names_the_setting(turning: dict[float, Dive], delay_s: float, late: str) -> None:
    dive = turning[5.0]
    config = load_config(None, [], ["reference.latency_s=0.03"])
    known = with_reference_delay(
        replace(dive, reference=later(reference_of(dive), delay_s), notes=()), config
    )
    (note,) = known.notes
    assert (note.code, note.severity) == ("reference_late", "warning")
    assert late in note.text
    assert note.hint == f"reference.latency_s = {0.03 + delay_s:.3f}"


@pytest.mark.parametrize("delay_s", [2.0, -10.0])
def test_other_clocks_are_told_before_any_contradiction(
    turning: dict[float, Dive], tmp_path: Path, delay_s: float
) -> None:
    dive = turning[5.0]
    moved = replace(dive, reference=later(reference_of(dive), delay_s))
    log = tmp_path / "dive.mcap"
    write_dive(log, moved)
    config = load_config("mems")
    read = read_checked_dive(log, config)
    warnings = [note for note in read.notes if note.severity == "warning"]
    assert [note.code for note in warnings] == ["reference_other_clock"]
    assert f"reference.latency_s = {delay_s:.3f}" in warnings[0].hint
    replay = replay_dive(read, config)
    verdicts = {found.verdict for found in replay.verdicts.values()}
    assert verdicts == {Verdict.NOT_EVALUATED}
    assert all("clocks differ" in found.reason for found in replay.verdicts.values())
