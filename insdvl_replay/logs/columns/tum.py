"""The poses in the text of a TUM file, with times that are exact to the nanosecond."""

from decimal import Decimal
from pathlib import Path
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.errors import LogError

TUM_FORMAT: Final = "time x y z qx qy qz qw: seconds on the log's clock, m, and the attitude"
_COLUMNS: Final = 8
_LATEST_NS: Final = 2**63
_LATEST_S: Final = Decimal(2**63) / NS_PER_S


def tum_poses(path: Path, text: str) -> tuple[TimeNs, Floats]:
    """Return the times of the poses in a text, (k,) ns, and their numbers, (k, 7), in the order of the lines.

    A LogError names the first line that is no pose.
    """
    times = []
    poses = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            time_s = Decimal(words[0])
            pose = [float(word) for word in words[1:]]
            if len(words) != _COLUMNS or not abs(time_s) < _LATEST_NS:
                raise ValueError
        except (ArithmeticError, ValueError) as error:
            # Of what is in it nothing is shown: it may be any file.
            what = f"line {number} is no pose: it needs {_COLUMNS} numbers"
            raise LogError(what, TUM_FORMAT, path) from error
        if abs(time_s) >= _LATEST_S:
            what = f"line {number} has the time {time_s:.3g}, which is no number of seconds"
            hint = "divide the times by 1e9 if they are nanoseconds, by 1e6 if microseconds"
            raise LogError(what, hint, path)
        times.append(round(time_s * NS_PER_S))
        poses.append(pose)
    if not poses:
        raise LogError("has no line with a pose", TUM_FORMAT, path)
    return np.array(times, np.int64), np.array(poses, np.float64)
