"""Evaluate each gate on each dive.

A missing, empty or non-numeric value never passes. Some gates compare a value, or the whole trajectory, with what is
stored in `expected`.
"""

import difflib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeGuard

import msgspec
from msgspec import Struct
from msgspec.structs import asdict, replace

from insdvl_replay.changes.cells import Moved, agree, cell_name, judge_cell, named_rows
from insdvl_replay.changes.expected import expected_of, expected_path, known_causes, stored_values, with_expected
from insdvl_replay.changes.gate_file import ANY, POOLED, TRAJECTORY, Gate, Gates, is_meant
from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ResultError, UserError
from insdvl_replay.core.result import Cell, Report, Row, StoredLog, StoredReport
from insdvl_replay.core.states import ANGLES, COLUMNS, GROUPS
from insdvl_replay.core.tables import PERCENTAGE, EvidenceRow, TableLayout
from insdvl_replay.core.words import ChangeVerdict, GateLevel, GateStatus, ReferenceStatus, Verdict
from insdvl_replay.results.folder import COMPLETE, TRAJECTORY_FILE
from insdvl_replay.results.stored_results import read_results
from insdvl_replay.show.document import numbers_apart

if TYPE_CHECKING:
    # Trajectories need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.results.trajectory import Trajectory

EVERY_DIVE: Final = "*"  # instead of the name of a dive
NOT_EXPECTED: Final = "is not in the expected trajectory"
SAME: Final = 1e-9  # relative difference of samples, over the largest value of a group, from rounding of processors
# Further cells that state a gain or loss against the baseline.
OF_GAIN: Final = frozenset(
    (
        ("filters", "prediction"),
        ("evidence", "verdict"),
        *(("outage", column) for column in ("ratio_to_baseline", "ratio_low", "ratio_high", "windows_won_pct")),
    )
)


class Finding(Struct, frozen=True):
    """One cell of a table that a gate checks."""

    table: str
    filter: str
    row: str
    column: str
    expected: Cell  # the stored value, if the gate compares with one
    value: Cell  # None if missing
    sentence: str  # the value and the condition
    passed: bool
    unit: str = ""  # of the two values
    limit: str = ""  # allowed loss against the expected value


class GateOutcome(Struct, frozen=True):
    """The outcome of one gate on one dive."""

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()  # why it did not pass, one sentence each
    findings: tuple[Finding, ...] = ()
    line: int = 0  # line of the gate in its file; 0 if unknown
    is_trajectory: bool = False  # the gate compares the trajectory with the expected one
    causes: tuple[str, ...] = ()  # known causes of a failure, one sentence each

    @property
    def explained(self) -> tuple[str, ...]:
        """The reasons, then the known causes."""
        return (*self.reasons, *self.causes)


class CheckResult(Struct, frozen=True):
    """The outcomes of all gates on all dives."""

    gates: str  # the gate file
    outcomes: tuple[GateOutcome, ...]  # failures first, then in the order of dives and gates
    words: dict[str, dict[str, int]] = {}  # by filter, number of dives with each verdict
    elapsed_s: dict[str, float] = {}  # time of the replay, by dive

    def count(self, status: GateStatus) -> int:
        """Count the outcomes of a status."""
        return sum(outcome.status == status for outcome in self.outcomes)


class Checked(NamedTuple):
    """A dive's name, its result or the error, and the folder of the result."""

    name: str
    result: StoredReport | Exception
    folder: Path | None = None


# --- Dives.


def checked_replay(folder: Path, result: Report | Exception) -> Checked:
    """Return a replayed dive to check."""
    if isinstance(result, Exception):
        return Checked(folder.name, result, folder)
    return Checked(folder.name, msgspec.json.decode(msgspec.json.encode(result), type=StoredReport), folder)


def checked_results(folder: Path) -> Iterator[Checked]:
    """Yield stored results to check; the name of the log becomes part of the path of its expected values."""
    try:
        for result in read_results(folder)[0]:
            if is_dive_name(result.name):
                yield Checked(result.name, result.report, result.folder)
                continue
            error = ResultError(
                f"{result.folder / COMPLETE}: log.name = {result.name[:LONGEST_NAME]!r} is not a valid name of a dive",
                "replay its log again; the dive gets the name of the file",
            )
            yield Checked(result.folder.name, error)
    except UserError as error:
        yield Checked(folder.name, error)


