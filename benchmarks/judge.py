"""How often the judgement is right: its words on simulated dives beside the truth, which an ensemble tells.

`make judge` runs this. Every dive is written to a log and replayed as a user's would be.
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import msgspec
from results import machine, table, write_part
from true_errors import MeanSquares, Soundness, mean_squares, soundness, true_ratios, truth
from worlds import DURATION_S, SCENARIO, WORLDS, dive_seed, exact_way, made_dive

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.rows import EvidenceRow
from insdvl_replay.core.words import Judgement
from insdvl_replay.evaluation.pooled_evidence import pooled_evidence, pooled_judgement
from insdvl_replay.evaluation.reference import reference_errors
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.reading import read_checked_dive
from insdvl_replay.preparation.running import prepared_timeline, run_filters
from insdvl_replay.replay import Replay, replay_dive
from insdvl_replay.studies.simulated_run import MonteCarloSetup, drawn_start

DIVES, POOLED = 60, 8
WORDS: Final = ("better", "equivalent", "undecided", "mixed", "worse", "not judged")
STARTS: Final = ("reference", "drawn")
"""The truth of filters that start on the reference, and of filters whose start errs as much as they allow for."""


def word_of_replay(replay: Replay, candidate: str) -> str:
    """Give the program's word on a candidate, one of `WORDS`."""
    return replay.verdicts[candidate].improvement


def evidence_of_replay(replay: Replay, candidate: str) -> list[EvidenceRow]:
    """Give the evidence of a dive on a candidate; none where it is not judged."""
    if replay.verdicts[candidate].improvement == Judgement.NOT_JUDGED:
        return []
    return [row for row in replay.tables.evidence if row.filter == candidate]


def pooled_word(candidate: str, evidence: Sequence[list[EvidenceRow]]) -> str:
    """Give the program's word on a candidate over several dives."""
    judged = [rows for rows in evidence if rows]
    return pooled_judgement(pooled_evidence(candidate, judged), len(evidence), len(judged))


@dataclass(frozen=True)
class JudgedDive:
    """What the program says of a dive, and what is true of it.

    Attributes
    ----------
    words, evidence : mapping of str to anything
        By candidate.
    errors : mapping of str to mapping of str to MeanSquares
        By start and filter; empty where the program refused the log, which is as good as not to judge it.
    """

    number: int
    words: Mapping[str, str]
    evidence: Mapping[str, list[EvidenceRow]]
    errors: Mapping[str, Mapping[str, MeanSquares]]
    soundness: Soundness | None


def judged_dive(task: tuple[int, int]) -> JudgedDive:
    """Simulate, replay and judge one dive; the task is the number of its world and its own."""
    number, seed = task[0], dive_seed(*task)
    world = WORLDS[number]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, made_dive(number, seed))
        try:
            dive = read_checked_dive(path, world.config)
            replay = replay_dive(dive, _with_own_draws(world.config, seed))
        except LogError:
            return JudgedDive(number, dict.fromkeys(world.candidates, "not judged"), {}, {}, None)
    return JudgedDive(
        number,
        {name: word_of_replay(replay, name) for name in world.candidates},
        {name: evidence_of_replay(replay, name) for name in world.candidates},
        {
            "reference": {name: mean_squares(errors) for name, errors in replay.errors.items()},
            "drawn": _errors_from_drawn_start(dive, number, seed),
        },
        soundness(replay.histories, replay.errors),
    )


def _with_own_draws(config: Config, seed: int) -> Config:
    """Draw other starts in each dive; simulated ones all begin at the same time, by which real ones differ."""
    return msgspec.structs.replace(config, evaluation=msgspec.structs.replace(config.evaluation, seed=seed))


def _errors_from_drawn_start(dive: Dive, number: int, seed: int) -> dict[str, MeanSquares]:
    """Replay a dive from a start that errs as the initial uncertainty says; the biases' errors are the sensors' own."""
    if dive.reference is None:
        raise ValueError("a simulated dive has a reference")
    world, start = WORLDS[number], prepare_dive(dive, WORLDS[number].config)
    drawn = drawn_start(MonteCarloSetup(exact_way(number), world.imu_errors, world.dvl_errors, world.config), seed)
    begun = replace(start, alignment=replace(start.alignment, start=drawn))
    histories = run_filters(begun, prepared_timeline(dive, begun))
    return {history.filter: mean_squares(reference_errors(history, dive.reference)) for history in histories}


def judged_dives(tasks: Sequence[tuple[int, int]], jobs: int) -> Iterator[JudgedDive]:
    """Judge dives, in processes of their own where there is more than one job."""
    if jobs == 1:
        yield from map(judged_dive, tasks)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as processes:
        yield from processes.map(judged_dive, tasks)


class Judged(NamedTuple):
    """All dives of one candidate in one world."""

    name: str
    kind: str
    truths: Mapping[str, str]
    words: Counter[str]
    pooled: Counter[str]
    soundness: str


def judged_candidates(dives: Sequence[JudgedDive], start: str) -> list[Judged]:
    """Hold the words on each candidate against the truth, which is of filters that start on a kind of start."""
    found = []
    for number, world in enumerate(WORLDS):
        of_world = [dive for dive in dives if dive.number == number]
        for candidate in world.candidates if of_world else ():
            ratios = {begun: _ratios(of_world, world.config.baseline, candidate, begun) for begun in STARTS}
            kind = "D" if world.dead else truth(ratios[start]) if ratios[start] else "-"
            told = {begun: " | ".join(map(str, ratio)) or "- | -" for begun, ratio in ratios.items()}
            words = Counter(dive.words[candidate] for dive in of_world)
            name = world.name if len(world.candidates) == 1 else f"{world.name}: {candidate}"
            found.append(Judged(name, kind, told, words, _pooled(of_world, candidate), _median_soundness(of_world)))
    return found


