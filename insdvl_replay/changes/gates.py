"""Evaluate each gate on each dive.

A missing, empty or non-numeric value never passes. Some gates compare a value, or the whole trajectory, with a stored
baseline. The last part of this module writes baselines.
"""

import difflib
import fnmatch
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeGuard

import msgspec
from msgspec import Struct
from msgspec.structs import asdict, replace

from insdvl_replay.changes.cells import agree, judge_cell, named_rows
from insdvl_replay.changes.gate_file import ANY, LAYOUTS, LOG, POOLED, TRAJECTORY, Gate, Gates
from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ConfigError, ResultError, UserError, looked_for
from insdvl_replay.core.result import Cell, Report, Row, StoredLog, StoredReport, as_json
from insdvl_replay.core.states import ANGLES, COLUMNS, GROUPS
from insdvl_replay.core.tables import CANDIDATES, PERCENTAGE, EvidenceRow, TableLayout
from insdvl_replay.core.words import ChangeVerdict, GateLevel, GateStatus, ReferenceStatus, Verdict
from insdvl_replay.results.folder import COMPLETE, TRAJECTORY_FILE, read_file, result_file
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories need numpy, and a check of tables alone must not wait for it.
    from insdvl_replay.results.trajectory import Trajectory

EVERY_DIVE: Final = "*"  # instead of the name of a dive
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
    was: Cell  # the baseline's value, if the gate has one
    value: Cell  # None if missing
    sentence: str  # the value and the condition
    passed: bool
    unit: str = ""  # of the two values
    allowed: str = ""  # allowed loss against the baseline


class GateOutcome(Struct, frozen=True):
    """The outcome of one gate on one dive."""

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()  # why it did not pass, one sentence each
    findings: tuple[Finding, ...] = ()
    line: int = 0  # line of the gate in its file; 0 if unknown
    is_trajectory: bool = False  # the gate compares the trajectory with its baseline


class CheckResult(Struct, frozen=True):
    """The outcomes of all gates on all dives."""

    gates: str  # the gate file
    outcomes: tuple[GateOutcome, ...]  # failures first, then in the order of dives and gates
    words: dict[str, dict[str, int]] = {}  # by filter, number of dives with each verdict

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
    """Yield stored results to check; the name of the log becomes part of the path of a baseline."""
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
    outcomes = [
        _evaluated(gates, gate, dive)
        for dive in dives
        for gate in gates.content.gate
        if gate.table != POOLED and is_meant(gate, dive.name)
    ]
    for gate in gates.content.gate:
        if gate.table == POOLED:
            outcomes.append(_evaluated(gates, gate, pooled_dive(dives)))
        share_pct, own = gate.share_of_dives_pct, [item for item in outcomes if item.gate == gate.name]
        passed = sum(item.status == GateStatus.PASSED for item in own)
        # Failures on single dives are warnings if enough dives passed.
        if share_pct is not None and own and 100.0 * passed >= share_pct * len(own):
            reason = f"passed on {passed} of {len(own)} dives, required: {share_pct:g} %"
            outcomes = [
                replace(item, status=GateStatus.WARNING, reasons=(*item.reasons, reason))
                if item.gate == gate.name and item.status == GateStatus.FAILED
                else item
                for item in outcomes
            ]
    outcomes.sort(key=lambda item: list(GateStatus).index(item.status))
    words: dict[str, dict[str, int]] = {}
    for dive in dives:
        for name, candidate in (dive.result.filters if isinstance(dive.result, StoredReport) else {}).items():
            counts, word = words.setdefault(name, {}), str(candidate.get("verdict", ""))
            counts[word] = counts.get(word, 0) + 1
    return CheckResult(str(gates.path), tuple(outcomes), words)


def is_meant(gate: Gate, dive: str) -> bool:
    """Return whether a gate applies to a dive, by its name."""
    return not gate.dives or any(fnmatch.fnmatchcase(dive, pattern) for pattern in gate.dives)


