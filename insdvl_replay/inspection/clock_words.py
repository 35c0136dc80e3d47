"""How far the clock of a sensor is off, and what may be the reason, in words."""

from typing import Final

from insdvl_replay.core.dive_record import Clock
from insdvl_replay.logs.columns.tables import SAME_CLOCK_S

_NAMES: Final = {"imu": "IMU", "dvl": "DVL"}
# Seconds by which a time runs ahead of UTC: by leap seconds, since 2017.
_LEAPS_S: Final = ((18.0, "GPS time?"), (37.0, "TAI?"))
_ZONE_S: Final = 900.0  # time zones are whole quarters of an hour apart
_FARTHEST_ZONE_S: Final = 14.0 * 3600.0
_YEARS_S: Final = 3.0e8  # stamps that are so far behind count from something else than 1970
_DAY_S: Final = 86_400.0


def is_other_clock(clock: Clock) -> bool:
    """Return whether stamps are from a clock that is not the recorder's."""
    return abs(clock.log_minus_stamp_s) > SAME_CLOCK_S + clock.spread_s


def apart(clock: Clock) -> str:
    """State how far stamps are from the recorder's clock."""
    return f"log time minus stamp is {clock.log_minus_stamp_s:.3f} s (median)"


def clock_words(clock: Clock) -> str:
    """State how far a clock is ahead of the recorder's or behind it, and what it may count."""
    ahead_s = -clock.log_minus_stamp_s
    size = f"{abs(ahead_s):.2f} s"
    if abs(ahead_s) > 2.0 * _DAY_S:
        size = f"{abs(ahead_s) / _DAY_S:.1f} days"
    guess = _guess(ahead_s)
    why = ""
    if guess:
        why = f" ({guess})"
    return f"the {_NAMES.get(clock.role, clock.role)}'s clock is {size} {'ahead' if ahead_s > 0.0 else 'behind'}{why}"


def _guess(ahead_s: float) -> str:
    for leap_s, name in _LEAPS_S:
        if abs(ahead_s - leap_s) < 0.5:
            return name
    if ahead_s < -_YEARS_S:
        return "time since its start?"
    from_zone_s = abs(ahead_s - _ZONE_S * round(ahead_s / _ZONE_S))
    if 0.5 * _ZONE_S < abs(ahead_s) <= _FARTHEST_ZONE_S and from_zone_s < 2.0:
        return "local time?"
    return ""
