"""Motion of the vehicle as smooth functions of time with exact derivatives, and readings of perfect sensors.

Times are seconds from the start of the dive. After the last segment a vehicle continues straight ahead. Velocity,
acceleration and rates are formulae in time; only the position is integrated. Results are equal to the last bit on
every processor: only sums, products, quotients, roots and sines of this module are used. There are no matrix products,
because their order of summation varies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from scipy.integrate import cumulative_simpson

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import (
    earth_rate_of,
    gravity_of,
    meridian_radius_of,
    transverse_radius_of,
)
from insdvl_replay.geometry.rotation import mat_from_sines, turned

QUARTER_TURN: Final = (
    1.57079632673412561417,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)
"""Half of pi as a sum. The first two have 33 bits, so that their multiples up to 2^20 are exact.

Source: Cody and Waite, "Software Manual for the Elementary Functions", 1980; the parts are those of fdlibm.
"""
_SINE_ORDERS: Final = range(17, 1, -2)
_COSINE_ORDERS: Final = range(16, 0, -2)


def sine_and_cosine(angle: Floats) -> tuple[Floats, Floats]:
    """Return sine and cosine of angles within a million rad of zero, to one unit of the last bit of 1."""
    quarters = np.rint(angle / QUARTER_TURN[0])
    rest = angle
    for part in QUARTER_TURN:
        rest = rest - quarters * part
    square = rest * rest
    sine = rest * _series(square, _SINE_ORDERS)
    cosine = _series(square, _COSINE_ORDERS)
    odd = quarters % 2.0 == 1.0
    second_half = quarters % 4.0 >= 2.0
    sine_of_angle = np.where(odd, cosine, sine)
    cosine_of_angle = np.where(odd, -sine, cosine)
    return (
        np.where(second_half, -sine_of_angle, sine_of_angle),
        np.where(second_half, -cosine_of_angle, cosine_of_angle),
    )


def _series(square: Floats, orders: range) -> Floats:
    """Sum Taylor's series from its last term: ``1 - x^2/(n (n - 1)) (1 - x^2/((n + 2) (n + 1)) (...))``."""
    total = np.ones_like(square)
    for order in orders:
        total *= square
        total *= -1.0 / (order * (order - 1))
        total += 1.0
    return total


HEADING_DEG: Final = 30.0  # at the start of every scenario
RAMP_S: Final = 2.0  # time in which a turn rate grows from nothing to its full value


@dataclass(frozen=True)
class Wave:
    """A quantity that oscillates around its mean: ``mean + amplitude sin(2 pi t / period_s)``."""

    mean: float = 0.0  # in the unit of the quantity, as the amplitude
    amplitude: float = 0.0
    period_s: float = 60.0

    def value(self, time_s: Floats) -> Floats:
        """Return the quantity at times of shape (k,)."""
        sine, _ = sine_and_cosine(2.0 * np.pi * time_s / self.period_s)
        return self.mean + self.amplitude * sine

    def rate(self, time_s: Floats) -> Floats:
        """Return its derivative, per second."""
        frequency = 2.0 * np.pi / self.period_s
        _, cosine = sine_and_cosine(frequency * time_s)
        return self.amplitude * frequency * cosine


@dataclass(frozen=True)
class Segment:
    """A part of the track with at most one turn.

    The turn rate rises in `RAMP_S`, holds, and falls in `RAMP_S`. Both ramps are the polynomial 3u^2 - 2u^3, which
    gives the turn rate a continuous derivative.
    """

    duration_s: float  # above `RAMP_S` in a turn; the full rate is reached from twice `RAMP_S` on
    turn_deg: float = 0.0  # positive to starboard

    @property
    def peak_rate(self) -> float:
        """Turn rate between the ramps, rad/s."""
        return self.turn_deg * DEG / (self.duration_s - RAMP_S)

    def heading_change(self, time_s: Floats) -> Floats:
        """Return the change of heading, rad, at seconds from the segment's start."""
        fall_s = time_s - (self.duration_s - RAMP_S)
        area = _ramp_area(time_s / RAMP_S) - _ramp_area(fall_s / RAMP_S)
        change: Floats = self.peak_rate * RAMP_S * area
        return change

    def heading_rate(self, time_s: Floats) -> Floats:
        """Return the turn rate, rad/s, at seconds from the segment's start."""
        fall_s = time_s - (self.duration_s - RAMP_S)
        rate: Floats = self.peak_rate * (_ramp(time_s / RAMP_S) - _ramp(fall_s / RAMP_S))
        return rate


