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
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from results import machine, table, write_part
from true_errors import MeanSquares, Soundness, is_large, mean_squares, soundness, true_ratios, truth
from worlds import DURATION_S, SCENARIO, SEA_SEED, WORLDS, World, dive_seed, made_dive

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.evaluation.reference_errors import reference_errors
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import prepare_dive, read_checked_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.replay import Replay, replay_dive
from insdvl_replay.studies.montecarlo import MonteCarloSetup, drawn_start

DIVES, SEA_DIVES = 60, 24
TRUTH_DIVES, TRUTH_ALONE = 72, 1000
"""So many more dives in each world at sea, from this number on, tell what is true and are not evaluated."""
EXCHANGES = 200
"""So many groups of dives of each pair of equal filters, which are exchanged at random."""
FEW, POOLED = 3, 8
"""Dives that are pooled, disjoint groups in the order of their numbers."""
WORDS: Final = ("better", "equivalent", "undecided", "mixed", "worse", "not evaluated")
LONG_S: Final = 3600.0
STARTS: Final = ("reference", "drawn")
"""The truth of filters that start on the reference, and of filters whose start errs as much as they allow for."""


def word_of_replay(replay: Replay, candidate: str) -> str:
    """Give the program's word on a candidate, one of `WORDS`."""
    return replay.verdicts[candidate].verdict


def evidence_of_replay(replay: Replay, candidate: str) -> list[EvidenceRow]:
    """Give the evidence of a dive on a candidate; none where it is not evaluated."""
    if replay.verdicts[candidate].verdict == Verdict.NOT_EVALUATED:
        return []
    return [row for row in replay.tables.evidence if row.filter == candidate]


def pooled_verdict_word(candidate: str, evidence: Sequence[list[EvidenceRow]]) -> str:
    """Give the program's word on a candidate over several dives."""
    judged = [rows for rows in evidence if rows]
    return pooled_candidate(candidate, "baseline", judged, len(evidence)).verdict


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


def judged_dive(task: tuple[int, ...]) -> JudgedDive:
    """Simulate, replay and judge one dive; the task is the numbers of its world and its own, and the seed at sea."""
    number, seed = task[0], dive_seed(*task)
    world = WORLDS[number]
    reported, exact = made_dive(number, seed)
    if task[1] >= TRUTH_ALONE:
        return JudgedDive(number, {}, {}, {"drawn": _errors_from_drawn_start(reported, exact, number, seed)}, None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, reported)
        try:
            dive = read_checked_dive(path, world.config)
            replay = replay_dive(dive, _with_own_draws(world.config, seed))
        except LogError:
            return JudgedDive(number, dict.fromkeys(world.candidates, "not evaluated"), {}, {}, None)
    return JudgedDive(
        number,
        {name: word_of_replay(replay, name) for name in world.candidates},
        {name: evidence_of_replay(replay, name) for name in world.candidates},
        {
            "reference": _true_errors(replay.histories, exact),
            "drawn": _errors_from_drawn_start(dive, exact, number, seed),
        },
        soundness(replay.histories, replay.errors),
    )


def _with_own_draws(config: Config, seed: int) -> Config:
    """Draw other starts in each dive; simulated ones all begin at the same time, by which real ones differ."""
    return msgspec.structs.replace(config, evaluation=msgspec.structs.replace(config.evaluation, seed=seed))


def _errors_from_drawn_start(dive: Dive, exact: Dive, number: int, seed: int) -> dict[str, MeanSquares]:
    """Replay a dive from a start that errs as the initial uncertainty says; the biases' errors are the sensors' own."""
    world = WORLDS[number]
    start, drawn = (
        prepare_dive(dive, world.config),
        drawn_start(MonteCarloSetup(exact, world.imu_errors, world.dvl_errors, world.config), seed),
    )
    begun = replace(start, alignment=replace(start.alignment, start=drawn))
    timeline = prepared_timeline(dive, begun)
    return _true_errors([run_one(filter_, begun, timeline) for filter_ in begun.filters], exact)


