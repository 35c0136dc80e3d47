"""Whose noise a filter takes: its own before the common one, whichever key either stands in."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from insdvl_replay.batch.noise_tuning import with_tuned_baseline
from insdvl_replay.core.config import Config, Dvl, Filter, InertialNoise
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import DvlMounting, beam_vectors
from insdvl_replay.nav.dvl import DvlVelocities, dvl_velocities
from insdvl_replay.preparation.filters import ResolvedFilter, resolve_filter
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive
from insdvl_replay.studies.montecarlo import matched_errors

BEAM, VELOCITY = "beam_sd_mps", "velocity_sd_mps"

# What [dvl] names, what the filter names, and what holds. The digits say where a value is from: 1 and 2 are [dvl]'s, 3
# and 4 the filter's.
TABLE = [
    ({VELOCITY: 0.1}, {}, (VELOCITY, 0.1)),
    ({VELOCITY: 0.1}, {VELOCITY: 0.3}, (VELOCITY, 0.3)),
    ({VELOCITY: 0.1}, {BEAM: 0.4}, (BEAM, 0.4)),
    ({VELOCITY: 0.1}, {VELOCITY: 0.3, BEAM: 0.4}, (BEAM, 0.4)),
    ({VELOCITY: 0.1, BEAM: 0.2}, {}, (BEAM, 0.2)),
    ({VELOCITY: 0.1, BEAM: 0.2}, {VELOCITY: 0.3}, (VELOCITY, 0.3)),
    ({VELOCITY: 0.1, BEAM: 0.2}, {BEAM: 0.4}, (BEAM, 0.4)),
    ({VELOCITY: 0.1, BEAM: 0.2}, {VELOCITY: 0.3, BEAM: 0.4}, (BEAM, 0.4)),
]
COMBINATIONS = pytest.mark.parametrize(("common", "own", "expected"), TABLE)
Named = dict[str, float]
Expected = tuple[str, float]


def configured(common: Named, own: Named) -> tuple[Config, Filter]:
    filter_ = Filter(aiding=("velocity",), **own)
    return Config(dvl=Dvl(**common), filters={"baseline": filter_}), filter_


def resolved(filter_: Filter, config: Config) -> ResolvedFilter:
    return resolve_filter("baseline", filter_, config)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("straight", seed=3, duration_s=40.0, imu_rate_hz=20.0)


@pytest.fixture(scope="module")
def from_beams(dive: Dive) -> DvlVelocities:
    return dvl_velocities(dive.dvl)


def reports_velocities(dive: Dive) -> Dive:
    """The same dive from a DVL that keeps its beams to itself."""
    velocities = dvl_velocities(dive.dvl)
    return replace(
        dive,
        dvl=replace(
            dive.dvl, beam_velocity_mps=None, beam_vectors_d=None, velocity_d=velocities.velocity_b
        ),
    )


@COMBINATIONS
def test_the_filters_own_noise_goes_before_the_common_one(
    common: Named, own: Named, expected: Expected
) -> None:
    config, filter_ = configured(common, own)
    assert resolved(filter_, config).dvl_noise == expected


@COMBINATIONS
def test_the_filter_is_given_what_was_resolved(
    dive: Dive, from_beams: DvlVelocities, common: Named, own: Named, expected: Expected
) -> None:
    """A DVL that keeps its beams to itself has the noise that those of a Janus at 30 deg have."""
    config, filter_ = configured(common, own)
    shape = {BEAM: np.diag([2.0, 2.0, 1.0 / 3.0]), VELOCITY: np.eye(3)}
    key, sd_mps = expected
    for velocities in (from_beams, dvl_velocities(reports_velocities(dive).dvl)):
        (measurement,) = resolved(filter_, config).measurements(velocities, DvlMounting())
        np.testing.assert_allclose(
            measurement.cov[0], sd_mps**2 * shape[key], rtol=0.0, atol=1e-12
        )


@pytest.mark.parametrize("tilt_deg", [20.0, 30.0])
def test_noise_of_a_beam_is_turned_with_the_mounting(dive: Dive, tilt_deg: float) -> None:
    """Along the axes of the DVL a beam's variance times 1 / (2 sin^2), twice, and 1 / (4 cos^2) of the tilt."""
    reported = replace(reports_velocities(dive).dvl, beam_vectors_d=beam_vectors(tilt_deg))
    mounting = DvlMounting.from_rpy((0.0, 0.0, 0.0), (90.0, 0.0, 0.0), 1.0)
    (measurement,) = resolved(*configured({BEAM: 0.01}, {})[::-1]).measurements(
        dvl_velocities(reported, mounting), mounting
    )
    sine, cosine = np.sin(tilt_deg * DEG), np.cos(tilt_deg * DEG)
    across, down = 1.0 / (2.0 * sine**2), 1.0 / (4.0 * cosine**2)
    expected = 1e-4 * np.diag([across, down, across])
    np.testing.assert_allclose(
        measurement.cov, np.broadcast_to(expected, measurement.cov.shape), atol=1e-16
    )