def turn(turn_deg: float, peak_rate_degps: float) -> Segment:
    """Return the segment that turns by an angle at a given rate between its ramps."""
    return Segment(abs(turn_deg) / peak_rate_degps + RAMP_S, turn_deg)


def _ramp(u: Floats) -> Floats:
    """Climb smoothly from 0 at u = 0 to 1 at u = 1."""
    within = np.clip(u, 0.0, 1.0)
    climb: Floats = within * within * (3.0 - 2.0 * within)
    return climb


def _ramp_area(u: Floats) -> Floats:
    """Integrate `_ramp` from 0 to u."""
    within = np.clip(u, 0.0, 1.0)
    area: Floats = within * within * within * (1.0 - 0.5 * within) + np.maximum(u - 1.0, 0.0)
    return area


@dataclass(frozen=True)
class Scenario:
    """Speed, attitude and track of a simulated dive."""

    about: str  # in one line
    duration_s: float  # unless the dive is asked to be shorter or longer
    speed_mps: Wave  # forward
    segments: tuple[Segment, ...] = ()  # legs and turns in their order
    roll_deg: Wave = Wave()
    pitch_deg: Wave = Wave()
    sway_mps: Wave = Wave()  # to starboard
    heave_mps: Wave = Wave()  # down

    def _turns(self, time_s: Floats) -> list[tuple[Segment, Floats]]:
        """Pair each turn with the seconds since it began."""
        ends_s = np.cumsum([segment.duration_s for segment in self.segments])
        turns = []
        for segment, end_s in zip(self.segments, ends_s, strict=True):
            if segment.turn_deg:
                turns.append((segment, time_s - (end_s - segment.duration_s)))
        return turns

    def rpy(self, time_s: Floats) -> Floats:
        """Return roll, pitch and heading, rad, shape (k, 3); the heading is not wrapped."""
        heading = np.full_like(time_s, HEADING_DEG * DEG)
        for segment, since_s in self._turns(time_s):
            heading += segment.heading_change(since_s)
        return np.stack(
            [self.roll_deg.value(time_s) * DEG, self.pitch_deg.value(time_s) * DEG, heading],
            axis=-1,
        )

    def rpy_rate(self, time_s: Floats) -> Floats:
        """Return the derivatives of roll, pitch and heading, rad/s, shape (k, 3)."""
        heading_rate = np.zeros_like(time_s)
        for segment, since_s in self._turns(time_s):
            heading_rate += segment.heading_rate(since_s)
        return np.stack(
            [self.roll_deg.rate(time_s) * DEG, self.pitch_deg.rate(time_s) * DEG, heading_rate],
            axis=-1,
        )

    def velocity_b(self, time_s: Floats) -> Floats:
        """Return the velocity over ground in b, m/s, shape (k, 3)."""
        return np.stack([wave.value(time_s) for wave in self._speeds_mps], axis=-1)

    def velocity_rate_b(self, time_s: Floats) -> Floats:
        """Return the derivative of the components of `velocity_b`, m/s^2, shape (k, 3)."""
        return np.stack([wave.rate(time_s) for wave in self._speeds_mps], axis=-1)

    @property
    def _speeds_mps(self) -> tuple[Wave, Wave, Wave]:
        return self.speed_mps, self.sway_mps, self.heave_mps


