"""Sentences: lines of text with a name, cells between commas, and a checksum behind a star.

What stands in front of a sentence in its line, such as a time of arrival, is not read. Source: NMEA 0183 for sentences
that begin with ``$``; makers have others of the same form.
"""

import math
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import (
    Floats,
    Mask,
)
from insdvl_replay.logs.formats.instrument_file import (
    InstrumentFile,
    Record,
)
from insdvl_replay.logs.formats.log_file import FileBytes

_NUMBERS: Final = re.compile(rb"\d+")
_LONGEST_SHAPE: Final = 40  # bytes of what is in front of a sentence, by which it is told apart
_MOST_SHAPES: Final = 1000
_OTHER_SHAPES: Final = b"others"
_AT_A_TIME: Final = 1 << 14  # sentences whose checksums are computed together
Bytes = NDArray[np.uint8]  # (k, n): lines side by side, with zeros in front of short ones


class Sentence(NamedTuple):
    """A sentence whose checksum is right."""

    offset: int
    name: str
    cells: list[bytes]


class Decoded(NamedTuple):
    """The numbers of a sentence."""

    kind: str  # sentences of one kind have the same count of numbers
    numbers: list[float]


class _Candidate(NamedTuple):
    """What looks like a sentence."""

    offset: int
    body: bytes  # that the checksum covers
    checksum: int


class SentenceFile(InstrumentFile):
    """A file of sentences; a reader knows how they begin, and their checksum."""

    records = "sentences"
    # A sentence: group 1 is what the checksum covers, group 2 the checksum.
    form: ClassVar[re.Pattern[bytes]] = re.compile(rb"\$([^$*]{0,1000})\*([0-9A-Fa-f]{2})")

    def __init__(self, file: FileBytes) -> None:
        # How many sentences begin their lines so, by the shape of what is in front of them, and where the first does.
        self._in_front = Counter[bytes]()
        self._first_in_front: dict[bytes, int] = {}
        super().__init__(file)

    @staticmethod
    def checksums(lines: Bytes) -> Bytes:
        """Return the checksums of lines, (k,): of NMEA, the exclusive or of all bytes."""
        return np.asarray(np.bitwise_xor.reduce(lines, axis=1))

    @abstractmethod
    def decode(self, sentence: Sentence) -> Decoded | None:
        """Return the numbers of a sentence and the kind of its row; None where it is of no use, and was passed over.

        A ValueError or an IndexError says that its cells are not as they should.
        """

    def rows(self) -> dict[str, Floats]:
        """Decode all sentences into rows by kind, (k, 1 + n): the place in the file, then the numbers."""
        parts: dict[str, list[Floats]] = {}
        for records in self.text_records():
            of_piece: dict[str, list[list[float]]] = {}
            for sentence in self._sound(records):
                try:
                    decoded = self.decode(sentence)
                except (ValueError, IndexError):
                    self.lose(sentence.offset, f"cells of {sentence.name} are not as they should")
                    continue
                if decoded is not None:
                    row = [float(sentence.offset), *decoded.numbers]
                    of_piece.setdefault(decoded.kind, []).append(row)
            for kind, rows in of_piece.items():
                parts.setdefault(kind, []).append(np.array(rows))
        self._lose_beginnings()
        return {kind: np.concatenate(found) for kind, found in parts.items()}

    def _sound(self, records: Sequence[Record]) -> Iterator[Sentence]:
        """Give the sentences of some lines whose checksum is right."""
        found: list[_Candidate] = []
        for record in records:
            found += self._candidates(record)
        for start in range(0, len(found), _AT_A_TIME):
            some = found[start : start + _AT_A_TIME]
            for candidate, is_right in zip(some, self._are_right(some), strict=True):
                if is_right:
                    yield _sentence(candidate)
                else:
                    what = "the checksum of a sentence is not that of its bytes"
                    self.lose(candidate.offset, what)

    def _candidates(self, record: Record) -> Iterator[_Candidate]:
        """Give what looks like a sentence in a line; more than one has lost the ends of lines between them."""
        content = record.content
        end = 0
        for match in self.form.finditer(content):
            before = content[end : match.start()]
            if not end:
                shape = _NUMBERS.sub(b"0", before)[:_LONGEST_SHAPE]
                if len(self._in_front) >= _MOST_SHAPES and shape not in self._in_front:
                    shape = _OTHER_SHAPES
                self._in_front[shape] += 1
                self._first_in_front.setdefault(shape, record.offset)
            elif before.strip():
                self.lose(record.offset + end, "something else is between two sentences")
            end = match.end()
            yield _Candidate(
                offset=record.offset + match.start(),
                body=match[1],
                checksum=int(match[2], 16),
            )
        if end and content[end:].strip():
            self.lose(record.offset + end, "something else is behind a sentence in its line")
        elif not end and (b"," in content or b"*" in content):
            self.lose(record.offset, "a line has no beginning of a sentence, or no checksum")
        elif not end and content.strip():
            self.pass_over("other text")

    def _lose_beginnings(self) -> None:
        """Lose what is in front of single sentences: what is in front of most is of the program that recorded them."""
        for shape, count in self._in_front.most_common()[1:]:
            what = "something else is in front of a sentence in its line"
            self.lose(self._first_in_front[shape], what, count)

    def _are_right(self, found: Sequence[_Candidate]) -> Mask:
        """Return which checksums are right, (k,)."""
        width = max(len(candidate.body) for candidate in found)
        padded = b"".join(candidate.body.rjust(width, b"\0") for candidate in found)
        lines = np.frombuffer(padded, np.uint8).reshape(len(found), -1)
        written = np.array([candidate.checksum for candidate in found], np.uint8)
        return np.asarray(self.checksums(lines) == written)


def _sentence(candidate: _Candidate) -> Sentence:
    """Split a sentence into its cells."""
    name, *cells = candidate.body.split(b",")
    return Sentence(
        offset=candidate.offset,
        name=name.decode("ascii", "replace"),
        cells=cells,
    )


def numbers(cells: Sequence[bytes], count: int) -> list[float]:
    """Return the numbers of so many cells, NaN of an empty one; a ValueError where one is none, or there are fewer."""
    if len(cells) < count:
        raise ValueError(f"{len(cells)} cells, where {count} are needed")
    return [float(cell) if cell.strip() else math.nan for cell in cells[:count]]
