"""Hold dives against gates. Some are replayed for it, some are results already."""

from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec
from msgspec.structs import asdict, replace

from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ConfigError, ResultError, UserError, looked_for
from insdvl_replay.core.stored_report import Row, StoredLog, StoredReport, StoredResult
from insdvl_replay.core.tables import CANDIDATES, EvidenceRow
from insdvl_replay.core.words import GateLevel, GateStatus
from insdvl_replay.core.words import Judgement as Word
from insdvl_replay.gates.gate_file import Gates
from insdvl_replay.gates.judged_cells import gate_findings, gated_rows
from insdvl_replay.gates.model import EVERY_DIVE, LOG, POOLED, TRAJECTORY, CheckResult, Finding, Gate, Judgement
from insdvl_replay.results.folder import COMPLETE, TRAJECTORY_FILE, read_file, result_file
from insdvl_replay.results.json_report import Report, as_json
from insdvl_replay.results.stored_results import read_results

if TYPE_CHECKING:
    # Trajectories need numpy, for which whoever holds tables alone must not wait.
    from insdvl_replay.results.trajectory import Trajectory


class Checked(NamedTuple):
    """A dive's name, its result or why there is none, and where that lies."""

    name: str
    result: StoredReport | Exception
    folder: Path | None = None


_WORST_FIRST: Final = tuple(GateStatus)


def checked_replay(folder: Path, result: Report | Exception) -> Checked:
    """Take what a replay gave, into a folder of the dive's name, as a dive to be judged."""
    return Checked(folder.name, result if isinstance(result, Exception) else _stored(result), folder)


def _stored(report: Report) -> StoredReport:
    return msgspec.json.decode(msgspec.json.encode(report), type=StoredReport)


def checked_results(folder: Path) -> Iterator[Checked]:
    """Take a stored result as a dive to be judged."""
    try:
        results, _ = read_results(folder)
        yield from map(_checked_result, results)
    except UserError as error:
        yield Checked(folder.name, error)


def _checked_result(result: StoredResult) -> Checked:
    """Refuse a result whose log's name, which becomes that of its baseline, leads out of the baselines' folder."""
    if is_dive_name(result.name):
        return Checked(result.name, result.report, result.folder)
    error = ResultError(
        f"{result.folder / COMPLETE}: log.name = {result.name[:LONGEST_NAME]!r} is no name of a dive",
        "replay its log again, which names it after its file",
    )
    return Checked(result.folder.name, error)


def evaluate_gates(gates: Gates, dives: Iterable[Checked]) -> CheckResult:
    """Hold every dive against every gate that means it, and all together against those on the pooled evidence."""
    dives = list(dives)
    placed = list(zip(gates.content.gate, gates.lines, strict=True))
    judgements = [
        _evaluated(gates, gate, line, dive)
        for dive in dives
        for gate, line in placed
        if gate.table != POOLED and is_meant(gate, dive.name)
    ]
    for gate, line in placed:
        if gate.table == POOLED:
            judgements.append(_evaluated(gates, gate, line, pooled_dive(dives)))
        if gate.share_of_dives_pct is not None:
            judgements = _enough(gate, judgements, gate.share_of_dives_pct)
    judgements.sort(key=lambda judgement: _WORST_FIRST.index(judgement.status))
    return CheckResult(str(gates.path), tuple(judgements), _words(dives))


def _words(dives: Sequence[Checked]) -> dict[str, dict[str, int]]:
    """Count by filter on how many dives each word is said of it."""
    counts: dict[str, dict[str, int]] = {}
    for dive in dives:
        filters = dive.result.filters if isinstance(dive.result, StoredReport) else {}
        for name, candidate in filters.items():
            of_filter, word = counts.setdefault(name, {}), str(candidate.get("improvement", ""))
            of_filter[word] = of_filter.get(word, 0) + 1
    return counts


def is_meant(gate: Gate, dive: str) -> bool:
    """Return whether a gate means a dive, by its name."""
    return not gate.dives or any(fnmatchcase(dive, pattern) for pattern in gate.dives)


def pooled_dive(dives: Sequence[Checked]) -> Checked:
    """Make a result of what all dives say together, as if it were one dive's."""
    from insdvl_replay.evaluation.over_dives import pooled_evidence

    reports = [dive.result for dive in dives if isinstance(dive.result, StoredReport)]
    if not reports:
        return Checked(EVERY_DIVE, ResultError("no dive has a result", "see the dives above"))
    rows = [
        dict(asdict(row))
        for name in dict.fromkeys(name for report in reports for name in report.filters)
        for row in pooled_evidence(name, [_evidence_on(name, report) for report in reports if _is_judged(name, report)])
    ]
    return Checked(EVERY_DIVE, StoredReport({}, StoredLog(EVERY_DIVE), {POOLED: rows}, baseline=reports[0].baseline))


