"""Sensors of which the filters are told the truth."""

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Initial, Noise

MATCHED = Config(
    noise=Noise(
        accel_white_mps_rts=5e-3,
        gyro_white_rad_rts=4.4e-5,
        accel_bias_walk_mps2_rts=2e-5,
        gyro_bias_walk_radps_rts=8e-8,
    ),
    initial=Initial(uncertainty="settings", accel_bias_sd_mg=3.0),
    dvl=Dvl(velocity_sd_mps=0.01),
    filters={
        "baseline": Filter(aiding=("velocity",)),
        "published": Filter(
            aiding=("velocity", "acceleration"), acceleration=Acceleration(model="published")
        ),
    },
)
"""A tactical IMU and a good DVL, of which the filters are told the truth."""
