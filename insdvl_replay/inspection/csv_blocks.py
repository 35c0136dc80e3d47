"""What a log holds, as CSV: one block for each kind of thing."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.report.csv_tables import rows_csv


def inventory_csv(inventory: Inventory) -> str:
    """Write what is known of a log as tables one after the other, a blank line between them.

    Parameters
    ----------
    inventory : Inventory

    Returns
    -------
    str
        Every line begins with the columns ``table`` and ``log``, the header's too, so that one table is easily cut out
        and several logs laid together. Between several values in a cell stands ``; ``. Tables without rows are left
        out, and so are proposed settings, which are none.
    """
    records: dict[str, Sequence[Any]] = {
        "file": [inventory.log],
        "topics": inventory.topics,
        "roles": inventory.roles,
        "clocks": inventory.clocks,
        "pings": [inventory.pings] if inventory.pings else [],
        "reference": [inventory.reference] if inventory.reference else [],
        "notes": inventory.notes,
        "obstacles": inventory.obstacles,
    }
    blocks = [_block(inventory.log.name, name, *_columns(rows)) for name, rows in records.items() if rows]
    conventions = [(topic, key, value) for topic, keys in inventory.conventions.items() for key, value in keys.items()]
    if conventions:
        blocks.append(_block(inventory.log.name, "conventions", ("topic", "key", "value"), conventions))
    return "\n".join(blocks)


def _columns(records: Sequence[Any]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Give the names of the fields of records of one kind, and their values."""
    names = tuple(field.name for field in fields(records[0]))
    return names, [tuple(getattr(record, name) for name in names) for record in records]


def _block(log: str, table: str, header: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> str:
    return rows_csv(("table", "log", *header), ((table, log, *map(_cell, row)) for row in rows))


def _cell(value: Any) -> Any:
    match value:
        case dict():
            return "; ".join(f"{key}={part}" for key, part in value.items())
        case tuple() | list():
            return "; ".join(map(str, value))
    return value
