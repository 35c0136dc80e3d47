"""The ensembles of PD0: where their types of data are, and which fields of these are read.

Source: Teledyne RD Instruments, "Pathfinder DVL Guide", 95B-6116-00, April 2018: ensemble and header, tables 33 (fixed
leader), 34 (variable leader) and 40 (bottom track); "WorkHorse Commands and Output Data Format" for byte 59.
"""

import struct
from bisect import bisect_right
from typing import Final

import numpy as np

from insdvl_replay.logs.formats.teledyne import Fields, structure

FEWEST: Final = 6 + 4 + 33 + 28  # bytes of a header and both leaders, as short as they can be
# What is read of each type of data: its number, its bytes at least, and its fields.
_FIXED: Final = 0x0000
_VARIABLE: Final = 0x0080
BOTTOM: Final = 0x0600
_SHORTEST: Final = {_FIXED: 33, _VARIABLE: 28, BOTTOM: 44}
_FIELDS: Final[dict[int, Fields]] = {
    _FIXED: {
        "system": ("<u2", 5),  # configuration
        "transform": ("u1", 26),  # command EX
        "alignment": ("<i2", 27),  # command EA, 0.01 deg
        "beam_angle": ("u1", 59),  # deg, 0 of firmware that does not tell it
    },
    _VARIABLE: {
        "clock": ("7u1", 5),  # year without century, month, day, hour, minute, second, hundredth
        "depth": ("<u2", 17),  # dm
        "heading": ("<u2", 19),  # 0.01 deg
        "pitch": ("<i2", 21),
        "roll": ("<i2", 23),
        "pressure": ("<i4", 49),  # 10 Pa; above the water it may be less than that of the air
        "y2k_clock": ("8u1", 58),  # century first
    },
    BOTTOM: {
        "range": ("4<u2", 17),  # cm
        "velocity": ("4<i2", 25),  # mm/s
        "correlation": ("4u1", 33),
        "amplitude": ("4u1", 37),
        "percent_good": ("4u1", 41),
        "range_msb": ("4u1", 78),
    },
}
_SIZES: Final = {_FIXED: 59, _VARIABLE: 65, BOTTOM: 81}
ENSEMBLE: Final = np.dtype(
    [
        ("offset", "<i8"),
        ("fixed", structure(_FIELDS[_FIXED], _SIZES[_FIXED])),
        ("variable", structure(_FIELDS[_VARIABLE], _SIZES[_VARIABLE])),
        ("bottom", structure(_FIELDS[BOTTOM], _SIZES[BOTTOM])),
    ]
)
"""One ensemble: its place in the file, and what is read of its types of data."""


def ensemble_bytes(offset: int, found: dict[int, bytes]) -> bytes:
    """Return an ensemble at a place of the file as an `ENSEMBLE`; fields that old firmware does not write are 0."""
    parts = [struct.pack("<q", offset)]
    for kind in (_FIXED, _VARIABLE, BOTTOM):
        size = _SIZES[kind]
        parts.append(found[kind][:size].ljust(size, b"\0"))
    return b"".join(parts)


def data_of(content: bytes) -> dict[int, bytes] | None:
    """Return the bytes of each type of data in an ensemble; None where the header or a leader cannot be."""
    end = len(content) - 2
    count = content[5]
    if 6 + 2 * count > end:
        return None
    offsets = struct.unpack_from(f"<{count}H", content, 6)
    bounds = sorted({*offsets, end})
    found: dict[int, bytes] = {}
    for offset in offsets:
        if offset + 2 > end:
            return None
        behind = bounds[bisect_right(bounds, offset)]
        kind = int.from_bytes(content[offset : offset + 2], "little")
        found[kind] = content[offset:behind]
    for kind, shortest in _SHORTEST.items():
        is_short = len(found.get(kind, b"")) < shortest
        if is_short and (kind in found or kind != BOTTOM):
            return None
    return found
