"""How often `compare OLD NEW --reference TRUTH` is right of trajectories whose errors are known.

`python benchmarks/trajectory_worlds.py` writes the part of the page of results. Sets are made by `trajectory_sets`,
written as TUM files and compared by the command. Words are counted as right, wrong or undecided.
"""

import math
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from judged import Compared, compared, over_dives
from results import finish, judging_parser, machine, table, worker_processes
from rule_worlds import LEAST_FOUND_PCT, contradicts, is_opposite
from trajectory_sets import POWER_RATIOS, SETS, SetKind, SetTruth, make_set

from insdvl_replay.core.words import Verdict

SEED: Final = 83_000_000
ALLOWED_ERRORS: Final = 3.0
"""A rate breaks what is asked if it is off by more than so many standard errors."""
MOST_RATIO_OFF: Final = 0.02
"""A reported ratio may differ from that of the files by so much, since files are sampled."""
FEWEST_DIVES: Final = 3


# --- Words held against the truth.

PLAIN: Final = {
    Verdict.BETTER: "better",
    Verdict.WORSE: "worse",
    Verdict.MIXED: "mixed",
    Verdict.EQUIVALENT: "equivalent",
    Verdict.NO_EFFECT: "equivalent",
}
"""What words say of gain or loss; all others say nothing of it."""
REFUSED: Final = "refused"
USAGE: Final = 2
UNUSABLE: Final = 3


class JudgedSet(NamedTuple):
    """What the tool said of one set."""

    kind: int
    number: int
    dives: int
    truth: SetTruth
    found: Compared

    @property
    def of_kind(self) -> SetKind:
        """How the set was drawn."""
        return SETS[self.kind]

    @property
    def word(self) -> str:
        """The word of the tool, or that it refused the files."""
        return self.found.word or REFUSED

    @property
    def plain(self) -> str:
        """What the word says of gain or loss."""
        return PLAIN.get(Verdict(self.found.word), "") if self.found.word else ""

    @property
    def is_broken(self) -> bool:
        """Whether the command did not end as it must: with a word, or with a sentence."""
        if self.found.word:
            return self.found.code != 0
        is_refused = self.found.code in (USAGE, UNUSABLE)
        return not is_refused or "Traceback" in self.found.stderr

    @property
    def is_wrong(self) -> bool:
        """Whether the word is contradicted by the truth."""
        truth = self.of_kind.truth
        if truth == "copy":
            return self.word != Verdict.NO_EFFECT
        if truth == "no word":
            return bool(self.plain)
        if truth == "mixed":
            return self.plain not in ("", "mixed")
        if truth == "equal" and self.plain == "mixed":
            return True
        return contradicts(self.plain, math.log(self.of_kind.ratio))

    @property
    def is_right(self) -> bool:
        """Whether the word says what is true."""
        if self.is_wrong:
            return False
        truth = self.of_kind.truth
        if truth == "no word":
            return not self.is_broken
        if truth == "change":
            return self.plain in ("better", "worse")
        return bool(self.plain)

    @property
    def is_opposite(self) -> bool:
        """Whether the word has the wrong sign."""
        return is_opposite(self.plain, math.log(self.of_kind.ratio))

    @property
    def is_off(self) -> bool:
        """Whether the reported ratio is not that of the files."""
        if not self.found.word or not self.of_kind.is_exact or self.of_kind.is_copy:
            return False
        if self.of_kind.truth == "no word":
            # Runs that differ may be joined by their squares, or by their logarithms as the truth is.
            return False
        if math.isnan(self.ratio_off):
            return self.has_dives_enough and self.of_kind.repeats is None
        return self.ratio_off > MOST_RATIO_OFF

    @property
    def ratio_off(self) -> float:
        """By how much the reported ratio differs from that of the files; NaN where there is none."""
        if not self.of_kind.is_exact or math.isnan(self.found.ratio):
            return math.nan
        return abs(math.log(self.found.ratio / self.truth.ratio))

    @property
    def has_dives_enough(self) -> bool:
        """Whether so many dives have all files that a verdict is possible."""
        return len(self.truth.log_ratios) >= FEWEST_DIVES

    @property
    def is_miscounted(self) -> bool:
        """Whether the tool took another number of dives; it need not say how many where it says no word."""
        return bool(self.plain) and self.found.dives != len(self.truth.log_ratios)

    @property
    def misses(self) -> bool:
        """Whether the interval does not hold the ratio that the set was drawn with."""
        ratio = self.of_kind.ratio
        return not self.found.low <= ratio <= self.found.high

    @property
    def has_interval(self) -> bool:
        """Whether an interval is asked to hold the ratio."""
        is_drawn = self.of_kind.truth in ("equal", "change")
        return is_drawn and self.of_kind.is_exact and not math.isnan(self.found.low)

    @property
    def rule_word(self) -> str:
        """The word of the tool's rule on the true ratios of these dives."""
        return over_dives(self.truth.log_ratios, always=False).word


