"""Tables: rows become a `DisplayTable` for people, whose values are text, or CSV."""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import astuple

from insdvl_replay.core.errors import Note, visible
from insdvl_replay.core.quantities import label
from insdvl_replay.core.tables import layout_of, share_text
from insdvl_replay.document.parts import (
    PAGE,
    Block,
    CellText,
    DisplayTable,
    Document,
    Figure,
    Format,
    Heading,
    Html,
    Only,
    Part,
)

if TYPE_CHECKING:
    import pandas as pd

MISSING: Final = "-"
SMALLEST_SHOWN: Final = 0.0001  # of a probability
TENFOLD: Final = 10.0  # A larger ratio has as many digits as other numbers.


def number(value: float | None) -> str:
    """Write a number with four significant digits, without an exponent where that stays short."""
    if value is None or math.isnan(value):
        return MISSING
    if value == 0.0 or math.isinf(value):
        return f"{value:g}"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return f"{value:.{max(3 - exponent, 0)}f}"
    return f"{value:.2e}"


def signed_number(value: float) -> str:
    """Write a number with its sign."""
    sign = "-" if value < 0.0 else "+"
    return f"{sign}{number(abs(value))}"


def decimal(value: float | None, digits: int) -> str:
    """Write a number with a fixed number of digits after the point."""
    if value is None or math.isnan(value):
        return MISSING
    return f"{value:.{digits}f}"


def probability(value: float | None) -> str:
    """Write a probability with four decimals, one that would be zero by its bound."""
    if value is not None and 0.0 <= value < SMALLEST_SHOWN / 2.0:
        return f"< {SMALLEST_SHOWN}"
    return decimal(value, 4)


def significant(value: float | None, digits: int = 2) -> str:
    """Write a number with a fixed number of significant digits."""
    if value is None or math.isnan(value):
        return MISSING
    return f"{value:.{digits}g}"


def numbers_apart(old: float, new: float) -> tuple[str, str]:
    """Write two numbers with three digits, or with as many as it takes to tell them apart."""
    for digits in range(3, 18):
        before = f"{old:.{digits}g}"
        after = f"{new:.{digits}g}"
        if before != after:
            return before, after
    return f"{old:.3g}", f"{new:.3g}"


def percent(value: float | None) -> str:
    """Write a percentage with one digit."""
    if value is None or math.isnan(value):
        return MISSING
    return f"{value:z.1f} %"


def ratio(value: float | None) -> str:
    """Write a ratio with three decimals, one of ten and more with four digits."""
    if value is None or abs(value) < TENFOLD:
        return decimal(value, 3)
    return number(value)


def signed_percent(value: float | None) -> str:
    """Write a change in percent with its sign: one decimal, two if it is small, none near zero."""
    if value is None:
        return MISSING
    if abs(value) < 0.005:
        return "0"
    if abs(value) >= 0.95:
        return f"{value:+.1f}"
    return f"{value:+.2f}"


def plain_text(value: object) -> str:
    """Write a number with four digits, anything else as it is."""
    if value is None or isinstance(value, float):
        return number(value)
    return str(value)


# The format of a column's values, by the name in its row type.
FORMS: Final[Mapping[str, Callable[[Any], CellText]]] = {
    "": plain_text,
    "label": label,
    "short": lambda name: label(name).replace("accelerometer", "accel."),
    "words": lambda value: value.replace("_", " "),
    "percent": percent,
    "ratio": ratio,
    "probability": probability,
    "significant": significant,
    "value": partial(significant, digits=3),
    "signed_percent": signed_percent,
    "share": share_text,
    "day": lambda stamp: stamp[: len("2026-01-31")],
    **{str(digits): partial(decimal, digits=digits) for digits in range(5)},
}

# Heading; alignment; the text of a cell, or the row's key with its format after a colon, such as ``sd:percent``.
ShownColumn = tuple[str, str, Callable[[Any], CellText] | str]


