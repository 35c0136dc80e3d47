"""The first screen of a page: for each candidate its verdict, what decided, and the evidence as forest plots.

A forest plot has ratios with their intervals on a logarithmic axis, the band of equal results, and a text each. Places
across are percent of the width, places down are pixels. So the text has the same size at any width.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final
from urllib.parse import quote

from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.quantities import WITHOUT_VERDICT, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import Number, PooledRow, WhereRow, finite
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.document.page import HOW_TO_READ, table_html
from insdvl_replay.document.parts import DisplayTable, Html
from insdvl_replay.document.tables import significant
from insdvl_replay.evaluation.answers import Answer
from insdvl_replay.evaluation.interval import BAND, word_of_interval
from insdvl_replay.evaluation.sentences import (
    CONFIRMED,
    NOT_CONFIRMED,
    begun_with_capital,
    ratio_text,
    word_of,
)
from insdvl_replay.evaluation.where import notable
from insdvl_replay.show.answers import chosen_rows, verdict_in_table

# --- Forest plots as SVG.

# Percent of the width: the end of labels, both ends of the axis, the start of texts.
LABEL_END = 28.0
LEFT = 30.0
RIGHT = 64.0
TEXT = 66.0
# Pixels: free above the rows, the height of a row, the height of the axis labels.
TOP = 3
ROW = 17
BOTTOM = 16
_BASELINE: Final = 4  # Pixels by which the foot of a text is below the middle of its row.
# Ticks by the upper end of the axis; the lower end is one over it.
AXES: Final = {
    2.0: (0.5, 0.7, 1.0, 1.4, 2.0),
    5.0: (0.2, 0.5, 1.0, 2.0, 5.0),
    20.0: (0.05, 0.2, 1.0, 5.0, 20.0),
    100.0: (0.01, 0.1, 1.0, 10.0, 100.0),
}
_MOST_BEYOND: Final = 0.5  # Share of the ratios that may be beyond the axis, as arrows.
_LONGEST_LABEL: Final = 20
_ARROW: Final = "\N{RIGHTWARDS ARROW}"
OLD_TO_NEW: Final = f"old {_ARROW} new"  # above values of both sides
_RAISED: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class ForestRow:
    """A ratio with its interval; what is missing is not drawn."""

    label: str
    ratio: Number
    interval: tuple[float, float] | None = None
    tone: str = ""  # a verdict: its colour
    text: str = ""  # after the axis
    link: str = ""  # target of the label
    why: str = ""  # footnote
    decides: bool = False  # printed in bold

    @property
    def known_interval(self) -> tuple[float, float] | None:
        """The interval if both of its ends are numbers."""
        if self.interval is None or math.isnan(sum(self.interval)):
            return None
        return self.interval


def forest(title: str, rows: Sequence[ForestRow], head: str = "") -> str:
    """Draw ratios, a row each, in a section of their own; ``head`` says above the texts what they are."""
    return _section_of_plots([_plot(title, rows, head)])


def _section_of_plots(plots: Sequence[str]) -> str:
    """Return a section with plots below each other."""
    return f'<section class="forest">{"".join(plots)}</section>'


def _plot(title: str, rows: Sequence[ForestRow], head: str = "") -> str:
    """Draw ratios, a row each; the mark of a row's reason, a footnote, is behind its text."""
    marks: dict[str, str] = {}
    notes = []
    for row in rows:
        if row.why and row.why not in marks:
            mark = str(len(marks) + 1).translate(_RAISED)
            marks[row.why] = mark
            notes.append(f"{mark}&nbsp;{unbroken(row.why)}")
    footnote = ""
    if notes:
        footnote = f'<p class="footnote">{". ".join(notes)}.</p>'
    end = axis_end(rows)
    top = TOP
    if head:
        top += ROW
    bottom = top + ROW * len(rows)
    lines = [f'<svg width="100%" height="{bottom + BOTTOM}">', *_axis(end, bottom)]
    if head:
        lines.append(f'<text class="tick" x="{TEXT}%" y="{ROW - _BASELINE}">{escape(head)}</text>')
    for number, row in enumerate(rows):
        middle = top + ROW * number + ROW / 2.0
        lines += _row(row, middle, end, marks.get(row.why, ""))
    svg = "".join([*lines, "</svg>"])
    return f"<h3>{escape(title)}</h3>{svg}{footnote}"


