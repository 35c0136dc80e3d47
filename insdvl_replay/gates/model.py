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
    """One condition on one column of a table.

    Attributes
    ----------
    name : str
        For people; no two gates share it.
    table : str
        As in ``report.json``, or ``filters``.
    row : str
        A state, quantity or measurement.
    min, max : float, optional
        Limits that may be reached.
    equals : str, number or tuple of them, optional
        The value, or those that it may have.
    baseline : str, optional
        Path of a stored result, seen from the gate file; ``{log}`` stands for the dive's name.
    max_worse_pct : float, optional
        By how much a value may be worse than the baseline's, in percent of it; in percentage points where the value is
        a percentage itself.
    max_worse_abs : float, optional
        The same in the unit of the value. Of two allowances the larger one counts.
    max_abs, max_rel : optional
        By how much samples of a trajectory may differ: by column in its unit; as a share of the largest of its group.
    within : tuple of float, optional
        The band in which a quantity of the trajectory, the row, is to stay.
    share_pct, longest_outside_s, at_s : float, optional
        For which share of the samples; for how long it may be outside; at which time alone. Else all samples.
    dives : tuple of str
        Patterns of the names of the dives that are meant; empty for all.
    share_of_dives_pct : float, optional
        The gate holds if so many of the dives that are meant pass it.
    """

    name: str
    table: str
    filter: str = ANY
    row: str = ANY
    column: str = ""
    min: float | None = None
    max: float | None = None
    equals: str | int | float | tuple[str | int | float, ...] | None = None
    baseline: str | None = None
    max_worse_pct: Allowance | None = None
    max_worse_abs: Allowance | None = None
    max_abs: dict[str, Allowance] = {}
    max_rel: Allowance | None = None
    within: tuple[float, float] | None = None
    share_pct: Share | None = None
    longest_outside_s: Allowance | None = None
    at_s: Allowance | None = None
    dives: tuple[str, ...] = ()
    share_of_dives_pct: Share | None = None
    level: GateLevel = GateLevel.ERROR


class GateFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file of gates.

    Attributes
    ----------
    dives : tuple of str
        Logs, bags, folders, patterns, lists or results, seen from the file's folder.
    config : str, optional
        Settings of the replays, seen from the file's folder.
    allow_damaged : bool
        Use what can be read of damaged logs.
    """

    dives: tuple[str, ...] = ()
    config: str | None = None
    preset: str | None = None
    allow_damaged: bool = False
    gate: tuple[Gate, ...] = ()


class Finding(Struct, frozen=True):
    """What one cell of a table has to do with a gate.

    Attributes
    ----------
    table, filter, row, column : str
        Where it stands.
    was : str, number or None
        The baseline's value, if the gate has one.
    value : str, number or None
        None for what is missing.
    sentence : str
        What is, and what is wanted.
    unit : str
        Of the two values.
    allowed : str
        By how much it may be worse than the baseline's.
    """

    table: str
    filter: str
    row: str
    column: str
    was: Cell
    value: Cell
    sentence: str
    passed: bool
    unit: str = ""
    allowed: str = ""


class Judgement(Struct, frozen=True):
    """What became of one gate on one dive.

    Attributes
    ----------
    dive, gate : str
        Their names.
    reasons : tuple of str
        Why it is not passed, one sentence each.
    line : int
        Where the gate stands in its file; 0 if that is not known.
    is_trajectory : bool
        The gate holds the trajectory against its baseline.
    """

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    line: int = 0
    is_trajectory: bool = False


class CheckResult(Struct, frozen=True):
    """What became of all gates on all dives.

    Attributes
    ----------
    gates : str
        The gate file.
    judgements : tuple of Judgement
        Failures first, then in the order of dives and gates.
    words : dict of str to dict of str to int
        By filter, on how many dives each word is said of it.
    """

    gates: str
    judgements: tuple[Judgement, ...]
    words: dict[str, dict[str, int]] = {}

    def count(self, status: GateStatus) -> int:
        """Count the judgements of a status."""
        return sum(judgement.status == status for judgement in self.judgements)
