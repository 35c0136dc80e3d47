"""What can be read: a log, several files that are one dive, or a bag, the folder of a recorder that split its file."""

import hashlib
import os
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.dive_record import LOG_SUFFIXES, TABLE_SUFFIXES
from insdvl_replay.core.errors import (
    LogError,
    Note,
    counted,
    counted_clause,
    is_writable,
    read_text,
    visible,
)
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.formats.fields import TABLE
from insdvl_replay.logs.formats.log_file import (
    COPY_AGAIN,
    Block,
    Digest,
    FileBytes,
    LogFile,
    UnusableFileError,
    damaged_file_error,
)
from insdvl_replay.logs.formats.mcap_file import MAGIC, McapFile
from insdvl_replay.logs.formats.recorder_clock import OneClock, one_clock, spans_a_step

_COMMON_CLOCK_NS: Final = 10**17  # times after 1973 are those of a clock that counts from 1970
CHANNELS_OF_A_PART: Final = 1 << 16  # a channel id has 16 bits
Step = TypeVar("Step")


def open_log_file(path: Path) -> LogFile:
    """Open a file. Its first bytes determine the format, not its name."""
    file = FileBytes(path)
    start = bytes(file.read(0, 16))
    if start == b"SQLite format 3\0":
        from insdvl_replay.logs.formats.sqlite_bag import SqliteFile

        return SqliteFile(file)
    if start.startswith(b"#ROSBAG V2.0\n"):
        from insdvl_replay.logs.formats.ros1_bag import BagFile

        return BagFile(file)
    if start.startswith(MAGIC):
        return McapFile(file)
    other = other_format(path, start)
    is_other = other is not None and other.any_name
    if path.suffix.lower() in TABLE_SUFFIXES and not is_other:
        from insdvl_replay.logs.formats.table_file import TableFile

        return TableFile(file)
    if other is not None:
        raise LogError(f"is {other.name}, which is not read", other.step.format(path=path), path)
    if len(file) < len(MAGIC):
        text = f"has only {counted(len(file), 'byte')}, too few for a log"
        raise UnusableFileError(text, "the recording never began, or the copy failed", path)
    return McapFile(file)


