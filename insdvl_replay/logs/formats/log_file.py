"""What every kind of log file shares: its bytes, whether it has changed, its channels, and messages as blocks of bytes.

Other programs may write to a log, cut it, replace it or remove it while it is read. The log is refused then, since the
parts that were read are from different versions.
"""

import errno
import hashlib
import os
import stat
import weakref
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import Array, Integers, Mask, TimeNs, seconds
from insdvl_replay.core.errors import LogError, Note, counted, counted_clause, listed
from insdvl_replay.core.notes import note

Span = tuple[int, int]  # first and last log time, ns
LARGEST_CHUNK: Final = 1 << 30  # bytes to which a chunk may open; recorders write some megabytes
MOST_OF_A_CUT_CHUNK: Final = 1 << 26  # more of one that lacks its end is not looked at
_USUAL_SIZE: Final = 64 << 20
# Larger chunks are believed only if they are compressed less densely than this.
_MOST_COMPRESSED: Final = 256
_SHOWN: Final = 3  # damaged places that a note lists


def joined_bounds(bounds: Sequence[Span]) -> Span:
    """Return the first and the last of several."""
    return min(first for first, _ in bounds), max(last for _, last in bounds)


@dataclass(frozen=True)
class LogChannel:
    """One channel of a log; a topic may have several."""

    id: int  # that the messages carry
    topic: str
    type_name: str
    encoding: str
    schema_encoding: str  # language of the schema, ``ros2msg`` for ROS 2
    messages: int  # how many are found
    schema_data: bytes = b""  # may be empty; protobuf's is no text
    metadata: Mapping[str, str] = field(default_factory=dict)
    time_column: str = ""  # of a table: the column of its log times
    # Of a table: why its times cannot be read, so that its rows are only counted.
    untimed: str = ""

    @cached_property
    def schema_text(self) -> str:
        """The schema as text."""
        return self.schema_data.decode("utf-8", "replace")


def by_topic(channels: Iterable[LogChannel]) -> dict[str, list[LogChannel]]:
    """Return the channels of each topic."""
    topics: dict[str, list[LogChannel]] = {}
    for channel in channels:
        topics.setdefault(channel.topic, []).append(channel)
    return topics


@dataclass(frozen=True)
class Block:
    """Messages of one channel, in the order of the file."""

    channel_id: int
    buffer: memoryview
    offsets: Integers  # (k,) where in the buffer each payload starts
    sizes: Integers  # (k,) bytes of each payload
    log_time: TimeNs  # (k,) ns, when each was recorded
    publish_time: TimeNs  # (k,) ns; the same where the container has no other

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.offsets.size)

    def part(self, rows: slice | Integers) -> "Block":
        """Return some of the messages."""
        columns = {
            name: getattr(self, name)[rows]
            for name in ("offsets", "sizes", "log_time", "publish_time")
        }
        return replace(self, **columns)


def gather(buffer: memoryview, offsets: Integers, dtype: np.dtype[Any]) -> Array:
    """Copy a structure from many places of a buffer, (k,); each must end within the buffer."""
    if not offsets.size or not dtype.itemsize:
        return np.empty(offsets.size, dtype)
    # As mere bytes, structures are copied six times as fast.
    copied: Any = dtype if dtype.fields is None else (np.void, dtype.itemsize)
    windows: Array = np.ndarray((len(buffer) - dtype.itemsize + 1,), copied, buffer, strides=(1,))
    return windows[offsets].view(dtype)


# --- Damage.


class Damage(NamedTuple):
    """A damaged place: its offset in the file, and what is there."""

    offset: int
    found: str


class DamageError(Exception):
    """Bytes that are not what the format says."""

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.damage = Damage(offset, found)


class UnusableFileError(LogError):
    """A file of which nothing can be used: it is of no format that is read, or no part of it can be believed."""


class ChangedLogError(LogError):
    """A file has changed since it was opened."""


