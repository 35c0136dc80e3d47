"""The error-state Kalman filter: propagate to each node of the time line, update at pings, remember what was believed.

One loop for every filter. What a filter is aided by is the tuple of its measurements.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs
from insdvl_replay.compiled import compiled
from insdvl_replay.history import History
from insdvl_replay.nav.correction import correct
from insdvl_replay.nav.error_model import add_noise, propagate_cov
from insdvl_replay.nav.innovation import InsAtPing, linearise
from insdvl_replay.nav.kalman import cholesky, innovation_cov, standardised, transposed_gain, update_cov
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.place import normal_gravity, place_at, within_reach
from insdvl_replay.nav.recording import Ins, Records, Updates, history_of, new_records, new_updates, write_record
from insdvl_replay.nav.start import Start
from insdvl_replay.nav.strapdown import Motion, propagate
from insdvl_replay.nav.timeline import Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.vector_algebra import Vector, matrix, rotate_back, subtract, vector, write_vector


class _Memory(NamedTuple):
    """What windows need of past pings, see `measurements.InsAtPing`, and the body velocity after the last one."""

    rate_nb_b: Floats
    rate_eb_b: Floats
    velocity_change_b: Floats
    velocity_after_b: Floats


class _Stack(NamedTuple):
    """Measurements with a leading axis, so that one compiled loop serves any number of them."""

    kind: NDArray[np.int64]
    available: NDArray[np.bool_]
    valid_ns: TimeNs
    measured_b: Floats
    cov_b: Floats
    velocity_weights: Floats
    interval_weights: Floats
    gate: Floats


def run_filter(
    name: str,
    timeline: Timeline,
    start: Start,
    noise_density: Floats,
    measurements: tuple[Measurement, ...],
    lever_arm_b: Floats,
    *,
    cov_ns: TimeNs | None = None,
) -> History:
    """Run one filter over a dive.

    Parameters
    ----------
    name : str
        The filter's name.
    timeline : Timeline
        Nodes with readings, pings and what to record.
    start : Start
        State and uncertainty at the first node.
    noise_density : ndarray, shape (12,)
        From `error_model.noise_density`.
    measurements : tuple of Measurement
        Applied in this order at each ping. At least one.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    cov_ns : ndarray, shape (c,), optional
        Recorded times at which the history keeps all of P, not only its diagonal; others are ignored.

    Returns
    -------
    History
    """
    keep_cov = np.isin(timeline.event_ns[timeline.record], () if cov_ns is None else cov_ns)
    records, updates = new_records(keep_cov), new_updates(len(measurements), int(timeline.ping.max()) + 1)
    ins = Ins(
        start.position.copy(),
        start.velocity_n.copy(),
        start.mat_nb.copy(order="C"),
        start.accel_bias_b.copy(),
        start.gyro_bias_b.copy(),
        np.diag(start.sd**2),
    )
    _run(timeline, ins, noise_density, _stacked(measurements), lever_arm_b, records, updates)
    return history_of(name, timeline, measurements, records, updates)


@compiled
def _run(
    timeline: Timeline,
    ins: Ins,
    noise_density: Floats,
    measurements: _Stack,
    lever_arm_b: Floats,
    records: Records,
    updates: Updates,
) -> None:
    """Walk the time line. This is the whole filter."""
    pings = updates.nis.shape[1]
    memory = _Memory(np.zeros((pings, 3)), np.zeros((pings, 3)), np.zeros((pings, 3)), np.zeros(3))
    place = place_at(ins.position[0], ins.position[2])
    z, H = np.zeros(3), np.zeros((3, 12))

    row, before = 0, first_node(timeline)
    write_record(ins, records, row)
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        if not within_reach(place, ins.position[0], ins.position[2]):
            place = place_at(ins.position[0], ins.position[2])
        force_b = subtract(mean(before.specific_force_b, now.specific_force_b), vector(ins.accel_bias_b))
        rate_b = subtract(mean(before.angular_rate_b, now.angular_rate_b), vector(ins.gyro_bias_b))
        motion = propagate(ins.position, ins.velocity_n, ins.mat_nb, force_b, rate_b, dt, place)
        propagate_cov(ins.P, motion, noise_density, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(ins.P, timeline.gap_noise_density[gap], dt)
        before = now
        if not is_event(timeline, now):
            continue

        ping = timeline.ping[now.event]
        if ping >= 0:
            _note_motion(ins, memory, ping, now.angular_rate_b, motion)
            for m in range(len(measurements.kind)):
                if measurements.available[m, ping]:
                    measurement = _unstacked(measurements, m)
                    linearise(measurement, ping, _at_ping(ins, memory, now.specific_force_b, lever_arm_b), z, H)
                    _update(ins, measurement, m, ping, z, H, updates)
            write_vector(_velocity_b(ins), memory.velocity_after_b)
        if timeline.record[now.event]:
            row += 1
            write_record(ins, records, row)


def _stacked(measurements: tuple[Measurement, ...]) -> _Stack:
    """Give all measurements the longest window; the weights of older pings are zero."""
    longest = max(measurement.velocity_weights.shape[1] for measurement in measurements)

    def padded(weights: Floats, width: int) -> Floats:
        return np.hstack([np.zeros((len(weights), width - weights.shape[1])), weights])

    return _Stack(
        np.array([measurement.kind for measurement in measurements]),
        np.stack([measurement.available for measurement in measurements]),
        np.stack([measurement.valid_ns for measurement in measurements]),
        np.stack([measurement.measured_b for measurement in measurements]),
        np.stack([measurement.cov_b for measurement in measurements]),
        np.stack([padded(measurement.velocity_weights, longest) for measurement in measurements]),
        np.stack([padded(measurement.interval_weights, longest - 1) for measurement in measurements]),
        np.array([measurement.gate for measurement in measurements]),
    )


@compiled
def _note_motion(ins: Ins, memory: _Memory, ping: int, reading_b: Vector, motion: Motion) -> None:
    """Write down the angular rates at a ping, and what the mechanisation added to the body velocity since the last."""
    rate_ib_b = subtract(reading_b, vector(ins.gyro_bias_b))
    write_vector(subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_in_n)), memory.rate_nb_b[ping])
    write_vector(subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_ie_n)), memory.rate_eb_b[ping])
    change_b = subtract(_velocity_b(ins), vector(memory.velocity_after_b))
    write_vector(change_b, memory.velocity_change_b[ping])


@compiled
def _velocity_b(ins: Ins) -> Vector:
    return rotate_back(matrix(ins.mat_nb), vector(ins.velocity_n))


@compiled
def _at_ping(ins: Ins, memory: _Memory, reading_b: Vector, lever_arm_b: Floats) -> InsAtPing:
    specific_force_b = np.empty(3)
    write_vector(subtract(reading_b, vector(ins.accel_bias_b)), specific_force_b)
    return InsAtPing(
        ins.velocity_n,
        ins.mat_nb,
        specific_force_b,
        memory.rate_nb_b,
        memory.rate_eb_b,
        memory.velocity_change_b,
        normal_gravity(ins.position[0], ins.position[2]),
        lever_arm_b,
    )


@compiled
def _unstacked(stack: _Stack, m: int) -> Measurement:
    return Measurement(
        stack.kind[m],
        stack.available[m],
        stack.valid_ns[m],
        stack.measured_b[m],
        stack.cov_b[m],
        stack.velocity_weights[m],
        stack.interval_weights[m],
        stack.gate[m],
    )


@compiled
def _update(ins: Ins, measurement: Measurement, m: int, ping: int, z: Floats, H: Floats, updates: Updates) -> None:
    """Judge an innovation by its gate, use it if it passes, and write down both."""
    R, HP, S, L = measurement.cov_b[ping], np.empty((3, 12)), np.empty((3, 3)), np.empty((3, 3))
    innovation_cov(ins.P, H, R, HP, S)
    cholesky(S, L)
    nis = 0.0
    for whitened in standardised(L, z):
        nis += whitened * whitened
    updates.nis[m, ping] = nis
    updates.used[m, ping] = nis <= measurement.gate
    updates.log_det[m, ping] = 2.0 * (math.log(L[0, 0]) + math.log(L[1, 1]) + math.log(L[2, 2]))
    for i in range(3):
        updates.innovation_b[m, ping, i] = z[i]
        updates.sd_b[m, ping, i] = math.sqrt(S[i, i])
    if updates.used[m, ping]:
        KT = transposed_gain(HP, L)
        update_cov(ins.P, H, R, HP, KT)
        correct(ins, KT, z)
