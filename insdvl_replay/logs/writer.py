"""Batches become a log: MCAP with the profile ``ros2``, indexed, compressed, checked, and the same bytes every time.

Messages of all topics stand in the order of their times of validity. Source: https://mcap.dev/spec.
"""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from insdvl_replay.errors import LogError
from insdvl_replay.logs.layout import layout_for_texts
from insdvl_replay.logs.messages import FRAMES, Batch
from insdvl_replay.logs.ros2msg import Definition, definition_text, parse_definitions

LIBRARY: Final = "insdvl-replay"
_STAMP_POLICY: Final = "log_time = publish_time = header.stamp = time of validity"
# No profile at all is the one value that every release of rosbag2 reads.
_QOS: Final = {"offered_qos_profiles": ""}
_ROWS_AT_ONCE: Final = 4096
_MAX_TIME_NS: Final = (2**31 - 1) * 1_000_000_000


def write_log(
    path: Path,
    batches: Sequence[Batch],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]] | None = None,
) -> None:
    """Write messages to a log; it appears under its name when it is complete.

    Parameters
    ----------
    path : Path
    batches : sequence of Batch
        Batches of the same topic share its channel.
    metadata : mapping of str to str
        Becomes the record ``insdvl_replay``, beside the meaning of the frames and the stamps.
    attachments : mapping of str to (str, bytes), optional
        Media type and content by name.

    Raises
    ------
    LogError
        A time does not fit the 32-bit seconds of a ROS stamp.
    OSError
        The file cannot be written.
    ValueError
        The times of a batch decrease, or it names a field that its type does not have.
    """
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
    writer = Writer(stream)
    writer.start(profile="ros2", library=LIBRARY)
    frames = {f"frame.{name}": meaning for name, meaning in FRAMES.items()}
    writer.add_metadata("insdvl_replay", {**metadata, **frames, "stamps": _STAMP_POLICY})
    channels = _register(writer, batches)
    streams = [_serialised(batch, channels[batch.topic]) for batch in batches]
    for time_ns, channel, payload in heapq.merge(*streams, key=itemgetter(0)):
        writer.add_message(channel_id=channel, log_time=time_ns, publish_time=time_ns, data=payload)
    for name, (media_type, content) in attachments.items():
        writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)
    writer.finish()  # type: ignore[no-untyped-call]


def _register(writer: Writer, batches: Sequence[Batch]) -> dict[str, int]:
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for batch in batches:
        if batch.type_name not in schemas:
            text = definition_text(batch.type_name).encode()
            schemas[batch.type_name] = writer.register_schema(batch.type_name, "ros2msg", text)
        if batch.topic not in channels:
            channels[batch.topic] = writer.register_channel(batch.topic, "cdr", schemas[batch.type_name], _QOS)
    return channels


def _serialised(batch: Batch, channel: int) -> Iterator[tuple[int, int, bytes]]:
    """Give time, channel and payload of each message, serialising some thousand at once."""
    for start in range(0, len(batch.time_ns), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        messages = serialise(batch, rows)
        size, data = messages.itemsize, messages.tobytes()
        for i, time_ns in enumerate(batch.time_ns[rows].tolist()):
            yield time_ns, channel, data[i * size : (i + 1) * size]


def serialise(batch: Batch, rows: slice) -> NDArray[np.void]:
    """Lay some messages of a batch out as CDR.

    Parameters
    ----------
    batch : Batch
    rows : slice
        Which of its messages.

    Returns
    -------
    ndarray of structures
        Each the bytes of one message.
    """
    texts = {path: value.encode() for path, value in batch.columns.items() if isinstance(value, str)}
    layout = layout_for_texts(_definitions(batch.type_name), batch.type_name, texts)
    messages = layout.new_messages(len(batch.time_ns[rows]))
    for path, column in batch.columns.items():
        value: Any = texts.get(path, column)
        messages[path] = value[rows] if isinstance(value, np.ndarray) else value
    return messages


@cache
def _definitions(type_name: str) -> dict[str, Definition]:
    return parse_definitions(type_name, definition_text(type_name))


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
