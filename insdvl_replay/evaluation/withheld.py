"""What filters lose against sensors that were withheld from them: squared innovations, one sensor at a time.

As against a reference, positions and depths are judged by what they drift by over a minute; a heading by itself. What a
sensor errs by itself is in both filters alike and makes them look the more equal the noisier it is: readings of a few
seconds, in which no filter drifts, are averaged.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs, nanoseconds
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import WITHHELD
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.drift import STEP_S, time_segments
from insdvl_replay.evaluation.losses import Losses


def withheld_losses(history: History, noise_sd: Mapping[str, Floats]) -> dict[str, Losses]:
    """Square what a filter and the withheld sensors differ by.

    Parameters
    ----------
    noise_sd : mapping of str to ndarray, shape (s,)
        Of the components of one reading of each sensor of `core.sensors`, by its name: m, or of a heading rad. The
        first stands for all that are compared.

    Returns
    -------
    dict of str to Losses
        By quantity of `quantities.WITHHELD_QUANTITIES`; what has no two values is left out.
    """
    found = {}
    for innovations in history.innovations:
        name = innovations.measurement.removeprefix(WITHHELD)
        if innovations.is_withheld and name in _LOSSES:
            found[innovations.measurement] = _LOSSES[name](innovations, float(noise_sd[name][0]))
    return {quantity: losses for quantity, losses in found.items() if losses.squared.shape[1] > 1}


def _depth(innovations: Innovations, sd_m: float) -> Losses:
    return _drift(innovations, 1, sd_m)


def _position(innovations: Innovations, sd_m: float) -> Losses:
    return _drift(innovations, 2, sd_m)


def _drift(innovations: Innovations, components: int, sd_m: float) -> Losses:
    """Square by how much differences in the first components change over segments; both ends are the sensor's."""
    time_ns, apart_m, together = _averaged(innovations.time_ns, innovations.innovation[:, :components])
    segments = time_segments(time_ns)
    change_m = apart_m[segments.last] - apart_m[segments.first]
    floor_m = math.sqrt(2.0 * components / together) * sd_m
    return Losses("m", np.sum(change_m**2, axis=1)[None], segments.steps, floor_m)


def _averaged(time_ns: TimeNs, values: Floats) -> tuple[TimeNs, Floats, float]:
    """Average the values, shape (k, s), of every few seconds; return how many there mostly are together, too."""
    steps = (time_ns - time_ns[:1]) // nanoseconds(STEP_S)
    _, first, counts = np.unique(steps, return_index=True, return_counts=True)
    means = np.add.reduceat(values, first, axis=0) / counts[:, None]
    return (
        time_ns[first] + (np.add.reduceat(time_ns - time_ns[first].repeat(counts), first) // counts),
        means,
        float(np.median(counts)),
    )


def _heading(innovations: Innovations, sd_rad: float) -> Losses:
    return Losses("deg", (innovations.innovation.T / DEG) ** 2, 1, sd_rad / DEG)


_LOSSES: Final[dict[str, Callable[[Innovations, float], Losses]]] = {
    "depth": _depth,
    "heading": _heading,
    "position": _position,
}