def _axis(end: float, bottom: int) -> Iterator[str]:
    """Draw the band of equal results, and the ticks of the axis up to ``end``."""
    low = place(1.0 / BAND, end)
    high = place(BAND, end)
    yield f'<rect class="within" x="{low:.2f}%" y="0" width="{high - low:.2f}%" height="{bottom}"/>'
    for tick in AXES[end]:
        across = f"{place(tick, end):.2f}%"
        style = "one" if tick == 1.0 else "grid"
        yield f'<line class="{style}" x1="{across}" x2="{across}" y1="0" y2="{bottom}"/>'
        yield f'<text class="tick" x="{across}" y="{bottom + 13}" text-anchor="middle">{tick:g}</text>'


def _row(
    row: ForestRow,
    middle: float,
    end: float,
    mark: str,
) -> Iterator[str]:
    """Draw a row: its label, its ratio on the axis up to ``end``, and its text with the mark of a footnote."""
    foot = middle + _BASELINE
    style = f"row {tone_class(row.tone)}"
    if row.decides:
        style += " decides"
    yield f'<g class="{style.rstrip()}"><title>{escape(_in_full(row))}</title>'
    name = escape(_shortened(visible(row.label)))
    text = f'<text x="{LABEL_END}%" y="{foot}" text-anchor="end">{name}</text>'
    if row.link:
        text = f'<a href="{escape(row.link)}">{text}</a>'
    yield text
    yield from _mark(row, middle, end)
    said = escape(visible(row.text))
    if mark:
        said += f" {mark}"
    yield f'<text x="{TEXT}%" y="{foot}">{said}</text></g>'


def _in_full(row: ForestRow) -> str:
    """Write what is read where the pointer rests: whole name, ratio, interval, verdict."""
    text = row.label
    if not math.isnan(finite(row.ratio)):
        text += f": {row.ratio:.3g}"
    ends = row.known_interval
    if ends is not None:
        text += f" ({ends[0]:.3g} .. {ends[1]:.3g})"
    return visible(f"{text} {row.tone}".rstrip())


def _shortened(name: str) -> str:
    """Return begin and end of a long name."""
    half = _LONGEST_LABEL // 2
    if len(name) > _LONGEST_LABEL:
        return f"{name[: half - 1]}…{name[-half:]}"
    return name


def place(ratio: float, end: float) -> float:
    """Return the place of a ratio in percent of the width, on an axis up to ``end``."""
    return (LEFT + RIGHT) / 2.0 + (RIGHT - LEFT) / 2.0 * math.log(ratio) / math.log(end)


def axis_end(rows: Sequence[ForestRow]) -> float:
    """Return the upper end of the shortest axis that has at least half of the ratios."""
    ratios = [finite(row.ratio) for row in rows]
    sizes = [max(ratio, 1.0 / ratio) for ratio in ratios if 0.0 < ratio < math.inf]
    for end in AXES:
        beyond = [size for size in sizes if size > end]
        if len(beyond) <= _MOST_BEYOND * len(sizes):
            return end
    return max(AXES)


def change_of_value(old: Number, new: Number, unit: str) -> str:
    """Write two values, such as ``0.107 → 0.092 m``."""
    return f"{significant(old, 3)} {_ARROW} {significant(new, 3)} {unit}"


def unbroken(text: str) -> str:
    """Write text as HTML whose numbers stay on one line with their percent sign."""
    return escape(visible(text), quote=False).replace(" %", "&nbsp;%")


def tone_class(verdict: str) -> str:
    """Return the class of a verdict in the style sheet."""
    return verdict.replace(" ", "-")


def _mark(row: ForestRow, middle: float, end: float) -> Iterator[str]:
    """Draw a ratio as a dot on its interval, one beyond the axis as an arrow with the number."""
    if row.ratio is None or not row.ratio >= 0.0:
        return
    if not 1.0 / end <= row.ratio <= end:
        yield _arrow(row.ratio, middle)
        return
    if row.known_interval is not None:
        yield from _interval(row.known_interval, middle, end)
    yield f'<circle cx="{place(row.ratio, end):.2f}%" cy="{middle}" r="3.5"/>'


