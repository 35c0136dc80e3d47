"""What a dive's reference and its baseline say of each other, if the reference were built in otherwise.

Velocities are compared in the axes of the body, each by its own attitude, so that the heading that a filter has lost
does not count; attitudes by how their difference changes from row to row, which the same heading hardly moves, and
level by its mean. Where the reference has no velocity, ways between its positions are compared, turned likewise. The
filter is run anew for whatever changes what it is told, or when it is asked; the reference is moved as
`preparation.prepared` moves it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.fit import scatter_of
from insdvl_replay.calibration.innovations import DiveInnovations
from insdvl_replay.calibration.parameters import (
    NAMES,
    SCALE,
    moved_mounting,
    moved_pings,
)
from insdvl_replay.calibration.reference_parameters import (
    CLOCK,
    HEADING,
    LATEST_CLOCK_S,
    REFERENCE_MOUNTING,
    SHARED,
    SHARED_STEPS,
    ReferenceGeometry,
)
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, at_time, nanoseconds, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.timeline import build_timeline
from insdvl_replay.preparation.alignment import Alignment
from insdvl_replay.preparation.prepared import reference_at_imu
from insdvl_replay.preparation.running import run_one

SETTLED_S: Final = 30.0
"""After the start, which hangs on the reference."""
APART_S: Final = 0.5
"""Rows of the reference that are nearer to each other would say the same."""
WAY_S: Final = 10.0
"""Between two positions: the way is longer than a fix is wrong."""
OWN: Final = 2
"""Of each dive alone, where the reference has no attitude: the filter's heading, and how it drifts over the dive."""
LOST_HEADING_SD: Final = 10.0 * DEG
ATTITUDE, LEVEL, MOTION = 0, 1, 2
"""Families of rows."""


@dataclass(frozen=True)
class Compared:
    """Estimated minus reference.

    Attributes
    ----------
    time_s : ndarray, shape (k,)
        Since the start.
    family : ndarray, shape (k,)
        `ATTITUDE` and `LEVEL`, rad, or `MOTION`, m/s or m.
    values : ndarray, shape (k, 3)
        NaN where nothing is known.
    own : ndarray, shape (k, 3, 2)
        Derivative by what is the dive's own.
    """

    time_s: Floats
    family: NDArray[np.int64]
    values: Floats
    own: Floats


