"""Clean columns of one dive: sorted, unique, in SI units and the project's frames.

`logs` makes them from files, `sim` from nothing; the filters cannot tell which.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_record import Channel, ImuFingerprint, ReferenceDelay, StartHeading
from insdvl_replay.core.errors import Note

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]  # of the rows that are meant
Array = NDArray[Any]  # of numbers of any kind
TimeNs = Integers
NS_PER_S: Final = 1_000_000_000
_AT_A_TIME: Final = 1 << 14
Scalar = TypeVar("Scalar", bound=np.generic)


def seconds(time_ns: TimeNs, origin_ns: int | TimeNs) -> Floats:
    """Return the seconds since an origin, exact to the nanosecond for spans of months.

    Parameters
    ----------
    time_ns : TimeNs
        Times of any shape, ns.
    origin_ns : int or TimeNs
        One origin, or one for each time, ns on the same clock.
    """
    elapsed_s: Floats = np.multiply(time_ns - origin_ns, 1e-9)
    return elapsed_s


def nanoseconds(time_s: float) -> int:
    """Return the nearest number of nanoseconds, for any finite number of seconds.

    Raises
    ------
    ValueError, OverflowError
        The number is not finite.
    """
    return round(Fraction(time_s) * NS_PER_S)


def is_new(values: NDArray[np.integer[Any]]) -> Mask:
    """Return which values, shape (k,), differ from the one before; the first one always does."""
    new = np.ones(values.size, np.bool_)
    new[1:] = values[1:] != values[:-1]
    return new


def in_spans(time_ns: TimeNs, spans: Sequence[tuple[int, int]]) -> Mask:
    """Return which times lie after the start of any of some spans, up to its end, shape (k,).

    Parameters
    ----------
    time_ns : TimeNs
        Times in any order, shape (k,), ns.
    spans : sequence of (int, int)
        Start and end of each, ns. They are in the order of time and do not overlap: however many there are, each time
        looks at one.
    """
    if not spans:
        return np.zeros(len(time_ns), np.bool_)
    start_ns, end_ns = np.array(spans, dtype=np.int64).T
    begun = np.searchsorted(start_ns, time_ns)
    return np.asarray((begun > 0) & (time_ns <= end_ns[begun - 1]))


def distinct(time_ns: TimeNs) -> TimeNs:
    """Return each of some times, shape (k,), once and in order, ns.

    `numpy.unique` does so with a table of hashes, thirty times as slowly.
    """
    ordered = np.sort(time_ns)
    return ordered[is_new(ordered)]


def find_runs(mask: Mask) -> tuple[Integers, Integers]:
    """Return where a mask, shape (k,), is true: the first row of each run, and the row behind its last; (r,) each."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[::2], edges[1::2]


def in_pauses(
    from_ns: TimeNs,
    to_ns: TimeNs,
    sample_ns: TimeNs,
    longest_ns: float,
) -> Mask:
    """Return which spans have a part in a pause, shape (k,).

    Parameters
    ----------
    from_ns, to_ns : TimeNs
        Start and end of each span, shape (k,), ns.
    sample_ns : TimeNs
        Times of samples in their order, shape (r,), ns.
    longest_ns : float
        Samples that are further apart, ns, have a pause between them.
    """
    begins = np.flatnonzero(np.diff(sample_ns) > longest_ns)
    # Such a pause begins before the span ends, and ends after the span begins.
    begun = np.searchsorted(sample_ns[begins], to_ns, "left")
    ended = np.searchsorted(sample_ns[begins + 1], from_ns, "right")
    return np.asarray(ended < begun)


def nothing(shape: tuple[int, ...]) -> Floats:
    """Return missing numbers of a shape, for any unit: one NaN stands for all, and cannot be written to."""
    return np.broadcast_to(np.nan, shape)


def in_blocks(
    change: Callable[[NDArray[Scalar]], Floats], rows: NDArray[Scalar], into: Floats
) -> Floats:
    """Change rows some at a time, because what numpy needs on the way can be several times as large as they are.

    Parameters
    ----------
    change : callable
        Changes some of the rows, and may change their unit.
    rows : ndarray
        Shape (k, ...), any unit.
    into : Floats
        Where the changed rows are written, shape (k, ...). It may be the rows themselves, and is returned.
    """
    for first in range(0, len(rows), _AT_A_TIME):
        block = slice(first, first + _AT_A_TIME)
        into[block] = change(rows[block])
    return into


def apart_s(time_ns: TimeNs, values: Floats, at_ns: TimeNs) -> Floats:
    """Return the seconds from each of some times to the nearest row of values that is finite, shape (k,).

    They are infinite where there is no finite row.

    Parameters
    ----------
    time_ns : TimeNs
        Times of the rows in their order, shape (r,), ns.
    values : Floats
        Shape (r, n), any unit.
    at_ns : TimeNs
        Shape (k,), ns.
    """
    finite_ns = time_ns[np.isfinite(values).all(axis=1)]
    if not len(finite_ns):
        return np.full(len(at_ns), np.inf)
    after = np.searchsorted(finite_ns, at_ns).clip(1, max(1, len(finite_ns) - 1))
    neighbours = finite_ns[np.stack([after - 1, np.minimum(after, len(finite_ns) - 1)])]
    return np.asarray(np.abs(seconds(neighbours, at_ns)).min(axis=0))