def damaged_file_error(
    faults: Sequence[LogError], saved: Iterable[TimeNs], place: str = "damaged place"
) -> LogError:
    """Return the error for a damaged log: its first fault, the count of the others, and what could be saved.

    The log times of all messages that can be read are given in parts, ns.
    """
    first, *others = faults
    what = first.what
    if others:
        what += f" ({counted(len(others), f'more {place}')})"
    times = np.concatenate([np.empty(0, np.int64), *saved])
    hint = "no message in it can be read; copy it again from the recorder"
    if times.size:
        span_s = float(seconds(times.max(), int(times.min())))
        hint = f"--allow-damaged uses the {span_s:.1f} s and {counted(times.size, 'message')} that can be read"
    return LogError(what, hint, *first.where)


def damage_note(name: str, found: Iterable[Damage], lost: str) -> Note:
    """Return the note on a damaged log: in how many places, what was lost, and what is in the first of them."""
    # Checksums are checked beside the reading, and what is found first is a matter of chance.
    damages = sorted(found)
    shown = [f"byte {damage.offset}: {damage.found}" for damage in damages[:_SHOWN]]
    if len(damages) > _SHOWN:
        shown.append(f"and {len(damages) - _SHOWN} more")
    return note(
        "log_damaged",
        len(damages),
        name=name,
        lost=lost,
        found="; ".join(shown),
    )


# --- Compressed bytes.


def most_opened(
    compressed_size: int, usual: int = _USUAL_SIZE, times: int = _MOST_COMPRESSED
) -> int:
    """Return the bytes to which compressed bytes may open: what is usual, or more where there are more of them."""
    return max(usual, times * compressed_size)


def opened(
    data: memoryview,
    compression: str,
    size: int,
    offset: int,
    crc: int = 0,
    *,
    is_cut: bool = False,
) -> memoryview:
    """Decompress a chunk that is at an offset of the file, and check its length and, if it has one, its checksum.

    One whose end is missing is opened as far as it goes; some recorders write last of all to how much it opens.
    """
    room = min(most_opened(len(data)), LARGEST_CHUNK)
    if is_cut:
        size = min(size or room, room, MOST_OF_A_CUT_CHUNK)
    elif compression and size > room:
        found = f"a chunk of {len(data)} compressed bytes says it opens to {size}"
        raise DamageError(offset, found)
    content = _decompressed(data, compression, size + 1, offset)
    if len(content) > size:
        raise DamageError(offset, f"a chunk opens to more than {size} bytes")
    if is_cut:
        return content
    if len(content) < size:
        found = f"a chunk opens to {len(content)} bytes, but {size} were announced"
        raise DamageError(offset, found)
    if crc and zlib_ng.crc32(content) != crc:
        raise DamageError(offset, "the checksum of a chunk is not that of its bytes")
    return content


def _decompressed(
    data: memoryview,
    compression: str,
    most: int,
    offset: int,
) -> memoryview:
    """Decompress the bytes of a chunk, up to the most that are of use."""
    try:
        if compression == "":
            return data
        if compression == "zstd":
            return memoryview(zstandard.ZstdDecompressor().stream_reader(data).read(most))
        if compression == "lz4":
            return memoryview(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))
        if compression == "bz2":
            import bz2

            return memoryview(bz2.BZ2Decompressor().decompress(data, most))
    except (zstandard.ZstdError, RuntimeError, OverflowError, OSError) as error:
        found = f"a {compression} chunk cannot be decompressed ({error})"
        raise DamageError(offset, found) from error
    found = f"a chunk is compressed with '{compression}'; only zstd, lz4 and bz2 can be read"
    raise DamageError(offset, found)


# --- Files.

_NOT_WAITING: Final = (
    getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
)
_PIECE: Final = 1 << 20


class Digest(NamedTuple):
    """What a pass over all bytes of a file gives: SHA-256 in hexadecimal, and checksums that are not of their bytes."""

    sha256: str
    damages: list[Damage]