def evaluate_gates(gates: Gates, dives: Sequence[Checked]) -> CheckResult:
    """Evaluate every gate on the dives it applies to, and gates on the pooled evidence on all together."""
    outcomes = list[GateOutcome]()
    for dive in dives:
        own = [gate for gate in gates.content.gate if gate.table != POOLED and is_meant(gate, dive.name)]
        outcomes += _with_causes(gates, dive, [_evaluated(gates, gate, dive) for gate in own])
    for gate in gates.content.gate:
        if gate.table == POOLED:
            outcomes.append(_evaluated(gates, gate, pooled_dive(dives)))
        share_pct, of_gate = gate.share_of_dives_pct, [item for item in outcomes if item.gate == gate.name]
        passed = sum(item.status == GateStatus.PASSED for item in of_gate)
        # Failures on single dives are warnings if enough dives passed.
        if share_pct is not None and of_gate and 100.0 * passed >= share_pct * len(of_gate):
            reason = f"passed on {passed} of {len(of_gate)} dives, required: {share_pct:g} %"
            outcomes = [
                replace(item, status=GateStatus.WARNING, reasons=(*item.reasons, reason))
                if item.gate == gate.name and item.status == GateStatus.FAILED
                else item
                for item in outcomes
            ]
    outcomes.sort(key=lambda item: list(GateStatus).index(item.status))
    words: dict[str, dict[str, int]] = {}
    elapsed_s = dict[str, float]()
    for dive in dives:
        if isinstance(dive.result, StoredReport) and _is_number(seconds := dive.result.tool.get("elapsed_s")):
            elapsed_s[dive.name] = float(seconds)
        for name, candidate in (dive.result.filters if isinstance(dive.result, StoredReport) else {}).items():
            counts, word = words.setdefault(name, {}), str(candidate.get("verdict", ""))
            counts[word] = counts.get(word, 0) + 1
    return CheckResult(str(gates.path), tuple(outcomes), words, elapsed_s)


def pooled_dive(dives: Sequence[Checked]) -> Checked:
    """Return the pooled evidence of all dives as one result."""
    from insdvl_replay.evaluation.answers import pooled_evidence

    reports = [dive.result for dive in dives if isinstance(dive.result, StoredReport)]
    if not reports:
        return Checked(EVERY_DIVE, ResultError("no dive has a result", "see the dives above"))
    rows = list[Row]()
    for name in dict.fromkeys(name for report in reports for name in report.filters):
        evidence = [
            [row for row in report.tables.get("evidence", []) if row.get("filter") == name]
            for report in reports
            if name in report.filters and report.filters[name].get("verdict") != Verdict.NOT_EVALUATED
        ]
        rows += [asdict(row) for row in pooled_evidence(name, msgspec.convert(evidence, list[list[EvidenceRow]]))]
    return Checked(EVERY_DIVE, StoredReport({}, StoredLog(EVERY_DIVE), {POOLED: rows}, baseline=reports[0].baseline))


def _with_causes(gates: Gates, dive: Checked, outcomes: list[GateOutcome]) -> list[GateOutcome]:
    """Add the known causes to the gates of a dive that did not pass."""
    missed = (GateStatus.FAILED, GateStatus.WARNING)
    if not (isinstance(dive.result, StoredReport) and any(item.status in missed for item in outcomes)):
        return outcomes
    causes = known_causes(gates, dive.name, dive.result)
    return [replace(item, causes=causes) if item.status in missed else item for item in outcomes]


def _evaluated(gates: Gates, gate: Gate, dive: Checked) -> GateOutcome:
    held = gate.table == TRAJECTORY and gate.expected is not None
    outcome = GateOutcome(dive.name, gate.name, GateStatus.OFF, line=gates.lines.get(gate.name, 0), is_trajectory=held)
    if gate.level == GateLevel.OFF:
        return replace(outcome, is_trajectory=False)
    if isinstance(dive.result, Exception):
        return replace(outcome, status=GateStatus.UNUSABLE, reasons=(str(dive.result),))
    findings: tuple[Finding, ...] = ()
    try:
        expected = None if gate.expected is None else expected_of(gates, gate, dive.result.log)
        findings = _findings(gate, dive, dive.result, expected)
        reasons = tuple(finding.sentence for finding in findings if not finding.passed)
    except UserError as error:
        reasons = (f"{error.message}; {error.hint}",)
    missed = GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED
    return replace(outcome, status=missed if reasons else GateStatus.PASSED, reasons=reasons, findings=findings)


