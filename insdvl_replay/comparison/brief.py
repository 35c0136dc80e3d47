"""A comparison in brief: verdicts that changed, what differs, and the evidence that moved; the rest is counted."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

from insdvl_replay.comparison.display_tables import growth, old_and_new, percent_text
from insdvl_replay.core.changes import Aggregate, Change, Comparison, Difference
from insdvl_replay.core.errors import listed
from insdvl_replay.core.plain_text import natural_key, visible
from insdvl_replay.core.quantities import label
from insdvl_replay.core.table import RATIO
from insdvl_replay.core.words import ChangeWord
from insdvl_replay.report.document import Column, DisplayTable, Html, Sentences, counted, table_of

EVIDENCE: Final = "evidence"
SHOWN: Final = ("value", "baseline")
"""Columns of the evidence that are errors of one filter; ratios and their intervals follow from them."""
HONESTY_ROWS: Final = ("nis", "nees")
_MOST_DIFFERENCES: Final = 8
_FULL_PCT: Final = 50.0
"""Changes beyond end at the edge of a cell."""
_STYLES: Final = {ChangeWord.BETTER: "filter2", ChangeWord.WORSE: "filter0"}


def brief_differences(differences: Sequence[Difference]) -> Iterator[Sentences]:
    """State in a line each what differs beside the tables: first that logs do, then settings."""
    other = [one for one in differences if (one.block, one.key) == ("log", "sha256") and one.old and one.new]
    in_order = sorted(
        (one for one in differences if one not in other), key=lambda difference: difference.block != "config"
    )
    lines = [f"{one.block} {one.key}: {_short(one.old)}, now {_short(one.new)}" for one in in_order[:_MOST_DIFFERENCES]]
    left = len(in_order) - len(lines)
    yield Sentences((*_other_logs(other), *lines, *([f"{left} more differ: --all"] if left else [])))


def _other_logs(differences: Sequence[Difference]) -> Iterator[str]:
    """State of which dives the logs are not the same file: what moved there need not be the settings' doing."""
    names = sorted({name for one in differences for name in one.logs}, key=natural_key)
    if names:
        whose = "the log is" if len(names) == 1 else f"the logs of {listed(names)} are"
        yield f"{whose} another one (SHA-256): what moved may be the log's"


def _short(value: str | None) -> str:
    return "-" if value is None else value if len(value) <= 30 else f"{value[:27]}..."


def brief_changes(changes: Sequence[Change], baseline: str) -> Iterator[DisplayTable]:
    """Lay out the evidence of one dive that moved."""
    rows = [change for change in changes if _is_shown(change)]
    columns: list[Column[Change]] = [
        ("filter", "l", lambda change: _owner(change, baseline)),
        ("evidence", "l", lambda change: _name(change.row)),
        ("", "l", lambda change: change.unit),
        ("old", "r", lambda change: old_and_new(change)[0]),
        ("new", "r", lambda change: old_and_new(change)[1]),
        ("change", "r", growth),
        ("", "l", lambda change: change.word),
    ]
    if rows:
        yield table_of("Evidence that moved", _once(rows, baseline), columns, spare=(2, 3, 4))


def _once(rows: Sequence[Change], baseline: str) -> list[Change]:
    """Leave out what the baseline has beside each candidate again."""
    return list({(_owner(row, baseline), row.row): row for row in reversed(rows)}.values())[::-1]


def brief_aggregates(aggregates: Sequence[Aggregate], baseline: str) -> Iterator[DisplayTable]:
    """Lay out the evidence that moved on some dive: medians over the dives."""
    rows = [cell for cell in aggregates if _is_shown(cell) and cell.same < cell.dives]
    rows = list({(_owner(row, baseline), row.row): row for row in reversed(rows)}.values())[::-1]
    columns: list[Column[Aggregate]] = [
        ("filter", "l", lambda cell: _owner(cell, baseline)),
        ("evidence", "l", lambda cell: _name(cell.row)),
        ("better", "r", lambda cell: str(cell.better)),
        ("worse", "r", lambda cell: str(cell.worse)),
        ("same", "r", lambda cell: str(cell.same)),
        ("median [%]", "r", lambda cell: percent_text(cell.median_change_pct)),
        ("worst [%]", "r", lambda cell: percent_text(cell.worst_change_pct)),
        ("in", "l", lambda cell: cell.worst_log),
    ]
    if rows:
        yield table_of("Evidence that moved, in dives", rows, columns, spare=(7, 4, 6))


