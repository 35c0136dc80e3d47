"""The user's own code, called where a mistake in it is told in a sentence: its readings, its prediction at the start.

Compiled code neither raises nor looks whether a column of H exists: what is wrong there would be read off no table.
"""

import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeVar

import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import ConfigError, Note, UserError, listed
from insdvl_replay.core.runtime import plain
from insdvl_replay.core.states import states_with
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_measurement import INS_SIZE, OwnMeasurement, OwnReadings, Predict
from insdvl_replay.preparation.filters import ResolvedFilter

SHOWN: Final = "docs/own_measurement.md shows one"
_PREDICT: Final = "predict(ins, z, H)"
_OUTSIDE: Final = ("math domain error", "expected ")
"""So begin the errors of `math` outside a function's domain, up to Python 3.13 and from 3.14 on."""
DOWN, POSITION = 2, 12
"""Columns of H: the velocity down, and the first of the position, of a filter that estimates it."""
_STEPS: Final = (1e-5, 1e-6, 1e-5, 1e-7, 0.01)
"""Of velocity m/s, misalignment rad, specific force m/s^2, angular rate rad/s and position m: far above what is rounded
off, far below what bends."""
_OFF: Final = 0.1
"""By how much of itself an entry of H may differ from differences: simplifications are told from wrong signs."""
_UP_N: Final = np.array([0.0, 0.0, -9.8])

_T = TypeVar("_T")


def called(word: str, own: OwnMeasurement, what: str, call: Callable[[], _T], hint: str) -> _T:
    """Call code of the user's; what it raises becomes a ConfigError with file and line."""
    try:
        return call()
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # one that leaves would end the run without a word
        said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise ConfigError(f"{word}: {what} fails{_line(own, error)}: {said}", hint) from error


def _line(own: OwnMeasurement, error: BaseException) -> str:
    """Say where in the user's module it happened."""
    file = getattr(sys.modules[type(own).__module__], "__file__", None)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" in line {lines[-1]} of {file}" if lines else ""


def asked_readings(word: str, own: OwnMeasurement, dive: Dive, held_out: Sequence[str]) -> OwnReadings:
    """Return the readings of a dive; ConfigError where the code raises, or gives something else."""
    topics = f"dive.topics has {listed(sorted(dive.topics))}" if dive.topics else "dive.topics is empty"
    hint = f"{topics}; a section [topics.NAME] adds one"
    if held_out:
        hint += f"; the {listed(held_out)} is held out (evaluation.withheld), with all that may be made of it"
    readings = called(word, own, "readings(self, dive)", lambda: own.readings(dive), hint)
    if not isinstance(readings, OwnReadings):
        raise ConfigError(f"{word}: readings(self, dive) gives {type(readings).__name__}, not OwnReadings", SHOWN)
    return readings


def uncompiled_prediction(word: str, own: OwnMeasurement, hint: str = SHOWN) -> Predict:
    """Return a prediction as it is, which where its arithmetic fails is no number, as in compiled code.

    Whatever else it raises is told as of `called`.
    """
    predict = plain(own.predict)

    def as_compiled(ins: Floats, z: Floats, H: Floats) -> None:
        try:
            with np.errstate(all="ignore"):
                predict(ins, z, H)
        except (ArithmeticError, ValueError) as error:
            if isinstance(error, ValueError) and not str(error).startswith(_OUTSIDE):
                raise
            z[:] = np.nan

    return lambda ins, z, H: called(word, own, _PREDICT, lambda: as_compiled(ins, z, H), hint)


def tried_prediction(
    word: str, own: OwnMeasurement, size: int, filter_: ResolvedFilter, start: Start
) -> tuple[bool, tuple[Note, ...]]:
    """Predict a reading once where a filter starts, and return whether it measures the velocity down, by half or more.

    A warning says where H contradicts z in an entry that is not zero, or is all zero, and where one component is not
    written. There is none where z is no number at the start, as a direction is none at rest. ConfigError where the code
    raises, as where it writes a column that the filter does not have.
    """
    count = len(states_with(filter_.states))
    lacks = "" if "position" in filter_.states else '; states = ["position"] gives it columns 12 to 14'
    hint = f"filters.{filter_.name} has {count} error states: z is ({size},) and H ({size}, {count}){lacks}"
    predict = uncompiled_prediction(word, own, hint)
    z, jacobian = np.zeros(size), np.zeros((size, count))
    with np.errstate(all="ignore"):
        predict(_ins(start, np.zeros(15)), z, jacobian)
        if not np.isfinite(z).all():
            return False, ()
        differences = _differences(predict, size, count, start, "position" in filter_.states)
    holds_height = bool(np.any(np.abs(jacobian[:, DOWN]) > 0.5))
    return holds_height, tuple(_notes(word, z, jacobian, differences, filter_))


def _differences(predict: Predict, size: int, count: int, start: Start, has_position: bool) -> Floats:
    """Return H by central differences of z, shape (s, n); zero for states that the user's code does not see."""
    found = np.zeros((size, count))
    for column in range(POSITION + 3 if has_position else POSITION):
        error, z = np.zeros(15), np.zeros((2, size))
        for side, sign in enumerate((1.0, -1.0)):
            error[column] = sign * _STEPS[column // 3]
            predict(_ins(start, error), z[side], np.zeros((size, count)))
        found[:, column] = (z[0] - z[1]) / (2.0 * _STEPS[column // 3])
    return found


def _ins(start: Start, error: Floats) -> Floats:
    """Return what an INS knows that is off by an error, shape (15,), in the order of H, from a vehicle at rest."""
    mat_nb = start.mat_nb + skew(error[3:6]) @ start.mat_nb
    ins = np.empty(INS_SIZE)
    ins[0:3], ins[3:6] = moved_position(start.position, error[12:15]), start.velocity_n + error[0:3]
    ins[6:15], ins[15:18], ins[18:21] = mat_nb.ravel(), start.mat_nb.T @ _UP_N + error[6:9], error[9:12]
    return ins


def _notes(word: str, z: Floats, jacobian: Floats, differences: Floats, filter_: ResolvedFilter) -> Iterator[Note]:
    hint = "H is the change of z by what the INS is off: docs/own_measurement.md has columns and signs"
    unwritten = np.flatnonzero((z == 0.0) & ~jacobian.any(axis=1))
    if len(unwritten) or not jacobian.any():
        left = f"z[{unwritten[0]}] and H[{unwritten[0]}]" if jacobian.any() else "H"
        text = f"{word} leaves {left} at zero where filters.{filter_.name} starts: its readings change nothing there"
        yield Note("own_measurement_jacobian", text, severity=Severity.WARNING, hint=hint)
    known = np.isfinite(differences)
    with np.errstate(invalid="ignore"):
        largest = np.abs(differences).max(axis=1, initial=0.0, where=known, keepdims=True)
        off = np.abs(jacobian - differences) > _OFF * np.maximum(np.abs(jacobian), 1e-3 * largest)
    wrong = np.argwhere(off & (jacobian != 0.0) & known & np.isfinite(jacobian))
    if len(wrong):
        row, column = wrong[0]
        text = (
            f"H of {word} contradicts its z where filters.{filter_.name} starts: H[{row}, {column}] is "
            f"{jacobian[row, column]:.3g}, and z changes by {differences[row, column]:.3g}"
        )
        yield Note("own_measurement_jacobian", text, len(wrong), Severity.WARNING, hint)