class Recording:
    """One or several files, open for reading as one log.

    A damaged file is refused with the place and what could be saved. Where damage is allowed, it is read as far as its
    bytes can be used, and files of which nothing can be used are done without.
    """

    def __init__(self, path: Path, files: Collection[Path], *, allow_damaged: bool = False) -> None:
        self.path = path  # stands for the whole: the folder of a bag, or one of the files
        self.allow_damaged = allow_damaged
        self._unusable: dict[Path, UnusableFileError] = {}
        opened: list[LogFile] = []
        for file in sorted(files):
            try:
                # One file must not be refused before it is known what could be saved of all.
                opened.append(open_log_file(file))
            except UnusableFileError as error:
                self._unusable[file] = error
        if not opened:
            raise next(iter(self._unusable.values()))
        if any(channel.time_column for part in opened for channel in part.channels):
            _align_times_of_day(opened)
        if len(opened) > 1:  # by their first log times, files without messages last
            opened.sort(
                key=lambda part: (part.span_ns[0] if part.span_ns else float("inf"), part.path.name)
            )
        self.parts = tuple(opened)
        self._is_one_file = len(files) == 1 and self.parts[0].path == path
        self.channels = (
            tuple(  # of all parts; their ids count on from part to part, so that none occurs twice
                replace(channel, id=channel.id + number * CHANNELS_OF_A_PART)
                for number, part in enumerate(self.parts)
                for channel in part.channels
            )
        )
        self._raise_if_damaged()

    @property
    def notes(self) -> tuple[Note, ...]:
        """Notes on damage found so far, and on files that were read as one."""
        notes = [note for part in self.parts for note in part.notes]
        for error in self._unusable.values():
            text = f"{error.message}; the whole file is lost (unknown number of messages, unknown time)"
            notes.append(Note("log_damaged", text, 1, Severity.WARNING, COPY_AGAIN))
        if self.one_clock is not None:
            notes.append(self.one_clock.note)
        if len(self.parts) > 1:
            names = ", ".join(part.path.name for part in self.parts)
            notes.insert(0, Note("joined_files", f"read as one dive: {names}", len(self.parts)))
            logs = [
                part
                for part in self.parts
                if not all(channel.encoding == TABLE for channel in part.channels)
            ]
            at_0 = [
                part.path.name
                for part in self.parts
                if part not in logs and part.span_ns and not part.span_ns[0]
            ]
            if len(at_0) > 1:
                text = f"tables that begin at 0 s may have no common clock: {', '.join(at_0)}"
                hint = "to shift one: dvl.latency_s or reference.latency_s"
                notes.append(Note("tables_from_0", text, len(at_0), hint=hint))
            spans = [part.span_ns for part in logs if part.span_ns]
            reached = accumulate((last for _, last in spans), max)
            following = zip(reached, spans[1:], strict=False)
            overlaps = [(end - start) * 1e-9 for end, (start, _) in following if end >= start]
            if overlaps:
                clause = f"files overlap with the file before, by up to {max(overlaps):.3f} s"
                text = counted_clause(len(overlaps), clause)
                notes.append(Note("files_overlap", text, len(overlaps)))
        return tuple(notes)

    @cached_property
    def one_clock(self) -> OneClock | None:
        """The part of a recording with one clock that is used; None where its clock was not set."""
        logs = [
            part
            for part in self.parts
            if not all(channel.encoding == TABLE for channel in part.channels)
        ]
        spans = [part.span_ns for part in logs if part.span_ns]
        if not spans or not spans_a_step(
            min(first for first, _ in spans), max(last for _, last in spans)
        ):
            return None
        return one_clock([times for part in logs for times in part.log_times().values()])

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns."""
        times = {
            channel_id + number * CHANNELS_OF_A_PART: times
            for number, part in enumerate(self.parts)
            for channel_id, times in part.log_times().items()
        }
        self._raise_if_damaged()
        return times

    def digests(self) -> list[Digest]:
        """Go over all bytes of the parts in their order, then of the files that cannot be used.

        It changes nothing here, so that another thread can do it.
        """
        unusable = [
            Digest(hashlib.sha256(file.read_bytes()).hexdigest(), []) for file in self._unusable
        ]
        return [part.digest() for part in self.parts] + unusable

    def sha256(self, digests: Sequence[Digest] | None = None) -> str:
        """Return the digest of the file, or of the digests of all files, and note wrong checksums."""
        digests = digests or self.digests()
        for part, digest in zip(self.parts, digests, strict=False):
            part.damages.update(dict.fromkeys(digest.damages))
        self._raise_if_damaged()
        if self._is_one_file:
            return digests[0].sha256
        return hashlib.sha256("".join(digest.sha256 for digest in digests).encode()).hexdigest()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the files if one has changed since it was opened."""
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
        faults = [
            *(fault for part in self.parts for fault in part.faults()),
            *self._unusable.values(),
        ]
        saved = (times for part in self.parts for times in part.saved_times())
        if faults:
            return damaged_file_error(faults, saved)
        return None

    def _raise_if_damaged(self) -> None:
        if not self.allow_damaged and (error := self.damage_error()) is not None:
            for part in self.parts:
                part.file.require_unchanged()
            raise error


