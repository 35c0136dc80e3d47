"""Message types of ROS 2 and ROS 1: definitions, from a log or from the tool, parsed to fields.

A log carries for every type the text of its definition and of all types in it, one after the other. The types that the
tool writes or knows by name are files: its own in ``schemas/insdvl_msgs``, those of others in ``definitions``.
Sources: https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html, http://wiki.ros.org/msg, and the schema
encodings of https://mcap.dev/spec/registry.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, Final, Literal

from insdvl_replay.core.errors import LogError

# Numpy formats of the primitive types of fixed size.
PRIMITIVES: Final[dict[str, str]] = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
# Fields of a type: real types have hundreds, and a short schema can mean billions.
MOST_PATHS: Final = 1 << 16
MOST_LEVELS: Final = 64  # structures within structures
LONGEST_ARRAY: Final = 2**32 - 1  # CDR counts elements in words of four bytes
LEAVE_OUT: Final = "do not use its topic for a role"
_ROS2_RECORDER: Final = "`ros2 bag record --storage mcap`"
_RECORDERS: Final = {
    "ros1msg": "`mcap convert`",
    "ros2msg": _ROS2_RECORDER,
    "ros2idl": _ROS2_RECORDER,
}
_ROS1_SYNONYMS: Final = {"byte": "int8", "char": "uint8"}
_RULE: Final = "=" * 80
_LINE: Final = re.compile(
    r"(?P<base>[A-Za-z][\w/]*)(<=\d+)?(?P<brackets>\[(?P<bounded><=)?(?P<length>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)(?:\s*(?P<constant>=)|\s|#|$)"
)


@dataclass(frozen=True)
class Field:
    """One field of a message."""

    name: str
    type_name: str  # of PRIMITIVES, "string", "wstring", or a message type as package/msg/Type
    kind: Literal["single", "array", "sequence"] = "single"
    length: int = 1  # values of an array; 0 for a sequence, whose length is in the message


Definitions = Mapping[str, tuple[Field, ...]]  # by type name; constants are no fields
# ROS 2 sends a byte where no fields are.
_EMPTY: Final = (Field("structure_needs_at_least_one_member", "uint8"),)


def full_name(type_name: str) -> str:
    """Return a type's name as ``package/msg/Type``."""
    if type_name.count("/") != 1:
        return type_name
    return type_name.replace("/", "/msg/")


def record_again(language: str) -> str:
    """Return the hint for a schema that is not complete."""
    return f"record the log again with complete schemas, with {_RECORDERS[language]}"


def _only(language: str) -> str:
    return f"schemas must be of encoding {language}; {_RECORDERS[language]} writes them"


@cache
def definitions_of(
    type_name: str,
    schema_text: str,
    encoding: str,
    schema_encoding: str = "",
) -> Definitions:
    """Parse a channel's schema. What a schema of ROS 2 lacks, all of it or types in it, comes with the tool."""
    if encoding == "ros1":
        return parse_definitions(type_name, schema_text, "ros1msg")
    text = schema_text
    if defines_nothing(type_name, schema_text):
        text = definition_text(type_name)
    elif schema_encoding == "ros2idl":
        return parse_definitions(type_name, schema_text, "ros2idl")
    for missing in missing_types(type_name, text):  # BlueOS records the file of a type alone
        with suppress(LogError):
            text = f"{text}\n{_RULE}\nMSG: {missing.replace('/msg/', '/')}\n{definition_text(missing)}"
    return parse_definitions(type_name, text)


def defines_nothing(type_name: str, schema_text: str) -> bool:
    """Return whether a schema is empty or holds the name of its type alone, as some recorders write it."""
    name = schema_text.strip().removeprefix("MSG:").removeprefix("IDL:").strip()
    return not name or full_name(name) == full_name(type_name)


def parse_definitions(type_name: str, text: str, language: str = "ros2msg") -> Definitions:
    """Parse the full text of a type; the language is the encoding of its schema."""
    if language == "ros2idl":
        definitions = _parse_idl(type_name, text)
    else:
        definitions = {}
        for name, section in _sections(type_name, text, language):
            definitions.setdefault(name, tuple(_fields(name, section, language)))
    if language == "ros1msg":  # the fields are named as in ROS 2, so that paths are the same
        for name, number in (("time", "uint32"), ("duration", "int32")):
            definitions[name] = (Field("sec", number), Field("nanosec", number))
    else:
        definitions = {name: fields or _EMPTY for name, fields in definitions.items()}
    _check(type_name, definitions, language)
    return definitions


