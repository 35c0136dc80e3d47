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
from insdvl_replay.geometry.frames import north_east_down_m


def withheld_losses(history: History, noise_sd: Mapping[str, Floats]) -> dict[str, Losses]:
    """Square what a filter and the withheld sensors differ by, by quantity of `quantities.WITHHELD_QUANTITIES`.

    The noise is that of the components of one reading, by the sensor's name, SI; the first stands for all. What has no
    two values is left out.
    """
    found = {}
    for innovations in history.innovations:
        name = innovations.measurement.removeprefix(WITHHELD)
        if innovations.is_withheld and name in _LOSSES:
            found[innovations.measurement] = _LOSSES[name](history, innovations, float(noise_sd[name][0]))
    return {quantity: losses for quantity, losses in found.items() if losses.squared.shape[1] > 1}


def withheld_track(history: History) -> dict[str, float]:
    """Return by how much the track of a filter differs from withheld fixes and depths: the rms and the last, m.

    Readings of a few seconds are averaged.
    """
    found: dict[str, float] = {}
    for innovations in history.innovations:
        name = innovations.measurement.removeprefix(WITHHELD)
        if innovations.is_withheld and name in _ALONG and len(innovations.time_ns):
            _, apart_m, _ = _averaged(innovations.time_ns, innovations.innovation[:, : len(_ALONG[name])])
            off_m = np.linalg.norm(apart_m, axis=1)
            found |= {name: float(np.sqrt(np.mean(off_m**2))), f"{name}_end": float(off_m[-1])}
    return found


def _drift(history: History, innovations: Innovations, sd_m: float) -> Losses:
    """Square by how much differences change over segments, between corrections; both ends are the sensor's."""
    along = _ALONG[innovations.measurement.removeprefix(WITHHELD)]
    apart_m = innovations.innovation[:, : len(along)]
    if len(history.corrected):
        rows = np.searchsorted(history.time_ns, innovations.time_ns, side="right") - 1
        apart_m = apart_m - north_east_down_m(history.position[rows], history.dead_reckoned[rows])[:, along]
    time_ns, apart_m, together = _averaged(innovations.time_ns, apart_m)
    segments = time_segments(time_ns)
    change_m = apart_m[segments.last] - apart_m[segments.first]
    floor_m = math.sqrt(2.0 * len(along) / together) * sd_m
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


def _heading(_: History, innovations: Innovations, sd_rad: float) -> Losses:
    return Losses("deg", (innovations.innovation.T / DEG) ** 2, 1, sd_rad / DEG)


_LOSSES: Final[dict[str, Callable[[History, Innovations, float], Losses]]] = {
    "depth": _drift,
    "heading": _heading,
    "position": _drift,
}
_ALONG: Final = {"depth": [2], "position": [0, 1]}
"""Sensors that tell of the track, and along which axes of n."""
