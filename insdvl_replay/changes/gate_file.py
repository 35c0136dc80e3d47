"""The gate file: conditions on a dive's tables and its trajectory, read from TOML."""

import fnmatch
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import PROSE
from insdvl_replay.core.config_file import converted, read_toml, toml_value
from insdvl_replay.core.errors import ConfigError, error_context, is_writable, listed, require_known
from insdvl_replay.core.result import Row
from insdvl_replay.core.states import COLUMNS, GROUPS
from insdvl_replay.core.tables import CANDIDATES, TABLES, PooledRow, TableLayout, layout_of
from insdvl_replay.core.words import GateLevel

ANY: Final = "*"  # every table, filter or row
LOG: Final = "{log}"  # in the path of expected values, the dive's name
POOLED: Final = "pooled"  # the table of the evidence pooled over all dives, as in the ``evidence.csv`` of several dives
TRAJECTORY: Final = "trajectory"  # compared sample by sample
EXAMPLE: Final = 'table = "improvement", row = "ba_z", column = "improvement_pct", min = 40'
ON_TRAJECTORY: Final = 'expected = "expected/{log}.npz", or within = [0.0, 2.0] with share_pct = 95'
MOST_NAMES: Final = 20  # of columns in a hint
LAYOUTS = (*TABLES, CANDIDATES, layout_of(POOLED, PooledRow))
Allowance = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=100)]