def _sections(type_name: str, text: str, language: str) -> Iterator[tuple[str, str]]:
    """Give the name of each type in a text and its part of the text."""
    first, *others = re.split(r"(?m)^={3,}[ \t]*$", text.replace("\r\n", "\n"))
    yield full_name(type_name), first
    for section in others:
        heading = re.match(r"\s*MSG:\s*(\S+)[^\n]*\n?", section)
        if heading is None:
            start = section.strip().partition("\n")[0]
            what = f"{type_name}: a section of the schema starts with '{start}' where 'MSG: package/Type' belongs"
            raise LogError(what, _only(language))
        yield full_name(heading[1]), section[heading.end() :]


def _fields(type_name: str, section: str, language: str) -> Iterator[Field]:
    package = type_name.partition("/")[0]
    for line in section.splitlines():
        statement = line.strip()
        if not statement or statement.startswith("#"):
            continue
        match = _LINE.match(statement)
        if match is None:
            raise LogError(
                f"{type_name}: '{statement}' in the schema is no field", _only(language)
            )
        if match["constant"] is not None:
            continue
        base = _type_of(match["base"], package, language)
        if match["brackets"] is None:
            yield Field(match["name"], base)
        elif match["bounded"] or not match["length"]:
            yield Field(match["name"], base, "sequence", 0)
        else:
            length = 0
            if len(match["length"]) <= 10:  # Python makes no number of thousands of digits
                length = int(match["length"])
            if not 0 < length <= LONGEST_ARRAY:
                array = f"{match['base']}[{match['length'][:12]}]"
                what = f"{type_name}: the schema has an array '{array}', which is none or too long"
                raise LogError(what, record_again(language))
            yield Field(match["name"], base, "array", length)


def _type_of(name: str, package: str, language: str) -> str:
    """Return the type that a name means in the definitions of a package."""
    if language == "ros1msg":
        if name in ("time", "duration"):
            return name
        name = _ROS1_SYNONYMS.get(name, name)
    if name == "Header":
        return "std_msgs/msg/Header"
    if name in PRIMITIVES or name in ("string", "wstring"):
        return name
    if "/" not in name:
        name = f"{package}/{name}"
    return full_name(name)


def _parse_idl(type_name: str, text: str) -> dict[str, tuple[Field, ...]]:
    """Parse OMG's interface language, in which ROS 2 describes messages that have no .msg file."""
    # It takes a while, and few logs have it.
    from rosbags.typesys import TypesysError, get_types_from_idl

    # The texts of all types in a schema, without the lines between them and those of the preprocessor.
    plain = re.sub(
        r"(?m)^(?:[ \t]*#|={3,}[ \t]*$|(?:IDL|MSG):).*$", "", text.replace("\r\n", "\n")
    )
    try:
        types = get_types_from_idl(plain)
    except (TypesysError, RecursionError, ValueError, AssertionError) as error:
        what = f"{type_name}: the schema is not ROS 2's part of IDL"
        lines = str(error).splitlines()
        if len(lines) == 1:  # more than one repeat the whole text
            what += f" ({lines[0]})"
        raise LogError(what, _only("ros2idl")) from error
    definitions = {}
    for name, (_, fields) in types.items():
        definitions[name] = tuple(_idl_field(type_name, *field) for field in fields)
    if full_name(type_name) not in definitions:
        raise LogError(f"{type_name}: the schema does not define it", record_again("ros2idl"))
    return definitions


def _idl_field(type_name: str, name: str, description: Any) -> Field:
    """Make a field of what rosbags says: node 1 is a primitive, 2 a type, 3 an array and 4 a sequence of these."""
    node, argument = description
    if node in (3, 4):
        element, length = argument
        base = _idl_type(*element)
        if node == 4:
            return Field(name, base, "sequence", 0)
        if not isinstance(length, int) or not 0 < length <= LONGEST_ARRAY:
            raise LogError(
                f"{type_name}: the schema has an array of '{length!s:.12}'",
                record_again("ros2idl"),
            )
        return Field(name, base, "array", length)
    return Field(name, _idl_type(node, argument))


