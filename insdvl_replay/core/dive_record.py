"""A dive for the record: what it is called, and what its log holds on each topic.

Every result, table and baseline bears its dive's name, so that no two may share one. Whoever reads a stored report must
not wait for numpy, which is not needed here.
"""

import os
from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from insdvl_replay.core.errors import ConfigError


@dataclass(frozen=True)
class Clock:
    """The stamps of a topic against the times at which it was recorded.

    Attributes
    ----------
    stamp : str
        Where the stamps come from, as the configuration names it.
    messages : int
        How many were read to know it.
    log_minus_stamp_s : float
        Median, as the log has it.
    spread_s : float
        From the 5th to the 95th percentile of log time minus stamp.
    back_steps, repeats : int
        Stamps that lie before, or at, the one before in the file.
    rate_hz : float or None
        By the stamps: those that differ, over the time between the first and the last; None where all repeat.
    latency_s : float
        What the configuration takes off the stamps, and was not taken off here.
    """

    role: str
    topic: str
    stamp: str
    messages: int
    log_minus_stamp_s: float
    spread_s: float
    back_steps: int
    repeats: int
    rate_hz: float | None
    latency_s: float = 0.0


@dataclass(frozen=True)
class Channel:
    """What a log holds on one topic, for the record.

    Attributes
    ----------
    topic, type_name, encoding : str
        As the log names them.
    role : str
        ``imu``, ``dvl``, ``reference``, ``truth``, or empty where the replay has no use for it.
    messages : int
        How many messages the log holds.
    """

    topic: str
    type_name: str
    encoding: str
    role: str
    messages: int


LOG_SUFFIXES: Final = (".mcap", ".db3", ".bag")
"""Endings of logs. Of those that differ in nothing else the first is the one that a log was converted to."""
NAMELESS: Final = "dive"
"""What a dive is called whose file has no name but dots."""
LONGEST_NAME: Final = 255
"""Bytes of a name that file systems keep."""


def dive_name(path: Path) -> str:
    """Name a dive after its file without the ending, or after its folder, in whose name a dot may be of a date."""
    whole = _whole(path)
    name = whole.name if whole.is_dir() else whole.stem
    # `..mcap` would bear the name of the folder that its result lies in, and `...mcap` that of the one above.
    return _writable(name if name.strip(".") else whole.name.strip(".") or NAMELESS)


def _writable(name: str) -> str:
    """Escape what is not UTF-8 in a name, so that it can be said that its dive cannot be used."""
    return name.encode("utf-8", "backslashreplace").decode()


def is_dive_name(name: str) -> bool:
    """Return whether a name, which anybody may have written, can be that of a dive, and so of a file below a folder."""
    separators = {"/", os.sep, os.altsep or os.sep, "\0"}
    return bool(name.strip(".")) and not separators & set(name) and len(os.fsencode(name)) <= LONGEST_NAME


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Name each dive after its file, and those that would share a name after as many folders as tell them apart.

    Of ``monday/dive.mcap``, ``tuesday/dive.mcap`` and ``tuesday/test.mcap`` these are ``monday_dive``, ``tuesday_dive``
    and ``test``. A ConfigError names two dives that folders do not tell apart either.
    """
    whole = [(*_whole(path).parts[1:-1], dive_name(path)) for path in paths]
    lengths = [1] * len(paths)
    while again := _repeated([parts[-length:] for parts, length in zip(whole, lengths, strict=True)]):
        if all(lengths[place] >= len(whole[place]) for place in again):
            break
        for place in again:
            lengths[place] += 1
    names = [_writable("_".join(parts[-length:])) for parts, length in zip(whole, lengths, strict=True)]
    if again := _repeated(names):
        both = " and ".join(str(paths[place]) for place in again if names[place] == names[again[0]])
        raise ConfigError(f"{both} would share the name {names[again[0]]}", "rename one of them")
    return names


def _whole(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  # resolves `..`, which is no name


def _repeated(names: Sequence[Hashable]) -> list[int]:
    """Return the places of names that there are twice."""
    times = Counter(names)
    return [place for place, name in enumerate(names) if times[name] > 1]
