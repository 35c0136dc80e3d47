"""Adaptive and Student-t noise of the DVL, as candidates beside a filter that believes what it is told."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from matched_sensors import MATCHED

from insdvl_replay.core.config import Config, Evaluation, Filter, Initial
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.words import EvidenceWord
from insdvl_replay.nav.measurement_noise import CEILING, FLOOR, adapted_factor, outlier_factor
from insdvl_replay.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors

SD_MPS, WHITE = 0.02, 1e-3
CONFIG = Config(
    noise=msgspec.structs.replace(MATCHED.noise, accel_white_mps_rts=WHITE),
    initial=Initial(accel_bias_sd_mg=1.02, gyro_bias_sd_degph=0.1),
    dvl=msgspec.structs.replace(MATCHED.dvl, velocity_sd_mps=SD_MPS),
    evaluation=Evaluation(starts=1),
    filters={
        "baseline": Filter(aiding=("velocity",)),
        "adaptive": Filter(aiding=("velocity",), dvl_noise="adaptive"),
        "student": Filter(aiding=("velocity",), dvl_noise="student-t"),
    },
)


def simulated(seed: int, contaminated: float) -> Dive:
    """A dive of which a share of the pings is off by a metre per second along three beams."""
    dive = simulate_dive(
        "lawnmower", seed=seed, duration_s=1500.0, imu_errors=ImuErrors(WHITE, 4.4e-5, 0.01, 0.0, 2e-5, 8e-8),
        dvl_errors=DvlErrors(0.0, 0.0, 0.0, 0.0, velocity_sd_mps=SD_MPS),
    )  # fmt: skip
    assert dive.dvl.beam_velocity_mps is not None
    rng, beams = np.random.default_rng(seed), dive.dvl.beam_velocity_mps.copy()
    hit = rng.random(len(beams)) < contaminated
    beams[hit] += rng.normal(scale=0.5, size=(int(hit.sum()), beams.shape[1]))
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def words(seed: int, contaminated: float, name: str) -> dict[str, str]:
    rows = replay_dive(simulated(seed, contaminated), CONFIG).tables.evidence
    return {row.quantity: row.word for row in rows if row.filter == name}


@pytest.mark.parametrize("name", ["adaptive", "student"])
def test_where_pings_are_contaminated_they_are_better(name: str) -> None:
    found = [words(seed, 0.05, name) for seed in (1, 2, 3)]
    along = [each["velocity_along"] for each in found]
    assert along.count(EvidenceWord.BETTER) == 3, found
    assert not any(word == EvidenceWord.WORSE for each in found for word in each.values()), found


@pytest.mark.parametrize("name", ["adaptive", "student"])
def test_on_clean_dives_they_are_equivalent(name: str) -> None:
    found = [words(seed, 0.0, name) for seed in (1, 2, 3)]
    assert [each["velocity_along"] for each in found].count(EvidenceWord.EQUIVALENT) == 3, found
    assert not any(word in (EvidenceWord.WORSE, EvidenceWord.BETTER) for each in found for word in each.values()), found


def test_a_noise_that_doubles_is_followed_within_a_window_or_two() -> None:
    rng, R, factor = np.random.default_rng(2), np.eye(3), 1.0
    found = []
    for step in range(600):
        var = 1.0 if step < 300 else 2.0
        z = rng.normal(scale=np.sqrt(var + 0.5), size=3)
        factor = adapted_factor(factor, z, factor * R + 0.5 * np.eye(3), factor * R)
        found.append(factor)
    assert np.mean(found[100:300]) == pytest.approx(1.0, abs=0.15)
    assert np.mean(found[360:]) == pytest.approx(2.0, abs=0.3)
    assert min(found) > FLOOR
    assert max(found) < CEILING


def test_an_innovation_as_large_as_expected_leaves_the_noise_as_it_is() -> None:
    assert outlier_factor(3.0, 3) == 1.0
    assert outlier_factor(103.0, 3) == pytest.approx(123.0 / 23.0)
