"""Fifteen states against python-ins, which has the position among its own, with fixes and with a depth."""

import numpy as np
import pytest
from python_ins import INITIAL, Case, depths, fixes, our_belief, their_belief

from insdvl_replay.core.config import Depth, Filter, Initial, Position
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

START_SD_M, FIX_SD_M, DEPTH_SD_M = 5.0, 0.5, 0.05


@pytest.mark.filterwarnings(
    "ignore:The copy keyword is deprecated"
)  # python-ins calls pandas the old way
@pytest.mark.parametrize(
    ("scenario", "sensor"),
    [
        (scenario, sensor)
        for sensor in ("position", "depth", None)
        for scenario in ("straight", "figure-eight")
    ],
)
@pytest.mark.nightly
def test_fifteen_states_predict_what_those_of_python_ins_predict(
    scenario: str, sensor: str | None
) -> None:
    case = Case(
        scenario, sensors={"position": SensorErrors(FIX_SD_M), "depth": SensorErrors(DEPTH_SD_M)}
    )
    dive = case.dive()
    more = {"position": fixes(dive, FIX_SD_M), "depth": depths(dive, DEPTH_SD_M)}
    aided = Filter(aiding=("velocity", *([sensor] if sensor else [])), states=("position",))
    settings = case.config(
        filters={"aided": aided},
        initial=Initial(
            uncertainty="settings",
            velocity_sd_mps=INITIAL.velocity_sd_mps,
            accel_bias_sd_mg=INITIAL.accel_bias_sd_mg,
            gyro_bias_sd_degph=INITIAL.gyro_bias_sd_degph,
            position_sd_m=(START_SD_M,) * 3,
        ),
        position=Position(sd_m=FIX_SD_M, height_sd_m=FIX_SD_M),
        depth=Depth(sd_m=DEPTH_SD_M, surface_height_m=0.0),
    )
    (history,) = replay_dive(dive, settings).histories
    ours = our_belief(history, int(dive.dvl.time_ns[-1]))
    others = [more[sensor]] if sensor else []
    theirs = their_belief(dive, case.velocities(dive), *others, position_sd_m=START_SD_M)
    np.testing.assert_allclose(ours.position_sd, theirs.position_sd, rtol=0.005)
    np.testing.assert_allclose(ours.bias_sd, theirs.bias_sd, rtol=0.005)
    apart_m = north_east_down_m(ours.position[None], theirs.position)[0]
    np.testing.assert_allclose(apart_m / ours.position_sd, 0.0, atol=0.06)
    np.testing.assert_allclose(
        ours.biases / ours.bias_sd, theirs.biases / ours.bias_sd, rtol=0.0, atol=0.06
    )
