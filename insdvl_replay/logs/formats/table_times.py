"""Times of tables: numbers in a unit, days of a calendar, dates, and times of day without a date or an hour."""

import re
from dataclasses import dataclass
from datetime import date
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.core.dive_columns import NS_PER_S, Array, Floats, Mask, TimeNs
from insdvl_replay.core.units import TIME_UNITS_NS
from insdvl_replay.logs.formats.log_file import Span

TIME_NAME: Final = re.compile(
    r"(^|[_.])(time|times|timestamp|stamp|t|utc|epoch|clock|tow|datetime|datenum|time_?of_?day|hms)([_.]?(s|sec|ms|us|ns))?$"
)
DATE_NAME: Final = re.compile(r"(^|[_.])(date|day|datum|ymd)$")
HOUR_NS: Final = TIME_UNITS_NS["h"]
DAY_NS: Final = TIME_UNITS_NS["d"]
DAY_S: Final = DAY_NS / NS_PER_S
_RATES_HZ: Final = (0.2, 4000.0)  # of a sensor: they tell the unit of times that has no name
_SLOWEST_HZ: Final = 1.0 / 3600.0  # of fixes, where nothing else fits
_SINCE_1970_S: Final = (1e9, 4e9)  # times of a clock that counts from then, from 2001 to 2096
# 2000 to 2050, days since 1970
_FIRST_DAY: Final = 10_957
_LAST_DAY: Final = 29_220
_FEW: Final = 0.05  # share of the cells that may be no times, and of the steps that may fall
_AS_FAR: Final = 0.3  # shuffled times fall by more than this share of how far they rise
_COARSE: Final = 0.1  # share of the usual step by which rounded times may be wrong
_MOST_DIGITS: Final = 12
_CELL: Final = re.compile(
    r"\s*(?:(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4})[ T]+)?"
    r"(?:(\d{1,2}):)?(\d{1,2}):(\d{1,2}(?:[.,:]\d+)?)\s*([AaPp][Mm])?Z?\s*"
)
_DATE: Final = re.compile(r"\s*(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})\s*")


_DateNumbers = tuple[int, int, int]  # as a date is written, the year first or last


@dataclass(frozen=True)
class Calendar:
    """A count of days."""

    name: str
    zero: float  # its number on 1970-01-01


CALENDARS: Final = (
    Calendar("days since 1899-12-30 (a spreadsheet's)", 25_569.0),
    Calendar("days since the year 0 (MATLAB's datenum)", 719_529.0),
    Calendar("days since 1970-01-01", 0.0),
    Calendar("modified Julian days", 40_587.0),
    Calendar("Julian days", 2_440_587.5),
)


@dataclass(frozen=True)
class TextTimes:
    """Times that were text."""

    # (k,) of day, or since 1970 where the cells have a date; 0 where a cell has none.
    time_ns: TimeNs
    known: Mask  # (k,)
    period_ns: int  # after which they repeat: an hour, a day, or 0 with a date


def calendar_of(values: Array) -> Calendar | None:
    """Return the calendar in which numbers are days from 2000 to 2050, the first that is possible; None without one."""
    middle = float(np.median(values))
    found = (known for known in CALENDARS if _FIRST_DAY <= middle - known.zero < _LAST_DAY)
    return next(found, None)


def zero_of(values: Array, unit: str) -> float:
    """Return the number from which times in a unit are counted: of days that of 1970 in their calendar."""
    calendar = calendar_of(values) if unit == "d" and values.size else None
    if calendar:
        return calendar.zero
    return 0.0


def in_ns(values: Array, unit: str) -> TimeNs:
    """Return times in a unit as ns, (k,); days of a calendar are counted from 1970."""
    if values.dtype.kind != "f" and unit != "d":
        return np.asarray(values.astype(np.int64) * TIME_UNITS_NS[unit])
    zero = zero_of(values, unit)
    return np.asarray(np.rint((values - zero) * TIME_UNITS_NS[unit]).astype(np.int64))


def usual_step(values: Array) -> float:
    """Return the median step between times that rise; 0 where none does. Rows in no order are sorted for it."""
    numbers = values.astype(np.float64)
    steps = np.diff(numbers)
    if _is_shuffled(steps):
        steps = np.diff(np.sort(numbers))
    if (steps > 0.0).any():
        return float(np.median(steps[steps > 0.0]))
    return 0.0


def _is_shuffled(steps: Floats) -> bool:
    """Return whether times with these steps are in no order: many fall, and about as far as others rise.

    Times that begin anew fall only once, and those of two interleaved sensors fall by little. Sorted, their rows would
    be closer together than those of a sensor.
    """
    is_fall = steps < 0.0
    if np.count_nonzero(is_fall) <= _FEW * steps.size:
        return False
    rises = steps[steps > 0.0]
    if not rises.size:
        return True
    return float(np.median(-steps[is_fall])) > _AS_FAR * float(np.median(rises))


def likely_unit(values: Array) -> str:
    """Return the unit of times by the rate that a sensor can have, and best by a size that counts from 1970.

    Days are told by their calendar too. Empty where no unit gives a possible rate.
    """
    step = usual_step(values)
    size = float(np.median(np.abs(values)))
    if step == 0.0:
        return "s"
    seconds = {unit: factor / NS_PER_S for unit, factor in TIME_UNITS_NS.items()}
    small = [unit for unit in ("s", "ms", "us", "ns") if _is_of_sensor(step * seconds[unit])]
    for unit in small:
        if _SINCE_1970_S[0] < size * seconds[unit] < _SINCE_1970_S[1]:
            return unit
    if small:
        return small[0]
    if calendar_of(values) is not None and _is_of_sensor(step * seconds["d"], _SLOWEST_HZ):
        return "d"
    if _is_of_sensor(step * seconds["s"], _SLOWEST_HZ):
        return "s"
    return ""


