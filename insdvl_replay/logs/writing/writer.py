"""Batches become a log: MCAP with the profile ``ros2``, indexed, compressed, checked, and the same bytes every time.

Messages of all topics stand in the order of their times of validity. Source: https://mcap.dev/spec.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.ros2msg import definition_text
from insdvl_replay.logs.writing.log_file import LogFile
from insdvl_replay.logs.writing.message_records import MessageRecords, in_chunks
from insdvl_replay.logs.writing.messages import FRAMES, Batch

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
    """Give each type a schema and each topic a channel."""
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
