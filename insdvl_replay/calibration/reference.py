"""Dives with a reference: where it sits, how it is turned and how late it is, and what it says of the DVL.

Velocities are compared in the axes of the body, each by its own attitude, so that the heading that a filter has lost
does not count; attitudes by how their difference changes from row to row, which the same heading hardly moves, and
level by its mean. Where the reference has no velocity, ways between its positions are compared, turned likewise. The
filter is run anew for whatever changes what it is told, or when it is asked; the reference is moved as
`preparation.prepared` moves it.

What the innovations said of the DVL is a measurement of its own, as sure as they are, so that the two heads are told
apart: velocities see the sum of how the reference and the DVL are turned, and innovations see the DVL alone.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.calibration import (
    MANY_TIMES,
    PLAUSIBLE_SCALE,
    PLAUSIBLE_SDS,
    Calibration,
    ReferenceCalibration,
    Refusals,
    finite_or_none,
    parameter_rows,
)
from insdvl_replay.calibration.certainty import SEEN, Certainty, differing
from insdvl_replay.calibration.fit import Fit, Linearised, scatter_of
from insdvl_replay.calibration.innovations import (
    CLOCK,
    HEADING,
    NO_CHANGE,
    PRIOR_SD,
    REFERENCE_ARM,
    REFERENCE_MOUNTING,
    SCALE,
    SHARED,
    SHARED_SD,
    SHARED_STEPS,
    DiveInnovations,
    Geometry,
    Mask,
    ReadDive,
    central_differences,
    moved_mounting,
    moved_pings,
    with_dvl,
)
from insdvl_replay.calibration.rows import ReferenceDiveRow, StartRow
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, at_time, nanoseconds, seconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.words import Estimated
from insdvl_replay.evaluation.drift import TrackFit, filter_track_fit
from insdvl_replay.evaluation.reference_errors import reference_errors
from insdvl_replay.evaluation.series import samples_in_mean
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.timeline import build_timeline
from insdvl_replay.preparation.prepared import reference_at_imu
from insdvl_replay.preparation.run import fitted_start, run_one

COUNT: Final = len(SHARED)
# Of each dive alone, where the reference has no attitude: the filter's heading, and how it drifts over the dive.
OWN: Final = 2
OF_DVL: Final = (HEADING, SCALE)  # what a reference may move of the DVL
SETTLED_S: Final = 30.0  # after the start, which hangs on the reference
APART_S: Final = 0.5  # rows of the reference that are nearer to each other would say the same
WAY_S: Final = 10.0  # between two positions: the way is longer than a fix is wrong
LATEST_CLOCK_S: Final = 1.0
LOST_HEADING_SD: Final = 10.0 * DEG
ATTITUDE, LEVEL, MOTION = 0, 1, 2  # families of rows
ROUNDS: Final = 5
# Between two samples of the IMU the attitude is interpolated, which shifts a clock by about as much on all dives.
FINEST_CLOCK_S: Final = 2e-4
# Of what the innovations said of the DVL, the reference moves scale, pitch and heading; what may be wrong of the rest
# counts in every standard deviation. Velocities just behind a ping would mistake its noise for a delay.
CONSIDERED: Final = np.array(
    [parameter.name in ("delay", "mounting_x", "arm_x", "arm_y", "arm_z") for parameter in SHARED]
)
WAY: Final = "way made good beside the reference"


# --- What a dive's reference and its baseline say of each other.


@dataclass(frozen=True)
class Compared:
    """Estimated minus reference."""

    time_s: Floats  # (k,), since the start
    family: NDArray[np.int64]  # (k,): `ATTITUDE` and `LEVEL`, rad, or `MOTION`, m/s or m
    values: Floats  # (k, 3); NaN where nothing is known
    own: Floats  # (k, 3, 2): derivative by what is the dive's own


@dataclass(frozen=True)
class ReferenceDive:
    """A dive that has a reference, with a DVL built in as its innovations said."""

    asked: DiveInnovations
    reference: ReferenceColumns  # as it was read, thinned, and inside the span however late it is
    settings: Geometry  # as configured
    change: Floats  # (8,): what the innovations said of the DVL
    gives_start: bool  # whether the filter starts from the reference's attitude

    def moved_reference(self, shared: Floats) -> ReferenceColumns:
        """Return the reference as it would be read with other settings, at the IMU."""
        settings = self.settings.changed(shared[CLOCK:])
        late = replace(self.reference, time_ns=self._times_ns(shared))
        return reference_at_imu(late, self.asked.dive.imu, np.array(settings.lever_arm_m), settings.mat_b)

    def _times_ns(self, shared: Floats) -> TimeNs:
        return np.asarray(self.reference.time_ns - nanoseconds(float(shared[CLOCK])))

    def history(self, shared: Floats) -> History:
        """Run the baseline with another DVL, and look at it at the reference's times, late as they are said to be."""
        prepared, imu, change = self.asked.prepared, self.asked.dive.imu, self.change + shared[:CLOCK]
        alignment, pings = prepared.alignment, moved_pings(prepared.velocities, change)
        timeline = build_timeline(
            imu, pings.time_ns, self._times_ns(shared), alignment.start_ns, prepared.end_ns, prepared.gaps
        )
        if self.gives_start:
            # As the reference says once it is moved: from another heading the Earth seems to turn otherwise, which a
            # good filter takes for tilt and slowness.
            late = mat_from_vector(at_time(imu.time_ns, imu.angular_rate_b, alignment.start_ns) * shared[CLOCK])
            mat_nb = alignment.start.mat_nb @ late @ mat_from_vector(-shared[REFERENCE_MOUNTING])
            alignment = replace(alignment, start=replace(alignment.start, mat_nb=mat_nb))
        mounting = moved_mounting(prepared.mounting, change)
        moved = replace(prepared, velocities=pings, mounting=mounting, alignment=alignment)
        return run_one(self.asked.filter, moved, timeline)

    def compared(self, shared: Floats, history: History | None = None) -> Compared:
        """Compare with other settings, changes of `SHARED`; ``history`` as of `history`, if it is there already."""
        history = self.history(shared) if history is None else history
        theirs = self.moved_reference(shared)
        _, ours, rows = np.intersect1d(history.time_ns, theirs.time_ns, return_indices=True)
        theirs = theirs.rows(np.isin(np.arange(len(theirs.time_ns)), rows))
        time_s = seconds(theirs.time_ns, self.asked.prepared.alignment.start_ns)
        mat_nb, parts = history.mat_nb[ours], []
        if theirs.has_attitude:
            apart = vector_from_mat(np.swapaxes(theirs.mat_nb, 1, 2) @ mat_nb)
            level = np.array([[*apart[:, :2].mean(axis=0), np.nan]])
            parts += [(ATTITUDE, time_s[1:], np.diff(apart, axis=0)), (LEVEL, time_s[:1], level)]
        own = np.zeros((sum(len(values) for _, _, values in parts), 3, OWN))
        if theirs.has_velocity:
            ours_b = np.einsum("kji,kj->ki", mat_nb, history.velocity_n[ours])
            by_heading = np.column_stack([-ours_b[:, 1], ours_b[:, 0], np.zeros(len(ours_b))])
            their_mat_nb = theirs.mat_nb if theirs.has_attitude else mat_nb
            at_s, apart = time_s, ours_b - np.einsum("kji,kj->ki", their_mat_nb, theirs.velocity_n)
        else:
            # Ways between positions, north and east.
            known = np.flatnonzero(theirs.known["positions"])
            ends = known[thinned(theirs.time_ns[known], WAY_S)]
            origin = theirs.position[ends[0]]
            ours_m, theirs_m = (
                np.column_stack(north_east_m(position[ends], origin, origin))
                for position in (history.position[ours], theirs.position)
            )
            moved_m, at_s = np.diff(ours_m, axis=0), (time_s[ends[1:]] + time_s[ends[:-1]]) / 2.0
            by_heading = np.column_stack([-moved_m[:, 1], moved_m[:, 0], np.zeros(len(moved_m))])
            apart = np.column_stack([moved_m - np.diff(theirs_m, axis=0), np.full(len(moved_m), np.nan)])
            if theirs.has_attitude:
                off = vector_from_mat(mat_nb[ends] @ np.swapaxes(theirs.mat_nb[ends], 1, 2))[:, 2]
                apart -= ((off[1:] + off[:-1]) / 2.0)[:, None] * by_heading
        parts.append((MOTION, at_s, apart))
        # An attitude of its own tells the heading that the filter has lost.
        lost = by_heading * (not theirs.has_attitude)
        drift = lost * (at_s / time_s[-1])[:, None]
        return Compared(
            np.concatenate([time for _, time, _ in parts]),
            np.concatenate([np.full(len(time), family) for family, time, _ in parts]),
            np.concatenate([values for _, _, values in parts]),
            np.concatenate([own, np.stack([lost, drift], axis=-1)]),
        )

    def jacobian(self, shared: Floats, free: Mask) -> Floats:
        """Differentiate what is compared by the free numbers, central differences, (k, 3, 15).

        The filter's attitude hangs on the DVL by little more than jumps at pings, which say nothing of how it is built
        in: attitudes are taken to be without it.
        """
        base = self.history(shared)
        compared = self.compared(shared, base)

        def values_at(tried: Floats) -> Floats:
            is_of_filter = (tried[: CLOCK + 1] != shared[: CLOCK + 1]).any()
            return self.compared(tried, None if is_of_filter else base).values

        columns = central_differences(values_at, shared, SHARED_STEPS, free, compared.values.shape)
        columns[compared.family != MOTION, :, :CLOCK] = 0.0
        return columns

    @cached_property
    def level_sd(self) -> float:
        """How far roll and pitch may be off by themselves, as the filter says, rad."""
        history = self.history(np.zeros(COUNT))
        settled = history.time_ns >= self.reference.time_ns[0]
        return float(np.sqrt(np.mean(history.sd[settled, PHI][:, :2] ** 2)))

    @cached_property
    def information_of_pings(self) -> Floats:
        """What pings of such a scatter can tell at most, of `SHARED`; zero but for the DVL's heading and scale."""
        innovations = self.asked.runner(self.change)(self.asked.filter)
        scatter, velocity_b = scatter_of(innovations.innovation), innovations.measured
        information = np.zeros(COUNT)
        information[HEADING] = np.sum((velocity_b[:, [1, 0]] / scatter[:2]) ** 2)
        information[SCALE] = np.sum((velocity_b / scatter) ** 2)
        return information

    def linearised(self, values: Floats, free: Mask) -> tuple[Floats, Linearised]:
        """Return the times, (k,), and what is compared at 17 values; each axis of each family over its scatter."""
        shared, own = values[:COUNT], values[COUNT:]
        compared = self.compared(shared)
        off = compared.values - compared.own @ own
        known, scatter = np.isfinite(off), np.ones_like(off)
        for family in np.unique(compared.family):
            rows = compared.family == family
            scatter[rows] = self.level_sd if family == LEVEL else scatter_of(np.where(known[rows], off[rows], 0.0))
        jacobian = np.concatenate([self.jacobian(shared, free), -compared.own], axis=2)
        jacobian = np.where(known[:, :, None], jacobian / scatter[:, :, None], 0.0)
        return compared.time_s, Linearised(np.where(known, off / scatter, 0.0), np.ones(3), jacobian, jacobian)

    def apart(self, shared: Floats) -> tuple[float, TrackFit]:
        """Return the rms of what velocities or ways differ by, and what would lay the track on the reference's."""
        history, reference = self.history(shared), self.moved_reference(shared)
        compared = self.compared(shared, history)
        track = filter_track_fit(reference_errors(history, reference), reference)
        return float(np.sqrt(np.nanmean(compared.values[compared.family == MOTION] ** 2))), track


