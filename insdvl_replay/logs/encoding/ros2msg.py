"""The interface language of ROS 2, and of ROS 1: the text of a message type, parsed and assembled.

A log carries for every type the text of its definition and of all types in it, one after the other. The types that the
tool itself writes or knows by name stand as files: the project's own in ``schemas/insdvl_msgs``, those of others in
``definitions``. Source: https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html and the MCAP registry of
well-known schema encodings, https://mcap.dev/spec/registry; for ROS 1 http://wiki.ros.org/msg.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final, Literal

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.fields import MOST_LEVELS, MOST_PATHS, too_large

PRIMITIVES: Final[dict[str, str]] = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
"""Numpy formats of the primitive types of fixed size."""

LONGEST_ARRAY: Final = 2**32 - 1
"""CDR counts elements in words of four bytes."""
_SEPARATOR: Final = "=" * 80
_ANY_SEPARATOR: Final = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
_SECTION_NAME: Final = re.compile(r"\s*MSG:\s*(\S+)[^\n]*\n?")
_TYPE_NAME: Final = re.compile(r"[a-z]\w{0,99}/msg/[A-Z]\w{0,99}", re.ASCII)
"""Type that may come with the tool; other names are too long for a file, or lead elsewhere."""
_LINE: Final = re.compile(
    r"(?P<base>[A-Za-z][\w/]*)(<=\d+)?(?P<brackets>\[(?P<bounded><=)?(?P<length>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)(?:\s*(?P<constant>=)|\s|#|$)"
)


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Attributes
    ----------
    name : str
        As the definition names it.
    type_name : str
        ``string``, a key of `PRIMITIVES`, or a message type as ``package/msg/Type``.
    kind : {'single', 'array', 'sequence'}
        One value, a fixed number of values, or any number preceded by a length word.
    length : int
        Number of values of an array; 1 for a single value, 0 for a sequence.
    """

    name: str
    type_name: str
    kind: Literal["single", "array", "sequence"]
    length: int


@dataclass(frozen=True)
class Definition:
    """The fields of one message type, in order: constants are none, and IDL demands one byte at least."""

    type_name: str
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class Dialect:
    """In what the languages of ROS 1 and ROS 2 differ.

    Attributes
    ----------
    schema_encoding, recorder : str
        Name of the encoding in MCAP, and what writes it there.
    synonyms : mapping of str to str
        Primitive types of other names.
    builtin : mapping of str to Definition
        Structures that no text defines.
    empty : tuple of Field
        What stands in the place of no fields.
    """

    schema_encoding: str
    recorder: str
    synonyms: Mapping[str, str]
    builtin: Mapping[str, Definition]
    empty: tuple[Field, ...]

    @property
    def record_again(self) -> str:
        """What helps where a schema is not complete."""
        return f"record the log again with complete schemas, as {self.recorder} writes them"

    @property
    def only_this(self) -> str:
        """What helps where a schema is of another language."""
        return f"schemas must be of encoding {self.schema_encoding}, as {self.recorder} writes them"


def _time(name: str, number: str) -> Definition:
    return Definition(name, (Field("sec", number, "single", 1), Field("nanosec", number, "single", 1)))


ROS2MSG: Final = Dialect(
    schema_encoding="ros2msg",
    recorder="`ros2 bag record --storage mcap`",
    synonyms={},
    builtin={},
    empty=(Field("structure_needs_at_least_one_member", "uint8", "single", 1),),
)
ROS2IDL: Final = replace(ROS2MSG, schema_encoding="ros2idl")
ROS1MSG: Final = Dialect(
    schema_encoding="ros1msg",
    recorder="`mcap convert`",
    synonyms={"byte": "int8", "char": "uint8"},
    builtin={"time": _time("time", "uint32"), "duration": _time("duration", "int32")},
    empty=(),
)
"""Its times have the field names of ROS 2, so that paths are the same."""


def parse_definitions(type_name: str, text: str, dialect: Dialect = ROS2MSG) -> dict[str, Definition]:
    """Parse the full text of a type."""
    definitions: dict[str, Definition] = {}
    for name, section in _sections(type_name, text, dialect):
        definitions.setdefault(name, Definition(name, tuple(_fields(name, section, dialect)) or dialect.empty))
    definitions |= dialect.builtin
    check_complete(type_name, definitions, dialect)
    return definitions


def completed_text(type_name: str, text: str) -> str:
    """Add to the text of a ROS 2 type the types in it that it lacks, as far as they come with the tool.

    BlueOS records the file of a type alone.
    """
    for missing in missing_types(type_name, text):
        with suppress(LogError):
            text = f"{text}\n{_SEPARATOR}\nMSG: {missing.replace('/msg/', '/')}\n{definition_text(missing)}"
    return text


def missing_types(type_name: str, text: str) -> list[str]:
    """List the types that a text uses and does not define."""
    sections = _sections(type_name, text, ROS2MSG)
    defined = {name: list(_fields(name, section, ROS2MSG)) for name, section in sections}
    used = dict.fromkeys(field.type_name for fields in defined.values() for field in fields)
    return [name for name in used if "/" in name and name not in defined]


