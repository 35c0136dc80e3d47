"""Gates from TOML: strict, so that a slip is an error with its line, its key and the nearest known name."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from insdvl_replay.core.errors import ConfigError, error_context
from insdvl_replay.core.plain_text import is_writable
from insdvl_replay.core.strict_toml import TomlSource, read_toml
from insdvl_replay.gates.model import LOG, Gate, GateFile

EXAMPLE: Final = 'table = "improvement", row = "ba_z", column = "improvement_pct", min = 40'


@dataclass(frozen=True)
class Gates:
    """A gate file that was read.

    Attributes
    ----------
    lines : tuple of int
        Where each gate begins; 0 if that is not known.
    """

    path: Path
    content: GateFile
    lines: tuple[int, ...]

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
    places = [source.inside("gate", number, label=f"gate {number + 1}") for number in range(_count(source))]
    for place in places:
        gate = place.converted(source.content["gate"][place.at[-1]], Gate)
        with error_context(place.where()):
            _check_gate(gate)
    content = source.converted(source.content, GateFile)
    with error_context(source.name):
        _check_all(content)
    return Gates(path, content, tuple(place.line() for place in places))


def _count(source: TomlSource) -> int:
    """Count the gates; what is no array of them is refused when all is converted."""
    gates = source.content.get("gate")
    return len(gates) if isinstance(gates, list) else 0


def _check_gate(gate: Gate) -> None:
    _check_limits(gate)
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
    if all(gate.level == "off" for gate in content.gate):
        raise ConfigError("no gate is active", f"add [[gate]] with {EXAMPLE}, or set a level to error")