def thinned(time_ns: TimeNs, apart_s: float) -> NDArray[np.int64]:
    """Choose rows of which no two are nearer to each other, (m,)."""
    chosen: list[int] = []
    row = 0
    while row < len(time_ns):
        chosen.append(row)
        row = int(np.searchsorted(time_ns, time_ns[row] + nanoseconds(apart_s)))
    return np.array(chosen, dtype=np.int64)


def reference_dive(
    asked: DiveInnovations, reference: ReferenceColumns, settings: Geometry, change: Floats, *, gives_start: bool
) -> ReferenceDive | None:
    """Get a dive ready to be compared with its reference as it was read; None where that says too little."""
    start_ns = asked.prepared.alignment.start_ns + nanoseconds(SETTLED_S)
    end_ns = asked.prepared.end_ns - nanoseconds(2.0 * LATEST_CLOCK_S)
    inside = (reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)
    if reference.has_attitude:
        inside &= reference.known["attitudes"]
    kept = reference.rows(inside & reference.known["velocities" if reference.has_velocity else "positions"])
    kept = kept.rows(np.isin(np.arange(len(kept.time_ns)), thinned(kept.time_ns, APART_S)))
    if len(kept.time_ns) < 2 or (kept.time_ns[-1] - kept.time_ns[0]) * 1e-9 < 2.0 * WAY_S:
        return None
    return ReferenceDive(asked, kept, settings, change, gives_start and reference.has_attitude)