def _figure_eight() -> tuple[Segment, ...]:
    """Make an eight of straight lines: two triangles with a common corner, where the track crosses itself.

    Four turns by 138.9 deg, two to each side, are 555 deg in 394 s: 1.41 deg/s in the mean.
    """
    right = turn(138.9, 17.0)
    left = turn(-138.9, 17.0)
    base = Segment(35.0)
    diagonal = Segment(46.0)
    return (Segment(100.0), right, base, right, diagonal, left, base, left)


def _lawnmower() -> tuple[Segment, ...]:
    """Make legs of 300 s with U-turns between them, to either side in turn, each sharper than the last."""
    leg = Segment(300.0)
    return (
        leg,
        turn(180.0, 6.0),
        leg,
        turn(-180.0, 9.0),
        leg,
        turn(180.0, 12.0),
        leg,
        turn(-180.0, 15.0),
    )


def _calibration() -> tuple[Segment, ...]:
    """Make turns to both sides, with legs between them to gain speed."""
    segments: list[Segment] = []
    for angle_deg in (90.0, -120.0, 150.0, -90.0, 180.0, -150.0, 120.0, -180.0) * 2:
        segments += [Segment(20.0), turn(angle_deg, 12.0)]
    return tuple(segments)


SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        "straight": Scenario("level at constant speed and heading", 424.0, Wave(2.0)),
        "figure-eight": Scenario(
            "a long leg, then an eight with sharp turns",
            394.0,
            Wave(0.9, 0.05, 39.4),
            _figure_eight(),
            roll_deg=Wave(0.0, 1.0, 17.0),
            pitch_deg=Wave(0.0, 1.0, 31.0),
        ),
        "lawnmower": Scenario(
            "slow legs of 300 s with U-turns", 1500.0, Wave(0.6 / 3.6), _lawnmower()
        ),
        "static": Scenario("at rest", 300.0, Wave(0.0)),
        "calibration": Scenario(
            "every manoeuvre for calibration: turns, changes of speed, sway, heave, roll and pitch",
            400.0,
            Wave(1.2, 0.9, 31.0),
            _calibration(),
            roll_deg=Wave(0.0, 8.0, 13.0),
            pitch_deg=Wave(0.0, 8.0, 23.0),
            sway_mps=Wave(0.0, 0.3, 29.0),
            heave_mps=Wave(0.0, 0.2, 19.0),
        ),
    }
)
"""Every scenario by its name on the command line. The first three have the paper's durations, speeds and turn rates."""


START: Final = (32.8 * DEG, 34.9 * DEG, -20.0)
"""Where every dive starts: latitude and longitude off Haifa, height at 20 m depth."""
STEP_S: Final = 0.05
"""Step of the position's integration: Simpson's error stays below 1e-6 m through the sharpest turn."""


@dataclass(frozen=True)
class Motion:
    """The exact motion at k times."""

    position: Floats  # (k, 3), latitude rad, longitude rad, height m
    velocity_n: Floats  # (k, 3), over ground, m/s
    mat_nb: Floats  # (k, 3, 3)
    specific_force_b: Floats  # (k, 3), m/s^2
    angular_rate_b: Floats  # (k, 3), against inertial space, rad/s
    turn_rate_b: Floats  # (k, 3), against the Earth, rad/s


