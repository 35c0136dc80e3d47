"""Hold dives against gates. Some are replayed for it, some are results already."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from insdvl_replay.core.dive_record import LONGEST_NAME, is_dive_name
from insdvl_replay.core.errors import ConfigError, ResultError, UserError, looked_for
from insdvl_replay.core.stored_report import StoredReport, StoredResult
from insdvl_replay.core.words import GateLevel, GateStatus
from insdvl_replay.gates.gate_file import Gates
from insdvl_replay.gates.judged_cells import gate_findings
from insdvl_replay.gates.model import LOG, CheckResult, Finding, Gate, Judgement
from insdvl_replay.results.folder import COMPLETE, result_file
from insdvl_replay.results.json_report import Report, as_json
from insdvl_replay.results.stored_results import read_results

Checked = tuple[str, StoredReport | Exception]
"""A dive's name, and its result or why there is none."""

_WORST_FIRST: Final = tuple(GateStatus)


def checked_replay(name: str, result: Report | Exception) -> Checked:
    """Take what a replay gave as a dive to be judged.

    Parameters
    ----------
    name : str
        Of the dive.
    """
    return name, result if isinstance(result, Exception) else _stored(result)


def _stored(report: Report) -> StoredReport:
    return msgspec.json.decode(msgspec.json.encode(report), type=StoredReport)


def checked_results(folder: Path) -> Iterator[Checked]:
    """Take a stored result as a dive to be judged."""
    try:
        results, _ = read_results(folder)
        yield from map(_checked_result, results)
    except UserError as error:
        yield folder.name, error


def _checked_result(result: StoredResult) -> Checked:
    """Refuse a result whose log's name, which becomes that of its baseline, leads out of the baselines' folder."""
    if is_dive_name(result.name):
        return result.name, result.report
    return result.folder.name, ResultError(
        f"{result.folder / COMPLETE}: log.name = {result.name[:LONGEST_NAME]!r} is no name of a dive",
        "replay its log again, which names it after its file",
    )


def evaluate_gates(gates: Gates, dives: Iterable[Checked]) -> CheckResult:
    """Hold every dive against every gate."""
    judgements = [
        _evaluated(gates, gate, line, name, result)
        for name, result in dives
        for gate, line in zip(gates.content.gate, gates.lines, strict=True)
    ]
    judgements.sort(key=lambda judgement: _WORST_FIRST.index(judgement.status))
    return CheckResult(str(gates.path), tuple(judgements))


def _evaluated(gates: Gates, gate: Gate, line: int, name: str, result: StoredReport | Exception) -> Judgement:
    if gate.level == GateLevel.OFF:
        return Judgement(name, gate.name, GateStatus.OFF, line=line)
    if isinstance(result, Exception):
        return Judgement(name, gate.name, GateStatus.UNUSABLE, (str(result),), line=line)
    try:
        baseline = None if gate.baseline is None else _baseline(gates, gate, result)
    except UserError as error:
        reasons: tuple[str, ...] = (f"{error.message}; {error.hint}",)
        return Judgement(name, gate.name, _missed(gate), reasons, line=line)
    findings = gate_findings(gate, result, baseline)
    reasons = tuple(finding.sentence for finding in findings if not finding.passed)
    return Judgement(name, gate.name, _missed(gate) if reasons else GateStatus.PASSED, reasons, findings, line)


def _missed(gate: Gate) -> GateStatus:
    return GateStatus.WARNING if gate.level == GateLevel.WARN else GateStatus.FAILED


def baseline_path(gates: Gates, gate: Gate, dive: str) -> Path:
    """State where the baseline of a dive lies."""
    return gates.path.parent / (gate.baseline or "").replace(LOG, dive)


def _baseline(gates: Gates, gate: Gate, result: StoredReport) -> StoredReport:
    path, command = baseline_path(gates, gate, result.log.name), f"`insdvl-replay check {gates.path} --update`"
    with looked_for(path):
        if not path.is_file():
            raise ConfigError(f"{path}: there is no baseline yet", f"{command} makes it")
    baseline = _stored_baseline(path)
    if baseline is None:
        raise ConfigError(f"{path}: is not a result that can be read", f"{command} makes it anew")
    if baseline.log.sha256 != result.log.sha256:
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
        baseline = _stored_baseline(baseline_path(gates, gate, dive))
        found += [(dive, finding) for finding in gate_findings(gate, result, baseline)]
    return found


def write_baselines(gates: Gates, dives: Sequence[Checked]) -> list[Path]:
    """Make the results of today the baselines, without the time of day.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ConfigError
        No gate has a baseline, two dives share one, or the disk refuses.
    """
    reports: dict[Path, StoredReport] = {}
    for gate, dive, result in _with_baseline(gates, dives):
        path = baseline_path(gates, gate, dive)
        if reports.setdefault(path, result) is not result:
            raise ConfigError(f"{gates.where(gate)}: several dives share {path}", f"write {LOG} for the dive's name")
    for path, report in reports.items():
        with result_file(path, force=True) as file:
            file.write_bytes(_encoded(report))
    return list(reports)


def _with_baseline(gates: Gates, dives: Sequence[Checked]) -> Iterator[tuple[Gate, str, StoredReport]]:
    for gate in gates.content.gate:
        if gate.baseline is not None and gate.level != GateLevel.OFF:
            yield from ((gate, dive, result) for dive, result in dives if isinstance(result, StoredReport))


def _encoded(report: StoredReport) -> bytes:
    tool: dict[str, Any] = {name: report.tool[name] for name in ("name", "version") if name in report.tool}
    return as_json(msgspec.structs.replace(report, tool=tool))
