"""Gates: what must hold of a dive's tables; and what became of each gate on each dive."""

from typing import Annotated, Final

from msgspec import Meta, Struct

from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.words import GateLevel, GateStatus

ANY: Final = "*"
"""Stands for every table, filter or row."""

LOG: Final = "{log}"
"""Stands in the path of a baseline for the dive's name."""

POOLED: Final = "pooled"
"""The table of what all dives say together, as in ``evidence.csv`` beside them."""
TRAJECTORY: Final = "trajectory"
"""What is compared sample by sample."""
EVERY_DIVE: Final = "*"
"""Stands for the name of a dive where all are meant together."""
Allowance = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=100)]


class Gate(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One condition on one column of a table."""

    name: str  # for people; no two gates share it
    table: str  # as in ``report.json``, or ``filters``
    filter: str = ANY
    row: str = ANY  # a state, quantity or measurement
    column: str = ""
    min: float | None = None  # may be reached, as may the maximum
    max: float | None = None
    equals: str | int | float | tuple[str | int | float, ...] | None = None  # the value, or those that it may have
    baseline: str | None = None  # a stored result, seen from the gate file; ``{log}`` stands for the dive's name
    # By how much a value may be worse than the baseline's: in percent of it, or in percentage points where the value is
    # a percentage itself; and in the unit of the value. Of two allowances the larger one counts.
    max_worse_pct: Allowance | None = None
    max_worse_abs: Allowance | None = None
    # By how much samples of a trajectory may differ: by column in its unit; as a share of the largest of its group.
    max_abs: dict[str, Allowance] = {}
    max_rel: Allowance | None = None
    # The band in which a quantity of the trajectory, the row, is to stay: for which share of the samples, for how long
    # it may be outside, at which time alone; else all samples.
    within: tuple[float, float] | None = None
    share_pct: Share | None = None
    longest_outside_s: Allowance | None = None
    at_s: Allowance | None = None
    dives: tuple[str, ...] = ()  # patterns of the names of the dives that are meant; empty for all
    share_of_dives_pct: Share | None = None  # the gate holds if so many of the dives that are meant pass it
    level: GateLevel = GateLevel.ERROR


class GateFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file of gates; its paths are seen from its folder."""

    dives: tuple[str, ...] = ()  # logs, bags, folders, patterns, lists or results
    config: str | None = None  # settings of the replays
    preset: str | None = None
    allow_damaged: bool = False  # use what can be read of damaged logs
    gate: tuple[Gate, ...] = ()


class Finding(Struct, frozen=True):
    """What one cell of a table has to do with a gate."""

    table: str
    filter: str
    row: str
    column: str
    was: Cell  # the baseline's value, if the gate has one
    value: Cell  # None for what is missing
    sentence: str  # what is, and what is wanted
    passed: bool
    unit: str = ""  # of the two values
    allowed: str = ""  # by how much it may be worse than the baseline's


class Judgement(Struct, frozen=True):
    """What became of one gate on one dive."""

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()  # why it is not passed, one sentence each
    findings: tuple[Finding, ...] = ()
    line: int = 0  # where the gate is in its file; 0 if that is not known
    is_trajectory: bool = False  # the gate holds the trajectory against its baseline


class CheckResult(Struct, frozen=True):
    """What became of all gates on all dives."""

    gates: str  # the gate file
    judgements: tuple[Judgement, ...]  # failures first, then in the order of dives and gates
    words: dict[str, dict[str, int]] = {}  # by filter, on how many dives each word is said of it

    def count(self, status: GateStatus) -> int:
        """Count the judgements of a status."""
        return sum(judgement.status == status for judgement in self.judgements)