def pooled_dive(dives: Sequence[Checked]) -> Checked:
    """Return the pooled evidence of all dives as one result."""
    from insdvl_replay.evaluation.verdicts import pooled_evidence

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


def _evaluated(gates: Gates, gate: Gate, dive: Checked) -> GateOutcome:
    held = gate.table == TRAJECTORY and gate.baseline is not None
    outcome = GateOutcome(dive.name, gate.name, GateStatus.OFF, line=gates.lines.get(gate.name, 0), is_trajectory=held)
    if gate.level == GateLevel.OFF:
        return replace(outcome, is_trajectory=False)
    if isinstance(dive.result, Exception):
        return replace(outcome, status=GateStatus.UNUSABLE, reasons=(str(dive.result),))
    findings: tuple[Finding, ...] = ()
    try:
        baseline = None if gate.baseline is None else _baseline(gates, gate, dive.result.log)
        findings = _findings(gate, dive, dive.result, baseline)
        reasons = tuple(finding.sentence for finding in findings if not finding.passed)
    except UserError as error:
        reasons = (f"{error.message}; {error.hint}",)
    missed = GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED
    return replace(outcome, status=missed if reasons else GateStatus.PASSED, reasons=reasons, findings=findings)


def _findings(gate: Gate, dive: Checked, report: StoredReport, baseline: Any) -> tuple[Finding, ...]:
    if gate.table == TRAJECTORY:
        return trajectory_findings(gate, _trajectory(dive), baseline)
    return gate_findings(gate, report, baseline)


def _trajectory(dive: Checked) -> "Trajectory | None":
    from insdvl_replay.results.trajectory import read_trajectory

    return None if dive.folder is None else read_trajectory(dive.folder / TRAJECTORY_FILE)


# --- Gates on cells.


def _layouts(gate: Gate) -> list[TableLayout]:
    return [layout for layout in LAYOUTS if gate.table in (ANY, layout.name)]


def _means(gate: Gate, name: tuple[str, str, str], row: Row) -> bool:
    is_named = gate.filter in (ANY, name[0]) and gate.row in (ANY, name[1])
    return is_named and (gate.table != ANY or gate.column in row)


def gate_findings(gate: Gate, report: StoredReport, baseline: StoredReport | None) -> tuple[Finding, ...]:
    """Return a finding for each cell that a gate checks; one failed finding if it checks none."""
    findings, column = list[Finding](), gate.column
    for layout in _layouts(gate):
        rows, before = named_rows(report, layout), named_rows(baseline, layout) if baseline else {}
        # A star in the gate also checks rows that only the baseline has.
        for name in dict.fromkeys((*rows, *before)):
            row, was = rows.get(name, {}), before.get(name, {})
            if not _means(gate, name, row or was):
                continue
            old, value, unit = was.get(column), row.get(column), layout.unit_of(column, name[2])
            statement = f"{value_text(value)}{f' {unit}' if unit else ''}"
            statement = f"is {statement}" if old is None else f"changed from {value_text(old)} to {statement}"
            complaint = f"is missing, and so is its row; the baseline has {value_text(old)}"
            if row:
                is_evaluated = report.filters.get(name[0], {}).get("verdict") != Verdict.NOT_EVALUATED
                complaints = _complaints(gate, layout, row, was, unit, statement, is_evaluated=is_evaluated)
                complaint = "; ".join(complaints)
            sentence = f"{layout.name} {' '.join(dict.fromkeys(name[:2]))}: {column} {complaint or statement}"
            end = (unit, _allowed(gate)) if row else ()
            findings.append(Finding(layout.name, *name[:2], column, old, value, sentence, not complaint, *end))
    if findings:
        return tuple(findings)
    # Suggest a similar name.
    names, nearest = [name for layout in _layouts(gate) for name in named_rows(report, layout)], list[str]()
    for wanted, known in ((gate.filter, {name[0] for name in names}), (gate.row, {name[1] for name in names})):
        if wanted not in (ANY, *known):
            nearest = difflib.get_close_matches(wanted, sorted(known), n=1, cutoff=0.5)
    sentence = (
        f"{report.log.name} has no row for table {gate.table}, filter {gate.filter}, row {gate.row}, column {column}"
        f"{''.join(f'; did you mean {near}?' for near in nearest)}"
    )
    return (Finding(gate.table, gate.filter, gate.row, column, None, None, sentence, passed=False),)


