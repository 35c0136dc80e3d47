"""What can be read: a log, several files that are one dive, or a bag, the folder of a recorder that split its file."""

import hashlib
import math
import os
import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs
from insdvl_replay.core.dive_record import LOG_SUFFIXES, TABLE_SUFFIXES
from insdvl_replay.core.errors import (
    LogError,
    Note,
    counted,
    is_writable,
    read_text,
    visible,
)
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.fields import TABLE
from insdvl_replay.logs.formats.known_formats import (
    START,
    TEXT_SUFFIXES,
    dvl_next_to,
    instrument_format,
    known_format,
    may_be_table,
    other_format,
)
from insdvl_replay.logs.formats.log_file import (
    Block,
    Digest,
    FileBytes,
    LogFile,
    Span,
    UnusableFileError,
    damaged_file_error,
    joined_bounds,
)
from insdvl_replay.logs.formats.mcap_file import MAGIC, McapFile
from insdvl_replay.logs.formats.recorder_clock import (
    SET_BACK_NS,
    OneClock,
    OneSide,
    may_be_set_back,
    one_clock,
    one_side,
    spans_a_step,
)
from insdvl_replay.logs.formats.table_rows import RowsFile

_COMMON_CLOCK_NS: Final = 10**17  # times after 1973 are those of a clock that counts from 1970
PACKED_MAGIC: Final = b"\x28\xb5\x2f\xfd"  # of files that are compressed as a whole with zstd
CHANNELS_OF_A_PART: Final = 1 << 16  # a channel id has 16 bits
_COMPARED: Final = 200  # messages behind a step back that may repeat others
Step = TypeVar("Step")


def open_log_file(path: Path) -> LogFile:
    """Open a file. Its first bytes determine the format; a table as text is known by its name."""
    file = FileBytes(path)
    start = bytes(file.read(0, START))
    if start.startswith(PACKED_MAGIC):
        return _open_packed(file)
    known = known_format(start)
    if known is not None:
        opened: LogFile = known.open(file)
        return opened
    other = other_format(path, start[:16])
    is_other = other is not None and (other.any_name or path.suffix.lower() in TEXT_SUFFIXES)
    if may_be_table(path, start) and not is_other:
        from insdvl_replay.logs.formats.table_file import TableFile

        return TableFile(file)
    if other is not None:
        raise LogError(f"is {other.name}, which is not read", other.step.format(path=path), path)
    if len(file) < len(MAGIC):
        text = f"has only {counted(len(file), 'byte')}, too few for a log"
        raise UnusableFileError(text, "the recording never began, or the copy failed", path)
    return McapFile(file)


def _open_packed(packed: FileBytes) -> LogFile:
    """Open a file that is compressed as a whole."""
    from insdvl_replay.logs.formats.packed import UnpackedBytes

    path = packed.path
    file = UnpackedBytes(packed)
    known = known_format(bytes(file.read(0, START)))
    if known is None:
        hint = f"unpack it: `zstd -d {path}`"
        raise UnusableFileError("is compressed with zstd, and has no log in it", hint, path)
    opened: LogFile = known.open(file)
    opened.damages.update(dict.fromkeys(file.damages))
    return opened