def at_time(time_ns: TimeNs, values: Floats, at_ns: int) -> Floats:
    """Interpolate rows of values linearly at a time, shape (n,). Outside the finite rows the nearest of them counts.

    Parameters
    ----------
    time_ns : TimeNs
        Times of the rows in their order, shape (r,), ns.
    values : Floats
        Shape (r, n), any unit, but no angles that wrap around. Rows that are not finite are left out, and one at least
        is finite.
    at_ns : int
        The time, ns.
    """
    finite = np.flatnonzero(np.isfinite(values).all(axis=1))
    after = int(np.searchsorted(time_ns[finite], at_ns))
    near = finite[max(0, after - 1) : after + 1]
    offset_s = seconds(time_ns[near], at_ns)
    return np.array([np.interp(0.0, offset_s, column) for column in values[near].T])


@dataclass(frozen=True)
class Columns:
    """Rows at times, all at once or some of them."""

    time_ns: TimeNs  # (k,) of validity, strictly increasing
    # the other fields that have a row at each time, or are None
    per_row: ClassVar[tuple[str, ...]] = ()

    def rows(self, keep: Mask | slice) -> Self:
        """Keep some of the rows, chosen by a mask of shape (k,) or, without copying them, by a slice."""
        columns = {name: getattr(self, name) for name in self.per_row}
        kept: dict[str, Any] = {
            name: column if column is None else column[keep] for name, column in columns.items()
        }
        return replace(self, time_ns=self.time_ns[keep], **kept)

    def within(self, start_ns: int, end_ns: int) -> Self:
        """Keep the rows from the start to the end, both included, ns, without copying them."""
        first = np.searchsorted(self.time_ns, start_ns)
        last = np.searchsorted(self.time_ns, end_ns, side="right")
        return self.rows(slice(int(first), int(last)))


@dataclass(frozen=True)
class ImuColumns(Columns):
    """Readings of the accelerometers and gyros."""

    specific_force_b: Floats  # (k, 3) m/s^2
    angular_rate_b: Floats  # (k, 3) against inertial space, rad/s
    per_row = ("specific_force_b", "angular_rate_b")

    @cached_property
    def usual_step_s(self) -> float:
        """The median time from one sample to the next, s; NaN of a single sample."""
        steps_ns = np.diff(self.time_ns)
        if steps_ns.size:
            return float(np.median(steps_ns)) / NS_PER_S
        return np.nan

    def averaged(self, size: int) -> "ImuColumns":
        """Return the means of so many samples each, at the means of their times; a few at the end may be left out."""
        blocks = len(self.time_ns) // size
        time_ns = self.time_ns[: blocks * size].reshape(blocks, size)
        middle_ns = time_ns[:, 0] + ((time_ns - time_ns[:, :1]).mean(axis=1)).astype(np.int64)

        def means(readings: Floats) -> Floats:
            return np.asarray(readings[: blocks * size].reshape(blocks, size, 3).mean(axis=1))

        return ImuColumns(middle_ns, means(self.specific_force_b), means(self.angular_rate_b))

    def row_by_row(self) -> "ImuColumns":
        """Return the same readings as the filters go through them, so that none of their runs has to copy them."""
        return replace(
            self,
            specific_force_b=np.ascontiguousarray(self.specific_force_b),
            angular_rate_b=np.ascontiguousarray(self.angular_rate_b),
        )

    def times_only(self) -> "ImuColumns":
        """Return the times without the readings, which are the better part of a long dive's memory."""
        return ImuColumns(
            self.time_ns, self.specific_force_b[:0].copy(), self.angular_rate_b[:0].copy()
        )


@dataclass(frozen=True)
class DvlColumns(Columns):
    """Pings of the DVL, either as beams or as velocities, in the frame d of the DVL."""

    # (k, beams) along the beams, towards the seabed; NaN where a beam is lost
    beam_velocity_mps: Floats | None = None
    # (beams, 3) unit vectors towards the seabed; none with velocities: a Janus's
    beam_vectors_d: Floats | None = None
    # (k, 3) over ground, m/s, NaN where invalid; of instruments without beams
    velocity_d: Floats | None = None
    look_d: Floats | None = None  # (3,) where the beams look on average, if the messages tell it
    # (k,) m above the bottom, NaN where it is not known; None if the messages have neither it nor ranges
    altitude_m: Floats | None = None
    per_row = ("beam_velocity_mps", "velocity_d", "altitude_m")


