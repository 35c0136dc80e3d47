"""The trajectory of each filter once a second, in ``trajectory.npz``: what a gate compares, and a paper prints.

It is small, a few hundred bytes a second, and full: every state with its standard deviation, and the errors against the
reference. numpy reads it: ``names``, ``columns``, ``time_s``, ``sha256`` of the log, and ``values`` of shape (filters,
times, columns).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zipfile import BadZipFile

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, Integers, TimeNs
from insdvl_replay.core.states import COLUMNS, DEG, DEG_PER_HOUR, GROUPS, MG, STATES
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.results.folder import read_file

if TYPE_CHECKING:
    # Only their types are needed: who reads a trajectory must not wait for the filters.
    from insdvl_replay.core.history import History
    from insdvl_replay.evaluation.convergence import ConvergenceCurves
    from insdvl_replay.evaluation.reference_errors import ReferenceErrors
    from insdvl_replay.preparation.replay import Replay

_CURVE: Final = "curve_"  # Begins the name of an array that is no sample of a second.
# Measurements whose NIS is compared, in the order of the columns.
_OF_DVL: Final = ("velocity", "acceleration")
# An error against the reference is used for so long after the time of the reference.
_HELD_NS: Final = 10 * NS_PER_S


@dataclass(frozen=True)
class Trajectory:
    """The filters of a dive, second by second."""

    sha256: str  # of the log
    names: tuple[str, ...]  # of the filters; the first is the baseline
    time_s: Floats  # (k,), from the start of the replay
    values: Floats  # (filters, k, columns), in the order of `COLUMNS`; NaN where nothing is known
    # Measured convergence, SI units: QUANTITY_time_s (g,), QUANTITY_rms and QUANTITY_predicted (filters, g).
    curves: Mapping[str, Floats] = field(default_factory=dict)

    def of(self, name: str, column: str) -> Floats:
        """Return one column of one filter, shape (k,)."""
        values: Floats = self.values[self.names.index(name), :, COLUMNS.index(column)]
        return values


def trajectory_of(replay: "Replay") -> Trajectory:
    """Sample the histories of a replay once a second: the last state at or before each."""
    grid_ns = np.arange(replay.start_ns, replay.end_ns + 1, NS_PER_S)
    origin = replay.histories[0].position[0]
    values = []
    for history in replay.histories:
        samples = [
            _states(history, origin, grid_ns),
            _nis_over_dof(history, grid_ns),
            _errors(replay.errors.get(history.filter), grid_ns),
        ]
        values.append(np.hstack(samples))
    names = tuple(history.filter for history in replay.histories)
    return Trajectory(
        replay.dive.sha256,
        names,
        (grid_ns - replay.start_ns) / NS_PER_S,
        np.stack(values),
        _convergence(replay.curves.convergence, names),
    )


def _states(history: "History", origin: Floats, grid_ns: TimeNs) -> Floats:
    """Sample the states of a filter and their standard deviations, in shown units."""
    rows = _last_before(history.time_ns, grid_ns)
    position = history.position[rows]
    factors = np.array([state.factor for state in STATES])
    columns = [
        north_east_down_m(position, np.broadcast_to(origin, position.shape)),
        history.velocity_n[rows],
        rpy_from_mat(history.mat_nb[rows]) / DEG,
        history.accel_bias_b[rows] / MG,
        history.gyro_bias_b[rows] / DEG_PER_HOUR,
        history.sd[rows, : len(STATES)] / factors,
    ]
    return np.hstack(columns)


def _nis_over_dof(history: "History", grid_ns: TimeNs) -> Floats:
    """Sample the NIS of the DVL's measurements over its degrees of freedom; NaN before the first update."""
    nis = np.full((len(grid_ns), len(_OF_DVL)), np.nan)
    for met in history.innovations:
        if met.measurement in _OF_DVL and len(met.time_ns):
            begun = grid_ns >= met.time_ns[0]
            latest = _last_before(met.time_ns, grid_ns)[begun]
            nis[begun, _OF_DVL.index(met.measurement)] = met.nis[latest] / met.dof
    return nis


def _errors(errors: "ReferenceErrors | None", grid_ns: TimeNs) -> Floats:
    """Sample the errors against the reference, in shown units; NaN where it is unknown for long."""
    sampled = np.full((len(grid_ns), len(GROUPS["error"])), np.nan)
    if errors is None or not len(errors.time_ns):
        return sampled
    latest = _last_before(errors.time_ns, grid_ns)
    age_ns = grid_ns - errors.time_ns[latest]
    known = (age_ns >= 0) & (age_ns <= _HELD_NS)
    position_m = errors.position_error_ned_m[latest[known]]
    velocity_mps = errors.velocity_error_n[latest[known]]
    attitude_rad = errors.attitude_error_rad[latest[known]]
    columns = [
        np.hypot(position_m[:, 0], position_m[:, 1]),
        position_m[:, 2],
        np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]),
        np.hypot(attitude_rad[:, 0], attitude_rad[:, 1]) / DEG,
        attitude_rad[:, 2] / DEG,
    ]
    sampled[known] = np.column_stack(columns)
    return sampled


def _convergence(
    found: "Mapping[str, ConvergenceCurves]", names: Sequence[str]
) -> dict[str, Floats]:
    """Return the curves of measured convergence as they are stored."""
    curves = {}
    for quantity, curve in found.items():
        unknown = np.full(len(curve.time_s), np.nan)  # of a solution that was read
        measured = [curve.rms.get(name, unknown) for name in names]
        predicted = [curve.predicted.get(name, unknown) for name in names]
        curves[f"{quantity}_time_s"] = curve.time_s
        curves[f"{quantity}_rms"] = np.stack(measured)
        curves[f"{quantity}_predicted"] = np.stack(predicted)
    return curves


def _last_before(time_ns: TimeNs, grid_ns: TimeNs) -> Integers:
    """Return the row of the last time at or before each of the grid; the first where there is none."""
    rows = np.searchsorted(time_ns, grid_ns, side="right") - 1
    return np.asarray(np.maximum(rows, 0), dtype=np.int64)


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory; the same one gives the same bytes."""
    arrays: dict[str, Any] = {
        "sha256": np.array(trajectory.sha256),
        "names": np.array(trajectory.names),
        "columns": np.array(COLUMNS),
        "time_s": trajectory.time_s,
        "values": trajectory.values,
    }
    for name, curve in trajectory.curves.items():
        arrays[f"{_CURVE}{name}"] = curve
    with path.open("wb") as file:
        np.savez(file, **arrays)


def read_trajectory(path: Path) -> Trajectory | None:
    """Read a trajectory; None if there is none, or what is there is none of this version."""
    try:
        with np.load(BytesIO(read_file(path)), allow_pickle=False) as stored:
            if tuple(stored["columns"].tolist()) != COLUMNS:
                return None
            curves = {}
            for name in stored.files:
                if name.startswith(_CURVE):
                    curves[name.removeprefix(_CURVE)] = stored[name]
            return Trajectory(
                sha256=str(stored["sha256"]),
                names=tuple(stored["names"].tolist()),
                time_s=stored["time_s"],
                values=stored["values"],
                curves=curves,
            )
    except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile):
        return None