def _true_errors(histories: Sequence[History], exact: Dive) -> dict[str, MeanSquares]:
    """Measure what filters are off by against the exact motion, however noisy the reference in the log is."""
    if exact.reference is None:
        raise ValueError("a simulated dive has a reference")
    return {history.filter: mean_squares(reference_errors(history, exact.reference)) for history in histories}


def judged_dives(tasks: Sequence[tuple[int, ...]], jobs: int) -> Iterator[JudgedDive]:
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
    of_few: Counter[str]
    """Words on groups of `FEW` dives."""
    is_far: bool
    """Whether the better or the worse filter errs by at least 10 % less."""
    is_copy: bool


def evaluated_candidates(dives: Sequence[JudgedDive], start: str) -> list[Judged]:
    """Hold the words on each candidate against the truth, which is of filters that start on a kind of start."""
    found = []
    for number, world in enumerate(WORLDS):
        every = [dive for dive in dives if dive.number == number]
        of_world = [dive for dive in every if dive.words]
        for candidate in world.candidates if of_world else ():
            # The first worlds were chosen by their drift and velocity.
            count = None if world.sea else 2
            ratios = {begun: _ratios(every, world.config.baseline, candidate, begun)[:count] for begun in STARTS}
            kind = "D" if world.dead else truth(ratios[start]) if ratios[start] else "-"
            told = {begun: " | ".join(map(str, ratio)) or "- | -" for begun, ratio in ratios.items()}
            words = Counter(dive.words[candidate] for dive in of_world)
            name = world.name if len(world.candidates) == 1 else f"{world.name}: {candidate}"
            pooled, of_few = (_pooled(of_world, candidate, size) for size in (POOLED, FEW))
            is_far, is_copy = is_large(ratios[start]), candidate.startswith("copy")
            sound = _median_soundness(of_world)
            found.append(Judged(name, kind, told, words, pooled, sound, of_few, is_far, is_copy))
    return found


def _ratios(dives: Sequence[JudgedDive], baseline: str, candidate: str, start: str) -> tuple[Any, ...]:
    known = [dive.errors[start] for dive in dives if start in dive.errors]
    return true_ratios(known, baseline, candidate) if known else ()


def _pooled(dives: Sequence[JudgedDive], candidate: str, size: int) -> Counter[str]:
    """Count the words on whole groups of dives."""
    groups = (dives[first : first + size] for first in range(0, len(dives) - size + 1, size))
    return Counter(
        pooled_verdict_word(candidate, [dive.evidence.get(candidate, []) for dive in group]) for group in groups
    )


def exchanged_rate(dives: Sequence[JudgedDive], candidates: Sequence[Judged], size: int) -> str:
    """Say how often equal filters are better or worse, if they are exchanged at random in dives drawn at random."""
    rng, words = np.random.default_rng(SEA_SEED), Counter[str]()
    for judged in (it for it in candidates if _is("B")(it) and not it.is_copy):
        world, candidate = judged.name.rsplit(": ", 1)
        of_world = [dive for dive in dives if dive.words and WORLDS[dive.number].name == world]
        for _ in range(EXCHANGES):
            drawn = rng.choice(len(of_world), size, replace=False) if len(of_world) >= size else ()
            groups = [_exchanged(of_world[i].evidence[candidate], bool(rng.integers(2))) for i in drawn]
            words[pooled_verdict_word(candidate, groups)] += bool(groups)
    return _rate(words, frozenset({"better", "worse", "mixed"}))


def _exchanged(rows: Sequence[EvidenceRow], is_exchanged: bool) -> list[EvidenceRow]:
    """Let the candidate be the baseline."""
    return [
        msgspec.structs.replace(row, baseline=row.value, value=row.baseline, ratio=1.0 / row.ratio)
        if is_exchanged and row.ratio
        else row
        for row in rows
    ]


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
    Question("dead, said anything but *not evaluated*", "D", frozenset(WORDS) - {"not evaluated"}, "0", "0"),
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


