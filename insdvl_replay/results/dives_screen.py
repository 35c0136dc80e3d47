"""What a terminal shows of several replays: what all say together, a row a dive, and where the rest is."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from insdvl_replay.core.errors import natural_key
from insdvl_replay.core.quantities import DECIDING_TOGETHER, HONESTY, label
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import EvidenceRow, PooledRow
from insdvl_replay.core.words import GateStatus, Judgement, Severity
from insdvl_replay.evaluation.over_dives import PooledCandidate
from insdvl_replay.evaluation.verdicts import spoken_of
from insdvl_replay.report.document import (
    MISSING,
    Code,
    Column,
    DisplayTable,
    Part,
    Sentences,
    counted,
    table_of,
)
from insdvl_replay.results.dive_screen import interval_text, ratio_text, shouted, value_text
from insdvl_replay.results.json_report import Report
from insdvl_replay.results.overviews import Failure, pooled_candidates

MOST_DIVES: Final = 20
"""Of more dives those that failed and the worst have rows."""
MOST_FAILED, WORST = 8, 3
MOST_CODES: Final = 3
FAILED: Final = GateStatus.FAILED
"""The word in place of a judgement."""
Outcome = Report | Failure


def dives_screen(outcomes: Sequence[Outcome], index: str) -> list[Part]:
    """Lay out the screen of several dives.

    Parameters
    ----------
    outcomes : sequence of Report or Failure
        In the order in which the logs were given.
    index : str
        Where the page of all of them lies, which is named last.
    """
    pooled = pooled_candidates(outcomes)
    return [
        *(_pooled(pooled) if pooled else ()),
        *_dives(outcomes),
        _counts(outcomes),
        Code(f"all tables: -v   page: {index}", ""),
    ]


def _counts(outcomes: Sequence[Outcome]) -> str:
    failed = sum(isinstance(outcome, Failure) for outcome in outcomes)
    said = [counted(len(outcomes), "dive"), f"{failed} failed", *_warnings(outcomes)]
    return ", ".join(said)


def _warnings(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Count on how many dives there is each warning, the most frequent first."""
    codes = [
        {note.code for note in outcome.notes if note.severity == Severity.WARNING}
        for outcome in outcomes
        if isinstance(outcome, Report)
    ]
    counts = Counter(code for of_dive in codes for code in of_dive)
    if counts:
        named = [f"{code} {count}" for code, count in counts.most_common(MOST_CODES)]
        more = [f"{len(counts) - MOST_CODES} more"] if len(counts) > MOST_CODES else []
        yield f"warnings on {sum(map(bool, codes))}: {', '.join(named + more)}"


def _pooled(pooled: Sequence[PooledCandidate]) -> Iterator[Part]:
    columns: list[Column[PooledCandidate]] = [
        (f"against {' or '.join(dict.fromkeys(one.baseline for one in pooled))}", "l", lambda one: one.name),
        ("all dives", "l", lambda one: shouted(one.judgement)),
        ("by", "l", lambda one: _of(one, lambda row: label(row.quantity))),
        ("ratio", "r", lambda one: _of(one, lambda row: ratio_text(row.ratio))),
        ("over dives", "r", lambda one: _of(one, lambda row: interval_text(row.low, row.high))),
        ("won", "r", lambda one: _of(one, lambda row: f"{row.dives_won}/{row.dives}")),
        ("p", "r", lambda one: _of(one, lambda row: f"{finite(row.p):.2g}")),
    ]
    yield table_of("", pooled, columns, spare=(2, 4, 6, 5, 3))
    yield Sentences(())


def _of(pooled: PooledCandidate, text: Callable[[PooledRow], str]) -> str:
    """Write something of the piece of evidence that decided, or could have."""
    judgement = pooled.judgement
    rows = [] if judgement == Judgement.NOT_JUDGED else spoken_of(judgement, pooled.rows, DECIDING_TOGETHER)
    return text(rows[0]) if rows else MISSING


@dataclass(frozen=True)
class _Dive:
    """One row: the evidence on each candidate in the quantity that is shown, and the words on them."""

    log: str
    evidence: Mapping[str, EvidenceRow]
    words: Mapping[str, str]

    def text(self, name: str, write: Callable[[EvidenceRow], str]) -> str:
        """Write something of the evidence on a candidate, where there is any."""
        return write(self.evidence[name]) if name in self.evidence else MISSING


def _dives(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Lay out a row a dive, with the values of a single candidate, and the ratio and the word of each."""
    reports = [outcome for outcome in outcomes if isinstance(outcome, Report)]
    names = list(dict.fromkeys(name for report in reports for name in report.filters))
    quantity, unit = _shown_quantity(reports)
    dives = [_dive(outcome, names, quantity) for outcome in outcomes]
    shown = sorted(_shown(dives), key=lambda dive: natural_key(dive.log))
    columns: list[Column[_Dive]] = [(label(quantity) or "dive", "l", lambda dive: dive.log)]
    if len(names) == 1:
        [name], baselines = names, {report.baseline for report in reports}
        columns += [
            (f"{' or '.join(sorted(baselines))} [{unit}]", "r", _text_of(name, lambda row: value_text(row.baseline))),
            (f"{name} [{unit}]", "r", _text_of(name, lambda row: value_text(row.value))),
        ]
    for name in names:
        heading = "ratio" if len(names) == 1 else name
        columns.append((heading, "r", _text_of(name, lambda row: ratio_text(row.ratio))))
        if len(names) == 1:
            columns.append(("on this dive", "r", _text_of(name, lambda row: interval_text(row.low, row.high))))
        columns.append(("", "l", partial(_word, name=name)))
    left_out = len(dives) - len(shown)
    footnote = f"failed, and the {WORST} with the largest ratio; {left_out} more: see the page" if left_out else ""
    yield table_of("", shown, columns, footnote, spare=(4, 1, 2) if len(names) == 1 else ())


def _text_of(name: str, write: Callable[[EvidenceRow], str]) -> Callable[[_Dive], str]:
    return lambda dive: dive.text(name, write)


def _word(dive: _Dive, name: str) -> str:
    return dive.words.get(name, MISSING)


def _shown_quantity(reports: Sequence[Report]) -> tuple[str, str]:
    """Return the piece of evidence that comes first on most dives, and its unit."""
    firsts = Counter(
        next((row.quantity, row.unit) for row in report.tables.evidence if row.filter == name)
        for report in reports
        for name in report.filters
        if any(row.filter == name and row.evidence != HONESTY for row in report.tables.evidence)
    )
    return firsts.most_common(1)[0][0] if firsts else ("", "")


def _dive(outcome: Outcome, names: Sequence[str], quantity: str) -> _Dive:
    if isinstance(outcome, Failure):
        return _Dive(outcome.log, {}, dict.fromkeys(names, FAILED))
    rows = {row.filter: row for row in outcome.tables.evidence if row.quantity == quantity}
    words = {name: shouted(candidate.improvement) for name, candidate in outcome.filters.items()}
    return _Dive(outcome.log.name, rows, words)


def _shown(dives: Sequence[_Dive]) -> list[_Dive]:
    """Choose the dives that have rows: all, or those that failed and the worst."""
    if len(dives) <= MOST_DIVES:
        return list(dives)
    failed = [dive for dive in dives if FAILED in dive.words.values()]
    known = [dive for dive in dives if dive.evidence]
    worst = sorted(known, key=lambda dive: -max(finite(row.ratio) for row in dive.evidence.values()))
    chosen = [*failed[:MOST_FAILED], *worst[:WORST]]
    return [dive for dive in dives if dive in chosen]
