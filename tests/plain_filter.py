"""The velocity-aided filter as a textbook has it: matrices in numpy, one epoch after the other, nothing saved."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from instants import instants
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.earth import (
    EARTH_RATE,
    meridian_radius_m,
    normal_gravity,
    transverse_radius_m,
)
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.prepared import prepare_dive


class Inputs(NamedTuple):
    """What a filter of velocities works on, here and in the program."""

    timeline: Timeline
    start: Start
    noise_density: Floats
    velocity: Measurement


class Prediction(NamedTuple):
    """What a filter believes."""

    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats
    P: Floats


def baseline_inputs(dive: Dive, config: Config) -> Inputs:
    """Prepare the baseline; no innovation is too large for it."""
    prepared = prepare_dive(dive, config)
    baseline = replace(prepared.filters[0], gate_probability=1.0)
    ping_ns, nowhere = prepared.velocities.time_ns, np.empty(0, dtype=np.int64)
    timeline = build_timeline(
        dive.imu, ping_ns, nowhere, prepared.alignment.start_ns, prepared.end_ns
    )
    (velocity,) = baseline.measurements(prepared.velocities, prepared.mounting)
    return Inputs(timeline, prepared.alignment.start, baseline.noise_density, velocity)


def run_plain_filter(inputs: Inputs) -> Prediction:
    """Run the filter over a time line; the DVL is at the IMU."""
    timeline, start, noise_density, velocity = inputs
    prediction = Prediction(
        start.position,
        start.velocity_n,
        start.mat_nb,
        start.accel_bias_b,
        start.gyro_bias_b,
        start.cov.copy(),
    )
    at = instants(timeline)
    for k in range(1, len(at.time_s)):
        ends, dt = slice(k - 1, k + 1), at.time_s[k] - at.time_s[k - 1]
        force_b, turn_b = summed(
            dt,
            at.specific_force_b[ends] - prediction.accel_bias_b,
            at.angular_rate_b[ends] - prediction.gyro_bias_b,
            at.force_bend_b[ends],
            at.rate_bend_b[ends],
        )
        prediction = propagated(prediction, force_b, turn_b, dt, noise_density)
        if at.ping[k] >= 0:
            prediction = updated(prediction, velocity.values[at.ping[k]], velocity.cov[at.ping[k]])
    return prediction


def summed(
    dt: float, force: Floats, rate: Floats, force_bend: Floats, rate_bend: Floats
) -> tuple[Floats, Floats]:
    """Sum readings at the ends of an interval, (2, 3): the mean force and the turn, with coning and sculling."""
    force_b = force.mean(axis=0) - dt**2 / 12.0 * force_bend.sum(axis=0)
    rate_b = rate.mean(axis=0) - dt**2 / 12.0 * rate_bend.sum(axis=0)
    coning = dt**2 / 12.0 * np.cross(rate[0], rate[1])
    sculling = dt / 12.0 * (np.cross(rate[0], force[1]) + np.cross(force[0], rate[1]))
    centripetal = dt**2 / 12.0 * np.cross(rate_b, np.cross(rate_b, force_b))
    return force_b + sculling - centripetal, dt * rate_b + coning


def propagated(
    prediction: Prediction, force_b: Floats, turn_b: Floats, dt: float, noise_density: Floats
) -> Prediction:
    (latitude, longitude, height_m), velocity = prediction.position, prediction.velocity_n
    r_n, r_e = meridian_radius_m(latitude) + height_m, transverse_radius_m(latitude) + height_m
    w_ie = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    w_in = w_ie + np.array(
        [velocity[1] / r_e, -velocity[0] / r_n, -velocity[1] * np.tan(latitude) / r_e]
    )

    frame_turn, body_turn = Rotation.from_rotvec(-w_in * dt), Rotation.from_rotvec(turn_b)
    mat_nb = frame_turn.as_matrix() @ prediction.mat_nb @ body_turn.as_matrix()
    force_n = 0.5 * (prediction.mat_nb + mat_nb) @ force_b
    gravity_n = np.array([0.0, 0.0, normal_gravity(latitude, height_m)])
    felt_n = force_n + gravity_n
    velocity_n = velocity + dt * (felt_n - np.cross(w_ie + w_in, velocity + 0.5 * dt * felt_n))
    north, east, down = 0.5 * dt * (velocity + velocity_n)
    position = np.array(
        [latitude + north / r_n, longitude + east / (r_e * np.cos(latitude)), height_m - down]
    )

    Phi = np.eye(12)
    Phi[DV, DV] -= skew(w_ie + w_in) * dt
    Phi[DV, PHI] -= skew(force_n) * dt
    Phi[PHI, PHI] -= skew(w_in) * dt
    Phi[PHI, DV] -= (
        np.array(
            [[0.0, 1.0 / r_e, 0.0], [-1.0 / r_n, 0.0, 0.0], [0.0, -np.tan(latitude) / r_e, 0.0]]
        )
        * dt
    )
    Phi[DV, BA] = Phi[PHI, BG] = mat_nb * dt
    P = Phi @ prediction.P @ Phi.T + np.diag(noise_density) * dt
    return prediction._replace(position=position, velocity_n=velocity_n, mat_nb=mat_nb, P=P)


def updated(prediction: Prediction, velocity_b: Floats, R: Floats) -> Prediction:
    H = np.zeros((3, 12))
    H[:, DV], H[:, PHI] = prediction.mat_nb.T, prediction.mat_nb.T @ skew(prediction.velocity_n)
    z = prediction.mat_nb.T @ prediction.velocity_n - velocity_b
    K = prediction.P @ H.T @ np.linalg.inv(H @ prediction.P @ H.T + R)
    dx, A, T = K @ z, np.eye(12) - K @ H, np.eye(12)
    turn_back, invariant_error = (
        Rotation.from_rotvec(-dx[PHI]),
        dx[DV] + np.cross(prediction.velocity_n, dx[PHI]),
    )
    velocity_n = turn_back.apply(prediction.velocity_n - invariant_error)
    T[DV, PHI] = skew(prediction.velocity_n - velocity_n)
    return Prediction(
        prediction.position,
        velocity_n,
        turn_back.as_matrix() @ prediction.mat_nb,
        prediction.accel_bias_b + dx[BA],
        prediction.gyro_bias_b + dx[BG],
        T @ (A @ prediction.P @ A.T + K @ R @ K.T) @ T.T,
    )
