"""Gates: what must hold of a dive's tables; and what became of each gate on each dive."""

from typing import Annotated, Final

from msgspec import Meta, Struct

from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.words import GateLevel, GateStatus

ANY: Final = "*"
"""Stands for every table, filter or row."""

LOG: Final = "{log}"
"""Stands in the path of a baseline for the dive's name."""

Allowance = Annotated[float, Meta(ge=0)]


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
    """

    name: str
    table: str
    filter: str = ANY
    row: str = ANY
    column: str
    min: float | None = None
    max: float | None = None
    equals: str | int | float | tuple[str | int | float, ...] | None = None
    baseline: str | None = None
    max_worse_pct: Allowance | None = None
    max_worse_abs: Allowance | None = None
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
    """

    table: str
    filter: str
    row: str
    column: str
    was: Cell
    value: Cell
    sentence: str
    passed: bool


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
    """

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    line: int = 0


class CheckResult(Struct, frozen=True):
    """What became of all gates on all dives.

    Attributes
    ----------
    gates : str
        The gate file.
    judgements : tuple of Judgement
        Failures first, then in the order of dives and gates.
    """

    gates: str
    judgements: tuple[Judgement, ...]

    def count(self, status: GateStatus) -> int:
        """Count the judgements of a status."""
        return sum(judgement.status == status for judgement in self.judgements)
