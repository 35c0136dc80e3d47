"""What is checked and what is found: dives, the cells and trajectories that gates look at, and the outcomes."""

from pathlib import Path
from typing import Final, NamedTuple

from msgspec import Struct

from insdvl_replay.changes.cells import is_number, prints_the_same
from insdvl_replay.core.report import Cell, StoredReport
from insdvl_replay.core.words import GateStatus

EVERY_DIVE: Final = "*"  # instead of the name of a dive
TRAJECTORY: Final = "trajectory"  # the table of gates that look at samples


class Checked(NamedTuple):
    """The result of a dive, or why there is none, and its folder."""

    result: StoredReport | Exception
    folder: Path

    @property
    def name(self) -> str:
        """Name of the dive."""
        if isinstance(self.result, StoredReport):
            return self.result.log.name
        return self.folder.name


class Finding(Struct, frozen=True):
    """One cell of a table that a gate checks."""

    table: str
    filter: str
    row: str
    column: str
    expected: Cell  # the stored value, if the gate compares with one
    value: Cell  # None if missing
    sentence: str  # the value and the condition
    passed: bool
    unit: str = ""  # of the two values
    limit: str = ""  # allowed loss against the expected value

    @property
    def is_new(self) -> bool:
        """Whether the value prints another number than the expected one; of a trajectory, whether it differs."""
        if self.table == TRAJECTORY:
            return not self.passed
        if is_number(self.expected) and is_number(self.value):
            return not prints_the_same(self.expected, self.value, self.column)
        return self.expected != self.value


class UnexpectedFilter(Finding, frozen=True):
    """A filter whose trajectory is not among the expected ones."""


class GateOutcome(Struct, frozen=True):
    """The outcome of one gate on one dive."""

    dive: str
    gate: str
    status: GateStatus
    reasons: tuple[str, ...] = ()  # why it did not pass, one sentence each
    findings: tuple[Finding, ...] = ()
    line: int = 0  # line of the gate in its file; 0 if unknown
    is_trajectory: bool = False  # the gate compares the trajectory with the expected one
    causes: tuple[str, ...] = ()  # known causes of a failure, one sentence each

    @property
    def explained(self) -> tuple[str, ...]:
        """The reasons, then the known causes."""
        return (*self.reasons, *self.causes)


class CheckResult(Struct, frozen=True):
    """The outcomes of all gates on all dives."""

    gates: str  # the gate file
    outcomes: tuple[GateOutcome, ...]  # failures first, then in the order of dives and gates
    words: dict[str, dict[str, int]] = {}  # by filter, number of dives with each verdict
    elapsed_s: dict[str, float] = {}  # time of the replay, by dive

    def count(self, status: GateStatus) -> int:
        """Count the outcomes of a status."""
        return sum(outcome.status == status for outcome in self.outcomes)
