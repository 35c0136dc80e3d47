"""How late a reference is against the IMU, by its turns and its accelerations; no filter, start or DVL is needed.

From row to row a reference turns as the gyros say, and changes its velocity as accelerometers and gravity say, if its
rows are looked up at the right time. The delay is the one with which both agree best: a least-squares fit beside the
constants that also could make them differ (scale and mounting, biases, gravity, lever arm). Readings are integrated
over legs of a second between rows, so that a reference of 1 Hz is enough, and nothing is differentiated. The standard
error comes from the scatter of the scores of blocks of twenty seconds, in which residuals may be correlated.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    Dive,
    Floats,
    ImuColumns,
    Integers,
    Mask,
    ReferenceColumns,
    in_pauses,
    is_new,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.dive_record import (
    LATE_S,
    SIGNIFICANT_SDS,
    Delay,
    ReferenceDelay,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.words import DelayStatus
from insdvl_replay.geometry.rotation import mat_from_vector, skew, vector_from_mat

SURE_S: Final = 0.01  # standard error with which a delay of `LATE_S` would have been seen
FARTHEST_S: Final = 2.0  # delay that is looked for, either sign
# The same where gyros and reference turn, but not together.
VERY_FAR_S: Final = 30.0
OTHER_CLOCK_S: Final = 1.0  # such a delay is no latency, but that of another clock
CLEAR_TURN: Final = 0.02  # rad, root mean square over the legs, of a vehicle that turns
LATE_NOTES: Final = ("reference_late", "reference_other_clock")
COARSE_S: Final = 0.1  # steps of the first search
LEG_S: Final = 1.0
LONGEST_LEG_S: Final = 2.5
LARGEST_TURN: Final = 1.0  # rad, in a leg; more is a jump
MOST_LEGS: Final = 6000  # of a dive, evenly chosen
FEWEST_LEGS: Final = 30
BLOCK_S: Final = 20.0
FEWEST_BLOCKS: Final = 2.5  # that tell the delay, each by as much as the others
EXPLAINED: Final = 0.5  # least part of the signal that a fit explains
ROUNDS: Final = 4
SMALLEST_PAUSE_S: Final = 0.5  # nobody saw what happened in one of the IMU
_SAME_CLOCK: Final = 0.1  # part of a delay
_COARSE_LEGS: Final = 1000
_FAR_LEGS: Final = 300
_FORCE_LEGS: Final = 1500  # each takes several rotations
_SEARCHED_LEGS: Final = 250
# Of the misfit at the delay of the attitude, before another one is tried.
_CLEARLY_LESS: Final = 0.8
# Of a leg in eight parts, in each of which the attitude is that of its middle.
_ENDS: Final = np.arange(0, 17, 2) / 16.0
_MIDDLES: Final = np.arange(1, 17, 2) / 16.0
_ATTITUDES: Final = np.concatenate([[0.0], _MIDDLES, [1.0]])
# Columns of integrated readings.
_TURNS: Final = slice(0, 3)
_FORCES: Final = slice(3, 6)
_ROW_APART_S: Final = 0.1  # rows of a faster reference add nothing
_GRID_S: Final = 0.02  # steps in which the integrated readings are kept
_AROUND_S: Final = 0.05  # to each side, over which a reading is averaged
_OUTLIER_SDS: Final = 3.0
_UNIFORM: Final = 12.0**-0.5  # sd of what lies anywhere in a step
_TINY: Final = 1e-9  # rad and m/s: rounding
_ALIGNED: Final = 0.2  # largest element by which the axes of reference and IMU may differ to compare accelerations

Compared = Callable[[float], "Difference"]


@dataclass(frozen=True)
class Difference:
    """What k legs of the reference have more than the IMU says at one delay."""

    values: Floats  # (k, 3)
    constants: Floats  # (k, 3, p): derivatives by other unknowns
    # (k, 3): derivative of what the IMU says by the delay, per s; a search among many delays does without
    by_delay: Callable[[], Floats]


@dataclass(frozen=True)
class _Integrals:
    """Readings of an IMU, integrated from its first sample."""

    at_s: Floats  # (n,)
    total: Floats  # (n, 6): rad about the three axes, then m/s along them

    @classmethod
    def of(cls, imu: ImuColumns) -> "_Integrals":
        """Integrate by trapezoids; of a fast IMU only some sums are kept, as all would be large."""
        sample_s = seconds(imu.time_ns, imu.time_ns[0])
        step_s = np.diff(sample_s)
        stride = max(1, int(_GRID_S / imu.usual_step_s))
        kept = np.arange(0, len(sample_s), stride)
        total = np.zeros((len(kept), 6))
        columns = (*imu.angular_rate_b.T, *imu.specific_force_b.T)
        for into, values in zip(total.T, columns, strict=True):
            sums = 0.5 * (values[1:] + values[:-1])
            sums *= step_s
            np.cumsum(sums, out=sums)
            into[1:] = sums[kept[1:] - 1]
        return cls(sample_s[kept], total)

    def at(self, time_s: Floats, columns: slice) -> Floats:
        """Interpolate three columns at times, (..., 3)."""
        last = len(self.at_s) - 1
        after = np.searchsorted(self.at_s, time_s)
        after = np.maximum(after, 1)
        after = np.minimum(after, last)
        from_s = self.at_s[after - 1]
        share = (time_s - from_s) / (self.at_s[after] - from_s)
        total = self.total[:, columns]
        before = total[after - 1]
        change = total[after] - before
        return np.asarray(before + share[..., None] * change)

    def mean_around(self, time_s: Floats, columns: slice) -> Floats:
        """Return readings averaged around times, (..., 3): rad/s or m/s^2."""
        before = self.at(time_s - _AROUND_S, columns)
        after = self.at(time_s + _AROUND_S, columns)
        return np.asarray((after - before) / (2.0 * _AROUND_S))


@dataclass(frozen=True)
class _Legs:
    """Pairs of rows of a reference, about a second apart, in the order of time."""

    from_s: Floats  # (k,), since the first sample of the IMU
    to_s: Floats  # (k,)
    first: Integers  # (k,), rows
    last: Integers  # (k,)

    def some(self, most: int) -> "_Legs":
        """Choose at most so many, evenly."""
        stride = -(-len(self.first) // most)
        if stride <= 1:
            return self
        keep = slice(None, None, stride)
        return _Legs(self.from_s[keep], self.to_s[keep], self.first[keep], self.last[keep])

    def where(self, keep: Mask) -> "_Legs":
        """Keep some, by a mask of shape (k,)."""
        return _Legs(self.from_s[keep], self.to_s[keep], self.first[keep], self.last[keep])


def reference_delay(imu: ImuColumns, reference: ReferenceColumns | None) -> ReferenceDelay:
    """Return how much later the stamps of a reference are than the IMU's, s, with its standard error."""
    if reference is None:
        return ReferenceDelay(None, None, DelayStatus.NO_REFERENCE)
    if not reference.has_attitude:
        return ReferenceDelay(None, None, DelayStatus.NO_ATTITUDE)
    if len(imu.time_ns) < FEWEST_LEGS:
        return ReferenceDelay(None, None, DelayStatus.LITTLE_MOTION)
    integrals = _Integrals.of(imu)
    # Readings may be averages before their stamps, or around them.
    of_step_s = _UNIFORM * imu.usual_step_s
    turned = _by_turns(imu, reference, integrals, FARTHEST_S)
    if not turned.is_explained and _both_turn(imu, reference, integrals):
        turned = _by_turns(imu, reference, integrals, VERY_FAR_S)
    by_turns = turned.delay
    by_accelerations = None
    if turned.is_aligned:
        attitude_s = 0.0 if by_turns is None else by_turns.delay_s
        by_accelerations = _by_accelerations(imu, reference, integrals, attitude_s)
    return _together(_widened(by_turns, of_step_s), _widened(by_accelerations, of_step_s))


