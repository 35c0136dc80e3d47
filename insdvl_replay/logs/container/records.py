"""The records of an MCAP file: where each one stands, and where the next one stands after bytes that are none.

The loops over many of them are compiled, in `record_loops`, which is loaded where they are needed: the compiler takes a
second to load, and a look at a summary needs none.
Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from insdvl_replay.core.runtime import is_loaded

Span = tuple[int, int]
"""First and last log time, ns."""
_LONGEST_NS: Final = 10**15
"""No recording covers more."""


def plausible_span(first_ns: int, last_ns: int) -> Span | None:
    """Return a span if it can be one."""
    return (first_ns, last_ns) if first_ns > 0 and 0 <= last_ns - first_ns < _LONGEST_NS else None


@dataclass(frozen=True)
class Damage:
    """A damaged place: its offset in the file, and what stands there."""

    offset: int
    found: str


class DamageError(Exception):
    """Bytes that are not what the format says, at an offset in the file; ``found`` is what stands there."""

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.damage = Damage(offset, found)


RECORD_HEADER_SIZE: Final = 9
"""Bytes in front of each record's content: its kind and its length."""
LAST_KNOWN: Final = 15
"""Highest kind of record that the specification knows."""
_FIRST_PRIVATE: Final = 128
_LEAST_LENGTHS: Final = (0, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
"""What a record of each known kind must at least hold for its own fields."""


def can_be_record(opcode: int, length: int) -> bool:
    """Return whether a record of a kind can have a length."""
    if opcode > LAST_KNOWN:
        return opcode >= _FIRST_PRIVATE
    return opcode > 0 and length >= _LEAST_LENGTHS[opcode]


MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""
DATA_END_SIZE: Final = RECORD_HEADER_SIZE + 4
"""Bytes of the record behind the last message."""
MESSAGE_FIELDS_SIZE: Final = 22
"""Bytes of a message record in front of the payload."""
BATCH: Final = 1 << 16
"""Most records that are found at a time."""
_MESSAGE: Final = int(Opcode.MESSAGE)
_DATA_END: Final = int(Opcode.DATA_END)


@dataclass(frozen=True)
class Records:
    """Records in the order in which they stand, shape (k,): their kinds, and where their headers start.

    The length is that of the content, which stands behind the header.
    """

    opcodes: NDArray[np.uint8]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of records."""
        return int(self.opcodes.size)

    def rows(self) -> Iterator[tuple[int, int, int]]:
        """Go through them one by one: kind, start of the content, and its length."""
        contents = self.starts + RECORD_HEADER_SIZE
        return zip(self.opcodes.tolist(), contents.tolist(), self.lengths.tolist(), strict=True)

    def where(self, chosen: Any) -> "Records":
        """Return some of them, chosen as an array of shape (k,) is indexed."""
        return Records(self.opcodes[chosen], self.starts[chosen], self.lengths[chosen])


def joined(batches: Sequence[Records]) -> Records:
    """Put batches one behind the other."""
    return Records(*map(np.concatenate, zip(*((one.opcodes, one.starts, one.lengths) for one in batches), strict=True)))


def find_records(data: memoryview, start: int, end: int) -> tuple[Records, int]:
    """Return the records from a place on, `BATCH` at most, and where they end, as at bytes that are none."""
    if _Plain.left > 0 and not is_loaded():
        found, stop = find_plainly(data, start, end)
        _Plain.left -= len(found)
        return found, stop
    from insdvl_replay.logs.container.record_loops import walk

    room = _ROOM.records
    count, stop = walk(np.frombuffer(data, np.uint8), start, end, room.opcodes, room.starts, room.lengths)
    return Records(room.opcodes[:count].copy(), room.starts[:count].copy(), room.lengths[:count].copy()), stop


class _Room(threading.local):
    """Room for a batch, made once for each thread: to make it for each chunk takes longer than the walk."""

    def __init__(self) -> None:
        self.records = Records(np.empty(BATCH, np.uint8), np.empty(BATCH, np.int64), np.empty(BATCH, np.int64))


_ROOM: Final = _Room()


class _Plain:
    """How many records are still found without the compiler, before its loops are worth the second that they load."""

    left = 500_000


def find_plainly(data: memoryview, start: int, end: int) -> tuple[Records, int]:
    """Do what `find_records` does, record by record."""
    found: list[tuple[int, int, int]] = []
    while start + RECORD_HEADER_SIZE <= end and len(found) < BATCH:
        opcode, length = struct.unpack_from("<BQ", data, start)
        if length > end - start - RECORD_HEADER_SIZE or not can_be_record(opcode, length):
            break
        found.append((opcode, start, length))
        start += RECORD_HEADER_SIZE + length
        if opcode == _DATA_END:
            break
    columns = np.array(found, dtype=np.int64).reshape(-1, 3).T
    return Records(columns[0].astype(np.uint8), columns[1].copy(), columns[2].copy()), start


def is_broken(batch: Records, stop: int, end: int) -> bool:
    """Return whether a walk stopped because the bytes are no record."""
    return stop < end and len(batch) < BATCH and not (len(batch) and batch.opcodes[-1] == _DATA_END)


def next_record(data: memoryview, start: int, end: int) -> int:
    """Search for a place where a record can stand with another one, or the end, right behind it."""
    from insdvl_replay.logs.container.record_loops import resume

    return int(resume(np.frombuffer(data, np.uint8), start, end))


def go_on(data: memoryview, batch: Records, stop: int, end: int) -> tuple[Records, int]:
    """Return a batch less a last message that may be false, and where records go on behind bytes that are none."""
    if len(batch) and batch.opcodes[-1] == _MESSAGE:
        return batch.where(slice(-1)), next_record(data, int(batch.starts[-1]) + 1, end)
    return batch, next_record(data, stop + 1, end)


def what_stands(data: memoryview, start: int, end: int) -> str:
    """State why no record can stand at a place."""
    room = end - start - RECORD_HEADER_SIZE
    if room < 0:
        return f"{end - start} bytes are left where a record needs at least {RECORD_HEADER_SIZE}"
    opcode, length = struct.unpack_from("<BQ", data, start)
    if length > room:
        return f"a record of kind {opcode} says it has {length} bytes; {room} are left"
    return f"{length} bytes under kind {opcode} are no record"


def parsed(kind: Any, data: memoryview, start: int, length: int) -> Any:
    """Parse a record."""
    try:
        return kind.read(ReadDataStream(BytesIO(data[start : start + length])))
    except (McapError, struct.error, UnicodeDecodeError, EOFError) as error:
        raise DamageError(start, f"a {kind.__name__} record of {length} bytes cannot be parsed") from error


@dataclass(frozen=True)
class LogChannel:
    """One channel of a log; a topic may have several.

    Attributes
    ----------
    id : int
        Number that the messages carry.
    topic, type_name, encoding : str
        As the log names them.
    schema_encoding : str
        Language of the schema, ``ros2msg`` for ROS 2.
    messages : int
        How many messages are found.
    schema_data : bytes
        The schema as it stands in the log; may be empty, and protobuf's are no text.
    metadata : mapping of str to str
        What the recorder wrote beside it.
    """

    id: int
    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    messages: int
    schema_data: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def schema_text(self) -> str:
        """The schema as text."""
        return self.schema_data.decode("utf-8", "replace")


def described(channel: records.Channel, schema: records.Schema | None, messages: int) -> LogChannel:
    """Describe a channel by its records."""
    return LogChannel(
        id=channel.id,
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        messages=messages,
        schema_data=schema.data if schema else b"",
        metadata=channel.metadata,
    )


def by_topic(channels: Iterable[LogChannel]) -> dict[str, list[LogChannel]]:
    """Return the channels of each topic."""
    topics: dict[str, list[LogChannel]] = {}
    for channel in channels:
        topics.setdefault(channel.topic, []).append(channel)
    return topics


_TIMES: Final = struct.Struct("<QQ")


@dataclass(frozen=True)
class Attachment:
    """A file inside a log.

    Its bytes are read from the disk when they are looked at. The size is that of the record in front of its checksum,
    and this 0 if there is none.
    """

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    data: memoryview
    size: int
    crc: int


def attachment_at(data: memoryview, start: int, length: int) -> Attachment:
    """Find an attachment's fields; its bytes are not touched."""
    record = data[start : start + length]
    log_time_ns, create_time_ns = _TIMES.unpack_from(record)
    name, place = _text(record, start, _TIMES.size)
    media_type, place = _text(record, start, place)
    size = int.from_bytes(record[place : place + 8], "little")
    place += 8
    if place + size + 4 > length:
        raise DamageError(start, f"an attachment says it has {size} bytes; its record has {length}")
    end = place + size
    crc = int.from_bytes(record[end : end + 4], "little")
    return Attachment(name, media_type, log_time_ns, create_time_ns, record[place:end], end, crc)


def _text(record: memoryview, start: int, place: int) -> tuple[str, int]:
    end = place + 4 + int.from_bytes(record[place : place + 4], "little")
    if end > len(record):
        raise DamageError(start, f"a text of an attachment says it ends {end - len(record)} bytes behind it")
    return bytes(record[place + 4 : end]).decode("utf-8", "replace"), end


def attachment_damages(data: memoryview, places: Sequence[tuple[int, int]]) -> list[Damage]:
    """Check the checksums of attachments."""
    damages = []
    for start, length in places:
        attachment = attachment_at(data, start, length)
        if attachment.crc and zlib_ng.crc32(data[start : start + attachment.size]) != attachment.crc:
            damages.append(Damage(start, "the checksum of an attachment is not that of its bytes"))
    return damages
