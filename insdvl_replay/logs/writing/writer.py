"""Columns become messages, and these a log: MCAP with the profile ``ros2``, indexed, compressed, always the same bytes.

`dive_log` and `replay_log` say what goes where: a `Batch` names for each column the field that it fills. Messages of
all topics stand in the order of their times of validity. Source: https://mcap.dev/spec.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.layout import layout_for_texts
from insdvl_replay.logs.encoding.ros2msg import Definition, definition_text, parse_definitions
from insdvl_replay.logs.writing.log_file import IndexedChunk, LogFile

NED: Final = "ned"
IMU: Final = "imu"
DVL: Final = "dvl"
ODOM: Final = "odom"
BASE_LINK: Final = "base_link"
FRAMES: Final = {
    NED: "north-east-down at the vehicle",
    IMU: "the body: forward-starboard-down at the IMU",
    DVL: "the DVL: forward-starboard-down of the instrument",
    ODOM: "east-north-up at the first position",
    BASE_LINK: "the body with the axes forward-port-up",
}
"""What the names in ``frame_id`` mean."""


@dataclass(frozen=True)
class InUnit:
    """A column in another unit, which is converted as it is written: a copy would take as much memory as the history.

    The values, shape (k,) or (k, n), are SI; the unit is one of the other in SI.
    """

    values: Floats
    unit: float

    def __getitem__(self, rows: slice) -> Floats:
        """Return some rows in the unit."""
        return self.values[rows] / self.unit


Column = NDArray[Any] | InUnit | str | float | tuple[float, ...]
"""Values of one field: an array with one row per message, or what all messages share."""


@dataclass(frozen=True)
class Batch:
    """Messages of one topic whose strings are the same, as columns by the path of the field; others stay zero.

    Times of validity, shape (k,), do not decrease.
    """

    topic: str
    type_name: str
    time_ns: TimeNs
    columns: Mapping[str, Column]


def stamped(topic: str, type_name: str, time_ns: TimeNs, frame: str, columns: Mapping[str, Column]) -> Batch:
    """Make a batch of messages that begin with a header, whose frame is one of `FRAMES`."""
    return Batch(topic, type_name, time_ns, {**stamp("header.stamp", time_ns), "header.frame_id": frame, **columns})


def stamp(path: str, time_ns: TimeNs) -> dict[str, Column]:
    """Fill the builtin_interfaces/Time at a path."""
    seconds, nanoseconds = np.divmod(time_ns, NS_PER_S)
    return {f"{path}.sec": seconds.astype(np.int32), f"{path}.nanosec": nanoseconds.astype(np.uint32)}


def xyz(path: str, vectors: Floats) -> dict[str, Column]:
    """Fill the geometry_msgs/Vector3 or Point at a path with vectors, shape (k, 3)."""
    return {f"{path}.{axis}": vectors[:, i] for i, axis in enumerate("xyz")}


def missing_xyz(path: str) -> dict[str, Column]:
    """Fill a geometry_msgs/Vector3 with NaN, for what is not known."""
    return {f"{path}.{axis}": np.nan for axis in "xyz"}


def solution(position: Floats, velocity_n: Floats, rpy: Floats) -> dict[str, Column]:
    """Fill the fields that insdvl_msgs/NavSolution and FilterState share.

    Positions, shape (k, 3), are latitude rad, longitude rad, height m; roll, pitch and heading rad.
    """
    latitude_deg, longitude_deg = np.rad2deg(position[:, :2]).T
    return {
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "height_m": position[:, 2],
        "velocity_ned_mps": velocity_n,
        **angles(rpy),
    }


def angles(rpy: Floats) -> dict[str, Column]:
    """Fill roll, pitch and heading, shape (k, 3), rad."""
    roll_deg, pitch_deg, heading_deg = np.rad2deg(rpy).T
    return {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "heading_deg": heading_deg}


CHUNK_BYTES: Final = 1024 * 1024
"""A chunk is full with the message that exceeds this, before compression."""
_FRAME: Final = [("opcode", "u1"), ("length", "<u8")]
_HEAD: Final = [("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
_FRAME_BYTES: Final = np.dtype(_FRAME).itemsize


class MessageRecords:
    """The messages of a batch as records of a channel; it names no field that its type does not have."""

    def __init__(self, batch: Batch, channel: int) -> None:
        self.batch = batch
        self.channel = channel
        self._texts = {path: value.encode() for path, value in batch.columns.items() if isinstance(value, str)}
        self._layout = layout_for_texts(_definitions(batch.type_name), batch.type_name, self._texts)
        self._dtype = np.dtype([*_FRAME, *_HEAD, ("message", f"V{self._layout.size}")])

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return self._dtype.itemsize

    def rows(self, rows: slice) -> list[bytes]:
        """Return the records of some messages."""
        time_ns = self.batch.time_ns[rows]
        records = np.zeros(len(time_ns), dtype=self._dtype)
        records["opcode"], records["length"] = Opcode.MESSAGE, self.size - _FRAME_BYTES
        records["channel"] = self.channel
        records["log_time"] = records["publish_time"] = time_ns
        messages = self._layout.new_messages(len(time_ns))
        for path, column in self.batch.columns.items():
            value: Any = self._texts.get(path, column)
            messages[path] = value[rows] if isinstance(value, np.ndarray | InUnit) else value
        records["message"] = messages.view(f"V{self._layout.size}")
        as_bytes: list[bytes] = records.view(f"V{self.size}").tolist()
        return as_bytes


def in_chunks(batches: Sequence[MessageRecords], head: bytes) -> Iterator[IndexedChunk]:
    """Put the messages of all batches in the order of their times, and cut them into chunks.

    The messages of a batch in one chunk are neighbours in the batch: they are laid out together and then dealt out.
    """
    time_ns, batch_of = _in_order(batches)
    channels = np.array([records.channel for records in batches])
    sizes = np.array([records.size for records in batches])
    done = np.zeros(len(batches), dtype=np.int64)
    for inside in _cuts(np.cumsum(sizes[batch_of]), len(head)):
        own = np.bincount(batch_of[inside], minlength=len(batches))
        by_batch = [
            record
            for number in np.flatnonzero(own).tolist()
            for record in batches[number].rows(slice(done[number], done[number] + own[number]))
        ]
        place = np.argsort(np.argsort(batch_of[inside], kind="stable"))
        data = head + b"".join([by_batch[i] for i in place.tolist()])
        size = sizes[batch_of[inside]]
        offset = len(head) + np.cumsum(size) - size
        yield IndexedChunk(data, channels[batch_of[inside]], time_ns[inside], offset)
        done += own
        head = b""


def _in_order(batches: Sequence[MessageRecords]) -> tuple[TimeNs, NDArray[np.int32]]:
    """Return the times of all messages in their order, and the batch that each is of."""
    time_ns = np.concatenate([records.batch.time_ns for records in batches])
    batch_of = np.repeat(np.arange(len(batches), dtype=np.int32), [len(records.batch.time_ns) for records in batches])
    order = np.argsort(time_ns, kind="stable")
    return time_ns[order], batch_of[order]


def _cuts(ends: NDArray[np.int64], head_bytes: int) -> Iterator[slice]:
    """Return the messages of each chunk by where each message ends."""
    begin, before = 0, -head_bytes
    while begin < len(ends):
        end = min(int(np.searchsorted(ends, before + CHUNK_BYTES, side="right")) + 1, len(ends))
        yield slice(begin, end)
        begin, before = end, int(ends[end - 1])


@cache
def _definitions(type_name: str) -> dict[str, Definition]:
    return parse_definitions(type_name, definition_text(type_name))


LIBRARY: Final = "insdvl-replay"
_STAMP_POLICY: Final = "log_time = publish_time = header.stamp = time of validity"

# No profile at all is the one value that every release of rosbag2 reads.
_QOS: Final = {"offered_qos_profiles": ""}
_MAX_TIME_NS: Final = (2**31 - 1) * 1_000_000_000


def write_log(
    path: Path,
    batches: Sequence[Batch],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]] | None = None,
) -> None:
    """Write messages to a log; it appears under its name when it is complete."""
    for batch in batches:
        _check_times(batch)
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as stream:
            _write(stream, batches, metadata, attachments or {})
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


def _write(
    stream: BinaryIO,
    batches: Sequence[Batch],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> None:
    log = LogFile(stream, profile="ros2", library=LIBRARY)
    frames = {f"frame.{name}": meaning for name, meaning in FRAMES.items()}
    log.add_metadata("insdvl_replay", {**metadata, **frames, "stamps": _STAMP_POLICY})
    records = _registered(log, batches)
    for chunk in in_chunks(records, log.registrations()):
        log.add_chunk(chunk)
    for name, (media_type, content) in attachments.items():
        log.add_attachment(name, media_type, content)
    log.finish()


def _registered(log: LogFile, batches: Sequence[Batch]) -> list[MessageRecords]:
    """Return each type a schema and each topic a channel."""
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for batch in batches:
        if batch.type_name not in schemas:
            text = definition_text(batch.type_name).encode()
            schemas[batch.type_name] = log.add_schema(batch.type_name, "ros2msg", text)
        if batch.topic not in channels:
            channels[batch.topic] = log.add_channel(batch.topic, "cdr", schemas[batch.type_name], _QOS)
    return [MessageRecords(batch, channels[batch.topic]) for batch in batches]


def _check_times(batch: Batch) -> None:
    time_ns = batch.time_ns
    if np.any(np.diff(time_ns) < 0):
        raise ValueError(f"the times of {batch.topic} decrease")
    for time in time_ns[:1].tolist() + time_ns[-1:].tolist():
        if not 0 <= time <= _MAX_TIME_NS:
            raise LogError(
                f"{batch.topic}: time {time} ns does not fit a ROS stamp, which counts 0 to 2147483647 s",
                "choose another clock, for example --set imu.stamp=log_time --set dvl.stamp=log_time",
            )
