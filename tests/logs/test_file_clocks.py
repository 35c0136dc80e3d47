"""An IMU in one file and a DVL in another, by clocks that have nothing to do with each other, become one dive.

The worlds are dives at sea: legs and turns, on which speed, attitude and drift sway as sums of waves of many periods,
and a straight one, whose motion tells nothing.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from instrument_logs import Told
from teledyne_logs import SHIP, Setup, pd0

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ImuColumns, TimeNs, seconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry.frames import solve_beams
from insdvl_replay.inspection.roles import read_roles
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.clock_by_motion import FileClock, Rows, clock_by_motion
from insdvl_replay.logs.read import held_back_messages
from insdvl_replay.sim.dive import START_NS, simulate_dive
from insdvl_replay.sim.trajectories import Scenario, Segment, Wave, turn

OFFSET_S = 37.0
DRIFT = 20e-6
WORST_S = 0.01  # that a dive with turns may be off anywhere


@dataclass(frozen=True)
class Waves(Wave):
    """The sum of waves, each with a phase in s."""

    waves: tuple[tuple[Wave, float], ...] = ()

    def value(self, time_s: Floats) -> Floats:
        total = np.full_like(time_s, self.mean)
        for wave, late_s in self.waves:
            total += wave.value(time_s + late_s)
        return total

    def rate(self, time_s: Floats) -> Floats:
        total = np.zeros_like(time_s)
        for wave, late_s in self.waves:
            total += wave.rate(time_s + late_s)
        return total


def swell(rng: np.random.Generator, mean: float, sd: float) -> Waves:
    """A quantity that sways by so much, with periods from 4 s to a minute."""
    waves = []
    for period_s in np.exp(rng.uniform(np.log(4.0), np.log(60.0), 12)):
        waves.append((Wave(0.0, sd / 6.0**0.5, float(period_s)), float(rng.uniform(0.0, 60.0))))
    return Waves(mean, waves=tuple(waves))


def at_sea(seed: int, legs: int = 6, leg_s: float = 90.0) -> Scenario:
    """Legs of about the same length, with U-turns to either side."""
    rng = np.random.default_rng(seed)
    segments = []
    for number in range(legs):
        segments += [
            Segment(leg_s + rng.uniform(-20.0, 20.0)),
            turn(-180.0 if number % 2 else 180.0, 8.0),
        ]
    return Scenario(
        "at sea",
        sum(segment.duration_s for segment in segments) + leg_s,
        swell(rng, 1.5, 0.03),
        tuple(segments),
        roll_deg=swell(rng, 0.0, 1.5),
        pitch_deg=swell(rng, -1.0, 1.5),
        sway_mps=swell(rng, 0.0, 0.03),
        heave_mps=swell(rng, 0.0, 0.03),
    )


def simulated(
    scenario: Scenario | str,
    seed: int,
    grade: str = "tactical",
    imu_hz: float = 100.0,
    dvl_hz: float = 4.0,
) -> Dive:
    """A dive whose DVL is turned and has a lever arm, with a row of the reference at each ping."""
    return simulate_dive(
        scenario, seed=seed, grade=grade, imu_rate_hz=imu_hz, dvl_rate_hz=dvl_hz,
        lever_arm_m=(0.3, 0.0, 0.2), mounting_rpy_deg=(2.0, -1.0, 45.0), reference_at_pings=True,
    )  # fmt: skip


def stamped(time_ns: TimeNs, offset_s: float = OFFSET_S, drift: float = DRIFT) -> TimeNs:
    """Times by the clock of the DVL."""
    since_s = seconds(time_ns, START_NS)
    return time_ns + np.rint((offset_s + drift * since_s) * 1e9).astype(np.int64)


def velocities(dive: Dive, offset_s: float = OFFSET_S) -> Rows:
    """What the file of the DVL has, by its clock."""
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0]
    return Rows.of_velocities(stamped(dive.dvl.time_ns, offset_s), velocity_d)


def assert_right(
    clock: FileClock | None, dive: Dive, worst_s: float, offset_s: float = OFFSET_S
) -> None:
    """The clock is right everywhere that both saw, and its standard errors say how right."""
    assert clock is not None
    time_ns = dive.dvl.time_ns
    time_ns = time_ns[(time_ns >= dive.imu.time_ns[0]) & (time_ns <= dive.imu.time_ns[-1])]
    wrong_s = seconds(clock.by_imu(stamped(time_ns, offset_s)) - time_ns, 0)
    assert np.abs(wrong_s).max() < worst_s
    assert abs(wrong_s.mean()) < 3.0 * clock.ahead_sd_s
    assert np.abs(wrong_s).max() < 3.0 * clock.largest_sd_s
    assert abs(clock.drift - DRIFT) < 3.0 * clock.drift_sd


NIGHTLY = pytest.mark.nightly


@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=NIGHTLY), pytest.param(3, marks=NIGHTLY)]
)
@pytest.mark.parametrize(
    ("grade", "imu_hz", "dvl_hz", "worst_s"),
    [("tactical", 100.0, 4.0, WORST_S), ("mems", 50.0, 8.0, 0.02), ("mems", 20.0, 2.0, 0.04)],
)
def test_turns_and_sway_tell_offset_and_drift(
    grade: str, imu_hz: float, dvl_hz: float, worst_s: float, seed: int
) -> None:
    dive = simulated(at_sea(seed), seed, grade, imu_hz, dvl_hz)
    assert_right(clock_by_motion(dive.imu, [velocities(dive)]), dive, worst_s)


@pytest.mark.parametrize("offset_s", [1e9, -1e9])
def test_clocks_may_be_of_other_years(offset_s: float) -> None:
    dive = simulated(at_sea(4), 4)
    clock = clock_by_motion(dive.imu, [velocities(dive, offset_s)])
    assert_right(clock, dive, WORST_S, offset_s)


def test_half_of_a_dive_is_enough() -> None:
    dive = simulated(at_sea(5), 5, imu_hz=50.0)
    length_ns = int(dive.imu.time_ns[-1]) - START_NS
    imu = dive.imu.within(START_NS, START_NS + 2 * length_ns // 3)
    dvl = dive.dvl.within(START_NS + length_ns // 3, START_NS + length_ns)
    part = replace(dive, imu=imu, dvl=dvl)
    assert_right(clock_by_motion(imu, [velocities(part)]), part, 0.03)


@pytest.mark.parametrize("grade", ["tactical", "mems"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_straight_dive_tells_nothing(grade: str, seed: int) -> None:
    dive = simulated("straight", seed, grade)
    assert clock_by_motion(dive.imu, [velocities(dive)]) is None


@pytest.mark.nightly
def test_another_dive_is_not_taken_for_this_one() -> None:
    dive = simulated(at_sea(6), 6)
    other = simulated(at_sea(7), 7)
    assert clock_by_motion(dive.imu, [velocities(other)]) is None


# --- Files.


def write_imu(folder: Path, imu: ImuColumns) -> Path:
    """Write samples as a table."""
    path = folder / "imu.csv"
    columns = {"time [s]": imu.time_ns / 1e9}
    for axis, force, rate in zip("xyz", imu.specific_force_b.T, imu.angular_rate_b.T, strict=True):
        columns[f"acc_{axis} [m/s^2]"] = force
        columns[f"gyro_{axis} [rad/s]"] = rate
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def written(folder: Path, dive: Dive, offset_s: float, since_boot: bool = False) -> list[Path]:
    """Write an IMU as a table and a DVL as PD0, with the attitude of the vehicle in each ensemble."""
    folder.mkdir(exist_ok=True)
    imu = dive.imu
    if since_boot:
        imu = replace(imu, time_ns=imu.time_ns - START_NS)
    assert dive.reference is not None
    rows = velocities(dive, offset_s)
    # The clock of PD0 has hundredths.
    time_ns = (rows.time_ns + 5_000_000) // 10_000_000 * 10_000_000
    at_pings = replace(dive.reference.rows(slice(1, None)), time_ns=time_ns)
    dvl = DvlColumns(time_ns, velocity_d=rows.values)
    by_dvl = replace(dive, dvl=dvl, reference=at_pings)
    told = Told(by_dvl, time_ns, rows.values, np.full((len(time_ns), 4), np.nan))
    path = folder / "dvl.pd0"
    path.write_bytes(b"".join(pd0(told, Setup(SHIP))))
    return [write_imu(folder, imu), path]


SETTINGS = Config(
    imu=Imu(
        topic="imu.csv",
        specific_force="acc_x, acc_y, acc_z",
        angular_rate="gyro_x, gyro_y, gyro_z",
    )
)


@pytest.mark.parametrize(
    ("offset_s", "since_boot"),
    [(OFFSET_S, False), pytest.param(OFFSET_S, True, marks=pytest.mark.nightly)],
)
def test_pd0_is_brought_onto_the_clock_of_a_table(
    offset_s: float, since_boot: bool, tmp_path: Path
) -> None:
    dive = simulated(at_sea(8), 8, imu_hz=50.0)
    paths = written(tmp_path, dive, offset_s, since_boot)
    found = read_dive(paths, SETTINGS)
    true_ns = dive.dvl.time_ns - (START_NS if since_boot else 0)
    late_s = seconds(found.dvl.time_ns - true_ns, 0)
    assert np.abs(late_s - np.median(late_s)).max() < 0.012
    (said,) = [note for note in found.notes if note.code == "file_clock"]
    assert (
        "dvl.pd0 has another clock than the IMU: by velocities and attitudes, it is" in said.text
    )
    assert "standard error" in said.text
    assert abs(late_s.mean()) < WORST_S
    inventory = inspect_log(paths, SETTINGS)
    assert [note.text for note in inventory.notes if note.code == "file_clock"] == [said.text]


@pytest.mark.nightly
def test_an_imu_without_settings_is_aligned_before_they_are_searched(tmp_path: Path) -> None:
    dive = simulated(at_sea(11), 11)
    written(tmp_path / "dive", dive, OFFSET_S)
    (only,) = find_dives([str(tmp_path / "dive")])
    readings = read_roles(only.path, Config(), allow_damaged=False)
    late_s = seconds(readings.dvls[0].pings.time_ns - dive.dvl.time_ns, 0)
    assert abs(late_s.mean()) < WORST_S


def test_files_by_one_clock_stay_as_they_are(tmp_path: Path) -> None:
    dive = simulated(at_sea(9), 9, imu_hz=50.0)
    found = read_dive(written(tmp_path, dive, 0.3), SETTINGS)
    late_s = seconds(found.dvl.time_ns - dive.dvl.time_ns, 0)
    assert np.abs(late_s - 0.3 - DRIFT * seconds(dive.dvl.time_ns, START_NS)).max() < 0.006
    assert "file_clock" not in {note.code for note in found.notes}


def test_pings_that_settings_count_are_taken_as_they_are(tmp_path: Path) -> None:
    """The rate and the latency are those of the settings; no clock is looked for."""
    dive = simulated(at_sea(9), 9, imu_hz=50.0)
    dvl = velocities(dive, 0.0)
    columns = {"time [s]": dvl.time_ns / 1e9}
    for axis, values in zip("xyz", dvl.values.T, strict=True):
        columns[f"dvl_{axis} [m/s]"] = values
    pd.DataFrame(columns).to_csv(tmp_path / "dvl.csv", index=False)
    counted = Dvl(topic="dvl.csv", velocity="dvl_x, dvl_y, dvl_z", kind="velocity", stamp="5 Hz")
    settings = Config(imu=SETTINGS.imu, dvl=counted)
    found = read_dive([write_imu(tmp_path, dive.imu), tmp_path / "dvl.csv"], settings)
    step_s = np.diff(seconds(found.dvl.time_ns, int(dvl.time_ns[0])))
    assert np.abs(step_s - 0.2).max() < 1e-6
    assert "file_clock" not in {note.code for note in found.notes}


def test_a_straight_dive_by_two_clocks_is_refused_with_what_to_set(tmp_path: Path) -> None:
    dive = simulated("straight", 1)
    paths = written(tmp_path, dive, 1000.0)
    with pytest.raises(LogError, match="clocks that have nothing to do with each other") as raised:
        read_dive(paths, SETTINGS)
    assert "dvl.latency_s" in raised.value.hint
    told = Config(imu=SETTINGS.imu, dvl=Dvl(latency_s=1000.0))
    found = read_dive(paths, told)
    assert np.abs(seconds(found.dvl.time_ns - dive.dvl.time_ns, 0)).max() < 0.02


@pytest.mark.parametrize(("scenario", "is_said"), [("straight", True), ("at sea", False)])
@pytest.mark.nightly
def test_clocks_that_no_motion_confirms_are_said(
    scenario: str, is_said: bool, tmp_path: Path
) -> None:
    course = "straight" if scenario == "straight" else at_sea(9)
    found = read_dive(written(tmp_path, simulated(course, 9), 0.3), SETTINGS)
    codes = [note.code for note in found.notes]
    assert ("file_clock_unconfirmed" in codes) == is_said


@pytest.mark.nightly
def test_pings_of_outages_are_held_back_by_the_clock_of_the_imu(tmp_path: Path) -> None:
    dive = simulated(at_sea(10), 10, imu_hz=50.0)
    paths = written(tmp_path, dive, OFFSET_S)
    outage = (START_NS + 100 * 10**9, START_NS + 160 * 10**9)
    held_back = held_back_messages(paths, SETTINGS, [outage])["dvl/velocity"]
    assert held_back is not None
    inside = (dive.dvl.time_ns > outage[0]) & (dive.dvl.time_ns <= outage[1])
    written_ns = stamped(dive.dvl.time_ns[inside])
    assert abs(len(held_back) - len(written_ns)) <= 1
    assert abs(float(seconds(held_back[0], int(written_ns[0])))) < 0.3


@pytest.mark.filterwarnings("error")
def test_what_never_changes_tells_nothing() -> None:
    dive = simulated(at_sea(5, legs=1), 5)
    sway = velocities(dive)
    unturned = Rows.of_attitudes(sway.time_ns, np.tile(np.eye(3), (len(sway.time_ns), 1, 1)))
    with_both = clock_by_motion(dive.imu, [sway, unturned], are_stamps_likely=True)
    assert with_both == clock_by_motion(dive.imu, [sway], are_stamps_likely=True)
    at_rest = replace(
        dive.imu,
        specific_force_b=0.0 * dive.imu.specific_force_b,
        angular_rate_b=0.0 * dive.imu.angular_rate_b,
    )
    steady = Rows.of_velocities(sway.time_ns, np.ones((len(sway.time_ns), 3)))
    assert clock_by_motion(at_rest, [steady], are_stamps_likely=True) is None


@pytest.mark.filterwarnings("error")
def test_bursts_of_pings_far_apart_tell_nothing() -> None:
    dive = simulated(at_sea(5, legs=1), 5)
    sway = velocities(dive)
    since_first = np.arange(len(sway.time_ns)) // 10 * 2_500_000_000
    bursts = Rows(sway.time_ns[0] + since_first, sway.values)
    assert clock_by_motion(dive.imu, [bursts]) is None
