"""Evaluate each gate on each dive.

A missing, empty or non-numeric value never passes. Some gates compare a value, or the whole trajectory, with what is
expected.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
from msgspec.structs import asdict, replace

from insdvl_replay.changes.cells import (
    Moved,
    RowPair,
    agree,
    cell_name,
    is_number,
    judge_cell,
)
from insdvl_replay.changes.findings import (
    EVERY_DIVE,
    TRAJECTORY,
    CheckResult,
    Finding,
    GateOutcome,
)
from insdvl_replay.changes.gate_file import (
    POOLED,
    CellGate,
    Checked,
    Gate,
    Gates,
    TrajectoryGate,
    expected_of,
    expected_path,
    known_causes,
    stored_values,
    with_expected,
)
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ResultError, UserError
from insdvl_replay.core.quantities import WITHOUT_VERDICT
from insdvl_replay.core.report import Cell, StoredLog, StoredReport
from insdvl_replay.core.tables import PERCENTAGE, EvidenceRow, PooledRow
from insdvl_replay.core.words import ChangeVerdict, GateLevel, GateStatus, ReferenceStatus
from insdvl_replay.document.tables import numbers_apart
from insdvl_replay.results.folder import COMPLETE, TRAJECTORY_FILE
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.results.trajectory import Trajectory

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


# --- Dives.


def checked_results(folder: Path) -> Iterator[Checked]:
    """Yield stored results to check; the name of the log becomes part of the path of its expected values."""
    try:
        for result in read_results(folder)[0]:
            if is_dive_name(result.name):
                yield Checked(result.report, result.folder)
                continue
            error = ResultError(
                f"{result.folder / COMPLETE}: log.name = {result.name[:LONGEST_NAME]!r} is not a valid name of a dive",
                "replay its log again; the dive gets the name of the file",
            )
            yield Checked(error, result.folder)
    except UserError as error:
        yield Checked(error, folder)


def pooled_dive(dives: Sequence[Checked]) -> Checked:
    """Return the pooled evidence of all dives as one result, as the ``evidence.csv`` of several dives has it."""
    reports = [dive.result for dive in dives if isinstance(dive.result, StoredReport)]
    if not reports:
        return Checked(ResultError("no dive has a result", "see the dives above"), Path(EVERY_DIVE))
    rows = [asdict(row) for row in _pooled_rows(reports)]
    report = StoredReport({}, StoredLog(EVERY_DIVE), {POOLED: rows}, baseline=reports[0].baseline)
    return Checked(report, Path(EVERY_DIVE))


def _pooled_rows(reports: Sequence[StoredReport]) -> Iterator[PooledRow]:
    """Yield the pooled evidence on each candidate, with its share of the error rate."""
    from insdvl_replay.evaluation.answers import (
        CandidateAnswer,
        answers_together,
        pooled_candidate,
        primary_of,
    )

    reports, _ = distinct_dives(reports)
    settings = reports[0].config.get("evaluation", {})

    def answer_at(name: str, level: float) -> CandidateAnswer:
        evaluated = _evaluated_reports(reports, name)
        evidence = [_rows_on(report, name) for report in evaluated]
        return pooled_candidate(
            name,
            reports[0].baseline,
            evidence,
            len(evidence),
            primary=primary_of(evidence, settings.get("primary", "")),
            level=level,
            vehicles=[report.vehicle for report in evaluated],
        )

    names = dict.fromkeys(name for report in reports for name in report.filters)
    for answer in answers_together(names, answer_at, settings.get("candidate", "")).values():
        yield from answer.rows


def _evaluated_reports(reports: Sequence[StoredReport], name: str) -> list[StoredReport]:
    """Return the dives in which a candidate is evaluated."""
    return [
        report
        for report in reports
        if name in report.filters and report.filters[name].get("verdict") not in WITHOUT_VERDICT
    ]


def _rows_on(report: StoredReport, name: str) -> list[EvidenceRow]:
    """Return the rows of evidence on a candidate."""
    rows = [row for row in report.tables.get("evidence", []) if row.get("filter") == name]
    return msgspec.convert(rows, list[EvidenceRow])


# --- All gates.


def evaluate_gates(gates: Gates, dives: Sequence[Checked]) -> CheckResult:
    """Evaluate every gate on the dives it applies to, and gates on the pooled evidence on all together."""
    outcomes = list[GateOutcome]()
    missed = (GateStatus.FAILED, GateStatus.WARNING)
    for dive in dives:
        own = [gate for gate in gates.gates if gate.table != POOLED and gate.applies_to(dive.name)]
        found = [_outcome(gates, gate, dive) for gate in own]
        if isinstance(dive.result, StoredReport) and any(item.status in missed for item in found):
            causes = known_causes(gates, dive.name, dive.result)
            found = [
                replace(item, causes=causes) if item.status in missed else item for item in found
            ]
        outcomes += found
    for gate in gates.gates:
        if gate.table == POOLED:
            outcomes.append(_outcome(gates, gate, pooled_dive(dives)))
        if gate.share_of_dives_pct is not None:
            outcomes = _with_share(gate, gate.share_of_dives_pct, outcomes)
    outcomes.sort(key=lambda item: list(GateStatus).index(item.status))
    reports = {dive.name: dive.result for dive in dives if isinstance(dive.result, StoredReport)}
    words: dict[str, Counter[str]] = {}
    for report in reports.values():
        for name, candidate in report.filters.items():
            words.setdefault(name, Counter())[str(candidate.get("verdict", ""))] += 1
    elapsed_s = {
        name: float(seconds)
        for name, report in reports.items()
        if is_number(seconds := report.tool.get("elapsed_s"))
    }
    return CheckResult(str(gates.path), tuple(outcomes), {**words}, elapsed_s)


def _with_share(gate: Gate, share_pct: float, outcomes: Sequence[GateOutcome]) -> list[GateOutcome]:
    """Make failures of a gate on single dives warnings, if a large enough share of the dives passed."""
    own = [item for item in outcomes if item.gate == gate.name]
    passed = sum(item.status == GateStatus.PASSED for item in own)
    if not own or 100.0 * passed < share_pct * len(own):
        return [*outcomes]
    reason = f"passed on {passed} of {len(own)} dives, required: {share_pct:g} %"
    return [
        replace(item, status=GateStatus.WARNING, reasons=(*item.reasons, reason))
        if item.gate == gate.name and item.status == GateStatus.FAILED
        else item
        for item in outcomes
    ]


def _outcome(gates: Gates, gate: Gate, dive: Checked) -> GateOutcome:
    """Evaluate a gate on a dive."""
    outcome = GateOutcome(dive.name, gate.name, GateStatus.OFF, line=gates.lines.get(gate.name, 0))
    if gate.level == GateLevel.OFF:
        return outcome
    outcome = replace(outcome, is_trajectory=gate.table == TRAJECTORY and gate.expected is not None)
    if isinstance(dive.result, Exception):
        return replace(outcome, status=GateStatus.UNUSABLE, reasons=(str(dive.result),))
    findings: tuple[Finding, ...] = ()
    try:
        expected = None if gate.expected is None else expected_of(gates, gate, dive.result.log)
        findings = findings_of(gate, dive.result, dive.folder, expected)
        reasons = tuple(finding.sentence for finding in findings if not finding.passed)
    except UserError as error:
        reasons = (f"{error.message}; {error.hint}",)
    missed = GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED
    return replace(
        outcome, status=missed if reasons else GateStatus.PASSED, reasons=reasons, findings=findings
    )


def findings_of(
    gate: Gate, report: StoredReport, folder: Path, expected: "StoredReport | Trajectory | None"
) -> tuple[Finding, ...]:
    """Return what a gate finds in a result, in its tables or in its trajectory."""
    if isinstance(gate, CellGate):
        return gate_findings(gate, report, expected if isinstance(expected, StoredReport) else None)
    assert isinstance(gate, TrajectoryGate)
    assert not isinstance(expected, StoredReport)
    from insdvl_replay.changes.trajectory_gates import trajectory_findings
    from insdvl_replay.results.trajectory import read_trajectory

    return trajectory_findings(gate, read_trajectory(folder / TRAJECTORY_FILE), expected)


def compare_with_expected(gates: Gates, dives: Sequence[Checked]) -> list[tuple[str, Finding]]:
    """Return dive and cell of every gate with expected values, compared with what is stored, if anything is."""
    return [
        (dive.name, finding)
        for gate, dive, report in with_expected(gates, dives)
        for finding in findings_of(
            gate, report, dive.folder, stored_values(gate, expected_path(gates, gate, dive.name))
        )
    ]


# --- Gates on cells.


def gate_findings(
    gate: CellGate, report: StoredReport, expected: StoredReport | None
) -> tuple[Finding, ...]:
    """Return a finding for each cell that a gate checks; one failed finding if it checks none.

    A star in the gate also checks rows that only the expected values have.
    """
    if found := tuple(_finding(gate, pair, report) for pair in gate.rows_of(expected, report)):
        return found
    sentence = (
        f"{report.log.name} has no row for table {gate.table}, filter {gate.filter}, row {gate.row}, "
        f"column {gate.column}"
    )
    return (
        Finding(gate.table, gate.filter, gate.row, gate.column, None, None, sentence, passed=False),
    )


def _finding(gate: CellGate, pair: RowPair, report: StoredReport) -> Finding:
    """Check one cell."""
    column = gate.column
    layout = pair.layout
    old = pair.old.get(column)
    value = pair.new.get(column)
    unit = layout.unit_of(column, pair.unit)
    in_unit = f" {unit}" if unit else ""
    percent = "points" if column.endswith(PERCENTAGE) else "%"
    moved = None
    limit = ""
    statement = f"is {value_text(value)}{in_unit}"
    if gate.expected is not None and is_number(old) and is_number(value):
        moved = judge_cell(pair, column, gate.max_worse_pct, gate.max_worse_abs)
        # Both values, their change and the allowed loss with its sign: ``1.54 -> 3.27 m (+112 %, limit +5 %)``.
        sign = "-" if layout.better.get(column) == "higher" else "+"
        limits = [
            *([] if gate.max_worse_pct is None else [f"{sign}{gate.max_worse_pct:g} {percent}"]),
            *([] if gate.max_worse_abs is None else [f"{sign}{gate.max_worse_abs:g}{in_unit}"]),
        ]
        # processors differ in the last digits
        limit = " or ".join(limits)
        is_same = agree(value, old, column)
        of_size = {"nearer zero": " in magnitude", "nearer dof": " farther from dof"}.get(
            moved.better or "", ""
        )
        growth = (
            []
            if moved.change_pct is None
            else [f"{0.0 if is_same else moved.change_pct:+.3g} {percent}{of_size}"]
        )
        values = " -> ".join(numbers_apart(old, old if is_same else value))
        statement = f"{values}{in_unit} ({', '.join([*growth, f'limit {limit}'])})"
    complaint = f"is missing, and so is its row; expected: {value_text(old)}"
    if pair.new:
        word = str(report.filters.get(pair.filter, {}).get("verdict") or "")
        complaint = _why_unusable(pair, column, word)
        complaint = complaint or "; ".join(
            _broken_conditions(gate, value, in_unit, moved, statement)
        )
    return Finding(
        table=layout.name,
        filter=pair.filter,
        row=pair.row,
        column=column,
        expected=old,
        value=value,
        sentence=f"{cell_name(layout.name, pair.filter, pair.row, column, report.baseline)} {complaint or statement}",
        passed=not complaint,
        unit=unit if pair.new else "",
        limit=limit,
    )


def _why_unusable(pair: RowPair, column: str, verdict: str) -> str:
    """Return why a value of a filter with some verdict can meet no condition; empty if it can."""
    layout = pair.layout
    row = pair.new
    value = pair.new.get(column)
    # A gain or loss fails if the filter is not evaluated; the verdict itself can pass.
    is_relative = not layout.baseline_too or layout.name == "drift"
    is_gain = (layout.name, column) in OF_GAIN or (is_relative and column in layout.better)
    if is_gain and verdict in WITHOUT_VERDICT:
        return f"is {value_text(value)}, but the filter is {verdict}"
    if row.get("status") == ReferenceStatus.PARTLY_COVERED and column in layout.better:
        covered = (
            f"the reference does not cover the whole replay ({ReferenceStatus.PARTLY_COVERED})"
        )
        return f"is {value_text(value)}, but {covered}"
    if value in (None, "") or (isinstance(value, float) and not math.isfinite(value)):
        word = row.get("status") or row.get("verdict")
        return f"is empty{f' ({word})' if word else ''}"
    return ""


def _broken_conditions(
    gate: CellGate, value: Cell, unit: str, moved: Moved | None, statement: str
) -> Iterator[str]:
    """Yield the conditions that a value does not meet."""
    close = [wanted for wanted in gate.wanted if is_number(wanted) and isinstance(value, float)
             and agree(value, wanted, gate.column)]  # fmt: skip
    if gate.wanted and (value not in gate.wanted or isinstance(value, bool)) and not close:
        yield f"is {value_text(value)}, required: {' or '.join(map(value_text, gate.wanted))}"
    for name, sign, limit in (("least", 1.0, gate.min), ("most", -1.0, gate.max)):
        if limit is None:
            continue
        if not is_number(value):
            yield f"is the word {value!r}, required: a number"
            break
        if not (sign * (value - limit) >= 0.0 or agree(value, limit, gate.column)):
            yield f"is {value_text(value)}{unit}, required: at {name} {value_text(limit)}"
    if gate.expected is not None and moved is None:
        yield "has no expected number"
    elif moved is not None and moved.better is None:
        yield "cannot be compared: degrees of freedom (dof) are missing here or in the expected values"
    elif moved is not None and moved.verdict == ChangeVerdict.WORSE:
        yield statement


def value_text(value: Cell) -> str:
    """Write a value with enough digits to differ from its limit; words are unchanged."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)