class Task(NamedTuple):
    """One set."""

    kind: int
    number: int
    seed: int


def tasks_of(times: int, seed: int) -> list[Task]:
    """Name all sets, each of them drawn so many times."""
    found = list[Task]()
    for kind, of_kind in enumerate(SETS):
        found += [Task(kind, number, seed) for number in range(times * len(of_kind.dives))]
    return found


def judged_set(task: Task) -> JudgedSet:
    """Make a set and ask the tool."""
    kind = SETS[task.kind]
    dives = kind.dives[task.number % len(kind.dives)]
    rng = np.random.default_rng((task.seed, zlib.crc32(kind.name.encode()), task.number))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = make_set(kind, dives, rng, folder)
        found = compared(folder / "OLD", folder / "NEW", folder / "TRUTH")
    return JudgedSet(task.kind, task.number, dives, truth, found)


# --- The page.


class Question(NamedTuple):
    """A row of the table of rates."""

    asks: str
    names: tuple[str, ...]
    """Beginnings of the names of kinds; a dollar sign stands for the end."""
    part: str
    """The property of a set that is counted."""
    asked_pct: float | None = None
    is_least: bool = False
    by_dives: Mapping[int, float] = {}
    """Percent that are asked at least, by the dives of a set."""


def _power(scatter: float) -> Question:
    """Ask for what true changes of 20 % must find, with as many dives as each set has."""
    names = tuple(f"power: {ratio:g}, s {scatter:g}" for ratio in POWER_RATIOS)
    asks = f"true changes of 20 %, s {scatter:g}, found"
    return Question(asks, names, "is_right", is_least=True, by_dives=LEAST_FOUND_PCT[scatter])


EQUAL_PCT: Final = 5.0
STATED: Final = (
    "equal: noise of the reference 3, stated",
    "changed: 0.5, noise of the reference 3, stated",
)
QUESTIONS: Final = (
    Question("equal pairs, s 0, a word", ("equal: s 0$",), "is_wrong", EQUAL_PCT),
    Question("equal pairs, s 0.1, a word", ("equal: s 0.1",), "is_wrong", EQUAL_PCT),
    Question("equal pairs, s 0.2, a word", ("equal: s 0.2",), "is_wrong", EQUAL_PCT),
    Question("equal pairs, s 0.5, a word", ("equal: s 0.5",), "is_wrong", EQUAL_PCT),
    Question("equal pairs, all, a word", ("equal",), "is_wrong", EQUAL_PCT),
    Question("true changes, wrong words", ("changed", "power"), "is_wrong", EQUAL_PCT),
    Question("true changes, opposite sign", ("changed", "power"), "is_opposite", 0.0),
    *(_power(scatter) for scatter in LEAST_FOUND_PCT),
    Question("true changes, all, found", ("changed",), "is_right"),
    Question("copies, said anything but *no effect*", ("copy",), "is_wrong", 0.0),
    Question(
        "repeats that differ, a word",
        ("repeats: one", "repeats: the same", "repeats: 0.8"),
        "is_wrong",
        0.0,
    ),
    Question("repeats that hardly differ, 0.5 found", ("repeats: 0.5",), "is_right", 100.0, True),
    Question("fewer than three dives, a word", ("few", "repeats: two"), "is_wrong", 0.0),
    Question("files without a common time, a word", ("clocks",), "is_wrong", 0.0),
    Question("position better, heading worse: a plain word", ("mixed",), "is_wrong", 0.0),
    Question("all, ended otherwise than with a word or a sentence", ("",), "is_broken", 0.0),
    Question("all with a word, another number of dives", ("",), "is_miscounted", 0.0),
    Question(
        "noise of the reference that it does not state, wrong words", ("untold",), "is_wrong"
    ),
    Question("noise of the reference that it states, wrong words", STATED, "is_wrong", 0.0),
    Question("ratio off by more than 2 %", ("",), "is_off", 0.0),
    Question("interval misses the ratio", ("",), "misses", EQUAL_PCT),
)