def _findings(gate: Gate, dive: Checked, report: StoredReport, expected: Any) -> tuple[Finding, ...]:
    if gate.table == TRAJECTORY:
        return trajectory_findings(gate, _trajectory(dive), expected)
    return gate_findings(gate, report, expected)


def _trajectory(dive: Checked) -> "Trajectory | None":
    from insdvl_replay.results.trajectory import read_trajectory

    return None if dive.folder is None else read_trajectory(dive.folder / TRAJECTORY_FILE)


# --- Gates on cells.


def gate_findings(gate: Gate, report: StoredReport, expected: StoredReport | None) -> tuple[Finding, ...]:
    """Return a finding for each cell that a gate checks; one failed finding if it checks none."""
    findings, column = list[Finding](), gate.column
    for layout in gate.layouts:
        rows, stored = named_rows(report, layout), named_rows(expected, layout) if expected else {}
        # A star in the gate also checks rows that only the expected values have.
        for name in dict.fromkeys((*rows, *stored)):
            row, was = rows.get(name, {}), stored.get(name, {})
            if not gate.is_about(name, row or was):
                continue
            old, value, unit = was.get(column), row.get(column), layout.unit_of(column, name[2])
            limit, complaint = "", f"is missing, and so is its row; expected: {value_text(old)}"
            statement = f"is {value_text(value)}{f' {unit}' if unit else ''}"
            if row:
                moved = None
                if gate.expected is not None and _is_number(old) and _is_number(value):
                    moved = judge_cell(was, row, column, layout, gate.max_worse_pct, gate.max_worse_abs)
                    limit = _limit(gate, layout, unit)
                    statement = _moved_text(old, value, unit, column, moved, limit)
                is_evaluated = report.filters.get(name[0], {}).get("verdict") != Verdict.NOT_EVALUATED
                complaints = _complaints(gate, layout, row, moved, unit, statement, is_evaluated=is_evaluated)
                complaint = "; ".join(complaints)
            sentence = f"{cell_name(layout.name, *name[:2], column, report.baseline)} {complaint or statement}"
            place = layout.name, *name[:2], column
            findings.append(Finding(*place, old, value, sentence, not complaint, unit if row else "", limit))
    if findings:
        return tuple(findings)
    # Suggest a similar name.
    names, nearest = [name for layout in gate.layouts for name in named_rows(report, layout)], list[str]()
    for wanted, known in ((gate.filter, {name[0] for name in names}), (gate.row, {name[1] for name in names})):
        if wanted not in (ANY, *known):
            nearest = difflib.get_close_matches(wanted, sorted(known), n=1, cutoff=0.5)
    sentence = (
        f"{report.log.name} has no row for table {gate.table}, filter {gate.filter}, row {gate.row}, column {column}"
        f"{''.join(f'; did you mean {near}?' for near in nearest)}"
    )
    return (Finding(gate.table, gate.filter, gate.row, column, None, None, sentence, passed=False),)


def _complaints(
    gate: Gate, layout: TableLayout, row: Row, moved: Moved | None, unit: str, statement: str, *, is_evaluated: bool
) -> Iterator[str]:
    """Yield the reasons why a cell does not pass."""
    column, value = gate.column, row.get(gate.column)
    # A gain or loss fails if the filter is not evaluated; the verdict itself can pass.
    is_relative = not layout.baseline_too or layout.name == "drift"
    is_gain = (layout.name, column) in OF_GAIN or (is_relative and column in layout.better)
    if is_gain and not is_evaluated:
        yield f"is {value_text(value)}, but the filter is {Verdict.NOT_EVALUATED}"
        return
    if row.get("status") == ReferenceStatus.PARTLY_COVERED and column in layout.better:
        covered = f"the reference does not cover the whole replay ({ReferenceStatus.PARTLY_COVERED})"
        yield f"is {value_text(value)}, but {covered}"
        return
    if value in (None, "") or (isinstance(value, float) and not math.isfinite(value)):
        word = row.get("status") or row.get("verdict")
        yield f"is empty{f' ({word})' if word else ''}"
        return
    if gate.equals is not None:
        is_close = any(_is_number(wanted) and isinstance(value, float) and agree(value, wanted, column)
                       for wanted in gate.wanted)  # fmt: skip
        if (value not in gate.wanted or isinstance(value, bool)) and not is_close:
            yield f"is {value_text(value)}, required: {' or '.join(map(value_text, gate.wanted))}"
    for name, sign, limit in (("least", 1.0, gate.min), ("most", -1.0, gate.max)):
        if limit is None:
            continue
        if not _is_number(value):
            yield f"is the word {value!r}, required: a number"
            break
        if not (sign * (value - limit) >= 0.0 or agree(value, limit, column)):
            yield f"is {value_text(value)}{f' {unit}' if unit else ''}, required: at {name} {value_text(limit)}"
    if gate.expected is None:
        return
    if moved is None:
        yield "has no expected number"
    elif moved.better is None:
        yield "cannot be compared: degrees of freedom (dof) are missing here or in the expected values"
    elif moved.verdict == ChangeVerdict.WORSE:
        yield statement


