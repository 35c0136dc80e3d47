"""Samples that are lost one by one, which no single pause shows: steps of stamps that are multiples of the usual one.

A log does not say what never came into it. Its stamps do where a sensor is regular: then pauses are two, three or more
usual steps, and nothing between. Where stamps jitter, come in bursts or follow a rate that changes, pauses are of any
length, or of one length in a row or at even distances, and nothing is said.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import NS_PER_S, Floats
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
    """Note samples for which stamps leave a place, but which the log does not hold.

    Parameters
    ----------
    cleaner : Cleaner
        Before messages are dropped: those without a use were recorded all the same.
    """
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
    cleaner.note("lost_samples", text, lost, "warning" if much else "info", _HINT if much else "", first=first)


def _in_usual_steps(steps_ns: Floats) -> Floats:
    """Divide steps by the usual one: the mean of those about the quantile, since stamps may be rounded."""
    first = float(np.quantile(steps_ns, _USUAL))
    return np.asarray(steps_ns / steps_ns[np.abs(steps_ns / first - 1.0) <= _NEAR].mean())


def _are_losses(near: Mask, pauses: Mask) -> bool:
    """Tell losses at random from jitter, from a rate that changes and from pauses that come in turn."""
    count = int(np.count_nonzero(pauses))
    if count < _LEAST_PAUSES or near.mean() < _MOST_NEAR or near[pauses].mean() < _MOST_PAUSES_NEAR:
        return False
    share = pauses.mean()
    if abs(np.mean(pauses[1:] & pauses[:-1]) - share**2) > _LIKE_THE_LAST * share * (1.0 - share):
        return False
    distances = np.diff(np.flatnonzero(pauses))
    return bool(distances.std() > _EVEN * distances.mean())