def _is_shown(cell: Change | Aggregate) -> bool:
    """Return whether a cell of the evidence is shown: errors and times, and of honesty how far it is from 1.

    A smaller mean NIS or NEES is not the better one: its ratio, of the distances from 1, tells.
    """
    wanted = (RATIO,) if cell.row in HONESTY_ROWS else SHOWN
    return cell.table == EVIDENCE and cell.column in wanted and (isinstance(cell, Aggregate) or _has_moved(cell))


def _name(quantity: str) -> str:
    """Name a piece of evidence; of honesty its ratio is shown, of the distances from 1."""
    if quantity in HONESTY_ROWS:
        return f"{quantity.upper()} off 1, times the baseline's"
    return label(quantity)


def _has_moved(change: Change) -> bool:
    return change.word != ChangeWord.SAME


def _owner(cell: Change | Aggregate, baseline: str) -> str:
    """Name the filter whose error it is: the baseline's stand in the rows of each candidate."""
    return baseline if cell.column == "baseline" else cell.filter


def moved_elsewhere(comparison: Comparison) -> str:
    """Count what moved in the other tables."""
    counts = {
        name: sum(tally.counts.values()) - tally.counts[ChangeWord.SAME] for name, tally in comparison.by_table.items()
    }
    moved = [f"{name} {count}" for name, count in counts.items() if count]
    unmoved = sum(tally.counts[ChangeWord.SAME] for tally in comparison.by_table.values())
    said = f"values that moved, by table: {', '.join(moved)}" if moved else "no value moved"
    return f"{said}; {counted(unmoved, 'value')} the same; --all shows them, --table NAME some"


def dot_plot(comparison: Comparison, baseline: str) -> Iterator[Html]:
    """Draw each dive and piece of evidence that moved: from what it was, in the middle, to what it is."""
    changes = [change for change in comparison.changes if _is_shown(change) and change.change_pct is not None]
    columns = list(dict.fromkeys((_owner(change, baseline), change.row) for change in changes))
    cells = {(change.log, _owner(change, baseline), change.row): change for change in changes}
    dives = sorted({change.log for change in changes}, key=natural_key)
    if not changes:
        return
    head = "".join(
        f'<th class="axis">{escape(visible(owner))}<br>{escape(visible(label(row)))}</th>' for owner, row in columns
    )
    rows = "".join(
        f'<tr><th scope="row">{escape(visible(dive))}</th>'
        f"{''.join(_dot(cells.get((dive, *column))) for column in columns)}</tr>"
        for dive in dives
    )
    yield Html(
        "<figure><figcaption><strong>Errors and times, old to new</strong><span>A line begins at the old value and "
        "ends in a dot at the new one: to the left what became smaller, which is better. The edges are "
        f"{_FULL_PCT:g} % away; green is better, red worse.</span></figcaption>"
        '<div class="wide" tabindex="0"><table class="bars dots">'
        f"<thead><tr><th>dive</th>{head}</tr></thead><tbody>{rows}</tbody></table></div></figure>"
    )


def _dot(change: Change | None) -> str:
    if change is None or change.change_pct is None:
        return '<td class="axis"></td>'
    end = max(-_FULL_PCT, min(_FULL_PCT, change.change_pct))
    style = _STYLES.get(change.word, "reference")
    text = escape(f"{growth(change)}: {' to '.join(old_and_new(change))} {change.unit}")
    return (
        f'<td class="axis"><svg viewBox="-55 0 110 16" role="img" aria-label="{text}"><title>{text}</title>'
        f'<path class="zero" d="M0 0V16"/><path class="line solid {style}" d="M0 8H{end:.1f}"/>'
        f'<path class="points {style}" d="M{end:.1f} 8h0"/></svg></td>'
    )
