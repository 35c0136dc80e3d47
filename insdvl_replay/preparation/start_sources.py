"""What a start comes from, and the uncertainty that it takes from there (``initial.uncertainty = "source"``)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.core.words import HeadingSource
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.preparation.source_errors import HEADING_FLOOR, SourceSd, ahrs_sd, reference_sd

NEAR_PINGS: Final = 10  # around a ping, that show how fast the velocity changes
UNKNOWN: Final = np.full(3, np.nan)


class AttitudeSource(StrEnum):
    """Where roll and pitch at the start come from."""

    REFERENCE = "reference"
    AHRS = "ahrs"
    GRAVITY = "gravity"


class PositionSource(StrEnum):
    """Where the position at the start comes from."""

    REFERENCE = "reference"
    SENSOR = "sensor"
    SETTINGS = "settings"


ATTITUDE_WORDS: Final = {
    AttitudeSource.REFERENCE: "attitude of the reference",
    AttitudeSource.AHRS: "attitude of the AHRS",
    AttitudeSource.GRAVITY: "level by gravity",
}
HEADING_WORDS: Final = {
    HeadingSource.SENSOR: "of the sensor",
    HeadingSource.FIT: "fitted to positions",
    HeadingSource.SETTINGS: "of the settings",
}


@dataclass(frozen=True)
class StartSources:
    """What a start was taken from."""

    attitude: AttitudeSource
    heading: HeadingSource
    position: PositionSource
    is_velocity_of_reference: bool  # else it is the DVL's
    fitted_heading_sd: float | None = None  # rad, with `HeadingSource.FIT`


@dataclass(frozen=True)
class StartSd:
    """The uncertainty of a start by its sources."""

    states: Floats  # (12,) of the error states where each is known by itself, SI units
    position_m: tuple[float, float, float]  # north, east, down


def initial_sd(initial: Initial) -> Floats:
    """Return the standard deviations of the 12 error states by ``[initial]``, shape (12,), SI units."""
    sd = np.empty(12)
    sd[DV] = initial.velocity_sd_mps
    sd[PHI] = np.array(initial.misalignment_sd_deg) * DEG
    sd[BA] = initial.accel_bias_sd_mg * MG
    sd[BG] = initial.gyro_bias_sd_degph * DEG_PER_HOUR
    return sd


def source_sd(
    dive: Dive,
    config: Config,
    velocities: DvlVelocities,
    sources: StartSources,
    start_ns: int,
    latitude: float,
) -> StartSd:
    """Return how uncertain a start is by its sources, and by ``[initial]`` where nothing is known of them.

    The level by gravity and a velocity of the DVL have covariances of their own, see `nav.levelling.start_cov`.
    """
    by_settings = initial_sd(config.initial)
    reference = SourceSd(UNKNOWN, UNKNOWN, UNKNOWN)
    takes_reference = (
        sources.attitude == AttitudeSource.REFERENCE
        or sources.is_velocity_of_reference
        or sources.position == PositionSource.REFERENCE
    )
    if takes_reference:
        reference = reference_sd(dive, config, velocities, start_ns, latitude)

    attitude = UNKNOWN
    if sources.attitude == AttitudeSource.REFERENCE:
        attitude = reference.attitude
    elif sources.attitude == AttitudeSource.AHRS:
        attitude = ahrs_sd(dive, config, start_ns, latitude)
    heading = np.nan
    if sources.heading == HeadingSource.FIT and sources.fitted_heading_sd is not None:
        heading = max(sources.fitted_heading_sd, HEADING_FLOOR)
    elif sources.heading == HeadingSource.SENSOR and sources.attitude != AttitudeSource.AHRS:
        heading = config.heading.sd_deg * DEG
    elif sources.heading != HeadingSource.SETTINGS:
        heading = attitude[2]
    states = by_settings.copy()
    states[PHI] = _or([*attitude[:2], heading], by_settings[PHI])
    if sources.is_velocity_of_reference:
        states[DV] = _or(reference.velocity, by_settings[DV])

    position_m = UNKNOWN
    if sources.position == PositionSource.REFERENCE:
        position_m = reference.position
    elif sources.position == PositionSource.SENSOR:
        height_sd_m = config.position.height_sd_m
        position_m = np.array([config.position.sd_m, config.position.sd_m, height_sd_m or np.nan])
    north_m, east_m, down_m = _or(position_m, config.initial.position_sd_m).tolist()
    return StartSd(states, (north_m, east_m, down_m))


def _or(known: Sequence[float] | Floats, otherwise: Sequence[float] | Floats) -> Floats:
    """Return numbers, and others where these are NaN."""
    found = np.array(known, np.float64)
    return np.where(np.isnan(found), np.array(otherwise, np.float64), found)


def velocity_change_cov(velocities: DvlVelocities, ping: int, start_ns: int) -> Floats:
    """Return by how much the velocity may have changed from the start to a ping, (3, 3), m^2/s^2.

    It is the mean square of the accelerations between the pings around, their noise included, times the time.
    """
    around = slice(max(0, ping - NEAR_PINGS), ping + NEAR_PINGS + 1)
    step_s = np.diff(velocities.time_ns[around]) / NS_PER_S
    if not step_s.size:
        return np.zeros((3, 3))
    rates = np.diff(velocities.velocity_b[around], axis=0) / step_s[:, None]
    away_s = (int(velocities.time_ns[ping]) - start_ns) / NS_PER_S
    return np.diag(np.mean(rates**2, axis=0)) * away_s**2


def source_note(sources: StartSources, cov: Floats) -> Note:
    """Say what the start comes from and how uncertain it is."""
    sd = np.sqrt(np.diagonal(cov))
    attitude = ATTITUDE_WORDS[sources.attitude]
    if sources.attitude == AttitudeSource.GRAVITY or sources.heading == HeadingSource.SETTINGS:
        attitude = f"{attitude}, heading {HEADING_WORDS[sources.heading]}"
    return note(
        "start_source",
        attitude=attitude,
        level=float(np.max(sd[PHI][:2])) / DEG,
        heading=float(sd[PHI][2]) / DEG,
        velocity="the reference" if sources.is_velocity_of_reference else "the DVL",
        velocity_sd=float(np.max(sd[DV])),
    )
