"""Observability: the errors at the start of a span that its measurements can tell apart.

The rows ``H(t) Phi(t, t0)`` of all pings are stacked. Each is divided by its measurement's noise, so that velocities
and accelerations fit into one stack, and each state is in units of its prior standard deviation. A singular value s is
then a ratio of signal to noise: without process noise, the measurements leave ``1 / sqrt(1 + s^2)`` of the prior
uncertainty along its direction. What they leave with it, see `remaining_cov`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import compiled, inlined
from insdvl_replay.nav.algebra import (
    Vector,
    add,
    cross,
    rotate_back,
    row_matrix,
    row_vector,
    subtract,
    vector,
    write_row_matrix,
    write_row_vector,
)
from insdvl_replay.nav.earth_model import (
    NOWHERE,
    gravity_at,
    local_earth_at,
    local_earth_near,
    normal_gravity,
    transport_curvature,
    transport_rate_n,
)
from insdvl_replay.nav.error_model import (
    TWELVE,
    TWELVE_ALONE,
    add_noise,
    over,
    propagate_cov,
    propagate_errors,
)
from insdvl_replay.nav.kalman import multiply
from insdvl_replay.nav.measurements import InsNow, Measurement, Memory, Stack, linearise, stacked
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import PINGS, Timeline, first_node, is_event, is_last, next_node

TOLERANCE: Final = 3e-6
"""Rounding leaves about 1e-8 of the largest singular value; the weakest effect, of the Earth's rate, is about 1e-5."""


class NominalPings(NamedTuple):
    """The motion around which the errors are linearised, at the pings."""

    velocity_n: Floats  # (m, 3), m/s
    mat_nb: Floats  # (m, 3, 3)
    rate_nb_b: Floats  # (m, 3), angular rate of the body against n, rad/s
    gravity: Floats  # (m,), m/s^2
    # (m, 12, 12), Phi(t, t0), from the errors at the start to those at the ping
    transition: Floats
    step: Floats  # (m, 12, 12), Phi from the ping before, for the first from the start
    noise: Floats  # (m, 12, 12), covariance that process noise has added meanwhile


def nominal_pings(
    timeline: Timeline,
    nominal: History,
    noise_density: Floats,
    *,
    earth_rate: bool = True,
) -> NominalPings:
    """Carry the errors at the start to each ping along a nominal motion.

    Equations (48) and (49) of Levy and Klein, as the product of ``I + F dt`` along the way; see
    docs/equations/observability.md.

    Parameters
    ----------
    nominal : History
        A row at each recorded event of the time line; from one to the next the motion is mechanised.
    noise_density : ndarray, shape (12,)
        From `error_model.noise_density`; long gaps of the IMU add theirs.
    earth_rate : bool
        False: the Earth is flat and at rest, and the Coriolis acceleration is taken out of the readings.

    Raises
    ------
    ValueError
        The history was recorded on another time line.
    """
    if not np.array_equal(nominal.time_ns, timeline.event_ns[timeline.record >= 0]):
        raise ValueError("the nominal motion has other times than the time line records")
    pings = int(timeline.ping.max()) + 1
    found = NominalPings(
        np.empty((pings, 3)),
        np.empty((pings, 3, 3)),
        np.empty((pings, 3)),
        np.empty(pings),
        *np.empty((3, pings, TWELVE, TWELVE)),
    )
    mat_nb = np.ascontiguousarray(nominal.mat_nb)
    states = (
        nominal.position,
        nominal.velocity_n,
        mat_nb,
        nominal.accel_bias_b,
        nominal.gyro_bias_b,
    )
    _walk_motion(timeline, states, tuple(noise_density.tolist()), earth_rate, found)
    return found


States = tuple[Floats, Floats, Floats, Floats, Floats]
"""Columns of navigation states, in the order of `strapdown.NavState`."""


@inlined
def _state_at(states: States, row: int) -> NavState:
    return NavState(
        row_vector(states[0], row),
        row_vector(states[1], row),
        row_matrix(states[2], row),
        row_vector(states[3], row),
        row_vector(states[4], row),
    )