class Recording:
    """One or several files, open for reading as one log.

    A damaged file is refused with the place and what could be saved. Where damage is allowed, it is read as far as its
    bytes can be used, and files of which nothing can be used are done without.
    """

    def __init__(
        self,
        path: Path,
        files: Collection[Path],
        *,
        allow_damaged: bool = False,
    ) -> None:
        self.path = path  # stands for the whole: the folder of a bag, or one of the files
        self.allow_damaged = allow_damaged
        # What whoever joins the files by their motion found.
        self.is_aligned = False
        self.notes_on_files: list[Note] = []
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
        if any(_has_times_of_rows(part) for part in opened):
            _align_times_of_day(opened)
        if len(opened) > 1:  # by their first log times, files without messages last
            opened.sort(key=_begin)
        self.parts = tuple(opened)
        self._is_one_file = len(files) == 1 and self.parts[0].path == path
        channels = []
        for number, part in enumerate(self.parts):
            first = number * CHANNELS_OF_A_PART  # ids count on, so that none occurs twice
            channels += [replace(channel, id=channel.id + first) for channel in part.channels]
        self.channels = tuple(channels)
        self._raise_if_damaged()

    @property
    def notes(self) -> tuple[Note, ...]:
        """Notes on damage found so far, and on files that were read as one."""
        notes: list[Note] = []
        if len(self.parts) > 1:
            names = ", ".join(part.path.name for part in self.parts)
            notes.append(
                note(
                    "joined_files",
                    len(self.parts),
                    names=names,
                )
            )
        for part in self.parts:
            notes += part.notes
        for error in self._unusable.values():
            notes.append(note("log_damaged whole", why=error.message))
        if self.one_clock is not None:
            notes.append(self.one_clock.note)
        if self.one_side is not None:
            notes.append(self.one_side.note)
        if len(self.parts) > 1:
            notes += self._notes_on_clocks()
        notes += self.notes_on_files
        return tuple(notes)

    def _notes_on_clocks(self) -> Iterator[Note]:
        """Note tables that may have no common clock, and logs that were recorded at the same time."""
        at_0 = []
        for part in self.parts:
            if _holds_tables(part) and part.span_ns and part.span_ns[0] == 0:
                at_0.append(part.path.name)
        if len(at_0) > 1:
            yield note(
                "tables_from_0",
                len(at_0),
                names=", ".join(at_0),
            )
        overlaps_s = _overlaps_s(self._spans_of_logs())
        if overlaps_s:
            yield note(
                "files_overlap",
                len(overlaps_s),
                longest_s=max(overlaps_s),
            )

    def _logs(self) -> list[LogFile]:
        """Return the parts that a recorder wrote, with times of its clock."""
        return [part for part in self.parts if not _holds_tables(part)]

    def _spans_of_logs(self) -> list[Span]:
        spans = [part.span_ns for part in self._logs()]
        return [span for span in spans if span is not None]

    @property
    def one_clock(self) -> OneClock | None:
        """The part of a recording with one clock that is used; None where it was not set by more than a day."""
        return self._clocks[0]

    @property
    def one_side(self) -> OneSide | None:
        """The side of this part that is used; None where the clock was not set back by less than a day."""
        return self._clocks[1]

    @cached_property
    def _clocks(self) -> tuple[OneClock | None, OneSide | None]:
        """Find where the recorder's clock was set. Both read the same times, which take long to collect."""
        by_file = {}
        for number, part in enumerate(self.parts):
            if not _holds_tables(part):
                by_file[number] = part.log_times()
        times: list[TimeNs] = []
        for channels in by_file.values():
            times += [time_ns for time_ns in channels.values() if time_ns.size]
        if not times:
            return None, None
        clock = None
        first_ns = min(int(time_ns.min()) for time_ns in times)
        last_ns = max(int(time_ns.max()) for time_ns in times)
        if spans_a_step(first_ns, last_ns):
            clock = one_clock(times)
        return clock, self._side(clock, by_file)

    def _side(
        self,
        clock: OneClock | None,
        by_file: Mapping[int, Mapping[int, TimeNs]],
    ) -> OneSide | None:
        """Return the longest side of a clock that was set back; files and their channels have their log times, ns."""
        for number, channels in by_file.items():
            if not may_be_set_back(_held(channels, clock)):
                continue
            part = self.parts[number]
            side = one_side(_held(_times_as_read(part, channels.keys()), clock))
            if side is None or _repeats_messages(part, clock, side):
                continue
            if len(by_file) > 1:
                raise _set_back_in_one_file(part.path, side)
            first = number * CHANNELS_OF_A_PART
            rows = {channel_id + first: span for channel_id, span in side.rows.items()}
            return replace(side, rows=rows)
        return None

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns."""
        times = {}
        for number, part in enumerate(self.parts):
            for channel_id, time_ns in part.log_times().items():
                times[channel_id + number * CHANNELS_OF_A_PART] = time_ns
        self._raise_if_damaged()
        return times

    def digests(self) -> list[Digest]:
        """Go over all bytes of the parts in their order, then of the files that cannot be used.

        It changes nothing here, so that another thread can do it.
        """
        digests = [part.digest() for part in self.parts]
        for file in self._unusable:
            digests.append(Digest(hashlib.sha256(file.read_bytes()).hexdigest(), []))
        return digests

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
        faults: list[LogError] = []
        for part in self.parts:
            faults += part.faults()
        faults += self._unusable.values()
        if not faults:
            return None
        saved = chain.from_iterable(part.saved_times() for part in self.parts)
        return damaged_file_error(faults, saved)

    def _raise_if_damaged(self) -> None:
        if not self.allow_damaged and (error := self.damage_error()) is not None:
            for part in self.parts:
                part.file.require_unchanged()
            raise error


def _begin(part: LogFile) -> tuple[float, str]:
    """Sort parts by their first log times, those without messages last."""
    if part.span_ns is None:
        return math.inf, part.path.name
    return part.span_ns[0], part.path.name


def _holds_tables(part: LogFile) -> bool:
    """Return whether a part has tables, whose times are their own, or nothing."""
    return all(channel.encoding == TABLE for channel in part.channels)


def _held(times: Mapping[int, TimeNs], clock: OneClock | None) -> Mapping[int, TimeNs]:
    """Return the times of the part with one clock, by channel."""
    if clock is None:
        return times
    return {channel_id: time_ns[clock.holds(time_ns)] for channel_id, time_ns in times.items()}


def _times_as_read(part: LogFile, channel_ids: Collection[int]) -> dict[int, TimeNs]:
    """Return the log times of the messages that can be read, by channel, in the order in which they are read.

    Indexes may be sorted, or name messages that cannot be read.
    """
    times: dict[int, list[TimeNs]] = {}
    for block in part.blocks(channel_ids):
        times.setdefault(block.channel_id, []).append(block.log_time)
    return {channel_id: np.concatenate(blocks) for channel_id, blocks in times.items()}


def _repeats_messages(
    part: LogFile,
    clock: OneClock | None,
    side: OneSide,
) -> bool:
    """Return whether a side repeats messages of the other, as where logs of two recorders were put into one file."""
    channel_id = max(side.rows, key=lambda id_: side.rows[id_][1] - side.rows[id_][0])
    begin, end = side.rows[channel_id]
    step = begin or end  # the row of the first message behind a step back
    times = _held(_times_as_read(part, [channel_id]), clock)[channel_id]
    some = times[step : step + _COMPARED]
    around = times >= some.min() - SET_BACK_NS
    around &= times <= some.max() + SET_BACK_NS
    around[step + _COMPARED :] = False
    before: set[bytes] = set()
    repeated = 0
    first = 0
    for block in part.blocks([channel_id]):
        if clock is not None:
            block = block.part(np.flatnonzero(clock.holds(block.log_time)))
        for i in np.flatnonzero(around[first : first + len(block)]).tolist():
            offset = int(block.offsets[i])
            payload = bytes(block.buffer[offset : offset + int(block.sizes[i])])
            if first + i < step:
                before.add(payload)
            else:
                repeated += payload in before
        first += len(block)
    return repeated > some.size / 2


def _set_back_in_one_file(path: Path, side: OneSide) -> LogError:
    """Refuse files of one dive: which of them have the clock from before the step, nobody knows."""
    text = (
        f"the recorder's clock was set back {side.back_ns / NS_PER_S:.1f} s in this file, {side.set_s:.1f} s in, "
        "and it is one of several files of a dive"
    )
    return LogError(text, f"replay it alone: `insdvl-replay run {shlex.quote(str(path))}`", path)


def _has_times_of_rows(part: LogFile) -> bool:
    """Return whether a part has tables with times of their own, which may lack the date."""
    if isinstance(part, RowsFile) and part.periods_ns:
        return True
    return any(channel.time_column for channel in part.channels)


def _overlaps_s(spans: Sequence[Span]) -> list[float]:
    """Return by how much each span begins before the ones before it have ended, where it does."""
    overlaps_s: list[float] = []
    reached_ns = -math.inf
    for first_ns, last_ns in spans:
        if reached_ns >= first_ns:
            overlaps_s.append((reached_ns - first_ns) * 1e-9)
        reached_ns = max(reached_ns, last_ns)
    return overlaps_s


class _OpenTable(NamedTuple):
    """A table whose times of day have no date or no hour."""

    file: RowsFile
    channel_id: int
    period_ns: int  # after which they repeat
    bounds: Span

    @property
    def topic(self) -> str:
        """The name of the table."""
        return self.file.channels[self.channel_id].topic


def _align_times_of_day(parts: Sequence[LogFile]) -> None:
    """Shift tables without date or hour so that they overlap the others the most: those with a date, else the first."""
    from insdvl_replay.logs.formats.table_times import shift_ns

    fixed: list[Span] = []
    open_ones: list[_OpenTable] = []
    for part in parts:
        if isinstance(part, RowsFile):
            dated, without_date = _sorted_tables(part)
            fixed += dated
            open_ones += without_date
        elif part.span_ns:
            fixed.append(part.span_ns)
    # Those that lack the date alone are shifted before those that lack the hour.
    for table in sorted(open_ones, key=lambda table: -table.period_ns):
        shift: int | None = 0
        if fixed:
            shift = shift_ns(table.bounds, table.period_ns, joined_bounds(fixed))
        if shift is None:
            what = f"the times of day of {table.topic} fit the other tables in several hours"
            hint = "write them with date and hour, such as 2021-06-08T10:41:07.25"
            raise LogError(what, hint, table.file.path)
        if shift:
            table.file.shift(table.channel_id, shift)
        first_ns, last_ns = table.bounds
        fixed.append((first_ns + shift, last_ns + shift))


def _sorted_tables(file: RowsFile) -> tuple[list[Span], list[_OpenTable]]:
    """Return the spans of the tables of a file that have dates, and those that lack a date or an hour."""
    dated: list[Span] = []
    without_date: list[_OpenTable] = []
    for channel_id, times in file.log_times().items():
        if not times.size or file.channels[channel_id].untimed:
            continue
        bounds = (int(times.min()), int(times.max()))
        if channel_id in file.periods_ns:
            period_ns = file.periods_ns[channel_id]
            without_date.append(_OpenTable(file, channel_id, period_ns, bounds))
        elif bounds[0] > _COMMON_CLOCK_NS:
            dated.append(bounds)
    return dated, without_date


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
        log = Recording(given[0], given, allow_damaged=allow_damaged)
        dvl = dvl_next_to(given[0])
        if dvl is not None:
            log.notes_on_files.append(_unread_note(given[0], dvl))
        return log
    files: list[Path] = []
    for part in given:
        files += bag_parts(part) if part.is_dir() else (part,)
    # A file that is named twice is read once.
    unique = {os.path.realpath(file): file for file in files}
    return Recording(name_giver(given), unique.values(), allow_damaged=allow_damaged)


def _unread_note(log: Path, dvl: Path) -> Note:
    """Report a file that looks like a part of the dive, and is not read."""
    return note(
        "dvl_unread",
        name=dvl.name,
        log=shlex.quote(str(log)),
        dvl=shlex.quote(str(dvl)),
    )


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
    for packed in _logs_in(path, _PACKED):
        # One that the user has unpacked is read so.
        if packed.with_suffix("") not in found:
            found.append(packed)
    suffix = found[0].suffix if found else LOG_SUFFIXES[0]
    by_name = f"{path / f'*{suffix}'} --one-dive"
    parts = found
    if metadata.is_file():
        parts = _listed_parts(metadata, by_name)
        for other in found:
            if other not in parts:
                what = f"does not list {other.name}, which is in the folder of the bag"
                hint = f"move it to another folder, or read all logs of the folder: {by_name}"
                raise LogError(what, hint, metadata)
    if not parts:
        parts = [file for file in sorted(path.iterdir()) if _is_part_of_dive(file)]
    if not parts:
        what = f"is a folder without {' or '.join(LOG_SUFFIXES)} files, and without tables"
        raise LogError(what, "give a log, or a folder with the parts of one", path)
    return tuple(parts)


def _is_part_of_dive(file: Path) -> bool:
    """Return whether a file of a folder without logs is a table, or what an instrument wrote."""
    return file.suffix.lower() in TABLE_SUFFIXES or instrument_format(file) is not None


def _listed_parts(metadata: Path, by_name: str) -> list[Path]:
    """Return the files that the list of a bag names, all of which must be there."""
    parts = []
    for name in _listed(metadata, by_name):
        part = metadata.parent / name
        # A part that the list has as it was packed may be there as the user has unpacked it.
        if part.suffix == _PACKED and _is_file(part.with_suffix("")):
            part = part.with_suffix("")
        parts.append(part)
    for part in parts:
        if not _is_file(part):
            hint = f"copy the whole bag, or read the existing parts: {by_name}"
            raise LogError(f"lists {part.name}, which is not there", hint, metadata)
    return parts


def _logs_in(folder: Path, behind: str = "") -> list[Path]:
    """Return the logs of a folder, whose endings may have something behind them."""
    found: list[Path] = []
    for suffix in LOG_SUFFIXES:
        found += folder.glob(f"*{suffix}{behind}")
    return sorted(found)


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
    between = r"[\[\],]" if listed.startswith("[") else r"\n[ \t]*-[ \t]+"
    items = re.split(between, listed)
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
