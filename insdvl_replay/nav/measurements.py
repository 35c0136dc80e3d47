"""What sensors measure at times of their own, ready for a filter: values, their noise R, and how they are judged.

`innovation` predicts the same from the INS.

What a measurement says of the errors when it is made: the innovation z and the Jacobian H.

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
``windowed`` predicts the same weighted sum of velocities that the DVL's slope is, from what the mechanisation alone has
added to the body velocity between pings. Equations (36) to (46) of Levy and Klein, signs as of F: equations/updates.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import (
    Matrix,
    Vector,
    add,
    add_matrices,
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
from insdvl_replay.nav.earth_model import Place
from insdvl_replay.nav.error_model import TWELVE, StateLayout, offset_n
from insdvl_replay.nav.kalman import FIXED
from insdvl_replay.nav.timeline import PINGS
from insdvl_replay.nav.user_measurement import INS_SIZE, Predicts

VELOCITY: Final = 0
PUBLISHED: Final = 1
WINDOWED: Final = 2
BEAM: Final = 3
NOTHING_PASSES: Final = -1.0
"""A gate below any NIS."""
NEVER_REOPENED: Final = 0
"""An acceleration that is rejected locks nothing out: the velocity brings the INS back."""


@dataclass(frozen=True)
class Measurement:
    """One kind of aiding, ready for every reading of its sensor.

    Attributes
    ----------
    name : str
        In tables and messages.
    unit : str
        Of its values.
    kind : int
        How `innovation.linearise` predicts it.
    sensor : int
        Whose readings these are: a row of `timeline.Timeline.rows`.
    available : ndarray of bool, shape (k,)
        Which readings can be used.
    valid_ns : ndarray, shape (k,)
        Times of validity: the readings' own, or the middle of a window.
    values : ndarray, shape (k, m)
        What was measured; of the DVL in b.
    cov : ndarray, shape (k, m, m)
        R.
    gate : float
        Largest NIS that is used.
    reopen_after : int
        Rejections in a row after which the velocity's uncertainty is opened; 0: never.
    velocity_weights : ndarray, shape (k, w)
        Weights c of the window's velocities; w = 0 where there is no window.
    interval_weights : ndarray, shape (k, w - 1)
        Weights W of the window's intervals.
    lever_arm_b : ndarray, shape (3,)
        IMU to the sensor, m; of the DVL the filter is told it by itself.
    direction_b : ndarray, shape (3,)
        Of a beam.
    noise : int
        How R is taken, see `measurement_noise`.
    predict : callable or None
        Of measurements of the user's own, of which this one is number ``kind - innovation.OWN``; see `own_measurement`.
    goes_on : bool
        The next measurement is of the same reading: the state is corrected by both together.
    axes : tuple of str
        Names of the components; none of a measurement that has one.
    holds_height : bool
        It measures the velocity down: gravity follows the INS's height while it is used, see `local_earth`.
    """

    name: str
    unit: str
    kind: int
    sensor: int
    available: NDArray[np.bool_]
    valid_ns: TimeNs
    values: Floats
    cov: Floats
    gate: float
    reopen_after: int
    velocity_weights: Floats
    interval_weights: Floats
    lever_arm_b: Floats = field(default_factory=lambda: np.zeros(3))
    direction_b: Floats = field(default_factory=lambda: np.zeros(3))
    noise: int = FIXED
    goes_on: bool = False
    predict: Predicts | None = None
    axes: tuple[str, ...] = ()
    holds_height: bool = False

    @property
    def size(self) -> int:
        """Components of one reading."""
        return int(self.values.shape[1])

    def rows(self, rows: slice) -> "Measurement":
        """Keep some of the readings."""
        columns = ("available", "valid_ns", "values", "cov", "velocity_weights", "interval_weights")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def until(self, end_ns: int) -> "Measurement":
        """Keep the readings up to a time."""
        return self.rows(slice(int(np.searchsorted(self.valid_ns, end_ns, side="right"))))


class Stack(NamedTuple):
    """Measurements with a leading axis, so that one compiled loop serves any number of them.

    What is narrower than the widest stands in the first rows and columns; weights stand at the end, since a window ends
    at its ping.
    """

    kind: NDArray[np.int64]
    sensor: NDArray[np.int64]
    size: NDArray[np.int64]
    available: NDArray[np.bool_]
    values: Floats
    cov: Floats
    velocity_weights: Floats
    interval_weights: Floats
    lever_arm_b: Floats
    direction_b: Floats
    noise: NDArray[np.int64]
    goes_on: NDArray[np.bool_]
    holds_height: NDArray[np.bool_]
    gate: Floats
    reopen_after: NDArray[np.int64]


def stacked(measurements: Sequence[Measurement]) -> Stack:
    """Stack measurements, at least one, for the loop."""
    count, width = max(len(one.available) for one in measurements), max(one.size for one in measurements)
    window = max(1, *(one.velocity_weights.shape[1] for one in measurements))
    shapes = {
        "available": (count,),
        "values": (count, width),
        "cov": (count, width, width),
        "velocity_weights": (count, window),
        "interval_weights": (count, window - 1),
    }
    columns = {name: np.zeros((len(measurements), *shape)) for name, shape in shapes.items()}
    for m, one in enumerate(measurements):
        k, size, w = len(one.available), one.size, one.velocity_weights.shape[1]
        columns["available"][m, :k] = one.available
        columns["values"][m, :k, :size] = one.values
        columns["cov"][m, :k, :size, :size] = one.cov
        columns["velocity_weights"][m, :k, window - w :] = one.velocity_weights
        columns["interval_weights"][m, :k, window - w :] = one.interval_weights
    return Stack(
        kind=np.array([one.kind for one in measurements]),
        sensor=np.array([one.sensor for one in measurements]),
        size=np.array([one.size for one in measurements]),
        available=columns["available"].astype(np.bool_),
        values=columns["values"],
        cov=columns["cov"],
        velocity_weights=columns["velocity_weights"],
        interval_weights=columns["interval_weights"],
        lever_arm_b=np.stack([one.lever_arm_b for one in measurements]),
        direction_b=np.stack([one.direction_b for one in measurements]),
        noise=np.array([one.noise for one in measurements]),
        goes_on=np.array([one.goes_on for one in measurements]),
        holds_height=np.array([one.holds_height for one in measurements]),
        gate=np.array([one.gate for one in measurements]),
        reopen_after=np.array([one.reopen_after for one in measurements]),
    )


def withheld(measurement: Measurement) -> Measurement:
    """Let a filter meet a measurement of which it is not told: no gate lets it pass."""
    return replace(measurement, gate=NOTHING_PASSES, reopen_after=NEVER_REOPENED)


def sensor_measurement(
    name: str, unit: str, kind: int, time_ns: TimeNs, values: Floats, sd: Floats, *, axes: tuple[str, ...] = ()
) -> Measurement:
    """Aid by a sensor beside the DVL at every reading, without a gate.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        Times of validity.
    values : ndarray, shape (k, s)
    sd : ndarray, shape (s,) or (k, s)
        Noise of the components, which do not depend on each other.
    """
    k, size = values.shape
    cov = np.broadcast_to(sd, (k, size))[:, :, None] ** 2 * np.eye(size)
    return Measurement(
        name=name,
        unit=unit,
        kind=kind,
        sensor=PINGS,
        available=np.ones(k, dtype=np.bool_),
        valid_ns=time_ns,
        values=values,
        cov=cov,
        gate=np.inf,
        reopen_after=NEVER_REOPENED,
        velocity_weights=np.zeros((k, 0)),
        interval_weights=np.zeros((k, 0)),
        axes=axes,
    )


DEPTH: Final = 4
HEADING: Final = 5
FIX: Final = 6
OWN: Final = 7
"""Kinds of measurement beside the DVL's, above those of `measurements`; from `OWN` on each of the user's own."""

IDENTITY: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO: Final = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class InsAtPing(NamedTuple):
    """What the INS knows when something is measured, and what it remembers of the pings until then.

    Attributes
    ----------
    position : tuple of 3 float
        Latitude rad, longitude rad, height m.
    velocity_n : tuple of 3 float
        m/s
    mat_nb : tuple of 3 rows
        Attitude.
    specific_force_b : tuple of 3 float
        Compensated reading, m/s^2.
    ping : int
        Row of the ping that is now, -1 for none.
    rate_nb_b, rate_eb_b : ndarray, shape (m, 3)
        Angular rate of the body against n and against the Earth at each ping so far, rad/s.
    velocity_change_b : ndarray, shape (m, 3)
        What the mechanisation added to the body velocity since the ping before, m/s.
    gravity : float
        m/s^2
    lever_arm_b : tuple of 3 float
        IMU to DVL, m.
    place : Place
        What there is to know of the Earth here.
    rate_eb_now_b : tuple of 3 float
        Angular rate of the body against the Earth, rad/s.
    constants : ndarray, shape (c,)
        What the constants of the sensors are taken to be, in the order of their states.
    """

    position: Vector
    velocity_n: Vector
    mat_nb: Matrix
    specific_force_b: Vector
    ping: int
    rate_nb_b: Floats
    rate_eb_b: Floats
    velocity_change_b: Floats
    gravity: float
    lever_arm_b: Vector
    place: Place
    rate_eb_now_b: Vector
    constants: Floats


@inlined
def linearise(
    measurements: Stack,
    m: int,
    row: int,
    ins: InsAtPing,
    layout: StateLayout,
    own: Predicts | None,
    z: Floats,
    H: Floats,
) -> None:
    """Write the innovation of a measurement, predicted minus measured, and its Jacobian.

    Parameters
    ----------
    m, row : int
        The measurement, and the row of its reading.
    own : callable or None
        The predictions of the user's own measurements.
    z : ndarray, shape (s,)
        Written; s components.
    H : ndarray, shape (s, n)
        Written.
    """
    if measurements.kind[m] <= WINDOWED:
        _linearise_dvl(measurements, m, row, ins, layout, z, H)
    elif measurements.kind[m] == BEAM:
        _linearise_beam(measurements, m, row, ins, layout, z, H)
    elif measurements.kind[m] < OWN:
        _linearise_sensor(measurements, m, row, ins, layout, z, H)
    elif own is not None:
        _linearise_own(measurements, m, row, ins, own, z, H)


@inlined
def _linearise_own(measurements: Stack, m: int, row: int, ins: InsAtPing, own: Predicts, z: Floats, H: Floats) -> None:
    """Let the user's prediction write z and H, and take the reading off: no gate would refuse what is infinite."""
    size, known = len(z), np.empty(INS_SIZE)
    for i in range(3):
        known[i], known[3 + i] = ins.position[i], ins.velocity_n[i]
        known[15 + i], known[18 + i] = ins.specific_force_b[i], ins.rate_eb_now_b[i]
        for j in range(3):
            known[6 + 3 * i + j] = ins.mat_nb[i][j]
    predicted, jacobian = np.zeros(size), np.zeros((size, H.shape[1]))
    own(measurements.kind[m] - OWN, known, predicted, jacobian)
    for i in range(size):
        z[i] = predicted[i] - measurements.values[m, row, i] if math.isfinite(predicted[i]) else math.nan
        for j in range(H.shape[1]):
            H[i, j] = jacobian[i, j]


