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
from insdvl_replay.core.report import Tool, as_json, this_tool
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
    rows = list[tuple[str, str, str, str]]()
    for item in found.outcomes:
        rows.append((item.dive, item.gate, str(item.status), "; ".join(item.explained)))
    tables = {"gates": Block(("dive", "gate", "status", "why"), rows)}
    counts = {status.name.lower(): found.count(status) for status in GateStatus}
    report = CheckReport(this_tool(), found.gates, **counts, outcomes=found.outcomes)
    document = list(_document(found))
    return Result("check", "Gates", tables=tables, document=document, data=report)


def _document(found: CheckResult) -> Iterator[Part]:
    """Yield what there is to read: counts, gates that did not pass, and values that changed within their limits."""
    yield Title("Gates")
    yield Callout(check_sentence(found), "bad" if _has_errors(found) else "good")
    yield from _trajectory_counts(found)
    for name, words in found.words.items():
        counts = ", ".join(f"{count} {word}" for word, count in words.items())
        yield f"{name} against the baseline: {counts}"
    missed = tuple(_missed_row(item) for item in _missed(found))
    if missed:
        yield DisplayTable("Gates that did not pass", ("", "dive", "gate", "why"), "llll", missed)
    moved = tuple(_moved_within_limits(found))
    if moved:
        title = "Changed within the limits"
        more = f"and {len(moved) - MOST_MOVED} more" if len(moved) > MOST_MOVED else ""
        yield DisplayTable(title, ("dive", "value"), "ll", moved[:MOST_MOVED], more)
    yield DisplayTable("Gates", ("gate", "passed"), "ll", tuple(_passed(found)))


def _has_errors(found: CheckResult) -> bool:
    return any(found.count(status) for status in _ERRORS)


def _missed_row(item: GateOutcome) -> tuple[str, str, str, tuple[str, ...]]:
    word, _, _ = WORDS[item.status]
    return (word, item.dive, item.gate, item.explained)


def _moved_within_limits(found: CheckResult) -> Iterator[tuple[str, str]]:
    """Yield dive and sentence of the values that pass, and differ from the expected ones."""
    for item in found.outcomes:
        for cell in item.findings:
            if cell.passed and cell.is_new and cell.expected is not None:
                yield (item.dive, cell.sentence)


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
    dives = {item.dive for item in found.outcomes} - {EVERY_DIVE}
    gates = {item.gate for item in found.outcomes}
    where = counted(len(dives), "dive") if dives else "all dives together"
    return f"{counted(len(gates), 'gate')} on {where}: {', '.join(_counts_in_words(found))}"


def _counts_in_words(found: CheckResult) -> list[str]:
    """Return the number of outcomes of each status that there is, such as ``2 failed``."""
    counts = list[str]()
    for status, (_, word, _) in WORDS.items():
        count = found.count(status)
        if count:
            counts.append(f"{count} {word}")
    return counts


def _trajectory_counts(found: CheckResult) -> list[str]:
    """Return the counts of changed trajectories, if gates compare them."""
    dives = set[str]()
    errors = set[str]()
    changed = set[str]()
    for item in found.outcomes:
        if not item.is_trajectory:
            continue
        dives.add(item.dive)
        if item.status == GateStatus.UNUSABLE or not item.findings:
            errors.add(item.dive)
        elif not all(finding.passed for finding in item.findings):
            changed.add(item.dive)
    if not dives:
        return []
    changed -= errors
    unchanged = dives - errors - changed
    counts = f"{len(changed)} changed, {len(unchanged)} unchanged, {len(errors)} errors"
    return [f"trajectories: {counts}"]


def _missed(found: CheckResult) -> list[GateOutcome]:
    return [item for item in found.outcomes if item.status in (*_ERRORS, GateStatus.WARNING)]


def _passed(found: CheckResult) -> Iterator[tuple[str, str]]:
    """Yield the number of passed dives of each gate."""
    by_gate: dict[str, list[GateOutcome]] = {}
    for item in found.outcomes:
        by_gate.setdefault(item.gate, []).append(item)
    for name, own in by_gate.items():
        status = own[0].status
        if own[0].dive == EVERY_DIVE:
            word, _, _ = WORDS[status]
            yield name, f"{word}, all dives together"
        elif status == GateStatus.OFF:
            yield name, "off"
        else:
            passed = sum(item.status == GateStatus.PASSED for item in own)
            yield name, f"passed on {passed} of {counted(len(own), 'dive')}"


# --- For machines of others.


