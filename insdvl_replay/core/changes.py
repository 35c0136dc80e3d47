"""What moved between two sets of results, as data.

The comparison finds it out and shows it.
"""

from dataclasses import dataclass, field

from insdvl_replay.core.errors import Note
from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.words import ChangeWord, MatchedBy

Counts = dict[ChangeWord, int]


@dataclass(frozen=True)
class Difference:
    """One thing that differs beside the tables: a reason why a number may have moved.

    Attributes
    ----------
    block : str
        ``tool``, ``versions``, ``config``, ``log``, ``filters`` or ``notes``.
    key : str
        Dotted, as on the command line.
    old, new : str or None
        As in TOML; None where a side does not have it.
    logs : tuple of str
        The dives it concerns.
    """

    block: str
    key: str
    old: str | None
    new: str | None
    logs: tuple[str, ...]


@dataclass(frozen=True)
class Change:
    """One cell of a table, before and after.

    Attributes
    ----------
    log, table, filter, row, unit, column : str
        Where it stands, and the unit of its numbers, empty where they have none.
    old, new : str, number or None
        None where it is missing.
    change : float or None
        New minus old; None for words and where a side is missing.
    change_pct : float or None
        By how much its size grew: of the value itself, of its magnitude (``nearer zero``), or of its distance from
        ``dof`` as a ratio. For columns that are percentages, in percentage points. None where there is no percentage.
    """

    log: str
    table: str
    filter: str
    row: str
    unit: str
    column: str
    old: Cell
    new: Cell
    change: float | None
    change_pct: float | None
    word: ChangeWord


@dataclass(frozen=True)
class Tally:
    """What became of many cells.

    Attributes
    ----------
    counts : dict of str to int
        Cells by word; every word has a count.
    worst, best : Change or None
        The largest loss and the largest gain by percent, in the chief column of a table before all others; None where
        nothing is worse, or better.
    """

    counts: Counts
    worst: Change | None
    best: Change | None


@dataclass(frozen=True)
class DiveComparison:
    """One dive and its counterpart.

    Attributes
    ----------
    log : str
        Name of the dive, the new one where the two differ.
    old, new : str or None
        Folders of the results; None where a side does not have the dive.
    tally : Tally or None
        None for a dive without counterpart.
    """

    log: str
    old: str | None
    new: str | None
    matched_by: MatchedBy
    tally: Tally | None


@dataclass(frozen=True)
class Aggregate:
    """One cell over all dives that have it on both sides.

    Attributes
    ----------
    better, worse, same : int
        Dives by word.
    share_better_pct : float
        ``100 better / dives``.
    median_change_pct : float or None
        Median of `Change.change_pct` over the dives that have one; None if none has.
    worst_log : str
        The dive in which it lost most, or gained least.
    worst_change_pct : float or None
        Its change there; None where the number was lost, or grew from zero.
    worst_word : str
        What it is there.
    """

    table: str
    filter: str
    row: str
    unit: str
    column: str
    dives: int
    better: int
    worse: int
    same: int
    share_better_pct: float
    median_change_pct: float | None
    worst_log: str
    worst_change_pct: float | None
    worst_word: ChangeWord


@dataclass(frozen=True)
class Comparison:
    """Two sets of results, and all that differs.

    Attributes
    ----------
    old, new : str
        As they were named.
    tolerance_pct : float or None
        Up to which a change counts as ``same``; None: up to the last printed digit.
    total : Tally
        Of all dives.
    by_table : dict of str to Tally
        Likewise, for each table.
    baseline : str
        Name of the filter that the candidates of the new results are held against; the first, if there are several.
    """

    old: str
    new: str
    tolerance_pct: float | None
    total: Tally
    by_table: dict[str, Tally]
    differences: tuple[Difference, ...]
    dives: tuple[DiveComparison, ...]
    aggregates: tuple[Aggregate, ...]
    changes: tuple[Change, ...]
    notes: tuple[Note, ...] = field(default=())
    baseline: str = ""


@dataclass(frozen=True)
class Limit:
    """What is not allowed.

    Attributes
    ----------
    word : str
        ``worse``, which includes what is gone, or ``changed``, which is anything but the same.
    above_pct : float
        Losses up to here are allowed, in percent; percentage points where the number is a percentage. A verdict that
        fell, a number that was lost or grew from zero, and a row that is gone exceed every limit.
    """

    word: ChangeWord
    above_pct: float = 0.0


@dataclass(frozen=True)
class Violation:
    """What exceeds a limit.

    Attributes
    ----------
    count : int
        Cells.
    worst : Change or None
        The largest loss of them, as in `Tally`; None where only dives are missing.
    dives : tuple of str
        Dives without counterpart.
    """

    limit: Limit
    count: int
    worst: Change | None
    dives: tuple[str, ...]