def _complaints(
    gate: Gate, layout: TableLayout, row: Row, was: Row, unit: str, statement: str, *, is_evaluated: bool
) -> Iterator[str]:
    """Yield the reasons why a cell does not pass."""
    column, value, old = gate.column, row.get(gate.column), was.get(gate.column)
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
    if gate.baseline is None:
        return
    if not (_is_number(old) and _is_number(value)):
        yield "has no number in the baseline"
        return
    moved = judge_cell(was, row, column, layout, gate.max_worse_pct, gate.max_worse_abs)
    if moved.better is None:
        yield "cannot be compared: degrees of freedom (dof) are missing here or in the baseline"
    elif moved.verdict == ChangeVerdict.WORSE:
        pct = moved.change_pct
        amount = "by more than any percentage" if pct is None else f"by {abs(pct):.3g} {_percent(column)}"
        yield f"{statement}: worse {amount}, allowed: {_allowed(gate)}"


def _is_number(value: Cell) -> TypeGuard[float | int]:
    """Return whether a value is a number; ``true`` and ``false`` are not."""
    return isinstance(value, float | int) and not isinstance(value, bool)


def _allowed(gate: Gate) -> str:
    percent = "" if gate.max_worse_pct is None else f"{gate.max_worse_pct:g} {_percent(gate.column)}"
    absolute = "" if gate.max_worse_abs is None else f"{gate.max_worse_abs:g}"
    return " or ".join(filter(None, (percent, absolute)))


def _percent(column: str) -> str:
    return "percentage points" if column.endswith(PERCENTAGE) else "%"


