"""Pictures as SVG and PNG: drawn without a screen, and to the same bytes from the same input."""

import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Final

import pandas as pd
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.states import State
from insdvl_replay.report.document import Html
from insdvl_replay.report.page import escape

# Nobody's own style, text as text, identifiers from the salt, and no date or version of the drawing program.
_OWN_STYLE: Final[dict[str, Any]] = {
    "svg.hashsalt": "insdvl-replay",
    "svg.fonttype": "none",
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
}
_STYLE: Final[list[Any]] = ["default", _OWN_STYLE]
_METADATA: Final[dict[str, dict[str, Any]]] = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}
PIXELS_PER_INCH: Final = 150
SETTLED: Final = 0.02
"""Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high."""

FAR_ABOVE: Final = 10.0
"""A NEES this many times above the interval is drawn on a logarithmic scale, which shows the others, too."""


_THEME: Final = {
    "#ffffff": "var(--paper)", "#000000": "var(--ink)", "#808080": "var(--soft)",
    "#b0b0b0": "var(--soft)", "#cccccc": "var(--rule)",
    "#1f77b4": "var(--blue)", "#d62728": "var(--red)", "#2ca02c": "var(--green)",
    "#ff7f0e": "var(--ochre)", "#9467bd": "var(--purple)",
}  # fmt: skip
"""The drawing program's colours, and which of the page's they become."""


def own_style() -> AbstractContextManager[None]:
    """Draw in the program's own style while the context lasts, whatever style its user has set."""
    return style.context(_STYLE)


def picture_bytes(figure: Figure, format_: str) -> bytes:
    """Write a figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    format_ : str
        ``svg`` or ``png``.

    Returns
    -------
    bytes
        Without a date, so that the same figure gives the same bytes.
    """
    stream = io.BytesIO()
    with own_style():
        figure.savefig(stream, format=format_, dpi=PIXELS_PER_INCH, metadata=_METADATA[format_])
    return stream.getvalue()


def draw_nees(title: str, nees: pd.DataFrame) -> Figure:
    """Draw the mean NEES of each filter over time, with the interval of consistent ones.

    Parameters
    ----------
    title : str
    nees : DataFrame
        From `ensemble_tables.nees_table`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with own_style():
        figure = Figure(figsize=(10.0, 3.2), layout="constrained")
        panel = figure.subplots()
        panel.axhspan(
            nees["low"][0], nees["high"][0], color="tab:green", alpha=0.25, label="95 % of consistent filters"
        )
        for name, rows in nees.groupby("filter", sort=False):
            panel.plot(rows["time_s"], rows["mean_nees"], linewidth=1.2, label=name)
        scale = "log" if nees["mean_nees"].max() > FAR_ABOVE * nees["high"][0] else "linear"
        panel.set(xlabel="time [s]", ylabel="mean NEES", yscale=scale)
        panel.margins(x=0.0)
        panel.legend(frameon=False)
        figure.suptitle(title)
    return figure


def draw_ensemble(
    title: str, states: Sequence[State], time_s: Floats, sd: Floats, error_sd: Floats, error_mean: Floats
) -> Figure:
    """Draw sigma from P, ensemble sigma and ensemble mean over time, one panel for each state.

    The colours are those of Levy and Klein; the lines differ also in width and dashes.

    Parameters
    ----------
    title : str
    states : sequence of State
        What to draw, three in a row.
    time_s : ndarray, shape (k,)
    sd, error_sd, error_mean : ndarray, shape (k, 12)
        SI units.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with own_style():
        figure = Figure(figsize=(10.0, 2.6 * len(states) / 3 + 0.6), layout="constrained")
        panels = figure.subplots(len(states) // 3, 3, sharex=True, squeeze=False)
        for panel, state in zip(panels.flat, states, strict=True):
            columns = (column[:, state.index] / state.factor for column in (sd, error_sd, error_mean))
            _draw_state(panel, state, time_s, *columns)
        for panel in panels[-1]:
            panel.set_xlabel("time [s]")
        figure.suptitle(title)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _draw_state(panel: Axes, state: State, time_s: Floats, sd: Floats, error_sd: Floats, error_mean: Floats) -> None:
    panel.plot(time_s, error_sd, color="black", linewidth=1.0, label="ensemble sigma")
    panel.plot(time_s, error_mean, color="tab:green", linewidth=1.2, linestyle=":", label="ensemble mean")
    panel.plot(time_s, sd, color="tab:blue", linewidth=2.2, linestyle="--", label="sigma from P")
    panel.set_title(f"{state.label} [{state.unit}]", fontsize="medium")
    panel.margins(x=0.0)
    settled = time_s >= SETTLED * time_s[-1]
    lowest, highest = min(0.0, error_mean[settled].min()), max(sd[settled].max(), error_sd[settled].max())
    panel.set_ylim(1.1 * lowest - 0.1 * highest, 1.1 * highest)


def picture(name: str, svg: bytes) -> Html:
    """Put a picture into the page, in the page's colours, no wider than it was drawn and never too small to be read.

    Parameters
    ----------
    name : str
        Of the picture among those of the page.
    svg : bytes
        From `pictures.picture_bytes`.

    Returns
    -------
    Html
    """
    text = svg.decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    as_drawn = rf'\1 style="max-width: \2; min-width: calc(.7 * \2)" role="img" aria-label="{escape(name)}"'
    text = re.sub(r'(<svg [^>]*?) width="([^"]*)" height="[^"]*"', as_drawn, text)
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{re.sub('[^a-z]', '-', name)}-", text)
    for colour, variable in _THEME.items():
        text = text.replace(colour, variable)
    return Html(f'<figure class="picture">{text}</figure>')
