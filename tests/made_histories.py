"""Histories of a filter that met one measurement, with given NIS."""

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History, Innovations

GATE = 25.9
"""NIS that one in 100,000 exceeds."""


def history(
    name: str,
    nis: Floats,
    used: Floats | NDArray[np.bool_] | None = None,
    measurement: str = "velocity",
) -> History:
    m = len(nis)
    nothing = np.zeros((m, 3))
    kept, gate = (np.ones(m, dtype=bool), np.inf) if used is None else (used.astype(bool), GATE)
    innovations = Innovations(
        measurement,
        "m/s",
        ("x", "y", "z"),
        np.arange(m, dtype=np.int64),
        np.arange(m, dtype=np.int64),
        nothing,
        nothing,
        np.ones((m, 3)),
        nis,
        kept,
        np.zeros(m),
        gate,
        5,
        np.zeros(m, dtype=bool),
    )
    one = np.zeros((1, 3))
    return History(
        name,
        np.zeros(1, dtype=np.int64),
        np.ones(1, dtype=bool),
        one,
        one,
        np.eye(3)[None],
        one,
        one,
        np.ones((1, 12)),
        np.empty(0, dtype=np.int64),
        np.empty((0, 12, 12)),
        (innovations,),
    )