def with_reference_delay(dive: Dive, config: Config) -> Dive:
    """Return a dive with the delay of its reference, and with a note where it matters."""
    found = reference_delay(dive.imu, dive.reference)
    count = 0 if dive.reference is None else len(dive.reference.time_ns)
    notes = (*dive.notes, *_delay_notes(found, count, config.reference.latency_s))
    return replace(dive, reference_delay=found, notes=notes)


def _delay_notes(found: ReferenceDelay, count: int, latency_s: float) -> tuple[Note, ...]:
    """Warn of a late or early reference; the latency is the one that its stamps are without already."""
    turns = found.by_turns
    accelerations = found.by_accelerations
    late_s = surely_late_s(found)
    if late_s is None:
        if not found.is_late or turns is None or accelerations is None:
            return ()
        both = {"turns_s": turns.delay_s, "accelerations_s": accelerations.delay_s}
        return (note("reference_late in_part", count, **both),)
    shown = {
        "late": "late" if late_s > 0.0 else "early",
        "setting": latency_s + late_s,
        "size_s": abs(late_s),
        "sd_s": found.sd_s,
    }
    if abs(late_s) >= OTHER_CLOCK_S:
        return (note("reference_other_clock", count, **shown),)
    return (note("reference_late", count, **shown),)


def surely_late_s(found: ReferenceDelay) -> float | None:
    """Return how late a reference is, s; None where its delay is unknown or too little to matter.

    Turns and accelerations that contradict each other by less than a tenth of both are by the same other clock.
    """
    if not found.is_late:
        return None
    if found.status != DelayStatus.CONTRADICTORY:
        return found.delay_s
    if found.by_turns is None or found.by_accelerations is None:
        return None
    turns_s = found.by_turns.delay_s
    apart_s = abs(turns_s - found.by_accelerations.delay_s)
    if abs(turns_s) >= OTHER_CLOCK_S and apart_s < _SAME_CLOCK * abs(turns_s):
        return turns_s
    return None


