"""The usual error-state Kalman filter of INS and DVL as a class: what others in this folder change one step of.

    VEHICLE=vehicle.toml PYTHONPATH=examples/candidates insdvl-replay run dive.mcap -c mine.toml --allow-code

``VEHICLE`` names the settings of the vehicle, such as the vehicle.toml in the result of an earlier run. The noise is
that of the baseline then, so that only the filters differ.

The error is estimated minus true for velocity ``dv`` (n, m/s) and misalignment ``phi`` (n, rad): the estimated attitude
is ``(I + [phi x])`` times the true one. Of the biases (b, m/s2 and rad/s) it is true minus estimated. n is
north-east-down, b is forward-starboard-down, and ``C`` turns b into n.

    dv'  = -[f x] phi - [2 w_ie + w_en] x dv + C ba      f: specific force in n, m/s2
    phi' = -w_in x phi + C bg                            w_ie, w_in: of the Earth and of n, in n, rad/s
    z    = C' v + w x l - y                              y: velocity of the DVL, l: from the IMU to the DVL, m
    H    = [C' | C' [v x] | 0 | -[l x]]

Source: P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems".
"""

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insdvl_replay import Candidate, Solution

EARTH_RATE = 7.292115e-5  # rad/s
SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999e-3
V = slice(0, 3)  # rows of the error: velocity, misalignment, biases of accelerometers and gyros
PHI = slice(3, 6)
BA = slice(6, 9)
BG = slice(9, 12)
STEP_NS = 50_000_000  # of the filter: 20 Hz is enough for a vehicle that turns slowly
BEAM_TILT = np.deg2rad(30.0)
GATE = 25.9  # of the squared innovation over its covariance: one of 100 000 correct velocities is beyond it
REOPENED_AFTER = 5  # rejected velocities: then the filter is wrong, not the DVL


@dataclass
class Ins:
    """What the filter estimates, and the covariance of its error."""

    position: np.ndarray  # latitude rad, longitude rad, height m
    velocity_n: np.ndarray  # m/s
    mat_nb: np.ndarray
    accel_bias_b: np.ndarray  # m/s2
    gyro_bias_b: np.ndarray  # rad/s
    P: np.ndarray  # (12, 12), SI


@dataclass
class Noise:
    """The noise of the sensors."""

    density: np.ndarray  # (12,), of the process, squared, per second
    dvl_b: np.ndarray  # (3, 3), covariance of the DVL's velocity, m2/s2

    @classmethod
    def of_vehicle(cls):
        """Read it from the settings that ``VEHICLE`` names."""
        if "VEHICLE" not in os.environ:
            raise ValueError(
                "VEHICLE is not set; it names the settings with the noise, such as VEHICLE=replay/dive/vehicle.toml"
            )
        settings = tomllib.loads(Path(os.environ["VEHICLE"]).read_text("utf-8"))
        noise = settings["noise"]
        sd = [
            noise["accel_white_mps_rts"],
            noise["gyro_white_rad_rts"],
            noise["accel_bias_walk_mps2_rts"],
            noise["gyro_bias_walk_radps_rts"],
        ]
        # Four beams at 90 degrees to each other: least squares share their noise so.
        along = 2.0 * np.sin(BEAM_TILT) ** 2
        down = 4.0 * np.cos(BEAM_TILT) ** 2
        variance = settings["dvl"]["beam_sd_mps"] ** 2
        return cls(
            np.repeat(np.square(sd), 3), variance * np.diag([1 / along, 1 / along, 1 / down])
        )


