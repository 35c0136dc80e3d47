"""From the readings of a sensor and its section of the configuration to a measurement that filters can be aided by."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Config, Depth, Heading, Position
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, SensorColumns, TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG, FASTEST_MPS, SENSORS
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import DEPTH, FIX, HEADING, Measurement, sensor_measurement
from insdvl_replay.nav.timeline import FIRST_OTHER

FAR_M: Final = 1000.0
"""What a track that was reckoned until the start is not off by, nor a position that somebody configured from a map."""

SILENT_S, SILENT_READINGS = 30.0, 20.0
"""A pause between readings is told that is longer than this, and than so many of the usual ones."""

Measured = tuple[int, Floats, Floats]
"""Kind of the prediction; values, shape (k, s); and their standard deviations, of a shape that fits the values."""


@dataclass(frozen=True)
class _Sensor:
    """A sensor's readings inside the span, and what a filter starts from there."""

    name: str
    columns: SensorColumns
    settings: Any
    start: Start
    start_ns: int
    notes: list[Note]


NOTHING_TOLD: Final[Mapping[str, int]] = MappingProxyType({})


def prepare_sensors(
    sensors: Mapping[str, SensorColumns],
    config: Config,
    start: Start,
    start_ns: int,
    end_ns: int,
    told_ns: Mapping[str, int] = NOTHING_TOLD,
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the sensors of a dive, without a gate; LogError where one has no reading in the span.

    The rows of a time line from `timeline.FIRST_OTHER` on are theirs, in this order. The start is made of their
    readings at ``told_ns``, which are not used again.
    """
    found, notes = dict[str, Measurement](), list[Note]()
    for row, (name, columns) in enumerate(sensors.items(), start=FIRST_OTHER):
        inside = (columns.time_ns > start_ns) & (columns.time_ns <= end_ns)
        if not inside.any():
            raise LogError(
                f"no reading of the {name} lies between the start of the replay and its end",
                f"check {name}.stamp against imu.stamp, or widen --start and --end",
            )
        columns = columns.rows(inside)
        notes += silence_notes(name, columns.time_ns, start_ns, end_ns)
        sensor = _Sensor(name, columns, getattr(config, name), start, start_ns, notes)
        kind, values, sd = _MEASURED[name](sensor)
        of_sensor = SENSORS[name]
        measurement = sensor_measurement(
            name, of_sensor.unit, kind, columns.time_ns, values, sd, axes=of_sensor.components[: values.shape[1]]
        )
        measurement.available[columns.time_ns == told_ns.get(name)] = False
        arm_b = np.array(getattr(sensor.settings, "lever_arm_m", (0.0, 0.0, 0.0)))
        found[name] = replace(measurement, sensor=row, lever_arm_b=arm_b)
    return found, tuple(notes)


def silence_notes(name: str, time_ns: TimeNs, start_ns: int, end_ns: int) -> list[Note]:
    """Note the longest pause between readings, at times of shape (k,), where it is far longer than others.

    Fixes come at the surface, so that pauses of theirs are no fault.
    """
    ends_ns = np.concatenate([[start_ns], time_ns, [end_ns]])
    length_s = np.diff(ends_ns) / NS_PER_S
    longest = int(np.argmax(length_s))
    usual_s = float(np.median(length_s[1:-1])) if len(time_ns) > 1 else 0.0
    if length_s[longest] <= max(SILENT_S, SILENT_READINGS * usual_s):
        return []
    since_s, span_s = (int(ends_ns[longest]) - start_ns) / NS_PER_S, (end_ns - start_ns) / NS_PER_S
    until = "to the end" if longest == len(time_ns) else "on"
    text = (
        f"no reading of the {name} for {length_s[longest]:.0f} of {span_s:.0f} s, from {since_s:.0f} s after the start "
        f"{until}"
    )
    severity = Severity.INFO if name == "position" else Severity.WARNING
    return [Note(f"{name}_silent", text, severity=severity)]


def withheld_notes(config: Config) -> tuple[Note, ...]:
    """Say which filters are not aided by a sensor that they name, since it is withheld from all."""
    named = {
        sensor: [name for name, filter_ in config.computed.items() if sensor in filter_.aiding]
        for sensor in config.evaluation.withheld
    }
    return tuple(
        Note(
            f"{sensor}_withheld",
            f"the {sensor} is withheld, and does not aid {', '.join(names)}",
            severity=Severity.WARNING,
            hint=f'take "{sensor}" out of evaluation.withheld',
        )
        for sensor, names in named.items()
        if names
    )


def _depth(sensor: _Sensor) -> Measured:
    """Return how far down the gauge is from the ellipsoid: its own zero is at the water's surface, or anywhere."""
    settings: Depth = sensor.settings
    depth_m, surface_m = sensor.columns.values, settings.surface_height_m
    if surface_m is None:
        arm_down_m = float((sensor.start.mat_nb @ np.array(settings.lever_arm_m))[2])
        surface_m = float(sensor.start.position[2]) - arm_down_m + float(depth_m[0, 0])
        late_s = (int(sensor.columns.time_ns[0]) - sensor.start_ns) / NS_PER_S
        text = (
            f"depth: 0 is taken to be {surface_m:.3f} m above the ellipsoid, by the first reading, {late_s:.2f} s "
            "after the start, and the height at the start; filters that are aided by it find out"
        )
        sensor.notes.append(Note("depth_zero", text, hint="depth.surface_height_m says it otherwise"))
    return DEPTH, depth_m - surface_m, np.array([settings.sd_m])


def _heading(sensor: _Sensor) -> Measured:
    settings: Heading = sensor.settings
    return HEADING, sensor.columns.values, np.array([settings.sd_deg * DEG])


def _position(sensor: _Sensor) -> Measured:
    """Return the fixes without heights that are not to be used."""
    settings: Position = sensor.settings
    fixes = sensor.columns.values
    sd_m = np.array([settings.sd_m, settings.sd_m, settings.height_sd_m or np.nan])
    used = slice(2 if settings.height_sd_m is None else 3)
    sensor.notes.extend(_far_notes(sensor, fixes[0]))
    return FIX, fixes[:, used], sd_m[used]


def _far_notes(sensor: _Sensor, fix: Floats) -> list[Note]:
    """Warn of a first fix at which no vehicle can be that was at the start."""
    late_s = (int(sensor.columns.time_ns[0]) - sensor.start_ns) / NS_PER_S
    away_m = float(np.hypot(*north_east_m(fix, sensor.start.position, sensor.start.position)))
    if away_m <= FAR_M + FASTEST_MPS * late_s:
        return []
    latitude_deg, longitude_deg = fix[:2] / DEG
    text = (
        f"the first fix, {late_s:.2f} s after the start, is {away_m / 1000.0:.3g} km from it: at latitude "
        f"{latitude_deg:.4f} deg, longitude {longitude_deg:.4f} deg"
    )
    hint = "position.latitude, position.longitude and position.angle_unit; or initial.latitude_deg and longitude_deg"
    return [Note("position_contradiction", text, 1, Severity.WARNING, hint)]


_MEASURED: Final[dict[str, Callable[[_Sensor], Measured]]] = {
    "depth": _depth,
    "heading": _heading,
    "position": _position,
}
