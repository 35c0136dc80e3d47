"""From the configuration of a filter to its measurements and its noise."""

from typing import Literal, NamedTuple

import msgspec
import numpy as np

from insdvl_replay.core.columns import Floats, TimeNs
from insdvl_replay.core.config import Config, Filter, Noise
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.error_model import noise_density
from insdvl_replay.nav.gaps import NO_GAPS, Gaps
from insdvl_replay.nav.levelling import SensorNoise
from insdvl_replay.nav.measurements import (
    PUBLISHED,
    WINDOWED,
    Measurement,
    acceleration_measurement,
    velocity_cov,
    velocity_measurement,
)
from insdvl_replay.preparation.long_gaps import swing_cov


class DvlNoise(NamedTuple):
    """The DVL's noise as one filter takes it.

    Attributes
    ----------
    key : {'beam_sd_mps', 'velocity_sd_mps'}
        Whether it is that of one beam, or of each axis of a velocity from all beams.
    sd_mps : float
    """

    key: Literal["beam_sd_mps", "velocity_sd_mps"]
    sd_mps: float


def dvl_noise(filter_: Filter, config: Config, *, from_beams: bool) -> DvlNoise:
    """Resolve the DVL's noise for a filter: what the filter names itself, under either key, goes before ``[dvl]``.

    Where one of the two names both, the beams' goes first. Velocities that do not come from beams have no noise of
    beams, so that there ``beam_sd_mps`` says nothing.

    Parameters
    ----------
    filter_ : Filter
    config : Config
    from_beams : bool
        Whether the velocities are solved from beams.

    Returns
    -------
    DvlNoise
    """
    for named in (filter_, config.dvl):
        if from_beams and named.beam_sd_mps is not None:
            return DvlNoise("beam_sd_mps", named.beam_sd_mps)
        if named.velocity_sd_mps is not None:
            return DvlNoise("velocity_sd_mps", named.velocity_sd_mps)
    raise ValueError("[dvl] always has a velocity_sd_mps")


def inertial_noise(filter_: Filter, config: Config) -> Noise:
    """Resolve the inertial sensors' noise for a filter: its own densities, and the common ones where it names none.

    Parameters
    ----------
    filter_ : Filter
    config : Config

    Returns
    -------
    Noise
    """
    own = {key: getattr(filter_, key) for key in Noise.__struct_fields__}
    return msgspec.structs.replace(config.noise, **{key: value for key, value in own.items() if value is not None})


def filter_noise(filter_: Filter, config: Config) -> Floats:
    """Give a filter's process noise.

    Parameters
    ----------
    filter_ : Filter
    config : Config

    Returns
    -------
    ndarray, shape (12,)
        See `error_model.noise_density`.
    """
    return noise_density(**msgspec.structs.asdict(inertial_noise(filter_, config)))


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
    noise = dvl_noise(filter_, config, from_beams=velocities.from_beams)
    return velocity_cov(velocities, noise.sd_mps, of_one_beam=noise.key == "beam_sd_mps")


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
    return SensorNoise(ping_cov(filter_, velocities, config), inertial_noise(filter_, config).accel_white_mps_rts)


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
            measurements.append(velocity_measurement(velocities, cov_b, gate, filter_.gate_reopen_after))
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
        accel_white_mps_rts=inertial_noise(filter_, config).accel_white_mps_rts,
        gate=gate,
    )
