"""Small tables that ask for much: what they unpack to, how many rows or cells they say to have, and what they name."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

DOUBLE, INT8 = 9, 1  # types of elements of MATLAB
DOUBLE_CLASS, INT8_CLASS, CELL_CLASS, STRUCTURE_CLASS = 6, 8, 1, 2
PIECE = bytes(1 << 24)


def parquet(table: pa.Table, **options: object) -> bytes:
    """Write a table."""
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd", **options)
    return stream.getvalue()


def runs(rows: int, columns: int = 1) -> bytes:
    """Have one value in all rows, which takes some bytes for a million of them."""
    value = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([1.0]))
    names = ["time", *(f"c{number}" for number in range(1, columns))]
    return parquet(pa.table(dict.fromkeys(names, value)), row_group_size=rows)


def long_texts(rows: int, letters: int) -> bytes:
    """Have one long text in all rows."""
    text = pa.DictionaryArray.from_arrays(
        pa.array(np.zeros(rows, np.int8)), pa.array(["1" * letters])
    )
    return parquet(pa.table({"time": np.arange(float(rows)), "text": text}), row_group_size=rows)


def texts_by_difference(rows: int, letters: int) -> bytes:
    """Have long texts that differ in their ends, and are stored by these."""
    texts = pa.array(["1" * letters + f"{row:06}" for row in range(rows)])
    encodings = {"time": "PLAIN", "text": "DELTA_BYTE_ARRAY"}
    table = pa.table({"time": np.arange(float(rows)), "text": texts})
    return parquet(table, use_dictionary=False, column_encoding=encodings)


def lists(rows: int, length: int) -> bytes:
    """Have long lists in all rows."""
    values = pa.array(np.zeros(rows * length))
    column = pa.FixedSizeListArray.from_arrays(values, length)
    return parquet(pa.table({"time": np.arange(float(rows)), "acc": column}))


def wide_parquet(columns: int) -> bytes:
    """Have many columns."""
    return parquet(pa.table({f"c{number}": [1.0, 2.0, 3.0] for number in range(columns)}))


def lying_pages() -> bytes:
    """Say in front of a page that it opens to two gigabytes, which the sums at the end of the file hide."""
    data = bytearray(parquet(pa.table({"time": np.arange(1000.0)}), use_dictionary=False))
    start = 7  # behind the magic and the type of the page, the size has seven bits a byte
    end = start + 1
    while data[end - 1] > 0x7F:
        end += 1
    data[start:end] = _thrift_number(2_000_000_000)
    return bytes(data)


def _thrift_number(value: int) -> bytes:
    left, out = 2 * value, bytearray()
    while left > 0x7F:
        out.append(left & 0x7F | 0x80)
        left >>= 7
    return bytes([*out, left])


# --- MATLAB.


def element(kind: int, data: bytes) -> bytes:
    """Write an element, filled up to eight bytes."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix_start(variable: str, kind: int, dimensions: Sequence[int]) -> bytes:
    """Write what is in front of the numbers of a variable."""
    flags = element(6, struct.pack("<II", kind, 0))
    return (
        flags + element(5, np.array(dimensions, "<i4").tobytes()) + element(1, variable.encode())
    )


def matlab(*elements: bytes) -> bytes:
    """Write a file."""
    return (
        b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM" + b"".join(elements)
    )


