"""The rows of the tables, a type for each table, whose columns say what is known of them.

Numbers that are missing are NaN as they are computed, and null, or None, in a report.
"""

from typing import Annotated, ClassVar, Final

from msgspec import Struct

from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CREDIBILITY_QUANTITIES,
    EVIDENCE_QUANTITIES,
    JOINT,
    MEASUREMENTS,
    POSITION_QUANTITIES,
    REFERENCE_QUANTITIES,
    VERDICTS_BEST_FIRST,
    axis_of,
)
from insdvl_replay.core.states import STATES
from insdvl_replay.core.table_layout import Column, Number
from insdvl_replay.core.words import EvidenceWord, Whiteness

_WHY: Final = Column("Why the verdict is not what the interval says, if it is not.")
_STATE: Final = Column(names=tuple(state.id for state in STATES))
_REFERENCE_QUANTITY: Final = Column(names=tuple(REFERENCE_QUANTITIES))
_MEASUREMENT: Final = Column(
    names=tuple(row for name, axes in MEASUREMENTS.items() for row in (name, *(axis_of(name, axis) for axis in axes)))
)
_EVIDENCE_QUANTITY: Final = Column(names=EVIDENCE_QUANTITIES)
_CREDIBILITY_QUANTITY: Final = Column(
    names=(*CREDIBILITY_QUANTITIES, *POSITION_QUANTITIES, *ALL_CREDIBILITY_GROUPS, JOINT)
)


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
    unchanged_s: Annotated[
        Number,
        Column("Time at which the baseline itself came to stay there, and a candidate does that changes nothing."),
    ] = None
    nearest_approach_s: Annotated[
        Number,
        Column(
            "When the candidate's standard deviation is nearest to the target: Levy and Klein's time.", better="lower"
        ),
    ] = None
    nearest_approach_improvement_pct: Annotated[Number, Column(better="higher")] = None


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
        Column(
            "consistent, over-confident, over-cautious, too few, not finite; not told of a filter without the states "
            "that a withheld sensor needs.",
            best_first=VERDICTS_BEST_FIRST,
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

    log: Annotated[str, Column("Dive, filter, and a quantity or group of them; all is every compared state together.")]
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
    why: Annotated[str, _WHY] = ""


class EvidenceRow(Struct, frozen=True):
    """One piece of evidence: a candidate beside the baseline in one quantity, with its interval and a word."""

    about: ClassVar = "One piece of evidence on a candidate beside the baseline: what was measured, and what it says."

    log: Annotated[str, Column("Dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: Annotated[str, Column("accuracy, coasting, withheld, track, convergence or honesty.")]
    quantity: Annotated[str, _EVIDENCE_QUANTITY]
    unit: Annotated[str, Column("Unit of the two values.")]
    baseline: Annotated[
        Number,
        Column(
            "What the baseline and the candidate have on this dive, from its own start: a root mean square, a final "
            "error, or the time of convergence from drawn starts.",
            better="lower",
        ),
    ]
    value: Annotated[Number, Column(better="lower")]
    ratio: Annotated[
        Number,
        Column(
            "Candidate over baseline, of accuracy over all drawn starts, and its 95 % interval on this dive: other "
            "dives may differ by more.",
            better="lower",
            primary=True,
        ),
    ]
    low: Number
    high: Number
    effective_samples: Annotated[Number, Column("How many independent values the ratio and its interval rest on.")]
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
    p: Annotated[
        Number,
        Column("Of a true difference of at most 5 %, by Student's t or by drawn starts: below 0.01 the row decides."),
    ] = None
    why: Annotated[str, Column("What keeps the row from deciding, if it is not the interval.")] = ""