@inlined
def _linearise_beam(
    measurements: Stack, m: int, row: int, ins: InsAtPing, layout: StateLayout, z: Floats, H: Floats
) -> None:
    """Write what one beam says: the part of the velocity along it. H has room for three rows, of which one stays."""
    _clear_beyond_twelve(H)
    predicted_b, b = _predict_velocity(ins, ins.rate_eb_now_b, H), row_vector(measurements.direction_b, m)
    if layout.dvl_scale >= 0 or layout.dvl_yaw >= 0:
        predicted_b = _as_the_dvl_reads(predicted_b, ins, layout, H)
    for j in range(H.shape[1]):
        H[0, j] = b[0] * H[0, j] + b[1] * H[1, j] + b[2] * H[2, j]
    z[0] = dot(b, predicted_b) - measurements.values[m, row, 0]


@inlined
def _linearise_dvl(
    measurements: Stack, m: int, row: int, ins: InsAtPing, layout: StateLayout, z: Floats, H: Floats
) -> None:
    _clear_beyond_twelve(H)
    kind = measurements.kind[m]
    if kind == VELOCITY:
        predicted_b = _predict_velocity(ins, row_vector(ins.rate_eb_b, row), H)
    elif kind == PUBLISHED:
        predicted_b = _predict_specific_force(ins, H)
    else:
        predicted_b = _predict_slope(measurements, m, ins, row, H)
    if layout.dvl_scale >= 0 or layout.dvl_yaw >= 0:
        predicted_b = _as_the_dvl_reads(predicted_b, ins, layout, H)
    for i in range(3):
        z[i] = predicted_b[i] - measurements.values[m, row, i]


