"""A filter before a pull request, and after each of its changes, as candidates.

The filter is the error-state filter for IMU and DVL of vortexntnu/vortex-auv (MIT licence, pull request #640), and the
changes are those of pull request #740. Both are written here anew, from their equations. Frames: n is north-east-down
at the start, b is forward-starboard-down. The Earth is flat and does not turn, as in the original.

    state    p_n (m), v_n (m/s), R_nb, b_a (m/s2), b_w (rad/s); a bias is reading minus truth
    errors   15 numbers: dp, dv, dtheta, and both biases, true minus estimated; true R_nb = R_nb exp(dtheta)
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from insdvl_replay import Candidate, Solution

# Columns of the errors in P, in this order.
POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
ACCEL_BIAS = slice(9, 12)
GYRO_BIAS = slice(12, 15)


@dataclass(frozen=True)
class Noise:
    """Standard deviations of all noise; those of the axes x, y and z have the shape (3,)."""

    force: np.ndarray  # m/s2/sqrt(Hz)
    rate: np.ndarray  # rad/s/sqrt(Hz)
    accel_bias: float  # its walk, m/s2/sqrt(s)
    gyro_bias: float  # its walk, rad/s/sqrt(s)
    dvl: np.ndarray  # m/s


# As the authors set it: not fitted to any of the dives.
OLD_NOISE = Noise(
    force=np.array([0.05, 0.05, 0.1]),
    rate=np.array([0.01, 0.01, 0.02]),
    accel_bias=0.001,
    gyro_bias=0.0001,
    dvl=np.array([0.01, 0.01, 0.01]),
)
# Of the AUV Snapir, as examples/snapir.toml has it: found by `insdvl-replay calibrate`.
SNAPIR_NOISE = Noise(
    force=np.array([2.8e-4, 2.8e-4, 2.8e-4]),
    rate=np.array([4.9e-6, 4.9e-6, 4.9e-6]),
    accel_bias=1e-6,
    gyro_bias=2e-10,
    dvl=np.array([0.0052, 0.0052, 0.0021]),
)
START_VARIANCE = np.repeat([1.0, 0.5, 0.1, 0.001, 0.001], 3)  # of the authors, in SI

NS_PER_S = 1e9
EARTH_RATE = 7.292115e-5  # rad/s
SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999e-3


@dataclass
class State:
    """The nominal state, and the covariance of its errors."""

    position_n: np.ndarray  # (3,), m from the start
    velocity_n: np.ndarray  # (3,), m/s
    mat_nb: np.ndarray  # (3, 3)
    accel_bias_b: np.ndarray  # (3,), m/s2
    gyro_bias_b: np.ndarray  # (3,), rad/s
    cov: np.ndarray  # (15, 15), P


class Track:
    """The states at k times; innovations, and P in n, where there is a ping."""

    def __init__(self, time_ns):
        count = len(time_ns)
        self.time_ns = time_ns  # (k,)
        self.position_n = np.empty((count, 3))  # m from the start
        self.velocity_n = np.empty((count, 3))  # m/s
        self.mat_nb = np.empty((count, 3, 3))
        self.innovation_b = np.full((count, 3), np.nan)  # predicted minus measured velocity, m/s
        self.innovation_cov = np.full((count, 3, 3), np.nan)  # S
        self.cov = np.full((count, 9, 9), np.nan)  # of velocity, misalignment and position

    def solution(self, start):
        """Return it as a solution."""
        metres = metres_per_unit(start.position[0])
        pinged = np.isfinite(self.cov[:, 0, 0])
        return Solution(
            self.time_ns,
            start.position + self.position_n / metres,
            self.velocity_n,
            self.mat_nb,
            self.cov[pinged],
            self.time_ns[pinged],
            self.innovation_b,
            self.innovation_cov,
        )


class AsItIs(Candidate):
    """The filter before the pull request. Three class attributes say which of its changes a filter has."""

    jacobian_mended = False
    order_mended = False
    decay_removed = False
    noise = OLD_NOISE
    earth_turns = False

    def run(self, dive, start):
        """Return the trajectory from the start to the end of the dive, at all IMU samples and pings."""
        latitude = start.position[0]
        self.gravity_n = np.array([0.0, 0.0, normal_gravity(latitude)])  # m/s2
        self.earth_rate_n = np.zeros(3)  # rad/s
        if self.earth_turns:
            self.earth_rate_n = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
        state = State(
            np.zeros(3),
            start.velocity_n.copy(),
            start.mat_nb.copy(),
            start.accel_bias_b.copy(),
            start.gyro_bias_b.copy(),
            self.start_cov(start),
        )
        imu = dive.imu
        time_ns = np.union1d(imu.time_ns, dive.dvl.time_ns)
        time_ns = time_ns[(time_ns > start.time_ns) & (time_ns <= imu.time_ns[-1])]
        step_s = np.diff(time_ns, prepend=start.time_ns) / NS_PER_S
        # During a step the readings are those of the sample at its end, or after it.
        samples = np.searchsorted(imu.time_ns, time_ns)
        force_b = imu.specific_force_b[samples]
        rate_b = imu.angular_rate_b[samples]
        pings = np.flatnonzero(np.isin(time_ns, dive.dvl.time_ns))
        velocities = np.searchsorted(dive.dvl.time_ns, time_ns[pings])
        velocity_d = dict(zip(pings.tolist(), dive.dvl.velocity_d[velocities], strict=True))

        track = Track(time_ns)
        for first, end in pairwise(np.unique([0, *(pings + 1), len(time_ns)])):
            rows = slice(first, end)
            moved = self.propagate(state, force_b[rows], rate_b[rows], step_s[rows])
            track.position_n[rows], track.velocity_n[rows], track.mat_nb[rows] = moved
            last = end - 1
            if last not in velocity_d:
                continue
            # The DVL's velocity less the lever arm's part, by the gyros: that of the IMU.
            turning_b = np.cross(rate_b[last] - state.gyro_bias_b, start.dvl_lever_arm_b)
            innovation = self.update(state, velocity_d[last] - turning_b)
            track.innovation_b[last], track.innovation_cov[last] = innovation
            track.position_n[last] = state.position_n
            track.velocity_n[last] = state.velocity_n
            track.mat_nb[last] = state.mat_nb
            track.cov[last] = shown_cov(state)
        return track.solution(start)

    def start_cov(self, start):
        """Return P at the start, shape (15, 15)."""
        return np.diag(START_VARIANCE)

    # --- The equations.

    def propagate(self, state, force_b, rate_b, step_s):
        """Move the state and P over k steps of the IMU; return position, velocity and attitude after each.

        Force (m/s2) and rate (rad/s) have the shape (k, 3), the steps (s) the shape (k,). In a step of dt, with
        a = R (f - b_a) + g and w = rate - b_w::

            p += v dt + a dt^2 / 2,   v += a dt,   R = R exp(w dt)
            P = F P F' + Q,           F = I + A dt + (A dt)^2 / 2,   Q = (F G W G' F' + G W G') dt / 2
        """
        step = step_s[:, None]
        force_b = force_b - state.accel_bias_b
        rate_b = rate_b - state.gyro_bias_b - state.mat_nb.T @ self.earth_rate_n
        mat_nb = np.concatenate([state.mat_nb[None], exp(rate_b * step)])
        for row in range(len(step_s)):
            mat_nb[row + 1] = mat_nb[row] @ mat_nb[row + 1]
        before_nb = mat_nb[:-1]
        accel_n = np.einsum("kij,kj->ki", before_nb, force_b) + self.gravity_n
        velocity_n = state.velocity_n + np.cumsum(accel_n * step, axis=0)
        moved_n = (velocity_n - 0.5 * accel_n * step) * step
        position_n = state.position_n + np.cumsum(moved_n, axis=0)

        dynamics = self.dynamics(before_nb, force_b, rate_b) * step_s[:, None, None]
        transition = np.eye(15) + dynamics + 0.5 * dynamics @ dynamics
        half_noise = 0.5 * step_s[:, None, None] * shaped_noise(self.noise, before_nb)
        for step_matrix, half in zip(transition, half_noise, strict=True):
            state.cov = step_matrix @ (state.cov + half) @ step_matrix.T + half

        state.position_n = position_n[-1]
        state.velocity_n = velocity_n[-1]
        state.mat_nb = mat_nb[-1]
        return position_n, velocity_n, mat_nb[1:]

    def dynamics(self, mat_nb, force_b, rate_b):
        """Return A of the errors' d/dt x = A x + G w, shape (k, 15, 15).

        The specific force f and the rate w are without their biases::

                   p    v      theta       b_a    b_w
            p      .    I        .          .      .
            v      .    .    -R [f x]      -R      .
            theta  .    .     -[w x]        .     -I
            b_a    .    .        .         -I      .
            b_w    .    .        .          .     -I

        By the last two lines biases decay within a second, while those of the state are constant. The pull request
        removes the two -I.
        """
        matrix = np.zeros((len(mat_nb), 15, 15))
        matrix[:, POSITION, VELOCITY] = IDENTITY
        matrix[:, VELOCITY, ATTITUDE] = -mat_nb @ cross_matrix(force_b)
        matrix[:, VELOCITY, ACCEL_BIAS] = -mat_nb
        matrix[:, ATTITUDE, ATTITUDE] = -cross_matrix(rate_b)
        matrix[:, ATTITUDE, GYRO_BIAS] = -IDENTITY
        if not self.decay_removed:
            matrix[:, ACCEL_BIAS, ACCEL_BIAS] = -IDENTITY
            matrix[:, GYRO_BIAS, GYRO_BIAS] = -IDENTITY
        return matrix

    def predicted_velocity(self, state):
        """Return what the DVL should measure at the IMU, R' v, in b, m/s."""
        return state.mat_nb.T @ state.velocity_n

    def dvl_jacobian(self, state):
        """Return H of the predicted velocity, shape (3, 15): R' for the velocity, [R' v x] for the attitude.

        The filter as it is has -R [v x] for the attitude, which is the derivative of R v.
        """
        jacobian = np.zeros((3, 15))
        jacobian[:, VELOCITY] = state.mat_nb.T
        if self.jacobian_mended:
            jacobian[:, ATTITUDE] = cross_matrix(self.predicted_velocity(state))
        else:
            jacobian[:, ATTITUDE] = -state.mat_nb @ cross_matrix(state.velocity_n)
        return jacobian

    def update(self, state, measured_b):
        """Correct the state by a velocity (b, m/s); return predicted minus measured velocity, and its covariance S.

        In Joseph's form::

            S = H P H' + V,   K = P H' S^-1,   P = (I - K H) P (I - K H)' + K V K'
        """
        predicted_b = self.predicted_velocity(state)
        jacobian = self.dvl_jacobian(state)
        dvl_cov = np.diag(self.noise.dvl**2)
        innovation_cov = jacobian @ state.cov @ jacobian.T + dvl_cov
        gain = np.linalg.solve(innovation_cov, jacobian @ state.cov).T
        kept = np.eye(15) - gain @ jacobian
        state.cov = kept @ state.cov @ kept.T + gain @ dvl_cov @ gain.T
        self.inject(state, gain @ (measured_b - predicted_b))
        return predicted_b - measured_b, innovation_cov

    def inject(self, state, errors):
        """Add the estimated errors, shape (15,), to the state: R = R exp(dtheta), and all others by a sum.

        P has the accelerometers' bias before the gyros'. The filter as it is takes them in the other order here.
        """
        state.position_n = state.position_n + errors[POSITION]
        state.velocity_n = state.velocity_n + errors[VELOCITY]
        state.mat_nb = state.mat_nb @ exp(errors[ATTITUDE])
        if self.order_mended:
            state.accel_bias_b = state.accel_bias_b + errors[ACCEL_BIAS]
            state.gyro_bias_b = state.gyro_bias_b + errors[GYRO_BIAS]
        else:
            state.gyro_bias_b = state.gyro_bias_b + errors[ACCEL_BIAS]
            state.accel_bias_b = state.accel_bias_b + errors[GYRO_BIAS]


