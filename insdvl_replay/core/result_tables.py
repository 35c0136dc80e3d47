"""The tables of a result, once: which column names a row, and what counts as better in each of the others.

Whoever lists, compares or judges tables takes their names from here.
"""

from dataclasses import dataclass, field
from typing import Final, Literal

from insdvl_replay.core.states import BA, STATES

Better = Literal["lower", "higher", "nearer zero", "nearer dof"]
"""What is better: ``nearer zero`` for signed errors and correlations, ``nearer dof`` for a mean NIS or NEES."""
PERCENTAGE: Final = "_pct"
"""End of the name of a column whose numbers are percentages, and change by percentage points."""
VERDICTS_BEST_FIRST: Final = ("consistent", "over-cautious", "over-confident", "not finite")
"""On a filter's consistency; ``too few`` says nothing of it and has no rank."""

REFERENCE_QUANTITIES: Final = {
    "velocity_n": "m/s",
    "velocity_e": "m/s",
    "velocity_d": "m/s",
    "roll": "deg",
    "pitch": "deg",
    "heading": "deg",
    "position_h": "m",
    "depth": "m",
    "position_h_pct": "%",
}
"""Rows of reference errors and their units; ``position_h_pct`` is of the distance travelled."""
CREDIBILITY_QUANTITIES: Final = (
    "velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", *(state.id for state in STATES[BA.start :]),
)  # fmt: skip
"""Rows of credibility in the order of the error state; the attitude about the vehicle's level axes."""
JOINT: Final = "all"
"""The row of all compared states together."""
AXES: Final = ("x", "y", "z")
"""Axes of a measurement in b."""


def axis_of(measurement: str, axis: str) -> str:
    """Name the row that a measurement has for one of its axes."""
    return f"{measurement}_{axis}"


MEASUREMENTS: Final = ("velocity", "acceleration")
"""What filters are aided by."""
_STATES: Final = tuple(state.id for state in STATES)


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
    chief : str
        The column that a reader looks at first.
    words : dict of str to tuple of str
        By column of words, the words that have a rank, best first.
    rows : tuple of str
        What the key may name; empty where it names filters, whose names are the user's.
    baseline_too : bool
        The baseline has rows of its own; else it stands beside each candidate.
    """

    name: str
    key: str
    better: dict[str, Better]
    chief: str
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)
    rows: tuple[str, ...] = ()
    baseline_too: bool = False

    def unit_of(self, column: str, row_unit: str) -> str:
        """Give the unit of a column's numbers; empty for those without, and for words.

        Parameters
        ----------
        column : str
        row_unit : str
            What the row's ``unit`` says, which holds for its physical quantities alone.

        Returns
        -------
        str
        """
        if column.endswith(PERCENTAGE):
            return "%"
        if column.endswith("_s"):
            return "s"
        return row_unit if column in self.better else ""


TABLES: Final[tuple[TableLayout, ...]] = (
    TableLayout(
        "improvement",
        "state",
        {"baseline_sd": "lower", "sd": "lower", "improvement_pct": "higher"},
        "sd",
        rows=_STATES,
    ),
    TableLayout(
        "convergence",
        "state",
        {"target_sd": "lower", "baseline_s": "lower", "reached_s": "lower", "improvement_pct": "higher"},
        "reached_s",
        rows=_STATES,
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
        "rmse",
        rows=tuple(REFERENCE_QUANTITIES),
    ),
    TableLayout(
        "consistency",
        "measurement",
        {"rejected": "lower", "mean_nis": "nearer dof", "autocorrelation": "nearer zero"},
        "mean_nis",
        {"verdict": VERDICTS_BEST_FIRST, "whiteness": ("white", "correlated")},
        tuple(row for name in MEASUREMENTS for row in (name, *(axis_of(name, axis) for axis in AXES))),
        baseline_too=True,
    ),
    TableLayout(
        "credibility",
        "quantity",
        {"mean_nees": "nearer dof"},
        "mean_nees",
        {"verdict": VERDICTS_BEST_FIRST},
        (*CREDIBILITY_QUANTITIES, JOINT),
        baseline_too=True,
    ),
)

PARTLY_COVERED: Final = "partly covered"
"""The status of an error against a reference that knows the quantity in a part of the replay alone."""
NOT_JUDGED: Final = "not judged"
"""The word on a candidate where it, or the baseline, is dead: its numbers say nothing of gain or loss."""
CANDIDATES: Final = TableLayout(
    "filters",
    "filter",
    {
        "mean_improvement_pct": "higher",
        "mean_convergence_improvement_pct": "higher",
        "reference_improvement_pct": "higher",
    },
    "reference_improvement_pct",
    {
        "improvement": ("borne out", "none believed", "not borne out", "worse", NOT_JUDGED),
        "consistency": VERDICTS_BEST_FIRST,
    },
)
"""The block ``filters`` of a report, read as a table with one row for each candidate."""
LAYOUTS: Final = (CANDIDATES, *TABLES)
"""All that results are compared by, in the order of what a reader asks first."""


def is_whole(measurement: str) -> bool:
    """Tell a whole measurement, which stands for a filter's verdict, from one of its axes, which say where."""
    return not measurement.endswith(tuple(axis_of("", axis) for axis in AXES))
