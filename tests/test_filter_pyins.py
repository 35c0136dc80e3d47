"""The baseline against python-ins: another's mechanisation, error model and Kalman filter on the same readings.

Its filter has the position among its states. There it is known to a millimetre at the start, and with bottom track
unsure by centimetres at the end, which is nothing to gravity and to the Earth's rate: the other 12 states do not see it.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from pyins.filters import run_feedback_filter
from pyins.inertial_sensor import EstimationModel
from pyins.measurements import BodyVelocity
from pyins.strapdown import compute_increments_from_imu
from pyins.transform import mat_from_rph, mat_to_rph
from pyins.util import ACCEL_COLS, GYRO_COLS, TRAJECTORY_COLS
from scipy.spatial.transform import Rotation

from insdvl_replay.columns import Dive, Floats, ReferenceColumns, seconds
from insdvl_replay.config import Config, Dvl, Filter, Initial, Noise, Span, Vector
from insdvl_replay.earth import EARTH_RATE
from insdvl_replay.history import History
from insdvl_replay.replay import replay_dive
from insdvl_replay.sim.dive import START_NS, simulate_dive
from insdvl_replay.sim.dvl_errors import DvlErrors, LostBeam
from insdvl_replay.sim.imu_errors import ImuErrors
from insdvl_replay.states import BA, BG, DEG, DEG_PER_HOUR, MG, PHI

START_S, END_S = 93.0, 153.0  # level at the start, so that roll, pitch and heading are as sure as phi; two turns
BEAM_SD_MPS = 0.0042
NOISE = Noise(
    accel_white_mps_rts=0.01,
    gyro_white_rad_rts=4.4e-5,
    accel_bias_walk_mps2_rts=2e-5,
    gyro_bias_walk_radps_rts=8e-8,
)
INITIAL = Initial(velocity_sd_mps=0.1, accel_bias_sd_mg=3.0, gyro_bias_sd_degph=10.0)
IMU_ERRORS = ImuErrors(0.01, 4.4e-5, 3.0 * MG, 10.0 * DEG_PER_HOUR, 2e-5, 8e-8)
DVL_ERRORS = DvlErrors(BEAM_SD_MPS, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Case:
    """A dive and how its DVL is mounted."""

    scenario: str = "figure-eight"
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0)
    beams: tuple[int, ...] = (0, 1, 2, 3)

    def dive(self) -> Dive:
        lost = [LostBeam(beam, 0.0, END_S + 1.0) for beam in range(4) if beam not in self.beams]
        return simulate_dive(
            self.scenario,
            seed=3,
            duration_s=END_S,
            reference_rate_hz=100.0,
            lost_beams=lost,
            imu_errors=IMU_ERRORS,
            dvl_errors=DVL_ERRORS,
            lever_arm_m=self.lever_arm_m,
            mounting_rpy_deg=self.mounting_rpy_deg,
        )

    def config(self) -> Config:
        return Config(
            dvl=Dvl(
                lever_arm_m=self.lever_arm_m, mounting_rpy_deg=self.mounting_rpy_deg, beam_sd_mps=BEAM_SD_MPS
            ),
            initial=INITIAL,
            noise=NOISE,
            span=Span(start_s=START_S),
            filters={"baseline": Filter(aiding=("velocity",))},
        )

    def velocities(self, dive: Dive) -> BodyVelocity:
        """Bring the DVL's readings to the IMU's axes and place, which python-ins takes for granted."""
        assert dive.dvl.beam_velocity_mps is not None
        assert dive.dvl.beam_vectors_d is not None
        roll_pitch_heading = np.deg2rad(self.mounting_rpy_deg)
        mat_bd = Rotation.from_euler("xyz", roll_pitch_heading).as_matrix()
        vectors_b = (dive.dvl.beam_vectors_d @ mat_bd.T)[list(self.beams)]
        velocity_b = dive.dvl.beam_velocity_mps[:, self.beams] @ np.linalg.pinv(vectors_b).T
        velocity_b -= np.cross(turn_rate_b(dive), self.lever_arm_m)
        measurement = BodyVelocity(
            pd.DataFrame(velocity_b, index=seconds(dive.dvl.time_ns, START_NS), columns=["VX", "VY", "VZ"]), sd=1.0
        )
        measurement.R = BEAM_SD_MPS**2 * np.linalg.inv(vectors_b.T @ vectors_b)
        return measurement


def turn_rate_b(dive: Dive) -> Floats:
    """Give the gyros' readings at the pings, less the Earth's rate."""
    assert dive.reference is not None
    rows = np.searchsorted(dive.imu.time_ns, dive.dvl.time_ns)
    latitude = dive.reference.position[rows, 0]
    earth_rate_n = EARTH_RATE * np.stack([np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)], axis=-1)
    rate_b: Floats = dive.imu.angular_rate_b[rows] - np.einsum("kji,kj->ki", dive.reference.mat_nb[rows], earth_rate_n)
    return rate_b
