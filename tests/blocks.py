"""Blocks of messages, as an open chunk gives them."""

import struct

import numpy as np

from insdvl_replay.logs.container.blocks import Block

CHANNEL = 1


def block_of(messages: list[bytes]) -> Block:
    """Put payloads into message records, one nanosecond after the other."""
    records = [
        struct.pack("<BQHIQQ", 5, 22 + len(message), CHANNEL, i, i, i) + message for i, message in enumerate(messages)
    ]
    sizes = np.array([len(record) for record in records])
    buffer, starts = memoryview(b"".join(records)), np.cumsum(sizes) - sizes
    return Block(CHANNEL, buffer, starts, sizes - 9)
