"""Write the ROS definitions of the tables' rows from their types."""

from collections.abc import Iterator
from pathlib import Path

from insdvl_replay.core.tables import TABLES, TableLayout

FOLDER = Path(__file__).resolve().parents[2] / "schemas" / "insdvl_msgs" / "msg"
TYPES = {"text": "string", "count": "uint32", "number": "float64", "flag": "bool"}


def message_definition(layout: TableLayout) -> str:
    """Give the text of a table's message type; a column that says something begins a paragraph."""
    return "\n".join(_lines(layout)) + "\n"


def _lines(layout: TableLayout) -> Iterator[str]:
    yield from (f"# {layout.about}", "", "# End of the dive.", "std_msgs/Header header")
    for name, column in layout.columns.items():
        if column.comment:
            yield from ("", f"# {column.comment}")
        yield f"{TYPES[layout.kinds[name]]} {name}"


if __name__ == "__main__":
    for layout in TABLES:
        (FOLDER / f"{layout.row.__name__}.msg").write_text(message_definition(layout), "utf-8")