@dataclass(frozen=True)
class ReferenceDive:
    """A dive that has a reference, with a DVL built in as its innovations said.

    Attributes
    ----------
    asked : DiveInnovations
    reference : ReferenceColumns
        As it was read, thinned, and inside the span however late it is.
    settings : ReferenceGeometry
        As configured.
    change : ndarray, shape (8,)
        What the innovations said of the DVL.
    gives_start : bool
        Whether the filter starts from the reference's attitude.
    """

    asked: DiveInnovations
    reference: ReferenceColumns
    settings: ReferenceGeometry
    change: Floats
    gives_start: bool

    def compared(self, shared: Floats, history: History | None = None) -> Compared:
        """Compare with other settings, changes of `SHARED`; ``history`` as of `history`, if it is there already."""
        history = self.history(shared) if history is None else history
        theirs = self.moved_reference(shared)
        _, ours, rows = np.intersect1d(history.time_ns, theirs.time_ns, return_indices=True)
        theirs = theirs.rows(np.isin(np.arange(len(theirs.time_ns)), rows))
        time_s = seconds(theirs.time_ns, self.asked.prepared.alignment.start_ns)
        parts = _attitudes(history, ours, theirs, time_s) if theirs.has_attitude else []
        if theirs.has_velocity:
            parts.append(_velocities(history, ours, theirs, time_s))
        elif theirs.has_position:
            parts.append(_ways(history, ours, theirs, time_s))
        time, family, values, own = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return Compared(time, family, values, own)

    def moved_reference(self, shared: Floats) -> ReferenceColumns:
        """Return the reference as it would be read with other settings, at the IMU."""
        settings = self.settings.changed(shared)
        late = replace(self.reference, time_ns=self._times_ns(shared))
        return reference_at_imu(late, self.asked.dive.imu, np.array(settings.lever_arm_m), settings.mat_br)

    def history(self, shared: Floats) -> History:
        """Run the baseline with another DVL, and look at it at the reference's times, late as they are said to be."""
        asked, change = self.asked, self.change + shared[: len(NAMES)]
        prepared = asked.prepared
        pings = moved_pings(prepared.velocities, change)
        mounting = moved_mounting(prepared.mounting, change)
        moved = replace(prepared, velocities=pings, mounting=mounting, alignment=self._alignment(shared))
        start_ns, end_ns = prepared.alignment.start_ns, prepared.end_ns
        timeline = build_timeline(
            asked.dive.imu, pings.time_ns, self._times_ns(shared), start_ns, end_ns, prepared.gaps
        )
        return run_one(asked.filter, moved, timeline)

    def _alignment(self, shared: Floats) -> Alignment:
        """Start as the reference says once it is moved.

        From another heading the Earth seems to turn otherwise, which a good filter takes for tilt and slowness.
        """
        alignment, imu = self.asked.prepared.alignment, self.asked.dive.imu
        if not self.gives_start:
            return alignment
        rate_b = at_time(imu.time_ns, imu.angular_rate_b, alignment.start_ns)
        late = mat_from_vector(rate_b * shared[CLOCK])
        mat_nb = alignment.start.mat_nb @ late @ mat_from_vector(-shared[REFERENCE_MOUNTING])
        return replace(alignment, start=replace(alignment.start, mat_nb=mat_nb))

    def jacobian(self, shared: Floats, free: NDArray[np.bool_]) -> Floats:
        """Differentiate what is compared by the free numbers, central differences, shape (k, 3, 15).

        The filter's attitude hangs on the DVL by little more than jumps at pings, which say nothing of how it is built
        in: attitudes are taken to be without it.
        """
        base = self.history(shared)
        chosen = np.flatnonzero(free)
        steps = [sign * SHARED_STEPS[i] * np.eye(len(SHARED))[i] for i in chosen for sign in (1.0, -1.0)]

        def at(step: Floats) -> Floats:
            is_of_filter = step[: CLOCK + 1].any()
            return self.compared(shared + step, None if is_of_filter else base).values

        found = list(parallel_map(at, steps))
        compared = self.compared(shared, base)
        columns = np.zeros((*compared.values.shape, len(SHARED)))
        for i, after, before in zip(chosen, found[::2], found[1::2], strict=True):
            columns[:, :, i] = (after - before) / (2.0 * SHARED_STEPS[i])
        columns[compared.family != MOTION, :, : len(NAMES)] = 0.0
        return columns

    @cached_property
    def level_sd(self) -> float:
        """How far roll and pitch may be off by themselves, as the filter says, rad."""
        history = self.history(np.zeros(len(SHARED)))
        settled = history.time_ns >= self.reference.time_ns[0]
        return float(np.sqrt(np.mean(history.sd[settled, PHI][:, :2] ** 2)))

    @cached_property
    def information_of_pings(self) -> Floats:
        """What pings of such a scatter can tell at most, of `SHARED`; zero but for the DVL's heading and scale."""
        innovations = self.asked.history(self.change).innovations[0]
        scatter, velocity_b = scatter_of(innovations.innovation), innovations.measured
        told = np.zeros(len(SHARED))
        told[HEADING] = np.sum((velocity_b[:, [1, 0]] / scatter[:2]) ** 2)
        told[SCALE] = np.sum((velocity_b / scatter) ** 2)
        return told

    def _times_ns(self, shared: Floats) -> TimeNs:
        return np.asarray(self.reference.time_ns - nanoseconds(float(shared[CLOCK])))


Part = tuple[Floats, NDArray[np.int64], Floats, Floats]


def _attitudes(history: History, ours: NDArray[np.int64], theirs: ReferenceColumns, time_s: Floats) -> list[Part]:
    apart = vector_from_mat(np.swapaxes(theirs.mat_nb, 1, 2) @ history.mat_nb[ours])
    changes = np.diff(apart, axis=0)
    level = np.array([[*apart[:, :2].mean(axis=0), np.nan]])
    return [
        (time_s[1:], np.full(len(changes), ATTITUDE), changes, np.zeros((len(changes), 3, OWN))),
        (time_s[:1], np.array([LEVEL]), level, np.zeros((1, 3, OWN))),
    ]


