"""A filter of the user's: a class that makes a solution of a dive and a start, or a program with the same as files."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from insdvl_replay.core.dive_columns import Dive, Floats, TimeNs
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.nav.levelling import Start


class CandidateError(Exception):
    """Why a candidate is not evaluated."""


@dataclass(frozen=True)
class Solution:
    """The trajectory of a candidate. What it does not estimate is left out."""

    time_ns: TimeNs  # (k,), increasing, on the clock of the dive
    position: Floats | None = None  # (k, 3), latitude rad, longitude rad, height m
    velocity_n: Floats | None = None  # (k, 3), m/s
    mat_nb: Floats | None = None  # (k, 3, 3)
    # (c, 9, 9), covariance of velocity, misalignment and position errors, in n, SI; NaN: unknown
    cov: Floats | None = None
    cov_ns: TimeNs | None = None  # (c,), its times, if they are not those of the rows
    # (k, 3), predicted minus measured velocity of the DVL; NaN where there is none
    innovation_b: Floats | None = None
    innovation_cov: Floats | None = None  # (k, 3, 3), their covariance S


Axes = tuple[float, float, float]


class StartFile(Struct, frozen=True):
    """The start of a program, in JSON. Each value has its standard deviation under its name with ``_sd``."""

    time_ns: Annotated[int, Meta(description="on the clock of the dive")]
    latitude_deg: float
    latitude_deg_sd: float
    longitude_deg: float
    longitude_deg_sd: float
    height_m: Annotated[float, Meta(description="above the ellipsoid")]
    height_m_sd: float
    velocity_ned_mps: Annotated[Axes, Meta(description="of the IMU: north, east, down")]
    velocity_ned_mps_sd: Axes
    roll_pitch_heading_deg: Axes
    roll_pitch_heading_deg_sd: Axes
    accelerometer_bias_mps2: Annotated[
        Axes, Meta(description="reading minus true: forward, starboard, down")
    ]
    accelerometer_bias_mps2_sd: Axes
    gyro_bias_radps: Annotated[
        Axes, Meta(description="reading minus true: forward, starboard, down")
    ]
    gyro_bias_radps_sd: Axes
    dvl_lever_arm_m: Annotated[Axes, Meta(description="IMU to DVL: forward, starboard, down")]


@dataclass(frozen=True)
class CandidateStart(Start):
    """The start that a candidate is given: a `Start` with its time, and what the dive does not hold."""

    time_ns: int = 0
    dvl_lever_arm_b: Floats = field(default_factory=lambda: np.zeros(3))  # IMU to DVL, m
    position_sd_m: Floats = field(default_factory=lambda: np.ones(3))  # north, east, down

    def to_json(self) -> bytes:
        """Write what a program is given, a `StartFile`."""
        _, _, heading = rpy_from_mat(self.mat_nb)
        level_nb = mat_from_rpy(np.array([0.0, 0.0, heading]))
        sd = self.sd
        level_cov = level_nb.T @ self.cov[3:6, 3:6] @ level_nb
        position_sd = np.abs(moved_position(self.position, self.position_sd_m) - self.position)
        values: dict[str, tuple[Any, Any]] = {
            "latitude_deg": (self.position[0] / DEG, position_sd[0] / DEG),
            "longitude_deg": (self.position[1] / DEG, position_sd[1] / DEG),
            "height_m": (self.position[2], position_sd[2]),
            "velocity_ned_mps": (self.velocity_n, sd[0:3]),
            "roll_pitch_heading_deg": (
                rpy_from_mat(self.mat_nb) / DEG,
                np.sqrt(np.diagonal(level_cov)) / DEG,
            ),
            "accelerometer_bias_mps2": (self.accel_bias_b, sd[6:9]),
            "gyro_bias_radps": (self.gyro_bias_b, sd[9:12]),
        }
        content: dict[str, Any] = {
            "time_ns": self.time_ns,
            "dvl_lever_arm_m": self.dvl_lever_arm_b.tolist(),
        }
        for name, (value, sigma) in values.items():
            content[name] = np.asarray(value).tolist()
            content[f"{name}_sd"] = np.asarray(sigma).tolist()
        return (
            msgspec.json.format(msgspec.json.encode(msgspec.convert(content, StartFile)), indent=1)
            + b"\n"
        )

    @classmethod
    def from_json(cls, text: str | bytes) -> "CandidateStart":
        """Read what `to_json` writes."""
        given = msgspec.json.decode(text, type=StartFile)
        rpy = np.array(given.roll_pitch_heading_deg) * DEG
        rpy_sd = np.array(given.roll_pitch_heading_deg_sd) * DEG
        sd = (
            given.velocity_ned_mps_sd,
            (0.0,) * 3,
            given.accelerometer_bias_mps2_sd,
            given.gyro_bias_radps_sd,
        )
        cov = np.diag(np.concatenate(sd) ** 2)
        cov[3:6, 3:6] = misalignment_cov(rpy_sd[None], rpy[2:])[0]
        return cls(
            np.array([given.latitude_deg * DEG, given.longitude_deg * DEG, given.height_m]),
            np.array(given.velocity_ned_mps),
            mat_from_rpy(rpy),
            cov,
            np.array(given.accelerometer_bias_mps2),
            np.array(given.gyro_bias_radps),
            time_ns=given.time_ns,
            dvl_lever_arm_b=np.array(given.dvl_lever_arm_m),
        )


class Candidate:
    """A filter of yours; made without arguments, a new one for each run.

    `insdvl_replay.run_as_program` makes a program of it.
    """

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Return the trajectory from the start to the end of the dive.

        Parameters
        ----------
        dive : Dive
            What the built-in filters get: ``imu``, ``dvl.velocity_d`` in the axes of the IMU, and ``sensors``; all in
            SI, at their times of validity.
        start : CandidateStart
            State, covariance and time at the start.
        """
        raise NotImplementedError("the class has no method run(self, dive, start)")


def misalignment_cov(rpy_sd: Floats, heading: Floats) -> Floats:
    """Turn standard deviations of roll, pitch and heading, shape (k, 3), to a covariance in n, shape (k, 3, 3)."""
    level_nb = mat_from_rpy(np.column_stack([np.zeros((len(heading), 2)), heading]))
    return np.asarray((level_nb * rpy_sd[:, None, :] ** 2) @ np.swapaxes(level_nb, 1, 2))
