"""Blocks of messages, as an open chunk gives them."""

import numpy as np

from insdvl_replay.logs.formats.log_file import Block

CHANNEL = 1


def block_of(messages: list[bytes]) -> Block:
    """Put payloads one behind the other with some bytes between them, one nanosecond after the other."""
    gap = 31
    sizes = np.array([len(message) for message in messages], np.int64)
    offsets, time_ns = (
        gap * np.arange(1, len(messages) + 1) + np.cumsum(sizes) - sizes,
        np.arange(len(messages)),
    )
    return Block(
        CHANNEL,
        memoryview(b"".join(bytes(gap) + message for message in messages)),
        offsets,
        sizes,
        time_ns,
        time_ns,
    )
