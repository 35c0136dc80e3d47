"""Several files read as one log: the parts of a bag, or what recorders wrote of one dive."""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Final

from insdvl_replay.core.columns import TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.attachments import Digest
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.damage import COPY_AGAIN, damaged_file_error
from insdvl_replay.logs.container.mapped_file import UnusableFileError
from insdvl_replay.logs.container.mcap_file import Log

CHANNELS_OF_A_PART: Final = 1 << 16
"""A channel id has 16 bits."""


class Parts:
    """Several files, open for reading as one log.

    Parameters
    ----------
    path : Path
        What stands for the whole: the folder, or one of the files.
    files : iterable of Path
        In any order; what was recorded first is read first.
    allow_damaged : bool
        Read what can be believed of damaged files, and do without those that are empty or not MCAP at all.

    Attributes
    ----------
    parts : tuple of Log
        In the order of their first log times.
    channels : tuple of LogChannel
        Of all parts; their ids count on from part to part, so that none occurs twice.

    Raises
    ------
    LogError
        A file cannot be read, or none has anything in it.
    """

    def __init__(self, path: Path, files: Iterable[Path], *, allow_damaged: bool = False) -> None:
        self.path = path
        self.allow_damaged = allow_damaged
        self._unusable: dict[Path, UnusableFileError] = {}
        self.parts = tuple(sorted(self._opened(files), key=_start))
        if not self.parts:
            raise next(iter(self._unusable.values()))
        self.channels = tuple(
            replace(channel, id=channel.id + number * CHANNELS_OF_A_PART)
            for number, part in enumerate(self.parts)
            for channel in part.channels
        )
        self._raise_if_damaged()

    def _opened(self, files: Iterable[Path]) -> Iterator[Log]:
        for file in sorted(files):
            try:
                # One file must not be refused before it is known what could be saved of all.
                yield Log(file, allow_damaged=True)
            except UnusableFileError as error:
                self._unusable[file] = error

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong or was passed over so far."""
        inside = (note for part in self.parts for note in part.notes)
        return (*self._joined_notes(), *inside, *self._unusable_notes(), *self._overlap_notes())

    def _joined_notes(self) -> Iterator[Note]:
        if len(self.parts) > 1:
            names = ", ".join(part.path.name for part in self.parts)
            yield Note("joined_files", f"read as one dive: {names}", len(self.parts))

    def _unusable_notes(self) -> Iterator[Note]:
        for error in self._unusable.values():
            text = f"{error.message}; an unknown number of messages (an unknown time) are lost; nothing of it is left"
            yield Note("log_damaged", text, 1, Severity.WARNING, COPY_AGAIN)

    def _overlap_notes(self) -> Iterator[Note]:
        spans = [part.span_ns for part in self.parts if part.span_ns]
        reached = accumulate((last for _, last in spans), max)
        overlaps = [(end - start) * 1e-9 for end, (start, _) in zip(reached, spans[1:], strict=False) if end >= start]
        if overlaps:
            text = f"{len(overlaps)} files begin before those before them end, by up to {max(overlaps):.3f} s"
            yield Note("files_overlap", text, len(overlaps))

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages, as `Log.log_times`.

        Returns
        -------
        dict of int to ndarray, shape (k,)
            By channel; ns.
        """
        times = {
            channel_id + number * CHANNELS_OF_A_PART: times
            for number, part in enumerate(self.parts)
            for channel_id, times in part.log_times().items()
        }
        self._raise_if_damaged()
        return times

    def digests(self) -> list[Digest]:
        """Go over all bytes of the parts in their order, then of the files that cannot be used, as `Log.digests`."""
        of_parts = [digest for part in self.parts for digest in part.digests()]
        return of_parts + [Digest(_sha256(file), []) for file in self._unusable]

    def sha256(self, digests: Sequence[Digest] | None = None) -> str:
        """Return the digest of all digests, and note wrong checksums, as `Log.sha256`."""
        digests = digests or self.digests()
        for part, digest in zip(self.parts, digests, strict=False):
            part.sha256([digest])
        self._raise_if_damaged()
        return hashlib.sha256("".join(digest.sha256 for digest in digests).encode()).hexdigest()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the parts if one has changed by the end, as `Log.watched`."""
        with ExitStack() as all_parts:
            for part in self.parts:
                all_parts.enter_context(part.watched())
            yield

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, part by part."""
        for number, part in enumerate(self.parts):
            first = number * CHANNELS_OF_A_PART
            inside = {id_ - first for id_ in channel_ids if 0 <= id_ - first < CHANNELS_OF_A_PART}
            for block in part.blocks(inside):
                self._raise_if_damaged()
                yield replace(block, channel_id=block.channel_id + first)
        self._raise_if_damaged()

    def check_unopened(self) -> None:
        """Check the chunks that nobody needed, as `Log.check_unopened`."""
        for part in self.parts:
            part.check_unopened()
        self._raise_if_damaged()

    def damage_error(self) -> LogError | None:
        """Return the error with which the files would be refused, by the damage found so far."""
        faults = [*(fault for part in self.parts for fault in part.faults()), *self._unusable.values()]
        saved = (times for part in self.parts for times in part.saved_times())
        return damaged_file_error(faults, saved) if faults else None

    def _raise_if_damaged(self) -> None:
        if not self.allow_damaged and (error := self.damage_error()) is not None:
            raise error


def _sha256(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise LogError(f"cannot be read any more: {error.strerror}", "read a copy of the recording", file) from error


def _start(part: Log) -> tuple[float, str]:
    """Sort files without messages behind all others, and those that begin together by their names."""
    return (part.span_ns[0] if part.span_ns else float("inf"), part.path.name)
