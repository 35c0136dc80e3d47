"""Filters that run the baseline with other sensors, so that two filters may err differently and yet equally much.

Each is a Python class, as a user's own filter is. It takes the readings that it is given, adds errors that were drawn
for this dive and this filter, and runs the baseline over them. What was drawn stands in a file, which an environment
variable names, so that a class also finds it in a process of its own.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config, Dvl, Filter, Initial, Vector
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ReferenceColumns,
    TimeNs,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, vector_from_mat
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude

CASE: Final = "SCATTER_CASE"
"""The environment variable that names the folder of what was drawn for a dive."""
CASE_FILE = "case.json"
EXACT_FILE = "exact.npz"
EVERY_SAMPLE: Final = 5
"""A solution has a row for every so many samples of the IMU: those of the reference are among them."""
PLAIN_STATES: Final = 12
NO_TURN: Final[Vector] = (0.0, 0.0, 0.0)


class PingNoise(msgspec.Struct, frozen=True):
    """White noise of a DVL of the filter's own, in place of that of the baseline's DVL.

    Both are drawn from their seeds, so that the filter gives the same answer whenever it runs.
    """

    own_mps: float
    own_seed: int
    baseline_mps: float
    baseline_seed: int

    def added_mps(self, pings: int) -> Floats:
        """Return what the velocities of the filter's DVL have beside those of the baseline's, shape (k, 3)."""
        return self.of_own_mps(pings) - self.of_baseline_mps(pings)

    def of_own_mps(self, pings: int) -> Floats:
        """Return the noise of the filter's DVL, shape (k, 3)."""
        rng = np.random.default_rng(self.own_seed)
        return self.own_mps * rng.standard_normal((pings, 3))

    def of_baseline_mps(self, pings: int) -> Floats:
        """Return the noise of the baseline's DVL, which is in the readings of the dive, shape (k, 3)."""
        rng = np.random.default_rng(self.baseline_seed)
        return self.baseline_mps * rng.standard_normal((pings, 3))

    @property
    def exchanged(self) -> "PingNoise":
        """The noise of a filter that has the DVL of the baseline, whose DVL the baseline has."""
        return PingNoise(self.baseline_mps, self.baseline_seed, self.own_mps, self.own_seed)


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """How the sensors of one filter in one dive differ from those of the baseline."""

    accel_bias_mps2: Vector = (0.0, 0.0, 0.0)
    gyro_bias_radps: Vector = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Vector = NO_TURN
    """By which the velocities of the DVL are turned."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """By which the lever arm that the filter is told is off."""
    ping_noise: PingNoise | None = None
    heading_deg: float = 0.0
    """Added to the readings of a heading."""
    velocity_sd_mps: float | None = None
    """What the filter believes of the DVL, if not what the baseline believes."""
    shake_mps: float = 0.0
    """Standard deviation of velocities that are added to those of the DVL, drawn anew whenever the filter runs."""
    factor: float = 1.0
    """By which all errors of the filter are larger than they would be."""


class Case(msgspec.Struct, frozen=True):
    """What is drawn for the filters of one dive."""

    config: Config
    told: dict[str, Told]


def write_case(folder: Path, case: Case, exact: ReferenceColumns) -> None:
    """Write what the filters of this dive are told, and how the vehicle truly moved; later runs find it."""
    (folder / CASE_FILE).write_bytes(msgspec.json.encode(case))
    np.savez(
        folder / EXACT_FILE,
        time_ns=exact.time_ns,
        position=exact.position,
        velocity_n=exact.velocity_n,
        mat_nb=exact.mat_nb,
    )
    os.environ[CASE] = str(folder)


def read_case() -> tuple[Case, ReferenceColumns]:
    """Read what `write_case` wrote."""
    folder = Path(os.environ[CASE])
    case = msgspec.json.decode((folder / CASE_FILE).read_bytes(), type=Case)
    with np.load(folder / EXACT_FILE) as exact:
        return case, ReferenceColumns(
            exact["time_ns"], exact["position"], exact["velocity_n"], exact["mat_nb"]
        )


def with_other_sensors(dive: Dive, told: Told) -> Dive:
    """Change the readings of a dive as one filter has them."""
    imu = replace(
        dive.imu,
        specific_force_b=dive.imu.specific_force_b + np.array(told.accel_bias_mps2),
        angular_rate_b=dive.imu.angular_rate_b + np.array(told.gyro_bias_radps),
    )
    sensors = dict(dive.sensors)
    if "heading" in sensors and told.heading_deg:
        heading = sensors["heading"]
        sensors["heading"] = replace(
            heading, values=heading.values + told.heading_deg * DEG, mat_nb=None
        )
    dvl = turned_dvl(dive.dvl, told.mounting_rpy_deg, told.shake_mps)
    if told.ping_noise is not None:
        dvl = with_added(dvl, told.ping_noise.added_mps(len(dvl.time_ns)))
    return replace(dive, imu=imu, dvl=dvl, sensors=sensors)


def turned_dvl(dvl: DvlColumns, rpy_deg: Vector, shake_mps: float = 0.0) -> DvlColumns:
    """Turn all velocities of a DVL, of beams or of axes, and shake them."""
    if rpy_deg == NO_TURN and not shake_mps:
        return dvl
    added_mps = shake_mps * np.random.default_rng().standard_normal((len(dvl.time_ns), 3))
    mat = mat_from_rpy(np.array(rpy_deg) * DEG)
    velocity_d = dvl.velocity_d
    if velocity_d is None:
        velocity_d = beam_columns(dvl)[0] @ np.linalg.pinv(beam_columns(dvl)[1]).T
    return with_added(dvl, velocity_d @ mat.T - velocity_d + added_mps)


def with_added(dvl: DvlColumns, added_mps: Floats) -> DvlColumns:
    """Add velocities in d, shape (k, 3), to those of a DVL, of beams or of axes."""
    if dvl.velocity_d is not None:
        return replace(dvl, velocity_d=dvl.velocity_d + added_mps)
    # Beams measure the velocity and a little noise beside it, which stays as it is.
    velocity_mps, vectors_d = beam_columns(dvl)
    return replace(dvl, beam_velocity_mps=velocity_mps + added_mps @ vectors_d.T)


def beam_columns(dvl: DvlColumns) -> tuple[Floats, Floats]:
    """Return the velocities along the beams, shape (k, beams), and their directions in d, shape (beams, 3)."""
    if dvl.beam_velocity_mps is None or dvl.beam_vectors_d is None:
        raise ValueError("a DVL has velocities along beams or along axes")
    return dvl.beam_velocity_mps, dvl.beam_vectors_d


def baseline_of(config: Config, told: Told) -> Filter:
    """Give the baseline of some settings, which may believe something else of the DVL."""
    baseline = config.filters[config.baseline]
    if told.velocity_sd_mps is None:
        return baseline
    return msgspec.structs.replace(baseline, velocity_sd_mps=told.velocity_sd_mps)


def with_lever_arm(dvl: Dvl, told: Told) -> Dvl:
    """Give a filter the settings of the DVL with the lever arm that it is told."""
    told_m = np.array(dvl.lever_arm_m) + np.array(told.lever_arm_m)
    return msgspec.structs.replace(dvl, lever_arm_m=tuple(map(float, told_m)))


def with_larger_errors(found: History, exact: ReferenceColumns, factor: float) -> History:
    """Multiply the errors of a trajectory by a factor."""
    if factor == 1.0:
        return found
    # A run in which all stamps are a microsecond later ends behind the exact motion.
    at_ns = np.minimum(found.time_ns, exact.time_ns[-1])
    position = interpolated(exact.time_ns, exact.position, at_ns)
    velocity_n = interpolated(exact.time_ns, exact.velocity_n, at_ns)
    mat_nb = interpolated_attitude(exact.time_ns, exact.mat_nb, at_ns)
    turn = factor * vector_from_mat(found.mat_nb @ np.swapaxes(mat_nb, 1, 2))
    return replace(
        found,
        position=position + factor * (found.position - position),
        velocity_n=velocity_n + factor * (found.velocity_n - velocity_n),
        mat_nb=mat_from_vector(turn) @ mat_nb,
    )


class OtherSensors(Candidate):
    """The baseline, with sensors of its own."""

    name = "other"

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Run the baseline from the start that is given."""
        case, exact = read_case()
        told = case.told[self.name]
        # Readings come in the axes of the IMU, and the start is replaced below.
        dvl = with_lever_arm(case.config.dvl, told)
        dvl = msgspec.structs.replace(dvl, mounting_rpy_deg=NO_TURN, scale=1.0)
        initial = Initial(
            source="level", heading_deg=0.0, latitude_deg=float(start.position[0] / DEG)
        )
        filters = {case.config.baseline: baseline_of(case.config, told)}
        config = msgspec.structs.replace(case.config, dvl=dvl, initial=initial, filters=filters)
        dive = with_other_sensors(dive, told)
        prepared = prepare_dive(dive, config)
        alignment = replace(prepared.alignment, start=_plain(start), start_ns=start.time_ns)
        prepared = replace(prepared, alignment=alignment)
        time_ns = rows_of_solution(dive.imu.time_ns, start.time_ns, prepared.end_ns)
        found = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared, time_ns))
        found = with_larger_errors(found, exact, told.factor)
        return Solution(found.time_ns, found.position, found.velocity_n, found.mat_nb)


