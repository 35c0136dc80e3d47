"""Units: their SI factors by quantity, how titles of columns spell them, and how the program's own names end."""

import re
from collections.abc import Mapping
from typing import Final

from insdvl_replay.core.states import DEG, MG

_FOOT_M: Final = 0.3048
_KNOT_MPS: Final = 1852.0 / 3600.0

SPECIFIC_FORCE_UNITS: Final = {
    "m/s2": 1.0, "g": 1000.0 * MG, "mg": MG, "ug": 1e-3 * MG, "cm/s2": 1e-2, "mm/s2": 1e-3, "ft/s2": _FOOT_M,
}  # fmt: skip
ANGULAR_RATE_UNITS: Final = {
    "rad/s": 1.0, "deg/s": DEG, "mrad/s": 1e-3, "mdeg/s": 1e-3 * DEG, "deg/min": DEG / 60.0, "deg/h": DEG / 3600.0,
    "rad/h": 1.0 / 3600.0, "rpm": 6.0 * DEG,
}  # fmt: skip
VELOCITY_UNITS: Final = {
    "m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6, "kn": _KNOT_MPS, "ft/s": _FOOT_M, "in/s": _FOOT_M / 12.0,
    "m/min": 1.0 / 60.0,
}  # fmt: skip
ANGLE_UNITS: Final = {"deg": DEG, "rad": 1.0, "mrad": 1e-3, "mdeg": 1e-3 * DEG}
PRESSURE_UNITS: Final = {
    "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "dbar": 1e4, "bar": 1e5, "mbar": 1e2, "MPa": 1e6, "psi": 6894.757293168361,
}  # fmt: skip
LENGTH_UNITS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": _FOOT_M}
TIME_UNITS_NS: Final = {
    "s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1, "min": 60 * 10**9, "h": 3600 * 10**9, "d": 86_400 * 10**9,
}  # fmt: skip

UNITS_BY_KIND: Final[dict[str, Mapping[str, float]]] = {
    "specific force": SPECIFIC_FORCE_UNITS,
    "angular rate": ANGULAR_RATE_UNITS,
    "velocity": VELOCITY_UNITS,
    "angle": ANGLE_UNITS,
    "pressure": PRESSURE_UNITS,
    "length": LENGTH_UNITS,
    "time": TIME_UNITS_NS,
}
# The unit in which the numbers of a quantity are read where neither a setting nor a title has one.
USUAL_UNITS: Final = {
    "specific force": "m/s2", "angular rate": "rad/s", "velocity": "m/s", "angle": "deg", "pressure": "Pa",
    "length": "m", "time": "s",
}  # fmt: skip
KNOWN_UNITS: Final[frozenset[str]] = frozenset().union(*UNITS_BY_KIND.values())

# How names of columns and settings end, and the unit that this means; the longer endings come first.
UNIT_ENDINGS: Final = {
    "_accel_sd_mg": "mg",
    "_mps_rts": "m/s/sqrt(s)",
    "_rad_rts": "rad/sqrt(s)",
    "_mps2_rts": "m/s2/sqrt(s)",
    "_radps_rts": "rad/s/sqrt(s)",
    "_kgpm3": "kg/m3",
    "_degph": "deg/h",
    "_degps": "deg/s",
    "_mps2": "m/s2",
    "_mps": "m/s",
    "_mrad": "mrad",
    "_mg": "mg",
    "_deg": "deg",
    "_pct": "%",
    "_hz": "Hz",
    "_m": "m",
    "_s": "s",
}
PERCENTAGE: Final = "_pct"
"""End of the name of a column of percentages, whose changes are in percentage points."""