def page(candidates: Sequence[Judged], dives: int, start: str, took_s: float, _: Sequence[JudgedDive] = ()) -> str:
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


class SeaQuestion(NamedTuple):
    """A row of the table of rates at sea: of which candidates, which words, and how often they may be."""

    asks: str
    of: Callable[[Judged], bool]
    words: Callable[[Judged], frozenset[str]]
    asked: tuple[str, str, str]
    """Of one dive, of three, of eight; empty where nothing is asked."""


def _is(kind: str) -> Callable[[Judged], bool]:
    return lambda it: it.kind.rstrip("?") == kind


def _wrong(it: Judged) -> frozenset[str]:
    """Give the words that contradict the truth: gain or loss of equal ones, else the opposite and likeness."""
    wrong = {"A": {"worse", "equivalent", "mixed"}, "B": {"better", "worse", "mixed"}}
    found = frozenset(wrong.get(it.kind.rstrip("?"), {"better", "equivalent", "mixed"}))
    return found if it.is_far or _is("B")(it) else found - {"equivalent"}


def _opposite(it: Judged) -> frozenset[str]:
    return frozenset({"worse" if _is("A")(it) else "better"})


SEA_QUESTIONS: Final = (
    SeaQuestion(
        "gains of 10 % or more, said better",
        lambda it: _is("A")(it) and it.is_far,
        lambda _: frozenset({"better"}),
        ("at least 45 %", "at least 35 %", "at least 90 %"),
    ),
    SeaQuestion(
        "losses of 10 % or more, said worse",
        lambda it: _is("C")(it) and it.is_far,
        lambda _: frozenset({"worse"}),
        ("", "", ""),
    ),
    SeaQuestion(
        "truly better or worse, said the opposite",
        lambda it: _is("A")(it) or _is("C")(it),
        _opposite,
        ("at most 1 %", "at most 0.5 %", "0"),
    ),
    SeaQuestion(
        "truly the same, said better or worse",
        _is("B"),
        lambda _: frozenset({"better", "worse", "mixed"}),
        ("at most 2 %", "", "0"),
    ),
    SeaQuestion("all, wrong words", lambda it: it.kind[0] in "ABC", _wrong, ("", "", "0")),
    SeaQuestion(
        "copies, said equivalent",
        lambda it: it.is_copy,
        lambda _: frozenset({"equivalent"}),
        ("at least 95 %", "at least 95 %", "at least 95 %"),
    ),
    SeaQuestion(
        "six that are the same, with an outage of 120 s, said better or worse",
        lambda it: "outage" in it.name,
        lambda _: frozenset({"better", "worse", "mixed"}),
        ("at most 4 of 48", "", "0"),
    ),
)


def sea_rates(candidates: Sequence[Judged]) -> list[str]:
    """Give the rows of the table of rates at sea."""
    rows = []
    for question in SEA_QUESTIONS:
        cells = []
        for count, asked in zip(("words", "of_few", "pooled"), question.asked, strict=True):
            words = [(getattr(it, count), question.words(it)) for it in candidates if question.of(it)]
            total = sum(counted.total() for counted, _ in words)
            said = sum(counted[word] for counted, some in words for word in some)
            cells += [f"{100.0 * said / total:.1f} % ({said} of {total})" if total else "-", asked]
        rows.append(f"| {question.asks} | {' | '.join(cells)} |")
    return rows


