"""A dive as a log: what a vehicle's recorder would have written.

``/imu`` sensor_msgs/Imu, ``/dvl`` marine_acoustic_msgs/Dvl or geometry_msgs/TwistWithCovarianceStamped, ``/reference``
insdvl_msgs/NavSolution, ``/truth/biases`` insdvl_msgs/SensorBiases, ``/pressure`` sensor_msgs/FluidPressure,
``/ahrs`` geometry_msgs/QuaternionStamped, ``/gnss`` sensor_msgs/NavSatFix. Axes are forward, starboard, down.

What is computed here of the columns is the same on every processor: matrices are solved by formulae, since LAPACK sums
in another order on each, and what goes through a library's arcs is rounded, since their last bits differ.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay import __version__
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
    TruthColumns,
)
from insdvl_replay.core.states import STANDARD_GRAVITY_MPS2
from insdvl_replay.geometry.frames import MAT_ENU_NED, MAT_FRD_FLU
from insdvl_replay.geometry.rotation import mat_from_rpy, quat_from_mat, rpy_from_mat, turned
from insdvl_replay.logs.writing.writer import (
    BASE_LINK,
    DVL,
    IMU,
    NED,
    Batch,
    Column,
    missing_xyz,
    solution,
    stamped,
    write_log,
    xyz,
)

ALTITUDE_M: Final = 20.0
"""Height above a flat seabed from which the ranges of the beams follow; no filter uses it."""

VELOCITY_DIGITS: Final = 6
"""Decimals of what the instrument makes of its beams, m/s and rad: far below the noise of a beam."""
ANGLE_DIGITS: Final = 9
"""Decimals of the reference's angles, rad."""
QUATERNION_DIGITS: Final = 12

FIX_DIGITS: Final = 10
"""Decimals of the degrees of a fix: 11 um."""
PRESSURE_DIGITS: Final = 1
"""Decimals of a pressure, Pa: a hundredth of a millimetre of water."""
ATMOSPHERE_PA: Final = 101325.0
SEA_WATER_KGPM3: Final = 1025.0

_BOTTOM_TRACK: Final = 1
_BEAMS_FOR_VELOCITY: Final = 3
_UNKNOWN_VARIANCE: Final = -1.0


def write_dive(path: Path, dive: Dive) -> None:
    """Write a dive as a ROS 2 log.

    Parameters
    ----------
    path : Path
        File to write, replaced if it exists.
    dive : Dive
        Beams must be four. What is not there is not written: reference, truth.

    Raises
    ------
    LogError
        A time does not fit a ROS stamp.
    OSError
        The file cannot be written.
    ValueError
        The DVL has neither four beams nor velocities.
    """
    batches = [_imu(dive.imu), _dvl(dive.dvl)]
    if dive.reference is not None:
        batches.append(_reference(dive.reference))
    if dive.truth is not None:
        batches.append(_truth(dive.truth))
    batches += [_SENSORS[name](columns) for name, columns in dive.sensors.items()]
    write_log(path, batches, {"version": __version__, "dive": dive.name})


def _imu(imu: ImuColumns) -> Batch:
    columns = {
        "orientation_covariance": (_UNKNOWN_VARIANCE, *[0.0] * 8),
        **xyz("angular_velocity", imu.angular_rate_b),
        **xyz("linear_acceleration", imu.specific_force_b),
    }
    return stamped("/imu", "sensor_msgs/msg/Imu", imu.time_ns, IMU, columns)


def _dvl(dvl: DvlColumns) -> Batch:
    if dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        columns = _beam_columns(dvl.beam_velocity_mps, dvl.beam_vectors_d)
        return stamped("/dvl", "marine_acoustic_msgs/msg/Dvl", dvl.time_ns, DVL, columns)
    if dvl.velocity_d is None:
        raise ValueError("the DVL has neither beams nor velocities")
    columns = {**xyz("twist.twist.linear", dvl.velocity_d), **missing_xyz("twist.twist.angular")}
    return stamped("/dvl", "geometry_msgs/msg/TwistWithCovarianceStamped", dvl.time_ns, DVL, columns)


