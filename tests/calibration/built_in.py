"""Dives of a vehicle whose DVL is built in otherwise than the configuration says, by numbers that are known."""

from typing import Final

import numpy as np

from insdvl_replay.calibration.innovations import PARAMETERS, ReadDive
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.preparation.prepared import with_reference_at_imu
from insdvl_replay.sim.dive import add_errors, exact_dive, late_and_long
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

CONFIG: Final = load_config("fog")
WHITE: Final = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
DELAY_S, ARM_M, YAW_DEG, SCALE = 0.12, (0.3, -0.1, 0.2), 1.5, 1.02
TRUTH: Final = np.array([DELAY_S, 0.0, 0.0, YAW_DEG * DEG, *ARM_M, np.log(SCALE)])
"""What a calibration has to find, of `PARAMETERS`."""


def built_in_otherwise(
    scenario: str,
    seed: int,
    dvl_errors: DvlErrors = WHITE,
    yaw_deg: float = YAW_DEG,
    duration_s: float | None = None,
    config: Config = CONFIG,
    grade: str = "fog",
) -> ReadDive:
    """Simulate a dive whose configuration knows nothing of arm, yaw, delay and scale."""
    exact = exact_dive(
        scenario, duration_s=duration_s, lever_arm_m=ARM_M, mounting_rpy_deg=(0.0, 0.0, yaw_deg)
    )
    return as_read(
        late_and_long(add_errors(exact, GRADES[grade], dvl_errors, seed), DELAY_S, SCALE), config
    )


def as_read(dive: Dive, config: Config = CONFIG) -> ReadDive:
    """Take a dive as if it came from a log."""
    return ReadDive(with_reference_at_imu(dive, config), config)


def shown(values: Floats) -> Floats:
    """Turn SI to the units that are shown."""
    return values * np.array([parameter.shown_as for parameter in PARAMETERS])
