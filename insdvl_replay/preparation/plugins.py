"""User-defined measurements and noise: imported, asked for a dive, and prepared like those of a sensor.

They are given no data that is held back from the filters. A held-out sensor is absent from their dive. For the DVL
outage test they are asked again, on a dive that ends with the outage and lacks its pings. An error in the user's code
becomes a sentence; compiled code neither raises nor checks that a column of H exists, so H is tried once uncompiled.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final, TypeVar

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, Mask, TimeNs, in_spans
from insdvl_replay.core.errors import ConfigError, Note, UserError, error_context, listed
from insdvl_replay.core.quantities import COMPONENTS
from insdvl_replay.core.runtime import plain
from insdvl_replay.core.states import states_with
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import USER, Measurement, sensor_measurement
from insdvl_replay.nav.timeline import FIRST_OTHER
from insdvl_replay.nav.user_measurement import (
    INS_SIZE,
    NoiseFactors,
    Predict,
    UserMeasurement,
    UserNoise,
    UserReadings,
    checked_factors,
    checked_readings,
    compiled_prediction,
    failure_text,
    joined,
    load_plugin,
)
from insdvl_replay.preparation.filters import ResolvedFilter, silence_notes
from insdvl_replay.preparation.notes import note

Outage = tuple[int, int]  # times of the last ping before it, and of the last ping in it, ns
SHOWN: Final = "example: docs/own_filter.md"
NO_END: Final = int(np.iinfo(np.int64).max)
APART_NS: Final = 60 * NS_PER_S  # between two outages of one call: user code mostly looks back less
ONE_BY_ONE: Final = (
    4  # outages that are asked for one by one; more take four calls, if the user's code allows
)
ALIKE: Final = 1e-3  # in the noise of a reading: a network rounds otherwise with more pings at once
# columns of H: the velocity down, and the first of the position
DOWN = 2
POSITION = 12
# Steps of velocity m/s, misalignment rad, specific force m/s^2, angular rate rad/s and position m: far above rounding,
# far below what bends.
_STEPS: Final = (1e-5, 1e-6, 1e-5, 1e-7, 0.01)
_TOLERANCE: Final = (
    0.1  # share by which an entry of H may differ from differences: it may be simplified
)
_OUTSIDE: Final = (
    "math domain error",
    "expected ",
)  # errors of `math` outside a domain, up to Python 3.13 and later

_T = TypeVar("_T")


def prepare_user_measurements(
    dive: Dive,
    config: Config,
    filters: Sequence[ResolvedFilter],
    sensors: int,
    start: Start,
    start_ns: int,
    end_ns: int,
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the measurements that filters name as ``module:Class``, without a gate.

    Their rows of the time line follow those of the ``sensors``, a number. Each prediction is tried at the start.
    """
    plugins = dict.fromkeys(
        plugin for filter_ in filters for plugin in filter_.aiding if ":" in plugin
    )
    found = dict[str, Measurement]()
    notes = list[Note]()
    predictions = dict[str, Predict]()
    compiled = dict[str, Predict]()
    for row, plugin in enumerate(plugins, start=FIRST_OTHER + sensors):
        user, readings = _asked(plugin, UserMeasurement, dive, config)
        readings = _inside(readings, [(start_ns, end_ns)])
        if not len(readings.time_ns):
            text = f"{plugin} has no reading between the start and the end of the replay"
            raise ConfigError(
                text, "readings need times in int64 ns, on the clock of the IMU stamps"
            )
        holds_height = False
        for filter_ in (filter_ for filter_ in filters if plugin in filter_.aiding):
            holds_height, found_notes = _tried_prediction(
                plugin, user, readings.values.shape[1], filter_, start
            )
            notes += found_notes
        notes += silence_notes(user.name, readings.time_ns, start_ns, end_ns)
        found[plugin] = replace(
            _measurement(user.name, user.unit, readings), sensor=row, holds_height=holds_height
        )
        predictions[plugin] = _uncompiled_prediction(plugin, user, SHOWN)
        if (prediction := compiled_prediction(user.predict)) is not None:
            compiled[plugin] = prediction
    for filter_ in filters:
        plugin_of = dict[str, str]()
        for plugin in (plugin for plugin in filter_.aiding if plugin in found):
            if (other := plugin_of.setdefault(found[plugin].name, plugin)) != plugin:
                raise ConfigError(
                    f"filters.{filter_.name} is aided by {other} and {plugin}, which have the same name "
                    f"'{found[plugin].name}'",
                    "change `name` in one of the two classes",
                )
    # Each prediction has a number, by which one function calls it. Compiled ones have the first numbers: these stay
    # the same where they run beside others that are not compiled.
    order = sorted(plugins, key=lambda plugin: plugin not in compiled)
    by_compiled = joined([*compiled.values()], compiled=True) if compiled else None
    by_all = (
        joined([predictions[plugin] for plugin in order], compiled=False)
        if len(compiled) < len(order)
        else None
    )
    for number, plugin in enumerate(order):
        predict = by_compiled if plugin in compiled else by_all
        found[plugin] = replace(found[plugin], kind=USER + number, predict=predict)
    uncompiled = [
        note("user_measurement_plain", plugin=plugin)
        for plugin in plugins
        if plugin not in compiled
    ]
    return found, (*uncompiled, *dict.fromkeys(notes))