def _beam_columns(beam_velocity_mps: Floats, beam_vectors_d: Floats) -> dict[str, Column]:
    if beam_vectors_d.shape != (4, 3):
        raise ValueError(f"marine_acoustic_msgs/Dvl has 4 beams, found vectors of shape {beam_vectors_d.shape}")
    good = np.isfinite(beam_velocity_mps)
    good_beams = good.sum(axis=1)
    any_good = good_beams > 0
    velocity_d = np.round(_velocity_from_beams(beam_velocity_mps, beam_vectors_d), VELOCITY_DIGITS)
    forward, starboard = velocity_d[:, 0], velocity_d[:, 1]
    columns: dict[str, Column] = {
        "velocity_mode": _BOTTOM_TRACK,
        **xyz("velocity", velocity_d),
        "velocity_covar": (_UNKNOWN_VARIANCE,) * 9,
        "altitude": np.where(any_good, ALTITUDE_M, np.nan),
        "course_gnd": np.round(np.arctan2(starboard, forward), VELOCITY_DIGITS),
        "speed_gnd": np.round(np.sqrt(forward * forward + starboard * starboard), VELOCITY_DIGITS),
        "num_good_beams": good_beams,
        "sound_speed": np.nan,
        "beam_ranges_valid": any_good,
        "beam_velocities_valid": any_good,
        "range": np.where(good, ALTITUDE_M / beam_vectors_d[:, 2], np.nan),
        "range_covar": (_UNKNOWN_VARIANCE,) * 4,
        "beam_quality": (np.nan,) * 4,
        "beam_velocity": beam_velocity_mps,
        "beam_velocity_covar": (_UNKNOWN_VARIANCE,) * 4,
    }
    for i, vector in enumerate(beam_vectors_d.tolist()):
        columns |= {f"beam_unit_vec[{i}].{axis}": component for axis, component in zip("xyz", vector, strict=True)}
    return columns


def _velocity_from_beams(beam_velocity_mps: Floats, beam_vectors_d: Floats) -> Floats:
    """Solve the beams for the velocity by least squares, as the instrument would; NaN with fewer than three beams.

    The normal matrix N is symmetric, so that its adjugate has the cross products of its columns as its rows.
    """
    good = np.isfinite(beam_velocity_mps)
    normal, projected = np.zeros((len(good), 3, 3)), np.zeros((len(good), 3))
    for beam, vector in enumerate(beam_vectors_d):
        normal += np.where(good[:, beam, None, None], vector[:, None] * vector, 0.0)
        projected += np.where(good[:, beam, None], beam_velocity_mps[:, beam, None] * vector, 0.0)
    x, y, z = (normal[:, i] for i in range(3))
    adjugate = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    determinant = turned(adjugate[:, :1], x)
    enough = good.sum(axis=1, keepdims=True) >= _BEAMS_FOR_VELOCITY
    return np.divide(turned(adjugate, projected), determinant, out=np.full_like(projected, np.nan), where=enough)


def _reference(reference: ReferenceColumns) -> Batch:
    rpy = np.round(rpy_from_mat(reference.mat_nb), ANGLE_DIGITS)
    columns = solution(reference.position, reference.velocity_n, rpy)
    return stamped("/reference", "insdvl_msgs/msg/NavSolution", reference.time_ns, NED, columns)


def _truth(truth: TruthColumns) -> Batch:
    columns: dict[str, Column] = {"accel_bias_mps2": truth.accel_bias_b, "gyro_bias_radps": truth.gyro_bias_b}
    return stamped("/truth/biases", "insdvl_msgs/msg/SensorBiases", truth.time_ns, IMU, columns)


def _depth(depth: SensorColumns) -> Batch:
    pressure_pa = ATMOSPHERE_PA + SEA_WATER_KGPM3 * STANDARD_GRAVITY_MPS2 * depth.values[:, 0]
    columns: dict[str, Column] = {"fluid_pressure": np.round(pressure_pa, PRESSURE_DIGITS), "variance": 0.0}
    return stamped("/pressure", "sensor_msgs/msg/FluidPressure", depth.time_ns, IMU, columns)


def _heading(heading: SensorColumns) -> Batch:
    """Write the attitude, level where it is not known, east-north-up and forward-port-up, as its type has it."""
    if (mat_nb := heading.mat_nb) is None:
        level = np.zeros((len(heading.time_ns), 2))
        mat_nb = mat_from_rpy(np.concatenate([level, heading.values], axis=1))
    quat = np.round(quat_from_mat(MAT_ENU_NED.T @ mat_nb @ MAT_FRD_FLU.T), QUATERNION_DIGITS)
    columns: dict[str, Column] = {
        f"quaternion.{axis}": component for axis, component in zip("xyzw", quat.T, strict=True)
    }
    return stamped("/ahrs", "geometry_msgs/msg/QuaternionStamped", heading.time_ns, BASE_LINK, columns)


def _fix(fixes: SensorColumns) -> Batch:
    latitude_deg, longitude_deg = np.round(np.rad2deg(fixes.values[:, :2]), FIX_DIGITS).T
    columns = {"latitude": latitude_deg, "longitude": longitude_deg, "altitude": np.round(fixes.values[:, 2], 4)}
    return stamped("/gnss", "sensor_msgs/msg/NavSatFix", fixes.time_ns, BASE_LINK, columns)


_SENSORS: Final[dict[str, Callable[[SensorColumns], Batch]]] = {"depth": _depth, "heading": _heading, "position": _fix}
