"""The tables of a result, once: a row type for each, whose columns say what is known of them.

Files, messages, schemas, gates and comparisons are derived from them. Numbers that are missing are NaN as they are
computed, and null, or None, in a report.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, get_args, get_type_hints

from msgspec import Meta, Struct

from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import BA, STATES
from insdvl_replay.core.table_layout import Column, TableLayout, layout_of
from insdvl_replay.core.words import Belief, Consistency, EvidenceWord, Judgement, Whiteness

VERDICTS_BEST_FIRST: Final = (
    Consistency.CONSISTENT,
    Consistency.OVER_CAUTIOUS,
    Consistency.OVER_CONFIDENT,
    Consistency.NOT_FINITE,
)
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


def is_whole(measurement: str) -> bool:
    """Distinguish a whole measurement, which stands for a filter's verdict, from one of its axes, which say where."""
    return not measurement.endswith(tuple(axis_of("", axis) for axis in AXES))


MEASUREMENTS: Final = ("velocity", "acceleration")
"""What filters are aided by."""

Number = float | None
_STATE: Final = Column(names=tuple(state.id for state in STATES))
_REFERENCE_QUANTITY: Final = Column(names=tuple(REFERENCE_QUANTITIES))
_MEASUREMENT: Final = Column(
    names=tuple(row for name in MEASUREMENTS for row in (name, *(axis_of(name, axis) for axis in AXES)))
)
ACCURACY: Final = (
    "drift_30s", "drift_60s", "drift_100m", "velocity_along", "velocity_across", "depth_60s", "level", "heading"
)  # fmt: skip
"""Errors against the reference, the one that decides first."""
COASTING_WINDOWS_S: Final = ("30", "60", "120", "300")
"""Lengths for which the DVL is withheld."""
CONVERGED: Final = ("velocity", "level", "heading")
EVIDENCE_QUANTITIES: Final = (
    *ACCURACY,
    *(f"coasting_{window}s" for window in COASTING_WINDOWS_S),
    *(f"convergence_{name}" for name in CONVERGED),
    "nis",
    "nees",
)
"""Rows of evidence, each name once."""
_EVIDENCE_QUANTITY: Final = Column(names=EVIDENCE_QUANTITIES)
_CREDIBILITY_QUANTITY: Final = Column(names=(*CREDIBILITY_QUANTITIES, JOINT))