class Gate(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One condition on one column of a table, or on the trajectory."""

    name: str  # unique
    table: str  # as in ``report.json``, or ``filters``
    filter: str = ANY
    row: str = ANY  # a state, quantity or measurement
    column: str = ""
    min: float | None = None  # inclusive, as the maximum
    max: float | None = None
    equals: str | int | float | tuple[str | int | float, ...] | None = None  # the allowed value or values
    expected: str | None = None  # stored values, relative to the gate file; ``{log}`` is the dive's name
    # Allowed loss against the expected value: in percent, or in percentage points if the value is a percentage; and in
    # the unit of the value. The larger of the two counts.
    max_worse_pct: Allowance | None = None
    max_worse_abs: Allowance | None = None
    # Allowed difference of trajectory samples: by column in its unit; relative to the largest value of its group.
    max_abs: dict[str, Allowance] = {}
    max_rel: Allowance | None = None
    # Allowed band for a quantity (row) of the trajectory: for a share of the samples, with a longest time outside, or
    # at one time; else for all samples.
    within: tuple[float, float] | None = None
    share_pct: Share | None = None
    longest_outside_s: Allowance | None = None
    at_s: Allowance | None = None
    dives: tuple[str, ...] = ()  # name patterns of the dives to check; empty for all
    share_of_dives_pct: Share | None = None  # the gate passes if this share of the dives passes it
    level: GateLevel = GateLevel.ERROR

    @property
    def wanted(self) -> tuple[str | int | float, ...]:
        """The allowed values."""
        return self.equals if isinstance(self.equals, tuple) else () if self.equals is None else (self.equals,)

    @property
    def layouts(self) -> list[TableLayout]:
        """The tables that it may be about."""
        return [layout for layout in LAYOUTS if self.table in (ANY, layout.name)]

    def is_about(self, name: tuple[str, str, str], row: Row) -> bool:
        """Return whether it checks a row, by its filter, key and unit."""
        is_named = self.filter in (ANY, name[0]) and self.row in (ANY, name[1])
        return is_named and (self.table != ANY or self.column in row)


class GateFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file of gates; its paths are relative to its folder."""

    dives: tuple[str, ...] = ()  # logs, bags, folders, patterns, lists or results
    config: str | None = None  # settings of the replays
    preset: str | None = None
    allow_damaged: bool = False  # use what can be read of damaged logs
    gate: tuple[Gate, ...] = ()


@dataclass(frozen=True)
class Gates:
    """A gate file that was read."""

    path: Path
    content: GateFile
    lines: dict[str, int]  # first line of a gate, by name

    def where(self, gate: Gate) -> str:
        """Name a gate and its place, for messages."""
        line = self.lines.get(gate.name)
        return f"{self.path}{f':{line}' if line else ''}: gate '{gate.name}'"


def load_gates(path: Path) -> Gates:
    """Read a gate file; ConfigError where a key, a value or a combination of them is wrong, or no gate is active."""
    if not is_writable(str(path)):
        raise ConfigError(f"{path}: its name is not UTF-8", "rename it")
    source = read_toml(
        path, f"for example {EXAMPLE}", if_unreadable="name a file of gates", if_invalid=f"[[gate]] {EXAMPLE}"
    )
    tables = source.content.get("gate")
    for number, table in enumerate(tables if isinstance(tables, list) else [], 1):
        if isinstance(table, dict) and "baseline" in table:
            hint = f"expected = {toml_value(table['baseline'])}"
            raise ConfigError(f"{path}: gate {number}: the key baseline is now expected", hint)
        gate = converted(table, Gate, source, label=f"gate {number}")
        with error_context(f"{path}: gate {number}"):
            _check_gate(gate)
    content = converted(source.content, GateFile, source)
    names = [gate.name for gate in content.gate]
    for name, times in Counter(names).items():
        if times > 1:
            raise ConfigError(f"two gates have the name '{name}'", "give each gate its own name", source.name)
    if all(gate.level == GateLevel.OFF for gate in content.gate):
        raise ConfigError("no gate is active", f"add [[gate]] with {EXAMPLE}, or set a level to error", source.name)
    lines = [number for number, line in enumerate(source.text.split("\n"), 1) if line.lstrip().startswith("[[gate]]")]
    return Gates(path, content, dict(zip(names, lines, strict=True)) if len(lines) == len(names) else {})


def is_meant(gate: Gate, dive: str) -> bool:
    """Return whether a gate applies to a dive, by its name."""
    return not gate.dives or any(fnmatch.fnmatchcase(dive, pattern) for pattern in gate.dives)


def chosen_gates(gates: Gates, only: Sequence[str], skip: Sequence[str]) -> Gates:
    """Keep the gates whose names match a pattern of ``only`` and none of ``skip``."""
    names = [gate.name for gate in gates.content.gate]
    matches = {pattern: fnmatch.filter(names, pattern) for pattern in (*only, *skip)}
    for pattern, found in matches.items():
        if not found:
            raise ConfigError(f"{gates.path}: no gate has the name '{pattern}'", f"gates: {listed(names)}")
    wanted = {name for pattern in only for name in matches[pattern]} if only else set(names)
    wanted -= {name for pattern in skip for name in matches[pattern]}
    if not wanted:
        raise ConfigError(f"{gates.path}: no gate is left", "leave out --skip, or widen --only")
    kept = tuple(gate for gate in gates.content.gate if gate.name in wanted)
    return Gates(gates.path, replace(gates.content, gate=kept), gates.lines)


def _check_gate(gate: Gate) -> None:
    """Raise for the first rule that is broken: keys that do not go together."""
    name, low, high, band = f"'{gate.name}'", gate.min, gate.max, gate.within
    limits = {key: getattr(gate, key) for key in ("min", "max", "max_worse_pct", "max_worse_abs")}
    endless = [f"{key} = {limit}" for key, limit in limits.items() if limit is not None and not math.isfinite(limit)]
    no_limits, not_stored = low is None and high is None and gate.equals is None, gate.expected is None
    no_allowance = gate.max_worse_pct is None and gate.max_worse_abs is None
    sample_keys = ("within", "share_pct", "longest_outside_s", "at_s", "max_abs", "max_rel")
    foreign = [key for key in sample_keys if getattr(gate, key)]
    unknown = re.findall(r"\{.*?\}", (gate.expected or "").replace(LOG, ""))
    pooled_only = gate.table == POOLED and (not not_stored or gate.share_of_dives_pct is not None or gate.dives)
    is_crossed, on_trajectory = low is not None and high is not None and low > high, gate.table == TRAJECTORY
    example = f"{endless[0].split()[0]} = 40.0" if endless else ""
    rules: list[tuple[object, str, str]] = [
        (endless, f"{' '.join(endless[:1])} is not a limit", example),
        (is_crossed, f"min = {low or 0:g} is above max = {high or 0:g}", "exchange min and max"),
    ]
    if on_trajectory:
        with_column, with_both = gate.column or not no_limits, band and (not not_stored or gate.max_abs)
        rules += [
            (with_column, f"{name}: a trajectory has samples and no columns", ON_TRAJECTORY),
            (with_both, f"{name}: within and expected cannot be in one gate", "make two gates of it"),
            (not band and not_stored, f"{name} has no condition", ON_TRAJECTORY),
        ]
    else:
        on_samples = f'{name}: {" ".join(foreign[:1])} is for table = "{TRAJECTORY}"'
        together = f"{name}: expected needs max_worse_pct or max_worse_abs, and these need expected"
        hint = 'expected = "expected/{log}.json" with max_worse_pct = 5'
        rules += [
            (not gate.column, f"{name} names no column", EXAMPLE),
            (foreign, on_samples, "min, max, or max_worse_abs"),
            (pooled_only, f"{name}: pooled evidence has no expected values and no single dives", "min, max or equals"),
            (unknown, f"expected: {' '.join(unknown[:1])} is not known", f"use {LOG} for the dive's name"),
            (no_limits and not_stored, f"{name} has no condition", "add min, max, equals or expected"),
            (not_stored != no_allowance, together, hint),
        ]
    for is_broken, text, hint in rules:
        if is_broken:
            raise ConfigError(text, hint)
    if on_trajectory:
        require_known("row", gate.row, COLUMNS if band else [ANY, *GROUPS, *COLUMNS])
        if band and not band[0] <= band[1]:
            raise ConfigError(f"{name}: within = {list(band)} contains no value", "exchange its ends")
        for column in gate.max_abs:
            require_known("max_abs", column, COLUMNS)


def require_known_names(
    gates: Gates,
    filters: Sequence[str]
    | None,  # of the replays, the baseline first; None for stored results, which may have other filters
) -> None:
    """Raise a ConfigError, with line and nearest name, if a gate has a name that no result can have."""
    for gate in gates.content.gate:
        with error_context(gates.where(gate)):
            if gate.table == TRAJECTORY:
                require_known("filter", gate.filter, [ANY, *(filters or (gate.filter,))])
            else:
                _require_known_cells(gate, filters)


def _require_known_cells(gate: Gate, filters: Sequence[str] | None) -> None:
    require_known("table", gate.table, [ANY, TRAJECTORY, *(layout.name for layout in LAYOUTS)])
    named = [layout for layout in LAYOUTS if gate.table in (ANY, layout.name)]
    columns = {
        layout.name: [name for name in layout.columns if name not in ("log", "filter", layout.key)] for layout in named
    }
    known = list(dict.fromkeys(name for names in columns.values() for name in names if name not in PROSE))
    if gate.column in PROSE:
        raise ConfigError(
            f"column '{gate.column}' is prose, and another version may word it differently",
            f"columns for gates: {listed(known, len(known) if gate.table != ANY else MOST_NAMES)}",
        )
    require_known("column", gate.column, known)
    layouts = [layout for layout in named if gate.column in columns[layout.name]]
    # The candidates of stored results are not known yet.
    if filters is not None or CANDIDATES not in layouts:
        rows = [row for layout in layouts for row in layout.rows or (filters or ())[1:]]
        kind = " or ".join(dict.fromkeys(layout.key for layout in layouts))
        require_known(kind, gate.row, [ANY, *dict.fromkeys(rows)])
    if filters is not None:
        require_known("filter", gate.filter, [ANY, *filters])
        if gate.filter == filters[0] and not any(layout.baseline_too for layout in layouts):
            raise ConfigError(
                f"filter '{filters[0]}' is the baseline, which has no rows in {gate.table}",
                f"name a candidate: {', '.join(filters[1:])}; its rows also have columns of the baseline",
            )
    # A condition that the column's kind can never meet
    for layout in layouts:
        words, column = layout.kinds[gate.column] == "text", f"column '{gate.column}' of {layout.name}"
        if words and not (gate.min is None and gate.max is None):
            raise ConfigError(f"{column} contains words, which have no limits", "use equals")
        if gate.wanted and not any(isinstance(value, str) == words for value in gate.wanted):
            raise ConfigError(f"equals: {column} contains {'words' if words else 'numbers'}, found {gate.equals!r}")
        if gate.expected is not None and gate.column not in layout.better:
            raise ConfigError(
                f"{column} has no better or worse direction, so it cannot be compared with an expected value",
                f"name one of {', '.join(layout.better)}, or give equals, min or max",
            )
