"""How often one interval over dives gives a right word, a wrong one or none, where every log ratio is drawn.

`python benchmarks/rule_worlds.py` writes the part of the page of results. No dive is simulated here: a dive is one
number, the logarithm of a ratio, so that thousands of archives take seconds. The worlds are equal pairs and true
changes that scatter, normally or strongly skewed; vehicles that differ; archives that grow and are looked at after
every dive; and several candidates at once. What the tool makes of the numbers it says itself, through `judged`.
"""

import math
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from judged import level_of, over_dives
from results import finish, judging_parser, machine, table, worker_processes

from insdvl_replay.core.dive_columns import Floats

SEED: Final = 41_000_000
REPEATS: Final = 1500
LOOKED: Final = 500
"""Archives that are looked at after every dive."""
MARGIN: Final = math.log(1.05)
SCATTERS: Final = (0.05, 0.1, 0.2, 0.5)
DIVES: Final = (3, 4, 5, 8)
CHANGES: Final = (0.9, 0.8, 0.67)
MOST_LOOKS: Final = 200
BY_DIVES: Final = (8, 13, 20)
DECIDED: Final = ("better", "worse", "mixed")
ALLOWED_ERRORS: Final = 3.0
"""A rate breaks what is asked if it is off by more than so many standard errors."""


# --- How a log ratio scatters from dive to dive: mean 0, standard deviation 1.


def normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Draw from a normal distribution."""
    return rng.standard_normal(shape)


def exponential(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Draw from an exponential distribution, moved to mean 0: most dives are a little below, some are far above."""
    return rng.exponential(1.0, shape) - 1.0