class ImprovementRow(Struct, frozen=True):
    """What a candidate believes of one state at the end of the dive, beside the baseline."""

    about: ClassVar = (
        "One state at the end of a dive: how much smaller the candidate's believed standard deviation is than the "
        "baseline's."
    )

    log: Annotated[str, Column("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, Column("Unit of the standard deviations.")]
    baseline_sd: Annotated[Number, Column(better="lower")]
    sd: Annotated[Number, Column(better="lower", primary=True)]
    improvement_pct: Annotated[
        Number, Column("(baseline - candidate) / baseline; NaN where there is none.", better="higher")
    ]
    status: Annotated[str, Column("improved, same, worse or not finite.")]


class ConvergenceRow(Struct, frozen=True):
    """When a candidate became, and stayed, as sure of one state as the baseline is at the end."""

    about: ClassVar = (
        "One state: how much sooner the candidate reaches for good the standard deviation that the baseline ends with."
    )

    log: Annotated[str, Column("Dive, candidate and state.")]
    filter: str
    state: Annotated[str, _STATE]
    unit: Annotated[str, Column("Unit of the standard deviation to reach.")]
    target_sd: Annotated[Number, Column(better="lower")]
    baseline_s: Annotated[
        Number,
        Column("Times from the start at which the baseline and the candidate have it; NaN for never.", better="lower"),
    ]
    reached_s: Annotated[Number, Column(better="lower", primary=True)]
    improvement_pct: Annotated[Number, Column(better="higher")]
    status: Annotated[str, Column("reached, at_start or never.")]
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


class ReferenceErrorRow(Struct, frozen=True):
    """How far a candidate is from the reference in one quantity, beside the baseline."""

    about: ClassVar = "One quantity: errors of the baseline and of the candidate against the reference solution."

    log: Annotated[str, Column("Dive, candidate and quantity.")]
    filter: str
    quantity: Annotated[str, _REFERENCE_QUANTITY]
    unit: Annotated[str, Column("Unit of the errors.")]
    baseline_rmse: Annotated[Number, Column("Root mean square over the dive.", better="lower")]
    rmse: Annotated[Number, Column(better="lower", primary=True)]
    improvement_pct: Annotated[Number, Column(better="higher")]
    baseline_final: Annotated[Number, Column("At the last reference time, with its sign.", better="nearer zero")]
    final: Annotated[Number, Column(better="nearer zero")]
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

    log: Annotated[str, Column("Dive, filter, and measurement such as velocity, or an axis of it such as velocity_x.")]
    filter: str
    measurement: Annotated[str, _MEASUREMENT]
    dof: Annotated[int, Column("Degrees of freedom of one innovation.")]
    used: int
    rejected: Annotated[int, Column(better="lower")]
    mean_nis: Annotated[
        Number,
        Column(
            "Mean normalised innovation squared, and the interval in which 95 % of consistent filters have it.",
            better="nearer dof",
            primary=True,
        ),
    ]
    low: Number
    high: Number
    verdict: Annotated[
        str,
        Column("consistent, over-confident, over-cautious, too few or not finite.", best_first=VERDICTS_BEST_FIRST),
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


class CredibilityRow(Struct, frozen=True):
    """Whether a filter's errors against the reference, or the truth, are as large as it says."""

    about: ClassVar = (
        "One quantity: are the errors of a filter against the reference, or the truth, as large as the filter expects?"
    )
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive, filter and quantity; the quantity all is every compared state together.")]
    filter: str
    quantity: Annotated[str, _CREDIBILITY_QUANTITY]
    dof: Annotated[int, Column("Degrees of freedom of one error, and the times that were compared.")]
    samples: int
    mean_nees: Annotated[
        Number,
        Column(
            "Mean normalised error squared, and the interval in which 95 % of consistent filters have it.",
            better="nearer dof",
            primary=True,
        ),
    ]
    low: Number
    high: Number
    within_1sd_pct: Annotated[
        Number,
        Column("Share of the errors within one and three standard deviations; 68.3 % and 99.7 % are expected."),
    ]
    within_3sd_pct: Number
    verdict: Annotated[
        str,
        Column(
            "consistent, over-confident, over-cautious, too few, not finite, not in reference or no reference.",
            best_first=VERDICTS_BEST_FIRST,
        ),
    ]
    effective_samples: Annotated[Number, Column("How many independent samples the compared times are worth.")]


class EvidenceRow(Struct, frozen=True):
    """One piece of evidence: a candidate beside the baseline in one quantity, with its interval and a word."""

    about: ClassVar = "One piece of evidence on a candidate beside the baseline: what was measured, and what it says."

    log: Annotated[str, Column("Dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: Annotated[str, Column("accuracy, coasting, convergence or honesty.")]
    quantity: Annotated[str, _EVIDENCE_QUANTITY]
    unit: Annotated[str, Column("Unit of the two values.")]
    baseline: Annotated[
        Number, Column("What the baseline and the candidate have: a root mean square, or a median.", better="lower")
    ]
    value: Annotated[Number, Column(better="lower")]
    ratio: Annotated[
        Number,
        Column("Candidate over baseline, and the interval that holds it with 95 %.", better="lower", primary=True),
    ]
    low: Number
    high: Number
    effective_samples: Annotated[Number, Column("How many independent values the dive holds.")]
    starts: Annotated[
        int, Column("Starts that were replayed, and stretches of the dive or windows that were compared.")
    ]
    windows: int
    word: Annotated[
        str,
        Column(
            "better, worse, equivalent or undecided; empty where the filter is not judged.",
            best_first=(EvidenceWord.BETTER, EvidenceWord.EQUIVALENT, EvidenceWord.UNDECIDED, EvidenceWord.WORSE),
        ),
    ]


class CoastingRow(Struct, frozen=True):
    """How far a filter drifts in some time without velocities, beside the baseline."""

    about: ClassVar = (
        "Windows of one length in which every velocity was withheld from a filter: how far it went astray by what the "
        "withheld velocities say. Blind to heading, to the DVL's scale and to its mounting about down."
    )
    baseline_too: ClassVar = True

    log: Annotated[str, Column("Dive, filter and length of the windows.")]
    filter: str
    window_s: Annotated[str, Column(names=COASTING_WINDOWS_S)]
    windows: Annotated[int, Column("Windows that do not overlap, and those left out since DVL or IMU fell silent.")]
    left_out: int
    drift_median_m: Annotated[
        Number,
        Column(
            "Horizontal drift at the end of a window: median, root mean square and 95th percentile, which of fewer "
            "than 20 windows is nearly the largest.",
            better="lower",
            primary=True,
        ),
    ]
    drift_rms_m: Annotated[Number, Column(better="lower")]
    drift_p95_m: Annotated[Number, Column(better="lower")]
    drift_of_distance_pct: Annotated[
        Number, Column("Median over windows; NaN where the vehicle hardly moved.", better="lower")
    ]
    end_velocity_mps: Annotated[Number, Column("Median horizontal velocity error at the end.", better="lower")]
    vertical_median_m: Annotated[Number, Column("Median vertical drift, either way.", better="lower")]
    ratio_to_baseline: Annotated[
        Number,
        Column(
            "Median ratio of the drifts in the same windows, with its 95 % interval; NaN for the baseline.",
            better="lower",
        ),
    ]
    ratio_low: Number
    ratio_high: Number
    windows_won_pct: Annotated[
        Number, Column("Windows in which it drifts less than the baseline; a draw counts half.", better="higher")
    ]
    nis_per_dof: Annotated[Number, Column("Mean over windows, of the last withheld velocity; 1 is expected.")]


class Tables(Struct, frozen=True):
    """The tables, row for row as in the CSV files; null for what is missing. Early reports lack the last three."""

    improvement: list[ImprovementRow]
    convergence: list[ConvergenceRow]
    reference_error: list[ReferenceErrorRow]
    consistency: list[ConsistencyRow]
    credibility: list[CredibilityRow] = []
    evidence: list[EvidenceRow] = []
    coasting: list[CoastingRow] = []


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
    credibility: Annotated[str, Meta(description="the gravest verdict of its errors against the reference")] = ""
    belief: Annotated[
        str,
        Meta(description="whether what was measured bears out what it believes: borne out, not borne out, undecided"),
        Column(best_first=tuple(Belief)),
    ] = ""


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


def finite(number: Number) -> float:
    """Return a number of a row, NaN where it is missing or not finite."""
    return math.nan if number is None or not math.isfinite(number) else number


Cell = str | int | float | bool | None
Row = dict[str, Cell]


class StoredLog(Struct, frozen=True):
    """What was replayed. Of an old result, what it does not say is empty."""

    name: str
    sha256: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    duration_s: float | None = None
    channels: list[dict[str, Cell]] = []


class StoredReport(Struct, frozen=True):
    """The blocks of a report.json, with whatever rows and columns they hold."""

    tool: dict[str, Cell]
    log: StoredLog
    tables: dict[str, list[Row]]
    versions: dict[str, str] = {}
    baseline: str = ""
    filters: dict[str, Row] = {}
    notes: list[Note] = []
    config: dict[str, Any] = {}


@dataclass(frozen=True)
class StoredResult:
    """One result and where it lies.

    Attributes
    ----------
    folder : Path
        That holds the report.
    below : str
        The same, seen from the folder that was searched; ``.`` for that folder itself.
    """

    folder: Path
    below: str
    report: StoredReport

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.report.log.name
