"""How often the verdict over several dives is right: its words on simulated dives beside the truth.

`make judge` runs this. Every dive is written to a log and replayed as a user's would be. Groups of 3, 5 and 8 dives are
drawn, and the tool says its word on each. The truth is the geometric mean of the ratios of the position errors against
the exact motion, over these dives and more of the same world, from the start that each dive has.
"""

import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from judged import REFUSED, SIZES, Record, drawn_groups, record_of, verdicts_over, word_counts
from results import finish, judging_parser, machine, table, worker_processes
from scatter_judge import Truth, is_opposite, outcome, plain
from true_errors import (
    MeanSquares,
    Soundness,
    TrueRatio,
    mean_squares,
    soundness,
    true_ratios,
)
from worlds import DURATION_S, SCENARIO, SEA_SEED, WORLDS, World, dive_seed, made_dive

from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.reference_errors import reference_errors
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import prepare_dive, read_checked_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one

DIVES: Final = 12
TRUTH_DIVES: Final = 36
"""So many more dives in each world tell what is true and are not replayed."""
GROUPS: Final = 60
LONG_S: Final = 3600.0
LONG_SHARE: Final = 2
"""Of worlds whose dives are long, one dive in so many is made."""
DEAD_DIVES: Final = 8
"""Dives of a world in which nobody can say anything; one group of the largest size is enough."""
PRIMARY: Final = "position_m2"
LARGE: Final = 1.1


@dataclass(frozen=True)
class JudgedDive:
    """What the tool keeps of a dive, and what is true of it.

    Attributes
    ----------
    world : int
        Its number.
    records : mapping of str to Record
        By candidate; empty of dives that tell the truth alone.
    errors : mapping of str to MeanSquares
        By filter; empty where the tool refused the log, which is as good as not to judge it.
    """

    world: int
    number: int
    records: Mapping[str, Record]
    errors: Mapping[str, MeanSquares]
    soundness: Soundness | None


class Task(NamedTuple):
    """One dive of a world; those that tell the truth alone are not replayed."""

    world: int
    number: int
    sea_seed: int
    is_replayed: bool


def judged_dive(task: Task) -> JudgedDive:
    """Simulate and replay one dive, and measure what is true of it."""
    world = WORLDS[task.world]
    reported, exact = made_dive(task.world, dive_seed(task.world, task.number, task.sea_seed))
    if not task.is_replayed:
        errors = true_errors_of(histories_of(world, reported), exact)
        return JudgedDive(task.world, task.number, {}, errors, None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, reported)
        try:
            replay = replay_dive(read_checked_dive(path, world.config), world.config)
        except LogError:
            return JudgedDive(
                task.world, task.number, dict.fromkeys(world.candidates, REFUSED), {}, None
            )
    return JudgedDive(
        task.world,
        task.number,
        {name: record_of(replay, name) for name in world.candidates},
        true_errors_of(replay.histories, exact),
        soundness(replay.histories, replay.errors),
    )


def histories_of(world: World, dive: Dive) -> list[History]:
    """Run all filters from the start that a dive has."""
    prepared = prepare_dive(dive, world.config)
    timeline = prepared_timeline(dive, prepared)
    return [run_one(filter_, prepared, timeline) for filter_ in prepared.filters]


def true_errors_of(histories: Sequence[History], exact: Dive) -> dict[str, MeanSquares]:
    """Measure what filters are off by against the exact motion, however noisy the reference in the log is."""
    if exact.reference is None:
        raise ValueError("a simulated dive has a reference")
    return {
        history.filter: mean_squares(reference_errors(history, exact.reference))
        for history in histories
    }


def judged_dives(tasks: Sequence[Task], jobs: int) -> Iterator[JudgedDive]:
    """Judge dives, in processes of their own where there is more than one job."""
    if jobs == 1:
        yield from map(judged_dive, tasks)
        return
    with worker_processes(jobs) as processes:
        yield from processes.map(judged_dive, tasks)


# --- Words on groups of dives.


@dataclass(frozen=True)
class Judged:
    """All that was said of one candidate in one world.

    Attributes
    ----------
    truth : Truth
        By the position.
    ratios : mapping of str to TrueRatio
        By the fields of `MeanSquares`; empty where no log could be replayed.
    words : mapping of int to Counter
        By the number of dives of a group.
    dives : int
        Dives from which the groups are drawn.
    """

    name: str
    truth: Truth
    ratios: Mapping[str, TrueRatio]
    words: Mapping[int, Counter[str]]
    soundness: str
    dives: int
    is_copy: bool = False

    @property
    def kind(self) -> str:
        """Name the truth, and where it is a gain or loss of 10 % or more, say so."""
        is_far = self.truth.high <= 1.0 / LARGE or self.truth.low >= LARGE
        return (
            f"{self.truth.name} 10 %"
            if is_far and self.truth.kind != "no word"
            else self.truth.name
        )


