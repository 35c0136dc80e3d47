"""What became of the gates: as text, Markdown for a merge request, JSON, JUnit XML, and annotations on GitHub."""

import re
from collections.abc import Sequence
from typing import Annotated, Final
from xml.etree import ElementTree

from msgspec import Meta, Struct

from insdvl_replay.changes.gates import EVERY_DIVE, TRAJECTORY, CheckResult, Finding, Judgement
from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.result import Cell, DisplayTable, Part, Title, Tool, as_json, this_tool
from insdvl_replay.core.tables import PERCENTAGE
from insdvl_replay.core.words import GateStatus
from insdvl_replay.show.document import MISSING, counted
from insdvl_replay.show.text import as_markdown

# By status: its word beside a gate, its word behind a count, and its element of JUnit XML.
WORDS: Final[dict[GateStatus, tuple[str, str, str]]] = {
    GateStatus.UNUSABLE: ("NO RESULT", "without a result", "error"),
    GateStatus.FAILED: ("FAILED", "failed", "failure"),
    GateStatus.WARNING: ("WARNING", "with a warning", "skipped"),
    GateStatus.OFF: ("off", "off", "skipped"),
    GateStatus.PASSED: ("passed", "passed", ""),
}
_ERRORS: Final = (GateStatus.UNUSABLE, GateStatus.FAILED)
_NOT_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
MOST_MOVED: Final = 30  # values that moved and are listed in the Markdown; of more the rest is counted
MOST_ANNOTATIONS: Final = 10  # of a level that a step on GitHub shows; the last one counts what is beyond that


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


def check_json(result: CheckResult) -> str:
    """Write JSON, indented."""
    counts = {status.name.lower(): result.count(status) for status in GateStatus}
    return as_json(CheckReport(this_tool(), result.gates, **counts, judgements=result.judgements)).decode()


def check_sentence(result: CheckResult) -> str:
    """Count what became of the gates, in one sentence."""
    dives = len({item.dive for item in result.judgements} - {EVERY_DIVE})
    gates = len({item.gate for item in result.judgements})
    counts = ", ".join(f"{count} {word}" for status, (_, word, _) in WORDS.items() if (count := result.count(status)))
    return f"{counted(gates, 'gate')} on {counted(dives, 'dive') if dives else 'all dives together'}: {counts}"


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
    lines = list[str]()
    for item in _missed(result):
        lines += [f"{WORDS[item.status][0]}  {item.dive}: {item.gate}", *(f"    {reason}" for reason in item.reasons)]
    lines += [""] if lines else []
    lines += [f"{name}: {passed}" for name, passed in _passed(result)]
    counts = filter(None, (trajectory_sentence(result), check_sentence(result)))
    return "".join(f"{visible(line)}\n" for line in (*lines, "", *counts))


def check_markdown(result: CheckResult) -> str:
    """Lay the same out in Markdown, with the gated values that moved against their baselines."""
    parts: list[Part] = [Title("Gates"), *filter(None, (check_sentence(result), trajectory_sentence(result)))]
    for name, words in result.words.items():
        parts.append(f"{name}: {', '.join(f'{count} {word}' for word, count in words.items())}")
    if missed := _missed(result):
        rows = tuple((WORDS[item.status][0], item.dive, item.gate, "; ".join(item.reasons)) for item in missed)
        parts.append(DisplayTable("What did not pass", ("", "dive", "gate", "why"), "llll", rows))
    moved = [
        (
            item.dive,
            f"{finding.table} {finding.filter} {finding.row}: {finding.column}",
            _short(finding.was),
            _with_unit(finding),
            _growth(finding),
            "" if finding.passed else WORDS[GateStatus.FAILED][0],
        )
        for item in result.judgements
        for finding in item.findings
        if finding.was is not None and _short(finding.was) != _short(finding.value)
    ]
    moved.sort(key=lambda row: not row[-1])  # those that did not pass first
    if moved:
        more = f"and {len(moved) - MOST_MOVED} more" if len(moved) > MOST_MOVED else ""
        header = ("dive", "value", "before", "after", "change", "")
        parts.append(DisplayTable("Before and after", header, "llrrrl", tuple(moved[:MOST_MOVED]), more))
    parts.append(DisplayTable("Gates", ("gate", "passed"), "ll", tuple(_passed(result))))
    return as_markdown(parts)


def _missed(result: CheckResult) -> list[Judgement]:
    return [item for item in result.judgements if item.status in (*_ERRORS, GateStatus.WARNING)]


def _passed(result: CheckResult) -> list[tuple[str, str]]:
    """State for each gate on how many dives it was passed."""
    rows = []
    for name in dict.fromkeys(item.gate for item in result.judgements):
        own = [item for item in result.judgements if item.gate == name]
        passed = sum(item.status == GateStatus.PASSED for item in own)
        text = "off" if own[0].status == GateStatus.OFF else f"passed by {passed} of {counted(len(own), 'dive')}"
        is_pooled = own[0].dive == EVERY_DIVE
        rows.append((name, f"{WORDS[own[0].status][0]}, all dives together" if is_pooled else text))
    return rows


