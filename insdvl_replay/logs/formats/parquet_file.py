"""Files of Parquet as named columns, after the sizes in them have been compared with the size of the file.

The file says at its end how many rows it has, and in front of each page to how much it opens. Runs of one value and
dictionaries may stand for any number of rows, so rows are counted, and texts by their letters. Headers of pages are
those of parquet.thrift (Apache Parquet) in the compact protocol of Thrift.
"""

from collections.abc import Iterator
from io import BytesIO
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.logs.formats.array_files import Found, require_few, require_room

_NUMBER_SIZE: Final = 8  # bytes of a cell
_OBJECT_SIZE: Final = 128  # of one that is no number, without its letters
_LONGEST_FIXED: Final = 32  # bytes of a cell of fixed length, as of decimals


def read_parquet(content: memoryview) -> Found:
    """Read the columns by their titles; a ValueError where they need more memory than there is room for."""
    file = pq.ParquetFile(BytesIO(content))
    require_few(len(file.schema), "columns")
    pages = list(_pages(content, file.metadata))
    require_room(sum(page.size for page in pages), len(content))
    found, kinds = _flat_columns(file, {page.column for page in pages if page.is_difference})
    texts = [name for name, kind in kinds.items() if not _is_number(kind)]
    require_room(_cells(file.metadata) * _NUMBER_SIZE, len(content))
    require_room(file.metadata.num_rows * len(texts) * _OBJECT_SIZE, len(content))
    table = pq.ParquetFile(BytesIO(content), read_dictionary=texts).read(columns=list(kinds))
    require_room(sum(_letters(table.column(name)) for name in texts), len(content))
    for name in kinds:
        found.arrays[name] = _as_numpy(table.column(name))
    return found


# --- Columns.


def _flat_columns(file: Any, packed: set[int]) -> tuple[Found, dict[str, Any]]:
    """Find the columns with one value a row, with their types, and note the others."""
    found = Found()
    kinds: dict[str, Any] = {}
    leaf = 0
    for column in file.schema_arrow:
        stored = file.schema.column(leaf)
        if column.name in kinds:
            raise ValueError(f"two columns are called '{column.name}'")
        if column.type.num_fields or stored.max_repetition_level:
            found.ignored[column.name] = "of lists or structures"
        elif isinstance(column.type, pa.BaseExtensionType) or stored.length > _LONGEST_FIXED:
            found.ignored[column.name] = "of objects"
        elif leaf in packed and not _is_number(column.type):
            found.ignored[column.name] = "of texts that are stored as differences"
        else:
            kinds[column.name] = column.type
        leaf += _leaves(column.type)
    return found, kinds


def _leaves(kind: Any) -> int:
    """Return how many columns of the file a column of a type consists of."""
    if isinstance(kind, pa.BaseExtensionType):
        return _leaves(kind.storage_type)
    return sum(_leaves(kind.field(number).type) for number in range(kind.num_fields)) or 1


def _is_number(kind: Any) -> bool:
    """Return whether cells of a type are numbers, or times that are one."""
    types = pa.types
    if types.is_dictionary(kind):
        return _is_number(kind.value_type)
    is_temporal = types.is_temporal(kind) and not types.is_time(kind)
    is_numeric = types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
    return is_numeric or is_temporal or types.is_boolean(kind) or types.is_null(kind)


def _letters(column: Any) -> int:
    """Return the length of all texts of a column together, without making them."""
    if not pa.types.is_dictionary(column.type):  # of fixed length, and short
        return 0
    total = 0
    for chunk in column.chunks:
        lengths = pc.binary_length(chunk.dictionary)
        total += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    return total


def _as_numpy(column: Any) -> Array:
    """Return the cells of a column, (k,), of which missing numbers are NaN and texts are objects."""
    types = pa.types
    if not _is_number(column.type):
        return np.asarray(column.to_pandas(), dtype=object)
    if types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    kind = column.type
    if types.is_boolean(kind):
        column = column.cast(pa.uint8())
    elif types.is_null(kind) or types.is_decimal(kind):
        column = column.cast(pa.float64())
    elif types.is_date(kind):
        column = column.cast(pa.timestamp("ms"))
    elif types.is_timestamp(kind):
        column = column.cast(pa.timestamp(kind.unit))  # from its time zone to UTC
    values: Array = column.to_numpy()
    return values