def judged_candidates(
    number: int, dives: Sequence[JudgedDive], groups: int, seed: int
) -> list[Judged]:
    """Say the tool's words on all candidates of a world, for drawn groups of its dives."""
    world = WORLDS[number]
    replayed = [dive for dive in dives if dive.records]
    known = [dive.errors for dive in dives if dive.errors]
    words = {size: _words_on_groups(world, replayed, size, groups, seed) for size in SIZES}
    found = []
    for candidate in world.candidates:
        is_copy = candidate.startswith("copy")
        ratios = true_ratios(known, world.config.baseline, candidate) if len(known) > 1 else {}
        found.append(
            Judged(
                name=world.name if len(world.candidates) == 1 else f"{world.name}: {candidate}",
                truth=truth_of(world, ratios, is_copy=is_copy),
                ratios=ratios,
                words={
                    size: Counter(said[candidate] for said in of_size)
                    for size, of_size in words.items()
                },
                soundness=_median_soundness(replayed),
                dives=len(replayed),
                is_copy=is_copy,
            )
        )
    return found


def truth_of(world: World, ratios: Mapping[str, TrueRatio], *, is_copy: bool) -> Truth:
    """Give the truth of a candidate: what the ensemble tells of the position, but of copies and dead worlds."""
    if world.dead:
        return Truth("no word", math.nan, math.nan)
    if is_copy:
        return Truth("copy", 1.0, 1.0)
    return Truth("ensemble", ratios[PRIMARY].low, ratios[PRIMARY].high)


def _words_on_groups(
    world: World, dives: Sequence[JudgedDive], size: int, groups: int, seed: int
) -> list[dict[str, str]]:
    drawn = drawn_groups([dive.number for dive in dives], size, groups, seed)
    found = []
    for rows in drawn:
        records = {name: [dives[row].records[name] for row in rows] for name in world.candidates}
        found.append(verdicts_over(world.config.baseline, records))
    return found


def _median_soundness(dives: Sequence[JudgedDive]) -> str:
    known = [dive.soundness for dive in dives if dive.soundness is not None]
    if not known:
        return "refused | refused | refused"
    return " | ".join(f"{median(values):.3g}" for values in zip(*known, strict=True))


# --- The page.


class Question(NamedTuple):
    """A row of the table of rates: of which candidates, which words, and how often they may be or must be."""

    asks: str
    of: Callable[[Judged], bool]
    is_meant: Callable[[str, Truth], bool]
    at_most_pct: float | None = None


def _is_evaluated(word: str, _: Truth) -> bool:
    return word != Verdict.NOT_EVALUATED


def _has_effect(word: str, _: Truth) -> bool:
    return word != Verdict.NO_EFFECT


def _is_wrong(word: str, truth: Truth) -> bool:
    return outcome(word, truth) == "wrong"


def _is_gain(word: str, _: Truth) -> bool:
    return plain(word) == "better"


def _is_loss(word: str, _: Truth) -> bool:
    return plain(word) == "worse"


def _is_decided(word: str, _: Truth) -> bool:
    return plain(word) in ("better", "worse", "mixed")


def _is_of(*kinds: str) -> Callable[[Judged], bool]:
    return lambda judged: judged.kind in kinds and not judged.is_copy


QUESTIONS: Final = (
    Question(
        "dead or unfit, said anything but *not evaluated*", _is_of("no word"), _is_evaluated, 0.0
    ),
    Question(
        "copies, said anything but *no effect*", lambda judged: judged.is_copy, _has_effect, 0.0
    ),
    Question("the same, said better, worse or mixed", _is_of("same"), _is_decided, 5.0),
    Question("better by 10 % or more, said better", _is_of("better 10 %"), _is_gain),
    Question("worse by 10 % or more, said worse", _is_of("worse 10 %"), _is_loss),
    Question(
        "better or worse, said the opposite",
        _is_of("better", "worse", "better 10 %", "worse 10 %"),
        is_opposite,
        1.0,
    ),
    Question("all, wrong words", lambda _: True, _is_wrong, 5.0),
)
ALLOWED_ERRORS: Final = 3.0


def rates(candidates: Sequence[Judged]) -> tuple[list[str], bool]:
    """Give the rows of the table of rates, and whether all are as asked, but for the chance of so few dives."""
    rows = list[str]()
    all_met = True
    for question in QUESTIONS:
        chosen = [judged for judged in candidates if question.of(judged)]
        cells = list[str]()
        for size in SIZES:
            said, total = counted(question, chosen, size)
            if not total:
                cells.append("-")
                continue
            pct = 100.0 * said / total
            met = question.at_most_pct is None or is_at_most(
                pct, question.at_most_pct, chosen, size
            )
            all_met &= met
            cells.append(f"{pct:.1f} ({said} of {total}){'' if met else ' *'}")
        asked = "" if question.at_most_pct is None else f"at most {question.at_most_pct:g}"
        rows.append(f"| {question.asks} | {len(chosen)} | {' | '.join(cells)} | {asked} |")
    return rows, all_met


def counted(question: Question, candidates: Sequence[Judged], size: int) -> tuple[int, int]:
    """Count the groups of one size on which a word is as a question asks, and all groups."""
    said = total = 0
    for judged in candidates:
        for word, count in judged.words[size].items():
            said += count * question.is_meant(word, judged.truth)
            total += count
    return said, total


