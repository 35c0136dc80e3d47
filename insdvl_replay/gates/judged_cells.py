"""Whether the cells of a result pass a gate. What is missing, empty or not a number never does."""

import difflib
import math
from collections.abc import Iterator
from typing import Final, TypeGuard

from insdvl_replay.changes.cells import (
    agree,
    direction_of,
    rounding,
    rounding_pct,
    rows_of,
    size,
    size_change_pct,
    within,
)
from insdvl_replay.core.stored_report import Cell, Row, StoredReport
from insdvl_replay.core.table import PERCENTAGE, TableLayout, layout_of
from insdvl_replay.core.tables import CANDIDATES, TABLES, PooledRow
from insdvl_replay.core.words import Judgement, ReferenceStatus
from insdvl_replay.gates.model import ANY, POOLED, Finding, Gate

LAYOUTS = (*TABLES, CANDIDATES, layout_of(POOLED, PooledRow))
OF_GAIN: Final = frozenset(
    (
        ("filters", "belief"),
        ("evidence", "word"),
        ("coasting", "ratio_to_baseline"),
        ("coasting", "ratio_low"),
        ("coasting", "ratio_high"),
        ("coasting", "windows_won_pct"),
    )
)
"""Cells beside those that can be better or worse, and those of filters by themselves, that speak of gain or loss."""
_Named = dict[tuple[str, str], Row]
"""Rows by filter and key."""


def gate_findings(gate: Gate, report: StoredReport, baseline: StoredReport | None) -> tuple[Finding, ...]:
    """Return a finding for each cell that a gate means, passed or not and why; one not passed if it means none."""
    findings = tuple(_findings(gate, report, baseline))
    if findings:
        return findings
    sentence = f"no row of {report.log.name} is meant by {_meaning(gate)}{_nearest(gate, report)}"
    return (Finding(gate.table, gate.filter, gate.row, gate.column, None, None, sentence, passed=False),)


def gated_rows(gate: Gate, report: StoredReport) -> Iterator[tuple[TableLayout, Row]]:
    """Yield each row that a gate means, cut down to what names it and what a comparison with it needs."""
    for layout in LAYOUTS:
        if gate.table in (ANY, layout.name):
            needed = ("log", "filter", layout.key, "unit", "dof", "evidence", gate.column)
            for row in rows_of(report, layout):
                if _is_meant(gate, layout, row):
                    yield layout, {name: row[name] for name in needed if name in row}


def _findings(gate: Gate, report: StoredReport, baseline: StoredReport | None) -> Iterator[Finding]:
    for layout in LAYOUTS:
        if gate.table not in (ANY, layout.name):
            continue
        before = {_name(row, layout): row for row in rows_of(baseline, layout)} if baseline else {}
        for row in rows_of(report, layout):
            if not _is_meant(gate, layout, row):
                continue
            was = before.get(_name(row, layout))
            complaint = _complaint(gate, layout, row, was, _is_unjudged(layout, row, gate, report))
            yield Finding(
                layout.name,
                str(row["filter"]),
                str(row[layout.key]),
                gate.column,
                was.get(gate.column) if was else None,
                row.get(gate.column),
                f"{_cell(gate, layout, row)} {complaint or _statement(layout, row, gate.column, was)}",
                passed=not complaint,
                unit=_unit(layout, row, gate.column).strip(),
                allowed=_allowed(gate),
            )
        yield from _removed_rows(gate, layout, before, report)


def _removed_rows(gate: Gate, layout: TableLayout, before: _Named, report: StoredReport) -> Iterator[Finding]:
    """Find the rows that the baseline has and the result lacks: a star in the gate means them, too."""
    left = {_name(row, layout) for row in rows_of(report, layout)}
    for (filter_, key), was in before.items():
        if (filter_, key) not in left and _is_meant(gate, layout, was):
            value = was.get(gate.column)
            sentence = f"{_cell(gate, layout, was)} is gone with its row, the baseline has {value_text(value)}"
            yield Finding(layout.name, filter_, key, gate.column, value, None, sentence, passed=False)


def _name(row: Row, layout: TableLayout) -> tuple[str, str]:
    return str(row["filter"]), str(row[layout.key])


def _is_meant(gate: Gate, layout: TableLayout, row: Row) -> bool:
    return (
        gate.filter in (ANY, row["filter"])
        and gate.row in (ANY, row[layout.key])
        and (gate.table != ANY or gate.column in row)
    )


def _is_unjudged(layout: TableLayout, row: Row, gate: Gate, report: StoredReport) -> bool:
    """Return whether a cell speaks of what a filter gains where nothing can be said of that; the verdict itself can."""
    candidate = report.filters.get(str(row["filter"]), {})
    held_against = not layout.baseline_too or layout.name == "drift"
    of_gain = (layout.name, gate.column) in OF_GAIN or (held_against and gate.column in layout.better)
    return of_gain and candidate.get("improvement") == Judgement.NOT_JUDGED