def _cells(metadata: Any) -> int:
    """Return how many values all columns have, of which a list has several a row."""
    cells = 0
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        cells += sum(group.column(column).num_values for column in range(metadata.num_columns))
    return cells


# --- Headers of pages.

_TRUE: Final = 1  # types of Thrift
_FALSE: Final = 2
_BYTE: Final = 3
_BINARY: Final = 8
_STRUCTURE: Final = 12
_INTEGERS: Final = (4, 5, 6)
_DEEPEST: Final = 4
_MOST_FIELDS: Final = 32
_PAGE_SIZE: Final = 2  # fields of a header: of the page in memory, and in the file
_STORED_SIZE: Final = 3
_ENCODINGS: Final = ((5, 2), (8, 4))  # where the two kinds of pages with data have their encoding
_DELTA_BYTE_ARRAY: Final = 7


class _Page(NamedTuple):
    """A page of a column."""

    column: int
    size: int  # bytes to which it opens
    is_difference: bool  # each text is stored by how it differs from the one before


def _pages(content: memoryview, metadata: Any) -> Iterator[_Page]:
    """Go through the pages of all columns by their headers."""
    stored = 0
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for column in range(metadata.num_columns):
            chunk = group.column(column)
            places = [chunk.data_page_offset]
            if chunk.dictionary_page_offset:
                places.append(chunk.dictionary_page_offset)
            stored += chunk.total_compressed_size
            if min(places) < 0 or chunk.total_compressed_size < 0 or stored > len(content):
                raise ValueError("its columns are larger than the file")
            data = content[min(places) : min(places) + chunk.total_compressed_size]
            yield from _pages_of_chunk(data, column)


def _pages_of_chunk(data: memoryview, column: int) -> Iterator[_Page]:
    place = 0
    while place < len(data):
        header = _Header(data, place)
        fields = header.structure()
        stored_size = fields.get(_STORED_SIZE, -1)
        size = fields.get(_PAGE_SIZE, -1)
        if stored_size < 0 or size < 0:
            raise ValueError("the header of a page has no size")
        inside = [(fields.get(kind), inner) for kind, inner in _ENCODINGS]
        encodings = [page.get(inner) for page, inner in inside if isinstance(page, dict)]
        yield _Page(column, size, _DELTA_BYTE_ARRAY in encodings)
        place = header.offset + stored_size


class _Header:
    """Reads the fields of a header by their numbers; texts are left out."""

    def __init__(self, data: memoryview, place: int) -> None:
        self._data = data
        self.offset = place

    def structure(self, level: int = 0) -> dict[int, Any]:
        """Read a structure; a ValueError where it is none that a header of a page has."""
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            step = head >> 4
            number = number + step if step else self._integer()
            fields[number] = self._value(head & 0x0F, level)
            if len(fields) > _MOST_FIELDS or level > _DEEPEST:
                break
        else:
            return fields
        raise ValueError("the header of a page is none")

    def _value(self, kind: int, level: int) -> Any:
        if kind in _INTEGERS:
            return self._integer()
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind == _BYTE:
            return self._byte()
        if kind == _STRUCTURE:
            return self.structure(level + 1)
        if kind != _BINARY:
            raise ValueError(f"the header of a page has a field of type {kind}")
        length = self._unsigned()
        self.offset += length
        return None

    def _byte(self) -> int:
        if self.offset >= len(self._data):
            raise ValueError("the header of a page is cut")
        self.offset += 1
        return self._data[self.offset - 1]

    def _unsigned(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise ValueError("a number in the header of a page is too long")

    def _integer(self) -> int:
        """Read a signed number: 0, -1, 1, -2, ... are stored as 0, 1, 2, 3, ..."""
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)
