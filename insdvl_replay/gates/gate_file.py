"""Gates from TOML: strict, so that a slip is an error with its gate, its key and the nearest known name."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from insdvl_replay.core.config_file import converted, read_toml
from insdvl_replay.core.errors import ConfigError, error_context, is_writable, listed, require_known
from insdvl_replay.core.table import TableLayout
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.core.words import GateLevel
from insdvl_replay.gates.judged_cells import LAYOUTS
from insdvl_replay.gates.model import ANY, LOG, POOLED, TRAJECTORY, Gate, GateFile
from insdvl_replay.gates.trajectory_keys import OF_TIME, check_trajectory_gate

EXAMPLE: Final = 'table = "improvement", row = "ba_z", column = "improvement_pct", min = 40'


@dataclass(frozen=True)
class Gates:
    """A gate file that was read."""

    path: Path
    content: GateFile
    lines: tuple[int, ...]  # where each gate begins; 0 if that is not known

    def where(self, gate: Gate) -> str:
        """Name a gate and its place, for messages."""
        line = self.lines[self.content.gate.index(gate)]
        return f"{self.path}{f':{line}' if line else ''}: gate '{gate.name}'"


def load_gates(path: Path) -> Gates:
    """Read a gate file.

    Raises
    ------
    ConfigError
        It cannot be read, is not TOML, has an unknown key or a value of the wrong kind; two gates share a name, a gate
        has no condition, or none is active.
    """
    if not is_writable(str(path)):
        raise ConfigError(f"{path}: its name is not UTF-8, so no result could tell it", "rename it")
    source = read_toml(
        path, f"for example {EXAMPLE}", if_unreadable="name a file of gates", if_invalid=f"[[gate]] {EXAMPLE}"
    )
    gates = source.content.get("gate")
    for number, table in enumerate(gates if isinstance(gates, list) else [], 1):
        gate = converted(table, Gate, source, label=f"gate {number}")
        with error_context(f"{path}: gate {number}"):
            _check_gate(gate)
    content = converted(source.content, GateFile, source)
    with error_context(source.name):
        _check_all(content)
    lines = [number for number, line in enumerate(source.text.split("\n"), 1) if line.lstrip().startswith("[[gate]]")]
    return Gates(path, content, tuple(lines if len(lines) == len(content.gate) else [0] * len(content.gate)))


def chosen_gates(gates: Gates, only: Sequence[str], skip: Sequence[str]) -> Gates:
    """Keep the gates whose names are like one of the patterns, and like none of those to be left out.

    Raises
    ------
    ConfigError
        No gate is left, or a pattern is like no name.
    """
    names = [gate.name for gate in gates.content.gate]
    for pattern in (*only, *skip):
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigError(f"{gates.path}: no gate is called '{pattern}'", f"gates: {listed(names)}")
    kept = [
        (gate, line)
        for gate, line in zip(gates.content.gate, gates.lines, strict=True)
        if (not only or any(fnmatchcase(gate.name, pattern) for pattern in only))
        and not any(fnmatchcase(gate.name, pattern) for pattern in skip)
    ]
    if not kept:
        raise ConfigError(f"{gates.path}: no gate is left", "leave out --skip, or widen --only")
    chosen, lines = zip(*kept, strict=True)
    return Gates(gates.path, replace(gates.content, gate=chosen), lines)


def _check_gate(gate: Gate) -> None:
    _check_limits(gate)
    if gate.table == TRAJECTORY:
        check_trajectory_gate(gate)
        return
    _check_cells(gate)


def _check_cells(gate: Gate) -> None:
    if not gate.column:
        raise ConfigError(f"'{gate.name}' names no column", EXAMPLE)
    if foreign := [key for key in (*OF_TIME, "max_abs", "max_rel") if getattr(gate, key)]:
        raise ConfigError(f"'{gate.name}': {foreign[0]} is for table = \"{TRAJECTORY}\"", "min, max, or max_worse_abs")
    if gate.table == POOLED and (gate.baseline is not None or gate.share_of_dives_pct is not None or gate.dives):
        raise ConfigError(
            f"'{gate.name}': the pooled evidence is of all dives, without a baseline", "min, max or equals"
        )
    allowances = (gate.max_worse_pct, gate.max_worse_abs)
    if gate.baseline is not None and (strange := re.search(r"\{.*?\}", gate.baseline.replace(LOG, ""))):
        raise ConfigError(f"baseline: {strange[0]} is not known", f"{LOG} stands for the dive's name")
    if all(limit is None for limit in (gate.min, gate.max, gate.equals, gate.baseline)):
        raise ConfigError(f"'{gate.name}' has no condition", "add min, max, equals or baseline")
    if (gate.baseline is None) != (allowances == (None, None)):
        raise ConfigError(
            f"'{gate.name}': baseline and max_worse_pct or max_worse_abs need each other",
            'baseline = "baselines/{log}.json" with max_worse_pct = 5',
        )


def _check_limits(gate: Gate) -> None:
    for key in ("min", "max", "max_worse_pct", "max_worse_abs"):
        limit = getattr(gate, key)
        if limit is not None and not math.isfinite(limit):
            raise ConfigError(f"{key} = {limit} is no limit", f"{key} = 40.0")
    if gate.min is not None and gate.max is not None and gate.min > gate.max:
        raise ConfigError(f"no value is at least {gate.min:g} and at most {gate.max:g}", "exchange min and max")


def _check_all(content: GateFile) -> None:
    names = [gate.name for gate in content.gate]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"two gates bear the name '{name}'", "give each a name of its own")
    if all(gate.level == GateLevel.OFF for gate in content.gate):
        raise ConfigError("no gate is active", f"add [[gate]] with {EXAMPLE}, or set a level to error")


def require_known_names(gates: Gates, filters: Sequence[str] | None) -> None:
    """Raise a ConfigError, with line and nearest name, if a gate names what no result can have.

    Parameters
    ----------
    filters : sequence of str or None
        Those that will be replayed, the baseline first; None if there are stored results, which may have others.
    """
    for gate in gates.content.gate:
        if gate.table == TRAJECTORY:
            with error_context(gates.where(gate)):
                require_known("filter", gate.filter, [ANY, *(filters or (gate.filter,))])
            continue
        with error_context(gates.where(gate)):
            layouts = _layouts(gate)
            _require_known_rows(gate, layouts, filters)
            if filters is not None:
                require_known("filter", gate.filter, [ANY, *filters])
                _require_baseline_rows(gate, layouts, filters)
            for layout in layouts:
                _require_fitting_condition(gate, layout)


def _layouts(gate: Gate) -> list[TableLayout]:
    """Return the tables that a gate means: those of its name that have its column."""
    require_known("table", gate.table, [ANY, TRAJECTORY, *(layout.name for layout in LAYOUTS)])
    named = [layout for layout in LAYOUTS if gate.table in (ANY, layout.name)]
    require_known("column", gate.column, _unique(column for layout in named for column in _columns(layout)))
    return [layout for layout in named if gate.column in _columns(layout)]


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _require_known_rows(gate: Gate, layouts: Sequence[TableLayout], filters: Sequence[str] | None) -> None:
    """Refuse what is no row, as far as rows do not bear the names of filters that nobody knows yet."""
    if filters is None and CANDIDATES in layouts:
        return
    rows = [layout.rows or tuple((filters or ())[1:]) for layout in layouts]
    kind = " or ".join(_unique(layout.key for layout in layouts))
    require_known(kind, gate.row, [ANY, *_unique(row for of_table in rows for row in of_table)])


def _require_baseline_rows(gate: Gate, layouts: Sequence[TableLayout], filters: Sequence[str]) -> None:
    """Refuse the baseline where it has no rows, but stands beside each candidate."""
    baseline, *candidates = filters
    if gate.filter == baseline and not any(layout.baseline_too for layout in layouts):
        raise ConfigError(
            f"filter '{baseline}' is the baseline, which has no rows of its own in {gate.table}",
            f"name a candidate: {', '.join(candidates)}; its rows have columns of the baseline, too",
        )


def _columns(layout: TableLayout) -> list[str]:
    """Return the columns that a gate may name."""
    return [name for name in layout.columns if name not in ("log", "filter", layout.key)]


def _require_fitting_condition(gate: Gate, layout: TableLayout) -> None:
    """Refuse a condition that the column's kind can never meet."""
    words = layout.kinds[gate.column] == "text"
    if words and not (gate.min is None and gate.max is None):
        raise ConfigError(f"column '{gate.column}' of {layout.name} holds words, which have no limits", "use equals")
    wanted = gate.equals if isinstance(gate.equals, tuple) else (gate.equals,)
    if gate.equals is not None and not any(isinstance(value, str) == words for value in wanted):
        kind = "words" if words else "numbers"
        raise ConfigError(f"equals: column '{gate.column}' of {layout.name} holds {kind}, found {gate.equals!r}")
    if gate.baseline is not None and gate.column not in layout.better:
        raise ConfigError(
            f"column '{gate.column}' of {layout.name} is neither better nor worse, so no baseline can be kept to",
            f"one of {', '.join(layout.better)}, or equals, min or max",
        )