def _complaint(gate: Gate, layout: TableLayout, row: Row, was: Row | None, unjudged: bool) -> str:
    """State why a cell does not pass; nothing if it does."""
    value = row.get(gate.column)
    if unjudged:
        return f"is {value_text(value)}, and the filter is {Judgement.NOT_JUDGED}"
    if row.get("status") == ReferenceStatus.PARTLY_COVERED and gate.column in layout.better:
        return f"is {value_text(value)}, and the reference does not cover the replay ({ReferenceStatus.PARTLY_COVERED})"
    if value in (None, "") or (isinstance(value, float) and not math.isfinite(value)):
        word = row.get("status") or row.get("verdict")
        return f"is empty{f' ({word})' if word else ''}"
    complaints = [
        *_of_equality(gate, value),
        *_of_limits(gate, value, _unit(layout, row, gate.column)),
        *_of_baseline(gate, layout, row, was),
    ]
    return "; ".join(complaints)


def _of_equality(gate: Gate, value: Cell) -> Iterator[str]:
    if gate.equals is None:
        return
    wanted = gate.equals if isinstance(gate.equals, tuple) else (gate.equals,)
    if (value not in wanted or isinstance(value, bool)) and not any(_agree(value, one, gate.column) for one in wanted):
        yield f"is {value_text(value)}, {' or '.join(map(value_text, wanted))} is wanted"


def _of_limits(gate: Gate, value: Cell, unit: str) -> Iterator[str]:
    if gate.min is None and gate.max is None:
        return
    if not _is_number(value):
        yield f"is the word {value!r}, a number is wanted"
        return
    if gate.min is not None and not (value >= gate.min or agree(value, gate.min, gate.column)):
        yield f"is {value_text(value)}{unit}, at least {value_text(gate.min)} is wanted"
    if gate.max is not None and not (value <= gate.max or agree(value, gate.max, gate.column)):
        yield f"is {value_text(value)}{unit}, at most {value_text(gate.max)} is wanted"


def _of_baseline(gate: Gate, layout: TableLayout, row: Row, was: Row | None) -> Iterator[str]:
    """Compare with the stored value; of two allowances the larger one counts."""
    if gate.baseline is None:
        return
    was = was or {}
    old, new = was.get(gate.column), row[gate.column]
    better, dof = direction_of(layout, gate.column, row)
    dofs = direction_of(layout, gate.column, was)[1], dof
    if not _is_number(old) or not _is_number(new):
        yield "has no number in the baseline to compare with"
        return
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        yield "has no dof beside it, or none in the baseline, to compare by"
        return
    if better is None:
        return
    before, after = (size(value, better, dof) for value, dof in zip((old, new), dofs, strict=True))
    sign = -1.0 if better == "higher" else 1.0
    change_pct = size_change_pct(before, after, gate.column)
    worse_pct = math.inf * sign * (after - before) if change_pct is None else sign * change_pct
    in_percent = worse_pct, gate.max_worse_pct, rounding_pct(before, after, gate.column)
    in_unit = sign * (after - before), gate.max_worse_abs, rounding(before, after, gate.column)
    if any(allowed is not None and within(worse, allowed, digits) for worse, allowed, digits in (in_percent, in_unit)):
        return
    amount = f"by {worse_pct:.3g} {_percent(gate.column)}" if math.isfinite(worse_pct) else "beyond any percentage"
    yield f"{_statement(layout, row, gate.column, was)}: worse {amount}, {_allowed(gate)} is allowed"


def _agree(value: Cell, wanted: str | int | float, column: str) -> bool:
    return isinstance(value, float) and isinstance(wanted, float | int) and agree(value, wanted, column)


def _is_number(value: Cell) -> TypeGuard[float | int]:
    """Distinguish a number from a word, and from ``true`` and ``false``, which Python counts among them."""
    return isinstance(value, float | int) and not isinstance(value, bool)


def _allowed(gate: Gate) -> str:
    percent = None if gate.max_worse_pct is None else f"{gate.max_worse_pct:g} {_percent(gate.column)}"
    absolute = None if gate.max_worse_abs is None else f"{gate.max_worse_abs:g}"
    return " or ".join(limit for limit in (percent, absolute) if limit)


def _percent(column: str) -> str:
    return "percentage points" if column.endswith(PERCENTAGE) else "%"


def _cell(gate: Gate, layout: TableLayout, row: Row) -> str:
    names = dict.fromkeys((str(row["filter"]), str(row[layout.key])))
    return f"{layout.name} {' '.join(names)}: {gate.column}"


def _statement(layout: TableLayout, row: Row, column: str, was: Row | None) -> str:
    unit = _unit(layout, row, column)
    if was is None or was.get(column) is None:
        return f"is {value_text(row[column])}{unit}"
    return f"went from {value_text(was[column])} to {value_text(row[column])}{unit}"


def _unit(layout: TableLayout, row: Row, column: str) -> str:
    unit = layout.unit_of(column, str(row.get("unit", "")))
    return f" {unit}" if unit else ""


def value_text(value: Cell) -> str:
    """Write a value with enough digits to differ from its limit, words as they are."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _meaning(gate: Gate) -> str:
    return f"table {gate.table}, filter {gate.filter}, row {gate.row}, column {gate.column}"


def _nearest(gate: Gate, report: StoredReport) -> str:
    """Name what the gate may have meant."""
    rows = [(layout, row) for layout in LAYOUTS if gate.table in (ANY, layout.name) for row in rows_of(report, layout)]
    known = {
        gate.row: {str(row[layout.key]) for layout, row in rows},
        gate.filter: {str(row["filter"]) for _, row in rows},
    }
    for name, names in known.items():
        if name != ANY and name not in names:
            return "".join(
                f"; did you mean {near}?" for near in difflib.get_close_matches(name, sorted(names), n=1, cutoff=0.5)
            )
    return ""
