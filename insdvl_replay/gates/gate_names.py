"""Whether gates name what a result can have, which is asked before anything is replayed."""

from collections.abc import Iterable, Sequence

from insdvl_replay.core.errors import ConfigError, error_context, refuse_unknown
from insdvl_replay.core.table_layout import TableLayout
from insdvl_replay.core.tables import CANDIDATES, LAYOUTS
from insdvl_replay.gates.gate_file import Gates
from insdvl_replay.gates.model import ANY, Gate


def refuse_unknown_names(gates: Gates, filters: Sequence[str] | None) -> None:
    """Raise a ConfigError, with line and nearest name, if a gate names what no result can have.

    Parameters
    ----------
    filters : sequence of str or None
        Those that will be replayed, the baseline first; None if there are stored results, which may have others.
    """
    for gate in gates.content.gate:
        with error_context(gates.where(gate)):
            layouts = _layouts(gate)
            _refuse_unknown_rows(gate, layouts, filters)
            if filters is not None:
                refuse_unknown("filter", gate.filter, [ANY, *filters])
                _refuse_baseline(gate, layouts, filters)
            for layout in layouts:
                _refuse_unjudged(gate, layout)


def _layouts(gate: Gate) -> list[TableLayout]:
    """Give the tables that a gate means: those of its name that have its column."""
    refuse_unknown("table", gate.table, [ANY, *(layout.name for layout in LAYOUTS)])
    named = [layout for layout in LAYOUTS if gate.table in (ANY, layout.name)]
    refuse_unknown("column", gate.column, _unique(column for layout in named for column in _columns(layout)))
    return [layout for layout in named if gate.column in _columns(layout)]


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _refuse_unknown_rows(gate: Gate, layouts: Sequence[TableLayout], filters: Sequence[str] | None) -> None:
    """Refuse what is no row, as far as rows do not bear the names of filters that nobody knows yet."""
    if filters is None and CANDIDATES in layouts:
        return
    rows = [layout.rows or tuple((filters or ())[1:]) for layout in layouts]
    kind = " or ".join(_unique(layout.key for layout in layouts))
    refuse_unknown(kind, gate.row, [ANY, *_unique(row for of_table in rows for row in of_table)])


def _refuse_baseline(gate: Gate, layouts: Sequence[TableLayout], filters: Sequence[str]) -> None:
    """Refuse the baseline where it has no rows, but stands beside each candidate."""
    baseline, *candidates = filters
    if gate.filter == baseline and not any(layout.baseline_too for layout in layouts):
        raise ConfigError(
            f"filter '{baseline}' is the baseline, which has no rows of its own in {gate.table}",
            f"name a candidate: {', '.join(candidates)}; its rows have columns of the baseline, too",
        )


def _columns(layout: TableLayout) -> list[str]:
    """Give the columns that a gate may name."""
    return [name for name in layout.columns if name not in ("log", "filter", layout.key)]


def _refuse_unjudged(gate: Gate, layout: TableLayout) -> None:
    """Refuse a condition that the column's kind can never meet."""
    words = layout.kinds[gate.column] == "text"
    if words and not (gate.min is None and gate.max is None):
        raise ConfigError(f"column '{gate.column}' of {layout.name} holds words, which have no limits", "use equals")
    wanted = gate.equals if isinstance(gate.equals, tuple) else (gate.equals,)
    if gate.equals is not None and not any(isinstance(value, str) == words for value in wanted):
        kind = "words" if words else "numbers"
        raise ConfigError(f"equals: column '{gate.column}' of {layout.name} holds {kind}, found {gate.equals!r}")
    if gate.baseline is not None and gate.column not in layout.better:
        raise ConfigError(
            f"column '{gate.column}' of {layout.name} is neither better nor worse, so no baseline can be kept to",
            f"one of {', '.join(layout.better)}, or equals, min or max",
        )
