"""From the point that a reference is of to the IMU, where the filters are."""

from dataclasses import replace

import numpy as np

from insdvl_replay.core.columns import Floats, ImuColumns, ReferenceColumns, seconds
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.frames import moved_position


def reference_at_imu(reference: ReferenceColumns, imu: ImuColumns, lever_arm_b: Floats) -> ReferenceColumns:
    """Move a reference to the IMU: ``p_imu = p - C l`` and ``v_imu = v - C (w_eb x l)``.

    Parameters
    ----------
    reference : ReferenceColumns
        r rows.
    imu : ImuColumns
        Gives the angular rate, linear between samples.
    lever_arm_b : ndarray, shape (3,)
        IMU to the reference's point, m.

    Returns
    -------
    ReferenceColumns
        Rows without an attitude lose their position and velocity, rows outside the IMU's samples their velocity. Rows
        of which no number is left are left out. With no lever arm, and numbers in all rows, the reference itself.
    """
    moved = _moved(reference, imu, lever_arm_b) if np.any(lever_arm_b) else reference
    said = np.any(list(moved.known.values()), axis=0)
    return moved if said.all() else moved.rows(said)


def _moved(reference: ReferenceColumns, imu: ImuColumns, lever_arm_b: Floats) -> ReferenceColumns:
    arm_n = reference.mat_nb @ lever_arm_b
    arm_velocity_n = np.einsum("kij,kj->ki", reference.mat_nb, np.cross(_rate_eb_b(reference, imu), lever_arm_b))
    return replace(
        reference,
        position=moved_position(reference.position, -arm_n),
        velocity_n=reference.velocity_n - arm_velocity_n,
    )


def _rate_eb_b(reference: ReferenceColumns, imu: ImuColumns) -> Floats:
    sample_s, row_s = seconds(imu.time_ns, imu.time_ns[0]), seconds(reference.time_ns, imu.time_ns[0])
    columns = [np.interp(row_s, sample_s, column, np.nan, np.nan) for column in imu.angular_rate_b.T]
    latitude = np.where(np.isfinite(reference.position[:, 0]), reference.position[:, 0], 0.0)
    rate_ie_b = np.einsum("kji,kj->ki", reference.mat_nb, earth_rate_n(latitude))
    rate_eb_b: Floats = np.column_stack(columns) - rate_ie_b
    return rate_eb_b
