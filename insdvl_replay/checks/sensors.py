"""Whether a sensor tells anything: one that is stuck does not, nor does one whose readings the reference is made of.

One in another unit or other axes than its settings say tells what is not so.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from insdvl_replay.checks.instants import same_instants
from insdvl_replay.core.config import Config, Depth
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ReferenceColumns, SensorColumns, nanoseconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle

OWN_SHARE: Final = 0.5
"""Of a sensor's readings; so many are in the reference by no accident."""
SAME_RAD, SAME_M = 1e-9, 1e-3
"""Readings that differ by less came from one message: 6 mm of latitude, a millimetre of depth."""

ZERO_HINT: Final = "depth.surface_height_m, of depth 0 above the ellipsoid, or leave it out"

FEWEST_ALIKE, ALIKE_S = 20, 30.0
"""So many readings over so long are never the same down to the last digit where a sensor and a vehicle are at work."""

NEAR_S: Final = 0.5
"""A reading is held against what the reference says no further from it."""
HEADING_OFF, HEADING_SPREAD = 5.0 * DEG, 20.0 * DEG
"""No AHRS errs by more in the mean, and no compass that is turned to true north scatters so."""
DEPTH_RANGE_M, DEPTH_FOLLOWS, DEPTH_SCALE = 1.0, 0.9, 1.25
"""How far a vehicle has to dive for its depths to be compared, how well they have to follow, and a factor that no
density makes: feet are 3.3 times metres."""
DEPTH_OFF_M, DEPTH_OFF_SHARE, DEPTH_OFF_SDS = 2.0, 0.03, 5.0
"""What swell and air pressure do not make of a depth whose zero is told; what fresh water makes of it, as a share; and
by how many standard deviations of both it differs from the height at the start by no accident."""
SINKING_MPS: Final = 2.0
"""No vehicle goes down faster until its first reading."""
FILTER_RANGE_M, FILTER_SCALE = 2.0, 2.0
"""The same where depths are held against a filter's height, which drifts."""


def sensor_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Note the sensors that are stuck, and those whose readings, with the latencies put back, are the reference's."""
    owned = () if reference is None else _of_reference(sensors, reference, config)
    return (*_stuck(sensors), *owned)


def _stuck(sensors: Mapping[str, SensorColumns]) -> Iterator[Note]:
    for name, columns in sensors.items():
        count, span_s = len(columns.time_ns), (int(columns.time_ns[-1]) - int(columns.time_ns[0])) / NS_PER_S
        if count >= FEWEST_ALIKE and span_s >= ALIKE_S and _all_alike(columns.values):
            text = (
                f"all {count} readings of the {name} are the same, over {span_s:.0f} s: it is stuck, not connected, or "
                "too coarse for how little the vehicle moves"
            )
            yield Note(f"{name}_stuck", text, count, Severity.WARNING, f"{name}.topic names another one")


def _all_alike(values: Floats) -> bool:
    """Return whether all rows are the first, where NaN, as of a height that no fix has, is the same as NaN."""
    return np.array_equal(values, np.broadcast_to(values[0], values.shape), equal_nan=True)


def _of_reference(sensors: Mapping[str, SensorColumns], reference: ReferenceColumns, config: Config) -> Iterator[Note]:
    for name, columns in ((name, columns) for name, columns in sensors.items() if name in _SAME):
        latency_s = getattr(config, name).latency_s - config.reference.latency_s
        ours, theirs = same_instants(columns.time_ns, reference.time_ns, latency_s)
        with np.errstate(invalid="ignore"):
            same = _SAME[name](columns.values[ours], reference.rows(np.isin(np.arange(len(reference.time_ns)), theirs)))
        if (count := int(same.sum())) > OWN_SHARE * len(columns.time_ns):
            text = f"{count} of {len(columns.time_ns)} readings of the {name} are the reference's own"
            hint = f'evaluation.withheld = ["{name}"] judges by them; filters aided by them need another reference'
            yield Note(f"{name}{IS_REFERENCE}", text, count, Severity.WARNING, hint)


def _same_position(values: Floats, reference: ReferenceColumns) -> Floats:
    return np.asarray((np.abs(values[:, :2] - reference.position[:, :2]) < SAME_RAD).all(axis=1))


def _same_depth(values: Floats, reference: ReferenceColumns) -> Floats:
    """Compare how the two change: the gauge has a zero of its own."""
    ours_m, theirs_m = np.diff(values[:, 0]), -np.diff(reference.position[:, 2])
    return np.asarray((np.abs(ours_m - theirs_m) < SAME_M) & (np.abs(ours_m) > SAME_M))