@inlined
def _clear_beyond_twelve(H: Floats) -> None:
    """Take out what the measurement before has left of the states beside the twelve, of which the DVL says nothing."""
    for i in range(3):
        for j in range(TWELVE, H.shape[1]):
            H[i, j] = 0.0


@inlined
def _as_the_dvl_reads(predicted_b: Vector, ins: InsAtPing, layout: StateLayout, H: Floats) -> Vector:
    """Turn and stretch a prediction as the DVL does, ``u <- (1 + k) R_z(psi)' u``, and its Jacobian likewise.

    Of what is left of k and psi, true minus estimated, z then has ``-u / (1 + k)`` and ``(-u_y, u_x, 0)``.
    """
    factor, yaw = 1.0, 0.0
    if layout.dvl_scale >= 0:
        factor += ins.constants[layout.dvl_scale - layout.constants]
    if layout.dvl_yaw >= 0:
        yaw += ins.constants[layout.dvl_yaw - layout.constants]
    along, across = factor * math.cos(yaw), factor * math.sin(yaw)
    for j in range(H.shape[1]):
        x, y = H[0, j], H[1, j]
        H[0, j], H[1, j], H[2, j] = along * x + across * y, along * y - across * x, factor * H[2, j]
    x, y, z = predicted_b
    read_b = (along * x + across * y, along * y - across * x, factor * z)
    write_dvl_constants(read_b, ins.constants, layout, H)
    return read_b


