"""What the tool says to its user: errors that end the work, notes that go with the result."""

import difflib
import heapq
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from insdvl_replay.core.words import Severity

ALIKE: Final = 0.6
"""Share of letters that a misspelled name has in common with what was meant; of others it is no use to speak."""
LISTED: Final = 8
"""Names that a hint lists."""


class UserError(Exception):
    """One sentence with file, place and value, and a hint with something to copy.

    What is wrong, with the value that was found, follows the places from the outermost inwards: a file, a topic.
    """

    exit_code = 2

    def __init__(self, what: str, hint: str = "", *where: object) -> None:
        self.what = what
        self.hint = hint
        self.where = tuple(map(str, where))
        super().__init__(self.message)
        if hint:
            self.add_note(f"hint: {hint}")  # for those who see it raised in Python

    @property
    def message(self) -> str:
        """The whole sentence."""
        return ": ".join((*self.where, self.what))

    def inside(self, *known: object) -> str:
        """Return the sentence for whom it is clear already which places are meant."""
        places = {str(place) for place in known}
        return ": ".join((*(place for place in self.where if place not in places), self.what))

    def __reduce__(self) -> tuple[type["UserError"], tuple[str, ...]]:
        """Keep hint and places when the error crosses a process boundary."""
        return type(self), (self.what, self.hint, *self.where)


class ConfigError(UserError):
    """The command line or the configuration asks for something that cannot be (exit code 2)."""


class LogError(UserError):
    """A log cannot be used (exit code 3)."""

    exit_code = 3


class ResultError(UserError):
    """A stored result cannot be read (exit code 3)."""

    exit_code = 3


class LimitError(UserError):
    """A result is worse than its user allows (exit code 1)."""

    exit_code = 1


_COMPARED: Final = 500
"""Names that are compared with one letter by letter."""
_LONGEST: Final = 200
"""Letters of a name that are compared; a name that a user types has fewer."""


@contextmanager
def error_context(*where: object) -> Iterator[None]:
    """Begin the sentence of any user error inside with the places it concerns."""
    try:
        yield
    except UserError as error:
        raise type(error)(error.what, error.hint, *where, *error.where) from error


@contextmanager
def looked_for(path: Path) -> Iterator[None]:
    """State why the system cannot look for a file: too long a name, or a folder that may not be entered."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{path}: cannot be looked for: {error.strerror}", "check the path") from error


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name of which another may be a misspelling, None where none is like it."""
    return next(iter(most_like(name, known, most=1, least=ALIKE)), None)


def most_like(name: str, known: Iterable[str], most: int, least: float = 0.0) -> list[str]:
    """Return the known names that are most like another, the most like first.

    They have at least so large a share of letters in common with it.
    """
    starts = {other[:_LONGEST]: other for other in known}
    compared: Collection[str] = starts
    if len(starts) > _COMPARED:
        # To compare one takes a tenth of a millisecond: of thousands those with the same pairs of letters are enough.
        pairs = set(pairwise(name))
        compared = heapq.nlargest(_COMPARED, starts, key=lambda start: len(pairs.intersection(pairwise(start))))
    return [starts[start] for start in difflib.get_close_matches(name[:_LONGEST], compared, n=most, cutoff=least)]


def listed(names: Iterable[str], most: int = LISTED) -> str:
    """List names for a hint, and count those that would make it too long."""
    first = list(names)
    more = f" and {len(first) - most} more" if len(first) > most else ""
    return ", ".join(first[:most]) + more


def require_known(kind: str, name: str, known: Collection[str], *, within: str = "", most: int = LISTED) -> None:
    """Raise a ConfigError, with the nearest name that is known, if a name is not known.

    What stands before all of these names, such as ``dvl.``, is told with them.
    """
    if name not in known:
        raise ConfigError(f"{kind} '{within}{name}' is not known", hint_for(name, known, within=within, most=most))


def hint_for(name: str, known: Collection[str], *, within: str = "", most: int = LISTED) -> str:
    """Return the hint for a name that is not known: the nearest one, else those there are."""
    meant = nearest(name, known)
    return f"did you mean {within}{meant}?" if meant else f"known: {listed(known, most)}"


@dataclass(frozen=True)
class Note:
    """A warning as data: what was dropped, assumed or found odd, and how often."""

    code: str  # stable name for scripts, for example ``imu_gaps``
    text: str  # one sentence for people, with values and units
    count: int = 1  # samples, messages or places that it concerns
    severity: Severity = Severity.INFO
    hint: str = ""
