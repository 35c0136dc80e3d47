"""Lines of a table that is text: their encoding, their separator, and what they hold."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

# In text with several of them the first one separates.
_SEPARATORS: Final = (b"\t", b";", b"|", b",")
_COMMENTS: Final = (b"#", b"%")


@dataclass(frozen=True)
class TextLines:
    """The lines of a table, blank ones left out."""

    lines: list[bytes]  # without comments
    comments: list[bytes]
    above: list[bytes]  # the comments above all other lines
    is_cut: bool  # the last line did not end, and is not among the lines

    @classmethod
    def of(cls, content: bytes) -> "TextLines":
        """Split a text in UTF-8 with the line ends of Unix."""
        written = [line for line in content.split(b"\n") if line.strip()]
        lines = [line for line in written if not is_comment(line)]
        is_cut = bool(lines) and not content.endswith(b"\n")
        if is_cut:
            lines.pop()
        comments = [line for line in written if is_comment(line)]
        return cls(lines, comments, list(takewhile(is_comment, written)), is_cut)


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


def counts_of_cells(lines: Sequence[bytes], separator: bytes | None) -> list[int]:
    """Return how many cells each line has."""
    if separator is None:
        return [len(line.split()) for line in lines]
    return [line.count(separator) + 1 for line in lines]


def last_words(comments: Sequence[bytes], separator: bytes | None, width: int) -> bytes:
    """Return the last comment that is no row of numbers, without its mark; empty without one."""
    for comment in reversed(comments):
        words = comment.strip(b" #%")
        if not is_row(words, separator, width):
            return words
    return b""


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
