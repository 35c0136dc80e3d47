"""One channel of a log: its topic, and how its messages are encoded."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mcap import records


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
    """Give the channels of each topic."""
    topics: dict[str, list[LogChannel]] = {}
    for channel in channels:
        topics.setdefault(channel.topic, []).append(channel)
    return topics