@compiled
def _walk_motion(
    timeline: Timeline,
    nominal: States,
    noise_density: tuple[float, ...],
    earth_rate: bool,
    found: NominalPings,
) -> None:
    """Mechanise from one recorded event to the next, and let errors grow and noise gather from ping to ping."""
    transition = np.eye(TWELVE)
    step = np.eye(TWELVE)
    noise = np.zeros((TWELVE, TWELVE))
    step_by_row = step.ravel()
    noise_by_row = noise.ravel()
    state = _state_at(nominal, timeline.record[0])
    earth = NOWHERE
    before = first_node(timeline)
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        before_n = state.velocity_n
        earth = local_earth_near(state.position, earth)
        gravity = gravity_at(earth, state.position[2])
        state, motion = propagate(state, before.readings, now.readings, dt, earth, gravity)
        errors_motion = motion
        if not earth_rate:
            # The same way on an Earth that is flat and at rest takes another specific force.
            coriolis_n = cross(add(motion.rate_ie_n, motion.rate_in_n), before_n)
            still = (0.0, 0.0, 0.0)
            errors_motion = Motion(
                still, still, subtract(motion.force_n, coriolis_n), motion.mat_nb, still
            )
        propagate_errors(step_by_row, noise_density, over(errors_motion, dt))
        propagate_cov(noise_by_row, errors_motion, noise_density, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(noise_by_row, TWELVE, timeline.gap_noise_density[gap], dt)
        before = now
        if not is_event(timeline, now):
            continue

        ping = timeline.rows[PINGS, now.event]
        row = timeline.record[now.event]
        if row >= 0:
            state = _state_at(nominal, row)
        if ping >= 0:
            write_row_vector(state.velocity_n, found.velocity_n, ping)
            write_row_matrix(state.mat_nb, found.mat_nb, ping)
            rate_ib_b = subtract(now.readings.angular_rate_b, state.gyro_bias_b)
            rate_in_b = rotate_back(motion.mat_nb, motion.rate_in_n)
            write_row_vector(subtract(rate_ib_b, rate_in_b), found.rate_nb_b, ping)
            found.gravity[ping] = normal_gravity(state.position[0], state.position[2])
            multiply(step, transition, found.transition[ping])
            found.step[ping] = step
            found.noise[ping] = noise
            transition = found.transition[ping]
            step[:] = np.eye(TWELVE)
            noise[:] = 0.0


def whitened_rows(pings: NominalPings, measurement: Measurement, lever_arm_b: Floats) -> Floats:
    """Stack ``R^(-1/2) H(t) Phi(t, t0)`` over the pings that have a measurement, shape (3 k, 12).

    Equation (47) of Levy and Klein: a direction is unobservable where all these rows are zero along it. The lever arm
    is from the IMU to the DVL, m.
    """
    rows = np.flatnonzero(measurement.available)
    H = jacobians(pings, measurement, lever_arm_b)[rows]
    L = np.linalg.cholesky(measurement.cov[rows])
    whitened: Floats = np.linalg.solve(L, H @ pings.transition[rows]).reshape(-1, TWELVE)
    return whitened


def jacobians(pings: NominalPings, measurement: Measurement, lever_arm_b: Floats) -> Floats:
    """Return the H of a measurement at every ping, shape (m, 3, 12); zero without a measurement."""
    H = np.zeros((len(measurement.available), 3, TWELVE))
    _write_jacobians(
        stacked((measurement,)),
        np.flatnonzero(measurement.available),
        pings,
        vector(lever_arm_b),
        H,
    )
    return H


@compiled
def _write_jacobians(
    measurement: Stack,
    rows: NDArray[np.int64],
    pings: NominalPings,
    lever_arm_b: Vector,
    H: Floats,
) -> None:
    """Write the Jacobian of each ping. What only the innovation needs is left at zero."""
    unused = (0.0, 0.0, 0.0)
    unused_b = np.zeros(pings.velocity_n.shape)
    z = np.empty(3)
    memory = Memory(pings.rate_nb_b, unused_b, unused_b)
    nothing = np.empty(0)
    for ping in rows:
        velocity_n = row_vector(pings.velocity_n, ping)
        mat_nb = row_matrix(pings.mat_nb, ping)
        gravity = pings.gravity[ping]
        ins = InsNow(
            unused, velocity_n, mat_nb, unused, memory, gravity, lever_arm_b, NOWHERE, unused, nothing
        )  # fmt: skip
        linearise(measurement, 0, ping, ins, TWELVE_ALONE, None, z, H[ping])


@dataclass(frozen=True)
class Observability:
    """Information of a stack of measurements about the errors at the start."""

    singular_values: Floats  # (12,), falling; signal to noise of each direction
    directions: Floats  # (12, 12), a row for each, in prior standard deviations, of unit length; largest part positive
    tolerance: float  # a singular value up to this share of the largest counts as zero

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
        """Return the signal to noise for an error in a direction, shape (12,), of unit length in prior sd."""
        return float(np.linalg.norm(self.singular_values * (self.directions @ direction)))

    def left(self) -> Floats:
        """Return the share of each state's prior standard deviation that is left without process noise, shape (12,)."""
        return np.asarray(np.sqrt(1.0 / (1.0 + self.singular_values**2) @ self.directions**2))


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
    """
    # R has the singular values of the stack, and is as small as one ping whatever the length of the dive.
    triangle = np.asarray(np.linalg.qr(rows * prior_sd, mode="r"))
    R = np.zeros((TWELVE, TWELVE))
    R[: len(triangle)] = triangle
    _, singular_values, directions = np.linalg.svd(R)
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None], axis=1)
    return Observability(singular_values, directions * np.sign(largest), tolerance)


def remaining_cov(
    pings: NominalPings,
    measurements: Sequence[Measurement],
    lever_arm_b: Floats,
    prior_sd: Floats,
) -> Floats:
    """Return P after the last ping: ``P <- Phi P Phi' + Q`` from one to the next, then its updates, shape (12, 12).

    Observability is about the errors at the start, which do not change any more. On the way errors grow into each other
    and process noise adds to them, so that more may be left at the end than there was at the start.

    Parameters
    ----------
    measurements : sequence of Measurement
        Of the same pings; applied in this order.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.
    """
    P = np.diag(np.square(prior_sd))
    identity = np.eye(TWELVE)
    jacobians_of = [jacobians(pings, measurement, lever_arm_b) for measurement in measurements]
    for ping, (step, noise) in enumerate(zip(pings.step, pings.noise, strict=True)):
        P = step @ P @ step.T + noise
        for measurement, H_of in zip(measurements, jacobians_of, strict=True):
            if measurement.available[ping]:
                H = H_of[ping]
                R = measurement.cov[ping]
                K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
                kept = identity - K @ H
                P = kept @ P @ kept.T + K @ R @ K.T
        P = 0.5 * (P + P.T)
    return np.asarray(P)


# Named directions of error, since straight and level motion hides them
#
# A misalignment tilts gravity, and an accelerometer bias can cancel it: the pair stays. So does a heading error with
# the velocity error that turns the way as a whole. On the turning Earth each also needs the gyro bias that cancels the
# Earth's rate.


@dataclass(frozen=True)
class ErrorDirection:
    """A direction in the space of the 12 error states."""

    id: str  # name in tables
    label: str  # name in words
    error: Floats  # (12,), SI units; the leading state is 1

    def scaled(self, prior_sd: Floats) -> Floats:
        """Return the direction in prior standard deviations, of unit length."""
        scaled = self.error / prior_sd
        return np.asarray(scaled / np.linalg.norm(scaled))


def named_directions(
    position: Floats,
    velocity_n: Floats,
    mat_nb: Floats,
    *,
    earth_rate: bool = True,
) -> tuple[ErrorDirection, ...]:
    """Make the directions that steady motion hides from velocities, or from accelerations.

    Equations (50) to (54) of Levy and Klein, and what they leave out; see docs/equations/observability.md.

    Parameters
    ----------
    position, velocity_n : ndarray, shape (3,)
        At the start; latitude rad, longitude rad, height m, and m/s.
    mat_nb : ndarray, shape (3, 3)
        Attitude at the start.
    earth_rate : bool
        False: on an Earth that is flat and at rest.

    Returns
    -------
    tuple of ErrorDirection
        In an order in which each is simpler than those after it.
    """
    zero = np.zeros(3)
    axes = ("north", "east", "down")
    earth = local_earth_at(float(position[0]), float(position[2]))

    def rate_en_n(moving_n: Floats) -> Floats:
        curvature = transport_curvature(earth, float(position[2]))
        return np.array(transport_rate_n(curvature, vector(moving_n))) if earth_rate else zero

    rate_ie_n = np.array(earth.rate_ie_n) if earth_rate else zero
    rate_in_n = rate_ie_n + rate_en_n(velocity_n)
    coriolis_n = rate_ie_n + rate_in_n
    force_n = np.cross(coriolis_n, velocity_n) - np.array(
        [0.0, 0.0, normal_gravity(position[0], position[2])]
    )
    velocities = []
    tilts = []
    for axis, across, unit in zip(axes, ("east", "north", ""), np.eye(3), strict=True):
        error = np.concatenate([unit, zero, zero, zero])
        velocities.append(ErrorDirection(f"dv_{axis[0]}", f"velocity error {axis}", error))
        label = f"misalignment about {axis} with accelerometer bias {across}"
        label = (
            label if across else "heading with velocity error across"
        ) + " and gyro bias" * earth_rate
        dv = -np.cross(velocity_n, unit)
        ba = mat_nb.T @ (np.cross(force_n, unit) + np.cross(coriolis_n, dv))
        bg = mat_nb.T @ (np.cross(rate_in_n, unit) + rate_en_n(dv))
        tilts.append(
            ErrorDirection(f"phi_{axis[0]} held", label, np.concatenate([dv, unit, ba, bg]))
        )
    down_n = np.array([0.0, 0.0, 1.0])
    down_b = mat_nb.T @ down_n
    across_b = -mat_nb.T @ np.cross(velocity_n, down_n)
    gyro = ErrorDirection(
        "bg_d", "gyro bias about down", np.concatenate([zero, zero, zero, down_b])
    )
    # A heading that drifts by the gyro bias bends the way as steadily as the accelerometer bias does.
    bent_error = np.concatenate([zero, zero, across_b, down_b])
    bent = ErrorDirection(
        "bg_d held", "gyro bias about down with accelerometer bias across", bent_error
    )
    return (*velocities, *tilts, gyro, bent)


def name_unobservable(
    observability: Observability, directions: tuple[ErrorDirection, ...], prior_sd: Floats
) -> tuple[ErrorDirection, ...]:
    """Return the named directions that span the unobservable space.

    The least observable come first. A direction is taken if more than half of it is in the unobservable space that has
    no name yet.

    Parameters
    ----------
    directions : tuple of ErrorDirection
        From `named_directions`.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.

    Returns
    -------
    tuple of ErrorDirection
        At most 12 less the rank; in the order of ``directions``.
    """
    unnamed = observability.unobservable
    found = set()
    for direction in sorted(
        directions, key=lambda named: observability.response(named.scaled(prior_sd))
    ):
        part = unnamed.T @ (unnamed @ direction.scaled(prior_sd))
        if part @ part > 0.5:
            found.add(direction.id)
            # The rest is at right angles to the part that was named.
            _, _, basis = np.linalg.svd(
                unnamed @ (np.eye(TWELVE) - np.outer(part, part) / (part @ part))
            )
            unnamed = basis[: len(unnamed) - 1]
    return tuple(direction for direction in directions if direction.id in found)