def reference_on_time(dive: Dive) -> ReferenceColumns | None:
    """Return the reference of a dive at the times of the IMU, as far as its delay is known."""
    if dive.reference is None or dive.reference_delay is None:
        return dive.reference
    late_s = surely_late_s(dive.reference_delay)
    if late_s is None:
        return dive.reference
    return replace(dive.reference, time_ns=dive.reference.time_ns - nanoseconds(late_s))


def _widened(found: Delay | None, of_step_s: float) -> Delay | None:
    if found is None:
        return None
    return Delay(found.delay_s, float(np.hypot(found.sd_s, of_step_s)))


def _together(by_turns: Delay | None, by_accelerations: Delay | None) -> ReferenceDelay:
    """Return the mean of both by their weights, or the larger of two that exclude each other."""
    if by_accelerations is not None and by_accelerations.sd_s > SURE_S:
        # Noise of the attitude turns gravity, and an unsure fit takes that for a delay.
        by_accelerations = None
    known = [found for found in (by_turns, by_accelerations) if found is not None]
    if not known:
        return ReferenceDelay(None, None, DelayStatus.LITTLE_MOTION)
    delays_s = np.array([found.delay_s for found in known])
    weights = np.array([found.sd_s for found in known]) ** -2.0
    delay_s = float(weights @ delays_s / weights.sum())
    sd_s = float(weights.sum() ** -0.5)
    status = DelayStatus.DETERMINED
    apart_s = float(np.ptp(delays_s))
    if apart_s > max(LATE_S, SIGNIFICANT_SDS * float(np.sqrt(np.sum(1.0 / weights)))):
        larger = max(known, key=lambda found: abs(found.delay_s))
        delay_s = larger.delay_s
        sd_s = larger.sd_s
        status = DelayStatus.CONTRADICTORY
    found = ReferenceDelay(delay_s, sd_s, status, by_turns, by_accelerations)
    if sd_s <= SURE_S or found.is_late:
        return found
    return ReferenceDelay(delay_s, sd_s, DelayStatus.LITTLE_MOTION, by_turns, by_accelerations)


