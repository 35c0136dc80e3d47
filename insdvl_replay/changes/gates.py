"""Evaluate each gate on each dive: on its tables or its trajectory, alone or against what is expected."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
from msgspec.structs import asdict, replace

from insdvl_replay.changes.cell_gates import gate_findings
from insdvl_replay.changes.cells import is_number
from insdvl_replay.changes.expected import (
    expected_of,
    expected_path,
    known_causes,
    stored_values,
    with_expected,
)
from insdvl_replay.changes.findings import (
    EVERY_DIVE,
    TRAJECTORY,
    Checked,
    CheckResult,
    Finding,
    GateOutcome,
)
from insdvl_replay.changes.gate_file import (
    OVER_DIVES,
    POOLED,
    CellGate,
    Gate,
    Gates,
    TrajectoryGate,
)
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ResultError, UserError
from insdvl_replay.core.report import Row, StoredLog, StoredReport
from insdvl_replay.core.tables import ANSWERS, EvidenceRow
from insdvl_replay.core.words import GateLevel, GateStatus
from insdvl_replay.results.folder import COMPLETE, TRAJECTORY_FILE
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories and answers need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.evaluation.answers import CandidateAnswer, CandidateOnDive
    from insdvl_replay.results.trajectory import Trajectory


_MISSED: Final = (GateStatus.FAILED, GateStatus.WARNING)


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


def together(dives: Sequence[Checked]) -> Checked:
    """Return the tables over all dives as one result, as a run of several dives writes them.

    They are the answer for each candidate, as in ``answers.csv``, and the evidence, as in ``evidence.csv``.
    """
    reports = [dive.result for dive in dives if isinstance(dive.result, StoredReport)]
    if not reports:
        return Checked(
            ResultError("no dive has a result", "see the dives above"), Path(EVERY_DIVE)
        )
    from insdvl_replay.evaluation.answers import answer_row

    tables: dict[str, list[Row]] = {ANSWERS.name: [], POOLED: []}
    for answer in _answers(reports):
        row = asdict(answer_row(answer))
        tables[ANSWERS.name].append(row | {"reason": answer.reason})
        tables[POOLED] += [asdict(row) for row in answer.rows]
    report = StoredReport({}, StoredLog(EVERY_DIVE), tables, baseline=reports[0].baseline)
    return Checked(report, Path(EVERY_DIVE))


def _answers(reports: Sequence[StoredReport]) -> list["CandidateAnswer"]:
    """Return the answer for each candidate, with its share of the error rate."""
    from insdvl_replay.evaluation.answers import (
        CandidateAnswer,
        answer_over_dives,
        answers_together,
    )

    reports, _ = distinct_dives(reports)
    settings = reports[0].config.get("evaluation", {})

    def answer_at(name: str, level: float) -> CandidateAnswer:
        having = [report for report in reports if name in report.filters]
        dives = [_candidate_on(report, name) for report in having]
        return answer_over_dives(name, dives, primary=settings.get("primary", ""), level=level)

    names = dict[str, None]()
    for report in reports:
        names.update(dict.fromkeys(report.filters))
    return [*answers_together(names, answer_at, settings.get("candidate", "")).values()]


def _candidate_on(report: StoredReport, name: str) -> "CandidateOnDive":
    """Return what a result says of a candidate."""
    from insdvl_replay.evaluation.answers import CandidateOnDive

    candidate = report.filters[name]
    rows = [row for row in report.tables.get("evidence", []) if row.get("filter") == name]
    return CandidateOnDive(
        log=report.log.name,
        baseline=report.baseline,
        vehicle=report.vehicle,
        verdict=str(candidate.get("verdict", "")),
        reason=str(candidate.get("reason") or ""),
        predicted_pct=None,
        rows=msgspec.convert(rows, list[EvidenceRow]),
    )


# --- All gates.


def evaluate_gates(gates: Gates, dives: Sequence[Checked]) -> CheckResult:
    """Evaluate every gate on the dives it applies to, and gates on tables over all dives on all together."""
    outcomes = list[GateOutcome]()
    for dive in dives:
        outcomes += _outcomes_of_dive(gates, dive)
    for gate in gates.gates:
        if gate.table in OVER_DIVES:
            outcomes.append(_outcome(gates, gate, together(dives)))
        if gate.share_of_dives_pct is not None:
            outcomes = _with_share(gate, gate.share_of_dives_pct, outcomes)
    outcomes.sort(key=lambda item: list(GateStatus).index(item.status))
    words: dict[str, Counter[str]] = {}
    elapsed_s = dict[str, float]()
    for name, report in _reports_of(dives).items():
        for filter_, candidate in report.filters.items():
            words.setdefault(filter_, Counter())[str(candidate.get("verdict", ""))] += 1
        seconds = report.tool.get("elapsed_s")
        if is_number(seconds):
            elapsed_s[name] = float(seconds)
    return CheckResult(str(gates.path), tuple(outcomes), {**words}, elapsed_s)


def _reports_of(dives: Sequence[Checked]) -> dict[str, StoredReport]:
    """Return the reports of the dives that have a result, by name."""
    return {dive.name: dive.result for dive in dives if isinstance(dive.result, StoredReport)}


def _outcomes_of_dive(gates: Gates, dive: Checked) -> list[GateOutcome]:
    """Evaluate the gates that apply to a dive; those that it does not pass name the known causes."""
    outcomes = list[GateOutcome]()
    for gate in gates.gates:
        if gate.table not in OVER_DIVES and gate.applies_to(dive.name):
            outcomes.append(_outcome(gates, gate, dive))
    is_missed = any(item.status in _MISSED for item in outcomes)
    if not is_missed or not isinstance(dive.result, StoredReport):
        return outcomes
    causes = known_causes(gates, dive.name, dive.result)
    explained = list[GateOutcome]()
    for item in outcomes:
        if item.status in _MISSED:
            item = replace(item, causes=causes)
        explained.append(item)
    return explained


def _with_share(
    gate: Gate, share_pct: float, outcomes: Sequence[GateOutcome]
) -> list[GateOutcome]:
    """Make failures of a gate on single dives warnings, if a large enough share of the dives passed."""
    own = [item for item in outcomes if item.gate == gate.name]
    passed = sum(item.status == GateStatus.PASSED for item in own)
    if not own or 100.0 * passed < share_pct * len(own):
        return [*outcomes]
    reason = f"passed on {passed} of {len(own)} dives, required: {share_pct:g} %"
    milder = list[GateOutcome]()
    for item in outcomes:
        if item.gate == gate.name and item.status == GateStatus.FAILED:
            item = replace(item, status=GateStatus.WARNING, reasons=(*item.reasons, reason))
        milder.append(item)
    return milder


def _outcome(gates: Gates, gate: Gate, dive: Checked) -> GateOutcome:
    """Evaluate a gate on a dive."""
    outcome = GateOutcome(dive.name, gate.name, GateStatus.OFF, line=gates.lines.get(gate.name, 0))
    if gate.level == GateLevel.OFF:
        return outcome
    outcome = replace(
        outcome, is_trajectory=gate.table == TRAJECTORY and gate.expected is not None
    )
    if isinstance(dive.result, Exception):
        return replace(outcome, status=GateStatus.UNUSABLE, reasons=(str(dive.result),))
    missed = GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED
    try:
        expected = None
        if gate.expected is not None:
            expected = expected_of(gates, gate, dive.result.log)
        findings = findings_of(gate, dive.result, dive.folder, expected)
    except UserError as error:
        return replace(outcome, status=missed, reasons=(f"{error.message}; {error.hint}",))
    broken = tuple(finding.sentence for finding in findings if not finding.passed)
    status = missed if broken else GateStatus.PASSED
    return replace(outcome, status=status, reasons=broken, findings=findings)


def findings_of(
    gate: Gate,
    report: StoredReport,
    folder: Path,
    expected: "StoredReport | Trajectory | None",
) -> tuple[Finding, ...]:
    """Return what a gate finds in a result, in its tables or in its trajectory."""
    if isinstance(gate, CellGate):
        return gate_findings(
            gate, report, expected if isinstance(expected, StoredReport) else None
        )
    assert isinstance(gate, TrajectoryGate)
    assert not isinstance(expected, StoredReport)
    from insdvl_replay.changes.trajectory_gates import trajectory_findings
    from insdvl_replay.results.trajectory import read_trajectory

    return trajectory_findings(gate, read_trajectory(folder / TRAJECTORY_FILE), expected)


def compare_with_expected(gates: Gates, dives: Sequence[Checked]) -> list[tuple[str, Finding]]:
    """Return dive and cell of every gate with expected values, compared with what is stored, if anything is."""
    found = list[tuple[str, Finding]]()
    for gate, dive, report in with_expected(gates, dives):
        stored = stored_values(gate, expected_path(gates, gate, dive.name))
        for finding in findings_of(gate, report, dive.folder, stored):
            found.append((dive.name, finding))
    return found
