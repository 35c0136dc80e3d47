"""A filter from which velocities are withheld drifts as its errors say, and is no other than the one that has them."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from counted import Counted, counted
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Noise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.evaluation.outage_test import OutageRun, outage_run
from insdvl_replay.geometry.earth import EARTH_RATE
from insdvl_replay.nav.dvl import DvlBeams, beam_measurements
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.outage import GravityDrift, gravity_drift, restart, run_outage
from insdvl_replay.nav.timeline import Timeline
from insdvl_replay.nav.user_measurement import NoiseFactors
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.run import plan_runs, prepared_timeline, run_candidates, run_one
from insdvl_replay.sim.dive import add_errors, exact_dive, simulate_dive
from insdvl_replay.studies.montecarlo import make_setup, run_seed

T, GRAVITY, DVL_HZ = 60.0, 9.795, 1.0
FROM, TO = 5, 65
"""Rows of the last ping that is used, and of the last one that is withheld."""
NOWHERE_ELSE = np.zeros(3)


class Flight:
    """A vehicle that goes straight on, its sensors exact, and a filter that knows all of its state."""

    def __init__(self, duration_s: float = 70.0) -> None:
        dive = exact_dive("straight", duration_s=duration_s, imu_rate_hz=20.0, dvl_rate_hz=DVL_HZ)
        self.start = prepare_dive(dive, Config())
        self.timeline = prepared_timeline(dive, self.start)
        self.ping_ns = self.start.velocities.time_ns
        self.history = run_one(
            self.start.filters[0], self.start, self.timeline, cov_ns=self.ping_ns
        )
        (self.velocity,) = self.start.filters[0].measurements(
            self.start.velocities, self.start.mounting
        )
        self.row = int(np.searchsorted(self.history.time_ns, self.ping_ns[FROM]))
        self.mat_nb = self.history.mat_nb[self.row]

    def coasted(
        self,
        *,
        history: History | None = None,
        timeline: Timeline | None = None,
        velocity: Measurement | None = None,
    ) -> OutageRun:
        """OutageRun with some part of all this in error."""
        history = history or self.history
        return outage_run(
            run_outage(
                history,
                gravity_drift(history),
                timeline or self.timeline,
                (int(self.ping_ns[FROM]), int(self.ping_ns[TO])),
                noise_density=self.start.filters[0].noise_density,
                measurements=(velocity or self.velocity,),
                lever_arm_b=NOWHERE_ELSE,
            )
        )

    def off_by(self, **errors: Floats) -> History:
        """Let the state from which the filter coasts be off."""
        columns = {name: getattr(self.history, name).copy() for name in errors}
        for name, error in errors.items():
            columns[name][self.row] += error
        return replace(self.history, **columns)

    def tilted(self, angle: float) -> History:
        """Tilt the vehicle about its own forward axis."""
        turned = self.mat_nb @ Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
        return self.off_by(mat_nb=turned - self.mat_nb)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight()


def horizontal_drift_m(coasted: OutageRun) -> float:
    return float(np.hypot(*coasted.drift_n[-1, :2]))


# Closed forms


def test_filter_that_knows_all_does_not_drift(flight: Flight) -> None:
    coasted = flight.coasted()
    assert coasted.time_s[-1] == pytest.approx(T)
    assert np.abs(coasted.drift_n).max() < 2e-4
    assert np.isnan(coasted.nis[0])
    assert coasted.nis[1:].max() < 1e-4


def test_tilt_falls_by_its_share_of_gravity(flight: Flight) -> None:
    angle = 0.01 * DEG
    expected_m = 0.5 * GRAVITY * angle * T**2
    assert expected_m == pytest.approx(3.08, abs=0.01)
    assert horizontal_drift_m(flight.coasted(history=flight.tilted(angle))) == pytest.approx(
        expected_m, rel=0.02
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_accelerometer_bias_accelerates(flight: Flight, axis: int) -> None:
    expected_m = 0.5 * 0.1 * MG * T**2
    assert expected_m == pytest.approx(1.77, abs=0.01)
    coasted = flight.coasted(history=flight.off_by(accel_bias_b=0.1 * MG * np.eye(3)[axis]))
    assert horizontal_drift_m(coasted) == pytest.approx(expected_m, rel=0.02)
    assert np.hypot(*coasted.velocity_error_n[-1, :2]) == pytest.approx(0.1 * MG * T, rel=0.02)


def test_vertical_accelerometer_bias_is_vertical_drift(flight: Flight) -> None:
    coasted = flight.coasted(history=flight.off_by(accel_bias_b=np.array([0.0, 0.0, 0.1 * MG])))
    assert abs(coasted.drift_n[-1, 2]) == pytest.approx(0.5 * 0.1 * MG * T**2, rel=0.02)
    assert horizontal_drift_m(coasted) < 0.01


@pytest.mark.parametrize("axis", [0, 1])
def test_gyro_bias_tilts_more_and_more(flight: Flight, axis: int) -> None:
    bias = 0.1 * DEG_PER_HOUR
    expected_m = GRAVITY * bias * T**3 / 6.0
    assert expected_m == pytest.approx(0.171, abs=0.001)
    coasted = flight.coasted(history=flight.off_by(gyro_bias_b=bias * np.eye(3)[axis]))
    assert horizontal_drift_m(coasted) == pytest.approx(expected_m, rel=0.02)


def test_velocity_at_the_start_stays(flight: Flight) -> None:
    """It is off at the ping that is used last, where the error counts as zero: half an interval is missing."""
    coasted = flight.coasted(history=flight.off_by(velocity_n=np.array([0.003, 0.004, 0.0])))
    assert horizontal_drift_m(coasted) == pytest.approx(0.30, rel=0.02)


def test_heading_shows_by_the_earths_rate_alone(flight: Flight) -> None:
    """Prediction and measurement turn together, but the Earth is then taken to turn about another axis."""
    angle, latitude = 1.0 * DEG, float(flight.history.position[flight.row, 0])
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() - np.eye(3)
    turned = {
        name: turn @ getattr(flight.history, name)[flight.row] for name in ("mat_nb", "velocity_n")
    }
    as_gyro_bias = EARTH_RATE * np.cos(latitude) * angle
    drift_m = horizontal_drift_m(flight.coasted(history=flight.off_by(**turned)))
    assert drift_m == pytest.approx(GRAVITY * as_gyro_bias * T**3 / 6.0, rel=0.02)
    assert drift_m < 0.2 * 2.0 * T * angle, "a fifth of what it does to the position"


@pytest.mark.nightly
def test_white_noise_of_the_accelerometers_walks(flight: Flight) -> None:
    density, rng = 1e-3, np.random.default_rng(1)
    expected_m = density * np.sqrt(T**3 / 3.0)
    assert expected_m == pytest.approx(0.268, abs=0.001)
    sd = density * np.sqrt(20.0)

    def drift_n() -> Floats:
        force_b = flight.timeline.specific_force_b
        noisy = flight.timeline._replace(
            specific_force_b=force_b + sd * rng.standard_normal(force_b.shape)
        )
        return flight.coasted(timeline=noisy).drift_n[-1]

    drifts_n = np.array([drift_n() for _ in range(1500)])
    assert np.sqrt(np.mean(drifts_n**2)) == pytest.approx(expected_m, rel=0.02)


@pytest.mark.nightly
def test_noise_of_the_dvl_that_measures_is_the_floor(flight: Flight) -> None:
    sd_mps, rng = 0.005, np.random.default_rng(2)
    expected_m = sd_mps * np.sqrt(T / DVL_HZ)
    assert expected_m == pytest.approx(0.039, abs=0.001)

    def drift_n() -> Floats:
        exact_b = flight.velocity.values
        noisy = replace(
            flight.velocity, values=exact_b + sd_mps * rng.standard_normal(exact_b.shape)
        )
        return flight.coasted(velocity=noisy).drift_n[-1]

    drifts_n = np.array([drift_n() for _ in range(1500)])
    assert np.sqrt(np.mean(drifts_n**2)) == pytest.approx(expected_m, rel=0.02)


# The filter that coasts is the one that was told nothing

LEVER_ARM_M = (-1.8, 0.3, 0.5)
AIDED = Filter(aiding=("velocity", "acceleration"), acceleration=Acceleration())


def told_nothing(start: Prepared, timeline: Timeline, first: int, last: int) -> History:
    """Run a whole dive, with a noise in a window beside which its pings say nothing."""
    (filter_,) = start.filters
    velocity, *acceleration = filter_.measurements(start.velocities, start.mounting, start.gaps)
    window = slice(first + 1, last + 1)
    cov_b = velocity.cov.copy()
    cov_b[window] *= 1e12
    measurements = [replace(velocity, cov=cov_b)]
    for of_kind in acceleration:
        available = of_kind.available.copy()
        available[window] = False
        measurements.append(replace(of_kind, available=available))
    return run_filter(
        filter_.name,
        timeline,
        start.alignment.start,
        filter_.noise_density,
        tuple(measurements),
        start.mounting.lever_arm_b,
    )


def window_of(start: Prepared, at_s: float, length_s: float) -> tuple[int, int]:
    time_s = seconds(start.velocities.time_ns, start.alignment.start_ns)
    first, last = np.searchsorted(time_s, [at_s, at_s + length_s])
    return int(first), int(last)


def assert_same_coast(dive: Dive, config: Config, at_s: float, length_s: float) -> None:
    start = prepare_dive(dive, config)
    timeline = prepared_timeline(dive, start)
    first, last = window_of(start, at_s, length_s)
    ping_ns = start.velocities.time_ns
    (filter_,) = start.filters
    history = run_one(filter_, start, timeline, cov_ns=ping_ns)
    (velocity,) = replace(filter_, aiding=("velocity",)).measurements(
        start.velocities, start.mounting
    )
    window_ns = int(ping_ns[first]), int(ping_ns[last])
    coasted = run_outage(
        history, gravity_drift(history), timeline, window_ns, noise_density=filter_.noise_density,
        measurements=(velocity,), lever_arm_b=start.mounting.lever_arm_b,
    )  # fmt: skip
    whole = told_nothing(start, timeline, first, last)
    rows = np.searchsorted(whole.time_ns, coasted.time_ns)
    np.testing.assert_array_equal(coasted.time_ns, ping_ns[first : last + 1])
    np.testing.assert_allclose(coasted.velocity_n, whole.velocity_n[rows], rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(coasted.mat_nb, whole.mat_nb[rows], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(coasted.sd, whole.sd[rows], rtol=1e-5)
    held_out, noisy = coasted.innovations[0], whole.innovations[0]
    assert not held_out.used.any()
    innovation_b = noisy.innovation[first + 1 : last + 1]
    np.testing.assert_allclose(held_out.innovation, innovation_b, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize(
    "filter_", [Filter(aiding=("velocity",)), AIDED], ids=["velocity", "both"]
)
@pytest.mark.parametrize("at_s", [20.4, 101.0])
def test_outage_is_a_run_in_which_pings_say_nothing(filter_: Filter, at_s: float) -> None:
    dive = simulate_dive(
        "figure-eight", seed=3, duration_s=150.0, dvl_rate_hz=3.0, lever_arm_m=LEVER_ARM_M
    )
    config = Config(dvl=Dvl(lever_arm_m=LEVER_ARM_M), filters={"only": filter_})
    assert_same_coast(dive, config, at_s, 40.0)


def test_gravity_is_taken_where_the_filter_took_it_after_an_outage() -> None:
    """Its height is off by hundreds of metres, and with it gravity would be by 3.1e-6 m/s^2 each."""
    config = load_config("tactical")
    config = msgspec.structs.replace(config, filters={"baseline": config.filters["baseline"]})
    outages = [(20.0, 820.0)]
    dive = simulate_dive(
        "straight", seed=1, duration_s=1200.0, grade="tactical", imu_rate_hz=20.0, outages=outages
    )
    assert_same_coast(dive, config, 1000.0, 60.0)


@pytest.mark.parametrize("holds_height", [True, False])
def test_what_measures_the_velocity_down_holds_the_height(
    flight: Flight, monkeypatch: pytest.MonkeyPatch, holds_height: bool
) -> None:
    """After an outage its height has drifted; without a measurement of it nothing says by how much."""
    monkeypatch.setattr("insdvl_replay.nav.outage.HOLD_AFTER_S", 10.0)
    rising = replace(
        flight.history,
        position=flight.history.position + np.arange(len(flight.history.time_ns))[:, None],
    )
    (velocity,) = flight.history.innovations
    velocity = replace(
        velocity,
        used=velocity.used
        & ((velocity.time_ns < flight.ping_ns[10]) | (velocity.time_ns > flight.ping_ns[50])),
        holds_height=holds_height,
    )
    silent = replace(rising, innovations=(velocity,))
    height_m = restart(silent, gravity_drift(silent), int(flight.ping_ns[TO])).position[2]
    own_m = rising.position[np.searchsorted(rising.time_ns, flight.ping_ns[TO]), 2]
    assert (height_m < own_m) == holds_height


def test_a_window_knows_the_drifts_before_it(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two times without velocities, from ping 10 to 31 and from 40 to 56; gravity follows for 10 s, then it is held."""
    monkeypatch.setattr("insdvl_replay.nav.outage.HOLD_AFTER_S", 10.0)
    (velocity,) = flight.history.innovations
    ping = np.arange(len(velocity.used))
    used = (ping <= 10) | ((ping >= 31) & (ping <= 40)) | (ping >= 56)
    position = flight.history.position.copy()
    position[:, 2] = (flight.history.time_ns - flight.history.time_ns[0]) / NS_PER_S
    risen = replace(flight.history, position=position, innovations=(replace(velocity, used=used),))
    drift = gravity_drift(risen)
    heights_m = [
        restart(risen, drift, int(flight.ping_ns[at])).position[2] for at in (5, 30, 31, 45, 60)
    ]
    own_m = position[np.searchsorted(risen.time_ns, flight.ping_ns[[5, 30, 31, 45, 60]]), 2]
    np.testing.assert_allclose(own_m - heights_m, [0.0, 0.0, 11.0, 11.0, 17.0], atol=1e-9)


