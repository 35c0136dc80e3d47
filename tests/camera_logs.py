"""Logs in which a camera fills most chunks, as some recorders write them: each chunk has sensors, or pictures."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

CAMERA = "/camera/image"


def with_camera(
    path: Path,
    dive: bytes,
    picture_bytes: int,
    pictures: int,
    *,
    messages_between: int = 50,
) -> None:
    """Write the messages of a dive with pictures after some of them, in chunks of their own."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType.NONE)
        writer.start("ros2", "camera logs")
        close_chunk: Callable[[], Any] = getattr(writer, "_Writer__finalize_chunk")  # noqa: B009
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data")
        camera = writer.register_channel(CAMERA, "cdr", schema)
        ids: dict[int, int] = {}
        content = bytes(picture_bytes)
        left = pictures
        for number, (type_, channel, message) in enumerate(
            make_reader(BytesIO(dive)).iter_messages()
        ):
            if channel.id not in ids:
                assert type_ is not None
                known = writer.register_schema(type_.name, type_.encoding, type_.data)
                ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known, channel.metadata
                )
            writer.add_message(
                ids[channel.id], message.log_time, message.data, message.publish_time
            )
            if number % messages_between == 0 and left:
                close_chunk()
                writer.add_message(camera, message.log_time, content, message.publish_time)
                close_chunk()
                left -= 1
        while left:
            writer.add_message(camera, message.log_time, content, message.publish_time)
            close_chunk()
            left -= 1
        writer.add_metadata("vehicle", {"name": "one"})
        writer.finish()