def sea_page(candidates: Sequence[Judged], dives: int, start: str, took_s: float, judged: Sequence[JudgedDive]) -> str:
    """Write the part of the page of results on the worlds at sea."""
    equal = " and ".join(f"{exchanged_rate(judged, candidates, size)} of {size} dives" for size in (FEW, POOLED))
    about = (
        f"{dives} dives in each world (a third as many of 2 h), replayed from their logs. No dive has the motion of "
        "another. IMUs have turn-on biases, Gauss-Markov biases, scale errors and misalignments; DVLs have correlated "
        "errors and lose the bottom; references are noisy. The filters are told presets. Truth is as in "
        f"*Judgement*, of these and {TRUTH_DIVES} more dives of each world: horizontal drift in 60 s, velocity, "
        "position and last position, and the depth, against the exact motion. A gain or a loss is of 10 % or more "
        "where one of them is at most 1/1.1 of the other filter's. A copy has the baseline's own settings. Three and "
        "eight dives are disjoint groups. Wrong words are "
        "gain or loss of equal filters, the opposite, *mixed*, and *equivalent* where 10 % are true. The classes are "
        f"those of filters that start {_START_IN_WORDS[start]}."
    )
    groups = ("one dive", "three dives", "eight dives")
    rates_of = [cell for group in groups for cell in (group, "asked")]
    said = [
        f"| {it.name.removeprefix('sea: ')} | {it.kind}{' 10 %' if it.is_far else ''} | {it.truths[start]} | "
        f"{' | '.join(_counts(count) for count in (it.words, it.of_few, it.pooled))} |"
        for it in candidates
    ]
    columns = ("world", "truth", "drift", "velocity", "position", "last position", "depth", *groups)
    return "\n".join(
        [
            *("# Judgement at sea", "", about, ""),
            *table(("", *rates_of), sea_rates(candidates)),
            *("", f"Equal filters, exchanged at random in groups of dives: {equal} are better or worse.", ""),
            *("b: better, e: equivalent, u: undecided, m: mixed, w: worse, n: not evaluated.", ""),
            *table(columns, said),
            *("", f"{machine()}; {took_s:.0f} s."),
        ]
    )


def _counts(words: Counter[str]) -> str:
    return " ".join(f"{words[word]} {word[0]}" for word in WORDS if words[word])


_START_IN_WORDS: Final = {
    "reference": "on the reference",
    "drawn": "as far off as they allow for",
}


def main() -> None:
    """Judge, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="in each world")
    parser.add_argument("--sea-dives", type=int, default=SEA_DIVES, help="in each world at sea; a third as many of 2 h")
    parser.add_argument("--worlds", nargs="+", default=[""], help="those whose names hold one of these texts")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--seed", type=int, default=SEA_SEED, help="of the worlds at sea")
    parser.add_argument(
        "--truth", choices=STARTS, default=STARTS[1], help="the start of the filters that say what is true"
    )
    arguments = parser.parse_args()
    for library in ("OPENBLAS", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # each process, which has yet to load numpy, has one core
    parts = (False, arguments.dives, DIVES, page), (True, arguments.sea_dives, SEA_DIVES, sea_page)
    for at_sea, dives, usual, write in parts:
        numbers = [
            i
            for i, world in enumerate(WORLDS)
            if bool(world.sea) == at_sea and any(part in world.name for part in arguments.worlds)
        ]
        if not numbers:
            continue
        begun_s = time.monotonic()
        tasks = [(i, dive, arguments.seed) for i in numbers for dive in _dives_of(WORLDS[i], dives)]
        judged = list(judged_dives(tasks, arguments.jobs))
        candidates = evaluated_candidates(judged, arguments.truth)
        part = write(candidates, dives, arguments.truth, time.monotonic() - begun_s, judged)
        if (dives, arguments.worlds, arguments.seed) in [
            (usual, all_worlds, SEA_SEED) for all_worlds in ([""], ["sea:"])
        ]:
            write_part(part)
        sys.stdout.write(f"{part}\n\n")


def _dives_of(world: World, dives: int) -> list[int]:
    """Number the dives of a world, a third of them where they are long; at sea also those that tell the truth alone."""
    share = 3 if world.sea and world.sea.duration_s > LONG_S else 1
    alone = range(TRUTH_ALONE, TRUTH_ALONE + TRUTH_DIVES, share) if world.sea else ()
    return [*range(dives // share), *alone]


if __name__ == "__main__":
    main()
