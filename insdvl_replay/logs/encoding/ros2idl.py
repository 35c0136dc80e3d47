"""The part of OMG's interface language in which ROS 2 describes messages that have no .msg file, parsed to definitions.

Structures stand in modules, ``module pkg { module msg { struct Type { double x; sequence<float> all; }; }; };``, those
of a message and of all in it one behind the other, each behind a line ``IDL: pkg/msg/Type``. Comments, lines for the
preprocessor and annotations say nothing about the layout. Sources: https://design.ros2.org/articles/idl_interface_definition.html
for the part of the language, https://mcap.dev/spec/registry#ros2idl for the text, OMG's "Interface Definition
Language", version 4.2, for names and scopes.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from typing import Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.encoding.ros2msg import (
    LONGEST_ARRAY,
    ROS2IDL,
    Definition,
    Field,
    check_complete,
    full_name,
)

_TOKEN: Final = re.compile(
    r"(?P<skipped>\s+|//[^\n]*|/\*.*?\*/|(?m:^[ \t]*#[^\n]*)|(?m:^={3,}[ \t]*$)|(?m:^(?:IDL|MSG):[^\n]*$))"
    r'|(?P<text>L?"(?:[^"\\]|\\.)*"|L?\'(?:[^\'\\]|\\.)*\')'
    r"|(?P<name>(?:::)?[A-Za-z_]\w*(?:::[A-Za-z_]\w*)*)"
    r"|(?P<number>\.?\d[\w.]*)"
    r"|(?P<sign>.)",
    re.DOTALL,
)
_PRIMITIVES: Final = {
    "boolean": "bool",
    "octet": "byte",
    "char": "char",
    "short": "int16",
    "unsigned short": "uint16",
    "long": "int32",
    "unsigned long": "uint32",
    "long long": "int64",
    "unsigned long long": "uint64",
    "float": "float32",
    "double": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
_WORDS: Final = ("unsigned", "long", "short", "double")
"""Of which the names of some types are made."""
_WORDS_ALONE: Final = tuple([word] for word in _WORDS)
_MOST_TOKENS: Final = 1 << 20


@dataclass(frozen=True)
class _Type:
    """A type as it is called inside some modules, in a sequence or not, and the sizes behind the name that has it."""

    name: str
    in_sequence: bool = False
    sizes: tuple[int, ...] = ()
    modules: tuple[str, ...] = ()


@dataclass
class _Parser:
    """Goes through the tokens once, and keeps structures and other names of types by their scoped names."""

    type_name: str
    tokens: list[str]
    place: int = 0
    structures: dict[str, list[tuple[str, _Type]]] = field(default_factory=dict)
    others: dict[str, _Type] = field(default_factory=dict)

    def text(self) -> None:
        """Pass over modules and what is in them."""
        modules: list[str] = []
        while self.place < len(self.tokens):
            statement = self.next()
            if statement == "module":
                modules.append(self.next())
                self.need("{")
                continue
            if statement == "}" and modules:
                modules.pop()
            elif statement == "struct":
                self.structure("::".join(modules))
            elif statement == "typedef":
                self.others.update((f"{'::'.join(modules)}::{name}", type_) for name, type_ in self.declared(modules))
            elif statement == "const":
                while self.tokens[self.place : self.place + 1] not in ([";"], []):
                    self.next()
            else:
                raise self.wrong(statement)
            self.need(";")
        if modules:
            raise self.wrong("the end")

    def structure(self, scope: str) -> None:
        """Pass over a structure."""
        name, members = f"{scope}::{self.next()}", list[tuple[str, _Type]]()
        self.need("{")
        while not self.found("}"):
            members += self.declared(scope.split("::"))
            self.need(";")
        self.structures.setdefault(name, members)

    def declared(self, modules: Sequence[str]) -> Iterator[tuple[str, _Type]]:
        """Pass over a type and the names that have it, such as ``double a, b[3][3]``."""
        type_ = self.type(modules)
        while True:
            name, sizes = self.next(), list[int]()
            while self.found("["):
                sizes.append(self.size())
                self.need("]")
            yield name, replace(type_, sizes=tuple(sizes))
            if not self.found(","):
                return

    def type(self, modules: Sequence[str]) -> _Type:
        """Pass over the name of a type; one that is not primitive is kept with the modules around it."""
        word = self.next()
        if word == "sequence":
            self.need("<")
            inner = self.type(modules)
            if inner.in_sequence:
                raise self.lists_of_lists()
            self.bound(",")
            self.need(">")
            return replace(inner, in_sequence=True)
        if word in ("string", "wstring"):
            if self.found("<"):
                self.size()
                self.need(">")
            return _Type(word)
        while word.split()[-1] in _WORDS and self.tokens[self.place : self.place + 1] in _WORDS_ALONE:
            word = f"{word} {self.next()}"
        return _Type(_PRIMITIVES[word]) if word in _PRIMITIVES else _Type(word, modules=tuple(modules))

    def bound(self, sign: str) -> None:
        """Pass over the longest that a sequence may be."""
        if self.found(sign):
            self.size()

    def size(self) -> int:
        """Pass over a number of elements."""
        word = self.next()
        # Python makes no number of thousands of digits.
        size = int(word) if word.isdecimal() and len(word) <= len(str(LONGEST_ARRAY)) else 0
        if not 0 < size <= LONGEST_ARRAY:
            raise LogError(f"{self.type_name}: the schema has an array of '{word[:12]}'", ROS2IDL.record_again)
        return size

    def next(self) -> str:
        """Return a token and go behind it."""
        if self.place >= len(self.tokens):
            raise self.wrong("the end")
        self.place += 1
        return self.tokens[self.place - 1]

    def found(self, token: str) -> bool:
        """Go behind a token if it stands here."""
        is_there = self.tokens[self.place : self.place + 1] == [token]
        self.place += is_there
        return is_there

    def need(self, token: str) -> None:
        """Go behind a token that must stand here."""
        if not self.found(token):
            raise self.wrong(self.next())

    def wrong(self, token: str) -> LogError:
        """Make the error of what does not belong where it stands."""
        return LogError(f"{self.type_name}: '{token[:40]}' in the schema is not where it belongs", ROS2IDL.only_this)

    def lists_of_lists(self) -> LogError:
        """Make the error of what no field of a `Definition` can be."""
        return LogError(f"{self.type_name}: the schema has lists of lists, which are not read", _LEAVE)


_LEAVE: Final = "leave its topic out of the roles"


def parse_idl(type_name: str, text: str) -> dict[str, Definition]:
    """Parse the full text of a type.

    Raises
    ------
    LogError
        It is of another language, not complete, or has unions, structures that inherit, or lists of lists.
    """
    parser = _Parser(type_name, list(_tokens(type_name, text)))
    parser.text()
    definitions = {
        name.replace("::", "/"): Definition(
            name.replace("::", "/"), tuple(_field(parser, member, type_) for member, type_ in members) or ROS2IDL.empty
        )
        for name, members in parser.structures.items()
    }
    if full_name(type_name) not in definitions:
        raise LogError(f"{type_name}: the schema does not define it", ROS2IDL.record_again)
    check_complete(type_name, definitions, ROS2IDL)
    return definitions


def _tokens(type_name: str, text: str) -> Iterator[str]:
    """Part a text into names, numbers and signs, without annotations, which are ``@name`` or ``@name(...)``."""
    found = (match for match in _TOKEN.finditer(text.replace("\r\n", "\n")) if match.lastgroup != "skipped")
    annotated, depth = False, 0
    for number, match in enumerate(found):
        if number > _MOST_TOKENS:
            raise LogError(f"{type_name}: the schema is longer than any", _LEAVE)
        token = match[0]
        if token == "@" and not depth:
            annotated = True
        elif annotated and match.lastgroup == "name" and not depth:
            annotated, depth = False, -1
        elif depth and token == "(":
            depth = 1 if depth < 0 else depth + 1
        elif depth > 0:
            depth -= token == ")"
        else:
            depth = 0
            yield token


def _field(parser: _Parser, name: str, type_: _Type) -> Field:
    """Make a field, with what other names of types stand for."""
    sizes, in_sequence = type_.sizes, type_.in_sequence
    for _ in range(len(parser.others) + 1):
        meant = next((one for one in _meant(type_) if one in parser.structures or one in parser.others), type_.name)
        if meant not in parser.others:
            break
        type_ = parser.others[meant]
        if in_sequence and (type_.in_sequence or type_.sizes):
            raise parser.lists_of_lists()
        sizes, in_sequence = (*sizes, *type_.sizes), in_sequence or type_.in_sequence
    if in_sequence and sizes:
        raise parser.lists_of_lists()
    name_there = meant.removeprefix("::").replace("::", "/")
    if in_sequence:
        return Field(name, name_there, "sequence", 0)
    return Field(name, name_there, "array", prod(sizes)) if sizes else Field(name, name_there, "single", 1)


def _meant(type_: _Type) -> Iterator[str]:
    """List what the name of a type may mean inside its modules, the innermost first."""
    if not type_.name.startswith("::"):
        yield from ("::".join((*type_.modules[:depth], type_.name)) for depth in range(len(type_.modules), 0, -1))
    yield type_.name.removeprefix("::")