def _ratios(dives: Sequence[JudgedDive], baseline: str, candidate: str, start: str) -> tuple[Any, ...]:
    known = [dive.errors[start] for dive in dives if dive.errors]
    return true_ratios(known, baseline, candidate) if known else ()


def _pooled(dives: Sequence[JudgedDive], candidate: str) -> Counter[str]:
    """Count the words on whole groups of dives."""
    groups = (dives[first : first + POOLED] for first in range(0, len(dives) - POOLED + 1, POOLED))
    return Counter(pooled_word(candidate, [dive.evidence.get(candidate, []) for dive in group]) for group in groups)


def _median_soundness(dives: Sequence[JudgedDive]) -> str:
    known = [dive.soundness for dive in dives if dive.soundness is not None]
    if not known:
        return "refused | refused | refused"
    return " | ".join(f"{median(values):.3g}" for values in zip(*known, strict=True))


class Question(NamedTuple):
    """A row of the table of rates: how often some words fall on dives of one class, and how often they may."""

    asks: str
    kind: str
    words: frozenset[str]
    of_one: str
    of_eight: str


QUESTIONS: Final = (
    Question("truly better, said better", "A", frozenset({"better"}), "at least 60 %", "at least 85 %"),
    Question("truly better, said worse", "A", frozenset({"worse"}), "at most 1 %", "0"),
    Question("truly the same, said better or worse", "B", frozenset({"better", "worse"}), "at most 4 %", "at most 1 %"),
    Question("truly worse, said worse", "C", frozenset({"worse"}), "at least 60 %", "100 %"),
    Question("truly worse, said better", "C", frozenset({"better"}), "at most 1 %", "0"),
    Question("dead, said anything but *not judged*", "D", frozenset(WORDS) - {"not judged"}, "0", "0"),
)


def rates(candidates: Sequence[Judged]) -> list[str]:
    """Give the rows of the table of rates."""
    rows = []
    for question in QUESTIONS:
        of_kind = [candidate for candidate in candidates if candidate.kind.rstrip("?") == question.kind]
        one, eight = (
            _rate(sum((getattr(candidate, count) for candidate in of_kind), Counter()), question.words)
            for count in ("words", "pooled")
        )
        rows.append(f"| {question.asks} | {one} | {question.of_one} | {eight} | {question.of_eight} |")
    return rows


def _rate(words: Counter[str], asked: frozenset[str]) -> str:
    said = sum(words[word] for word in asked)
    return f"{100.0 * said / words.total():.1f} % ({said} of {words.total()})" if words else "-"


def page(candidates: Sequence[Judged], dives: int, start: str, took_s: float) -> str:
    """Write the part of the page of results."""
    asked = ("", "one dive", "asked", "eight dives pooled", "asked")
    words = [
        f"| {it.name} | {it.kind} | {' | '.join(str(it.words[word] or '') for word in WORDS)} |" for it in candidates
    ]
    facts = [
        f"| {it.name} | {it.kind} | {' | '.join(it.truths[begun] for begun in STARTS)} | {it.soundness} |"
        for it in candidates
    ]
    about = (
        f"{dives} dives of a {SCENARIO}, {DURATION_S:g} s, in each world, replayed from their logs. What is true is "
        "told by the errors of all dives of a world together: A, the candidate is truly better than the baseline, by "
        "5 % or more; B, they are the same; C, it is worse; a question mark where the intervals allow for another "
        "class. D, the filters are dead or set wrong. The classes are those of filters that start "
        f"{_START_IN_WORDS[start]}. Worlds whose class was not clear, or in which drift and velocity contradict each "
        "other, were left out when they were chosen: the rates are of worlds that have an answer."
    )
    facts_about = (
        "Root mean square of the candidate's horizontal errors over the baseline's, over all dives, with the interval "
        "of 95 % from dives drawn with replacement: the drift in 60 s, and the velocity; first of filters that start "
        "on the reference, then of filters whose attitude and velocity err at the start as much as they allow for. "
        "Then, in the median of the dives, the pings that the worst filter rejects, its NIS, 1 expected, and its "
        "horizontal position error in percent of the distance."
    )
    of_truth = [f"{quantity}, {begun} start" for begun, quantity in product(STARTS, ("drift", "velocity"))]
    return "\n".join(
        [
            *("# Judgement", "", about, ""),
            *table(asked, rates(candidates)),
            *("", "How often each word was said:", ""),
            *table(("world", "truth", *WORDS), words),
            *("", facts_about, ""),
            *table(("world", "truth", *of_truth, "rejected [%]", "NIS / dof", "error [%]"), facts),
            *("", f"{machine()}; {took_s:.0f} s."),
        ]
    )


_START_IN_WORDS: Final = {
    "reference": "on the reference",
    "drawn": "as far off as they allow for",
}


def main() -> None:
    """Judge, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="in each world")
    parser.add_argument("--worlds", nargs="+", default=[""], help="those whose names hold one of these texts")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument(
        "--truth", choices=STARTS, default=STARTS[1], help="the start of the filters that say what is true"
    )
    arguments = parser.parse_args()
    numbers = [i for i, world in enumerate(WORLDS) if any(part in world.name for part in arguments.worlds)]
    for library in ("OPENBLAS", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # each process, which has yet to load numpy, has one core
    begun_s = time.monotonic()
    dives = list(judged_dives([*product(numbers, range(arguments.dives))], arguments.jobs))
    candidates = judged_candidates(dives, arguments.truth)
    part = page(candidates, arguments.dives, arguments.truth, time.monotonic() - begun_s)
    if (arguments.dives, arguments.worlds) == (DIVES, [""]):
        write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
