"""The index records behind a chunk: one for each channel in it, with the time and place of each message.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.logs.container.damage import DamageError

_INDEX: Final = struct.Struct("<HI")
_ENTRY: Final = np.dtype([("log_time", "<i8"), ("start", "<i8")])


def index_count(data: memoryview, offset: int, length: int) -> tuple[int, int]:
    """Read of which channel an index record is, and how many messages it names.

    Parameters
    ----------
    data : memoryview
        The file.
    offset, length : int
        Where its content stands.

    Returns
    -------
    channel_id, count : int

    Raises
    ------
    DamageError
        The lengths do not agree.
    """
    channel_id, size = _INDEX.unpack_from(data, offset)
    if size > length - _INDEX.size or size % _ENTRY.itemsize:
        raise DamageError(offset, f"an index record of {length} bytes says it has {size} bytes of entries")
    return channel_id, size // _ENTRY.itemsize


def index_entries(data: memoryview, offset: int, length: int) -> tuple[int, NDArray[Any]]:
    """Read an index record.

    Parameters
    ----------
    data : memoryview
        The file.
    offset, length : int
        Where its content stands.

    Returns
    -------
    int
        A channel.
    ndarray, shape (k,)
        Fields ``log_time``, ns, and ``start`` of the message record in the open chunk.

    Raises
    ------
    DamageError
        The lengths do not agree.
    """
    channel_id, count = index_count(data, offset, length)
    return channel_id, np.frombuffer(data, _ENTRY, count, offset + _INDEX.size)
