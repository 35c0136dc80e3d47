"""The gate file: conditions on a dive's tables and its trajectory."""

import fnmatch
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import PROSE, RowPair, paired_rows
from insdvl_replay.changes.findings import TRAJECTORY
from insdvl_replay.core.config_file import LARGEST, SECTIONS, converted, read_toml
from insdvl_replay.core.errors import (
    ConfigError,
    error_context,
    hint_for,
    is_writable,
    listed,
    looked_for,
    require_known,
)
from insdvl_replay.core.path_kinds import require_kind_of_toml
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.states import COLUMNS, GROUPS
from insdvl_replay.core.tables import ANSWERS, CANDIDATES, TABLES, PooledRow, layout_of
from insdvl_replay.core.words import GateLevel, known_words

ANY: Final = "*"  # every filter or row
LOG: Final = "{log}"  # in the path of expected values, the dive's name
POOLED: Final = "pooled"  # the table of the evidence pooled over all dives, as in the ``evidence.csv`` of several dives
OVER_DIVES: Final = (ANSWERS.name, POOLED)
EXAMPLE: Final = 'table = "improvement", row = "ba_z", column = "improvement_pct", min = 40'
ON_TRAJECTORY: Final = (
    'expected = "expected/{log}.npz", or within = [0.0, 2.0] with share_pct = 95'
)
LAYOUTS: Final = {
    layout.name: layout
    for layout in (
        *TABLES,
        CANDIDATES,
        ANSWERS,
        layout_of(POOLED, PooledRow),
    )
}
Limit = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # finite
Allowance = Annotated[float, Meta(ge=0, le=LARGEST)]
Share = Annotated[float, Meta(ge=0, le=100)]


