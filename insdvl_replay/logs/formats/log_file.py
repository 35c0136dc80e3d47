"""What every kind of log file shares: its bytes, whether it has changed, its channels, and messages as blocks of bytes.

Other programs may write to a log, cut it, put another file in its place or remove it while it is read. What was read by
then is of no file that ever was, so that the log is refused.
"""

import errno
import hashlib
import os
import stat
import weakref
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity

Span = tuple[int, int]  # first and last log time, ns
COPY_AGAIN: Final = "copy the log again from the recorder if it still has it"
LARGEST_CHUNK: Final = 1 << 30  # bytes to which a chunk may open; recorders write some megabytes
_USUAL_SIZE: Final = 64 << 20
_MOST_COMPRESSED: Final = 256  # larger chunks are believed only if they are compressed less densely than this
_SHOWN: Final = 3  # damaged places that a note lists


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
    offsets: NDArray[np.int64]  # (k,) where in the buffer each payload starts
    sizes: NDArray[np.int64]  # (k,) bytes of each payload
    log_time: TimeNs  # (k,) ns, when each was recorded
    publish_time: TimeNs  # (k,) ns; the same where the container has no other

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.offsets.size)

    def part(self, rows: slice | NDArray[np.int64]) -> "Block":
        """Return some of the messages."""
        columns = {name: getattr(self, name)[rows] for name in ("offsets", "sizes", "log_time", "publish_time")}
        return replace(self, **columns)


