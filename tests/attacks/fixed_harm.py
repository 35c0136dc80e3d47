"""What a log says, changed as a wrong recorder or somebody with a purpose would; the file around it is right."""

import re
import struct
from collections.abc import Callable
from dataclasses import replace
from random import Random

from content import Content, content_of, file_of
from mcap import records

Harm = Callable[[Content, Random], None]

NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e-320, 0.0, 1e9, -1.0)
TIMES = (0, 1, 2**31, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
TEXTS = (
    "",
    "/",
    "../../../etc/passwd",
    "\x1b]0;title\x07\x1b[31m",
    "a\n::error file=x::y",
    "a\r\nb\x00c",
    "<script>alert(1)</script>",
    "=HYPERLINK(1)",
    "\u202eevil",
    "a" * 5000,
)
JSON_VALUES = (
    "NaN",
    "Infinity",
    "1e999",
    "null",
    '"x"',
    "[]",
    "{}",
    "-0",
    "9" * 400,
    "[" * 200 + "]" * 200,
    "true",
)
FIELD = re.compile(
    rb"\b(float64|float32|int32|uint32|uint8|uint16|int16|bool|string)(\[[0-9]*\])?(?= )"
)
FIELD_TYPES = (
    b"float32",
    b"float64",
    b"string",
    b"float64[]",
    b"float64[3]",
    b"float64[4000000]",
    b"acme/Missing",
)
FIELD_TYPES += (b"int8", b"wstring", b"string<=3", b"float64[<=2]", b"float64[-1]")


def _chosen(content: Content, rng: Random) -> list[int]:
    """Choose messages of a channel: one, a stretch, a share or all of them."""
    by_channel: dict[int, list[int]] = {}
    for place, message in enumerate(content.messages):
        by_channel.setdefault(message.channel_id, []).append(place)
    if not by_channel:
        return []
    places = by_channel[rng.choice(sorted(by_channel))]
    start = rng.randrange(len(places))
    some = places[start : start + max(len(places) // 3, 1)]
    share = [place for place in places if rng.random() < 0.3] or places[:1]
    return rng.choice(([places[start]], some, share, places))


def drop(content: Content, rng: Random) -> None:
    """Lose messages before they were recorded."""
    gone = set(_chosen(content, rng))
    content.messages = [one for place, one in enumerate(content.messages) if place not in gone]


def repeat(content: Content, rng: Random) -> None:
    """Record messages twice."""
    twice = set(_chosen(content, rng))
    content.messages = [
        one for place, one in enumerate(content.messages) for _ in range(1 + (place in twice))
    ]


def reorder(content: Content, rng: Random) -> None:
    """Record messages in another order."""
    start = rng.randrange(max(len(content.messages), 1))
    end = start + rng.choice((2, 50, len(content.messages)))
    span = content.messages[start:end]
    rng.shuffle(span)
    content.messages[start:end] = span


def change_log_times(content: Content, rng: Random) -> None:
    """Set or shift the times at which messages were recorded."""
    fixed, shift = (
        rng.choice((*TIMES, None, None, None)),
        rng.choice((-(10**9), 10**7, 10**9, 10**13, -(10**18))),
    )
    for place in _chosen(content, rng):
        message = content.messages[place]
        time_ns = (message.log_time + shift) % 2**64 if fixed is None else fixed
        content.messages[place] = replace(message, log_time=time_ns, publish_time=time_ns)


def _change_payloads(content: Content, rng: Random, change: Callable[[bytes], bytes]) -> None:
    for place in _chosen(content, rng):
        content.messages[place] = replace(
            content.messages[place], data=change(content.messages[place].data)
        )


def change_numbers(content: Content, rng: Random) -> None:
    """Write a number where CDR may have a double."""
    number, where = struct.pack("<d", rng.choice(NUMBERS)), rng.random()

    def change(data: bytes) -> bytes:
        places = range(4 + (len(data) - 4) % 8, len(data) - 7, 8)
        place = places[int(where * len(places))] if places else 0
        return data[:place] + number[: len(data)] + data[place + 8 :]

    _change_payloads(content, rng, change)


def change_all_numbers(content: Content, rng: Random) -> None:
    """Write not-a-number over the last half of payloads, as a driver does that has no solution."""
    number = struct.pack("<d", rng.choice(NUMBERS))

    def change(data: bytes) -> bytes:
        count = len(data) // 16
        return data[: len(data) - 8 * count] + number * count

    _change_payloads(content, rng, change)


def change_stamps(content: Content, rng: Random) -> None:
    """Set the first eight bytes of CDR, a header's stamp."""
    sec, nanosec = (
        rng.choice((0, 1, 2**31 - 1, -(2**31), -1, 1_700_000_000)),
        rng.choice((0, 5, 10**9, 2**32 - 1)),
    )
    stamp = struct.pack("<iI", sec, nanosec)
    _change_payloads(content, rng, lambda data: data[:4] + stamp + data[12:])


def change_size(content: Content, rng: Random) -> None:
    """Cut payloads, or put something behind them."""
    keep, more = (
        rng.choice((0, 1, 3, 4, 5, 12, 40, 10**6)),
        rng.choice((b"", b"", b"\0", bytes(100))),
    )
    _change_payloads(content, rng, lambda data: data[:keep] + more)


def change_bytes(content: Content, rng: Random) -> None:
    """Flip bits of payloads: lengths of strings and sequences, keys of protobuf, brackets of JSON."""
    where, bit = rng.random(), 1 << rng.randrange(8)

    def change(data: bytes) -> bytes:
        place = int(where * len(data))
        return data[:place] + bytes([data[place] ^ bit]) + data[place + 1 :] if data else data

    _change_payloads(content, rng, change)


def change_lengths(content: Content, rng: Random) -> None:
    """Write a length over four aligned bytes of payloads."""
    where, length = rng.random(), struct.pack("<I", rng.choice((0, 1, 2**16, 2**31, 2**32 - 1)))

    def change(data: bytes) -> bytes:
        place = int(where * len(data)) // 4 * 4
        return data[:place] + length + data[place + 4 :]

    _change_payloads(content, rng, change)


def change_json(content: Content, rng: Random) -> None:
    """Write something else for a number of JSON; payloads without any lose their first half."""
    value, which = rng.choice(JSON_VALUES).encode(), rng.randrange(8)

    def change(data: bytes) -> bytes:
        numbers = (
            list(re.finditer(rb"-?[0-9]+\.?[0-9]*(e-?[0-9]+)?", data)) if data[:1] == b"{" else []
        )
        if not numbers:
            return data[len(data) // 2 :]
        number = numbers[which % len(numbers)]
        return data[: number.start()] + value + data[number.end() :]

    _change_payloads(content, rng, change)


def change_channel_ids(content: Content, rng: Random) -> None:
    """Record messages on another channel, or on one that nobody described."""
    other = rng.choice([*(channel.id for channel in content.channels), 0, 999, 65535])
    for place in _chosen(content, rng):
        content.messages[place] = replace(content.messages[place], channel_id=other)


def change_channel(content: Content, rng: Random) -> None:
    """Describe a channel otherwise."""
    place = rng.randrange(len(content.channels))
    changes = (
        {"topic": rng.choice((*TEXTS, rng.choice(content.channels).topic))},
        {"message_encoding": rng.choice(("cdr", "json", "protobuf", "ros1", "", *TEXTS))},
        {"schema_id": rng.choice((0, 999, *(schema.id for schema in content.schemas)))},
        {"metadata": {rng.choice(TEXTS): rng.choice(TEXTS)}},
        {"id": rng.choice([0, 65535, *(channel.id for channel in content.channels)])},
    )
    content.channels[place] = replace(content.channels[place], **rng.choice(changes))


def repeat_channel(content: Content, rng: Random) -> None:
    """Describe a channel twice: the same, otherwise, or under another number."""
    channel = rng.choice(content.channels)
    changes = (
        {},
        {"id": channel.id + 100},
        {"topic": "/other"},
        {"schema_id": rng.choice(content.channels).schema_id},
    )
    content.channels.append(replace(channel, **rng.choice(changes)))


def forget(content: Content, rng: Random) -> None:
    """Leave out the description of a channel or of a type."""
    part = rng.choice([part for part in (content.channels, content.schemas) if part] or [[]])
    if part:
        del part[rng.randrange(len(part))]


def change_schema(content: Content, rng: Random) -> None:
    """Describe a type otherwise, or call it otherwise."""
    if not content.schemas:
        return
    place = rng.randrange(len(content.schemas))
    schema = content.schemas[place]
    start = rng.randrange(len(schema.data) + 1)
    changes = (
        {"name": rng.choice((*TEXTS, "sensor_msgs/msg/Imu", rng.choice(content.schemas).name))},
        {"encoding": rng.choice(("ros2msg", "ros2idl", "jsonschema", "protobuf", "", *TEXTS))},
        {"data": schema.data[:start]},
        {"data": schema.data[:start] + rng.randbytes(4) + schema.data[start + 4 :]},
        {"data": schema.data * rng.choice((2, 50))},
        {"data": rng.choice(content.schemas).data},
        {"data": b"" if rng.random() < 0.5 else rng.randbytes(200)},
        {"id": rng.choice((0, 65535, rng.choice(content.schemas).id))},
    )
    content.schemas[place] = replace(schema, **rng.choice(changes))


def change_field_type(content: Content, rng: Random) -> None:
    """Give a field of a ROS type another type."""
    known = [place for place, schema in enumerate(content.schemas) if FIELD.search(schema.data)]
    if not known:
        return change_schema(content, rng)
    place = rng.choice(known)
    schema = content.schemas[place]
    match = rng.choice(list(FIELD.finditer(schema.data)))
    data = schema.data[: match.start()] + rng.choice(FIELD_TYPES) + schema.data[match.end() :]
    content.schemas[place] = replace(schema, data=data)


def add_others(content: Content, rng: Random) -> None:
    """Put attachments and metadata with strange names and times beside the messages."""
    name, time_ns = rng.choice(TEXTS), rng.choice(TIMES)
    content.others.append(
        records.Attachment(time_ns, time_ns, name, rng.choice(TEXTS), rng.randbytes(50))
    )
    content.others.append(
        records.Metadata(rng.choice((*TEXTS, "insdvl_replay")), {rng.choice(TEXTS): name})
    )
    content.header = records.Header(rng.choice(("ros2", "ros1", *TEXTS)), rng.choice(TEXTS))


def harm_chunk(content: Content, rng: Random) -> None:
    """Change a byte of a chunk before it is packed and its checksum is taken."""
    chunk, where, new = (
        rng.randrange(3),
        rng.random(),
        rng.choice((0, 1, 5, 255, rng.randrange(256))),
    )

    def change(number: int, data: bytes) -> bytes:
        place = int(where * min(len(data), 6000 if number == 0 else len(data)))
        return data[:place] + bytes([new]) + data[place + 1 :] if number == chunk else data

    content.harm_chunk = change


def harm_summary(content: Content, rng: Random) -> None:
    """Change bytes of the summary before its checksum is taken."""
    where, new = (
        rng.random(),
        rng.choice((b"\0", b"\xff", bytes(8), b"\xff" * 8, rng.randbytes(2))),
    )

    def change(data: bytes) -> bytes:
        place = int(where * len(data))
        return (data[:place] + new + data[place + len(new) :])[: len(data)]

    content.harm_summary = change


HARMS: tuple[Harm, ...] = (
    *(
        drop,
        repeat,
        reorder,
        change_log_times,
        change_numbers,
        change_all_numbers,
        change_stamps,
        change_size,
    ),
    *(
        change_bytes,
        change_lengths,
        change_json,
        change_channel_ids,
        change_channel,
        repeat_channel,
        forget,
    ),
    *(change_schema, change_field_type, add_others, harm_chunk, harm_summary),
)


def harmed(data: bytes, rng: Random) -> tuple[str, bytes]:
    """Change a log in one way, and one time in four in two or three.

    Returns
    -------
    str
        What was done.
    bytes
    """
    content, names = content_of(data), []
    for _ in range(rng.choice((1, 1, 1, 1, 1, 1, 2, 3))):
        harm = rng.choice(
            [
                one
                for one in HARMS
                if content.channels or one not in (change_channel, repeat_channel)
            ]
        )
        harm(content, rng)
        names.append(harm.__name__)
    return " + ".join(names), file_of(content)
