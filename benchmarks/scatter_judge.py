"""How often the verdict is right, wrong or undecided where two filters differ by constants that are drawn once a dive.

`python benchmarks/scatter_judge.py` writes the part of the page of results. Each dive of a world is written to a log
and replayed once, as a user's would be. Groups of 3, 5 and 8 dives are then drawn from them, and the tool says its word
on each group. What is true is told by `scatter_worlds`. `--keep FILE` stores what was found in each dive, and `--kept
FILE` judges it again without any replay.
"""

import math
import pickle
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from judged import (
    SIZES,
    Found,
    Record,
    classes_run_here,
    drawn_groups,
    level_of,
    log_ratio_of,
    over_dives,
    record_of,
    verdicts_over,
)
from results import finish, judging_parser, machine, table, worker_processes
from scatter_filters import Case, write_case
from scatter_worlds import (
    DURATION_S,
    FIVE,
    SEED,
    WORLDS,
    ScatterWorld,
    TrueErrors,
    dive_of,
    exchanged,
    reference_of,
    true_errors_of,
    true_ratios,
)
from true_errors import TrueRatio

from insdvl_replay.core.words import Verdict
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import replay_dive

DIVES: Final = 32
TRUTH_DIVES: Final = 60
"""So many more dives tell the truth of worlds in which it is not known beforehand."""
GROUPS: Final = 100
"""Groups of each size that are drawn from the dives of a world."""
MARGIN: Final = 1.05
LARGE: Final = 1.1
Outcome = Literal["right", "wrong", "mixed", "undecided"]
OUTCOMES: Final[tuple[Outcome, ...]] = ("right", "wrong", "mixed", "undecided")


@dataclass(frozen=True)
class JudgedDive:
    """What the tool keeps of one dive, by candidate, and the true errors by filter."""

    world: str
    number: int
    """Of what was drawn: where two filters are exchanged, two dives have the same number."""
    records: Mapping[str, Record]
    errors: Mapping[str, TrueErrors]
    replay_s: float
    """Processor seconds of the replay from its log."""
    is_exchanged: bool = False


class Task(NamedTuple):
    """One dive of a world; those that tell the truth alone are not replayed."""

    world: int
    number: int
    seed: int
    is_replayed: bool
    is_exchanged: bool = False


def judged_dive(task: Task) -> JudgedDive:
    """Make a dive, replay it, and measure what is true of it."""
    world = WORLDS[task.world]
    drawn = dive_of(world, task.number, task.seed)
    if task.is_exchanged:
        drawn = exchanged(drawn, world.candidates[0])
    errors = true_errors_of(world, drawn)
    if not task.is_replayed:
        return JudgedDive(world.name, task.number, {}, errors, 0.0)
    config = world.config_of(task.number)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / f"dive_{task.number}.mcap"
        write_dive(log, drawn.reported)
        write_case(folder, Case(config, dict(drawn.told)), reference_of(drawn.exact))
        begun_s = time.process_time()
        with classes_run_here():
            replay = replay_dive(read_checked_dive(log, config), config)
        took_s = time.process_time() - begun_s
    records = {candidate: record_of(replay, candidate) for candidate in world.candidates}
    return JudgedDive(world.name, task.number, records, errors, took_s, task.is_exchanged)


def judged_dives(tasks: Sequence[Task], jobs: int) -> Iterator[JudgedDive]:
    """Judge dives, in processes of their own where there is more than one job."""
    if jobs == 1:
        yield from map(judged_dive, tasks)
        return
    with worker_processes(jobs) as processes:
        yield from processes.map(judged_dive, tasks)


# --- Words held against the truth.


PLAIN: Final = {
    Verdict.BETTER: "better",
    Verdict.BETTER_WITHOUT_DVL: "better",
    Verdict.EQUIVALENT: "equivalent",
    Verdict.EQUIVALENT_WITHOUT_DVL: "equivalent",
    # A proof that the candidate does nearly nothing says that it is the same.
    Verdict.NO_EFFECT: "equivalent",
    Verdict.UNDECIDED: "undecided",
    Verdict.MIXED: "mixed",
    Verdict.WORSE_WITHOUT_DVL: "worse",
    Verdict.WORSE: "worse",
    Verdict.NOT_REPEATABLE: "undecided",
    Verdict.NOT_EVALUATED: "undecided",
}


