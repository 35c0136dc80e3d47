"""JSON5 is read as pyjson5 and the specification's own example say; schemas of a first message are not believed."""

import json
import math
import time

import numpy as np
import pytest
from blocks import block_of

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.decoded import JsonReader, as_json, without_nan

EXAMPLE = r"""{
  // comments
  unquoted: 'and you can quote me on that',
  singleQuotes: 'I can use "double quotes" here',
  lineBreaks: "Look, Mom! \
No \\n's!",
  hexadecimal: 0xdecaf,
  leadingDecimalPoint: .8675309, andTrailing: 8675309.,
  positiveSign: +1,
  trailingComma: 'in objects', andIn: ['arrays',],
  "backwardsCompatible": "with JSON",
}"""
"""Of https://spec.json5.org, section 1.3."""
VALUES = {
    "unquoted": "and you can quote me on that",
    "singleQuotes": 'I can use "double quotes" here',
    "lineBreaks": "Look, Mom! No \\n's!",
    "hexadecimal": 0xDECAF,
    "leadingDecimalPoint": 0.8675309,
    "andTrailing": 8675309.0,
    "positiveSign": 1,
    "trailingComma": "in objects",
    "andIn": ["arrays"],
    "backwardsCompatible": "with JSON",
}


CASES = [
    (EXAMPLE, VALUES),
    ("[NaN, -Infinity, +NaN, 1]", [None, None, None, 1]),
    ("[-.5, 5.e3, -0x1F, 1e-3]", [-0.5, 5000.0, -31, 1e-3]),
    ("{a: {b: [1, 2, /* three */ 3,], },}", {"a": {"b": [1, 2, 3]}}),
    ("""['it\\'s', '\\x41', "NaN: [\\""]""", ["it's", "A", 'NaN: ["']),
    ('{"// no comment": "/* neither */"}', {"// no comment": "/* neither */"}),
]


def test_values_are_those_of_the_specification_and_json_stays_what_it_is() -> None:
    for text, value in CASES:
        assert json.loads(as_json(text)) == value
    for value in (VALUES, [1.5, -2, 1e300, "a\n\u00e4"], {"deep": [[[{}]]]}, "text", None):
        assert json.loads(as_json(json.dumps(value))) == value


def test_what_is_neither_is_refused() -> None:
    for text in ("{", "{a 1}", "[1 2]", "{a: 0xfffffffffffffffffffff", "'", "/*", "\\"):
        with pytest.raises(LogError, match="is neither JSON nor JSON5"):
            JsonReader("M", b"", ["a"]).columns(block_of([text.encode()]))


def test_hostile_messages_take_time_by_their_length() -> None:
    def took_s(piece: str, count: int) -> float:
        begun = time.process_time()
        as_json(piece * count)
        without_nan(b":" + (piece * count).encode())
        return time.process_time() - begun

    took_s("a", 1000)
    for piece in ("/*", '"', "[", "0x", "\\", "-", "a"):
        # Quadratic work would take 400 times as long; a hundred leave room for a busy machine.
        assert took_s(piece, 200_000) < 100 * max(took_s(piece, 10_000), 2e-3), piece


def test_columns_of_what_blueos_records() -> None:
    """NaN in a number, a name without quotes, and a schema of a first message with null and whole numbers."""
    schema = {
        "type": "object",
        "properties": {
            "message": {
                "type": "object",
                "properties": {"type": {"type": "string"}, "x": {"type": "null"}, "y": {"type": "integer"}},
            },
            "ranges": {"type": "array", "items": {}},
        },
    }
    texts = [
        '{"message": {"type": "A", "x": null, "y": 1}, "ranges": []}',
        '{"message": {"type": "A", "x": NaN, "y": 1.5}, "ranges": [1, 2.5]}',
        '{message: {type: "A", x: 0.25, y: 2,}, ranges: [3, 4]}',
    ]
    block = block_of([text.encode() for text in texts])
    found = JsonReader("M", json.dumps(schema).encode(), ["message.x", "message.y", "ranges"]).columns(block)
    np.testing.assert_array_equal(found["message.x"][:, 0], [math.nan, math.nan, 0.25])
    np.testing.assert_array_equal(found["message.y"][:, 0], [1.0, 1.5, 2.0])
    np.testing.assert_array_equal(found["ranges"], [[math.nan] * 2, [1.0, 2.5], [3.0, 4.0]])


def test_messages_of_many_types_in_one_topic() -> None:
    """As ``mavlink/out`` has them: what another type lacks is NaN."""
    texts = ['{"message":{"type":"RAW_IMU","xacc":5}}', '{"message":{"type":"ATTITUDE","roll":0.5}}'] * 60
    found = JsonReader("M", b"", ["message.xacc", "message.roll"]).columns(block_of([t.encode() for t in texts]))
    np.testing.assert_array_equal(found["message.xacc"][:, 0], [5.0, math.nan] * 60)
    np.testing.assert_array_equal(found["message.roll"][:, 0], [math.nan, 0.5] * 60)
