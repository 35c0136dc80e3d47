"""The innovations of one dive's velocities, as they would be if the DVL were built in otherwise.

One filter run for each question; its gate is open, since a gate that follows the answer would make the cost jump.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.parameters import DELAY, NAMES, SCALE, STEPS, moved_mounting, moved_pings
from insdvl_replay.core.dive_columns import Dive, Floats, nanoseconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import DV
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.prepared import Prepared
from insdvl_replay.preparation.running import run_one

LATEST_S: Final = 0.4
"""Delays are looked for up to here, either way."""
SKIPPED: Final = 5
"""Pings at both ends that do not count: the start hangs on one of them."""
FEWEST: Final = 30
"""Pings from which something can be estimated."""
READ_S: Final = 1800.0
"""Of each dive so much is read: more would say the same again."""
START_SPEED_SD_MPS: Final = 2.0
"""The velocity at the start is left to the pings."""
WILD: Final = 20.0
"""Times the upper quartile of what pings are off their neighbours."""
LEAST_OFF_MPS: Final = 0.01
"""As much is usual even on a dive on which nothing moves."""
FAR: Final = 1e3
"""Stands for an innovation that is larger, or not finite, in its own standard deviations."""


@dataclass(frozen=True)
class DiveInnovations:
    """What has to be known of a dive to ask for its innovations.

    Attributes
    ----------
    dive : Dive
        Its IMU.
    prepared : Prepared
        With those pings that stay inside the span however late they are.
    filter : ResolvedFilter
        The baseline, aided by velocities alone.
    left_out : int
        Pings that no vehicle could have followed.
    """

    dive: Dive
    prepared: Prepared
    filter: ResolvedFilter
    left_out: int

    @property
    def name(self) -> str:
        """Of the dive."""
        return self.dive.name

    @cached_property
    def count(self) -> int:
        """How many pings count."""
        return len(self.prepared.velocities.time_ns) - 2 * SKIPPED

    @property
    def gated(self) -> ResolvedFilter:
        """The filter with the gate that is configured."""
        configured = self.prepared.filters[0]
        probability, reopen_after = configured.gate_probability, configured.gate_reopen_after
        return replace(self.filter, gate_probability=probability, gate_reopen_after=reopen_after)

    def history(self, change: Floats) -> History:
        """Run the filter with another geometry, shape (8,)."""
        moved, timeline = self._moved(change)
        return run_one(self.filter, moved, timeline)

    def runner(self, change: Floats) -> Callable[[ResolvedFilter], Innovations]:
        """Return what gives the innovations of velocities with another geometry, shape (8,), filter by filter."""
        moved, timeline = self._moved(change)
        return lambda tried: run_one(tried, moved, timeline).innovations[0]

    def _moved(self, change: Floats) -> tuple[Prepared, Timeline]:
        configured = self.prepared.velocities
        # With covariances that turn, a mounting is likelier that lays a noisy axis along a quiet one.
        pings = replace(
            moved_pings(configured, change),
            unit_cov_b=configured.unit_cov_b,
            full_unit_cov_b=configured.full_unit_cov_b,
        )
        moved = replace(self.prepared, velocities=pings, mounting=moved_mounting(self.prepared.mounting, change))
        timeline = build_timeline(
            self.dive.imu,
            pings.time_ns,
            np.empty(0, dtype=np.int64),
            self.prepared.alignment.start_ns,
            self.prepared.end_ns,
            self.prepared.gaps,
        )
        return moved, timeline

    def residuals(self, change: Floats) -> Floats:
        """Return the innovations in their own standard deviations, shape (count, 3).

        They are taken back to the DVL's own scale: in true metres a larger scale makes all of them smaller, and the fit
        would follow.
        """
        innovations = self.history(change).innovations[0]
        standardised = innovations.standardised[SKIPPED:-SKIPPED] * np.exp(change[SCALE])
        return np.asarray(np.clip(np.nan_to_num(standardised, nan=FAR), -FAR, FAR))

    def jacobian(self, change: Floats, free: NDArray[np.bool_]) -> Floats:
        """Differentiate the residuals by the free parameters, central differences, shape (count, 3, 8)."""
        columns, chosen = np.zeros((self.count, 3, len(NAMES))), np.flatnonzero(free)
        steps = [sign * STEPS[i] * np.eye(len(NAMES))[i] for i in chosen for sign in (1.0, -1.0)]
        found = list(parallel_map(self.residuals, [change + step for step in steps]))
        for i, after, before in zip(chosen, found[::2], found[1::2], strict=True):
            columns[:, :, i] = (after - before) / (2.0 * STEPS[i])
        return columns


def dive_innovations(dive: Dive, prepared: Prepared) -> DiveInnovations:
    """Get a dive ready to be asked.

    Parameters
    ----------
    dive : Dive
        As `prepared.prepare_dive` takes it.
    prepared : Prepared
        Of the same.

    Raises
    ------
    LogError
        It has too few pings.
    """
    baseline = replace(prepared.filters[0], aiding=("velocity",), gate_probability=1.0, gate_reopen_after=0)
    # A change of the delay by a step beyond the latest one has to find its pings inside, too.
    room_ns = nanoseconds(LATEST_S + 2.0 * float(STEPS[DELAY]))
    start_ns = prepared.alignment.start_ns
    end_ns = min(prepared.end_ns, start_ns + nanoseconds(READ_S))
    inside = prepared.velocities.within(start_ns + room_ns, end_ns - room_ns)
    velocities = inside.where(steady(inside.velocity_b))
    ready = replace(
        prepared,
        velocities=velocities,
        alignment=replace(prepared.alignment, start=_unsure_of_velocity(prepared.alignment.start)),
        end_ns=end_ns,
        gaps=prepared.gaps.within(start_ns, end_ns),
    )
    found = DiveInnovations(
        replace(dive, reference=None), ready, baseline, len(inside.time_ns) - len(velocities.time_ns)
    )
    if found.count < FEWEST:
        raise LogError(
            f"{dive.name}: {max(found.count, 0)} pings are too few to calibrate by, {FEWEST} are needed",
            "leave the dive out, or widen span.start_s and span.end_s",
        )
    return found


def steady(velocity_b: Floats) -> NDArray[np.bool_]:
    """Find the pings that are like their neighbours, whatever the geometry: with the gate open, a wild one would pull
    the filter with it.

    Parameters
    ----------
    velocity_b : ndarray, shape (m, 3)

    Returns
    -------
    ndarray of bool, shape (m,)
        False far from the median of five, beyond what is usual on this dive.
    """
    padded = np.pad(velocity_b, ((2, 2), (0, 0)), mode="edge")
    off = np.abs(velocity_b - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1))
    usual = np.maximum(np.quantile(off, 0.75, axis=0), LEAST_OFF_MPS)
    return np.asarray((off <= WILD * usual).all(axis=1))


def _unsure_of_velocity(start: Start) -> Start:
    """Forget the velocity at the start, which would tell how the DVL is turned by no more than its own word."""
    cov = start.cov.copy()
    cov[DV, DV] += START_SPEED_SD_MPS**2 * np.eye(3)
    return replace(start, cov=cov)