def touched_by_a_window(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> int:
    """Count the elements that are gone through before the filter runs in a window."""
    history, timeline, drift = flight.history, flight.timeline, gravity_drift(flight.history)
    columns = {
        name: counted(getattr(history, name))
        for name in ("time_ns", "cov_ns", "position", "sd", "cov")
    }
    of_velocity = {
        name: counted(getattr(flight.velocity, name)) for name in ("values", "cov", "available")
    }
    updates = replace(history.innovations[0], time_ns=counted(history.innovations[0].time_ns))
    factors = NoiseFactors(
        counted(timeline.sample_ns), counted(np.ones((len(timeline.sample_ns), 6)))
    )
    given = list[NoiseFactors]()
    monkeypatch.setattr(
        "insdvl_replay.nav.outage.run_filter",
        lambda *_, noise_factors, **__: given.append(noise_factors),
    )
    Counted.touched = 0
    run_outage(
        replace(history, innovations=(updates,), **columns),
        drift._replace(drift_m=counted(drift.drift_m)),
        Timeline(*map(counted, timeline)),
        (int(flight.ping_ns[FROM]), int(flight.ping_ns[FROM + 30])),
        (replace(flight.velocity, **of_velocity),),
        noise_factors=factors,
    )
    (inside,) = given
    return Counted.touched + inside.factors.size


def test_a_window_is_no_more_work_in_a_longer_dive(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_the_short = touched_by_a_window(flight, monkeypatch)
    assert in_the_short > 30
    assert touched_by_a_window(Flight(280.0), monkeypatch) == in_the_short


def test_all_windows_of_a_history_share_what_goes_through_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dive, config, calls = (
        exact_dive("straight", duration_s=240.0, imu_rate_hz=20.0),
        Config(),
        list[str](),
    )
    prepared = prepare_dive(dive, config)

    def once(history: History) -> GravityDrift:
        calls.append(history.filter)
        return gravity_drift(history)

    monkeypatch.setattr("insdvl_replay.preparation.run.gravity_drift", once)
    plan = plan_runs(dive, prepared, config, starts=0)
    run_candidates(dive, prepared, plan, config)
    assert len(plan.windows.start_ns) == 4
    assert sorted(calls) == sorted(config.filters)


def test_every_beam_holds_the_height() -> None:
    beams = DvlBeams(np.arange(3), np.ones((3, 5)), np.eye(3)[[0, 1, 2, 2, 2]])
    assert [one.holds_height for one in beam_measurements(beams, 0.01)] == [True] * 5


def test_history_without_p_cannot_be_gone_on_from(flight: Flight) -> None:
    with pytest.raises(ValueError, match=r"\bP\b"):
        restart(
            flight.history.without_cov(), gravity_drift(flight.history), int(flight.ping_ns[FROM])
        )


# What NIS says


@pytest.mark.nightly
def test_nis_of_the_last_held_out_ping_is_that_of_a_filter_that_knows_its_noise() -> None:
    """Windows of one dive share its biases; of many dives, sums of NIS are chi-square."""
    noise = Noise(accel_white_mps_rts=5e-3, gyro_white_rad_rts=4.4e-5)
    config = Config(
        noise=noise,
        dvl=Dvl(velocity_sd_mps=0.01),
        filters={"baseline": Filter(aiding=("velocity",))},
    )
    world = make_setup("figure-eight", config, "matched", 220.0)
    nis = []
    for run in range(60):
        dive = add_errors(world.exact, world.imu_errors, world.dvl_errors, run_seed(1, run))
        start = prepare_dive(dive, config)
        runs = run_candidates(
            dive, start, plan_runs(dive, start, config, starts=0), config
        ).outages.runs["baseline"]
        nis.append(runs[-1].nis[-1])
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nis)) / (3 * len(nis))
    assert low < np.mean(nis) / 3.0 < high


def test_windows_on_a_long_dive_run_in_threads_and_are_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dive = simulate_dive("figure-eight", seed=4, duration_s=230.0, imu_rate_hz=20.0)
    config = Config()
    start = prepare_dive(dive, config)
    plan = plan_runs(dive, start, config, starts=0)
    in_turn = run_candidates(dive, start, plan, config).outages
    monkeypatch.setattr("insdvl_replay.preparation.run.WORTH_A_THREAD", 0)
    threaded = run_candidates(dive, start, plan, config).outages
    assert list(threaded.runs) == [filter_.name for filter_ in start.filters]
    for name, runs in in_turn.runs.items():
        for one, other in zip(runs, threaded.runs[name], strict=True):
            np.testing.assert_array_equal(one.drift_n, other.drift_n)
    assert (plan.windows.start_ns >= start.alignment.start_ns + 99 * NS_PER_S).all()