# --- Reference and DVL fitted to each other: robust least squares of what the baseline and the reference differ by.


@dataclass(frozen=True)
class ReferenceFit(Fit):
    """An answer: changes of `SHARED`, then what is each of the n dives' own; what is `CONSIDERED` is not estimated."""

    times_s: tuple[Floats, ...]  # of each dive
    information_of_pings: Floats  # (15,), at most; zero where they are not asked

    @property
    def certainty(self) -> Certainty:
        """Three standard deviations of each of `SHARED`, as those of a calibration without reference."""
        cov, considered = solved(self, self.information)
        moved, _ = solved(self, self.squares("jacobian", 3))
        # What the prior says is one measurement of its own.
        correlated = considered + np.sum((moved / self.prior_sd) ** 2, axis=1)
        for rows, time_s, near in zip(self.rows, self.times_s, self.dives, strict=True):
            times, at = np.unique(time_s, return_inverse=True)
            scores = np.zeros((len(times), COUNT + OWN))
            np.add.at(scores, at, near.scores)
            # Parts of a sum that may be alike for a long time.
            parts = scores @ moved[rows]
            samples = np.array([max(samples_in_mean(column), 1.0) for column in parts.T])
            correlated += np.sum(parts**2, axis=0) * len(parts) / samples
        # What all pings of a dive are off by is fitted away, and no residual shows it: their scatter says how much.
        seen = np.flatnonzero(self.information_of_pings)
        correlated[seen] += 1.0 / self.information_of_pings[seen]
        correlated[CLOCK] += FINEST_CLOCK_S**2
        formal, correlated = (np.sqrt(variances)[:COUNT] for variances in (np.diag(cov) + considered, correlated))
        between = birge = np.full(COUNT, np.nan)
        if len(self.dives) > 1:
            own, own_sd = np.empty((2, len(self.dives), COUNT))
            for i in range(len(self.dives)):
                alone = self.alone(i)
                cov, considered = solved(alone, alone.information)
                own[i] = (alone.values + cov @ alone.gradient)[:COUNT]
                own_sd[i] = np.sqrt(np.diag(cov) + considered)[:COUNT]
            between, birge = differing(own, own_sd, np.ones_like(own))
        return Certainty(SHARED_SD, formal, correlated, between, birge, np.zeros(COUNT), np.zeros(COUNT))