def rows_of_solution(sample_ns: TimeNs, start_ns: int, end_ns: int) -> TimeNs:
    """Choose samples of the IMU at which a solution has rows."""
    inside = sample_ns[(sample_ns >= start_ns) & (sample_ns <= end_ns)]
    return inside[::EVERY_SAMPLE]


def _plain(start: CandidateStart) -> Start:
    """Give the state and its uncertainty alone."""
    cov = start.cov[:PLAIN_STATES, :PLAIN_STATES]
    return Start(
        start.position, start.velocity_n, start.mat_nb, cov, start.accel_bias_b, start.gyro_bias_b
    )


class First(OtherSensors):
    """The first of five filters."""

    name = "first"


class Second(OtherSensors):
    """The second of five filters."""

    name = "second"


class Third(OtherSensors):
    """The third of five filters."""

    name = "third"


class Fourth(OtherSensors):
    """The fourth of five filters."""

    name = "fourth"


class Fifth(OtherSensors):
    """The fifth of five filters."""

    name = "fifth"


KINDS: Final = {kind.name: kind for kind in (OtherSensors, First, Second, Third, Fourth, Fifth)}


def as_filter(name: str) -> Filter:
    """Give the settings of one of these filters."""
    return Filter(candidate=f"{__name__}:{KINDS[name].__name__}")
