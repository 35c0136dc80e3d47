"""The rows of what several dives say together: no table of one result, and written beside them."""

from typing import Annotated, ClassVar

from msgspec import Struct

from insdvl_replay.core.quantities import EVIDENCE_QUANTITIES
from insdvl_replay.core.table_layout import Column, Number


class PooledRow(Struct, frozen=True):
    """One piece of evidence on a candidate beside the baseline, over several dives."""

    about: ClassVar = "One piece of evidence on a candidate beside the baseline, over several dives."

    log: Annotated[str, Column("Every dive, candidate, kind of evidence and quantity.")]
    filter: str
    evidence: str
    quantity: Annotated[str, Column(names=EVIDENCE_QUANTITIES)]
    unit: Annotated[str, Column("Unit of the two values, which are medians over the dives.")]
    baseline: Number
    value: Number
    ratio: Annotated[
        Number,
        Column(
            "Geometric mean of the dives' ratios, and its 95 % interval over dives (Student's).", "lower", primary=True
        ),
    ]
    low: Number
    high: Number
    dives: Annotated[int, Column("Dives that have a ratio, and those of them in which the candidate errs less.")]
    dives_won: int
    p: Annotated[Number, Column("Of a true difference of at most 5 %, by Student's t: below 0.01 the row decides.")]
    word: str
