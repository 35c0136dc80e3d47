"""All notes: what each says, how severe it is, and what it means. `notes.toml` is the table of them.

A note of a new code is an entry in the table and a call of `note`::

    notes.append(note("dvl_three_beams", count))
    notes.append(note(f"{sensor}_silent", sensor=sensor, length=length_s, since=since_s))

No other module makes notes, so that the table has all of them.
"""

from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import ConfigError, Note, counted_clause, nearest
from insdvl_replay.core.states import SENSORS
from insdvl_replay.core.words import Severity

SOURCES: Final = ("imu", "dvl", "reference", "truth", *SENSORS, "solution", "topics.NAME")
"""What a ``*`` at the beginning of a code stands for."""


class Sentence(msgspec.Struct, frozen=True):
    """What a note says, with fields for values, as `str.format` has them.

    ``{count}`` is the count of the note. ``{counted:gaps are long}`` is the count and a clause about several, which is
    written about one where the count is 1: ``1 gap is long``.
    """

    severity: Severity
    text: str
    hint: str = ""


class NoteKind(msgspec.Struct, frozen=True, kw_only=True):
    """What the notes of a code say, and what they mean, in one or two short sentences each."""

    severity: Severity = Severity.INFO
    text: str = ""  # empty where the code has only other sentences
    hint: str = ""
    other: dict[str, Sentence] = {}  # by a word: other sentences of the same code
    what: str  # what happened
    effect: str  # what it does to the results
    cure: str  # what to do: a command or a settings key to copy


def note(code: str, count: int = 1, severity: Any = None, **fields: Any) -> Note:
    """Make a note of a code.

    Parameters
    ----------
    code : str
        As in the table; behind it, after a blank, the word of another sentence of the code: ``dvl_bad_residual most``.
    count : int
        Samples, messages or places that it concerns. The sentence has it as ``count`` and ``counted``.
    severity : Severity, optional
        Instead of that in the table.
    fields
        Values for the fields of sentence and hint.

    Raises
    ------
    ValueError
        If the table has no such code or no such sentence, or a field has no value.
    """
    name, _, word = code.partition(" ")
    said = _sentence(name, word)
    fields["count"] = count
    fields["counted"] = _Counted(count)
    try:
        text = said.text.format(**fields)
        hint = said.hint.format(**fields)
    except KeyError as error:
        raise ValueError(f"the note {code} has no value of its field {error}") from error
    return Note(name, text, count, severity or said.severity, hint)


def text_of(code: str, **fields: Any) -> str:
    """Return the sentence of a code, for an error that says the same; its fields are those of `note`."""
    name, _, word = code.partition(" ")
    return _sentence(name, word).text.format(**fields)


class _Counted(int):
    """A count that is written with a clause."""

    def __format__(self, clause: str) -> str:
        return counted_clause(int(self), clause)


def _sentence(code: str, word: str) -> Sentence:
    """Return the sentence of a code, or another of its sentences by its word."""
    kind = _kind(code)
    if kind is not None and word in kind.other:
        return kind.other[word]
    if kind is not None and kind.text and not word:
        return Sentence(kind.severity, kind.text, kind.hint)
    raise ValueError(f"notes.toml has no sentence of {code} {word}".rstrip())


@cache
def explanations() -> dict[str, dict[str, NoteKind]]:
    """Return all notes by subject and code; a ``*`` in a code stands for a source or a filter."""
    text = resources.files("insdvl_replay").joinpath("core", "notes.toml").read_text("utf-8")
    return msgspec.toml.decode(text, type=dict[str, dict[str, NoteKind]])


@cache
def _kinds() -> dict[str, NoteKind]:
    """Return all notes by code."""
    kinds: dict[str, NoteKind] = {}
    for subject in explanations().values():
        kinds |= subject
    return kinds


@cache
def _kind(code: str) -> NoteKind | None:
    """Return what there is on a code: by itself, else by the longest pattern that fits; None if there is nothing."""
    kinds = _kinds()
    if code in kinds:
        return kinds[code]
    patterns = [pattern for pattern in kinds if fnmatchcase(code, pattern)]
    if patterns:
        return kinds[max(patterns, key=len)]
    return None


def explanation(code: str) -> NoteKind:
    """Return what a code means.

    Raises
    ------
    ConfigError
        The code is not known. The hint has the nearest one.
    """
    kind = _kind(code)
    if kind is not None:
        return kind
    codes = []
    for pattern in _kinds():
        codes += [pattern.replace("*", source) for source in SOURCES]
    meant = nearest(code, dict.fromkeys(codes))
    hint = f"did you mean {meant}?" if meant else "`insdvl-replay explain` lists all codes"
    raise ConfigError(f"code '{code}' is not known", hint)