def definition_text(type_name: str) -> str:
    """Assemble the full text of a type that comes with the tool: its own definition, then that of every type in it."""
    texts = {name: _known_text(name) for name in _with_dependencies(full_name(type_name))}
    first, *others = texts.items()
    sections = [f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others]
    return "".join([first[1], *sections])


def full_name(type_name: str) -> str:
    """Return a type's name as ``package/msg/Type``."""
    return type_name if type_name.count("/") != 1 else type_name.replace("/", "/msg/")


def _sections(type_name: str, text: str, dialect: Dialect) -> Iterator[tuple[str, str]]:
    first, *others = _ANY_SEPARATOR.split(text.replace("\r\n", "\n"))
    yield full_name(type_name), first
    for section in others:
        heading = _SECTION_NAME.match(section)
        if heading is None:
            start = section.strip().partition("\n")[0]
            raise LogError(
                f"{type_name}: a section of the schema starts with '{start}' where 'MSG: package/Type' belongs",
                dialect.only_this,
            )
        yield full_name(heading[1]), section[heading.end() :]


def check_complete(type_name: str, definitions: Mapping[str, Definition], dialect: Dialect) -> None:
    """Refuse definitions of which one is missing or contains itself, or which are more than any message has."""
    graph = {name: [field.type_name for field in definition.fields] for name, definition in definitions.items()}
    for name, used in graph.items():
        for missing in (other for other in used if "/" in other and other not in definitions):
            what = f"{type_name}: the schema uses {missing} in {name} and does not define it"
            raise LogError(what, dialect.record_again)
    try:
        inner_first = tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        what = f"{type_name}: the schema's type {error.args[1][0]} contains itself"
        raise LogError(what, dialect.record_again) from error
    _check_size(type_name, definitions, inner_first)


def _check_size(type_name: str, definitions: Mapping[str, Definition], inner_first: Sequence[str]) -> None:
    """Refuse a type with too many fields, which are counted type by type and not by going to each."""
    paths: dict[str, int] = {}
    levels: dict[str, int] = {}
    for name in inner_first:
        fields = definitions[name].fields if name in definitions else ()
        paths[name] = sum(1 + (field.kind != "single") + paths[field.type_name] for field in fields)
        levels[name] = 1 + max((levels[field.type_name] for field in fields), default=-1)
        if paths[name] > MOST_PATHS or levels[name] > MOST_LEVELS:
            raise too_large(type_name)


def _fields(type_name: str, section: str, dialect: Dialect) -> Iterator[Field]:
    package = type_name.partition("/")[0]
    for line in section.splitlines():
        statement = line.strip()
        if not statement or statement.startswith("#"):
            continue
        match = _LINE.match(statement)
        if match is None:
            raise LogError(f"{type_name}: '{statement}' in the schema is no field", dialect.only_this)
        if match["constant"] is None:
            yield _field(package, match, dialect)


def _field(package: str, match: re.Match[str], dialect: Dialect) -> Field:
    type_name = _resolved(package, match["base"], dialect)
    if match["brackets"] is None:
        return Field(match["name"], type_name, "single", 1)
    if match["bounded"] or not match["length"]:
        return Field(match["name"], type_name, "sequence", 0)
    # Python makes no number of thousands of digits.
    length = int(match["length"]) if len(match["length"]) <= len(str(LONGEST_ARRAY)) else 0
    if not 0 < length <= LONGEST_ARRAY:
        array = f"{match['base']}[{match['length'][:12]}]"
        raise LogError(f"{package}: the schema has an array '{array}', which is none or too long", dialect.record_again)
    return Field(match["name"], type_name, "array", length)


def _resolved(package: str, base: str, dialect: Dialect) -> str:
    base = dialect.synonyms.get(base, base)
    if base in PRIMITIVES or base in ("string", "wstring") or base in dialect.builtin:
        return base
    if base == "Header":
        return "std_msgs/msg/Header"
    return full_name(base if "/" in base else f"{package}/{base}")


def _with_dependencies(type_name: str) -> list[str]:
    """List a type and all types in it, each once, in the order in which they are met."""
    names = [type_name]
    for name in names:
        for field in _fields(name, _known_text(name), ROS2MSG):
            if "/" in field.type_name and field.type_name not in names:
                names.append(field.type_name)
    return names


@cache
def _known_text(type_name: str) -> str:
    package, _, name = type_name.partition("/msg/")
    for folder in _definition_folders() if _TYPE_NAME.fullmatch(type_name) else ():
        file = folder / package / "msg" / f"{name}.msg"
        if file.is_file():
            return file.read_text("utf-8")
    raise LogError(f"{type_name}: no definition of this type comes with the tool", ROS2MSG.record_again)


def _definition_folders() -> tuple[Path, ...]:
    """Find the definitions; ``schemas`` lies beside the package in a checkout and inside it in a wheel."""
    logs = Path(__file__).parents[1]
    return logs / "definitions", logs.parent / "schemas", logs.parent.parent / "schemas"
