"""Messages that stand in a damaged file more than once, since bytes were written twice.

Each of them stands for one that was written over or pushed aside, as far as the number of messages tells.
"""

import numpy as np

from insdvl_replay.logs.blocks import MESSAGE, gather
from insdvl_replay.logs.chunks import Content, read_chunk
from insdvl_replay.logs.damage import DamageError
from insdvl_replay.logs.packed import Chunk
from insdvl_replay.logs.walk import Anatomy


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
    if not anatomy.passed or all(chunk.kind != "loose" for chunk in anatomy.chunks):
        return 0
    contents = [content for chunk in anatomy.chunks for content in _contents(data, chunk)]
    blocks = [block for content in contents for block in content.blocks.values()]
    headers = np.concatenate([np.empty(0, MESSAGE), *(gather(block.buffer, block.starts, MESSAGE) for block in blocks)])
    _, first, count = np.unique(headers["log_time"], return_inverse=True, return_counts=True)
    # Few messages share their log time, and only these are compared as a whole, which takes longer.
    suspected = headers[count[first] > 1]
    return len(suspected) - len(np.unique(suspected))


def _contents(data: memoryview, chunk: Chunk) -> list[Content]:
    try:
        return [read_chunk(data, chunk)]
    except DamageError:
        return []
