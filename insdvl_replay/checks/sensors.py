"""Whether a sensor tells anything: one that is stuck does not, nor does one whose readings the reference is made of."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ReferenceColumns, SensorColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle

OWN_SHARE: Final = 0.5
"""Of a sensor's readings; so many are in the reference by no accident."""
SAME_RAD, SAME_M = 1e-9, 1e-3
"""Readings that differ by less came from one message: 6 mm of latitude, a millimetre of depth."""

FEWEST_ALIKE, ALIKE_S = 20, 30.0
"""So many readings over so long are never the same down to the last digit where a sensor and a vehicle are at work."""


def sensor_notes(sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None) -> tuple[Note, ...]:
    """Note the sensors that are stuck, and those whose readings the reference is made of."""
    owned = () if reference is None else _of_reference(sensors, reference)
    return (*_stuck(sensors), *owned)


def _stuck(sensors: Mapping[str, SensorColumns]) -> Iterator[Note]:
    for name, columns in sensors.items():
        count, span_s = len(columns.time_ns), (int(columns.time_ns[-1]) - int(columns.time_ns[0])) / NS_PER_S
        if count >= FEWEST_ALIKE and span_s >= ALIKE_S and np.all(columns.values == columns.values[0]):
            text = (
                f"all {count} readings of the {name} are the same, over {span_s:.0f} s: it is stuck, or not connected"
            )
            yield Note(f"{name}_stuck", text, count, Severity.WARNING, f"{name}.topic names another one")


def _of_reference(sensors: Mapping[str, SensorColumns], reference: ReferenceColumns) -> Iterator[Note]:
    for name, columns in ((name, columns) for name, columns in sensors.items() if name in _SAME):
        _, ours, theirs = np.intersect1d(columns.time_ns, reference.time_ns, return_indices=True)
        with np.errstate(invalid="ignore"):
            same = _SAME[name](columns.values[ours], reference.rows(np.isin(np.arange(len(reference.time_ns)), theirs)))
        if (count := int(same.sum())) > OWN_SHARE * len(columns.time_ns):
            text = f"{count} of {len(columns.time_ns)} readings of the {name} are the reference's own"
            hint = f'evaluation.withheld = ["{name}"] judges by them; filters aided by them need another reference'
            yield Note(f"{name}{IS_REFERENCE}", text, count, Severity.WARNING, hint)


def _same_position(values: Floats, reference: ReferenceColumns) -> Floats:
    return np.asarray((np.abs(values[:, :2] - reference.position[:, :2]) < SAME_RAD).all(axis=1))


def _same_depth(values: Floats, reference: ReferenceColumns) -> Floats:
    """Compare how the two change: the gauge has a zero of its own."""
    ours_m, theirs_m = np.diff(values[:, 0]), -np.diff(reference.position[:, 2])
    return np.asarray((np.abs(ours_m - theirs_m) < SAME_M) & (np.abs(ours_m) > SAME_M))


def _same_heading(values: Floats, reference: ReferenceColumns) -> Floats:
    return np.asarray(np.abs(wrap_angle(values[:, 0] - rpy_from_mat(reference.mat_nb)[:, 2])) < SAME_RAD)


_SAME: Final[dict[str, Callable[[Floats, ReferenceColumns], Floats]]] = {
    "depth": _same_depth,
    "heading": _same_heading,
    "position": _same_position,
}