def plain(word: str) -> str:
    """Reduce a word, which may carry its object as in *better without DVL*, to what it says of gain or loss."""
    return PLAIN[Verdict(word)]


class Truth(NamedTuple):
    """What is true of a pair: why it is known, and the least and the largest ratio of the quantity that counts."""

    kind: str
    low: float
    high: float

    @property
    def name(self) -> str:
        """Better, worse or the same, by a factor of 1.05; a question mark where the ensemble is not sure."""
        if self.kind == "no word":
            return "no word"
        if self.high <= 1.0 / MARGIN:
            return "better"
        if self.low >= MARGIN:
            return "worse"
        is_within = self.low > 1.0 / MARGIN and self.high < MARGIN
        return "same" if is_within else "?"


def truth_of(world: ScatterWorld, ratio: TrueRatio) -> Truth:
    """Give the truth of a pair; of filters that could be exchanged it is exactly 1, whatever the ensemble says."""
    if world.kind in ("equal", "copy"):
        return Truth(world.kind, 1.0, 1.0)
    return Truth(world.kind, ratio.low, ratio.high)


def outcome(word: str, truth: Truth) -> Outcome:
    """Hold a word against the truth.

    *Equivalent* is wrong where a difference of 10 % or more is true, and nothing where it is of 5 to 10 %. *Mixed* is
    wrong of filters that are the same. Where nobody can judge, every word is wrong.
    """
    said = plain(word)
    if said == "undecided":
        return "right" if truth.kind == "no word" else "undecided"
    if truth.kind == "no word":
        return "wrong"
    if said == "mixed":
        return "mixed" if truth.kind == "ensemble" else "wrong"
    if said == "better":
        return (
            "right"
            if truth.name == "better"
            else "undecided"
            if truth.low <= 1.0 / MARGIN
            else "wrong"
        )
    if said == "worse":
        return (
            "right" if truth.name == "worse" else "undecided" if truth.high >= MARGIN else "wrong"
        )
    if truth.name == "same":
        return "right"
    return "wrong" if truth.high <= 1.0 / LARGE or truth.low >= LARGE else "undecided"


def is_opposite(word: str, truth: Truth) -> bool:
    """Return whether a word has the wrong sign."""
    opposite = {"better": "worse", "worse": "better"}.get(truth.name)
    return plain(word) == opposite


# --- Groups of dives.


FLEET: Final = 4
"""Vehicles of a group, at most, where dives are of vehicles."""


