"""What sensors measure at times of their own, ready for a filter: values, their noise R, and how they are judged.

`innovation` predicts the same from the INS.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.nav.measurement_noise import FIXED
from insdvl_replay.nav.own_measurement import Predicts
from insdvl_replay.nav.timeline import PINGS

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