def prepare_user_noise(
    dive: Dive, config: Config, filters: Sequence[ResolvedFilter]
) -> dict[str, NoiseFactors]:
    """Ask the classes that filters name in ``noise_factors``."""
    plugins = dict.fromkeys(
        filter_.noise_factors for filter_ in filters if filter_.noise_factors is not None
    )
    asked = {plugin: _asked(plugin, UserNoise, dive, config)[1] for plugin in plugins}
    return {
        plugin: NoiseFactors(readings.time_ns, readings.values)
        for plugin, readings in asked.items()
    }


# --- Readings. Factors of noise are taken for readings, which hold until the next.


def _asked(
    plugin: str,
    base: type,
    dive: Dive,
    config: Config,
    outages: Sequence[Outage] = (),
    end_ns: int = NO_END,
) -> tuple[Any, UserReadings]:
    """Get the readings from a new object, which has no state of earlier calls."""
    given = given_dive(dive, config, outages, end_ns)
    held_out = config.evaluation.held_out
    topics = (
        f"dive.topics has {listed(sorted(given.topics))}"
        if given.topics
        else "dive.topics is empty"
    )
    hint = f"{topics}; to add a topic, write a section [topics.NAME]"
    if held_out:
        hint += f"; evaluation.held_out removes {listed(held_out)}, and topics and solutions that contain it"
    try:
        user: Any = load_plugin(plugin, base)
        if isinstance(user, UserNoise):
            what = "noise_factors(self, dive)"
            noise = checked_factors(
                _called(plugin, user, what, lambda: user.noise_factors(given), hint)
            )
            return user, UserReadings(noise.time_ns, noise.factors, noise.factors)
        readings = _called(plugin, user, "readings(self, dive)", lambda: user.readings(given), hint)
        if not isinstance(readings, UserReadings):
            text = f"{plugin}: readings(self, dive) returns {type(readings).__name__}, not UserReadings"
            raise ConfigError(text, SHOWN)
        return user, checked_readings(readings)
    except ValueError as error:
        raise ConfigError(
            f"{plugin} {error}", f"{SHOWN}; PYTHONPATH must contain the folder of the module"
        ) from error


def _called(plugin: str, user: object, what: str, call: Callable[[], _T], hint: str) -> _T:
    """Call code of the user's; what it raises becomes a ConfigError with file and line."""
    try:
        return call()
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # sys.exit would end the run without a message
        raise ConfigError(
            f"{plugin}: {what} fails{failure_text(error, type(user))}", hint
        ) from error


def _measurement(name: str, unit: str, readings: UserReadings) -> Measurement:
    axes = COMPONENTS[:width] if (width := readings.values.shape[1]) > 1 else ()
    return sensor_measurement(
        name, unit, USER, readings.time_ns, readings.values, readings.sd, axes
    )


def _inside(
    readings: UserReadings, spans: Sequence[Outage], *, holds: bool = False
) -> UserReadings:
    """Keep the readings after the start of any of some spans, up to its end; and what holds at the start."""
    columns = readings.time_ns, readings.values, readings.sd
    parts = [tuple(column[:0] for column in columns)]
    for start_ns, end_ns in spans:
        first, last = np.searchsorted(readings.time_ns, (start_ns, end_ns), "right")
        time_ns, values, sd = (column[max(first - holds, 0) : last] for column in columns)
        parts.append((np.maximum(time_ns, start_ns), values, sd))
    return UserReadings(*map(np.concatenate, zip(*parts, strict=True)))


# --- Predictions.


