"""What the settings and the reference leave open of the start, by the sensors that tell it: heading and position."""

from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, SensorColumns, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.sensors import BY_SENSOR
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity

FAR_S: Final = 1.0
"""A reading that is further from the start says little about it: a vehicle moves on."""


def started_by_sensors(
    config: Config, sensors: Mapping[str, SensorColumns], reference: ReferenceColumns | None, start_ns: int
) -> tuple[Config, tuple[Note, ...]]:
    """Fill in heading and position at the start by the readings nearest to it.

    Parameters
    ----------
    sensors : mapping of str to SensorColumns
        Of the dive.
    start_ns : int
        Of the span; where a reference gives the attitude, this counts and no sensor.

    Returns
    -------
    Config
        With the start filled in; it is no surer than the sensors are.
    tuple of Note

    Raises
    ------
    LogError
        The heading is to be a sensor's, which is silent at the start.
    """
    initial, notes = config.initial, list[Note]()
    posed = initial.source == "reference" and reference is not None and reference.has_attitude
    if not posed and "heading" in sensors and initial.heading_deg in (None, BY_SENSOR):
        initial = _with_heading(initial, sensors["heading"], config.heading.sd_deg, start_ns, notes)
    located = reference is not None and reference.has_position
    if not located and "position" in sensors and initial.latitude_deg is None:
        initial = _with_position(initial, sensors["position"], config.position.sd_m, start_ns, notes)
    return msgspec.structs.replace(config, initial=initial), tuple(notes)


def _with_heading(
    initial: Initial, readings: SensorColumns, sd_deg: float, start_ns: int, notes: list[Note]
) -> Initial:
    values, away_s = _nearest(readings, start_ns)
    if away_s > FAR_S:
        raise LogError(
            f"the reading of the heading that is nearest to the start is {away_s:.1f} s away",
            "--start where there is one, or --set initial.heading_deg=...",
        )
    heading_deg = float(values[0]) / DEG % 360.0
    text = f"heading at the start {heading_deg:.2f} deg, of the sensor's reading {away_s:.2f} s away"
    notes.append(Note("start_heading_sensor", text))
    north_deg, east_deg, down_deg = initial.misalignment_sd_deg
    return msgspec.structs.replace(
        initial, heading_deg=heading_deg, misalignment_sd_deg=(north_deg, east_deg, max(down_deg, sd_deg))
    )


def _with_position(initial: Initial, fixes: SensorColumns, sd_m: float, start_ns: int, notes: list[Note]) -> Initial:
    (latitude, longitude, height_m), away_s = _nearest(fixes, start_ns)
    text = f"position at the start by the fix {away_s:.2f} s away"
    severity = Severity.WARNING if away_s > FAR_S else Severity.INFO
    notes.append(Note("start_position_sensor", text, severity=severity))
    north_m, east_m, down_m = initial.position_sd_m
    return msgspec.structs.replace(
        initial,
        latitude_deg=float(latitude) / DEG,
        longitude_deg=float(longitude) / DEG,
        height_m=float(height_m),
        position_sd_m=(max(north_m, sd_m), max(east_m, sd_m), down_m),
    )


def _nearest(readings: SensorColumns, start_ns: int) -> tuple[Floats, float]:
    """Return the reading nearest to a time, and by how many seconds it is away."""
    away_s = np.abs(seconds(readings.time_ns, start_ns))
    row = int(np.argmin(away_s))
    return readings.values[row], float(away_s[row])