def of_question(question: Question, sets: Sequence[JudgedSet]) -> list[JudgedSet]:
    """Choose the sets that a question is about."""
    chosen = [one for one in sets if f"{one.of_kind.name}$".startswith(question.names)]
    if question.part == "misses":
        return [one for one in chosen if one.has_interval]
    return chosen


class Asked(NamedTuple):
    """How many of some sets are asked, and by how much chance may be off."""

    counted: float
    error: float


def asked_of(question: Question, sets: Sequence[JudgedSet]) -> Asked | None:
    """Return how many sets are asked, most or least; None where nothing is."""
    if question.by_dives:
        shares = [question.by_dives[one.dives] / 100.0 for one in sets]
    elif question.asked_pct is not None:
        shares = [question.asked_pct / 100.0] * len(sets)
    else:
        return None
    variance = sum(share * (1.0 - share) for share in shares)
    return Asked(sum(shares), math.sqrt(variance))


def is_met(question: Question, count: int, asked: Asked | None) -> bool:
    """Return whether a count is as asked, but for chance."""
    if asked is None:
        return True
    allowed = ALLOWED_ERRORS * asked.error
    if question.is_least:
        return count >= asked.counted - allowed - 1e-9
    return count <= asked.counted + allowed + 1e-9


def rate_rows(sets: Sequence[JudgedSet]) -> tuple[list[str], bool]:
    """Give the rows of the table of rates, and whether all are as asked."""
    rows = list[str]()
    all_met = True
    for question in QUESTIONS:
        chosen = of_question(question, sets)
        if not chosen:
            continue
        count = sum(getattr(one, question.part) for one in chosen)
        asked = asked_of(question, chosen)
        met = is_met(question, count, asked)
        all_met &= met
        limit = ""
        if asked is not None:
            side = "at least" if question.is_least else "at most"
            limit = f"{side} {100.0 * asked.counted / len(chosen):.3g}"
        pct = f"{100.0 * count / len(chosen):.1f}{'' if met else ' *'}"
        rows.append(f"| {question.asks} | {count} of {len(chosen)} | {pct} | {limit} |")
    return rows, all_met


def kind_row(kind: SetKind, sets: Sequence[JudgedSet]) -> str:
    """Write what was said of the sets of one kind."""
    words = Counter(one.word for one in sets)
    said = ", ".join(f"{count} {word}" for word, count in sorted(words.items()))
    wrong = sum(one.is_wrong for one in sets)
    right = sum(one.is_right for one in sets)
    other = len(sets) - wrong - right
    dives = ", ".join(map(str, dict.fromkeys(one.dives for one in sets)))
    return (
        f"| {kind.name} | {dives} | {said} | {right} / {wrong} / {other} | {largest_off(sets)} |"
    )


