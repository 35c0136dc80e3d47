"""Checks of an IMU: its rate, stuck readings, gravity, and its turns against other sources."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np

from insdvl_replay.checks.sentences import Remark, marked, refusal
from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    Integers,
    Mask,
    ReferenceColumns,
    TimeNs,
    find_runs,
    in_pauses,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError, counted
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG
from insdvl_replay.core.units import SPECIFIC_FORCE_UNITS
from insdvl_replay.geometry import earth
from insdvl_replay.geometry.rotation import vector_from_mat

AXES: Final = ("forward", "starboard", "down")
ENOUGH: Final = 20  # fewer pairs may agree by chance
LONGEST_STEP_S: Final = 2.5  # longer steps are not used
FASTEST_HZ: Final = 10_000.0  # no IMU is read more often
LEAST_DIVE_S: Final = 1.0  # what is shorter is no dive, or its times are in another unit
# Weight of no rotation at all, where the vectors leave a turn about one axis open.
SMALLEST: Final = 1e-3
# Second singular value from which vectors determine a rotation; one alone has 0.
LEAST_SEEN: Final = 0.2
NO_PAIRS: Final = (np.empty((0, 3)), np.empty((0, 3)))
SPIN_RADPS: Final = 1.0  # no vehicle that a DVL can follow turns faster than this half of the time

_LEAST_S: Final = 2.0  # a shorter log is no reason to refuse it
# Units of specific force that are taken for one another.
_CONFUSED: Final = ("m/s2", "g", "mg")


def since_s(time_ns: TimeNs, row: int) -> float:
    """Return the seconds from the first row to another one."""
    return float((time_ns[row] - time_ns[0]) * 1e-9)


def samples_in(imu: ImuColumns, length_s: float) -> int:
    """Return the number of samples, 1 at least, that an IMU takes in a time."""
    if len(imu.time_ns) > 1:
        return max(1, round(length_s / imu.usual_step_s))
    return 1


def lies_within(time_ns: TimeNs, others_ns: TimeNs) -> Mask:
    """Find which times are between the first and the last of others, which are in order."""
    return np.asarray((time_ns >= others_ns[0]) & (time_ns <= others_ns[-1]))


def length_refusal(place: str, imu: ImuColumns) -> LogError | None:
    """Refuse an IMU, all of whose samples are in less than a second: that is no dive."""
    span_s = since_s(imu.time_ns, -1)
    if span_s >= LEAST_DIVE_S:
        return None
    samples = counted(len(imu.time_ns), "sample")
    return refusal("imu_too_short", place, samples=samples, span_s=span_s)


def rate_remark(place: str, imu: ImuColumns, settings: Imu) -> Remark | None:
    """Refuse an IMU whose rate cannot be or is too low, and warn of a low one; None where the rate is usual."""
    count = len(imu.time_ns)
    steps_ns = np.diff(imu.time_ns)
    short_ns = steps_ns[steps_ns <= nanoseconds(settings.max_gap_s)]
    if len(short_ns) < ENOUGH:
        return None
    rate_hz = NS_PER_S / float(short_ns.mean())
    if rate_hz > FASTEST_HZ:
        return refusal(
            "imu_too_fast", place, rate_hz=rate_hz, count=count, span_s=since_s(imu.time_ns, -1)
        )
    if rate_hz < 0.95 * settings.min_rate_hz:  # what an IMU holds of its nominal rate
        return refusal("imu_too_slow", place, rate_hz=rate_hz, least_hz=np.floor(rate_hz))
    if rate_hz < 40.0:  # a vehicle rolls and surges at 1 to 2 Hz; slower samples miss part of it
        return note("imu_slow", count, rate_hz=rate_hz)
    return None


def imu_remarks(
    place: str,
    imu: ImuColumns,
    reference: ReferenceColumns | None,
    settings: Imu,
) -> Iterator[Remark]:
    """Check the readings of an IMU."""
    count = len(imu.time_ns)
    span_s = since_s(imu.time_ns, -1)
    some_b = imu.angular_rate_b[:: 1 + count // 100_000]
    turning_radps = float(np.median(np.linalg.norm(some_b, axis=1)))
    if turning_radps > SPIN_RADPS and span_s > _LEAST_S:
        yield refusal(
            "imu_spinning", place, turning_radps=turning_radps, turning_degps=turning_radps / DEG
        )

    unusual_rate = rate_remark(place, imu, settings)
    if unusual_rate is not None:
        yield unusual_rate
    if span_s >= 10.0:
        yield from _constant_remarks(place, imu)
    yield from _stuck_remarks(imu)
    yield from _gravity_remarks(place, imu, reference, settings)


def _constant_remarks(place: str, imu: ImuColumns) -> Iterator[Remark]:
    """Look for axes that never change: none of a vehicle in water is constant to the last bit for ten seconds."""
    count = len(imu.time_ns)
    by_name = {
        "specific_force": ("m/s^2", imu.specific_force_b),
        "angular_rate": ("rad/s", imu.angular_rate_b),
    }
    for name, (unit, readings) in by_name.items():
        known = {"name": name, "quantity": name.replace("_", " "), "unit": unit}
        # The last reading mostly shows that they are not the same.
        same = readings[-1] == readings[0]
        same[same] = (readings[:, same] == readings[0, same]).all(axis=0)
        if same.all() and not readings[0].any():
            yield refusal("imu_zero", place, count=count, **known)
            break
        for axis in np.flatnonzero(same).tolist():
            yield note("imu_constant", count, axis=AXES[axis], value=readings[0, axis], **known)


def _stuck_remarks(imu: ImuColumns) -> Iterator[Remark]:
    """Look for runs of over a second in which all six readings repeat."""
    same = imu.specific_force_b[1:, 0] == imu.specific_force_b[:-1, 0]
    rows = np.flatnonzero(same)
    for readings in (imu.specific_force_b, imu.angular_rate_b):
        same[rows] &= (readings[rows + 1] == readings[rows]).all(axis=1)
    starts, ends = find_runs(same)
    lengths_s = seconds(imu.time_ns[ends], imu.time_ns[starts])
    long = np.flatnonzero(lengths_s > 1.0)
    if long.size:
        repeats = int(np.sum(ends[long] - starts[long]))
        first_s = since_s(imu.time_ns, starts[long[0]])
        yield note("imu_stuck", repeats, first_s=first_s, longest_s=lengths_s.max())


@dataclass(frozen=True)
class _QuietForce:
    """The specific force in the quieter half of the seconds."""

    mean_b: Floats  # (k, 3) m/s^2
    starts: Integers  # (k,), rows with which the seconds begin

    @classmethod
    def of(cls, imu: ImuColumns) -> "_QuietForce":
        """Look at a thousand seconds of a long dive."""
        length = min(samples_in(imu, 1.0), len(imu.time_ns))
        blocks = len(imu.time_ns) // length
        some = np.arange(0, blocks, 1 + blocks // 1000)
        force_b = imu.specific_force_b[: blocks * length].reshape(blocks, length, 3)[some]
        unrest = force_b.var(axis=1).sum(axis=1)
        quiet = unrest <= np.median(unrest)
        return cls(force_b[quiet].mean(axis=1), some[quiet] * length)


@dataclass(frozen=True)
class _Cure:
    """What brings a specific force to gravity."""

    text: str
    is_measured: bool = False


def _gravity_remarks(
    place: str,
    imu: ImuColumns,
    reference: ReferenceColumns | None,
    settings: Imu,
) -> Iterator[Remark]:
    """Compare the specific force of the quieter half of the seconds with gravity."""
    quiet = _QuietForce.of(imu)
    gravity = SPECIFIC_FORCE_UNITS["g"]
    if reference is not None and reference.has_position:
        gravity = float(earth.normal_gravity(float(np.nanmedian(reference.position[:, 0])), 0.0))
    sizes = np.linalg.norm(quiet.mean_b, axis=1)
    size = float(np.median(sizes))
    ratio = size / gravity
    cure = _cure(imu, ratio, settings)
    found = {"size": size, "gravity": gravity, "cure": cure.text}
    down = quiet.mean_b[:, 2]
    along_down = float(np.median(down))
    is_other_unit = not 1.0 / 1.5 < ratio < 1.5  # or another scale
    if is_other_unit and since_s(imu.time_ns, -1) > _LEAST_S:
        refused = refusal("imu_no_gravity", place, **found)
        yield marked(refused, is_measured=cure.is_measured)
    elif abs(ratio - 1.0) > 0.05:  # no bias of a working accelerometer reaches 50 mg
        off = np.abs(sizes / gravity - 1.0) > 0.05
        first_s = since_s(imu.time_ns, quiet.starts[off][0])
        warned = note("imu_gravity", int(off.sum()), first_s=first_s, **found)
        yield marked(warned, is_measured=cure.is_measured)
    elif along_down > 0.0:
        above = down > 0.0
        first_s = since_s(imu.time_ns, quiet.starts[above][0])
        force = {"along_down": along_down, "level": -gravity}
        yield note("imu_upside_down", int(above.sum()), first_s=first_s, **force)


def _cure(imu: ImuColumns, ratio: float, settings: Imu) -> _Cure:
    """Return the setting with which a specific force of so many times gravity is gravity."""
    if not ratio:
        return _Cure('to read another field: imu.specific_force = "field.path"')
    step_s = imu.usual_step_s if len(imu.time_ns) > ENOUGH else np.inf
    is_increment = abs(ratio / step_s - 1.0) < 0.1 and step_s < 0.09
    if is_increment and settings.increment_s is None and settings.specific_force_unit != "mg":
        step = f"{step_s:.4g}"
        what = f"it is {ratio:.3g} times gravity: increments over {step} s?"
        return _Cure(f"{what} imu.increment_s = {step}")
    for unit, taken in permutations(_CONFUSED, 2):
        wrong = SPECIFIC_FORCE_UNITS[taken] / SPECIFIC_FORCE_UNITS[unit]
        if abs(ratio / wrong - 1.0) < 0.1:
            return _Cure(f'imu.specific_force_unit = "{unit}"')
    scale = ratio * settings.specific_force_scale
    return _Cure(f"imu.specific_force_scale = {scale:.4g}", is_measured=True)


@dataclass(frozen=True)
class AttitudeFit:
    """How the gyros follow the change of the reference's attitude."""

    scale: float  # measured over true
    correlation: float
    excursion: Floats  # (3,), rad: how far the attitude swings about each axis, which tells whether there is a signal
    by_axis: Floats  # (3,), correlations


