"""Measurements of the user's own: imported, asked for their readings of a dive, and prepared like those of a sensor."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from insdvl_replay.core.dive_columns import Dive, TimeNs
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.quantities import COMPONENTS
from insdvl_replay.core.words import Severity
from insdvl_replay.nav.initial_state import Start
from insdvl_replay.nav.innovation import OWN
from insdvl_replay.nav.measurements import Measurement, sensor_measurement
from insdvl_replay.nav.own_measurement import (
    OwnMeasurement,
    Predict,
    checked_readings,
    compiled_prediction,
    joined,
    load_own_measurement,
)
from insdvl_replay.nav.timeline import FIRST_OTHER
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.own_code import SHOWN, asked_readings, tried_prediction, uncompiled_prediction
from insdvl_replay.preparation.sensors import silence_notes


def prepare_own_measurements(
    dive: Dive, filters: Sequence[ResolvedFilter], sensors: int, start: Start, start_ns: int, end_ns: int
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the measurements that filters name as ``module:Class``.

    Parameters
    ----------
    sensors : int
        How many sensors stand in the time line before them.
    start : Start
        Where each prediction is tried.
    start_ns, end_ns : int
        Span of the replay.

    Returns
    -------
    dict of str to Measurement
        By the word in ``aiding``, without a gate.
    tuple of Note
        Of predictions that run as they are, and of those whose H contradicts their z.

    Raises
    ------
    ConfigError
        One cannot be imported, has no reading in the span, its readings are none, or its code fails.
    """
    words = dict.fromkeys(word for filter_ in filters for word in filter_.aiding if ":" in word)
    found, owns, notes = dict[str, Measurement](), dict[str, OwnMeasurement](), list[Note]()
    for row, word in enumerate(words, start=FIRST_OTHER + sensors):
        measurement, own, readings_ns = _read(word, dive, start_ns, end_ns)
        found[word], owns[word] = replace(measurement, sensor=row), own
        for filter_ in (filter_ for filter_ in filters if word in filter_.aiding):
            notes += tried_prediction(word, own, measurement.values.shape[1], filter_, start)
        notes += silence_notes(measurement.name, readings_ns, start_ns, end_ns)
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

    What is compiled has the first numbers, so that they are the same in what is compiled of these alone and in what
    runs all as they are, for a filter that has another one, too.
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


def _read(word: str, dive: Dive, start_ns: int, end_ns: int) -> tuple[Measurement, OwnMeasurement, TimeNs]:
    """Return a measurement that is not predicted yet, what will predict it, and the times of its readings."""
    try:
        own = load_own_measurement(word)
        readings = checked_readings(asked_readings(word, own, dive))
    except ValueError as error:
        raise ConfigError(f"{word} {error}", f"{SHOWN}; PYTHONPATH names the folder in which it lies") from error
    inside = (readings.time_ns > start_ns) & (readings.time_ns <= end_ns)
    if not inside.any():
        raise ConfigError(f"{word} has no reading between the start of the replay and its end", "times are int64 ns")
    made = sensor_measurement(
        own.name, own.unit, OWN, readings.time_ns[inside], readings.values[inside], readings.sd[inside],
        axes=COMPONENTS[:width] if (width := readings.values.shape[1]) > 1 else (),
    )  # fmt: skip
    return made, own, readings.time_ns[inside]
