"""The pauses between the samples of a topic: those in which samples are missing, and those that are none."""

from typing import Final

import numpy as np

from insdvl_replay.columns import seconds
from insdvl_replay.logs.cleaning import Cleaner

GAP_STEPS: Final = 5.0
"""A pause of this many steps is more than the jitter of stamps that come in bursts."""
BURST_STEP: Final = 0.2
"""Share of the usual step below which two samples came together, and were not taken so."""
PAUSES: Final = 0.95
"""Share of steps that are no pauses, in which samples are lost."""
BURSTS: Final = 0.05
"""Share of steps that may be so short by the jitter of stamps that are otherwise regular."""


def note_gaps(cleaner: Cleaner, max_gap_s: float) -> None:
    """Note pauses between rows in which several are missing.

    Parameters
    ----------
    cleaner : Cleaner
    max_gap_s : float
        Pauses up to this count as harmless.
    """
    times = cleaner.times
    pauses_s = seconds(times[1:], times[:-1])
    is_short = pauses_s <= max_gap_s
    short_s = pauses_s if is_short.all() else pauses_s[is_short]
    least_s = min(GAP_STEPS * float(short_s.mean()), max_gap_s) if short_s.size else max_gap_s
    gaps = np.flatnonzero(pauses_s > least_s)
    if not gaps.size:
        return
    long = int(np.count_nonzero(pauses_s > max_gap_s))
    text = (
        f"gaps are longer than {least_s:.3g} s, the longest of {pauses_s.max():.3f} s, "
        f"{pauses_s[gaps].sum():.3f} s in all; {long} longer than {max_gap_s:g} s"
    )
    hint = f"{cleaner.role}.max_gap_s says which are harmless" if long else ""
    cleaner.note("gaps", text, gaps.size, "warning" if long else "info", hint, first=cleaner.rows[gaps])


def note_bursts(cleaner: Cleaner, remedy: str) -> None:
    """Note rows that came several at once, so that their times are those of the delivery.

    Parameters
    ----------
    cleaner : Cleaner
    remedy : str
        What helps where the messages do not hold the sensor's own time.
    """
    times = cleaner.times
    steps_s = seconds(times[1:], times[:-1])
    # The usual step is none longer than the mean.
    if not steps_s.size or steps_s.min() >= BURST_STEP * steps_s.mean():
        return
    # The median would be that within the bursts, where more than two samples come at once.
    usual_s = float(steps_s[steps_s <= np.quantile(steps_s, PAUSES)].mean())
    together = np.flatnonzero(steps_s < BURST_STEP * usual_s)
    if together.size <= BURSTS * steps_s.size:
        return
    text = (
        f"samples, {together.size / steps_s.size:.0%} of all, are stamped less than {BURST_STEP:g} of the "
        f"usual step of {usual_s:.4f} s after the one before: stamps in bursts are those of a delivery"
    )
    hint = f"{cleaner.stamp_hint}; else raise {remedy} until the mean NIS is that of a consistent filter"
    cleaner.note("bursts", text, together.size, "warning", hint, first=cleaner.rows[together])
