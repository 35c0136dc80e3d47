"""Noise of the inertial sensors that a user's class finds over time."""

import time
from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, TimeNs
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.history import History
from insdvl_replay.geometry.rotation import mat_from_rpy, vector_from_mat
from insdvl_replay.nav.error_model import add_noise_of_axes
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_measurement import NoiseFactors, UserNoise, checked_factors
from insdvl_replay.preparation.plugins import in_outages
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import add_errors, simulate_dive
from insdvl_replay.studies.montecarlo import drawn_start, make_setup

HERE = __name__
STEP_S, FACTOR = 150, 100.0


class Ones(UserNoise):
    """The noise of the settings."""

    def noise_factors(self, dive: Dive) -> tuple[TimeNs, Floats]:
        """Give it at every sample, so that the filter has most to do."""
        return dive.imu.time_ns, np.ones((len(dive.imu.time_ns), 2))


class Step(UserNoise):
    """Accelerometers that are worse from a time on."""

    def noise_factors(self, dive: Dive) -> tuple[TimeNs, Floats]:
        """Know the time."""
        start_ns = int(dive.imu.time_ns[0])
        return np.array([start_ns, start_ns + STEP_S * NS_PER_S]), np.array(
            [[1.0, 1.0], [FACTOR, 1.0]]
        )


class OfPings(UserNoise):
    """A noise by the pings that are there."""

    def noise_factors(self, dive: Dive) -> tuple[TimeNs, Floats]:
        """Count the pings so far."""
        return dive.dvl.time_ns, np.arange(1.0, 1.0 + len(dive.dvl.time_ns))[:, None] * np.ones(6)


