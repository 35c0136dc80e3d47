"""What became of the gates: text, Markdown for a merge request or a job's summary, JSON, and what GitHub shows."""

import re
from collections.abc import Sequence
from typing import Annotated, Final
from xml.etree import ElementTree

from msgspec import Meta, Struct

from insdvl_replay.core.plain_text import visible, visible_lines
from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.words import GateStatus
from insdvl_replay.gates.model import CheckResult, Finding, Judgement
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
    dives = len({judgement.dive for judgement in result.judgements})
    counts = ", ".join(f"{count} {word}" for status, word in _COUNTED.items() if (count := result.count(status)) > 0)
    return f"{counted(len(_gates(result)), 'gate')} on {counted(dives, 'dive')}: {counts}"


def check_text(result: CheckResult) -> str:
    """State what did not pass, and then for each gate on how many dives it did."""
    lines = []
    for judgement in _missed(result):
        lines.append(f"{WORDS[judgement.status]}  {judgement.dive}: {judgement.gate}")
        lines += [f"    {reason}" for reason in judgement.reasons]
    if lines:
        lines.append("")
    lines += [f"{name}: {passed}" for name, passed in _passed(result)]
    return "".join(f"{visible(line)}\n" for line in (*lines, "", check_sentence(result)))


def check_markdown(result: CheckResult) -> str:
    """Lay the same out in Markdown."""
    parts: list[Part] = [Title("Gates"), check_sentence(result)]
    if missed := _missed(result):
        rows = tuple((WORDS[item.status], item.dive, item.gate, "; ".join(item.reasons)) for item in missed)
        parts.append(DisplayTable("What did not pass", ("", "dive", "gate", "why"), "llll", rows))
    parts.append(DisplayTable("Gates", ("gate", "passed"), "ll", tuple(_passed(result))))
    return as_markdown(parts)


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
    moved = [(dive, finding) for dive, finding in changes if _value_text(finding.was) != _value_text(finding.value)]
    lines = [f"{dive}: {_movement(finding)}" for dive, finding in moved]
    return "".join(
        f"{visible(line)}\n"
        for line in (*lines, f"{counted(len(moved), 'value')} new or moved, {len(changes) - len(moved)} as before")
    )


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
    cell = f"{finding.table} {finding.filter} {finding.row}: {finding.column}"
    now = _value_text(finding.value)
    return f"{cell} is new: {now}" if finding.was is None else f"{cell} goes from {_value_text(finding.was)} to {now}"


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
        passed = sum(judgement.status == GateStatus.PASSED for judgement in own)
        rows.append(
            (name, "off" if own[0].status == GateStatus.OFF else f"passed by {passed} of {counted(len(own), 'dive')}")
        )
    return rows