# Other spellings, in lower case and after the words and signs below are replaced.
_SPELLINGS: Final = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "msecs": "ms", "millis": "ms",
    "milliseconds": "ms", "usec": "us", "usecs": "us", "micros": "us", "microseconds": "us", "nsec": "ns",
    "nsecs": "ns", "nanos": "ns", "nanoseconds": "ns", "minute": "min", "minutes": "min", "mins": "min", "hr": "h",
    "hrs": "h", "hour": "h", "hours": "h", "day": "d", "days": "d", "mps": "m/s", "mmps": "mm/s", "cmps": "cm/s",
    "kt": "kn", "kts": "kn", "knot": "kn", "knots": "kn", "fps": "ft/s", "feet/s": "ft/s", "kmh": "km/h", "kph": "km/h",
    "km/hr": "km/h", "mps2": "m/s2", "m/s/s": "m/s2", "ft/s/s": "ft/s2", "gal": "cm/s2",
    "dps": "deg/s", "degps": "deg/s", "deg/sec": "deg/s", "deg/hr": "deg/h", "degph": "deg/h", "dph": "deg/h",
    "radps": "rad/s", "rad/sec": "rad/s", "mdps": "mdeg/s", "degree": "deg", "degrees": "deg", "radian": "rad",
    "radians": "rad", "pa": "Pa", "hpa": "hPa", "kpa": "kPa", "meter": "m", "meters": "m", "metre": "m",
    "metres": "m", "feet": "ft", "foot": "ft",
}  # fmt: skip
_SIGNS: Final = {
    "µ": "u", "μ": "u", "²": "2", "^": "", "**": "", "·": "*", "°": "deg", "s-1": "/s", "s⁻¹": "/s", "s-2": "/s2",
    "s⁻²": "/s2", "*": "", " per ": "/", "second": "s", "sec": "s", "degrees": "deg", "radians": "rad",
    "metres": "m", "meters": "m", "hour": "h", "minute": "min", "min-1": "/min", "min⁻¹": "/min",
}  # fmt: skip
# What titles have in brackets and is no unit: axes, frames, and what is said of times.
_NO_UNIT: Final = re.compile(
    r"[xyz]|[xyz]-?axis|forward|starboard|port|down|up|north|east|fwd|stbd|surge|sway|heave|body|nav|ned|enu|frd|flu|"
    r"true|magnetic|raw|filtered|calibrated|local|utc|gmt|gps|unix|posix|epoch|iso.*|[dmyhs:./\- ]*(hh|mm:ss|yyyy).*|"
    r"since .*|\d*|-|none|bool|flag|0/1|1/0"
)
_BRACKETS: Final = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_ENDINGS: Final = re.compile(
    r"_(mps|mmps|cmps|kn|kts|knots|fps|kmh|mps2|mg|ug|dps|degps|degph|radps|deg|rad)$"
)


def spelled(text: str) -> str:
    """Return a unit in the spelling of this program; a text that is no unit that is known stays as it is."""
    unit = text.strip()
    if unit in KNOWN_UNITS:
        return unit
    unit = unit.lower()
    unit = _SPELLINGS.get(unit, unit)
    if unit in KNOWN_UNITS:
        return unit
    for sign, other in _SIGNS.items():
        unit = unit.replace(sign, other)
    unit = unit.replace(" ", "")
    unit = _SPELLINGS.get(unit, unit)
    if unit in KNOWN_UNITS:
        return unit
    return text.strip()


def ending_of(name: str) -> str:
    """Return the end of the name of a column or setting that tells its unit, such as ``_mps``; empty without one."""
    for ending in UNIT_ENDINGS:
        if name.endswith(ending):
            return ending
    return ""


def unit_of_name(name: str) -> str:
    """Return the unit of a column or setting of this program by the end of its name; empty without one."""
    return UNIT_ENDINGS.get(ending_of(name), "")


def name_with_unit(name: str, unit: str) -> str:
    """Return a name with the ending of its unit, such as ``dv_x`` in m/s as ``dv_x_mps``.

    A unit that no ending means is a ValueError.
    """
    for ending, meant in UNIT_ENDINGS.items():
        if meant == unit and ending.count("_") == 1:
            return name + ending
    raise ValueError(f"no ending means {unit}")


def unit_of(title: str) -> str:
    """Return the unit that the title of a column has, in brackets or at its end; empty without one."""
    if found := _BRACKETS.search(title):
        text = found[1].strip()
        if _NO_UNIT.fullmatch(text.lower()):
            return ""
        return spelled(text)
    return unit_at_end(title)


def unit_at_end(name: str) -> str:
    """Return the unit with which a name ends, such as ``vel_x_mps``; empty without one."""
    ending = _ENDINGS.search(name.strip().lower())
    if ending:
        return spelled(ending[1])
    return ""


def title_without_unit(title: str) -> str:
    """Return the title of a column without what it has in brackets."""
    return _BRACKETS.sub("", title).strip()
