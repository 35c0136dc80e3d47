"""Single faults of sensors and clocks: dropped and counted with a warning, or refused, never in the tables unsaid."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import write_dive
from insdvl_replay.logs.columns.tables import clock_notes
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import Replay, replay_log
from insdvl_replay.sim.dive import simulate_dive

CONFIG = load_config("levy-klein")


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("straight", seed=4, duration_s=60.0)


def replayed(dive: Dive, path: Path) -> Replay:
    write_dive(path, dive)
    return replay_log(path, CONFIG)


def position_rms_m(replay: Replay) -> float:
    return float(
        frame(replay.tables.reference_error).set_index("quantity").loc["position_h", "rmse"]
    )


def with_force_spike(dive: Dive) -> Dive:
    force = dive.imu.specific_force_b.copy()
    force[3000, 1] = 1e5
    return replace(dive, imu=replace(dive.imu, specific_force_b=force))


def with_dead_samples(dive: Dive) -> Dive:
    force, rate = dive.imu.specific_force_b.copy(), dive.imu.angular_rate_b.copy()
    force[2000:2010], rate[2000:2010] = 0.0, 0.0
    return replace(dive, imu=replace(dive.imu, specific_force_b=force, angular_rate_b=rate))


def with_beam_spike(dive: Dive) -> Dive:
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[30, 2] = 50.0
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def with_lost_lock(dive: Dive) -> Dive:
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[20:40] = 0.0
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def with_dvl_that_stands_still(dive: Dive) -> Dive:
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[21:30] = beams[20]
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def with_lost_samples(dive: Dive) -> Dive:
    force = dive.imu.specific_force_b.copy()
    force[2000:2020, 0] = np.nan
    return replace(dive, imu=replace(dive.imu, specific_force_b=force))


def with_position_zero(dive: Dive) -> Dive:
    assert dive.reference is not None
    position = dive.reference.position.copy()
    position[10:13, :2] = 0.0
    return replace(dive, reference=replace(dive.reference, position=position))


@pytest.mark.parametrize(
    ("fault", "code", "count"),
    [
        (with_force_spike, "imu_impossible", 1),
        (with_dead_samples, "imu_impossible", 10),
        (with_beam_spike, "dvl_impossible", 1),
        (with_lost_lock, "dvl_zero", 20),
        (with_dvl_that_stands_still, "dvl_stuck", 9),
        (with_lost_samples, "imu_not_finite", 20),
        (with_position_zero, "reference_zero", 3),
    ],
)
def test_fault_is_counted_with_a_warning_and_does_not_reach_the_filters(
    fault: Callable[[Dive], Dive], code: str, count: int, dive: Dive, tmp_path: Path
) -> None:
    sound = replayed(dive, tmp_path / "sound.mcap")
    faulty = replayed(fault(dive), tmp_path / "faulty.mcap")
    (note,) = [note for note in faulty.notes if note.code == code]
    assert (note.severity, note.count) == ("warning", count)
    assert re.search(r"\b\d+\.\d{3} s\b", note.text)
    assert re.search(r"\b(imu|dvl|reference)\.[a-z_]+\b", note.hint), (
        "a hint names the key that helps"
    )
    assert position_rms_m(faulty) == pytest.approx(position_rms_m(sound), abs=0.25)


def test_single_lost_sample_is_no_warning(dive: Dive, tmp_path: Path) -> None:
    force = dive.imu.specific_force_b.copy()
    force[2000, 0] = np.nan
    found = replayed(
        replace(dive, imu=replace(dive.imu, specific_force_b=force)), tmp_path / "dive.mcap"
    ).notes
    # What the innovations say of the settings' noise has nothing to do with it.
    of_noise = ("noise_far_off", "not_evaluated")
    assert [(note.code, note.severity) for note in found if note.code not in of_noise] == [
        ("imu_not_finite", "info")
    ]


@pytest.mark.parametrize("value", [0.0, 0.7])
def test_dvl_that_never_changes_is_refused(value: float, dive: Dive, tmp_path: Path) -> None:
    write_dive(
        tmp_path / "dive.mcap",
        replace(dive, dvl=DvlColumns(dive.dvl.time_ns, velocity_d=np.full((60, 3), value))),
    )
    with pytest.raises(LogError, match=r"/dvl: .* 60 .* 59\.0 s") as refused:
        read_checked_dive(tmp_path / "dive.mcap", CONFIG)
    assert "dvl.velocity" in refused.value.hint


def test_dvl_in_another_unit_is_refused_with_and_without_a_reference(
    dive: Dive, tmp_path: Path
) -> None:
    assert dive.dvl.beam_velocity_mps is not None
    milli = replace(
        dive, dvl=replace(dive.dvl, beam_velocity_mps=1000.0 * dive.dvl.beam_velocity_mps)
    )
    for name, wrong in (("with", milli), ("without", replace(milli, reference=None))):
        write_dive(tmp_path / f"{name}.mcap", wrong)
        with pytest.raises(LogError) as refused:
            read_checked_dive(tmp_path / f"{name}.mcap", CONFIG)
        assert 'dvl.velocity_unit = "mm/s"' in refused.value.hint


def clock(role: str, median_s: float, spread_s: float) -> Clock:
    return replace(
        CLOCK, role=role, topic=f"/{role}", log_minus_stamp_s=median_s, spread_s=spread_s
    )


CLOCK = Clock(
    role="imu", topic="/imu", stamp="header", messages=1000, log_minus_stamp_s=0.0, spread_s=0.0,
    back_steps=0, repeats=0, rate_hz=100.0,
)  # fmt: skip


def test_clock_that_drifts_is_no_excuse_for_itself() -> None:
    notes = clock_notes(
        "dive", [clock("imu", 0.0, 0.01), clock("dvl", -1.5, 5.4)], max_disagreement_s=1.0
    )
    assert "dvl_clock_unsteady" in {note.code for note in notes if note.severity == "warning"}
    with pytest.raises(LogError, match="clocks"):
        clock_notes(
            "dive", [clock("imu", 0.0, 0.01), clock("dvl", -3.0, 5.4)], max_disagreement_s=1.0
        )


def test_jitter_of_a_recorder_is_no_drift() -> None:
    assert (
        clock_notes(
            "dive", [clock("imu", 0.02, 0.3), clock("dvl", 0.1, 0.4)], max_disagreement_s=1.0
        )
        == ()
    )