@inlined
def write_dvl_constants(read_b: Vector, constants: Floats, layout: StateLayout, H: Floats) -> None:
    """Write what an innovation says of scale and yaw, where this is what the DVL reads but for noise."""
    if layout.dvl_scale >= 0:
        factor = 1.0 + constants[layout.dvl_scale - layout.constants]
        write_column_vector(scale(-1.0 / factor, read_b), H, layout.dvl_scale)
    if layout.dvl_yaw >= 0:
        write_column_vector((-read_b[1], read_b[0], 0.0), H, layout.dvl_yaw)


@inlined
def _linearise_sensor(
    measurements: Stack, m: int, row: int, ins: InsAtPing, layout: StateLayout, z: Floats, H: Floats
) -> None:
    H[:] = 0.0
    reading, arm_n = measurements.values[m, row], rotate(ins.mat_nb, row_vector(measurements.lever_arm_b, m))
    if measurements.kind[m] == DEPTH:
        z[0] = _predict_depth(ins, arm_n, layout, H) - reading[0]
    elif measurements.kind[m] == HEADING:
        z[0] = nearest_turn(_predict_heading(ins, layout, H) - reading[0])
    else:
        _linearise_fix(ins, reading, arm_n, layout, z, H)


@inlined
def _predict_depth(ins: InsAtPing, arm_n: Vector, layout: StateLayout, H: Floats) -> float:
    """Return what the gauge reads so far below the ellipsoid, -h + (C l)_d + d_0, and write its Jacobian."""
    H[0, 3], H[0, 4] = arm_n[1], -arm_n[0]
    if layout.position >= 0:
        H[0, layout.position + 2] = 1.0
    zero_m = 0.0
    if layout.depth_zero >= 0:
        H[0, layout.depth_zero], zero_m = -1.0, ins.constants[layout.depth_zero - layout.constants]
    return arm_n[2] - ins.position[2] + zero_m


