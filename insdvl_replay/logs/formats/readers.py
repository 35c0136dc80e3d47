"""Readers of chosen fields: `open_reader` makes the one for the encoding of a channel.

`BinaryReader` reads messages of ROS 2 and ROS 1, whose fields `fields` finds. Those of tables are in `table_file`, of
protobuf and JSON in `decoded`.
"""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import count, takewhile
from typing import Any, Final

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
    from insdvl_replay.logs.formats.table_file import RowReader

    return RowReader(channel, [path]).names[path]


def open_reader(
    channel: LogChannel, paths: Sequence[str], element: Element | None = None
) -> FieldReader:
    """Make the reader of some fields of a readable channel; a LogError names a field that its schema does not know."""
    # What reads an encoding is not loaded before a log has it: protobuf's takes longer than to read a short log.
    if channel.encoding == TABLE:
        from insdvl_replay.logs.formats.table_file import RowReader

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


class _Plan:
    """What is read of the messages of one layout, as one structure: words that must agree, numbers and texts."""

    def __init__(
        self, layout: Layout, paths: Sequence[str], element: Element | None, *, is_cdr: bool
    ) -> None:
        self.size = layout.size
        formats: list[Any] = []
        offsets: list[int] = []

        def take(format_: Any, offset: int) -> str:
            formats.append(format_)
            offsets.append(offset)
            return str(len(formats) - 1)

        self.checks: dict[str, int] = {take("<u2", 0): _LITTLE_ENDIAN} if is_cdr else {}
        for offset, length in zip(layout.length_offsets, layout.lengths, strict=True):
            self.checks[take("<u4", offset)] = length
        total = len(formats)
        self.fields: dict[str, list[str]] = {}
        for path in paths:
            runs: list[
                tuple[np.dtype[Any], int, int]
            ] = []  # kind, offset and count of numbers that are side by side
            for dtype, offset in _leaves(layout.dtype, path):
                base = dtype.base
                start = offset
                number = math.prod(dtype.shape)
                total += number
                if total > MOST_NUMBERS:
                    raise LogError(
                        f"'{path}' means more than {MOST_NUMBERS} numbers of a message", "use fewer"
                    )
                if (
                    runs
                    and runs[-1][0] == base
                    and runs[-1][1] + runs[-1][2] * base.itemsize == offset
                ):
                    _, start, before = runs.pop()
                    number += before
                runs.append((base, start, number))
            self.fields[path] = [take((base, (number,)), start) for base, start, number in runs]
        self.texts: list[list[str]] = []  # of each element of the list that is meant
        known = dict(layout.dtype.fields or {})
        if element is not None:
            names = (
                [f"{element.list_name}[{i}].{name}" for name in element.fields] for i in count()
            )
            for texts in takewhile(lambda texts: texts[0] in known, names):
                self.texts.append(
                    [take((np.uint8, (known[name][0].itemsize,)), known[name][1]) for name in texts]
                )
        size = max(
            (np.dtype(one).itemsize + offset for one, offset in zip(formats, offsets, strict=True)),
            default=0,
        )
        columns: Any = {
            "names": [*map(str, range(len(formats)))],
            "formats": formats,
            "offsets": offsets,
        }
        self.dtype: np.dtype[Any] = np.dtype(columns | {"itemsize": size})

    def numbers(self, values: Array, path: str) -> Array:
        """Return the numbers of a path, (k, n), as integers if all are whole."""
        parts = []
        for name in self.fields[path]:
            part = values[name]
            if part.dtype.kind == "b":
                part = part.view(np.uint8) != 0
            parts.append(part.astype(np.float64 if part.dtype.kind == "f" else np.int64))
        if len(parts) == 1:
            return parts[0]
        return np.concatenate([np.empty((len(values), 0), np.int64), *parts], axis=1)


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
        self.seen: dict[
            tuple[str, ...], None
        ] = {}  # the texts of other elements, while none was found
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
            left = (
                left[:0] if rows.size == left.size else np.setdiff1d(left, rows, assume_unique=True)
            )
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
        columns = {
            path: _joined([(rows, found[path]) for rows, found in parts]) for path in self._paths
        }
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
            raise LogError(
                f"a message of {size} bytes has {layout.size} by its schema ({self._type_name})",
                "the schema in the log does not match the messages",
            )
        return rows, plan, values

    def _with_layout(self, block: Block, rows: Rows, plan: _Plan) -> tuple[Rows, Array]:
        """Read those of some messages that have a layout: its size, apart from padding at the end, and its lengths."""
        # All that is read of a message is inside its record, since none is shorter than the layout.
        padding = block.sizes[rows] - plan.size
        fits = (padding >= 0) & (padding <= (3 if self._is_cdr else 0))
        rows = rows if fits.all() else rows[fits]
        values = gather(block.buffer, block.offsets[rows], plan.dtype)
        fits = np.ones(rows.size, np.bool_)
        for name, word in plan.checks.items():
            fits &= values[name] == word
        if fits.all():
            return (rows, values)
        return (rows[fits], values[fits])

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

    def _wanted(self, plan: _Plan, values: Array, element: Element) -> Mask:
        """Find the elements with the texts that are wanted, (messages, elements)."""
        end = b"\0" if self._is_cdr else b""
        asked = [np.frombuffer(text.encode() + end, np.uint8) for text in element.texts]
        wanted = np.zeros((len(values), len(plan.texts)), np.bool_)
        for i, names in enumerate(plan.texts):
            texts = [values[name] for name in names]
            if asked and all(
                text.shape[1] == one.size for text, one in zip(texts, asked, strict=True)
            ):
                wanted[:, i] = np.all(
                    [(text == one).all(axis=1) for text, one in zip(texts, asked, strict=True)],
                    axis=0,
                )
            if not self._is_found and not wanted[:, i].any():
                for row in np.unique(np.concatenate(texts, axis=1), axis=0)[:_MOST_SEEN]:
                    parts = np.split(row, np.cumsum([text.shape[1] for text in texts])[:-1])
                    if len(self.seen) < _MOST_SEEN:
                        decoded = (
                            part.tobytes().removesuffix(end).decode("utf-8", "replace")
                            for part in parts
                        )
                        self.seen[tuple(decoded)] = None
        self._is_found |= bool(wanted.any())
        return wanted


def _joined(parts: Sequence[tuple[Rows, Array]]) -> Array:
    """Bring the rows of several layouts into the order of the messages."""
    if len(parts) == 1:
        return parts[0][1]
    rows = np.concatenate([np.empty(0, np.int64), *(rows for rows, _ in parts)])
    places = np.empty_like(rows)
    width = max((values.shape[1] for _, values in parts), default=0)
    places[np.argsort(rows, kind="stable")] = np.arange(rows.size)
    same = all(values.shape[1] == width and values.dtype == np.int64 for _, values in parts)
    joined = np.zeros((rows.size, width), np.int64) if same else np.full((rows.size, width), np.nan)
    start = 0
    for found, values in parts:
        joined[places[start : start + found.size], : values.shape[1]] = values
        start += found.size
    return joined