def _is_judged(name: str, report: StoredReport) -> bool:
    return name in report.filters and report.filters[name].get("improvement") != Word.NOT_JUDGED


def _evidence_on(name: str, report: StoredReport) -> list[EvidenceRow]:
    rows = [row for row in report.tables.get("evidence", []) if row.get("filter") == name]
    return msgspec.convert(rows, list[EvidenceRow])


def _enough(gate: Gate, judgements: Sequence[Judgement], share_pct: float) -> list[Judgement]:
    """Turn failures on single dives into warnings where enough of the others passed."""
    own = [judgement for judgement in judgements if judgement.gate == gate.name]
    passed = sum(judgement.status == GateStatus.PASSED for judgement in own)
    if not own or 100.0 * passed < share_pct * len(own):
        return list(judgements)
    reason = f"passed by {passed} of {len(own)} dives, {share_pct:g} % are wanted"
    return [
        replace(judgement, status=GateStatus.WARNING, reasons=(*judgement.reasons, reason))
        if judgement.gate == gate.name and judgement.status == GateStatus.FAILED
        else judgement
        for judgement in judgements
    ]


def _evaluated(gates: Gates, gate: Gate, line: int, dive: Checked) -> Judgement:
    name, result, _ = dive
    held = gate.table == TRAJECTORY and gate.baseline is not None
    if gate.level == GateLevel.OFF:
        return Judgement(name, gate.name, GateStatus.OFF, line=line)
    if isinstance(result, Exception):
        return Judgement(name, gate.name, GateStatus.UNUSABLE, (str(result),), line=line, is_trajectory=held)
    try:
        findings = _findings(gates, gate, dive, result)
    except UserError as error:
        reasons: tuple[str, ...] = (f"{error.message}; {error.hint}",)
        return Judgement(name, gate.name, _missed(gate), reasons, line=line, is_trajectory=held)
    reasons = tuple(finding.sentence for finding in findings if not finding.passed)
    status = _missed(gate) if reasons else GateStatus.PASSED
    return Judgement(name, gate.name, status, reasons, findings, line, held)


def _findings(gates: Gates, gate: Gate, dive: Checked, result: StoredReport) -> tuple[Finding, ...]:
    if gate.table == TRAJECTORY:
        from insdvl_replay.gates.trajectory_gate import trajectory_findings

        old = None if gate.baseline is None else _trajectory_baseline(gates, gate, result)
        return trajectory_findings(gate, _trajectory(dive), old)
    return gate_findings(gate, result, None if gate.baseline is None else _baseline(gates, gate, result))


def _trajectory(dive: Checked) -> "Trajectory | None":
    from insdvl_replay.results.trajectory import read_trajectory

    return None if dive.folder is None else read_trajectory(dive.folder / TRAJECTORY_FILE)


def _missed(gate: Gate) -> GateStatus:
    return GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED


def baseline_path(gates: Gates, gate: Gate, dive: str) -> Path:
    """State where the baseline of a dive lies."""
    return gates.path.parent / (gate.baseline or "").replace(LOG, dive)


def _require_baseline(gates: Gates, gate: Gate, dive: str) -> tuple[Path, str]:
    """Return where a baseline lies, and the command that makes it; raise if there is none."""
    path, command = baseline_path(gates, gate, dive), f"`insdvl-replay check {gates.path} --update`"
    with looked_for(path):
        if not path.is_file():
            raise ConfigError(f"{path}: there is no baseline yet", f"{command} makes it")
    return path, command


def _baseline(gates: Gates, gate: Gate, result: StoredReport) -> StoredReport:
    path, command = _require_baseline(gates, gate, result.log.name)
    baseline = _stored_baseline(path)
    if baseline is None:
        raise ConfigError(f"{path}: is not a result that can be read", f"{command} makes it anew")
    if baseline.log.sha256 != result.log.sha256:
        raise ConfigError(f"{path}: the baseline is of another log than {result.log.name}", f"{command} makes it anew")
    return baseline


