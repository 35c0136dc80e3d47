"""What one filter believed and when, and each innovation it met."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.states import POSITION, STATES, State


@dataclass(frozen=True)
class Innovations:
    """All updates of one kind of measurement.

    Attributes
    ----------
    measurement : str
        Its name, such as ``velocity``.
    unit : str
        Unit of the innovation.
    axes : tuple of str
        Names of its components; none of a measurement that has one.
    time_ns : ndarray, shape (m,)
        Time of each update.
    valid_ns : ndarray, shape (m,)
        Time of validity of what was measured: a slope's lies in the middle of its window.
    measured : ndarray, shape (m, s)
        What the sensor said, the DVL in b.
    innovation : ndarray, shape (m, s)
        Predicted minus measured.
    sd : ndarray, shape (m, s)
        Square roots of the diagonal of S = H P H' + R.
    nis : ndarray, shape (m,)
        Normalised innovation squared, z' S^-1 z.
    used : ndarray of bool, shape (m,)
        False where the gate rejected it.
    log_det : ndarray, shape (m,)
        Logarithm of the determinant of S, for the likelihood.
    gate : float
        Largest NIS that was used; infinite where none was rejected.
    reopen_after : int
        Rejections in a row after which the velocity's uncertainty was opened; 0: never.
    reopened : ndarray of bool, shape (m,)
        Used in spite of the gate, after so many rejections in a row that the velocity's uncertainty was opened; NIS and
        standard deviations are those before.
    noise_factor : float
        By how much R is larger at the end than it is said to be, by the innovations; 1 but for adaptive noise.
    holds_height : bool
        It measures the velocity down, see `nav.earth_model.GravityHeight`.
    """

    measurement: str
    unit: str
    axes: tuple[str, ...]
    time_ns: TimeNs
    valid_ns: TimeNs
    measured: Floats
    innovation: Floats
    sd: Floats
    nis: Floats
    used: NDArray[np.bool_]
    log_det: Floats
    gate: float
    reopen_after: int
    reopened: NDArray[np.bool_]
    noise_factor: float = 1.0
    holds_height: bool = False

    @property
    def dof(self) -> int:
        """Degrees of freedom of one innovation."""
        return int(self.innovation.shape[1])

    @property
    def weight(self) -> Floats:
        """The share of each NIS that counts in a mean, shape (m,): of one beyond the gate, as much as the gate is.

        Left out, the rejected ones would let a filter that has lost its way seem in order; in full, a single outlier
        of the DVL, which a gate is there for, would decide over all others.
        """
        if self.is_withheld or not np.isfinite(self.gate):
            return np.ones_like(self.nis)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.minimum(1.0, self.gate / self.nis)

    @property
    def is_withheld(self) -> bool:
        """Whether the filter was told of none of them."""
        return self.gate < 0.0

    @property
    def standardised(self) -> Floats:
        """Each component of the innovation in its own standard deviation, shape (m, s)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self.innovation / self.sd


@dataclass(frozen=True)
class History:
    """States and uncertainties of one filter at the start, after each ping, at each reference time and at the end.

    Of a solution that was read and not run, the same at the same times, NaN where it says nothing.

    Attributes
    ----------
    filter : str
        The filter's name in the configuration.
    time_ns : ndarray, shape (k,)
        Times, strictly increasing.
    updated : ndarray of bool, shape (k,)
        Whether a ping was used here. The first row is the start, the last updated one is the end of what a filter
        learnt.
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (k, 3)
        Velocity over ground, m/s.
    mat_nb : ndarray, shape (k, 3, 3)
        Attitude.
    accel_bias_b, gyro_bias_b : ndarray, shape (k, 3)
        Estimated sensor biases, m/s^2 and rad/s.
    sd : ndarray, shape (k, n)
        Square roots of the diagonal of P, SI units, in the order of the states.
    cov_ns : ndarray, shape (c,)
        Those of the times at which P itself was asked for.
    cov : ndarray, shape (c, n, n)
        P at these times.
    innovations : tuple of Innovations
        One entry for each kind of aiding, in the filter's order.
    states : tuple of State
        What it estimates: the twelve of `states.STATES`, and perhaps more.
    constants : ndarray, shape (k, c)
        What it takes the constants of the sensors to be, the last c of its states, SI units.
    is_partial : bool
        Whether NaN means that it says nothing there, as of a recorded solution, and not that it broke down.
    has_own_start : bool
        Whether it did not start with the others on the reference.
    is_turned : bool
        Whether the heading of a solution was laid on the baseline's, so that it does not err at first.
    corrected : ndarray, shape (k, 3)
        Sum of all corrections of the position up to each time, in the units of ``position``; no rows where the filter
        makes none.
    """

    filter: str
    time_ns: TimeNs
    updated: NDArray[np.bool_]
    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats
    sd: Floats
    cov_ns: TimeNs
    cov: Floats
    innovations: tuple[Innovations, ...]
    states: tuple[State, ...] = STATES
    constants: Floats = field(default_factory=lambda: np.empty((0, 0)))
    is_partial: bool = False
    has_own_start: bool = False
    is_turned: bool = False
    corrected: Floats = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def believed(self) -> NDArray[np.bool_]:
        """Of which states it says how sure it is, shape (n,): all of a filter that was run, even if it broke down."""
        return np.asarray(np.isfinite(self.sd).any(axis=0) | (not self.is_partial))

    @property
    def estimates_position(self) -> bool:
        """Whether the position is among its states."""
        return len(self.states) >= POSITION.stop and self.states[POSITION.start].id == "dp_n"

    @property
    def dead_reckoned(self) -> Floats:
        """The position with all corrections taken back, shape (k, 3): it moves by the velocity alone."""
        return self.position - self.corrected if len(self.corrected) else self.position

    @property
    def reopened_ns(self) -> TimeNs:
        """Times at which it was set to the DVL again, by a velocity or by beams, shape (r,)."""
        times = [one.time_ns[one.reopened] for one in self.innovations]
        return np.unique(np.concatenate([np.empty(0, np.int64), *times]))

    def motion(self) -> ReferenceColumns:
        """Return where it is and how it moves, in the rows that say anything of that."""
        motion = ReferenceColumns(self.time_ns, self.position, self.velocity_n, self.mat_nb)
        return motion.rows(np.any(list(motion.known.values()), axis=0)) if self.is_partial else motion

    def without_cov(self) -> "History":
        """Let go of P, by far the largest part; its diagonal stays."""
        return replace(self, cov_ns=self.cov_ns[:0].copy(), cov=self.cov[:0].copy())
