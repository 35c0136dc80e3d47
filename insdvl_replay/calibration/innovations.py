"""The parameters that are calibrated, and the innovations of a dive's velocities for other parameters.

No log is read again: a delay moves pings in time, mounting and scale turn and stretch their velocities, and the filter
gets another lever arm. Each set of parameters needs one filter run. The gate is off, because a gate that changes with
the parameters would make the cost jump.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from insdvl_replay.core.config import Config, Dvl, Reference
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    ImuColumns,
    Mask,
    ReferenceColumns,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import DEG, DV
from insdvl_replay.geometry.frames import DvlMounting
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, rpy_from_mat
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.prepared import (
    Prepared,
    find_gaps,
    gaps_that_split,
    read_checked_dive,
    with_reference_at_imu,
)
from insdvl_replay.preparation.run import prepare_with_heading, run_one


class Parameter(NamedTuple):
    """One parameter."""

    name: str
    group: str  # name in ``--only``
    label: str
    key: str  # in ``[dvl]`` or ``[reference]``
    unit: str
    shown_as: float  # factor from SI to the unit
    prior_sd: float  # sd of the configured value, SI
    step: float  # of central differences, SI: large against the resolution of the log
    shown_by: str  # the manoeuvre that determines it


_TIME: Final = ("latency_s", "s", 1.0, 0.5, 0.05)
_LENGTH: Final = ("lever_arm_m", "m", 1.0, 3.0, 0.02)
_ANGLE: Final = ("mounting_rpy_deg", "deg", 1.0 / DEG, 2.0 * DEG, 0.1 * DEG)
# The mounting's prior is 2 deg, although configured values may be wrong by 5 to 10 deg. With 5 deg a straight line
# changed roll and pitch on 12 of 12 simulated dives, with errors of up to 3.4 reported sds: the levelling of a filter
# looks like a mounting. With 2 deg its signal to noise stays near 2, and nothing is changed. A larger error is still
# found if the dive determines it.
_SPEED: Final = "changes of speed, or turns at speed"
_TURNS: Final = "turns about down"
_LEANING: Final = "rolling or pitching"
_WAY: Final = "distance travelled, and manoeuvres that determine the DVL's mounting"

# Of the DVL: changes from the configuration. The mounting is turned about the axes of b; the scale is the
# logarithm of its factor.
PARAMETERS: Final = (
    Parameter("delay", "delay", "delay", *_TIME, _SPEED),
    Parameter("mounting_x", "mounting", "mounting x", *_ANGLE, "sway or heave"),
    Parameter("mounting_y", "mounting", "mounting y", *_ANGLE, "changes of speed, or porpoising"),
    Parameter("mounting_z", "mounting", "mounting z", *_ANGLE, _SPEED),
    Parameter("arm_x", "arm", "arm x", *_LENGTH, _TURNS),
    Parameter("arm_y", "arm", "arm y", *_LENGTH, _TURNS),
    Parameter("arm_z", "arm", "arm z", *_LENGTH, _LEANING),
    Parameter(
        "scale", "scale", "scale", "scale", "%", 100.0, 0.05, 1e-3, "large changes of speed"
    ),
)
# Of a reference, in the same order.
REFERENCE_PARAMETERS: Final = (
    Parameter(
        "reference_clock", "reference_clock", "ref. clock", *_TIME, "changes of speed, or turns"
    ),
    Parameter(
        "reference_mounting_x",
        "reference_mounting",
        "ref. mounting x",
        *_ANGLE,
        "turns, for level",
    ),
    Parameter(
        "reference_mounting_y",
        "reference_mounting",
        "ref. mounting y",
        *_ANGLE,
        "turns, for level",
    ),
    Parameter("reference_mounting_z", "reference_mounting", "ref. mounting z", *_ANGLE, _WAY),
    Parameter("reference_arm_x", "reference_arm", "ref. arm x", *_LENGTH, _TURNS),
    Parameter("reference_arm_y", "reference_arm", "ref. arm y", *_LENGTH, _TURNS),
    Parameter("reference_arm_z", "reference_arm", "ref. arm z", *_LENGTH, _LEANING),
)
SHARED: Final = (*PARAMETERS, *REFERENCE_PARAMETERS)  # common to all dives, with a reference
LABELS: Final = {parameter.name: parameter.label for parameter in SHARED}
NAMES: Final = tuple(parameter.name for parameter in PARAMETERS)
NOISE: Final = "noise"
ALL_GROUPS: Final = ("arm", "mounting", "delay", "scale", NOISE)
REFERENCE_GROUPS: Final = (*ALL_GROUPS, "reference_arm", "reference_mounting", "reference_clock")
DELAY: Final = NAMES.index("delay")
SCALE: Final = NAMES.index("scale")
HEADING: Final = NAMES.index("mounting_z")
MOUNTING: Final = slice(1, 4)
ARM: Final = slice(4, 7)
CLOCK: Final = len(PARAMETERS)
REFERENCE_MOUNTING: Final = slice(CLOCK + 1, CLOCK + 4)
REFERENCE_ARM: Final = slice(CLOCK + 4, CLOCK + 7)
SHARED_SD: Final = np.array([parameter.prior_sd for parameter in SHARED])
SHARED_STEPS: Final = np.array([parameter.step for parameter in SHARED])
PRIOR_SD: Final = SHARED_SD[:CLOCK]
STEPS: Final = SHARED_STEPS[:CLOCK]


def moved_pings(velocities: DvlVelocities, change: Floats) -> DvlVelocities:
    """Return the pings for a changed geometry of the DVL."""
    turn_b = mat_from_vector(change[MOUNTING])
    scale = np.exp(change[SCALE])
    return replace(
        velocities,
        time_ns=velocities.time_ns - nanoseconds(float(change[DELAY])),
        velocity_b=velocities.velocity_b @ turn_b.T / scale,
        unit_cov_b=turn_b @ velocities.unit_cov_b @ turn_b.T,
        full_unit_cov_b=turn_b @ velocities.full_unit_cov_b @ turn_b.T,
    )


def moved_mounting(mounting: DvlMounting, change: Floats) -> DvlMounting:
    """Return the mounting that matches `moved_pings`."""
    return DvlMounting(
        mounting.lever_arm_b + change[ARM],
        mat_from_vector(change[MOUNTING]) @ mounting.mat_bd,
        mounting.scale * float(np.exp(change[SCALE])),
    )


class Geometry(Struct, frozen=True):
    """The keys of ``[dvl]`` or ``[reference]`` that are calibrated."""

    latency_s: float
    lever_arm_m: tuple[float, float, float]
    mounting_rpy_deg: tuple[float, float, float]
    scale: float = 1.0  # of a DVL

    @classmethod
    def of(cls, settings: Dvl | Reference) -> "Geometry":
        """Take them from a configuration."""
        scale = settings.scale if isinstance(settings, Dvl) else 1.0
        return cls(settings.latency_s, settings.lever_arm_m, settings.mounting_rpy_deg, scale)

    @property
    def mat_b(self) -> Floats:
        """Rotation from the instrument's axes to the body's, (3, 3)."""
        return mat_from_rpy(np.array(self.mounting_rpy_deg) * DEG)

    def rounded(self) -> "Geometry":
        """Return the settings with six decimals, finer than any sd."""
        return Geometry(
            round(self.latency_s, 6),
            _rounded(self.lever_arm_m),
            _rounded(self.mounting_rpy_deg),
            round(self.scale, 6),
        )

    def changed(self, change: Floats) -> "Geometry":
        """Return the settings after a change, (7,) or with a scale (8,); a group without change is equal to the bit."""
        turn = change[MOUNTING]
        roll, pitch, heading = (rpy_from_mat(mat_from_vector(turn) @ self.mat_b) / DEG).tolist()
        x, y, z = (np.array(self.lever_arm_m) + change[ARM]).tolist()
        return Geometry(
            self.latency_s + float(change[DELAY]),
            (x, y, z),
            (roll, pitch, heading) if turn.any() else self.mounting_rpy_deg,
            self.scale * float(np.exp(change[SCALE:].sum())),
        )


def _rounded(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = vector
    return round(x, 6), round(y, 6), round(z, 6)


# --- Dives and their innovations.

LATEST_S: Final = 0.4  # largest delay of the search, either sign
SKIPPED: Final = 5  # pings at both ends that do not count: the start depends on one of them
FEWEST: Final = 30  # pings from which something can be estimated
READ_S: Final = 1800.0  # most that is used of a dive; more adds little
START_SPEED_SD_MPS: Final = 2.0  # large, so that the pings determine the velocity at the start
WILD: Final = 20.0  # times the upper quartile of the distance of pings from the pings around them
LEAST_OFF_MPS: Final = 0.01  # usual distance even without motion
# replaces an innovation that is larger, or not finite, in its own standard deviations
FAR: Final = 1e3
NO_CHANGE: Final = np.zeros(len(NAMES))


@dataclass(frozen=True)
class ReadDive:
    """A dive with its configuration, from which it can be prepared for any geometry."""

    dive: Dive
    config: Config
    as_read: ReferenceColumns | None = None  # its reference, before it was moved to the IMU

    def with_config(self, config: Config) -> "ReadDive":
        """Return the same readings with other settings."""
        return replace(self, config=config)

    def with_settings(self, config: Config) -> "ReadDive":
        """Return the same part of the dive with other settings, whose span does not count."""
        return self.with_config(msgspec.structs.replace(config, span=self.config.span))

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of what is replayed of the settings' span, s since the first sample of the IMU."""
        span = self.config.span
        time_ns = self.dive.imu.time_ns
        first_ns = int(time_ns[0])
        start_s = span.start_s or 0.0
        end_s = min(span.end_s or np.inf, float(time_ns[-1] - first_ns) / NS_PER_S)
        start_ns = first_ns + nanoseconds(start_s)
        end_ns = first_ns + nanoseconds(end_s)
        gaps = find_gaps(time_ns, self.config.imu).within(start_ns, end_ns)
        split = gaps_that_split(gaps, self.config.imu)
        if not len(split.start_ns):
            return start_s, end_s
        kept_ns = np.array(split.longest_stretch(start_ns, end_ns))
        kept_start_s, kept_end_s = seconds(kept_ns, first_ns).tolist()
        return kept_start_s, kept_end_s

    @property
    def imu_in_span(self) -> ImuColumns:
        """The readings in this span, which are no copies."""
        first_ns = int(self.dive.imu.time_ns[0])
        from_s, to_s = self.span_s
        return self.dive.imu.within(first_ns + nanoseconds(from_s), first_ns + nanoseconds(to_s))

    @property
    def alone(self) -> Config:
        """The settings with the baseline alone."""
        name = self.config.baseline
        return msgspec.structs.replace(self.config, filters={name: self.config.filters[name]})

    def innovations(self) -> "DiveInnovations":
        """Prepare it for a fit, with pings that stay inside the span for any delay.

        Raises
        ------
        LogError
            It has too few pings.
        """
        prepared = prepare_with_heading(self.dive, self.alone)
        baseline = replace(
            prepared.filters[0], aiding=("velocity",), gate_probability=1.0, gate_reopen_after=0
        )
        # A step beyond the largest delay also needs its pings inside.
        room_ns = nanoseconds(LATEST_S + 2.0 * float(STEPS[DELAY]))
        alignment = prepared.alignment
        start_ns = alignment.start_ns
        end_ns = min(prepared.end_ns, start_ns + nanoseconds(READ_S))
        inside = prepared.velocities.within(start_ns + room_ns, end_ns - room_ns)
        velocities = inside.where(steady(inside.velocity_b))
        count = len(velocities.time_ns) - 2 * SKIPPED
        if count < FEWEST:
            raise LogError(
                f"{self.dive.name}: {max(count, 0)} pings are too few to calibrate; {FEWEST} are needed",
                "leave the dive out, or widen span.start_s and span.end_s",
            )
        # The velocity at the start comes from the DVL, so it must not determine the mounting.
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


