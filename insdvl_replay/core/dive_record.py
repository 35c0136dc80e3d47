"""A dive for the record: what it is called, and what its log holds on each topic.

Every result, table and baseline bears its dive's name, so that no two may share one. Nothing here needs numpy.
"""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.words import DelayStatus, HeadingSource

# Endings of logs. Of those that differ in nothing else the first is the one that a log was converted to.
LOG_SUFFIXES: Final = (".mcap", ".db3", ".bag")
# Endings of tables. Those of a folder without logs are one dive. HDF5 is not read, but its files are found, so that
# they are refused with what helps.
TABLE_SUFFIXES: Final = (".csv", ".tsv", ".npy", ".npz", ".parquet", ".mat", ".h5", ".hdf5")
LATE_S: Final = 0.02  # smaller delays of a reference matter to no verdict
SIGNIFICANT_SDS: Final = 3.0
LONGEST_NAME: Final = 255  # Bytes of a name that file systems keep.


@dataclass(frozen=True)
class Clock:
    """The stamps of a topic against the times at which it was recorded."""

    role: str
    topic: str
    stamp: str  # where the stamps come from, as the configuration names it
    messages: int  # how many were read to know it
    log_minus_stamp_s: float  # median, as the log has it
    spread_s: float  # from the 5th to the 95th percentile of log time minus stamp
    back_steps: int  # stamps that are before the one before in the file
    repeats: int  # stamps that equal it
    # different stamps over the time between the first and the last; None where all repeat
    rate_hz: float | None
    # that the configuration takes off the stamps, and was not taken off here
    latency_s: float = 0.0


@dataclass(frozen=True)
class Channel:
    """What a log holds on one topic."""

    topic: str
    type_name: str
    encoding: str
    role: str  # ``imu``, ``dvl``, ``reference``, ``truth``, or empty where the replay has no use for it
    messages: int


@dataclass(frozen=True)
class Delay:
    """How much later stamps are than those of the IMU, s, with the standard error."""

    delay_s: float
    sd_s: float


@dataclass(frozen=True)
class ReferenceDelay:
    """How much later a reference is than the IMU, beyond `reference.latency_s`; negative where it is early."""

    delay_s: float | None  # None where nothing is known
    sd_s: float | None  # standard error
    status: DelayStatus
    by_turns: Delay | None = None  # against the gyros
    by_accelerations: Delay | None = None  # against the accelerometers

    @property
    def is_checked(self) -> bool:
        """Whether the delay is known well enough to rely on."""
        return self.status == DelayStatus.DETERMINED

    @property
    def is_late(self) -> bool:
        """Whether the delay is large enough to matter, and surely none by chance."""
        if self.delay_s is None or self.sd_s is None:
            return False
        return abs(self.delay_s) > max(LATE_S, SIGNIFICANT_SDS * self.sd_s)


@dataclass(frozen=True)
class StartHeading:
    """What the heading at the start comes from, and how well it is known."""

    source: HeadingSource
    sd_deg: float  # as the filters are told
    # Of the second start, in whose heading only the vehicle's own sensors and `[initial]` count; None: there was none.
    drawn_sd_deg: float | None = None
    drawn_error_deg: float | None = None  # by which the heading of the second start was turned


@dataclass(frozen=True)
class ImuFingerprint:
    """Digests of single samples of an IMU, by which a copy or a part of a dive is known."""

    first_ns: int  # of the IMU's samples, on the log's clock
    last_ns: int
    # whole seconds of the log's clock, at or after which the first sample is digested
    at_s: tuple[int, ...] = ()
    digests: tuple[str, ...] = ()
    # One of so many samples is marked: which ones, its readings decide and not its time.
    one_in: int = 1
    # marked samples whose readings come only once: ms since the first sample, and their digests
    marked_ms: tuple[int, ...] = ()
    marks: tuple[str, ...] = ()


def dive_name(path: Path) -> str:
    """Name a dive after its file without the ending, or after its folder, in whose name a dot may be of a date."""
    whole = _whole(path)
    name = whole.name if whole.is_dir() else whole.stem
    # `..mcap` would bear the name of the folder that its result is in, and `...mcap` that of the one above.
    return _writable(name if name.strip(".") else whole.name.strip(".") or "dive")


def is_dive_name(name: str) -> bool:
    """Return whether a name, which anybody may have written, can be that of a dive, and so of a file below a folder."""
    separators = {"/", os.sep, os.altsep or os.sep, "\0"}
    return (
        bool(name.strip("."))
        and not separators & set(name)
        and len(os.fsencode(name)) <= LONGEST_NAME
    )


def _endings(parts: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return a name alone, then after one folder more and more."""
    return [parts[-length:] for length in range(1, len(parts) + 1)]


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Name each dive after its file, and those that would share a name after as many folders as tell them apart.

    Of ``monday/dive.mcap``, ``tuesday/dive.mcap`` and ``tuesday/test.mcap`` these are ``monday_dive``, ``tuesday_dive``
    and ``test``.

    Raises
    ------
    ConfigError
        Folders do not tell two dives apart either.
    """
    whole = [(*_whole(path).parts[1:-1], dive_name(path)) for path in paths]
    times: Counter[tuple[str, ...]] = Counter()  # of each ending of a path, by the dives
    for parts in whole:
        times.update(_endings(parts))
    names = []
    for parts in whole:
        alone = [ending for ending in _endings(parts) if times[ending] == 1]
        shortest = alone[0] if alone else parts
        names.append(_writable("_".join(shortest)))
    for name, count in Counter(names).items():
        if count > 1:
            both = " and ".join(
                str(path) for path, other in zip(paths, names, strict=True) if other == name
            )
            raise ConfigError(f"{both} would share the name {name}", "rename one of them")
    return names


def _writable(name: str) -> str:
    """Escape what is not UTF-8 in a name, so that it can be said that its dive cannot be used."""
    return name.encode("utf-8", "backslashreplace").decode()


def _whole(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  # resolves `..`, which is no name
