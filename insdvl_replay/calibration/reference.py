"""Calibrate the reference (lever arm, mounting, delay), and the DVL with its help.

Velocities are compared in body axes, each with its own attitude, so that the heading error of a filter does not count.
Attitudes are compared by the change of their difference from row to row, on which a constant heading error has little
effect; level by the mean difference. Without a velocity in the reference, displacements between its positions are
compared, turned in the same way. The filter runs again for each change of its inputs or output times. The reference is
moved as in `preparation.prepared`.

The result from the innovations is a prior for the DVL, with its sds. This separates the two mountings: velocities
depend on the sum of the mountings of reference and DVL, innovations only on that of the DVL.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import msgspec
import numpy as np

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
    ReadDive,
    central_differences,
    moved_mounting,
    moved_pings,
    with_dvl,
)
from insdvl_replay.calibration.rows import ReferenceDiveRow, StartRow
from insdvl_replay.core.dive_columns import (
    Floats,
    Integers,
    Mask,
    ReferenceColumns,
    TimeNs,
    at_time,
    nanoseconds,
    seconds,
)
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
# Unknowns of each dive, if the reference has no attitude: heading error of the filter, and its drift.
OWN: Final = 2
OF_DVL: Final = (HEADING, SCALE)  # parameters of the DVL that a reference may change
SETTLED_S: Final = 30.0  # after the start, which depends on the reference
APART_S: Final = 0.5  # least time between reference rows; closer rows add nothing
WAY_S: Final = 10.0  # between two positions: the displacement is larger than the error of a fix
LATEST_CLOCK_S: Final = 1.0
LOST_HEADING_SD: Final = 10.0 * DEG
# families of rows
ATTITUDE: Final = 0
LEVEL: Final = 1
MOTION: Final = 2
ROUNDS: Final = 5
# While the clock still moves. Attitudes in turns are outliers until it is right to some 10 ms, so it moves slowly
# beside a filter whose headings are hardly noisy.
MOST_ROUNDS: Final = 20
# The attitude is interpolated between IMU samples, which shifts the clock by about this on all dives.
FINEST_CLOCK_S: Final = 2e-4
# The reference changes scale, pitch and heading of the DVL. Errors of its other parameters count in every standard
# deviation. Velocities just after a ping would take its noise for a delay.
CONSIDERED: Final = np.array(
    [parameter.name in ("delay", "mounting_x", "arm_x", "arm_y", "arm_z") for parameter in SHARED]
)
WAY: Final = "distance travelled, compared with the reference"


# --- Compare a dive's baseline with its reference.


@dataclass(frozen=True)
class Compared:
    """Estimated minus reference."""

    time_s: Floats  # (k,), since the start
    family: Integers  # (k,): `ATTITUDE` and `LEVEL`, rad, or `MOTION`, m/s or m
    values: Floats  # (k, 3); NaN if unknown
    own: Floats  # (k, 3, 2): derivative by the dive's own unknowns


@dataclass(frozen=True)
class ReferenceDive:
    """A dive with a reference, and with the geometry of the DVL from its innovations."""

    asked: DiveInnovations
    reference: ReferenceColumns  # as it was read, thinned, and inside the span for any delay
    settings: Geometry  # as configured
    change: Floats  # (8,): change of the DVL's geometry from the innovations
    gives_start: bool  # whether the filter starts from the reference's attitude

    def moved_reference(self, shared: Floats) -> ReferenceColumns:
        """Return the reference at the IMU, read with other settings."""
        settings = self.settings.changed(shared[CLOCK:])
        late = replace(self.reference, time_ns=self._times_ns(shared))
        return reference_at_imu(
            late, self.asked.dive.imu, np.array(settings.lever_arm_m), settings.mat_b
        )

    def _times_ns(self, shared: Floats) -> TimeNs:
        return np.asarray(self.reference.time_ns - nanoseconds(float(shared[CLOCK])))

    def history(self, shared: Floats) -> History:
        """Run the baseline with another DVL geometry, with rows at the delayed times of the reference."""
        prepared = self.asked.prepared
        imu = self.asked.dive.imu
        change = self.change + shared[:CLOCK]
        alignment = prepared.alignment
        pings = moved_pings(prepared.velocities, change)
        timeline = build_timeline(
            imu,
            pings.time_ns,
            self._times_ns(shared),
            alignment.start_ns,
            prepared.end_ns,
            prepared.gaps,
        )
        if self.gives_start:
            # Use the attitude of the moved reference. With another heading the Earth rate would be in other axes,
            # which a good filter takes for tilt and velocity. The start is uncertain by its mounting and delay, too,
            # which are looked for here. Its own scatter, which may be much smaller, does not show them.
            late = mat_from_vector(
                at_time(imu.time_ns, imu.angular_rate_b, alignment.start_ns) * shared[CLOCK]
            )
            mat_nb = alignment.start.mat_nb @ late @ mat_from_vector(-shared[REFERENCE_MOUNTING])
            alignment = replace(alignment, start=replace(alignment.spread_start, mat_nb=mat_nb))
        mounting = moved_mounting(prepared.mounting, change)
        moved = replace(prepared, velocities=pings, mounting=mounting, alignment=alignment)
        return run_one(self.asked.filter, moved, timeline)

    def compared(self, shared: Floats, history: History | None = None) -> Compared:
        """Compare with other settings, changes of `SHARED`; ``history`` is that of `history`, if it is known."""
        history = self.history(shared) if history is None else history
        theirs = self.moved_reference(shared)
        _, ours, rows = np.intersect1d(history.time_ns, theirs.time_ns, return_indices=True)
        theirs = theirs.rows(np.isin(np.arange(len(theirs.time_ns)), rows))
        time_s = seconds(theirs.time_ns, self.asked.prepared.alignment.start_ns)
        mat_nb = history.mat_nb[ours]
        families: list[Compared] = []
        if theirs.has_attitude:
            families += _attitudes(time_s, mat_nb, theirs)
        if theirs.has_velocity:
            families.append(_velocities(time_s, mat_nb, history.velocity_n[ours], theirs))
        else:
            families.append(_displacements(time_s, mat_nb, history.position[ours], theirs))
        return Compared(
            np.concatenate([family.time_s for family in families]),
            np.concatenate([family.family for family in families]),
            np.concatenate([family.values for family in families]),
            np.concatenate([family.own for family in families]),
        )

    def jacobian(self, shared: Floats, free: Mask) -> Floats:
        """Differentiate what is compared by the free numbers, central differences, (k, 3, 15).

        The filter's attitude depends on the DVL mainly by steps at pings, which say nothing about its geometry. So the
        derivative of attitudes by the DVL's parameters is taken as zero.
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
        """Sd of roll and pitch from the filter, rad."""
        history = self.history(np.zeros(COUNT))
        settled = history.time_ns >= self.reference.time_ns[0]
        return float(np.sqrt(np.mean(history.sd[settled, PHI][:, :2] ** 2)))

    @cached_property
    def information_of_pings(self) -> Floats:
        """Upper limit of the pings' information on `SHARED`; zero except for heading and scale."""
        innovations = self.asked.runner(self.change)(self.asked.filter)
        scatter = scatter_of(innovations.innovation)
        velocity_b = innovations.measured
        information = np.zeros(COUNT)
        information[HEADING] = np.sum((velocity_b[:, [1, 0]] / scatter[:2]) ** 2)
        information[SCALE] = np.sum((velocity_b / scatter) ** 2)
        return information

    def linearised(self, values: Floats, free: Mask) -> tuple[Floats, Linearised]:
        """Return times, (k,), and the linearised comparison at 17 values; each axis of a family over its scatter."""
        shared = values[:COUNT]
        own = values[COUNT:]
        compared = self.compared(shared)
        off = compared.values - compared.own @ own
        known = np.isfinite(off)
        scatter = np.ones_like(off)
        for family in np.unique(compared.family):
            rows = compared.family == family
            if family == LEVEL:
                scatter[rows] = self.level_sd
            else:
                scatter[rows] = scatter_of(np.where(known[rows], off[rows], 0.0))
        jacobian = np.concatenate([self.jacobian(shared, free), -compared.own], axis=2)
        jacobian = np.where(known[:, :, None], jacobian / scatter[:, :, None], 0.0)
        return compared.time_s, Linearised(
            np.where(known, off / scatter, 0.0), np.ones(3), jacobian, jacobian
        )

    def apart(self, shared: Floats) -> tuple[float, TrackFit]:
        """Return the rms difference of velocities or displacements, and the track fit."""
        history = self.history(shared)
        reference = self.moved_reference(shared)
        compared = self.compared(shared, history)
        track = filter_track_fit(reference_errors(history, reference), reference)
        return float(np.sqrt(np.nanmean(compared.values[compared.family == MOTION] ** 2))), track


