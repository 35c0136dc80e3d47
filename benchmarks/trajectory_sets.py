"""Sets of trajectories with known truth: equal pairs, true changes, copies, repeated runs, and sets that lack files.

A set is three folders, OLD, NEW and TRUTH, with a TUM file for each dive. Both estimates err independently, and their
errors are scaled so that the ratio of their position errors is known in each dive: it is the ratio of the set, and
scatters from dive to dive as the set says.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from made_trajectories import (
    ERROR_SHARE,
    KINDS,
    Error,
    Sampling,
    Track,
    drawn_track,
    write_noisy_csv,
    write_tum,
)
from rule_worlds import LEAST_FOUND_PCT

DAY_S: Final = 86_400.0

USUAL: Final = Sampling()

Truth = Literal["equal", "change", "copy", "no word", "mixed"]


# --- What a set is.


@dataclass(frozen=True)
class Repeats:
    """Several runs of each dive, in folders of their own."""

    runs: int
    spread: float
    """Standard deviation of the log ratio from run to run, within a dive."""
    is_by_run: bool = False
    """Whether the first run is better by the spread in all dives, and the second one worse."""
    old_too: bool = True
    """Whether the old side has as many runs, which do not differ; else it has one."""


@dataclass(frozen=True)
class SetKind:
    """Sets of trajectories that are drawn alike.

    Attributes
    ----------
    dives : tuple of int
        Of each set; there are as many sets.
    ratio : float
        Position error of NEW over OLD, its geometric mean over dives like these.
    scatter : float
        Standard deviation of the log ratio from dive to dive; NaN where errors are as large as they were drawn.
    errors : tuple of str
        Kinds of errors; the dives take them in turn.
    heading_ratio : float
        By which the attitude error of NEW is larger beside this.
    noise : float
        White noise of the reference, over the position error of OLD.
    is_noise_stated : bool
        Whether the reference states this noise.
    missing : tuple of str
        Sides that lack the file of the second dive.
    copy_noise_m : float
        White noise that a copy differs by; NaN where NEW is no copy.
    is_exact : bool
        Whether the files are sampled so that the ratio must be reported as it is.
    """

    name: str
    truth: Truth
    dives: tuple[int, ...]
    ratio: float = 1.0
    scatter: float = 0.1
    errors: tuple[str, ...] = ("velocity walk", "position walk")
    duration_s: tuple[float, float] = (100.0, 900.0)
    heading_ratio: float = 1.0
    old: Sampling = USUAL
    new: Sampling = USUAL
    reference: Sampling = USUAL
    noise: float = 0.0
    is_noise_stated: bool = False
    missing: tuple[str, ...] = ()
    copy_noise_m: float = math.nan
    repeats: Repeats | None = None
    is_exact: bool = True

    @property
    def is_copy(self) -> bool:
        """Whether NEW is a copy of OLD."""
        return not math.isnan(self.copy_noise_m)


@dataclass(frozen=True)
class SetTruth:
    """What is true of one set.

    Attributes
    ----------
    log_ratios : tuple of float
        Of the dives that can be compared.
    """

    log_ratios: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Geometric mean over these dives."""
        return math.exp(sum(self.log_ratios) / len(self.log_ratios))


# --- Making a set.


def make_set(kind: SetKind, dives: int, rng: np.random.Generator, folder: Path) -> SetTruth:
    """Write the three folders of a set."""
    known = list[float]()
    for number in range(dives):
        log_ratio = _make_dive(kind, number, rng, folder)
        lacks = bool(kind.missing) and number == 1
        if not lacks:
            known.append(log_ratio)
    if kind.missing:
        for side in kind.missing:
            (folder / side / file_name(1)).unlink()
    return SetTruth(tuple(known))


def file_name(number: int) -> str:
    """Name the files of a dive, which are the same on all sides."""
    return f"dive_{number + 1:02d}.tum"


def _make_dive(kind: SetKind, number: int, rng: np.random.Generator, folder: Path) -> float:
    """Write the files of one dive, and return the logarithm of the ratio of its errors."""
    shortest_s, longest_s = kind.duration_s
    duration_s = float(np.exp(rng.uniform(math.log(shortest_s), math.log(longest_s))))
    track = drawn_track(duration_s, rng)
    made = drawn_errors(kind, number, track, rng)
    name = file_name(number)
    # Horizontal noise has two components.
    noise_m = kind.noise * made.old.rms_m / math.sqrt(2.0)
    reference = on_day(kind.reference, number)
    if kind.is_noise_stated:
        path = folder / "TRUTH" / Path(name).with_suffix(".csv")
        write_noisy_csv(path, track, reference, noise_m, rng)
    else:
        write_tum(folder / "TRUTH" / name, track, None, reference, noise_m, rng)
    if kind.repeats is not None:
        return made.log_ratio + _write_runs(kind, kind.repeats, made, number, rng, folder)
    write_tum(folder / "OLD" / name, track, made.old, on_day(kind.old, number))
    noise_m = kind.copy_noise_m if kind.is_copy else 0.0
    write_tum(folder / "NEW" / name, track, made.new, on_day(kind.new, number), noise_m, rng)
    return made.log_ratio