@COMBINATIONS
def test_simulated_sensors_err_as_the_filter_is_reported(
    common: Named, own: Named, expected: Expected
) -> None:
    """What the drawn noise scatters by, against R of the filter that it is drawn for."""
    del expected
    config, filter_ = configured(common, own)
    errors = matched_errors(config)[1]
    exact = exact_dive("straight", duration_s=4000.0, imu_rate_hz=2.0).dvl
    assert exact.beam_vectors_d is not None
    rng, pings = np.random.default_rng(4), len(exact.time_ns)
    beams = errors.beam_sd_mps * rng.standard_normal((pings, 4))
    beams += errors.velocity_sd_mps * rng.standard_normal((pings, 3)) @ exact.beam_vectors_d.T
    noise = dvl_velocities(replace(exact, beam_velocity_mps=beams))
    (measurement,) = resolved(filter_, config).measurements(noise, DvlMounting())
    R = measurement.cov[0]
    np.testing.assert_allclose(np.cov(noise.velocity_b.T), R, rtol=0.0, atol=0.1 * R.max())


@COMBINATIONS
def test_the_control_fits_the_noise_that_the_baseline_has(
    dive: Dive,
    monkeypatch: pytest.MonkeyPatch,
    common: Named,
    own: Named,
    expected: Expected,
) -> None:
    """A search that may not leave its start ends there."""
    for edge in ("LOWEST", "HIGHEST"):
        monkeypatch.setattr(f"insdvl_replay.batch.noise_tuning.{edge}", 1.0)
    config, _ = configured(common, own)
    key, sd_mps = expected
    for from_one in (dive, reports_velocities(dive)):
        tuned = with_tuned_baseline(from_one, config)[0].filters["tuned"]
        assert getattr(tuned, key) == pytest.approx(sd_mps)
        found = resolved(tuned, config)
        assert found.dvl_noise == (key, pytest.approx(sd_mps))
        assert found.noise_density == pytest.approx(
            resolved(config.filters["baseline"], config).noise_density
        )


def test_own_velocity_noise_moves_the_result_under_a_common_noise_of_beams(dive: Dive) -> None:
    velocity = Filter(aiding=("velocity",))
    noisy = Filter(aiding=("velocity",), velocity_sd_mps=0.2)
    baseline, own = replay_dive(
        dive, Config(dvl=Dvl(beam_sd_mps=0.01), filters={"baseline": velocity, "noisy": noisy})
    ).histories
    (alone,) = replay_dive(
        dive, Config(dvl=Dvl(velocity_sd_mps=0.2), filters={"baseline": velocity})
    ).histories
    np.testing.assert_array_equal(own.sd, alone.sd)
    assert (own.sd[-1, :3] > 1.3 * baseline.sd[-1, :3]).all()


@pytest.mark.parametrize("key", InertialNoise.__struct_fields__)
def test_a_density_of_the_filters_own_goes_before_the_common_one(key: str) -> None:
    config, own = Config(), msgspec.structs.replace(Filter(aiding=("velocity",)), **{key: 0.0})
    assert resolved(own, config).inertial_noise == InertialNoise(**{key: 0.0})
    assert np.count_nonzero(resolved(own, config).noise_density) == 9