def value_text(value: Cell) -> str:
    """Write a value with enough digits to differ from its limit; words are unchanged."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# --- Gates on the trajectory: no change, sample by sample, and conditions over time.


def trajectory_findings(
    gate: Gate,
    new: "Trajectory | None",  # of the result; None if it has none
    old: "Trajectory | None",  # of the baseline, for a gate that compares with it
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
            sentence = f"{name}: is missing, the baseline has it"
            findings.append(Finding(TRAJECTORY, name, gate.row, "", None, None, sentence, passed=False))
    return tuple(findings)


def _against(gate: Gate, new: "Trajectory", old: "Trajectory | None", name: str) -> tuple[str, str, bool]:
    """Return the first quantity that differs from the baseline, a sentence, and whether it passed."""
    import numpy as np

    samples = len(new.time_s)
    if old is None or name not in old.names:
        return gate.row, "is not in the baseline", False
    if not np.array_equal(new.time_s, old.time_s):
        return gate.row, f"has {samples} samples, the baseline has {len(old.time_s)} at other times", False
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
        f"{COLUMNS[place]} first differs at {new.time_s[first]:g} s ({apart[first, place]:.2g}, "
        f"{allowed[COLUMNS[place]]:.2g} allowed), {int(differs[:, place].sum())} of {samples} samples"
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


# --- Baselines.


def baseline_path(gates: Gates, gate: Gate, dive: str) -> Path:
    """Return where the baseline of a dive is stored."""
    return gates.path.parent / (gate.baseline or "").replace(LOG, dive)


def _stored_baseline(gate: Gate, path: Path) -> "StoredReport | Trajectory | None":
    """Read a baseline; None if there is none, or the file is something else."""
    if gate.table == TRAJECTORY:
        from insdvl_replay.results.trajectory import read_trajectory

        return read_trajectory(path)
    try:
        return read_results(path)[0][0].report
    except UserError:
        return None


def _baseline(gates: Gates, gate: Gate, log: StoredLog) -> "StoredReport | Trajectory":
    """Return the baseline of a log; the ConfigError names the command that writes it."""
    path, command = baseline_path(gates, gate, log.name), f"`insdvl-replay check {gates.path} --update`"
    with looked_for(path):
        if not path.is_file():
            raise ConfigError(f"{path}: there is no baseline yet", f"{command} writes it")
    baseline = _stored_baseline(gate, path)
    if baseline is None:
        kind = "trajectory" if gate.table == TRAJECTORY else "result"
        raise ConfigError(f"{path}: is not a readable {kind}", f"{command} writes a new one")
    if (baseline.log.sha256 if isinstance(baseline, StoredReport) else baseline.sha256) != log.sha256:
        raise ConfigError(f"{path}: the baseline is of another log than {log.name}", f"{command} writes a new one")
    return baseline


def compare_with_baselines(gates: Gates, dives: Sequence[Checked]) -> list[tuple[str, Finding]]:
    """Return dive and cell of every gate with a baseline, compared with the stored value, if any."""
    found = list[tuple[str, Finding]]()
    for gate, dive, result in _with_baseline(gates, dives):
        baseline = _stored_baseline(gate, baseline_path(gates, gate, dive.name))
        if gate.table == TRAJECTORY and baseline is None:
            from insdvl_replay.results.trajectory import Trajectory

            new = _trajectory(dive)
            assert new is not None
            baseline = Trajectory(new.sha256, (), new.time_s, new.values[:0])  # an empty baseline
        found += [(dive.name, finding) for finding in _findings(gate, dive, result, baseline)]
    return found


def write_baselines(gates: Gates, dives: Sequence[Checked]) -> list[Path]:
    """Store the gated values and trajectories as baselines; return the files."""
    written: dict[Path, tuple[Checked, StoredReport, list[Gate]]] = {}
    for gate, dive, result in _with_baseline(gates, dives):
        path = baseline_path(gates, gate, dive.name)
        owner, _, sharing = written.setdefault(path, (dive, result, []))
        if owner is not dive:
            raise ConfigError(f"{gates.where(gate)}: several dives share {path}", f"use {LOG} for the dive's name")
        if sharing and (sharing[0].table == TRAJECTORY) != (gate.table == TRAJECTORY):
            raise ConfigError(
                f"{gates.where(gate)}: a trajectory and tables share {path}", "use a separate file for the trajectory"
            )
        sharing.append(gate)
    for path, (dive, result, sharing) in written.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with result_file(path, force=True) as file:
            if sharing[0].table == TRAJECTORY:
                assert dive.folder is not None
                file.write_bytes(read_file(dive.folder / TRAJECTORY_FILE))
            else:
                file.write_bytes(as_json(_gated_values(result, sharing)))
    return list(written)


def _with_baseline(gates: Gates, dives: Sequence[Checked]) -> Iterator[tuple[Gate, Checked, StoredReport]]:
    for gate in gates.content.gate:
        if gate.baseline is not None and gate.level != GateLevel.OFF:
            for dive in dives:
                if isinstance(dive.result, StoredReport) and is_meant(gate, dive.name):
                    yield gate, dive, dive.result


def _gated_values(report: StoredReport, gates: Sequence[Gate]) -> dict[str, Any]:
    """Return the gated values with their names and what a comparison needs, readable in a review."""
    tables: dict[str, dict[tuple[str, str, str], Row]] = {}
    for gate in gates:
        for layout in _layouts(gate):
            needed = ("log", "filter", layout.key, "unit", "dof", "evidence", gate.column)
            for name, row in named_rows(report, layout).items():
                if _means(gate, name, row):
                    kept = tables.setdefault(layout.name, {}).setdefault(name, {})
                    kept.update({column: row[column] for column in needed if column in row})
    candidates = tables.pop(CANDIDATES.name, {}).values()
    return {
        "tool": {name: report.tool[name] for name in ("name", "version") if name in report.tool},
        "log": {"name": report.log.name, "sha256": report.log.sha256},
        "tables": {name: list(rows.values()) for name, rows in tables.items()},
        "baseline": report.baseline,
        "filters": {str(row["filter"]): row for row in candidates},
    }
