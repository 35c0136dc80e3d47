"""Readers of chosen fields: `open_reader` makes the one for the encoding of a channel.

`BinaryReader` reads messages of ROS 2 and ROS 1, whose fields `fields` finds. Those of tables are in `table_file`, of
protobuf and JSON in `decoded`.
"""

import math
import re
from collections.abc import Collection, Iterator, Sequence
from itertools import count
from typing import Any, Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Array, Integers, Mask
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.definitions import (
    Definitions,
    binary_paths,
    definitions_of,
    full_name,
)
from insdvl_replay.logs.formats.fields import (
    ENCAPSULATION,
    ROWS,
    TABLE,
    Columns,
    Element,
    FieldReader,
    Kinds,
    Layout,
    check_path,
    message_layout,
)
from insdvl_replay.logs.formats.log_file import Block, LogChannel, gather

MOST_NUMBERS: Final = 1 << 16  # numbers that are read of one message; a sensor gives some hundreds
_MOST_SEEN: Final = 100  # combinations of texts that are remembered for an error
_LITTLE_ENDIAN: Final = int.from_bytes(ENCAPSULATION[:2], "little")
_ENCAPSULATIONS: Final = {
    0x00: "big-endian CDR", 0x02: "a big-endian parameter list", 0x03: "a parameter list", 0x06: "big-endian XCDR2",
    0x07: "XCDR2", 0x08: "big-endian delimited XCDR2", 0x09: "delimited XCDR2",
    0x0A: "a big-endian XCDR2 parameter list", 0x0B: "an XCDR2 parameter list",
}  # fmt: skip

Rows = Integers  # numbers of messages in a block


def channel_paths(channel: LogChannel) -> Kinds:
    """Return every field path that the schema of a readable channel knows; empty where only the messages tell."""
    return open_reader(channel, ()).known


def column_of(channel: LogChannel, path: str) -> str:
    """Return the name of a column of a table by a path: its name, title or number."""
    from insdvl_replay.logs.formats.table_rows import RowReader

    return RowReader(channel, [path]).names[path]


def open_reader(
    channel: LogChannel, paths: Sequence[str], element: Element | None = None
) -> FieldReader:
    """Make the reader of some fields of a readable channel; a LogError names a field that its schema does not know."""
    # What reads an encoding is not loaded before a log has it: protobuf's takes longer than to read a short log.
    if channel.encoding == TABLE:
        from insdvl_replay.logs.formats.table_rows import RowReader

        return RowReader(channel, paths)
    if channel.encoding in ("protobuf", "json"):
        from insdvl_replay.logs.formats.decoded import JsonReader, protobuf_reader

        if element is not None:
            text = f"elements of '{element.list_name}' can be selected by text in CDR and ROS 1 messages only"
            raise LogError(text, "record the selected element on its own topic")
        make = protobuf_reader if channel.encoding == "protobuf" else JsonReader
        return make(channel.type_name, channel.schema_data, paths)
    definitions = definitions_of(
        channel.type_name, channel.schema_text, channel.encoding, channel.schema_encoding
    )
    return BinaryReader(
        definitions, channel.type_name, paths, is_cdr=channel.encoding == "cdr", element=element
    )


# --- Messages of ROS 2 and ROS 1.


class _Taken:
    """Parts of a message that are read together, as the fields of one structure."""

    def __init__(self) -> None:
        self._formats: list[Any] = []
        self._offsets: list[int] = []

    def add(self, format_: Any, offset: int) -> str:
        """Take what is at a place of the message; return the field of the structure."""
        self._formats.append(format_)
        self._offsets.append(offset)
        return str(len(self._formats) - 1)

    def dtype(self) -> np.dtype[Any]:
        """Return the structure, which ends where the last of its parts does."""
        size = 0
        for format_, offset in zip(self._formats, self._offsets, strict=True):
            size = max(size, offset + np.dtype(format_).itemsize)
        columns: Any = {
            "names": [str(number) for number in range(len(self._formats))],
            "formats": self._formats,
            "offsets": self._offsets,
            "itemsize": size,
        }
        dtype: np.dtype[Any] = np.dtype(columns)
        return dtype


