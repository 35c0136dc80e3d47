"""What reaches the user: errors that end the work, notes that go with the result, and text from elsewhere.

A topic may hold whatever its recorder was given. A control character can move a terminal's cursor, a line break can
begin what a job's log takes for a command, and a character that is not seen can turn the others round. Each becomes an
escape that is seen. Escapes are for eyes: a backslash stays as it is, so they are not meant to be read back.
"""

import difflib
import errno
import heapq
import os
import re
import stat
import unicodedata
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

from insdvl_replay.core.urls import without_access
from insdvl_replay.core.words import Severity

# Share of letters that a misspelled name has in common with what was meant; of others it is no use to speak.
ALIKE: Final = 0.6
LISTED: Final = 8  # Names that a hint lists.
_COMPARED: Final = 500  # Names that are compared with one letter by letter.
_LONGEST: Final = 200  # Letters of a name that are compared; a name that a user types has fewer.
# Categories of Unicode: control, format that is not seen (bidi, joiners), lone surrogates, breaks of lines.
_ACTING: Final = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
_COMMAND: Final = re.compile(r"^([^\S\n]*):(?=:)", re.MULTILINE)
_OLD_COMMAND: Final = re.compile(r"#(?=#\w*\[)")
# Of a text that is read: more than anybody writes by hand; a device may go on without end.
_MOST_BYTES: Final = 1 << 24


_NAMES: Final[dict[str, str]] = {}


def show_as(path: Path, name: str) -> None:
    """Have errors and messages name a file otherwise: a fetched log by its URL, which people know."""
    _NAMES[str(path)] = name


def as_shown(text: str) -> str:
    """Return a text with the names of files that people know, and URLs without what gives access to them."""
    for path, name in _NAMES.items():
        text = text.replace(path, name)
    return without_access(text)


class UserError(Exception):
    """One sentence with file, place and value, and a hint with something to copy.

    What is wrong, with the value that was found, follows the places from the outermost inwards: a file, a topic.
    """

    exit_code = 2

    def __init__(self, what: str, hint: str = "", *where: object) -> None:
        self.what = as_shown(what)
        self.hint = as_shown(hint)
        self.where = tuple(as_shown(str(place)) for place in where)
        super().__init__(self.message)
        if self.hint:
            self.add_note(f"hint: {self.hint}")  # for those who see it raised in Python

    @property
    def message(self) -> str:
        """The whole sentence."""
        return ": ".join((*self.where, self.what))

    def inside(self, *known: object) -> str:
        """Return the sentence without the places that the reader knows already."""
        places = {as_shown(str(place)) for place in known}
        return ": ".join((*(place for place in self.where if place not in places), self.what))

    def __reduce__(self) -> tuple[type["UserError"], tuple[str, ...]]:
        """Keep hint and places when the error crosses a process boundary."""
        return type(self), (self.what, self.hint, *self.where)


class ConfigError(UserError):
    """The command line or the configuration asks for something that cannot be (exit code 2)."""


class TargetError(ConfigError):
    """A result cannot be written where it was asked for (exit code 2). No settings of the replay change that."""


class LogError(UserError):
    """A log cannot be used (exit code 3)."""

    exit_code = 3


class ResultError(UserError):
    """A stored result cannot be read (exit code 3)."""

    exit_code = 3


class LimitError(UserError):
    """A result is worse than its user allows (exit code 1)."""

    exit_code = 1


@dataclass(frozen=True)
class Note:
    """A warning as data: what was dropped, assumed or found odd, and how often."""

    code: str  # stable name for scripts, for example ``imu_gaps``
    text: str  # one sentence for people, with values and units
    count: int = 1  # samples, messages or places that it concerns
    severity: Severity = Severity.INFO
    hint: str = ""

    def about(self, place: object) -> "Note":
        """Return the note with what it is about in front of its sentence."""
        return replace(self, text=f"{place}: {self.text}")

    @property
    def is_finding(self) -> bool:
        """Whether it reports settings that were found or assumed."""
        return self.code.startswith("found_")

    @property
    def finding(self) -> str:
        """What was found or assumed, as a line of its own."""
        if self.severity == Severity.WARNING:
            return f"assumed: {self.text}"
        return f"found: {self.text}"

    @property
    def is_own_finding(self) -> bool:
        """Whether it says that a dive has settings of its own, other than those of its vehicle."""
        return self.code == "found_own"


@contextmanager
def error_context(*where: object) -> Iterator[None]:
    """Begin the sentence of any user error inside with the places it concerns, the outermost first."""
    try:
        yield
    except UserError as error:
        raise type(error)(error.what, error.hint, *where, *error.where) from error


@contextmanager
def looked_for(path: Path) -> Iterator[None]:
    """Report why the system cannot look for a file: too long a name, or a folder that may not be entered.

    Raises
    ------
    ConfigError
        In place of an OSError of the block.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(
            f"{path}: is not a usable path: {error.strerror}", "check the path"
        ) from error


# --- Names that were meant


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name of which another may be a misspelling, None where none is like it."""
    return next(iter(most_like(name, known, most=1, least=ALIKE)), None)


