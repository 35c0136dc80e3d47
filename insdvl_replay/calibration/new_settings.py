"""What a calibration proposes: each setting with its interval, lines to copy, and a picture of the vehicle."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from insdvl_replay.calibration.calibration import Calibration
from insdvl_replay.calibration.innovations import LABELS, SHARED, Geometry
from insdvl_replay.calibration.rows import ParameterRow
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.document.parts import (
    LIMIT,
    REFERENCE,
    Curve,
    DisplayTable,
    Figure,
    Panel,
    filter_style,
)
from insdvl_replay.document.tables import MISSING, number, signed_number, table_of
from insdvl_replay.geometry.rotation import mat_from_rpy

_SDS: Final = 1.96  # half of a 95 % interval, in standard deviations
_PERCENT: Final = 100.0
_KEYS: Final = {parameter.name: parameter.key for parameter in SHARED}
_ARM: Final = "lever_arm_m"  # in front of all others
_UNITS: Final = {"scale": ""}  # of a value, where it is not that of its change
_DIRECTIONS: Final = {"x": "forward", "y": "starboard", "z": "down"}


def is_proposed(row: ParameterRow) -> bool:
    """Return whether a parameter has a new value."""
    return row.status == Estimated.ESTIMATED and row.change is not None


def new_settings_table(
    title: str,
    rows: Sequence[ParameterRow],
    before: Geometry,
    after: Geometry,
) -> DisplayTable:
    """Return each asked parameter before and after, with the 95 % interval of the new value."""

    def old(row: ParameterRow) -> str:
        value = _value(row, before)
        if value is None:
            return MISSING
        return number(value)

    def new(row: ParameterRow) -> str:
        if not is_proposed(row):
            return row.status
        value = _value(row, after)
        if value is None:
            return signed_number(finite(row.change))
        return number(value)

    def interval(row: ParameterRow) -> str:
        if not is_proposed(row):
            return MISSING
        low, high = _interval(row, after)
        return f"{number(low)} .. {number(high)}"

    asked = [row for row in rows if row.status != Estimated.NOT_ASKED]
    asked.sort(key=lambda row: _KEYS[row.parameter] != _ARM)
    columns = (
        ("", "l", _name),
        ("before", "r", old),
        ("new", "r", new),
        ("95 % interval", "r", interval),
    )
    footnote = ""
    if any(_is_turn(row) for row in asked):
        footnote = (
            "Mounting: how far the DVL is turned about these axes relative to the settings. "
            "The interval is 1.96 sd."
        )
    return table_of(title, asked, columns, footnote)


def _name(row: ParameterRow) -> str:
    """Name a parameter as people know it, with the direction of its axis and its unit."""
    name = LABELS[row.parameter]
    words, _, axis = name.rpartition(" ")
    if axis in _DIRECTIONS and not _is_turn(row):
        name = f"{words.replace('arm', 'lever arm')} {axis}, {_DIRECTIONS[axis]}"
    unit = _UNITS.get(row.parameter, row.unit)
    if unit:
        return f"{name} [{unit}]"
    return name


def _is_turn(row: ParameterRow) -> bool:
    return _KEYS[row.parameter] == "mounting_rpy_deg"


def _value(row: ParameterRow, geometry: Geometry) -> float | None:
    """Return the setting of a parameter; a turn about an axis is no setting of its own."""
    if _is_turn(row):
        return None
    value = getattr(geometry, _KEYS[row.parameter])
    if isinstance(value, tuple):
        return float(value["xyz".index(row.parameter[-1])])
    return float(value)


def _interval(row: ParameterRow, after: Geometry) -> tuple[float, float]:
    """Return the 95 % interval of a new value, of a turn that of its change."""
    middle = _value(row, after)
    if middle is None:
        middle = finite(row.change)
    half = _SDS * finite(row.sd)
    if row.unit == "%":
        half /= _PERCENT
    return middle - half, middle + half


# --- The vehicle.

_BEFORE: Final = filter_style(1)
_AFTER: Final = filter_style(0)
_LENGTH: Final = 1.3  # of the half hull, in units of the farthest sensor
_WIDTH: Final = 0.35
_SMALLEST_M: Final = 0.1
_ARROW: Final = 0.35


def vehicle_figure(found: Calibration) -> Iterator[Figure]:
    """Draw where the DVL is, before and after, from above and from the side, if a part of its lever arm is new."""
    arm = [row for row in found.rows if _KEYS[row.parameter] == _ARM]
    if not any(map(is_proposed, arm)):
        return
    sd_m = np.array([finite(row.sd) if is_proposed(row) else 0.0 for row in arm])
    texts = []
    for row in arm:
        if is_proposed(row):
            low, high = _interval(row, found.after)
            direction = _DIRECTIONS[row.parameter[-1]]
            value = number(_value(row, found.after))
            texts.append(f"{value} m {direction} ({number(low)} .. {number(high)})")
    caption = (
        f"The DVL as seen from the IMU: {', '.join(texts)}. The bars at the DVL show these intervals, and the short "
        f"line its x axis. The hull is only a sketch."
    )
    size_m = max(_SMALLEST_M, *np.abs(found.before.lever_arm_m), *np.abs(found.after.lever_arm_m))
    panels = (
        _panel("from above: port [m]", found, sd_m, size_m, upwards=1),
        _panel("from the side: up [m]", found, sd_m, size_m, upwards=2),
    )
    yield Figure("Where the DVL is", caption, panels, ())


def _panel(
    title: str,
    found: Calibration,
    sd_m: Floats,  # (3,), of the new arm; 0 for what is not new
    size_m: float,
    *,
    upwards: int,  # axis of the vehicle whose negative points up in the panel
) -> Panel:
    """Draw IMU and DVL with the bow to the right."""
    before = np.array(found.before.lever_arm_m)
    after = np.array(found.after.lever_arm_m)
    x_axis = mat_from_rpy(np.deg2rad(found.after.mounting_rpy_deg))[:, 0]

    def seen(points: Floats) -> tuple[Floats, Floats]:
        rows = np.atleast_2d(points)
        return rows[:, 0], -rows[:, upwards]

    bars = []
    for axis in (0, upwards):
        half = np.zeros(3)
        half[axis] = _SDS * sd_m[axis]
        bars += [after - half, after + half, np.full(3, np.nan)]
    origin = np.zeros(3)
    arrow = np.array([after, after + _ARROW * size_m * x_axis])
    curves = (
        Curve(*_hull(size_m), LIMIT, name=""),
        Curve(*seen(np.array([origin, before])), f"{_BEFORE} sigma", name=""),
        Curve(*seen(np.array([origin, after])), f"{_AFTER} solid", name=""),
        Curve(*seen(arrow), f"{_AFTER} solid", name=""),
        Curve(*seen(np.array(bars)), f"{_AFTER} solid", name=""),
        Curve(*seen(before), _BEFORE, points=True, label="DVL before"),
        Curve(*seen(after), _AFTER, points=True, label="DVL, new"),
        Curve(*seen(origin), REFERENCE, points=True, label="IMU"),
    )
    return Panel(title, "forward [m]", curves, equal=True, low=True, ends=False)


def _hull(size_m: float) -> tuple[Floats, Floats]:
    """Return the outline of a torpedo about the origin, its round bow to the right and its narrow stern to the left."""
    along = np.linspace(-1.0, 1.0, 101)
    bow = np.clip((along - 0.6) / 0.4, 0.0, 1.0)
    stern = np.clip((-0.3 - along) / 0.7, 0.0, 1.0)
    half_width = _WIDTH * np.sqrt(1.0 - bow**2) * (1.0 - 0.8 * stern**2)
    x = np.concatenate([along, along[::-1], along[:1]])
    y = np.concatenate([half_width, -half_width[::-1], half_width[:1]])
    size = _LENGTH * size_m
    return size * x, size * y
