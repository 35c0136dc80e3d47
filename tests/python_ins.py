"""python-ins on the readings of a simulated dive: another's mechanisation, error model and Kalman filter.

Its filter has the position among its states. Beside our twelve states it is known to a millimetre at the start, and
with bottom track to centimetres at the end, which is nothing to gravity and to the Earth's rate: the other states do
not see it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from pyins.filters import run_feedback_filter
from pyins.inertial_sensor import EstimationModel
from pyins.measurements import BodyVelocity, Measurement, Position
from pyins.strapdown import compute_increments_from_imu
from pyins.transform import mat_from_rph, mat_to_rph
from pyins.util import ACCEL_COLS, GYRO_COLS, LLA_COLS, TRAJECTORY_COLS, TRAJECTORY_ERROR_COLS
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl, Filter, Initial, Noise, Span, Vector
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, MG, POSITION
from insdvl_replay.geometry.earth import EARTH_RATE
from insdvl_replay.sim.dive import START_NS, simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors, LostBeam, SensorErrors

START_S, END_S = (
    93.0,
    153.0,
)  # level at the start, so that roll, pitch and heading are as sure as phi; two turns
BEAM_SD_MPS = 0.0042
DENSITIES = {
    "accel_white_mps_rts": 0.01,
    "gyro_white_rad_rts": 4.4e-5,
    "accel_bias_walk_mps2_rts": 2e-5,
    "gyro_bias_walk_radps_rts": 8e-8,
}
NOISE = Noise(**DENSITIES)
INITIAL = Initial(
    uncertainty="settings", velocity_sd_mps=0.1, accel_bias_sd_mg=3.0, gyro_bias_sd_degph=10.0
)
IMU_ERRORS = ImuErrors(
    accel_bias_sd_mps2=3.0 * MG, gyro_bias_sd_radps=10.0 * DEG_PER_HOUR, **DENSITIES
)
DVL_ERRORS = DvlErrors(
    beam_sd_mps=BEAM_SD_MPS, beam_bias_sd_mps=0.0, beam_scale_sd=0.0, beam_quantum_mps=0.0
)


@dataclass(frozen=True)
class Case:
    """A dive, how its DVL is mounted, and the sensors beside it, which are at the IMU."""

    scenario: str = "figure-eight"
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0)
    beams: tuple[int, ...] = (0, 1, 2, 3)
    sensors: Mapping[str, SensorErrors] = field(default_factory=dict)
    end_s: float = END_S

    def dive(self) -> Dive:
        """Simulate it. python-ins corrects at the IMU sample before a ping; a ping at a sample leaves no difference."""
        with patch("insdvl_replay.sim.dive.FIRST_PING_S", 0.37):
            return self._simulated()

    def _simulated(self) -> Dive:
        lost = [
            LostBeam(beam, 0.0, self.end_s + 1.0) for beam in range(4) if beam not in self.beams
        ]
        return simulate_dive(
            self.scenario,
            seed=3,
            duration_s=self.end_s,
            reference_rate_hz=100.0,
            lost_beams=lost,
            imu_errors=IMU_ERRORS,
            dvl_errors=DVL_ERRORS,
            lever_arm_m=self.lever_arm_m,
            mounting_rpy_deg=self.mounting_rpy_deg,
            sensors=self.sensors,
        )

    def config(self, **changes: Any) -> Config:
        settings = {
            "dvl": Dvl(
                lever_arm_m=self.lever_arm_m,
                mounting_rpy_deg=self.mounting_rpy_deg,
                beam_sd_mps=BEAM_SD_MPS,
            ),
            "initial": INITIAL,
            "noise": NOISE,
            "span": Span(start_s=START_S),
            "filters": {"baseline": Filter(aiding=("velocity",))},
        }
        return Config(**(settings | changes))

    def velocities(self, dive: Dive) -> BodyVelocity:
        """Bring the DVL's readings to the IMU's axes and place, which python-ins takes for granted."""
        assert dive.dvl.beam_velocity_mps is not None
        assert dive.dvl.beam_vectors_d is not None
        mat_bd = Rotation.from_euler("xyz", self.mounting_rpy_deg, degrees=True).as_matrix()
        vectors_b = (dive.dvl.beam_vectors_d @ mat_bd.T)[list(self.beams)]
        velocity_b = dive.dvl.beam_velocity_mps[:, self.beams] @ np.linalg.pinv(vectors_b).T
        velocity_b -= np.cross(turn_rate_b(dive), self.lever_arm_m)
        measurement = BodyVelocity(
            pd.DataFrame(
                velocity_b, index=seconds(dive.dvl.time_ns, START_NS), columns=["VX", "VY", "VZ"]
            ),
            sd=1.0,
        )
        measurement.R = BEAM_SD_MPS**2 * np.linalg.inv(vectors_b.T @ vectors_b)
        return measurement


def turn_rate_b(dive: Dive) -> Floats:
    """Give the gyros' readings at the pings, less the Earth's rate."""
    assert dive.reference is not None
    rows = np.searchsorted(dive.imu.time_ns, dive.dvl.time_ns)
    latitude = dive.reference.position[rows, 0]
    earth_rate_n = EARTH_RATE * np.stack(
        [np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)], axis=-1
    )
    rate_b: Floats = dive.imu.angular_rate_b[rows] - np.einsum(
        "kji,kj->ki", dive.reference.mat_nb[rows], earth_rate_n
    )
    return rate_b


@dataclass(frozen=True)
class Prediction:
    """What a filter believes after its last ping. Without a state for the position nothing is said of its sd."""

    velocity_n: Floats
    mat_nb: Floats
    biases: Floats
    bias_sd: Floats
    position: Floats
    position_sd: Floats


def our_belief(history: History, last_ns: int) -> Prediction:
    row = int(np.searchsorted(history.time_ns, last_ns))
    biases = np.concatenate([history.accel_bias_b[row], history.gyro_bias_b[row]])
    bias_sd = np.concatenate([history.sd[row, BA], history.sd[row, BG]])
    return Prediction(
        history.velocity_n[row],
        history.mat_nb[row],
        biases,
        bias_sd,
        history.position[row],
        history.sd[row, POSITION] if history.estimates_position else np.empty(0),
    )


class Depth(Measurement):  # type: ignore[misc]
    """A depth as python-ins has its measurements: the third row of its own position's."""

    def __init__(self, depth_m: "pd.Series[float]", sd_m: float) -> None:
        self.fixes = Position(pd.DataFrame({"lat": 0.0, "lon": 0.0, "alt": -depth_m}), sd_m)
        super().__init__(self.fixes.data)

    def compute_matrices(
        self, time: float, pva: Any, error_model: Any
    ) -> tuple[Floats, Floats, Floats] | None:
        if (found := self.fixes.compute_matrices(time, pva, error_model)) is None:
            return None
        z, H, R = found
        return z[2:], H[2:], R[2:, 2:]