def _packed_zeros(size: int, kind: int, type_: int, item: int) -> bytes:
    """Compress a variable that is all zero."""
    start = matrix_start("imu_time", kind, (size // item, 1))
    packer = zlib.compressobj(9)
    out = packer.compress(
        struct.pack("<II", 14, len(start) + 8 + size) + start + struct.pack("<II", type_, size)
    )
    for _ in range(size // len(PIECE)):
        out += packer.compress(PIECE)
    out += packer.compress(bytes(size % len(PIECE))) + packer.flush()
    return struct.pack("<II", 15, len(out)) + out


def zeros(
    size: int, kind: int = DOUBLE_CLASS, type_: int = DOUBLE, item: int = 8, times: int = 1
) -> bytes:
    """Have variables that are all zero."""
    return matlab(*[_packed_zeros(size, kind, type_, item)] * times)


def claimed_cells(kind: int) -> bytes:
    """Say to have cells or structures by the billion."""
    body = matrix_start("imu", kind, (1 << 30, 1))
    if kind == STRUCTURE_CLASS:
        body += element(5, struct.pack("<i", 8)) + element(1, b"time\0\0\0\0")
    return matlab(element(14, body))


def deep_structures(levels: int) -> bytes:
    """Nest structures."""
    inner = element(14, matrix_start("", DOUBLE_CLASS, (2, 1)) + element(DOUBLE, bytes(16)))
    for level in range(levels):
        name = "imu" if level == levels - 1 else ""
        fields = element(5, struct.pack("<i", 8)) + element(1, b"time\0\0\0\0")
        inner = element(14, matrix_start(name, STRUCTURE_CLASS, (1, 1)) + fields + inner)
    return matlab(inner)


def many_variables(count: int) -> bytes:
    """Have many variables."""
    return matlab(
        *(element(14, matrix_start(f"v{number}", DOUBLE_CLASS, (2, 1)) + element(DOUBLE, bytes(16)))
          for number in range(count))
    )  # fmt: skip


# --- numpy.


def npy(shape: tuple[int, ...], data: bytes, descr: str = "<f8") -> bytes:
    """Write an array whose header says a shape."""
    header = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header + data


def npz(arrays: dict[str, bytes], lie: int = 0) -> bytes:
    """Write an archive; with a lie, its list says so many bytes of each array."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    data = bytearray(stream.getvalue())
    place = data.find(b"PK\x01\x02")
    while lie and place >= 0:
        data[place + 24 : place + 28] = struct.pack("<I", lie)
        place = data.find(b"PK\x01\x02", place + 4)
    return bytes(data)


def packed_numbers(count: int, *, lie: int = 0) -> bytes:
    """Have an array of zeros."""
    return npz({"time": npy((count,), bytes(8 * count))}, lie)


# --- Text.


def text(titles: Sequence[str], rows: int = 300) -> bytes:
    """Write a table with titles."""
    lines = [",".join(f"{row * 0.01:.2f}" for _ in titles) for row in range(rows)]
    return "\n".join([",".join(titles), *lines, ""]).encode()


TABLE_BOMBS: dict[str, Callable[[], bytes]] = {
    "2 10^7 equal values.parquet": partial(runs, 20_000_000),
    "8 10^6 equal values.parquet": partial(runs, 8_000_000),
    "10^6 rows of 100 equal columns.parquet": partial(runs, 1_000_000, 100),
    "10^6 long texts.parquet": partial(long_texts, 1_000_000, 100_000),
    "10^4 long texts that differ.parquet": partial(texts_by_difference, 10_000, 20_000),
    "long lists.parquet": partial(lists, 10_000, 3_000),
    "10^4 columns.parquet": partial(wide_parquet, 10_000),
    "a page that lies.parquet": lying_pages,
    "1 GB of zeros.mat": partial(zeros, 1_000_000_000),
    "60 MB of zeros.mat": partial(zeros, 60_000_000),
    "60 MB of small zeros.mat": partial(zeros, 60_000_000, INT8_CLASS, INT8, 1),
    "100 variables of zeros.mat": partial(zeros, 60_000_000, times=100),
    "10^9 cells.mat": partial(claimed_cells, CELL_CLASS),
    "10^9 structures.mat": partial(claimed_cells, STRUCTURE_CLASS),
    "3000 levels.mat": partial(deep_structures, 3_000),
    "10^5 variables.mat": partial(many_variables, 100_000),
    "4 10^7 zeros.npz": partial(packed_numbers, 40_000_000),
    "4 10^7 zeros, denied.npz": partial(packed_numbers, 40_000_000, lie=80_000),
    "10^9 claimed.npy": partial(npy, (1 << 30,), bytes(800)),
    "10^9 claimed.npz": lambda: npz({"time": npy((1 << 30,), bytes(800))}),
    "objects.npz": lambda: npz({"time": npy((3,), b"\x80\x04cos\nsystem\n", "|O")}),
    "10^4 arrays.npz": lambda: npz(
        {f"a{number}": npy((2,), bytes(16)) for number in range(10_000)}
    ),
    "blanks in a title.csv": lambda: text(["time", "[" + 3000 * " " + "x", "b"]),
    "brackets in a title.csv": lambda: text(["time", 60_000 * "[", "b"]),
    "4000 equal titles.csv": lambda: text(["time", *["a"] * 4000], rows=20),
    "200 000 columns.csv": lambda: text([f"c{number}" for number in range(200_000)], rows=3),
    "10^7 empty lines.csv": lambda: text(["time", "b"]) + 10_000_000 * b"\n",
}
"""Makers of tables by the names of their files."""
