"""What perfect sensors feel along a scenario: the equations of navigation, turned round.

Nothing is differentiated numerically. Velocity, acceleration and rates are formulae in time; only the position is
integrated. All is computed by operations that every processor rounds alike, so that it is the same to the last bit:
sums, products, quotients and roots, sines from `trajectories`, and no matrix products, whose order of summation varies.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.integrate import cumulative_simpson

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import earth_rate_of, gravity_of, meridian_radius_of, transverse_radius_of
from insdvl_replay.geometry.rotation import mat_from_sines, turned
from insdvl_replay.sim.trajectories import Scenario, sine_and_cosine

START: Final = (32.8 * DEG, 34.9 * DEG, -20.0)
"""Where every dive starts: latitude and longitude off Haifa, height at 20 m depth."""
STEP_S: Final = 0.05
"""Step of the position's integration: Simpson's error stays below 1e-6 m through the sharpest turn."""


@dataclass(frozen=True)
class Motion:
    """The exact motion at k times.

    Attributes
    ----------
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (k, 3)
        Velocity over ground, m/s.
    mat_nb : ndarray, shape (k, 3, 3)
        Attitude.
    specific_force_b : ndarray, shape (k, 3)
        Specific force, m/s^2.
    angular_rate_b : ndarray, shape (k, 3)
        Angular rate against inertial space, rad/s.
    turn_rate_b : ndarray, shape (k, 3)
        Angular rate against the Earth, rad/s.
    """

    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    specific_force_b: Floats
    angular_rate_b: Floats
    turn_rate_b: Floats


class Trajectory:
    """A scenario put on the Earth.

    Parameters
    ----------
    end_s : float
        How far the trajectory is needed, seconds from the start.
    """

    def __init__(self, scenario: Scenario, end_s: float) -> None:
        self._scenario = scenario
        knots_s = np.linspace(0.0, end_s, int(np.ceil(end_s / STEP_S)) + 1)
        mat_nb = mat_from_sines(*sine_and_cosine(scenario.rpy(knots_s)))
        self._way = _Way.of_velocity(knots_s, turned(mat_nb, scenario.velocity_b(knots_s)))

    def at(self, time_s: Floats) -> Motion:
        """Return the motion at any times up to the trajectory's end.

        Implements ``f_b = C'(v' - g + (2 w_ie + w_en) x v)`` and ``w_b = w_nb + C'(w_ie + w_en)`` with
        ``v' = C (w_nb x v_b + v_b')``; see equations/mechanisation.md.

        Parameters
        ----------
        time_s : ndarray, shape (k,)
        """
        sine, cosine = sine_and_cosine(self._scenario.rpy(time_s))
        velocity_b = self._scenario.velocity_b(time_s)
        mat_nb = mat_from_sines(sine, cosine)
        mat_bn = np.swapaxes(mat_nb, -1, -2)
        position = self._way.position(time_s)
        velocity_n = turned(mat_nb, velocity_b)
        place = _Place(position)
        rate_ie_b = turned(mat_bn, place.earth_rate_n())
        rate_en_b = turned(mat_bn, place.transport_rate_n(velocity_n))
        rate_nb_b = _body_rate(sine, cosine, self._scenario.rpy_rate(time_s))
        acceleration_b = np.cross(rate_nb_b, velocity_b) + self._scenario.velocity_rate_b(time_s)
        gravity_b = mat_nb[:, 2, :] * place.gravity()[:, None]
        coriolis_b = np.cross(2.0 * rate_ie_b + rate_en_b, velocity_b)
        return Motion(
            position=position,
            velocity_n=velocity_n,
            mat_nb=mat_nb,
            specific_force_b=acceleration_b - gravity_b + coriolis_b,
            angular_rate_b=rate_nb_b + rate_ie_b + rate_en_b,
            turn_rate_b=rate_nb_b + rate_en_b,
        )


@dataclass(frozen=True)
class _Way:
    """Position and its rate at k knots, and between them Hermite's cubic."""

    knots_s: Floats
    knot_position: Floats
    knot_rate: Floats

    @classmethod
    def of_velocity(cls, knots_s: Floats, velocity_n: Floats) -> "_Way":
        """Integrate the position.

        The rates of latitude and longitude depend on the position only through the radii of curvature, so that each
        repetition leaves the square of the error: after two of a day's dive it is far below a micrometre.
        """
        position = np.tile(START, (len(knots_s), 1))
        for _ in range(3):
            rate = _Place(position).position_rate(velocity_n)
            position = START + cumulative_simpson(rate, x=knots_s, axis=0, initial=0.0)
        return cls(knots_s, position, _Place(position).position_rate(velocity_n))

    def position(self, time_s: Floats) -> Floats:
        """Return the position at times of shape (k,)."""
        left = np.clip(np.searchsorted(self.knots_s, time_s, side="right") - 1, 0, len(self.knots_s) - 2)
        right = left + 1
        step_s = (self.knots_s[right] - self.knots_s[left])[:, None]
        done = (time_s - self.knots_s[left])[:, None] / step_s
        ahead = 1.0 - done
        chord = self.knot_position[right] - self.knot_position[left]
        bend = done * ahead * step_s * (ahead * self.knot_rate[left] - done * self.knot_rate[right])
        between: Floats = self.knot_position[left] + done * done * (3.0 - 2.0 * done) * chord + bend
        return between


class _Place:
    """The Earth at k positions."""

    def __init__(self, position: Floats) -> None:
        self._sine, self._cosine = sine_and_cosine(position[:, 0])
        self._sin2, self._height_m = self._sine * self._sine, position[:, 2]

    def position_rate(self, velocity_n: Floats) -> Floats:
        """Return the rates of latitude, longitude and height."""
        north_mps, east_mps, down_mps = velocity_n.T
        latitude_rate = north_mps / (meridian_radius_of(self._sin2) + self._height_m)
        longitude_rate = east_mps / ((transverse_radius_of(self._sin2) + self._height_m) * self._cosine)
        return np.stack([latitude_rate, longitude_rate, -down_mps], axis=-1)

    def gravity(self) -> Floats:
        """Return the magnitude of gravity."""
        gravity: Floats = gravity_of(self._sin2, self._height_m)
        return gravity

    def earth_rate_n(self) -> Floats:
        """Return the rotation rate of the Earth."""
        return np.stack(np.broadcast_arrays(*earth_rate_of(self._sine, self._cosine)), axis=-1)

    def transport_rate_n(self, velocity_n: Floats) -> Floats:
        """Return the turn rate of north-east-down against the Earth as the vehicle moves on."""
        north = velocity_n[:, 1] / (transverse_radius_of(self._sin2) + self._height_m)
        east = -velocity_n[:, 0] / (meridian_radius_of(self._sin2) + self._height_m)
        return np.stack([north, east, -north * self._sine / self._cosine], axis=-1)


def _body_rate(sine: Floats, cosine: Floats, rpy_rate: Floats) -> Floats:
    """Turn the rates of roll, pitch and heading into the rate of b against n, in b."""
    (sr, sp, _), (cr, cp, _) = sine.T, cosine.T
    roll_rate, pitch_rate, heading_rate = rpy_rate.T
    about_y = cp * heading_rate
    return np.stack(
        [roll_rate - sp * heading_rate, cr * pitch_rate + sr * about_y, cr * about_y - sr * pitch_rate],
        axis=-1,
    )
