"""Figures that stand on their own, for a paper: as wide as a column, with names, units and legends of their own."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.states import DEG, STATES
from insdvl_replay.core.stored_report import Row
from insdvl_replay.results.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM_PER_INCH: Final = 25.4
_COLOURS: Final = ("#c0232c", "#1c5fc4", "#1f7f45", "#7a45b8", "#a86a00", "#0a7c86")
_DASHES: Final = ("--", "-", ":", "-.", (0, (6, 1)), (0, (3, 1, 1, 1)))
_SHAPE: Final = 0.62
"""Height over width of a panel."""
_STYLE: Final[Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "legend.fontsize": 7.0,
    "lines.linewidth": 0.9,
    "axes.linewidth": 0.5,
    "grid.linewidth": 0.3,
    "axes.grid": True,
    "pdf.fonttype": 42,
    "svg.hashsalt": "insdvl-replay",
    "svg.fonttype": "none",
}
_CONVERGED: Final = {
    "level": ("level [deg]", DEG),
    "heading": ("heading [deg]", DEG),
    "velocity": ("velocity [m/s]", 1.0),
}


@dataclass(frozen=True)
class Drawn:
    """What a figure is drawn of."""

    trajectory: Trajectory
    coasting: Sequence[Row]
    states: tuple[str, ...]


def draw_figure(kind: str, drawn: Drawn, path: Path, *, width_mm: float) -> None:
    """Draw a figure into a file, whose ending says the format: .pdf, .svg, .png or .pgf.

    Raises
    ------
    ConfigError
        The result has nothing to draw, or .pgf is asked for where there is no LaTeX.
    """
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    panels = KINDS[kind](drawn)
    if not panels:
        raise ConfigError(f"there is nothing to draw for {kind}", f"kinds: {', '.join(KINDS)}")
    columns = min(len(panels), 1 if width_mm < 120.0 else 3)
    rows = math.ceil(len(panels) / columns)
    width = width_mm / MM_PER_INCH
    with mpl.rc_context(_STYLE):
        figure, axes = plt.subplots(
            rows, columns, figsize=(width, rows * width / columns * _SHAPE), squeeze=False, layout="constrained"
        )
        try:
            for place, axis in enumerate(axes.flat):
                if place < len(panels):
                    panels[place](axis)
                else:
                    axis.set_visible(False)
            axes.flat[0].legend(frameon=False)
            data = BytesIO()  # the writer of PDF loses the reason where a disk is full
            figure.savefig(data, format=path.suffix[1:], dpi=300, metadata=_undated(path))
        except (RuntimeError, FileNotFoundError, OSError) as error:
            if path.suffix != ".pgf":
                raise
            raise ConfigError("--format pgf needs LaTeX, which is not there", "--format pdf needs nothing") from error
        finally:
            plt.close(figure)
    path.write_bytes(data.getvalue())


def _undated(path: Path) -> dict[str, Any] | None:
    """Leave the time of day out, so that the same result gives the same bytes."""
    return {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(path.suffix)


Panel = Callable[["Axes"], None]


def _over_time(drawn: Drawn, column: str, label: str) -> Panel:
    def draw(axis: "Axes") -> None:
        for number, name in enumerate(drawn.trajectory.names):
            axis.plot(drawn.trajectory.time_s, drawn.trajectory.of(name, column), label=name, **_line(number))
        axis.set_xlabel("time [s]")
        axis.set_ylabel(label)

    return draw


def _line(number: int) -> dict[str, Any]:
    """Return the look of a filter; the baseline lies on top, so that through its dashes the same is still seen."""
    look = number % len(_COLOURS)
    return {"color": _COLOURS[look], "linestyle": _DASHES[look], "zorder": 3.0 - 0.1 * number}


def _known(drawn: Drawn, column: str) -> bool:
    return any(np.isfinite(drawn.trajectory.of(name, column)).any() for name in drawn.trajectory.names)


def _errors(drawn: Drawn) -> list[Panel]:
    labels = {
        "position_error_m": "position error [m]",
        "velocity_error_mps": "velocity error [m/s]",
        "level_error_deg": "level error [deg]",
        "heading_error_deg": "heading error [deg]",
    }
    return [_over_time(drawn, column, label) for column, label in labels.items() if _known(drawn, column)]


def _track(drawn: Drawn) -> list[Panel]:
    def draw(axis: "Axes") -> None:
        for number, name in enumerate(drawn.trajectory.names):
            east, north = (drawn.trajectory.of(name, column) for column in ("position_e_m", "position_n_m"))
            axis.plot(east, north, label=name, **_line(number))
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("east [m]")
        axis.set_ylabel("north [m]")

    return [draw]


def _sigmas(drawn: Drawn) -> list[Panel]:
    chosen = [state for state in STATES if not drawn.states or state.id.startswith(drawn.states)]
    return [_over_time(drawn, f"{state.id}_sd", f"{state.label} [{state.unit}]") for state in chosen]


def _nis(drawn: Drawn) -> list[Panel]:
    def beside_one(column: str, label: str) -> Panel:
        draw = _over_time(drawn, column, label)

        def draw_log(axis: "Axes") -> None:
            draw(axis)
            axis.set_yscale("log")
            axis.axhline(1.0, color="black", linewidth=0.5)

        return draw_log

    columns = {"nis_velocity": "NIS / dof, velocity", "nis_acceleration": "NIS / dof, acceleration"}
    return [beside_one(column, label) for column, label in columns.items() if _known(drawn, column)]


def _coasting(drawn: Drawn) -> list[Panel]:
    def draw(axis: "Axes") -> None:
        for number, name in enumerate(drawn.trajectory.names):
            rows = [row for row in drawn.coasting if row.get("filter") == name]
            at_s = [float(str(row["window_s"])) for row in rows]
            for column, fill, label in (("drift_median_m", "full", name), ("drift_p95_m", "none", "")):
                axis.plot(at_s, [_number(row, column) for row in rows], marker="o", fillstyle=fill, markersize=3.0,
                          label=label or None, **_line(number))  # fmt: skip
        axis.set(xscale="log", yscale="log", xlabel="time without DVL [s]", ylabel="drift [m], median and 95 %")

    return [draw] if drawn.coasting else []


def _number(row: Mapping[str, object], column: str) -> float:
    value = row.get(column)
    return float(value) if isinstance(value, int | float) else math.nan


def _convergence(drawn: Drawn) -> list[Panel]:
    def of_one(quantity: str) -> Panel:
        label, unit = _CONVERGED[quantity]
        curves = drawn.trajectory.curves

        def draw(axis: "Axes") -> None:
            for number, name in enumerate(drawn.trajectory.names):
                time_s = curves[f"{quantity}_time_s"]
                axis.plot(time_s, curves[f"{quantity}_rms"][number] / unit, label=name, **_line(number))
                believed = curves[f"{quantity}_believed"][number] / unit
                axis.plot(time_s, believed, color=_line(number)["color"], linewidth=0.4)
            axis.set(xlabel="time [s]", ylabel=label, yscale="log")

        return draw

    return [of_one(quantity) for quantity in _CONVERGED if f"{quantity}_time_s" in drawn.trajectory.curves]


KINDS: Final[Mapping[str, Callable[[Drawn], list[Panel]]]] = {
    "error": _errors,
    "track": _track,
    "sigma": _sigmas,
    "nis": _nis,
    "coasting": _coasting,
    "convergence": _convergence,
}
"""What can be drawn."""


def chosen_states(text: str) -> tuple[str, ...]:
    """Read names of states, or their beginnings such as ``ba``, with commas between them."""
    names = tuple(part.strip() for part in text.split(",") if part.strip())
    beginnings = list(dict.fromkeys(state.id.partition("_")[0] for state in STATES))
    for name in names:
        if not any(state.id.startswith(name) for state in STATES):
            require_known("state", name, [*beginnings, *(state.id for state in STATES)])
    return names