def solved(fit: Fit, information: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of what is estimated, and the variances that what is considered adds (Schmidt).

    The first is zero, and the second the prior's, for what is considered.
    """
    considered = np.flatnonzero(CONSIDERED)
    estimated = np.setdiff1d(np.arange(len(information)), considered)
    cov, added = np.zeros_like(information), np.zeros(len(information))
    own = np.linalg.inv(information[np.ix_(estimated, estimated)])
    cov[np.ix_(estimated, estimated)] = own
    moved = own @ information[np.ix_(estimated, considered)]
    added[estimated] = np.sum((moved * fit.prior_sd[considered]) ** 2, axis=1)
    added[considered] = fit.prior_sd[considered] ** 2
    return cov, added


def fit_reference(dives: Sequence[ReferenceDive], free: Mask, shared_sd: Floats) -> ReferenceFit:
    """Find the changes of `SHARED`, known by some sds before, under which baseline and reference differ least."""
    own = COUNT + np.arange(OWN * len(dives)).reshape(-1, OWN)
    rows = tuple(np.append(np.arange(COUNT), places) for places in own)
    prior_sd = np.append(shared_sd, np.full(own.size, LOST_HEADING_SD))
    pings = np.sum([dive.information_of_pings for dive in dives], axis=0) * free

    def linearised(values: Floats) -> ReferenceFit:
        found = [dive.linearised(values[places], free) for dive, places in zip(dives, rows, strict=True)]
        times_s, near = zip(*found, strict=True)
        return ReferenceFit(rows, prior_sd, np.ones_like(values, bool), values, near, times_s, pings)

    fit = linearised(np.zeros(len(prior_sd)))
    for _ in track_progress("fitting the reference", range(ROUNDS)):
        cov, _ = solved(fit, fit.information)
        values = fit.values + cov @ fit.gradient
        values[CLOCK] = np.clip(values[CLOCK], -LATEST_CLOCK_S, LATEST_CLOCK_S)
        fit = linearised(values)
    return fit


# --- What is proposed.


def with_reference(
    found: Calibration, reads: Sequence[ReadDive], dives: Sequence[DiveInnovations], groups: Collection[str]
) -> Calibration:
    """Hold what the innovations said against the references of the same dives, and add what these show.

    Raises
    ------
    LogError
        None of the dives has a reference that says enough.
    """
    before = Geometry.of(reads[0].config.reference)
    compared: list[ReferenceDive] = []
    for i, (read, asked) in enumerate(zip(reads, dives, strict=True)):
        if read.as_read is not None:
            gives_start = read.config.initial.source == "reference"
            noisy, change = found.noise.applied(asked), found.change_of_dive(i)
            dive = reference_dive(noisy, read.as_read, before, change, gives_start=gives_start)
            compared += [dive] if dive is not None else []
    if not compared:
        raise LogError(
            "no dive has a reference to calibrate by",
            "velocities or positions are needed over a minute at least; `insdvl-replay inspect LOG` says what is there",
        )
    wanted = np.array([parameter.group in groups for parameter in SHARED])
    free = wanted.copy()
    if not all(dive.reference.has_attitude for dive in compared):
        free[REFERENCE_MOUNTING] = free[REFERENCE_ARM] = False
    # As sure as the innovations are of the DVL, but for its scale, which smoothing inside the DVL would pull.
    sds = SHARED_SD.copy()
    for row, dvl_row in enumerate(found.rows):
        if row != SCALE and dvl_row.status == Estimated.ESTIMATED and dvl_row.sd is not None:
            sds[row] = min(dvl_row.sd / SHARED[row].shown_as, PRIOR_SD[row])
    by_innovations = np.concatenate([found.change, np.zeros(COUNT - CLOCK)])
    # Once to see what is shown, and again without what is not.
    first = fit_reference(compared, free, sds)
    certainty, total = first.certainty, first.values[:COUNT] + by_innovations
    refused = dict(_refused(certainty, total, free))
    kept = free & ~np.isin(np.arange(COUNT), list(refused))
    fit = first if (kept == free).all() else fit_reference(compared, kept, sds)
    proposed = np.where(kept, fit.values[:COUNT] + by_innovations, 0.0)
    without_attitude = Estimated.HELD, "needs a reference with attitude"
    refused |= dict.fromkeys(np.flatnonzero(wanted & ~free).tolist(), without_attitude)
    rows = tuple(parameter_rows(SHARED, certainty, proposed, total, wanted, refused))
    dive_rows = tuple(_dive_row(dive, fit) for dive in compared)
    # The reference has the last word on those of the DVL's numbers that it shows.
    dvl_rows, change = list(found.rows), found.change.copy()
    for row in OF_DVL:
        if rows[row].status == Estimated.ESTIMATED:
            dvl_rows[row] = msgspec.structs.replace(rows[row], why=WAY)
            change[row] = proposed[row]
    after = found.before.changed(change)
    warnings = _warnings(certainty, kept, dive_rows, independent=reads[0].config.reference.independent)
    # The headings at the start that only positions tell, with the DVL as it is proposed.
    starts = []
    for read in reads:
        known = read.dive.reference
        if known is not None and known.has_position and not known.has_attitude:
            with suppress(LogError):
                start = fitted_start(read.dive, with_dvl(read.config, after))
                gyro = (start.gyro_bias_degph, start.gyro_bias_sd_degph)
                starts.append(StartRow(read.dive.name, start.heading_deg, start.heading_sd_deg, *gyro))
    reference = ReferenceCalibration(before, before.changed(proposed[CLOCK:]), rows[CLOCK:], dive_rows, tuple(starts))
    return replace(
        found,
        rows=tuple(dvl_rows),
        change=change,
        after=after,
        warnings=(*found.warnings, *warnings),
        reference=reference,
    )


def _refused(certainty: Certainty, change: Floats, free: Mask) -> Refusals:
    for row in np.flatnonzero(free).tolist():
        parameter = SHARED[row]
        if row < CLOCK and row not in OF_DVL:
            continue
        # First of all: at the edge what is left is no noise, and no sd right.
        if row == CLOCK and abs(change[row]) > LATEST_CLOCK_S - parameter.step:
            yield row, (Estimated.IMPLAUSIBLE, "at the edge of what is looked at: are the clocks the same?")
        elif certainty.signal_to_noise[row] < SEEN:
            yield row, (Estimated.HELD, f"needs {parameter.shown_by}")
        elif row == SCALE and abs(np.expm1(change[row])) > PLAUSIBLE_SCALE:
            yield row, (Estimated.IMPLAUSIBLE, "no sound of speed is so wrong: is the reference's velocity in m/s?")
        elif abs(change[row]) > PLAUSIBLE_SDS * parameter.prior_sd:
            yield row, (Estimated.IMPLAUSIBLE, "too far from the configuration: are axes and clocks the same?")


def _dive_row(dive: ReferenceDive, fit: ReferenceFit) -> ReferenceDiveRow:
    # Before is as configured, without what the innovations said.
    rms_before, track_before = replace(dive, change=NO_CHANGE).apart(np.zeros(COUNT))
    rms, track = dive.apart(fit.values[:COUNT])
    numbers = (track_before.scale_pct, track.scale_pct, track.scale_sd_pct)
    turns = (track_before.turn_deg, track.turn_deg, track.turn_sd_deg)
    unit = "m/s" if dive.reference.has_velocity else "m"
    count = len(dive.reference.time_ns)
    return ReferenceDiveRow(dive.asked.name, count, unit, rms_before, rms, *map(finite_or_none, (*numbers, *turns)))


def _warnings(
    certainty: Certainty, kept: Mask, dives: Sequence[ReferenceDiveRow], *, independent: bool
) -> Iterator[str]:
    if not independent:
        yield "the reference is made from the same IMU or DVL (reference.independent = false), and repeats their errors"
    for row in np.flatnonzero(kept & (np.nan_to_num(certainty.birge) > MANY_TIMES)).tolist():
        if row in OF_DVL or row >= CLOCK:
            yield (
                f"beside the reference, dives differ in {SHARED[row].name} {certainty.birge[row]:.1f} times as much as "
                "each is sure"
            )
    for dive in dives:
        left, sd = dive.track_scale_after_pct, dive.track_scale_sd_pct
        if kept[SCALE] and left is not None and sd is not None and abs(left) > PLAUSIBLE_SDS * sd:
            yield f"{dive.dive}: by its track, the scale is still off by {left:+.2f} % (sd {sd:.2f} %)"
