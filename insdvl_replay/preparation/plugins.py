"""User-defined measurements and noise: imported, asked for a dive, and prepared like those of a sensor.

They are given no data that is held back from the filters. A held-out sensor is absent from their dive. For the DVL
outage test they are asked again, on a dive that ends with the outage and lacks its pings. An error in the user's code
becomes a sentence; compiled code neither raises nor checks that a column of H exists, so H is tried once uncompiled.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    Mask,
    SensorColumns,
    SolutionColumns,
    TimeNs,
    in_spans,
)
from insdvl_replay.core.errors import ConfigError, Note, UserError, error_context, listed
from insdvl_replay.core.held_out import NOTHING, HeldOut, Span, Why
from insdvl_replay.core.notes import note
from insdvl_replay.core.quantities import COMPONENTS
from insdvl_replay.core.runtime import is_compiled, plain
from insdvl_replay.core.states import states_with
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.logs.columns.topics import solution_role
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import USER, Measurement, sensor_measurement
from insdvl_replay.nav.timeline import FIRST_OTHER
from insdvl_replay.nav.user_measurement import (
    INS_SIZE,
    NoiseFactors,
    Predict,
    Predicts,
    UserMeasurement,
    UserNoise,
    UserReadings,
    checked_factors,
    checked_readings,
    compiled_prediction,
    failure_text,
    is_of_math,
    joined,
    load_plugin,
)
from insdvl_replay.preparation.filters import ResolvedFilter, silence_notes

Outage = Span  # from the last ping before it to the last ping in it
SHOWN: Final = "example: docs/own_filter.md"
NO_END: Final = int(np.iinfo(np.int64).max)
# between two outages of one call: user code mostly looks back less
APART_NS: Final = 60 * NS_PER_S
# outages that are asked for one by one; more take four calls, if the user's code allows
ONE_BY_ONE: Final = 4
# in the noise of a reading: a network rounds otherwise with more pings at once
ALIKE: Final = 1e-3
# columns of H: the velocity down, and the first of the position
DOWN = 2
POSITION = 12
# Steps of velocity m/s, misalignment rad, specific force m/s^2, angular rate rad/s and position m: far above rounding,
# far below what bends.
_STEPS: Final = (1e-5, 1e-6, 1e-5, 1e-7, 0.01)
# share by which an entry of H may differ from differences: it may be simplified
_TOLERANCE: Final = 0.1

_T = TypeVar("_T")


def _plugins_of(filters: Sequence[ResolvedFilter]) -> list[str]:
    """Return the measurements that filters name as ``module:Class``, each once."""
    plugins: list[str] = []
    for filter_ in filters:
        for aid in filter_.aiding:
            if ":" in aid and aid not in plugins:
                plugins.append(aid)
    return plugins


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
    plugins = _plugins_of(filters)
    found = dict[str, Measurement]()
    notes = list[Note]()
    users = dict[str, UserMeasurement]()
    for row, plugin in enumerate(plugins, start=FIRST_OTHER + sensors):
        user, readings = _asked(plugin, UserMeasurement, dive, config)
        readings = _inside(readings, [(start_ns, end_ns)])
        if not len(readings.time_ns):
            text = f"{plugin} has no reading between the start and the end of the replay"
            raise ConfigError(
                text, "readings need times in int64 ns, on the clock of the IMU stamps"
            )
        holds_height = False
        size = readings.values.shape[1]
        for filter_ in filters:
            if plugin in filter_.aiding:
                tried = _tried_prediction(plugin, user, size, filter_, start)
                holds_height = tried.is_of_velocity_down
                notes += tried.notes
        notes += silence_notes(user.name, readings.time_ns, start_ns, end_ns)
        made = _measurement(user.name, user.unit, readings)
        found[plugin] = replace(made, sensor=row, holds_height=holds_height)
        users[plugin] = user
    for filter_ in filters:
        _require_names_of_their_own(filter_, found)
    predictions = _numbered_predictions(users)
    for plugin, (number, predict) in predictions.items():
        found[plugin] = replace(found[plugin], kind=USER + number, predict=predict)
    uncompiled = [
        note("user_measurement_plain", plugin=plugin)
        for plugin in plugins
        if not is_compiled(predictions[plugin].predict)
    ]
    return found, (*uncompiled, *dict.fromkeys(notes))


def _require_names_of_their_own(filter_: ResolvedFilter, found: Mapping[str, Measurement]) -> None:
    """Require that the measurements of the user's that aid a filter have different names."""
    plugin_of = dict[str, str]()
    for plugin in filter_.aiding:
        if plugin not in found:
            continue
        name = found[plugin].name
        other = plugin_of.setdefault(name, plugin)
        if other != plugin:
            raise ConfigError(
                f"filters.{filter_.name} is aided by {other} and {plugin}, which have the same name "
                f"'{name}'",
                "change `name` in one of the two classes",
            )


