"""What perfect sensors feel along a scenario: the equations of navigation, turned round.

Nothing is differentiated numerically. Velocity, acceleration and rates are formulae in time; only the position is
integrated.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicHermiteSpline

from insdvl_replay.columns import Floats
from insdvl_replay.earth import EARTH_RATE, meridian_radius_m, normal_gravity, transverse_radius_m
from insdvl_replay.rotation import mat_from_rpy
from insdvl_replay.sim.trajectories import Scenario
from insdvl_replay.states import DEG

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


class Course:
    """A scenario put on the Earth.

    Parameters
    ----------
    scenario : Scenario
    end_s : float
        How far the course is needed, seconds from the start.
    """

    def __init__(self, scenario: Scenario, end_s: float) -> None:
        self._scenario = scenario
        knots_s = np.linspace(0.0, end_s, int(np.ceil(end_s / STEP_S)) + 1)
        self._position = _position_spline(knots_s, self._velocity_n(knots_s))

    def _velocity_n(self, time_s: Floats) -> Floats:
        return _turned(mat_from_rpy(self._scenario.rpy(time_s)), self._scenario.velocity_b(time_s))

    def at(self, time_s: Floats) -> Motion:
        """Give the motion at any times up to the course's end.

        Implements ``f_b = C'(v' - g + (2 w_ie + w_en) x v)`` and ``w_b = w_nb + C'(w_ie + w_en)`` with
        ``v' = C (w_nb x v_b + v_b')``; see EQUATIONS.md.

        Parameters
        ----------
        time_s : ndarray, shape (k,)

        Returns
        -------
        Motion
        """
        rpy, velocity_b = self._scenario.rpy(time_s), self._scenario.velocity_b(time_s)
        mat_nb = mat_from_rpy(rpy)
        mat_bn = np.swapaxes(mat_nb, -1, -2)
        position: Floats = self._position(time_s)
        velocity_n = _turned(mat_nb, velocity_b)
        rate_ie_b = _turned(mat_bn, _earth_rate_n(position))
        rate_en_b = _turned(mat_bn, _transport_rate_n(position, velocity_n))
        rate_nb_b = _body_rate(rpy, self._scenario.rpy_rate(time_s))
        acceleration_b = np.cross(rate_nb_b, velocity_b) + self._scenario.velocity_rate_b(time_s)
        gravity_b = mat_nb[:, 2, :] * normal_gravity(position[:, 0], position[:, 2])[:, None]
        coriolis_b = np.cross(2.0 * rate_ie_b + rate_en_b, velocity_b)
        return Motion(
            position=position,
            velocity_n=velocity_n,
            mat_nb=mat_nb,
            specific_force_b=acceleration_b - gravity_b + coriolis_b,
            angular_rate_b=rate_nb_b + rate_ie_b + rate_en_b,
            turn_rate_b=rate_nb_b + rate_en_b,
        )


def _turned(mat: Floats, vector: Floats) -> Floats:
    """Take each vector into another frame by its matrix: (k, 3, 3) and (k, 3) to (k, 3)."""
    turned: Floats = np.einsum("kij,kj->ki", mat, vector)
    return turned


def _position_spline(knots_s: Floats, velocity_n: Floats) -> CubicHermiteSpline:
    """Integrate the position.

    The rates of latitude and longitude depend on the position only through the radii of curvature, so that each
    repetition leaves the square of the error: after two of a day's dive it is far below a micrometre.
    """
    position = np.tile(START, (len(knots_s), 1))
    for _ in range(3):
        rate = _position_rate(position, velocity_n)
        position = START + cumulative_simpson(rate, x=knots_s, axis=0, initial=0.0)
    return CubicHermiteSpline(knots_s, position, _position_rate(position, velocity_n))


def _position_rate(position: Floats, velocity_n: Floats) -> Floats:
    latitude, height_m = position[:, 0], position[:, 2]
    north_mps, east_mps, down_mps = velocity_n.T
    latitude_rate = north_mps / (meridian_radius_m(latitude) + height_m)
    longitude_rate = east_mps / ((transverse_radius_m(latitude) + height_m) * np.cos(latitude))
    return np.stack([latitude_rate, longitude_rate, -down_mps], axis=-1)


def _earth_rate_n(position: Floats) -> Floats:
    latitude = position[:, 0]
    return EARTH_RATE * np.stack([np.cos(latitude), np.zeros_like(latitude), -np.sin(latitude)], axis=-1)


def _transport_rate_n(position: Floats, velocity_n: Floats) -> Floats:
    """Turn rate of north-east-down against the Earth as the vehicle moves on."""
    latitude, height_m = position[:, 0], position[:, 2]
    north = velocity_n[:, 1] / (transverse_radius_m(latitude) + height_m)
    east = -velocity_n[:, 0] / (meridian_radius_m(latitude) + height_m)
    return np.stack([north, east, -north * np.tan(latitude)], axis=-1)


def _body_rate(rpy: Floats, rpy_rate: Floats) -> Floats:
    """Turn the rates of roll, pitch and heading into the rate of b against n, in b."""
    roll, pitch = rpy[:, 0], rpy[:, 1]
    roll_rate, pitch_rate, heading_rate = rpy_rate.T
    about_y = np.cos(pitch) * heading_rate
    return np.stack(
        [
            roll_rate - np.sin(pitch) * heading_rate,
            np.cos(roll) * pitch_rate + np.sin(roll) * about_y,
            np.cos(roll) * about_y - np.sin(roll) * pitch_rate,
        ],
        axis=-1,
    )
