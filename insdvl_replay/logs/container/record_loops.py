"""The loops over records, compiled: millions of messages outside chunks cost no more than those inside."""

from typing import Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.core.runtime import compiled, inlined
from insdvl_replay.logs.container.records import LAST_KNOWN, RECORD_HEADER_SIZE, can_be_record

_DATA_END: Final = int(Opcode.DATA_END)
inlined(can_be_record)  # which must not load the compiler where it stands


@inlined
def _fitting(data: NDArray[np.uint8], start: int, end: int) -> tuple[int, int]:
    """Return kind and length of the record at a place, or kind 0 if no record can stand there."""
    room = end - start - RECORD_HEADER_SIZE
    if room < 0:
        return 0, 0
    opcode = int(data[start])
    length = 0
    for i in range(8, 0, -1):
        length = 256 * length + int(data[start + i])
        # Checked at each byte, so that no length can overflow.
        if length > room:
            return 0, 0
    return (opcode, length) if can_be_record(opcode, length) else (0, 0)


@compiled
def walk(
    data: NDArray[np.uint8],
    start: int,
    end: int,
    opcodes: NDArray[np.uint8],
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> tuple[int, int]:
    """Write down kind, place and length of each record, as many as find room; give their number and where it ended."""
    count = 0
    while start < end and count < opcodes.size:
        opcode, length = _fitting(data, start, end)
        if opcode == 0:
            break
        opcodes[count], starts[count], lengths[count] = opcode, start, length
        count += 1
        start += RECORD_HEADER_SIZE + length
        if opcode == _DATA_END:
            break
    return count, start


@compiled
def resume(data: NDArray[np.uint8], start: int, end: int) -> int:
    """Search for a place where a record can stand with another one, or the end, right behind it."""
    for place in range(start, end):
        if not 0 < data[place] <= LAST_KNOWN:
            continue  # most bytes are done with here
        opcode, length = _fitting(data, place, end)
        if 0 < opcode <= LAST_KNOWN:
            after = place + RECORD_HEADER_SIZE + length
            follower, _ = _fitting(data, after, end)
            if after == end or 0 < follower <= LAST_KNOWN:
                return place
    return end
