"""Gates from TOML: strict, so that a slip is an error with its line, its key and the nearest known name."""

import math
import re
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

import msgspec
from msgspec import Struct

from insdvl_replay.core.errors import ConfigError, error_context, refuse_unknown
from insdvl_replay.core.plain_text import is_writable
from insdvl_replay.core.text_files import read_text
from insdvl_replay.core.toml_text import parsed_toml
from insdvl_replay.gates.model import LOG, Gate, GateFile, Level

EXAMPLE: Final = 'table = "improvement", row = "ba_z", column = "improvement_pct", min = 40'
_HEADER: Final = re.compile(r"\s*\[\[\s*gate\s*\]\]")


@dataclass(frozen=True)
class Gates:
    """A gate file that was read.

    Attributes
    ----------
    path : Path
    content : GateFile
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

    Parameters
    ----------
    path : Path

    Returns
    -------
    Gates

    Raises
    ------
    ConfigError
        It cannot be read, is not TOML, has an unknown key or a value of the wrong kind; two gates share a name, a gate
        has no condition, or none is active.
    """
    text = _read(path)
    try:
        raw = parsed_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}", f"[[gate]] {EXAMPLE}") from error
    lines = _gate_lines(text, raw)
    with error_context(_place(path, _line_of(text, 0, raw, GateFile))):
        _refuse_unknown_keys(raw, GateFile.__struct_fields__)
    for number, entry in enumerate(_entries(raw)):
        with error_context(f"{_place(path, _line_of(text, lines[number], entry, Gate))}: gate {number + 1}"):
            _refuse_unknown_keys(entry, Gate.__struct_fields__)
            if isinstance(level := entry.get("level"), str):
                refuse_unknown("level", level, get_args(Level))
            _check_gate(_converted(entry, Gate))
    with error_context(_place(path, _line_of(text, 0, raw, GateFile))):
        content = _converted(raw, GateFile)
        _check_all(content)
    return Gates(path, content, lines)


def _read(path: Path) -> str:
    if not is_writable(str(path)):
        raise ConfigError(f"{path}: its name is not UTF-8, so no result could tell it", "rename it")
    try:
        return read_text(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", "name a file of gates") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start})", "gates are a TOML file") from error


def _entries(raw: dict[str, Any]) -> list[dict[str, Any]]:
    """Give the gates as far as they are tables; what else stands there is refused when all is converted."""
    gates = raw.get("gate", [])
    return [entry for entry in gates if isinstance(entry, dict)] if isinstance(gates, list) else []


def _gate_lines(text: str, raw: dict[str, Any]) -> tuple[int, ...]:
    headers = [number for number, line in enumerate(text.splitlines(), 1) if _HEADER.match(line)]
    count = len(_entries(raw))
    return tuple(headers) if len(headers) == count else (0,) * count


def _line_of(text: str, first: int, entry: dict[str, Any], kind: type[Struct]) -> int:
    """Find the line of the key that is wrong with an entry; its first line if none is."""
    keys = [key for key in entry if key not in kind.__struct_fields__] or [_wrong_key(entry, kind)]
    for number, line in enumerate(text.splitlines()[max(0, first - 1) :], max(1, first)):
        if keys[0] and re.match(rf"""\s*(\[\[?\s*)?["']?{re.escape(keys[0])}["']?\s*[]=]""", line):
            return number
    return first


def _wrong_key(entry: dict[str, Any], kind: type[Struct]) -> str:
    try:
        msgspec.convert(entry, kind)
    except msgspec.ValidationError as error:
        match = re.search(r"at `\$\.(\w+)", str(error))
        return match[1] if match else ""
    return ""


def _place(path: Path, line: int) -> str:
    return f"{path}:{line}" if line else str(path)


def _refuse_unknown_keys(entry: dict[str, Any], known: Collection[str]) -> None:
    for key in entry:
        refuse_unknown("key", key, known)


def _converted(entry: dict[str, Any], kind: type[Struct]) -> Any:
    try:
        return msgspec.convert(entry, kind)
    except msgspec.ValidationError as error:
        sentence, _, place = str(error).partition(" - at `$")
        key = place.rstrip("`").lstrip(".")
        found = f", found {entry[key]!r}" if key in entry else ""
        raise ConfigError(
            f"{f'{key}: ' if key else ''}{sentence[:1].lower()}{sentence[1:]}{found}", f"for example {EXAMPLE}"
        ) from error


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
