"""What a filter writes down on its way: its state at the recorded events, and each innovation."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.runtime import inlined
from insdvl_replay.core.states import State
from insdvl_replay.geometry.rotation import wrap_angle
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.strapdown import NavState
from insdvl_replay.nav.timeline import Timeline
from insdvl_replay.nav.vector_algebra import Vector, write_row_matrix, write_row_vector


class Records(NamedTuple):
    """The navigation state at the recorded events, and P at some: ``cov_row`` is its row in ``cov``, -1 for none.

    ``corrected`` is the sum of all corrections of the position; it has no rows where no filter makes any.
    """

    position: Floats
    corrected: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats
    constants: Floats
    sd: Floats
    cov_row: NDArray[np.int64]
    cov: Floats


class Updates(NamedTuple):
    """Innovations, first axis measurement, second axis reading; and how far each kind is in a run of rejections.

    ``refused_in_a_row`` counts the rejections up to now, ``refused_s`` is the time of the last, ``used_s`` that of the
    last reading that was used, and ``reopened_s`` that of the last that was used in spite of the gate. ``noise_found``
    is how much larger R is by the innovations, ``noise_var`` its variance by chance alone, and ``noise_factor`` as
    far as it is more than that.
    """

    innovation: Floats
    sd: Floats
    nis: Floats
    used: NDArray[np.bool_]
    reopened: NDArray[np.bool_]
    log_det: Floats
    refused_in_a_row: NDArray[np.int64]
    refused_s: Floats
    used_s: Floats
    reopened_s: Floats
    noise_factor: Floats
    noise_found: Floats
    noise_var: Floats


def new_records(keep_cov: NDArray[np.bool_], states: int, constants: int, *, corrects_position: bool) -> Records:
    """Make room for the states at recorded events, with all of P at those that are to keep it."""
    rows = len(keep_cov)
    return Records(
        position=np.empty((rows, 3)),
        corrected=np.empty((rows if corrects_position else 0, 3)),
        velocity_n=np.empty((rows, 3)),
        mat_nb=np.empty((rows, 3, 3)),
        accel_bias_b=np.empty((rows, 3)),
        gyro_bias_b=np.empty((rows, 3)),
        constants=np.empty((rows, constants)),
        sd=np.empty((rows, states)),
        cov_row=np.where(keep_cov, np.cumsum(keep_cov) - 1, -1),
        cov=np.empty((int(keep_cov.sum()), states, states)),
    )


def new_updates(measurements: int, readings: int, size: int) -> Updates:
    """Make room for the innovations of some kinds of measurement, with so many components at most, at each reading."""
    return Updates(
        innovation=np.full((measurements, readings, size), np.nan),
        sd=np.full((measurements, readings, size), np.nan),
        nis=np.full((measurements, readings), np.nan),
        used=np.zeros((measurements, readings), dtype=np.bool_),
        reopened=np.zeros((measurements, readings), dtype=np.bool_),
        log_det=np.full((measurements, readings), np.nan),
        refused_in_a_row=np.zeros(measurements, dtype=np.int64),
        refused_s=np.full(measurements, -np.inf),
        used_s=np.zeros(measurements),
        reopened_s=np.full(measurements, -np.inf),
        noise_factor=np.ones(measurements),
        noise_found=np.ones(measurements),
        noise_var=np.zeros(measurements),
    )


@inlined
def write_record(state: NavState, corrected: Vector, constants: Floats, P: Floats, records: Records, row: int) -> None:
    """Write down the navigation state and what its covariance P says, as a row."""
    write_row_vector(state.position, records.position, row)
    if row < len(records.corrected):
        write_row_vector(corrected, records.corrected, row)
    write_row_vector(state.velocity_n, records.velocity_n, row)
    write_row_matrix(state.mat_nb, records.mat_nb, row)
    write_row_vector(state.accel_bias_b, records.accel_bias_b, row)
    write_row_vector(state.gyro_bias_b, records.gyro_bias_b, row)
    for i in range(len(constants)):
        records.constants[row, i] = constants[i]
    for i in range(P.shape[0]):
        records.sd[row, i] = math.sqrt(P[i, i])
    cov_row = records.cov_row[row]
    if cov_row >= 0:
        # By elements: numba takes three seconds to compile the assignment of a whole array.
        for i in range(P.shape[0]):
            for j in range(P.shape[0]):
                records.cov[cov_row, i, j] = P[i, j]


@inlined
def write_update(
    updates: Updates,
    m: int,
    row: int,
    z: Floats,
    S: Floats,
    L: Floats,
    nis: float,
    used: bool,
    reopened: bool,
    is_again: bool,
) -> None:
    """Write down an innovation and what was thought of it; L is the Cholesky factor of its covariance S.

    Of one that is met again stays what it was at first.
    """
    updates.used[m, row], updates.reopened[m, row] = used, reopened or (is_again and used)
    if is_again:
        return
    updates.nis[m, row] = nis
    log_det = 0.0
    for i in range(len(z)):
        log_det += math.log(L[i, i])
        updates.innovation[m, row, i] = z[i]
        updates.sd[m, row, i] = math.sqrt(S[i, i])
    updates.log_det[m, row] = 2.0 * log_det


def history_of(
    name: str,
    timeline: Timeline,
    states: tuple[State, ...],
    measurements: tuple[Measurement, ...],
    records: Records,
    updates: Updates,
) -> History:
    """Gather what a filter wrote down."""
    innovations = []
    for m, measurement in enumerate(measurements):
        reading_ns = timeline.event_ns[timeline.rows[measurement.sensor] >= 0]
        rows = np.flatnonzero(measurement.available)
        innovations.append(
            Innovations(
                measurement=measurement.name,
                unit=measurement.unit,
                axes=measurement.axes,
                time_ns=reading_ns[rows],
                valid_ns=measurement.valid_ns[rows],
                measured=measurement.values[rows],
                innovation=updates.innovation[m, rows, : measurement.size],
                sd=updates.sd[m, rows, : measurement.size],
                nis=updates.nis[m, rows],
                used=updates.used[m, rows],
                gate=measurement.gate,
                reopen_after=measurement.reopen_after,
                reopened=updates.reopened[m, rows],
                log_det=updates.log_det[m, rows],
                noise_factor=float(updates.noise_factor[m]),
                holds_height=measurement.holds_height,
            )
        )
    records.position[:, 1] = wrap_angle(records.position[:, 1])
    recorded = timeline.record >= 0
    time_ns = timeline.event_ns[recorded]
    return History(
        filter=name,
        states=states,
        time_ns=time_ns,
        updated=timeline.ping[recorded] >= 0,
        position=records.position,
        velocity_n=records.velocity_n,
        mat_nb=records.mat_nb,
        accel_bias_b=records.accel_bias_b,
        gyro_bias_b=records.gyro_bias_b,
        sd=records.sd,
        cov_ns=time_ns[records.cov_row >= 0],
        cov=records.cov,
        innovations=tuple(innovations),
        constants=records.constants,
        corrected=records.corrected,
    )