def gather(buffer: memoryview, offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy a structure from many places of a buffer, (k,); each must end within the buffer."""
    if not offsets.size or not dtype.itemsize:
        return np.empty(offsets.size, dtype)
    # As mere bytes, structures are copied six times as fast.
    copied: Any = dtype if dtype.fields is None else (np.void, dtype.itemsize)
    windows: NDArray[Any] = np.ndarray((len(buffer) - dtype.itemsize + 1,), copied, buffer, strides=(1,))
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
    """A file is no longer what it was when it was opened."""


def damaged_file_error(faults: Sequence[LogError], saved: Iterable[TimeNs], places: str = "damaged places") -> LogError:
    """Return the error for a damaged log: its first fault, the count of the others, and what could be saved.

    The log times of all messages that can be read are given in parts, ns.
    """
    first, *others = faults
    what = f"{first.what} ({len(others)} more {places})" if others else first.what
    times = np.concatenate([np.empty(0, np.int64), *saved])
    hint = "no message in it can be read; copy it again from the recorder"
    if times.size:
        span_s = float(seconds(times.max(), int(times.min())))
        hint = f"--allow-damaged uses the {span_s:.1f} s and {times.size} messages that can be read"
    return LogError(what, hint, *first.where)


def damage_note(name: str, found: Iterable[Damage], lost: str) -> Note:
    """Return the note on a damaged log: in how many places, what was lost, and what is in the first of them."""
    # Checksums are checked beside the reading, and what is found first is a matter of chance.
    damages = sorted(found)
    shown = "; ".join(f"byte {damage.offset}: {damage.found}" for damage in damages[:_SHOWN])
    more = f"; and {len(damages) - _SHOWN} more" if len(damages) > _SHOWN else ""
    places = "1 place" if len(damages) == 1 else f"{len(damages)} places"
    text = f"{name} is damaged in {places}, {lost} ({shown}{more})"
    return Note("log_damaged", text, len(damages), Severity.WARNING, COPY_AGAIN)


# --- Compressed bytes.


def most_opened(compressed_size: int, usual: int = _USUAL_SIZE) -> int:
    """Return the bytes to which compressed bytes may open: what is usual, or more where there are more of them."""
    return max(usual, _MOST_COMPRESSED * compressed_size)


def opened(compressed: memoryview, compression: str, size: int, offset: int, crc: int = 0) -> memoryview:
    """Decompress a chunk that is at an offset of the file, and check its length and, if it has one, its checksum."""
    if compression and size > min(most_opened(len(compressed)), LARGEST_CHUNK):
        raise DamageError(offset, f"a chunk of {len(compressed)} compressed bytes says it opens to {size}")
    try:
        if compression == "":
            content = compressed
        elif compression == "zstd":
            if zstandard.frame_content_size(compressed) not in (-1, size):
                raise DamageError(offset, f"a zstd chunk does not open to the {size} bytes that it announces")
            content = memoryview(zstandard.ZstdDecompressor().decompress(compressed, max_output_size=size))
        elif compression == "lz4":
            decompressor = lz4.frame.LZ4FrameDecompressor()
            content = memoryview(decompressor.decompress(compressed, max_length=size))
            if not (decompressor.eof or decompressor.needs_input):
                raise DamageError(offset, f"a chunk opens to more than {size} bytes")
        elif compression == "bz2":
            import bz2

            content = memoryview(bz2.BZ2Decompressor().decompress(compressed, size + 1))
        else:
            what = f"a chunk is compressed with '{compression}', which is none of zstd, lz4, bz2 and nothing"
            raise DamageError(offset, what)
    except (zstandard.ZstdError, RuntimeError, OverflowError, OSError) as error:
        raise DamageError(offset, f"a {compression} chunk cannot be decompressed ({error})") from error
    if len(content) != size:
        raise DamageError(offset, f"a chunk opens to {len(content)} bytes where {size} were announced")
    if crc and zlib_ng.crc32(content) != crc:
        raise DamageError(offset, "the checksum of a chunk is not that of its bytes")
    return content


# --- Files.

_NOT_WAITING: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_PIECE: Final = 1 << 20


class Digest(NamedTuple):
    """What a pass over all bytes of a file gives: SHA-256 in hexadecimal, and checksums that are not of their bytes."""

    sha256: str
    damages: list[Damage]


class FileBytes:
    """The bytes of a file, read where they are asked for; the file stays open so that changes are noticed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # A pipe that nobody writes to would be waited for without end.
            self._descriptor = os.open(path, os.O_RDONLY | _NOT_WAITING)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            many = isinstance(error, OSError) and error.errno == errno.EMFILE
            hint = "each part of a dive stays open; raise the limit with `ulimit -n`" if many else "check the path"
            raise LogError(f"cannot be read: {reason}", hint, path) from error
        weakref.finalize(self, os.close, self._descriptor)
        self._before = os.fstat(self._descriptor)
        if stat.S_ISDIR(self._before.st_mode):
            raise LogError(f"cannot be read: {os.strerror(errno.EISDIR)}", "check the path", path)
        if not stat.S_ISREG(self._before.st_mode):
            raise LogError("is a pipe or a device, not a file", "write it to a file, and name that", path)
        if not self._before.st_size:
            raise UnusableFileError("is empty (0 bytes)", "the recording never began, or the copy failed", path)

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
            raise LogError(f"cannot be read: {error.strerror}", "copy it to another disk", self.path) from error
        if len(data) < wanted:
            self.require_unchanged()
            raise ChangedLogError("ends before its size says", "copy it again, and read the copy", self.path)
        return memoryview(data)

    def digest(self, section_end: int = 0, section_crc: int = 0) -> Digest:
        """Go over all bytes, whatever has the file's name by now, and check the checksum of those up to a place.

        It changes nothing here, so that another thread can do it.
        """
        digest, crc = hashlib.sha256(), 0
        for start in range(0, len(self), _PIECE):
            piece = self.read(start, start + _PIECE)
            digest.update(piece)
            if section_crc and start < section_end:
                crc = zlib_ng.crc32(piece[: section_end - start], crc)
        text = "the checksum of all messages is not that of their bytes; some may be wrong"
        return Digest(digest.hexdigest(), [Damage(section_end, text)] if crc != section_crc else [])

    def require_unchanged(self) -> None:
        """Refuse the file if it is no longer what it was when it was opened."""
        before, change = self._before, ""
        try:
            now, named = os.fstat(self._descriptor), self.path.stat()
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
            hint = "read it when nothing writes there any more, or read a copy of it"
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
        times = [times for times in self.log_times().values() if times.size]
        return (min(int(part.min()) for part in times), max(int(part.max()) for part in times)) if times else None

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
        return [LogError(f"is damaged at byte {place}: {found}", "", self.path) for place, found in self.damages]

    def saved_times(self) -> Iterator[TimeNs]:
        """Give the log times of all messages that can be read, some at a time; ns."""
        yield from self.log_times().values()

    def check_unopened(self) -> Iterator[None]:
        """Check, step by step, what nobody has looked at so far."""
        return iter(())

    def digest(self) -> Digest:
        """Go over all bytes of the file."""
        return self.file.digest()

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Note a damaged place, and go on behind what it spoils."""
        try:
            yield
        except DamageError as error:
            self.damages.setdefault(error.damage)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the file if it has changed by the end, above all if that made something inside fail."""
        try:
            yield
        except Exception:
            self.file.require_unchanged()
            raise
        self.file.require_unchanged()
