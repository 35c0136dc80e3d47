"""What became of the gates: text, Markdown for a merge request or a job's summary, JSON, and what GitHub shows."""

import re
from collections.abc import Sequence
from typing import Annotated, Final
from xml.etree import ElementTree

from msgspec import Meta, Struct

from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.table import PERCENTAGE
from insdvl_replay.core.words import GateStatus
from insdvl_replay.gates.model import EVERY_DIVE, TRAJECTORY, CheckResult, Finding, Judgement
from insdvl_replay.report.document import MISSING, DisplayTable, Part, Title, counted
from insdvl_replay.report.markdown import as_markdown
from insdvl_replay.results.json_report import Tool, as_json, this_tool

_ELEMENTS: Final[dict[GateStatus, str]] = {
    GateStatus.UNUSABLE: "error",
    GateStatus.FAILED: "failure",
    GateStatus.WARNING: "skipped",
    GateStatus.OFF: "skipped",
}
_ERRORS: Final = (GateStatus.UNUSABLE, GateStatus.FAILED)
_NOT_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(result: CheckResult) -> str:
    """Write JUnit XML."""
    root = ElementTree.Element("testsuites", {"name": _clean(result.gates), **_counts(result.judgements)})
    for dive in dict.fromkeys(judgement.dive for judgement in result.judgements):
        own = tuple(judgement for judgement in result.judgements if judgement.dive == dive)
        skipped = str(sum(_ELEMENTS.get(judgement.status) == "skipped" for judgement in own))
        attributes = {"name": _clean(dive), **_counts(own), "skipped": skipped}
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for judgement in own:
            _add_case(suite, judgement)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _counts(judgements: tuple[Judgement, ...]) -> dict[str, str]:
    def count(status: GateStatus) -> str:
        return str(sum(judgement.status == status for judgement in judgements))

    return {"tests": str(len(judgements)), "failures": count(GateStatus.FAILED), "errors": count(GateStatus.UNUSABLE)}


def _add_case(suite: ElementTree.Element, judgement: Judgement) -> None:
    names = {"classname": _clean(judgement.dive), "name": _clean(judgement.gate)}
    case = ElementTree.SubElement(suite, "testcase", names)
    if element := _ELEMENTS.get(judgement.status):
        message = {"message": _clean("; ".join(map(visible, judgement.reasons)) or judgement.status)}
        kind = {} if element == "skipped" else {"type": judgement.status}
        entry = ElementTree.SubElement(case, element, {**message, **kind})
        entry.text = _clean("\n".join(map(visible, judgement.reasons)))