@dataclass(frozen=True)
class _Turns:
    """The turns of a reference from attitude to attitude, and what the gyros sum to meanwhile."""

    time_ns: TimeNs  # (k,), of the attitudes
    time_s: Floats  # (k,), since the first sample
    mat_nb: Floats  # (k, 3, 3)
    turned: Floats  # (k - 1, 3), rad
    summed: Floats  # (k - 1, 3), rad

    @classmethod
    def of(cls, imu: ImuColumns, reference: ReferenceColumns) -> "_Turns | None":
        """Compare the attitudes that lie within the samples; None where they are too few."""
        is_known = np.isfinite(reference.mat_nb).all(axis=(1, 2))
        rows = np.flatnonzero(is_known & lies_within(reference.time_ns, imu.time_ns))
        if len(rows) < ENOUGH:
            return None
        time_ns = reference.time_ns[rows]
        time_s = seconds(time_ns, imu.time_ns[0])
        mat_nb = reference.mat_nb[rows]
        turned = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])
        summed = np.diff(turned_by(imu, time_s), axis=0)
        return cls(time_ns, time_s, mat_nb, turned, summed)

    @property
    def are_near(self) -> Mask:
        """Between which attitudes little time is, (k - 1,)."""
        return np.asarray(np.diff(self.time_s) <= LONGEST_STEP_S)

    @property
    def are_clear(self) -> Mask:
        """Which turns between near attitudes are neither noise nor jumps, (k - 1,)."""
        size = np.linalg.norm(self.turned, axis=1)
        # Slower turns than 0.3 deg/s are below the noise of differences of attitudes.
        is_seen = size > 0.3 * DEG * np.diff(self.time_s)
        return np.asarray(self.are_near & is_seen & (size < 1.0))