def _is_number(value: Cell) -> TypeGuard[float | int]:
    """Return whether a value is a number; ``true`` and ``false`` are not."""
    return isinstance(value, float | int) and not isinstance(value, bool)


def _moved_text(old: float, new: float, unit: str, column: str, moved: Moved, limit: str) -> str:
    """Write a change against the expected value with its limit, such as ``1.54 -> 3.27 m (+112 %, limit +5 %)``."""
    of_size = {"nearer zero": " in magnitude", "nearer dof": " farther from dof"}.get(moved.better or "", "")
    is_same = agree(new, old, column)  # processors differ in the last digits
    change_pct = 0.0 if is_same and moved.change_pct is not None else moved.change_pct
    growth = [] if change_pct is None else [f"{change_pct:+.3g} {_percent(column)}{of_size}"]
    pair = " -> ".join(numbers_apart(old, old if is_same else new))
    return f"{pair}{f' {unit}' if unit else ''} ({', '.join([*growth, f'limit {limit}'])})"


def _limit(gate: Gate, layout: TableLayout, unit: str) -> str:
    """Write the allowed loss with the sign of a loss."""
    sign = "-" if layout.better.get(gate.column) == "higher" else "+"
    percent = "" if gate.max_worse_pct is None else f"{sign}{gate.max_worse_pct:g} {_percent(gate.column)}"
    absolute = "" if gate.max_worse_abs is None else f"{sign}{gate.max_worse_abs:g}{f' {unit}' if unit else ''}"
    return " or ".join(filter(None, (percent, absolute)))


def _percent(column: str) -> str:
    return "points" if column.endswith(PERCENTAGE) else "%"