class KalmanFilter(Candidate):
    """Velocity of the DVL, 12 states, one update a ping."""

    def run(self, dive, start):
        """Return the trajectory from the start to the end of the dive."""
        noise = Noise.of_vehicle()
        pings = np.isfinite(dive.dvl.velocity_d).all(axis=1) & (dive.dvl.time_ns > start.time_ns)
        ping_ns = dive.dvl.time_ns[pings]
        measured_b = dive.dvl.velocity_d[pings]
        imu_ns = dive.imu.time_ns
        steps_ns = np.arange(start.time_ns, imu_ns[-1], STEP_NS)
        time_ns = np.union1d(steps_ns, ping_ns[ping_ns <= imu_ns[-1]])
        force_b = step_means(time_ns, imu_ns, dive.imu.specific_force_b)
        rate_b = step_means(time_ns, imu_ns, dive.imu.angular_rate_b)
        rate_at_ping_b = at_times(ping_ns, imu_ns, dive.imu.angular_rate_b)
        row_of_ping = np.searchsorted(time_ns, ping_ns)

        ins = Ins(
            start.position.copy(),
            start.velocity_n.copy(),
            start.mat_nb.copy(),
            start.accel_bias_b.copy(),
            start.gyro_bias_b.copy(),
            self.from_usual(start.velocity_n) @ start.cov @ self.from_usual(start.velocity_n).T,
        )
        rows = Rows.of(time_ns)
        rows.keep(0, ins)
        rows.keep_cov(0, ins, self.from_usual(ins.velocity_n))
        ping = 0
        rejected = 0
        since_ping = np.zeros((12, 12))
        for row in range(1, len(time_ns)):
            step_s = (time_ns[row] - time_ns[row - 1]) * 1e-9
            force = force_b[row - 1] - ins.accel_bias_b
            rate = rate_b[row - 1] - ins.gyro_bias_b
            since_ping += self.predict(ins, force, rate, step_s, noise)
            if ping < len(row_of_ping) and row_of_ping[ping] == row:
                rate = rate_at_ping_b[ping] - ins.gyro_bias_b
                turn_b = rate - ins.mat_nb.T @ frame_rates(ins)[0]
                z, H = self.innovation(ins, measured_b[ping], turn_b, start.dvl_lever_arm_b)
                K, S, P = self.gain(ins.P, H, noise.dvl_b, since_ping)
                rows.innovation_b[row] = z
                rows.innovation_cov[row] = S
                if z @ np.linalg.solve(S, z) <= GATE or rejected >= REOPENED_AFTER:
                    ins.P = 0.5 * (P + P.T)
                    self.correct(ins, K @ z)
                    rejected = 0
                else:
                    rejected += 1
                since_ping = np.zeros((12, 12))
                ping += 1
                rows.keep_cov(row, ins, self.from_usual(ins.velocity_n))
            rows.keep(row, ins)
        return rows.solution()

    def predict(self, ins, force_b, rate_b, step_s, noise):
        """Move INS and covariance on by a step; return the process noise of the step."""
        earth_n, carried_n = frame_rates(ins)
        frame_n = earth_n + carried_n
        coriolis_n = 2.0 * earth_n + carried_n
        gravity_n = np.array([0.0, 0.0, normal_gravity(ins.position)])
        turned_nb = rotation(-step_s * frame_n) @ ins.mat_nb @ rotation(step_s * rate_b)
        force_n = 0.5 * (ins.mat_nb + turned_nb) @ force_b

        F = self.error_rate(ins, force_n, gravity_n, (earth_n, frame_n, coriolis_n))
        G = self.noise_input(ins)
        step_noise = (G * (noise.density * step_s)) @ G.T
        moved = np.eye(12) + F * step_s
        ins.P = moved @ ins.P @ moved.T + step_noise

        before_n = ins.velocity_n
        change = force_n + gravity_n - np.cross(coriolis_n, before_n)
        ins.velocity_n = before_n + step_s * change
        ins.mat_nb = turned_nb
        ins.position = moved_by(ins.position, 0.5 * step_s * (before_n + ins.velocity_n))
        return step_noise

    def error_rate(self, ins, force_n, gravity_n, rates_n):
        """Return F: the error changes by ``F e`` a second."""
        _, frame_n, coriolis_n = rates_n
        F = np.zeros((12, 12))
        F[V, V] = -skew(coriolis_n)
        F[V, PHI] = -skew(force_n)
        F[V, BA] = ins.mat_nb
        F[PHI, PHI] = -skew(frame_n)
        F[PHI, BG] = ins.mat_nb
        return F

    def noise_input(self, ins):
        """Return G: how the noise of accelerometers, gyros and biases comes into the error."""
        G = np.eye(12)
        G[V, V] = ins.mat_nb
        G[PHI, PHI] = ins.mat_nb
        return G

    def innovation(self, ins, measured_b, turn_b, arm_b):
        """Return z, predicted minus measured velocity in b, and H: z is ``H e`` and the noise of the DVL."""
        z = ins.mat_nb.T @ ins.velocity_n + np.cross(turn_b, arm_b) - measured_b
        H = np.zeros((3, 12))
        H[:, V] = ins.mat_nb.T
        H[:, PHI] = ins.mat_nb.T @ skew(ins.velocity_n)
        H[:, BG] = -skew(arm_b)
        return z, H

    def gain(self, P, H, R, since_ping):
        """Return K, the covariance S of the innovation, and P after the update."""
        S = H @ P @ H.T + R
        K = np.linalg.solve(S, H @ P).T
        left = np.eye(12) - K @ H
        return K, S, left @ P @ left.T + K @ R @ K.T

    def correct(self, ins, error):
        """Take an estimated error away."""
        ins.velocity_n = ins.velocity_n - error[V]
        ins.mat_nb = rotation(-error[PHI]) @ ins.mat_nb
        ins.accel_bias_b = ins.accel_bias_b + error[BA]
        ins.gyro_bias_b = ins.gyro_bias_b + error[BG]

    def from_usual(self, velocity_n):
        """Return the matrix that makes the error of this filter of the usual one."""
        return np.eye(12)


