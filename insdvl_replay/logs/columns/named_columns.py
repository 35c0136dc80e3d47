"""Which columns of a table are those of a trajectory, by their names."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

# An altitude is no height here: most vehicles mean that above the bottom.
REFERENCE_WORDS: Final = {
    "latitude": re.compile(r"(^|[._])lat(itude)?([._]|$)"),
    "longitude": re.compile(r"(^|[._])(lon|lng|long|longitude)([._]|$)"),
    "depth": re.compile(r"(^|[._])depth([._]|$)"),
    "roll": re.compile(r"(^|[._])roll([._]|$)"),
    "pitch": re.compile(r"(^|[._])pitch([._]|$)"),
    "heading": re.compile(r"(^|[._])(heading|hdg|yaw)([._]|$)"),
}
PLACE: Final = ("latitude", "longitude")
ATTITUDE: Final = ("roll", "pitch", "heading")
_HEIGHT: Final = re.compile(r"(^|[._])height([._]|$)")
_NORTH: Final = re.compile(r"(?i)(.*(?:v|vel|velocity)_?)(n|north)((?:_mps|_m_s)?)")
_EAST_AND_DOWN: Final = {"n": ("e", "d"), "north": ("east", "down")}
_NORTH_AND_UP: Final = {"e": ("n", "u"), "east": ("north", "up")}
# Positions in metres, and quaternions, by their components; a table such as EuRoC's writes ``p_RS_R_x``.
_LOCAL: Final = re.compile(
    r"((?:.*_)?(?:p|pos|position|t|trans|translation|p_rs_r)_?|pose_|)([xyz])((?:_m)?)"
)
_IN_NED: Final = re.compile(r"((?:(?:.*_)?(?:p|pos|position)_?)?)(north|n)((?:_m)?)")
_IN_ENU: Final = re.compile(r"((?:(?:.*_)?(?:p|pos|position)_?)?)(east|e)((?:_m)?)")
_WITHOUT_HEIGHT: Final = re.compile(
    r"((?:(?:.*_)?(?:p|pos|position|utm)_?)?)(easting|east)((?:_m)?)"
)
_QUATERNION: Final = re.compile(
    r"((?:.*_)?(?:q|quat|quaternion|orientation|rot|rotation|q_rs)_?)([xyzw])()"
)
_SD: Final = re.compile(r"(?:(?:sd|std|sigma)_(.+)|(.+)_(?:sd|std|sigma))")


@dataclass(frozen=True)
class NamedColumns:
    """The columns of a trajectory."""

    fields: Mapping[str, str]  # the columns by the quantity that they hold
    is_ned: bool = False  # whether positions in metres are named north, east and down
    sds: Mapping[str, str] = field(default_factory=dict)  # of standard deviations, likewise


def velocity_columns(names: Collection[str]) -> str | None:
    """Return three columns such as ``vn``, ``ve``, ``vd`` or ``vel_north``, ``vel_east``, ``vel_down``."""
    return _family(names, _NORTH, _EAST_AND_DOWN)


def positions_by_direction(names: Collection[str]) -> tuple[str, str] | None:
    """Return two or three columns of positions in metres that are named by directions, and the axes that these are.

    They are such as ``north, east, down``, ``pos_e, pos_n, pos_u`` or ``easting, northing``; the axes are those of the
    settings.
    """
    in_ned = _family(names, _IN_NED, _EAST_AND_DOWN)
    if in_ned is not None:
        return in_ned, "ned_frd"
    in_enu = _family(names, _IN_ENU, _NORTH_AND_UP)
    if in_enu is not None:
        return in_enu, "enu_flu"
    flat = _family(names, _WITHOUT_HEIGHT, {"easting": ("northing",), "east": ("north",)})
    if flat is not None:
        return flat, "enu_flu"
    return None


def trajectory_columns(names: Iterable[str]) -> NamedColumns:
    """Find the columns of a position, a velocity and an attitude, each optional, and their standard deviations."""
    values = list[str]()
    sds: dict[str, str] = {}  # by the name of the column whose deviation it is
    for name in names:
        match = _SD.fullmatch(name)
        if match is None:
            values.append(name)
        else:
            sds[match[1] or match[2]] = name
    fields, is_ned = _fields_of(values)
    own_sds: dict[str, str] = {}
    for quantity, joined in _fields_of(list(sds))[0].items():
        own_sds[quantity] = ", ".join(sds[name] for name in joined.split(", "))
    return NamedColumns(fields, is_ned, own_sds)


def reference_columns(names: Collection[str]) -> dict[str, str]:
    """Return for each quantity of a solution the first column that has its name."""
    found: dict[str, str] = {}
    for quantity, words in REFERENCE_WORDS.items():
        for name in names:
            if words.search(name.lower()):
                found.setdefault(quantity, name)
    return found


def _leave_out(found: dict[str, str], quantities: Iterable[str]) -> None:
    for quantity in quantities:
        found.pop(quantity, None)


def _fields_of(names: Collection[str]) -> tuple[dict[str, str], bool]:
    """Return the columns of each quantity, and whether positions in metres are named north, east and down."""
    found = reference_columns(names)
    for together in (PLACE, ATTITUDE):
        if not found.keys() >= set(together):
            _leave_out(found, together)
    velocity = velocity_columns(names)
    if velocity is not None:
        found["velocity_n"] = velocity
    quaternion = _family(names, _QUATERNION, {"x": ("y", "z", "w")})
    if quaternion is not None:
        found["quaternion"] = quaternion
        _leave_out(found, ATTITUDE)
    if "latitude" in found:
        heights = [name for name in names if _HEIGHT.search(name)]
        if heights:
            found["height"] = heights[0]
        return found, False
    found.pop("depth", None)
    in_ned = _family(names, _IN_NED, _EAST_AND_DOWN)
    local = _family(names, _LOCAL, {"x": ("y", "z")})
    if local is not None or in_ned is not None:
        found["local_position"] = local or in_ned or ""
    return found, local is None and in_ned is not None


def _family(
    names: Collection[str], pattern: re.Pattern[str], others: Mapping[str, tuple[str, ...]]
) -> str | None:
    """Return the columns that belong together, the first of which is like a pattern; None if one is missing."""
    for name in names:
        match = pattern.fullmatch(name)
        if match is None or match[2].lower() not in others:
            continue
        rest = [f"{match[1]}{other}{match[3]}" for other in others[match[2].lower()]]
        if set(names) >= set(rest):
            return ", ".join((name, *rest))
    return None