class FileBytes:
    """The bytes of a file, read where they are asked for; the file stays open so that changes are noticed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.content = path  # the file that holds the bytes
        try:
            # A pipe that nobody writes to would be waited for without end.
            self._descriptor = os.open(path, os.O_RDONLY | _NOT_WAITING)
        except OSError as error:
            hint = "check the path"
            if error.errno == errno.EMFILE:
                hint = "each part of a dive stays open; raise the limit with `ulimit -n`"
            raise LogError(f"cannot be read: {error.strerror}", hint, path) from error
        except ValueError as error:  # no name of a file
            raise LogError(f"cannot be read: {error}", "check the path", path) from error
        weakref.finalize(self, os.close, self._descriptor)
        self._before = os.fstat(self._descriptor)
        if stat.S_ISDIR(self._before.st_mode):
            raise LogError(f"cannot be read: {os.strerror(errno.EISDIR)}", "check the path", path)
        if not stat.S_ISREG(self._before.st_mode):
            raise LogError("is a pipe or a device, not a file", "write it to a file first", path)
        if not self._before.st_size:
            raise UnusableFileError(
                "is empty (0 bytes)", "the recording never began, or the copy failed", path
            )

    def __len__(self) -> int:
        """Return the size of the file in bytes."""
        return self._before.st_size

    def read(self, start: int, end: int) -> memoryview:
        """Return the bytes from a place to another, or to the end of the file."""
        wanted = max(min(end, len(self)) - start, 0)
        try:
            data = os.pread(self._descriptor, wanted, start)
            # The system gives two gigabytes at a time.
            while more := os.pread(self._descriptor, wanted - len(data), start + len(data)):
                data += more
        except OSError as error:
            raise LogError(
                f"cannot be read: {error.strerror}", "copy it to another disk", self.path
            ) from error
        if len(data) < wanted:
            self.require_unchanged()
            raise ChangedLogError(
                "ends before its size says", "copy it again, and read the copy", self.path
            )
        return memoryview(data)

    def digest(self, section_end: int = 0, section_crc: int = 0) -> Digest:
        """Go over all bytes, whatever has the file's name by now, and check the checksum of those up to a place.

        It changes nothing here, so that another thread can do it.
        """
        digest = hashlib.sha256()
        crc = 0
        for start in range(0, len(self), _PIECE):
            piece = self.read(start, start + _PIECE)
            digest.update(piece)
            if section_crc and start < section_end:
                crc = zlib_ng.crc32(piece[: section_end - start], crc)
        if crc == section_crc:
            return Digest(digest.hexdigest(), [])
        text = "the checksum of all messages is not that of their bytes; some may be wrong"
        return Digest(digest.hexdigest(), [Damage(section_end, text)])

    def require_unchanged(self) -> None:
        """Refuse the file if it has changed since it was opened."""
        before = self._before
        change = ""
        try:
            now = os.fstat(self._descriptor)
            named = self.path.stat()
        except FileNotFoundError:
            change = "was removed"
        except OSError as error:
            change = f"went away ({error.strerror})"
        else:
            if now.st_size != before.st_size:
                word = "was cut" if now.st_size < before.st_size else "grew"
                change = f"{word} from {before.st_size} to {now.st_size} bytes"
            elif now.st_mtime_ns != before.st_mtime_ns:
                change = "was written to"
            elif not os.path.samestat(before, named):
                change = "was replaced by another file"
        if change:
            hint = "wait until the recording has ended, or read a copy"
            raise ChangedLogError(f"{change} while it was read", hint, self.path)


class LogFile(ABC):
    """A file with messages, open for reading; damage is collected, and allowed or not by the recording."""

    channels: tuple[LogChannel, ...] = ()  # their ids are below 65536
    profile: str = ""  # what the recorder promises to follow, ``ros2`` for ROS 2
    library: str = ""  # what wrote the log
    has_summary: bool  # whether the file closes with a summary that can be believed, or needs none
    chunk_count: int = 0
    compression: tuple[str, ...] = ()  # of its chunks, ``none`` for those that are not compressed
    metadata: Sequence[Any] = ()  # the metadata records in the order of the file, each with a name
    attachments: Sequence[Any] = ()

    def __init__(self, file: FileBytes) -> None:
        self.file = file
        self.path = file.path
        self.damages: dict[Damage, None] = {}  # the places found so far

    @property
    def size_bytes(self) -> int:
        """How large the file is."""
        return len(self.file)

    @property
    def span_ns(self) -> Span | None:
        """First and last log time; None without messages."""
        known = [times for times in self.log_times().values() if times.size]
        if not known:
            return None
        first_ns = min(int(times.min()) for times in known)
        last_ns = max(int(times.max()) for times in known)
        return first_ns, last_ns

    @property
    @abstractmethod
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong so far."""

    @abstractmethod
    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a part of the file at a time."""

    @abstractmethod
    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns."""

    def faults(self) -> list[LogError]:
        """Return an error for each damaged place found so far."""
        return [
            LogError(f"is damaged at byte {place}: {found}", "", self.path)
            for place, found in self.damages
        ]

    def saved_times(self) -> Iterator[TimeNs]:
        """Give the log times of all messages that can be read, some at a time; ns."""
        yield from self.log_times().values()

    def check_unopened(self) -> Iterator[None]:
        """Check, step by step, what nobody has looked at so far."""
        return iter(())

    def digest(self) -> Digest:
        """Go over all bytes of the file."""
        return self.file.digest()

    def add_damage(self, damage: Damage) -> None:
        """Keep a damaged place; one that is found again counts once."""
        self.damages.setdefault(damage)

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Keep a damaged place that is found inside, and go on behind the block."""
        try:
            yield
        except DamageError as error:
            self.add_damage(error.damage)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Raise a ChangedLogError if the file changes while the block runs.

        It also replaces any error of the block, since a file that changes may well be the cause.
        """
        try:
            yield
        except Exception:
            self.file.require_unchanged()
            raise
        self.file.require_unchanged()