def junit_xml(result: CheckResult) -> str:
    """Write JUnit XML."""

    def counts(judgements: Sequence[Judgement]) -> dict[str, str]:
        statuses = [item.status for item in judgements]
        failed, unusable = (str(statuses.count(status)) for status in (GateStatus.FAILED, GateStatus.UNUSABLE))
        return {"tests": str(len(judgements)), "failures": failed, "errors": unusable}

    root = ElementTree.Element("testsuites", {"name": _clean(result.gates), **counts(result.judgements)})
    for dive in dict.fromkeys(item.dive for item in result.judgements):
        own = [item for item in result.judgements if item.dive == dive]
        skipped = str(sum(WORDS[item.status][2] == "skipped" for item in own))
        attributes = {"name": _clean(dive), **counts(own), "skipped": skipped}
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for item in own:
            names = {"classname": _clean(item.dive), "name": _clean(item.gate)}
            case, reasons = ElementTree.SubElement(suite, "testcase", names), [*map(visible, item.reasons)]
            if element := WORDS[item.status][2]:
                kind = {} if element == "skipped" else {"type": item.status}
                message = {"message": _clean("; ".join(reasons) or item.status), **kind}
                ElementTree.SubElement(case, element, message).text = _clean("\n".join(reasons))
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _clean(text: str) -> str:
    """Show control characters, which XML cannot hold, and leave out what else it cannot."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", visible_lines(text))


def github_annotations(result: CheckResult) -> str:
    """Write a workflow command for each gate that a dive did not pass, which GitHub shows as an annotation.

    Source: GitHub's "Workflow commands for GitHub Actions".
    """

    def command(level: str, line: int, title: str, message: str) -> str:
        file, title = (_data(visible(text)).replace(":", "%3A").replace(",", "%2C") for text in (result.gates, title))
        place = f"file={file}" + (f",line={line}" if line else "")
        return f"::{level} {place},title={title}::{_data(message)}"

    lines = list[str]()
    for level, statuses in (("error", _ERRORS), ("warning", (GateStatus.WARNING,))):
        found = [item for item in result.judgements if item.status in statuses]
        listed = found if len(found) <= MOST_ANNOTATIONS else found[: MOST_ANNOTATIONS - 1]
        for item in listed:
            message = "\n".join(map(visible, item.reasons))
            lines.append(command(level, item.line, f"{item.dive}: {item.gate}", message))
        if hidden := len(found) - len(listed):
            lines.append(command(level, 0, "more", f"{hidden} more gates were not passed; the log lists them"))
    return "".join(f"{line}\n" for line in (*lines, check_sentence(result)))


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def baseline_text(
    changes: Sequence[tuple[str, Finding]],  # dive and cell
) -> str:
    """State what a new baseline would change: each value that is new or moved, and how many are as before."""
    moved, shown = 0, list[str]()
    for dive, finding in changes:
        is_trajectory = finding.table == TRAJECTORY
        if finding.passed if is_trajectory else _exact(finding.was) == _exact(finding.value):
            continue
        moved += 1
        if is_trajectory:
            sentence = finding.sentence.replace(": is not in the baseline", " is new")
            shown.append(f"{dive}: trajectory of {sentence}")
        elif _short(finding.was) != _short(finding.value):
            cell = f"{dive}: {finding.table} {finding.filter} {finding.row}: {finding.column}"
            allowed = f", {finding.allowed} allowed" if finding.allowed else ""
            change = f"goes from {_short(finding.was)} to {_with_unit(finding)} ({_growth(finding)}{allowed})"
            shown.append(f"{cell} is new: {_with_unit(finding)}" if finding.was is None else f"{cell} {change}")
    unseen = f"{moved - len(shown)} by less than four digits show, " if moved > len(shown) else ""
    count = f"{counted(len(shown), 'value')} new or moved, {unseen}{len(changes) - moved} as before"
    return "".join(f"{visible(line)}\n" for line in (*shown, count))


def _growth(finding: Finding) -> str:
    was, now = finding.was, finding.value
    if not isinstance(was, int | float) or not isinstance(now, int | float):
        return "changed"
    if finding.column.endswith(PERCENTAGE):
        return f"{now - was:+.3g} points"
    return f"{100.0 * (now - was) / abs(was):+.3g} %" if was else "from zero"


def _with_unit(finding: Finding) -> str:
    return f"{_short(finding.value)}{f' {finding.unit}' if finding.unit else ''}"


def _short(value: Cell) -> str:
    return f"{value:.4g}" if isinstance(value, float) else _exact(value)


def _exact(value: Cell) -> str:
    """Write a value with the digits in which all processors agree."""
    if value is None:
        return MISSING
    return f"{value:.9g}" if isinstance(value, float) else str(value)
