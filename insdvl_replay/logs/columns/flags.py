"""Columns that mark pings as valid or not: by their names, and by what their values coincide with.

A name such as ``valid`` or ``bottom_lock`` says which sense it has. What a ``status`` or a ``quality`` of 0 means, only
the pings can say: those without a velocity, or with one that scatters, are the invalid ones.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats

_BEFORE: Final = r"(^|.*[._])(is|has|dvl|bt|bottom|track|ping|data|vel|velocity|[xyz]|v[xyz])*"
_VALID: Final = re.compile(
    _BEFORE + r"(valid|validity|lock|locked|good|ok|usable)(_?(flag|bit|status))?"
)
_INVALID: Final = re.compile(
    _BEFORE + r"(invalid|bad|lost|(no|not|un)_?(valid|lock|locked|good|ok))(_?(flag|bit))?"
)
_UNSURE: Final = re.compile(_BEFORE + r"(status|state|quality|qual|qc|flags?|error|fault)")
_OF_OTHERS: Final = re.compile(
    r"imu|acc|gyr|gps|gnss|fix|nav|ref|ahrs|mag|depth|press|alt|head|usbl|beam|(^|[._])b\d|time|clock"
)
_FEWEST: Final = 3  # pings that show what a flag means
_ENOUGH: Final = 8  # pings of each kind, of which the scatter is compared
# Share of the pings that have no velocity.
_MOSTLY: Final = 0.5
_HARDLY: Final = 0.05
_SCATTERS: Final = 3.0  # times as much as the others
_OUTLIER: Final = 10.0  # times the usual speed: a number that stands for none
_CODES: Final = 8  # values of a status at most; a quantity has more


@dataclass(frozen=True)
class FlagColumns:
    """Columns by what their names say: not 0 where a ping is valid, not 0 where it is not, or neither."""

    valid: tuple[str, ...]
    invalid: tuple[str, ...]
    unsure: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.valid, *self.invalid, *self.unsure)


def flag_columns(names: Iterable[str]) -> FlagColumns:
    """Find the columns that may say which pings of a DVL are valid."""
    found: dict[re.Pattern[str], list[str]] = {_INVALID: [], _VALID: [], _UNSURE: []}
    for name in names:
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
        if _OF_OTHERS.search(text):
            continue
        for form, others in found.items():
            if form.fullmatch(text) or form.fullmatch(text.replace("_", "")):
                others.append(name)
                break
    return FlagColumns(tuple(found[_VALID]), tuple(found[_INVALID]), tuple(found[_UNSURE]))


def says_valid(flag: Floats, velocity: Floats) -> bool | None:
    """Return whether a flag, (k,), is 0 for invalid pings, or for valid ones; None where velocities do not say.

    Velocities have shape (k, 3).
    """
    is_zero = flag == 0.0
    groups = (is_zero, ~is_zero & np.isfinite(flag))
    speed = np.abs(velocity).max(axis=1)
    usual = 0.0
    if (speed > 0.0).any():
        usual = float(np.median(speed[speed > 0.0]))
    has_none = ~(speed > 0.0) | (speed > _OUTLIER * usual)
    if min(np.count_nonzero(group) for group in groups) < _FEWEST:
        return None
    shares = [float(np.mean(has_none[group])) for group in groups]
    if min(shares) <= _HARDLY and max(shares) >= _MOSTLY:
        return shares[0] > shares[1]
    off = _scatter(velocity, ~has_none)
    parts = [off[group & np.isfinite(off)] for group in groups]
    if min(map(len, parts)) < _ENOUGH:
        return None
    zero = float(np.median(parts[0]))
    other = float(np.median(parts[1]))
    if max(zero, other) < _SCATTERS * min(zero, other):
        return None
    return zero > other


def _scatter(velocity: Floats, usable: Floats) -> Floats:
    """Return how far each velocity is from the median of itself and its four neighbours, (k,); NaN of unusable ones."""
    off = np.full(len(velocity), np.nan)
    rows = np.flatnonzero(usable)
    if len(rows) < 5:
        return off
    values = velocity[rows]
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    off[rows] = np.linalg.norm(values - np.median(windows, axis=-1), axis=1)
    return off


def marks_some(flag: Floats, *, is_sure: bool) -> int:
    """Return how many pings a flag, (k,), may mark as invalid; 0 where it says nothing.

    One whose name has a sense is 0 for them. Of another the rarer values count: it is a code of few values.
    """
    known = flag[np.isfinite(flag)]
    zeros = int(np.count_nonzero(flag == 0.0))
    if is_sure and len(known):
        return zeros + len(flag) - len(known)
    if is_sure:
        return zeros
    values, counts = np.unique(known, return_counts=True)
    if len(values) < 2:
        return 0
    if len(values) <= _CODES and np.all(values == np.rint(values)):
        return int(counts.sum() - counts.max())
    return zeros