def _same_heading(values: Floats, reference: ReferenceColumns) -> Floats:
    return np.asarray(np.abs(wrap_angle(values[:, 0] - rpy_from_mat(reference.mat_nb)[:, 2])) < SAME_RAD)


_SAME: Final[dict[str, Callable[[Floats, ReferenceColumns], Floats]]] = {
    "depth": _same_depth,
    "heading": _same_heading,
    "position": _same_position,
}


def contradiction_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, depth: Depth
) -> tuple[Note, ...]:
    """Note the sensors that say something else than the reference does: in other units or axes, or from another zero.

    Parameters
    ----------
    reference : ReferenceColumns or None
        At the IMU, in its axes.
    depth : Depth
        How the gauge is set.
    """
    if reference is None or not len(reference.time_ns):
        return ()
    paired = {name: _side_by_side(columns, reference) for name, columns in sensors.items() if name in _COMPARED}
    notes = [note for name, pair in paired.items() for note in _COMPARED[name](*pair)]
    if "depth" in paired and not any(note.code.startswith("depth") for note in notes):
        notes += _zero_compared(*paired["depth"], depth)
    return tuple(notes)


def depth_at_start_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, start: ReferenceColumns, config: Config
) -> tuple[Note, ...]:
    """Note a gauge whose told zero contradicts the height at the start, where no reference tells heights.

    Parameters
    ----------
    start : ReferenceColumns
        One row.
    """
    told = reference is not None and bool(reference.known["heights"].any())
    if "depth" not in sensors or told or config.depth.surface_height_m is None:
        return ()
    first = sensors["depth"].rows(np.arange(len(sensors["depth"].time_ns)) == 0)
    deeper_m = _deeper_m(first.values, start, config.depth)[0]
    late_s = (int(first.time_ns[0]) - int(start.time_ns[0])) / NS_PER_S
    sd_m = float(np.hypot(config.depth.sd_m, config.initial.position_sd_m[2]))
    if not abs(deeper_m) > DEPTH_OFF_M + DEPTH_OFF_SDS * sd_m + SINKING_MPS * late_s:
        return ()
    text = (
        f"the first depth, {late_s:.2f} s after the start, is {_below(deeper_m)} the height at the start, "
        f"{start.position[0, 2]:.2f} m"
    )
    return (_contradiction("depth", text, 1, f"{ZERO_HINT}; or initial.height_m"),)


def contradiction_of_filter(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, baseline: History
) -> tuple[Note, ...]:
    """Note the sensors that do not follow a filter that is not aided by them, where the reference cannot tell."""
    told = {
        "heading": reference is not None and reference.has_attitude,
        "depth": reference is not None and bool(np.isfinite(reference.position[:, 2]).any()),
        **{innovations.measurement: True for innovations in baseline.innovations},
    }
    return tuple(
        note
        for name, columns in sensors.items()
        if name in _OF_FILTER and not told[name]
        for note in _OF_FILTER[name](*_side_by_side(columns, baseline.motion()))
    )


def _side_by_side(columns: SensorColumns, reference: ReferenceColumns) -> tuple[Floats, ReferenceColumns]:
    """Pair the readings, shape (k, s), with the rows of the reference that are nearest to them, if any is near."""
    last = len(reference.time_ns) - 1
    after = np.searchsorted(reference.time_ns, columns.time_ns).clip(max=last)
    before = (after - 1).clip(min=0)
    is_before = columns.time_ns - reference.time_ns[before] < np.abs(reference.time_ns[after] - columns.time_ns)
    row = np.where(is_before, before, after)
    near = np.abs(reference.time_ns[row] - columns.time_ns) <= nanoseconds(NEAR_S)
    row = row[near]
    paired = ReferenceColumns(
        reference.time_ns[row], reference.position[row], reference.velocity_n[row], reference.mat_nb[row]
    )
    return columns.values[near], paired


def _heading_compared(values: Floats, reference: ReferenceColumns) -> list[Note]:
    off, mean = _headings_apart(values, reference)
    if astray := _heading_astray(off, mean, "reference"):
        return astray
    if len(off) >= FEWEST_ALIKE and abs(mean) > HEADING_OFF:
        text = f"the heading is {mean / DEG:+.1f} deg off the reference's, in the mean of {len(off)} readings"
        hint = "heading.declination_deg, heading.mounting_rpy_deg or heading.axes; or the reference is turned"
        return [_contradiction("heading", text, len(off), hint)]
    return []