class Trajectory:
    """A scenario on the Earth, up to ``end_s`` seconds from the start."""

    def __init__(self, scenario: Scenario, end_s: float) -> None:
        # Position and its rate at knots. The rates of latitude and longitude depend on the position only through the
        # radii of curvature, so that each repetition leaves the square of the error: after two for a day's dive it is
        # far below a micrometre.
        self._scenario = scenario
        self._knots_s = np.linspace(0.0, end_s, int(np.ceil(end_s / STEP_S)) + 1)
        mat_nb = mat_from_sines(*sine_and_cosine(scenario.rpy(self._knots_s)))
        velocity_n = turned(mat_nb, scenario.velocity_b(self._knots_s))
        self._position = np.tile(START, (len(self._knots_s), 1))
        for _ in range(3):
            rate = _position_rate(self._position, velocity_n)
            self._position = START + cumulative_simpson(rate, x=self._knots_s, axis=0, initial=0.0)
        self._rate = _position_rate(self._position, velocity_n)

    def at(self, time_s: Floats) -> Motion:
        """Return the motion at any times up to the trajectory's end.

        Implements ``f_b = C'(v' - g + (2 w_ie + w_en) x v)`` and ``w_b = w_nb + C'(w_ie + w_en)`` with
        ``v' = C (w_nb x v_b + v_b')``; see docs/equations/mechanisation.md.
        """
        # Hermite's cubic between the knots.
        before = np.searchsorted(self._knots_s, time_s, side="right") - 1
        left = np.clip(before, 0, len(self._knots_s) - 2)
        right = left + 1
        step_s = (self._knots_s[right] - self._knots_s[left])[:, None]
        done = (time_s - self._knots_s[left])[:, None] / step_s
        ahead = 1.0 - done
        chord = self._position[right] - self._position[left]
        bend = done * ahead * step_s * (ahead * self._rate[left] - done * self._rate[right])
        position: Floats = self._position[left] + done * done * (3.0 - 2.0 * done) * chord + bend

        sine, cosine = sine_and_cosine(self._scenario.rpy(time_s))
        velocity_b = self._scenario.velocity_b(time_s)
        mat_nb = mat_from_sines(sine, cosine)
        mat_bn = np.swapaxes(mat_nb, -1, -2)
        velocity_n = turned(mat_nb, velocity_b)

        # The rates of the Earth, of n, and of b against n.
        sine_lat, cosine_lat = sine_and_cosine(position[:, 0])
        sin2 = sine_lat * sine_lat
        height_m = position[:, 2]
        rate_ie_n = np.stack(np.broadcast_arrays(*earth_rate_of(sine_lat, cosine_lat)), axis=-1)
        north = velocity_n[:, 1] / (transverse_radius_of(sin2) + height_m)
        east = -velocity_n[:, 0] / (meridian_radius_of(sin2) + height_m)
        rate_en_n = np.stack([north, east, -north * sine_lat / cosine_lat], axis=-1)
        rate_ie_b = turned(mat_bn, rate_ie_n)
        rate_en_b = turned(mat_bn, rate_en_n)
        sr, sp, _ = sine.T
        cr, cp, _ = cosine.T
        roll_rate, pitch_rate, heading_rate = self._scenario.rpy_rate(time_s).T
        about_y = cp * heading_rate
        rates = [
            roll_rate - sp * heading_rate,
            cr * pitch_rate + sr * about_y,
            cr * about_y - sr * pitch_rate,
        ]
        rate_nb_b = np.stack(rates, axis=-1)

        acceleration_b = np.cross(rate_nb_b, velocity_b) + self._scenario.velocity_rate_b(time_s)
        gravity_b = mat_nb[:, 2, :] * gravity_of(sin2, height_m)[:, None]
        coriolis_b = np.cross(2.0 * rate_ie_b + rate_en_b, velocity_b)
        return Motion(
            position=position,
            velocity_n=velocity_n,
            mat_nb=mat_nb,
            specific_force_b=acceleration_b - gravity_b + coriolis_b,
            angular_rate_b=rate_nb_b + rate_ie_b + rate_en_b,
            turn_rate_b=rate_nb_b + rate_en_b,
        )


def _position_rate(position: Floats, velocity_n: Floats) -> Floats:
    """Return the rates of latitude, longitude and height."""
    sine, cosine = sine_and_cosine(position[:, 0])
    sin2 = sine * sine
    height_m = position[:, 2]
    north_mps, east_mps, down_mps = velocity_n.T
    latitude_rate = north_mps / (meridian_radius_of(sin2) + height_m)
    longitude_rate = east_mps / ((transverse_radius_of(sin2) + height_m) * cosine)
    return np.stack([latitude_rate, longitude_rate, -down_mps], axis=-1)