class Gate(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What gates on cells and on the trajectory have in common."""

    name: str  # unique
    table: str
    filter: str = ANY
    row: str = ANY
    # stored values, relative to the gate file; ``{log}`` is the dive's name
    expected: str | None = None
    dives: tuple[str, ...] = ()  # name patterns of the dives to check; empty for all
    share_of_dives_pct: Share | None = None  # the gate passes if this share of the dives passes it
    level: GateLevel = GateLevel.ERROR

    def applies_to(self, dive: str) -> bool:
        """Return whether it applies to a dive, by its name."""
        return not self.dives or any(fnmatch.fnmatchcase(dive, pattern) for pattern in self.dives)


class CellGate(Gate, frozen=True, kw_only=True):
    """A condition on a column of a table: as in ``report.json``, ``filters``, or over all dives."""

    column: str
    min: Limit | None = None  # inclusive, as the maximum
    max: Limit | None = None
    # the allowed value or values
    equals: str | int | float | tuple[str | int | float, ...] | None = None
    # Allowed loss against the expected value: in percent, or in percentage points if the value is a percentage; and in
    # the unit of the value. The larger of the two counts.
    max_worse_pct: Allowance | None = None
    max_worse_abs: Allowance | None = None

    @property
    def wanted(self) -> tuple[str | int | float, ...]:
        """The allowed values."""
        if isinstance(self.equals, tuple):
            return self.equals
        if self.equals is None:
            return ()
        return (self.equals,)

    def rows_of(self, old: StoredReport | None, new: StoredReport) -> Iterator[RowPair]:
        """Yield the rows that it checks, each with the expected one."""
        for pair in paired_rows(old, new, [LAYOUTS[self.table]]):
            if self.filter in (ANY, pair.filter) and self.row in (ANY, pair.row):
                yield pair


class TrajectoryGate(Gate, frozen=True, kw_only=True):
    """A condition on the samples of a trajectory: they are the expected ones, or a quantity (row) is in a band."""

    # Allowed difference of samples: by column in its unit; relative to the largest value of its group.
    max_abs: dict[str, Allowance] = {}
    max_rel: Allowance | None = None
    # The band holds for a share of the samples, with a longest time outside, or at one time; else for all samples.
    within: tuple[float, float] | None = None
    share_pct: Share | None = None
    longest_outside_s: Allowance | None = None
    at_s: Allowance | None = None


class GateFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file of gates; its paths are relative to its folder."""

    dives: tuple[str, ...] = ()  # logs, bags, folders, patterns, lists or results
    config: str | None = None  # settings of the replays
    preset: str | None = None
    allow_damaged: bool = False  # use what can be read of damaged logs
    gate: tuple[dict[str, Any], ...] = ()


class Gates(Struct, frozen=True):
    """A gate file that was read."""

    path: Path
    content: GateFile
    gates: tuple[CellGate | TrajectoryGate, ...]
    lines: dict[str, int]  # first line of a gate, by name; empty if unknown

    def where(self, gate: Gate) -> str:
        """Name a gate and its place, for messages."""
        line = self.lines.get(gate.name)
        return f"{self.path}{f':{line}' if line else ''}: gate '{gate.name}'"


def load_gates(path: Path) -> Gates:
    """Read a gate file; ConfigError where a key, a value or a combination of them is wrong, or no gate is active."""
    if not is_writable(str(path)):
        raise ConfigError(f"{path}: its name is not UTF-8", "rename it")
    source = read_toml(
        path,
        f"for example {EXAMPLE}",
        if_unreadable="name a file of gates",
        if_invalid=f"[[gate]] {EXAMPLE}",
    )
    require_kind_of_toml(path, source.content, "gates", SECTIONS)
    content = converted(source.content, GateFile, source)
    gates = list[CellGate | TrajectoryGate]()
    for number, table in enumerate(content.gate, 1):
        kind: type[CellGate | TrajectoryGate] = (
            TrajectoryGate if table.get("table") == TRAJECTORY else CellGate
        )
        gates.append(converted(table, kind, source, label=f"gate {number}"))
    names = [gate.name for gate in gates]
    for name, times in Counter(names).items():
        if times > 1:
            raise ConfigError(
                f"two gates have the name '{name}'", "give each gate its own name", source.name
            )
    if all(gate.level == GateLevel.OFF for gate in gates):
        raise ConfigError(
            "no gate is active",
            f"add [[gate]] with {EXAMPLE}, or set a level to error",
            source.name,
        )
    found = Gates(path, content, tuple(gates), _first_lines(names, source.text))
    for gate in gates:
        with error_context(found.where(gate)):
            if isinstance(gate, CellGate):
                _check_cell_gate(gate)
            else:
                _check_trajectory_gate(gate)
    return found


def _first_lines(names: Sequence[str], text: str) -> dict[str, int]:
    """Return the first line of each gate, by name; empty where they cannot be told, as of gates in a row."""
    lines = list[int]()
    for number, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith("[[gate]]"):
            lines.append(number)
    if len(lines) == len(names):
        return dict(zip(names, lines, strict=True))
    return {}


def settings_of(gates: Gates) -> list[Path]:
    """Return the file of settings that a gate file names, relative to its own folder, if it names one."""
    if gates.content.config is None:
        return []
    named = gates.path.parent / gates.content.config
    with looked_for(named):
        if not named.is_file():
            text = f"{gates.path}: config names {named}, which is not a file"
            raise ConfigError(text, "paths are relative to the gate file")
    return [named]


def chosen_gates(gates: Gates, only: Sequence[str], skip: Sequence[str]) -> Gates:
    """Keep the gates whose names match a pattern of ``only`` and none of ``skip``."""
    wanted = set[str]()
    for pattern in only or ["*"]:
        wanted.update(_names_like(pattern, gates))
    for pattern in skip:
        wanted.difference_update(_names_like(pattern, gates))
    if not wanted:
        raise ConfigError(f"{gates.path}: no gate is left", "leave out --skip, or widen --only")
    return replace(gates, gates=tuple(gate for gate in gates.gates if gate.name in wanted))


def _names_like(pattern: str, gates: Gates) -> list[str]:
    """Return the names of gates that match a pattern; a ConfigError where none does."""
    names = [gate.name for gate in gates.gates]
    found = fnmatch.filter(names, pattern)
    if not found:
        raise ConfigError(
            f"{gates.path}: no gate has the name '{pattern}'", f"gates: {listed(names)}"
        )
    return found


def require_known_filters(
    gates: Gates,
    filters: Sequence[str],  # of the replays, the baseline first
) -> None:
    """Raise a ConfigError, with line and nearest name, if a gate is about a filter that no replay has."""
    baseline, *candidates = filters
    for gate in gates.gates:
        with error_context(gates.where(gate)):
            require_known("filter", gate.filter, [ANY, *filters])
            if (
                isinstance(gate, CellGate)
                and gate.filter == baseline
                and not LAYOUTS[gate.table].baseline_too
            ):
                raise ConfigError(
                    f"filter '{baseline}' is the baseline, which has no rows in {gate.table}",
                    f"name a candidate: {', '.join(candidates)}; its rows also have columns of the baseline",
                )
            if gate.table == CANDIDATES.name:
                require_known("filter", gate.row, [ANY, *candidates])


def _check_trajectory_gate(gate: TrajectoryGate) -> None:
    """Raise for keys that do not go together, and for unknown quantities."""
    if (gate.within is None) == (gate.expected is None):
        raise ConfigError("needs either expected or within", ON_TRAJECTORY)
    require_known("row", gate.row, COLUMNS if gate.within else [ANY, *GROUPS, *COLUMNS])
    if gate.within and not gate.within[0] <= gate.within[1]:
        raise ConfigError(f"within = {list(gate.within)} contains no value", "exchange its ends")
    for column in gate.max_abs:
        require_known("max_abs", column, COLUMNS)


def _check_cell_gate(gate: CellGate) -> None:
    """Raise for keys that do not go together, for unknown names, and for conditions that no value can meet."""
    require_known("table", gate.table, [TRAJECTORY, *LAYOUTS])
    _check_place(gate)
    _check_conditions(gate)
    _check_expectation(gate)


def _column_of(gate: CellGate) -> str:
    """Name the column of a gate, for messages."""
    return f"column '{gate.column}' of {gate.table}"


def _check_place(gate: CellGate) -> None:
    """Raise if the table has no such column or row, or none that a gate may look at."""
    layout = LAYOUTS[gate.table]
    others = ("log", "filter", layout.key, *PROSE)
    known = [name for name in layout.columns if name not in others]
    if gate.column in PROSE:
        text = f"{_column_of(gate)} is prose, and another version may word it differently"
        raise ConfigError(text, f"columns for gates: {listed(known, len(known))}")
    require_known("column", gate.column, known)
    if layout is not CANDIDATES:  # its rows are the candidates
        require_known(layout.key, gate.row, [ANY, *layout.rows])


def _check_conditions(gate: CellGate) -> None:
    """Raise without a condition, and for limits and words that no value of the column can meet."""
    if gate.min is None and gate.max is None and not gate.wanted and gate.expected is None:
        raise ConfigError("has no condition", "add min, max, equals or expected")
    if gate.min is not None and gate.max is not None and gate.min > gate.max:
        raise ConfigError(
            f"min = {gate.min:g} is above max = {gate.max:g}", "exchange min and max"
        )
    has_words = LAYOUTS[gate.table].kinds[gate.column] == "text"
    has_limits = gate.min is not None or gate.max is not None
    if has_words and has_limits:
        raise ConfigError(f"{_column_of(gate)} contains words, which have no limits", "use equals")
    if gate.wanted and not any(isinstance(value, str) == has_words for value in gate.wanted):
        content = "words" if has_words else "numbers"
        raise ConfigError(f"equals: {_column_of(gate)} contains {content}, found {gate.equals!r}")
    _check_words(gate)


def _check_words(gate: CellGate) -> None:
    """Raise for a word that no result has, if the column has words of an enumeration."""
    ranked = LAYOUTS[gate.table].words.get(gate.column, ())
    if not ranked:
        return
    possible = known_words()
    for value in gate.wanted:
        if value not in possible:
            raise ConfigError(
                f"equals: {_column_of(gate)} never is {value!r}", hint_for(str(value), ranked)
            )


def _check_expectation(gate: CellGate) -> None:
    """Raise if a value cannot be compared with an expected one in the way that the gate asks for."""
    has_allowance = gate.max_worse_pct is not None or gate.max_worse_abs is not None
    if (gate.expected is not None) != has_allowance:
        text = "expected needs max_worse_pct or max_worse_abs, and these need expected"
        raise ConfigError(text, 'expected = "expected/{log}.json" with max_worse_pct = 5')
    is_of_dives = gate.expected is not None or gate.share_of_dives_pct is not None or gate.dives
    if gate.table in OVER_DIVES and is_of_dives:
        text = (
            f"table {gate.table} is over all dives: it has no expected values and no single dives"
        )
        raise ConfigError(text, "min, max or equals")
    if gate.expected is None:
        return
    unknown = re.findall(r"\{.*?\}", gate.expected.replace(LOG, ""))
    if unknown:
        raise ConfigError(f"expected: {unknown[0]} is not known", f"use {LOG} for the dive's name")
    better = LAYOUTS[gate.table].better
    if gate.column not in better:
        raise ConfigError(
            f"{_column_of(gate)} has no better or worse direction, so it cannot be compared with an expected value",
            f"name one of {', '.join(better)}, or give equals, min or max",
        )
