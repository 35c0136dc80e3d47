"""Worlds like those at sea, in which nothing errs as the filters are told: how the vehicles move and what sensors do.

No dive is like another: courses, speeds and waves are drawn anew, as splines and sums of waves, not as the segments of
`sim/trajectories.py`. Inertial sensors have turn-on biases, Gauss-Markov biases, scale errors and misalignments, DVLs
have errors that stay for some seconds and lose the bottom, and the reference is noisy. Filters are told presets.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
)
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.sim.dive import exact_dive
from insdvl_replay.sim.sensor_errors import GRADES
from insdvl_replay.sim.trajectories import HEADING_DEG, Scenario, Wave

MARGIN_S: Final = 60.0
"""Splines go on beyond the dive, where their ends are not smooth."""
PPM: Final = 1e-6
MRAD: Final = 1e-3


@dataclass(frozen=True)
class Voyage:
    """How a kind of vehicle moves; each dive draws its own motion."""

    speed_mps: float
    speed_sd_mps: float
    leg_s: float
    """Mean time between two changes of course."""
    turn_sd_deg: float
    wave_deg: float = 1.0
    """Standard deviation of roll and pitch."""
    wave_mps: float = 0.05
    """Standard deviation of sway and heave."""
    wave_period_s: float = 8.0


@dataclass(frozen=True, kw_only=True)
class DrawnMotion(Scenario):
    """One drawn motion: splines through courses and speeds, and waves."""

    course: CubicSpline
    speed: CubicSpline
    frequency: Floats
    """Of ten waves in roll, pitch, heading, surge, sway and heave, shape (10, 6), rad/s."""
    phase: Floats
    size: Floats

    def rpy(self, time_s: Floats) -> Floats:
        """Return roll, pitch and heading, rad, shape (k, 3)."""
        angles = self._waves(time_s, slice(0, 3))
        angles[:, 2] += self.course(time_s)
        return angles

    def rpy_rate(self, time_s: Floats) -> Floats:
        """Return their derivatives."""
        rates = self._wave_rates(time_s, slice(0, 3))
        rates[:, 2] += self.course(time_s, 1)
        return rates

    def velocity_b(self, time_s: Floats) -> Floats:
        """Return the velocity over ground in b, m/s, shape (k, 3)."""
        return np.asarray(self.speed(time_s) + self._waves(time_s, slice(3, 6)))

    def velocity_rate_b(self, time_s: Floats) -> Floats:
        """Return the derivative of its components."""
        return np.asarray(self.speed(time_s, 1) + self._wave_rates(time_s, slice(3, 6)))

    def _waves(self, time_s: Floats, of: slice) -> Floats:
        total = np.zeros((len(time_s), 3))
        for frequency, phase, size in zip(
            self.frequency[:, of], self.phase[:, of], self.size[:, of], strict=True
        ):
            total += size * np.sin(np.outer(time_s, frequency) + phase)
        return total

    def _wave_rates(self, time_s: Floats, of: slice) -> Floats:
        total = np.zeros((len(time_s), 3))
        for frequency, phase, size in zip(
            self.frequency[:, of], self.phase[:, of], self.size[:, of], strict=True
        ):
            total += size * frequency * np.cos(np.outer(time_s, frequency) + phase)
        return total


def drawn_motion(voyage: Voyage, duration_s: float, rng: np.random.Generator) -> DrawnMotion:
    """Draw one motion."""
    waves = 10
    end_s = duration_s + MARGIN_S
    legs_s = rng.uniform(0.4, 1.6, int(end_s / (0.4 * voyage.leg_s)) + 4) * voyage.leg_s
    knots_s = np.cumsum(np.append(-voyage.leg_s, legs_s))
    knots_s = knots_s[: np.searchsorted(knots_s, end_s) + 3]
    heading = HEADING_DEG * DEG + np.cumsum(
        voyage.turn_sd_deg * DEG * rng.standard_normal(len(knots_s))
    )
    # Two knots on each course: a leg is nearly straight, and a turn takes a third of the time.
    twice_s = np.ravel(np.column_stack([knots_s[:-1], knots_s[:-1] + np.diff(knots_s) * 0.65]))
    speed_mps = voyage.speed_mps + voyage.speed_sd_mps * rng.standard_normal((len(knots_s), 1))
    drift_mps = 0.3 * voyage.speed_sd_mps * rng.standard_normal((len(knots_s), 2))
    tilt = np.array([1.0, 1.0, 0.5]) * voyage.wave_deg * DEG
    sway_mps = np.array([0.3, 1.0, 1.0]) * voyage.wave_mps
    return DrawnMotion(
        "drawn",
        duration_s,
        Wave(voyage.speed_mps),
        course=CubicSpline(twice_s, np.repeat(heading[:-1], 2)),
        speed=CubicSpline(knots_s, np.column_stack([speed_mps, drift_mps])),
        frequency=2.0 * np.pi / voyage.wave_period_s * rng.uniform(0.5, 1.6, (waves, 6)),
        phase=rng.uniform(0.0, 2.0 * np.pi, (waves, 6)),
        size=np.sqrt(2.0 / waves)
        * np.concatenate([tilt, sway_mps])
        * rng.uniform(0.5, 1.5, (waves, 6)),
    )


@dataclass(frozen=True)
class SeaDvl:
    """Errors of a DVL: white and correlated noise, bias and scale of each beam, and lost bottom lock."""

    white_mps: float = 0.006
    correlated_mps: float = 0.004
    correlated_s: float = 10.0
    bias_mps: float = 0.002
    scale: float = 0.002
    lost_spans: int = 0
    lost_s: tuple[float, float] = (4.0, 15.0)
    """Shortest and longest span in which a beam, or in half of the cases every beam, finds no bottom."""


@dataclass(frozen=True)
class SeaReference:
    """White noise of the reference; a third as much again stays for a minute."""

    position_m: float = 0.02
    velocity_mps: float = 0.005
    attitude_deg: float = 0.02
    rate_hz: float = 2.0


@dataclass(frozen=True)
class Sea:
    """All that is drawn for one dive of a world."""

    voyage: Voyage
    grade: str
    duration_s: float
    dvl: SeaDvl = SeaDvl()
    reference: SeaReference = SeaReference()
    imu_rate_hz: float = 50.0
    outage_s: tuple[float, float] | None = None

    def drawn_motion(self, rng: np.random.Generator) -> Scenario:
        """Draw the motion of one dive."""
        return drawn_motion(self.voyage, self.duration_s, rng)

    def dive(self, seed: int) -> tuple[Dive, Dive]:
        """Simulate one dive: as its sensors report it, and exactly. Nobody knows the true biases."""
        motion, imu, dvl, reference = (
            np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(4)
        )
        exact = exact_dive(
            self.drawn_motion(motion),
            imu_rate_hz=self.imu_rate_hz,
            reference_rate_hz=self.reference.rate_hz,
            outages=[self.outage_s] if self.outage_s else [],
        )
        if exact.reference is None:
            raise ValueError("a simulated dive has a reference")
        reported = replace(
            exact,
            imu=_imu_at_sea(exact.imu, GRADE_ERRORS[self.grade], imu),
            dvl=_dvl_at_sea(exact.dvl, self.dvl, dvl),
            reference=_reference_at_sea(exact.reference, self.reference, reference),
            truth=None,
        )
        return reported, replace(exact, truth=None)


@dataclass(frozen=True)
class SeaImu:
    """Errors of an IMU, each standard deviation of three like accelerometers and three like gyros."""

    grade: str
    gauss_markov_accel_mps2: float
    gauss_markov_gyro_radps: float
    scale: float
    misalignment_rad: float
    gauss_markov_s: float = 200.0

    @cached_property
    def white(self) -> tuple[float, float]:
        """White noise densities, accelerometers and gyros."""
        return GRADES[self.grade].accel_white_mps_rts, GRADES[self.grade].gyro_white_rad_rts

    @cached_property
    def turn_on(self) -> tuple[float, float]:
        """Biases at the start."""
        return GRADES[self.grade].accel_bias_sd_mps2, GRADES[self.grade].gyro_bias_sd_radps


GRADE_ERRORS: Final = {
    "fog": SeaImu("fog", 0.01 * MG, 0.003 * DEG_PER_HOUR, 100.0 * PPM, 0.1 * MRAD),
    "tactical": SeaImu("tactical", 0.2 * MG, 0.5 * DEG_PER_HOUR, 500.0 * PPM, 0.5 * MRAD),
    "mems": SeaImu("mems", 0.5 * MG, 5.0 * DEG_PER_HOUR, 1500.0 * PPM, 1.0 * MRAD),
}


def _gauss_markov(
    time_ns: TimeNs, columns: int, sd: float, time_constant_s: float, rng: np.random.Generator
) -> Floats:
    """Draw a stationary first-order Gauss-Markov process at evenly spaced times, shape (k, columns)."""
    step_s = float(time_ns[-1] - time_ns[0]) / NS_PER_S / (len(time_ns) - 1)
    kept = float(np.exp(-step_s / time_constant_s))
    driven = sd * np.sqrt(1.0 - kept**2) * rng.standard_normal((len(time_ns), columns))
    driven[0] = sd * rng.standard_normal(columns)
    return np.asarray(lfilter([1.0], [1.0, -kept], driven, axis=0))


def _imu_at_sea(exact: ImuColumns, errors: SeaImu, rng: np.random.Generator) -> ImuColumns:
    root_rate = np.sqrt(
        (len(exact.time_ns) - 1) * NS_PER_S / float(exact.time_ns[-1] - exact.time_ns[0])
    )
    readings = []
    slow = errors.gauss_markov_accel_mps2, errors.gauss_markov_gyro_radps
    columns = exact.specific_force_b, exact.angular_rate_b
    for reading, white, turn_on, wander in zip(
        columns, errors.white, errors.turn_on, slow, strict=True
    ):
        matrix = np.eye(3) + errors.misalignment_rad * rng.standard_normal((3, 3))
        np.fill_diagonal(matrix, 1.0 + errors.scale * rng.standard_normal(3))
        noise = white * root_rate * rng.standard_normal(
            reading.shape
        ) + turn_on * rng.standard_normal(3)
        readings.append(
            reading @ matrix.T
            + noise
            + _gauss_markov(exact.time_ns, 3, wander, errors.gauss_markov_s, rng)
        )
    return ImuColumns(exact.time_ns, *readings)


def _dvl_at_sea(exact: DvlColumns, errors: SeaDvl, rng: np.random.Generator) -> DvlColumns:
    if exact.beam_velocity_mps is None:
        raise ValueError("a simulated DVL has beams")
    pings, beams = exact.beam_velocity_mps.shape
    noise = errors.white_mps * rng.standard_normal(
        (pings, beams)
    ) + errors.bias_mps * rng.standard_normal(beams)
    noise += _gauss_markov(exact.time_ns, beams, errors.correlated_mps, errors.correlated_s, rng)
    velocity_mps = (
        exact.beam_velocity_mps * (1.0 + errors.scale * rng.standard_normal(beams)) + noise
    )
    time_s = (exact.time_ns - exact.time_ns[0]) / NS_PER_S
    for _ in range(errors.lost_spans):
        begun_s = rng.uniform(30.0, time_s[-1])
        lost_s = rng.uniform(*errors.lost_s)
        lost = (time_s >= begun_s) & (time_s < begun_s + lost_s)
        of_beams = slice(None) if rng.random() < 0.5 else int(rng.integers(beams))
        velocity_mps[lost, of_beams] = np.nan
    return replace(exact, beam_velocity_mps=velocity_mps)


def _reference_at_sea(
    exact: ReferenceColumns, errors: SeaReference, rng: np.random.Generator
) -> ReferenceColumns:
    def noise(sd: float) -> Floats:
        stays = _gauss_markov(exact.time_ns, 3, sd / 3.0, 60.0, rng)
        return sd * rng.standard_normal((len(exact.time_ns), 3)) + stays

    return ReferenceColumns(
        exact.time_ns,
        moved_position(exact.position, noise(errors.position_m)),
        exact.velocity_n + noise(errors.velocity_mps),
        mat_from_rpy(rpy_from_mat(exact.mat_nb) + noise(errors.attitude_deg * DEG)),
    )
