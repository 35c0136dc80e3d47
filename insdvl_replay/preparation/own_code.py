"""The user's own code, called where a mistake in it is told in a sentence: its readings, its prediction at the start.

Compiled code neither raises nor looks whether a column of H exists: what is wrong there would be read off no table.
"""

import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Final, TypeVar

import numpy as np

from insdvl_replay.core.compiled import plain
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import ConfigError, Note, UserError, listed
from insdvl_replay.core.states import states_with
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.initial_state import Start
from insdvl_replay.nav.own_measurement import INS_SIZE, OwnMeasurement, OwnReadings, Predict
from insdvl_replay.preparation.filters import ResolvedFilter

SHOWN: Final = "docs/own_measurement.md shows one"
POSITION: Final = 12
"""Its first column in H, of a filter that estimates it."""
_STEPS: Final = (1e-5, 1e-6, 1e-5, 1e-7, 0.01)
"""Of velocity m/s, misalignment rad, specific force m/s^2, angular rate rad/s and position m: far above what is rounded
off, far below what bends."""
_OFF: Final = 0.1
"""By how much of itself an entry of H may differ from differences: simplifications are told from wrong signs."""
_UP_N: Final = np.array([0.0, 0.0, -9.8])

_T = TypeVar("_T")


def called(word: str, own: OwnMeasurement, what: str, call: Callable[[], _T], hint: str) -> _T:
    """Call code of the user's; what it raises is an error of the settings that name it, with file and line.

    Raises
    ------
    ConfigError
        It raises, but for errors of arithmetic, which compiled code has none of.
    """
    try:
        return call()
    except (UserError, ArithmeticError):
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise ConfigError(f"{word}: {what} fails{_line(own, error)}: {said}", hint) from error


def _line(own: OwnMeasurement, error: Exception) -> str:
    """Say where in the user's module it happened."""
    file = getattr(sys.modules[type(own).__module__], "__file__", None)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" in line {lines[-1]} of {file}" if lines else ""


def asked_readings(word: str, own: OwnMeasurement, dive: Dive) -> OwnReadings:
    """Ask for the readings of a dive.

    Raises
    ------
    ConfigError
        The code raises, or gives something else.
    """
    topics = f"dive.topics has {listed(sorted(dive.topics))}" if dive.topics else "dive.topics is empty"
    hint = f"{topics}; a section [topics.NAME] adds one"
    try:
        readings = called(word, own, "readings(self, dive)", lambda: own.readings(dive), hint)
    except ArithmeticError as error:
        raise ConfigError(f"{word}: readings(self, dive) fails{_line(own, error)}: {error}", SHOWN) from error
    if not isinstance(readings, OwnReadings):
        raise ConfigError(f"{word}: readings(self, dive) gives {type(readings).__name__}, not OwnReadings", SHOWN)
    return readings


def tried_prediction(
    word: str, own: OwnMeasurement, size: int, filter_: ResolvedFilter, start: Start
) -> tuple[Note, ...]:
    """Predict once where a filter starts, and hold H against differences of z.

    Parameters
    ----------
    size : int
        Components of a reading.

    Returns
    -------
    tuple of Note
        A warning where H says something else than z, in an entry that is not zero, or is all zero.

    Raises
    ------
    ConfigError
        The code raises, as where it writes a column that the filter does not have.
    """
    predict, count = plain(own.predict), len(states_with(filter_.states))
    lacks = "" if "position" in filter_.states else '; states = ["position"] gives it columns 12 to 14'
    hint = f"filters.{filter_.name} has {count} error states: z is ({size},) and H ({size}, {count}){lacks}"
    ins, jacobian = _ins(start, np.zeros(15)), np.zeros((size, count))
    with np.errstate(all="ignore"):
        try:
            called(word, own, "predict(ins, z, H)", lambda: predict(ins, np.zeros(size), jacobian), hint)
            differences = _differences(predict, size, count, start, "position" in filter_.states)
        except ArithmeticError:  # at rest, as at 0 m/s, compiled code goes on
            return ()
    return tuple(_notes(word, jacobian, differences, filter_))


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


def _notes(word: str, jacobian: Floats, differences: Floats, filter_: ResolvedFilter) -> Iterator[Note]:
    hint = "H is the change of z by what the INS is off: docs/own_measurement.md has columns and signs"
    if not jacobian.any() and np.isfinite(jacobian).all():
        text = f"{word} leaves H at zero where filters.{filter_.name} starts: its readings change nothing there"
        yield Note("own_measurement_jacobian", text, severity=Severity.WARNING, hint=hint)
        return
    with np.errstate(invalid="ignore"):
        largest = np.abs(differences).max(axis=1, initial=0.0, keepdims=True)
        off = np.abs(jacobian - differences) > _OFF * np.maximum(np.abs(jacobian), 1e-3 * largest)
    wrong = np.argwhere(off & (jacobian != 0.0) & np.isfinite(differences) & np.isfinite(jacobian))
    if len(wrong):
        row, column = wrong[0]
        text = (
            f"H of {word} contradicts its z where filters.{filter_.name} starts: H[{row}, {column}] is "
            f"{jacobian[row, column]:.3g}, and z changes by {differences[row, column]:.3g}"
        )
        yield Note("own_measurement_jacobian", text, len(wrong), Severity.WARNING, hint)
