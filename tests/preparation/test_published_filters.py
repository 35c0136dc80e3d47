"""The filters of published papers among the examples: their equations, and what they do on simulated dives."""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from jacobian import assert_jacobian

from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Noise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, DvlColumns, Floats
from insdvl_replay.core.words import Verdict
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.user_candidate import Solution
from insdvl_replay.nav.user_measurement import failure_text
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive

EXAMPLES = Path(__file__).parents[2] / "examples" / "candidates"
sys.path.insert(0, str(EXAMPLES))

import correlated_noise  # noqa: E402
import held_velocity  # noqa: E402
import invariant_filter  # noqa: E402
import kalman_filter  # noqa: E402
import without_attitude  # noqa: E402
from test_user_candidates import start_of  # noqa: E402

ARM_M = (0.5, -0.2, 0.3)
FILTERS = (kalman_filter.KalmanFilter, invariant_filter.InvariantFilter)
VEHICLE = """
[dvl]
beam_sd_mps = {beam_sd_mps}
[noise]
accel_white_mps_rts = {accel_white_mps_rts}
gyro_white_rad_rts = {gyro_white_rad_rts}
accel_bias_walk_mps2_rts = {accel_bias_walk_mps2_rts}
gyro_bias_walk_radps_rts = {gyro_bias_walk_radps_rts}
"""


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))