def read_dive(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False
) -> ReadDive:
    """Read a dive and check it, as `prepared.read_checked_dive` does."""
    dive = read_checked_dive(path, config.without_solutions(), allow_damaged=allow_damaged)
    return ReadDive(with_reference_at_imu(dive, config), config, dive.reference)


def with_dvl(config: Config, geometry: Geometry) -> Config:
    """Return the settings with another geometry of the DVL."""
    dvl = msgspec.structs.replace(config.dvl, **msgspec.structs.asdict(geometry))
    return msgspec.structs.replace(config, dvl=dvl)


@dataclass(frozen=True)
class DiveInnovations:
    """A prepared dive whose innovations can be computed for any geometry."""

    dive: Dive  # its IMU
    prepared: Prepared
    filter: ResolvedFilter  # the baseline, aided by velocities alone
    left_out: int  # number of outliers

    @property
    def name(self) -> str:
        """Name of the dive."""
        return self.dive.name

    @cached_property
    def count(self) -> int:
        """Number of pings that count."""
        return len(self.prepared.velocities.time_ns) - 2 * SKIPPED

    @property
    def gated(self) -> ResolvedFilter:
        """The filter with the configured gate."""
        configured = self.prepared.filters[0]
        probability = configured.gate_probability
        reopen_after = configured.gate_reopen_after
        return replace(self.filter, gate_probability=probability, gate_reopen_after=reopen_after)

    def moved(self, change: Floats) -> tuple[Prepared, Timeline]:
        """Return dive and timeline for a change of the geometry, (8,)."""
        configured = self.prepared.velocities
        # The covariances do not turn: else a mounting with a noisy axis along a quiet one would look likelier.
        pings = replace(
            moved_pings(configured, change),
            unit_cov_b=configured.unit_cov_b,
            full_unit_cov_b=configured.full_unit_cov_b,
        )
        moved = replace(
            self.prepared,
            velocities=pings,
            mounting=moved_mounting(self.prepared.mounting, change),
        )
        start_ns = self.prepared.alignment.start_ns
        end_ns = self.prepared.end_ns
        gaps = self.prepared.gaps
        return moved, build_timeline(
            self.dive.imu, pings.time_ns, np.empty(0, np.int64), start_ns, end_ns, gaps
        )

    def runner(self, change: Floats) -> Callable[[ResolvedFilter], Innovations]:
        """Return a function from a filter to its velocity innovations with a changed geometry."""
        moved, timeline = self.moved(change)
        return lambda tried: run_one(tried, moved, timeline).innovations[0]

    def residuals(self, change: Floats) -> Floats:
        """Return the innovations in their own standard deviations, (count, 3).

        They are in the DVL's own scale. In true metres a larger scale would make all of them smaller, and bias the fit.
        """
        innovations = self.runner(change)(self.filter)
        standardised = innovations.standardised[SKIPPED:-SKIPPED] * np.exp(change[SCALE])
        return np.asarray(np.clip(np.nan_to_num(standardised, nan=FAR), -FAR, FAR))

    def jacobian(self, change: Floats, free: Mask) -> Floats:
        """Differentiate the residuals by the free parameters, (count, 3, 8)."""
        return central_differences(self.residuals, change, STEPS, free, (self.count, 3))