class _Plan:
    """What is read of the messages of one layout, as one structure: words that must agree, numbers and texts."""

    def __init__(
        self,
        layout: Layout,
        paths: Sequence[str],
        element: Element | None,
        *,
        is_cdr: bool,
    ) -> None:
        self.size = layout.size
        taken = _Taken()
        self.checks: dict[str, int] = {}  # what words must hold, by the fields of the structure
        if is_cdr:
            self.checks[taken.add("<u2", 0)] = _LITTLE_ENDIAN
        for offset, length in zip(layout.length_offsets, layout.lengths, strict=True):
            self.checks[taken.add("<u4", offset)] = length
        total = len(self.checks)
        self.fields: dict[str, list[str]] = {}  # with the numbers of each path
        for path in paths:
            runs = _runs(layout.dtype, path)
            total += sum(run.length for run in runs)
            if total > MOST_NUMBERS:
                text = f"'{path}' means more than {MOST_NUMBERS} numbers of a message"
                raise LogError(text, "use fewer")
            self.fields[path] = [taken.add((run.kind, (run.length,)), run.offset) for run in runs]
        self.texts: list[list[str]] = []  # of each element of the list that is meant
        if element is not None:
            known = dict(layout.dtype.fields or {})
            for names in _texts_of_elements(element, known):
                places = [known[name] for name in names]
                self.texts.append(
                    [taken.add((np.uint8, (place[0].itemsize,)), place[1]) for place in places]
                )
        self.dtype = taken.dtype()

    def numbers(self, values: Array, path: str) -> Array:
        """Return the numbers of a path, (k, n), as integers if all are whole."""
        parts = []
        for name in self.fields[path]:
            part = values[name]
            if part.dtype.kind == "b":
                part = part.view(np.uint8) != 0
            kind = np.float64 if part.dtype.kind == "f" else np.int64
            parts.append(part.astype(kind))
        if len(parts) == 1:
            return parts[0]
        return np.concatenate([np.empty((len(values), 0), np.int64), *parts], axis=1)


class _Run(NamedTuple):
    """Numbers of one kind that are side by side in a message."""

    kind: np.dtype[Any]
    offset: int
    length: int  # how many they are

    @property
    def end(self) -> int:
        """Where they end."""
        return self.offset + self.length * self.kind.itemsize


def _runs(dtype: np.dtype[np.void], path: str) -> list[_Run]:
    """Return the numbers of a layout that a path means."""
    runs: list[_Run] = []
    for leaf, offset in _leaves(dtype, path):
        run = _Run(leaf.base, offset, math.prod(leaf.shape))
        if runs and runs[-1].kind == run.kind and runs[-1].end == run.offset:
            before = runs.pop()
            run = _Run(run.kind, before.offset, before.length + run.length)
        runs.append(run)
    return runs


def _texts_of_elements(element: Element, known: Collection[str]) -> Iterator[list[str]]:
    """Give the fields with the texts of each element that a list has."""
    for number in count():
        names = [f"{element.list_name}[{number}].{name}" for name in element.fields]
        if names[0] not in known:
            return
        yield names


def _leaves(dtype: np.dtype[np.void], path: str) -> Iterator[tuple[np.dtype[Any], int]]:
    """Give kind and offset of the fields of a layout that a path means, or of the elements of them."""

    def pattern(path: str) -> re.Pattern[str]:
        """Match the field that a path names, and every field below it."""
        return re.compile(re.escape(path).replace(r"\[\*\]", r"\[\d+\]") + r"(?![^.\[])")

    match = re.fullmatch(r"(.*)\[(\d+|\*)\]", path)
    whole = pattern(path)
    element = pattern(match[1]) if match else None
    index = match[2] if match else ""
    for name, (field, offset, *_) in (dtype.fields or {}).items():
        if field.base.kind not in "biuf":
            continue
        if whole.match(name):
            yield field, offset
        elif element is not None and field.shape and element.fullmatch(name):
            if index == "*":
                yield field, offset
            elif int(index) < field.shape[0]:
                yield field.base, offset + int(index) * field.base.itemsize


