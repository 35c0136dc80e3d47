"""Checks of the other sensors and of the onboard solutions, in the units of the settings.

They find stuck sensors, and sensors and solutions whose values are the reference's own.
"""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.imu import ENOUGH
from insdvl_replay.core.config import Config, Depth
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    Mask,
    ReferenceColumns,
    SensorColumns,
    SolutionColumns,
    TimeNs,
    nanoseconds,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.notes import note
from insdvl_replay.core.of_reference import sensor_is_reference, solution_is_reference
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle

# More than this share of a sensor's readings cannot be in the reference by chance.
_SHARED: Final = 0.5
_SAME_RAD: Final = 1e-9  # readings that differ by less come from one message: 6 mm of latitude


# --- Readings that are the reference's own.


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
    since_before_ns = np.abs(theirs_ns[before] - ours_ns)
    until_after_ns = np.abs(theirs_ns[after] - ours_ns)
    return np.where(since_before_ns < until_after_ns, before, after)


def sensor_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Note the sensors that are stuck, and those whose readings, with the latencies put back, are the reference's."""
    stuck = []
    shared = []
    for name, columns in sensors.items():
        all_count = len(columns.time_ns)
        span_s = (int(columns.time_ns[-1]) - int(columns.time_ns[0])) / NS_PER_S
        # No working sensor repeats a reading for so long.
        if all_count >= ENOUGH and span_s >= 30.0 and _are_all_same(columns.values):
            stuck.append(note(f"{name}_stuck", all_count, name=name, span_s=span_s))
        if reference is None or name not in ("depth", "heading", "position"):
            continue
        latency_s = getattr(config, name).latency_s - config.reference.latency_s
        ours, theirs = same_instants(columns.time_ns, reference.time_ns, latency_s)
        with np.errstate(invalid="ignore"):
            same = _are_shared(name, columns.values[ours], reference, theirs)
        count = int(same.sum())
        if count > _SHARED * all_count:
            shared.append(note(sensor_is_reference(name), count, name=name, readings=all_count))
    return (*stuck, *shared)


def _are_all_same(values: Floats) -> bool:
    alike = np.broadcast_to(values[0], values.shape)
    return np.array_equal(values, alike, equal_nan=True)


def _are_shared(
    name: str,
    values: Floats,
    reference: ReferenceColumns,
    rows: NDArray[np.intp],
) -> Mask:
    """Find which readings of a sensor are those of some rows of the reference."""
    position = reference.position[rows]
    if name == "depth":  # the changes, since its zero is its own
        change_m = np.diff(values[:, 0])
        is_same = np.abs(change_m + np.diff(position[:, 2])) < 1e-3
        return np.asarray(is_same & (np.abs(change_m) > 1e-3))
    if name == "heading":
        heading = rpy_from_mat(reference.mat_nb[rows])[:, 2]
        return np.asarray(np.abs(wrap_angle(values[:, 0] - heading)) < _SAME_RAD)
    return np.asarray((np.abs(values[:, :2] - position[:, :2]) < _SAME_RAD).all(axis=1))


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
        motion = solution.motion
        found = {
            "attitudes": _count_shared(motion.mat_nb[ours], reference.mat_nb[theirs], 1e-7),
            "velocities": _count_shared(
                motion.velocity_n[ours], reference.velocity_n[theirs], 1e-7
            ),
            "positions": _count_shared(
                motion.position[ours, :2], reference.position[theirs, :2], _SAME_RAD
            ),
        }
        if solution.moved_n is not None:
            # Of positions in metres, whose origin is not known, displacements of ten seconds.
            time_ns = motion.time_ns[ours]
            moved_n = solution.moved_n[ours]
            position = reference.position[theirs]
            later = np.searchsorted(time_ns, time_ns + 10 * NS_PER_S)
            earlier = np.flatnonzero(later < len(time_ns))
            later = later[earlier]
            ours_m = (moved_n[later] - moved_n[earlier])[:, :2]
            theirs_m = north_east_down_m(position[later], position[earlier])[:, :2]
            apart_m = np.linalg.norm(ours_m - theirs_m, axis=1)
            far_m = np.linalg.norm(theirs_m, axis=1)
            found["ways"] = int(np.count_nonzero((apart_m < 1e-3) & (far_m > 0.1)))
        quantity, count = max(found.items(), key=lambda item: item[1])
        all_count = len(solution.motion.time_ns)
        if count > max(_SHARED * all_count, 10):
            known = {"name": name, "rows": all_count, "quantity": quantity}
            notes.append(note(f"{solution_is_reference(name)} solution", count, **known))
    return tuple(notes)


def _count_shared(ours: Floats, theirs: Floats, least: float) -> int:
    """Count the rows that are the same; at rest all velocities are zero, and such rows do not count."""
    axes = tuple(range(1, ours.ndim))
    apart = np.abs(ours - theirs).max(axis=axes, initial=0.0)
    size = np.abs(ours).max(axis=axes, initial=0.0)
    return int(np.count_nonzero((apart < least) & (size > least)))


# --- Sensors that contradict a solution, which is at the IMU: in units, axes, or a zero.


def contradiction_notes(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, depth: Depth
) -> tuple[Note, ...]:
    """Note the sensors that contradict the reference."""
    if reference is None or not len(reference.time_ns):
        return ()
    notes: list[Note] = []
    for name in ("depth", "heading"):
        if name in sensors:
            notes += _contradictions(name, sensors[name], reference, depth)
    return tuple(notes)


