"""The trajectory of each filter once a second, in ``trajectory.npz``: what a gate compares, and a paper prints.

It is small, a few hundred bytes a second, and full: every state with its standard deviation, and the errors against the
reference. numpy reads it: ``names``, ``columns``, ``time_s``, ``sha256`` of the log, and ``values`` of shape (filters,
times, columns).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from zipfile import BadZipFile

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, Integers, TimeNs
from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.quantities import AXES
from insdvl_replay.core.report import Row
from insdvl_replay.core.states import COLUMNS, DEG, DEG_PER_HOUR, GROUPS, MG, STATES
from insdvl_replay.document.parts import (
    LIMIT,
    PREDICTED,
    REFERENCE,
    Curve,
    Figure,
    Panel,
    filter_style,
)
from insdvl_replay.evaluation.consistency import mean_interval
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.results.folder import read_file

if TYPE_CHECKING:
    # Only their types are needed: who reads a trajectory must not wait for the filters.
    import pandas as pd

    from insdvl_replay.preparation.replay import Replay

_CURVE: Final = "curve_"  # Begins the name of an array that is no sample of a second.
_OF_DVL: Final = (
    "velocity",
    "acceleration",
)  # Measurements whose NIS is compared, in the order of the columns.
_HELD_NS: Final = (
    10 * NS_PER_S
)  # An error against the reference is used for so long after the time of the reference.


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
    factors = np.array([state.factor for state in STATES])
    values = []
    for history in replay.histories:
        rows = _last_before(history.time_ns, grid_ns)
        position = history.position[rows]
        nis = np.full(
            (len(grid_ns), len(_OF_DVL)), np.nan
        )  # over the degrees of freedom; NaN before the first update
        for met in history.innovations:
            if met.measurement in _OF_DVL and len(met.time_ns):
                begun = grid_ns >= met.time_ns[0]
                latest = _last_before(met.time_ns, grid_ns)[begun]
                nis[begun, _OF_DVL.index(met.measurement)] = met.nis[latest] / met.dof
        error = np.full((len(grid_ns), len(GROUPS["error"])), np.nan)
        errors = replay.errors.get(history.filter)
        if errors is not None and len(errors.time_ns):
            latest = _last_before(errors.time_ns, grid_ns)
            age_ns = grid_ns - errors.time_ns[latest]
            known = (age_ns >= 0) & (age_ns <= _HELD_NS)
            position_m, velocity_mps, attitude_rad = (
                array[latest[known]]
                for array in (
                    errors.position_error_ned_m,
                    errors.velocity_error_n,
                    errors.attitude_error_rad,
                )
            )
            error[known] = np.column_stack(
                [
                    np.hypot(position_m[:, 0], position_m[:, 1]),
                    position_m[:, 2],
                    np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]),
                    np.hypot(attitude_rad[:, 0], attitude_rad[:, 1]) / DEG,
                    attitude_rad[:, 2] / DEG,
                ]
            )
        states = [
            north_east_down_m(position, np.broadcast_to(origin, position.shape)),
            history.velocity_n[rows],
            rpy_from_mat(history.mat_nb[rows]) / DEG,
            history.accel_bias_b[rows] / MG,
            history.gyro_bias_b[rows] / DEG_PER_HOUR,
            history.sd[rows, : len(STATES)] / factors,
        ]
        values.append(np.column_stack([*states, nis, error]))
    names = tuple(history.filter for history in replay.histories)
    curves = {}
    for quantity, curve in replay.curves.convergence.items():
        unknown = np.full(len(curve.time_s), np.nan)  # of a solution that was read
        curves[f"{quantity}_time_s"] = curve.time_s
        curves[f"{quantity}_rms"] = np.stack([curve.rms.get(name, unknown) for name in names])
        curves[f"{quantity}_predicted"] = np.stack(
            [curve.predicted.get(name, unknown) for name in names]
        )
    return Trajectory(
        replay.dive.sha256, names, (grid_ns - replay.start_ns) / NS_PER_S, np.stack(values), curves
    )


def _last_before(time_ns: TimeNs, grid_ns: TimeNs) -> Integers:
    return np.asarray(
        np.maximum(np.searchsorted(time_ns, grid_ns, side="right") - 1, 0), dtype=np.int64
    )


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
            curves = {
                name.removeprefix(_CURVE): stored[name]
                for name in stored.files
                if name.startswith(_CURVE)
            }
            names = tuple(stored["names"].tolist())
            return Trajectory(
                str(stored["sha256"]), names, stored["time_s"], stored["values"], curves
            )
    except (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile):
        return None


# --- Figures for a paper.

_ERRORS: Final = {
    "position_error_m": "position error [m]",
    "velocity_error_mps": "velocity error [m/s]",
    "level_error_deg": "level error [deg]",
    "heading_error_deg": "heading error [deg]",
}
_NIS: Final = {"nis_velocity": "NIS / dof, velocity", "nis_acceleration": "NIS / dof, acceleration"}
_CONVERGED: Final = {
    "level": ("level [deg]", DEG),
    "heading": ("heading [deg]", DEG),
    "velocity": ("velocity [m/s]", 1.0),
}
KINDS: Final = ("error", "track", "sigma", "nis", "outage", "convergence")  # What can be drawn.


def paper_figure(
    kind: str,
    trajectory: Trajectory,
    tables: Mapping[str, Sequence[Row]],
    states: str = "",
    reference: "pd.DataFrame | None" = None,
) -> Figure:
    """Return a figure of a kind, by the tables of the dive; states are for sigma, the reference for the track."""
    require_known("figure", kind, KINDS, most=len(KINDS))
    chosen = chosen_states(states)
    names = trajectory.names
    panels = list[Panel]()
    styles = [filter_style(number) for number in range(len(names))]
    legend = [*zip(styles, names, strict=True)]

    def panel(title: str, x_label: str, curves: Sequence[Sequence[Curve]], **axes: Any) -> None:
        baseline_last = (
            *curves[1:],
            *curves[:1],
        )  # curves that equal it are seen through its dashes
        panels.append(
            Panel(
                title,
                x_label,
                tuple(curve for filter_ in baseline_last for curve in filter_),
                **axes,
            )
        )

    def over_time(columns: Mapping[str, str], **axes: Any) -> None:
        for column, title in columns.items():
            series = [trajectory.of(name, column) for name in names]
            if kind == "sigma" or any(np.isfinite(values).any() for values in series):
                curves = [
                    [Curve(trajectory.time_s, y, style)]
                    for style, y in zip(styles, series, strict=True)
                ]
                band = _consistent(column, trajectory.time_s, tables) if kind == "nis" else []
                panel(title, "time [s]", [*curves[:1], band, *curves[1:]], **axes)

    match kind:
        case "error":
            over_time(_ERRORS)
        case "nis":
            over_time(_NIS, y_scale="log")
            legend.append((f"band {LIMIT}", "95 % of a consistent filter"))
        case "sigma":
            shown = [state for state in STATES if not chosen or state.id.startswith(chosen)]
            over_time({f"{state.id}_sd": f"{state.label} [{state.unit}]" for state in shown})
        case "track":
            tracks = [
                (trajectory.of(name, "position_e_m"), trajectory.of(name, "position_n_m"))
                for name in names
            ]
            curves = [[Curve(*track, style)] for style, track in zip(styles, tracks, strict=True)]
            true = []
            if reference is not None and reference["position_n_m"].notna().any():
                east_m, north_m = (reference[f"position_{axis}_m"].to_numpy() for axis in "en")
                true = [Curve(east_m, north_m, REFERENCE)]
            line = (true or [curve for (curve,) in curves])[0]
            known = np.flatnonzero(np.isfinite(line.x))
            marks = [
                Curve(line.x[[row]], line.y[[row]], style, points=True)
                for style, row in zip(
                    ("start", "end"), known[[0, -1]] if len(known) else (), strict=False
                )
            ]
            panel("north [m]", "east [m]", [marks, *curves[1:], true, curves[0]], equal=True)
            legend += [
                *([(REFERENCE, REFERENCE)] if true else []),
                ("start", "start"),
                ("end", "end"),
            ]
        case "outage" if rows := tables.get("outage", ()):
            curves = []
            for style, name in zip(styles, names, strict=True):
                own = [row for row in rows if row.get("filter") == name]
                at_s = np.array([float(str(row["window_s"])) for row in own])
                median_m, p95_m = (
                    np.array([_number(row.get(column)) for row in own])
                    for column in ("drift_median_m", "drift_p95_m")
                )
                thin = Curve(at_s, p95_m, f"{style} {PREDICTED}")
                curves.append(
                    [Curve(at_s, median_m, style), Curve(at_s, median_m, style, points=True), thin]
                )
            panel("drift [m]", "time without DVL [s]", curves, x_scale="log", y_scale="log")
            legend += [(REFERENCE, "median"), (f"{REFERENCE} {PREDICTED}", "95 %")]
        case "convergence":
            for quantity, (title, unit) in _CONVERGED.items():
                if (time_s := trajectory.curves.get(f"{quantity}_time_s")) is not None:
                    rms, predicted = (
                        trajectory.curves[f"{quantity}_{kind}"] / unit
                        for kind in ("rms", "predicted")
                    )
                    curves = [
                        [
                            Curve(time_s, rms[i], style),
                            Curve(time_s, predicted[i], f"{style} {PREDICTED}"),
                        ]
                        for i, style in enumerate(styles)
                    ]
                    panel(title, "time [s]", curves, y_scale="log")
            legend += [(REFERENCE, "measured"), (f"{REFERENCE} {PREDICTED}", "predicted")]
    if not panels:
        raise ConfigError(f"there is nothing to draw for {kind}", f"kinds: {', '.join(KINDS)}")
    return Figure("", "", tuple(panels), tuple(legend))


def _consistent(column: str, time_s: Floats, tables: Mapping[str, Sequence[Row]]) -> list[Curve]:
    """Return the NIS over its degrees of freedom that is expected, with 95 % of its values."""
    measurement = column.removeprefix("nis_")
    rows = [row for row in tables.get("consistency", ()) if row.get("measurement") == measurement]
    dof = int(_number(rows[0]["dof"])) if rows else len(AXES)
    low, high = (np.full(len(time_s), limit / dof) for limit in mean_interval(dof, 1))
    return [Curve(time_s, np.ones(len(time_s)), LIMIT, band=(low, high))]


def _number(value: object) -> float:
    if isinstance(value, int | float):
        return float(value)
    return math.nan


def chosen_states(text: str) -> tuple[str, ...]:
    """Read names of states, or their beginnings such as ``ba``, with commas between them."""
    names = tuple(part.strip() for part in text.split(",") if part.strip())
    beginnings = list(dict.fromkeys(state.id.partition("_")[0] for state in STATES))
    for name in names:
        if not any(state.id.startswith(name) for state in STATES):
            require_known("state", name, [*beginnings, *(state.id for state in STATES)])
    return names