# --- Files of chunks.

# While a chunk is read, so many behind it are opened. Together they open to so many bytes at most,
# but the next one is opened in any case.
_AHEAD: Final = 3
_MOST_OPEN: Final = 256 << 20
# The first chunks of each reading stay open for the next one, because samples of many topics are
# read from the same chunks. The oldest are closed where they have more than so many bytes.
_FIRST_KEPT: Final = 2
_MOST_KEPT: Final = 16 << 20
_LISTED: Final = 4  # topics that a note lists
_LONGEST_NS: Final = 10**15  # 11 days; a chunk that says it covers more is not believed


class Messages(NamedTuple):
    """The messages of a chunk, in the order of the file; each column is (k,)."""

    channel_ids: Integers
    log_ns: TimeNs
    publish_ns: TimeNs
    starts: Integers  # bytes from the beginning of the open chunk to each payload
    sizes: Integers  # bytes of each payload

    def rows(self, chosen: Mask | Integers) -> "Messages":
        """Return some of the messages."""
        return Messages(*[column[chosen] for column in self])


class MessageTimes(NamedTuple):
    """Channel and log time of the messages of a chunk; each column is (k,)."""

    channel_ids: Integers
    log_ns: TimeNs


@dataclass(eq=False)
class Chunk:
    """A part of a file with messages: a chunk and the indexes behind it, or a run of messages that are in no chunk.

    Places are bytes from the beginning of the file.
    """

    start: int
    end: int  # of the chunk; its indexes follow
    is_loose: bool = False  # a run of messages that are in no chunk
    # From its header, which may be wrong. Messages that are in no chunk have none of this.
    compression: str = ""  # empty: it is not compressed
    data_start: int = 0  # where its compressed bytes begin
    data_size: int = 0  # how many these are
    size: int = 0  # bytes to which they open
    crc: int = 0  # CRC-32 of the open bytes; 0 where the recorder computed none
    span_ns: Span = (0, 0)
    # Learnt while the file is read.
    indexes: list[tuple[int, int]] = field(default_factory=list)  # start and end of each
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel
    is_indexed: bool = True  # False once the indexes are found not to name all messages
    is_cut: bool = False  # its end is missing, since the recording stopped within it

    @property
    def index_end(self) -> int:
        """Where its last index ends; without indexes, where it ends itself."""
        if self.indexes:
            return self.indexes[-1][1]
        return self.end


class Content(NamedTuple):
    """The messages of an open chunk, in the order of the file."""

    buffer: memoryview
    messages: Messages

    def counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        ids, counts = np.unique(self.messages.channel_ids, return_counts=True)
        return Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))

    def blocks(self, channel_ids: Iterable[int]) -> Iterator[Block]:
        """Give the messages of some channels, channel by channel."""
        for channel_id in sorted(channel_ids):
            places = np.flatnonzero(self.messages.channel_ids == channel_id)
            if places.size:
                own = self.messages.rows(places)
                yield Block(
                    channel_id,
                    self.buffer,
                    offsets=own.starts,
                    sizes=own.sizes,
                    log_time=own.log_ns,
                    publish_time=own.publish_ns,
                )