class BinaryReader:
    """Reads some fields of all messages of one type; with an element, of those elements of a list alone."""

    def __init__(
        self,
        definitions: Definitions,
        type_name: str,
        paths: Sequence[str],
        *,
        is_cdr: bool = True,
        element: Element | None = None,
    ) -> None:
        self._definitions = definitions
        self._type_name = full_name(type_name)
        self._paths = tuple(paths)
        self._is_cdr = is_cdr
        self._element = element
        self._plans: dict[tuple[int, ...], _Plan] = {}  # by the lengths of strings and sequences
        self._latest: _Plan | None = None
        self._is_found = False
        # The texts of other elements, while none was found.
        self.seen: dict[tuple[str, ...], None] = {}
        self.known: Kinds = dict(binary_paths(definitions, self._type_name))
        for path in paths:
            check_path(path, self.known, self._type_name)

    def columns(self, block: Block) -> Columns:
        """Return the fields of all messages of a block, (k, n); shorter sequences are filled up with NaN.

        Of elements there may be more rows than messages, or fewer: `ROWS` has the message of each.
        """
        parts: list[tuple[Rows, Columns]] = []
        left = np.arange(len(block))
        while left.size:
            rows, plan, values = self._next_group(block, left)
            left = _without(left, rows)
            found = {path: plan.numbers(values, path) for path in self._paths}
            if self._element is not None:
                wanted = self._wanted(plan, values, self._element)
                elements = wanted.shape[1]
                rows = rows[np.nonzero(wanted)[0]]
                if not rows.size:
                    continue
                found = {
                    path: one.reshape(len(values), elements, -1)[wanted]
                    for path, one in found.items()
                }
            parts.append((rows, found))
        columns: Columns = {}
        for path in self._paths:
            columns[path] = _joined([(rows, found[path]) for rows, found in parts])
        if self._element is None:
            return columns
        if not parts:
            return {ROWS: np.empty((0, 1), np.int64)}
        return {
            ROWS: np.sort(np.concatenate([rows for rows, _ in parts]), kind="stable")[:, None],
            **columns,
        }

    def _next_group(self, block: Block, left: Rows) -> tuple[Rows, _Plan, Array]:
        """Read all messages that share a layout: the latest one if any has it, else that of the first message."""
        if self._latest is not None:
            rows, values = self._with_layout(block, left, self._latest)
            if rows.size:
                return rows, self._latest, values
        if self._is_cdr:
            self._require_little_endian(block)
        start = int(block.offsets[left[0]])
        size = int(block.sizes[left[0]])
        layout = message_layout(
            self._definitions,
            self._type_name,
            block.buffer[start : start + size],
            is_cdr=self._is_cdr,
        )
        if layout.lengths not in self._plans:
            self._plans[layout.lengths] = _Plan(
                layout, self._paths, self._element, is_cdr=self._is_cdr
            )
        self._latest = plan = self._plans[layout.lengths]
        rows, values = self._with_layout(block, left, plan)
        if not rows.size:
            text = f"a message of {size} bytes has {layout.size} by its schema ({self._type_name})"
            raise LogError(text, "the schema in the log does not match the messages")
        return rows, plan, values

    def _with_layout(
        self,
        block: Block,
        rows: Rows,
        plan: _Plan,
    ) -> tuple[Rows, Array]:
        """Read those of some messages that have a layout: its size, apart from padding at the end, and its lengths."""
        # All that is read of a message is inside its record, since none is shorter than the layout.
        padding = block.sizes[rows] - plan.size
        fits = (padding >= 0) & (padding <= (3 if self._is_cdr else 0))
        if not fits.all():
            rows = rows[fits]
        values = gather(block.buffer, block.offsets[rows], plan.dtype)
        fits = np.ones(rows.size, np.bool_)
        for name, word in plan.checks.items():
            fits &= values[name] == word
        if fits.all():
            return rows, values
        return rows[fits], values[fits]

    def _require_little_endian(self, block: Block) -> None:
        if np.any(block.sizes < len(ENCAPSULATION)):
            raise LogError(
                f"a message of {block.sizes.min()} bytes is no CDR", "the log is damaged"
            )
        kinds = gather(block.buffer, block.offsets, np.dtype("<u2"))
        wrong = kinds[kinds != _LITTLE_ENDIAN]
        if wrong.size:
            second, first = divmod(int(wrong[0]), 256)
            name = _ENCAPSULATIONS.get(second, "no CDR") if first == 0 else "no CDR"
            raise LogError(
                f"{wrong.size} of {kinds.size} messages are {name} "
                f"(they start with bytes '{first:02x} {second:02x}'), not little-endian CDR",
                "record with the default middleware, or convert the log with `ros2 bag convert`",
            )

    def _wanted(
        self,
        plan: _Plan,
        values: Array,
        element: Element,
    ) -> Mask:
        """Find the elements with the texts that are wanted, (messages, elements)."""
        end = b"\0" if self._is_cdr else b""
        asked = [np.frombuffer(text.encode() + end, np.uint8) for text in element.texts]
        wanted = np.zeros((len(values), len(plan.texts)), np.bool_)
        for i, names in enumerate(plan.texts):
            texts = [values[name] for name in names]
            wanted[:, i] = _are_equal(texts, asked)
            if not self._is_found and not wanted[:, i].any():
                self._remember(texts, end)
        self._is_found |= bool(wanted.any())
        return wanted

    def _remember(self, texts: Sequence[Array], end: bytes) -> None:
        """Remember the texts of elements that are not wanted, for an error."""
        ends = np.cumsum([text.shape[1] for text in texts])
        for row in np.unique(np.concatenate(texts, axis=1), axis=0)[:_MOST_SEEN]:
            if len(self.seen) >= _MOST_SEEN:
                return
            parts = [part.tobytes().removesuffix(end) for part in np.split(row, ends[:-1])]
            self.seen[tuple(part.decode("utf-8", "replace") for part in parts)] = None


