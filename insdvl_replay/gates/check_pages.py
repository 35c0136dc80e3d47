"""What became of the gates, for people: as text, and as Markdown for a merge request or a job's summary."""

from collections.abc import Sequence
from typing import Final

from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.stored_result import Cell
from insdvl_replay.gates.model import CheckResult, Finding, Judgement, Status
from insdvl_replay.report.display_table import MISSING, ShownTable, counted
from insdvl_replay.report.markup import markdown_page

WORDS: Final[dict[Status, str]] = {
    "unusable": "NO RESULT",
    "failed": "FAILED",
    "warning": "WARNING",
    "off": "off",
    "passed": "passed",
}
_COUNTED: Final[dict[Status, str]] = {
    "unusable": "without a result",
    "failed": "failed",
    "warning": "with a warning",
    "off": "off",
    "passed": "passed",
}


def check_sentence(result: CheckResult) -> str:
    """Count what became of the gates, in one sentence."""
    dives = len({judgement.dive for judgement in result.judgements})
    counts = ", ".join(f"{count} {word}" for status, word in _COUNTED.items() if (count := result.count(status)) > 0)
    return f"{counted(len(_gates(result)), 'gate')} on {counted(dives, 'dive')}: {counts}"


def check_text(result: CheckResult) -> str:
    """Say what did not pass, and then for each gate on how many dives it did.

    Parameters
    ----------
    result : CheckResult

    Returns
    -------
    str
    """
    lines = []
    for judgement in _missed(result):
        lines.append(f"{WORDS[judgement.status]}  {judgement.dive}: {judgement.gate}")
        lines += [f"    {reason}" for reason in judgement.reasons]
    if lines:
        lines.append("")
    lines += [f"{name}: {passed}" for name, passed in _passed(result)]
    return "".join(f"{visible(line)}\n" for line in (*lines, "", check_sentence(result)))


def check_markdown(result: CheckResult) -> str:
    """Lay the same out in Markdown.

    Parameters
    ----------
    result : CheckResult

    Returns
    -------
    str
    """
    tables = []
    if missed := _missed(result):
        rows = tuple((WORDS[item.status], item.dive, item.gate, "; ".join(item.reasons)) for item in missed)
        tables.append(ShownTable("What did not pass", ("", "dive", "gate", "why"), "llll", rows))
    tables.append(ShownTable("Gates", ("gate", "passed"), "ll", tuple(_passed(result))))
    return markdown_page("Gates", [check_sentence(result)], tables)


def baseline_text(changes: Sequence[tuple[str, Finding]]) -> str:
    """Say what a new baseline would change.

    Parameters
    ----------
    changes : sequence of tuple of str and Finding
        Dive and cell.

    Returns
    -------
    str
        A line for each value that is new or moved in what it shows, and how many are as before.
    """
    moved = [(dive, finding) for dive, finding in changes if _shown(finding.was) != _shown(finding.value)]
    lines = [f"{dive}: {_movement(finding)}" for dive, finding in moved]
    return "".join(
        f"{visible(line)}\n"
        for line in (*lines, f"{counted(len(moved), 'value')} new or moved, {len(changes) - len(moved)} as before")
    )


def _movement(finding: Finding) -> str:
    cell = f"{finding.table} {finding.filter} {finding.row}: {finding.column}"
    now = _shown(finding.value)
    return f"{cell} is new: {now}" if finding.was is None else f"{cell} goes from {_shown(finding.was)} to {now}"


def _shown(value: Cell) -> str:
    """Write a value with the digits in which all processors agree."""
    if value is None:
        return MISSING
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _gates(result: CheckResult) -> list[str]:
    return list(dict.fromkeys(judgement.gate for judgement in result.judgements))


def _missed(result: CheckResult) -> list[Judgement]:
    return [judgement for judgement in result.judgements if judgement.status in ("unusable", "failed", "warning")]


def _passed(result: CheckResult) -> list[tuple[str, str]]:
    """Say for each gate on how many dives it was passed."""
    rows = []
    for name in _gates(result):
        own = [judgement for judgement in result.judgements if judgement.gate == name]
        passed = sum(judgement.status == "passed" for judgement in own)
        rows.append((name, "off" if own[0].status == "off" else f"passed by {passed} of {counted(len(own), 'dive')}"))
    return rows
