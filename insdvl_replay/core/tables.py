"""The tables of a result: the only place where a table is described.

A row type says what its columns hold, which is better, and under which heading people see them. Files, messages,
schemas, gates, comparisons and shown tables are derived from it. Numbers that are missing are NaN as they are computed,
and None in a row.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, ClassVar, Final, get_args, get_type_hints

from msgspec import Meta, Struct

from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    COASTING_WINDOWS_S,
    CREDIBILITY_QUANTITIES,
    DRIFT_QUANTITIES,
    EVIDENCE_QUANTITIES,
    JOINT,
    MEASUREMENTS,
    POSITION_QUANTITIES,
    REFERENCE_QUANTITIES,
    TRACK_FIT_QUANTITIES,
    VERDICTS_BEST_FIRST,
    axis_of,
)
from insdvl_replay.core.states import STATES
from insdvl_replay.core.table import Column, Number, TableLayout, layout_of
from insdvl_replay.core.words import Belief, EvidenceWord, Judgement, Whiteness

_WHY: Final = Column("Why the verdict is not what the interval says, if it is not.")
_STATE: Final = Column(names=tuple(state.id for state in STATES), head="state", form="label")
_MEASUREMENTS: Final = tuple(
    row for name, axes in MEASUREMENTS.items() for row in (name, *(axis_of(name, axis) for axis in axes))
)
_CREDIBILITY: Final = (*CREDIBILITY_QUANTITIES, *POSITION_QUANTITIES, *ALL_CREDIBILITY_GROUPS, JOINT)


def _quantity(names: Sequence[str]) -> Column:
    return Column(names=tuple(names), head="quantity", form="label")


def _unit(comment: str) -> Column:
    return Column(comment, head="unit")


class ImprovementRow(Struct, frozen=True):
    """What a candidate believes of one state at the end of the dive, beside the baseline."""

    about: ClassVar = (
        "One state at the end of a dive: how much smaller the candidate's believed standard deviation is than the "
        "baseline's."
    )
    title: ClassVar = "Improvement: standard deviations at the end, {filter} against {baseline}"

    log: Annotated[str, Column("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the standard deviations.")]
    baseline_sd: Annotated[Number, Column(better="lower", head="{baseline}")]
    sd: Annotated[Number, Column(better="lower", primary=True, head="{filter}")]
    improvement_pct: Annotated[
        Number,
        Column(
            "(baseline - candidate) / baseline; NaN where there is none.",
            better="higher",
            head="improvement",
            form="percent",
        ),
    ]
    status: Annotated[str, Column("improved, same, worse or not finite.", head="status")]


class ConvergenceRow(Struct, frozen=True):
    """When a candidate became, and stayed, as sure of one state as the baseline is at the end."""

    about: ClassVar = (
        "One state: how much sooner the candidate reaches for good the standard deviation that the baseline ends with."
    )

    title: ClassVar = "Convergence: when {filter} is as sure as {baseline} is at the end"

    log: Annotated[str, Column("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, _unit("Unit of the standard deviation to reach.")]
    target_sd: Annotated[Number, Column(better="lower", head="target")]
    baseline_s: Annotated[
        Number,
        Column("Times from the start at which the baseline and the candidate have it; NaN for never.", better="lower"),
    ]
    reached_s: Annotated[Number, Column(better="lower", primary=True, head="{filter}\n[s]")]
    improvement_pct: Annotated[Number, Column(better="higher", head="sooner", form="percent")]
    status: Annotated[str, Column("reached, at_start or never.", head="status", form="words")]
    measured_target: Annotated[
        Number,
        Column("Rms of the baseline's true errors at the end, over starts that are drawn from P0.", better="lower"),
    ] = None
    measured_baseline_s: Annotated[
        Number,
        Column(
            "Times from which on the errors of the baseline and of the candidate stay there; NaN for never.",
            better="lower",
        ),
    ] = None
    measured_s: Annotated[Number, Column(better="lower")] = None
    measured_status: Annotated[str, Column("reached, at_start, never or not measured.")] = ""
    unchanged_s: Annotated[
        Number,
        Column("Time at which the baseline itself came to stay there, and a candidate does that changes nothing."),
    ] = None
    nearest_approach_s: Annotated[
        Number,
        Column(
            "When the candidate's standard deviation is nearest to the target: Levy and Klein's time.",
            better="lower",
            head="nearest\n[s]",
        ),
    ] = None
    nearest_approach_improvement_pct: Annotated[Number, Column(better="higher", head="sooner", form="percent")] = None


class ReferenceErrorRow(Struct, frozen=True):
    """How far a candidate is from the reference in one quantity, beside the baseline."""

    about: ClassVar = "One quantity: errors of the baseline and of the candidate against the reference solution."

    title: ClassVar = "Reference error: distance from the reference, {filter} against {baseline}"

    log: Annotated[str, Column("Dive, candidate and quantity.")]
    filter: str
    quantity: Annotated[str, _quantity(tuple(REFERENCE_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    baseline_rmse: Annotated[Number, Column("Root mean square over the dive.", better="lower", head="{baseline}\nrms")]
    rmse: Annotated[Number, Column(better="lower", primary=True, head="{filter}\nrms")]
    improvement_pct: Annotated[Number, Column(better="higher", head="better", form="percent")]
    baseline_final: Annotated[
        Number,
        Column("At the last reference time, with its sign.", better="nearer zero", head="{baseline}\nfinal"),
    ]
    final: Annotated[Number, Column(better="nearer zero", head="{filter}\nfinal")]
    samples: Annotated[int, Column("Reference times that were compared.")]
    status: Annotated[
        str, Column("compared, partly covered, no reference, not in reference, no distance or lost in gap.")
    ]


class ConsistencyRow(Struct, frozen=True):
    """Whether a filter's innovations are as large as it says."""

    about: ClassVar = (
        "One kind of measurement or one of its axes: do the innovations of a filter have the size that the filter "
        "expects?"
    )
    baseline_too: ClassVar = True
    title: ClassVar = "Consistency: mean NIS and where 95 % of consistent filters would have it"

    log: Annotated[str, Column("Dive, filter, and measurement such as velocity, or an axis of it such as velocity_x.")]
    filter: Annotated[str, Column(head="filter")]
    measurement: Annotated[str, Column(names=_MEASUREMENTS, head="measurement", form="words")]
    dof: Annotated[int, Column("Degrees of freedom of one innovation.")]
    used: Annotated[int, Column(head="used")]
    rejected: Annotated[int, Column(better="lower", head="rejected")]
    mean_nis: Annotated[
        Number,
        Column(
            "Mean normalised innovation squared, and the interval in which 95 % of consistent filters have it.",
            better="nearer dof",
            primary=True,
            head="NIS",
        ),
    ]
    low: Annotated[Number, Column(head="low")]
    high: Annotated[Number, Column(head="high")]
    verdict: Annotated[
        str,
        Column(
            "consistent, over-confident, over-cautious, too few, not finite; not told of a filter without the states "
            "that a withheld sensor needs.",
            best_first=VERDICTS_BEST_FIRST,
            head="verdict",
        ),
    ]
    autocorrelation: Annotated[
        Number,
        Column(
            "Correlation of each innovation with the one before, and what 95 % of white innovations stay below.",
            better="nearer zero",
        ),
    ] = None
    autocorrelation_limit: Number = None
    whiteness: Annotated[
        str,
        Column("white, correlated, too few or not finite.", best_first=(Whiteness.WHITE, Whiteness.CORRELATED)),
    ] = ""
    why: Annotated[str, _WHY] = ""


