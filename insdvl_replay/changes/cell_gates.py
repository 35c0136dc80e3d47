"""Gates on cells of tables: limits, allowed values, and the allowed loss against an expected value.

A missing, empty or non-numeric value never passes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from insdvl_replay.changes.cells import (
    Moved,
    RowPair,
    agree,
    cell_name,
    is_number,
    judge_cell,
    unit_of_change,
)
from insdvl_replay.changes.findings import Finding
from insdvl_replay.changes.gate_file import CellGate
from insdvl_replay.core.quantities import WITHOUT_VERDICT
from insdvl_replay.core.report import Cell, StoredReport
from insdvl_replay.core.words import ChangeVerdict, ReferenceStatus
from insdvl_replay.document.tables import numbers_apart

# Further cells that state a gain or loss against the baseline.
OF_GAIN: Final = frozenset(
    (
        ("filters", "prediction"),
        ("evidence", "moves"),
        ("evidence", "acts"),
        ("outage", "ratio_to_baseline"),
        ("outage", "windows_won_pct"),
    )
)
# Behind the change of a size that is not the value itself.
_OF_SIZE: Final = {"nearer zero": " in magnitude", "nearer dof": " farther from dof"}


def gate_findings(
    gate: CellGate, report: StoredReport, expected: StoredReport | None
) -> tuple[Finding, ...]:
    """Return a finding for each cell that a gate checks; one failed finding if it checks none.

    A star in the gate also checks rows that only the expected values have.
    """
    findings = [_finding(gate, pair, report) for pair in gate.rows_of(expected, report)]
    if findings:
        return tuple(findings)
    sentence = (
        f"{report.log.name} has no row for table {gate.table}, filter {gate.filter}, row {gate.row}, "
        f"column {gate.column}"
    )
    return (
        Finding(
            gate.table, gate.filter, gate.row, gate.column, None, None, sentence, passed=False
        ),
    )


@dataclass(frozen=True)
class _Case:
    """One cell that a gate checks."""

    gate: CellGate
    pair: RowPair
    unit: str
    moved: Moved | None  # against the expected value; None if they are not two numbers
    verdict: str  # on the filter; empty for the baseline
    why: str  # the filter is not evaluated; empty if it is

    @property
    def old(self) -> Cell:
        """The expected value; None without one."""
        return self.pair.old.get(self.gate.column)

    @property
    def value(self) -> Cell:
        """The value; None without one."""
        return self.pair.new.get(self.gate.column)

    @property
    def because(self) -> str:
        """Why the filter is not evaluated, behind its verdict; empty if it is, or if its result does not say why."""
        if self.why:
            return f" ({self.why})"
        return ""

    @property
    def in_unit(self) -> str:
        """The unit, behind a value."""
        if self.unit:
            return f" {self.unit}"
        return ""


def _finding(gate: CellGate, pair: RowPair, report: StoredReport) -> Finding:
    """Check one cell."""
    column = gate.column
    moved = None
    is_compared = gate.expected is not None
    if is_compared and is_number(pair.old.get(column)) and is_number(pair.new.get(column)):
        moved = judge_cell(pair, column, gate.max_worse_pct, gate.max_worse_abs)
    unit = pair.layout.unit_of(column, pair.unit)
    case = _Case(
        gate, pair, unit, moved, _verdict_of(pair, report), _why_not_evaluated(pair, report)
    )
    statement = f"is {value_text(case.value)}{case.in_unit}"
    limit = ""
    if moved is not None:
        limit = _limit_text(case)
        statement = _change_text(case, moved, limit)
    complaint = _complaint(case, statement)
    name = cell_name(pair.layout.name, pair.filter, pair.row, column, report.baseline)
    return Finding(
        table=pair.layout.name,
        filter=pair.filter,
        row=pair.row,
        column=column,
        expected=case.old,
        value=case.value,
        sentence=f"{name} {statement if complaint is None else complaint}",
        passed=complaint is None,
        unit=case.unit if pair.new else "",
        limit=limit,
    )


def _verdict_of(pair: RowPair, report: StoredReport) -> str:
    """Return the verdict on the filter of a cell; empty for the baseline."""
    return str(report.filters.get(pair.filter, {}).get("verdict") or "")


def _why_not_evaluated(pair: RowPair, report: StoredReport) -> str:
    """Return why the filter of a cell is not evaluated, on one dive or on all of them; empty if it is."""
    on_dive = report.filters.get(pair.filter, {})
    for verdict, reason in (
        (on_dive.get("verdict"), on_dive.get("reason")),
        (pair.new.get("verdict"), pair.new.get("reason")),
    ):
        if verdict in WITHOUT_VERDICT and reason:
            return str(reason)
    return ""


# --- What is said of a value.


def _limit_text(case: _Case) -> str:
    """Write the allowed loss with its sign, such as ``+5 %``."""
    gate = case.gate
    is_gain = case.pair.layout.better.get(gate.column) == "higher"
    sign = "-" if is_gain else "+"
    limits = list[str]()
    if gate.max_worse_pct is not None:
        limits.append(f"{sign}{gate.max_worse_pct:g} {unit_of_change(gate.column)}")
    if gate.max_worse_abs is not None:
        limits.append(f"{sign}{gate.max_worse_abs:g}{case.in_unit}")
    return " or ".join(limits)


def _change_text(case: _Case, moved: Moved, limit: str) -> str:
    """Write both values, their change and the allowed loss: ``1.54 -> 3.27 m (+112 %, limit +5 %)``."""
    column = case.gate.column
    old = case.old
    value = case.value
    assert is_number(old)
    assert is_number(value)
    change_pct = moved.change_pct
    if agree(value, old, column):  # processors differ in the last digits
        value = old
        change_pct = None if change_pct is None else 0.0
    details = list[str]()
    if change_pct is not None:
        of_size = _OF_SIZE.get(moved.better or "", "")
        details.append(f"{change_pct:+.3g} {unit_of_change(column)}{of_size}")
    details.append(f"limit {limit}")
    return f"{' -> '.join(numbers_apart(old, value))}{case.in_unit} ({', '.join(details)})"


def value_text(value: Cell) -> str:
    """Write a value with enough digits to differ from its limit; words are unchanged."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


