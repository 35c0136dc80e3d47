"""TOML into structures, strictly: a slip is an error with its file, line, key, value and the nearest known name."""

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import EnumMeta
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Struct

from insdvl_replay.core.errors import LISTED, ConfigError, error_context, listed, require_known
from insdvl_replay.core.likely_names import likely_elsewhere, likely_names
from insdvl_replay.core.plain_text import read_text
from insdvl_replay.core.value_wanted import list_meant, value_wanted

KeyPath = tuple[str | int, ...]
"""Names of tables and keys from the top, and places in arrays among them."""
Table = TypeVar("Table", bound=Struct)

_SHOWN: Final = 80
"""Letters of a wrong value that a message repeats."""
_CLOSING: Final = re.compile(r"""]|}|\"{3}|'{3}""")
"""With one of these ends a statement of several lines."""
_GOES_ON: Final = re.compile(r"^[^#]*,\s*$")
"""A line of an array that goes on."""


@dataclass(frozen=True)
class TomlSource:
    """A file, preset or option that holds TOML, or one table of it, and how messages name what is in it."""

    name: str  # with which every message begins
    hint: str  # what to do about a wrong value
    content: dict[str, Any] = field(default_factory=dict)
    text: str = ""  # of the file; empty where lines are of no use
    at: KeyPath = ()  # where the table stands; empty for the whole
    label: str = ""  # what messages call the table, in place of its path
    assigned: str = "{} = {}"  # how a key gets its value there, with ``{}`` for both

    def says(self, *keys: str | int) -> bool:
        """Return whether a key, from the top, stands there."""
        inner: Any = self.content
        for key in keys:
            if not isinstance(inner, Mapping) or key not in inner:
                return False
            inner = inner[key]
        return True

    def inside(self, *at: str | int, label: str = "") -> "TomlSource":
        """Return the same for one of its tables."""
        return replace(self, at=at, label=label)

    @property
    def lines(self) -> Mapping[KeyPath, int]:
        """Lines, from 1, on which tables and keys begin."""
        return _key_lines(self.text)

    def line(self, *keys: str | int) -> int:
        """Find the line of a key, or of the innermost table around it that stands in the file; 0 if none does."""
        path = (*self.at, *keys)
        return next((self.lines[path[:end]] for end in range(len(path), 0, -1) if path[:end] in self.lines), 0)

    def where(self, *keys: str | int) -> str:
        """Name the place of a key, for the beginning of a message."""
        line = self.line(*keys)
        place = f"{self.name}:{line}" if line else self.name
        return f"{place}: {self.label}" if self.label else place

    def key(self, *keys: str | int) -> str:
        """Write the path of a key as in TOML, with places in arrays in brackets."""
        path = keys if self.label else (*self.at, *keys)
        return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")

    def converted(self, table: object, kind: type[Table]) -> Table:
        """Convert a table to its structure, which forbids unknown fields.

        Raises
        ------
        ConfigError
            A key is not known or missing, or its value is of the wrong kind or range.
        """
        try:
            return msgspec.convert(table, kind)
        except msgspec.ValidationError as error:
            self._require_known_keys(table, kind)
            reason, _, place = str(error).partition(" - at `$.")
            keys = tuple(int(part) if part.isdigit() else part for part in re.findall(r"\w+", place))
            with error_context(self.where(*keys)):
                self._raise_for_value(reason, keys, _value_at(table, keys), _hint_at(kind, keys))

    def _require_known_keys(self, table: object, kind: type[Struct]) -> None:
        for *above, key, known in _unknown_keys(table, kind):
            within = f"{self.key(*above)}.".removeprefix(".")
            with error_context(self.where(*above, key)):
                raise ConfigError(f"key '{within}{key}' is not known", self._hint_for_key(key, within, known, kind))

    def _hint_for_key(self, key: str, within: str, known: Collection[str], kind: type[Struct]) -> str:
        meant = [within + name for name in likely_names(key, known)]
        if not meant:
            outside = f"{self.key()}.".removeprefix(".")
            meant = [outside + path for path in likely_elsewhere(key, list(_known_paths(kind)))]
        if meant:
            return f"did you mean {', '.join(meant[:-1])}{' or ' if meant[1:] else ''}{meant[-1]}?"
        return f"known: {listed(known)}{f'; {self.hint}' if len(known) > LISTED else ''}"

    def _raise_for_value(self, reason: str, keys: KeyPath, value: object, hint: object) -> NoReturn:
        name = self.key(*keys)
        if isinstance(value, str) and (words := tuple(_words(hint))):
            require_known(name, value, words)
        if reason.startswith("Expected `object`") and name and not name.endswith("]"):
            raise ConfigError(f"{name} is a section, found {_shortened(value)}", f"write [{name}]")
        found = f", found {_shortened(value)}" if keys else ""
        example = list_meant(value, hint) if reason.startswith("Expected `array`") else ""
        example_hint = f"a list is written so: {self.assigned.format(name, example)}" if example else self.hint
        raise ConfigError(f"{f'{name}: ' if name else ''}{value_wanted(reason)}{found}", example_hint)