class CredibilityRow(Struct, frozen=True):
    """Whether a filter's errors against the reference, or the truth, are as large as it says."""

    about: ClassVar = (
        "One quantity: are the errors of a filter against the reference, or the truth, as large as the filter expects?"
    )
    baseline_too: ClassVar = True
    title: ClassVar = "Credibility: errors of {filter} in its own standard deviations"

    log: Annotated[str, Column("Dive, filter, and a quantity or group of them; all is every compared state together.")]
    filter: str
    quantity: Annotated[str, Column(names=_CREDIBILITY, head="quantity", form="short")]
    dof: Annotated[int, Column("Degrees of freedom of one error, and the times that were compared.")]
    samples: int
    mean_nees: Annotated[
        Number,
        Column(
            "Mean normalised error squared, and the interval in which 95 % of consistent filters have it.",
            better="nearer dof",
            primary=True,
            head="NEES",
        ),
    ]
    low: Annotated[Number, Column(head="low", form="2")]
    high: Annotated[Number, Column(head="high", form="2")]
    within_1sd_pct: Annotated[
        Number,
        Column(
            "Share of the errors within one and three standard deviations; 68.3 % and 99.7 % are expected.",
            head="in\n1 sd",
            form="1",
        ),
    ]
    within_3sd_pct: Annotated[Number, Column(head="in\n3 sd", form="1")]
    verdict: Annotated[
        str,
        Column(
            "consistent, over-confident, over-cautious, too few, not finite, not in reference or no reference.",
            best_first=VERDICTS_BEST_FIRST,
            head="verdict",
        ),
    ]
    effective_samples: Annotated[
        Number, Column("How many independent samples the compared times are worth.", head="indep.", form="0")
    ]
    why: Annotated[str, _WHY] = ""


