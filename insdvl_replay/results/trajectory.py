"""The trajectory of each filter once a second, in ``trajectory.npz``: what a gate compares sample by sample.

It is small, a few hundred bytes a second, and full: every state with its standard deviation, and the errors against the
reference. numpy reads it: ``names``, ``columns``, ``time_s``, ``sha256`` of the log, and ``values`` of shape (filters,
times, columns).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.states import COLUMNS, DEG, DEG_PER_HOUR, GROUPS, MG, STATES
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.results.folder import read_file

if TYPE_CHECKING:
    # Only their types are needed, and whoever reads a trajectory must not wait for the filters.
    from insdvl_replay.core.history import History
    from insdvl_replay.evaluation.errors import ReferenceErrors
    from insdvl_replay.replay import Replay

_CURVE: Final = "curve_"
"""Begins the name of an array that is no sample of a second."""
_OF_DVL: Final = ("velocity", "acceleration")
"""Measurements whose NIS is compared, in the order of the columns."""
_HELD_NS: Final = 10 * NS_PER_S
"""An error against the reference stands for so long after the time of the reference."""


@dataclass(frozen=True)
class Trajectory:
    """The filters of a dive, second by second.

    Attributes
    ----------
    sha256 : str
        Of the log.
    names : tuple of str
        Of the filters; the first is the baseline.
    time_s : ndarray, shape (k,)
        From the start of the replay.
    values : ndarray, shape (filters, k, columns)
        In the order of `COLUMNS`; NaN where nothing is known.
    curves : dict of str to ndarray
        Measured convergence, by quantity: ``QUANTITY_time_s``, shape (g,), and ``QUANTITY_rms`` and
        ``QUANTITY_believed``, shape (filters, g), SI units.
    """

    sha256: str
    names: tuple[str, ...]
    time_s: Floats
    values: Floats
    curves: Mapping[str, Floats] = field(default_factory=dict)

    def of(self, name: str, column: str) -> Floats:
        """Return one column of one filter, shape (k,)."""
        values: Floats = self.values[self.names.index(name), :, COLUMNS.index(column)]
        return values


def trajectory_of(replay: "Replay") -> Trajectory:
    """Sample the histories of a replay once a second: the last state at or before each."""
    grid_ns = np.arange(replay.start_ns, replay.end_ns + 1, NS_PER_S)
    origin = replay.histories[0].position[0]
    values = np.stack(
        [
            np.column_stack(
                [
                    _states(history, grid_ns, origin),
                    _nis(history, grid_ns),
                    _errors(replay.errors.get(history.filter), grid_ns),
                ]
            )
            for history in replay.histories
        ]
    )
    names = tuple(history.filter for history in replay.histories)
    return Trajectory(replay.dive.sha256, names, (grid_ns - replay.start_ns) / NS_PER_S, values, _curves(replay))


def _curves(replay: "Replay") -> dict[str, Floats]:
    names = [history.filter for history in replay.histories]
    found: dict[str, Floats] = {}
    for quantity, curve in replay.curves.convergence.items():
        found[f"{quantity}_time_s"] = curve.time_s
        unknown = np.full(len(curve.time_s), np.nan)  # of a solution that was read
        found[f"{quantity}_rms"] = np.stack([curve.rms.get(name, unknown) for name in names])
        found[f"{quantity}_believed"] = np.stack([curve.believed.get(name, unknown) for name in names])
    return found


def _states(history: "History", grid_ns: TimeNs, origin: Floats) -> Floats:
    rows = _last_before(history.time_ns, grid_ns)
    position = history.position[rows]
    return np.column_stack(
        [
            north_east_down_m(position, np.broadcast_to(origin, position.shape)),
            history.velocity_n[rows],
            rpy_from_mat(history.mat_nb[rows]) / DEG,
            history.accel_bias_b[rows] / MG,
            history.gyro_bias_b[rows] / DEG_PER_HOUR,
            history.sd[rows, : len(STATES)] / np.array([state.factor for state in STATES]),
        ]
    )


def _nis(history: "History", grid_ns: TimeNs) -> Floats:
    """Return the NIS of the last update of each measurement, over its degrees of freedom; NaN before the first."""
    found = np.full((len(grid_ns), len(_OF_DVL)), np.nan)
    for met in (one for one in history.innovations if one.measurement in _OF_DVL):
        if len(met.time_ns):
            rows, begun = _last_before(met.time_ns, grid_ns), grid_ns >= met.time_ns[0]
            found[begun, _OF_DVL.index(met.measurement)] = met.nis[rows[begun]] / met.dof
    return found


def _errors(errors: "ReferenceErrors | None", grid_ns: TimeNs) -> Floats:
    found = np.full((len(grid_ns), len(GROUPS["error"])), np.nan)
    if errors is None or not len(errors.time_ns):
        return found
    rows = _last_before(errors.time_ns, grid_ns)
    age_ns = grid_ns - errors.time_ns[rows]
    known = (age_ns >= 0) & (age_ns <= _HELD_NS)
    position, velocity, attitude = (
        array[rows[known]]
        for array in (errors.position_error_ned_m, errors.velocity_error_n, errors.attitude_error_rad)
    )
    found[known] = np.column_stack(
        [
            np.hypot(position[:, 0], position[:, 1]),
            position[:, 2],
            np.hypot(velocity[:, 0], velocity[:, 1]),
            np.hypot(attitude[:, 0], attitude[:, 1]) / DEG,
            attitude[:, 2] / DEG,
        ]
    )
    return found


def _last_before(time_ns: TimeNs, grid_ns: TimeNs) -> NDArray[np.int64]:
    return np.asarray(np.maximum(np.searchsorted(time_ns, grid_ns, side="right") - 1, 0), dtype=np.int64)


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory; the same one gives the same bytes."""
    arrays: dict[str, Any] = {
        "sha256": np.array(trajectory.sha256),
        "names": np.array(trajectory.names),
        "columns": np.array(COLUMNS),
        "time_s": trajectory.time_s,
        "values": trajectory.values,
        **{f"{_CURVE}{name}": curve for name, curve in trajectory.curves.items()},
    }
    with path.open("wb") as file:
        np.savez(file, **arrays)


def read_trajectory(path: Path) -> Trajectory | None:
    """Read a trajectory; None if there is none, or what is there is none of this version."""
    try:
        with np.load(BytesIO(read_file(path)), allow_pickle=False) as stored:
            if tuple(stored["columns"].tolist()) != COLUMNS:
                return None
            curves = {name.removeprefix(_CURVE): stored[name] for name in stored.files if name.startswith(_CURVE)}
            names = tuple(stored["names"].tolist())
            return Trajectory(str(stored["sha256"]), names, stored["time_s"], stored["values"], curves)
    except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile):
        return None
