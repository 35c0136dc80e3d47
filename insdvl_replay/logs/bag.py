"""A bag: a folder in which a recorder that split its recording left several MCAP files, read as one log."""

import hashlib
import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from insdvl_replay.columns import TimeNs
from insdvl_replay.errors import LogError, Note
from insdvl_replay.logs.chunks import Block
from insdvl_replay.logs.container import Log

METADATA: Final = "metadata.yaml"
"""File in which rosbag2 lists the parts of a bag."""

_PART_LIST: Final = re.compile(r"^\s*relative_file_paths:\s*\n((?:\s*-\s*\S.*\n?)+)", re.MULTILINE)
_CHANNELS_OF_A_PART: Final = 1 << 16
"""A channel id has 16 bits."""


class Bag:
    """The files of a bag, open for reading.

    Parameters
    ----------
    path : Path
        The folder.
    allow_damaged : bool
        Read what can be believed of damaged files.

    Attributes
    ----------
    path : Path
    parts : tuple of Log
        Its files in their order.
    channels : tuple of LogChannel
        Of all parts; their ids count on from part to part, so that none occurs twice.

    Raises
    ------
    LogError
        The folder has no parts, one that is listed is not there, or one cannot be read.
    """

    def __init__(self, path: Path, *, allow_damaged: bool = False) -> None:
        self.path = path
        self.parts = tuple(Log(part, allow_damaged=allow_damaged) for part in bag_parts(path))
        self.channels = tuple(
            replace(channel, id=channel.id + number * _CHANNELS_OF_A_PART)
            for number, part in enumerate(self.parts)
            for channel in part.channels
        )

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong or was passed over so far."""
        return tuple(note for part in self.parts for note in part.notes)

    def log_times(self) -> dict[int, TimeNs]:
        """Give the log times of all messages, as `Log.log_times`.

        Returns
        -------
        dict of int to ndarray, shape (k,)
            By channel; ns.
        """
        return {
            channel_id + number * _CHANNELS_OF_A_PART: times
            for number, part in enumerate(self.parts)
            for channel_id, times in part.log_times().items()
        }

    def sha256(self) -> str:
        """Give the digest of the parts' digests, in their order."""
        return hashlib.sha256("".join(part.sha256() for part in self.parts).encode()).hexdigest()

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, part by part.

        Parameters
        ----------
        channel_ids : collection of int

        Yields
        ------
        Block

        Raises
        ------
        LogError
            A part is damaged.
        """
        for number, part in enumerate(self.parts):
            first = number * _CHANNELS_OF_A_PART
            inside = {id_ - first for id_ in channel_ids if 0 <= id_ - first < _CHANNELS_OF_A_PART}
            for block in part.blocks(inside):
                yield replace(block, channel_id=block.channel_id + first)


Recording = Log | Bag
"""What can be read."""


def open_recording(path: Path, *, allow_damaged: bool = False) -> Recording:
    """Open a log or a bag.

    Parameters
    ----------
    path : Path
        An MCAP file, or a folder of them.
    allow_damaged : bool
        Read what can be believed of damaged files.

    Returns
    -------
    Log or Bag

    Raises
    ------
    LogError
        It cannot be read.
    """
    kind = Bag if path.is_dir() else Log
    return kind(path, allow_damaged=allow_damaged)


def bag_parts(path: Path) -> tuple[Path, ...]:
    """Find the files of a bag in their order.

    Parameters
    ----------
    path : Path
        A folder.

    Returns
    -------
    tuple of Path
        As the metadata lists them, else by name.

    Raises
    ------
    LogError
        There are none, one that is listed is not there, or one that is there is not listed.
    """
    listed = _listed(path / METADATA)
    if listed is None:
        parts = tuple(sorted(path.glob("*.mcap"), key=_by_number))
    else:
        parts = tuple(path / name for name in listed)
        for part in parts:
            if not part.is_file():
                raise LogError(
                    f"{path / METADATA}: lists {part.name}, which is not there",
                    f"copy the whole bag, or remove {METADATA} to read the parts that are there",
                )
        for other in sorted(set(path.glob("*.mcap")) - set(parts)):
            raise LogError(
                f"{path / METADATA}: does not list {other.name}, which lies beside the parts of the bag",
                f"move it away, or remove {METADATA} to read all .mcap files of the folder",
            )
    if not parts:
        raise LogError(f"{path}: is a folder without .mcap files", "name a log, or a folder with the parts of one")
    return parts


def _by_number(part: Path) -> list[tuple[str, int]]:
    """Sort names as people count: part 2 before part 10."""
    return [(word, int(digits or 0)) for word, digits in re.findall(r"(\D*)(\d*)", part.name)]


def _listed(metadata: Path) -> list[str] | None:
    if not metadata.is_file():
        return None
    match = _PART_LIST.search(metadata.read_text("utf-8", "replace"))
    if match is None:
        raise LogError(f"{metadata}: lists no files", f"remove {METADATA} to read all .mcap files beside it")
    return [line.strip().removeprefix("-").strip().strip("'\"") for line in match[1].splitlines() if line.strip()]
