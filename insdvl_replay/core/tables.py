"""The tables of a result, once: files, messages, schemas, gates and comparisons are derived from them."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Final, get_args, get_type_hints

from msgspec import Meta, Struct

from insdvl_replay.core.quantities import VERDICTS_BEST_FIRST
from insdvl_replay.core.rows import (
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    EvidenceRow,
    ImprovementRow,
    ReferenceErrorRow,
)
from insdvl_replay.core.table_layout import Column, Number, TableLayout, layout_of
from insdvl_replay.core.track_rows import CoastingRow, DriftRow, JumpRow, TrackFitRow
from insdvl_replay.core.words import Belief, Judgement


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