def _clean(text: str) -> str:
    """Show control characters, which XML cannot hold, and leave out what else it cannot."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", visible_lines(text))


WORDS: Final[dict[GateStatus, str]] = {
    GateStatus.UNUSABLE: "NO RESULT",
    GateStatus.FAILED: "FAILED",
    GateStatus.WARNING: "WARNING",
    GateStatus.OFF: "off",
    GateStatus.PASSED: "passed",
}
_COUNTED: Final[dict[GateStatus, str]] = {
    GateStatus.UNUSABLE: "without a result",
    GateStatus.FAILED: "failed",
    GateStatus.WARNING: "with a warning",
    GateStatus.OFF: "off",
    GateStatus.PASSED: "passed",
}
MOST_MOVED: Final = 30
"""Values that moved and stand in the Markdown; of more the rest is counted."""
MOST_ANNOTATIONS: Final = 10
"""Annotations of a level that a step on GitHub shows; what is beyond that is counted in the last one."""


class CheckReport(Struct, frozen=True):
    """All gates on all dives, and how many of each kind."""

    tool: Tool
    gates: Annotated[str, Meta(description="the gate file")]
    failed: int
    unusable: Annotated[int, Meta(description="the dive could not be replayed, or its result not be read")]
    warning: int
    off: int
    passed: int
    judgements: Annotated[tuple[Judgement, ...], Meta(description="failures first")]


def check_sentence(result: CheckResult) -> str:
    """Count what became of the gates, in one sentence."""
    dives = len({judgement.dive for judgement in result.judgements} - {EVERY_DIVE})
    counts = ", ".join(f"{count} {word}" for status, word in _COUNTED.items() if (count := result.count(status)) > 0)
    where = counted(dives, "dive") if dives else "all dives together"
    return f"{counted(len(_gates(result)), 'gate')} on {where}: {counts}"


def trajectory_sentence(result: CheckResult) -> str:
    """Count the dives whose trajectory changed; empty without a gate that holds one against its baseline."""
    held = [item for item in result.judgements if item.is_trajectory]
    if not held:
        return ""
    errors = {item.dive for item in held if item.status == GateStatus.UNUSABLE or not item.findings}
    changed = {item.dive for item in held if not all(finding.passed for finding in item.findings)} - errors
    unchanged = {item.dive for item in held} - errors - changed
    return f"trajectories: {len(changed)} changed, {len(unchanged)} unchanged, {len(errors)} errors"


def check_text(result: CheckResult) -> str:
    """State what did not pass, and then for each gate on how many dives it did."""
    lines = []
    for judgement in _missed(result):
        lines.append(f"{WORDS[judgement.status]}  {judgement.dive}: {judgement.gate}")
        lines += [f"    {reason}" for reason in judgement.reasons]
    if lines:
        lines.append("")
    lines += [f"{name}: {passed}" for name, passed in _passed(result)]
    counts = [line for line in (trajectory_sentence(result), check_sentence(result)) if line]
    return "".join(f"{visible(line)}\n" for line in (*lines, "", *counts))


def check_markdown(result: CheckResult) -> str:
    """Lay the same out in Markdown."""
    parts: list[Part] = [Title("Gates"), *filter(None, (check_sentence(result), trajectory_sentence(result)))]
    parts += [
        f"{name}: {', '.join(f'{count} {word}' for word, count in words.items())}"
        for name, words in result.words.items()
    ]
    if missed := _missed(result):
        rows = tuple((WORDS[item.status], item.dive, item.gate, "; ".join(item.reasons)) for item in missed)
        parts.append(DisplayTable("What did not pass", ("", "dive", "gate", "why"), "llll", rows))
    parts += _before_and_after(result)
    parts.append(DisplayTable("Gates", ("gate", "passed"), "ll", tuple(_passed(result))))
    return as_markdown(parts)


def _before_and_after(result: CheckResult) -> list[DisplayTable]:
    """Lay out the gated values that moved against their baselines, those that did not pass first."""
    moved = [
        (item.dive, finding)
        for item in result.judgements
        for finding in item.findings
        if finding.was is not None and _short_text(finding.was) != _short_text(finding.value)
    ]
    moved.sort(key=lambda one: one[1].passed)
    rows = tuple(
        (
            dive,
            f"{finding.table} {finding.filter} {finding.row}: {finding.column}",
            _short_text(finding.was),
            f"{_short_text(finding.value)}{f' {finding.unit}' if finding.unit else ''}",
            _growth(finding),
            "" if finding.passed else WORDS[GateStatus.FAILED],
        )
        for dive, finding in moved[:MOST_MOVED]
    )
    more = f"and {len(moved) - MOST_MOVED} more" if len(moved) > MOST_MOVED else ""
    header = ("dive", "value", "before", "after", "change", "")
    return [DisplayTable("Before and after", header, "llrrrl", rows, more)] if rows else []


def check_json(result: CheckResult) -> str:
    """Write JSON, indented."""
    report = CheckReport(
        this_tool(),
        result.gates,
        result.count(GateStatus.FAILED),
        result.count(GateStatus.UNUSABLE),
        result.count(GateStatus.WARNING),
        result.count(GateStatus.OFF),
        result.count(GateStatus.PASSED),
        result.judgements,
    )
    return as_json(report).decode()


def github_annotations(result: CheckResult) -> str:
    """Write a workflow command for each gate that a dive did not pass, which GitHub shows as an annotation.

    Source: GitHub's "Workflow commands for GitHub Actions".
    """
    errors = [judgement for judgement in result.judgements if judgement.status in _ERRORS]
    warnings = [judgement for judgement in result.judgements if judgement.status == GateStatus.WARNING]
    lines = [*_commands("error", result.gates, errors), *_commands("warning", result.gates, warnings)]
    return "".join(f"{line}\n" for line in (*lines, check_sentence(result)))


def baseline_text(changes: Sequence[tuple[str, Finding]]) -> str:
    """State what a new baseline would change.

    Parameters
    ----------
    changes : sequence of tuple of str and Finding
        Dive and cell.

    Returns
    -------
    str
        A line for each value that is new or moved in what it shows, and how many are as before.
    """
    moved = [(dive, finding) for dive, finding in changes if _has_moved(finding)]
    shown = [(dive, finding) for dive, finding in moved if _is_seen(finding)]
    lines = [f"{dive}: {_movement(finding)}" for dive, finding in shown]
    unseen = f"{len(moved) - len(shown)} by less than four digits show, " if len(moved) > len(shown) else ""
    count = f"{counted(len(shown), 'value')} new or moved, {unseen}{len(changes) - len(moved)} as before"
    return "".join(f"{visible(line)}\n" for line in (*lines, count))


def _has_moved(finding: Finding) -> bool:
    if finding.table == TRAJECTORY:
        return not finding.passed
    return _value_text(finding.was) != _value_text(finding.value)


def _is_seen(finding: Finding) -> bool:
    return finding.table == TRAJECTORY or _short_text(finding.was) != _short_text(finding.value)


def _commands(level: str, file: str, judgements: Sequence[Judgement]) -> list[str]:
    listed = judgements if len(judgements) <= MOST_ANNOTATIONS else judgements[: MOST_ANNOTATIONS - 1]
    lines = [_of_judgement(level, file, item) for item in listed]
    if hidden := len(judgements) - len(listed):
        lines.append(_command(level, file, 0, "more", f"{hidden} more gates were not passed; the log lists them"))
    return lines


def _of_judgement(level: str, file: str, item: Judgement) -> str:
    return _command(level, file, item.line, f"{item.dive}: {item.gate}", "\n".join(map(visible, item.reasons)))


def _command(level: str, file: str, line: int, title: str, message: str) -> str:
    place = f"file={_property(visible(file))}" + (f",line={line}" if line else "")
    return f"::{level} {place},title={_property(visible(title))}::{_data(message)}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")


def _movement(finding: Finding) -> str:
    """State in a line what becomes of a value in the baseline: from, to, by how much, and what is allowed."""
    if finding.table == TRAJECTORY:
        return f"trajectory of {finding.sentence.replace(': is not in the baseline', ' is new')}"
    cell = f"{finding.table} {finding.filter} {finding.row}: {finding.column}"
    now = f"{_short_text(finding.value)}{f' {finding.unit}' if finding.unit else ''}"
    if finding.was is None:
        return f"{cell} is new: {now}"
    allowed = f", {finding.allowed} allowed" if finding.allowed else ""
    return f"{cell} goes from {_short_text(finding.was)} to {now} ({_growth(finding)}{allowed})"


def _growth(finding: Finding) -> str:
    was, now = finding.was, finding.value
    if not isinstance(was, int | float) or not isinstance(now, int | float):
        return "changed"
    if finding.column.endswith(PERCENTAGE):
        return f"{now - was:+.3g} points"
    return f"{100.0 * (now - was) / abs(was):+.3g} %" if was else "from zero"


def _short_text(value: Cell) -> str:
    return f"{value:.4g}" if isinstance(value, float) else _value_text(value)


def _value_text(value: Cell) -> str:
    """Write a value with the digits in which all processors agree."""
    if value is None:
        return MISSING
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _gates(result: CheckResult) -> list[str]:
    return list(dict.fromkeys(judgement.gate for judgement in result.judgements))


def _missed(result: CheckResult) -> list[Judgement]:
    return [judgement for judgement in result.judgements if judgement.status in (*_ERRORS, GateStatus.WARNING)]


def _passed(result: CheckResult) -> list[tuple[str, str]]:
    """State for each gate on how many dives it was passed."""
    rows = []
    for name in _gates(result):
        own = [judgement for judgement in result.judgements if judgement.gate == name]
        if own[0].dive == EVERY_DIVE:
            rows.append((name, f"{WORDS[own[0].status]}, all dives together"))
            continue
        passed = sum(judgement.status == GateStatus.PASSED for judgement in own)
        rows.append(
            (name, "off" if own[0].status == GateStatus.OFF else f"passed by {passed} of {counted(len(own), 'dive')}")
        )
    return rows
