"""Whether the other sensors and the onboard solutions tell anything of their own, in the units of the settings.

A sensor that is stuck tells nothing, nor does one whose readings the reference is made of.
"""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.imu import warning
from insdvl_replay.core.config import Config, Depth
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ReferenceColumns,
    SensorColumns,
    SolutionColumns,
    TimeNs,
    nanoseconds,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle

_OWN_SHARE: Final = 0.5  # so many of a sensor's readings are in the reference by no accident
_SAME_RAD: Final = 1e-9  # readings that differ by less come from one message: 6 mm of latitude
_FEWEST_ALIKE: Final = 20
_ZERO_HINT: Final = "depth.surface_height_m, of depth 0 above the ellipsoid, or leave it out"

Mask = NDArray[np.bool_]


def same_instants(
    ours_ns: TimeNs, theirs_ns: TimeNs, latency_s: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair rows whose times differ by what most of them do, which may be up to half a step of theirs.

    The latency is what was taken off our times, less what was taken off theirs.
    """
    if not len(ours_ns) or not len(theirs_ns):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    ours_ns = ours_ns + nanoseconds(latency_s)
    nearest = _nearest(ours_ns, theirs_ns)
    apart_ns = ours_ns - theirs_ns[nearest]
    # A file of seconds since 1970 holds microseconds.
    ours = np.flatnonzero(np.abs(apart_ns - int(np.median(apart_ns))) <= 2_000)
    return ours, nearest[ours]


def _nearest(ours_ns: TimeNs, theirs_ns: TimeNs) -> NDArray[np.intp]:
    """Return the row of theirs that is nearest to each of our times."""
    after = np.minimum(np.searchsorted(theirs_ns, ours_ns), len(theirs_ns) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(theirs_ns[before] - ours_ns) < np.abs(theirs_ns[after] - ours_ns), before, after)


def _rows(motion: ReferenceColumns, rows: NDArray[np.intp]) -> ReferenceColumns:
    return ReferenceColumns(motion.time_ns[rows], motion.position[rows], motion.velocity_n[rows], motion.mat_nb[rows])


def sensor_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Note the sensors that are stuck, and those whose readings, with the latencies put back, are the reference's."""
    notes = []
    for name, columns in sensors.items():
        count, span_s = len(columns.time_ns), (int(columns.time_ns[-1]) - int(columns.time_ns[0])) / NS_PER_S
        alike = np.array_equal(columns.values, np.broadcast_to(columns.values[0], columns.values.shape), equal_nan=True)
        if count >= _FEWEST_ALIKE and span_s >= 30.0 and alike:  # no working sensor repeats a reading for so long
            text = (
                f"all {count} readings of the {name} are the same, over {span_s:.0f} s: it is stuck, not connected, or "
                "too coarse for how little the vehicle moves"
            )
            notes.append(warning(f"{name}_stuck", text, count, f"{name}.topic names another one"))
    for name, columns in sensors.items():
        if reference is None or name not in ("depth", "heading", "position"):
            continue
        latency_s = getattr(config, name).latency_s - config.reference.latency_s
        ours, theirs = same_instants(columns.time_ns, reference.time_ns, latency_s)
        with np.errstate(invalid="ignore"):
            same = _same_reading(name, columns.values[ours], _rows(reference, theirs))
        if (count := int(same.sum())) > _OWN_SHARE * len(columns.time_ns):
            text = f"{count} of {len(columns.time_ns)} readings of the {name} are the reference's own"
            hint = f'evaluation.held_out = ["{name}"] judges by them; filters aided by them need another reference'
            notes.append(warning(f"{name}{IS_REFERENCE}", text, count, hint))
    return tuple(notes)


def _same_reading(name: str, values: Floats, reference: ReferenceColumns) -> Mask:
    """Find the readings that are the reference's, or of a depth, whose zero is its own, the changes."""
    if name == "depth":
        ours_m, theirs_m = np.diff(values[:, 0]), -np.diff(reference.position[:, 2])
        return np.asarray((np.abs(ours_m - theirs_m) < 1e-3) & (np.abs(ours_m) > 1e-3))
    if name == "heading":
        return np.asarray(np.abs(wrap_angle(values[:, 0] - rpy_from_mat(reference.mat_nb)[:, 2])) < _SAME_RAD)
    return np.asarray((np.abs(values[:, :2] - reference.position[:, :2]) < _SAME_RAD).all(axis=1))


def solution_notes(
    solutions: Mapping[str, SolutionColumns], reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Note the onboard solutions that are the reference itself, with the latencies put back."""
    if reference is None:
        return ()
    notes = []
    for name, solution in solutions.items():
        latency_s = config.solutions[name].latency_s - config.reference.latency_s
        ours, theirs = same_instants(solution.motion.time_ns, reference.time_ns, latency_s)
        found = {
            quantity: int(_same_rows(getattr(solution.motion, field)[ours], getattr(reference, field)[theirs], least))
            for quantity, field, least in (
                ("attitudes", "mat_nb", 1e-7),
                ("velocities", "velocity_n", 1e-7),
                ("positions", "position", _SAME_RAD),
            )
        }
        if solution.way_n is not None:
            # Of positions in metres, whose origin is not known, displacements of ten seconds; at rest all are the same.
            time_ns, way_n, position = solution.motion.time_ns[ours], solution.way_n[ours], reference.position[theirs]
            later = np.searchsorted(time_ns, time_ns + 10 * NS_PER_S)
            earlier = np.flatnonzero(later < len(time_ns))
            later = later[earlier]
            ours_m = (way_n[later] - way_n[earlier])[:, :2]
            theirs_m = north_east_down_m(position[later], position[earlier])[:, :2]
            apart_m, far_m = (np.linalg.norm(rows, axis=1) for rows in (ours_m - theirs_m, theirs_m))
            found["ways"] = int(np.count_nonzero((apart_m < 1e-3) & (far_m > 0.1)))
        quantity, count = max(found.items(), key=lambda item: item[1])
        if count > max(_OWN_SHARE * len(solution.motion.time_ns), 10):
            text = (
                f"{count} of {len(solution.motion.time_ns)} {quantity} of filters.{name}.solution are the reference's"
            )
            hint = "reference.topic and reference.fix name what it is to be judged by"
            notes.append(warning(f"solution_{name}{IS_REFERENCE}", text, count, hint))
    return tuple(notes)


def _same_rows(ours: Floats, theirs: Floats, least: float) -> int:
    """Count the rows that are the same and not zero; at rest all velocities are. Of positions two components count."""
    ours, theirs = (rows[:, :2] if least == _SAME_RAD else rows.reshape(len(rows), -1) for rows in (ours, theirs))
    apart, size = (np.abs(rows).max(axis=1, initial=0.0) for rows in (ours - theirs, theirs))
    return int(np.count_nonzero((apart < least) & (size > least)))


def contradiction_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, depth: Depth
) -> tuple[Note, ...]:
    """Note the sensors that contradict the reference, which is at the IMU: in units, axes, or a zero."""
    if reference is None or not len(reference.time_ns):
        return ()
    depths: list[Note] = []
    headings: list[Note] = []
    if "heading" in sensors:
        headings += _heading_notes(*_side_by_side(sensors["heading"], reference), "reference")
    if "depth" in sensors:
        values, paired = _side_by_side(sensors["depth"], reference)
        depths += _depth_notes(values, paired, "reference", 1.0, 1.25)
        headings += () if depths else _zero_notes(values, paired, depth)
    return (*depths, *headings)


def contradiction_of_filter(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, baseline: History
) -> tuple[Note, ...]:
    """Note the sensors that do not follow a filter that is not aided by them, where the reference cannot tell."""
    compared = {innovations.measurement for innovations in baseline.innovations}
    if reference is not None:
        compared |= {"heading"} if reference.has_attitude else set()
        compared |= {"depth"} if np.isfinite(reference.position[:, 2]).any() else set()
    notes: list[Note] = []
    for name in sorted(sensors.keys() - compared - {"position"}):
        values, paired = _side_by_side(sensors[name], baseline.motion())
        if name == "heading":
            notes += _heading_notes(values, paired, "baseline")
        else:
            notes += _depth_notes(values, paired, "baseline", 2.0, 2.0)  # its height drifts
    return tuple(notes)


def depth_at_start_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, start: ReferenceColumns, config: Config
) -> tuple[Note, ...]:
    """Note a depth whose configured zero contradicts the height at the start, one row, if no reference has heights."""
    known = reference is not None and bool(reference.known["heights"].any())
    if "depth" not in sensors or known or config.depth.surface_height_m is None:
        return ()
    first = sensors["depth"].rows(np.arange(len(sensors["depth"].time_ns)) == 0)
    deeper_m = _deeper_m(first.values, start, config.depth)[0]
    late_s = (int(first.time_ns[0]) - int(start.time_ns[0])) / NS_PER_S
    sd_m = float(np.hypot(config.depth.sd_m, config.initial.position_sd_m[2]))
    # Swell and air pressure, standard deviations of both, and the fastest dive until the first reading.
    if not abs(deeper_m) > 2.0 + 5.0 * sd_m + 2.0 * late_s:
        return ()
    text = (
        f"the first depth, {late_s:.2f} s after the start, is {_below(deeper_m)} the height at the start, "
        f"{start.position[0, 2]:.2f} m"
    )
    return (warning("depth_contradiction", text, 1, f"{_ZERO_HINT}; or initial.height_m"),)


def _side_by_side(columns: SensorColumns, known: ReferenceColumns) -> tuple[Floats, ReferenceColumns]:
    """Pair the readings, shape (k, s), with the nearest rows of a solution, where one is near."""
    row = _nearest(columns.time_ns, known.time_ns)
    near = np.abs(known.time_ns[row] - columns.time_ns) <= NS_PER_S // 2
    return columns.values[near], _rows(known, row[near])


def _heading_notes(values: Floats, known: ReferenceColumns, whose: str) -> Iterator[Note]:
    off = wrap_angle(values[:, 0] - rpy_from_mat(known.mat_nb)[:, 2])
    off = off[np.isfinite(off)]
    if len(off) < _FEWEST_ALIKE:
        return
    mean = float(np.angle(np.mean(np.exp(1j * off))))
    spread = float(np.median(np.abs(wrap_angle(off - mean))))
    if spread > 20.0 * DEG:  # no compass that is turned to true north scatters so
        text = (
            f"the heading does not follow the {whose}'s: with the mean difference of {mean / DEG:+.0f} deg taken off, "
            f"half of its {len(off)} readings are still more than {spread / DEG:.0f} deg off"
        )
        hint = "heading.angle_unit, heading.axes or heading.stamp"
        yield warning("heading_contradiction", text, len(off), hint)
    elif whose == "reference" and abs(mean) > 5.0 * DEG:  # no AHRS errs by more in the mean
        text = f"the heading is {mean / DEG:+.1f} deg off the reference's, in the mean of {len(off)} readings"
        hint = "heading.declination_deg, heading.mounting_rpy_deg or heading.axes; or the reference is turned"
        yield warning("heading_contradiction", text, len(off), hint)


def _depth_notes(values: Floats, known: ReferenceColumns, whose: str, range_m: float, largest: float) -> Iterator[Note]:
    """Compare changes of depth with a solution that goes down by at least the range.

    No density makes a factor of more than the largest; feet are 3.3 times metres.
    """
    down_m = -known.position[:, 2]
    both = np.isfinite(down_m) & np.isfinite(values[:, 0])
    ours_m, theirs_m = values[both, 0], down_m[both]
    if len(ours_m) < _FEWEST_ALIKE or np.ptp(np.percentile(theirs_m, [5.0, 95.0])) < range_m:
        return
    ours_m, theirs_m = ours_m - ours_m.mean(), theirs_m - theirs_m.mean()
    product, power = float(ours_m @ theirs_m), float(theirs_m @ theirs_m)
    scale = product / power
    follows = abs(product) >= 0.9 * np.sqrt(power * float(ours_m @ ours_m))
    if follows and not 1.0 / largest < scale < largest:
        text = f"the depth changes by {scale:.3g} m for each metre that the {whose} goes down"
        hint = (
            "depth.pressure_unit or depth.density_kgpm3; depth.depth for what is positive downwards, else depth.height"
        )
        yield warning("depth_contradiction", text, len(ours_m), hint)


def _zero_notes(values: Floats, known: ReferenceColumns, depth: Depth) -> Iterator[Note]:
    if depth.surface_height_m is None:
        return
    deeper_m = _deeper_m(values, known, depth)
    deeper_m, depth_m = deeper_m[np.isfinite(deeper_m)], values[np.isfinite(deeper_m), 0]
    if len(deeper_m) < _FEWEST_ALIKE:
        return
    off_m, typical_m = float(np.median(deeper_m)), float(np.median(np.abs(depth_m)))
    if abs(off_m) > 2.0 + 0.03 * typical_m:  # swell and air pressure, and what fresh water makes of a depth
        text = f"the depth is {_below(off_m)} the reference's height, by the median of {len(deeper_m)} readings"
        yield warning("depth_contradiction", text, len(deeper_m), _ZERO_HINT)


def _deeper_m(values: Floats, known: ReferenceColumns, depth: Depth) -> Floats:
    """Return by how much the depth sensor, with its configured zero, puts the IMU below a solution, shape (k,)."""
    arm_down_m = np.nan_to_num(known.mat_nb[:, 2] @ np.array(depth.lever_arm_m))
    return np.asarray(values[:, 0] - arm_down_m - (depth.surface_height_m or 0.0) + known.position[:, 2])


def _below(deeper_m: float) -> str:
    return f"{abs(deeper_m):.2f} m {'below' if deeper_m > 0.0 else 'above'}"