def _velocities(history: History, ours: NDArray[np.int64], theirs: ReferenceColumns, time_s: Floats) -> Part:
    mat_nb = history.mat_nb[ours]
    ours_b = np.einsum("kji,kj->ki", mat_nb, history.velocity_n[ours])
    own = np.zeros((len(time_s), 3, OWN))
    if theirs.has_attitude:
        mat_nb = theirs.mat_nb
    else:
        own[:, :2, 0] = np.column_stack([-ours_b[:, 1], ours_b[:, 0]])
        own[:, :, 1] = own[:, :, 0] * (time_s / time_s[-1])[:, None]
    apart = ours_b - np.einsum("kji,kj->ki", mat_nb, theirs.velocity_n)
    return time_s, np.full(len(time_s), MOTION), apart, own


def _ways(history: History, ours: NDArray[np.int64], theirs: ReferenceColumns, time_s: Floats) -> Part:
    """Compare the ways between positions, north and east."""
    known = np.flatnonzero(theirs.known["positions"])
    ends = known[thinned(theirs.time_ns[known], WAY_S)]
    ours_m, theirs_m = (
        np.column_stack(north_east_m(position[ends], theirs.position[ends[0]], theirs.position[ends[0]]))
        for position in (history.position[ours], theirs.position)
    )
    way_m, count = np.diff(ours_m, axis=0), len(ends) - 1
    apart, own = np.full((count, 3), np.nan), np.zeros((count, 3, OWN))
    aside_m = np.column_stack([-way_m[:, 1], way_m[:, 0]])
    apart[:, :2] = way_m - np.diff(theirs_m, axis=0)
    if theirs.has_attitude:
        off = vector_from_mat(history.mat_nb[ours][ends] @ np.swapaxes(theirs.mat_nb[ends], 1, 2))[:, 2]
        apart[:, :2] -= ((off[1:] + off[:-1]) / 2.0)[:, None] * aside_m
    else:
        own[:, :2, 0] = aside_m
    middle_s = (time_s[ends[1:]] + time_s[ends[:-1]]) / 2.0
    own[:, :, 1] = own[:, :, 0] * (middle_s / time_s[-1])[:, None]
    return middle_s, np.full(count, MOTION), apart, own


def thinned(time_ns: TimeNs, apart_s: float) -> NDArray[np.int64]:
    """Choose rows of which no two are nearer to each other, shape (m,)."""
    chosen: list[int] = []
    next_ns = None
    for row, now_ns in enumerate(time_ns.tolist()):
        if next_ns is None or now_ns >= next_ns:
            chosen.append(row)
            next_ns = now_ns + nanoseconds(apart_s)
    return np.array(chosen, dtype=np.int64)


def reference_dive(
    asked: DiveInnovations,
    reference: ReferenceColumns,
    settings: ReferenceGeometry,
    change: Floats,
    *,
    gives_start: bool,
) -> ReferenceDive | None:
    """Get a dive ready to be compared; None where its reference says too little.

    Parameters
    ----------
    reference : ReferenceColumns
        As it was read.
    settings : ReferenceGeometry
        With which its stamps were read.
    change : ndarray, shape (8,)
        What the innovations said of the DVL.
    gives_start : bool
        Whether the filter starts from the reference's attitude, if it has any.
    """
    start_ns = asked.prepared.alignment.start_ns + nanoseconds(SETTLED_S)
    end_ns = asked.prepared.end_ns - nanoseconds(2.0 * LATEST_CLOCK_S)
    inside = (reference.time_ns >= start_ns) & (reference.time_ns <= end_ns)
    needed = reference.known["attitudes"] if reference.has_attitude else np.ones(len(inside), dtype=np.bool_)
    moves = "velocities" if reference.has_velocity else "positions"
    kept = reference.rows(inside & needed & reference.known[moves])
    kept = kept.rows(np.isin(np.arange(len(kept.time_ns)), thinned(kept.time_ns, APART_S)))
    if len(kept.time_ns) < 2 or (kept.time_ns[-1] - kept.time_ns[0]) * 1e-9 < 2.0 * WAY_S:
        return None
    return ReferenceDive(asked, kept, settings, change, gives_start and reference.has_attitude)
