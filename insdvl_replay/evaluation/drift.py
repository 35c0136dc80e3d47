"""Drift of each filter from the reference, fit of its track, and jumps of its position.

The position error at the end of a dive is one number; over segments only what is lost inside each counts, so that there
are many. After a long gap of the IMU there are rows of the velocity alone. Sources: Geiger, Lenz and Urtasun, "Are we
ready for autonomous driving? The KITTI vision benchmark suite", 2012, and Sturm et al., "A benchmark for the evaluation
of RGB-D SLAM systems", 2012, for relative errors; Umeyama, "Least-squares estimation of transformation parameters
between two point patterns", 1991, for track fits, which in the plane are a regression between complex numbers.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    Integers,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import (
    DRIFT_QUANTITIES,
    DRIFT_STRETCHES,
    STRETCHES,
    TRACK_FIT_QUANTITIES,
)
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import DriftRow, JumpRow, TrackFitRow
from insdvl_replay.evaluation.reference_errors import (
    SHORTEST_M,
    ReferenceErrors,
    reference_distance_m,
)
from insdvl_replay.evaluation.series import samples_in_mean, thinned
from insdvl_replay.geometry.frames import find_jumps, north_east_m, steps_of, unexplained_m

SEGMENT_S: Final = DRIFT_STRETCHES["drift_60s"].length
SEGMENT_M: Final = DRIFT_STRETCHES["drift_100m"].length
STEP_S: Final = 5.0  # Step between the starts of overlapping segments.
ABOUT: Final = 0.1  # A segment may differ by this share if the reference has no sample at its end.
ROUNDING: Final = 1e-6  # Share of a segment for rounding of sums.
SECONDS_PER_HOUR: Final = 3600.0
SLOWEST_MPS: Final = 0.1  # A slower vehicle has no course.
# A smaller step is no jump: in turns, velocities and positions of a few hertz differ by some centimetres.
SMALLEST_JUMP_M: Final = 0.5
# Residuals of tracks are averaged over this time, which leaves the drift and removes the noise of fixes.
AVERAGED_S: Final = 20.0
LEAST_AVERAGED_S: Final = 6.0  # In short dives it is less, but some fixes of 1 Hz.
FEWEST_AVERAGES: Final = 6  # From fewer there is no standard error.

Complexes = NDArray[np.complex128]


# --- Drift over segments, and velocity errors along and across the course.


class Segments(NamedTuple):
    """m pairs of the compared times, the same for all filters of a dive."""

    first: Integers  # rows of the compared times
    last: Integers


class CourseErrors(NamedTuple):
    """Horizontal velocity error along and across (to starboard of) the reference's course, shape (..., k).

    NaN where the reference has no velocity, or the vehicle is slower than `SLOWEST_MPS`.
    """

    along_mps: Floats
    across_mps: Floats


def drift_segments(name: str, time_ns: TimeNs, travelled_m: Floats) -> Segments:
    """Choose the segments of a row of `STRETCHES`."""
    stretch = STRETCHES[name]
    if stretch.unit == "s":
        return time_segments(time_ns, stretch.length)
    return distance_segments(time_ns, travelled_m, stretch.length)


def time_segments(time_ns: TimeNs, length_s: float = SEGMENT_S) -> Segments:
    """Choose overlapping segments of a length in time; none if the reference has a gap near the end."""
    return distance_segments(time_ns, seconds(time_ns, time_ns[:1]), length_s)


def distance_segments(time_ns: TimeNs, travelled: Floats, length: float = SEGMENT_M) -> Segments:
    """Pair each start with the time that is nearest to one length later, in metres travelled or seconds."""
    first = thinned(time_ns, STEP_S)
    # The rest at the end of the dive is no segment; the last segment may be short by rounding.
    first = first[travelled[first] + length <= travelled[-1:] + ROUNDING * length]
    if not len(first):
        return Segments(first, first)
    end = travelled[first] + length
    after = np.minimum(np.searchsorted(travelled, end), len(travelled) - 1)
    last = np.where(travelled[after] - end > end - travelled[after - 1], after - 1, after)
    whole = np.abs(travelled[last] - travelled[first] - length) <= ABOUT * length
    return Segments(first[whole], last[whole])


def segment_change(errors: ReferenceErrors, segments: Segments) -> Floats:
    """Return the change of the position error over each segment, without corrections, (m, 3), NED; NaN if unknown."""
    drifting_ned_m = errors.drifting_ned_m
    change_ned_m: Floats = drifting_ned_m[segments.last] - drifting_ned_m[segments.first]
    return change_ned_m


def course_errors(errors: ReferenceErrors, reference: ReferenceColumns) -> CourseErrors:
    """Turn the horizontal velocity error to the reference's course over ground."""
    velocity_n = reference.velocity_n[np.searchsorted(reference.time_ns, errors.time_ns), :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        speed_mps = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
        course = np.where(
            speed_mps[:, None] >= SLOWEST_MPS, velocity_n / speed_mps[:, None], np.nan
        )
    north_mps = errors.velocity_error_n[..., 0]
    east_mps = errors.velocity_error_n[..., 1]
    return CourseErrors(
        course[:, 0] * north_mps + course[:, 1] * east_mps,
        course[:, 0] * east_mps - course[:, 1] * north_mps,
    )


def drift_table(
    log: str,
    errors: Mapping[str, ReferenceErrors],  # by filter, of the run from the dive's own start
    reference: ReferenceColumns,
    start_ns: int,  # origin of the times of the worst error
    *,
    lost_m: float = 10.0,  # error above which a vehicle counts as lost
    bridged_gaps: bool = False,  # the filters went through long gaps of the IMU
) -> list[DriftRow]:
    """Return median, 95th percentile, rms and largest error of each filter.

    Each of `DRIFT_QUANTITIES` with numbers has a row.
    """
    sizes_of = {name: _error_sizes(found, reference) for name, found in errors.items()}
    known = set()
    for sizes in sizes_of.values():
        known |= {quantity for quantity, found in sizes.items() if np.isfinite(found.size).any()}
    rows = []
    for name, sizes in sizes_of.items():
        for quantity in DRIFT_QUANTITIES:
            is_lost = bridged_gaps and not quantity.startswith("velocity")
            if quantity not in known or is_lost:
                continue
            row = _drift_row(log, name, quantity, sizes[quantity], errors[name], start_ns)
            if quantity == "position_h" and row.samples:
                row = _with_position(
                    row, sizes[quantity], errors[name].distance_m, start_ns, lost_m
                )
            rows.append(row)
    return rows


class _ErrorSizes(NamedTuple):
    """Absolute errors in one quantity, shape (k,), with the begin and the end of the stretch of each."""

    size: Floats
    from_ns: TimeNs
    to_ns: TimeNs


def _error_sizes(errors: ReferenceErrors, reference: ReferenceColumns) -> dict[str, _ErrorSizes]:
    """Return the sizes of a filter's errors by quantity of `DRIFT_QUANTITIES`."""
    time_ns = errors.time_ns
    distance_m = np.empty(0)
    if len(time_ns):
        distance_m = reference_distance_m(reference, time_ns)
    with np.errstate(over="ignore", invalid="ignore"):
        position_m = np.hypot(*errors.position_error_ned_m[:, :2].T)
        course = course_errors(errors, reference)
        return {
            "position_h": _ErrorSizes(position_m, time_ns, time_ns),
            "drift_60s": _drift_sizes(errors, time_segments(time_ns)),
            "drift_100m": _drift_sizes(errors, distance_segments(time_ns, distance_m)),
            "velocity_along": _ErrorSizes(np.abs(course.along_mps), time_ns, time_ns),
            "velocity_across": _ErrorSizes(np.abs(course.across_mps), time_ns, time_ns),
        }


def _drift_sizes(errors: ReferenceErrors, segments: Segments) -> _ErrorSizes:
    change_ned_m = segment_change(errors, segments)
    drift_m = np.asarray(np.hypot(change_ned_m[:, 0], change_ned_m[:, 1]))
    return _ErrorSizes(drift_m, errors.time_ns[segments.first], errors.time_ns[segments.last])


def _drift_row(
    log: str, name: str, quantity: str, sizes: _ErrorSizes, errors: ReferenceErrors, start_ns: int
) -> DriftRow:
    """Return the statistics of a filter's errors in one quantity; all are NaN where no error is known."""
    row = DriftRow(
        log=log,
        filter=name,
        quantity=quantity,
        unit=DRIFT_QUANTITIES[quantity],
        samples=0,
        p50=math.nan,
        p95=math.nan,
        rms=math.nan,
        worst=math.nan,
        worst_from_s=math.nan,
        worst_to_s=math.nan,
        final=math.nan,
        distance_m=math.nan,
        final_of_distance_pct=math.nan,
        two_drms=math.nan,
        per_hour=math.nan,
        lost_pct=math.nan,
    )
    known = np.flatnonzero(np.isfinite(sizes.size))
    if not len(known):
        return row
    size = sizes.size[known]
    worst = known[np.argmax(size)]
    p50, p95 = np.quantile(size, [0.5, 0.95]).tolist()
    return structs.replace(
        row,
        samples=len(known),
        p50=p50,
        p95=p95,
        rms=_rms(size),
        worst=float(sizes.size[worst]),
        worst_from_s=(int(sizes.from_ns[worst]) - start_ns) / NS_PER_S,
        worst_to_s=(int(sizes.to_ns[worst]) - start_ns) / NS_PER_S,
        final=float(size[-1]),
        distance_m=errors.distance_m,
    )


def _with_position(
    row: DriftRow, sizes: _ErrorSizes, distance_m: float, start_ns: int, lost_m: float
) -> DriftRow:
    """Add what only the position has: 2DRMS, the share of the time in which it is lost, and rates of the final error.

    The final error is for each hour of a long dive, and in percent of a distance that is not too short.
    """
    known = np.isfinite(sizes.size)
    size_m = sizes.size[known]
    final_m = float(size_m[-1])
    hours = (int(sizes.to_ns[known][-1]) - start_ns) / NS_PER_S / SECONDS_PER_HOUR
    per_hour = math.nan
    if hours >= 1.0:
        per_hour = final_m / hours
    of_distance_pct = math.nan
    if distance_m >= SHORTEST_M:
        of_distance_pct = 100.0 * final_m / distance_m
    return structs.replace(
        row,
        final_of_distance_pct=of_distance_pct,
        two_drms=2.0 * _rms(size_m),
        per_hour=per_hour,
        lost_pct=100.0 * float(np.mean(size_m > lost_m)),
    )


def _rms(size: Floats) -> float:
    # The errors of a filter that diverged may overflow.
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(size**2)))


