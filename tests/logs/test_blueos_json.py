"""What BlueOS writes where JSON has no number is NaN; schemas of a first message are not believed."""

import json
import math

import numpy as np
from blocks import block_of

from insdvl_replay.logs.formats.decoded import JsonReader


def test_columns_of_what_blueos_records() -> None:
    """NaN in a number, an infinity, and a schema of a first message with null and whole numbers."""
    schema = {
        "type": "object",
        "properties": {
            "message": {
                "type": "object",
                "properties": {
                    "type": {"type": "string"},
                    "x": {"type": "null"},
                    "y": {"type": "integer"},
                },
            },
            "ranges": {"type": "array", "items": {}},
        },
    }
    texts = [
        '{"message": {"type": "A", "x": null, "y": 1}, "ranges": []}',
        '{"message": {"type": "A", "x": NaN, "y": 1.5}, "ranges": [1, 2.5]}',
        '{"message": {"type": "NaN, ", "x": 0.25, "y": -Infinity}, "ranges": [NaN, 4]}',
    ]
    block = block_of([text.encode() for text in texts])
    found = JsonReader(
        "M", json.dumps(schema).encode(), ["message.x", "message.y", "ranges"]
    ).columns(block)
    np.testing.assert_array_equal(found["message.x"][:, 0], [math.nan, math.nan, 0.25])
    np.testing.assert_array_equal(found["message.y"][:, 0], [1.0, 1.5, math.nan])
    np.testing.assert_array_equal(found["ranges"], [[math.nan] * 2, [1.0, 2.5], [math.nan, 4.0]])


def test_messages_of_many_types_in_one_topic() -> None:
    """As ``mavlink/out`` has them: what another type lacks is NaN."""
    texts = [
        '{"message":{"type":"RAW_IMU","xacc":5}}',
        '{"message":{"type":"ATTITUDE","roll":0.5}}',
    ] * 60
    found = JsonReader("M", b"", ["message.xacc", "message.roll"]).columns(
        block_of([t.encode() for t in texts])
    )
    np.testing.assert_array_equal(found["message.xacc"][:, 0], [5.0, math.nan] * 60)
    np.testing.assert_array_equal(found["message.roll"][:, 0], [math.nan, 0.5] * 60)