def drawn_fleets(
    vehicles: Sequence[int], sides: Sequence[bool], size: int, groups: int, seed: int
) -> list[list[int]]:
    """Draw groups of rows of some vehicles; filters are exchanged on all dives of a vehicle, or on none."""
    fleet = min(size, FLEET)
    rng = np.random.default_rng((seed, size))
    rows_of = dict[tuple[int, bool], list[int]]()
    for row, (vehicle, side) in enumerate(zip(vehicles, sides, strict=True)):
        rows_of.setdefault((vehicle, side), []).append(row)
    most = -(-size // fleet)
    whole = [
        vehicle
        for vehicle in dict.fromkeys(vehicles)
        if all(len(rows_of.get((vehicle, side), [])) >= most for side in (False, True))
    ]
    if len(whole) < fleet:
        return []
    found = []
    for _ in range(groups):
        group = list[int]()
        for place, vehicle in enumerate(rng.choice(whole, fleet, replace=False).tolist()):
            rows = rows_of[vehicle, bool(rng.integers(2))]
            dives = size // fleet + (place < size % fleet)
            group += rng.choice(rows, dives, replace=False).tolist()
        found.append(group)
    return found


def groups_of(
    world: ScatterWorld, dives: Sequence[JudgedDive], size: int, groups: int, seed: int
) -> list[list[int]]:
    """Draw groups of the dives of a world, of which each is a row."""
    if not world.dives_of_vehicle:
        return drawn_groups([dive.number for dive in dives], size, groups, seed)
    vehicles = [world.vehicle_of(dive.number) for dive in dives]
    return drawn_fleets(vehicles, [dive.is_exchanged for dive in dives], size, groups, seed)


@dataclass(frozen=True)
class JudgedPair:
    """All that was said of one candidate in one world.

    Attributes
    ----------
    words : dict of int to Counter
        By the number of dives; of one dive the words of the dives themselves.
    primary : dict of int to list of Found
        The tool's interval of the quantity that counts, for each group.
    """

    world: ScatterWorld
    candidate: str
    truth: Truth
    ratios: Mapping[str, TrueRatio]
    reported: tuple[float, float]
    """Geometric mean and scatter of the quantity that counts, as the tool reports it."""
    words: dict[int, Counter[str]]
    by_group: dict[int, list[str]]
    primary: dict[int, list[Found]]

    def outcomes(self, size: int) -> Counter[str]:
        """Count the outcomes of groups of one size."""
        found = Counter[str]()
        for word, count in self.words[size].items():
            found[outcome(word, self.truth)] += count
        return found

    def opposite(self, size: int) -> int:
        """Count the words of the wrong sign."""
        return sum(
            count for word, count in self.words[size].items() if is_opposite(word, self.truth)
        )


def judged_pairs(
    world: ScatterWorld, dives: Sequence[JudgedDive], groups: int, seed: int
) -> list[JudgedPair]:
    """Say the tool's word on all candidates of a world, for drawn groups of its dives."""
    replayed = [dive for dive in dives if dive.records]
    drawn = {size: groups_of(world, replayed, size, groups, seed) for size in SIZES}
    said = {
        size: [_words_on(world, [replayed[row] for row in rows]) for rows in drawn[size]]
        for size in SIZES
    }
    return [
        _judged_pair(
            world,
            candidate,
            dives,
            drawn,
            {size: [words[candidate] for words in of_size] for size, of_size in said.items()},
        )
        for candidate in world.candidates
    ]


def _words_on(world: ScatterWorld, dives: Sequence[JudgedDive]) -> dict[str, str]:
    """Say the tool's words on all candidates, which share the error rate of one."""
    records = {
        candidate: [dive.records[candidate] for dive in dives] for candidate in world.candidates
    }
    settings = world.config.evaluation
    return verdicts_over(
        world.config.baseline, records, named=settings.candidate, primary=settings.primary
    )


def _judged_pair(
    world: ScatterWorld,
    candidate: str,
    dives: Sequence[JudgedDive],
    drawn: Mapping[int, list[list[int]]],
    by_group: dict[int, list[str]],
) -> JudgedPair:
    ratios = true_ratios([dict(dive.errors) for dive in dives], world.config.baseline, candidate)
    records = [dive.records[candidate] for dive in dives if dive.records]
    logs = np.array([log_ratio_of(record, world.primary) for record in records])
    named = world.config.evaluation.candidate
    level = level_of(len(world.candidates), named=bool(named), is_named=candidate == named)
    primary = dict[int, list[Found]]()
    for size, groups in drawn.items():
        known = [rows for rows in groups if np.isfinite(logs[rows]).all()]
        primary[size] = [
            over_dives(
                logs[rows].tolist(),
                level=level,
                vehicles=[records[row].vehicle for row in rows],
                always=False,
            )
            for rows in known
        ]
    words = {size: Counter(of_size) for size, of_size in by_group.items()}
    words[1] = Counter(record.word for record in records)
    finite = logs[np.isfinite(logs)]
    reported = (
        (math.exp(finite.mean()), float(finite.std(ddof=1)))
        if len(finite) > 1
        else (math.nan, math.nan)
    )
    truth = truth_of(world, ratios[world.primary])
    return JudgedPair(world, candidate, truth, ratios, reported, words, by_group, primary)


# --- The page.


class Question(NamedTuple):
    """A row of the table of rates: of which worlds, which part of the words, and how large it may be or must be."""

    asks: str
    names: tuple[str, ...]
    """Beginnings of the names of worlds; a dollar sign stands for the end."""
    part: str
    asked: tuple[float, float, float] | None = None
    """In percent, with 3, 5 and 8 dives."""
    is_least: bool = False
    candidates: tuple[str, ...] = ()
    """Of several the ones that are meant; empty for all."""


EQUAL: Final = (
    "two compasses",
    "two mountings",
    "two IMUs",
    "equal on average",
    "late: two compasses",
)
CHANGED: Final = ("errors times", "a mounting", "baseline's R")
FIVE_PCT = (5.0,) * 3
ONE_PCT = (1.0,) * 3
NONE = (0.0,) * 3
ALL = (100.0,) * 3


def _equal(scatter: str) -> Question:
    names = tuple(f"{kind}, s {scatter}" for kind in EQUAL[:3])
    return Question(f"equal pairs, s {scatter}, a word", names, "wrong", FIVE_PCT)


QUESTIONS: Final = (
    _equal("0.1"),
    _equal("0.2"),
    _equal("0.5"),
    Question("equal pairs, all, a word", EQUAL, "wrong", FIVE_PCT),
    Question(
        "five at once, none differs, any has a word", ("five compasses",), "any wrong", FIVE_PCT
    ),
    Question("vehicles that differ, a word", ("vehicles",), "wrong", FIVE_PCT),
    Question(
        "five at once, the named one is 0.8, s 0.1, found",
        ("five at once",),
        "right",
        (35.0, 80.0, 97.0),
        is_least=True,
        candidates=FIVE[:1],
    ),
    Question(
        "five at once, one is named, any other has a word",
        ("five at once",),
        "any wrong",
        FIVE_PCT,
        candidates=FIVE[1:],
    ),
    Question(
        "errors times 0.8, s 0.1, found",
        ("errors times 0.8, s 0.1",),
        "right",
        (35.0, 80.0, 97.0),
        True,
    ),
    Question(
        "errors times 0.8, s 0.2, found",
        ("errors times 0.8, s 0.2",),
        "right",
        (13.0, 30.0, 54.0),
        True,
    ),
    Question("true changes, all, found", CHANGED, "right"),
    Question("true changes, all, opposite sign", CHANGED, "opposite", ONE_PCT),
    Question("start headings, opposite sign", ("a compass",), "opposite", ONE_PCT),
    Question("late references, wrong", ("late: R",), "wrong", FIVE_PCT),
    Question("copies, a word", ("a copy",), "wrong", NONE),
    Question("copies, said to be the same", ("a copy",), "right", ALL, True),
    Question("baseline 800 times too large, a word", ("baseline's noise",), "wrong", NONE),
    Question("another answer each time, a word", ("another answer",), "wrong", NONE),
)
ALLOWED_ERRORS: Final = 3.0


def of_question(question: Question, pairs: Sequence[JudgedPair]) -> list[JudgedPair]:
    """Choose the pairs that a question is about."""
    return [
        pair
        for pair in pairs
        if pair.world.name.startswith(question.names)
        and pair.candidate in (question.candidates or (pair.candidate,))
    ]


def counted(question: Question, pairs: Sequence[JudgedPair], size: int) -> tuple[int, int]:
    """Count the groups of one size that are as a question asks, and all of them."""
    if question.part == "any wrong":
        together = zip(*(pair.by_group[size] for pair in pairs), strict=True)
        rows = [
            any(
                outcome(word, pair.truth) == "wrong"
                for word, pair in zip(words, pairs, strict=True)
            )
            for words in together
        ]
        return sum(rows), len(rows)
    total = sum(pair.words[size].total() for pair in pairs)
    if question.part == "opposite":
        return sum(pair.opposite(size) for pair in pairs), total
    return sum(pair.outcomes(size)[question.part] for pair in pairs), total


def is_met(question: Question, pct: float, asked: float, independent: float) -> bool:
    """Return whether a rate is as asked, but for the chance of so many independent groups."""
    share = min(max(asked / 100.0, 0.0), 1.0)
    error_pct = 100.0 * math.sqrt(share * (1.0 - share) / independent)
    if question.is_least:
        return pct >= asked - ALLOWED_ERRORS * error_pct
    return pct <= asked + ALLOWED_ERRORS * error_pct


def rate_rows(pairs: Sequence[JudgedPair], dives: int) -> tuple[list[str], bool]:
    """Give the rows of the table of rates, and whether all are as asked."""
    rows = list[str]()
    all_met = True
    for question in QUESTIONS:
        chosen = of_question(question, pairs)
        cells = list[str]()
        worlds = len({pair.world.name for pair in chosen})
        for size, asked in zip(SIZES, question.asked or (None,) * len(SIZES), strict=True):
            said, total = counted(question, chosen, size) if chosen else (0, 0)
            if not total:
                cells += ["-", ""]
                continue
            pct = 100.0 * said / total
            met = asked is None or is_met(question, pct, asked, worlds * dives / size)
            all_met &= met
            limit = (
                ""
                if asked is None
                else f"{'at least' if question.is_least else 'at most'} {asked:g}"
            )
            cells += [f"{pct:.1f}{'' if met else ' *'}", limit]
        rows.append(f"| {question.asks} | {' | '.join(cells)} |")
    return rows, all_met


def shares(counts: Counter[str]) -> str:
    """Write outcomes in percent of all: right, wrong, mixed, undecided."""
    total = counts.total()
    if not total:
        return "-"
    return " / ".join(f"{100.0 * counts[name] / total:.0f}" for name in OUTCOMES)


def missed_pct(pair: JudgedPair, size: int) -> str:
    """Say how many intervals of the quantity that counts do not hold the truth."""
    known = pair.primary[size]
    if not known or pair.truth.kind == "no word":
        return ""
    value = 1.0 if pair.truth.kind in ("equal", "copy") else pair.ratios[pair.world.primary].value
    off = sum(not found.low - 1e-6 <= value <= found.high + 1e-6 for found in known)
    return f"{100.0 * off / len(known):.0f}"


def spoken_alone(pair: JudgedPair) -> int:
    """Count the single dives that have a word of gain or loss."""
    return sum(
        count
        for word, count in pair.words[1].items()
        if plain(word) in ("better", "worse", "mixed")
    )


def one_dive_words(pairs: Sequence[JudgedPair]) -> tuple[int, int]:
    """Count single dives of equal pairs: those with a word of gain or loss, and all."""
    equal = [pair for pair in pairs if pair.world.kind == "equal"]
    return sum(spoken_alone(pair) for pair in equal), sum(pair.words[1].total() for pair in equal)


def world_row(pair: JudgedPair) -> str:
    """Write the row of one candidate in one world."""
    several = len(pair.world.candidates) > 1
    name = f"{pair.world.name}: {pair.candidate}" if several else pair.world.name
    mean, scatter = pair.reported
    one_dive = f"{100.0 * spoken_alone(pair) / max(pair.words[1].total(), 1):.0f}"
    cells = [shares(pair.outcomes(size)) for size in SIZES]
    missed = " / ".join(missed_pct(pair, size) or "-" for size in SIZES)
    true = pair.ratios[pair.world.primary]
    return (
        f"| {name} | {pair.truth.name} | {pair.world.primary} | {true} | {mean:.3f}, s {scatter:.2f} | {one_dive} | "
        f"{' | '.join(cells)} | {missed} |"
    )


def truth_row(pair: JudgedPair) -> str:
    """Write the true ratios of all quantities."""
    several = len(pair.world.candidates) > 1
    name = f"{pair.world.name}: {pair.candidate}" if several else pair.world.name
    cells = [
        f"{pair.ratios[quantity].value:.3f}, s {pair.ratios[quantity].scatter:.2f}"
        for quantity in TrueErrors._fields
    ]
    return f"| {name} | {' | '.join(cells)} |"


ABOUT: Final = (
    "Two filters with two compasses, mountings or IMUs of the same kind are equal, since they could be exchanged, and "
    "every other dive is the one before with both exchanged, so that none is better in these dives. No group has both. "
    "The truth of other pairs is the geometric mean of the ratios of their dives, and of more that are not replayed, "
    "against the exact motion and from the start that the dive has. A star marks what is not as asked."
)
OF_WORLDS: Final = (
    "Truth, its value with the interval of 95 %, and the scatter s of the log ratio from dive to dive; the mean and "
    "scatter that the tool reports; dives that have a word by themselves, in percent. Then right / wrong / mixed / "
    "undecided in percent of the groups, and intervals of the quantity that do not hold the truth with 3 / 5 / 8 "
    "dives, in percent."
)
COLUMNS: Final = (
    *("world", "truth", "by", "true ratio", "reported", "one dive"),
    *(f"{size} dives" for size in SIZES),
    "missed",
)


def page(
    pairs: Sequence[JudgedPair], dives: Sequence[JudgedDive], took_s: float, groups: int
) -> tuple[str, bool]:
    """Write the part of the page of results; and say whether all rates are as asked."""
    replayed = [dive for dive in dives if dive.records]
    each = max(Counter(dive.world for dive in replayed).values())
    rates, all_met = rate_rows(pairs, each)
    took_each_s = float(np.mean([dive.replay_s for dive in replayed]))
    about = (
        f"{each} dives of {DURATION_S:g} s in each world, replayed from their logs in {took_each_s:.2f} s of processor "
        f"time each. {groups} groups of 3, 5 and 8 dives are drawn from them. {ABOUT}"
    )
    spoken, said = one_dive_words(pairs)
    one_dive = (
        f"Single dives of equal pairs that have a word of gain or loss: {spoken} of {said} (asked: none). One dive "
        "cannot tell what the next one will show."
    )
    all_met &= spoken == 0
    lines = [
        *("# Judgement: dives that scatter", "", about, ""),
        *table(("", *(cell for size in SIZES for cell in (f"{size} dives [%]", "asked"))), rates),
        *("", one_dive, "", OF_WORLDS, ""),
        *table(COLUMNS, [world_row(pair) for pair in pairs]),
        *("", "What is true of all quantities: geometric mean and scatter.", ""),
        *table(("world", *TrueErrors._fields), [truth_row(pair) for pair in pairs]),
        *("", f"{machine()}; {took_s:.0f} s."),
    ]
    return "\n".join(lines), all_met


def tasks_of(worlds: Sequence[int], dives: int, truth_dives: int, seed: int) -> list[Task]:
    """Name all dives."""
    found = list[Task]()
    for world in worlds:
        if WORLDS[world].can_be_exchanged:
            found += [
                Task(world, row // 2, seed, True, is_exchanged=row % 2 == 1)
                for row in range(dives)
            ]
        else:
            found += [Task(world, number, seed, True) for number in range(dives)]
        if WORLDS[world].kind == "ensemble":
            found += [Task(world, dives + number, seed, False) for number in range(truth_dives)]
    return found


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as asked."""
    parser = judging_parser(__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="in each world")
    parser.add_argument(
        "--truth-dives", type=int, default=TRUTH_DIVES, help="more, that are not replayed"
    )
    parser.add_argument("--groups", type=int, default=GROUPS)
    parser.add_argument(
        "--worlds", nargs="+", default=[""], help="those whose names hold one of these texts"
    )
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--keep", type=Path, help="store what was found in each dive")
    parser.add_argument("--kept", type=Path, help="judge what was stored, without replays")
    given = parser.parse_args()
    begun_s = time.monotonic()
    chosen = [
        row for row, world in enumerate(WORLDS) if any(part in world.name for part in given.worlds)
    ]
    if given.kept:
        dives = pickle.loads(given.kept.read_bytes())
    else:
        dives = list(
            judged_dives(tasks_of(chosen, given.dives, given.truth_dives, given.seed), given.jobs)
        )
    if given.keep:
        given.keep.write_bytes(pickle.dumps(dives))
    pairs = list[JudgedPair]()
    for row in chosen:
        of_world = [dive for dive in dives if dive.world == WORLDS[row].name]
        if of_world:
            pairs += judged_pairs(WORLDS[row], of_world, given.groups, given.seed)
    part, all_met = page(pairs, dives, time.monotonic() - begun_s, given.groups)
    finish(part, is_whole=given.worlds == [""] and not given.print, all_met=all_met)


if __name__ == "__main__":
    main()