def gyro_by_attitude(imu: ImuColumns, reference: ReferenceColumns) -> AttitudeFit | None:
    """Compare the summed gyros with the turn between two attitudes; None where the vehicle turned too little."""
    turns = _Turns.of(imu, reference)
    if turns is None:
        return None
    longest_ns = nanoseconds(LONGEST_STEP_S)
    paused = in_pauses(turns.time_ns[:-1], turns.time_ns[1:], imu.time_ns, longest_ns)
    good = turns.are_clear & ~paused
    if np.count_nonzero(good) < ENOUGH:
        return None
    turned = turns.turned[good]
    summed = turns.summed[good]
    product = np.sum(summed * turned, axis=0)
    power = np.sum(turned * turned, axis=0)
    summed_power = np.sum(summed * summed, axis=0)
    return AttitudeFit(
        scale=float(product.sum() / power.sum()),
        correlation=float(_correlation(product.sum(), power.sum() * summed_power.sum())),
        excursion=np.ptp(np.cumsum(turns.turned, axis=0), axis=0),
        by_axis=_correlation(product, power * summed_power),
    )


def turn_to_reference(
    imu: ImuColumns, reference: ReferenceColumns, velocities: tuple[Floats, Floats] = NO_PAIRS
) -> Floats | None:
    """Return the constant rotation from the IMU's axes to those of the reference's attitude, (3, 3).

    Turns, gravity, and perhaps velocities of the DVL and of the reference, both (k, 3), are compared in the axes of
    both. Where these leave a turn about one axis open, it is the smallest rotation. None without attitudes.
    Source: Wahba, "A least squares estimate of satellite attitude", 1965; solved by Markley, "Attitude determination
    using vector observations and the singular value decomposition", 1988.
    """
    turns = _Turns.of(imu, reference)
    if turns is None:
        return None
    sample_s = seconds(imu.time_ns, imu.time_ns[0])
    columns = [integrated(sample_s, force, turns.time_s) for force in imu.specific_force_b.T]
    force = np.diff(np.column_stack(columns), axis=0)
    down_b = turns.mat_nb[:, 2]
    up = -0.5 * (down_b[1:] + down_b[:-1])
    near = turns.are_near
    clear = turns.are_clear
    gyros = (turns.summed[clear], turns.turned[clear])
    pairs = [gyros, (force[near], up[near]), velocities]
    total = np.zeros((3, 3))
    for ours, theirs in pairs:
        if len(ours) < ENOUGH:
            continue
        power = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
        if power > 0.0:
            total += theirs.T @ ours / power
    if np.linalg.svd(total, compute_uv=False)[1] < LEAST_SEEN:
        total += SMALLEST * np.eye(3)
    left, _, right = np.linalg.svd(total)
    return np.asarray(left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right)


