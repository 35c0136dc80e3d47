"""Beams one by one: what the velocity update says of three and more, and what it cannot of one and two."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from matched_sensors import MATCHED

from insdvl_replay.core.config import Config, Depth, Dvl, Evaluation, Filter, Initial, Position
from insdvl_replay.core.dive_columns import Dive, ImuColumns
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.evaluation.notes import update_notes
from insdvl_replay.evaluation.verdicts import diverged_filters
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors, LostBeam, SensorErrors

BEAM_SD_MPS = 0.01
IMU = ImuErrors(5e-4, 4.4e-5, 0.01, 0.0, 2e-5, 8e-8)
ARM_M = (0.5, -0.2, 0.3)
DIVE_S = 600.0
LOST = (200.0, 260.0)


def simulated(seed: int, **changes: object) -> Dive:
    errors = DvlErrors(BEAM_SD_MPS, 0.0, 0.0, 0.0)
    return simulate_dive(
        "lawnmower", seed=seed, duration_s=DIVE_S, dvl_rate_hz=2.0, imu_errors=IMU, dvl_errors=errors,
        lever_arm_m=ARM_M, mounting_rpy_deg=(2.0, -3.0, 40.0), **changes,  # type: ignore[arg-type]
    )  # fmt: skip


def settings(gate_probability: float = 1.0) -> Config:
    return Config(
        noise=msgspec.structs.replace(MATCHED.noise, accel_white_mps_rts=5e-4),
        initial=Initial(accel_bias_sd_mg=1.02, gyro_bias_sd_degph=0.1),
        dvl=Dvl(beam_sd_mps=BEAM_SD_MPS, lever_arm_m=ARM_M, mounting_rpy_deg=(2.0, -3.0, 40.0)),
        evaluation=Evaluation(starts=1),
        filters={
            "baseline": Filter(aiding=("velocity",), gate_probability=gate_probability),
            "single": Filter(aiding=("beams",), gate_probability=gate_probability),
        },
    )


def histories(dive: Dive, config: Config) -> tuple[History, ...]:
    prepared = prepare_dive(dive, config)
    timeline = prepared_timeline(dive, prepared)
    last_ns = timeline.event_ns[-1:]
    return tuple(
        run_one(filter_, prepared, timeline, cov_ns=last_ns) for filter_ in prepared.filters
    )


def met(history: History, name: str) -> Innovations:
    return next(one for one in history.innovations if one.measurement == name)


def test_with_all_beams_the_posterior_is_that_of_the_velocity() -> None:
    by_velocity, by_beams = histories(simulated(1), settings())
    sd = by_velocity.sd[-1]
    np.testing.assert_allclose(
        by_beams.cov[-1] / np.outer(sd, sd), by_velocity.cov[-1] / np.outer(sd, sd), atol=1e-9
    )
    np.testing.assert_allclose(by_beams.velocity_n, by_velocity.velocity_n, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(by_beams.mat_nb, by_velocity.mat_nb, rtol=0.0, atol=1e-10)


@pytest.mark.nightly
@pytest.mark.parametrize("states", [(), ("dvl_scale",)])
def test_next_to_fixes_and_a_depth_the_posterior_is_that_of_the_velocity_next_to_them(
    states: tuple[str, ...],
) -> None:
    """What a fix has said of the position is not left in the Jacobian of the beams after it."""
    others = ("depth", "position")
    filters = {
        word: Filter(aiding=(word, *others), states=states) for word in ("velocity", "beams")
    }
    dive = simulated(
        1, sensors={"position": SensorErrors(1.0, 2.0), "depth": SensorErrors(0.1, 4.0)}
    )
    by_velocity, by_beams = histories(dive, msgspec.structs.replace(settings(), filters=filters))
    sd = by_velocity.sd[-1]
    np.testing.assert_allclose(
        by_beams.cov[-1] / np.outer(sd, sd), by_velocity.cov[-1] / np.outer(sd, sd), atol=1e-8
    )
    np.testing.assert_allclose(by_beams.velocity_n, by_velocity.velocity_n, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(by_beams.position, by_velocity.position, rtol=0.0, atol=1e-12)


def test_one_update_by_three_or_four_beams_is_that_of_the_velocity_to_rounding() -> None:
    """After the first ping alone, where nothing has had time to drift apart."""
    for lost in ((), (LostBeam(2, 0.0, 10.0),)):
        dive = simulate_dive(
            "straight", seed=3, duration_s=1.0, imu_errors=IMU, lost_beams=lost,
            dvl_errors=DvlErrors(BEAM_SD_MPS, 0.0, 0.0, 0.0),
        )  # fmt: skip
        config = settings()
        config = Config(
            noise=config.noise,
            initial=config.initial,
            dvl=Dvl(beam_sd_mps=0.01),
            filters=config.filters,
        )
        by_velocity, by_beams = histories(dive, config)
        sd = by_velocity.sd[1]
        np.testing.assert_allclose(by_beams.sd[1] / sd, 1.0, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(
            by_beams.velocity_n[1], by_velocity.velocity_n[1], rtol=0.0, atol=1e-12
        )
        np.testing.assert_allclose(by_beams.mat_nb[1], by_velocity.mat_nb[1], rtol=0.0, atol=1e-12)


def test_nis_of_the_beams_is_that_of_the_velocity_and_of_the_parity() -> None:
    by_velocity, by_beams = histories(simulated(2), settings())
    of_beams = sum(met(by_beams, f"beam_{number}").nis for number in range(1, 5))
    np.testing.assert_allclose(
        of_beams, met(by_velocity, "velocity").nis + met(by_beams, "parity").nis, rtol=1e-6
    )
    assert met(by_beams, "parity").nis.mean() == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("arm_m", [(0.0, 0.0, 1.0), (2.0, 0.0, 0.0), (1.0, -0.5, 0.3)])
def test_beams_that_swing_unseen_in_a_gap_say_no_more_than_a_velocity_there(
    arm_m: tuple[float, float, float],
) -> None:
    dive, config = simulated(1), settings()
    imu, at_s = dive.imu, (dive.imu.time_ns - dive.imu.time_ns[0]) * 1e-9
    heard = (at_s < 50.0) | (at_s > 60.0)
    dive = replace(
        dive,
        imu=ImuColumns(imu.time_ns[heard], imu.specific_force_b[heard], imu.angular_rate_b[heard]),
    )
    config = msgspec.structs.replace(
        config, dvl=msgspec.structs.replace(config.dvl, lever_arm_m=arm_m)
    )
    prepared = prepare_dive(dive, config)
    (velocity,), beams = (
        one.measurements(
            prepared.velocities, prepared.mounting, prepared.gaps, beams=prepared.beams
        )
        for one in prepared.filters
    )
    information = sum(
        np.einsum("k,i,j->kij", 1.0 / one.cov[:, 0, 0], one.direction_b, one.direction_b)
        for one in beams
    )
    less = np.linalg.eigvalsh(np.linalg.inv(information) - velocity.cov)
    assert prepared.beams is not None
    inside = prepared.gaps.overlap(prepared.beams.time_ns, prepared.beams.time_ns)
    assert inside.sum() == 20
    assert less[inside].min() > -1e-12
    np.testing.assert_allclose(less[~inside], 0.0, atol=1e-12)


def horizontal_drift_m(replay: Replay, name: str) -> float:
    """How far the error has moved while beams were lost."""
    errors = replay.errors[name]
    at = np.searchsorted(
        errors.time_ns, errors.time_ns[0] + (np.array(LOST) * 1e9).astype(np.int64)
    )
    moved_m = np.diff(errors.position_error_ned_m[at, :2], axis=0)
    return float(np.hypot(*moved_m[0]))


@pytest.mark.nightly
def test_two_beams_are_better_than_none_and_worse_than_all() -> None:
    """Over 60 s, rms of eight dives."""
    every = range(4)
    squared_errors = {"none": [], "two": [1, 2], "all": [*every]}
    drift = {}
    for name, beams in squared_errors.items():
        lost = [LostBeam(beam, *LOST) for beam in beams]
        replays = [replay_dive(simulated(seed, lost_beams=lost), settings()) for seed in range(8)]
        drift[name] = np.sqrt(
            np.mean([horizontal_drift_m(replay, "single") ** 2 for replay in replays])
        )
        nis = np.concatenate(
            [one.nis for replay in replays for one in replay.histories[1].innovations[:4]]
        )
        assert 0.9 < nis.mean() < 1.1
    assert drift["none"] < 0.7 * drift["two"] < 0.5 * drift["all"], drift


def test_pings_of_few_beams_are_not_lost() -> None:
    """30 % of the pings with three beams or fewer: NIS stays right, and no ping is without use."""
    dive = simulated(5)
    assert dive.dvl.beam_velocity_mps is not None
    rng, beams = np.random.default_rng(1), dive.dvl.beam_velocity_mps.copy()
    for row in np.flatnonzero(rng.random(len(beams)) < 0.3):
        beams[row, rng.permutation(4)[: rng.integers(1, 4)]] = np.nan
    by_velocity, by_beams = histories(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), settings()
    )
    used = sum(int(met(by_beams, f"beam_{number}").used.sum()) for number in range(1, 5))
    assert used == np.isfinite(beams).sum()
    assert len(met(by_velocity, "velocity").nis) < len(beams) - 100
    nis = np.concatenate([one.nis for one in by_beams.innovations[:4]])
    assert 0.9 < nis.mean() < 1.1


def test_a_beam_that_errs_is_refused_and_the_others_are_used() -> None:
    dive = simulated(6)
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[100:140, 2] += 0.5
    _, by_beams = histories(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), settings(0.999)
    )
    assert not met(by_beams, "beam_3").used[100:140].any()
    for number in (1, 2, 4):
        assert met(by_beams, f"beam_{number}").used[100:140].mean() > 0.9


def test_a_filter_that_is_lost_is_set_to_its_beams_again() -> None:
    """Its start is off by 3 m/s, of which it is told 0.05."""
    dive = simulated(7)
    config = settings(0.999)
    prepared = prepare_dive(dive, config)
    start = prepared.alignment.start
    off = replace(start, velocity_n=start.velocity_n + np.array([2.0, -2.0, 0.3]))
    prepared = replace(prepared, alignment=replace(prepared.alignment, start=off))
    timeline = prepared_timeline(dive, prepared)
    by_velocity, by_beams = (run_one(filter_, prepared, timeline) for filter_ in prepared.filters)
    np.testing.assert_allclose(
        by_beams.velocity_n[-1], by_velocity.velocity_n[-1], rtol=0.0, atol=0.05
    )


@pytest.mark.parametrize("word", [pytest.param("velocity", marks=pytest.mark.nightly), "beams"])
def test_a_filter_that_is_thrown_off_comes_back_to_its_other_sensors(word: str) -> None:
    """Ten readings of the IMU that are false move it by 2 m/s, and by some 10 m until it is set to the DVL again."""
    dive = simulated(
        3, sensors={"depth": SensorErrors(0.05, 4.0), "position": SensorErrors(1.0, 1.0)}
    )
    force_b = dive.imu.specific_force_b.copy()
    force_b[10_000:10_010] += 20.0
    thrown = replace(dive, imu=replace(dive.imu, specific_force_b=force_b))
    aided = {"aided": Filter(aiding=(word, "depth", "position"), gate_probability=0.999)}
    told = {"depth": Depth(sd_m=0.05), "position": Position(sd_m=1.0), "filters": aided}
    (history,) = histories(thrown, msgspec.structs.replace(settings(), **told))
    assert len(history.reopened_ns) == 1
    (note,) = (note for note in update_notes((history,)) if note.code == "gate_reopened")
    assert note.count == 1
    for sensor in ("depth", "position"):
        assert met(history, sensor).used.mean() > 0.97
    assert dive.reference is not None
    (apart_n,) = north_east_down_m(history.position[-1:], dive.reference.position[-1:])
    assert np.abs(apart_n[:2]).max() < 1.5


def test_pings_that_are_lost_are_in_a_row_though_one_beam_is_dead() -> None:
    """Four of five, then one that is heard, time and again: nothing is opened."""
    dive = simulated(4)
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[:, 3] = np.nan
    for first in range(200, 300, 5):
        beams[first : first + 4] += np.array([3.0, -3.0, 3.0, 0.0])
    _, by_beams = histories(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), settings(0.999)
    )
    assert not met(by_beams, "beam_1").used[200:204].any()
    assert not len(by_beams.reopened_ns)


@pytest.mark.parametrize(
    "beam", [0, *(pytest.param(beam, marks=pytest.mark.nightly) for beam in (1, 2, 3))]
)
def test_whichever_beam_errs_the_filter_that_refuses_it_is_evaluated(beam: int) -> None:
    dive = simulated(7)
    assert dive.dvl.beam_velocity_mps is not None
    rng, beams = np.random.default_rng(1), dive.dvl.beam_velocity_mps.copy()
    beams[rng.random(len(beams)) < 0.2, beam] += 0.5
    replay = replay_dive(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), settings(0.999)
    )
    assert diverged_filters(replay.histories).keys() == {"baseline"}


@pytest.mark.parametrize("heard", [range(4), range(3)], ids=["four beams", "the last is dead"])
def test_a_filter_whose_pings_are_refused_is_not_evaluated(heard: range) -> None:
    """A metre a second more for 300 of 1199 pings, to which the filter is never set."""
    dive, config = simulated(7), settings(0.999)
    assert dive.dvl.beam_velocity_mps is not None
    beams = np.full_like(dive.dvl.beam_velocity_mps, np.nan)
    beams[:, heard] = dive.dvl.beam_velocity_mps[:, heard]
    beams[200:500] += np.array([1.0, -1.0, -1.0, 1.0])
    stubborn = msgspec.structs.replace(config.filters["single"], gate_reopen_after=0)
    config = msgspec.structs.replace(config, filters={**config.filters, "single": stubborn})
    replay = replay_dive(replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), config)
    assert re.search(r"single .*\d+ .*\b1200 ", diverged_filters(replay.histories)["single"])


def test_pings_that_are_refused_one_by_one_are_no_run_though_the_last_beam_is_dead() -> None:
    """Seven outliers half a minute apart, and good pings between them."""
    dive = simulated(7)
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    beams[100:401:50] += np.array([1.0, -1.0, -1.0, 1.0])
    beams[:, 3] = np.nan
    by_velocity, by_beams = histories(
        replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams)), settings(0.999)
    )
    assert not len(by_beams.reopened_ns)
    # What a gate refuses of single beams by chance makes a few per cent; opened, the velocity is as unsure as 1 m/s.
    np.testing.assert_allclose(by_beams.sd[:, :3], by_velocity.sd[:, :3], rtol=0.2)


def test_velocities_alone_have_no_beams() -> None:
    dive = simulated(1)
    velocity_d = np.zeros((len(dive.dvl.time_ns), 3))
    plain = replace(
        dive,
        dvl=replace(dive.dvl, beam_velocity_mps=None, beam_vectors_d=None, velocity_d=velocity_d),
    )
    with pytest.raises(ConfigError, match=r"filters\.single .*beams"):
        histories(plain, settings())