@inlined
def _predict_heading(ins: InsAtPing, layout: StateLayout, H: Floats) -> float:
    """Return where the bow points by a biased sensor, atan2(c_e, c_n) + b of C's first column c, and its Jacobian."""
    north, east, down = ins.mat_nb[0][0], ins.mat_nb[1][0], ins.mat_nb[2][0]
    steep = down / (north * north + east * east)
    H[0, 3], H[0, 4], H[0, 5] = -steep * north, -steep * east, 1.0
    bias = 0.0
    if layout.heading_bias >= 0:
        H[0, layout.heading_bias], bias = -1.0, ins.constants[layout.heading_bias - layout.constants]
    return math.atan2(east, north) + bias


@inlined
def _linearise_fix(ins: InsAtPing, fix: Floats, arm_n: Vector, layout: StateLayout, z: Floats, H: Floats) -> None:
    """Write how far the antenna is from a fix, p - p_fix + C l in n, m, and the Jacobian; both may lack the height."""
    height_m = fix[2] if len(z) == 3 else ins.position[2]
    apart_n = add(offset_n(ins.position, (fix[0], fix[1], height_m), ins.place), arm_n)
    by_turn = skew(scale(-1.0, arm_n))
    for i in range(len(z)):
        z[i], (H[i, 3], H[i, 4], H[i, 5]) = apart_n[i], by_turn[i]
        if layout.position >= 0:
            H[i, layout.position + i] = 1.0


@inlined
def _predict_velocity(ins: InsAtPing, rate_eb_b: Vector, H: Floats) -> Vector:
    """Return the velocity at the DVL, C' v + w_eb x l, and write its Jacobian, [ C' | C'[v x] | 0 | -[l x] ]."""
    mat_bn = transpose(ins.mat_nb)
    turned = compose(mat_bn, skew(ins.velocity_n))
    write_blocks((mat_bn, turned, ZERO, skew(scale(-1.0, ins.lever_arm_b))), H)
    return add(rotate(mat_bn, ins.velocity_n), cross(rate_eb_b, ins.lever_arm_b))


@inlined
def _predict_specific_force(ins: InsAtPing, H: Floats) -> Vector:
    """Return the paper's prediction, f + C' g, and write its Jacobian, [ 0 | C'[g x] | I | 0 ]."""
    mat_bn, gravity_n = transpose(ins.mat_nb), (0.0, 0.0, ins.gravity)
    write_blocks((ZERO, compose(mat_bn, skew(gravity_n)), IDENTITY, ZERO), H)
    return add(ins.specific_force_b, rotate(mat_bn, gravity_n))


@inlined
def _predict_slope(measurements: Stack, m: int, ins: InsAtPing, ping: int, H: Floats) -> Vector:
    """Return the slope of the DVL's velocity that the mechanisation predicts in the window, and write its Jacobian."""
    n = measurements.velocity_weights.shape[2]
    first, slope_b = ping - n + 1, (0.0, 0.0, 0.0)
    for j in range(max(0, -first), n):
        arm_velocity_b = cross(row_vector(ins.rate_eb_b, first + j), ins.lever_arm_b)
        slope_b = add(slope_b, scale(measurements.velocity_weights[m, ping, j], arm_velocity_b))
        if j > 0:
            change_b = row_vector(ins.velocity_change_b, first + j)
            slope_b = add(slope_b, scale(measurements.interval_weights[m, ping, j - 1], change_b))
    _write_slope_jacobian(ins, row_vector(ins.rate_nb_b, ping), H)
    return slope_b


@inlined
def _write_slope_jacobian(ins: InsAtPing, rate_nb_b: Vector, H: Floats) -> None:
    """Write [ -[w x]C' | C'[g x] - [w x]C'[v x] | I | [v_b x] ]."""
    mat_bn, against_rate = transpose(ins.mat_nb), skew(scale(-1.0, rate_nb_b))
    of_gravity = compose(mat_bn, skew((0.0, 0.0, ins.gravity)))
    of_turning = compose(against_rate, compose(mat_bn, skew(ins.velocity_n)))
    velocity_b = rotate(mat_bn, ins.velocity_n)
    blocks = compose(against_rate, mat_bn), add_matrices(of_gravity, of_turning), IDENTITY, skew(velocity_b)
    write_blocks(blocks, H)
