"""Columns become an MCAP file with the profile ``ros2``, indexed and compressed; the same input gives the same bytes.

A `Batch` names the field that each column fills. Messages of all topics are in the order of their times of validity.
The mcap library frames all records; the messages of a chunk are serialised column by column. Source:
https://mcap.dev/spec.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import Definitions, definition_text, parse_definitions
from insdvl_replay.logs.formats.layout import layout_for_texts

LIBRARY: Final = "insdvl-replay"
CHUNK_BYTES: Final = 1024 * 1024  # a chunk is full with the message that exceeds this, before compression
FRAMES: Final = {
    "ned": "north-east-down at the vehicle",
    "imu": "the body: forward-starboard-down at the IMU",
    "dvl": "the DVL: forward-starboard-down of the instrument",
    "odom": "east-north-up at the first position",
    "base_link": "the body with the axes forward-port-up",
}
"""What the names in ``frame_id`` mean."""
NED, IMU, DVL, ODOM, BASE_LINK = FRAMES
_STAMP_POLICY: Final = "log_time = publish_time = header.stamp = time of validity"
_QOS: Final = {"offered_qos_profiles": ""}  # no profile at all is the one value that every release of rosbag2 reads
_LATEST_NS: Final = (2**31 - 1) * NS_PER_S
_RECORD_HEAD: Final = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]


Column = NDArray[Any] | str | float | tuple[float, ...]
"""Values of one field: an array with one row per message, or what all messages share."""


@dataclass(frozen=True)
class Batch:
    """Messages of one topic whose strings are the same."""

    topic: str
    type_name: str
    time_ns: TimeNs  # (k,), never decreasing
    columns: Mapping[str, Column]  # by the path of the field; other fields stay zero


def stamped(topic: str, type_name: str, time_ns: TimeNs, frame: str, columns: Mapping[str, Column]) -> Batch:
    """Make a batch of messages that begin with a header, whose frame is one of `FRAMES`."""
    return Batch(topic, type_name, time_ns, {**stamp("header.stamp", time_ns), "header.frame_id": frame, **columns})


def stamp(path: str, time_ns: TimeNs) -> dict[str, Column]:
    """Fill the builtin_interfaces/Time at a path."""
    seconds, nanoseconds = np.divmod(time_ns, NS_PER_S)
    return {f"{path}.sec": seconds.astype(np.int32), f"{path}.nanosec": nanoseconds.astype(np.uint32)}


def components(path: str, vectors: Floats | float, names: str = "xyz") -> dict[str, Column]:
    """Fill the components at a path with the columns of vectors, or all with one number."""
    columns: Sequence[Any] = [vectors] * len(names) if isinstance(vectors, float) else list(vectors.T)
    return {f"{path}.{name}": column for name, column in zip(names, columns, strict=True)}


@cache
def _definitions(type_name: str) -> Definitions:
    return parse_definitions(type_name, definition_text(type_name))


class _Messages:
    """The messages of a batch as records of a channel."""

    def __init__(self, batch: Batch, channel: int) -> None:
        self.batch = batch
        self.channel = channel
        self._texts = {path: value.encode() for path, value in batch.columns.items() if isinstance(value, str)}
        self._layout = layout_for_texts(_definitions(batch.type_name), batch.type_name, self._texts)
        self._dtype = np.dtype([*_RECORD_HEAD, ("message", f"V{self._layout.size}")])
        self.size = self._dtype.itemsize

    def records(self, rows: slice) -> list[bytes]:
        """Return the records of some messages."""
        time_ns = self.batch.time_ns[rows]
        records = np.zeros(len(time_ns), self._dtype)
        records["opcode"], records["length"], records["channel"] = Opcode.MESSAGE, self.size - 9, self.channel
        records["log_time"] = records["publish_time"] = time_ns
        messages = self._layout.new_messages(len(time_ns))
        for path, column in self.batch.columns.items():
            value: Any = self._texts.get(path, column)
            messages[path] = value[rows] if isinstance(value, np.ndarray) else value
        records["message"] = messages.view(f"V{self._layout.size}")
        as_bytes: list[bytes] = records.view(f"V{self.size}").tolist()
        return as_bytes


class _ColumnIndex(MessageIndex):
    """A message index whose entries, times and offsets, are the rows of an array."""

    def write(self, stream: RecordBuilder) -> None:
        """Write it as the library does, all entries at once."""
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(self.records) * 16)
        stream.write(np.asarray(self.records, "<u8").tobytes())
        stream.finish_record()  # type: ignore[no-untyped-call]


def write_log(
    path: Path,
    batches: Sequence[Batch],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]] | None = None,
) -> None:
    """Write messages to a log, which appears under its name when it is complete.

    Attachments are media type and content by name. A `LogError` where a time does not fit a ROS stamp.
    """
    for batch in batches:
        if np.any(np.diff(batch.time_ns) < 0):
            raise ValueError(f"the times of {batch.topic} decrease")
        for time in batch.time_ns[:1].tolist() + batch.time_ns[-1:].tolist():
            if not 0 <= time <= _LATEST_NS:
                raise LogError(
                    f"{batch.topic}: time {time} ns does not fit a ROS stamp, which counts 0 to 2147483647 s",
                    "choose another clock, for example --set imu.stamp=log_time --set dvl.stamp=log_time",
                )
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as stream:
            writer = Writer(stream)
            writer.start("ros2", LIBRARY)
            frames = {f"frame.{name}": meaning for name, meaning in FRAMES.items()}
            writer.add_metadata("insdvl_replay", {**metadata, **frames, "stamps": _STAMP_POLICY})
            schemas: dict[str, int] = {}
            channels: dict[str, int] = {}
            for topic, type_name in {batch.topic: batch.type_name for batch in batches}.items():
                if type_name not in schemas:
                    text = definition_text(type_name).encode()
                    schemas[type_name] = writer.register_schema(type_name, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schemas[type_name], _QOS)
            _write_messages(writer, [_Messages(batch, channels[batch.topic]) for batch in batches])
            for name, (media_type, content) in (attachments or {}).items():
                writer.add_attachment(0, 0, name, media_type, content)
            writer.finish()  # type: ignore[no-untyped-call]
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


def _write_messages(writer: Writer, batches: Sequence[_Messages]) -> None:
    """Write the messages of all batches in the order of their times, chunk by chunk.

    The library adds one message after another; its chunk and its statistics are filled here with many at once.
    """
    chunk, statistics = (vars(writer)[f"_Writer__{name}"] for name in ("chunk_builder", "statistics"))
    time_ns = np.concatenate([messages.batch.time_ns for messages in batches])
    batch_of = np.repeat(np.arange(len(batches), dtype=np.int32), [len(messages.batch.time_ns) for messages in batches])
    order = np.argsort(time_ns, kind="stable")
    time_ns, batch_of = time_ns[order], batch_of[order]
    channel = np.array([messages.channel for messages in batches])[batch_of]
    ends = np.cumsum(np.array([messages.size for messages in batches])[batch_of])
    for number, rows in _by_channel(channel):
        statistics.channel_message_counts[number] = len(rows)
    if len(time_ns):
        statistics.message_count = len(time_ns)
        statistics.message_start_time, statistics.message_end_time = int(time_ns[0]), int(time_ns[-1])

    begin, start, done = 0, 0, np.zeros(len(batches), np.int64)
    while begin < len(ends):
        head = chunk.count  # of the first chunk, the schemas and channels
        end = min(int(np.searchsorted(ends, start - head + CHUNK_BYTES, side="right")) + 1, len(ends))
        # The messages of a batch are neighbours there: they are serialised together and then dealt out.
        own = np.bincount(batch_of[begin:end], minlength=len(batches))
        records = [
            record
            for number in np.flatnonzero(own).tolist()
            for record in batches[number].records(slice(done[number], done[number] + own[number]))
        ]
        places = np.argsort(np.argsort(batch_of[begin:end], kind="stable")).tolist()
        chunk.record_writer.write(b"".join([records[place] for place in places]))
        offsets = np.append(start, ends[begin : end - 1]) - start + head
        for number, rows in _by_channel(channel[begin:end]):
            entries: Any = np.stack([time_ns[begin:end][rows], offsets[rows]], axis=1)
            chunk.message_indices[number] = _ColumnIndex(number, entries)
        chunk.num_messages = end - begin
        chunk.message_start_time, chunk.message_end_time = int(time_ns[begin]), int(time_ns[end - 1])
        writer.flush()  # type: ignore[no-untyped-call]
        begin, start, done = end, int(ends[end - 1]), done + own


def _by_channel(channel: NDArray[np.int64]) -> list[tuple[int, NDArray[np.intp]]]:
    """Return the channels in the order of their first messages, each with the rows of all its messages."""
    numbers, first = np.unique(channel, return_index=True)
    return [(number, np.flatnonzero(channel == number)) for number in numbers[np.argsort(first)].tolist()]
