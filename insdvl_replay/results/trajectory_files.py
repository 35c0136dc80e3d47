"""The trajectories of a replay on disk, each in a file of its own, for evo."""

from pathlib import Path

from insdvl_replay.replay import Replay
from insdvl_replay.results.folder import REFERENCE_TRAJECTORY, trajectory_file
from insdvl_replay.results.tum_text import tum_trajectory


def save_trajectories(replay: Replay, folder: Path) -> None:
    """Write the trajectory of each filter, and of the reference inside the replay, if its positions are known.

    All count from where the baseline starts, and all are of the IMU.

    Parameters
    ----------
    replay : Replay
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