def _idl_type(node: int, argument: Any) -> str:
    """Return the name of a type, or of a primitive, which is beside its size."""
    name: str = argument if node == 2 else argument[0]
    return name


def _check(type_name: str, definitions: Definitions, language: str) -> None:
    """Refuse definitions of which one is missing or contains itself, or which have more fields than any message."""
    graph: dict[str, list[str]] = {}
    for name, fields in definitions.items():
        graph[name] = [field.type_name for field in fields]
        for used in graph[name]:
            if "/" in used and used not in definitions:
                what = f"{type_name}: the schema uses {used} in {name} and does not define it"
                raise LogError(what, record_again(language))
    try:
        inner_first = tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        what = f"{type_name}: the schema's type {error.args[1][0]} contains itself"
        raise LogError(what, record_again(language)) from error
    paths: dict[str, int] = {}
    levels: dict[str, int] = {}
    for name in inner_first:
        fields = definitions.get(name, ())
        paths[name] = sum(
            1 + (field.kind != "single") + paths[field.type_name] for field in fields
        )
        levels[name] = 1 + max((levels[field.type_name] for field in fields), default=-1)
        if paths[name] > MOST_PATHS or levels[name] > MOST_LEVELS:
            raise too_large(type_name)


def too_large(type_name: str) -> LogError:
    """Return the error for a type of more than `MOST_PATHS` fields or `MOST_LEVELS` levels."""
    text = f"{type_name}: the schema means more than {MOST_PATHS} fields, or more than {MOST_LEVELS} within each other"
    return LogError(text, LEAVE_OUT)


def binary_paths(
    definitions: Definitions, type_name: str, prefix: str = ""
) -> Iterator[tuple[str, str]]:
    """Give every field path of a type, with the type of what is there."""
    for field in definitions[type_name]:
        path = f"{prefix}{field.name}"
        yield path, field.type_name
        if field.kind != "single":
            path = f"{path}[*]"
            yield path, field.type_name
        if field.type_name not in PRIMITIVES and field.type_name in definitions:
            yield from binary_paths(definitions, field.type_name, f"{path}.")


# --- Definitions that come with the tool.


def missing_types(type_name: str, text: str) -> list[str]:
    """List the types that a text of ROS 2 uses and does not define."""
    defined: dict[str, list[Field]] = {}
    for name, section in _sections(type_name, text, "ros2msg"):
        defined[name] = list(_fields(name, section, "ros2msg"))
    used: dict[str, None] = {}
    for fields in defined.values():
        used |= dict.fromkeys(field.type_name for field in fields)
    return [name for name in used if "/" in name and name not in defined]


def definition_text(type_name: str) -> str:
    """Return the full text of a type that comes with the tool: its own definition, then that of every type in it."""
    names = [full_name(type_name)]
    for name in names:
        for field in _fields(name, _known_text(name), "ros2msg"):
            if "/" in field.type_name and field.type_name not in names:
                names.append(field.type_name)
    sections = [_known_text(names[0])]
    for name in names[1:]:
        sections.append(f"{_RULE}\nMSG: {name.replace('/msg/', '/')}\n{_known_text(name)}")
    return "".join(sections)


@cache
def _known_text(type_name: str) -> str:
    package, _, name = type_name.partition("/msg/")
    # Other names are too long for a file, or lead elsewhere.
    if re.fullmatch(r"[a-z]\w{0,99}/msg/[A-Z]\w{0,99}", type_name, re.ASCII):
        for folder in definition_folders():
            file = folder / package / "msg" / f"{name}.msg"
            if file.is_file():
                return file.read_text("utf-8")
    raise LogError(
        f"{type_name}: no definition of this type comes with the tool", record_again("ros2msg")
    )


def definition_folders() -> tuple[Path, ...]:
    """Return where definitions are; ``schemas`` is beside the package in a checkout and inside it in a wheel."""
    logs = Path(__file__).parents[1]
    return logs / "definitions", logs.parent / "schemas", logs.parent.parent / "schemas"