@pytest.fixture(autouse=True)
def vehicle(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The settings that the classes read are those of the baseline."""
    noise = msgspec.to_builtins(NOISE)
    file = tmp_path / "vehicle.toml"
    file.write_text(VEHICLE.format(**noise, beam_sd_mps=BEAM_SD_MPS))
    monkeypatch.setenv("VEHICLE", str(file))


def test_what_fails_in_a_class_that_is_derived_from_is_said_with_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Derived(kalman_filter.KalmanFilter):  # type: ignore[name-defined, misc]
        pass

    monkeypatch.delenv("VEHICLE")
    with pytest.raises(ValueError, match="VEHICLE is not set") as raised:
        Derived().run(None, None)
    text = failure_text(raised.value, Derived)
    assert re.match(
        r" in line \d+ of \S+kalman_filter\.py: ValueError: VEHICLE is not set; .*=", text
    )


BEAM_SD_MPS = 0.0045
NOISE = Noise(
    accel_white_mps_rts=2e-3,
    gyro_white_rad_rts=1.2e-4,
    accel_bias_walk_mps2_rts=8e-5,
    gyro_bias_walk_radps_rts=8e-7,
)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive(
        "figure-eight", seed=3, duration_s=200.0, grade="mems", imu_rate_hz=20.0, lever_arm_m=ARM_M
    )


def replayed(dive: Dive, mine: Filter) -> Replay:
    config: Config = load_config("mems")
    return replay_dive(
        dive,
        msgspec.structs.replace(
            config,
            noise=NOISE,
            filters={"baseline": Filter(aiding=("velocity",)), "mine": mine},
            dvl=Dvl(lever_arm_m=ARM_M, beam_sd_mps=BEAM_SD_MPS),
            evaluation=Evaluation(starts=1, repeats=False),
        ),
    )


def ratios_of(replay: Replay) -> dict[str, float]:
    return {row.quantity: row.ratio for row in replay.tables.evidence if row.filter == "mine"}


# --- The equations.


def some_ins() -> Any:
    """An INS that moves, turned and tilted."""
    return kalman_filter.Ins(
        np.array([0.6, 0.3, -20.0]),
        np.array([1.5, -0.7, 0.2]),
        kalman_filter.rotation(np.array([0.1, -0.2, 0.8])),
        np.array([0.02, -0.01, 0.03]),
        np.array([1e-4, 2e-4, -1e-4]),
        np.eye(12),
    )


def with_error(filter_: Any, error: Floats) -> Any:
    """An INS whose estimate is off by an error, as the filter writes it."""
    ins = some_ins()
    filter_.correct(ins, -error)
    return ins


def error_between(filter_: Any, estimated: Any, true: Any) -> Floats:
    """The error by its definition, to first order, and then as the filter writes it."""
    turned = estimated.mat_nb @ true.mat_nb.T
    usual = np.concatenate(
        [
            estimated.velocity_n - true.velocity_n,
            0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]),
            true.accel_bias_b - estimated.accel_bias_b,
            true.gyro_bias_b - estimated.gyro_bias_b,
        ]
    )  # fmt: skip
    return np.asarray(filter_.from_usual(true.velocity_n) @ usual)


@pytest.mark.parametrize("kind", FILTERS)
def test_a_correction_takes_away_the_error_that_it_is_given(kind: Callable[[], Any]) -> None:
    filter_ = kind()
    assert_jacobian(
        np.eye(12),
        lambda error: error_between(filter_, with_error(filter_, error), some_ins()),
        np.zeros(12),
        atol=1e-6,
        step=1e-5,
    )


@pytest.mark.parametrize("kind", FILTERS)
def test_the_error_grows_as_the_matrix_says(kind: Callable[[], Any]) -> None:
    """Over a step of the INS, from differences; the way on the ellipsoid is not in F."""
    filter_ = kind()
    step_s = 0.001
    force_b = np.array([0.3, -0.2, -9.7])
    rate_b = np.array([0.02, -0.05, 0.1])
    noise = kalman_filter.Noise(np.zeros(12), np.eye(3))

    def after(error: Floats) -> Floats:
        moved = []
        for ins in (with_error(filter_, error), some_ins()):
            force = force_b - ins.accel_bias_b
            filter_.predict(ins, force, rate_b - ins.gyro_bias_b, step_s, noise)
            moved.append(ins)
        return error_between(filter_, *moved)

    ins = some_ins()
    true_force_b = force_b - ins.accel_bias_b
    earth_n, carried_n = kalman_filter.frame_rates(ins)
    rates_n = (earth_n, earth_n + carried_n, 2.0 * earth_n + carried_n)
    gravity_n = np.array([0.0, 0.0, kalman_filter.normal_gravity(ins.position)])
    F = filter_.error_rate(ins, ins.mat_nb @ true_force_b, gravity_n, rates_n)
    # Terms of the second order of the step are as large as its square times gravity.
    assert_jacobian(np.eye(12) + F * step_s, after, np.zeros(12), atol=1e-5, step=1e-5)


@pytest.mark.parametrize("kind", FILTERS)
def test_the_innovation_is_what_the_matrix_says(kind: Callable[[], Any]) -> None:
    """The invariant filter has no attitude in H: its velocity error holds it."""
    filter_ = kind()
    arm_b = np.array(ARM_M)
    rate_b = np.array([0.02, -0.05, 0.1])

    def innovation(error: Floats) -> Floats:
        ins = with_error(filter_, error)
        turn_b = rate_b - ins.gyro_bias_b
        return np.asarray(filter_.innovation(ins, np.array([1.0, 0.0, 0.0]), turn_b, arm_b)[0])

    _, H = filter_.innovation(some_ins(), np.zeros(3), rate_b, arm_b)
    assert_jacobian(H, innovation, np.zeros(12), atol=1e-6, step=1e-5)


def test_no_noise_has_the_correlation_of_the_paper() -> None:
    """The covariance of both noises together has a negative eigenvalue beyond one sixth."""
    Q = np.diag(np.linspace(0.1, 2.0, 12) ** 2)
    R = np.diag([0.4, 0.5, 0.1])
    smallest = {}
    for rho in (correlated_noise.CorrelatedNoise.rho, 0.17, 1.0 / 6.0):
        M = correlated_noise.covariance_of_noises(rho, Q, R)
        smallest[rho] = np.linalg.eigvalsh(np.block([[Q, M], [M.T, R]])).min()
    assert smallest[0.42] < -1e-3
    assert smallest[0.17] < 0.0
    assert smallest[1.0 / 6.0] == pytest.approx(0.0, abs=1e-12)


# --- On simulated dives.


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("word", "tolerance"),
    [("kalman_filter:KalmanFilter", 0.3), ("invariant_filter:InvariantFilter", 0.05)],
)
def test_a_filter_with_the_noise_of_the_baseline_is_as_good_as_it(
    dive: Dive, word: str, tolerance: float
) -> None:
    """The baseline corrects velocity and attitude as the invariant filter does.

    The usual filter does not: on this dive its heading is 1.23 times as far off, and its position 1.13 times.
    """
    replay = replayed(dive, Filter(candidate=word))
    assert replay.verdicts["mine"].verdict != Verdict.NOT_EVALUATED
    ratios = ratios_of(replay)
    for quantity in ("position", "velocity_along", "velocity_across", "level", "heading"):
        assert ratios[quantity] == pytest.approx(1.0, abs=tolerance), quantity
    nis = {row.filter: row.mean_nis for row in replay.tables.consistency}
    assert nis["mine"] == pytest.approx(nis["baseline"], rel=0.05)


def solution_of(kind: Callable[[], Any], dive: Dive) -> Solution:
    """What a class finds from the true start."""
    assert dive.dvl is not None
    start = start_of(dive)
    cov = np.diag(np.repeat([0.01, 1e-3, 0.01, 1e-4], 3) ** 2)
    given = replace(start, cov=cov, dvl_lever_arm_b=np.array(ARM_M))
    velocities = dvl_velocities(dive.dvl)
    clean = DvlColumns(velocities.time_ns, velocity_d=velocities.velocity_b)
    solution: Solution = kind().run(Dive("dive", dive.imu, clean), given)
    return solution


def test_only_a_filter_without_the_attitude_in_h_is_sure_of_a_wrong_velocity(dive: Dive) -> None:
    assert dive.reference is not None
    beyond = {}
    for kind in (*FILTERS, without_attitude.WithoutAttitude):
        solution = solution_of(kind, dive)
        assert solution.velocity_n is not None
        assert solution.cov is not None
        error = solution.velocity_n[-1] - dive.reference.velocity_n[-1]
        beyond[kind.__name__] = np.abs(error[:2] / np.sqrt(np.diag(solution.cov[-1])[:2])).max()
    assert beyond["KalmanFilter"] < 3.0
    assert beyond["InvariantFilter"] < 3.0
    assert beyond["WithoutAttitude"] > 4.0


class WithoutCorrelation(correlated_noise.CorrelatedNoise):
    """The filter of the paper with its correlation at zero."""

    rho = 0.0


@pytest.mark.nightly
def test_correlation_shrinks_sigma_and_none_is_the_usual_filter(dive: Dive) -> None:
    usual = solution_of(kalman_filter.KalmanFilter, dive)
    without = solution_of(WithoutCorrelation, dive)
    np.testing.assert_allclose(without.velocity_n, usual.velocity_n, atol=1e-6)
    weak = solution_of(correlated_noise.WeaklyCorrelatedNoise, dive)
    assert usual.cov is not None
    assert weak.cov is not None
    sigma = np.sqrt(np.diagonal(usual.cov[-50:], axis1=1, axis2=2)[:, :2]).mean()
    smaller = np.sqrt(np.diagonal(weak.cov[-50:], axis1=1, axis2=2)[:, :2]).mean()
    assert smaller < sigma


# --- The velocity that is held.


def with_pause(dive: Dive, from_s: float, to_s: float) -> Dive:
    """A dive without the pings of a pause."""
    assert dive.dvl is not None
    since_s = (dive.dvl.time_ns - dive.imu.time_ns[0]) / NS_PER_S
    return replace(dive, dvl=dive.dvl.rows((since_s <= from_s) | (since_s >= to_s)))


def test_a_velocity_is_held_where_pings_are_missing_and_nowhere_else(dive: Dive) -> None:
    found = held_velocity.HeldVelocity().readings(with_pause(dive, 100.0, 130.0))
    since_s = (found.time_ns - dive.imu.time_ns[0]) / NS_PER_S
    elsewhere = held_velocity.HeldVelocity().readings(dive).sd
    assert (elsewhere == held_velocity.NO_WEIGHT_MPS).all()
    assert (found.sd[0] == held_velocity.NO_WEIGHT_MPS).all()
    assert since_s[1] > 100.0
    assert since_s[-1] < 130.0
    assert (np.ptp(found.values[1:], axis=0) == 0.0).all()
    assert found.sd[-1].max() > found.sd[1].max() >= held_velocity.LEAST_SD_MPS


def test_what_is_held_does_not_know_what_comes_later(dive: Dive) -> None:
    whole = held_velocity.HeldVelocity().readings(with_pause(dive, 100.0, 130.0))
    early = held_velocity.HeldVelocity().readings(with_pause(dive, 100.0, 1e9))
    count = len(whole.time_ns)
    np.testing.assert_array_equal(early.time_ns[:count], whole.time_ns)
    np.testing.assert_array_equal(early.values[:count], whole.values)
    np.testing.assert_array_equal(early.sd[:count], whole.sd)


@pytest.mark.nightly
def test_a_held_velocity_acts_in_outages_alone(dive: Dive) -> None:
    replay = replayed(dive, Filter(aiding=("velocity", "held_velocity:HeldVelocity")))
    assert "user_measurement_jacobian" not in {note.code for note in replay.notes}
    ratios = ratios_of(replay)
    assert ratios["position"] == pytest.approx(1.0, abs=1e-9)
    assert ratios["outage_30s"] != pytest.approx(1.0, abs=0.01)
