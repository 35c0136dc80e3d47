"""GTSAM on the readings that a filter is given: preintegration between pings, and a smoother over all of them.

At the end of a dive a smoother knows what a filter knows, so that its standard deviations have to be the same. Its map
is flat; the Earth's rotation is given to it as a constant.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from instants import Instants, instants
from plain_filter import Inputs

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.earth import EARTH_RATE, normal_gravity
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.levelling import Start

POSITION_SD_M = 1e-3
"""The origin is where the vehicle starts."""
INTEGRATION_COV = 1e-12 * np.eye(3)
"""Its own noise of the integration, which ours does not have."""

Residual = Callable[[gtsam.CustomFactor, gtsam.Values, list[Floats] | None], Floats]


@dataclass(frozen=True)
class Smoothed:
    """What GTSAM took, seconds of this thread's processor time, and the standard deviations of biases at the end."""

    integration_s: float
    whole_s: float
    bias_sd: Floats


def smooth(inputs: Inputs) -> Smoothed:
    """Integrate the readings, one call of Python for each, and estimate all that happened."""
    at = instants(inputs.timeline)
    start = inputs.start
    begin_s = time.thread_time()
    between = _integrated(at, _params(start, inputs.noise_density))
    integration_s = time.thread_time() - begin_s
    graph, guess = _graph(inputs, at, between)
    found = gtsam.LevenbergMarquardtOptimizer(graph, guess).optimize()
    cov = gtsam.Marginals(graph, found).marginalCovariance(B(len(between)))
    return Smoothed(integration_s, time.thread_time() - begin_s, np.sqrt(np.diag(cov)))


def _params(start: Start, noise_density: Floats) -> gtsam.PreintegrationCombinedParams:
    latitude = start.position[0]
    height_m = start.position[2]
    params = gtsam.PreintegrationCombinedParams.MakeSharedD(
        float(normal_gravity(latitude, height_m))
    )
    params.setAccelerometerCovariance(np.diag(noise_density[DV]))
    params.setGyroscopeCovariance(np.diag(noise_density[PHI]))
    params.setBiasAccCovariance(np.diag(noise_density[BA]))
    params.setBiasOmegaCovariance(np.diag(noise_density[BG]))
    params.setIntegrationCovariance(INTEGRATION_COV)
    params.setOmegaCoriolis(EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)]))
    return params


def _integrated(
    at: Instants, params: gtsam.PreintegrationCombinedParams
) -> list[gtsam.PreintegratedCombinedMeasurements]:
    """Integrate from ping to ping."""
    force_b, rate_b = (
        (one[1:] + one[:-1]) / 2.0 for one in (at.specific_force_b, at.angular_rate_b)
    )
    step_s = np.diff(at.time_s)
    is_end = at.ping[1:] >= 0
    is_end[-1] = True
    between = []
    current = gtsam.PreintegratedCombinedMeasurements(params)
    for k in range(len(step_s)):
        current.integrateMeasurement(force_b[k], rate_b[k], step_s[k])
        if is_end[k]:
            between.append(current)
            current = gtsam.PreintegratedCombinedMeasurements(params)
    return between


def _graph(
    inputs: Inputs, at: Instants, between: list[gtsam.PreintegratedCombinedMeasurements]
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Say what is known at the start, between pings and at them; and guess what happened by integrating alone."""
    graph = gtsam.NonlinearFactorGraph()
    guess = gtsam.Values()
    state, bias = _begin(graph, inputs.start)
    _insert(guess, 0, state, bias)
    pings = at.ping[at.ping >= 0]
    for i, measured in enumerate(between):
        graph.add(
            gtsam.CombinedImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), B(i + 1), measured)
        )
        state = measured.predict(state, bias)
        if i < len(pings):
            velocity_b, cov_b = (
                column[pings[i]] for column in (inputs.velocity.values, inputs.velocity.cov)
            )
            noise = gtsam.noiseModel.Gaussian.Covariance(cov_b)
            graph.add(gtsam.CustomFactor(noise, [X(i + 1), V(i + 1)], _residual_of(velocity_b)))
            velocity_n = state.attitude().matrix() @ velocity_b
            state = gtsam.NavState(state.attitude(), state.position(), velocity_n)
        _insert(guess, i + 1, state, bias)
    return graph, guess


def _begin(
    graph: gtsam.NonlinearFactorGraph, start: Start
) -> tuple[gtsam.NavState, gtsam.imuBias.ConstantBias]:
    pose = gtsam.Pose3(gtsam.Rot3(start.mat_nb), np.zeros(3))
    bias = gtsam.imuBias.ConstantBias()
    pose_cov = np.diag(np.full(6, POSITION_SD_M**2))
    pose_cov[:3, :3] = start.mat_nb.T @ np.diag(start.sd[PHI] ** 2) @ start.mat_nb
    biases = gtsam.noiseModel.Diagonal.Sigmas(start.sd[BA.start :])
    graph.add(gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(pose_cov)))
    graph.add(
        gtsam.PriorFactorVector(
            V(0), start.velocity_n, gtsam.noiseModel.Diagonal.Sigmas(start.sd[DV])
        )
    )
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, biases))
    return gtsam.NavState(pose, start.velocity_n), bias


def _insert(
    values: gtsam.Values, i: int, state: gtsam.NavState, bias: gtsam.imuBias.ConstantBias
) -> None:
    values.insert(X(i), state.pose())
    values.insert(V(i), state.velocity())
    values.insert(B(i), bias)


def _residual_of(measured_b: Floats) -> Residual:
    """Predict a velocity in the body, and write the Jacobians for a turn about its axes and for the velocity."""

    def residual(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats] | None
    ) -> Floats:
        pose, velocity = factor.keys()
        mat_bn = values.atPose3(pose).rotation().matrix().T
        predicted_b: Floats = mat_bn @ values.atVector(velocity)
        if jacobians is not None:
            jacobians[0] = np.hstack([skew(predicted_b), np.zeros((3, 3))])
            jacobians[1] = mat_bn
        return predicted_b - measured_b

    return residual
