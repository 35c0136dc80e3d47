"""Those elements of a list in messages that have certain texts, such as the transforms between two frames among many.

Messages of one layout have their texts in the same places, so that these are compared for all of them at once.
"""

from collections.abc import Mapping, Sequence
from itertools import count, takewhile
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.encoding.binary_fields import BinaryReader
from insdvl_replay.logs.encoding.fields import ROWS, Columns, Element
from insdvl_replay.logs.encoding.layout import Layout, Wire
from insdvl_replay.logs.encoding.ros2msg import Definition

_MOST_SEEN: Final = 100
"""Combinations of texts that are remembered for an error."""


class ElementReader(BinaryReader):
    """Reads some fields of the elements of a list that have the texts wanted: a row for each of them.

    Attributes
    ----------
    seen : dict of tuple of str to None
        The texts of other elements, while none was found.
    """

    def __init__(
        self, definitions: Mapping[str, Definition], type_name: str, paths: Sequence[str], wire: Wire, element: Element
    ) -> None:
        super().__init__(definitions, type_name, paths, wire)
        self._element = element
        self._end = b"\0" if wire.head else b""
        self._found = False
        self.seen: dict[tuple[str, ...], None] = {}

    def columns(self, block: Block) -> Columns:
        """Read the fields, shape (rows, n), and as `ROWS` of which message each row is, shape (rows, 1)."""
        data = np.frombuffer(block.buffer, np.uint8)
        parts: list[Columns] = []
        for rows, layout, columns in self.groups(block):
            elements = self._elements(layout)
            wanted = self._are_wanted(data, block.offsets[rows], layout, elements)
            found = {ROWS: rows[np.nonzero(wanted)[0]][:, None]}
            for path, values in columns.items():
                found[path] = values.reshape(rows.size, elements, -1)[wanted] if elements else values
            parts.append({path: values for path, values in found.items() if values.size})
        return self._in_order([part for part in parts if part])

    def _in_order(self, parts: Sequence[Columns]) -> Columns:
        if not parts:
            return {ROWS: np.empty((0, 1), np.int64)}
        joined = {path: np.concatenate([part[path] for part in parts]) for path in parts[0]}
        order = np.argsort(joined[ROWS][:, 0], kind="stable")
        return {path: values[order] for path, values in joined.items()}

    def _elements(self, layout: Layout) -> int:
        """Count the elements of the list in a layout."""
        first = self._element.fields[0]
        return sum(1 for _ in takewhile(lambda i: self._name(i, first) in (layout.dtype.fields or {}), count()))

    def _name(self, i: int, field: str) -> str:
        return f"{self._element.list_name}[{i}].{field}"

    def _are_wanted(
        self, data: NDArray[np.uint8], starts: NDArray[np.int64], layout: Layout, elements: int
    ) -> NDArray[np.bool_]:
        """Find the elements with the texts that are wanted, shape (messages, elements)."""
        wanted = np.zeros((starts.size, elements), np.bool_)
        for i in range(elements):
            texts = [self._texts(data, starts, layout, self._name(i, field)) for field in self._element.fields]
            if self._element.texts:
                wanted[:, i] = np.all(
                    [self._equal(*pair) for pair in zip(texts, self._element.texts, strict=True)], axis=0
                )
            if not self._found and not wanted[:, i].any():
                self._remember(texts)
        self._found |= bool(wanted.any())
        return wanted

    def _texts(
        self, data: NDArray[np.uint8], starts: NDArray[np.int64], layout: Layout, name: str
    ) -> NDArray[np.uint8]:
        """Return the bytes of a text, shape (messages, bytes), which lie in the messages as those have the layout."""
        dtype, offset = dict(layout.dtype.fields or {})[name][:2]
        return np.asarray(data[starts[:, None] + offset + np.arange(dtype.itemsize)])

    def _equal(self, texts: NDArray[np.uint8], wanted: str) -> NDArray[np.bool_]:
        bytes_ = np.frombuffer(wanted.encode() + self._end, np.uint8)
        if texts.shape[1] != bytes_.size:
            return np.zeros(len(texts), np.bool_)
        return np.asarray((texts == bytes_).all(axis=1))

    def _remember(self, texts: Sequence[NDArray[np.uint8]]) -> None:
        edges = np.cumsum([one.shape[1] for one in texts])[:-1]
        for row in np.unique(np.concatenate(texts, axis=1), axis=0)[:_MOST_SEEN]:
            parts = (part.tobytes().removesuffix(self._end) for part in np.split(row, edges))
            if len(self.seen) < _MOST_SEEN:
                self.seen[tuple(part.decode("utf-8", "replace") for part in parts)] = None