def central_differences(
    function: Callable[[Floats], Floats],
    at: Floats,
    steps: Floats,
    free: Mask,
    shape: tuple[int, ...],
) -> Floats:
    """Differentiate a function by its n arguments, (*shape, n); 0 for held ones."""
    chosen = np.flatnonzero(free)
    columns = np.zeros((*shape, len(at)))
    moved = np.diag(steps)[chosen]
    found = list(parallel_map(function, [*(at + moved), *(at - moved)]))
    after = found[: len(chosen)]
    before = found[len(chosen) :]
    for i, value, other in zip(chosen, after, before, strict=True):
        columns[..., i] = (value - other) / (2.0 * steps[i])
    return columns


def steady(velocity_b: Floats) -> Mask:
    """Find the pings, (m,), whose velocities (m, 3) are near the median of five, for any geometry.

    Without a gate, an outlier would disturb the filter.
    """
    if not len(velocity_b):
        return np.zeros(0, bool)
    padded = np.pad(velocity_b, ((2, 2), (0, 0)), mode="edge")
    off = np.abs(
        velocity_b
        - np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1)
    )
    usual = np.maximum(np.quantile(off, 0.75, axis=0), LEAST_OFF_MPS)
    return np.asarray((off <= WILD * usual).all(axis=1))
