"""Dives with a reference: where it sits, how it is turned and how late it is, and what it says of the DVL."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.calibration import (
    BELIEVABLE_SCALE,
    BELIEVABLE_SDS,
    MANY_TIMES,
    Calibration,
    ReferenceCalibration,
    parameter_rows,
)
from insdvl_replay.calibration.certainty import SEEN, Certainty
from insdvl_replay.calibration.dives import ReadDive, with_geometry
from insdvl_replay.calibration.fit import Mask
from insdvl_replay.calibration.innovations import DiveInnovations
from insdvl_replay.calibration.parameters import NAMES, PRIOR_SD, SCALE, DvlGeometry
from insdvl_replay.calibration.reference_fit import ReferenceFit, fit_reference
from insdvl_replay.calibration.reference_parameters import (
    CLOCK,
    HEADING,
    LATEST_CLOCK_S,
    OF_REFERENCE,
    REFERENCE_ARM,
    REFERENCE_MOUNTING,
    SHARED,
    SHARED_SD,
    SHARED_STEPS,
    ReferenceGeometry,
)
from insdvl_replay.calibration.rows import ParameterRow, ReferenceDiveRow, StartRow
from insdvl_replay.calibration.with_reference import MOTION, ReferenceDive, reference_dive
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.drift import TrackFit, filter_track_fit
from insdvl_replay.evaluation.errors import reference_errors
from insdvl_replay.preparation.start_heading import fitted_start

OF_DVL: Final = (HEADING, SCALE)
"""What a reference may move of the DVL."""
WAY: Final = "way made good beside the reference"


def with_reference(
    found: Calibration, reads: Sequence[ReadDive], dives: Sequence[DiveInnovations], groups: Collection[str]
) -> Calibration:
    """Hold what the innovations said against the references of the dives, and add what these show.

    Parameters
    ----------
    found : Calibration
        By innovations alone.
    reads, dives : sequence
        Those that were fitted, in the same order.
    groups : collection of str
        What may be estimated, of `REFERENCE_GROUPS`.

    Raises
    ------
    LogError
        None of the dives has a reference that says enough.
    """
    before = ReferenceGeometry.of(reads[0].config.reference)
    dives = [found.noise.applied(dive) for dive in dives]
    compared = list(_compared(found, reads, dives, before))
    if not compared:
        raise LogError(
            "no dive has a reference to calibrate by",
            "velocities or positions are needed over a minute at least; `insdvl-replay inspect LOG` says what is there",
        )
    asked = np.array([parameter.group in groups for parameter in SHARED])
    has_attitude = all(dive.reference.has_attitude for dive in compared)
    free = asked.copy()
    if not has_attitude:
        free[REFERENCE_MOUNTING] = free[REFERENCE_ARM] = False
    sds = _sure_of(found)
    first = fit_reference(compared, free, sds)
    certainty, total = first.certainty, _total(found, first)
    refused = dict(_refused(certainty, total, free))
    kept = free & ~np.isin(np.arange(len(SHARED)), list(refused))
    fit = first if (kept == free).all() else fit_reference(compared, kept, sds)
    proposed = np.where(kept, _total(found, fit), 0.0)
    refused |= dict.fromkeys(
        np.flatnonzero(asked & ~free).tolist(), (Estimated.HELD, "needs a reference with attitude")
    )
    rows = tuple(parameter_rows(SHARED, certainty, proposed, total, asked, refused))
    reference = ReferenceCalibration(
        before, before.changed(proposed), rows[len(NAMES) :], tuple(_dive_rows(compared, fit))
    )
    doubts = _doubts(certainty, kept, reference, independent=reads[0].config.reference.independent)
    calibrated = _replaced(found, rows, proposed, reference, tuple(doubts))
    starts = tuple(_starts(reads, calibrated.after))
    return replace(calibrated, reference=replace(reference, starts=starts))


def _starts(reads: Sequence[ReadDive], geometry: DvlGeometry) -> Iterator[StartRow]:
    """Fit the headings at the start that only positions tell, with the DVL as it is proposed."""
    for read in reads:
        reference = read.dive.reference
        if reference is None or not reference.has_position or reference.has_attitude:
            continue
        with suppress(LogError):
            start = fitted_start(read.dive, with_geometry(read.config, geometry))
            yield StartRow(
                read.dive.name,
                start.heading_deg,
                start.heading_sd_deg,
                start.gyro_bias_degph,
                start.gyro_bias_sd_degph,
            )


def _compared(
    found: Calibration, reads: Sequence[ReadDive], dives: Sequence[DiveInnovations], before: ReferenceGeometry
) -> Iterator[ReferenceDive]:
    for i, (read, asked) in enumerate(zip(reads, dives, strict=True)):
        if read.as_read is None:
            continue
        change = found.change_of_dive(i)
        gives_start = read.config.initial.source == "reference"
        if (compared := reference_dive(asked, read.as_read, before, change, gives_start=gives_start)) is not None:
            yield compared


def _sure_of(found: Calibration) -> Floats:
    """Return how sure each of `SHARED` is before: the DVL's numbers as the innovations say, but for its scale, which
    smoothing inside the DVL would pull."""
    sds = SHARED_SD.copy()
    for row, of_row in enumerate(found.rows):
        if row != SCALE and of_row.status == Estimated.ESTIMATED and of_row.sd is not None:
            sds[row] = min(of_row.sd / SHARED[row].shown_as, PRIOR_SD[row])
    return sds


def _total(found: Calibration, fit: ReferenceFit) -> Floats:
    """Return the change from what the configuration says, shape (15,)."""
    total: Floats = fit.shared + np.concatenate([found.change, np.zeros(len(OF_REFERENCE))])
    return total


def _refused(certainty: Certainty, change: Floats, free: Mask) -> Iterator[tuple[int, tuple[Estimated, str]]]:
    for row in np.flatnonzero(free).tolist():
        parameter = SHARED[row]
        if row < len(NAMES) and row not in OF_DVL:
            continue
        # Told first: at the edge what is left is no noise, and no sd right.
        if row == CLOCK and abs(change[row]) > LATEST_CLOCK_S - float(SHARED_STEPS[CLOCK]):
            yield row, (Estimated.DOUBTFUL, "at the edge of what is looked at: are the clocks the same?")
        elif certainty.signal_to_noise[row] < SEEN:
            yield row, (Estimated.HELD, f"needs {parameter.shown_by}")
        elif row == SCALE and abs(np.expm1(change[row])) > BELIEVABLE_SCALE:
            yield row, (Estimated.DOUBTFUL, "no sound of speed is so wrong: is the reference's velocity in m/s?")
        elif abs(change[row]) > BELIEVABLE_SDS * parameter.prior_sd:
            yield row, (Estimated.DOUBTFUL, "too far from the configuration: are axes and clocks the same?")


def _replaced(
    found: Calibration,
    rows: Sequence[ParameterRow],
    proposed: Floats,
    reference: ReferenceCalibration,
    doubts: tuple[str, ...],
) -> Calibration:
    """Let the reference have the last word on those of the DVL's numbers that it shows."""
    of_dvl, change = list(found.rows), found.change.copy()
    for row in OF_DVL:
        if rows[row].status == Estimated.ESTIMATED:
            of_dvl[row] = msgspec.structs.replace(rows[row], why=WAY)
            change[row] = proposed[row]
    return replace(
        found,
        rows=tuple(of_dvl),
        change=change,
        after=found.before.changed(change),
        doubts=(*found.doubts, *doubts),
        reference=reference,
    )


