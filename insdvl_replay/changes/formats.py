"""The outcome of the gates as text, Markdown for a merge request, page, JSON, JUnit XML, and annotations on GitHub."""

import re
from collections.abc import Iterator, Sequence
from typing import Annotated, Final
from xml.etree import ElementTree

from msgspec import Meta, Struct

from insdvl_replay.changes.cells import cell_name
from insdvl_replay.changes.findings import (
    EVERY_DIVE,
    TRAJECTORY,
    CheckResult,
    Finding,
    GateOutcome,
    UnexpectedFilter,
)
from insdvl_replay.core.errors import counted, visible, visible_lines
from insdvl_replay.core.report import Tool, this_tool
from insdvl_replay.core.words import GateStatus
from insdvl_replay.document.parts import (
    Block,
    Callout,
    DisplayTable,
    Part,
    Result,
    Title,
)
from insdvl_replay.document.render import render

# By status: word before a gate, word after a count, element of JUnit XML.
WORDS: Final[dict[GateStatus, tuple[str, str, str]]] = {
    GateStatus.UNUSABLE: ("NO RESULT", "without a result", "error"),
    GateStatus.FAILED: ("FAILED", "failed", "failure"),
    GateStatus.WARNING: ("WARNING", "with a warning", "skipped"),
    GateStatus.OFF: ("off", "off", "skipped"),
    GateStatus.PASSED: ("passed", "passed", ""),
}
_ERRORS: Final = (GateStatus.UNUSABLE, GateStatus.FAILED)
_NOT_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
MOST_MOVED: Final = 30  # changed values that the Markdown lists; the rest is counted
MOST_ANNOTATIONS: Final = 10  # most annotations of a level on GitHub; the last one counts the rest


class CheckReport(Struct, frozen=True):
    """All gates on all dives, and how many of each kind."""

    tool: Tool
    gates: Annotated[str, Meta(description="the gate file")]
    failed: int
    unusable: Annotated[
        int, Meta(description="the dive could not be replayed, or its result could not be read")
    ]
    warning: int
    off: int
    passed: int
    outcomes: Annotated[tuple[GateOutcome, ...], Meta(description="failures first")]


def in_format(found: CheckResult, format_: str) -> str:
    """Write the outcome of the gates as text, md, html, json, junit or github."""
    match format_:
        case "text":
            return check_text(found)
        case "junit":
            return junit_xml(found)
        case "github":
            return github_annotations(found)
    return render(check_result(found), format_)


# --- A document, and text.


def check_result(found: CheckResult) -> Result:
    """Return the outcome of the gates, with the gated values that differ from the expected ones."""
    tone = "bad" if any(found.count(status) for status in _ERRORS) else "good"
    parts: list[Part] = [
        Title("Gates"),
        Callout(check_sentence(found), tone),
        *_trajectory_counts(found),
    ]
    for name, words in found.words.items():
        parts.append(
            f"{name} against the baseline: {', '.join(f'{count} {word}' for word, count in words.items())}"
        )
    if missed := _missed(found):
        rows = tuple(
            (WORDS[item.status][0], item.dive, item.gate, item.explained) for item in missed
        )
        parts.append(
            DisplayTable("Gates that did not pass", ("", "dive", "gate", "why"), "llll", rows)
        )
    moved = [
        (item.dive, cell.sentence)
        for item in found.outcomes
        for cell in item.findings
        if cell.passed and cell.expected is not None and cell.is_new
    ]
    if moved:
        more = f"and {len(moved) - MOST_MOVED} more" if len(moved) > MOST_MOVED else ""
        title = "Changed within the limits"
        parts.append(DisplayTable(title, ("dive", "value"), "ll", tuple(moved[:MOST_MOVED]), more))
    parts.append(DisplayTable("Gates", ("gate", "passed"), "ll", tuple(_passed(found))))
    counts = {status.name.lower(): found.count(status) for status in GateStatus}
    report = CheckReport(this_tool(), found.gates, **counts, outcomes=found.outcomes)
    every = [
        (item.dive, item.gate, str(item.status), "; ".join(item.explained))
        for item in found.outcomes
    ]
    tables = {"gates": Block(("dive", "gate", "status", "why"), every)}
    return Result("check", "Gates", tables=tables, document=parts, data=report)


def check_text(found: CheckResult) -> str:
    """Return the counts, the gates that did not pass, and the number of passed dives of each gate."""
    lines = [check_sentence(found), *_trajectory_counts(found), ""]
    for item in _missed(found):
        lines += [
            f"{WORDS[item.status][0]}  {item.dive}: {item.gate}",
            *(f"    {reason}" for reason in item.explained),
        ]
    lines += [""] if lines[-1] else []
    lines += [f"{name}: {passed}" for name, passed in _passed(found)]
    return "".join(f"{visible(line)}\n" for line in lines)


def check_sentence(found: CheckResult) -> str:
    """Return the counts of the gates' outcomes, in one sentence."""
    dives = len({item.dive for item in found.outcomes} - {EVERY_DIVE})
    gates = len({item.gate for item in found.outcomes})
    counts = ", ".join(
        f"{count} {word}"
        for status, (_, word, _) in WORDS.items()
        if (count := found.count(status))
    )
    return f"{counted(gates, 'gate')} on {counted(dives, 'dive') if dives else 'all dives together'}: {counts}"


