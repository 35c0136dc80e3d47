"""The one place where the benchmarks ask the tool for its verdicts: over several dives, and by intervals alone.

Everything else in the worlds of the judge is about truth and counting, and calls nothing of `insdvl_replay.evaluation`
that makes a word. If the tool names its rule otherwise, this file changes and no other.
"""

import importlib
import importlib.util
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import numpy as np

from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.evaluation.series import dives_ratio, verdict_of_interval
from insdvl_replay.nav.user_candidate import CandidateStart, Solution
from insdvl_replay.preparation.programs import UserProcesses, solution_of_class
from insdvl_replay.replay import Replay

FEWEST_DIVES: Final = 3
RULE: Final = "insdvl_replay.evaluation.interval"


# --- The rule for one ratio over dives.


class Found(NamedTuple):
    """An interval over dives, the one that may be looked at after every dive, and their words."""

    low: float
    high: float
    word: str
    word_always: str


@cache
def has_interval_rule() -> bool:
    """Return whether the tool decides by one interval; else it decides by its probability, as it did before."""
    return importlib.util.find_spec(RULE) is not None


@cache
def _rule() -> Any:
    return importlib.import_module(RULE)


def over_dives(
    log_ratios: Sequence[float], *, level: float = 0.95, vehicles: Sequence[str] | None = None, always: bool = True
) -> Found:
    """Ask the tool for its interval over dives, and for its word.

    Parameters
    ----------
    log_ratios : sequence of float
        Candidate over baseline, one for each dive.
    level : float
        Of confidence.
    vehicles : sequence of str, optional
        Of each dive.
    always : bool
        Whether the word for every look is asked for, too.
    """
    if not has_interval_rule():
        interval = dives_ratio(np.asarray(log_ratios))
        word = str(verdict_of_interval(interval, FEWEST_DIVES))
        return Found(interval.low, interval.high, word, word)
    rule = _rule()
    found = rule.log_ratio_interval(log_ratios, level=level, vehicles=vehicles)
    word = _word(rule, found.low, found.high)
    return Found(found.low, found.high, word, _word(rule, found.low_always, found.high_always) if always else "")


def _word(rule: Any, low: float | None, high: float | None) -> str:
    """Give the word of an interval; one that is missing decides nothing."""
    if low is None or high is None or math.isnan(low) or math.isnan(high):
        return "undecided"
    return str(rule.word_of_interval(low, high))


def level_of(count: int, *, named: bool = False, is_named: bool = False) -> float:
    """Ask the tool for the level of confidence of one candidate of several; before, each had the level of one."""
    if not has_interval_rule():
        return 0.95
    return float(_rule().level_of_candidates(count, named=named, is_named=is_named))


# --- The whole tool: dives that were replayed, and the verdict over several of them.


@dataclass(frozen=True)
class Record:
    """What the tool keeps of one candidate in one dive, so that verdicts over dives can be made of it."""

    word: str
    """Its verdict on this dive alone."""
    rows: tuple[EvidenceRow, ...]
    is_evaluated: bool
    note_codes: tuple[str, ...] = ()


def record_of(replay: Replay, candidate: str) -> Record:
    """Keep what a verdict over several dives is made of."""
    rows = tuple(row for row in replay.tables.evidence if row.filter == candidate)
    word = str(replay.verdicts[candidate].verdict)
    codes = tuple(note.code for note in replay.notes)
    return Record(word, rows, word != Verdict.NOT_EVALUATED, codes)


def verdict_over(candidate: str, baseline: str, records: Sequence[Record], *, candidates: int = 1) -> str:
    """Ask the tool for its verdict over several dives on one of so many candidates."""
    judged = [record.rows for record in records if record.is_evaluated]
    return str(pooled_candidate(candidate, baseline, judged, len(records)).verdict)


def log_ratio_of(record: Record, quantity: str) -> float:
    """Give the logarithm of a ratio that a dive has; NaN where it has none."""
    for row in record.rows:
        if row.quantity == quantity and row.baseline and row.value:
            return math.log(row.value / row.baseline)
    return math.nan


@contextmanager
def classes_run_here() -> Iterator[None]:
    """Run classes of the user's in this process: words do not depend on it, and an interpreter takes far longer."""

    def run(processes: UserProcesses, _: str, dive_file: Path, start: CandidateStart) -> Solution:
        return solution_of_class(processes.settings.candidate or "", dive_file, start)

    with patch.object(UserProcesses, "run", run):
        yield