def _attitudes(time_s: Floats, mat_nb: Floats, theirs: ReferenceColumns) -> Iterator[Compared]:
    """Compare the changes of the difference of attitudes from row to row, and level by its mean."""
    apart = vector_from_mat(np.swapaxes(theirs.mat_nb, 1, 2) @ mat_nb)
    level = np.array([[*apart[:, :2].mean(axis=0), np.nan]])
    yield _of_family(ATTITUDE, time_s[1:], np.diff(apart, axis=0))
    yield _of_family(LEVEL, time_s[:1], level)


def _velocities(
    time_s: Floats,
    mat_nb: Floats,
    velocity_n: Floats,
    theirs: ReferenceColumns,
) -> Compared:
    """Compare velocities in body axes, each with its own attitude."""
    ours_b = np.einsum("kji,kj->ki", mat_nb, velocity_n)
    their_mat_nb = theirs.mat_nb if theirs.has_attitude else mat_nb
    apart = ours_b - np.einsum("kji,kj->ki", their_mat_nb, theirs.velocity_n)
    own = _by_heading(ours_b, time_s, time_s[-1], theirs)
    return _of_family(MOTION, time_s, apart, own)


def _displacements(
    time_s: Floats,
    mat_nb: Floats,
    position: Floats,
    theirs: ReferenceColumns,
) -> Compared:
    """Compare displacements between positions, north and east."""
    known = np.flatnonzero(theirs.known["positions"])
    ends = known[thinned(theirs.time_ns[known], WAY_S)]
    origin = theirs.position[ends[0]]
    moved_m = np.diff(np.column_stack(north_east_m(position[ends], origin, origin)), axis=0)
    theirs_m = np.column_stack(north_east_m(theirs.position[ends], origin, origin))
    at_s = (time_s[ends[1:]] + time_s[ends[:-1]]) / 2.0
    unknown_down = np.full(len(moved_m), np.nan)
    apart = np.column_stack([moved_m - np.diff(theirs_m, axis=0), unknown_down])
    if theirs.has_attitude:
        off = vector_from_mat(mat_nb[ends] @ np.swapaxes(theirs.mat_nb[ends], 1, 2))[:, 2]
        apart -= ((off[1:] + off[:-1]) / 2.0)[:, None] * _turned_by_heading(moved_m)
    return _of_family(MOTION, at_s, apart, _by_heading(moved_m, at_s, time_s[-1], theirs))


