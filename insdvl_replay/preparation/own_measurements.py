"""Measurements of the user's own: imported, asked for their readings of a dive, and prepared like those of a sensor.

They are given no data that is held back from the filters. Of a sensor that is held out they see nothing. For the DVL
outage test they are asked again, on a dive that ends with the outage and lacks its pings.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, TimeNs
from insdvl_replay.core.errors import ConfigError, Note, error_context
from insdvl_replay.core.quantities import COMPONENTS
from insdvl_replay.core.words import Severity
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import OWN, Measurement, sensor_measurement
from insdvl_replay.nav.timeline import FIRST_OTHER
from insdvl_replay.nav.user_measurement import (
    OwnMeasurement,
    OwnReadings,
    Predict,
    checked_readings,
    compiled_prediction,
    joined,
    load_own_measurement,
)
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.own_code import SHOWN, asked_readings, tried_prediction, uncompiled_prediction
from insdvl_replay.preparation.sensors import silence_notes

Outage = tuple[int, int]
"""Times of the last ping before it, and of the last ping in it, ns."""
_Asked = tuple[OwnMeasurement, OwnReadings]
NO_END: Final = int(np.iinfo(np.int64).max)
APART_NS: Final = 60 * NS_PER_S
"""Between two outages of one call: what user code mostly looks back on."""
ONE_BY_ONE: Final = 4
"""Outages that are asked for one by one; more of them take four calls, if the user's code allows."""
ALIKE: Final = 1e-3
"""In the noise of a reading: a network rounds otherwise when it is given more pings at once."""


