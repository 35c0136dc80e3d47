"""The plots of a dive, on its page and for a paper: each is made of the same `Figure` and `Panel`.

A plot is one function that returns a `Figure`. `all_plots` names those of a page, which are drawn from a replay in
full, and those of ``insdvl-replay figure``, which are drawn from a stored result: once a second, with its tables. A
plot that both have is made in one module from the same parts. A new plot is a function in one of the modules below,
and a line in `all_plots.on_page`, in `all_plots.FOR_PAPER`, or in both; for a paper its name is also in `PaperPlot`.

    curves      what the plots have in common: the curves of filters, the legend, the stored dive
    errors      errors against the reference, predicted standard deviations, innovations
    evidence    the position error, the drift without DVL, convergence
    motion      the track, the motion, the accelerations
    shades      what is behind the panels over time
    coverage    a strip for each sensor, which only a page has

``document/plot.py`` draws panels as SVG of a page, ``document/paper.py`` draws the same panels with matplotlib.
"""

from typing import Literal

PaperPlot = Literal["error", "track", "sigma", "nis", "outage", "convergence"]
"""What `insdvl-replay figure` draws."""
