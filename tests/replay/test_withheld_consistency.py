"""What is said of a filter by a sensor that is withheld from it, on dives that start as far off as it is told."""

from collections import Counter
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from contaminated_dives import competitors

from insdvl_replay.core.config import Config, Evaluation, Filter, Heading, Initial, Position
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors
from insdvl_replay.studies.montecarlo import matched_errors

DIVES, EARTH_M = 20, 6.371e6
SENSOR_SD = 1.0
"""deg and m"""


def dive_and_start(sensor: str, start_sd: float, seed: int) -> tuple[Dive, Initial]:
    """A dive without a reference, and a start that is off by what filters are told, m and deg."""
    imu_errors, dvl_errors = matched_errors(competitors("beams", 1))
    dive = simulate_dive(
        "lawnmower", seed=seed, duration_s=400.0, imu_errors=imu_errors, dvl_errors=dvl_errors,
        sensors={sensor: SensorErrors(SENSOR_SD)},
    )  # fmt: skip
    assert dive.reference is not None
    (latitude, longitude, height_m), mat_nb = dive.reference.position[0], dive.reference.mat_nb[:1]
    rng = np.random.default_rng((seed, 1))
    north_m, east_m = start_sd * rng.standard_normal(2)
    start = Initial(
        source="level",
        heading_deg=float(rpy_from_mat(mat_nb)[0, 2] / DEG + start_sd * rng.standard_normal()),
        latitude_deg=float((latitude + north_m / EARTH_M) / DEG),
        longitude_deg=float((longitude + east_m / EARTH_M / np.cos(latitude)) / DEG),
        height_m=float(height_m),
        misalignment_sd_deg=(0.5, 0.5, start_sd),
        position_sd_m=(start_sd,) * 3,
        accel_bias_sd_mg=1.0,
        gyro_bias_sd_degph=0.1,
    )
    return replace(dive, reference=None), start


def words(
    sensor: str,
    states: tuple[str, ...],
    start_sd: float = 1.0,
    told_sd: float = SENSOR_SD,
    dives: int = DIVES,
) -> Counter[str]:
    """Count the words on one filter, each dive another world."""
    found: Counter[str] = Counter()
    for seed in range(dives):
        dive, start = dive_and_start(sensor, start_sd, seed)
        config: Config = msgspec.structs.replace(
            competitors("velocity", 1),
            initial=start,
            filters={
                "baseline": Filter(aiding=("velocity",), states=states),
                "candidate": Filter(aiding=("beams",), states=states),
            },
            evaluation=Evaluation(held_out=(sensor,)),
            position=Position(sd_m=told_sd),
            heading=Heading(sd_deg=told_sd),
        )
        rows = replay_dive(dive, config).tables.consistency
        found.update(
            row.verdict
            for row in rows
            if (row.filter, row.measurement) == ("baseline", f"held_out_{sensor}")
        )
    return found


@pytest.mark.nightly
@pytest.mark.parametrize(("sensor", "states"), [("position", ("position",)), ("heading", ())])
def test_filters_that_are_right_are_seldom_said_to_be_wrong(
    sensor: str, states: tuple[str, ...]
) -> None:
    found = words(sensor, states)
    assert found["consistent"] + found["insufficient data"] >= DIVES - 1, found


@pytest.mark.nightly
@pytest.mark.parametrize(("sensor", "states"), [("position", ("position",)), ("heading", ())])
@pytest.mark.parametrize(("told_sd", "word"), [(3.0, "conservative"), (0.5, "overconfident")])
def test_a_wrong_noise_of_the_sensor_is_found(
    sensor: str, states: tuple[str, ...], told_sd: float, word: str
) -> None:
    found = words(sensor, states, 0.1, told_sd)
    assert found[word] >= DIVES - 1, found


def test_a_filter_that_does_not_estimate_the_position_does_not_tell() -> None:
    assert words("position", (), dives=2) == {"not available": 2}
