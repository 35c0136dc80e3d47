"""How far a filter drifts over segments of a dive, and how its velocity errs along and across the course.

The position error at the end of a dive is one number, and its rms over the dive about two independent ones. Over
segments only what is lost inside each counts, so that there are many. Sources: Geiger, Lenz and Urtasun, "Are we ready
for autonomous driving? The KITTI vision benchmark suite", 2012, and Sturm et al., "A benchmark for the evaluation of
RGB-D SLAM systems", 2012, for relative errors.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.evaluation.heading_fit import HeadingFit, heading_fit
from insdvl_replay.evaluation.jumps import jump_table
from insdvl_replay.evaluation.reference import ReferenceErrors
from insdvl_replay.evaluation.track_fit import UNKNOWN, TrackFit, filter_track_fit
from insdvl_replay.evaluation.travelled import thinned

SEGMENT_S: Final = 60.0
SEGMENT_M: Final = 100.0
STEP_S: Final = 5.0
"""From the start of a segment to that of the next, which overlaps with it."""
ABOUT: Final = 0.1
"""A segment may be longer or shorter by this share, where the reference has no sample at its end."""
ROUNDING: Final = 1e-6
"""Share of a segment that sums of speeds and steps may be short of it."""
SLOWEST_MPS: Final = 0.1
"""A slower vehicle has no course."""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Segments:
    """m pairs of the compared times, the same for all filters of a dive."""

    start_ns: TimeNs
    end_ns: TimeNs
    first: Indices  # rows of `ReferenceErrors` at the ends
    last: Indices
    steps: int  # following segments that one overlaps with: the least block of `paired_statistics.paired_ratio`


@dataclass(frozen=True)
class Drift:
    """How much a filter's position error changes over each segment. NaN where the reference or the filter has none."""

    segments: Segments
    horizontal_m: Floats  # length of the change
    down_m: Floats  # with its sign


@dataclass(frozen=True)
class CourseErrors:
    """Horizontal velocity error along and across (to starboard of) the reference's course over ground.

    NaN where the reference has no velocity, or is slower than `SLOWEST_MPS`.
    """

    along_mps: Floats
    across_mps: Floats


def time_segments(time_ns: TimeNs, length_s: float = SEGMENT_S) -> Segments:
    """Choose overlapping segments of a length in time; none where a hole of the reference is near the end."""
    return _segments(time_ns, seconds(time_ns, time_ns[0]) if len(time_ns) else np.empty(0), length_s)


def distance_segments(time_ns: TimeNs, distance_m: Floats, length_m: float = SEGMENT_M) -> Segments:
    """Choose overlapping segments of a length along the way, by the distance from `travelled.reference_distance_m`."""
    return _segments(time_ns, distance_m, length_m)


def segment_drift(errors: ReferenceErrors, segments: Segments) -> Drift:
    """Return what a filter's position error changes by over each segment, between corrections of the position."""
    change_ned_m = errors.drifting_ned_m[segments.last] - errors.drifting_ned_m[segments.first]
    return Drift(segments, np.hypot(change_ned_m[:, 0], change_ned_m[:, 1]), change_ned_m[:, 2])


def course_errors(errors: ReferenceErrors, reference: ReferenceColumns) -> CourseErrors:
    """Turn a filter's horizontal velocity error to the reference's course over ground."""
    velocity_n = reference.velocity_n[np.searchsorted(reference.time_ns, errors.time_ns), :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        speed_mps = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
        course = np.where(speed_mps[:, None] >= SLOWEST_MPS, velocity_n / speed_mps[:, None], np.nan)
    north_mps, east_mps = errors.velocity_error_n[:, :2].T
    return CourseErrors(
        course[:, 0] * north_mps + course[:, 1] * east_mps, course[:, 0] * east_mps - course[:, 1] * north_mps
    )


def _segments(time_ns: TimeNs, travelled: Floats, length: float) -> Segments:
    """Pair each start with the time whose seconds, or metres, are nearest to a length further on."""
    first = thinned(time_ns, STEP_S)
    # What remains at the end of the dive is no segment; the last may lack what rounding takes.
    first = first[travelled[first] + length <= travelled[-1:] + ROUNDING * length]
    if not len(first):
        return Segments(time_ns[:0], time_ns[:0], first, first, 1)
    end = travelled[first] + length
    after = np.minimum(np.searchsorted(travelled, end), len(travelled) - 1)
    last = np.where(travelled[after] - end > end - travelled[after - 1], after - 1, after)
    whole = np.abs(travelled[last] - travelled[first] - length) <= ABOUT * length
    first, last = first[whole], last[whole]
    # Those of a vehicle that stops on the way hold many more.
    inside = np.searchsorted(first, last) - np.arange(len(first))
    steps = max(1, int(np.ceil(np.median(inside)))) if len(first) else 1
    return Segments(time_ns[first], time_ns[last], first, last, steps)


__all__ = [
    "ABOUT",
    "ROUNDING",
    "SEGMENT_M",
    "SEGMENT_S",
    "SLOWEST_MPS",
    "STEP_S",
    "UNKNOWN",
    "CourseErrors",
    "Drift",
    "HeadingFit",
    "Indices",
    "Segments",
    "TrackFit",
    "course_errors",
    "distance_segments",
    "filter_track_fit",
    "heading_fit",
    "jump_table",
    "segment_drift",
    "time_segments",
]
