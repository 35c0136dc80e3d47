"""Files of numpy and MATLAB as named arrays, and the memory that the columns of a file may take.

Such files are compressed, and say themselves how many numbers they hold, so that a small one may ask for any amount of
memory. Each size is compared with what a file of its length can hold before that much is read. Objects of Python are
never loaded. MATLAB 5 to 7 write what its documentation calls level 5 of the "MAT-File Format".
"""

import math
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final, NamedTuple

import numpy as np
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.logs.formats.log_file import most_opened

MOST_COLUMNS: Final = 4096
"""Columns or arrays of a file; a log of sensors has some dozens."""
# Larger columns are believed only if their file is compressed less densely than this.
_MOST_TIMES: Final = 16
_NUMBERS: Final = "biufM"  # kinds of arrays that are columns

Arrays = dict[str, Array]


@dataclass
class Found:
    """What a file holds."""

    arrays: Arrays = field(default_factory=dict)  # by name; a dot joins those of structures
    ignored: dict[str, str] = field(default_factory=dict)  # by name, what is no array of numbers


def most_in_memory(file_size: int) -> int:
    """Return the bytes that all columns of a file may take together."""
    return most_opened(file_size, times=_MOST_TIMES)


def require_room(needed: int, file_size: int) -> None:
    """Raise a ValueError if columns need more memory than those of a file of a size may take."""
    most = most_in_memory(file_size)
    if needed > most:
        raise ValueError(
            f"its columns need more than {most / 1e6:.0f} MB of memory, which is the most for a file of "
            f"{file_size / 1e6:.2g} MB"
        )


def require_few(count: int, what: str = "arrays") -> None:
    """Raise a ValueError if a file has more columns than a log of sensors can have."""
    if count > MOST_COLUMNS:
        raise ValueError(f"it has {count} {what}; at most {MOST_COLUMNS} are read")


# --- numpy.


class SpreadsheetError(Exception):
    """An archive of zip holds sheets, not arrays."""


def read_numpy(content: memoryview) -> Found:
    """Read the arrays of a .npy or .npz file."""
    if bytes(content[:2]) != b"PK":
        return Found(_of_numbers({"": np.load(BytesIO(content))}))
    with zipfile.ZipFile(BytesIO(content)) as archive:
        members = archive.infolist()
        require_few(len(members))
        for member in members:
            if member.filename.startswith("xl/") or member.filename == "content.xml":
                raise SpreadsheetError
        require_room(sum(member.file_size for member in members), len(content))
    with np.load(BytesIO(content)) as stored:
        return Found(_of_numbers(dict(stored)))


def _of_numbers(values: Mapping[str, Any]) -> Arrays:
    """Return arrays of numbers, and the fields of those of structures."""
    found: Arrays = {}
    for name, value in values.items():
        array = np.asarray(value)
        prefix = f"{name}." if name else ""
        fields = {f"{prefix}{inner}": array[inner] for inner in array.dtype.names or ()}
        found |= _of_numbers(fields)
        if array.dtype.kind in _NUMBERS:
            found[name] = array
    return found


# --- MATLAB.

_HEADER_SIZE: Final = 128
_MATRIX: Final = 14  # types of elements
_COMPRESSED: Final = 15
_NUMBER_TYPES: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_STRUCTURE: Final = 2  # classes of variables
_TEXT: Final = 4
_NUMBER_CLASSES: Final = range(6, 16)
_OPAQUE: Final = 17
_OTHER_KINDS: Final = {
    1: "of cells",
    3: "an object",
    5: "sparse",
    16: "a function",
    _OPAQUE: "an object",
}
_IS_COMPLEX: Final = 0x0800  # in the flags of a variable
_DEEPEST: Final = 16  # levels of structures


class _Element(NamedTuple):
    """A part of a file: its type, and its bytes without the tag."""

    type: int
    data: memoryview


def read_matlab(content: memoryview) -> Found:
    """Read the variables of a .mat file of MATLAB 5 to 7."""
    return _MatlabReader(content).found


