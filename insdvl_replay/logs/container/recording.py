"""What can be read: a log, several files that are one dive, or a bag, the folder of a recorder that split its file."""

import hashlib
import os
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, TypeVar

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import LogError, Note, is_writable, read_text, visible
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.log_file import LogFile
from insdvl_replay.logs.container.loss import COPY_AGAIN, damaged_file_error
from insdvl_replay.logs.container.mapped_file import Digest, UnusableFileError
from insdvl_replay.logs.container.opening import open_log_file

CHANNELS_OF_A_PART: Final = 1 << 16
"""A channel id has 16 bits."""


Step = TypeVar("Step")


class Recording:
    """One or several files, open for reading as one log.

    A path stands for the whole: the folder of a bag, or one of the files. A damaged file is refused with the place and
    what could be saved. Where damage is allowed, it is read as far as its bytes can be believed, and files of
    which nothing can be used are done without.

    Attributes
    ----------
    parts : tuple of LogFile
        In the order of their first log times.
    channels : tuple of LogChannel
        Of all parts; their ids count on from part to part, so that none occurs twice.
    """

    def __init__(self, path: Path, files: Collection[Path], *, allow_damaged: bool = False) -> None:
        self.path = path
        self.allow_damaged = allow_damaged
        self._unusable: dict[Path, UnusableFileError] = {}
        opened = list(self._opened(files))
        if not opened:
            raise next(iter(self._unusable.values()))
        self.parts = tuple(sorted(opened, key=_start) if len(opened) > 1 else opened)
        self._is_one_file = len(files) == 1 and self.parts[0].path == path
        self.channels = tuple(
            replace(channel, id=channel.id + number * CHANNELS_OF_A_PART)
            for number, part in enumerate(self.parts)
            for channel in part.channels
        )
        self._raise_if_damaged()

    def _opened(self, files: Iterable[Path]) -> Iterator[LogFile]:
        for file in sorted(files):
            try:
                # One file must not be refused before it is known what could be saved of all.
                yield open_log_file(file)
            except UnusableFileError as error:
                self._unusable[file] = error

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong or was passed over so far."""
        inside = [note for part in self.parts for note in part.notes]
        if len(self.parts) == 1:
            return (*inside, *self._unusable_notes())
        names = ", ".join(part.path.name for part in self.parts)
        joined = Note("joined_files", f"read as one dive: {names}", len(self.parts))
        return (joined, *inside, *self._unusable_notes(), *self._overlap_notes())

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
        """Return the log times of all messages by channel, shape (k,), ns, as `LogFile.log_times`."""
        times = {
            channel_id + number * CHANNELS_OF_A_PART: times
            for number, part in enumerate(self.parts)
            for channel_id, times in part.log_times().items()
        }
        self._raise_if_damaged()
        return times

    def digests(self) -> list[Digest]:
        """Go over all bytes of the parts in their order, then of the files that cannot be used.

        It changes nothing here, so that another thread can do it meanwhile.
        """
        return [part.digest() for part in self.parts] + [Digest(_sha256(file), []) for file in self._unusable]

    def sha256(self, digests: Sequence[Digest] | None = None) -> str:
        """Return the digest of the file, or of the digests of all files, and note wrong checksums."""
        digests = digests or self.digests()
        for part, digest in zip(self.parts, digests, strict=False):
            part.add_damages(digest)
        self._raise_if_damaged()
        if self._is_one_file:
            return digests[0].sha256
        return hashlib.sha256("".join(digest.sha256 for digest in digests).encode()).hexdigest()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the files if one has changed by the end since it was opened."""
        with ExitStack() as all_parts:
            for part in self.parts:
                all_parts.enter_context(part.watched())
            yield

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, part by part, a chunk at a time."""
        for number, part in enumerate(self.parts):
            first = number * CHANNELS_OF_A_PART
            inside = {id_ - first for id_ in channel_ids if 0 <= id_ - first < CHANNELS_OF_A_PART}
            for block in self._while_sound(part.blocks(inside)):
                yield replace(block, channel_id=block.channel_id + first) if first else block

    def check_unopened(self) -> None:
        """Check the chunks that nobody needed."""
        for part in self.parts:
            for _ in self._while_sound(part.check_unopened()):
                pass

    def _while_sound(self, steps: Iterator[Step]) -> Iterator[Step]:
        """Go on step by step until damage is found that is not allowed."""
        for step in steps:
            self._raise_if_damaged()
            yield step
        self._raise_if_damaged()

    def damage_error(self) -> LogError | None:
        """Return the error with which the files would be refused, by the damage found so far."""
        faults = [*(fault for part in self.parts for fault in part.faults()), *self._unusable.values()]
        saved = (times for part in self.parts for times in part.saved_times())
        return damaged_file_error(faults, saved) if faults else None

    def _raise_if_damaged(self) -> None:
        if not self.allow_damaged and (error := self.damage_error()) is not None:
            for part in self.parts:
                part.require_unchanged()
            raise error


def _sha256(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise LogError(f"cannot be read any more: {error.strerror}", "read a copy of the recording", file) from error


def _start(part: LogFile) -> tuple[float, str]:
    """Sort files without messages behind all others, and those that begin together by their names."""
    return (part.span_ns[0] if part.span_ns else float("inf"), part.path.name)


METADATA: Final = "metadata.yaml"
"""File in which rosbag2 lists the parts of a bag."""
_INFORMATION: Final = "rosbag2_bagfile_information"
_DEEPEST: Final = 50
_PACKED: Final = ".zstd"
"""Ending of parts that rosbag2 compressed as a whole."""


def bag_parts(path: Path) -> tuple[Path, ...]:
    """Find the files of a bag."""
    listed = _listed(path / METADATA)
    found = _with_suffix(path)
    if listed is None:
        parts = tuple(found)
    else:
        parts = tuple(_unpacked(path / name) for name in listed)
        _require_all(path / METADATA, parts, found)
    for packed in _with_suffix(path, _PACKED):
        if packed.with_suffix("") not in parts:
            raise LogError("is compressed as a whole with zstd", f"`zstd -d {packed}` unpacks it", packed)
    if not parts:
        what = f"is a folder without {' or '.join(LOG_SUFFIXES)} files"
        raise LogError(what, "name a log, or a folder with the parts of one", path)
    return parts


def _with_suffix(folder: Path, behind: str = "") -> list[Path]:
    """Find the logs of a folder, by their names."""
    return sorted(path for suffix in LOG_SUFFIXES for path in folder.glob(f"*{suffix}{behind}"))


def _unpacked(part: Path) -> Path:
    """Return the part that the user has unpacked, where the metadata lists it as it was packed."""
    plain = part.with_suffix("") if part.suffix == _PACKED else part
    return plain if _is_file(plain) else part


def _is_file(path: Path) -> bool:
    """Return whether a file is there; a name that cannot be one is none."""
    return os.path.isfile(path)  # noqa: PTH113  # a Path raises where the name is too long


def _require_all(metadata: Path, parts: tuple[Path, ...], found: list[Path]) -> None:
    for part in parts:
        if not _is_file(part):
            raise LogError(
                f"lists {part.name}, which is not there",
                f"copy the whole bag, or read the parts that are there: {_by_name(metadata)}",
                metadata,
            )
    for other in found:
        if other not in parts:
            raise LogError(
                f"does not list {other.name}, which lies beside the parts of the bag",
                f"move it away, or read all logs of the folder: {_by_name(metadata)}",
                metadata,
            )


def _by_name(metadata: Path) -> str:
    """State how a bag is read without its list."""
    suffix = next((path.suffix for path in _with_suffix(metadata.parent)), LOG_SUFFIXES[0])
    return f"{metadata.parent / f'*{suffix}'} --one-dive"


def _is_plain(events: Iterable[Any]) -> bool:
    """Return whether a YAML text is about as large as what it stands for: aliases multiply it."""
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    depth = 0
    for event in events:
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > _DEEPEST or isinstance(event, AliasEvent):
            return False
    return True


def _listed(metadata: Path) -> list[str] | None:
    """Read which parts the metadata names; None where there is none."""
    if not metadata.is_file():
        return None
    # Imported here, since few logs are bags and it takes a while.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    by_name = f"read the logs beside it: {_by_name(metadata)}"
    try:
        text, yaml = read_text(metadata), YAML(typ="safe", pure=True)
        if not _is_plain(yaml.parse(text)):
            raise LogError("has aliases or deep nesting, which no recorder writes", by_name, metadata)
        content: Any = yaml.load(text)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", by_name, metadata) from error
    except (YAMLError, ValueError, RecursionError) as error:  # also a day or a number that cannot be
        raise LogError("is no YAML", by_name, metadata) from error
    information = content.get(_INFORMATION) if isinstance(content, dict) else None
    information = information if isinstance(information, dict) else {}
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise LogError("lists no files", by_name, metadata)
    if str(information.get("compression_mode")).upper() == "MESSAGE":
        hint = "`ros2 bag convert` writes them as they are"
        raise LogError("says that each message is compressed for itself", hint, metadata)
    return names


def open_recording(path: Path | Sequence[Path], *, allow_damaged: bool = False) -> Recording:
    """Open a log, a bag, or several of them as one.

    Parameters
    ----------
    path : Path or sequence of Path
        A log, a folder of them, or several; their order does not matter.
    allow_damaged : bool
        Read what can be believed of damaged files.

    Raises
    ------
    LogError
        It cannot be read.
    """
    given = (path,) if isinstance(path, Path) else tuple(path)
    for one in given:
        if not is_writable(str(one)):
            raise LogError(f"{visible(str(one))}: its name is not UTF-8, so no result could bear it", "rename it")
    if len(given) == 1 and not given[0].is_dir():
        return Recording(given[0], given, allow_damaged=allow_damaged)
    files = [file for one in given for file in (bag_parts(one) if one.is_dir() else (one,))]
    # A file that is named twice is read once.
    unique = {os.path.realpath(file): file for file in files}
    return Recording(name_giver(given), unique.values(), allow_damaged=allow_damaged)


def name_giver(paths: Sequence[Path]) -> Path:
    """Find after which of several paths what they hold together is named: the first by its name."""
    return min(paths, key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[str, int]]:
    """Sort names as people count: part 2 before part 10."""
    return [(word, int(digits or 0)) for word, digits in re.findall(r"(\D*)(\d*)", path.name)]