def _are_equal(texts: Sequence[Array], asked: Sequence[Array]) -> Mask:
    """Find the rows in which some texts, (k, letters), are those that are asked for; none where none are."""
    equal = np.full(len(texts[0]), bool(asked))
    for text, one in zip(texts, asked, strict=bool(asked)):
        if text.shape[1] != one.size:
            return np.zeros(len(text), np.bool_)
        equal &= (text == one).all(axis=1)
    return equal


def _without(left: Rows, rows: Rows) -> Rows:
    """Return the messages that are left after some of them."""
    if rows.size == left.size:
        return left[:0]
    return np.setdiff1d(left, rows, assume_unique=True)


def _joined(parts: Sequence[tuple[Rows, Array]]) -> Array:
    """Bring the rows of several layouts into the order of the messages."""
    if len(parts) == 1:
        return parts[0][1]
    rows = np.concatenate([np.empty(0, np.int64), *(rows for rows, _ in parts)])
    places = np.empty_like(rows)
    places[np.argsort(rows, kind="stable")] = np.arange(rows.size)
    width = max((values.shape[1] for _, values in parts), default=0)
    joined = np.full((rows.size, width), np.nan)
    if all(values.shape[1] == width and values.dtype == np.int64 for _, values in parts):
        joined = np.zeros((rows.size, width), np.int64)
    start = 0
    for found, values in parts:
        joined[places[start : start + found.size], : values.shape[1]] = values
        start += found.size
    return joined
