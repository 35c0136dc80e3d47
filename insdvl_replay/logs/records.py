"""The records of an MCAP file: where each one stands, and where the next one stands after bytes that are none.

The two loops over bytes are compiled, so that a file of millions of messages outside chunks, or a chunk without index,
costs no more than one with.
Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.logs.damage import DamageError

_P = ParamSpec("_P")
_T = TypeVar("_T")

MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""

RECORD_HEADER_SIZE: Final = 9
"""Bytes in front of each record's content: its kind and its length."""

DATA_END_SIZE: Final = RECORD_HEADER_SIZE + 4
"""Bytes of the record behind the last message."""

MESSAGE_FIELDS_SIZE: Final = 22
"""Bytes of a message record in front of the payload."""

BATCH: Final = 1 << 16
"""Most records that are found at a time."""

_MESSAGE: Final = int(Opcode.MESSAGE)
_DATA_END: Final = int(Opcode.DATA_END)
_LAST_KNOWN: Final = 15
_FIRST_PRIVATE: Final = 128
_LEAST_LENGTHS: Final = (0, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
"""What a record of each known kind must at least hold for its own fields."""


@dataclass(frozen=True)
class Records:
    """Records in the order in which they stand.

    Attributes
    ----------
    opcodes : ndarray of uint8, shape (k,)
        Their kinds.
    starts : ndarray, shape (k,)
        Where their headers start.
    lengths : ndarray, shape (k,)
        Bytes of their contents, which stand behind the headers.
    """

    opcodes: NDArray[np.uint8]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        """Give the number of records."""
        return int(self.opcodes.size)

    def rows(self) -> Iterator[tuple[int, int, int]]:
        """Go through them one by one: kind, start of the content, and its length."""
        contents = self.starts + RECORD_HEADER_SIZE
        return zip(self.opcodes.tolist(), contents.tolist(), self.lengths.tolist(), strict=True)

    def where(self, chosen: Any) -> "Records":
        """Give some of them, chosen as an array of shape (k,) is indexed."""
        return Records(self.opcodes[chosen], self.starts[chosen], self.lengths[chosen])


def _compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile on the first call, and keep the machine code where any folder can be written."""
    try:
        return cast(Callable[_P, _T], numba.njit(cache=True, nogil=True)(function))
    except RuntimeError:
        return cast(Callable[_P, _T], numba.njit(nogil=True)(function))


@_compiled
def _fitting(data: NDArray[np.uint8], start: int, end: int) -> tuple[int, int]:
    """Give kind and length of the record at a place, or kind 0 if no record can stand there."""
    room = end - start - 9
    if room < 0:
        return 0, 0
    opcode = int(data[start])
    length = 0
    for i in range(8, 0, -1):
        length = 256 * length + int(data[start + i])
        # Checked at each byte, so that no length can overflow.
        if length > room:
            return 0, 0
    if _LAST_KNOWN < opcode < _FIRST_PRIVATE or (opcode <= _LAST_KNOWN and length < _LEAST_LENGTHS[opcode]):
        return 0, 0
    return opcode, length


@_compiled
def _walk(
    data: NDArray[np.uint8],
    start: int,
    end: int,
    opcodes: NDArray[np.uint8],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> tuple[int, int]:
    count = 0
    while start < end and count < opcodes.size:
        opcode, length = _fitting(data, start, end)
        if opcode == 0:
            break
        opcodes[count], starts[count], lengths[count] = opcode, start, length
        count += 1
        start += 9 + length
        if opcode == _DATA_END:
            break
    return count, start


@_compiled
def _resume(data: NDArray[np.uint8], start: int, end: int) -> int:
    for place in range(start, end):
        opcode, length = _fitting(data, place, end)
        if 0 < opcode <= _LAST_KNOWN:
            after = place + 9 + length
            follower, _ = _fitting(data, after, end)
            if after == end or 0 < follower <= _LAST_KNOWN:
                return place
    return end


def find_records(data: memoryview, start: int, end: int) -> tuple[Records, int]:
    """Go from record to record.

    Parameters
    ----------
    data : memoryview
    start, end : int
        Where the first record starts and the last one ends.

    Returns
    -------
    Records
        At most `BATCH`; none follows one that ends the data section.
    int
        Where the walk stopped: at the end, behind the last of the records, or at bytes that are no record.
    """
    opcodes, starts, lengths = np.empty(BATCH, np.uint8), np.empty(BATCH, np.int64), np.empty(BATCH, np.int64)
    count, stop = _walk(np.frombuffer(data, np.uint8), start, end, opcodes, starts, lengths)
    return Records(opcodes[:count].copy(), starts[:count].copy(), lengths[:count].copy()), stop


def is_broken(batch: Records, stop: int, end: int) -> bool:
    """Tell whether a walk stopped because the bytes are no record.

    Parameters
    ----------
    batch : Records
    stop : int
        As `find_records` gives them.
    end : int
        Where the last record ends.

    Returns
    -------
    bool
    """
    return stop < end and len(batch) < BATCH and not (len(batch) and batch.opcodes[-1] == _DATA_END)


def next_record(data: memoryview, start: int, end: int) -> int:
    """Search for a place where a record can stand with another one, or the end, right behind it.

    Parameters
    ----------
    data : memoryview
    start, end : int

    Returns
    -------
    int
        The place, or the end.
    """
    return int(_resume(np.frombuffer(data, np.uint8), start, end))


def go_on(data: memoryview, batch: Records, stop: int, end: int) -> tuple[Records, int]:
    """Go on behind bytes that are no record.

    Parameters
    ----------
    data : memoryview
    batch : Records
    stop : int
        As `find_records` gives them.
    end : int
        Where to give up.

    Returns
    -------
    Records
        Without a message just before the place, since its own length may be what is wrong.
    int
        Where the next record stands, or the end.
    """
    if len(batch) and batch.opcodes[-1] == _MESSAGE:
        return batch.where(slice(-1)), next_record(data, int(batch.starts[-1]) + 1, end)
    return batch, next_record(data, stop + 1, end)


def what_stands(data: memoryview, start: int, end: int) -> str:
    """Say why no record can stand at a place.

    Parameters
    ----------
    data : memoryview
    start, end : int

    Returns
    -------
    str
    """
    room = end - start - RECORD_HEADER_SIZE
    if room < 0:
        return f"{end - start} bytes are left where a record needs at least {RECORD_HEADER_SIZE}"
    opcode, length = struct.unpack_from("<BQ", data, start)
    if length > room:
        return f"a record of kind {opcode} says it has {length} bytes; {room} are left"
    return f"{length} bytes under kind {opcode} are no record"


def parsed(kind: Any, data: memoryview, start: int, length: int) -> Any:
    """Parse a record.

    Parameters
    ----------
    kind : type
        One of `mcap.records`.
    data : memoryview
    start, length : int
        Where its content stands.

    Returns
    -------
    object of `kind`

    Raises
    ------
    DamageError
        The content is none of this kind.
    """
    try:
        return kind.read(ReadDataStream(BytesIO(data[start : start + length])))
    except (McapError, struct.error, UnicodeDecodeError, EOFError) as error:
        raise DamageError(start, f"a {kind.__name__} record of {length} bytes cannot be parsed") from error
