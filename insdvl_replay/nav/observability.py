"""Observability: which errors at the start of a span its measurements can tell apart.

The rows ``H(t) Phi(t, t0)`` of all pings are stacked. Each is divided by its measurement's noise, so that velocities
and accelerations can stand in one stack, and each state is counted in units of its prior standard deviation. A singular
value s is then a ratio of signal to noise: were there no process noise, the measurements would leave
``1 / sqrt(1 + s^2)`` of the prior uncertainty along its direction.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled
from insdvl_replay.history import History
from insdvl_replay.nav.error_model import write_system_matrix
from insdvl_replay.nav.innovation import InsAtPing, linearise
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.place import normal_gravity, place_at, within_reach
from insdvl_replay.nav.strapdown import Motion, propagate
from insdvl_replay.nav.timeline import Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.vector_algebra import Vector, add, cross, rotate_back, subtract, vector, write_vector

TOLERANCE: Final = 3e-6
"""Rounding leaves about 1e-8 of the largest singular value; the weakest effect, of the Earth's rate, is about 1e-5."""


@dataclass(frozen=True)
class NominalPings:
    """The motion around which the errors are linearised, where it is measured.

    Attributes
    ----------
    velocity_n : ndarray, shape (m, 3)
        m/s
    mat_nb : ndarray, shape (m, 3, 3)
        Attitude.
    rate_nb_b : ndarray, shape (m, 3)
        Angular rate of the body against n, rad/s.
    gravity : ndarray, shape (m,)
        m/s^2
    transition : ndarray, shape (m, 12, 12)
        Phi(t, t0), from the errors at the start to those at the ping.
    """

    velocity_n: Floats
    mat_nb: Floats
    rate_nb_b: Floats
    gravity: Floats
    transition: Floats


def nominal_pings(timeline: Timeline, nominal: History, *, earth_rate: bool = True) -> NominalPings:
    """Carry the errors at the start to each ping along a nominal motion.

    Equations (48) and (49) of Levy and Klein, as the product of ``I + F dt`` along the way; see EQUATIONS.md.

    Parameters
    ----------
    timeline : Timeline
        Nodes with readings and pings.
    nominal : History
        A row at each recorded event of the time line; from one to the next the motion is mechanised.
    earth_rate : bool
        False: let the Earth be flat and at rest, and take the Coriolis acceleration out of the readings.

    Returns
    -------
    NominalPings

    Raises
    ------
    ValueError
        The history was recorded on another time line.
    """
    if not np.array_equal(nominal.time_ns, timeline.event_ns[timeline.record]):
        raise ValueError("the nominal motion has other times than the time line records")
    pings = int(timeline.ping.max()) + 1
    found = NominalPings(
        np.empty((pings, 3)),
        np.empty((pings, 3, 3)),
        np.empty((pings, 3)),
        np.empty(pings),
        np.empty((pings, 12, 12)),
    )
    _walk(
        timeline,
        nominal.position,
        nominal.velocity_n,
        np.ascontiguousarray(nominal.mat_nb),
        nominal.accel_bias_b,
        nominal.gyro_bias_b,
        earth_rate,
        found.velocity_n,
        found.mat_nb,
        found.rate_nb_b,
        found.gravity,
        found.transition,
    )
    return found


def whitened_rows(pings: NominalPings, measurement: Measurement, lever_arm_b: Floats) -> Floats:
    """Stack ``R^(-1/2) H(t) Phi(t, t0)`` over the pings that have a measurement.

    Equation (47) of Levy and Klein: a direction is unobservable where all these rows are blind to it.

    Parameters
    ----------
    pings : NominalPings
        m pings.
    measurement : Measurement
        Of the same pings.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.

    Returns
    -------
    ndarray, shape (3 k, 12)
        Three rows for each of the k pings that have the measurement.
    """
    rows = np.flatnonzero(measurement.available)
    H = np.empty((len(rows), 3, 12))
    _jacobians(measurement, rows, pings.velocity_n, pings.mat_nb, pings.rate_nb_b, pings.gravity, lever_arm_b, H)
    L = np.linalg.cholesky(measurement.cov_b[rows])
    whitened: Floats = np.linalg.solve(L, H @ pings.transition[rows]).reshape(-1, 12)
    return whitened