# --- The scale, the turn and the start that would align a filter's track with the reference's.


class TrackFit(NamedTuple):
    """Scale and turn that align the filter's track with the reference's, with standard errors; NaN where unknown."""

    scale_pct: float  # the factor minus one: positive if the filter's track is too small
    scale_sd_pct: float
    turn_deg: float  # clockwise seen from above, as a heading
    turn_sd_deg: float


UNKNOWN: Final = TrackFit(float("nan"), float("nan"), float("nan"), float("nan"))


def track_fit_table(
    log: str, errors: Mapping[str, ReferenceErrors], reference: ReferenceColumns
) -> list[TrackFitRow]:
    """Return the scale and the turn of each filter's track; no rows if the reference's track is too short."""
    rows = []
    for name, found in errors.items():
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            fit = filter_track_fit(found, reference)
        if not np.isfinite(fit.scale_pct):
            continue
        fitted = {"scale": fit.scale_pct, "turn": fit.turn_deg}
        fitted_sd = {"scale": fit.scale_sd_pct, "turn": fit.turn_sd_deg}
        for quantity, unit in TRACK_FIT_QUANTITIES.items():
            rows.append(
                TrackFitRow(
                    log=log,
                    filter=name,
                    quantity=quantity,
                    unit=unit,
                    fitted=fitted[quantity],
                    fitted_sd=fitted_sd[quantity],
                )
            )
    return rows