@dataclass
class Rows:
    """The solution, row by row."""

    time_ns: np.ndarray
    position: np.ndarray
    velocity_n: np.ndarray
    mat_nb: np.ndarray
    innovation_b: np.ndarray
    innovation_cov: np.ndarray
    cov_ns: list
    cov: list  # of velocity, misalignment and position, which is not estimated

    @classmethod
    def of(cls, time_ns):
        """Return rows without numbers."""
        shapes = ((3,), (3,), (3, 3), (3,), (3, 3))
        empty = [np.full((len(time_ns), *shape), np.nan) for shape in shapes]
        return cls(time_ns, *empty, [], [])

    def keep(self, row, ins):
        """Store the INS."""
        self.position[row] = ins.position
        self.velocity_n[row] = ins.velocity_n
        self.mat_nb[row] = ins.mat_nb

    def keep_cov(self, row, ins, from_usual):
        """Store the covariance of the usual error."""
        to_usual = np.linalg.inv(from_usual)
        cov = np.full((9, 9), np.nan)
        cov[:6, :6] = (to_usual @ ins.P @ to_usual.T)[:6, :6]
        self.cov_ns.append(self.time_ns[row])
        self.cov.append(cov)

    def solution(self):
        """Return what the tool compares."""
        return Solution(
            self.time_ns,
            self.position,
            self.velocity_n,
            self.mat_nb,
            cov=np.array(self.cov),
            cov_ns=np.array(self.cov_ns),
            innovation_b=self.innovation_b,
            innovation_cov=self.innovation_cov,
        )


def at_times(time_ns, own_ns, values):
    """Interpolate readings, shape (k, 3), at other times."""
    time_s = (time_ns - own_ns[0]) * 1e-9
    own_s = (own_ns - own_ns[0]) * 1e-9
    return np.column_stack([np.interp(time_s, own_s, axis) for axis in values.T])


def step_means(time_ns, own_ns, values):
    """Return the means of readings between neighbouring times, by the integral of the readings."""
    steps_s = np.diff(own_ns)[:, None] * 1e-9
    areas = 0.5 * (values[1:] + values[:-1]) * steps_s
    integral = np.vstack([np.zeros(3), np.cumsum(areas, axis=0)])
    changes = np.diff(at_times(time_ns, own_ns, integral), axis=0)
    return changes / (np.diff(time_ns)[:, None] * 1e-9)


def skew(vector):
    """Return the matrix of the cross product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector):
    """Return the rotation about a vector by its length, rad."""
    angle = np.sqrt(vector @ vector)
    cross = skew(vector)
    if angle < 1e-8:
        return np.eye(3) + cross
    square = (1.0 - np.cos(angle)) / angle**2
    return np.eye(3) + np.sin(angle) / angle * cross + square * cross @ cross


def radii_m(position):
    """Return the radii of the Earth along a meridian and across it, at a position."""
    root = np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(position[0]) ** 2)
    along = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / root**3
    return along + position[2], SEMI_MAJOR_M / root + position[2]


def frame_rates(ins):
    """Return the rate of the Earth in n, and the rate of n against the Earth, rad/s."""
    latitude = ins.position[0]
    along_m, across_m = radii_m(ins.position)
    north, east, _ = ins.velocity_n
    earth_n = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    carried_n = [east / across_m, -north / along_m, -east * np.tan(latitude) / across_m]
    return earth_n, np.array(carried_n)


def moved_by(position, way_n):
    """Return the position after a way, m."""
    along_m, across_m = radii_m(position)
    across_m = across_m * np.cos(position[0])
    return position + way_n / np.array([along_m, across_m, -1.0])


def normal_gravity(position):
    """Return gravity by the formula of WGS 84 and the gradient in free air, m/s2."""
    square = np.sin(position[0]) ** 2
    at_zero = 9.7803253359 * (1.0 + 0.00193185265241 * square)
    return at_zero / np.sqrt(1.0 - ECCENTRICITY_SQUARED * square) - 3.086e-6 * position[2]