# --- The changes.


class JacobianMended(AsItIs):
    """The Jacobian of the DVL is that of its prediction."""

    jacobian_mended = True


class OrderMended(AsItIs):
    """Each bias is corrected by its own error."""

    order_mended = True


class BothMended(AsItIs):
    """Jacobian and order are mended."""

    jacobian_mended = True
    order_mended = True


class DecayRemoved(BothMended):
    """Jacobian and order are mended, and biases do not decay. The noise is the old one."""

    decay_removed = True


class Tuned(DecayRemoved):
    """All is mended, the Earth turns, and noise and start are as uncertain as those of the dives."""

    noise = SNAPIR_NOISE
    earth_turns = True

    def start_cov(self, start):
        """Return P at the start, shape (15, 15), by what the tool knows of it."""
        position_sd = start.position_sd_m
        velocity_sd = start.sd[0:3]
        biases_sd = start.sd[6:12]
        matrix = np.diag(np.concatenate([position_sd, velocity_sd, np.zeros(3), biases_sd]) ** 2)
        matrix[ATTITUDE, ATTITUDE] = start.mat_nb.T @ start.cov[3:6, 3:6] @ start.mat_nb
        return matrix


# --- What the equations need.

IDENTITY = np.eye(3)


def cross_matrix(vector):
    """Return [v x] of vectors, shape (..., 3): [v x] u is the cross product of v and u."""
    return np.cross(vector[..., None, :], IDENTITY, axis=-1).swapaxes(-1, -2)