def is_at_most(pct: float, asked_pct: float, candidates: Sequence[Judged], size: int) -> bool:
    """Return whether a rate is as asked, but for the chance of so many groups that have no dive in common."""
    independent = sum(judged.dives for judged in candidates) / size
    share = asked_pct / 100.0
    return pct <= asked_pct + ALLOWED_ERRORS * 100.0 * math.sqrt(
        share * (1.0 - share) / independent
    )


def page(candidates: Sequence[Judged], dives: int, groups: int, took_s: float) -> tuple[str, bool]:
    """Write the part of the page of results, and say whether all rates are as asked."""
    found, all_met = rates(candidates)
    about = (
        f"{dives} dives in each world, replayed from their logs: a {SCENARIO} of {DURATION_S:g} s with errors drawn "
        "anew, or dives at sea, of which none has the motion of another. At sea IMUs have turn-on biases, Gauss-Markov "
        "biases, scale errors and misalignments, DVLs have correlated errors and lose the bottom, references are "
        f"noisy, and filters are told presets. {groups} groups of 3, 5 and 8 dives are drawn from them. The truth is "
        "the geometric mean of the ratio of the position errors, of these dives and of more that are not replayed, "
        "against the exact motion and from the start that the dive has: better or worse by 5 % or more, the same, or "
        "a question mark where the interval of the ensemble is not sure. Where filters are dead or set wrong, or the "
        "baseline's noise is far off, nobody can say anything. A copy has the baseline's own settings. Wrong words are "
        "gain or loss of equal ones, the opposite, and *equivalent* where 10 % are true."
    )
    words = [
        f"| {it.name} | {it.kind} | {' | '.join(word_counts(it.words[size]) for size in SIZES)} |"
        for it in candidates
    ]
    facts_about = (
        "True ratios of position, drift in 60 s and velocity, each with its interval of 95 % and the scatter s of the "
        "logarithm from dive to dive. Then, in the median of the dives, the pings that the worst filter rejects, its "
        "NIS, 1 expected, and its horizontal position error in percent of the distance."
    )
    quantities = (PRIMARY, "drift_m2", "velocity_m2ps2")
    facts = [
        f"| {it.name} | {' | '.join(str(it.ratios.get(quantity, '-')) for quantity in quantities)} | {it.soundness} |"
        for it in candidates
    ]
    sizes = tuple(f"{size} dives" for size in SIZES)
    lines = [
        *("# Judgement", "", about, ""),
        *table(("", "candidates", *(f"{size} [%]" for size in sizes), "asked [%]"), found),
        *("", "How often each word was said, in percent of the groups:", ""),
        *table(("world", "truth", *sizes), words),
        *("", facts_about, ""),
        *table(
            ("world", "position", "drift", "velocity", "rejected [%]", "NIS / dof", "error [%]"),
            facts,
        ),
        *("", f"{machine()}; {took_s:.0f} s."),
    ]
    return "\n".join(lines), all_met


def tasks_of(number: int, dives: int, truth_dives: int, sea_seed: int) -> list[Task]:
    """Name the dives of a world; fewer where they are long, and where nothing can be said."""
    world = WORLDS[number]
    if world.dead:
        return [Task(number, dive, sea_seed, True) for dive in range(min(dives, DEAD_DIVES))]
    share = LONG_SHARE if world.sea and world.sea.duration_s > LONG_S else 1
    replayed = dives // share
    alone = truth_dives // share
    return [Task(number, dive, sea_seed, dive < replayed) for dive in range(replayed + alone)]


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as asked."""
    parser = judging_parser(__doc__)
    parser.add_argument(
        "--dives", type=int, default=DIVES, help="in each world; half as many of 2 h"
    )
    parser.add_argument(
        "--truth-dives", type=int, default=TRUTH_DIVES, help="more, that are not replayed"
    )
    parser.add_argument("--groups", type=int, default=GROUPS)
    parser.add_argument(
        "--worlds", nargs="+", default=[""], help="those whose names hold one of these texts"
    )
    parser.add_argument("--seed", type=int, default=SEA_SEED, help="of the worlds at sea")
    given = parser.parse_args()
    # Each process, which has yet to load numpy, has one core.
    begun_s = time.monotonic()
    chosen = [
        i for i, world in enumerate(WORLDS) if any(part in world.name for part in given.worlds)
    ]
    tasks = [
        task for i in chosen for task in tasks_of(i, given.dives, given.truth_dives, given.seed)
    ]
    dives = list(judged_dives(tasks, given.jobs))
    candidates = list[Judged]()
    for i in chosen:
        candidates += judged_candidates(
            i, [dive for dive in dives if dive.world == i], given.groups, given.seed
        )
    part, all_met = page(candidates, given.dives, given.groups, time.monotonic() - begun_s)
    finish(part, is_whole=given.worlds == [""] and not given.print, all_met=all_met)


if __name__ == "__main__":
    main()
