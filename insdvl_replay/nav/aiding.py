"""From the configuration of a filter to its measurements and its noise."""

import numpy as np

from insdvl_replay.columns import Floats, TimeNs
from insdvl_replay.config import Config, Filter
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.error_model import noise_density
from insdvl_replay.nav.gaps import NO_GAPS, Gaps, swing_cov
from insdvl_replay.nav.levelling import SensorNoise
from insdvl_replay.nav.measurements import (
    PUBLISHED,
    WINDOWED,
    Measurement,
    acceleration_measurement,
    velocity_cov,
    velocity_measurement,
)


def filter_noise(filter_: Filter, config: Config) -> Floats:
    """Give a filter's process noise: its own densities, and the common ones where it names none.

    Parameters
    ----------
    filter_ : Filter
    config : Config

    Returns
    -------
    ndarray, shape (12,)
        See `error_model.noise_density`.
    """
    return noise_density(**{key: _own_or(filter_, config.noise, key) for key in config.noise.__struct_fields__})


def ping_cov(filter_: Filter, velocities: DvlVelocities, config: Config) -> Floats:
    """Give the covariance of each ping's velocity as a filter is told it.

    Parameters
    ----------
    filter_ : Filter
    velocities : DvlVelocities
        m pings.
    config : Config

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    return velocity_cov(
        velocities,
        _own_or(filter_, config.dvl, "velocity_sd_mps"),
        filter_.beam_sd_mps or config.dvl.beam_sd_mps,
    )


def sensor_noise(filter_: Filter, velocities: DvlVelocities, config: Config) -> SensorNoise:
    """Give the noise with which the level is found.

    Parameters
    ----------
    filter_ : Filter
    velocities : DvlVelocities
    config : Config

    Returns
    -------
    SensorNoise
    """
    white_mps_rts = _own_or(filter_, config.noise, "accel_white_mps_rts")
    return SensorNoise(ping_cov(filter_, velocities, config), white_mps_rts)


def filter_measurements(
    filter_: Filter, velocities: DvlVelocities, config: Config, gate: float, gaps: Gaps = NO_GAPS
) -> tuple[Measurement, ...]:
    """Prepare what a filter is aided by, in its order.

    Parameters
    ----------
    filter_ : Filter
    velocities : DvlVelocities
        m pings.
    config : Config
    gate : float
        Largest NIS that is used.
    gaps : Gaps
        The IMU's long gaps. In one the lever arm swings unseen, and no window of accelerations spans any part of one.

    Returns
    -------
    tuple of Measurement
    """
    cov_b = ping_cov(filter_, velocities, config)
    cov_b = cov_b + swing_cov(gaps, velocities.time_ns, np.array(config.dvl.lever_arm_m), config.imu)
    measurements = []
    for aiding in filter_.aiding:
        if aiding == "velocity":
            measurements.append(velocity_measurement(velocities, cov_b, gate))
        else:
            measurement = _acceleration(filter_, velocities, cov_b, config, gate)
            measurements.append(_seen(measurement, velocities.time_ns, gaps))
    return tuple(measurements)


def _seen(measurement: Measurement, time_ns: TimeNs, gaps: Gaps) -> Measurement:
    """Withhold an acceleration wherever its window, or the reading at its ping, lies in a gap."""
    window = measurement.velocity_weights.shape[1]
    first = np.maximum(np.arange(len(time_ns)) - window + 1, 0)
    return measurement._replace(available=measurement.available & ~gaps.overlap(time_ns[first], time_ns))


def _acceleration(
    filter_: Filter, velocities: DvlVelocities, cov_b: Floats, config: Config, gate: float
) -> Measurement:
    settings = filter_.acceleration
    if settings is None:
        raise ValueError("a filter aided by acceleration says how")
    return acceleration_measurement(
        velocities,
        cov_b,
        kind=WINDOWED if settings.model == "windowed" else PUBLISHED,
        window=settings.window,
        order=settings.order,
        max_gap_s=settings.max_window_gap_s,
        sd_mps2=settings.sd_mps2,
        accel_white_mps_rts=_own_or(filter_, config.noise, "accel_white_mps_rts"),
        gate=gate,
    )


def _own_or(filter_: Filter, common: object, key: str) -> float:
    own = getattr(filter_, key)
    return float(getattr(common, key) if own is None else own)