class EvidenceRow(Struct, frozen=True):
    """One piece of evidence: a candidate beside the baseline in one quantity, with its interval and a word."""

    about: ClassVar = "One piece of evidence on a candidate beside the baseline: what was measured, and what it says."

    title: ClassVar = "Evidence: what was measured, {filter} against {baseline}"

    log: Annotated[str, Column("Dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: Annotated[str, Column("accuracy, coasting, withheld, track, convergence or honesty.")]
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, _unit("Unit of the two values.")]
    baseline: Annotated[
        Number,
        Column(
            "What the baseline and the candidate have on this dive, from its own start: a root mean square, a final "
            "error, or the time of convergence from drawn starts.",
            better="lower",
            head="{baseline}",
        ),
    ]
    value: Annotated[Number, Column(better="lower", head="{filter}")]
    ratio: Annotated[
        Number,
        Column(
            "Candidate over baseline, of accuracy over all drawn starts, and its 95 % interval on this dive: other "
            "dives may differ by more.",
            better="lower",
            primary=True,
            head="ratio",
            form="ratio",
        ),
    ]
    low: Annotated[Number, Column(head="low", form="ratio")]
    high: Annotated[Number, Column(head="high", form="ratio")]
    effective_samples: Annotated[
        Number, Column("How many independent values the ratio and its interval rest on.", head="n", form="0")
    ]
    starts: Annotated[
        int, Column("Starts that were replayed, and stretches of the dive or windows that were compared.")
    ]
    windows: int
    word: Annotated[
        str,
        Column(
            "better, worse, equivalent or undecided; empty where the filter is not judged.",
            best_first=(EvidenceWord.BETTER, EvidenceWord.EQUIVALENT, EvidenceWord.UNDECIDED, EvidenceWord.WORSE),
            head="word",
        ),
    ]
    p: Annotated[
        Number,
        Column(
            "Of a true difference of at most 5 %, by Student's t or by drawn starts: below 0.01 the row decides.",
            head="p",
            form="4",
        ),
    ] = None
    why: Annotated[str, Column("What keeps the row from deciding, if it is not the interval.", head="why")] = ""


class CoastingRow(Struct, frozen=True):
    """How far a filter drifts in some time without velocities, beside the baseline."""

    about: ClassVar = (
        "Windows of one length in which every velocity was withheld from a filter: how far it went astray by what the "
        "withheld velocities say. Where a wrong heading, scale or mounting about down takes the track is "
        "not seen."
    )
    baseline_too: ClassVar = True
    title: ClassVar = "Coasting: drift while the DVL is withheld"
    footnote: ClassVar = (
        "Where a wrong heading, scale or constant turn of the mounting takes the track is not seen: the DVL itself "
        "shares it."
    )

    log: Annotated[str, Column("Dive, filter and length of the windows.")]
    filter: Annotated[str, Column(head="filter")]
    window_s: Annotated[str, Column(names=COASTING_WINDOWS_S, head="for [s]")]
    windows: Annotated[
        int,
        Column("Windows that do not overlap, and those left out since DVL or IMU fell silent.", head="windows"),
    ]
    left_out: int
    drift_median_m: Annotated[
        Number,
        Column(
            "Horizontal drift at the end of a window: median, root mean square and 95th percentile, which of fewer "
            "than 20 windows is nearly the largest.",
            better="lower",
            primary=True,
            head="median\n[m]",
        ),
    ]
    drift_rms_m: Annotated[Number, Column(better="lower")]
    drift_p95_m: Annotated[Number, Column(better="lower", head="95 %\n[m]")]
    drift_of_distance_pct: Annotated[
        Number,
        Column(
            "Median over windows; NaN where the vehicle hardly moved.", better="lower", head="of way\n[%]", form="2"
        ),
    ]
    end_velocity_mps: Annotated[Number, Column("Median horizontal velocity error at the end.", better="lower")]
    vertical_median_m: Annotated[Number, Column("Median vertical drift, either way.", better="lower", head="down\n[m]")]
    ratio_to_baseline: Annotated[
        Number,
        Column(
            "Ratio of the root mean squares over the same windows, with its 95 % interval; NaN for the baseline.",
            better="lower",
            head="rms\nratio",
            form="2",
        ),
    ]
    ratio_low: Number
    ratio_high: Number
    windows_won_pct: Annotated[
        Number,
        Column(
            "Windows in which it drifts less than the baseline; a draw counts half.",
            better="higher",
            head="won\n[%]",
            form="0",
        ),
    ]
    nis_per_dof: Annotated[
        Number,
        Column(
            "Mean over windows, of the last withheld velocity; 1 is expected.", head="NIS\n/ dof", form="significant"
        ),
    ]


class DriftRow(Struct, frozen=True):
    """How far one filter is from the reference: half of the time, nearly always, and at worst."""

    about: ClassVar = "One quantity: the errors of a filter against the reference half of the time, mostly, at worst."
    baseline_too: ClassVar = True
    title: ClassVar = "Drift: how far each filter is from the reference"
    footnote: ClassVar = (
        "50 % and 95 % of the sizes stay below; of the position these are CEP50 and CEP95. Drift: what the horizontal "
        "position error changes by over a stretch."
    )

    log: Annotated[str, Column("Dive, filter and quantity: the position, its drift over stretches, or the velocity.")]
    filter: Annotated[str, Column(head="filter")]
    quantity: Annotated[str, _quantity(tuple(DRIFT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the errors.")]
    samples: Annotated[int, Column("Times, or stretches, which overlap, that were compared.")]
    p50: Annotated[
        Number,
        Column(
            "What half and 95 % of the sizes stay below, of the position CEP50 and CEP95; and the root mean square.",
            better="lower",
            primary=True,
            head="50 %",
        ),
    ]
    p95: Annotated[Number, Column(better="lower", head="95 %")]
    rms: Annotated[Number, Column(better="lower", head="rms")]
    worst: Annotated[Number, Column("The largest size.", better="lower", head="worst")]
    worst_from_s: Annotated[
        Number,
        Column("Where it begins and ends, from the start; of the others than drift once.", head="from\n[s]", form="0"),
    ]
    worst_to_s: Annotated[Number, Column(head="to\n[s]", form="0")]
    final: Annotated[Number, Column("The last size.", better="lower")] = None
    distance_m: Annotated[Number, Column("Distance travelled to the last compared position.")] = None
    final_of_distance_pct: Annotated[
        Number, Column("Of the position: the final error in percent of that distance.", better="lower")
    ] = None


class JumpRow(Struct, frozen=True):
    """How often the position of one filter jumps."""

    about: ClassVar = (
        "A filter whose position can jump: the steps of it that neither its velocity nor the steps around explain."
    )
    baseline_too: ClassVar = True
    title: ClassVar = "Jumps: steps of the position that its own velocity does not explain"
    footnote: ClassVar = (
        "What neither the velocity nor one of the three steps before and after explains of a horizontal step; a jump "
        "is more than 0.5 m and ten robust standard deviations of what usually is. Filters that go by their velocity "
        "alone have none."
    )

    log: Annotated[str, Column("Dive and filter: a solution that was read, or one that estimates its position.")]
    filter: Annotated[str, Column(head="filter")]
    steps: Annotated[int, Column("Steps from a horizontal position to the next that were looked at.", head="steps")]
    jumps: Annotated[
        int,
        Column(
            "Those of which more than 0.5 m, and ten robust standard deviations of what usually is, is unexplained.",
            better="lower",
            primary=True,
            head="jumps",
        ),
    ]
    largest_m: Annotated[Number, Column("The most of a step that is unexplained.", better="lower", head="largest\n[m]")]
    largest_at_s: Annotated[Number, Column("Where that step ends, from the start.", head="at\n[s]", form="1")]


class TrackFitRow(Struct, frozen=True):
    """What would lay a filter's track on the reference's."""

    about: ClassVar = "The scale or the turn that would lay a filter's track on the reference's, with standard error."
    baseline_too: ClassVar = True
    title: ClassVar = "Track fit: what would lay each track on the reference's"
    footnote: ClassVar = (
        "Scale: positive where the filter's track is too small. Turn: clockwise from above. Standard errors allow for "
        "noise, and not for a heading that drifts."
    )

    log: Annotated[str, Column("Dive, filter, and scale or turn.")]
    filter: Annotated[str, Column(head="filter")]
    quantity: Annotated[str, _quantity(tuple(TRACK_FIT_QUANTITIES))]
    unit: Annotated[str, _unit("Unit of the two numbers.")]
    fitted: Annotated[
        Number,
        Column(
            "Scale: positive where its track is too small. Turn: clockwise.",
            better="nearer zero",
            primary=True,
            head="fitted",
            form="3",
        ),
    ]
    fitted_sd: Annotated[
        Number,
        Column("Standard error by noise, without a heading that drifts; NaN of a short dive.", head="sd", form="3"),
    ]


class PooledRow(Struct, frozen=True):
    """One piece of evidence on a candidate beside the baseline, over several dives."""

    about: ClassVar = "One piece of evidence on a candidate beside the baseline, over several dives."
    title: ClassVar = "All dives together: {filter} against {baseline}"
    footnote: ClassVar = (
        "geometric mean of the dives' ratios, its 95 % interval over dives, and p, both by Student's t, each dive one "
        "sample; three dives are the fewest that decide"
    )

    log: Annotated[str, Column("Every dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: str
    quantity: Annotated[str, _quantity(EVIDENCE_QUANTITIES)]
    unit: Annotated[str, Column("Unit of the two values, which are medians over the dives.")]
    baseline: Number
    value: Number
    ratio: Annotated[
        Number,
        Column(
            "Geometric mean of the dives' ratios, and its 95 % interval over dives (Student's).",
            "lower",
            primary=True,
            head="ratio",
            form="ratio",
        ),
    ]
    low: Annotated[Number, Column(head="low", form="ratio")]
    high: Annotated[Number, Column(head="high", form="ratio")]
    dives: Annotated[
        int, Column("Dives that have a ratio, and those of them in which the candidate errs less.", head="dives")
    ]
    dives_won: Annotated[int, Column(head="won")]
    p: Annotated[
        Number,
        Column("Of a true difference of at most 5 %, by Student's t: below 0.01 the row decides.", head="p", form="4"),
    ]
    word: Annotated[str, Column(head="word")]


class Tables(Struct, frozen=True):
    """The tables, row for row as in the CSV files; null for what is missing. Early reports lack the last six."""

    improvement: list[ImprovementRow]
    convergence: list[ConvergenceRow]
    reference_error: list[ReferenceErrorRow]
    consistency: list[ConsistencyRow]
    credibility: list[CredibilityRow] = []
    evidence: list[EvidenceRow] = []
    coasting: list[CoastingRow] = []
    drift: list[DriftRow] = []
    track_fit: list[TrackFitRow] = []
    jumps: list[JumpRow] = []


class Candidate(Struct, frozen=True):
    """What there is to say of one candidate."""

    verdict: Annotated[str, Meta(description="one paragraph for people: measured, believed, consistent")]
    improvement: Annotated[
        str,
        Meta(description="better, worse, mixed, equivalent, undecided or not judged, by all evidence"),
        Column(best_first=tuple(Judgement)),
    ]
    consistency: Annotated[
        str,
        Meta(description="the gravest verdict of its measurements"),
        Column(best_first=VERDICTS_BEST_FIRST),
    ]
    mean_improvement_pct: Annotated[
        Number, Meta(description="believed; nine states, without the velocity errors"), Column(better="higher")
    ]
    mean_convergence_improvement_pct: Annotated[
        Number, Meta(description="the same nine; never and at start count 0"), Column(better="higher")
    ]
    reference_improvement_pct: Annotated[
        Number,
        Meta(description="actual; median over the compared quantities"),
        Column(better="higher", primary=True),
    ]
    credibility: Annotated[
        str, Meta(description="the gravest verdict of its errors against the reference, among the groups of states")
    ] = ""
    belief: Annotated[
        str,
        Meta(description="whether what was measured bears out what it believes: borne out, not borne out, undecided"),
        Column(best_first=tuple(Belief)),
    ] = ""
    mean_convergence_unchanged_pct: Annotated[
        Number, Meta(description="the mean convergence improvement that a candidate has which changes nothing")
    ] = None
    mean_nearest_approach_improvement_pct: Annotated[
        Number,
        Meta(description="the same nine; by the nearest approach, as Levy and Klein count"),
        Column(better="higher"),
    ] = None


TABLES: Final[tuple[TableLayout, ...]] = tuple(
    layout_of(name, row) for name, rows in get_type_hints(Tables).items() for row in get_args(rows)
)
CANDIDATES: Final = layout_of("filters", Candidate)
"""The block ``filters`` of a report, read as a table with one row for each candidate."""
LAYOUTS: Final = (CANDIDATES, *TABLES)
"""All that results are compared by, in the order of what a reader asks first."""


def each_table(tables: Tables) -> Iterator[tuple[TableLayout, Sequence[Struct]]]:
    """Yield each table's layout and rows."""
    for layout in TABLES:
        yield layout, getattr(tables, layout.name)