def most_like(
    name: str,
    known: Iterable[str],
    most: int,
    least: float = 0.0,
) -> list[str]:
    """Return known names that are like another one, the most like first.

    Parameters
    ----------
    name : str
        The other name.
    known : iterable of str
        Names to choose from.
    most : int
        How many are returned at most.
    least : float
        Share of letters, from 0 to 1, that a name must have in common with the other one.
    """
    starts = {other[:_LONGEST]: other for other in known}
    compared: Collection[str] = starts
    if len(starts) > _COMPARED:
        # To compare one takes a tenth of a millisecond: of thousands those with the same pairs of letters are enough.
        pairs = set(pairwise(name))
        compared = heapq.nlargest(
            _COMPARED, starts, key=lambda start: len(pairs.intersection(pairwise(start)))
        )
    return [
        starts[start]
        for start in difflib.get_close_matches(name[:_LONGEST], compared, n=most, cutoff=least)
    ]


def listed(names: Iterable[str], most: int = LISTED) -> str:
    """List names for a hint, and count those that would make it too long."""
    first = list(names)
    more = f" and {len(first) - most} more" if len(first) > most else ""
    return ", ".join(first[:most]) + more


def counted(count: int, noun: str) -> str:
    """Write a count with its noun."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


_SINGULAR: Final = {
    "are": "is",
    "have": "has",
    "repeat": "repeats",
    "overlap": "overlaps",
    "count": "counts",
}


def counted_clause(count: int, clause: str) -> str:
    """Write a count with a clause about several, such as ``gaps are longer than 1 s``; one gap *is* longer."""
    if count != 1:
        return f"{count} {clause}"
    end = re.search("[:;]|$", clause).start()  # type: ignore[union-attr]
    first, *words = clause[:end].split(" ")
    if first.endswith("ies"):
        first = f"{first[:-3]}y"
    first = first.removesuffix("s")
    return f"1 {' '.join([first, *(_SINGULAR.get(word, word) for word in words)])}{clause[end:]}"


def require_known(
    kind: str,
    name: str,
    known: Collection[str],
    *,
    most: int = LISTED,
) -> None:
    """Require that a name is known.

    Parameters
    ----------
    kind : str
        What it is a name of, for the sentence: ``filter``.
    name : str
        The name.
    known : collection of str
        All names that there are.
    most : int
        How many of them a hint lists.

    Raises
    ------
    ConfigError
        The name is not known. The hint has the nearest one that is.
    """
    if name not in known:
        raise ConfigError(f"{kind} '{name}' is not known", hint_for(name, known, most=most))


def hint_for(name: str, known: Collection[str], *, most: int = LISTED) -> str:
    """Return the hint for a name that is not known: the nearest one, else those there are."""
    meant = nearest(name, known)
    if meant:
        return f"did you mean {meant}?"
    return f"known: {listed(known, most)}"


# --- Text from elsewhere


def read_text(path: Path) -> str:
    """Read a text in UTF-8, with or without the mark that some editors put in front.

    Raises
    ------
    OSError
        The file cannot be read, or has more than 16 MiB.
    UnicodeDecodeError
        It is not UTF-8.
    """
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data.decode("utf-8-sig")


def read_regular(path: Path, most_bytes: int) -> bytes:
    """Read a file that others name, such as a path in settings.

    Raises
    ------
    OSError
        The file cannot be read, is no regular file, or has more than so many bytes.
    """
    # A named pipe is not waited for.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        state = os.fstat(file.fileno())
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        # Python takes the memory before it reads.
        data = file.read(min(state.st_size, most_bytes) + 1)
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes >> 20} MiB", str(path))
    return data


NaturalKey = tuple[tuple[bool, int, str], ...]


def natural_key(text: str) -> NaturalKey:
    """Return a key that sorts names by their letters, and the numbers in them by size: dive 2 before dive 10."""
    words = re.findall(r"\d+|\D+", text)
    return tuple(
        (not word.isdecimal(), int(word) if word.isdecimal() else 0, word) for word in words
    )


def visible(text: str) -> str:
    r"""Make one line of a text, with ``\x1b`` or ``\u202e`` for what acts and is not seen, ends of lines and tabs too.

    What is such a text already stays as it is. ``##[`` and ``##name[``, which job runners take for commands anywhere in
    a line, lose their beginning. From ``\u0080`` on, escapes are those of TOML, which has none of two digits.
    """
    if "##" in text:
        text = _OLD_COMMAND.sub(lambda _: "\\u0023", text)
    if text.isprintable():
        return text
    return "".join(map(_shown, text))


def _shown(character: str) -> str:
    if unicodedata.category(character) not in _ACTING:
        return character
    code = ord(character)
    if code < 0x80:
        return f"\\x{code:02x}"
    if code < 0x10000:
        return f"\\u{code:04x}"
    return f"\\U{code:08x}"


def visible_lines(text: str) -> str:
    """Do the same with a text of several lines, which stay lines."""
    return "\n".join(map(visible, text.split("\n")))


def without_commands(text: str) -> str:
    """Let no line of a text begin as commands to a job runner do: the first of two colons becomes an escape.

    GitHub takes a line for a command that begins with ``::``, on stdout and on stderr, after blanks too.
    """
    return _COMMAND.sub(r"\1\\u003a", text)


def is_writable(text: str) -> bool:
    """Return whether a text can be written as UTF-8: a file's name of other bytes cannot, as Python reads it."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
