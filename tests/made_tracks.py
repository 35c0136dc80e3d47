"""Trajectories of a few dives whose errors are known, as TUM files and as topics of logs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbag_messages import header, write_log, xyz

from insdvl_replay.core.dive_columns import Floats

START_S: Final = 1_700_000_000
RATE_HZ: Final = 2
DAY_S: Final = 86_400


def truth_m(number: int, count: int = 400) -> Floats:
    """Return the track of a dive, east, north, up, shape (k, 3)."""
    time_s = np.arange(count) / RATE_HZ
    east = 1.2 * time_s + 5.0 * np.sin(0.05 * time_s + number)
    north = 30.0 * np.sin(time_s / (30.0 + number)) - 10.0 * number
    return np.column_stack([east, north, -10.0 + np.sin(0.02 * time_s)])


def error_m(number: int, count: int = 400) -> Floats:
    """Return an error that grows and that no other dive has, shape (k, 3)."""
    rng = np.random.default_rng(number)
    steps = rng.normal(0.0, 0.03, (count, 3)) * [1.0, 1.0, 0.2]
    return np.asarray(np.cumsum(steps, axis=0))


def write_tum(
    path: Path,
    track_m: Floats,
    number: int = 0,
    *,
    late_s: float = 0.0,
    yaw: Floats | float = 0.3,
    rows: Sequence[int] | slice = slice(None),
) -> Path:
    """Write a track of a dive, which is of a day of its own."""
    path.parent.mkdir(parents=True, exist_ok=True)
    count = len(track_m)
    since_s = np.arange(count) / RATE_HZ + late_s + DAY_S * number
    half = 0.5 * np.broadcast_to(yaw, count)
    lines = list[str]()
    for row in np.arange(count)[rows]:
        numbers = [*track_m[row], 0.0, 0.0, np.sin(half[row]), np.cos(half[row])]
        time_s = f"{START_S + int(since_s[row])}.{round(since_s[row] % 1.0 * 1e9):09d}"
        lines.append(" ".join([time_s, *(f"{value:.9f}" for value in numbers)]))
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def write_dives(folder: Path, dives: int = 4, ratio: float = 0.5) -> None:
    """Write the folders old, new and truth: errors of new are those of old, and as much smaller."""
    for number in range(dives):
        name = f"dive_{number}.tum"
        track = truth_m(number)
        error = error_m(number)
        scatter = 1.0 + 0.05 * (-1.0) ** number
        write_tum(folder / "truth" / name, track, number)
        write_tum(folder / "old" / name, track + error, number)
        write_tum(folder / "new" / name, track + ratio * scatter * error, number)


def write_odometry(path: Path, number: int, *, with_covariance: bool = True) -> Path:
    """Write three topics: the odometry of two filters, and of the reference."""
    path.parent.mkdir(parents=True, exist_ok=True)
    track = truth_m(number)
    variance = np.eye(6).ravel() * 0.04 if with_covariance else np.zeros(36)
    messages = list[Any]()
    for topic, ratio in (("/odom_old", 1.0), ("/odom_new", 0.5), ("/truth", 0.0)):
        moved = track + ratio * error_m(number)
        for row, position in enumerate(moved):
            time_s = row / RATE_HZ
            pose = {
                "position": xyz(position),
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.1, "w": 0.99498744},
            }
            message = {
                "header": header(time_s),
                "pose": {"pose": pose, "covariance": variance},
                "twist": {"twist": {"linear": xyz([1.0, 0.0, 0.0])}, "covariance": np.zeros(36)},
            }
            messages.append((topic, "nav_msgs/msg/Odometry", time_s, message))
    return write_log(path, messages)