def filter_track_fit(errors: ReferenceErrors, reference: ReferenceColumns) -> TrackFit:
    """Fit a filter's track to the reference's at the times where they are compared."""
    position = reference.position[np.searchsorted(reference.time_ns, errors.time_ns)]
    error_m = errors.position_error_ned_m[:, :2]
    known = np.isfinite(position[:, :2]).all(axis=1) & np.isfinite(error_m).all(axis=1)
    if not known.any():
        return UNKNOWN
    origin = position[known][0]
    track_m = np.stack(north_east_m(position[known], origin, origin), axis=1)
    return track_fit(errors.time_ns[known], track_m + error_m[known], track_m)


def track_fit(
    time_ns: TimeNs,  # (k,), in order
    estimated_m: Floats,  # (k, 2), north, east
    reference_m: Floats,
) -> TrackFit:
    """Find scale, turn and shift, in closed form, that align one track with another.

    Residuals of dead reckoning wander; the standard errors come from their changes between averages, which are nearly
    independent. Noise of the reference makes them too large rather than too small. Unknown where the reference's track
    is not `SHORTEST_M` across.
    """
    if len(time_ns) < 2 or np.hypot(*np.ptp(reference_m, axis=0)) < SHORTEST_M:
        return UNKNOWN
    estimated = _about_mean(estimated_m)
    reference = _about_mean(reference_m)
    squares = float(np.sum(np.abs(estimated) ** 2))
    if squares == 0.0:
        return UNKNOWN
    similarity = complex(np.vdot(estimated, reference) / squares)
    if similarity == 0.0:
        return UNKNOWN
    weights = estimated.conj() / (squares * similarity)
    changes = _changes(time_ns, weights, reference - similarity * estimated)
    return TrackFit(
        scale_pct=100.0 * (abs(similarity) - 1.0),
        scale_sd_pct=100.0 * _sd_of_sum(changes.real),
        turn_deg=float(np.angle(similarity)) / DEG,
        turn_sd_deg=_sd_of_sum(changes.imag) / DEG,
    )