Opening = Future[tuple[memoryview, memoryview]]


def _may_be_opened(ahead: Collection[tuple[Chunk, Opening]], chunk: Chunk) -> bool:
    """Return whether a chunk may be opened beside those that are open already."""
    if not ahead:
        return True
    size = sum(other.size for other, _ in ahead) + chunk.size
    return len(ahead) <= _AHEAD and size <= _MOST_OPEN


def _by_channel(messages: Messages | MessageTimes) -> dict[int, TimeNs]:
    """Return the log times of each channel, in the order of the file."""
    times = dict[int, TimeNs]()
    for channel_id in np.unique(messages.channel_ids).tolist():
        times[channel_id] = messages.log_ns[messages.channel_ids == channel_id]
    return times


@dataclass
class _TopicFound:
    """What is found of a topic in a damaged file."""

    messages: int = 0
    latest_ns: int = 0  # log time of the latest of them
    holes: int = 0  # damaged places before the last of them in the file
    gap_ns: int = 0  # for how long it has none around damaged places

    def add(
        self,
        time_ns: TimeNs,
        holes: int,
        begun_ns: int | None,
    ) -> None:
        """Add the messages of a chunk that has some damaged places before it.

        A topic is interrupted from its last message before damaged bytes to its first one behind them. Before its first
        one it is since the recording began, if that is known.
        """
        before_ns = self.latest_ns if self.messages else begun_ns
        if holes > self.holes and before_ns is not None:
            self.gap_ns += max(int(time_ns.min()) - before_ns, 0)
        self.messages += time_ns.size
        self.latest_ns = max(self.latest_ns, int(time_ns.max()))
        self.holes = holes


