"""The tables of a result: the only place where a table is described.

A row type says what its columns hold, which is better, and under which heading people see them. Files, messages,
schemas, gates, comparisons and shown tables are derived from it. Numbers that are missing are NaN as they are computed,
and None in a row.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, ClassVar, Final, Literal, get_args, get_origin, get_type_hints

from msgspec import Meta, Struct

from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CREDIBILITY_QUANTITIES,
    DRIFT_QUANTITIES,
    EVIDENCE_QUANTITIES,
    JOINT,
    MEASUREMENTS,
    OUTAGE_WINDOWS_S,
    POSITION_QUANTITIES,
    REFERENCE_QUANTITIES,
    TRACK_FIT_QUANTITIES,
    VERDICTS_BEST_FIRST,
    axis_of,
)
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import EvidenceVerdict, Prediction, Verdict, Whiteness

Number = float | None
# What is better: ``nearer zero`` for signed errors and correlations, ``nearer dof`` for a mean NIS or NEES.
Better = Literal["lower", "higher", "nearer zero", "nearer dof"]
Kind = Literal["text", "count", "number"]
# End of the name of a column whose numbers are percentages, and change by percentage points.
PERCENTAGE: Final = "_pct"
UNITS: Final = {PERCENTAGE: "%", "_s": "s", "_mps": "m/s", "_m": "m"}  # Units by the end of a column's name.
RATIO: Final = "ratio"  # So begin columns without a unit.


def finite(number: Number) -> float:
    """Return a number of a row, NaN where it is missing or not finite."""
    return math.nan if number is None or not math.isfinite(number) else number


@dataclass(frozen=True)
class Col:
    """One column of a row type, as an annotation of its field."""

    comment: str = ""  # what it holds, and those after it until the next one with a comment
    better: Better | None = None  # None for words, counts and limits that are neither better nor worse
    primary: bool = False  # a reader looks at it first
    names: tuple[str, ...] | None = None  # what it names, if it names the row; empty where that is the user's choice
    best_first: tuple[str, ...] = ()  # the words that have a rank
    head: str = ""  # people see the column under it; ``{filter}`` and ``{baseline}`` are names. Empty: they do not
    form: str = ""  # how it is written, a key of `show.document.FORMS`


class TableLayout:
    """A table without its rows, as its row type describes it."""

    def __init__(self, name: str, row: type[Struct]) -> None:
        hints = get_type_hints(row, include_extras=True)
        self.name = name  # as in ``report.json`` and in the name of the CSV file
        self.row = row
        self.columns: dict[str, Col] = {}
        self.kinds: dict[str, Kind] = {}
        for column in row.__struct_fields__:
            kind, *parts = get_args(hints[column]) if get_origin(hints[column]) is Annotated else (hints[column],)
            self.columns[column] = next((part for part in parts if isinstance(part, Col)), Col())
            self.kinds[column] = "text" if kind is str else "count" if kind is int else "number"
        # The column that, with log and filter, names a row, and what it may name; empty for names of the user.
        self.key = next((column for column, found in self.columns.items() if found.names is not None), "filter")
        self.rows = self.columns[self.key].names or () if self.key in self.columns else ()
        self.better = {column: found.better for column, found in self.columns.items() if found.better}
        self.primary = next((column for column, found in self.columns.items() if found.primary), "")
        self.words = {column: found.best_first for column, found in self.columns.items() if found.best_first}
        self.about: str = getattr(row, "about", row.__doc__ or "")  # what a row says
        self.baseline_too: bool = getattr(row, "baseline_too", False)  # else it is next to each candidate
        self.title: str = getattr(row, "title", "")
        self.footnote: str = getattr(row, "footnote", "")

    def unit_of(self, column: str, row_unit: str) -> str:
        """Return a column's unit: by the end of its name, none of a ratio, else the row's of what can be better."""
        if unit := next((unit for ending, unit in UNITS.items() if column.endswith(ending)), ""):
            return unit
        return row_unit if column in self.better and not column.startswith(RATIO) else ""


@cache
def layout_of(name: str, row: type[Struct]) -> TableLayout:
    """Return the layout of a table by its row type."""
    return TableLayout(name, row)


_WHY: Final = Col("Why the verdict is not what the interval says, if it is not.")
_STATE: Final = Col(names=tuple(state.id for state in STATES), head="state", form="label")
_MEASUREMENTS: Final = tuple(
    row for name, axes in MEASUREMENTS.items() for row in (name, *(axis_of(name, axis) for axis in axes))
)
_CREDIBILITY: Final = (*CREDIBILITY_QUANTITIES, *POSITION_QUANTITIES, *ALL_CREDIBILITY_GROUPS, JOINT)


def _quantity(names: Sequence[str]) -> Col:
    return Col(names=tuple(names), head="quantity", form="label")


def _unit(comment: str) -> Col:
    return Col(comment, head="unit")


class ImprovementRow(Struct, frozen=True):
    """What a candidate believes of one state at the end of the dive, beside the baseline."""

    about: ClassVar = (
        "One state at the end of a dive: how much smaller the candidate's believed standard deviation is than the"
        " baseline's."
    )

    title: ClassVar = "Improvement: standard deviations at the end, {filter} against {baseline}"

    log: Annotated[str, Col("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the standard deviations.")]
    baseline_sd: Annotated[Number, Col(head="{baseline}", better="lower")]
    sd: Annotated[Number, Col(head="{filter}", better="lower", primary=True)]
    improvement_pct: Annotated[
        Number,
        Col(
            "(baseline - candidate) / baseline; NaN where there is none.",
            head="improvement",
            form="percent",
            better="higher",
        ),
    ]
    status: Annotated[str, Col("improved, same, worse or not finite.", head="status")]


class ConvergenceRow(Struct, frozen=True):
    """One state: how much sooner the candidate reaches for good the standard deviation that the baseline ends with."""

    title: ClassVar = "Convergence: when {filter} is as sure as {baseline} is at the end"

    log: Annotated[str, Col("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the standard deviation to reach.")]
    target_sd: Annotated[Number, Col(head="target", better="lower")]
    baseline_s: Annotated[
        Number,
        Col("Times from the start at which the baseline and the candidate have it; NaN for never.", better="lower"),
    ]
    reached_s: Annotated[Number, Col(head="{filter}\n[s]", better="lower", primary=True)]
    improvement_pct: Annotated[Number, Col(head="sooner", form="percent", better="higher")]
    status: Annotated[str, Col("reached, at_start or never.", head="status", form="words")]
    measured_target: Annotated[
        Number, Col("Rms of the baseline's true errors at the end, over starts that are drawn from P0.", better="lower")
    ] = None
    measured_baseline_s: Annotated[
        Number,
        Col(
            "Times from which on the errors of the baseline and of the candidate stay there; NaN for never.",
            better="lower",
        ),
    ] = None
    measured_s: Annotated[Number, Col(better="lower")] = None
    measured_status: Annotated[str, Col("reached, at_start, never or not measured.")] = ""
    unchanged_s: Annotated[
        Number, Col("Time at which the baseline itself came to stay there, and a candidate does that changes nothing.")
    ] = None
    nearest_approach_s: Annotated[
        Number,
        Col(
            "When the candidate's standard deviation is nearest to the target: Levy and Klein's time.",
            head="nearest\n[s]",
            better="lower",
        ),
    ] = None
    nearest_approach_improvement_pct: Annotated[Number, Col(head="sooner", form="percent", better="higher")] = None


class ReferenceErrorRow(Struct, frozen=True):
    """One quantity: errors of the baseline and of the candidate against the reference solution."""

    title: ClassVar = "Reference error: distance from the reference, {filter} against {baseline}"

    log: Annotated[str, Col("Dive, candidate and quantity.")]
    filter: str
    quantity: Annotated[str, _quantity(tuple(REFERENCE_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    baseline_rmse: Annotated[Number, Col("Root mean square over the dive.", head="{baseline}\nrms", better="lower")]
    rmse: Annotated[Number, Col(head="{filter}\nrms", better="lower", primary=True)]
    improvement_pct: Annotated[Number, Col(head="better", form="percent", better="higher")]
    baseline_final: Annotated[
        Number, Col("At the last reference time, with its sign.", head="{baseline}\nfinal", better="nearer zero")
    ]
    final: Annotated[Number, Col(head="{filter}\nfinal", better="nearer zero")]
    samples: Annotated[int, Col("Reference times that were compared.")]
    status: Annotated[str, Col("compared, partly covered, no reference, not in reference, no distance or lost in gap.")]


class ConsistencyRow(Struct, frozen=True):
    """Whether a filter's innovations are as large as it says."""

    about: ClassVar = (
        "One kind of measurement or one of its axes: do the innovations of a filter have the size that the filter"
        " expects?"
    )

    baseline_too: ClassVar = True
    title: ClassVar = "Consistency: mean NIS and where 95 % of consistent filters would have it"

    log: Annotated[str, Col("Dive, filter, and measurement such as velocity, or an axis of it such as velocity_x.")]
    filter: Annotated[str, Col(head="filter")]
    measurement: Annotated[str, Col(head="measurement", form="words", names=_MEASUREMENTS)]
    dof: Annotated[int, Col("Degrees of freedom of one innovation.")]
    used: Annotated[int, Col(head="used")]
    rejected: Annotated[int, Col(head="rejected", better="lower")]
    mean_nis: Annotated[
        Number,
        Col(
            "Mean normalised innovation squared, and the interval in which 95 % of consistent filters have it.",
            head="NIS",
            better="nearer dof",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low")]
    high: Annotated[Number, Col(head="high")]
    verdict: Annotated[
        str,
        Col(
            "consistent, overconfident, conservative, insufficient data, not finite; not available for a filter "
            "without the states that a held-out sensor needs.",
            head="verdict",
            best_first=VERDICTS_BEST_FIRST,
        ),
    ]
    autocorrelation: Annotated[
        Number,
        Col(
            "Correlation of each innovation with the one before, and what 95 % of white innovations stay below.",
            better="nearer zero",
        ),
    ] = None
    autocorrelation_limit: Number = None
    whiteness: Annotated[
        str,
        Col("white, correlated, insufficient data or not finite.", best_first=(Whiteness.WHITE, Whiteness.CORRELATED)),
    ] = ""
    why: Annotated[str, _WHY] = ""


class CredibilityRow(Struct, frozen=True):
    """Whether a filter's errors against the reference, or the truth, are as large as it says."""

    about: ClassVar = (
        "One quantity: are the errors of a filter against the reference, or the truth, as large as the filter expects?"
    )

    baseline_too: ClassVar = True
    title: ClassVar = "Credibility: errors of {filter} in its own standard deviations"

    log: Annotated[str, Col("Dive, filter, and a quantity or group of them; all is every compared state together.")]
    filter: str
    quantity: Annotated[str, Col(head="quantity", form="short", names=_CREDIBILITY)]
    dof: Annotated[int, Col("Degrees of freedom of one error, and the times that were compared.")]
    samples: int
    mean_nees: Annotated[
        Number,
        Col(
            "Mean normalised error squared, and the interval in which 95 % of consistent filters have it.",
            head="NEES",
            better="nearer dof",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low", form="2")]
    high: Annotated[Number, Col(head="high", form="2")]
    within_1sd_pct: Annotated[
        Number,
        Col(
            "Share of the errors within one and three standard deviations; 68.3 % and 99.7 % are expected.",
            head="in\n1 sd",
            form="1",
        ),
    ]
    within_3sd_pct: Annotated[Number, Col(head="in\n3 sd", form="1")]
    verdict: Annotated[
        str,
        Col(
            "consistent, overconfident, conservative, insufficient data, not finite, not in reference or no reference.",
            head="verdict",
            best_first=VERDICTS_BEST_FIRST,
        ),
    ]
    effective_samples: Annotated[
        Number, Col("How many independent samples the compared times are worth.", head="indep.", form="0")
    ]
    why: Annotated[str, _WHY] = ""


class EvidenceRow(Struct, frozen=True):
    """One piece of evidence on a candidate beside the baseline: what was measured, and what it says."""

    title: ClassVar = "Evidence: what was measured, {filter} against {baseline}"

    log: Annotated[str, Col("Dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: Annotated[str, Col("accuracy, outage, held_out, track, convergence or consistency.")]
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, _unit("Unit of the two values.")]
    baseline: Annotated[
        Number,
        Col(
            "What the baseline and the candidate have on this dive, from its own start: a root mean square, a final "
            "error, or the time of convergence from drawn starts.",
            head="{baseline}",
            better="lower",
        ),
    ]
    value: Annotated[Number, Col(head="{filter}", better="lower")]
    ratio: Annotated[
        Number,
        Col(
            "Candidate over baseline, of accuracy over all drawn starts, and its 95 % interval on this dive: other "
            "dives may differ by more.",
            head="ratio",
            form="ratio",
            better="lower",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    effective_samples: Annotated[
        Number, Col("How many independent values the ratio and its interval rest on.", head="n", form="0")
    ]
    starts: Annotated[int, Col("Starts that were replayed, and stretches of the dive or windows that were compared.")]
    windows: int
    verdict: Annotated[
        str,
        Col(
            "better, worse, equivalent or undecided; empty where the filter is not evaluated.",
            head="verdict",
            best_first=(
                EvidenceVerdict.BETTER,
                EvidenceVerdict.EQUIVALENT,
                EvidenceVerdict.UNDECIDED,
                EvidenceVerdict.WORSE,
            ),
        ),
    ]
    p: Annotated[
        Number,
        Col(
            "Of a true difference of at most 5 %, by Student's t or by drawn starts: below 0.01 the row decides.",
            head="p",
            form="4",
        ),
    ] = None
    why: Annotated[str, Col("What keeps the row from deciding, if it is not the interval.", head="why")] = ""


class OutageRow(Struct, frozen=True):
    """How far a filter drifts in some time without velocities, beside the baseline."""

    about: ClassVar = (
        "Windows of one length in which every velocity was withheld from a filter: how far it went astray by what"
        " the withheld velocities say. Where a wrong heading, scale or mounting about down takes the track is not"
        " seen."
    )

    baseline_too: ClassVar = True
    title: ClassVar = "DVL outage test: drift while the DVL is withheld"
    footnote: ClassVar = (
        "Where a wrong heading, scale or constant turn of the mounting takes the track is not seen: the DVL itself "
        "shares it."
    )

    log: Annotated[str, Col("Dive, filter and length of the windows.")]
    filter: Annotated[str, Col(head="filter")]
    window_s: Annotated[str, Col(head="for [s]", names=OUTAGE_WINDOWS_S)]
    windows: Annotated[
        int, Col("Windows that do not overlap, and those left out since DVL or IMU fell silent.", head="windows")
    ]
    left_out: int
    drift_median_m: Annotated[
        Number,
        Col(
            "Horizontal drift at the end of a window: median, root mean square and 95th percentile, which of fewer "
            "than 20 windows is nearly the largest.",
            head="median\n[m]",
            better="lower",
            primary=True,
        ),
    ]
    drift_rms_m: Annotated[Number, Col(better="lower")]
    drift_p95_m: Annotated[Number, Col(head="95 %\n[m]", better="lower")]
    drift_of_distance_pct: Annotated[
        Number,
        Col("Median over windows; NaN where the vehicle hardly moved.", head="of way\n[%]", form="2", better="lower"),
    ]
    end_velocity_mps: Annotated[Number, Col("Median horizontal velocity error at the end.", better="lower")]
    vertical_median_m: Annotated[Number, Col("Median vertical drift, either way.", head="down\n[m]", better="lower")]
    ratio_to_baseline: Annotated[
        Number,
        Col(
            "Ratio of the root mean squares over the same windows, with its 95 % interval; NaN for the baseline.",
            head="rms\nratio",
            form="2",
            better="lower",
        ),
    ]
    ratio_low: Number
    ratio_high: Number
    windows_won_pct: Annotated[
        Number,
        Col(
            "Windows in which it drifts less than the baseline; a draw counts half.",
            head="won\n[%]",
            form="0",
            better="higher",
        ),
    ]
    nis_per_dof: Annotated[
        Number,
        Col("Mean over windows, of the last withheld velocity; 1 is expected.", head="NIS\n/ dof", form="significant"),
    ]


class DriftRow(Struct, frozen=True):
    """One quantity: the errors of a filter against the reference half of the time, mostly, at worst."""

    baseline_too: ClassVar = True
    title: ClassVar = "Drift: how far each filter is from the reference"
    footnote: ClassVar = (
        "50 % and 95 % of the sizes stay below; of the position these are CEP50 and CEP95. Drift: what the horizontal "
        "position error changes by over a stretch."
    )

    log: Annotated[str, Col("Dive, filter and quantity: the position, its drift over stretches, or the velocity.")]
    filter: Annotated[str, Col(head="filter")]
    quantity: Annotated[str, _quantity(tuple(DRIFT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    samples: Annotated[int, Col("Times, or stretches, which overlap, that were compared.")]
    p50: Annotated[
        Number,
        Col(
            "What half and 95 % of the sizes stay below, of the position CEP50 and CEP95; and the root mean square.",
            head="50 %",
            better="lower",
            primary=True,
        ),
    ]
    p95: Annotated[Number, Col(head="95 %", better="lower")]
    rms: Annotated[Number, Col(head="rms", better="lower")]
    worst: Annotated[Number, Col("The largest size.", head="worst", better="lower")]
    worst_from_s: Annotated[
        Number,
        Col("Where it begins and ends, from the start; of the others than drift once.", head="from\n[s]", form="0"),
    ]
    worst_to_s: Annotated[Number, Col(head="to\n[s]", form="0")]
    final: Annotated[Number, Col("The last size.", better="lower")] = None
    distance_m: Annotated[Number, Col("Distance travelled to the last compared position.")] = None
    final_of_distance_pct: Annotated[
        Number, Col("Of the position: the final error in percent of that distance.", better="lower")
    ] = None


class JumpRow(Struct, frozen=True):
    """A filter whose position can jump: the steps of it that neither its velocity nor the steps around explain."""

    baseline_too: ClassVar = True
    title: ClassVar = "Jumps: steps of the position that its own velocity does not explain"
    footnote: ClassVar = (
        "What neither the velocity nor one of the three steps before and after explains of a horizontal step; a jump "
        "is more than 0.5 m and ten robust standard deviations of what usually is. Filters that go by their velocity "
        "alone have none."
    )

    log: Annotated[str, Col("Dive and filter: a solution that was read, or one that estimates its position.")]
    filter: Annotated[str, Col(head="filter")]
    steps: Annotated[int, Col("Steps from a horizontal position to the next that were looked at.", head="steps")]
    jumps: Annotated[
        int,
        Col(
            "Those of which more than 0.5 m, and ten robust standard deviations of what usually is, is unexplained.",
            head="jumps",
            better="lower",
            primary=True,
        ),
    ]
    largest_m: Annotated[Number, Col("The most of a step that is unexplained.", head="largest\n[m]", better="lower")]
    largest_at_s: Annotated[Number, Col("Where that step ends, from the start.", head="at\n[s]", form="1")]


class TrackFitRow(Struct, frozen=True):
    """The scale or the turn that would lay a filter's track on the reference's, with standard error."""

    baseline_too: ClassVar = True
    title: ClassVar = "Track fit: what would lay each track on the reference's"
    footnote: ClassVar = (
        "Scale: positive where the filter's track is too small. Turn: clockwise from above. Standard errors allow for "
        "noise, and not for a heading that drifts."
    )

    log: Annotated[str, Col("Dive, filter, and scale or turn.")]
    filter: Annotated[str, Col(head="filter")]
    quantity: Annotated[str, _quantity(tuple(TRACK_FIT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the two numbers.")]
    fitted: Annotated[
        Number,
        Col(
            "Scale: positive where its track is too small. Turn: clockwise.",
            head="fitted",
            form="3",
            better="nearer zero",
            primary=True,
        ),
    ]
    fitted_sd: Annotated[
        Number, Col("Standard error by noise, without a heading that drifts; NaN of a short dive.", head="sd", form="3")
    ]


class PooledRow(Struct, frozen=True):
    """One piece of evidence on a candidate beside the baseline, over several dives."""

    title: ClassVar = "All dives together: {filter} against {baseline}"
    footnote: ClassVar = (
        "geometric mean of the dives' ratios, its 95 % interval over dives, and p, both by Student's t, each dive one "
        "sample; three dives are the fewest that decide"
    )

    log: Annotated[str, Col("Every dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: str
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, Col("Unit of the two values, which are medians over the dives.")]
    baseline: Number
    value: Number
    ratio: Annotated[
        Number,
        Col(
            "Geometric mean of the dives' ratios, and its 95 % interval over dives (Student's).",
            head="ratio",
            form="ratio",
            better="lower",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    dives: Annotated[
        int, Col("Dives that have a ratio, and those of them in which the candidate errs less.", head="dives")
    ]
    dives_won: Annotated[int, Col(head="won")]
    p: Annotated[
        Number,
        Col("Of a true difference of at most 5 %, by Student's t: below 0.01 the row decides.", head="p", form="4"),
    ]
    verdict: Annotated[str, Col(head="verdict")]


class Tables(Struct, frozen=True):
    """The tables, row for row as in the CSV files; null for what is missing. Early reports lack the last six."""

    improvement: list[ImprovementRow]
    convergence: list[ConvergenceRow]
    reference_error: list[ReferenceErrorRow]
    consistency: list[ConsistencyRow]
    credibility: list[CredibilityRow] = []
    evidence: list[EvidenceRow] = []
    outage: list[OutageRow] = []
    drift: list[DriftRow] = []
    track_fit: list[TrackFitRow] = []
    jumps: list[JumpRow] = []


class CandidateVerdict(Struct, frozen=True):
    """What there is to say of one candidate."""

    sentence: Annotated[str, Meta(description="one paragraph for people: measured, predicted, consistent")]
    verdict: Annotated[
        str,
        Meta(description="better, worse, mixed, equivalent, undecided or not evaluated, by all evidence"),
        Col(best_first=tuple(Verdict)),
    ]
    consistency: Annotated[
        str, Meta(description="the gravest verdict of its measurements"), Col(best_first=VERDICTS_BEST_FIRST)
    ]
    mean_improvement_pct: Annotated[
        Number, Meta(description="believed; nine states, without the velocity errors"), Col(better="higher")
    ]
    mean_convergence_improvement_pct: Annotated[
        Number, Meta(description="the same nine; never and at start count 0"), Col(better="higher")
    ]
    reference_improvement_pct: Annotated[
        Number, Meta(description="actual; median over the compared quantities"), Col(better="higher", primary=True)
    ]
    credibility: Annotated[
        str, Meta(description="the gravest verdict of its errors against the reference, among the groups of states")
    ] = ""
    prediction: Annotated[
        str,
        Meta(description="whether what was measured bears out what it believes: confirmed, not confirmed, undecided"),
        Col(best_first=tuple(Prediction)),
    ] = ""
    mean_convergence_unchanged_pct: Annotated[
        Number, Meta(description="the mean convergence improvement that a candidate has which changes nothing")
    ] = None
    mean_nearest_approach_improvement_pct: Annotated[
        Number,
        Meta(description="the same nine; by the nearest approach, as Levy and Klein count"),
        Col(better="higher"),
    ] = None


TABLES: Final[tuple[TableLayout, ...]] = tuple(
    layout_of(name, row) for name, rows in get_type_hints(Tables).items() for row in get_args(rows)
)
# The block ``filters`` of a report, read as a table with one row for each candidate.
CANDIDATES: Final = layout_of("filters", CandidateVerdict)
LAYOUTS: Final = (CANDIDATES, *TABLES)  # All that results are compared by, in the order of what a reader asks first.


def each_table(tables: Tables) -> Iterator[tuple[TableLayout, Sequence[Struct]]]:
    """Yield each table's layout and rows."""
    for layout in TABLES:
        yield layout, getattr(tables, layout.name)
