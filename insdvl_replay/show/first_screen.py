"""The first screen of a page: for each candidate its verdict, what decided, and the evidence as forest plots."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final
from urllib.parse import quote

from insdvl_replay.core.errors import visible_lines
from insdvl_replay.core.quantities import CONSISTENCY, label
from insdvl_replay.core.result import DisplayTable, Html, Report
from insdvl_replay.core.tables import PooledRow
from insdvl_replay.core.words import EvidenceVerdict, Verdict
from insdvl_replay.evaluation.answers import Piece, may_decide, reason_in_words, shown_interval
from insdvl_replay.show.answers import AnyAnswer, chosen_rows, ratio_text, verdict_in_table
from insdvl_replay.show.forest import ForestRow, change_of_value, forest, tone_class, unbroken
from insdvl_replay.show.page import table_html

# How to read the forest plots.
READING: Final = (
    "Ratio: error of the candidate over that of the baseline, with its 95 % interval. Left of 1 is better. Shaded: "
    "within 5 %. Open dot: undecided. Bold: named in the sentence."
)
MOST_DIVES: Final = 20  # With more dives, those with the largest effects are drawn.
DIVE_PAGE: Final = "report.html"  # The page of a dive, in its folder.


def first_screen(
    sections: Sequence[str], caption: str, pictures: str = "", tables: Sequence[DisplayTable] = ()
) -> Html:
    """Return sections of candidates with tables below and pictures next to them, and a caption."""
    aside = f'<div class="aside">{pictures}</div>' if pictures else ""
    reading = f"{READING} " if any("<svg" in section for section in sections) else ""
    note = f'<p class="footnote">{unbroken(f"{reading}{caption}")}</p>'
    shown = "".join([*sections, *map(table_html, tables)])
    return Html(f'<div class="opening"><div class="candidates">{shown}</div>{aside}</div>{note}')


def section(answer: AnyAnswer, sentences: Sequence[str], plots: Sequence[str] = ()) -> str:
    """Return the section of a candidate: the word, sentences, and plots next to them."""
    name, baseline = answer.filter, answer.baseline
    # A name keeps its first letter.
    begun = (text if text.startswith((name, baseline)) else f"{text[:1].upper()}{text[1:]}" for text in sentences)
    said = "".join(f"<p>{_stressed(sentence)}</p>" for sentence in begun)
    against = f"<p><b>{escape(visible_lines(name))}</b> against {escape(visible_lines(baseline))}</p>"
    word = f'<p class="word">{answer.verdict.upper()}</p>'
    return (
        f'<section class="candidate {tone_class(answer.verdict)}"><div class="says">{word}{against}{said}</div>'
        f"{''.join(plots)}</section>"
    )


def _stressed(sentence: str) -> str:
    """Write a sentence as HTML, with whether a prediction is confirmed in bold."""
    text = unbroken(sentence)
    word = next((word for word in ("Not confirmed", "Confirmed") if word in text), "")
    return text.replace(word, f"<b>{word}</b>", 1) if word else text


def _reason(row: Piece) -> str:
    """Say why a row does not decide; equivalent is a decision."""
    return "" if row.verdict == EvidenceVerdict.EQUIVALENT else reason_in_words(row)


def evidence_forest(title: str, answer: AnyAnswer, most: int) -> str:
    """Draw evidence rows: those that decided, the first of each kind, then others."""
    # Innovations have no vote, and the track of one dive is one sample.
    known = [row for row in answer.known if row.evidence != CONSISTENCY]
    known = [row for row in known if row.evidence != "track" or may_decide(row)]
    drawn = []
    for row in chosen_rows(known, most):
        won = f" {row.dives_won}/{row.dives}" if isinstance(row, PooledRow) and answer.dives > 1 else ""
        text, ends = f"{ratio_text(row.ratio)} {verdict_in_table(row)}{won}", shown_interval(row)
        decides = row in answer.spoken
        drawn.append(ForestRow(label(row.quantity), row.ratio, ends, row.verdict, text, "", _reason(row), decides))
    return forest(title, drawn)


def dives_forest(answer: AnyAnswer, reports: Iterable[Report], *, linked: bool) -> str:
    """Draw the dives one by one, the smallest ratio first, by the quantity of the row that decided."""
    first = [*answer.spoken, *answer.rows][:1]
    quantity, rows = first[0].quantity if first else "", list[ForestRow]()
    for report in (report for report in reports if answer.filter in report.filters):
        name, link = report.log.name, f"{quote(report.log.name)}/{DIVE_PAGE}" if linked else ""
        own = [row for row in report.tables.evidence if (row.filter, row.quantity) == (answer.filter, quantity)]
        if report.filters[answer.filter].verdict == Verdict.NOT_EVALUATED:
            rows.append(ForestRow(name, None, tone=Verdict.NOT_EVALUATED, text=Verdict.NOT_EVALUATED, link=link))
        elif not own or own[0].ratio is None:
            rows.append(ForestRow(name, None, text="no value", link=link))
        else:
            [row] = own
            text = change_of_value(row.baseline, row.value, row.unit)
            if row.evidence == "accuracy" and row.starts > 1:  # the values are from the dive's own start alone
                text = f"{ratio_text(row.ratio)} {row.verdict}"
            rows.append(ForestRow(name, row.ratio, shown_interval(row), row.verdict, text, link, _reason(row)))
    return by_dive_forest(quantity, rows)


def by_dive_forest(quantity: str, rows: Sequence[ForestRow]) -> str:
    """Draw the dives one by one, the smallest ratio first; of many those with the largest effects."""
    name = label(quantity) or "evidence"
    title = f"{name[:1].upper()}{name[1:]}, dive by dive"
    if len(rows) > MOST_DIVES:
        title += f": the {MOST_DIVES} largest effects of {len(rows)}"
    largest = sorted(rows, key=_effect, reverse=True)[:MOST_DIVES]
    return forest(title, sorted(largest, key=lambda row: math.inf if row.ratio is None else row.ratio))


def _effect(row: ForestRow) -> float:
    """Return the size of the effect of a row: how far its ratio is from 1."""
    if row.ratio is None:
        return -1.0
    return abs(math.log(row.ratio)) if row.ratio > 0.0 else math.inf