def _arrow(ratio: float, middle: float) -> str:
    """Point from the end of the axis to a ratio beyond it."""
    if ratio < 10.0:
        size = f"{ratio:.2g}"
    elif ratio < 1e5:
        size = f"{ratio:.0f}"
    else:
        size = f"{ratio:.0e}"
    foot = middle + _BASELINE
    if ratio > 1.0:
        return f'<text class="beyond" x="{RIGHT}%" y="{foot}" text-anchor="end">{size}x ▶</text>'
    return f'<text class="beyond" x="{LEFT}%" y="{foot}" text-anchor="start">◀ {size}x</text>'


def _interval(interval: tuple[float, float], middle: float, end: float) -> Iterator[str]:
    """Draw an interval, with a tip where it goes on beyond the axis."""
    low = min(max(interval[0], 1.0 / end), end)
    high = min(max(interval[1], 1.0 / end), end)
    left = f"{place(low, end):.2f}%"
    right = f"{place(high, end):.2f}%"
    yield f'<line class="interval" x1="{left}" x2="{right}" y1="{middle}" y2="{middle}"/>'
    if low != interval[0]:
        yield f'<svg class="tip" x="{left}" y="{middle}"><path d="M0 0l4-3v6z"/></svg>'
    if high != interval[1]:
        yield f'<svg class="tip" x="{right}" y="{middle}"><path d="M0 0l-4-3v6z"/></svg>'


# --- The first screen.

# How to read the forest plots.
READING: Final = (
    "Ratio: error of the {0} over that of the {1}, with its interval over dives. Left of 1 "
    "is better. The shaded band "
    "is a factor of 1.05. An interval completely left of it means better, right of it "
    "worse, and inside equivalent. "
    "The bold row decides."
)
MOST_PLOTS: Final = 2  # candidates whose drift by what the vehicle does is drawn, whatever it is
MOST_DIVES: Final = 20  # With more dives, those with the largest effects are drawn.
DIVE_PAGE: Final = "report.html"  # The page of a dive, in its folder.


def first_screen(
    sections: Sequence[str],
    caption: str,
    pictures: str = "",
    tables: Sequence[DisplayTable] = (),
    compared: tuple[str, str] = ("candidate", "baseline"),
    *,
    explains_figures: bool = False,  # the caption begins with how to read figures
) -> Html:
    """Return sections of candidates with tables below and pictures next to them, and a caption."""
    aside = ""
    if pictures:
        aside = f'<div class="aside">{pictures}</div>'
    if any("<svg" in section for section in sections):
        caption = f"{READING.format(*compared)} {caption}"
    reading = ""
    if explains_figures:
        reading = f'<span class="on-screen">{HOW_TO_READ}</span> '
    note = f'<p class="footnote">{reading}{unbroken(caption.strip())}</p>'
    shown = "".join([*sections, *map(table_html, tables)])
    opening = f'<div class="opening"><div class="candidates">{shown}</div>{aside}</div>{note}'
    return Html(opening, explains_figures=explains_figures)


def section(
    answer: Answer,
    sentences: Sequence[str],
    plots: Sequence[str] = (),
    footnote: str = "",  # why the last sentence is so
    compared: str = "",  # what is compared; empty: the candidate against its baseline
) -> str:
    """Return the section of a candidate: the word, sentences that do not repeat it, and plots next to them."""
    name = answer.filter
    baseline = answer.baseline
    said = ""
    for sentence in sentences:
        said += f"<p>{_stressed(begun_with_capital(sentence, answer))}</p>"
    if footnote:
        mark = "1".translate(_RAISED)
        said = said.removesuffix("</p>") + f" {mark}</p>"
        said += f'<p class="footnote">{mark}&nbsp;{unbroken(footnote)}.</p>'
    compared = compared or f" against {visible_lines(baseline)}"
    against = f"<p><b>{escape(visible_lines(name))}</b>{escape(compared)}</p>"
    word = f'<p class="word">{word_of(answer)}</p>'
    return (
        f'<section class="candidate {tone_class(answer.verdict)}"><div class="says">{word}{against}{said}</div>'
        f"{''.join(plots)}</section>"
    )


def _stressed(sentence: str) -> str:
    """Write a sentence as HTML, with whether a prediction is confirmed in bold."""
    text = unbroken(sentence)
    for word in (NOT_CONFIRMED, CONFIRMED):
        if word in text:
            return text.replace(word, f"<b>{word}</b>", 1)
    return text


