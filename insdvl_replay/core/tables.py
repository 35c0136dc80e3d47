"""The tables of a result: the only place where a table is described.

A row type has the meaning, direction and heading of each column. Files, messages, schemas, gates, comparisons and shown
tables are derived from it. Missing numbers are NaN in computations and None in a row.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, get_args, get_origin, get_type_hints

from msgspec import Meta, Struct

from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    BINS,
    CREDIBILITY_QUANTITIES,
    DRIFT_QUANTITIES,
    EVIDENCE_QUANTITIES,
    JOINT,
    MEASUREMENTS,
    OUTAGE_WINDOWS_S,
    POSITION_QUANTITIES,
    REFERENCE_QUANTITIES,
    SETTLED,
    TRACK_FIT_QUANTITIES,
    VERDICTS_BEST_FIRST,
    axis_of,
)
from insdvl_replay.core.states import STATES
from insdvl_replay.core.units import unit_of_name
from insdvl_replay.core.words import (
    EvidenceVerdict,
    Prediction,
    Reason,
    ReasonCode,
    Role,
    Settling,
    Verdict,
    Whiteness,
)

Number = float | None
_TWO_DIGITS: Final = 99.5  # From here on a size with two digits would have an exponent.
# What is better: ``nearer zero`` for signed errors and correlations, ``nearer dof`` for a mean NIS or NEES.
Better = Literal["lower", "higher", "nearer zero", "nearer dof"]
Kind = Literal["text", "count", "number", "flag"]
RATIO: Final = "ratio"  # Columns whose names begin with this have no unit.


def finite(number: Number) -> float:
    """Return a number of a row, NaN where it is missing or not finite."""
    if number is None or not math.isfinite(number):
        return math.nan
    return number


def two_digits(size: float) -> str:
    """Write a size with two digits; a large one in full, without an exponent."""
    if size < _TWO_DIGITS:
        return f"{size:.2g}"
    return f"{size:.0f}"


def share_text(share: Number) -> str:
    """Write a share in percent; a dash where it is unknown."""
    if math.isnan(finite(share)):
        return "-"
    return f"{two_digits(100.0 * finite(share))} %"


@dataclass(frozen=True)
class Col:
    """One column of a row type, as an annotation of its field."""

    comment: str = ""  # meaning of this column and of those after it until the next comment
    better: Better | None = None  # None for words, counts and limits
    primary: bool = False  # the main column of the table
    # possible names of a row, if the column names the row; empty if the user chooses them
    names: tuple[str, ...] | None = None
    best_first: tuple[str, ...] = ()  # the ranked words
    # heading of the shown column, with ``{filter}`` and ``{baseline}``; empty: not shown
    head: str = ""
    form: str = ""  # format, a key of `document.tables.FORMS`


class TableLayout:
    """The layout of a table, from its row type."""

    def __init__(self, name: str, row: type[Struct]) -> None:
        self.name = name  # as in ``report.json`` and in the name of the CSV file
        self.row = row
        self.columns: dict[str, Col] = {}
        self.kinds: dict[str, Kind] = {}
        self.better: dict[str, Better] = {}
        self.words: dict[str, tuple[str, ...]] = {}
        self.primary = ""
        # The column that names a row together with log and filter, and its possible names; empty if users choose them.
        self.key = "filter"
        self.rows: tuple[str, ...] = ()
        hints = get_type_hints(row, include_extras=True)
        for column in row.__struct_fields__:
            kind, found = _column_of(hints[column])
            self.kinds[column] = kind
            self.columns[column] = found
            if found.better is not None:
                self.better[column] = found.better
            if found.best_first:
                self.words[column] = found.best_first
            if found.primary:
                self.primary = column
            if found.names is not None:
                self.key = column
                self.rows = found.names
        self.about: str = getattr(row, "about", row.__doc__ or "")  # meaning of a row
        # else it has a row for each candidate only
        self.baseline_too: bool = getattr(row, "baseline_too", False)
        # Each filter has a table of its own, whose title names it.
        self.by_filter: bool = getattr(row, "by_filter", False)
        self.title: str = getattr(row, "title", "")
        self.footnote: str = getattr(row, "footnote", "")

    def unit_of(self, column: str, row_unit: str) -> str:
        """Return a column's unit: by the end of its name, none for a ratio, else the row's unit."""
        by_name = unit_of_name(column)
        if by_name:
            return by_name
        if column in self.better and not column.startswith(RATIO):
            return row_unit
        return ""


def _column_of(hint: Any) -> tuple[Kind, Col]:
    """Return what a column holds and its description, from the type of its field."""
    held = hint
    parts: list[Any] = []
    if get_origin(hint) is Annotated:
        held, *parts = get_args(hint)
    column = Col()
    meaning = ""
    for part in parts:
        if isinstance(part, Col):
            column = part
        elif isinstance(part, Meta):
            meaning = part.description or ""
    if meaning and not column.comment:
        column = replace(column, comment=f"{meaning[0].upper()}{meaning[1:]}.")
    if held is str:
        return "text", column
    if held is int:
        return "count", column
    if held is bool:
        return "flag", column
    return "number", column


@cache
def layout_of(name: str, row: type[Struct]) -> TableLayout:
    """Return the layout of a table by its row type."""
    return TableLayout(name, row)


def _each_with_axes(measurements: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Name each measurement, and then its axes."""
    for name, axes in measurements.items():
        yield name
        for axis in axes:
            yield axis_of(name, axis)