class _Numbered(NamedTuple):
    """A prediction by its number: one function calls several."""

    number: int
    predict: Predicts


def _numbered_predictions(users: Mapping[str, UserMeasurement]) -> dict[str, _Numbered]:
    """Number the predictions, and join them into one function for those that are compiled, and one for all.

    Compiled ones have the first numbers: these stay the same where they run beside others that are not compiled.
    """
    compiled = dict[str, Predict]()
    uncompiled = dict[str, Predict]()
    for plugin, user in users.items():
        prediction = compiled_prediction(user.predict)
        if prediction is None:
            uncompiled[plugin] = _uncompiled_prediction(plugin, user, SHOWN)
        else:
            compiled[plugin] = prediction
    found = dict[str, _Numbered]()
    if compiled:
        by_compiled = joined([*compiled.values()], compiled=True)
        for number, plugin in enumerate(compiled):
            found[plugin] = _Numbered(number, by_compiled)
    if uncompiled:
        # Beside it, those that are compiled run as they are.
        plain_ones = [
            _uncompiled_prediction(plugin, users[plugin], SHOWN)
            for plugin in (*compiled, *uncompiled)
        ]
        by_all = joined(plain_ones, compiled=False)
        for number, plugin in enumerate(uncompiled, start=len(compiled)):
            found[plugin] = _Numbered(number, by_all)
    return found


def prepare_user_noise(
    dive: Dive, config: Config, filters: Sequence[ResolvedFilter]
) -> dict[str, NoiseFactors]:
    """Ask the classes that filters name in ``noise_factors``."""
    found = dict[str, NoiseFactors]()
    for filter_ in filters:
        plugin = filter_.noise_factors
        if plugin is not None and plugin not in found:
            _, readings = _asked(plugin, UserNoise, dive, config)
            found[plugin] = NoiseFactors(readings.time_ns, readings.values)
    return found


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
    hint = _topics_hint(given, config)
    try:
        user: Any = load_plugin(plugin, base)
        if isinstance(user, UserNoise):
            what = "noise_factors(self, dive)"
            factors = _called(plugin, user, what, lambda: user.noise_factors(given), hint)
            noise = checked_factors(factors)
            return user, UserReadings(noise.time_ns, noise.factors, noise.factors)
        readings = _called(
            plugin, user, "readings(self, dive)", lambda: user.readings(given), hint
        )
        if not isinstance(readings, UserReadings):
            text = f"{plugin}: readings(self, dive) returns {type(readings).__name__}, not UserReadings"
            raise ConfigError(text, SHOWN)
        return user, checked_readings(readings)
    except ValueError as error:
        raise ConfigError(
            f"{plugin} {error}", f"{SHOWN}; PYTHONPATH must contain the folder of the module"
        ) from error


