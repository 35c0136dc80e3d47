"""A user-defined measurement: a class with its readings and its prediction by the INS, named in ``aiding``.

    class Speed(UserMeasurement):
        name, unit = "speed", "m/s"

        def readings(self, dive):
            log = dive.topics["speed_log"]
            return UserReadings(log.time_ns, log.values, np.array([0.05]))

        @staticmethod
        def predict(ins, z, H):
            north, east, down = ins[3], ins[4], ins[5]
            z[0] = np.sqrt(north**2 + east**2 + down**2)
            H[0, 0], H[0, 1], H[0, 2] = north / z[0], east / z[0], down / z[0]

``aiding = ["velocity", "my_package.module:Speed"]`` then aids by it, ``[topics.speed_log]`` names topic and field.
Every table has rows for it, by its name.
"""

import ast
import importlib
import inspect
import linecache
import math
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from types import BuiltinFunctionType
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Dive, Floats, TimeNs
from insdvl_replay.core.quantities import is_reserved, is_whole
from insdvl_replay.core.runtime import plain

Predict = Callable[[Floats, Floats, Floats], None]
Predicts = Callable[[int, Floats, Floats, Floats], None]
"""Several predictions, of which the number in front chooses one."""

Kind = TypeVar("Kind")

INS_SIZE: Final = 21
"""Numbers of ``ins``: position (rad, rad, m), velocity_n, mat_nb row by row, specific_force_b, rate_eb_b."""


@dataclass(frozen=True)
class UserReadings:
    """The readings of a user-defined measurement."""

    time_ns: TimeNs  # (k,), times of validity, strictly increasing
    values: Floats  # (k,), or (k, s), s is 1 to 4
    sd: Floats  # a number, (s,) or (k, s), noise of the independent components; (k,) for one component


@dataclass(frozen=True)
class NoiseFactors:
    """Factors of the white noise of the readings. Each row holds until the next; before the first they are one."""

    time_ns: TimeNs  # (k,), strictly increasing
    # (k, 6), of the standard deviations of accelerometers and gyros, axis by axis in b
    factors: Floats

    def within(self, start_ns: int, end_ns: int) -> "NoiseFactors":
        """Keep the row that holds at the start, if one does, and those up to the end."""
        first, last = np.searchsorted(self.time_ns, (start_ns, end_ns), "right")
        rows = slice(max(int(first) - 1, 0), int(last))
        return NoiseFactors(self.time_ns[rows], self.factors[rows])