# --- What is wrong with it.


def _complaint(case: _Case, statement: str) -> str | None:
    """Return why a cell does not pass; None if it does. The statement says how a value changed."""
    if not case.pair.new:
        return f"is missing, and so is its row; expected: {value_text(case.old)}"
    unusable = _why_unusable(case)
    if unusable is not None:
        return unusable
    broken = [*_not_allowed(case), *_beyond_limits(case), *_worse_than_expected(case, statement)]
    if broken:
        return "; ".join(broken)
    return None


def _why_unusable(case: _Case) -> str | None:
    """Return why a value can meet no condition; None if it can."""
    layout = case.pair.layout
    column = case.gate.column
    row = case.pair.new
    value = case.value
    # A gain or loss fails if the filter is not evaluated; the verdict itself can pass.
    is_relative = not layout.baseline_too or layout.name == "drift"
    is_gain = (layout.name, column) in OF_GAIN or (is_relative and column in layout.better)
    if is_gain and case.verdict in WITHOUT_VERDICT:
        return f"is {value_text(value)}, but the filter is {case.verdict}{case.because}"
    if row.get("status") == ReferenceStatus.PARTLY_COVERED and column in layout.better:
        covered = (
            f"the reference does not cover the whole replay ({ReferenceStatus.PARTLY_COVERED})"
        )
        return f"is {value_text(value)}, but {covered}"
    if value in (None, "") or (isinstance(value, float) and not math.isfinite(value)):
        word = row.get("status") or row.get("verdict")
        if word:
            return f"is empty ({word})"
        return "is empty"
    return None


def _not_allowed(case: _Case) -> Iterator[str]:
    """Complain of a value that is none of the allowed ones."""
    wanted = case.gate.wanted
    if wanted and not _is_allowed(case.value, case.gate):
        because = case.because if case.value in WITHOUT_VERDICT else ""
        required = " or ".join(map(value_text, wanted))
        yield f"is {value_text(case.value)}{because}, required: {required}"


def _is_allowed(value: Cell, gate: CellGate) -> bool:
    """Return whether a value is one of the allowed ones, a number up to rounding."""
    if value in gate.wanted and not isinstance(value, bool):
        return True
    for wanted in gate.wanted:
        if isinstance(value, float) and is_number(wanted) and agree(value, wanted, gate.column):
            return True
    return False


def _beyond_limits(case: _Case) -> Iterator[str]:
    """Complain of a value below the minimum or above the maximum, or that is no number."""
    least = case.gate.min
    most = case.gate.max
    value = case.value
    if least is None and most is None:
        return
    if not is_number(value):
        yield f"is the word {value!r}, required: a number"
        return
    found = f"is {value_text(value)}{case.in_unit}"
    column = case.gate.column
    if least is not None and value < least and not agree(value, least, column):
        yield f"{found}, required: at least {value_text(least)}"
    if most is not None and value > most and not agree(value, most, column):
        yield f"{found}, required: at most {value_text(most)}"


def _worse_than_expected(case: _Case, statement: str) -> Iterator[str]:
    """Complain of a value that is worse than the expected one by more than allowed, or cannot be compared with it."""
    moved = case.moved
    if moved is None:
        if case.gate.expected is not None:
            yield "has no expected number"
    elif moved.better is None:
        yield "cannot be compared: degrees of freedom (dof) are missing here or in the expected values"
    elif moved.verdict == ChangeVerdict.WORSE:
        yield statement
