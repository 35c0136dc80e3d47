"""What filters lose against the reference: squared errors, one quantity at a time, from every start of a dive.

Positions are judged by how far they drift over a stretch of time or of way: their error as such is one number that a
heading wrong at the start decides. Levels and headings are judged from drawn starts alone: a filter that is set to the
reference's own attitude has nothing to find.
"""

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.evaluation.coverage import WELL_COVERED, covered_share
from insdvl_replay.evaluation.drawn_errors import DrawnErrors, side_by_side
from insdvl_replay.evaluation.drift import (
    Segments,
    course_errors,
    distance_segments,
    segment_drift,
    time_segments,
)
from insdvl_replay.evaluation.reference import ReferenceErrors
from insdvl_replay.evaluation.travelled import reference_distance_m

ROOT_2: Final = float(np.sqrt(2.0))
SEGMENTS_S: Final = (30.0, 60.0)
HEADING_FREE: Final = ("velocity_along", "depth_60s")
"""Quantities in which a heading that is off shows in the second order alone."""
OF_STARTS: Final = ("level", "heading")
"""Quantities that are judged from drawn starts alone."""
FEWEST_STARTS: Final = 8
"""With fewer, levels and headings are no evidence: each start is one sample of them."""


class ReferenceNoise(NamedTuple):
    """How far the reference itself may be off, each axis."""

    position_m: float
    velocity_mps: float
    attitude_deg: float


class Losses(NamedTuple):
    """Squared errors of one filter in one quantity."""

    unit: str
    squared: Floats  # of s starts at k times or stretches, shape (s, k), in the unit squared
    least_block: int  # so many neighbours share what they are made of
    floor: float  # root mean square up to which the reference itself may err
    own: Floats | None = None  # from the dive's own start, shape (k,); None where that is the first of the s
    span_s: tuple[float, float] = (0.0, 0.0)  # first and last time, seconds from the start


def losses_of(
    drawn: DrawnErrors, reference: ReferenceColumns, noise: ReferenceNoise, *, bridged_gaps: bool
) -> dict[str, Losses]:
    """Square the errors of one filter, by quantity of `quantities.ACCURACY`, in its order.

    What the reference knows for less than `coverage.WELL_COVERED` of the runs is left out; and so are positions after
    long gaps of the IMU, in which nothing tells where the vehicle went.
    """
    found = dict(_losses(drawn, reference, noise, bridged_gaps=bridged_gaps))
    span_s = tuple(drawn.time_s[[0, -1]].tolist()) if len(drawn.time_s) else (0.0, 0.0)
    return {
        quantity: of_one._replace(span_s=span_s) for quantity, of_one in found.items() if of_one.squared.shape[1] > 1
    }


def losses_beside(
    drawn: DrawnErrors, one: DrawnErrors, reference: ReferenceColumns, noise: ReferenceNoise, *, bridged_gaps: bool
) -> tuple[dict[str, Losses], dict[str, Losses]]:
    """Square the errors of a filter, and of a run that has one start, where and when both have any.

    Both get the same quantities, times and number of starts. The reference has to cover the filter's runs; the one run
    may be as short as it is. Levels and headings are left out: those of the filter are what is left of the errors that
    it was started with, and the one run has none of them.
    """
    before, after = (
        dict(_losses(of_one, reference, noise, bridged_gaps=bridged_gaps, covered=drawn))
        for of_one in side_by_side(drawn, one)
    )
    known = [
        quantity
        for quantity in before
        if quantity not in OF_STARTS
        and np.count_nonzero(np.isfinite(before[quantity].squared[0] + after[quantity].squared[0])) > 1
    ]
    return {quantity: before[quantity] for quantity in known}, {quantity: after[quantity] for quantity in known}


def without_heading(losses: Mapping[str, Losses]) -> dict[str, Losses]:
    """Keep what does not hang on the heading at the start: all that says something of one that was given it."""
    return {quantity: of_one for quantity, of_one in losses.items() if quantity in HEADING_FREE}


def _losses(
    drawn: DrawnErrors,
    reference: ReferenceColumns,
    noise: ReferenceNoise,
    *,
    bridged_gaps: bool,
    covered: DrawnErrors | None = None,
) -> Iterator[tuple[str, Losses]]:
    """Yield each quantity that the reference covers, in these runs or in others of the same dive."""
    runs, whole = drawn.against_reference, covered or drawn
    time_ns, covering = runs[0].time_ns, whole.against_reference[0]
    located, moving = covering.position_error_ned_m, covering.velocity_error_n
    if _is_covered(whole, located[:, :2]) and not bridged_gaps:
        for length_s in SEGMENTS_S:
            yield f"drift_{length_s:.0f}s", _drift(runs, time_segments(time_ns, length_s), noise.position_m)
        way_m = reference_distance_m(reference, time_ns)
        yield "drift_100m", _drift(runs, distance_segments(time_ns, way_m), noise.position_m)
    if _is_covered(whole, moving[:, :2]):
        of_course = [course_errors(errors, reference) for errors in runs]
        along = np.stack([errors.along_mps for errors in of_course])
        across = np.stack([errors.across_mps for errors in of_course])
        yield "velocity_along", Losses("m/s", along**2, 1, noise.velocity_mps)
        yield "velocity_across", Losses("m/s", across**2, 1, noise.velocity_mps)
    if _is_covered(whole, located[:, 2:]) and not bridged_gaps:
        segments = time_segments(time_ns)
        down_m = np.stack([segment_drift(errors, segments).down_m for errors in runs])
        yield "depth_60s", Losses("m", down_m**2, segments.steps, ROOT_2 * noise.position_m)
    if len(drawn.error) >= FEWEST_STARTS and _is_covered(whole, whole.error[0, :, PHI]):
        squared = (drawn.error[:, :, PHI] / DEG) ** 2
        for quantity, square in ("level", squared[..., :2].mean(axis=-1)), ("heading", squared[..., 2]):
            yield quantity, Losses("deg", square[1:], 1, noise.attitude_deg, square[0])


def _is_covered(drawn: DrawnErrors, columns: Floats) -> bool:
    """Return whether numbers, shape (k, n), are known for nearly all of the time."""
    time_ns = drawn.against_reference[0].time_ns
    start_ns = int(time_ns[0] - round(drawn.time_s[0] * 1e9)) if len(time_ns) else 0
    known = np.asarray(np.isfinite(columns).all(axis=1))
    return bool(known.any()) and covered_share(time_ns, known, start_ns, int(time_ns[-1])) >= WELL_COVERED


def _drift(runs: tuple[ReferenceErrors, ...], segments: Segments, sd_m: float) -> Losses:
    """Square by how much horizontal position errors change over segments; both ends are the reference's."""
    drift_m = np.stack([segment_drift(errors, segments).horizontal_m for errors in runs])
    return Losses("m", drift_m**2, segments.steps, 2.0 * sd_m)