@dataclass(frozen=True)
class SensorColumns(Columns):
    """Readings of a sensor beside IMU and DVL, see `states.SENSORS`."""

    values: Floats  # (k, s); of a depth m below the surface; of a position NaN for a height that a fix lacks
    # (k, 3, 3); of a heading the attitude that it is part of, if its messages hold one
    mat_nb: Floats | None = None
    # (k, 3) rad, of that attitude about three axes, the last one upright, if stated
    attitude_sd: Floats | None = None
    per_row = ("values", "mat_nb", "attitude_sd")


@dataclass(frozen=True)
class StatedErrors:
    """What the messages of a solution say of its errors."""

    time_ns: TimeNs  # (c,), evenly chosen
    cov: Floats  # (c, 9, 9) of velocity error, misalignment and position error, all in n, SI; NaN where not given


@dataclass(frozen=True)
class ReferenceColumns(Columns):
    """Another filter's solution, to start from and to compare with. NaN rows where a quantity is not given."""

    position: Floats  # (k, 3) latitude rad, longitude rad, height m
    velocity_n: Floats  # (k, 3) over ground, m/s
    mat_nb: Floats  # (k, 3, 3)
    stated: StatedErrors | None = None  # at times of its own; None where the messages say nothing
    per_row = ("position", "velocity_n", "mat_nb")

    @cached_property
    def known(self) -> dict[str, Mask]:
        """Which rows hold finite numbers, shape (k,), of the positions, heights, velocities and attitudes."""
        quantities = {
            "positions": self.position[:, :2],
            "heights": self.position[:, 2:],
            "velocities": self.velocity_n,
            "attitudes": self.mat_nb.reshape(-1, 9),
        }
        return {
            name: np.asarray(np.isfinite(values).all(axis=1))
            for name, values in quantities.items()
        }

    @property
    def has_position(self) -> bool:
        """Whether any row has a position."""
        return bool(self.known["positions"].any())

    @property
    def has_velocity(self) -> bool:
        """Whether any row has a velocity."""
        return bool(self.known["velocities"].any())

    @property
    def has_attitude(self) -> bool:
        """Whether any row has an attitude."""
        return bool(self.known["attitudes"].any())

    def without_attitude(self) -> "ReferenceColumns":
        """Return positions and velocities alone."""
        return replace(self, mat_nb=nothing(self.mat_nb.shape))


@dataclass(frozen=True)
class SolutionColumns:
    """A solution that the vehicle found itself, as its log or a file has it."""

    motion: ReferenceColumns  # r rows
    moved_n: Floats | None  # (r, 3) m, from an unknown origin; `motion` has no positions then
    cov_ns: TimeNs  # (c,) times, evenly chosen, of which the covariance is kept
    cov: Floats  # (c, 9, 9) of velocity error, misalignment and position error, all in n, SI; NaN where not given

    def where(self, keep: Callable[[TimeNs], Mask]) -> "SolutionColumns":
        """Keep the rows at some of the times.

        Parameters
        ----------
        keep : callable
            Returns which of some times, shape (k,), ns, are kept. It is asked twice: for the r rows, and for the c
            times of the covariance.
        """
        rows = keep(self.motion.time_ns)
        of_cov = keep(self.cov_ns)
        moved_n = None if self.moved_n is None else self.moved_n[rows]
        return SolutionColumns(
            self.motion.rows(rows), moved_n, self.cov_ns[of_cov], self.cov[of_cov]
        )


@dataclass(frozen=True)
class TruthColumns(Columns):
    """Sensor biases that only a simulation can know."""

    accel_bias_b: Floats  # (k, 3) m/s^2
    gyro_bias_b: Floats  # (k, 3) rad/s
    per_row = ("accel_bias_b", "gyro_bias_b")


@dataclass(frozen=True)
class Dive:
    """Everything that is needed to replay a dive."""

    name: str  # of the log without its ending; names the result folder
    imu: ImuColumns
    dvl: DvlColumns
    reference: ReferenceColumns | None = None
    truth: TruthColumns | None = None
    # those of `states.SENSORS` that were asked for
    sensors: Mapping[str, SensorColumns] = field(default_factory=dict)
    solutions: Mapping[str, SolutionColumns] = field(default_factory=dict)  # by filter
    # of ``[topics]``, as the log has them
    topics: Mapping[str, SensorColumns] = field(default_factory=dict)
    sha256: str = ""  # of the log's bytes; empty for a dive that was never a file
    paths: tuple[Path, ...] = ()  # of the log's files
    channels: tuple[Channel, ...] = ()  # what the log holds
    reference_delay: ReferenceDelay | None = None  # None: nobody has looked
    imu_fingerprint: ImuFingerprint | None = None  # of all samples; None: not taken yet
    start_heading: StartHeading | None = None  # None: not replayed yet
    # what was dropped, assumed or found odd while reading
    notes: tuple[Note, ...] = field(default=())