def _topics_hint(given: Dive, config: Config) -> str:
    """Say which topics the user's code has, and how it gets others."""
    topics = "dive.topics is empty"
    if given.topics:
        topics = f"dive.topics has {listed(sorted(given.topics))}"
    hint = f"{topics}; to add a topic, write a section [topics.NAME]"
    sensors = config.held_out.sensors
    if sensors:
        hint += f"; evaluation.held_out removes {listed(sensors)}, and topics and solutions that contain it"
    return hint


def _called(
    plugin: str,
    user: object,
    what: str,
    call: Callable[[], _T],
    hint: str,
) -> _T:
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
    width = readings.values.shape[1]
    axes: tuple[str, ...] = ()
    if width > 1:
        axes = COMPONENTS[:width]
    return sensor_measurement(
        name, unit, USER, readings.time_ns, readings.values, readings.sd, axes
    )


def _inside(
    readings: UserReadings, spans: Sequence[Outage], *, holds: bool = False
) -> UserReadings:
    """Keep the readings after the start of any of some spans, up to its end; and what holds at the start."""
    parts = [UserReadings(readings.time_ns[:0], readings.values[:0], readings.sd[:0])]
    for start_ns, end_ns in spans:
        first, last = np.searchsorted(readings.time_ns, (start_ns, end_ns), "right")
        rows = slice(max(first - holds, 0), last)
        time_ns = np.maximum(readings.time_ns[rows], start_ns)
        parts.append(UserReadings(time_ns, readings.values[rows], readings.sd[rows]))
    return _one_after_the_other(parts)


def _one_after_the_other(parts: Sequence[UserReadings]) -> UserReadings:
    return UserReadings(
        np.concatenate([part.time_ns for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.sd for part in parts]),
    )


# --- Predictions.


def _uncompiled_prediction(plugin: str, user: UserMeasurement, hint: str) -> Predict:
    """Return a prediction that runs as it is; where its arithmetic fails z is no number, as in compiled code."""
    predict = plain(user.predict)

    def as_compiled(ins: Floats, z: Floats, H: Floats) -> None:
        try:
            with np.errstate(all="ignore"):
                predict(ins, z, H)
        except ArithmeticError:
            z[:] = np.nan
        except ValueError as error:
            if not is_of_math(error):
                raise
            z[:] = np.nan

    return lambda ins, z, H: _called(
        plugin, user, "predict(ins, z, H)", lambda: as_compiled(ins, z, H), hint
    )


class _Tried(NamedTuple):
    """What a prediction gives where a filter starts."""

    is_of_velocity_down: bool  # by half or more
    notes: list[Note]


def _ins_off_by(error: Floats, start: Start) -> Floats:
    """Return what user code sees of an INS at rest that is off by an error, shape (15,), in the order of H."""
    mat_nb = start.mat_nb + skew(error[3:6]) @ start.mat_nb
    ins = np.empty(INS_SIZE)
    ins[0:3] = moved_position(start.position, error[12:15])
    ins[3:6] = start.velocity_n + error[0:3]
    ins[6:15] = mat_nb.ravel()
    ins[15:18] = start.mat_nb.T @ np.array([0.0, 0.0, -9.8]) + error[6:9]
    ins[18:21] = error[9:12]
    return ins