def largest_off(sets: Sequence[JudgedSet]) -> str:
    """Say by how many percent reported ratios differ from those of the files, at most."""
    off = [one.ratio_off for one in sets if not math.isnan(one.ratio_off)]
    if not off:
        return ""
    return f"{100.0 * max(off):.2g}"


def failures(sets: Sequence[JudgedSet]) -> list[str]:
    """Name each set that is not as it must be, with what was said."""
    found = list[str]()
    for one in sets:
        parts = [part for part in FAULTS if getattr(one, part)]
        if not parts:
            continue
        faults = ", ".join(FAULTS[part] for part in parts)
        truth = f"{one.truth.ratio:.3f}" if one.truth.log_ratios else "-"
        seen = f"{one.found.ratio:.3f} ({one.found.low:.3f} .. {one.found.high:.3f})"
        found.append(
            f"| {one.of_kind.name} | {one.number} | {one.dives} | {one.word} | {truth} | {seen} | "
            f"{faults} |"
        )
    return found


FAULTS: Final = {
    "is_wrong": "wrong",
    "is_broken": "broken",
    "is_miscounted": "dives miscounted",
    "is_off": "ratio off",
}

ABOUT: Final = (
    "Estimates of drawn tracks err independently, by a kind of error, and are scaled so that the ratio of their "
    "horizontal position errors is known in each dive; s is the scatter of its logarithm from dive to dive. Sets are "
    "three folders of TUM files, of which `compare OLD NEW --reference TRUTH` says a word. *Better*, *worse* and "
    "*mixed* are wrong of equal pairs; *equivalent*, and the opposite, are wrong of true changes of 10 % or more. A "
    "star marks what is not as asked, but for three standard errors of so many sets."
)
OF_KINDS: Final = (
    "What was said of each kind; right / wrong / neither; and by how many percent, at most, the ratio is off that of "
    "the files, where they are sampled so that it can be told."
)
OF_FAULTS: Final = "Sets that are not as they must be, with their true ratio, what was reported, and what is wrong."


def page(sets: Sequence[JudgedSet], took_s: float) -> tuple[str, bool]:
    """Write the part of the page of results, and say whether all rates are as asked."""
    rates, all_met = rate_rows(sets)
    rows = list[str]()
    for number, kind in enumerate(SETS):
        of_kind = [one for one in sets if one.kind == number]
        if of_kind:
            rows.append(kind_row(kind, of_kind))
    agrees = sum(one.word == one.rule_word for one in sets if one.has_interval)
    judged = sum(one.has_interval for one in sets)
    lines = [
        *("# Judgement: trajectories", "", ABOUT, ""),
        *table(("", "sets", "%", "asked [%]"), rates),
        "",
        f"The word is that of the rule for the true ratios of the dives in {agrees} of {judged} sets.",
        *("", OF_KINDS, ""),
        *table(("set", "dives", "words", "right / wrong / neither", "ratio off [%]"), rows),
    ]
    faults = failures(sets)
    if faults:
        columns = ("set", "number", "dives", "word", "true", "reported", "fault")
        lines += ["", OF_FAULTS, "", *table(columns, faults)]
    return "\n".join([*lines, "", f"{machine()}; {took_s:.0f} s."]), all_met


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as asked."""
    parser = judging_parser(__doc__)
    parser.add_argument("--times", type=int, default=1, help="so many sets for each")
    parser.add_argument(
        "--sets", nargs="+", default=[""], help="those whose names hold one of these texts"
    )
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    begun_s = time.monotonic()
    tasks = list[Task]()
    for task in tasks_of(given.times, given.seed):
        if any(part in SETS[task.kind].name for part in given.sets):
            tasks.append(task)
    with worker_processes(given.jobs) as processes:
        sets = list(processes.map(judged_set, tasks))
    part, all_met = page(sets, time.monotonic() - begun_s)
    finish(part, is_whole=given.sets == [""] and not given.print, all_met=all_met)


if __name__ == "__main__":
    main()