def on_day(sampling: Sampling, number: int) -> Sampling:
    """Move the clock of a file to the day of its dive, unless it begins at 0 s on all days."""
    if sampling.clock_s == 0.0:
        return sampling
    return replace(sampling, clock_s=sampling.clock_s + DAY_S * number)


class MadeErrors(NamedTuple):
    """The errors of both sides of a dive, and the logarithm of their ratio."""

    track: Track
    old: Error
    new: Error
    log_ratio: float


def drawn_errors(kind: SetKind, number: int, track: Track, rng: np.random.Generator) -> MadeErrors:
    """Draw the errors of both sides of a dive."""
    draw = KINDS[kind.errors[number % len(kind.errors)]]
    size_m = ERROR_SHARE * track.distance_m * math.exp(0.4 * rng.standard_normal())
    old = draw(track, rng)
    if kind.is_copy:
        old = old.times(size_m / old.rms_m)
        return MadeErrors(track, old, old, 0.0)
    new = draw(track, rng)
    if math.isnan(kind.scatter):
        # Both are scaled alike, so that they could be exchanged.
        common = size_m / math.sqrt(old.rms_m * new.rms_m)
        old = old.times(common)
        new = new.times(common * kind.ratio)
    else:
        log_ratio = math.log(kind.ratio) + kind.scatter * rng.standard_normal()
        old = old.times(size_m / old.rms_m)
        new = new.times(size_m * math.exp(log_ratio) / new.rms_m)
    log_ratio = math.log(new.rms_m / old.rms_m)
    new = Error(new.position_m, kind.heading_ratio * new.turn_rad)
    return MadeErrors(track, old, new, log_ratio)


def _write_runs(
    kind: SetKind,
    repeats: Repeats,
    made: MadeErrors,
    number: int,
    rng: np.random.Generator,
    folder: Path,
) -> float:
    """Write the runs of a dive, and return by how much their mean log ratio differs from that of the dive."""
    logs = repeats.spread * rng.standard_normal(repeats.runs)
    if repeats.is_by_run:
        logs = repeats.spread * np.linspace(-1.0, 1.0, repeats.runs)
    name = file_name(number)
    old = on_day(kind.old, number)
    new = on_day(kind.new, number)
    for run, log_of_run in enumerate(logs.tolist()):
        of_run = Path(f"run_{run + 1}") / name
        error = made.new.times(math.exp(log_of_run))
        write_tum(folder / "NEW" / of_run, made.track, error, new)
        if repeats.old_too:
            write_tum(folder / "OLD" / of_run, made.track, made.old, old)
    if not repeats.old_too:
        write_tum(folder / "OLD" / name, made.track, made.old, old)
    return float(np.mean(logs))


# --- The sets.

AS_DRAWN: Final = math.nan
SHORT_S: Final = (100.0, 200.0)
LONG_S: Final = (1800.0, 3600.0)
OTHER_RATES: Final = {
    "old": Sampling(rate_hz=10.0),
    "new": Sampling(rate_hz=3.0, phase_s=0.13, clock_ppm=20.0),
    "reference": Sampling(rate_hz=1.0, phase_s=0.07),
}
FROM_ZERO: Final = Sampling(clock_s=0.0)
ENDS_EARLY: Final = Sampling(end_share=0.5)
WITH_HOLE: Final = Sampling(hole=(0.5, 0.7))
RATIOS: Final = (0.9, 0.8, 0.5, 1.0 / 0.9, 1.25, 2.0)
POWER_RATIOS: Final = (0.8, 1.25)
POWER_DIVES: Final = (3, 4, 5, 8)
POWER_SETS: Final = 4
"""Of each ratio, scatter and number of dives."""


def _equal(name: str, dives: tuple[int, ...], **others: Any) -> SetKind:
    return SetKind(f"equal: {name}", "equal", dives, **others)


def _changed(name: str, dives: tuple[int, ...], ratio: float, **others: Any) -> SetKind:
    return SetKind(f"changed: {name}", "change", dives, ratio=ratio, **others)


