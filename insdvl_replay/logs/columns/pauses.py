"""The pauses between the samples of a topic: those in which samples are missing, and those that are none.

A log does not say what never came into it. Its stamps do where a sensor is regular: then pauses are two, three or more
usual steps, and nothing between. Where stamps jitter, come in bursts or follow a rate that changes, pauses are of any
length, or of one length in a row or at even distances, and nothing is said of samples that are lost one by one.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import NS_PER_S, Floats, TimeNs, nanoseconds
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.cleaning import Cleaner
from insdvl_replay.logs.columns.order import Mask

_USUAL: Final = 0.25
"""Quantile of the steps that is the usual one while less than three samples of four are lost."""
_NEAR: Final = 0.2
"""Steps that are so near a multiple of the usual one count as that; two in five of any length would."""
_MOST_NEAR: Final = 0.8
"""Share of the steps that must be near a multiple."""
_MOST_PAUSES_NEAR: Final = 0.9
"""The same of the pauses among them."""
_PAUSE: Final = 1.5
"""From so many usual steps on a step is a pause."""
_LONGEST: Final = 10.5
"""Up to so many; longer ones are outages, which are told as such."""
_LEAST_PAUSES: Final = 6
"""Fewer pauses may be near a multiple by chance."""
_LIKE_THE_LAST: Final = 0.4
"""Correlation of pauses with those a step later: above it the rate changes, below minus it steps alternate."""
_EVEN: Final = 0.4
"""Spread over mean of the distances between pauses, below which they come in turn: at random it is 0.7 or more."""
_MUCH: Final = 0.05
"""Share of lost samples from which it may change how far a result is to be believed."""
_HINT: Final = "what was not recorded cannot be replayed: look for a recorder or a network that cannot follow"


def note_lost_samples(cleaner: Cleaner) -> None:
    """Note samples for which stamps leave a place, but which the log does not hold."""
    steps_ns = np.diff(cleaner.times)
    if not steps_ns.size or steps_ns.max() < _PAUSE * steps_ns.mean():
        return  # as of nearly all logs
    stamped = np.flatnonzero(steps_ns)
    in_steps = _in_usual_steps(steps_ns[stamped].astype(np.float64))
    multiples = np.round(in_steps)
    near = np.abs(in_steps - multiples) <= _NEAR
    pauses = (in_steps > _PAUSE) & (in_steps < _LONGEST)
    if not _are_losses(near, pauses):
        return
    lost = int(np.sum(multiples[pauses & near] - 1.0))
    share = lost / (lost + cleaner.times.size)
    usual_s = float(np.median(steps_ns[stamped[~pauses & near]])) / NS_PER_S
    text = (
        f"samples, {100.0 * share:.2g} % of all, are not in the log: pauses are multiples of the usual {usual_s:.4g} s"
    )
    much = share >= _MUCH
    first = cleaner.rows[stamped[pauses & near]]
    severity = Severity.WARNING if much else Severity.INFO
    cleaner.note("lost_samples", text, lost, severity, _HINT if much else "", first=first)


def _in_usual_steps(steps_ns: Floats) -> Floats:
    """Divide steps by the usual one: the mean of those about the quantile, since stamps may be rounded."""
    first = float(np.quantile(steps_ns, _USUAL))
    return np.asarray(steps_ns / steps_ns[np.abs(steps_ns / first - 1.0) <= _NEAR].mean())


def _are_losses(near: Mask, pauses: Mask) -> bool:
    """Distinguish losses at random from jitter, from a rate that changes and from pauses that come in turn."""
    count = int(np.count_nonzero(pauses))
    if count < _LEAST_PAUSES or near.mean() < _MOST_NEAR or near[pauses].mean() < _MOST_PAUSES_NEAR:
        return False
    share = pauses.mean()
    if abs(np.mean(pauses[1:] & pauses[:-1]) - share**2) > _LIKE_THE_LAST * share * (1.0 - share):
        return False
    distances = np.diff(np.flatnonzero(pauses))
    return bool(distances.std() > _EVEN * distances.mean())


GAP_STEPS: Final = 5.0
"""A pause of this many steps is more than the jitter of stamps that come in bursts."""
LONGEST_PAUSE_NS: Final = 86_400 * NS_PER_S
"""No recorder waits for a day in the middle of a dive."""
BURST_STEP: Final = 0.2
"""Share of the usual step below which two samples came together, and were not taken so."""
PAUSES: Final = 0.95
"""Share of steps that are no pauses, in which samples are lost."""
BURSTS: Final = 0.05
"""Share of steps that may be so short by the jitter of stamps that are otherwise regular."""


def note_gaps(cleaner: Cleaner, pauses_ns: TimeNs, max_gap_s: float) -> None:
    """Note pauses between rows in which several are missing."""
    max_gap_ns = nanoseconds(max_gap_s)
    is_short = pauses_ns <= max_gap_ns
    short_ns = pauses_ns if is_short.all() else pauses_ns[is_short]
    least_ns = min(GAP_STEPS * float(short_ns.mean()), max_gap_ns) if short_ns.size else max_gap_ns
    gaps = np.flatnonzero(pauses_ns > least_ns)
    if not gaps.size:
        return
    long = int(np.count_nonzero(pauses_ns > max_gap_ns))
    text = (
        f"gaps are longer than {least_ns / NS_PER_S:.3g} s, the longest of {pauses_ns.max() / NS_PER_S:.3f} s, "
        f"{pauses_ns[gaps].sum() / NS_PER_S:.3f} s in all; {long} longer than {max_gap_s:g} s"
    )
    hint = f"{cleaner.role}.max_gap_s says which are harmless" if long else ""
    cleaner.note("gaps", text, gaps.size, Severity.WARNING if long else Severity.INFO, hint, first=cleaner.rows[gaps])


def note_clock_set(cleaner: Cleaner, steps_ns: TimeNs) -> None:
    """Note steps that are no pause of a dive: a recorder without a clock of its own begins in 1970 until it is told."""
    if not steps_ns.size or steps_ns.max() <= LONGEST_PAUSE_NS:
        return
    steps = np.flatnonzero(steps_ns > LONGEST_PAUSE_NS)
    before, after = (np.datetime64(int(cleaner.times[steps[0] + i]), "ns").astype("M8[s]") for i in (0, 1))
    text = (
        f"steps are longer than a day, the first from {before} to {after} UTC: the clock was set while the log was "
        "recorded, or two dives are in it"
    )
    hint = "--start and --end choose what is before or behind"
    cleaner.note("clock_set", text, steps.size, Severity.WARNING, hint, first=cleaner.rows[steps])


def note_bursts(cleaner: Cleaner, steps_ns: TimeNs, remedy: str) -> None:
    """Note rows that came several at once, so that their times are those of the delivery."""
    # The usual step is none longer than the mean.
    if not steps_ns.size or steps_ns.min() >= BURST_STEP * steps_ns.mean():
        return
    # The median would be that within the bursts, where more than two samples come at once.
    usual_ns = float(steps_ns[steps_ns <= np.quantile(steps_ns, PAUSES)].mean())
    together = np.flatnonzero(steps_ns < BURST_STEP * usual_ns)
    if together.size <= BURSTS * steps_ns.size:
        return
    text = (
        f"samples, {together.size / steps_ns.size:.0%} of all, are stamped less than {BURST_STEP:g} of the usual "
        f"step of {usual_ns / NS_PER_S:.4f} s after the one before: stamps in bursts are those of a delivery"
    )
    hint = f"{cleaner.stamp_hint}; else raise {remedy} until the mean NIS is that of a consistent filter"
    cleaner.note("bursts", text, together.size, Severity.WARNING, hint, first=cleaner.rows[together])