class ChunkedFile(LogFile):
    """A file whose messages are in chunks: a kind of file says where they are and how messages are found in one."""

    usually_opened: int  # bytes to which a file may open, or more where it is large
    most_compressed: int

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._chunks: list[Chunk] = []
        self._lost: list[Chunk] = []  # that cannot be opened
        self._passed: list[Span] = []  # start and end of bytes in which no record is found
        self._missing: list[int] = []  # where chunks were whose places are known
        # Messages by channel, as the end of the file says.
        self._announced: Counter[int] | None = None
        self._announced_ns: Span | None = None  # first and last log time, likewise
        self._is_open_ended = False  # whether the end of the recording is not in the file
        self._opened: set[int] = set()
        self._kept: dict[int, Content] = {}
        self._kept_bytes = 0

    @abstractmethod
    def _find_messages(
        self,
        chunk: Chunk,
        buffer: memoryview,
        behind: memoryview,
    ) -> Messages:
        """Find the messages of an open chunk, behind which are its indexes."""

    @abstractmethod
    def _listed(self, chunk: Chunk) -> MessageTimes | None:
        """Return channel and log time of the messages of a chunk; None where only its content tells."""

    def damage(self, offset: int, found: str) -> None:
        """Keep a damaged place: its offset in the file, and what is there."""
        self.add_damage(Damage(offset, found))

    def _limit_size(self) -> None:
        """Leave out the chunks beyond what a file of this size may open to: a bomb would be read for hours."""
        most = max(self.usually_opened, self.most_compressed * len(self.file))
        total = 0
        for chunk in list(self._chunks):
            if chunk.size <= most:  # a larger one is refused where it is opened
                total += chunk.size
            if total > most:
                what = f"the chunks up to here open to {total} bytes, where a file of {len(self.file)} may hold {most}"
                self.damage(chunk.start, what)
                self._lose(chunk)

    def _lose(self, chunk: Chunk) -> None:
        """Leave a chunk out; another reader of the same file, that was further, may have lost it already."""
        if chunk in self._chunks:
            self._chunks.remove(chunk)
            self._lost.append(chunk)

    def _counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        return sum((chunk.counts for chunk in self._chunks), Counter[int]())

    def _contents(self, chunks: Iterable[Chunk]) -> Iterator[Content]:
        """Open chunks, some ahead of the reader; those that cannot be opened are lost."""
        left = deque(chunks)
        ahead = deque[tuple[Chunk, Opening]]()
        kept_open = {chunk.start for chunk in list(left)[:_FIRST_KEPT]}
        opener = ThreadPoolExecutor(1)
        try:
            while left or ahead:
                while left and _may_be_opened(ahead, left[0]):
                    chunk = left.popleft()
                    if chunk.start in self._kept and not ahead:
                        yield self._kept[chunk.start]
                    else:
                        ahead.append((chunk, opener.submit(self._open, chunk)))
                if not ahead:
                    continue
                chunk, opening = ahead.popleft()
                content = self._content(chunk, opening)
                del opening  # as `_content` does
                if content is None:
                    continue
                if chunk.start in kept_open:
                    self._keep(chunk, content)
                yield content
        finally:
            # Who leaves may be the garbage collector, in the midst of the start of a thread: it must not wait for one.
            opener.shutdown(wait=False, cancel_futures=True)

    def _content(self, chunk: Chunk, opening: Opening) -> Content | None:
        """Find the messages of a chunk; None where it cannot be opened, and is lost."""
        self._opened.add(chunk.start)
        try:
            buffer, behind = opening.result()
            return Content(buffer, self._find_messages(chunk, buffer, behind))
        except DamageError as error:
            self.add_damage(error.damage)
            self._lose(chunk)
            return None
        finally:
            # Its error leads back to this frame. As a circle, both would keep the bytes of the chunk for long.
            del opening

    def _keep(self, chunk: Chunk, content: Content) -> None:
        """Keep a chunk open, and let go of the oldest ones where they are too many."""
        replaced = self._kept.pop(chunk.start, None)
        if replaced is not None:
            self._kept_bytes -= len(replaced.buffer)
        self._kept[chunk.start] = content
        self._kept_bytes += len(content.buffer)
        while self._kept_bytes > _MOST_KEPT:
            oldest = self._kept.pop(next(iter(self._kept)))
            self._kept_bytes -= len(oldest.buffer)

    def _open(self, chunk: Chunk) -> tuple[memoryview, memoryview]:
        """Return the bytes of an open chunk, and those of the indexes behind it."""
        raw = self.file.read(chunk.start, chunk.index_end)
        end = chunk.end - chunk.start
        if chunk.is_loose:
            return raw, raw[end:]
        data = raw[chunk.data_start - chunk.start : end]
        if len(data) != chunk.data_size and not chunk.is_cut:
            what = f"a chunk says it has {chunk.data_size} compressed bytes; there are {len(data)}"
            raise DamageError(chunk.start, what)
        data = opened(
            data, chunk.compression, chunk.size, chunk.start, chunk.crc, is_cut=chunk.is_cut
        )
        return data, raw[end:]

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed."""
        wanted = [
            chunk for chunk in self._chunks if not chunk.counts.keys().isdisjoint(channel_ids)
        ]
        for content in self._contents(wanted):
            yield from content.blocks(channel_ids)

    def _times_by_chunk(self) -> Iterator[tuple[Chunk, dict[int, TimeNs]]]:
        """Give each chunk with the log times of its messages by channel; it is opened only if nothing else tells."""
        for chunk in list(self._chunks):
            found = self._listed(chunk)
            if found is not None:
                yield chunk, _by_channel(found)
                continue
            for content in self._contents([chunk]):
                yield chunk, _by_channel(content.messages)

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns."""
        parts: dict[int, list[TimeNs]] = {
            channel.id: [np.empty(0, np.int64)] for channel in self.channels
        }
        for _, times in self._times_by_chunk():
            for channel_id, time_ns in times.items():
                parts.setdefault(channel_id, []).append(time_ns)
        return {channel_id: np.concatenate(times) for channel_id, times in parts.items()}

    def saved_times(self) -> Iterator[TimeNs]:
        """Read all that can be read and give the log times, a chunk at a time; ns."""
        known = [channel.id for channel in self.channels]
        for _, messages in self._contents(list(self._chunks)):
            yield messages.log_ns[np.isin(messages.channel_ids, known)]

    def check_unopened(self) -> Iterator[None]:
        """Open the chunks that nobody has opened so far, one by one, for their checksums alone."""
        unopened = [chunk for chunk in self._chunks if chunk.start not in self._opened]
        for _ in self._contents([chunk for chunk in unopened if chunk.crc]):
            yield

    def _losses(self) -> str:
        """State how many messages of each topic are lost, for how long it has none, and how many bytes are damaged."""
        bad = {(chunk.start, chunk.end) for chunk in self._lost} | set(self._passed)
        found = self._found_by_topic([start for start, _ in bad])
        lost = self._lost_by_topic(found).most_common()
        is_open = self._is_open_ended and self._announced is None
        damaged_bytes = sum(end - start for start, end in bad)

        if lost:
            what = listed(self._lost_texts(lost, found), _LISTED)
        elif self._announced is None and (damaged_bytes or is_open):
            longest_s = max((topic.gap_ns for topic in found.values()), default=0) * 1e-9
            what = f"an unknown number of messages (at least {longest_s:.3f} s)"
        else:
            what = "no messages"
        verb = "is" if len(lost) == 1 and lost[0][1] == 1 else "are"
        text = f"{what} {verb} lost"
        if damaged_bytes:
            text += f", {counted_clause(damaged_bytes, 'bytes are damaged')}"
        if is_open:
            text += "; the end of the recording is unknown"
        return text

    def _lost_texts(
        self, lost: Iterable[tuple[str, int]], found: Mapping[str, _TopicFound]
    ) -> Iterator[str]:
        """State how many messages of each topic are lost, and for how long it has none."""
        least = "at least " if self._announced is None else ""
        for topic, count in lost:
            gap_s = found[topic].gap_ns * 1e-9 if topic in found else 0.0
            yield f"{least}{counted(count, 'message')} of {topic} ({gap_s:.3f} s)"

    def _topics(self) -> dict[int, str]:
        """Return the topics by the ids of their channels."""
        return {channel.id: channel.topic for channel in self.channels}

    def _found_by_topic(self, damaged: Collection[int]) -> dict[str, _TopicFound]:
        """Return what is found of each topic around damaged bytes, and around chunks that are missing."""
        topics = self._topics()
        holes = np.sort(np.array([*damaged, *self._missing], np.int64))
        begun_ns, ended_ns = self._recorded_span()
        found: dict[str, _TopicFound] = {}
        for chunk, times in self._times_by_chunk():
            holes_before = int(np.searchsorted(holes, chunk.start, "right"))
            together: dict[str, list[TimeNs]] = {}
            for channel_id in times.keys() & topics:
                together.setdefault(topics[channel_id], []).append(times[channel_id])
            for topic, parts in together.items():
                time_ns = np.concatenate(parts)
                found.setdefault(topic, _TopicFound()).add(time_ns, holes_before, begun_ns)
        for topic_found in found.values():
            if topic_found.holes < holes.size or self._is_open_ended:
                topic_found.gap_ns += max(ended_ns - topic_found.latest_ns, 0)
        return found

    def _recorded_span(self) -> tuple[int | None, int]:
        """Return when the recording began, None where nothing says it, and when it ended at the earliest; ns."""
        if self._announced_ns is not None:
            return self._announced_ns
        spans = [chunk.span_ns for chunk in [*self._chunks, *self._lost] if not chunk.is_loose]
        ends = [last for first, last in spans if 0 < first <= last < first + _LONGEST_NS]
        return None, max(ends, default=0)

    def _lost_by_topic(self, found: Mapping[str, _TopicFound]) -> Counter[str]:
        """Count the messages that are lost: those that the end of the file has more, else those of lost chunks."""
        counts = self._announced
        if counts is None:
            counts = sum((chunk.counts for chunk in self._lost), Counter[int]())
        topics = self._topics()
        by_topic = Counter[str]()
        for channel_id, count in counts.items():
            by_topic[topics.get(channel_id, "unknown channels")] += count
        if self._announced is None:
            return by_topic
        return by_topic - Counter({topic: one.messages for topic, one in found.items()})
