"""Tables as CSV: UTF-8, LF, numbers in full, empty for what is missing, a row a line.

Text is shown as everywhere (`errors.visible`), and what a spreadsheet would run is kept from it by an apostrophe.
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import astuple

from insdvl_replay.core.errors import visible

if TYPE_CHECKING:
    # Only its type is needed, and whoever compares stored results must not wait for it.
    import pandas as pd

_FORMULA: Final = ("=", "+", "-", "@")
"""What a cell begins with that a spreadsheet takes for a formula; blanks before it are escapes by then."""


def table_csv(table: "pd.DataFrame") -> bytes:
    """Write a table as CSV.

    Returns
    -------
    bytes
        Header and rows. Floats have as many digits as it takes to read them back exactly.
    """
    return rows_csv(list(table.columns), table.itertuples(index=False, name=None)).encode()


def structs_csv(kind: type[Struct], rows: Iterable[Struct]) -> str:
    """Write rows of one type as CSV."""
    return rows_csv(kind.__struct_fields__, map(astuple, rows))


def blocks_csv(column: str, blocks: Mapping[str, tuple[Sequence[str], Iterable[Sequence[object]]]]) -> str:
    """Write tables one after the other, a blank line between them.

    Parameters
    ----------
    column : str
        Name of the column before all others, in which stands the name of each row's table: one is easily cut out.
    blocks : mapping of str to (header, rows)
        As of `rows_csv`, by the names of the tables.
    """
    return "\n".join(
        rows_csv((column, *header), ((name, *row) for row in rows)) for name, (header, rows) in blocks.items()
    )


def rows_csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Write rows as CSV.

    Parameters
    ----------
    rows : iterable of sequences
        None and NaN become empty. A text that begins with ``=``, ``+``, ``-`` or ``@`` and is no number, as the name of
        a dive may, gets an apostrophe before it: spreadsheets take it for a formula.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, str):
        text = visible(value)
        return f"'{text}" if text.startswith(_FORMULA) and not _is_number(text) else text
    return None if _is_missing(value) else value


def _is_number(text: str) -> bool:
    """Return whether a text is a number, as values of settings are."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_missing(value: object) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))