def _is_of_sensor(step_s: float, slowest_hz: float = _RATES_HZ[0]) -> bool:
    """Return whether a step of times is one that a sensor can have."""
    return step_s > 0.0 and slowest_hz < 1.0 / step_s < _RATES_HZ[1]


def guessed_units(step: float) -> str:
    """Say what a step of times would be in the longer units, where it is that of a sensor."""
    guesses = []
    for unit in ("min", "h", "d"):
        step_s = step * TIME_UNITS_NS[unit] / NS_PER_S
        if _is_of_sensor(step_s):
            guesses.append(f"{step_s:.3g} s in {unit}")
    if guesses:
        return f"; it would be {' or '.join(guesses)}"
    return ""


def exact_to_s(days: Floats) -> float:
    """Return to which part of a second days are written or stored."""
    some = days[:1000]
    stored = float(np.spacing(np.abs(some).max()))
    for digits in range(_MOST_DIGITS):
        unit = 10.0**-digits
        if unit <= stored or np.all(
            np.abs(some / unit - np.rint(some / unit)) < 2.0 * stored / unit
        ):
            return max(unit, stored) * DAY_S
    return stored * DAY_S


def is_coarse(days: Floats) -> bool:
    """Return whether days are rounded so much that the steps between them are not those of the sensor."""
    return exact_to_s(days) > _COARSE * usual_step(days) * DAY_S


# --- Text.


def text_times(cells: "pd.Series[Any]") -> TextTimes | None:
    """Read cells such as ``10:41:07.5``, ``41:07.50``, ``6/8/2021 10:41:07`` or ``10:41:07 PM``; None for others."""
    texts = cells.dropna().astype(str)
    if not len(texts) or not _CELL.fullmatch(str(texts.iloc[0])):
        return None
    parts = texts.str.extract(f"^{_CELL.pattern}$")
    minute = pd.to_numeric(parts[2])
    second = pd.to_numeric(parts[3].str.replace(r"[,:]", ".", regex=True))
    hour = pd.to_numeric(parts[1])
    has_hour = parts[1].notna()
    good = (minute < 60) & (second < 60) & ~(hour > 24)
    if good.mean() <= 1.0 - _FEW:
        return None
    half = parts[4].str.lower()
    hour = hour.where(half.isna(), hour % 12) + 12.0 * (half == "pm")
    whole = hour.fillna(0.0) * 3600.0 + minute.fillna(0.0) * 60.0
    of_day = np.rint(whole.to_numpy() * 1e9) + np.rint(second.fillna(0.0).to_numpy() * 1e9)
    time_ns = np.zeros(len(cells), np.int64)
    known = np.zeros(len(cells), np.bool_)
    places = np.flatnonzero(cells.notna().to_numpy())[good.to_numpy()]
    known[places] = True
    time_ns[places] = of_day[good.to_numpy()].astype(np.int64)
    if parts[0].notna()[good].all():
        days = dates_ns(parts[0][good])
        if days is None:
            return None
        time_ns[places] += days
        return TextTimes(time_ns, known, 0)
    return TextTimes(time_ns, known, DAY_NS if has_hour[good].mean() > 0.5 else HOUR_NS)


def dates_ns(texts: "pd.Series[Any]") -> TimeNs | None:
    """Return dates such as ``2021-06-08``, ``8.6.2021`` or ``6/28/2021`` as ns since 1970, (k,); None for others.

    Where both could be the month, the day is first.
    """
    whole = texts.astype(str)
    numbers: dict[str, _DateNumbers] = {}  # by what is written
    for text in whole.unique():
        match = _DATE.fullmatch(str(text))
        if match is None:
            return None
        numbers[str(text)] = (int(match[1]), int(match[2]), int(match[3]))
    is_month_first = any(second > 12 for first, second, _ in numbers.values() if first <= 12)
    known: dict[str, int] = {}
    for text, written in numbers.items():
        try:
            days = _days_since_1970(written, is_month_first=is_month_first)
        except ValueError:
            return None
        known[text] = days * DAY_NS
    if not known:
        return None
    return np.asarray(whole.map(known).to_numpy(np.int64))


def _days_since_1970(numbers: _DateNumbers, *, is_month_first: bool) -> int:
    """Return the day of a date; a ValueError where there is no such day."""
    if numbers[0] > 31:
        year, month, day = numbers
    elif is_month_first:
        month, day, year = numbers
    else:
        day, month, year = numbers
    if year < 100:
        year += 2000
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()


def unwrapped(time_ns: TimeNs, known: Mask, period_ns: int) -> TimeNs:
    """Return times that go on where an hour or a day begins anew, (k,)."""
    rising = time_ns.copy()
    steps = np.diff(time_ns[known])
    turns = np.cumsum((steps < -period_ns // 2).astype(np.int64) - (steps > period_ns // 2))
    rising[known] += period_ns * np.concatenate([[0], turns])[: int(np.count_nonzero(known))]
    return rising


# --- Tables of one dive, of which some have no date or no hour.


def shift_ns(times: Span, period_ns: int, others: Span) -> int | None:
    """Return by how many periods times are to be shifted to overlap others the most, in ns.

    None where another shift is as good.
    """
    first, last = others

    def overlap_ns(shift: int) -> int:
        return min(last, times[1] + shift) - max(first, times[0] + shift)

    nearest = period_ns * round((first + last - times[0] - times[1]) / 2 / period_ns)
    shifts = [nearest + step * period_ns for step in (-1, 0, 1)]
    best, second, _ = sorted(shifts, key=overlap_ns, reverse=True)
    if overlap_ns(second) > 0 and overlap_ns(second) > 0.98 * overlap_ns(best):
        return None
    return best