def exp(angle):
    """Return rotations by angles about their own axes, shape (..., 3), rad."""
    size = np.linalg.norm(angle, axis=-1)[..., None, None]
    cross = cross_matrix(angle)
    slope = np.sinc(size / np.pi)
    bend = 0.5 * np.sinc(0.5 * size / np.pi) ** 2
    return IDENTITY + slope * cross + bend * cross @ cross


def shaped_noise(sd, mat_nb):
    """Return G W G', shape (k, 15, 15): white noise of force and rate, and the walks of both biases, per second.

    G has -R for the force, -I for the rate and I for both walks.
    """
    matrix = np.zeros((len(mat_nb), 15, 15))
    matrix[:, VELOCITY, VELOCITY] = (mat_nb * sd.force**2) @ mat_nb.swapaxes(-1, -2)
    matrix[:, ATTITUDE, ATTITUDE] = np.diag(sd.rate**2)
    matrix[:, ACCEL_BIAS, ACCEL_BIAS] = sd.accel_bias**2 * IDENTITY
    matrix[:, GYRO_BIAS, GYRO_BIAS] = sd.gyro_bias**2 * IDENTITY
    return matrix


def shown_cov(state):
    """Return P of velocity, misalignment and position, all in n, shape (9, 9)."""
    turn = np.zeros((9, 15))
    turn[0:3, VELOCITY] = IDENTITY
    turn[3:6, ATTITUDE] = state.mat_nb
    turn[6:9, POSITION] = IDENTITY
    return turn @ state.cov @ turn.T


def normal_gravity(latitude):
    """Return the Earth's gravity at a latitude (rad), m/s2, by Somigliana's formula of WGS 84."""
    sine_squared = np.sin(latitude) ** 2
    root = np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine_squared)
    return 9.7803253359 * (1.0 + 0.00193185265241 * sine_squared) / root


def metres_per_unit(latitude):
    """Return the metres of a radian of latitude, of a radian of longitude, and of a metre of height, going down."""
    root = np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    north_m = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / root**3
    east_m = SEMI_MAJOR_M / root * np.cos(latitude)
    return np.array([north_m, east_m, -1.0])