def lognormal(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Draw from a lognormal distribution, moved and scaled: a skewness of 2.3, with a longer tail."""
    sigma = 0.6
    mean = math.exp(0.5 * sigma**2)
    sd = mean * math.sqrt(math.exp(sigma**2) - 1.0)
    return (np.exp(sigma * rng.standard_normal(shape)) - mean) / sd


SHAPES: Final[dict[str, Callable[[np.random.Generator, tuple[int, ...]], Floats]]] = {
    "normal": normal,
    "exponential": exponential,
    "lognormal": lognormal,
}


# --- What is counted.


class Tally(NamedTuple):
    """Words on archives whose truth is known."""

    archives: int
    better: int
    worse: int
    equivalent: int
    wrong: int
    """Words that the truth contradicts, see `contradicts`."""
    opposite: int
    """Better where the candidate is truly worse, by however little, or the other way round."""
    missed: int
    """Intervals that do not hold the truth."""

    def share(self, count: int) -> float:
        """Give a part of the archives in percent."""
        return 100.0 * count / self.archives


def contradicts(word: str, log_truth: float) -> bool:
    """Return whether a word is false: gain or loss of a change within the margin, or the same of one beyond it."""
    # A truth on the edge of the margin is within it.
    edge = MARGIN * (1.0 - 1e-9)
    if word == "better":
        return log_truth > -MARGIN * (1.0 + 1e-9)
    if word == "worse":
        return log_truth < MARGIN * (1.0 + 1e-9)
    return word == "equivalent" and abs(log_truth) > edge


def is_opposite(word: str, log_truth: float) -> bool:
    """Return whether a word has the wrong sign; nothing has a sign where the truth is 1."""
    return (word == "better" and log_truth > 0.0) or (word == "worse" and log_truth < 0.0)


def tally(
    logs: Floats,
    log_truths: Floats,
    *,
    level: float = 0.95,
    vehicles: Sequence[str] | None = None,
) -> Tally:
    """Ask for the word on each archive.

    Parameters
    ----------
    logs : ndarray, shape (archives, dives)
    log_truths : ndarray, shape (archives,)
    """
    counts = dict.fromkeys(Tally._fields, 0)
    for dives, log_truth in zip(logs.tolist(), log_truths.tolist(), strict=True):
        found = over_dives(dives, level=level, vehicles=vehicles, always=False)
        if found.word in counts:
            counts[found.word] += 1
        counts["wrong"] += contradicts(found.word, log_truth)
        counts["opposite"] += is_opposite(found.word, log_truth)
        counts["missed"] += not found.low <= math.exp(log_truth) <= found.high
    return Tally(**{**counts, "archives": len(logs)})


def generator(*names: object) -> np.random.Generator:
    """Make the generator of one cell of a table, which no other cell changes."""
    return np.random.default_rng((SEED, zlib.crc32(repr(names).encode())))


# --- Equal pairs and true changes.


def pairs(shape: str, scatter: float, dives: int, ratio: float, repeats: int = REPEATS) -> Tally:
    """Judge archives of some dives of one vehicle."""
    rng = generator("pairs", shape, scatter, dives, ratio)
    log_truth = math.log(ratio)
    logs = log_truth + scatter * SHAPES[shape](rng, (repeats, dives))
    return tally(logs, np.full(repeats, log_truth))


class Row(NamedTuple):
    """A row of a table, and whether it is as it must be."""

    text: str
    is_met: bool = True


def at_most(tallied: Tally, count: int, asked_pct: float) -> bool:
    """Return whether a part is no larger than asked, but for the chance of so many archives."""
    error = 100.0 * math.sqrt(max(asked_pct, 0.05) / 100.0 / tallied.archives)
    return tallied.share(count) <= asked_pct + ALLOWED_ERRORS * error


def at_least(tallied: Tally, count: int, asked_pct: float) -> bool:
    """Return whether a part is no smaller than asked, but for the chance of so many archives."""
    share = asked_pct / 100.0
    error = 100.0 * math.sqrt(share * (1.0 - share) / tallied.archives)
    return tallied.share(count) >= asked_pct - ALLOWED_ERRORS * error


MOST_WRONG_PCT: Final = {"normal": 5.0, "lognormal": 8.0}
"""Of equal pairs. Nothing is asked of the exponential distribution, which shows what an even stronger skew does."""
MOST_OPPOSITE_PCT: Final = 1.0
OPPOSITE_RATIOS: Final = (0.8, 1.25)
LEAST_FOUND_PCT: Final = {
    0.1: {3: 35.0, 4: 60.0, 5: 80.0, 8: 97.0},
    0.2: {3: 13.0, 4: 21.0, 5: 30.0, 8: 54.0},
}
"""Of a true change of 20 % that scatters normally, by scatter and dives."""


def pairs_row(shape: str, scatter: float, dives: int, repeats: int) -> Row:
    """Judge equal pairs and true changes with one scatter and one number of dives."""
    equal, near = (pairs(shape, scatter, dives, ratio, repeats) for ratio in (1.0, 1.03))
    changed = {ratio: pairs(shape, scatter, dives, ratio, repeats) for ratio in (*CHANGES, 1.25)}
    opposite = max((changed[ratio] for ratio in OPPOSITE_RATIOS), key=lambda found: found.opposite)
    wanted_pct = 0.0
    most_wrong_pct = MOST_WRONG_PCT.get(shape)
    is_met = True
    if most_wrong_pct is not None:
        is_met &= at_most(equal, equal.wrong, most_wrong_pct)
        is_met &= at_most(opposite, opposite.opposite, MOST_OPPOSITE_PCT)
    if shape == "normal":
        wanted_pct = LEAST_FOUND_PCT.get(scatter, {}).get(dives, 0.0)
        is_met &= at_least(changed[0.8], changed[0.8].better, wanted_pct)
    cells = (
        *(shape, f"{scatter:g}", f"{dives}"),
        *(f"{equal.share(equal.wrong):.1f}", f"{most_wrong_pct:g}" if most_wrong_pct else ""),
        *(f"{equal.share(equal.equivalent):.1f}", f"{equal.share(equal.missed):.1f}"),
        *(f"{changed[ratio].share(changed[ratio].better):.1f}" for ratio in CHANGES),
        f"{wanted_pct:g}" if wanted_pct else "",
        *(f"{opposite.share(opposite.opposite):.2f}", f"{near.share(near.opposite):.1f}"),
    )
    return Row(f"| {' | '.join(cells)} |", is_met)


# --- Vehicles that differ.

LAYOUTS: Final[tuple[tuple[int, ...], ...]] = (
    (8,),
    (4, 4),
    (8, 3),
    (4, 4, 4),
    (8, 4, 1),
    (8, 1, 1),
    (3, 3, 3, 3, 3),
    (8, 3, 2, 1, 1),
)
"""Dives of each vehicle."""
VEHICLE_SCATTERS: Final = ((0.1, 0.0), (0.1, 0.05), (0.1, 0.1), (0.1, 0.2), (0.2, 0.1))
"""Standard deviations of the log ratio from dive to dive, and from vehicle to vehicle."""
FEWEST_VEHICLES: Final = 3
"""Of fewer nobody can say anything about vehicles that were not there: the truth is that of these."""


def of_vehicles(
    dives: Sequence[int], scatter: float, between: float, ratio: float, repeats: int
) -> Tally:
    """Judge archives of several vehicles, each of which has a ratio of its own."""
    rng = generator("vehicles", tuple(dives), scatter, between, ratio)
    own = math.log(ratio) + between * rng.standard_normal((repeats, len(dives)))
    of_dive = np.repeat(np.arange(len(dives)), dives)
    logs = own[:, of_dive] + scatter * rng.standard_normal((repeats, len(of_dive)))
    log_truths = (
        own.mean(axis=1) if len(dives) < FEWEST_VEHICLES else np.full(repeats, math.log(ratio))
    )
    return tally(logs, log_truths, vehicles=[f"vehicle {number + 1}" for number in of_dive])


def vehicles_row(dives: Sequence[int], scatter: float, between: float, repeats: int) -> Row:
    """Judge equal pairs and a change of 20 % on some vehicles."""
    equal, changed = (of_vehicles(dives, scatter, between, ratio, repeats) for ratio in (1.0, 0.8))
    is_met = at_most(equal, equal.wrong, 5.0) and at_most(
        changed, changed.opposite, MOST_OPPOSITE_PCT
    )
    return Row(
        f"| {' + '.join(map(str, dives))} | {scatter:g} | {between:g} | {equal.share(equal.wrong):.1f} | "
        f"{equal.share(equal.missed):.1f} | {changed.share(changed.better):.1f} | {changed.share(changed.worse):.2f} |",
        is_met,
    )


# --- Archives that grow, looked at after every dive.


@dataclass(frozen=True)
class Looks:
    """What somebody sees who looks at growing archives after every dive.

    Attributes
    ----------
    false_by : dict of int to int
        Archives that had a false word by some dive.
    found_by : dict of int to int
        Archives that were said to be better by some dive.
    """

    archives: int
    false_by: dict[int, int]
    found_by: dict[int, int]

    def pct(self, counts: dict[int, int], dives: int) -> float:
        """Give the archives that had the word by some dive, in percent."""
        return 100.0 * counts[dives] / self.archives


def looks(
    scatter: float,
    ratio: float,
    dives: int,
    archives: int,
    shape: str = "normal",
    *,
    always: bool = True,
) -> Looks:
    """Look at archives after each dive from the third on, by the interval for every look or by the usual one."""
    rng = generator("looks", scatter, ratio, shape)
    log_truth = math.log(ratio)
    logs = log_truth + scatter * SHAPES[shape](rng, (archives, dives))
    at = sorted({*BY_DIVES, dives})
    first_false = list[int]()
    first_found = list[int]()
    for archive in logs.tolist():
        false_at = found_at = dives + 1
        for count in range(3, dives + 1):
            found = over_dives(archive[:count], always=always)
            word = found.word_always if always else found.word
            if found_at > count and word == "better":
                found_at = count
            if false_at > count and contradicts(word, log_truth):
                false_at = count
            # Nothing that comes later can change what was already said.
            if min(false_at, found_at) <= count and (false_at <= count or ratio < 1.0):
                break
        first_false.append(false_at)
        first_found.append(found_at)
    return Looks(
        archives,
        {count: sum(first <= count for first in first_false) for count in at},
        {count: sum(first <= count for first in first_found) for count in at},
    )


LOOK_CELLS: Final = (
    *((scatter, 1.0, MOST_LOOKS, "normal") for scatter in (0.05, 0.1, 0.2, 0.5)),
    (0.2, 1.0, MOST_LOOKS, "exponential"),
    (0.2, 1.0 / 1.05, MOST_LOOKS, "normal"),
    *((scatter, 0.8, 20, "normal") for scatter in (0.1, 0.2, 0.5)),
)
MOST_FALSE_PCT: Final = 2.0


def looks_row(scatter: float, ratio: float, dives: int, shape: str, archives: int) -> Row:
    """Look at growing archives by the interval for every look; beside it, what the usual interval would give."""
    found = looks(scatter, ratio, dives, archives, shape)
    usual = looks(scatter, ratio, 20, archives, shape, always=False)
    is_asked = ratio == 1.0 and shape == "normal"
    error_pct = 100.0 * math.sqrt(MOST_FALSE_PCT / 100.0 / archives)
    is_met = (
        not is_asked
        or found.pct(found.false_by, dives) <= MOST_FALSE_PCT + ALLOWED_ERRORS * error_pct
    )
    better = " | ".join(
        f"{found.pct(found.found_by, count):.1f}" if ratio < 0.95 else "" for count in BY_DIVES
    )
    asked = f"{MOST_FALSE_PCT:g}" if is_asked else ""
    return Row(
        f"| {shape} | {scatter:g} | {ratio:.3g} | {found.pct(found.false_by, 20):.1f} | "
        f"{found.pct(found.false_by, dives):.1f} after {dives} | {asked} | {better} | "
        f"{usual.pct(usual.false_by, 20):.1f} |",
        is_met,
    )


# --- Several candidates at once.

CANDIDATE_COUNTS: Final = (2, 5, 10)
CORRELATION: Final = 0.5
"""Of the log ratios of two candidates, which share the baseline."""


class Family(NamedTuple):
    """Words on several candidates of the same dives."""

    archives: int
    wrong: int
    """Archives in which any equal candidate has a word."""
    others_wrong: int
    """The same, without the first candidate."""
    found: int
    """Archives in which the first candidate is said to be better."""


def family(
    count: int, dives: int, scatter: float, *, named: bool, ratio: float, repeats: int
) -> Family:
    """Judge several candidates, all but the first of which are equal to the baseline; the first may be named."""
    rng = generator("family", count, dives, scatter, ratio)
    common = math.sqrt(CORRELATION) * rng.standard_normal((repeats, 1, dives))
    own = math.sqrt(1.0 - CORRELATION) * rng.standard_normal((repeats, count, dives))
    logs = scatter * (common + own)
    logs[:, 0] += math.log(ratio)
    levels = [
        level_of(count, named=named, is_named=named and place == 0) for place in range(count)
    ]
    wrong = others_wrong = found = 0
    for archive in logs.tolist():
        words = [
            over_dives(of_one, level=level, always=False).word
            for of_one, level in zip(archive, levels, strict=True)
        ]
        is_false = [word in DECIDED for word in words]
        is_false[0] = contradicts(words[0], math.log(ratio))
        wrong += any(is_false)
        others_wrong += any(is_false[1:])
        found += words[0] == "better"
    return Family(repeats, wrong, others_wrong, found)


def family_row(count: int, dives: int, scatter: float, named: bool, repeats: int) -> Row:
    """Judge several candidates, none of which differs, and then with a first one that is better by 20 %."""
    equal, changed = (
        family(count, dives, scatter, named=named, ratio=ratio, repeats=repeats)
        for ratio in (1.0, 0.8)
    )
    pct = 100.0 / repeats
    asked = equal.others_wrong if named else equal.wrong
    is_met = asked * pct <= 5.0 + ALLOWED_ERRORS * 100.0 * math.sqrt(0.05 / repeats)
    return Row(
        f"| {count} | {'the first' if named else 'none'} | {scatter:g} | {dives} | {equal.wrong * pct:.1f} | "
        f"{equal.others_wrong * pct:.1f} | {changed.found * pct:.1f} |",
        is_met,
    )


# --- The page.


class Work(NamedTuple):
    """One row of a table, as a process computes it."""

    table: str
    row: Callable[..., Row]
    arguments: tuple[object, ...]


def works(repeats: int, looked: int) -> Iterator[Work]:
    """Name all rows."""
    for shape in SHAPES:
        for scatter in SCATTERS:
            for dives in DIVES:
                yield Work("pairs", pairs_row, (shape, scatter, dives, repeats))
    for layout in LAYOUTS:
        for scatter, between in VEHICLE_SCATTERS:
            yield Work("vehicles", vehicles_row, (layout, scatter, between, repeats))
    for scatter, ratio, dives, shape in LOOK_CELLS:
        yield Work("looks", looks_row, (scatter, ratio, dives, shape, looked))
    for count in CANDIDATE_COUNTS:
        for named in (False, True):
            for scatter in (0.1, 0.2):
                for dives in (3, 5, 8):
                    yield Work("family", family_row, (count, dives, scatter, named, repeats))


def row_of(work: Work) -> Row:
    """Compute a row."""
    return work.row(*work.arguments)


COLUMNS: Final = {
    "pairs": (
        "scatter is", "s", "dives", "equal, said better or worse [%]", "at most", "equal, said equivalent [%]",
        "equal, interval misses 1 [%]", "found 0.9 [%]", "0.8", "0.67", "0.8 at least", "0.8 or 1.25, opposite [%]",
        "1.03, said better [%]",
    ),
    "vehicles": (
        "dives of each vehicle", "s of dives", "of vehicles", "equal, wrong words [%]", "interval misses the truth [%]",
        "found 0.8 [%]", "said worse [%]",
    ),
    "looks": (
        "scatter is", "s", "truth", "false by 20 dives [%]", "false by the last [%]", "at most",
        *(f"better by {dives} [%]" for dives in BY_DIVES), "usual interval, false by 20 dives [%]",
    ),
    "family": (
        "candidates", "named", "s", "dives", "none differs, any has a word [%]", "any that is not named [%]",
        "first is 0.8, found [%]",
    ),
}  # fmt: skip
ABOUT: Final = {
    "pairs": (
        "Equal pairs and true changes. A wrong word on equal pairs is better or worse. Opposite is *worse* of a true "
        f"0.8 or *better* of a true 1.25, whichever is more frequent; at most {MOST_OPPOSITE_PCT:g} % is asked. "
        "Nothing is asked of the exponential distribution."
    ),
    "vehicles": (
        "Vehicles that differ. With one or two vehicles the truth is the mean of these; with more it is that of all "
        "vehicles like them. A wrong word is one that this truth contradicts."
    ),
    "looks": (
        "Growing archives, looked at after each dive from the third on, by the interval that may be looked at every "
        "time. False is a word that the truth contradicts, at any look so far."
    ),
    "family": (
        "Several candidates of the same dives, whose log ratios have a correlation of 0.5. A candidate may be named "
        "before the run, and is then judged as if it were alone."
    ),
}


def page(rows: dict[str, list[Row]], repeats: int, looked: int, took_s: float) -> str:
    """Write the part of the page of results."""
    lines = [
        "# Judgement: drawn ratios",
        "",
        f"The log ratio of each dive is drawn, {repeats} archives a cell ({looked} that grow), and the tool decides by "
        "its interval over dives. Rows that are not as they must be are marked with a star.",
    ]
    for name, columns in COLUMNS.items():
        marked = [row.text if row.is_met else f"{row.text[:-1]}* |" for row in rows[name]]
        lines += ["", ABOUT[name], "", *table(columns, marked)]
    return "\n".join([*lines, "", f"{machine()}; {took_s:.0f} s."])


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as it must be."""
    parser = judging_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument(
        "--looked", type=int, default=LOOKED, help="archives that are looked at after every dive"
    )
    given = parser.parse_args()
    begun_s = time.monotonic()
    asked = list(works(given.repeats, given.looked))
    with worker_processes(given.jobs) as processes:
        found = list(processes.map(row_of, asked))
    rows = {
        name: [row for work, row in zip(asked, found, strict=True) if work.table == name]
        for name in COLUMNS
    }
    part = page(rows, given.repeats, given.looked, time.monotonic() - begun_s)
    finish(part, is_whole=not given.print, all_met=all(row.is_met for row in found))


if __name__ == "__main__":
    main()
