"""What one filter estimated and when, and each innovation it met."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, Mask, ReferenceColumns, TimeNs
from insdvl_replay.core.held_out import held_out_sensor, is_never_used
from insdvl_replay.core.states import POSITION, STATES, State


@dataclass(frozen=True)
class Innovations:
    """All updates of one kind of measurement."""

    measurement: str  # its name, such as ``velocity``
    unit: str
    axes: tuple[str, ...]  # names of its components; none of a measurement that has one
    time_ns: TimeNs  # (m,) of the updates
    # (m,) of validity of what was measured: a slope's is in the middle of its window
    valid_ns: TimeNs
    measured: Floats  # (m, s), of the DVL in b
    innovation: Floats  # (m, s) predicted minus measured
    sd: Floats  # (m, s) square roots of the diagonal of S = H P H' + R
    nis: Floats  # (m,) z' S^-1 z
    used: Mask  # (m,) false where the gate rejected it
    log_det: Floats  # (m,) logarithm of the determinant of S, for the likelihood
    # largest NIS that was used; infinite where none was rejected; `NOTHING_PASSES` of what is held out
    gate: float
    # rejections in a row after which the velocity's uncertainty was opened; 0: never
    reopen_after: int
    # (m,) used in spite of the gate, after so many rejections in a row; NIS and standard deviations are those before
    reopened: Mask
    # by which R is larger at the end than configured; 1 but for adaptive noise
    noise_factor: float = 1.0
    # it measures the velocity down, see `nav.earth_model.GravityHeight`
    holds_height: bool = False

    @property
    def dof(self) -> int:
        """Degrees of freedom of one innovation."""
        return int(self.innovation.shape[1])

    @property
    def weight(self) -> Floats:
        """The share of each NIS that counts in a mean, shape (m,): of one beyond the gate, as much as the gate is.

        Left out, the rejected ones would let a diverged filter seem in order; in full, a single outlier of the DVL,
        which a gate is there for, would decide over all others.
        """
        if self.is_held_out or not np.isfinite(self.gate):
            return np.ones_like(self.nis)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.minimum(1.0, self.gate / self.nis)

    @property
    def is_held_out(self) -> bool:
        """Whether the filter got none of them."""
        return is_never_used(self.gate)

    @property
    def held_out_sensor(self) -> str:
        """The sensor that settings hold out; empty of all others."""
        return held_out_sensor(self.measurement)

    @property
    def standardised(self) -> Floats:
        """Each component of the innovation in its own standard deviation, shape (m, s)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self.innovation / self.sd


@dataclass(frozen=True)
class History:
    """States and uncertainties of one filter at the start, after each ping, at each reference time and at the end.

    Of a solution that was read and not run, the same at the same times, NaN where it has none.
    """

    filter: str  # its name in the configuration
    time_ns: TimeNs  # (k,) strictly increasing
    # (k,) whether a ping was used; the last one is the end of what a filter learnt
    updated: NDArray[np.bool_]
    position: Floats  # (k, 3) latitude rad, longitude rad, height m
    velocity_n: Floats  # (k, 3) over ground, m/s
    mat_nb: Floats  # (k, 3, 3)
    accel_bias_b: Floats  # (k, 3) m/s^2
    gyro_bias_b: Floats  # (k, 3) rad/s
    sd: Floats  # (k, n) square roots of the diagonal of P, SI units, in the order of the states
    cov_ns: TimeNs  # (c,) those of the times at which P itself was asked for
    cov: Floats  # (c, n, n) P at these times
    innovations: tuple[Innovations, ...]  # one for each kind of aiding, in the filter's order
    states: tuple[State, ...] = STATES  # the twelve, and perhaps more
    # (k, c) estimates of the last c states, SI
    constants: Floats = field(default_factory=lambda: np.empty((0, 0)))
    is_partial: bool = False  # whether NaN means that it has nothing there, as of a solution, and not that it diverged
    has_own_start: bool = False  # whether it did not start with the others on the reference
    failure: str = ""  # why a candidate gave no trajectory
    is_turned: bool = False  # whether the heading of a solution was aligned with the baseline's
    # (k, 3) sum of all corrections of the position, in its units; no rows where the filter makes none
    corrected: Floats = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def predicted(self) -> Mask:
        """Which states have a standard deviation, shape (n,): all of a filter that was run, even if it diverged."""
        return np.asarray(np.isfinite(self.sd).any(axis=0) | (not self.is_partial))

    @property
    def estimates_position(self) -> bool:
        """Whether the position is among its states."""
        return len(self.states) >= POSITION.stop and self.states[POSITION.start].id == "dp_n"

    @property
    def dead_reckoned(self) -> Floats:
        """The position with all corrections taken back: it moves by the velocity alone.

        Shape (k, 3): latitude rad, longitude rad, height m, as `position`.
        """
        if len(self.corrected):
            return self.position - self.corrected
        return self.position

    @property
    def reopened_ns(self) -> TimeNs:
        """Times at which it was set to the DVL again, by a velocity or by beams, shape (r,), ns."""
        times = [innovations.time_ns[innovations.reopened] for innovations in self.innovations]
        return np.unique(np.concatenate([np.empty(0, np.int64), *times]))

    def motion(self) -> ReferenceColumns:
        """Return where it is and how it moves; of a solution in the rows that have any of that."""
        motion = ReferenceColumns(self.time_ns, self.position, self.velocity_n, self.mat_nb)
        if self.is_partial:
            return motion.rows(np.any(list(motion.known.values()), axis=0))
        return motion

    def without_cov(self) -> "History":
        """Let go of P, by far the largest part; its diagonal stays."""
        return replace(self, cov_ns=self.cov_ns[:0].copy(), cov=self.cov[:0].copy())