@dataclass(frozen=True)
class Observability:
    """What a stack of measurements tells about the errors at the start.

    Attributes
    ----------
    singular_values : ndarray, shape (12,)
        Falling; signal to noise of each direction.
    directions : ndarray, shape (12, 12)
        Row i is the direction of singular value i, in prior standard deviations, of unit length; its largest
        component is positive.
    tolerance : float
        A singular value up to this share of the largest is called zero.
    """

    singular_values: Floats
    directions: Floats
    tolerance: float

    @property
    def rank(self) -> int:
        """Number of observable directions."""
        return int(np.sum(self.singular_values > self.tolerance * self.singular_values[0]))

    @property
    def gap(self) -> float:
        """Ratio of the last singular value that counts to the first that does not; NaN with full rank."""
        if not 0 < self.rank < len(self.singular_values):
            return float("nan")
        above, below = self.singular_values[self.rank - 1 : self.rank + 1]
        return float(above / below) if below > 0.0 else float("inf")

    @property
    def unobservable(self) -> Floats:
        """Orthonormal basis of what is not observable, in prior standard deviations, shape (12 - rank, 12)."""
        return self.directions[self.rank :]

    def response(self, direction: Floats) -> float:
        """Give the signal to noise with which the measurements see an error in a direction.

        Parameters
        ----------
        direction : ndarray, shape (12,)
            In prior standard deviations, of unit length.

        Returns
        -------
        float
            Between the smallest and the largest singular value.
        """
        return float(np.linalg.norm(self.singular_values * (self.directions @ direction)))

    def left(self) -> Floats:
        """Give the share of each state's prior standard deviation that the measurements leave, shape (12,)."""
        var = 1.0 / (1.0 + self.singular_values**2)
        share: Floats = np.sqrt(var @ self.directions**2)
        return share


def analyse(rows: Floats, prior_sd: Floats, tolerance: float = TOLERANCE) -> Observability:
    """Decompose a stack of measurement rows.

    Parameters
    ----------
    rows : ndarray, shape (k, 12)
        From `whitened_rows`, of one measurement or several.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.
    tolerance : float
        A singular value up to this share of the largest is called zero.

    Returns
    -------
    Observability
    """
    # R has the singular values of the stack, and is as small as one ping whatever the length of the dive.
    triangle = np.asarray(np.linalg.qr(rows * prior_sd, mode="r"))
    R = np.zeros((12, 12))
    R[: len(triangle)] = triangle
    _, singular_values, directions = np.linalg.svd(R)
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None], axis=1)
    return Observability(singular_values, directions * np.sign(largest), tolerance)


@compiled
def _walk(
    timeline: Timeline,
    nominal_position: Floats,
    nominal_velocity_n: Floats,
    nominal_mat_nb: Floats,
    accel_bias_b: Floats,
    gyro_bias_b: Floats,
    earth_rate: bool,
    velocity_n: Floats,
    mat_nb: Floats,
    rate_nb_b: Floats,
    gravity: Floats,
    transition: Floats,
) -> None:
    """Mechanise from one recorded event to the next, and multiply up the transition."""
    position_now, velocity_now, mat_now = (
        nominal_position[0].copy(),
        nominal_velocity_n[0].copy(),
        nominal_mat_nb[0].copy(),
    )
    place, row = place_at(position_now[0], position_now[2]), 0
    F, Phi = np.zeros((12, 12)), np.eye(12)
    before = first_node(timeline)
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        before_n = vector(velocity_now)
        if not within_reach(place, position_now[0], position_now[2]):
            place = place_at(position_now[0], position_now[2])
        force_b = subtract(mean(before.specific_force_b, now.specific_force_b), vector(accel_bias_b[row]))
        rate_b = subtract(mean(before.angular_rate_b, now.angular_rate_b), vector(gyro_bias_b[row]))
        motion = propagate(position_now, velocity_now, mat_now, force_b, rate_b, dt, place)
        rate_in_b = rotate_back(motion.mat_nb, motion.rate_in_n)
        write_system_matrix(motion if earth_rate else _on_a_resting_earth(motion, before_n), F)
        Phi += dt * (F @ Phi)
        before = now
        if not is_event(timeline, now):
            continue

        ping = timeline.ping[now.event]
        if timeline.record[now.event]:
            row += 1
            position_now[:] = nominal_position[row]
            velocity_now[:] = nominal_velocity_n[row]
            mat_now[:, :] = nominal_mat_nb[row]
        if ping >= 0:
            velocity_n[ping] = velocity_now
            mat_nb[ping] = mat_now
            rate_ib_b = subtract(now.angular_rate_b, vector(gyro_bias_b[row]))
            write_vector(subtract(rate_ib_b, rate_in_b), rate_nb_b[ping])
            gravity[ping] = normal_gravity(position_now[0], position_now[2])
            transition[ping] = Phi


@compiled
def _on_a_resting_earth(motion: Motion, velocity_n: Vector) -> Motion:
    """Give the motion with the specific force that the same way would take on an Earth that is flat and at rest."""
    coriolis_n = cross(add(motion.rate_ie_n, motion.rate_in_n), velocity_n)
    still = (0.0, 0.0, 0.0)
    return Motion(still, still, subtract(motion.force_n, coriolis_n), motion.mat_nb)


@compiled
def _jacobians(
    measurement: Measurement,
    pings: NDArray[np.int64],
    velocity_n: Floats,
    mat_nb: Floats,
    rate_nb_b: Floats,
    gravity: Floats,
    lever_arm_b: Floats,
    H: Floats,
) -> None:
    """Write the Jacobian of each ping. What only the innovation needs is left at zero."""
    force_b, unused_b, z = np.zeros(3), np.zeros(velocity_n.shape), np.zeros(3)
    for i, ping in enumerate(pings):
        ins = InsAtPing(
            velocity_n[ping], mat_nb[ping], force_b, rate_nb_b, unused_b, unused_b, gravity[ping], lever_arm_b
        )
        linearise(measurement, ping, ins, z, H[i])