_REASONS: Final = tuple(reason for reason in Reason if reason)
_WHY: Final = Col(
    f"Why the verdict differs from the interval: {', '.join(_REASONS)}; empty where it does not."
)
_STATE: Final = Col(names=tuple(state.id for state in STATES), head="state", form="label")
_MEASUREMENTS: Final = tuple(_each_with_axes(MEASUREMENTS))
_CREDIBILITY: Final = (
    *CREDIBILITY_QUANTITIES,
    *POSITION_QUANTITIES,
    *ALL_CREDIBILITY_GROUPS,
    JOINT,
    *SETTLED,
)
_REASON_CODES: Final = [code for code in ReasonCode if code]


def _quantity(names: Sequence[str]) -> Col:
    return Col(names=tuple(names), head="quantity", form="label")


def _unit(comment: str) -> Col:
    return Col(comment, head="unit")


class ImprovementRow(Struct, frozen=True):
    """One state: the predicted standard deviations of a candidate and of the baseline at the end of the dive."""

    about: ClassVar = (
        "One state at the end of a dive: how much smaller the candidate's predicted standard deviation is than the"
        " baseline's."
    )

    by_filter: ClassVar = True
    title: ClassVar = (
        "Predicted improvement: standard deviations at the end, {filter} against {baseline}"
    )

    log: Annotated[str, Col("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the standard deviations.")]
    baseline_sd: Annotated[
        Number, Col("Predicted standard deviations at the end.", head="{baseline}", better="lower")
    ]
    sd: Annotated[Number, Col(head="{filter}", better="lower", primary=True)]
    improvement_pct: Annotated[
        Number,
        Col(
            "(baseline - candidate) / baseline; NaN if unknown.",
            head="improvement",
            form="percent",
            better="higher",
        ),
    ]
    status: Annotated[str, Col("improved, same, worse or not finite.", head="status")]


class ConvergenceRow(Struct, frozen=True):
    """One state: when the candidate's standard deviation stays below the baseline's final one."""

    by_filter: ClassVar = True
    title: ClassVar = (
        "Predicted convergence: when sigma of {filter} stays below the final sigma of {baseline}"
    )

    log: Annotated[str, Col("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the target.")]
    target_sd: Annotated[
        Number, Col("The baseline's final standard deviation.", head="target", better="lower")
    ]
    baseline_s: Annotated[
        Number,
        Col(
            "Times from the start at which the baseline and the candidate reach it; NaN for never.",
            better="lower",
        ),
    ]
    reached_s: Annotated[Number, Col(head="{filter}\n[s]", better="lower", primary=True)]
    improvement_pct: Annotated[
        Number,
        Col(
            "How much sooner the candidate reaches it.",
            head="faster",
            form="percent",
            better="higher",
        ),
    ]
    status: Annotated[str, Col("reached, at_start or never.", head="status", form="words")]
    measured_target: Annotated[
        Number,
        Col(
            "Rms of the baseline's true errors at the end, over starts drawn from P0.",
            better="lower",
        ),
    ] = None
    measured_baseline_s: Annotated[
        Number,
        Col(
            "Times from which the true errors of the baseline and of the candidate stay there; NaN for never.",
            better="lower",
        ),
    ] = None
    measured_s: Annotated[Number, Col(better="lower")] = None
    measured_status: Annotated[str, Col("reached, at_start, never or not measured.")] = ""
    unchanged_s: Annotated[
        Number,
        Col(
            "Time from which the baseline stays at the target: the result of a candidate without any change."
        ),
    ] = None
    nearest_approach_s: Annotated[
        Number,
        Col(
            "Time at which the candidate's standard deviation is nearest to the target, as Levy and Klein count.",
            head="nearest\n[s]",
            better="lower",
        ),
    ] = None
    nearest_approach_improvement_pct: Annotated[
        Number,
        Col(
            "How much sooner that is than the baseline's time.",
            head="faster",
            form="percent",
            better="higher",
        ),
    ] = None


