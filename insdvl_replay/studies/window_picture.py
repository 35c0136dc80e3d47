"""The picture of a window study: error of the acceleration over the number of velocities it is made of."""

from typing import Final

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from insdvl_replay.report.pictures import own_style

_TITLES: Final = {
    "compensated": "lever arm compensated",
    "ignored": "lever arm ignored",
    "none": "no lever arm",
}
_LINES: Final = {"middle": ("tab:blue", "-", "o"), "end": ("tab:red", "--", "s")}


def draw_windows(windows: pd.DataFrame) -> Figure:
    """Draw the error at the middle and at the end of windows, one panel for each treatment of the lever arm.

    Parameters
    ----------
    windows : DataFrame
        Columns log, n, at, lever_arm, rmse_mps2, samples. The first log is drawn bold, the others thin.

    Returns
    -------
    matplotlib.figure.Figure
    """
    arms = windows["lever_arm"].unique()
    with own_style():
        figure = Figure(figsize=(5.0 * len(arms), 4.0), layout="constrained")
        panels = figure.subplots(1, len(arms), sharey=True, squeeze=False)[0]
        for panel, arm in zip(panels, arms, strict=True):
            _draw_arm(panel, windows[windows["lever_arm"] == arm])
            panel.set_title(_TITLES[arm])
        panels[0].set_ylabel("acceleration error, rms [m/s²]")
        if windows["log"].nunique() > 1:
            panels[0].plot([], [], color="grey", linewidth=0.6, label="each log alone")
        labels = panels[0].get_legend_handles_labels()
        figure.legend(*labels, loc="outside lower center", ncols=1 + len(arms), frameon=False)
    return figure


def _draw_arm(panel: Axes, windows: pd.DataFrame) -> None:
    first = windows["log"].iloc[0]
    for (log, at), rows in windows.groupby(["log", "at"], sort=False):
        colour, line, marker = _LINES[str(at)]
        if log == first:
            label = f"at the {at} of the window"
            panel.plot(rows["n"], rows["rmse_mps2"], line, color=colour, marker=marker, linewidth=2.0, label=label)
            least = rows.iloc[int(rows["rmse_mps2"].argmin())]
            panel.plot(least["n"], least["rmse_mps2"], marker, color=colour, markersize=11, fillstyle="none")
        else:
            panel.plot(rows["n"], rows["rmse_mps2"], line, color=colour, linewidth=0.6, alpha=0.5)
    panel.set_yscale("log")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_xlabel("number of velocities n")