def prepare_own_measurements(
    dive: Dive,
    config: Config,
    filters: Sequence[ResolvedFilter],
    sensors: int,
    start: Start,
    start_ns: int,
    end_ns: int,
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the measurements that filters name as ``module:Class``, by this word and without a gate.

    They stand in the time line behind so many ``sensors``. Each prediction is tried at the start. ConfigError where one
    cannot be imported, has no reading in the span, its readings are none, or its code fails.
    """
    words = dict.fromkeys(word for filter_ in filters for word in filter_.aiding if ":" in word)
    found, owns, notes = dict[str, Measurement](), dict[str, OwnMeasurement](), list[Note]()
    for row, word in enumerate(words, start=FIRST_OTHER + sensors):
        own, readings = _asked(word, dive, config)
        readings = _inside(readings, [(start_ns, end_ns)])
        if not len(readings.time_ns):
            raise ConfigError(
                f"{word} has no reading between the start of the replay and its end", "times are int64 ns"
            )
        whole, holds_height = _measurement(own, readings), False
        for filter_ in (filter_ for filter_ in filters if word in filter_.aiding):
            holds_height, of_filter = tried_prediction(word, own, whole.size, filter_, start)
            notes += of_filter
        notes += silence_notes(own.name, readings.time_ns, start_ns, end_ns)
        found[word], owns[word] = replace(whole, sensor=row, holds_height=holds_height), own
    for filter_ in filters:
        _require_different_rows(filter_.name, {word: found[word] for word in filter_.aiding if word in found})
    compiled = {word: made for word in words if (made := compiled_prediction(owns[word].predict)) is not None}
    uncompiled = {word: uncompiled_prediction(word, own) for word, own in owns.items()}
    plain_notes = (_plain_note(word) for word in words if word not in compiled)
    return found | _predicted(found, uncompiled, compiled), (*plain_notes, *dict.fromkeys(notes))


def _predicted(
    found: Mapping[str, Measurement], uncompiled: Mapping[str, Predict], compiled: Mapping[str, Predict]
) -> dict[str, Measurement]:
    """Give each measurement its prediction, by a number and what all have in common.

    Compiled ones have the first numbers: these are the same where they run beside others that are not compiled.
    """
    order = sorted(uncompiled, key=lambda word: word not in compiled)
    if compiled:
        by_compiled = joined([compiled[word] for word in order if word in compiled], compiled=True)
    if len(compiled) < len(order):
        by_all = joined([uncompiled[word] for word in order], compiled=False)
    return {
        word: replace(found[word], kind=OWN + which, predict=by_compiled if word in compiled else by_all)
        for which, word in enumerate(order)
    }


def _plain_note(word: str) -> Note:
    text = f"the prediction of {word} cannot be compiled, and runs as it is: the filter takes long"
    hint = "numbers, loops and numpy's functions of numbers can be compiled"
    return Note("own_measurement_plain", text, severity=Severity.WARNING, hint=hint)


def _require_different_rows(name: str, of_filter: Mapping[str, Measurement]) -> None:
    """Refuse measurements of one filter that share a row of its tables."""
    words = dict[str, str]()
    for word, measurement in of_filter.items():
        row = measurement.name
        if row in words:
            raise ConfigError(
                f"filters.{name} is aided by {words[row]} and {word}, which both have a row '{row}' in the tables",
                "give one of the two classes another name",
            )
        words[row] = word


def _asked(word: str, dive: Dive, config: Config, outages: Sequence[Outage] = (), end_ns: int = NO_END) -> _Asked:
    """Ask an object that is made for this call, so that it has kept nothing of another one."""
    given = given_dive(dive, config, outages, end_ns)
    try:
        own = load_own_measurement(word)
        return own, checked_readings(asked_readings(word, own, given, config.evaluation.withheld))
    except ValueError as error:
        raise ConfigError(f"{word} {error}", f"{SHOWN}; PYTHONPATH names the folder in which it lies") from error


def _measurement(own: OwnMeasurement, readings: OwnReadings) -> Measurement:
    axes = COMPONENTS[:width] if (width := readings.values.shape[1]) > 1 else ()
    return sensor_measurement(own.name, own.unit, OWN, readings.time_ns, readings.values, readings.sd, axes=axes)


def _inside(readings: OwnReadings, spans: Sequence[tuple[int, int]]) -> OwnReadings:
    """Keep the readings after the start of any of some spans and up to its end."""
    inside = np.any([(readings.time_ns > start) & (readings.time_ns <= end) for start, end in spans], axis=0)
    return OwnReadings(readings.time_ns[inside], readings.values[inside], readings.sd[inside])


# --- What is held back.


def given_dive(dive: Dive, config: Config, outages: Sequence[Outage] = (), end_ns: int = NO_END) -> Dive:
    """Return the dive that user code is given: up to a time, without held-out sensors and without pings in outages.

    The reference and solutions may be made of either, and are absent with it. So are topics that carry it.
    """
    held_out = config.evaluation.withheld
    if not (held_out or outages):
        return dive
    roles = {channel.topic: channel.role for channel in dive.channels}
    carried = {name: topic.sensor or roles.get(topic.topic, "") for name, topic in config.topics.items()}
    mixed = {name for name, role in carried.items() if role.startswith(("reference", "filters."))}
    of_dvl = mixed | {name for name, role in carried.items() if role == "dvl"}

    def known(time_ns: TimeNs, *, dvl: bool = True) -> NDArray[np.bool_]:
        keep = time_ns <= end_ns
        for before_ns, last_ns in outages if dvl else ():
            keep &= (time_ns <= before_ns) | (time_ns > last_ns)
        return np.asarray(keep)

    reference = None if held_out else dive.reference
    return replace(
        dive,
        imu=dive.imu.within(int(dive.imu.time_ns[0]), end_ns),
        dvl=dive.dvl.rows(known(dive.dvl.time_ns)),
        reference=None if reference is None else reference.rows(known(reference.time_ns)),
        sensors={
            name: one.rows(known(one.time_ns, dvl=False)) for name, one in dive.sensors.items() if name not in held_out
        },
        solutions={} if held_out else {name: one.where(known) for name, one in dive.solutions.items()},
        topics={
            name: one.rows(known(one.time_ns, dvl=name in of_dvl))
            for name, one in dive.topics.items()
            if not held_out or (name not in mixed and carried.get(name) not in held_out)
        },
    )


def in_outages(
    dive: Dive, config: Config, sensors: dict[str, Measurement], outages: Sequence[Outage]
) -> Iterator[tuple[Sequence[Outage], dict[str, Measurement]]]:
    """Yield groups of outages with the sensors that aid filters there: user code makes its readings anew.

    The outages of a group are far apart, so that one call serves all: a longer dive needs no more calls.
    """
    own = [word for word in sensors if ":" in word]
    if not own:
        yield outages, sensors
        return
    groups = list[list[Outage]]()
    for outage in outages:
        group = next((group for group in groups if outage[0] - group[-1][1] >= APART_NS), None)
        if group is None:
            groups.append(group := [])
        group.append(outage)
    for group in groups:
        with error_context(dive.name, "in the DVL outage test"):
            anew = {word: _in_outages(word, sensors[word], dive, config, group) for word in own}
        yield group, sensors | anew


def _in_outages(word: str, whole: Measurement, dive: Dive, config: Config, outages: Sequence[Outage]) -> Measurement:
    """Return the readings in outages, each as on a dive that ends with it and lacks its pings alone.

    One call for all outages is enough if it gives the same in the first, the shortest and the last. It does not for
    code that uses later data, or data from before the previous outage.
    """

    def asked(outages: Sequence[Outage], end_ns: int = NO_END) -> OwnReadings:
        readings = _inside(_asked(word, dive, config, outages, end_ns)[1], outages)
        if (size := readings.values.shape[1]) != whole.size:
            raise ConfigError(
                f"{word} gives readings of {size} components in an outage, and of {whole.size} else", SHOWN
            )
        return readings

    alone = cache(lambda outage: asked([outage], outage[1]))
    compared = outages[0], min(outages, key=lambda outage: outage[1] - outage[0]), outages[-1]
    readings = asked(outages) if len(outages) > ONE_BY_ONE else None
    if readings is None or not all(_alike(_inside(readings, [outage]), alone(outage)) for outage in compared):
        parts = [alone(outage) for outage in outages]
        readings = OwnReadings(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("time_ns", "values", "sd"))
        )
    made = sensor_measurement(
        whole.name, whole.unit, whole.kind, readings.time_ns, readings.values, readings.sd, axes=whole.axes
    )
    return replace(made, sensor=whole.sensor, predict=whole.predict, holds_height=whole.holds_height)


def _alike(one: OwnReadings, other: OwnReadings) -> bool:
    return np.array_equal(one.time_ns, other.time_ns) and all(
        bool(np.all(np.abs(a - b) <= ALIKE * other.sd)) for a, b in ((one.values, other.values), (one.sd, other.sd))
    )
