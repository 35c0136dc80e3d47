"""Tables of a result by their names, as ``--table`` asks for them: for people, as CSV, as JSON."""

from collections.abc import Iterator, Sequence

from msgspec.structs import asdict, astuple

from insdvl_replay.core.errors import require_known
from insdvl_replay.core.tables import TABLES
from insdvl_replay.report.csv_tables import blocks_csv, rows_csv
from insdvl_replay.report.document import DisplayTable
from insdvl_replay.results.dive_tables import evidence_tables, filter_tables, reference_tables
from insdvl_replay.results.json_report import Report, as_json


def require_tables(names: Sequence[str]) -> None:
    """Raise a ConfigError, with the nearest name, if a table is not known."""
    for name in names:
        require_known("table", name, [layout.name for layout in TABLES], most=len(TABLES))


def tables_named(report: Report, name: str) -> Iterator[DisplayTable]:
    """Yield what people are shown of a table; its title begins with its name."""
    for table in (*evidence_tables(report), *filter_tables(report), *reference_tables(report)):
        if table.title.startswith(_BEGINNINGS.get(name, (name.replace("_", " ").capitalize(),))):
            yield table


_BEGINNINGS = {"consistency": ("Consistency", "Innovations")}
"""Of the titles of a table that is shown in two."""


def csv_of(reports: Sequence[Report], names: Sequence[str] = ()) -> str:
    """Write the rows of all dives as CSV: of one table alone as they are, of several a block a table."""
    layouts = [layout for layout in TABLES if layout.name in names or not names]
    blocks = {
        layout.name: (
            tuple(layout.columns),
            [astuple(row) for report in reports for row in getattr(report.tables, layout.name)],
        )
        for layout in layouts
    }
    return rows_csv(*blocks[names[0]]) if len(names) == 1 else blocks_csv("table", blocks)


def json_of(reports: Sequence[Report], names: Sequence[str]) -> bytes:
    """Write the rows of all dives as JSON, by the names of their tables."""
    rows = {name: [asdict(row) for report in reports for row in getattr(report.tables, name)] for name in names}
    return as_json(rows)