class ReferenceErrorRow(Struct, frozen=True):
    """One quantity: errors of the baseline and of the candidate against the reference solution."""

    by_filter: ClassVar = True
    title: ClassVar = "Reference error: {filter} against {baseline}"

    log: Annotated[str, Col("Dive, candidate and quantity.")]
    filter: str
    quantity: Annotated[str, _quantity(tuple(REFERENCE_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    baseline_rmse: Annotated[
        Number, Col("Root mean square over the dive.", head="{baseline}\nrms", better="lower")
    ]
    rmse: Annotated[Number, Col(head="{filter}\nrms", better="lower", primary=True)]
    improvement_pct: Annotated[
        Number,
        Col(
            "How much smaller the candidate's rms is.",
            head="improvement",
            form="percent",
            better="higher",
        ),
    ]
    baseline_final: Annotated[
        Number,
        Col(
            "At the last reference time, with its sign.",
            head="{baseline}\nfinal",
            better="nearer zero",
        ),
    ]
    final: Annotated[Number, Col(head="{filter}\nfinal", better="nearer zero")]
    samples: Annotated[int, Col("Reference times that were compared.")]
    status: Annotated[
        str,
        Col(
            "compared, partly covered, no reference, not in reference, no distance or lost in gap."
        ),
    ]


class ConsistencyRow(Struct, frozen=True):
    """Whether a filter's innovations are as large as it predicts."""

    about: ClassVar = (
        "One measurement or one of its axes: are the innovations of a filter "
        "as large as the filter predicts?"
    )

    baseline_too: ClassVar = True
    title: ClassVar = (
        "Consistency: mean NIS, with the interval that holds 95 % of consistent filters"
    )

    log: Annotated[
        str,
        Col(
            "Dive, filter, and measurement such as velocity, or an axis of it such as velocity_x."
        ),
    ]
    filter: Annotated[str, Col(head="filter")]
    measurement: Annotated[str, Col(head="measurement", form="words", names=_MEASUREMENTS)]
    dof: Annotated[int, Col("Degrees of freedom of one innovation.")]
    used: Annotated[
        int, Col("Innovations that were used, and that the gate rejected.", head="used")
    ]
    rejected: Annotated[int, Col(head="rejected", better="lower")]
    mean_nis: Annotated[
        Number,
        Col(
            "Mean normalised innovation squared, and the interval that holds 95 % of consistent filters.",
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
            "Lag-1 correlation of the innovations, and its limit for 95 % of white innovations.",
            better="nearer zero",
        ),
    ] = None
    autocorrelation_limit: Number = None
    whiteness: Annotated[
        str,
        Col(
            "white, correlated, insufficient data or not finite.",
            best_first=(Whiteness.WHITE, Whiteness.CORRELATED),
        ),
    ] = ""
    why: Annotated[str, _WHY] = ""


class CredibilityRow(Struct, frozen=True):
    """Whether a filter's errors against the reference, or the truth, are as large as its sigma."""

    about: ClassVar = (
        "One quantity: are the errors of a filter against the reference, or "
        "the truth, as large as its sigma?"
    )

    baseline_too: ClassVar = True
    by_filter: ClassVar = True
    title: ClassVar = "Credibility: errors of {filter} in units of its own sigma"

    log: Annotated[
        str,
        Col(
            "Dive, filter, and a quantity or group of quantities; all is all compared states together, settled_ is of "
            "the baseline with the noise of the reference, and without errors that grow with the speed."
        ),
    ]
    filter: str
    quantity: Annotated[str, Col(head="quantity", form="short", names=_CREDIBILITY)]
    dof: Annotated[int, Col("Degrees of freedom of one error, and number of compared times.")]
    samples: int
    mean_nees: Annotated[
        Number,
        Col(
            "Mean normalised estimation error squared, and the interval that holds 95 % of consistent filters; of "
            "settled_ the limits within which a baseline is fit to judge by.",
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
            "Share of the errors within 1 and 3 standard deviations; 68.3 % and 99.7 % are expected.",
            head="in\n1 sd",
            form="1",
        ),
    ]
    within_3sd_pct: Annotated[Number, Col(head="in\n3 sd", form="1")]
    verdict: Annotated[
        str,
        Col(
            "consistent, overconfident, conservative, insufficient data, not finite, not in reference or no "
            "reference.",
            head="verdict",
            best_first=VERDICTS_BEST_FIRST,
        ),
    ]
    effective_samples: Annotated[
        Number, Col("Effective samples behind the mean.", head="effective\nsamples", form="0")
    ]
    why: Annotated[str, _WHY] = ""


_ROLE: Final = Col(
    "primary, secondary (it can warn, and cannot win), veto (the same, on its own), settling or shown.",
    head="role",
)


class EvidenceRow(Struct, frozen=True):
    """One measured comparison of a candidate with the baseline on one dive. One dive has no verdict."""

    by_filter: ClassVar = True
    title: ClassVar = "Evidence: measured, {filter} against {baseline}"

    log: Annotated[str, Col("Dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: Annotated[
        str, Col("accuracy, outage, held_out, track, prediction, convergence or consistency.")
    ]
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, _unit("Unit of the two values, and of moves.")]
    baseline: Annotated[
        Number,
        Col(
            "Values of the baseline and the candidate in the same run, from the start that the dive had: a root mean "
            "square or a final error. Convergence: the time from drawn starts.",
            head="{baseline}",
            better="lower",
        ),
    ]
    value: Annotated[Number, Col(head="{filter}", better="lower")]
    ratio: Annotated[
        Number,
        Col(
            "Candidate over baseline.",
            head="ratio",
            form="ratio",
            better="lower",
            primary=True,
        ),
    ]
    moves: Annotated[
        Number, Col("Root mean square of the difference of both runs.", head="moves")
    ] = None
    acts: Annotated[
        Number,
        Col(
            "The same over the error of the baseline. The ratio cannot differ from 1 by more.",
            head="acts",
            form="share",
        ),
    ] = None
    reference_noise: Annotated[
        Number, Col("Share of the reference's stated noise in the squared error of the baseline.")
    ] = None
    samples: Annotated[int, Col("Compared times, stretches or windows, and starts.", head="n")] = 0
    starts: int = 1
    from_s: Annotated[
        Number,
        Col(
            "Time after the start up to which the sigma of the baseline settles, which is left out."
        ),
    ] = None
    role: Annotated[str, Col("primary (it may decide), secondary, veto, settling or shown.")] = (
        Role.SHOWN
    )


class LakeRow(EvidenceRow, frozen=True, kw_only=True):
    """A row of evidence in the dataset of ``run --lake``, with what identifies its replay."""

    filter_verdict: Annotated[str, Col("Verdict on the filter by this dive.")]
    vehicle: Annotated[str, Col("The vehicle that made the dive; empty: nobody said.")]
    replay: Annotated[
        str,
        Col(
            "Identifies the replay: digest of log, settings, code, version and revision. The next four say which "
            "these "
            "are: SHA-256 of the log, of config.toml, and of your code (empty without), and the name that --revision "
            "gave."
        ),
    ]
    log_sha256: str
    settings_sha256: str
    code_sha256: str
    revision: str
    version: Annotated[str, Col("Version of the tool, and start of the replay (UTC, ISO 8601).")]
    started_at: str


class OutageRow(Struct, frozen=True):
    """Drift of a filter during a DVL outage of one length, compared with the baseline."""

    about: ClassVar = (
        "DVL outages of one length: drift of a filter without velocities, measured by the held-out velocities."
        " Errors of heading, scale and mounting about down cannot be seen."
    )

    baseline_too: ClassVar = True
    title: ClassVar = "DVL outage test: drift without the DVL"
    footnote: ClassVar = (
        "A wrong heading, scale or mounting about down causes drift that is not visible here, because the DVL shares "
        "the error."
    )

    log: Annotated[str, Col("Dive, filter and length of the windows.")]
    filter: Annotated[str, Col(head="filter")]
    window_s: Annotated[str, Col(head="outage\n[s]", names=OUTAGE_WINDOWS_S)]
    windows: Annotated[
        int,
        Col(
            "Windows that do not overlap, and windows left out because of a gap of DVL or IMU.",
            head="windows",
        ),
    ]
    left_out: int
    drift_median_m: Annotated[
        Number,
        Col(
            "Horizontal drift at the end of a window: median, root mean square and 95th percentile. With fewer than "
            "20 "
            "windows the percentile is nearly the largest.",
            head="median\n[m]",
            better="lower",
            primary=True,
        ),
    ]
    drift_rms_m: Annotated[Number, Col(better="lower")]
    drift_p95_m: Annotated[Number, Col(head="95 %\n[m]", better="lower")]
    drift_of_distance_pct: Annotated[
        Number,
        Col(
            "Drift in percent of the distance travelled, median over windows; NaN if the vehicle hardly moved.",
            head="share of\ndistance\n[%]",
            form="2",
            better="lower",
        ),
    ]
    end_velocity_mps: Annotated[
        Number, Col("Median horizontal velocity error at the end.", better="lower")
    ]
    vertical_median_m: Annotated[
        Number, Col("Median vertical drift, absolute.", head="depth\n[m]", better="lower")
    ]
    ratio_to_baseline: Annotated[
        Number,
        Col(
            "Ratio of the root mean squares over the same windows; NaN for the baseline.",
            head="rms\nratio",
            form="2",
            better="lower",
        ),
    ]
    windows_won_pct: Annotated[
        Number,
        Col(
            "Share of windows with less drift than the baseline; a tie counts half.",
            head="won\n[%]",
            form="0",
            better="higher",
        ),
    ]
    nis_per_dof: Annotated[
        Number,
        Col(
            "NIS/dof of the last held-out velocity, mean over windows; 1 is expected.",
            head="NIS\n/ dof",
            form="significant",
        ),
    ]


class DriftRow(Struct, frozen=True):
    """One quantity: median, 95th percentile, rms and largest error of a filter against the reference."""

    baseline_too: ClassVar = True
    title: ClassVar = "Drift: errors against the reference"
    footnote: ClassVar = (
        "50 % and 95 % of the errors are smaller than the values in these columns, which are CEP50 and CEP95 for the "
        "position. Drift: change of the horizontal position error over a time or distance."
    )

    log: Annotated[
        str,
        Col("Dive, filter and quantity: the position, its drift over stretches, or the velocity."),
    ]
    filter: Annotated[str, Col(head="filter")]
    quantity: Annotated[str, _quantity(tuple(DRIFT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    samples: Annotated[int, Col("Number of compared times, or of overlapping stretches.")]
    p50: Annotated[
        Number,
        Col(
            "50 % and 95 % of the absolute errors are smaller (CEP50 and CEP95 for the position); and the rms.",
            head="50 %",
            better="lower",
            primary=True,
        ),
    ]
    p95: Annotated[Number, Col(head="95 %", better="lower")]
    rms: Annotated[Number, Col(head="rms", better="lower")]
    worst: Annotated[Number, Col("The largest absolute error.", head="worst", better="lower")]
    worst_from_s: Annotated[
        Number,
        Col(
            "Begin and end of its stretch, from the start; equal for rows without a stretch.",
            head="from\n[s]",
            form="0",
        ),
    ]
    worst_to_s: Annotated[Number, Col(head="to\n[s]", form="0")]
    final: Annotated[Number, Col("The last absolute error.", better="lower")] = None
    distance_m: Annotated[Number, Col("Distance travelled to the last compared position.")] = None
    final_of_distance_pct: Annotated[
        Number, Col("Final position error in percent of that distance.", better="lower")
    ] = None
    two_drms: Annotated[
        Number, Col("Twice the rms of the horizontal position error (2DRMS).", better="lower")
    ] = None
    per_hour: Annotated[
        Number,
        Col(
            "Final position error over the hours of the replay; of dives of an hour or more.",
            better="lower",
        ),
    ] = None
    lost_pct: Annotated[
        Number,
        Col("Share of the time with a position error above evaluation.lost_m.", better="lower"),
    ] = None


class JumpRow(Struct, frozen=True):
    """Position steps of a filter that neither its velocity nor the neighbouring steps explain."""

    baseline_too: ClassVar = True
    title: ClassVar = "Jumps: position steps that the velocity does not explain"
    footnote: ClassVar = (
        "Unexplained is what neither the velocity nor the three steps before and after explain of a horizontal step. "
        "A jump is more than 0.5 m and more than ten robust standard deviations. Filters that only integrate their "
        "velocity do not jump."
    )

    log: Annotated[
        str, Col("Dive and filter: an onboard solution, or a filter that estimates its position.")
    ]
    filter: Annotated[str, Col(head="filter")]
    steps: Annotated[int, Col("Number of examined horizontal position steps.", head="steps")]
    jumps: Annotated[
        int,
        Col(
            "Steps with more than 0.5 m, and more than ten robust standard deviations, unexplained.",
            head="jumps",
            better="lower",
            primary=True,
        ),
    ]
    largest_m: Annotated[
        Number, Col("Largest unexplained part of a step.", head="largest\n[m]", better="lower")
    ]
    largest_at_s: Annotated[
        Number, Col("End of that step, from the start.", head="at\n[s]", form="1")
    ]


class TrackFitRow(Struct, frozen=True):
    """The scale or the turn that aligns a filter's track with the reference's, with standard error."""

    baseline_too: ClassVar = True
    title: ClassVar = "Track fit: scale and turn that align each track with the reference's"
    footnote: ClassVar = (
        "The scale is positive if the filter's track is too small, and the turn is clockwise from above. The "
        "standard errors allow for noise but not for heading drift."
    )

    log: Annotated[str, Col("Dive, filter, and scale or turn.")]
    filter: Annotated[str, Col(head="filter")]
    quantity: Annotated[str, _quantity(tuple(TRACK_FIT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the two numbers.")]
    fitted: Annotated[
        Number,
        Col(
            "Scale: positive if the filter's track is too small. Turn: clockwise from above.",
            head="fitted",
            form="3",
            better="nearer zero",
            primary=True,
        ),
    ]
    fitted_sd: Annotated[
        Number,
        Col(
            "Standard error by noise, without heading drift; NaN for a short dive.",
            head="sd",
            form="3",
        ),
    ]


class PooledRow(Struct, frozen=True):
    """One comparison of a candidate with the baseline, over several dives."""

    by_filter: ClassVar = True
    title: ClassVar = "All dives together: {filter} against {baseline}"
    footnote: ClassVar = (
        "ratio: geometric mean over dives. low, high: its interval, by Student's t; each dive is one sample. "
        "Wholly below 1/1.05: better. Wholly above 1.05: worse. Wholly between: equivalent."
    )

    log: Annotated[str, Col("* for all dives, then candidate, kind of evidence and quantity.")]
    filter: str
    evidence: str
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[
        str, Col("Unit of the values of baseline and candidate, which are medians over the dives.")
    ]
    baseline: Number
    value: Number
    ratio: Annotated[
        Number,
        Col(
            "Geometric mean of the dives' ratios, and its interval over dives, which gives the word.",
            head="ratio",
            form="ratio",
            better="lower",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    level_pct: Annotated[
        Number,
        Col(
            "Confidence of the interval: 95 %, more where several candidates or secondary rows share it.",
            form="1",
        ),
    ]
    low_always: Annotated[
        Number, Col("The 95 % interval that may be looked at after every dive.", form="ratio")
    ]
    high_always: Annotated[Number, Col(form="ratio")]
    dives: Annotated[
        int,
        Col(
            "Dives with a ratio, and those of them in which the candidate is better.", head="dives"
        ),
    ]
    dives_won: Annotated[int, Col(head="won")]
    scatter: Annotated[
        Number,
        Col(
            "Standard deviation of the logarithm of the ratio over dives; empty where each of several vehicles is one "
            "sample, whose dives differ less than vehicles do.",
            form="3",
        ),
    ]
    p: Annotated[
        Number,
        Col(
            "Probability of such data with a true difference of at most 5 %, by Student's t; empty without interval.",
            head="p",
            form="probability",
        ),
    ]
    moves: Annotated[
        Number, Col("Root mean square of the difference of both runs, median over the dives.")
    ]
    acts: Annotated[
        Number,
        Col(
            "The same over the error of the baseline, median over the dives and largest; the ratio of a dive cannot "
            "differ from 1 by more.",
            head="acts",
            form="share",
        ),
    ]
    acts_most: Number
    reference_noise: Annotated[
        Number,
        Col(
            "Share of the reference's noise in the squared error of the baseline, median over the dives."
        ),
    ]
    role: Annotated[str, _ROLE]
    verdict: Annotated[
        str,
        Col(
            "better, worse, equivalent or undecided; of convergence sooner, later, same or undecided.",
            head="verdict",
            best_first=(
                *(
                    EvidenceVerdict.BETTER,
                    Settling.SOONER,
                    EvidenceVerdict.EQUIVALENT,
                    Settling.SAME,
                ),
                *(EvidenceVerdict.UNDECIDED, Settling.LATER, EvidenceVerdict.WORSE),
            ),
        ),
    ]
    verdict_always: Annotated[
        str,
        Col(
            "The same word by low_always and high_always, which may be asked for after every dive."
        ),
    ] = EvidenceVerdict.UNDECIDED
    vehicles: Annotated[
        int, Col("Vehicles of the dives with a ratio; 0 where nobody said which vehicle it was.")
    ] = 0


class AnswerRow(Struct, frozen=True):
    """The answer for one candidate over all dives of a run: its headline, for scripts and gates."""

    title: ClassVar = "The answer over all dives"
    footnote: ClassVar = (
        "verdict: mixed if the primary quantity is better and another one worse, or if starts or vehicles "
        "contradict each other."
    )

    log: Annotated[str, Col("* for all dives; the dive where only one has the candidate.")]
    filter: Annotated[str, Col("The candidate, and what it is compared with.", head="filter")]
    baseline: Annotated[str, Col(head="against")]
    verdict: Annotated[
        str,
        Col(
            "The word of the headline. One dive has no verdict: undecided, unless it is proved how little is changed.",
            head="verdict",
            best_first=tuple(Verdict),
        ),
    ]
    verdict_always: Annotated[
        str,
        Col(
            "The same by the intervals that may be looked at after every dive.",
            best_first=tuple(Verdict),
        ),
    ]
    primary: Annotated[
        str, Col("The quantity that decides; empty for none.", head="decides by", form="label")
    ]
    ratio: Annotated[
        Number,
        Col(
            "Its ratio and interval, as in the table of all quantities.",
            head="ratio",
            form="ratio",
            better="lower",
            primary=True,
        ),
    ]
    low: Annotated[Number, Col(head="low", form="ratio")]
    high: Annotated[Number, Col(head="high", form="ratio")]
    dives: Annotated[
        int,
        Col("Dives that have the candidate, and those of them that are evaluated.", head="dives"),
    ]
    evaluated: Annotated[int, Col(head="evaluated")]
    vehicles: Annotated[
        int,
        Col(
            "Vehicles of the dives with this ratio; 0 where nobody said which vehicle it was.",
            head="vehicles",
        ),
    ]
    convergence: Annotated[
        str,
        Col(
            "The second answer: sooner, same, undecided or later; empty where it is not known.",
            head="convergence",
            best_first=(Settling.SOONER, Settling.SAME, Settling.UNDECIDED, Settling.LATER),
        ),
    ]
    reason_code: Annotated[
        str,
        Col(
            f"Why it is no plain word of the primary quantity: {', '.join(_REASON_CODES)}; empty where it is.",
            head="because",
        ),
    ]


class AssayRow(Struct, frozen=True):
    """One control of ``run --assay``: the baseline with a planted fault of known size, against the baseline."""

    by_filter: ClassVar = True
    title: ClassVar = "Assay: the baseline with a planted fault, {filter}"
    footnote: ClassVar = "What the evidence would have said about a filter with this fault."

    log: Annotated[str, Col("Dive, control and quantity.")]
    filter: Annotated[str, Col("Name of the control, such as gyro_noise_x3.", head="control")]
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, _unit("Unit of the two values.")]
    baseline: Annotated[
        Number, Col("Errors without and with the fault.", head="baseline", better="lower")
    ]
    value: Annotated[Number, Col(head="with fault", better="lower")]
    ratio: Annotated[
        Number, Col("With the fault over without it.", head="ratio", form="ratio", primary=True)
    ]
    role: Annotated[str, Col("primary (it may decide), secondary or shown.")] = Role.SHOWN


class WhereRow(Struct, frozen=True, kw_only=True):
    """One thing that the vehicle does: the drift of a candidate over that of the baseline meanwhile."""

    about: ClassVar = (
        "What the vehicle does, such as turns: the drift in 30 s meanwhile, of a candidate over that of the baseline."
        " No verdict depends on it."
    )

    baseline_too: ClassVar = True
    by_filter: ClassVar = True
    title: ClassVar = "Where: drift in 30 s by what the vehicle does, {filter} against {baseline}"
    footnote: ClassVar = (
        "ratio: of the drift in this bin. to rest: this ratio over that of the rest of the dive. A single dive has "
        "no interval, so nothing on it is notable."
    )

    log: Annotated[str, Col("Dive, or * for all dives, then filter and bin.")]
    filter: str
    bin: Annotated[str, Col(names=BINS, head="where", form="label")]
    unit: Annotated[str, Col("Unit of the drift.")]
    baseline: Annotated[
        Number,
        Col(
            "Root mean square of the horizontal drift in 30 s in this bin: of the baseline, and of the filter; of all "
            "dives the median.",
            head="{baseline}",
            form="value",
            better="lower",
        ),
    ]
    value: Annotated[Number, Col(head="{filter}", form="value", better="lower")]
    rest_value: Annotated[Number, Col("The filter's in the rest of the dive.", better="lower")]
    ratio: Annotated[
        Number,
        Col(
            "Filter over baseline in this bin, with its interval over dives. Of all dives it is the geometric mean.",
            head="ratio",
            form="ratio",
            better="lower",
        ),
    ] = None
    low: Annotated[Number, Col(form="ratio")] = None
    high: Annotated[Number, Col(form="ratio")] = None
    to_rest: Annotated[
        Number,
        Col(
            "This ratio over the ratio in the rest of the dive, with its interval over dives.",
            head="to rest",
            form="ratio",
        ),
    ] = None
    to_rest_low: Annotated[Number, Col(form="ratio")] = None
    to_rest_high: Annotated[Number, Col(form="ratio")] = None
    p_adjusted: Annotated[
        Number,
        Col(
            "Probability of such a to_rest if the bin and the rest differed by at most 5 %, two-sided, adjusted for "
            "all bins (Holm) and candidates.",
            form="4",
        ),
    ] = None
    stands_out: Annotated[
        bool,
        Col("Whether both intervals are wholly beyond the band, on the same side."),
    ] = False
    dives: Annotated[int, Col("Dives with a ratio, and their overlapping windows of 30 s.")] = 1
    windows: Annotated[int, Col(head="windows")] = 0


class Tables(Struct, frozen=True):
    """The tables, with the rows of the CSV files; missing values are null. Early reports lack the last eight."""

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
    assay: list[AssayRow] = []
    where: list[WhereRow] = []


class CandidateVerdict(Struct, frozen=True):
    """One candidate: its verdict, its consistency and its mean predicted improvement."""

    sentence: Annotated[
        str, Meta(description="one paragraph for people: measured, predicted, consistency")
    ]
    verdict: Annotated[
        str,
        Meta(
            description="verdict: on one dive no effect, equivalent (both proved), undecided, not repeatable or not "
            "evaluated"
        ),
        Col(best_first=tuple(Verdict)),
    ]
    consistency: Annotated[
        str,
        Meta(description="worst consistency of its measurements (NIS)"),
        Col(best_first=VERDICTS_BEST_FIRST),
    ]
    mean_improvement_pct: Annotated[
        Number,
        Meta(
            description="how much smaller its predicted sigma is at the end, mean of nine states (no velocity errors)"
        ),
        Col(better="higher"),
    ]
    mean_convergence_improvement_pct: Annotated[
        Number,
        Meta(
            description="how much faster its sigma converges, mean of the same nine states; never and at_start count 0"
        ),
        Col(better="higher"),
    ]
    reference_improvement_pct: Annotated[
        Number,
        Meta(
            description="how much smaller its error against the reference is, median over the compared quantities"
        ),
        Col(better="higher", primary=True),
    ]
    credibility: Annotated[
        str,
        Meta(
            description="worst consistency of its errors against the reference, over the groups of states (NEES)"
        ),
    ] = ""
    prediction: Annotated[
        str,
        Meta(
            description="whether the predicted improvement was measured: confirmed, not confirmed or undecided"
        ),
        Col(best_first=tuple(Prediction)),
    ] = ""
    mean_convergence_unchanged_pct: Annotated[
        Number, Meta(description="mean convergence improvement of a candidate without any change")
    ] = None
    reason: Annotated[str, Meta(description="why it is not evaluated; empty if it is")] = ""
    primary: Annotated[
        str, Meta(description="the quantity that decides, by what the log has; empty: none")
    ] = ""
    mean_nearest_approach_improvement_pct: Annotated[
        Number,
        Meta(
            description="as mean_convergence_improvement_pct, by the nearest approach, as Levy and Klein count"
        ),
        Col(better="higher"),
    ] = None


def _layouts() -> Iterator[TableLayout]:
    for name, rows in get_type_hints(Tables).items():
        (row,) = get_args(rows)
        yield layout_of(name, row)


TABLES: Final[tuple[TableLayout, ...]] = tuple(_layouts())
# The block ``filters`` of a report as a table with one row for each candidate.
CANDIDATES: Final = layout_of("filters", CandidateVerdict)
LAKE: Final = layout_of("lake", LakeRow)
ANSWERS: Final = layout_of("answers", AnswerRow)  # over all dives of a run
# All tables that results are compared by, most important first.
LAYOUTS: Final = (
    CANDIDATES,
    *TABLES,
)


def each_table(tables: Tables) -> Iterator[tuple[TableLayout, Sequence[Struct]]]:
    """Yield each table's layout and rows."""
    for layout in TABLES:
        yield layout, getattr(tables, layout.name)
