"""What can be read: a log, a bag, or several files that are one dive."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from insdvl_replay.logs.container.bag import bag_parts
from insdvl_replay.logs.container.mcap_file import Log
from insdvl_replay.logs.container.parts import Parts

Recording = Log | Parts
"""What can be read."""


def open_recording(path: Path | Sequence[Path], *, allow_damaged: bool = False) -> Recording:
    """Open a log, a bag, or several of them as one.

    Parameters
    ----------
    path : Path or sequence of Path
        An MCAP file, a folder of them, or several; their order does not matter.
    allow_damaged : bool
        Read what can be believed of damaged files.

    Returns
    -------
    Log or Parts

    Raises
    ------
    LogError
        It cannot be read.
    """
    given = (path,) if isinstance(path, Path) else tuple(path)
    if len(given) == 1 and not given[0].is_dir():
        return Log(given[0], allow_damaged=allow_damaged)
    files = [file for one in given for file in (bag_parts(one) if one.is_dir() else (one,))]
    # A file that is named twice is read once.
    unique = {os.path.realpath(file): file for file in files}
    return Parts(name_giver(given), unique.values(), allow_damaged=allow_damaged)


def name_giver(paths: Sequence[Path]) -> Path:
    """Tell after which of several paths what they hold together is named: the first by its name.

    Parameters
    ----------
    paths : sequence of Path
        At least one, in any order.

    Returns
    -------
    Path
    """
    return min(paths, key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[str, int]]:
    """Sort names as people count: part 2 before part 10.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of (str, int)
        To be compared.
    """
    return [(word, int(digits or 0)) for word, digits in re.findall(r"(\D*)(\d*)", path.name)]