def _by_heading(
    moved: Floats,
    at_s: Floats,
    end_s: float,
    theirs: ReferenceColumns,
) -> Floats:
    """Return the derivative of motion by the heading error of the filter and by its drift, (k, 3, 2).

    It is 0 where the reference has an attitude, which gives the heading error.
    """
    lost = _turned_by_heading(moved) * (not theirs.has_attitude)
    drift = lost * (at_s / end_s)[:, None]
    return np.stack([lost, drift], axis=-1)


def _turned_by_heading(moved: Floats) -> Floats:
    return np.column_stack([-moved[:, 1], moved[:, 0], np.zeros(len(moved))])


def _of_family(
    family: int,
    time_s: Floats,
    values: Floats,
    own: Floats | None = None,
) -> Compared:
    """Compare rows of one family; the dive's own unknowns change them only where that is given."""
    if own is None:
        own = np.zeros((len(values), 3, OWN))
    return Compared(time_s, np.full(len(time_s), family), values, own)


def thinned(time_ns: TimeNs, apart_s: float) -> Integers:
    """Choose rows that are at least this time apart, (m,)."""
    chosen: list[int] = []
    row = 0
    while row < len(time_ns):
        chosen.append(row)
        row = int(np.searchsorted(time_ns, time_ns[row] + nanoseconds(apart_s)))
    return np.array(chosen, dtype=np.int64)