def _equal_kinds() -> Iterator[SetKind]:
    yield _equal("s 0", (3, 5, 8, 20), scatter=0.0)
    yield _equal("s 0.1", (3, 4, 6, 10, 15))
    yield _equal("s 0.2", (3, 4, 6, 10, 15), scatter=0.2)
    yield _equal("s 0.5", (3, 4, 6, 10, 20), scatter=0.5)
    for error in KINDS:
        yield _equal(f"{error}, as drawn", (4, 9), scatter=AS_DRAWN, errors=(error,))
    yield _equal("30 to 60 min", (3, 8), scatter=0.2, duration_s=LONG_S)
    yield _equal("other rates and clocks", (4, 8), scatter=0.2, **OTHER_RATES)
    of_zero = {"old": FROM_ZERO, "new": FROM_ZERO, "reference": FROM_ZERO}
    yield _equal("all files begin at 0 s", (4, 8), scatter=0.2, **of_zero)
    yield _equal("NEW ends after a half", (5, 12), scatter=0.2, new=ENDS_EARLY, is_exact=False)
    yield _equal("NEW has a hole", (5, 12), scatter=0.2, new=WITH_HOLE, is_exact=False)
    yield _equal("noise of the reference 0.3", (5, 12), noise=0.3, is_exact=False)
    stated: dict[str, Any] = {"noise": 3.0, "is_noise_stated": True, "is_exact": False}
    yield _equal("noise of the reference 3, stated", (5, 12), **stated)
    for side in SIDES:
        yield _equal(f"{side} lacks a dive", (6,), scatter=0.2, missing=(side,))


def _changed_kinds() -> Iterator[SetKind]:
    for ratio in RATIOS:
        yield _changed(f"{ratio:.3g}, s 0.1", (5, 12), ratio)
        yield _changed(f"{ratio:.3g}, s 0.2", (4, 10), ratio, scatter=0.2)
    for error in KINDS:
        yield _changed(f"0.7, {error}", (8,), 0.7, errors=(error,))
    yield _changed("0.5, 30 to 60 min", (6,), 0.5, duration_s=LONG_S)
    yield _changed("0.5, other rates and clocks", (6,), 0.5, **OTHER_RATES)
    yield _changed("0.5, NEW ends after a half", (6,), 0.5, new=ENDS_EARLY, is_exact=False)
    yield _changed("2, NEW ends after a half", (6,), 2.0, new=ENDS_EARLY, is_exact=False)
    yield _changed("0.5, NEW has a hole", (6,), 0.5, new=WITH_HOLE, is_exact=False)
    yield _changed("0.5, noise of the reference 0.3", (6,), 0.5, noise=0.3, is_exact=False)
    stated: dict[str, Any] = {"noise": 3.0, "is_noise_stated": True, "is_exact": False}
    yield _changed("0.5, noise of the reference 3, stated", (4, 6, 8, 12), 0.5, **stated)
    for side in SIDES:
        yield _changed(f"0.5, {side} lacks a dive", (6,), 0.5, missing=(side,))


def _power_kinds() -> Iterator[SetKind]:
    for scatter in LEAST_FOUND_PCT:
        for ratio in POWER_RATIOS:
            for dives in POWER_DIVES:
                name = f"power: {ratio:g}, s {scatter:g}, {dives} dives"
                sets = (dives,) * POWER_SETS
                yield SetKind(name, "change", sets, ratio, scatter, duration_s=SHORT_S)


def _other_kinds() -> Iterator[SetKind]:
    yield SetKind("copy: the same files", "copy", (3, 10), copy_noise_m=0.0)
    yield SetKind("copy: noise of 1 um", "copy", (3, 10), copy_noise_m=1e-6)
    half = Sampling(rate_hz=2.0)
    yield SetKind("copy: every other row", "copy", (5,), copy_noise_m=0.0, new=half)
    untold: dict[str, Any] = {"noise": 3.0, "is_exact": False}
    yield SetKind("untold: noise of the reference 3", "equal", (5, 12), **untold)
    yield SetKind("untold: 0.5, the same", "change", (4, 6, 8, 12), ratio=0.5, **untold)
    by_run = Repeats(2, 0.22, is_by_run=True)
    yield SetKind("repeats: one is better, one worse", "no word", (5, 8), repeats=by_run)
    of_new = replace(by_run, old_too=False)
    yield SetKind("repeats: the same, of NEW alone", "no word", (5, 8), repeats=of_new)
    wide = Repeats(3, 0.22)
    yield SetKind("repeats: 0.8, spread 0.22", "no word", (5, 8), ratio=0.8, repeats=wide)
    narrow = Repeats(3, 0.001)
    yield SetKind("repeats: 0.5, spread 0.001", "change", (5, 8), ratio=0.5, repeats=narrow)
    yield SetKind("repeats: two dives", "no word", (2,), ratio=0.5, repeats=Repeats(4, 0.001))
    yield SetKind("few: one or two dives", "no word", (1, 2), ratio=0.5)
    yield SetKind("few: two of three", "no word", (3,), ratio=0.5, missing=("NEW",))
    yield SetKind("clocks: NEW begins at 0 s", "no word", (4,), ratio=0.5, new=FROM_ZERO)
    yield SetKind("mixed: heading worse", "mixed", (6, 12), ratio=0.5, heading_ratio=6.0)


SIDES: Final = ("OLD", "NEW", "TRUTH")
SETS: Final = (*_equal_kinds(), *_changed_kinds(), *_power_kinds(), *_other_kinds())