# --- What is compared.


def _legs(
    imu: ImuColumns,
    time_s: Floats,
    known: Mask,
    farthest_s: float,
) -> _Legs:
    """Return the legs between known rows of a reference, s since the first sample, that the IMU saw at any delay."""
    rows = np.flatnonzero(known)
    rows = rows[is_new(np.floor(time_s[rows] / _ROW_APART_S + 1e-6).astype(np.int64))]
    row_s = time_s[rows]
    usual_s = float(np.median(np.diff(row_s))) if len(rows) > 1 else LEG_S
    after = np.searchsorted(row_s, row_s + LEG_S - min(0.5 * usual_s, 0.5 * LEG_S))
    after = np.maximum(after, np.arange(1, len(rows) + 1))
    begin = np.flatnonzero(after < len(rows))
    end = after[begin]
    from_s = row_s[begin]
    to_s = row_s[end]
    end_of_imu_s = float(imu.time_ns[-1] - imu.time_ns[0]) * 1e-9
    seen = (from_s > farthest_s) & (to_s < end_of_imu_s - farthest_s)
    seen &= to_s - from_s <= LONGEST_LEG_S
    margin_ns = nanoseconds(farthest_s)
    from_ns = imu.time_ns[0] + np.rint(from_s * 1e9).astype(np.int64)
    to_ns = imu.time_ns[0] + np.rint(to_s * 1e9).astype(np.int64)
    seen &= ~in_pauses(
        from_ns - margin_ns, to_ns + margin_ns, imu.time_ns, nanoseconds(SMALLEST_PAUSE_S)
    )
    return _Legs(from_s, to_s, rows[begin], rows[end]).where(seen)