def filters(word: str) -> Config:
    mems = load_config("mems")
    mine = Filter(aiding=("velocity",), noise_factors=f"{HERE}:{word}")
    settings = {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    return Config(
        noise=mems.noise, initial=mems.initial, filters=settings, evaluation=Evaluation(starts=1)
    )


def ran(dive: Dive, word: str, start: Start | None = None) -> tuple[History, History]:
    prepared = prepare_dive(dive, filters(word))
    if start is not None:
        prepared = replace(prepared, alignment=replace(prepared.alignment, start=start))
    line = prepared_timeline(dive, prepared)
    plain, mine = (
        run_one(filter_, prepared, line, cov_ns=line.event_ns) for filter_ in prepared.filters
    )
    return plain, mine


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("lawnmower", seed=4, duration_s=300.0, grade="mems", imu_rate_hz=50.0)


def worse_from_a_step(dive: Dive, seed: int) -> Dive:
    """Add the noise of the step to the accelerometers."""
    since_s, rng = (dive.imu.time_ns - dive.imu.time_ns[0]) * 1e-9, np.random.default_rng(seed)
    sd_mps2 = (
        load_config("mems").noise.accel_white_mps_rts
        * np.sqrt(FACTOR**2 - 1.0)
        / np.sqrt(np.diff(since_s).mean())
    )
    noise = sd_mps2 * rng.standard_normal((len(since_s), 3)) * (since_s > STEP_S)[:, None]
    return replace(dive, imu=replace(dive.imu, specific_force_b=dive.imu.specific_force_b + noise))


def test_factors_of_one_give_the_same_bytes(dive: Dive) -> None:
    plain, mine = ran(dive, "Ones")
    for name in ("position", "velocity_n", "mat_nb", "sd", "cov"):
        assert getattr(plain, name).tobytes() == getattr(mine, name).tobytes()


def nees(history: History, dive: Dive) -> float:
    """Return the mean NEES of the twelve states after the step; errors of biases are true minus estimated."""
    assert dive.reference is not None
    assert dive.truth is not None
    time_ns, own, rows = np.intersect1d(
        history.cov_ns, dive.reference.time_ns, return_indices=True
    )
    at = np.searchsorted(history.time_ns, time_ns)
    turned = history.mat_nb[at] @ np.swapaxes(dive.reference.mat_nb[rows], 1, 2)
    error = np.column_stack(
        [
            history.velocity_n[at] - dive.reference.velocity_n[rows],
            vector_from_mat(turned),
            dive.truth.accel_bias_b[rows] - history.accel_bias_b[at],
            dive.truth.gyro_bias_b[rows] - history.gyro_bias_b[at],
        ]
    )
    late = (time_ns - history.time_ns[0]) * 1e-9 > STEP_S + 10.0
    solved = np.linalg.solve(history.cov[own][late], error[late][..., None])[..., 0]
    return float(np.mean(np.sum(error[late] * solved, axis=1)))


def test_a_known_step_of_the_noise_gives_the_nees_of_twelve_states() -> None:
    """In worlds that the filter's own settings describe: start, biases and noise, but for the step."""
    config = filters("Step")
    setup = make_setup("lawnmower", config, "matched", 300.0)
    found = []
    for seed in range(20):
        dive = worse_from_a_step(
            add_errors(setup.exact, setup.imu_errors, setup.dvl_errors, seed), seed
        )
        found.append(
            [nees(history, dive) for history in ran(dive, "Step", drawn_start(setup, seed))]
        )
    without, aware = np.mean(found, axis=0)
    assert aware == pytest.approx(12.0, abs=2.0)
    assert without > 30.0


@pytest.mark.all_starts
def test_a_filter_that_knows_a_step_of_the_noise_is_better() -> None:
    clean = simulate_dive("lawnmower", seed=2, duration_s=1200.0, grade="mems", imu_rate_hz=50.0)
    replay = replay_dive(worse_from_a_step(clean, 2), filters("Step"))
    ratios = {row.quantity: row.ratio for row in replay.tables.evidence if row.filter == "mine"}
    for quantity in ("position", "outage_60s", "drift_60s", "level"):
        assert ratios[quantity] < 0.95, (quantity, ratios)


@pytest.mark.nightly
def test_factors_at_every_sample_cost_little() -> None:
    """No code of Python runs in an epoch."""
    dive = simulate_dive("lawnmower", seed=4, duration_s=3600.0, grade="mems", imu_rate_hz=100.0)
    prepared = prepare_dive(dive, filters("Ones"))
    line, times_s = prepared_timeline(dive, prepared), []
    for filter_ in prepared.filters * 6:
        start_s = time.process_time()
        run_one(filter_, prepared, line)
        times_s.append(time.process_time() - start_s)
    assert min(times_s[3::2]) < 1.3 * min(times_s[2::2])


def test_noise_of_axes_is_turned_to_n() -> None:
    mat_nb, density_b = (
        mat_from_rpy(np.array([0.3, -0.2, 1.1])),
        np.array([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]),
    )
    P = np.zeros(144)
    add_noise_of_axes(P, 12, tuple(map(tuple, mat_nb)), density_b, 0.5)  # type: ignore[arg-type]
    P = P.reshape(12, 12)
    np.testing.assert_allclose(
        P[:3, :3], 0.5 * mat_nb @ np.diag(density_b[:3]) @ mat_nb.T, atol=1e-15
    )
    np.testing.assert_allclose(
        P[3:6, 3:6], 0.5 * mat_nb @ np.diag(density_b[3:]) @ mat_nb.T, atol=1e-15
    )
    assert not P[:3, 3:].any()
    assert not P[6:].any()


def test_in_an_outage_noise_is_found_without_its_pings(dive: Dive) -> None:
    ping_ns = dive.dvl.time_ns
    outages = [(int(ping_ns[100]), int(ping_ns[130]))]
    config = filters("OfPings")
    noise = prepare_dive(dive, config).noise
    [(_, _, found)] = in_outages(dive, config, {}, noise, outages)
    [whole], [inside] = noise.values(), found.values()
    np.testing.assert_array_equal(whole.time_ns, ping_ns)
    assert inside.time_ns.tolist() == [outages[0][0]]
    np.testing.assert_array_equal(inside.factors, np.full((1, 6), 101.0))


@pytest.mark.parametrize(
    ("start_ns", "end_ns", "kept"),
    [(5, 9, []), (5, 10, [10]), (10, 25, [10, 20]), (15, 30, [10, 20, 30]), (40, 50, [30])],
)
def test_a_factor_holds_from_its_time_to_the_next(
    start_ns: int, end_ns: int, kept: list[int]
) -> None:
    factors = NoiseFactors(np.array([10, 20, 30]), np.arange(18.0).reshape(3, 6))
    assert factors.within(start_ns, end_ns).time_ns.tolist() == kept


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (None, "NoneType, not two arrays"),
        ((np.arange(3), np.ones((3, 3))), r"\(3,\) and \(3, 3\)"),
        ((np.arange(3.0), np.ones((3, 2))), "increasing int64"),
        (
            (np.arange(3), np.array([[1.0, 1.0], [0.0, 1.0], [1.0, np.nan]])),
            "2 of 3 rows, the first is row 1",
        ),
    ],
)
def test_factors_that_are_none_are_reported(given: tuple[TimeNs, Floats], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        checked_factors(given)


def test_settings_of_noise_are_code_that_is_written_and_read() -> None:
    override = 'filters.mine={aiding=["velocity"], noise_factors="a.b:C", version="2"}'
    with pytest.raises(ConfigError, match=r"filters\.mine\.noise_factors names code: a\.b:C"):
        load_config(overrides=[override])
    config = load_config(overrides=[override], allow_code=True)
    assert config.code == ("a.b:C",)
    assert 'noise_factors = "a.b:C"' in render_toml(config)
    assert config.without_code().filters["mine"] == Filter(aiding=("velocity",))
    for key, value in {"noise_factors": "C", "version": "2", "input": "log"}.items():
        with pytest.raises(ConfigError, match=rf"filters\.mine\.{key} "):
            load_config(
                overrides=[f'filters.mine={{aiding=["velocity"], {key}="{value}"}}'],
                allow_code=True,
            )
