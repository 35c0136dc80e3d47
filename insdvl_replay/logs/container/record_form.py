"""The form of a record: its header, and how long one of each kind must at least be.

Source: the MCAP specification, https://mcap.dev/spec.
"""

from typing import Final

RECORD_HEADER_SIZE: Final = 9
"""Bytes in front of each record's content: its kind and its length."""

LAST_KNOWN: Final = 15
"""Highest kind of record that the specification knows."""
_FIRST_PRIVATE: Final = 128
_LEAST_LENGTHS: Final = (0, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
"""What a record of each known kind must at least hold for its own fields."""


def can_be_record(opcode: int, length: int) -> bool:
    """Return whether a record of a kind can have a length."""
    if opcode > LAST_KNOWN:
        return opcode >= _FIRST_PRIVATE
    return opcode > 0 and length >= _LEAST_LENGTHS[opcode]
