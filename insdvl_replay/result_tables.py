"""The tables of a result, once: which column names a row, and what counts as better in each of the others.

Whoever lists, compares or judges tables takes their names from here.
"""

from dataclasses import dataclass
from typing import Final, Literal

Better = Literal["lower", "higher", "nearer zero", "nearer dof"]
"""What is better: ``nearer zero`` for signed errors and correlations, ``nearer dof`` for a mean NIS or NEES."""


@dataclass(frozen=True)
class TableLayout:
    """What there is to know about one table without its rows.

    Attributes
    ----------
    name : str
        As in ``report.json`` and in the name of the CSV file.
    key : str
        The column that, with log and filter, names a row.
    better : dict of str to str
        By column of numbers, what counts as better. Counts and limits that are neither better nor worse are left out.
    """

    name: str
    key: str
    better: dict[str, Better]


TABLES: Final[tuple[TableLayout, ...]] = (
    TableLayout("improvement", "state", {"baseline_sd": "lower", "sd": "lower", "improvement_pct": "higher"}),
    TableLayout(
        "convergence",
        "state",
        {"target_sd": "lower", "baseline_s": "lower", "reached_s": "lower", "improvement_pct": "higher"},
    ),
    TableLayout(
        "reference_error",
        "quantity",
        {
            "baseline_rmse": "lower",
            "rmse": "lower",
            "improvement_pct": "higher",
            "baseline_final": "nearer zero",
            "final": "nearer zero",
        },
    ),
    TableLayout(
        "consistency",
        "measurement",
        {"rejected": "lower", "mean_nis": "nearer dof", "autocorrelation": "nearer zero"},
    ),
    TableLayout("credibility", "quantity", {"mean_nees": "nearer dof"}),
)

AXES: Final = ("x", "y", "z")
"""Axes of a measurement in b."""


def axis_of(measurement: str, axis: str) -> str:
    """Name the row that a measurement has for one of its axes."""
    return f"{measurement}_{axis}"


def is_whole(measurement: str) -> bool:
    """Tell a whole measurement, which stands for a filter's verdict, from one of its axes, which say where."""
    return not measurement.endswith(tuple(axis_of("", axis) for axis in AXES))