def _tried_prediction(
    plugin: str,
    user: UserMeasurement,
    size: int,
    filter_: ResolvedFilter,
    start: Start,
) -> _Tried:
    """Predict a reading once where a filter starts.

    A note reports an entry of H that contradicts z, an H of zeros, or a component that is not written. There is no note
    if z is NaN at the start, such as a direction at rest.
    """
    count = len(states_with(filter_.states))
    has_position = "position" in filter_.states
    hint = (
        f"filters.{filter_.name} has {count} error states: z is ({size},) and H ({size}, {count})"
    )
    if not has_position:
        hint += '; for columns 12 to 14: states = ["position"]'
    predict = _uncompiled_prediction(plugin, user, hint)

    def predicted(error: Floats) -> tuple[Floats, Floats]:
        z = np.zeros(size)
        H = np.zeros((size, count))
        predict(_ins_off_by(error, start), z, H)
        return z, H

    z, H = predicted(np.zeros(15))
    if not np.isfinite(z).all():
        return _Tried(is_of_velocity_down=False, notes=[])
    # H by central differences of z; zero for states that the user's code does not see.
    differences = np.zeros((size, count))
    seen = POSITION + 3 if has_position else POSITION
    for column in range(seen):
        step = np.zeros(15)
        step[column] = _STEPS[column // 3]
        with np.errstate(all="ignore"):
            more, _ = predicted(step)
            less, _ = predicted(-step)
            differences[:, column] = (more - less) / (2.0 * step[column])
    return _Tried(
        is_of_velocity_down=bool(np.any(np.abs(H[:, DOWN]) > 0.5)),
        notes=_jacobian_notes(plugin, filter_.name, z, H, differences),
    )


def _jacobian_notes(
    plugin: str,
    name: str,
    z: Floats,
    H: Floats,
    differences: Floats,
) -> list[Note]:
    """Note what is not written of z and H, and the first entry of H that contradicts differences of z."""
    notes = list[Note]()
    unwritten = np.flatnonzero((z == 0.0) & ~H.any(axis=1))
    left = ""
    if not H.any():
        left = "H"
    elif len(unwritten):
        left = f"z[{unwritten[0]}] and H[{unwritten[0]}]"
    if left:
        notes.append(
            note("user_measurement_jacobian unwritten", left=left, plugin=plugin, filter=name)
        )
    known = np.isfinite(differences)
    with np.errstate(invalid="ignore"):
        largest = np.abs(differences).max(
            axis=1,
            initial=0.0,
            where=known,
            keepdims=True,
        )
        off = np.abs(H - differences) > _TOLERANCE * np.maximum(np.abs(H), 1e-3 * largest)
    wrong = np.argwhere(off & (H != 0.0) & known & np.isfinite(H))
    if len(wrong):
        row, column = wrong[0]
        notes.append(
            note(
                "user_measurement_jacobian wrong",
                len(wrong),
                row=row,
                column=column,
                given=H[row, column],
                found=differences[row, column],
                plugin=plugin,
                filter=name,
            )
        )
    return notes


# --- What is held back.


@dataclass(frozen=True)
class _Given:
    """What user code is given of a dive."""

    held_out: HeldOut
    end_ns: int

    def is_given(self, role: str) -> bool:
        """Return whether user code sees a role at all, outside of outages."""
        return self.held_out.why(role) in (None, Why.OUTAGE)

    def rows(self, role: str, time_ns: TimeNs) -> Mask:
        """Find the rows of a role that user code sees, by their times."""
        known = np.asarray(time_ns <= self.end_ns)
        if self.held_out.why(role) == Why.OUTAGE:
            known &= ~in_spans(time_ns, self.held_out.outages)
        return known

    def columns(
        self, by_name: Mapping[str, SensorColumns], roles: Mapping[str, str]
    ) -> dict[str, SensorColumns]:
        """Return the columns whose roles are given; a name without a role carries none."""
        found = dict[str, SensorColumns]()
        for name, columns in by_name.items():
            role = roles.get(name, "")
            if self.is_given(role):
                found[name] = columns.rows(self.rows(role, columns.time_ns))
        return found


def given_dive(
    dive: Dive,
    config: Config,
    outages: Sequence[Outage] = (),
    end_ns: int = NO_END,
) -> Dive:
    """Return the dive that user code is given: up to a time, without held-out sensors and without pings in outages.

    The reference and solutions may be made of either, and are absent with it. So are topics that carry it. Outages are
    in the order of time and do not overlap.
    """
    held_out = config.held_out.in_outages(outages)
    if held_out == NOTHING:
        return dive
    given = _Given(held_out, end_ns)
    reference = None
    if dive.reference is not None and given.is_given("reference"):
        reference = dive.reference.rows(given.rows("reference", dive.reference.time_ns))
    solutions = dict[str, SolutionColumns]()
    for name, solution in dive.solutions.items():
        role = solution_role(name)
        if given.is_given(role):
            solutions[name] = solution.where(partial(given.rows, role))
    return replace(
        dive,
        imu=dive.imu.within(int(dive.imu.time_ns[0]), end_ns),
        dvl=dive.dvl.rows(given.rows("dvl", dive.dvl.time_ns)),
        reference=reference,
        sensors=given.columns(dive.sensors, {name: name for name in dive.sensors}),
        solutions=solutions,
        topics=given.columns(dive.topics, _carried_roles(dive, config)),
    )


def _carried_roles(dive: Dive, config: Config) -> dict[str, str]:
    """Return what each topic of the settings carries: the sensor that they name, else the role of its channel."""
    roles = {channel.topic: channel.role for channel in dive.channels}
    return {
        name: topic.sensor or roles.get(topic.topic, "") for name, topic in config.topics.items()
    }


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
    for group in _far_apart(outages):
        found = dict[str, Measurement]()
        factors = dict[str, NoiseFactors]()
        with error_context(dive.name, "in the DVL outage test"):
            for plugin, whole in plugins.items():
                readings = _in_outages(plugin, UserMeasurement, whole.size, dive, config, group)
                made = _measurement(whole.name, whole.unit, readings)
                found[plugin] = replace(
                    whole,
                    valid_ns=made.valid_ns,
                    values=made.values,
                    cov=made.cov,
                    available=made.available,
                )
            for plugin in noise:
                readings = _in_outages(plugin, UserNoise, 6, dive, config, group)
                factors[plugin] = NoiseFactors(readings.time_ns, readings.values)
        yield group, sensors | found, factors


def _far_apart(outages: Sequence[Outage]) -> list[list[Outage]]:
    """Group outages so that those of a group are at least `APART_NS` apart."""
    groups = list[list[Outage]]()
    for outage in outages:
        start_ns, _ = outage
        for group in groups:
            _, last_end_ns = group[-1]
            if start_ns - last_end_ns >= APART_NS:
                group.append(outage)
                break
        else:
            groups.append([outage])
    return groups


def _in_outages(
    plugin: str,
    base: type,
    size: int,
    dive: Dive,
    config: Config,
    outages: Sequence[Outage],
) -> UserReadings:
    """Return the readings in outages, each from a dive that ends with this outage and lacks its pings only.

    One call for all outages is enough if it gives the same in the first, the shortest and the last. It does not for
    code that uses later data, or data from before the previous outage.
    """
    holds = base is UserNoise

    def asked(outages: Sequence[Outage], end_ns: int = NO_END) -> UserReadings:
        _, readings = _asked(plugin, base, dive, config, outages, end_ns)
        readings = _inside(readings, outages, holds=holds)
        found = readings.values.shape[1]
        if found != size:
            text = f"{plugin} returns readings of {found} components in an outage, but {size} otherwise"
            raise ConfigError(text, SHOWN)
        return readings

    @cache
    def alone(outage: Outage) -> UserReadings:
        _, end_ns = outage
        return asked([outage], end_ns)

    if len(outages) > ONE_BY_ONE:
        together = asked(outages)
        shortest = min(outages, key=lambda outage: outage[1] - outage[0])
        compared = (outages[0], shortest, outages[-1])
        if all(
            _are_alike(_inside(together, [outage], holds=holds), alone(outage))
            for outage in compared
        ):
            return together
    return _one_after_the_other([alone(outage) for outage in outages])


def _are_alike(together: UserReadings, alone: UserReadings) -> bool:
    """Return whether readings of one call for several outages are those of a call for one of them, but for rounding."""
    if not np.array_equal(together.time_ns, alone.time_ns):
        return False
    least = ALIKE * alone.sd
    values_agree = np.abs(together.values - alone.values) <= least
    sds_agree = np.abs(together.sd - alone.sd) <= least
    return bool(np.all(values_agree) and np.all(sds_agree))