def table_of(
    title: str,
    rows: "Iterable[Any] | pd.DataFrame",
    columns: Sequence[ShownColumn],
    footnote: str = "",
    spare: tuple[int | tuple[int, ...], ...] = (),
    folds: int = 0,
) -> DisplayTable:
    """Return a table with a row for each of ``rows``: objects, mappings, or those of a frame."""
    listed: list[Any] = rows.to_dict("records") if hasattr(rows, "to_dict") else list(rows)
    heads = []
    letters = []
    for head, letter, _ in columns:
        heads.append(head)
        letters.append(letter)
    cells = []
    for row in listed:
        cells.append(tuple(_cell(row, written) for _, _, written in columns))
    return DisplayTable(
        title,
        tuple(heads),
        "".join(letters),
        tuple(cells),
        footnote,
        spare=spare,
        folds=folds,
    )


def _cell(row: Any, written: Callable[[Any], CellText] | str) -> CellText:
    """Write a cell of a row."""
    if not isinstance(written, str):
        return written(row)
    key, _, form = written.partition(":")
    value = row[key] if isinstance(row, dict) else attrgetter(key)(row)
    return FORMS[form](value)


def shown(
    kind: type[Struct], rows: Iterable[Struct], footnote: str = "", **names: str
) -> DisplayTable:
    """Return a table of rows of a type: its columns that have a head, in which ``{filter}`` is a name."""
    layout = layout_of("", kind)
    columns: list[ShownColumn] = []
    for name, column in layout.columns.items():
        if column.head:
            letter = "l" if layout.kinds[name] == "text" else "r"
            columns.append((column.head.format(**names), letter, f"{name}:{column.form}"))
    return table_of(layout.title.format(**names), rows, columns, footnote or layout.footnote)


def cell_lines(cell: CellText) -> list[str]:
    """Return the lines of a cell as they can be shown anywhere."""
    if isinstance(cell, str):
        return [visible(cell)]
    return [visible(line) for line in cell]


def notes_table(notes: Iterable[Note]) -> DisplayTable | str:
    """Return the notes as a table."""
    rows = []
    for note in notes:
        rows.append((str(note.count), note.severity, f"{note.text} [{note.code}]", note.hint))
    if not rows:
        return "No notes."
    title = "Notes on reading, preparing and filtering"
    return DisplayTable(title, ("count", "", "note", "hint"), "rlll", tuple(rows))


def parts_for(format_: Format, document: Document) -> Iterator[Part]:
    """Yield the parts that a format shows."""
    for part in document:
        if isinstance(part, Only):
            if format_ in part.formats:
                yield from part.parts
        elif format_ in PAGE or not isinstance(part, Heading | Figure | Html):
            yield part


# --- CSV: UTF-8, LF, numbers in full, empty for what is missing.

# A spreadsheet reads a cell with such a first character as a formula; leading blanks are escaped by then.
_FORMULA: Final = ("=", "+", "-", "@")


def rows_csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Write rows as CSV. A text that a spreadsheet would take for a formula gets an apostrophe before it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(_csv_cell, row) for row in rows)
    return text.getvalue()


def _csv_cell(value: object) -> object:
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return value
    if isinstance(value, dict):
        value = [f"{key}={part}" for key, part in value.items()]
    if isinstance(value, list | tuple):
        value = "; ".join(map(str, value))
    if not isinstance(value, str):
        return value
    text = visible(value)
    if not text.startswith(_FORMULA):
        return text
    try:
        float(text)  # values of settings are numbers, too
    except ValueError:
        return f"'{text}"
    return text


Rows = tuple[Sequence[str], Iterable[Sequence[object]]]  # Names of columns, and rows.


def header_and_rows(table: "Sequence[Struct] | Block | pd.DataFrame") -> Rows:
    """Return the names and the rows of a table; without rows of structs no name is known."""
    if isinstance(table, Block):
        return table.header, table.rows
    if isinstance(table, Sequence):
        header = table[0].__struct_fields__ if table else ()
        return header, map(astuple, table)
    return list(table.columns), table.itertuples(index=False, name=None)


def table_csv(table: "Sequence[Struct] | Block | pd.DataFrame") -> bytes:
    """Write a table as CSV. Floats have as many digits as it takes to read them back exactly."""
    return rows_csv(*header_and_rows(table)).encode()


def blocks_csv(column: str, blocks: Mapping[str, Rows]) -> str:
    """Write tables one after the other, a blank line between them; the first column, ``column``, has their names."""
    texts = []
    for name, (header, rows) in blocks.items():
        texts.append(rows_csv((column, *header), ((name, *row) for row in rows)))
    return "\n".join(texts)
