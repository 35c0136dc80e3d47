"""Which dives, or which part of a dive, a calibration fits, and which it holds out to test what was found."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.free_mounting import velocities_of
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.core.config import Config, Span
from insdvl_replay.core.dive_columns import NS_PER_S, nanoseconds, seconds
from insdvl_replay.core.errors import ConfigError, hint_for
from insdvl_replay.nav.levelling import FEWEST_SAMPLES, LONGEST_PAUSE_S, levelling_samples

HELD_OUT_SHARE: Final = 0.3  # of several dives, where nobody says which
FITTED_SHARE: Final = 0.5  # of a dive alone; the rest tests what was found
LONGEST_S: Final = 2400.0  # of a dive, from which settings that nobody gave are found
# readings of the IMU, to which noise is fitted: in this time those of 50 Hz
MOST_SAMPLES: Final = 120_000
MOST_STRETCHED: Final = 2.0  # usual lengths of some samples; longer ones have a pause inside


class By(Enum):
    """What divides dives into those that are fitted and those that are held out."""

    NOTHING = auto()  # All are fitted.
    DIVES = auto()  # Some of the dives are held out.
    TIME = auto()  # There is one dive, of which a part is held out.


@dataclass(frozen=True)
class Division:
    """Dives that are fitted, and dives that test the fit."""

    fitted: tuple[ReadDive, ...]
    held_out: tuple[ReadDive, ...] = ()
    by: By = By.NOTHING

    @classmethod
    def asked(cls, dives: Sequence[ReadDive], hold_out: Sequence[str]) -> "Division":
        """Hold out what a user asks for: a share of all dives, evenly spread, or those that are named.

        A ConfigError where a name is not known, a share is none, or no dive is left to fit.
        """
        names = [read.dive.name for read in dives]
        aside = set[int]()
        for wanted in hold_out:
            aside |= _rows_of(wanted, names)
        if len(aside) == len(names):
            raise ConfigError(
                "all dives are held out, and none is left to fit",
                "name more dives, or hold out fewer",
            )
        return cls._without(dives, aside)

    @classmethod
    def found(cls, dives: Sequence[ReadDive]) -> "Division":
        """Hold out what nobody has asked for: a share of several dives, the later part of one alone."""
        if len(dives) > 1:
            return cls._without(dives, _spread(HELD_OUT_SHARE, len(dives)))
        (dive,) = dives
        from_s, to_s = dive.span_s
        divide_s = _start_near(dive, from_s + FITTED_SHARE * (to_s - from_s), to_s)
        earlier = _within(dive, from_s, divide_s)
        later = _within(dive, divide_s, to_s)
        return cls((earlier,), (later,), By.TIME)

    @classmethod
    def nothing_held_out(cls, dives: Sequence[ReadDive]) -> "Division":
        """Fit all dives."""
        return cls(tuple(dives))

    @classmethod
    def _without(cls, dives: Sequence[ReadDive], aside: Collection[int]) -> "Division":
        """Hold out the dives in some rows."""
        fitted = []
        held_out = []
        for row, read in enumerate(dives):
            if row in aside:
                held_out.append(read)
            else:
                fitted.append(read)
        by = By.DIVES if held_out else By.NOTHING
        return cls(tuple(fitted), tuple(held_out), by)

    @property
    def exchanged(self) -> "Division":
        """The same dives, of which those are fitted that were held out."""
        return replace(self, fitted=self.held_out, held_out=self.fitted)

    def with_config(self, config: Config) -> "Division":
        """Return the same dives with other settings."""
        return replace(
            self,
            fitted=tuple(read.with_config(config) for read in self.fitted),
            held_out=tuple(read.with_config(config) for read in self.held_out),
        )


def _rows_of(wanted: str, names: Sequence[str]) -> set[int]:
    """Return the dives that are meant by a name that several may have, which may be a number, or by a share."""
    if wanted in names:
        return {row for row, name in enumerate(names) if name == wanted}
    try:
        share = float(wanted)
    except ValueError:
        raise ConfigError(
            f"dive to hold out '{wanted}' is not known", hint_for(wanted, names)
        ) from None
    if not 0.0 < share < 1.0:
        raise ConfigError(
            f"share to hold out must be between 0 and 1, found {wanted}", "for example 0.3"
        )
    return _spread(share, len(names))


def _spread(share: float, dives: int) -> set[int]:
    """Return a share of some dives, at least one, evenly spread and with the last."""
    count = max(1, round(share * dives))
    return {dives - 1 - round(number * dives / count) for number in range(count)}


# --- Parts of a dive.


def _start_near(dive: ReadDive, at_s: float, to_s: float) -> float:
    """Return the first time from which the IMU measures for long enough to find the level: not just before a pause.

    Where there is none before the end, it is the time that was asked for.
    """
    imu = dive.dive.imu
    first_ns = int(imu.time_ns[0])
    at_ns = first_ns + nanoseconds(at_s)
    pauses = np.flatnonzero(np.diff(imu.time_ns) > nanoseconds(LONGEST_PAUSE_S))
    ends_ns = imu.time_ns[pauses + 1]
    in_part = (ends_ns > at_ns) & (ends_ns < first_ns + nanoseconds(to_s))
    for start_ns in (at_ns, *ends_ns[in_part].tolist()):
        if len(levelling_samples(imu, start_ns).time_ns) >= FEWEST_SAMPLES:
            return float(start_ns - first_ns) / NS_PER_S
    return at_s


def middle(dive: ReadDive) -> ReadDive:
    """Return the middle of a long dive."""
    from_s, to_s = dive.span_s
    aside_s = 0.5 * (to_s - from_s - LONGEST_S)
    if aside_s <= 0.0:
        return dive
    return _within(dive, from_s + aside_s, to_s - aside_s)


def beginning(dive: ReadDive) -> ReadDive:
    """Return a long dive from its start until `LONGEST_S` after its first ping, which on a way down can be late."""
    from_s, to_s = dive.span_s
    ping_ns, _ = velocities_of(dive.dive.dvl)
    ping_s = seconds(ping_ns, int(dive.dive.imu.time_ns[0]))
    heard_s = ping_s[ping_s >= from_s]
    if not len(heard_s) or heard_s[0] + LONGEST_S >= to_s:
        return dive
    return _within(dive, from_s, float(heard_s[0]) + LONGEST_S)


def bounded(dive: ReadDive) -> ReadDive:
    """Return a dive with the readings of its span alone, about `MOST_SAMPLES` of them, where it has many more.

    Each few are one then, at the mean of their times. The noise of sensors is a density, which stays.
    """
    if round(len(dive.dive.imu.time_ns) / MOST_SAMPLES) <= 1:
        return dive
    imu = dive.imu_in_span
    size = max(1, round(len(imu.time_ns) / MOST_SAMPLES))
    blocks_ns = imu.time_ns[: len(imu.time_ns) // size * size].reshape(-1, size)
    stretched_s = seconds(blocks_ns[:, -1], blocks_ns[:, 0])
    is_whole = stretched_s <= MOST_STRETCHED * (size - 1) * imu.usual_step_s
    fewer = replace(dive.dive, imu=imu.averaged(size).rows(is_whole))
    return replace(dive, dive=fewer, config=msgspec.structs.replace(dive.config, span=Span()))


def _within(dive: ReadDive, from_s: float, to_s: float) -> ReadDive:
    span = msgspec.structs.replace(dive.config.span, start_s=from_s, end_s=to_s)
    return dive.with_config(msgspec.structs.replace(dive.config, span=span))