def _align_times_of_day(parts: Sequence[LogFile]) -> None:
    """Shift tables without date or hour so that they overlap the others the most: those with a date, else the first."""
    from insdvl_replay.logs.formats.table_file import TableFile
    from insdvl_replay.logs.formats.table_times import Bounds, joined_bounds, shift_ns

    fixed: list[Bounds] = []
    open_ones: list[tuple[int, TableFile, int, Bounds]] = []
    for part in parts:
        if not isinstance(part, TableFile):
            fixed += [part.span_ns] if part.span_ns else []
            continue
        for channel_id, times in part.log_times().items():
            channel = part.channels[channel_id]
            if not times.size or not channel.time_column:
                continue
            bounds = int(times.min()), int(times.max())
            if channel_id in part.periods_ns:
                open_ones.append((part.periods_ns[channel_id], part, channel_id, bounds))
            elif bounds[0] > _COMMON_CLOCK_NS:
                fixed.append(bounds)
    # Those that lack the date alone are shifted before those that lack the hour.
    for period_ns, part, channel_id, bounds in sorted(open_ones, key=lambda found: -found[0]):
        shift = shift_ns(bounds, period_ns, joined_bounds(fixed)) if fixed else 0
        if shift is None:
            what = f"the times of day of {part.channels[channel_id].topic} fit the other tables in several hours"
            raise LogError(
                what, "write them with date and hour, such as 2021-06-08T10:41:07.25", part.path
            )
        if shift:
            part.shift(channel_id, shift, "shifted to overlap the other tables, by")
        fixed.append((bounds[0] + shift, bounds[1] + shift))


def open_recording(path: Path | Sequence[Path], *, allow_damaged: bool = False) -> Recording:
    """Open a log, the folder of a bag, or several of them as one; their order does not matter.

    Damaged files are refused, or read as far as they can be used.
    """
    given = (path,) if isinstance(path, Path) else tuple(path)
    for name in map(str, given):
        if not is_writable(name):
            raise LogError(
                f"{visible(name)}: its name is not UTF-8, so it cannot be stored in results",
                "rename it",
            )
    if len(given) == 1 and not given[0].is_dir():
        return Recording(given[0], given, allow_damaged=allow_damaged)
    files = [file for part in given for file in (bag_parts(part) if part.is_dir() else (part,))]
    # A file that is named twice is read once.
    unique = {os.path.realpath(file): file for file in files}
    return Recording(name_giver(given), unique.values(), allow_damaged=allow_damaged)


def name_giver(paths: Sequence[Path]) -> Path:
    """Return the path after which several are named: the first by its name."""
    return min(paths, key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[str, int]]:
    """Sort names with numbers by value: part 2 before part 10."""
    return [(word, int(digits or 0)) for word, digits in re.findall(r"(\D*)(\d*)", path.name)]


# --- Bags: folders with the parts of a recording.

METADATA: Final = "metadata.yaml"  # in which rosbag2 lists the parts
_PACKED: Final = ".zstd"  # ending of parts that rosbag2 compressed as a whole


def bag_parts(path: Path) -> tuple[Path, ...]:
    """Return the files of a bag: those that its list names, which must be all that are there, or all logs."""
    metadata = path / METADATA
    found = _logs_in(path)
    by_name = f"{path / f'*{found[0].suffix if found else LOG_SUFFIXES[0]}'} --one-dive"
    parts = tuple(found)
    if metadata.is_file():
        # A part that the list has as it was packed may be there as the user has unpacked it.
        listed = [path / name for name in _listed(metadata, by_name)]
        plain = [part.with_suffix("") if part.suffix == _PACKED else part for part in listed]
        parts = tuple(
            unpacked if _is_file(unpacked) else part
            for part, unpacked in zip(listed, plain, strict=True)
        )
        for part in parts:
            if not _is_file(part):
                hint = f"copy the whole bag, or read the existing parts: {by_name}"
                raise LogError(f"lists {part.name}, which is not there", hint, metadata)
        for other in found:
            if other not in parts:
                what = f"does not list {other.name}, which is in the folder of the bag"
                raise LogError(
                    what,
                    f"move it to another folder, or read all logs of the folder: {by_name}",
                    metadata,
                )
    for packed in _logs_in(path, _PACKED):
        if packed.with_suffix("") not in parts:
            raise LogError(
                "is compressed as a whole with zstd", f"unpack it: `zstd -d {packed}`", packed
            )
    parts = parts or tuple(
        file for file in sorted(path.iterdir()) if file.suffix.lower() in TABLE_SUFFIXES
    )
    if not parts:
        what = f"is a folder without {' or '.join(LOG_SUFFIXES)} files, and without tables"
        raise LogError(what, "give a log, or a folder with the parts of one", path)
    return parts