def _about_mean(track_m: Floats) -> Complexes:
    """Return a track, shape (k, 2), about its mean, as complex numbers: north, and east as the imaginary part."""
    track = np.asarray(track_m @ [1.0, 1.0j])
    return np.asarray(track - track.mean())


def _sd_of_sum(parts: Floats) -> float:
    """Return the standard deviation of a sum of parts that may be correlated with their neighbours; NaN for few."""
    if len(parts) < FEWEST_AVERAGES:
        return math.nan
    return float(np.sqrt(np.sum(parts**2) * len(parts) / samples_in_mean(parts)))


def _changes(
    time_ns: TimeNs, weights: Complexes, residuals: Complexes, length_s: float = AVERAGED_S
) -> Complexes:
    """Return the effect of each change between averaged residuals on the weighted fit, shape (..., k).

    Each change moves all that follows it, with the weight that the points behind it have in the fit.
    """
    first = thinned(time_ns, length_s)
    averages = np.add.reduceat(residuals, first) / np.diff(first, append=len(time_ns))
    behind = np.cumsum(np.add.reduceat(weights, first, axis=-1)[..., ::-1], axis=-1)[..., ::-1]
    return np.asarray(behind[..., 1:] * np.diff(averages))


class HeadingFit(NamedTuple):
    """Change of the start that aligns its track with the reference's."""

    heading: float  # rad
    heading_sd: float
    bias: float  # of the gyro about down, rad/s
    bias_sd: float