def junit_xml(found: CheckResult) -> str:
    """Write JUnit XML: seconds of each dive's replay, in equal shares by gate; file and line of each gate."""
    by_dive: dict[str, list[GateOutcome]] = {}
    for item in found.outcomes:
        by_dive.setdefault(item.dive, []).append(item)
    total_s = sum(found.elapsed_s.values())
    root = ElementTree.Element(
        "testsuites", {"name": _clean(found.gates), **_counts(found.outcomes, total_s)}
    )
    for dive, own in by_dive.items():
        elapsed_s = found.elapsed_s.get(dive, 0.0)
        skipped = sum(_element_of(item) == "skipped" for item in own)
        attributes = {"name": _clean(dive), **_counts(own, elapsed_s), "skipped": str(skipped)}
        suite = ElementTree.SubElement(root, "testsuite", attributes)
        for item in own:
            _add_case(suite, item, found.gates, elapsed_s / len(own))
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_case(
    suite: ElementTree.Element,
    item: GateOutcome,
    gates: str,
    elapsed_s: float,
) -> None:
    """Add one gate on one dive to the suite of the dive."""
    names = {
        "classname": _clean(item.dive),
        "name": _clean(item.gate),
        "time": f"{elapsed_s:.3f}",
    }
    place = {"file": _clean(gates)}
    if item.line:
        place["line"] = str(item.line)
    case = ElementTree.SubElement(suite, "testcase", names | place)
    element = _element_of(item)
    if not element:
        return
    lines = [visible(line) for line in item.explained]
    attributes = {"message": _clean("; ".join(lines) or item.status)}
    if element != "skipped":
        attributes["type"] = item.status
    if lines:
        lines.append(":".join(place.values()))
    ElementTree.SubElement(case, element, attributes).text = _clean("\n".join(lines))


def _element_of(item: GateOutcome) -> str:
    """Return the element of JUnit XML for an outcome; empty for one that passed."""
    _, _, element = WORDS[item.status]
    return element


def _counts(outcomes: Sequence[GateOutcome], elapsed_s: float) -> dict[str, str]:
    failures = sum(item.status == GateStatus.FAILED for item in outcomes)
    errors = sum(item.status == GateStatus.UNUSABLE for item in outcomes)
    return {
        "tests": str(len(outcomes)),
        "failures": str(failures),
        "errors": str(errors),
        "time": f"{elapsed_s:.3f}",
    }


def _clean(text: str) -> str:
    """Escape control characters, and replace other characters that XML does not allow."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", visible_lines(text))


def github_annotations(found: CheckResult) -> str:
    """Write a workflow command for each failed gate; GitHub shows it as an annotation.

    Source: GitHub's "Workflow commands for GitHub Actions".
    """
    lines = list[str]()
    for level, statuses in (("error", _ERRORS), ("warning", (GateStatus.WARNING,))):
        missed = [item for item in found.outcomes if item.status in statuses]
        shown = missed
        if len(missed) > MOST_ANNOTATIONS:
            shown = missed[: MOST_ANNOTATIONS - 1]
        for item in shown:
            message = "\n".join(map(visible, item.explained))
            title = f"{item.dive}: {item.gate}"
            lines.append(_annotation(level, found.gates, item.line, title, message))
        hidden = len(missed) - len(shown)
        if hidden:
            message = f"{hidden} more gates did not pass; the log lists them"
            lines.append(_annotation(level, found.gates, 0, "more", message))
    return "".join(f"{line}\n" for line in (*lines, check_sentence(found)))


def _annotation(
    level: str,
    file: str,
    line: int,
    title: str,
    message: str,
) -> str:
    """Write one workflow command; the line is 0 where it is not known."""
    place = f"file={_property(file)}"
    if line:
        place += f",line={line}"
    return f"::{level} {place},title={_property(title)}::{_escaped(message)}"


def _property(text: str) -> str:
    """Escape a value before the message."""
    return _escaped(visible(text)).replace(":", "%3A").replace(",", "%2C")


def _escaped(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


class Badge(Struct, frozen=True, rename={"schema_version": "schemaVersion"}):
    """The outcome as the endpoint badge of shields.io reads it.

    Source: https://shields.io/badges/endpoint-badge.
    """

    schema_version: int
    label: str
    message: str
    color: str


def badge_json(found: CheckResult) -> bytes:
    """Write the counts of the gates' outcomes for a badge."""
    return as_json(Badge(1, "gates", ", ".join(_counts_in_words(found)), _badge_color(found)))


def _badge_color(found: CheckResult) -> str:
    if _has_errors(found):
        return "red"
    if found.count(GateStatus.WARNING):
        return "yellow"
    if found.count(GateStatus.PASSED):
        return "brightgreen"
    return "lightgrey"  # all gates are off


# --- New expected values.


def update_text(
    changes: Sequence[tuple[str, Finding]],  # dive and cell
) -> str:
    """Return the changes of the expected values: each new or changed one, and the number of unchanged ones."""
    lines = [f"{dive}: {_new_text(cell)}" for dive, cell in changes if cell.is_new]
    count = f"{counted(len(lines), 'value')} new or changed, {len(changes) - len(lines)} print the same"
    return "".join(f"{visible(line)}\n" for line in (*lines, count))


def _new_text(cell: Finding) -> str:
    """Say what is new in a cell or in the trajectory of a filter."""
    if isinstance(cell, UnexpectedFilter):
        return f"trajectory of {cell.filter} is new"
    if cell.table == TRAJECTORY:
        return f"trajectory of {cell.sentence}"
    if cell.expected is not None:
        return cell.sentence
    text = str(cell.value)
    if isinstance(cell.value, float):
        text = f"{cell.value:.4g}"
    if cell.unit:
        text += f" {cell.unit}"
    return f"{cell_name(cell.table, cell.filter, cell.row, cell.column)} is new: {text}"
