"""Layouts of messages in ULog files: texts such as `float[3] velocity;` become types of numpy.

Source: PX4 User Guide, "ULog File Format" v1.16, https://docs.px4.io/v1.16/en/dev_log/ulog_file_format.html.
"""

import re
from typing import Any, Final

import numpy as np

LONGEST: Final = (1 << 16) + 3
"""Bytes of a message."""
_SCALARS: Final = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "u1",
}  # fmt: skip
_UNREAD: Final = {"char": 1}  # bytes
_FIELD: Final = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
_DEEPEST: Final = 8  # layouts within each other


class Layouts:
    """The layouts that a file has told so far, by name."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._dtypes: dict[str, np.dtype[Any] | None] = {}

    def __contains__(self, name: str) -> bool:
        """Return whether the file has told a layout."""
        return name in self._texts

    def add(self, content: bytes) -> None:
        """Take a layout as its message has it; one that is told again changes nothing."""
        name, _, fields = content.decode("ascii", "replace").partition(":")
        self._texts.setdefault(name, fields)

    def subscribed(self, name: str) -> np.dtype[Any] | None:
        """Return the type of the messages of a topic: what fills up their end is not written."""
        dtype = self._dtype(name)
        if dtype is None:
            return None
        labels = list(dtype.names or ())
        while labels and labels[-1].startswith("_padding"):
            del labels[-1]
        if not labels:
            return None
        return np.dtype([(label, dtype[label]) for label in labels])

    def _dtype(self, name: str, level: int = 0) -> np.dtype[Any] | None:
        """Return the type of the messages of a layout; None where it is not known, or cannot be."""
        if name not in self._dtypes:
            self._dtypes[name] = None
            if level <= _DEEPEST:
                self._dtypes[name] = self._dtype_of_fields(self._texts.get(name, ""), level)
        return self._dtypes[name]

    def _dtype_of_fields(self, texts: str, level: int) -> np.dtype[Any] | None:
        """Return the type of a message with some fields, such as `float[3] velocity`."""
        fields: dict[str, Any] = {}
        for text in texts.rstrip(";").split(";"):
            field = _FIELD.fullmatch(text.strip())
            if field is None or field[3] in fields:
                return None
            field_type = self._field_type(field[1], int(field[2] or 1), level)
            if field_type is None:
                return None
            fields[field[3]] = field_type
        dtype = np.dtype(list(fields.items()))
        return dtype if dtype.itemsize < LONGEST else None

    def _field_type(
        self,
        type_name: str,
        count: int,
        level: int,
    ) -> Any:
        """Return the type of a field; what is read of no message is its bytes."""
        if type_name in _SCALARS:
            return (_SCALARS[type_name], (count,)) if count > 1 else _SCALARS[type_name]
        size = _UNREAD.get(type_name)
        if size is None:
            inner = self._dtype(type_name, level + 1)
            if inner is None:
                return None
            size = inner.itemsize
        return f"V{size * count}" if size * count < LONGEST else None