class UserMeasurement:
    """A user-defined measurement; made without arguments."""

    name: str = ""  # in the tables: letters, digits and ``_``
    unit: str = ""  # of its values

    def readings(self, dive: Dive) -> UserReadings:
        """Return the readings of a dive: from its columns, from ``dive.topics``, or from a file of your own.

        It is called again on dives without the pings of an outage. No dive contains data that are held out of the
        filters.
        """
        raise NotImplementedError

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write the reading that the INS predicts, and its Jacobian.

        It is compiled with the filter if it can be: numbers, loops and numpy's functions of numbers. Otherwise it runs
        as Python, and the filter with it, some hundred times slower.

        Parameters
        ----------
        ins : ndarray, shape (21,)
            The INS: position (latitude and longitude rad, height m) 0 to 2, velocity in n 3 to 5, attitude b to n row
            by row 6 to 14, specific force in b 15 to 17, angular rate against the Earth in b 18 to 20.
        z : ndarray, shape (s,)
            Written.
        H : ndarray, shape (s, n)
            Zero; written. Columns are estimated minus true: velocity in n 0 to 2, misalignment in n 3 to 5; of biases
            true minus estimated: accelerometers 6 to 8, gyros 9 to 11; and the position in n, m, 12 to 14 of a filter
            that estimates it.
        """
        raise NotImplementedError


class UserNoise:
    """The noise of the inertial sensors as your code finds it; made without arguments."""

    def noise_factors(self, dive: Dive) -> tuple[TimeNs, Floats]:
        """Return times, shape (k,), and factors of the white noise that the settings give.

        Factors of shape (k, 2) are of accelerometers and gyros, of shape (k, 6) of their axes x, y, z in b. A factor
        holds until the next time. It is called again on dives without the pings of an outage.
        """
        raise NotImplementedError


def load_class(word: str, base: type[Kind]) -> type[Kind]:
    """Import a class by ``module:Class``, derived from a base; a ValueError says why that fails."""
    module, _, name = word.partition(":")
    try:
        imported: Any = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, ImportError) else f"{type(error).__name__}: "
        raise ValueError(f"cannot be imported: {kind}{error}") from error
    found = getattr(imported, name, None)
    if found is None:
        near = get_close_matches(name, vars(imported), n=1)
        raise ValueError(
            f"is not in {module}" + (f"; the nearest name is {near[0]}" if near else "")
        )
    if not (isinstance(found, type) and issubclass(found, base)):
        raise ValueError(f"is not a class derived from {base.__name__}")
    return found


def failure_text(error: BaseException, kind: type) -> str:
    """Return where the code of a class raised an exception, and which: ``in line 3 of mine.py: ValueError: ...``."""
    files = _files_of(kind)
    where = ""
    for frame in traceback.extract_tb(error.__traceback__):
        if frame.filename in files:
            where = f" in line {frame.lineno} of {frame.filename}"
    return f"{where}: {type(error).__name__}" + (f": {error}" if str(error) else "")


def _files_of(kind: type) -> set[str]:
    """Return the files of a class and of the classes that it derives from, without those of this program."""
    files = set()
    for base in kind.__mro__:
        package, *_ = base.__module__.split(".")
        file = getattr(importlib.import_module(base.__module__), "__file__", None)
        if file and package != __name__.split(".")[0]:
            files.add(file)
    return files


def is_of_math(error: ValueError) -> bool:
    """Return whether a function of `math` raised an error, as it does outside its domain.

    Such an error has no code. But a function that is not written in Python has no frame of its own, so that the
    innermost one is its caller's, at the call.
    """
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return False
    frame = trace.tb_frame
    positions = [*frame.f_code.co_positions()]
    names = _called_at(frame.f_code.co_filename, positions[trace.tb_lasti // 2])
    if not names:
        return False
    first, *others = names
    called = (frame.f_globals | frame.f_locals).get(first)
    for name in others:
        called = getattr(called, name, None)
    return isinstance(called, BuiltinFunctionType) and called.__module__ == math.__name__


@cache
def _called_at(
    file: str,
    place: tuple[int | None, int | None, int | None, int | None],  # lines, and columns in bytes
) -> tuple[str, ...]:
    """Return the dotted name of the function that is called at a place of a file; empty where none is."""
    try:
        tree = ast.parse("".join(linecache.getlines(file)))
    except SyntaxError:
        return ()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            found = (node.lineno, node.end_lineno, node.col_offset, node.end_col_offset)
            name = ast.unparse(node.func)
            if found == place and name.replace(".", "").isidentifier():
                return tuple(name.split("."))
    return ()


def load_plugin(word: str, base: type[Kind]) -> Kind:
    """Import a class by ``module:Class`` and make an object; a ValueError says why that fails."""
    found = load_class(word, base)
    try:
        user = found()
    except (Exception, SystemExit) as error:
        raise ValueError(f"cannot be created without arguments: {error}") from error
    if isinstance(user, UserMeasurement):
        _require_whole(user)
    elif isinstance(user, UserNoise) and type(user).noise_factors is UserNoise.noise_factors:
        raise ValueError("has no method noise_factors(self, dive)")
    return user


def _require_whole(user: UserMeasurement) -> None:
    """Require the name, the unit and the methods of a measurement."""
    name = str(user.name)
    mistakes = (
        (not isinstance(user.name, str), f"has the name {user.name!r}, which is not text"),
        (not isinstance(user.unit, str), f"has the unit {user.unit!r}, which is not text"),
        (
            not (name.isidentifier() and is_whole(name)),
            f"has the name '{name}', which is not allowed in tables",
        ),
        (is_reserved(name), f"has the name '{name}', which is a built-in measurement"),
        (type(user).readings is UserMeasurement.readings, "has no method readings(self, dive)"),
        (user.predict is UserMeasurement.predict, "has no method predict(ins, z, H)"),
        (
            inspect.ismethod(user.predict),
            "has a predict that is not a static method: write @staticmethod above predict(ins, z, H)",
        ),
    )
    for is_wrong, text in mistakes:
        if is_wrong:
            raise ValueError(text)


def compiled_prediction(predict: Predict) -> Predict | None:
    """Compile a prediction so that `joined` can call it; None where that fails, or where nothing is compiled."""
    import numba
    from numba.core import config

    if getattr(config, "DISABLE_JIT", False):
        return None
    try:
        made: Any = numba.njit(_signature(), error_model="numpy")(plain(predict))
    except Exception:  # numba raises its own errors for some code, and Python's for other code
        return None
    found: Predict = made
    return found


def joined(predictions: Sequence[Predict], *, compiled: bool) -> Predicts:
    """Make one function of all predictions, so that the filter is the same code for any number of them.

    The result is compiled where all predictions are from `compiled_prediction`.
    """
    import numba
    from numba import types

    def last(predict: Predict) -> Predicts:
        def chosen(
            which: int,
            ins: Floats,
            z: Floats,
            H: Floats,
        ) -> None:
            predict(ins, z, H)

        return chosen

    def first_or(predict: Predict, others: Predicts) -> Predicts:
        def chosen(
            which: int,
            ins: Floats,
            z: Floats,
            H: Floats,
        ) -> None:
            if which == 0:
                predict(ins, z, H)
            else:
                others(which - 1, ins, z, H)

        return chosen

    chosen = last(predictions[-1])
    for predict in reversed(predictions[:-1]):
        chosen = first_or(predict, numba.njit(error_model="numpy")(chosen) if compiled else chosen)
    if not compiled:
        return chosen
    found: Predicts = numba.cfunc(
        types.void(types.int64, *_signature().args), error_model="numpy"
    )(chosen)
    return found


def _signature() -> Any:
    from numba import types

    vector = types.Array(types.float64, 1, "C")
    matrix = types.Array(types.float64, 2, "C")
    return types.void(vector, vector, matrix)


def checked_readings(readings: UserReadings) -> UserReadings:
    """Require what the filter relies on, shapes (k,), (k, s) and (k, s); a ValueError says what is wrong."""
    time_ns = np.asarray(readings.time_ns)
    values = _numbers("values", readings.values)
    sd = _numbers("sd", readings.sd)
    if values.ndim == 1 and values.shape == time_ns.shape:
        values = values[:, None]
    if values.ndim != 2 or not 1 <= values.shape[1] <= 4 or time_ns.shape != values.shape[:1]:
        shapes = f"{time_ns.shape} and {values.shape}"
        raise ValueError(
            f"returns times and values of shapes {shapes}, not (k,) and (k, s), s from 1 to 4"
        )
    try:
        sd = np.broadcast_to(
            sd[:, None] if sd.shape == time_ns.shape and values.shape[1] == 1 else sd, values.shape
        )
    except ValueError as error:
        shapes = f"{sd.shape} for values of shape {values.shape}"
        raise ValueError(f"returns sd of shape {shapes}, not (s,) or (k, s)") from error
    _require_increasing(time_ns)
    _require_rows("values that are not finite", np.isfinite(values))
    _require_rows("sd that is not above 0", sd > 0.0)
    if not np.isfinite(sd).all():
        raise ValueError("returns sd that is not finite")
    return UserReadings(time_ns, values, sd)


def checked_factors(given: tuple[TimeNs, Floats]) -> NoiseFactors:
    """Require what the filter relies on, and repeat factors for all axes; a ValueError says what is wrong."""
    try:
        times, found = given
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"returns {type(given).__name__}, not two arrays: times and factors"
        ) from error
    time_ns = np.asarray(times)
    factors = _numbers("factors", found)
    if time_ns.ndim != 1 or factors.shape not in ((len(time_ns), 2), (len(time_ns), 6)):
        shapes = f"{time_ns.shape} and {factors.shape}"
        raise ValueError(
            f"returns times and factors of shapes {shapes}, not (k,) and (k, 2) or (k, 6)"
        )
    _require_increasing(time_ns)
    _require_rows(
        "factors that are not finite and above 0", np.isfinite(factors) & (factors > 0.0)
    )
    return NoiseFactors(time_ns, np.repeat(factors, 6 // factors.shape[1], axis=1))


def _numbers(what: str, given: Any) -> Floats:
    try:
        return np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"returns {what} that are not an array of numbers: {error}") from error


def _require_increasing(time_ns: TimeNs) -> None:
    if time_ns.dtype != np.int64 or np.any(np.diff(time_ns) <= 0):
        raise ValueError("returns times that are not increasing int64 nanoseconds")


def _require_rows(what: str, good: NDArray[np.bool_]) -> None:
    if len(rows := np.flatnonzero(~good.all(axis=1))):
        raise ValueError(
            f"returns {what} in {len(rows)} of {len(good)} rows, the first is row {rows[0]}: leave them out"
        )