def read_toml(path: Path, hint: str, *, if_unreadable: str, if_invalid: str) -> TomlSource:
    """Read a file of the user's, with a hint what to do about wrong values in it.

    Raises
    ------
    ConfigError
        It cannot be read, is not UTF-8 or is not TOML.
    """
    try:
        text = read_text(path)
        return TomlSource(str(path), hint, parse_toml(text), text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", if_unreadable) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start})", "it has to be a TOML file") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}", if_invalid) from error


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; all that can be wrong with it is a TOMLDecodeError, more digits or brackets than Python reads too."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise tomllib.TOMLDecodeError("Too many brackets inside each other") from error
    except ValueError as error:
        raise tomllib.TOMLDecodeError("A number has too many digits") from error


@lru_cache(maxsize=4)
def _key_lines(text: str) -> Mapping[KeyPath, int]:
    """Find where tables and keys begin, by parsing statement after statement of a text that is valid."""
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    statement, begin = "", 0
    for number, line in enumerate(text.split("\n"), 1):
        if not statement:
            begin = number
        elif not _CLOSING.search(line) or _GOES_ON.search(line):
            statement += f"{line}\n"
            continue
        statement += f"{line}\n"
        try:
            parsed = parse_toml(statement)
        except tomllib.TOMLDecodeError:
            continue
        path: KeyPath = tuple(_first_path(parsed))
        if statement.lstrip().startswith("[["):
            counts[path] = counts.get(path, -1) + 1
        if statement.lstrip().startswith("["):
            table = path = _numbered(path, counts)
        elif path:
            path = (*table, *path)
        for end in range(1, len(path) + 1):
            lines.setdefault(path[:end], begin)
        statement = ""
    return lines


def _first_path(parsed: object) -> Iterator[str]:
    """Follow the names of tables that hold one name each, through arrays of tables."""
    while isinstance(parsed, dict) and len(parsed) == 1:
        (name, parsed), *_ = parsed.items()
        yield name
        if isinstance(parsed, list) and parsed == [{}]:
            return


def _numbered(path: KeyPath, counts: Mapping[KeyPath, int]) -> KeyPath:
    """Put the place of the last table of an array behind the array's name."""
    numbered: KeyPath = ()
    for end, name in enumerate(path, 1):
        numbered = (*numbered, name, *([counts[path[:end]]] if path[:end] in counts else []))
    return numbered


def _unknown_keys(table: object, kind: type[Struct]) -> Iterator[tuple[Any, ...]]:
    """Yield the tables above each key that is not known, the key, and the known ones."""
    if not isinstance(table, Mapping):
        return
    hints = get_type_hints(kind)
    for key, value in table.items():
        if key not in kind.__struct_fields__:
            yield key, kind.__struct_fields__
        elif (inner := _structure(hints[key])) is not None:
            for found in _unknown_keys(value, inner):
                yield key, *found


def _known_paths(kind: type[Struct], above: str = "") -> Iterator[str]:
    """Yield the dotted path of every key of a structure and of those inside it."""
    for name, hint in get_type_hints(kind).items():
        if (inner := _structure(hint)) is not None:
            yield from _known_paths(inner, f"{above}{name}.")
        elif name in kind.__struct_fields__:
            yield above + name


def _structure(hint: object) -> type[Struct] | None:
    """Find the structure that a field holds, if it is one."""
    if get_origin(hint) in (dict, tuple):
        return None
    return next((kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and issubclass(kind, Struct)), None)


def _hint_at(kind: type[Struct], keys: KeyPath) -> object:
    hint: object = kind
    for key in keys:
        if isinstance(key, str) and (structure := _structure(hint)) is not None:
            hint = get_type_hints(structure)[key]
    return hint


def _value_at(table: Any, keys: KeyPath) -> object:
    for key in keys:
        table = table[key]
    return table


def _words(hint: object) -> Iterator[str]:
    """Yield the words that a value may be."""
    if isinstance(hint, EnumMeta):
        yield from hint.__members__.values()
    for inner in get_args(hint):
        if get_origin(hint) is Literal:
            yield inner
        else:
            yield from _words(inner)


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
