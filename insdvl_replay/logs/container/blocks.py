"""The messages of one channel in one open chunk, as columns.

What stands in front of a payload is read only where somebody asks for it, in one step for all messages.
Source: the MCAP specification, https://mcap.dev/spec.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.core.columns import TimeNs, is_new
from insdvl_replay.logs.container.records import MESSAGE_FIELDS_SIZE, Records


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
    schema_text : str
        The schema; may be empty.
    messages : int
        How many messages are found.
    schema_data : bytes
        The schema as it stands in the log; protobuf's are no text.
    metadata : mapping of str to str
        What the recorder wrote beside it.
    """

    id: int
    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    schema_text: str
    messages: int
    schema_data: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=dict)


def described(channel: records.Channel, schema: records.Schema | None, messages: int) -> LogChannel:
    """Describe a channel by its records."""
    return LogChannel(
        id=channel.id,
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema_text=schema.data.decode("utf-8", "replace") if schema else "",
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


MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""What stands in front of the payload of a message record."""
_PLACES: Final = {name: (field[0], field[1]) for name, field in (MESSAGE.fields or {}).items()}


@dataclass(frozen=True)
class Block:
    """The messages of one channel in one chunk, in the order of the file.

    Attributes
    ----------
    channel_id : int
        Their channel.
    buffer : memoryview
        Bytes of the open chunk.
    starts, lengths : ndarray, shape (k,)
        Where in the buffer their records start, and how long the contents of these are.
    """

    channel_id: int
    buffer: memoryview
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.starts.size)

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Where in the buffer each message's payload starts, shape (k,)."""
        return self.starts + MESSAGE.itemsize

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """How many bytes each message's payload has, shape (k,)."""
        return self.lengths - MESSAGE_FIELDS_SIZE

    @cached_property
    def log_time(self) -> TimeNs:
        """When each message was recorded, shape (k,), ns."""
        return message_field(self.buffer, self.starts, "log_time")

    @cached_property
    def publish_time(self) -> TimeNs:
        """When each message was published, shape (k,), ns."""
        return message_field(self.buffer, self.starts, "publish_time")

    def part(self, rows: slice) -> "Block":
        """Return some of the messages."""
        return replace(self, starts=self.starts[rows], lengths=self.lengths[rows])


def by_channel(buffer: memoryview, records: Records) -> dict[int, Block]:
    """Part the messages among records by their channels."""
    messages = records.where(records.opcodes == Opcode.MESSAGE)
    ids = message_field(buffer, messages.starts, "channel_id")
    order = np.argsort(ids, kind="stable")
    ids, starts, lengths = ids[order], messages.starts[order], messages.lengths[order]
    edges = [*np.flatnonzero(is_new(ids)).tolist(), ids.size]
    blocks = [Block(int(ids[first]), buffer, starts[first:end], lengths[first:end]) for first, end in pairwise(edges)]
    return {block.channel_id: block for block in blocks}


def gather(buffer: memoryview | NDArray[np.uint8], offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy a structure from many places of a buffer.

    Parameters
    ----------
    offsets : ndarray, shape (k,)
        Where each structure starts; each must end within the buffer.

    Returns
    -------
    ndarray, shape (k,), of `dtype`
    """
    if not offsets.size:
        return np.empty(0, dtype)
    places = len(buffer) - dtype.itemsize + 1
    # As mere bytes, structures are copied six times as fast.
    copied: Any = dtype if dtype.fields is None else (np.void, dtype.itemsize)
    windows: NDArray[Any] = np.ndarray((places,), copied, buffer, strides=(1,))
    return windows[offsets].view(dtype)


def message_field(buffer: memoryview, starts: NDArray[np.int64], name: str) -> NDArray[Any]:
    """Read what stands in front of the payloads of messages.

    Parameters
    ----------
    starts : ndarray, shape (k,)
        Where the message records start.
    name : str
        A field of `MESSAGE`.

    Returns
    -------
    ndarray, shape (k,)
    """
    dtype, place = _PLACES[name]
    return gather(buffer, starts + place, dtype)
