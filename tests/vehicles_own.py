"""Solutions that a vehicle found itself, made of the truth and errors that are known, in files of their own.

Attitudes go to east-north-up and forward-port-up by scipy, which knows nothing of the program's matrices.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs.write import BASE_LINK, NED, ODOM, components, solution, stamped, write_log

ENU_OF_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_OF_FRD = Rotation.from_euler("x", 180.0, degrees=True)


@dataclass(frozen=True)
class Told:
    """What a vehicle says of itself.

    Attributes
    ----------
    way_n : ndarray, shape (k, 3)
        North, east, down from where its frame begins, m.
    velocity_n : ndarray, shape (k, 3)
        m/s
    attitude : Rotation
        Body to north-east-down, k of them.
    """

    time_ns: TimeNs
    moved_n: Floats
    velocity_n: Floats
    attitude: Rotation


def truth_of(dive: Dive, every: int = 1) -> Told:
    """Tell the truth, from an origin of its own that lies elsewhere."""
    reference = dive.reference
    assert reference is not None
    rows = slice(None, None, every)
    position = reference.position[rows]
    moved_n = north_east_down_m(position, np.broadcast_to(position[0], position.shape)) + np.array(
        [7.0, -3.0, 2.0]
    )
    return Told(
        reference.time_ns[rows],
        moved_n,
        reference.velocity_n[rows],
        Rotation.from_matrix(reference.mat_nb[rows]),
    )


def off(
    told: Told,
    *,
    moved_n: Floats | float = 0.0,
    velocity_n: Floats | float = 0.0,
    turn_n: Floats | None = None,
) -> Told:
    """Add errors, estimated minus true: metres, m/s, and a rotation vector in n."""
    turn = Rotation.identity() if turn_n is None else Rotation.from_rotvec(turn_n)
    return Told(
        told.time_ns, told.moved_n + moved_n, told.velocity_n + velocity_n, turn * told.attitude
    )


def write_odometry(
    path: Path,
    told: Told,
    covariances: Mapping[str, Floats] | None = None,
    topic: str = "/odometry",
) -> Path:
    """Write a log of nav_msgs/Odometry: the pose in its own frame, the twist in the body's."""
    attitude = ENU_OF_NED * told.attitude * FLU_OF_FRD
    quat = attitude.as_quat()
    velocity_b = attitude.inv().apply(ENU_OF_NED.apply(told.velocity_n))
    columns: dict[str, Any] = {
        "child_frame_id": BASE_LINK,
        **components("pose.pose.position", ENU_OF_NED.apply(told.moved_n)),
        **{f"pose.pose.orientation.{axis}": quat[:, i] for i, axis in enumerate("xyzw")},
        **components("twist.twist.linear", velocity_b),
        **{field: cov.reshape(len(quat), 36) for field, cov in (covariances or {}).items()},
    }
    write_log(path, [stamped(topic, "nav_msgs/msg/Odometry", told.time_ns, ODOM, columns)], {})
    return path


def write_nav_solution(path: Path, motion: ReferenceColumns, topic: str = "/vehicle") -> Path:
    """Write a log of the project's own insdvl_msgs/NavSolution."""
    columns = solution(motion.position, motion.velocity_n, rpy_from_mat(motion.mat_nb))
    write_log(
        path, [stamped(topic, "insdvl_msgs/msg/NavSolution", motion.time_ns, NED, columns)], {}
    )
    return path


def write_tum(path: Path, told: Told, east_north_up: bool = True) -> Path:
    """Write a TUM file: east-north-up as evo has it, or north-east-down and forward-starboard-down."""
    ways, attitude = told.moved_n, told.attitude
    if east_north_up:
        ways, attitude = ENU_OF_NED.apply(ways), ENU_OF_NED * attitude * FLU_OF_FRD
    rows = np.hstack([ways, attitude.as_quat()])
    stamps = (f"{time // 10**9}.{time % 10**9:09d}" for time in told.time_ns.tolist())
    lines = (
        f"{stamp} {' '.join(f'{number:.12g}' for number in row)}\n"
        for stamp, row in zip(stamps, rows, strict=True)
    )
    path.write_text("# time x y z qx qy qz qw\n" + "".join(lines))
    return path