@dataclass(frozen=True)
class _Turns:
    """Turns of a reference over legs."""

    legs: _Legs
    values: Floats  # (k, 3) rad

    def some(self, most: int) -> "_Turns":
        """Choose at most so many, evenly."""
        stride = -(-len(self.values) // most)
        return _Turns(self.legs.some(most), self.values[:: max(stride, 1)])


def _turns_of(imu: ImuColumns, reference: ReferenceColumns, farthest_s: float) -> _Turns:
    """Return the turns of a reference without jumps, over legs that the IMU saw at any delay."""
    time_s = seconds(reference.time_ns, imu.time_ns[0])
    legs = _legs(imu, time_s, reference.known["attitudes"], farthest_s).some(MOST_LEGS)
    mat_nb = reference.mat_nb
    turns = vector_from_mat(np.swapaxes(mat_nb[legs.first], 1, 2) @ mat_nb[legs.last])
    usual = np.linalg.norm(turns, axis=1) < LARGEST_TURN
    return _Turns(legs.where(usual), turns[usual])


def _both_turn(imu: ImuColumns, reference: ReferenceColumns, integrals: _Integrals) -> bool:
    """Return whether gyros and reference turn clearly, so that their delay would be seen."""
    found = _turns_of(imu, reference, FARTHEST_S)
    legs = found.legs
    if len(legs.first) < FEWEST_LEGS:
        return False
    measured = integrals.at(legs.to_s, _TURNS) - integrals.at(legs.from_s, _TURNS)
    least = len(legs.first) * CLEAR_TURN**2
    return min(_size(measured), _size(found.values)) > least


@dataclass(frozen=True)
class _ByTurns:
    """What the turns of a reference say of its delay."""

    delay: Delay | None
    is_aligned: bool = True  # its axes are those of the IMU, as far as they tell
    is_explained: bool = (
        False  # the turns are those of the gyros, so no farther delay is looked for
    )


def _by_turns(
    imu: ImuColumns,
    reference: ReferenceColumns,
    integrals: _Integrals,
    farthest_s: float,
) -> "_ByTurns":
    """Compare turns with the gyros at all delays up to the farthest."""
    found = _turns_of(imu, reference, farthest_s)
    legs = found.legs
    turns = found.values
    mat_nb = reference.mat_nb
    if len(legs.first) < FEWEST_LEGS:
        return _ByTurns(None)
    searched = found.some(_COARSE_LEGS if farthest_s == FARTHEST_S else _FAR_LEGS)
    coarse_s = np.arange(-farthest_s + COARSE_S, farthest_s, COARSE_S)
    misfits = []
    for tried_s in coarse_s.tolist():
        tried = _turns(searched.legs, searched.values, mat_nb, integrals, tried_s)
        misfits.append(_misfit(tried))
    best = int(np.argmin(misfits))
    if not 0 < best < len(coarse_s) - 1:
        return _ByTurns(None)
    best_s = float(coarse_s[best])

    def compared(delay_s: float) -> Difference:
        return _turns(legs, turns, mat_nb, integrals, delay_s)

    delay = _fitted(compared, legs, best_s, _size(turns))
    if delay is not None:
        is_aligned = _is_aligned(legs, turns, integrals, delay.delay_s)
        return _ByTurns(delay, is_aligned, is_explained=True)
    is_aligned = _is_aligned(legs, turns, integrals, 0.0)
    left = _left_of(compared(best_s))
    return _ByTurns(None, is_aligned, is_explained=_explains(float(np.sum(left**2)), _size(turns)))


def _turns(
    legs: _Legs,
    turns: Floats,
    mat_nb: Floats,
    integrals: _Integrals,
    delay_s: float,
) -> Difference:
    """Compare turns of the reference, (k, 3) rad, with the gyros; scale and mounting are any matrix."""
    from_s = legs.from_s - delay_s
    to_s = legs.to_s - delay_s
    measured = integrals.at(to_s, _TURNS) - integrals.at(from_s, _TURNS)
    length_s = (legs.to_s - legs.from_s)[:, None, None]
    bias = length_s * np.eye(3)
    earth = length_s * np.swapaxes(mat_nb[legs.first], 1, 2)
    mounted = np.einsum("kj,il->kilj", measured, np.eye(3)).reshape(len(measured), 3, 9)

    def by_delay() -> Floats:
        """Differentiate; what changes is turned and scaled as the turns are."""
        at_start = integrals.mean_around(from_s, _TURNS)
        at_end = integrals.mean_around(to_s, _TURNS)
        factor, *_ = np.linalg.lstsq(measured, turns, rcond=None)
        return np.asarray((at_start - at_end) @ factor)

    return Difference(turns, np.concatenate([mounted, bias, earth], axis=2), by_delay)


def _is_aligned(
    legs: _Legs,
    turns: Floats,
    integrals: _Integrals,
    delay_s: float,
) -> bool:
    """Return whether the turns of the reference are those of the gyros in the same axes, as far as they tell."""
    at_start = integrals.at(legs.from_s - delay_s, _TURNS)
    measured = integrals.at(legs.to_s - delay_s, _TURNS) - at_start
    power = measured.T @ measured
    apart = turns.T @ measured - power
    return bool(np.abs(apart).max() <= _ALIGNED * max(float(np.trace(power)), _TINY))


def _by_accelerations(
    imu: ImuColumns,
    reference: ReferenceColumns,
    integrals: _Integrals,
    attitude_s: float,
) -> Delay | None:
    """Compare changes of the velocity with the accelerometers, in axes of an attitude whose delay is known.

    The velocity may have another one, as where it comes from another filter.
    """
    if not reference.has_velocity:
        return None
    time_s = seconds(reference.time_ns, imu.time_ns[0])
    known = reference.known["velocities"] & reference.known["attitudes"]
    centre_s = 0.0
    if abs(attitude_s) > FARTHEST_S:
        centre_s = attitude_s
    farthest_s = FARTHEST_S + abs(centre_s)
    legs = _legs(imu, time_s, known, farthest_s).some(_FORCE_LEGS)
    if len(legs.first) < FEWEST_LEGS:
        return None
    mat_bn = np.swapaxes(reference.mat_nb[legs.first], 1, 2)
    changes_n = reference.velocity_n[legs.last] - reference.velocity_n[legs.first]
    changes_b = np.einsum("kij,kj->ki", mat_bn, changes_n)

    forces = _Forces(legs, changes_b, mat_bn, integrals, attitude_s)
    searched = forces.some(_SEARCHED_LEGS)
    start_s = attitude_s
    misfit = _CLEARLY_LESS * _misfit(searched.compared(start_s))
    around_s = np.arange(-FARTHEST_S, FARTHEST_S, 2.0 * COARSE_S)
    for delay_s in (centre_s + around_s).tolist():
        tried = _misfit(searched.compared(delay_s))
        if tried < misfit:
            start_s = delay_s
            misfit = tried
    return _fitted(forces.compared, legs, start_s, _size(changes_b))


@dataclass(frozen=True)
class _Forces:
    """Changes of a reference's velocity over k legs, to be compared with the accelerometers."""

    legs: _Legs
    changes_b: Floats  # (k, 3) m/s, in body axes of each leg's first row
    mat_bn: Floats  # (k, 3, 3) of these rows
    integrals: _Integrals
    attitude_s: float  # delay of the attitude

    def some(self, most: int) -> "_Forces":
        """Choose at most so many, evenly."""
        stride = -(-len(self.changes_b) // most)
        return replace(
            self,
            legs=self.legs.some(most),
            changes_b=self.changes_b[::stride],
            mat_bn=self.mat_bn[::stride],
        )

    def compared(self, delay_s: float) -> Difference:
        """Return what the changes have more than the accelerometers say, at a delay of the velocity."""
        from_s = self.legs.from_s - delay_s
        length_s = self.legs.to_s - self.legs.from_s
        to_s = from_s + length_s
        pushed = self._inside(from_s, length_s, _ENDS, _FORCES)
        pushed = np.diff(pushed, axis=1)
        turned = self._inside(from_s, length_s, _ATTITUDES, _TURNS)
        row_s = self.legs.from_s - self.attitude_s
        at_row = self.integrals.at(row_s, _TURNS)
        rotations = mat_from_vector(turned - at_row[:, None])
        gained = np.einsum("kpij,kpj->ki", rotations[:, 1:-1], pushed)
        of_start = rotations[:, 0]
        of_end = rotations[:, -1]
        rate_start = self.integrals.mean_around(from_s, _TURNS)
        rate_end = self.integrals.mean_around(to_s, _TURNS)
        bias = length_s[:, None, None] * np.eye(3)
        gravity = length_s[:, None, None] * self.mat_bn
        arm_start = of_start @ skew(rate_start)
        arm_end = of_end @ skew(rate_end)
        arm = arm_end - arm_start

        def by_delay() -> Floats:
            at_start = self.integrals.mean_around(from_s, _FORCES)
            at_end = self.integrals.mean_around(to_s, _FORCES)
            force_start = np.einsum("kij,kj->ki", of_start, at_start)
            force_end = np.einsum("kij,kj->ki", of_end, at_end)
            return np.asarray(force_start - force_end)

        constants = np.concatenate([bias, gravity, arm], axis=2)
        return Difference(self.changes_b - gained, constants, by_delay)

    def _inside(
        self,
        from_s: Floats,
        length_s: Floats,
        parts: Floats,
        columns: slice,
    ) -> Floats:
        """Return integrated readings at p parts of each leg, (k, p, 3)."""
        parts_s = length_s[:, None] * parts
        return self.integrals.at(from_s[:, None] + parts_s, columns)


# --- The fit.


def _size(values: Floats) -> float:
    """Return the sum of squares of a signal, (k, 3), without its mean."""
    return float(np.sum((values - values.mean(axis=0)) ** 2))


def _left(values: Floats, constants: Floats) -> Floats:
    """Return what is left of columns, (m, c), beside others, (m, p), of any units."""
    size = np.linalg.norm(constants, axis=0)
    unit = constants / np.where(size > 0.0, size, 1.0)
    solved = np.linalg.pinv(unit.T @ unit, rcond=1e-12, hermitian=True) @ (unit.T @ values)
    return np.asarray(values - unit @ solved)


def _left_of(difference: Difference) -> Floats:
    """Return what no constant explains, (3 k, 1)."""
    count = len(difference.values)
    constants = difference.constants.reshape(3 * count, -1)
    return _left(difference.values.reshape(-1, 1), constants)


def _misfit(difference: Difference) -> float:
    """Return the mean size of what no constant explains; jumps count once, not by their squares."""
    return float(np.mean(np.abs(_left_of(difference))))


def _explains(left: float, signal: float) -> bool:
    """Return whether a fit explains a signal, by its squares and those that are left."""
    return left < (1.0 - EXPLAINED) * signal


def _fitted(
    compared: Compared,
    legs: _Legs,
    start_s: float,
    signal: float,
) -> Delay | None:
    """Find a delay near a first one; None where the legs do not determine it."""
    delay_s = start_s
    for _ in range(ROUNDS):
        difference = compared(delay_s)
        fit = _solved(difference, legs)
        if fit is None:
            return None
        change_s, sd_s, left = fit
        delay_s += float(np.clip(change_s, -COARSE_S, COARSE_S))
        if abs(change_s) < 0.1 * sd_s:
            break
    has_settled = abs(change_s) < sd_s and abs(delay_s - start_s) < 2.0 * COARSE_S
    if has_settled and _explains(left, signal):
        return Delay(delay_s, sd_s)
    return None


def _solved(difference: Difference, legs: _Legs) -> tuple[float, float, float] | None:
    """Return the change of the delay and its standard error, s, and the squares that are left, without outliers."""
    count = len(difference.values)
    both = np.stack([difference.values, difference.by_delay()], axis=2)
    weight = np.ones((count, 3))
    for _ in range(2):  # first to learn the scatter of each axis, and which legs jump
        weighted = (weight[:, :, None] * both).reshape(3 * count, 2)
        constants = (weight[:, :, None] * difference.constants).reshape(3 * count, -1)
        values, slopes = _left(weighted, constants).T.reshape(2, count, 3)
        information = float(np.sum(slopes**2))
        if not information > 0.0:
            return None
        change_s = float(np.sum(slopes * values)) / information
        left = (values - change_s * slopes) / weight
        scatter = 1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0) + _TINY
        off = np.sqrt(np.mean((left / scatter) ** 2, axis=1))
        weight = np.minimum(1.0, _OUTLIER_SDS / np.maximum(off, _TINY))[:, None] / scatter
    block = np.floor(legs.from_s / BLOCK_S).astype(np.int64)
    block -= block[0]
    scores = np.bincount(block, np.sum(slopes * (values - change_s * slopes), axis=1))
    shares = np.bincount(block, np.sum(slopes**2, axis=1)) / information
    blocks = 1.0 / float(np.sum(shares**2))
    if blocks < FEWEST_BLOCKS:
        return None
    # Few blocks do not tell their scatter well.
    of_blocks_s = np.sqrt(np.sum(scores**2)) / information * (1.0 + 2.0 / (blocks - 1.0))
    of_legs_s = information**-0.5
    kept = np.minimum(np.abs(left), _OUTLIER_SDS * np.linalg.norm(scatter))
    return change_s, float(max(of_blocks_s, of_legs_s)), float(np.sum(kept**2))
