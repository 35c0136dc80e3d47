"""The trajectories of a replay on disk, each in a file of its own, in the TUM format, which evo reads.

One line for each time: ``timestamp tx ty tz qx qy qz qw``, seconds and metres, with single spaces.
Source: J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", 2012, and its file formats.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from insdvl_replay.core.columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.geometry.frames import east_north_up_m, quat_enu_flu
from insdvl_replay.replay import Replay
from insdvl_replay.results.folder import REFERENCE_TRAJECTORY, trajectory_file


def save_trajectories(replay: Replay, folder: Path) -> None:
    """Write the trajectory of each filter, and of the reference inside the replay, if its positions are known.

    All count from where the baseline starts, and all are of the IMU.

    Parameters
    ----------
    folder : Path
        Exists; its other files are left alone.
    """
    origin = replay.histories[0].position[0]
    for history in replay.histories:
        text = tum_trajectory(history.time_ns, history.position, history.mat_nb, origin)
        (folder / trajectory_file(history.filter)).write_bytes(text)
    reference = replay.dive.reference
    if reference is None:
        return
    inside = (reference.time_ns >= replay.start_ns) & (reference.time_ns <= replay.end_ns)
    text = tum_trajectory(reference.time_ns[inside], reference.position[inside], reference.mat_nb[inside], origin)
    if text:
        (folder / REFERENCE_TRAJECTORY).write_bytes(text)


def tum_trajectory(time_ns: TimeNs, position: Floats, mat_nb: Floats, origin: Floats) -> bytes:
    """Write a trajectory.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    mat_nb : ndarray, shape (k, 3, 3)
        NaN where no attitude is known.
    origin : ndarray, shape (3,)
        Position from which east, north and up are counted.

    Returns
    -------
    bytes
        Times as they are, to the nanosecond; forward-port-up to east-north-up. The format knows no missing positions:
        times without one have no line. A missing attitude is NaN, which evo takes where it compares positions.
    """
    known = np.isfinite(position).all(axis=1)
    columns = np.hstack([east_north_up_m(position[known], origin), quat_enu_flu(mat_nb[known])])
    return "".join(_lines(time_ns[known].tolist(), columns.tolist())).encode()


def _lines(times_ns: Iterable[int], rows: Iterable[Iterable[float]]) -> Iterable[str]:
    for time_ns, row in zip(times_ns, rows, strict=True):
        second, nanosecond = divmod(time_ns, NS_PER_S)
        yield f"{second}.{nanosecond:09d} {' '.join(f'{number:.9g}' for number in row)}\n"