def _trajectory_baseline(gates: Gates, gate: Gate, result: StoredReport) -> "Trajectory":
    from insdvl_replay.results.trajectory import read_trajectory

    path, command = _require_baseline(gates, gate, result.log.name)
    baseline = read_trajectory(path)
    if baseline is None:
        raise ConfigError(f"{path}: is not a trajectory that can be read", f"{command} makes it anew")
    if baseline.sha256 != result.log.sha256:
        raise ConfigError(f"{path}: the baseline is of another log than {result.log.name}", f"{command} makes it anew")
    return baseline


def _stored_baseline(path: Path) -> StoredReport | None:
    """Read a baseline; None if there is none, or what is there is none."""
    try:
        return read_results(path)[0][0].report
    except UserError:
        return None


def compare_with_baselines(gates: Gates, dives: Sequence[Checked]) -> list[tuple[str, Finding]]:
    """Lay the values of all gates with a baseline beside those that it holds, as far as it holds any.

    Returns
    -------
    list of tuple of str and Finding
        Dive and cell.
    """
    found = []
    for gate, dive, result in _with_baseline(gates, dives):
        path = baseline_path(gates, gate, dive.name)
        if gate.table == TRAJECTORY:
            found += [(dive.name, finding) for finding in _trajectory_changes(gate, dive, path)]
        else:
            found += [(dive.name, finding) for finding in gate_findings(gate, result, _stored_baseline(path))]
    return found


def _trajectory_changes(gate: Gate, dive: Checked, path: Path) -> tuple[Finding, ...]:
    from insdvl_replay.gates.trajectory_gate import trajectory_findings
    from insdvl_replay.results.trajectory import read_trajectory

    new, old = _trajectory(dive), read_trajectory(path)
    return trajectory_findings(gate, new, old or _nothing(new))


def _nothing(trajectory: "Trajectory | None") -> "Trajectory":
    """Return a baseline that has no filter yet."""
    from insdvl_replay.results.trajectory import Trajectory

    assert trajectory is not None
    return Trajectory(trajectory.sha256, (), trajectory.time_s, trajectory.values[:0])


def write_baselines(gates: Gates, dives: Sequence[Checked]) -> list[Path]:
    """Make the gated values of today the baselines, and the trajectories, without the time of day.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ConfigError
        No gate has a baseline, two dives share one, or the disk refuses.
    """
    written: dict[Path, tuple[Checked, list[Gate]]] = {}
    for gate, dive, _ in _with_baseline(gates, dives):
        path = baseline_path(gates, gate, dive.name)
        owner, its_gates = written.setdefault(path, (dive, []))
        if owner is not dive:
            raise ConfigError(f"{gates.where(gate)}: several dives share {path}", f"write {LOG} for the dive's name")
        if its_gates and (its_gates[0].table == TRAJECTORY) != (gate.table == TRAJECTORY):
            raise ConfigError(f"{gates.where(gate)}: a trajectory and tables share {path}", "give it a file of its own")
        its_gates.append(gate)
    for path, (dive, its_gates) in written.items():
        assert isinstance(dive.result, StoredReport)
        path.parent.mkdir(parents=True, exist_ok=True)
        with result_file(path, force=True) as file:
            if its_gates[0].table == TRAJECTORY:
                assert dive.folder is not None
                file.write_bytes(read_file(dive.folder / TRAJECTORY_FILE))
            else:
                file.write_bytes(_encoded(dive.result, its_gates))
    return list(written)


def _with_baseline(gates: Gates, dives: Sequence[Checked]) -> Iterator[tuple[Gate, Checked, StoredReport]]:
    for gate in gates.content.gate:
        if gate.baseline is not None and gate.level != GateLevel.OFF:
            for dive in dives:
                if isinstance(dive.result, StoredReport) and is_meant(gate, dive.name):
                    yield gate, dive, dive.result


def _encoded(report: StoredReport, its_gates: Sequence[Gate]) -> bytes:
    """Write the gated values alone, so that what moves can be read in a review."""
    tables: dict[str, dict[tuple[Any, ...], Row]] = {}
    for gate in its_gates:
        for layout, row in gated_rows(gate, report):
            key = row["filter"], row[layout.key]
            tables.setdefault(layout.name, {}).setdefault(key, {}).update(row)
    of_filters = {str(row["filter"]): row for row in tables.pop(CANDIDATES.name, {}).values()}
    kept = {
        "tool": {name: report.tool[name] for name in ("name", "version") if name in report.tool},
        "log": {"name": report.log.name, "sha256": report.log.sha256},
        "tables": {name: list(rows.values()) for name, rows in tables.items()},
        "baseline": report.baseline,
        "filters": of_filters,
    }
    return as_json(kept)