def heading_fit(
    time_ns: TimeNs,  # (k,), in order
    estimated_m: Floats,  # (k, 2), north, east
    per_heading_m: Floats,  # (k, 2), derivative of the estimated track, m/rad
    per_bias_m: Floats,  # (k, 2), m/(rad/s)
    reference_m: Floats,  # (k, 2)
    known_bias: tuple[float, float],  # the track's bias minus its prior, and the prior's sd, rad/s
    piece: Integers | None = None,  # (k,), number of the piece of the track that each time is in
) -> HeadingFit | None:
    """Fit heading and gyro bias at the start by least squares, with a scale, which is the DVL's, and shifts.

    Each piece of the track has its own shift, so that drift between two pieces does not count.

    None where the reference's track is not `SHORTEST_M` across, or too short for a standard error.
    """
    if len(time_ns) < 2 or np.hypot(*np.ptp(reference_m, axis=0)) < SHORTEST_M:
        return None
    columns = np.stack([per_heading_m, per_bias_m, estimated_m], axis=2)
    off_m = reference_m - estimated_m
    if piece is None:
        piece = np.zeros(len(time_ns), np.int64)
    for number in np.unique(piece):
        rows = piece == number
        columns[rows] -= columns[rows].mean(axis=0)
        off_m[rows] -= off_m[rows].mean(axis=0)
    weights = np.linalg.pinv(columns.reshape(-1, 3)).reshape(3, -1, 2)
    found = np.einsum("ika,ka->i", weights, off_m)
    complex_weights: Complexes = np.asarray(weights @ [1.0, -1.0j])
    residuals: Complexes = np.asarray((off_m - columns @ found) @ np.array([1.0, 1.0j]))
    # A pause of the reference fills one average, however long it is.
    filled_s = float(np.minimum(np.diff(time_ns) * 1e-9, LEAST_AVERAGED_S).sum())
    length_s = min(AVERAGED_S, max(LEAST_AVERAGED_S, filled_s / (FEWEST_AVERAGES + 1.5)))
    changes = _changes(time_ns, complex_weights, residuals, length_s).real
    if changes.shape[1] < FEWEST_AVERAGES:
        return None
    correlated = np.sqrt([len(part) / max(samples_in_mean(part), 1.0) for part in changes])
    cov = changes @ changes.T * np.outer(correlated, correlated)
    # The prior of the bias is one more measurement; the track couples it with the heading.
    exceeds, prior_sd = known_bias
    variance = float(cov[1, 1]) + prior_sd**2
    gain = cov[:2, 1] / variance
    heading, bias = (found[:2] - gain * (exceeds + found[1])).tolist()
    heading_sd, bias_sd = np.sqrt(np.diag(cov)[:2] - gain**2 * variance).tolist()
    return HeadingFit(heading, heading_sd, bias, bias_sd)


# --- Jumps.


def jump_table(
    log: str, histories: Iterable[History], motions: Mapping[str, ReferenceColumns]
) -> list[JumpRow]:
    """Count the position steps that neither the velocity nor the neighbouring steps explain, see `geometry.frames`.

    Only a filter that estimates its position, or has a recorded motion in ``motions``, can jump and has a row.
    """
    rows = []
    for history in histories:
        start_ns = int(history.time_ns[0])
        end_ns = int(history.time_ns[-1])
        if history.filter in motions:
            motion = motions[history.filter].within(start_ns, end_ns)
        elif history.estimates_position:
            motion = history.motion()
        else:
            continue
        # A repeated position counts once; all velocities are kept.
        placed = np.flatnonzero(motion.known["positions"])
        again = placed[1:][(np.diff(motion.position[placed, :2], axis=0) == 0.0).all(axis=1)]
        if len(again):
            position = motion.position.copy()
            position[again] = np.nan
            motion = replace(motion, position=position)
        unlike_m = unexplained_m(steps_of(motion))
        known = np.flatnonzero(np.isfinite(unlike_m))
        if len(known):
            largest = int(known[np.argmax(unlike_m[known])])
            at_s = (int(motion.time_ns[motion.known["positions"]][largest + 1]) - start_ns) * 1e-9
            jumps = len(find_jumps(unlike_m, SMALLEST_JUMP_M))
            rows.append(
                JumpRow(
                    log=log,
                    filter=history.filter,
                    steps=len(known),
                    jumps=jumps,
                    largest_m=float(unlike_m[largest]),
                    largest_at_s=at_s,
                )
            )
    return rows
