"""Believed against actual: what each filter claims to have gained, beside what the reference confirms."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Final

from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.report.display_table import percent, row_label
from insdvl_replay.results.json_report import Report

_SAME: Final = {"dv_n": "velocity_n", "dv_e": "velocity_e", "dv_d": "velocity_d", "phi_d": "heading"}
"""States whose error is also compared with the reference, and under which name."""
_FULL_PCT: Final = 100.0
"""Longer bars end at the edge; the number beside them says it all."""


def improvement_bars(report: Report, name: str) -> str:
    """Draw what a candidate believes to have gained over the baseline, and what it has gained, as bars with numbers.

    Parameters
    ----------
    report : Report
    name : str
        A candidate.

    Returns
    -------
    str
        An HTML table.
    """
    rows = "".join(_row(label, believed, actual) for label, believed, actual in _gains(report, name))
    title = f"{name} against {report.baseline}"
    return (
        f'<section><h3><b>{escape(title)}</b></h3><table class="bars"><thead><tr><th>quantity</th>'
        '<th class="r">believed</th><th class="r">actual</th><th class="axis"><span>&minus;100 %</span><span>0</span>'
        f"<span>100 %</span></th></tr></thead><tbody>{rows}</tbody></table></section>"
    )


def _gains(report: Report, name: str) -> Iterator[tuple[str, float | None, float | None]]:
    """Give label, believed and actual improvement in percent: the means, the states, and what has no state."""
    means = report.filters[name]
    yield "mean of nine states, median of the errors", means.mean_improvement_pct, means.reference_improvement_pct
    actual: dict[str, float | None] = {
        row.quantity: row.improvement_pct
        for row in report.tables.reference_error
        if row.filter == name and row.status == ReferenceStatus.COMPARED
    }
    believed: Mapping[str, float | None] = {
        row.state: row.improvement_pct for row in report.tables.improvement if row.filter == name
    }
    for state, improvement_pct in believed.items():
        quantity = _SAME.get(state, "")
        label = row_label(state) + (" / heading" if quantity == "heading" else "")
        yield label, improvement_pct, actual.pop(quantity, None)
    for quantity, improvement_pct in actual.items():
        yield row_label(quantity), None, improvement_pct


def _row(label: str, believed_pct: float | None, actual_pct: float | None) -> str:
    bars = _bar("believed", believed_pct, 1) + _bar("actual", actual_pct, 9)
    return (
        f'<tr><th scope="row">{escape(label)}</th><td class="r">{percent(believed_pct)}</td>'
        f'<td class="r">{percent(actual_pct)}</td><td class="axis"><svg viewBox="-100 0 200 16" '
        f'preserveAspectRatio="none"><path class="zero" d="M0 0V16"/>{bars}</svg></td></tr>'
    )


def _bar(style: str, value_pct: float | None, top: int) -> str:
    if value_pct is None:
        return ""
    end = max(-_FULL_PCT, min(_FULL_PCT, value_pct))
    return f'<rect class="{style}" x="{min(0.0, end):.1f}" y="{top}" width="{abs(end):.1f}" height="6"/>'