def contradiction_of_filter(
    sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, baseline: History
) -> tuple[Note, ...]:
    """Note the sensors that do not follow a filter that is not aided by them, where the reference cannot tell."""
    compared = {innovations.measurement for innovations in baseline.innovations} | {"position"}
    if reference is not None:
        if reference.has_attitude:
            compared.add("heading")
        if np.isfinite(reference.position[:, 2]).any():
            compared.add("depth")
    notes: list[Note] = []
    for name in sorted(sensors.keys() - compared):
        notes += _contradictions(name, sensors[name], baseline.motion(), None)
    return tuple(notes)


def _contradictions(
    name: str,
    columns: SensorColumns,
    known: ReferenceColumns,
    zero: Depth | None,
) -> Iterator[Note]:
    """Compare readings with the nearest rows of the reference, or, without ``zero``, of the baseline."""
    row = _nearest(columns.time_ns, known.time_ns)
    near = np.abs(known.time_ns[row] - columns.time_ns) <= NS_PER_S // 2
    values = columns.values[near]
    row = row[near]
    if name == "heading":
        off = wrap_angle(values[:, 0] - rpy_from_mat(known.mat_nb[row])[:, 2])
        yield from _heading_contradictions(off[np.isfinite(off)], zero)
    else:
        both = np.isfinite(known.position[row, 2]) & np.isfinite(values[:, 0])
        row = row[both]
        yield from _depth_contradictions(
            values[both], known.mat_nb[row], known.position[row], zero
        )


def _whose(zero: Depth | None) -> str:
    return "baseline" if zero is None else "reference"


def _heading_contradictions(off: Floats, zero: Depth | None) -> Iterator[Note]:
    """Note differences between headings, rad, that are too large, or scatter too much."""
    if len(off) < ENOUGH:
        return
    mean = float(np.angle(np.mean(np.exp(1j * off))))
    spread = float(np.median(np.abs(wrap_angle(off - mean))))
    if spread > 20.0 * DEG:  # no compass that is turned to true north scatters so
        spreads = {"mean_deg": mean / DEG, "spread_deg": spread / DEG}
        yield note("heading_contradiction", len(off), whose=_whose(zero), **spreads)
    elif zero is not None and abs(mean) > 5.0 * DEG:  # no AHRS errs by more in the mean
        yield note("heading_contradiction mean", len(off), mean_deg=mean / DEG)


def _depth_contradictions(
    values: Floats,
    mat_nb: Floats,
    position: Floats,
    zero: Depth | None,
) -> Iterator[Note]:
    """Note depths that change unlike the height of a solution, or have another zero."""
    ours_m = values[:, 0]
    if len(ours_m) < ENOUGH:
        return
    scale = _scale_of_depth(ours_m, -position[:, 2], zero)
    if scale is not None:
        yield note("depth_contradiction", len(ours_m), scale=scale, whose=_whose(zero))
        return
    if zero is None or zero.surface_height_m is None:
        return
    off_m = float(np.median(_deeper_m(values, mat_nb, position, zero)))
    # Swell and air pressure, and what fresh water makes of a depth.
    if abs(off_m) > 2.0 + 0.03 * float(np.median(np.abs(ours_m))):
        yield note("depth_contradiction zero", len(ours_m), below=_below(off_m))


def _scale_of_depth(ours_m: Floats, theirs_m: Floats, zero: Depth | None) -> float | None:
    """Return the scale of changes of depth, where it is none that a density can make; else None."""
    # Where the solution goes down far enough: the height of a baseline drifts. Feet are 3.3 times metres.
    range_m = 2.0 if zero is None else 1.0
    largest = 2.0 if zero is None else 1.25
    if np.ptp(np.percentile(theirs_m, [5.0, 95.0])) < range_m:
        return None
    down_m = ours_m - ours_m.mean()
    theirs_m = theirs_m - theirs_m.mean()
    product = float(down_m @ theirs_m)
    power = float(theirs_m @ theirs_m)
    scale = product / power
    follows = abs(product) >= 0.9 * np.sqrt(power * float(down_m @ down_m))
    if follows and not 1.0 / largest < scale < largest:
        return scale
    return None


def depth_at_start_notes(
    sensors: Mapping[str, SensorColumns],
    reference: ReferenceColumns | None,
    start: ReferenceColumns,
    config: Config,
) -> tuple[Note, ...]:
    """Note a depth whose configured zero contradicts the height at the start, one row, if no reference has heights."""
    known = reference is not None and bool(reference.known["heights"].any())
    if "depth" not in sensors or known or config.depth.surface_height_m is None:
        return ()
    first = sensors["depth"]
    deeper_m = _deeper_m(first.values[:1], start.mat_nb, start.position, config.depth)[0]
    late_s = (int(first.time_ns[0]) - int(start.time_ns[0])) / NS_PER_S
    sd_m = float(np.hypot(config.depth.sd_m, config.initial.position_sd_m[2]))
    # Swell and air pressure, standard deviations of both, and the fastest dive until the first reading.
    if not abs(deeper_m) > 2.0 + 5.0 * sd_m + 2.0 * late_s:
        return ()
    found = {"late_s": late_s, "below": _below(deeper_m), "height_m": start.position[0, 2]}
    return (note("depth_contradiction start", 1, **found),)


def _deeper_m(
    values: Floats,
    mat_nb: Floats,
    position: Floats,
    depth: Depth,
) -> Floats:
    """Return by how much the depth sensor, with its configured zero, puts the IMU below a solution, shape (k,)."""
    arm_down_m = np.nan_to_num(mat_nb[:, 2] @ np.array(depth.lever_arm_m))
    return np.asarray(values[:, 0] - arm_down_m - (depth.surface_height_m or 0.0) + position[:, 2])


def _below(deeper_m: float) -> str:
    return f"{abs(deeper_m):.2f} m {'below' if deeper_m > 0.0 else 'above'}"
