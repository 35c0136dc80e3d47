"""Dives that are read, and the innovations of their velocities, as they would be if the DVL were built in otherwise.

One filter run for each question; its gate is open, since a gate that follows the answer would make the cost jump.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.parameters import DELAY, NAMES, SCALE, STEPS, Geometry, moved_mounting, moved_pings
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, nanoseconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import DV
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.prepared import Prepared, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import prepare_with_heading, run_one

LATEST_S: Final = 0.4  # delays are looked for up to here, either way
SKIPPED: Final = 5  # pings at both ends that do not count: the start hangs on one of them
FEWEST: Final = 30  # pings from which something can be estimated
READ_S: Final = 1800.0  # of each dive so much is read: more would say the same again
START_SPEED_SD_MPS: Final = 2.0  # the velocity at the start is left to the pings
WILD: Final = 20.0  # times the upper quartile of what pings are off their neighbours
LEAST_OFF_MPS: Final = 0.01  # as much is usual even on a dive on which nothing moves
FAR: Final = 1e3  # stands for an innovation that is larger, or not finite, in its own standard deviations
NO_CHANGE: Final = np.zeros(len(NAMES))

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ReadDive:
    """A dive with its configuration, from which it can be prepared for any geometry."""

    dive: Dive
    config: Config
    as_read: ReferenceColumns | None = None  # its reference, before it was moved to the IMU

    def with_config(self, config: Config) -> "ReadDive":
        """Take other settings for the same readings."""
        return replace(self, config=config)

    def innovations(self) -> "DiveInnovations":
        """Prepare it for a fit, with pings that stay inside the span however late they are.

        Raises
        ------
        LogError
            It has too few pings.
        """
        prepared = prepare_with_heading(self.dive, self.config)
        baseline = replace(prepared.filters[0], aiding=("velocity",), gate_probability=1.0, gate_reopen_after=0)
        # A change of the delay by a step beyond the latest one has to find its pings inside, too.
        room_ns = nanoseconds(LATEST_S + 2.0 * float(STEPS[DELAY]))
        alignment = prepared.alignment
        start_ns = alignment.start_ns
        end_ns = min(prepared.end_ns, start_ns + nanoseconds(READ_S))
        inside = prepared.velocities.within(start_ns + room_ns, end_ns - room_ns)
        velocities = inside.where(steady(inside.velocity_b))
        if (count := len(velocities.time_ns) - 2 * SKIPPED) < FEWEST:
            raise LogError(
                f"{self.dive.name}: {max(count, 0)} pings are too few to calibrate by, {FEWEST} are needed",
                "leave the dive out, or widen span.start_s and span.end_s",
            )
        # The velocity at the start would tell how the DVL is turned by no more than the DVL itself does.
        cov = alignment.start.cov.copy()
        cov[DV, DV] += START_SPEED_SD_MPS**2 * np.eye(3)
        ready = replace(
            prepared,
            velocities=velocities,
            alignment=replace(alignment, start=replace(alignment.start, cov=cov)),
            end_ns=end_ns,
            gaps=prepared.gaps.within(start_ns, end_ns),
        )
        wild = len(inside.time_ns) - len(velocities.time_ns)
        return DiveInnovations(replace(self.dive, reference=None), ready, baseline, wild)


def read_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> ReadDive:
    """Read a dive and check it, as `reading.read_checked_dive` does."""
    dive = read_checked_dive(path, config.without_solutions(), allow_damaged=allow_damaged)
    return ReadDive(with_reference_at_imu(dive, config), config, dive.reference)


def with_dvl(config: Config, geometry: Geometry) -> Config:
    """Set how the DVL is built in."""
    dvl = msgspec.structs.replace(config.dvl, **msgspec.structs.asdict(geometry))
    return msgspec.structs.replace(config, dvl=dvl)


@dataclass(frozen=True)
class DiveInnovations:
    """A prepared dive whose innovations can be computed for any geometry."""

    dive: Dive  # its IMU
    prepared: Prepared
    filter: ResolvedFilter  # the baseline, aided by velocities alone
    left_out: int  # pings that no vehicle could have followed

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

    def moved(self, change: Floats) -> tuple[Prepared, Timeline]:
        """Build the DVL in otherwise, by a change (8,)."""
        configured = self.prepared.velocities
        # With covariances that turn, a mounting is likelier that lays a noisy axis along a quiet one.
        pings = replace(
            moved_pings(configured, change),
            unit_cov_b=configured.unit_cov_b,
            full_unit_cov_b=configured.full_unit_cov_b,
        )
        moved = replace(self.prepared, velocities=pings, mounting=moved_mounting(self.prepared.mounting, change))
        start_ns, end_ns, gaps = self.prepared.alignment.start_ns, self.prepared.end_ns, self.prepared.gaps
        return moved, build_timeline(self.dive.imu, pings.time_ns, np.empty(0, np.int64), start_ns, end_ns, gaps)

    def history(self, change: Floats) -> History:
        """Run the filter with a changed geometry."""
        return run_one(self.filter, *self.moved(change))

    def runner(self, change: Floats) -> Callable[[ResolvedFilter], Innovations]:
        """Return what gives the innovations of velocities with a changed geometry, filter by filter."""
        moved, timeline = self.moved(change)
        return lambda tried: run_one(tried, moved, timeline).innovations[0]

    def residuals(self, change: Floats) -> Floats:
        """Return the innovations in their own standard deviations, (count, 3).

        They are taken back to the DVL's own scale: in true metres a larger scale makes all of them smaller, and the fit
        would follow.
        """
        innovations = self.history(change).innovations[0]
        standardised = innovations.standardised[SKIPPED:-SKIPPED] * np.exp(change[SCALE])
        return np.asarray(np.clip(np.nan_to_num(standardised, nan=FAR), -FAR, FAR))

    def jacobian(self, change: Floats, free: Mask) -> Floats:
        """Differentiate the residuals by the free parameters, (count, 3, 8)."""
        return central_differences(self.residuals, change, STEPS, free, (self.count, 3))


def central_differences(
    function: Callable[[Floats], Floats], at: Floats, steps: Floats, free: Mask, shape: tuple[int, ...]
) -> Floats:
    """Differentiate a function whose values have a shape by its n arguments, (*shape, n); 0 where they are held."""
    chosen, columns = np.flatnonzero(free), np.zeros((*shape, len(at)))
    tried = [at + sign * steps[i] * np.eye(len(at))[i] for i in chosen for sign in (1.0, -1.0)]
    found = list(parallel_map(function, tried))
    for i, after, before in zip(chosen, found[::2], found[1::2], strict=True):
        columns[..., i] = (after - before) / (2.0 * steps[i])
    return columns


def steady(velocity_b: Floats) -> Mask:
    """Find the pings, (m,), of velocities (m, 3) that are near the median of five, whatever the geometry.

    With the gate open, a wild one would pull the filter with it.
    """
    padded = np.pad(velocity_b, ((2, 2), (0, 0)), mode="edge")
    off = np.abs(velocity_b - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1))
    usual = np.maximum(np.quantile(off, 0.75, axis=0), LEAST_OFF_MPS)
    return np.asarray((off <= WILD * usual).all(axis=1))