def fixes(dive: Dive, sd_m: float) -> Position:
    readings = dive.sensors["position"]
    values = readings.values * [1.0 / DEG, 1.0 / DEG, 1.0]
    data = pd.DataFrame(values, index=seconds(readings.time_ns, START_NS), columns=LLA_COLS)
    return Position(data[data.index > START_S], sd_m)


def depths(dive: Dive, sd_m: float) -> Depth:
    readings = dive.sensors["depth"]
    depth_m = pd.Series(readings.values[:, 0], index=seconds(readings.time_ns, START_NS))
    return Depth(depth_m[depth_m.index > START_S], sd_m)


def their_belief(
    dive: Dive, *measurements: Measurement, position_sd_m: float = 1e-3
) -> Prediction:
    assert dive.reference is not None
    imu = pd.DataFrame(
        np.hstack([dive.imu.angular_rate_b, dive.imu.specific_force_b]),
        index=seconds(dive.imu.time_ns, START_NS),
        columns=[*GYRO_COLS, *ACCEL_COLS],
    )
    result = run_feedback_filter(
        start(dive.reference),
        position_sd=position_sd_m,
        velocity_sd=INITIAL.velocity_sd_mps,
        level_sd=INITIAL.misalignment_sd_deg[0],
        azimuth_sd=INITIAL.misalignment_sd_deg[2],
        increments=compute_increments_from_imu(imu.loc[START_S:], "rate"),
        gyro_model=EstimationModel(
            INITIAL.gyro_bias_sd_degph * DEG_PER_HOUR,
            NOISE.gyro_white_rad_rts,
            NOISE.gyro_bias_walk_radps_rts,
        ),
        accel_model=EstimationModel(
            INITIAL.accel_bias_sd_mg * MG,
            NOISE.accel_white_mps_rts,
            NOISE.accel_bias_walk_mps2_rts,
        ),
        measurements=list(measurements),
        time_step=0.5,
    )
    last_s = measurements[0].data.index[-1]
    pva = result.trajectory.loc[last_s].to_numpy()
    return Prediction(
        pva[3:6],
        mat_from_rph(pva[6:]),
        np.concatenate([result.accel.loc[last_s], result.gyro.loc[last_s]]),
        np.concatenate([result.accel_sd.loc[last_s], result.gyro_sd.loc[last_s]]),
        pva[:3] * [DEG, DEG, 1.0],
        result.trajectory_sd.loc[last_s, TRAJECTORY_ERROR_COLS[:3]].to_numpy(),
    )


def start(reference: ReferenceColumns) -> "pd.Series[float]":
    row = int(np.searchsorted(reference.time_ns, START_NS + int(START_S * 1e9)))
    latitude, longitude, height_m = reference.position[row]
    position = [latitude / DEG, longitude / DEG, height_m]
    values = np.concatenate(
        [position, reference.velocity_n[row], mat_to_rph(reference.mat_nb[row])]
    )
    return pd.Series(values, index=TRAJECTORY_COLS, name=START_S)
