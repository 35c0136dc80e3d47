"""Messages that stand in a damaged file more than once, since bytes were written twice.

Each of them stands for one that was written over or pushed aside, as far as the number of messages tells.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.logs.container.blocks import MESSAGE, gather
from insdvl_replay.logs.container.chunk_messages import read_chunk
from insdvl_replay.logs.container.damage import DamageError
from insdvl_replay.logs.container.scanner import Anatomy


def repeated_messages(data: memoryview, anatomy: Anatomy) -> int:
    """Count the messages that are copies of others.

    Parameters
    ----------
    data : memoryview
        The file.
    anatomy : Anatomy

    Returns
    -------
    int
        0 where every byte is part of a record, or all messages stand in chunks: these are copied as a whole or not
        readable.
    """
    if not anatomy.passed or all(chunk.kind != "loose" for chunk in anatomy.chunks.values()):
        return 0
    headers = np.concatenate([np.empty(0, MESSAGE), *_headers(data, anatomy)])
    _, first, count = np.unique(headers["log_time"], return_inverse=True, return_counts=True)
    # Few messages share their log time, and only these are compared as a whole, which takes longer.
    suspected = headers[count[first] > 1]
    return len(suspected) - len(np.unique(suspected))


def _headers(data: memoryview, anatomy: Anatomy) -> Iterator[NDArray[Any]]:
    """Go through what stands in front of the payloads; no chunk stays open for it."""
    for chunk in anatomy.chunks.values():
        with suppress(DamageError):
            for block in read_chunk(data, chunk).blocks.values():
                yield gather(block.buffer, block.starts, MESSAGE)