def _logs_in(folder: Path, behind: str = "") -> list[Path]:
    return sorted(path for suffix in LOG_SUFFIXES for path in folder.glob(f"*{suffix}{behind}"))


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113  # a Path raises where the name is too long


def _listed(metadata: Path, by_name: str) -> list[str]:
    """Read which parts a list names, as rosbag2 writes it in YAML, or anybody in JSON."""
    hint = f"read the logs of the folder: {by_name}"
    try:
        text = read_text(metadata)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text"
        raise LogError(f"cannot be read: {reason}", hint, metadata) from error
    found = re.search(
        r'relative_file_paths"?:[ \t]*(\[[^\]]*\]|(?:\n[ \t]*-[ \t]+[^\n]+)+)',
        text.replace("\r", ""),
    )
    listed = found[1] if found else ""
    items = re.split(r"[\[\],]" if listed.startswith("[") else r"\n[ \t]*-[ \t]+", listed)
    names = [_unquoted(item.strip()) for item in items if item.strip()]
    if not names:
        raise LogError("lists no files", hint, metadata)
    if re.search(r'compression_mode"?:[ \t]*["\']?MESSAGE', text, re.IGNORECASE):
        what = "says that each message is compressed separately"
        raise LogError(what, "convert the bag without compression: `ros2 bag convert`", metadata)
    return names


def _unquoted(name: str) -> str:
    """Return a name as YAML means it."""
    if name[:1] == name[-1:] == "'" and len(name) > 1:
        return name[1:-1].replace("''", "'")
    if name[:1] == name[-1:] == '"' and len(name) > 1:
        return re.sub(r"\\(.)", r"\1", name[1:-1])
    return name


# --- Files of other formats: what they are, by their first bytes, and the step that makes a log of them.


class OtherFormat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A format that is not read; `other_formats.toml` says what each entry means."""

    name: str
    starts: tuple[str, ...]
    endings: tuple[str, ...]
    step: str
    any_name: bool = False
    is_text: bool = False


OTHER_FORMATS: Final = msgspec.toml.decode(
    Path(__file__).with_name("other_formats.toml").read_text("utf-8"),
    type=dict[str, list[OtherFormat]],
)["format"]


def other_format(path: Path, start: bytes) -> OtherFormat | None:
    """Return the format of a file by its first 16 bytes, of several by the ending of its name too; else by this."""
    ending = path.suffix.lower()
    alike = [
        known
        for known in OTHER_FORMATS
        if start.startswith(tuple(map(bytes.fromhex, known.starts)))
    ]
    if alike:
        return next((known for known in alike if ending in known.endings), alike[-1])
    # MAVLink: each message is behind its time in microseconds, from 2001 to 2096, the larger bytes first.
    if (
        len(start) > 8
        and start[8] in (0xFD, 0xFE)
        and 10**15 < int.from_bytes(start[:8]) < 4 * 10**15
    ):
        return next(known for known in OTHER_FORMATS if ".tlog" in known.endings)
    # An ending that belongs to bytes which are not there tells nothing.
    by_ending = (known for known in OTHER_FORMATS if not known.starts and ending in known.endings)
    return next((known for known in by_ending if not known.is_text or _is_text(start)), None)


def _is_text(start: bytes) -> bool:
    """Return whether bytes hold no control characters but those between words and lines."""
    return all(byte >= 0x20 or byte in b"\t\n\r" for byte in start)