def _dive_rows(dives: Sequence[ReferenceDive], fit: ReferenceFit) -> Iterator[ReferenceDiveRow]:
    for dive in dives:
        # Before is as configured, without what the innovations said.
        configured = replace(dive, change=np.zeros(len(NAMES)))
        (rms_before, track_before), (rms, track) = (
            _apart(configured, np.zeros(len(SHARED))),
            _apart(dive, fit.shared),
        )
        moves = "m/s" if dive.reference.has_velocity else "m"
        numbers = (track_before.scale_pct, track.scale_pct, track.scale_sd_pct)
        turns = (track_before.turn_deg, track.turn_deg, track.turn_sd_deg)
        yield ReferenceDiveRow(
            dive.asked.name, len(dive.reference.time_ns), moves, rms_before, rms, *map(_known, (*numbers, *turns))
        )


def _apart(dive: ReferenceDive, shared: Floats) -> tuple[float, TrackFit]:
    """Return the rms of what velocities or ways differ by, and what would lay the track on the reference's."""
    history = dive.history(shared)
    compared = dive.compared(shared, history)
    moved = compared.values[compared.family == MOTION]
    reference = dive.moved_reference(shared)
    track = filter_track_fit(reference_errors(history, reference), reference)
    return float(np.sqrt(np.nanmean(moved**2))), track


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _doubts(certainty: Certainty, kept: Mask, reference: ReferenceCalibration, *, independent: bool) -> Iterator[str]:
    if not independent:
        yield "the reference is made from the same IMU or DVL (reference.independent = false), and repeats their errors"
    for row in np.flatnonzero(kept & (np.nan_to_num(certainty.birge) > MANY_TIMES)).tolist():
        if row in OF_DVL or row >= len(NAMES):
            yield (
                f"beside the reference, dives differ in {SHARED[row].name} {certainty.birge[row]:.1f} times as much as "
                "each is sure"
            )
    for dive in reference.dives:
        left, sd = dive.track_scale_after_pct, dive.track_scale_sd_pct
        if kept[SCALE] and left is not None and sd is not None and abs(left) > BELIEVABLE_SDS * sd:
            yield f"{dive.dive}: by its track, the scale is still off by {left:+.2f} % (sd {sd:.2f} %)"
