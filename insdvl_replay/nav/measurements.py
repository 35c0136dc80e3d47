"""Measurements for a filter: values, noise R and gate, and how the INS predicts them.

The innovation z and its Jacobian H:

    z = predicted - measured = H dx + noise,    dx = estimated - true, of a bias what is left in the compensated
                                                reading: true - estimated

velocity      z = C' v + w_eb x l - v_dvl                    H = [ C' | C'[v x] | 0 | -[l x] ]
published     z = f + C' g - a_dvl                           H = [ 0 | C'[g x] | I | 0 ]
windowed      z = slope of the INS over the window - a_dvl   H = [ -[w x]C' | C'[g x] - [w x]C'[v x] | I | [v_b x] ]
beam          z = b' (C' v + w_eb x l) - y                    H = b' [ C' | C'[v x] | 0 | -[l x] ]
depth         z = -h + (C l)_d + d_0 - d                     H = [ 0 | (C l)_e, -(C l)_n, 0 | 0 | 0 | 0, 0, 1 | -1 ]
fix           z = p - p_fix + C l                            H = [ 0 | -[C l x] | 0 | 0 | I ]
heading       z = atan2(c_e, c_n) + b - psi                  H = [ 0 | -tan c_n, -tan c_e, 1 | 0 | 0 | -1 ], c = C e_x,
                                                                 tan = c_d / (c_n^2 + c_e^2)

The slope of a body-frame velocity is ``f + C' g - w x v_b``; ``published`` is the paper's model, without w x v_b.
``windowed`` predicts the same weighted sum of velocities as the DVL's slope, of what the mechanisation alone has added
to the body velocity between pings. Equations (36) to (46) of Levy and Klein, signs as of F: docs/equations/updates.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.held_out import NOTHING_PASSES
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import (
    Vector,
    add,
    compose,
    cross,
    dot,
    nearest_turn,
    rotate,
    row_vector,
    scale,
    skew,
    transpose,
    write_blocks,
    write_column_vector,
)
from insdvl_replay.nav.earth_model import LocalEarth
from insdvl_replay.nav.error_model import TWELVE, StateLayout, offset_n
from insdvl_replay.nav.kalman import FIXED
from insdvl_replay.nav.timeline import PINGS
from insdvl_replay.nav.user_measurement import INS_SIZE, Predicts

VELOCITY, PUBLISHED, WINDOWED, BEAM, DEPTH, HEADING, FIX, USER = range(8)
"""Kinds of measurement: the DVL's, other sensors', and from `USER` on each user-defined one."""

IDENTITY: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Final = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
NO_WINDOW: Final = np.zeros((0, 0))
NEVER_REOPENED: Final = 0
"""A rejected acceleration locks nothing out: the velocity brings the INS back."""


@dataclass(frozen=True)
class Measurement:
    """One kind of measurement, ready for every reading of its sensor."""

    name: str  # in tables and messages
    unit: str
    kind: int
    valid_ns: TimeNs  # (k,), times of validity: the readings' own, or the middle of a window
    values: Floats  # (k, m); of the DVL in b
    cov: Floats  # (k, m, m), R
    available: NDArray[np.bool_]  # (k,), readings that can be used
    axes: tuple[str, ...] = ()  # names of the components; empty for one component
    sensor: int = PINGS  # a row of `timeline.Timeline.rows`
    gate: float = np.inf  # largest NIS that is used
    # rejections in a row that open the velocity's uncertainty; 0: never
    reopen_after: int = NEVER_REOPENED
    # (k, w), c of the window's velocities
    velocity_weights: Floats = field(default_factory=lambda: NO_WINDOW)
    # (k, w - 1), W of the window's intervals
    interval_weights: Floats = field(default_factory=lambda: NO_WINDOW)
    # IMU to a sensor that is not the DVL, m
    sensor_arm_b: Floats = field(default_factory=lambda: np.zeros(3))
    direction_b: Floats = field(default_factory=lambda: np.zeros(3))  # of a beam
    noise: int = FIXED  # how R is taken, see `kalman`
    # the next measurement is of the same reading; both together correct the state
    goes_on: bool = False
    # of user-defined measurements, this one is number ``kind - USER``
    predict: Predicts | None = None
    # measures the velocity down: gravity follows the INS's height, see `earth_model`
    holds_height: bool = False

    @property
    def size(self) -> int:
        """Components of one reading."""
        return int(self.values.shape[1])

    def rows(self, rows: slice) -> "Measurement":
        """Keep some of the readings."""
        columns = (
            "available",
            "valid_ns",
            "values",
            "cov",
            "velocity_weights",
            "interval_weights",
        )
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def held_out(self) -> "Measurement":
        """Let a filter predict it without using it: its gate lets nothing pass."""
        return replace(self, gate=NOTHING_PASSES, reopen_after=NEVER_REOPENED)


def sensor_measurement(
    name: str,
    unit: str,
    kind: int,
    time_ns: TimeNs,
    values: Floats,
    sd: Floats,
    axes: tuple[str, ...] = (),
) -> Measurement:
    """Return a measurement at every reading, shape (k, s), without a gate; ``sd``, shape (s,) or (k, s), is its noise.

    The noise of its components is independent.
    """
    k, size = values.shape
    cov = np.broadcast_to(sd, (k, size))[:, :, None] ** 2 * np.eye(size)
    return Measurement(name, unit, kind, time_ns, values, cov, np.ones(k, dtype=np.bool_), axes)


class Stack(NamedTuple):
    """Measurements with a leading axis, so that one compiled loop serves any number of them.

    Narrow values are in the first rows and columns. Weights are at the end, since a window ends at its ping.
    """

    available: NDArray[np.bool_]
    values: Floats
    cov: Floats
    velocity_weights: Floats
    interval_weights: Floats
    kind: NDArray[np.int64]
    sensor: NDArray[np.int64]
    size: NDArray[np.int64]
    noise: NDArray[np.int64]
    goes_on: NDArray[np.bool_]
    holds_height: NDArray[np.bool_]
    gate: Floats
    reopen_after: NDArray[np.int64]
    sensor_arm_b: Floats
    direction_b: Floats


def stacked(measurements: Sequence[Measurement]) -> Stack:
    """Stack measurements, at least one, for the loop."""
    count = max(len(made.available) for made in measurements)
    width = max(made.size for made in measurements)
    window = max(1, *(made.velocity_weights.shape[1] for made in measurements))
    shapes = (), (width,), (width, width), (window,), (window - 1,)
    available, values, cov, velocity_weights, interval_weights = (
        np.zeros((len(measurements), count, *shape)) for shape in shapes
    )
    for m, made in enumerate(measurements):
        k = len(made.available)
        size = made.size
        windows, length = made.velocity_weights.shape
        available[m, :k] = made.available
        values[m, :k, :size] = made.values
        cov[m, :k, :size, :size] = made.cov
        velocity_weights[m, :windows, window - length :] = made.velocity_weights
        interval_weights[m, :windows, window - length :] = made.interval_weights
    by_measurement = (
        np.array([getattr(made, name) for made in measurements]) for name in Stack._fields[5:]
    )
    return Stack(
        available.astype(np.bool_),
        values,
        cov,
        velocity_weights,
        interval_weights,
        *by_measurement,
    )


class Memory(NamedTuple):
    """What the INS remembers of each of m pings, for windows."""

    rate_nb_b: Floats  # (m, 3), angular rate of the body against n, rad/s
    rate_eb_b: Floats  # (m, 3), against the Earth
    velocity_change_b: Floats  # (m, 3), added by the mechanisation since the ping before, m/s


class InsNow(NamedTuple):
    """The INS when something is measured, and the pings until then."""

    position: Vector  # latitude rad, longitude rad, height m
    velocity_n: Vector  # m/s
    mat_nb: tuple[Vector, Vector, Vector]
    specific_force_b: Vector  # compensated reading, m/s^2
    memory: Memory
    gravity: float  # m/s^2
    lever_arm_b: Vector  # IMU to DVL, m: enters z and H here, R in `Gaps.swing_cov`, the start in `levelling`
    earth: LocalEarth
    rate_eb_b: Vector  # angular rate of the body against the Earth, rad/s
    constants: Floats  # (c,), values of the sensors' constants, in the order of their states


@inlined
def linearise(
    measurements: Stack,
    m: int,
    row: int,
    ins: InsNow,
    layout: StateLayout,
    user: Predicts | None,
    z: Floats,
    H: Floats,
) -> None:
    """Write the innovation of a measurement, predicted minus measured, and its Jacobian.

    Parameters
    ----------
    m, row : int
        The measurement, and the row of its reading.
    user : callable or None
        The predictions of the user-defined measurements.
    z : ndarray, shape (s,)
        Written; s components.
    H : ndarray, shape (s, n), at least three rows
        Written.
    """
    kind = measurements.kind[m]
    if kind <= BEAM:
        _linearise_dvl(measurements, m, row, ins, layout, z, H)
    elif kind < USER:
        _linearise_sensor(measurements, m, row, ins, layout, z, H)
    elif user is not None:
        _linearise_user(measurements, m, row, ins, user, z, H)


@inlined
def _linearise_dvl(
    measurements: Stack,
    m: int,
    row: int,
    ins: InsNow,
    layout: StateLayout,
    z: Floats,
    H: Floats,
) -> None:
    kind, mat_bn = measurements.kind[m], transpose(ins.mat_nb)
    # The last measurement may have left something in the states beside the twelve.
    for i in range(3):
        for j in range(TWELVE, H.shape[1]):
            H[i, j] = 0.0
    velocity_turned = compose(mat_bn, skew(ins.velocity_n))
    gravity_turned = compose(mat_bn, skew((0.0, 0.0, ins.gravity)))
    if kind == PUBLISHED:
        # f + C' g
        write_blocks((ZERO, gravity_turned, IDENTITY, ZERO), H)
        predicted_b = add(ins.specific_force_b, rotate(mat_bn, (0.0, 0.0, ins.gravity)))
    elif kind == WINDOWED:
        # The slope of the DVL's velocity in the window, by the mechanisation.
        n = measurements.velocity_weights.shape[2]
        first, predicted_b = row - n + 1, (0.0, 0.0, 0.0)
        for j in range(max(0, -first), n):
            arm_velocity_b = cross(row_vector(ins.memory.rate_eb_b, first + j), ins.lever_arm_b)
            predicted_b = add(
                predicted_b, scale(measurements.velocity_weights[m, row, j], arm_velocity_b)
            )
            if j > 0:
                change_b = row_vector(ins.memory.velocity_change_b, first + j)
                predicted_b = add(
                    predicted_b, scale(measurements.interval_weights[m, row, j - 1], change_b)
                )
        against_rate = skew(scale(-1.0, row_vector(ins.memory.rate_nb_b, row)))
        turning = compose(against_rate, velocity_turned)
        by_misalignment = (
            add(gravity_turned[0], turning[0]),
            add(gravity_turned[1], turning[1]),
            add(gravity_turned[2], turning[2]),
        )
        velocity_b = rotate(mat_bn, ins.velocity_n)
        write_blocks(
            (compose(against_rate, mat_bn), by_misalignment, IDENTITY, skew(velocity_b)), H
        )
    else:
        # The velocity at the DVL, C' v + w_eb x l. Beams may be heard without a ping of the velocity.
        rate_eb_b = row_vector(ins.memory.rate_eb_b, row) if kind == VELOCITY else ins.rate_eb_b
        write_blocks((mat_bn, velocity_turned, ZERO, skew(scale(-1.0, ins.lever_arm_b))), H)
        predicted_b = add(rotate(mat_bn, ins.velocity_n), cross(rate_eb_b, ins.lever_arm_b))
    if layout.dvl_scale >= 0 or layout.dvl_yaw >= 0:
        predicted_b = _as_the_dvl_reads(predicted_b, ins, layout, H)
    if kind == BEAM:
        # The part along the beam. H has three rows, of which one stays.
        b = row_vector(measurements.direction_b, m)
        for j in range(H.shape[1]):
            H[0, j] = b[0] * H[0, j] + b[1] * H[1, j] + b[2] * H[2, j]
        z[0] = dot(b, predicted_b) - measurements.values[m, row, 0]
    else:
        for i in range(3):
            z[i] = predicted_b[i] - measurements.values[m, row, i]


@inlined
def _as_the_dvl_reads(
    predicted_b: Vector,
    ins: InsNow,
    layout: StateLayout,
    H: Floats,
) -> Vector:
    """Turn and scale a prediction as the DVL does, ``u <- (1 + k) R_z(psi)' u``, and its Jacobian likewise.

    For what is left of k and psi, true minus estimated, z then has ``-u / (1 + k)`` and ``(-u_y, u_x, 0)``.
    """
    factor, yaw = 1.0, 0.0
    if layout.dvl_scale >= 0:
        factor += ins.constants[layout.dvl_scale - layout.constants]
    if layout.dvl_yaw >= 0:
        yaw += ins.constants[layout.dvl_yaw - layout.constants]
    along, across = factor * math.cos(yaw), factor * math.sin(yaw)
    for j in range(H.shape[1]):
        x, y = H[0, j], H[1, j]
        H[0, j], H[1, j], H[2, j] = (
            along * x + across * y,
            along * y - across * x,
            factor * H[2, j],
        )
    x, y, z = predicted_b
    read_b = (along * x + across * y, along * y - across * x, factor * z)
    if layout.dvl_scale >= 0:
        write_column_vector(scale(-1.0 / factor, read_b), H, layout.dvl_scale)
    if layout.dvl_yaw >= 0:
        write_column_vector((-read_b[1], read_b[0], 0.0), H, layout.dvl_yaw)
    return read_b


@inlined
def _linearise_sensor(
    measurements: Stack,
    m: int,
    row: int,
    ins: InsNow,
    layout: StateLayout,
    z: Floats,
    H: Floats,
) -> None:
    for i in range(len(z)):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
    kind, position = measurements.kind[m], layout.position
    reading, arm_n = (
        measurements.values[m, row],
        rotate(ins.mat_nb, row_vector(measurements.sensor_arm_b, m)),
    )
    constant = 0.0
    if kind == DEPTH:
        H[0, 3], H[0, 4] = arm_n[1], -arm_n[0]
        if position >= 0:
            H[0, position + 2] = 1.0
        if layout.depth_zero >= 0:
            H[0, layout.depth_zero], constant = (
                -1.0,
                ins.constants[layout.depth_zero - layout.constants],
            )
        z[0] = arm_n[2] - ins.position[2] + constant - reading[0]
    elif kind == HEADING:
        north, east, down = ins.mat_nb[0][0], ins.mat_nb[1][0], ins.mat_nb[2][0]
        steep = down / (north * north + east * east)
        H[0, 3], H[0, 4], H[0, 5] = -steep * north, -steep * east, 1.0
        if layout.heading_bias >= 0:
            H[0, layout.heading_bias], constant = (
                -1.0,
                ins.constants[layout.heading_bias - layout.constants],
            )
        z[0] = nearest_turn(math.atan2(east, north) + constant - reading[0])
    else:
        # A fix may lack the height.
        height_m = reading[2] if len(z) == 3 else ins.position[2]
        apart_n = add(offset_n(ins.position, (reading[0], reading[1], height_m), ins.earth), arm_n)
        by_misalignment = skew(scale(-1.0, arm_n))
        for i in range(len(z)):
            z[i], (H[i, 3], H[i, 4], H[i, 5]) = apart_n[i], by_misalignment[i]
            if position >= 0:
                H[i, position + i] = 1.0


@inlined
def _linearise_user(
    measurements: Stack,
    m: int,
    row: int,
    ins: InsNow,
    user: Predicts,
    z: Floats,
    H: Floats,
) -> None:
    """Let the user's prediction write z and H, and subtract the reading. No gate would reject an infinite z."""
    size, known = len(z), np.empty(INS_SIZE)
    for i in range(3):
        known[i], known[3 + i] = ins.position[i], ins.velocity_n[i]
        known[15 + i], known[18 + i] = ins.specific_force_b[i], ins.rate_eb_b[i]
        for j in range(3):
            known[6 + 3 * i + j] = ins.mat_nb[i][j]
    predicted, jacobian = np.zeros(size), np.zeros((size, H.shape[1]))
    user(measurements.kind[m] - USER, known, predicted, jacobian)
    for i in range(size):
        z[i] = (
            predicted[i] - measurements.values[m, row, i]
            if math.isfinite(predicted[i])
            else math.nan
        )
        for j in range(H.shape[1]):
            H[i, j] = jacobian[i, j]