def _uncompiled_prediction(plugin: str, user: UserMeasurement, hint: str) -> Predict:
    """Return a prediction that runs as it is; where its arithmetic fails z is no number, as in compiled code."""
    predict = plain(user.predict)

    def as_compiled(ins: Floats, z: Floats, H: Floats) -> None:
        try:
            with np.errstate(all="ignore"):
                predict(ins, z, H)
        except (ArithmeticError, ValueError) as error:
            if isinstance(error, ValueError) and not str(error).startswith(_OUTSIDE):
                raise
            z[:] = np.nan

    return lambda ins, z, H: _called(
        plugin, user, "predict(ins, z, H)", lambda: as_compiled(ins, z, H), hint
    )


def _tried_prediction(
    plugin: str, user: UserMeasurement, size: int, filter_: ResolvedFilter, start: Start
) -> tuple[bool, list[Note]]:
    """Predict a reading once where a filter starts; return whether it measures the velocity down, by half or more.

    A note reports an entry of H that contradicts z, an H of zeros, or a component that is not written. There is no note
    if z is NaN at the start, such as a direction at rest.
    """
    count = len(states_with(filter_.states))
    has_position = "position" in filter_.states
    lacks = "" if has_position else '; for columns 12 to 14: states = ["position"]'
    hint = f"filters.{filter_.name} has {count} error states: z is ({size},) and H ({size}, {count}){lacks}"
    predict = _uncompiled_prediction(plugin, user, hint)

    def predicted(error: Floats) -> tuple[Floats, Floats]:
        """Return z and H of an INS that is off by an error, shape (15,), in the order of H, from a vehicle at rest."""
        mat_nb = start.mat_nb + skew(error[3:6]) @ start.mat_nb
        ins = np.empty(INS_SIZE)
        ins[0:3], ins[3:6] = (
            moved_position(start.position, error[12:15]),
            start.velocity_n + error[0:3],
        )
        force_b = start.mat_nb.T @ np.array([0.0, 0.0, -9.8]) + error[6:9]
        ins[6:15], ins[15:18], ins[18:21] = mat_nb.ravel(), force_b, error[9:12]
        z = np.zeros(size)
        H = np.zeros((size, count))
        predict(ins, z, H)
        return z, H

    z, H = predicted(np.zeros(15))
    if not np.isfinite(z).all():
        return False, []
    # H by central differences of z; zero for states that the user's code does not see.
    differences = np.zeros((size, count))
    for column in range(POSITION + 3 if has_position else POSITION):
        step = np.zeros(15)
        step[column] = _STEPS[column // 3]
        with np.errstate(all="ignore"):
            differences[:, column] = (predicted(step)[0] - predicted(-step)[0]) / (
                2.0 * step[column]
            )

    notes = list[Note]()
    at: dict[str, Any] = {"plugin": plugin, "filter": filter_.name}
    unwritten = np.flatnonzero((z == 0.0) & ~H.any(axis=1))
    if len(unwritten) or not H.any():
        left = f"z[{unwritten[0]}] and H[{unwritten[0]}]" if H.any() else "H"
        notes.append(note("user_measurement_jacobian unwritten", left=left, **at))
    known = np.isfinite(differences)
    with np.errstate(invalid="ignore"):
        largest = np.abs(differences).max(axis=1, initial=0.0, where=known, keepdims=True)
        off = np.abs(H - differences) > _TOLERANCE * np.maximum(np.abs(H), 1e-3 * largest)
    wrong = np.argwhere(off & (H != 0.0) & known & np.isfinite(H))
    if len(wrong):
        row, column = wrong[0]
        given = H[row, column]
        found = differences[row, column]
        notes.append(
            note(
                "user_measurement_jacobian wrong",
                len(wrong),
                row=row,
                column=column,
                given=given,
                found=found,
                **at,
            )
        )
    return bool(np.any(np.abs(H[:, DOWN]) > 0.5)), notes


# --- What is held back.


def given_dive(
    dive: Dive, config: Config, outages: Sequence[Outage] = (), end_ns: int = NO_END
) -> Dive:
    """Return the dive that user code is given: up to a time, without held-out sensors and without pings in outages.

    The reference and solutions may be made of either, and are absent with it. So are topics that carry it. Outages are
    in the order of time and do not overlap.
    """
    held_out = config.evaluation.held_out
    if not (held_out or outages):
        return dive
    roles = {channel.topic: channel.role for channel in dive.channels}
    carried = {
        name: topic.sensor or roles.get(topic.topic, "") for name, topic in config.topics.items()
    }
    mixed = {name for name, role in carried.items() if role.startswith(("reference", "filters."))}

    def known(time_ns: TimeNs, *, dvl: bool = True) -> Mask:
        return np.asarray((time_ns <= end_ns) & ~in_spans(time_ns, outages if dvl else ()))

    reference = None if held_out else dive.reference
    return replace(
        dive,
        imu=dive.imu.within(int(dive.imu.time_ns[0]), end_ns),
        dvl=dive.dvl.rows(known(dive.dvl.time_ns)),
        reference=None if reference is None else reference.rows(known(reference.time_ns)),
        sensors={
            name: columns.rows(known(columns.time_ns, dvl=False))
            for name, columns in dive.sensors.items()
            if name not in held_out
        },
        solutions={}
        if held_out
        else {name: columns.where(known) for name, columns in dive.solutions.items()},
        topics={
            name: columns.rows(
                known(columns.time_ns, dvl=name in mixed or carried.get(name) == "dvl")
            )
            for name, columns in dive.topics.items()
            if not held_out or (name not in mixed and carried.get(name) not in held_out)
        },
    )


def in_outages(
    dive: Dive,
    config: Config,
    sensors: dict[str, Measurement],
    noise: dict[str, NoiseFactors],
    outages: Sequence[Outage],
) -> Iterator[tuple[Sequence[Outage], dict[str, Measurement], dict[str, NoiseFactors]]]:
    """Yield groups of outages with the sensors and the noise that filters have there: user code is asked again.

    The outages of a group are far apart, so that one call serves all: a longer dive needs no more calls.
    """
    plugins = {plugin: sensor for plugin, sensor in sensors.items() if ":" in plugin}
    if not plugins and not noise:
        yield outages, sensors, noise
        return
    groups = list[list[Outage]]()
    for outage in outages:
        group = next((group for group in groups if outage[0] - group[-1][1] >= APART_NS), None)
        if group is None:
            groups.append(group := [])
        group.append(outage)
    for group in groups:
        found = dict[str, Measurement]()
        factors = dict[str, NoiseFactors]()
        with error_context(dive.name, "in the DVL outage test"):
            for plugin, whole in plugins.items():
                readings = _in_outages(plugin, UserMeasurement, whole.size, dive, config, group)
                made = _measurement(whole.name, whole.unit, readings)
                columns = {
                    name: getattr(made, name) for name in ("valid_ns", "values", "cov", "available")
                }
                found[plugin] = replace(whole, **columns)
            for plugin in noise:
                readings = _in_outages(plugin, UserNoise, 6, dive, config, group)
                factors[plugin] = NoiseFactors(readings.time_ns, readings.values)
        yield group, sensors | found, factors


def _in_outages(
    plugin: str, base: type, size: int, dive: Dive, config: Config, outages: Sequence[Outage]
) -> UserReadings:
    """Return the readings in outages, each from a dive that ends with this outage and lacks its pings only.

    One call for all outages is enough if it gives the same in the first, the shortest and the last. It does not for
    code that uses later data, or data from before the previous outage.
    """
    holds = base is UserNoise

    def asked(outages: Sequence[Outage], end_ns: int = NO_END) -> UserReadings:
        readings = _inside(
            _asked(plugin, base, dive, config, outages, end_ns)[1], outages, holds=holds
        )
        if (found := readings.values.shape[1]) != size:
            text = f"{plugin} returns readings of {found} components in an outage, but {size} otherwise"
            raise ConfigError(text, SHOWN)
        return readings

    def is_same(together: UserReadings, alone: UserReadings) -> bool:
        pairs = (together.values, alone.values), (together.sd, alone.sd)
        return np.array_equal(together.time_ns, alone.time_ns) and all(
            bool(np.all(np.abs(a - b) <= ALIKE * alone.sd)) for a, b in pairs
        )

    alone = cache(lambda outage: asked([outage], outage[1]))
    compared = outages[0], min(outages, key=lambda outage: outage[1] - outage[0]), outages[-1]
    readings = asked(outages) if len(outages) > ONE_BY_ONE else None
    if readings is None or not all(
        is_same(_inside(readings, [outage], holds=holds), alone(outage)) for outage in compared
    ):
        parts = [alone(outage) for outage in outages]
        columns = ([getattr(part, name) for part in parts] for name in ("time_ns", "values", "sd"))
        readings = UserReadings(*map(np.concatenate, columns))
    return readings
