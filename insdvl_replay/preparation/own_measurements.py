"""Measurements of the user's own: imported, asked for their readings of a dive, and prepared like those of a sensor."""

from dataclasses import replace

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.nav.innovation import OWN
from insdvl_replay.nav.measurements import Measurement, sensor_measurement
from insdvl_replay.nav.own_measurement import checked_readings, compiled_prediction, load_own_measurement
from insdvl_replay.nav.timeline import FIRST_OTHER


def prepare_own_measurements(
    dive: Dive, config: Config, sensors: int, start_ns: int, end_ns: int
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the measurements that filters name as ``module:Class``.

    Parameters
    ----------
    sensors : int
        How many sensors stand in the time line before them.
    start_ns, end_ns : int
        Span of the replay.

    Returns
    -------
    dict of str to Measurement
        By the word in ``aiding``, without a gate.
    tuple of Note
        Of predictions that run as they are.

    Raises
    ------
    ConfigError
        One cannot be imported, has no reading in the span, or its readings are none.
    """
    found, notes = dict[str, Measurement](), list[Note]()
    words = dict.fromkeys(word for filter_ in config.filters.values() for word in filter_.aiding if ":" in word)
    for row, word in enumerate(words, start=FIRST_OTHER + sensors):
        measurement, is_compiled = _prepared(word, dive, start_ns, end_ns)
        found[word] = replace(measurement, sensor=row)
        if not is_compiled:
            text = f"the prediction of {word} cannot be compiled, and runs as it is: the filter takes long"
            hint = "numbers, loops and numpy's functions of numbers can be compiled"
            notes.append(Note("own_measurement_plain", text, severity=Severity.WARNING, hint=hint))
    return found, tuple(notes)


def _prepared(word: str, dive: Dive, start_ns: int, end_ns: int) -> tuple[Measurement, bool]:
    try:
        own = load_own_measurement(word)
        readings = checked_readings(own.readings(dive))
    except ValueError as error:
        raise ConfigError(
            f"{word} {error}", "docs/own_measurement.md shows one; PYTHONPATH names the folder in which it lies"
        ) from error
    inside = (readings.time_ns > start_ns) & (readings.time_ns <= end_ns)
    if not inside.any():
        raise ConfigError(f"{word} has no reading between the start of the replay and its end", "times are int64 ns")
    made = sensor_measurement(
        own.name, own.unit, OWN, readings.time_ns[inside], readings.values[inside], readings.sd[inside],
        axes=tuple(str(i + 1) for i in range(readings.values.shape[1])) if readings.values.shape[1] > 1 else (),
    )  # fmt: skip
    predict = compiled_prediction(own.predict)
    return replace(made, predict=predict or own.predict), predict is not None
