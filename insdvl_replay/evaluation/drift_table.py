"""How far each filter is from the reference half of the time, nearly always and at worst, and how its track would fit.

All are of the run from the dive's own start. Where the filters went through a long gap of the IMU, nothing tells where
the vehicle went meanwhile: there are rows of the velocity alone.
"""

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.quantities import DRIFT_QUANTITIES, TRACK_FIT_QUANTITIES
from insdvl_replay.core.tables import DriftRow, TrackFitRow
from insdvl_replay.evaluation.drift import (
    Segments,
    course_errors,
    distance_segments,
    segment_drift,
    time_segments,
)
from insdvl_replay.evaluation.reference import SHORTEST_M, ReferenceErrors
from insdvl_replay.evaluation.track_fit import filter_track_fit
from insdvl_replay.evaluation.travelled import reference_distance_m

OF_POSITION: Final = ("position_h", "drift_60s", "drift_100m")
"""Quantities that keep what went wrong in a gap of the IMU."""


class _Sizes(NamedTuple):
    """Sizes of errors, shape (m,), and the times between which each arose; NaN where there is none."""

    size: Floats
    from_ns: TimeNs
    to_ns: TimeNs


def drift_table(
    log: str,
    errors: Mapping[str, ReferenceErrors],
    reference: ReferenceColumns,
    start_ns: int,
    *,
    bridged_gaps: bool = False,
) -> list[DriftRow]:
    """State how large the errors of each filter are: as many of `DRIFT_QUANTITIES` as the dive gives numbers for.

    The times of the worst count from ``start_ns``. ``bridged_gaps``: the filters went through long gaps of the IMU.
    """
    found = {name: _sizes(of_one, reference) for name, of_one in errors.items()}
    known = [
        quantity
        for quantity in DRIFT_QUANTITIES
        if not (bridged_gaps and quantity in OF_POSITION)
        and any(np.isfinite(sizes[quantity].size).any() for sizes in found.values())
    ]
    return [
        _row((log, name, quantity), sizes[quantity], start_ns, errors[name].distance_m)
        for name, sizes in found.items()
        for quantity in known
    ]


def _sizes(errors: ReferenceErrors, reference: ReferenceColumns) -> dict[str, _Sizes]:
    time_ns = errors.time_ns
    way_m = reference_distance_m(reference, time_ns) if len(time_ns) else np.empty(0)
    with np.errstate(over="ignore", invalid="ignore"):
        course = course_errors(errors, reference)
        position_m = np.hypot(errors.position_error_ned_m[:, 0], errors.position_error_ned_m[:, 1])
        return {
            "position_h": _Sizes(position_m, time_ns, time_ns),
            "drift_60s": _drift(errors, time_segments(time_ns)),
            "drift_100m": _drift(errors, distance_segments(time_ns, way_m)),
            "velocity_along": _Sizes(np.abs(course.along_mps), time_ns, time_ns),
            "velocity_across": _Sizes(np.abs(course.across_mps), time_ns, time_ns),
        }


def _drift(errors: ReferenceErrors, segments: Segments) -> _Sizes:
    return _Sizes(segment_drift(errors, segments).horizontal_m, segments.start_ns, segments.end_ns)


def _row(named: tuple[str, str, str], sizes: _Sizes, start_ns: int, distance_m: float) -> DriftRow:
    known, unit, nan = np.flatnonzero(np.isfinite(sizes.size)), DRIFT_QUANTITIES[named[2]], float("nan")
    if not len(known):
        return DriftRow(*named, unit, 0, *[nan] * 9)
    size = sizes.size[known]
    p50, p95 = np.quantile(size, [0.5, 0.95]).tolist()
    with np.errstate(over="ignore"):
        rms = float(np.sqrt(np.mean(size**2)))
    worst = known[np.argmax(size)]
    from_s, to_s = ((int(ends_ns[worst]) - start_ns) / NS_PER_S for ends_ns in (sizes.from_ns, sizes.to_ns))
    final = float(size[-1])
    final_pct = 100.0 * final / distance_m if named[2] == "position_h" and distance_m >= SHORTEST_M else nan
    largest = float(sizes.size[worst]), from_s, to_s
    return DriftRow(*named, unit, len(known), p50, p95, rms, *largest, final, distance_m, final_pct)


def track_fit_table(log: str, errors: Mapping[str, ReferenceErrors], reference: ReferenceColumns) -> list[TrackFitRow]:
    """State the scale and the turn that would align each filter's track with the reference's.

    There are no rows where no track of the reference is long enough.
    """
    return [row for name, of_one in errors.items() for row in _fit(log, name, of_one, reference)]


def _fit(log: str, name: str, errors: ReferenceErrors, reference: ReferenceColumns) -> Iterator[TrackFitRow]:
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        fit = filter_track_fit(errors, reference)
    numbers = {"scale": (fit.scale_pct, fit.scale_sd_pct), "turn": (fit.turn_deg, fit.turn_sd_deg)}
    if np.isfinite(fit.scale_pct):
        for quantity, unit in TRACK_FIT_QUANTITIES.items():
            yield TrackFitRow(log, name, quantity, unit, *numbers[quantity])