class _MatlabReader:
    """Reads the variables of a file; arrays are views of its bytes, so that what they say of their size is checked."""

    def __init__(self, content: memoryview) -> None:
        self.found = Found()
        if len(content) <= _HEADER_SIZE:
            raise ValueError("it has a header and no variables")
        self._byte_order = ">" if bytes(content[126:128]) == b"MI" else "<"
        self._variables = 0
        inflated = 0
        for element in self._elements(content[_HEADER_SIZE:]):
            variable = element
            if element.type == _COMPRESSED:
                plain = self._inflated(element.data, most_in_memory(len(content)) - inflated)
                inflated += len(plain)
                require_room(inflated, len(content))
                variable = next(self._elements(plain))
            if variable.type == _MATRIX:
                self._take(variable.data, "", 0)

    def _elements(self, data: memoryview) -> Iterator[_Element]:
        """Go through the elements that are one behind the other."""
        place = 0
        while place + 8 <= len(data):
            first, size = np.frombuffer(data, f"{self._byte_order}u4", 2, place).tolist()
            start = place + 8
            end = start + size
            place = end if first == _COMPRESSED else end + -end % 8
            if first >> 16:  # of up to four bytes, which are in the tag
                size = first >> 16
                start -= 4
                end = start + min(size, 4)
                place = start + 4
            if end > len(data):
                raise ValueError(f"a variable of {size} bytes is cut to {len(data) - start}")
            yield _Element(first & 0xFFFF, data[start:end])
        if place < len(data):
            raise ValueError(f"its last {len(data) - place} bytes are no variable")

    @staticmethod
    def _inflated(data: memoryview, room: int) -> memoryview:
        """Decompress a variable, up to one byte more than there is room for."""
        unpacker = zlib_ng.decompressobj()
        plain = unpacker.decompress(data, max(room, 0) + 1)
        if len(plain) <= room and not unpacker.eof:
            raise ValueError("a compressed variable is cut")
        return memoryview(plain)

    def _take(self, data: memoryview, field_name: str, level: int) -> None:
        """Read a variable or a field, if it is an array of numbers or a structure of them."""
        self._variables += 1
        require_few(self._variables, "variables")
        if not data:  # a field that was never set
            return
        parts = self._elements(data)
        flags = int(self._numbers(next(parts))[0])
        kind = flags & 0xFF
        dimensions = [] if kind == _OPAQUE else self._numbers(next(parts)).tolist()
        own_name = _text(next(parts))
        name = field_name or own_name
        if not name:  # what MATLAB keeps for its functions and objects
            return
        is_real = not flags & _IS_COMPLEX
        if kind in _NUMBER_CLASSES and is_real:
            self.found.arrays[name] = self._numbers(next(parts)).reshape(dimensions, order="F")
        elif kind == _STRUCTURE and math.prod(dimensions) == 1 and level < _DEEPEST:
            self._take_fields(parts, name, level)
        elif kind != _TEXT:
            usual = "of structures" if is_real else "of complex numbers"
            self.found.ignored[name] = _OTHER_KINDS.get(kind, usual)

    def _take_fields(self, parts: Iterator[_Element], above: str, level: int) -> None:
        """Read the fields of a structure."""
        length = max(int(self._numbers(next(parts))[0]), 1)
        names = next(parts).data
        require_few(len(names) // length, "fields")
        for start in range(0, len(names), length):
            inner = _text(_Element(0, names[start : start + length]))
            self._take(next(parts).data, f"{above}.{inner}", level + 1)

    def _numbers(self, element: _Element) -> Array:
        """Return the numbers of an element, (k,)."""
        if element.type not in _NUMBER_TYPES:
            raise ValueError(f"an element of type {element.type} is where numbers should be")
        dtype = np.dtype(self._byte_order + _NUMBER_TYPES[element.type])
        values = np.frombuffer(element.data, dtype)
        return values.astype(dtype.newbyteorder("="), copy=False)


def _text(element: _Element) -> str:
    return bytes(element.data).partition(b"\0")[0].decode("utf-8", "replace")