def _headings_apart(values: Floats, known: ReferenceColumns) -> tuple[Floats, float]:
    """Return by how much headings differ, rad, shape (k,), and their mean."""
    off = wrap_angle(values[:, 0] - rpy_from_mat(known.mat_nb)[:, 2])
    off = off[np.isfinite(off)]
    return off, float(np.angle(np.mean(np.exp(1j * off)))) if len(off) else 0.0


def _heading_astray(off: Floats, mean: float, whose: str) -> list[Note]:
    spread = float(np.median(np.abs(wrap_angle(off - mean)))) if len(off) >= FEWEST_ALIKE else 0.0
    if spread <= HEADING_SPREAD:
        return []
    text = (
        f"the heading does not follow the {whose}'s: with the mean difference of {mean / DEG:+.0f} deg taken off, half "
        f"of its {len(off)} readings are still more than {spread / DEG:.0f} deg off"
    )
    return [_contradiction("heading", text, len(off), "heading.angle_unit, heading.axes or heading.stamp")]


def _depth_compared(values: Floats, reference: ReferenceColumns) -> list[Note]:
    return _depth_astray(values, reference, "reference", DEPTH_RANGE_M, DEPTH_SCALE)


def _zero_compared(values: Floats, reference: ReferenceColumns, depth: Depth) -> list[Note]:
    if depth.surface_height_m is None:
        return []
    deeper_m = _deeper_m(values, reference, depth)
    deeper_m, depth_m = deeper_m[np.isfinite(deeper_m)], values[np.isfinite(deeper_m), 0]
    if len(deeper_m) < FEWEST_ALIKE:
        return []
    off_m, typical_m = float(np.median(deeper_m)), float(np.median(np.abs(depth_m)))
    if abs(off_m) <= DEPTH_OFF_M + DEPTH_OFF_SHARE * typical_m:
        return []
    text = f"the depth is {_below(off_m)} the reference's height, by the median of {len(deeper_m)} readings"
    return [_contradiction("depth", text, len(deeper_m), ZERO_HINT)]


def _deeper_m(values: Floats, known: ReferenceColumns, depth: Depth) -> Floats:
    """Return by how much the gauge, its zero where it is told to be, puts the IMU below what is known, shape (k,)."""
    arm_down_m = np.nan_to_num(known.mat_nb[:, 2] @ np.array(depth.lever_arm_m))
    return np.asarray(values[:, 0] - arm_down_m - (depth.surface_height_m or 0.0) + known.position[:, 2])


def _below(deeper_m: float) -> str:
    return f"{abs(deeper_m):.2f} m {'below' if deeper_m > 0.0 else 'above'}"


def _depth_astray(values: Floats, known: ReferenceColumns, whose: str, range_m: float, largest: float) -> list[Note]:
    """Hold changes of depth against those of what is known, if it goes down by so much, and allow for such a factor."""
    down_m = -known.position[:, 2]
    both = np.isfinite(down_m) & np.isfinite(values[:, 0])
    ours_m, theirs_m = values[both, 0], down_m[both]
    if len(ours_m) < FEWEST_ALIKE or np.ptp(np.percentile(theirs_m, [5.0, 95.0])) < range_m:
        return []
    ours_m, theirs_m = ours_m - ours_m.mean(), theirs_m - theirs_m.mean()
    product, power = float(ours_m @ theirs_m), float(theirs_m @ theirs_m)
    scale = product / power
    if abs(product) < DEPTH_FOLLOWS * np.sqrt(power * float(ours_m @ ours_m)):
        return []
    if 1.0 / largest < scale < largest:
        return []
    text = f"the depth changes by {scale:.3g} m for each metre that the {whose} goes down"
    hint = "depth.pressure_unit or depth.density_kgpm3; depth.depth for what is positive downwards, else depth.height"
    return [_contradiction("depth", text, len(ours_m), hint)]


def _contradiction(name: str, text: str, count: int, hint: str) -> Note:
    return Note(f"{name}_contradiction", text, count, Severity.WARNING, hint)


def _heading_of_filter(values: Floats, motion: ReferenceColumns) -> list[Note]:
    return _heading_astray(*_headings_apart(values, motion), "baseline")


def _depth_of_filter(values: Floats, motion: ReferenceColumns) -> list[Note]:
    return _depth_astray(values, motion, "baseline", FILTER_RANGE_M, FILTER_SCALE)


_Compares = Callable[[Floats, ReferenceColumns], list[Note]]
_COMPARED: Final[dict[str, _Compares]] = {"depth": _depth_compared, "heading": _heading_compared}
_OF_FILTER: Final[dict[str, _Compares]] = {"depth": _depth_of_filter, "heading": _heading_of_filter}
