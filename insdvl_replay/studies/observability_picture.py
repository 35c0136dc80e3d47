"""The picture of an observability study: how far the singular values fall, and where they drop to nothing."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from insdvl_replay.report.pictures import own_style

_MARKERS: Final = "os^Dv"
_SMALLEST: Final = 1e-12
"""Singular values are drawn down to this share of the largest; below is rounding."""


def draw_singular_values(title: str, values: pd.DataFrame, tolerance: float) -> Figure:
    """Draw the singular values of each aiding as shares of its largest, and the tolerance.

    Parameters
    ----------
    title : str
    values : DataFrame
        Columns aiding, number, singular_value.
    tolerance : float
        Share of the largest up to which a singular value is called zero.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with own_style():
        figure = Figure(figsize=(7.0, 4.5), layout="constrained")
        panel = figure.subplots()
        for (aiding, rows), marker in zip(values.groupby("aiding", sort=False), _MARKERS, strict=True):
            largest = rows["singular_value"].max() or 1.0
            share = np.maximum(rows["singular_value"] / largest, _SMALLEST)
            panel.plot(rows["number"], share, marker=marker, fillstyle="none", linewidth=1.0, label=str(aiding))
        panel.axhline(tolerance, color="black", linestyle="--", linewidth=1.0, label="tolerance")
        panel.set_yscale("log")
        panel.set_xticks(range(1, 13))
        panel.set_xlabel("number of the singular value")
        panel.set_ylabel("share of the largest")
        panel.set_title(title, fontsize="medium")
        panel.legend(fontsize="small")
    return figure
