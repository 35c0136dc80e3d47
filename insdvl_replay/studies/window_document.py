"""A window study for people: how many velocities make the best acceleration."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.report.document import DisplayTable, number
from insdvl_replay.report.plots.axis import limits
from insdvl_replay.report.plots.panel import Curve, Figure, Panel, filter_style

_ARM: Final = {
    "compensated": "With the lever arm compensated",
    "ignored": "With the lever arm ignored",
    "none": "Without a lever arm",
}
_HEADERS: Final = {"compensated": "arm comp.", "ignored": "arm ignored", "none": "no arm"}

_TITLES: Final = {"compensated": "lever arm compensated", "ignored": "lever arm ignored", "none": "no lever arm"}
_STYLES: Final = {"middle": filter_style(1), "end": filter_style(0)}
_ALONE: Final = "zero"


def window_sentences(best: pd.DataFrame, differentiated_over_s: Sequence[float]) -> tuple[str, ...]:
    """State which window is best, at its middle and at its end, and how fine the reference is that says so."""
    first_log = best[best["log"] == best["log"].iloc[0]]
    optima = [_optimum(rows.set_index("at")) for _, rows in first_log.groupby("lever_arm", sort=False)]
    shortest_s, longest_s = min(differentiated_over_s), max(differentiated_over_s)
    over = f"{shortest_s:.3g} s" if longest_s - shortest_s < 0.01 else f"{shortest_s:.3g} to {longest_s:.3g} s"
    return (
        *optima,
        f"The reference's acceleration is a difference of velocities over {over}; what is faster it misses.",
    )


def _optimum(rows: Any) -> str:
    middle, end = rows.loc["middle"], rows.loc["end"]
    return (
        f"{_ARM[middle['lever_arm']]}, the acceleration is nearest the reference's from {middle['n']} velocities at "
        f"the middle of their window, {number(middle['rmse_mps2'])} m/s^2 rms, and from {end['n']} at its end, "
        f"{number(end['rmse_mps2'])} m/s^2 rms."
    )


def window_display(windows: pd.DataFrame, best: pd.DataFrame) -> tuple[DisplayTable, ...]:
    """Turn the tables of a study into tables for people: errors by number of velocities, and the optima of each log."""
    return (_by_size(windows[windows["log"] == windows["log"].iloc[0]]), _optima(best))


def _by_size(rows: pd.DataFrame) -> DisplayTable:
    kinds = list(rows[["lever_arm", "at"]].drop_duplicates().itertuples(index=False, name=None))
    rmse = rows.set_index(["n", "lever_arm", "at"])["rmse_mps2"]
    return DisplayTable(
        f"Acceleration from n velocities against the reference's, rms [m/s^2], {rows['samples'].iloc[0]} pings",
        ("n", *(f"{at},\n{_HEADERS[arm]}" for arm, at in kinds)),
        "r" * (1 + len(kinds)),
        tuple((str(n), *(number(float(rmse[n, arm, at])) for arm, at in kinds)) for n in rows["n"].unique()),
    )


def _optima(best: pd.DataFrame) -> DisplayTable:
    return DisplayTable(
        "The number of velocities with the least error",
        ("log", "at", "lever arm", "n", "rms [m/s^2]", "pings"),
        "lllrrr",
        tuple(
            (row["log"], row["at"], row["lever_arm"], str(row["n"]), number(row["rmse_mps2"]), str(row["samples"]))
            for row in best.to_dict("records")
        ),
        "log *: all logs together" if best["log"].iloc[0] == "*" else "",
    )


def window_figure(windows: pd.DataFrame) -> Figure:
    """Draw the error at the middle and at the end of windows, one panel for each treatment of the lever arm."""
    y_limits = limits(windows["rmse_mps2"].to_numpy(), "log")
    panels = tuple(
        Panel(
            f"rms error [m/s²], {_TITLES[str(arm)]}",
            "number of velocities n",
            tuple(_curves(rows, windows["log"].iloc[0])),
            y_scale="log",
            y_limits=y_limits,
            x_whole=True,
        )
        for arm, rows in windows.groupby("lever_arm", sort=False)
    )
    legend = [(style, f"{at} of the window") for at, style in _STYLES.items()]
    if windows["log"].nunique() > 1:
        legend.append((_ALONE, "each log alone"))
    caption = "Dots: the number of velocities with the least error."
    return Figure("Acceleration errors by the number of velocities", caption, panels, tuple(legend))


def _curves(windows: pd.DataFrame, first: str) -> Iterator[Curve]:
    """Draw the first log last, which lies on top."""
    for (log, at), rows in reversed(list(windows.groupby(["log", "at"], sort=False))):
        style, n, rmse = _STYLES[str(at)], rows["n"].to_numpy(np.float64), rows["rmse_mps2"].to_numpy()
        yield Curve(n, rmse, style if log == first else f"{style} {_ALONE}")
        if log == first:
            least = int(rmse.argmin())
            yield Curve(n[[least]], rmse[[least]], style, points=True)
