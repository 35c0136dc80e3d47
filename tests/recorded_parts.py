"""Parts of a dive, as recorders wrote them into several files."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from small_logs import START_NS, written

Choice = Callable[[str, float], bool]


def write_part(path: Path, chosen: Choice, remark: bytes = b"", log: bytes = b"") -> Path:
    """Write those messages of the dive, or of another log, that are chosen, with a remark in their schemas."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=15_000)
    writer.start(profile="ros2")
    ids: dict[str, int] = {}
    for schema, channel, message in make_reader(BytesIO(log or written())).iter_messages():
        assert schema
        if chosen(channel.topic, (message.log_time - START_NS) * 1e-9):
            if channel.topic not in ids:
                schema_id = writer.register_schema(
                    schema.name, schema.encoding, remark + schema.data
                )
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            writer.add_message(
                ids[channel.topic], message.log_time, message.data, message.publish_time
            )
    writer.finish()
    path.write_bytes(stream.getvalue())
    return path
