"""Lines of a table that is text: their encoding, their separator, and what they hold."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

_SEPARATORS: Final = (
    b"\t",
    b";",
    b"|",
    b",",
)  # in text with several of them the first one separates
_COMMENTS: Final = (b"#", b"%")


def is_row(line: bytes, separator: bytes | None, width: int) -> bool:
    """Return whether a line has as many cells as the rows of a table, and numbers in the first two."""
    cells = line.split(separator)
    return len(cells) == width and all(map(is_number, cells[:2]))


def is_number(cell: bytes | str) -> bool:
    """Return whether a cell is a number, with a decimal point or comma."""
    text = cell.decode("utf-8", "replace") if isinstance(cell, bytes) else cell
    try:
        float(text.strip().strip('"').replace(",", "."))
    except ValueError:
        return False
    return True


def as_utf8(content: bytes) -> bytes:
    """Return text without a mark of its encoding, in UTF-8, with the line ends of Unix."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        content = content.decode("utf-16", "replace").encode()
    return content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def is_comment(line: bytes) -> bool:
    """Return whether a line begins with # or %."""
    return line.lstrip().startswith(_COMMENTS)


def separator_of(lines: Sequence[bytes]) -> bytes | None:
    """Return the mark that most of the last lines have; None for blanks."""
    sample = lines[1:][-200:] or lines or [b""]
    for mark in _SEPARATORS:
        if usual([line.count(mark) for line in sample]):
            return mark
    return None


def usual(counts: Sequence[int]) -> int:
    """Return the most common count; 0 for none."""
    if counts:
        return Counter(counts).most_common(1)[0][0]
    return 0


def first_row(lines: Sequence[bytes], separator: bytes | None) -> int:
    """Return the number of lines before the first one with a number."""
    for row, line in enumerate(lines):
        if any(map(is_number, line.split(separator))):
            return row
    return len(lines)