def evidence_forest(title: str, answer: Answer, most: int, where: Sequence[WhereRow] = ()) -> str:
    """Draw rows of evidence over dives: the one that decides, those that can warn, convergence, then others.

    Below them is the drift by what the vehicle does, where it is known.
    """
    drawn = [_evidence_row(row) for row in chosen_rows(answer.known, most)]
    head = ""
    if answer.dives > 1:
        head = "ratio, smaller on"
    plots = [_plot(title, drawn, head)]
    if where:
        plots.append(_where_plot(where))
    return _section_of_plots(plots)


def _evidence_row(row: PooledRow) -> ForestRow:
    text = f"{ratio_text(row.ratio)} {verdict_in_table(row)}"
    tone: str = Verdict.UNDECIDED
    if row.dives > 1:
        text += f" {row.dives_won}/{row.dives}"
        tone = row.verdict
    decides = row.role == Role.PRIMARY
    ends = interval_ends(row)
    return ForestRow(label(row.quantity), row.ratio, ends, tone, text, decides=decides)


def is_where_drawn(rows: Sequence[WhereRow], candidates: int) -> bool:
    """Return whether there is room for the drift by what the vehicle does: of many candidates only what is notable."""
    return candidates <= MOST_PLOTS or bool(notable(rows))


def _where_plot(rows: Iterable[WhereRow]) -> str:
    """Draw the drift by what the vehicle does. What is notable is bold, and has its colour."""
    drawn = []
    for row in rows:
        ends = interval_ends(row)
        tone: str = Verdict.UNDECIDED
        if row.stands_out:
            tone = word_of_interval(finite(row.low), finite(row.high))
        text = f"{ratio_text(row.ratio)}, {row.windows} windows"
        drawn.append(
            ForestRow(label(row.bin), row.ratio, ends, tone, text, decides=row.stands_out)
        )
    return _plot("Where: drift in 30 s by what the vehicle does. Bold: notable", drawn)


def interval_ends(row: PooledRow | WhereRow) -> tuple[float, float] | None:
    """Return the ends of the interval of a row; None without one."""
    low = finite(row.low)
    high = finite(row.high)
    if math.isnan(low + high):
        return None
    return (low, high)


def dives_forest(answer: Answer, reports: Iterable[Report], *, linked: bool) -> str:
    """Draw the dives one by one, the smallest ratio first, by the primary quantity. One dive has no interval."""
    rows = []
    for report in reports:
        if answer.filter in report.filters:
            link = f"{quote(report.log.name)}/{DIVE_PAGE}" if linked else ""
            rows.append(_dive_row(answer, report, link))
    head = f"{_shortened(answer.baseline)} {_ARROW} {_shortened(answer.filter)}"
    return by_dive_forest(answer.primary, rows, head)


def _dive_row(answer: Answer, report: Report, link: str) -> ForestRow:
    """Return a dive with its ratio in the primary quantity, or why there is none."""
    name = report.log.name
    word = report.filters[answer.filter].verdict
    if word in WITHOUT_VERDICT:
        return ForestRow(name, None, tone=word, text=word, link=link)
    for row in report.tables.evidence:
        if (
            row.filter == answer.filter
            and row.quantity == answer.primary
            and row.ratio is not None
        ):
            text = change_of_value(row.baseline, row.value, row.unit)
            return ForestRow(name, row.ratio, None, Verdict.UNDECIDED, text, link)
    return ForestRow(name, None, text="no value", link=link)


def by_dive_forest(quantity: str, rows: Sequence[ForestRow], head: str = "") -> str:
    """Draw the dives one by one, the smallest ratio first; of many those with the largest effects."""
    name = label(quantity) or "evidence"
    title = f"{name[:1].upper()}{name[1:]}, dive by dive"
    if len(rows) > MOST_DIVES:
        title += f": the {MOST_DIVES} largest effects of {len(rows)}"
    largest = sorted(rows, key=_effect, reverse=True)[:MOST_DIVES]
    return forest(title, sorted(largest, key=_smallest_first), head)


def _smallest_first(row: ForestRow) -> float:
    if row.ratio is None:
        return math.inf
    return row.ratio


def _effect(row: ForestRow) -> float:
    """Return the size of the effect of a row: how far its ratio is from 1."""
    if row.ratio is None:
        return -1.0
    if row.ratio > 0.0:
        return abs(math.log(row.ratio))
    return math.inf