def _trajectory_counts(found: CheckResult) -> list[str]:
    """Return the counts of changed trajectories, if gates compare them."""
    compared = [item for item in found.outcomes if item.is_trajectory]
    errors = {
        item.dive for item in compared if item.status == GateStatus.UNUSABLE or not item.findings
    }
    changed = {
        item.dive for item in compared if not all(finding.passed for finding in item.findings)
    } - errors
    unchanged = {item.dive for item in compared} - errors - changed
    counts = f"{len(changed)} changed, {len(unchanged)} unchanged, {len(errors)} errors"
    if compared:
        return [f"trajectories: {counts}"]
    return []


def _missed(found: CheckResult) -> list[GateOutcome]:
    return [item for item in found.outcomes if item.status in (*_ERRORS, GateStatus.WARNING)]


def _passed(found: CheckResult) -> Iterator[tuple[str, str]]:
    """Yield the number of passed dives of each gate."""
    for name in dict.fromkeys(item.gate for item in found.outcomes):
        own = [item for item in found.outcomes if item.gate == name]
        text = f"passed on {sum(item.status == GateStatus.PASSED for item in own)} of {counted(len(own), 'dive')}"
        if own[0].dive == EVERY_DIVE:
            text = f"{WORDS[own[0].status][0]}, all dives together"
        elif own[0].status == GateStatus.OFF:
            text = "off"
        yield name, text


# --- For machines of others.


def junit_xml(found: CheckResult) -> str:
    """Write JUnit XML: seconds of each dive's replay, in equal shares by gate; file and line of each gate."""

    def counts(outcomes: Sequence[GateOutcome], elapsed_s: float) -> dict[str, str]:
        failures, errors = (
            str(sum(item.status == status for item in outcomes))
            for status in (GateStatus.FAILED, GateStatus.UNUSABLE)
        )
        return {
            "tests": str(len(outcomes)),
            "failures": failures,
            "errors": errors,
            "time": f"{elapsed_s:.3f}",
        }

    def clean(text: str) -> str:
        """Escape control characters, and replace other characters that XML does not allow."""
        return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", visible_lines(text))

    total_s = sum(found.elapsed_s.values())
    root = ElementTree.Element(
        "testsuites", {"name": clean(found.gates), **counts(found.outcomes, total_s)}
    )
    for dive in dict.fromkeys(item.dive for item in found.outcomes):
        own = [item for item in found.outcomes if item.dive == dive]
        elapsed_s = found.elapsed_s.get(dive, 0.0)
        skipped = str(sum(WORDS[item.status][2] == "skipped" for item in own))
        attributes = {"name": clean(dive), **counts(own, elapsed_s), "skipped": skipped}
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for item in own:
            place = {"file": clean(found.gates), **({"line": str(item.line)} if item.line else {})}
            names = {
                "classname": clean(item.dive),
                "name": clean(item.gate),
                "time": f"{elapsed_s / len(own):.3f}",
            }
            case = ElementTree.SubElement(suite, "testcase", names | place)
            element = WORDS[item.status][2]
            lines = [visible(line) for line in item.explained]
            if element:
                attributes = {"message": clean("; ".join(lines) or item.status)}
                attributes |= {} if element == "skipped" else {"type": item.status}
                where = [":".join(place.values())] if lines else []
                ElementTree.SubElement(case, element, attributes).text = clean(
                    "\n".join([*lines, *where])
                )
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def github_annotations(found: CheckResult) -> str:
    """Write a workflow command for each failed gate; GitHub shows it as an annotation.

    Source: GitHub's "Workflow commands for GitHub Actions".
    """

    def escaped(text: str) -> str:
        return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")

    def command(level: str, line: int, title: str, message: str) -> str:
        file, title = (
            escaped(visible(text)).replace(":", "%3A").replace(",", "%2C")
            for text in (found.gates, title)
        )
        return f"::{level} file={file}{f',line={line}' if line else ''},title={title}::{escaped(message)}"

    lines = list[str]()
    for level, statuses in (("error", _ERRORS), ("warning", (GateStatus.WARNING,))):
        missed = [item for item in found.outcomes if item.status in statuses]
        listed = missed if len(missed) <= MOST_ANNOTATIONS else missed[: MOST_ANNOTATIONS - 1]
        for item in listed:
            message = "\n".join(map(visible, item.explained))
            lines.append(command(level, item.line, f"{item.dive}: {item.gate}", message))
        if hidden := len(missed) - len(listed):
            lines.append(
                command(level, 0, "more", f"{hidden} more gates did not pass; the log lists them")
            )
    return "".join(f"{line}\n" for line in (*lines, check_sentence(found)))


# --- New expected values.


def update_text(
    changes: Sequence[tuple[str, Finding]],  # dive and cell
) -> str:
    """Return the changes of the expected values: each new or changed one, and the number of unchanged ones."""
    lines = [f"{dive}: {_new_text(cell)}" for dive, cell in changes if cell.is_new]
    count = (
        f"{counted(len(lines), 'value')} new or changed, {len(changes) - len(lines)} print the same"
    )
    return "".join(f"{visible(line)}\n" for line in (*lines, count))


def _new_text(cell: Finding) -> str:
    """Say what is new in a cell or in the trajectory of a filter."""
    if isinstance(cell, UnexpectedFilter):
        return f"trajectory of {cell.filter} is new"
    if cell.table == TRAJECTORY:
        return f"trajectory of {cell.sentence}"
    if cell.expected is not None:
        return cell.sentence
    value = f"{cell.value:.4g}" if isinstance(cell.value, float) else cell.value
    unit = f" {cell.unit}" if cell.unit else ""
    return f"{cell_name(cell.table, cell.filter, cell.row, cell.column)} is new: {value}{unit}"