def value_text(value: Cell) -> str:
    """Write a value with enough digits to differ from its limit; words are unchanged."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# --- Gates on the trajectory: no change, sample by sample, and conditions over time.


def trajectory_findings(
    gate: Gate,
    new: "Trajectory | None",  # of the result; None if it has none
    old: "Trajectory | None",  # the expected one, for a gate that compares with it
) -> tuple[Finding, ...]:
    """Return a finding for each filter that a gate checks; one failed finding if it checks none."""
    meant = [name for name in new.names if gate.filter in (ANY, name)] if new else []
    if new is None or not meant:
        missing = (
            f"no filter {gate.filter} in the result" if new else "the result has no trajectory: replay the log again"
        )
        return (Finding(TRAJECTORY, gate.filter, gate.row, "", None, None, missing, passed=False),)
    findings = []
    for name in meant:
        row, sentence, passed = _over_time(gate, new, name) if gate.within else _against(gate, new, old, name)
        findings.append(Finding(TRAJECTORY, name, row, "", None, None, f"{name}: {sentence}", passed))
    for name in old.names if old else ():
        if name not in new.names and gate.filter in (ANY, name):
            sentence = f"{name}: is missing, but in the expected trajectory"
            findings.append(Finding(TRAJECTORY, name, gate.row, "", None, None, sentence, passed=False))
    return tuple(findings)


def _against(gate: Gate, new: "Trajectory", old: "Trajectory | None", name: str) -> tuple[str, str, bool]:
    """Return the first quantity that differs from the expected trajectory, a sentence, and whether it passed."""
    import numpy as np

    samples = len(new.time_s)
    if old is None or name not in old.names:
        return gate.row, NOT_EXPECTED, False
    if not np.array_equal(new.time_s, old.time_s):
        return gate.row, f"has {samples} samples, expected: {len(old.time_s)} at other times", False
    before, after = (trajectory.values[trajectory.names.index(name)] for trajectory in (old, new))  # (k, columns)
    with np.errstate(invalid="ignore"):
        apart = np.abs(np.where(before == after, 0.0, after - before))
    apart = np.where(np.isin(COLUMNS, list(ANGLES)), np.minimum(apart, np.abs(360.0 - apart)), apart)
    # Missing on both sides is the same; missing on one side always differs.
    apart = np.nan_to_num(apart, nan=0.0, posinf=np.inf)
    apart[np.isnan(before) != np.isnan(after)] = np.inf
    allowed = dict.fromkeys(COLUMNS, math.inf)
    for group, columns in GROUPS.items():
        largest = float(np.nanmax(np.abs(before[:, np.isin(COLUMNS, columns)]), initial=0.0))
        usual = (SAME if gate.max_rel is None else gate.max_rel) * largest
        allowed |= {name: gate.max_abs.get(name, usual) for name in columns if gate.row in (ANY, group, name)}
    differs = apart > np.array(list(allowed.values()))
    if not differs.any():
        return gate.row, f"{samples} samples are unchanged", True
    first = int(np.argmax(differs.any(axis=1)))
    place, others = int(np.argmax(differs[first])), int(differs.any(axis=0).sum()) - 1
    sentence = (
        f"{COLUMNS[place]} first differs at {new.time_s[first]:g} s (by {apart[first, place]:.2g}, allowed: "
        f"{allowed[COLUMNS[place]]:.2g}), in all at {int(differs[:, place].sum())} of {samples} samples"
        f"{f', and {others} more quantities' if others else ''}"
    )
    return COLUMNS[place], sentence, False


def _over_time(gate: Gate, trajectory: "Trajectory", name: str) -> tuple[str, str, bool]:
    """Check a quantity against its band: share of the samples, longest time outside, or one time."""
    import numpy as np

    from insdvl_replay.core.dive_columns import find_runs

    low, high = gate.within or (-math.inf, math.inf)
    time_s, values = trajectory.time_s, trajectory.of(name, gate.row)
    inside, complaints, statement = (values >= low) & (values <= high), list[str](), "it is"  # missing is outside
    if gate.at_s is not None:
        sample = int(np.argmin(np.abs(time_s - gate.at_s)))
        if abs(time_s[sample] - gate.at_s) > 1.0:
            complaints.append(f"the replay has no sample at {gate.at_s:g} s")
        elif not inside[sample]:
            complaints.append(f"it is {values[sample]:.6g} at {time_s[sample]:g} s")
    else:
        share_pct, longest_s = 100.0 * float(inside.mean()), gate.longest_outside_s
        wanted_pct = 100.0 if gate.share_pct is None and longest_s is None else gate.share_pct or 0.0
        if share_pct < wanted_pct:
            complaints.append(f"{share_pct:.1f} % of {len(inside)} samples, required: at least {wanted_pct:g} %")
        # Length and start of each time outside; one sample a second.
        begins, ends = find_runs(~inside)
        stays = [(float(end - begin), -float(time_s[begin])) for begin, end in zip(begins, ends, strict=True)]
        length_s, begin_s = max(stays, default=(0.0, 0.0))
        if longest_s is not None and length_s > longest_s:
            complaints.append(f"outside for {length_s:g} s from {-begin_s:g} s, allowed: {longest_s:g} s")
        statement = f"{share_pct:.1f} % of {len(inside)} samples, outside for {length_s:g} s at most"
    sentence = f"{gate.row} within {low:g} to {high:g}: {'; '.join(complaints) or statement}"
    return gate.row, sentence, not complaints


def compare_with_expected(gates: Gates, dives: Sequence[Checked]) -> list[tuple[str, Finding]]:
    """Return dive and cell of every gate with expected values, compared with what is stored, if anything is."""
    found = list[tuple[str, Finding]]()
    for gate, dive, result in with_expected(gates, dives):
        expected = stored_values(gate, expected_path(gates, gate, dive.name))
        if gate.table == TRAJECTORY and expected is None:
            from insdvl_replay.results.trajectory import Trajectory

            new = _trajectory(dive)
            assert new is not None
            expected = Trajectory(new.sha256, (), new.time_s, new.values[:0])  # without filters
        found += [(dive.name, finding) for finding in _findings(gate, dive, result, expected)]
    return found