def reference_dive(
    asked: DiveInnovations,
    reference: ReferenceColumns,
    settings: Geometry,
    change: Floats,
    *,
    gives_start: bool,
) -> ReferenceDive | None:
    """Prepare a dive for the comparison with its reference; None if the reference is too short."""
    start_ns = asked.prepared.alignment.start_ns + nanoseconds(SETTLED_S)
    end_ns = asked.prepared.end_ns - nanoseconds(2.0 * LATEST_CLOCK_S)
    inside = (reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)
    if reference.has_attitude:
        inside &= reference.known["attitudes"]
    motion = "velocities" if reference.has_velocity else "positions"
    kept = reference.rows(inside & reference.known[motion])
    kept = kept.rows(np.isin(np.arange(len(kept.time_ns)), thinned(kept.time_ns, APART_S)))
    if len(kept.time_ns) < 2 or (kept.time_ns[-1] - kept.time_ns[0]) * 1e-9 < 2.0 * WAY_S:
        return None
    return ReferenceDive(asked, kept, settings, change, gives_start and reference.has_attitude)


# --- Fit of reference and DVL: robust least squares of the differences of baseline and reference.


@dataclass(frozen=True)
class ReferenceFit(Fit):
    """A solution: changes of `SHARED`, then the unknowns of each of the n dives. `CONSIDERED` is not estimated."""

    times_s: tuple[Floats, ...]  # of each dive
    information_of_pings: Floats  # (15,), at most; zero for parameters that are not requested

    @property
    def certainty(self) -> Certainty:
        """Three standard deviations of each of `SHARED`, as for a calibration without reference."""
        cov, considered = solved(self, self.information)
        moved, _ = solved(self, self.squares("jacobian", 3))
        # The prior is one separate measurement.
        correlated = considered + np.sum((moved / self.prior_sd) ** 2, axis=1)
        for rows, time_s, near in zip(self.rows, self.times_s, self.dives, strict=True):
            times, at = np.unique(time_s, return_inverse=True)
            scores = np.zeros((len(times), COUNT + OWN))
            np.add.at(scores, at, near.scores)
            # Parts of a sum that may be correlated for a long time.
            parts = scores @ moved[rows]
            samples = np.array([max(samples_in_mean(column), 1.0) for column in parts.T])
            correlated += np.sum(parts**2, axis=0) * len(parts) / samples
        # A common error of all pings of a dive is fitted away and not in residuals. Their scatter gives its size.
        seen = np.flatnonzero(self.information_of_pings)
        correlated[seen] += 1.0 / self.information_of_pings[seen]
        correlated[CLOCK] += FINEST_CLOCK_S**2
        formal = np.sqrt(np.diag(cov) + considered)[:COUNT]
        correlated = np.sqrt(correlated)[:COUNT]
        between, birge = self._between_dives()
        return Certainty(
            SHARED_SD, formal, correlated, between, birge, np.zeros(COUNT), np.zeros(COUNT)
        )

    def _between_dives(self) -> tuple[Floats, Floats]:
        """Return the sd by how the dives differ, and the Birge ratio; NaN for one dive."""
        count = len(self.dives)
        if count < 2:
            unknown = np.full(COUNT, np.nan)
            return unknown, unknown
        own = np.empty((count, COUNT))
        own_sd = np.empty((count, COUNT))
        for i in range(count):
            alone = self.alone(i)
            cov, considered = solved(alone, alone.information)
            own[i] = (alone.values + cov @ alone.gradient)[:COUNT]
            own_sd[i] = np.sqrt(np.diag(cov) + considered)[:COUNT]
        return differing(own, own_sd, np.ones_like(own))