def integrated(sample_s: Floats, values: Floats, at_s: Floats) -> Floats:
    """Integrate samples by trapezoids from the first to times, (k,)."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(sample_s)
    return np.asarray(np.interp(at_s, sample_s, np.concatenate([[0.0], np.cumsum(steps)])))


def _correlation(product: Floats, powers: Floats) -> Floats:
    """Divide by the root of both powers; 0 where one is 0."""
    return np.divide(product, np.sqrt(powers), out=np.zeros_like(product), where=powers > 0.0)


def gyro_by_gravity(imu: ImuColumns) -> float | None:
    """Return the scale of the gyros by the change of gravity's direction in body axes, ``du/dt = -w x u``."""
    length = samples_in(imu, 0.25)
    blocks = len(imu.time_ns) // length
    if blocks <= 2 * ENOUGH:
        return None
    starts = np.arange(0, blocks * length, length)
    whole = blocks * length
    force_b = np.add.reduceat(imu.specific_force_b[:whole], starts, axis=0) / length
    rate_b = np.add.reduceat(imu.angular_rate_b[:whole], starts, axis=0) / length
    size = np.linalg.norm(force_b, axis=1, keepdims=True)
    direction = np.divide(force_b, size, out=np.zeros_like(force_b), where=size > 0.0)
    start_ns = imu.time_ns[:whole:length]
    step_s = seconds(start_ns[1:], start_ns[:-1])
    rate = rate_b[1:] + rate_b[:-1]
    turned = -np.cross(rate, direction[1:] + direction[:-1]) / 4.0 * step_s[:, None]
    seen = np.diff(direction, axis=0)
    good = step_s < 0.5
    product = float(np.sum(turned[good] * seen[good]))
    power = float(np.sum(turned[good] ** 2))
    correlated = product**2 > 0.7**2 * power * float(np.sum(seen[good] ** 2))
    if correlated:
        return power / product
    return None


def turned_by(imu: ImuColumns, at_s: Floats, longest_s: float = np.inf) -> Floats:
    """Sum the angular rate about each axis from the first sample to times, shape (k,), s; return rad, shape (k, 3).

    Nothing is added in longer steps, since nobody saw what turned in them.
    """
    sample_s = seconds(imu.time_ns, imu.time_ns[0])
    step_s = np.diff(sample_s)
    step_s[step_s > longest_s] = 0.0
    columns = []
    for rate in imu.angular_rate_b.T:
        total = np.zeros(len(rate))
        # In place: of hours of samples each copy is large.
        turned = np.add(rate[1:], rate[:-1], out=total[1:])
        turned *= 0.5
        turned *= step_s
        np.cumsum(turned, out=turned)
        columns.append(np.interp(at_s, sample_s, total))
    return np.stack(columns, axis=1)
