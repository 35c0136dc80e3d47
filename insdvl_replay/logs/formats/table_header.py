"""Where the rows of a table of text begin, and which line above them names the columns."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from insdvl_replay.core.units import KNOWN_UNITS, spelled, unit_of
from insdvl_replay.logs.formats.table_text import is_number
from insdvl_replay.logs.formats.table_times import DATE_NAME, TIME_NAME

_LONGEST: Final = 100  # lines above the rows at most
_FEW_ROWS: Final = 2  # rows without a line of names above them: more of them have none


@dataclass(frozen=True)
class Header:
    """What is above the rows of a table."""

    names_at: int  # number of the line that names the columns
    rows_at: int  # of the first row
    titles: tuple[str, ...]  # with the units of a line of units


def find_header(lines: Sequence[bytes], separator: bytes | None, width: int) -> Header | None:
    """Find the line of names right above the first row with numbers; None where no line is clearly that.

    Lines before it, such as the name of an instrument, need not have the cells of the table.
    """
    cells = [_cells(line, separator) for line in lines[:_LONGEST]]
    above: list[int] = []  # lines of words right above
    rows = 0
    for number, row in enumerate(cells):
        kind = _kind_of(row, width)
        if kind is _Kind.OTHER:
            above = []
        elif kind is _Kind.WORDS:
            above.append(number)
        elif above:
            return _header(cells, above, number)
        else:
            rows += 1
            if rows > _FEW_ROWS:
                return None
    return None


class _Kind(Enum):
    """What a line is among those of a table."""

    NUMBERS = auto()
    WORDS = auto()
    OTHER = auto()


def _kind_of(row: Sequence[str], width: int) -> _Kind:
    """Tell a line by its cells: words may name columns where nearly all cells have some."""
    if len(row) != width:
        return _Kind.OTHER
    numbers = sum(map(is_number, row))
    filled = sum(map(bool, row))
    if 2 * numbers > filled:
        return _Kind.NUMBERS
    if numbers == 0 and filled >= max(width - 1, 2):
        return _Kind.WORDS
    return _Kind.OTHER


def _header(cells: Sequence[Sequence[str]], above: Sequence[int], rows_at: int) -> Header:
    """Choose the line of names: one that names a time, else the last that is no line of units."""
    timed = [number for number in above if any(map(_names_time, cells[number]))]
    words = [number for number in above if not _are_units(cells[number])]
    names_at = above[0]
    if timed:
        names_at = timed[0]
    elif words:
        names_at = words[-1]
    titles = list(cells[names_at])
    for number in above:
        if number > names_at and _are_units(cells[number]):
            titles = list(map(_with_unit, titles, cells[number]))
    return Header(names_at, rows_at, tuple(titles))


def _with_unit(title: str, unit: str) -> str:
    if unit and not unit_of(title):
        return f"{title} [{unit.strip('[]()')}]"
    return title


def _cells(line: bytes, separator: bytes | None) -> list[str]:
    return [cell.decode("utf-8", "replace").strip().strip("\"'") for cell in line.split(separator)]


def _names_time(title: str) -> bool:
    name = title.partition("[")[0].partition("(")[0].strip().lower().replace(" ", "_")
    return bool(TIME_NAME.search(name) or DATE_NAME.search(name))


def _are_units(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell and cell != "-"]
    units = [cell for cell in filled if spelled(cell.strip("[]()")) in KNOWN_UNITS]
    return 2 * len(units) > len(filled)


class ColumnNames:
    """Names of columns, each once: of equal ones, the second is ``name_2``."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._counts: Counter[str] = Counter()

    def unique(self, name: str) -> str:
        """Return the name, or the next with a number that no column has."""
        unique = name
        self._counts[name] += 1
        while unique in self._taken:
            unique = f"{name}_{self._counts[name]}"
            self._counts[name] += 1
        self._taken.add(unique)
        return unique