def solved(fit: Fit, information: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of the estimated parameters, and the variances that considered ones add (Schmidt).

    For considered parameters the first is zero, and the second is the prior's.
    """
    considered = np.flatnonzero(CONSIDERED)
    estimated = np.setdiff1d(np.arange(len(information)), considered)
    cov = np.zeros_like(information)
    added = np.zeros(len(information))
    own = np.linalg.inv(information[np.ix_(estimated, estimated)])
    cov[np.ix_(estimated, estimated)] = own
    moved = own @ information[np.ix_(estimated, considered)]
    added[estimated] = np.sum((moved * fit.prior_sd[considered]) ** 2, axis=1)
    added[considered] = fit.prior_sd[considered] ** 2
    return cov, added


def fit_reference(dives: Sequence[ReferenceDive], free: Mask, shared_sd: Floats) -> ReferenceFit:
    """Find the changes of `SHARED` for the least difference of baseline and reference, with ``shared_sd`` as prior."""
    own = COUNT + np.arange(OWN * len(dives)).reshape(-1, OWN)
    rows = tuple(np.append(np.arange(COUNT), places) for places in own)
    prior_sd = np.append(shared_sd, np.full(own.size, LOST_HEADING_SD))
    pings = np.sum([dive.information_of_pings for dive in dives], axis=0) * free

    def linearised(values: Floats) -> ReferenceFit:
        times_s = []
        near = []
        for dive, places in zip(dives, rows, strict=True):
            own_times_s, own_rows = dive.linearised(values[places], free)
            times_s.append(own_times_s)
            near.append(own_rows)
        are_free = np.ones_like(values, bool)
        return ReferenceFit(rows, prior_sd, are_free, values, tuple(near), tuple(times_s), pings)

    fit = linearised(np.zeros(len(prior_sd)))
    for done in track_progress("fitting the reference", range(MOST_ROUNDS)):
        cov, _ = solved(fit, fit.information)
        before_s = fit.values[CLOCK]
        values = fit.values + cov @ fit.gradient
        values[CLOCK] = np.clip(values[CLOCK], -LATEST_CLOCK_S, LATEST_CLOCK_S)
        fit = linearised(values)
        if done + 1 >= ROUNDS and abs(values[CLOCK] - before_s) < FINEST_CLOCK_S:
            break
    return fit


# --- The proposed changes.


def with_reference(
    found: Calibration,
    reads: Sequence[ReadDive],
    dives: Sequence[DiveInnovations],
    groups: Collection[str],
) -> Calibration:
    """Add the calibration with the references of the same dives to the one from the innovations.

    Raises
    ------
    LogError
        No dive has a reference that is long enough.
    """
    before = Geometry.of(reads[0].config.reference)
    compared = _compared_dives(found, reads, dives, before)
    if not compared:
        raise LogError(
            "no dive has a usable reference",
            "the reference needs velocities or positions over at least a minute; `insdvl-replay inspect LOG` lists it",
        )
    wanted = np.array([parameter.group in groups for parameter in SHARED])
    free = wanted.copy()
    if not all(dive.reference.has_attitude for dive in compared):
        free[REFERENCE_MOUNTING] = False
        free[REFERENCE_ARM] = False
    by_innovations = np.concatenate([found.change, np.zeros(COUNT - CLOCK)])
    # First with all parameters, then without those that are not observable.
    sds = _prior_sds(found)
    first = fit_reference(compared, free, sds)
    certainty = first.certainty
    total = first.values[:COUNT] + by_innovations
    refused = dict(_refused(certainty, total, free))
    kept = free & ~np.isin(np.arange(COUNT), list(refused))
    fit = first if (kept == free).all() else fit_reference(compared, kept, sds)
    proposed = np.where(kept, fit.values[:COUNT] + by_innovations, 0.0)
    without_attitude = Estimated.HELD, "needs a reference with attitude"
    refused |= dict.fromkeys(np.flatnonzero(wanted & ~free).tolist(), without_attitude)
    rows = tuple(parameter_rows(SHARED, certainty, proposed, total, wanted, refused))
    dive_rows = tuple(_dive_row(dive, fit) for dive in compared)
    # The reference replaces those parameters of the DVL that it determines.
    dvl_rows = list(found.rows)
    change = found.change.copy()
    for row in OF_DVL:
        if rows[row].status == Estimated.ESTIMATED:
            dvl_rows[row] = msgspec.structs.replace(rows[row], why=WAY)
            change[row] = proposed[row]
    after = found.before.changed(change)
    independent = reads[0].config.reference.independent
    warnings = _warnings(certainty, kept, dive_rows, independent=independent)
    reference = ReferenceCalibration(
        before,
        before.changed(proposed[CLOCK:]),
        rows[CLOCK:],
        dive_rows,
        tuple(_start_rows(reads, after)),
    )
    return replace(
        found,
        rows=tuple(dvl_rows),
        change=change,
        after=after,
        warnings=(*found.warnings, *warnings),
        reference=reference,
    )


def _compared_dives(
    found: Calibration,
    reads: Sequence[ReadDive],
    dives: Sequence[DiveInnovations],
    before: Geometry,
) -> list[ReferenceDive]:
    """Return the dives that have a reference, and one that is long enough."""
    compared = []
    for i, (read, asked) in enumerate(zip(reads, dives, strict=True)):
        if read.as_read is None:
            continue
        dive = reference_dive(
            found.noise.applied(asked),
            read.as_read,
            before,
            found.change_of_dive(i),
            gives_start=read.config.initial.source == "reference",
        )
        if dive is not None:
            compared.append(dive)
    return compared


def _prior_sds(found: Calibration) -> Floats:
    """Return the prior sds: the innovations give that of the DVL, except for its scale.

    Smoothing inside the DVL would bias that.
    """
    sds = SHARED_SD.copy()
    for row, dvl_row in enumerate(found.rows):
        if row != SCALE and dvl_row.status == Estimated.ESTIMATED and dvl_row.sd is not None:
            sds[row] = min(dvl_row.sd / SHARED[row].shown_as, PRIOR_SD[row])
    return sds


def _start_rows(reads: Sequence[ReadDive], after: Geometry) -> Iterator[StartRow]:
    """Yield the headings at the start from positions, with the proposed settings of the DVL."""
    for read in reads:
        known = read.dive.reference
        if known is None or not known.has_position or known.has_attitude:
            continue
        try:
            start = fitted_start(read.dive, with_dvl(read.config, after))
        except LogError:
            continue
        yield StartRow(
            read.dive.name,
            start.heading_deg,
            start.heading_sd_deg,
            start.gyro_bias_degph,
            start.gyro_bias_sd_degph,
        )


def _refused(certainty: Certainty, change: Floats, free: Mask) -> Refusals:
    for row in np.flatnonzero(free).tolist():
        parameter = SHARED[row]
        if row < CLOCK and row not in OF_DVL:
            continue
        # Check this first: at the edge of the search range no sd is right.
        if row == CLOCK and abs(change[row]) > LATEST_CLOCK_S - parameter.step:
            reason = "at the edge of the search range. Check the clocks and stamps"
            yield row, (Estimated.IMPLAUSIBLE, reason)
        elif certainty.signal_to_noise[row] < SEEN:
            yield row, (Estimated.HELD, f"needs {parameter.shown_by}")
        elif row == SCALE and abs(np.expm1(change[row])) > PLAUSIBLE_SCALE:
            reason = "larger than any error of the speed of sound. Check the unit of the reference's velocity"
            yield row, (Estimated.IMPLAUSIBLE, reason)
        elif abs(change[row]) > PLAUSIBLE_SDS * parameter.prior_sd:
            reason = "too far from the configuration. Check axes and clocks"
            yield row, (Estimated.IMPLAUSIBLE, reason)


def _dive_row(dive: ReferenceDive, fit: ReferenceFit) -> ReferenceDiveRow:
    # Before: as configured, without the result of the innovations.
    rms_before, track_before = replace(dive, change=NO_CHANGE).apart(np.zeros(COUNT))
    rms, track = dive.apart(fit.values[:COUNT])
    return ReferenceDiveRow(
        dive=dive.asked.name,
        rows=len(dive.reference.time_ns),
        unit="m/s" if dive.reference.has_velocity else "m",
        rms_before=rms_before,
        rms_after=rms,
        track_scale_before_pct=finite_or_none(track_before.scale_pct),
        track_scale_after_pct=finite_or_none(track.scale_pct),
        track_scale_sd_pct=finite_or_none(track.scale_sd_pct),
        track_turn_before_deg=finite_or_none(track_before.turn_deg),
        track_turn_after_deg=finite_or_none(track.turn_deg),
        track_turn_sd_deg=finite_or_none(track.turn_sd_deg),
    )


def _warnings(
    certainty: Certainty,
    kept: Mask,
    dives: Sequence[ReferenceDiveRow],
    *,
    independent: bool,
) -> Iterator[str]:
    if not independent:
        yield "the reference uses the same IMU or DVL (reference.independent = false), so it shares their errors"
    for row in np.flatnonzero(kept & (np.nan_to_num(certainty.birge) > MANY_TIMES)).tolist():
        if row in OF_DVL or row >= CLOCK:
            yield (
                f"{SHARED[row].name} by the reference differs between the dives by {certainty.birge[row]:.1f} times "
                "the expected scatter"
            )
    for dive in dives:
        left = dive.track_scale_after_pct
        sd = dive.track_scale_sd_pct
        if kept[SCALE] and left is not None and sd is not None and abs(left) > PLAUSIBLE_SDS * sd:
            yield f"{dive.dive}: the track fit still has a scale error of {left:+.2f} % (sd {sd:.2f} %)"
