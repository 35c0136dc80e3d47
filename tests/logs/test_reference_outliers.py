"""Single positions of a reference to which no vehicle moves are missing; jumps, noise and solutions stay."""

from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Dvl, Filter, Imu, Reference, Solution
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.logs import read_dive

ROWS = 200
TIMES_S = np.arange(float(ROWS))
M_TO_DEG = 1.0 / 111_000.0
IMU = Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz")
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")


def positions_m(sd_m: float) -> Floats:
    """Return a way at 1.5 m/s, north and east, with noise."""
    way = np.column_stack([1.2 * TIMES_S, 0.9 * TIMES_S])
    return way + np.random.default_rng(3).normal(0.0, sd_m, way.shape)


def write_table(path: Path, titles: str, times_s: Floats, columns: Floats) -> None:
    rows = np.column_stack([times_s, columns])
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=f"time [s],{titles}", comments="")


def folder_with(folder: Path, way_m: Floats) -> Path:
    noise = np.random.default_rng(1).normal(0.0, 0.01, (ROWS, 9))
    write_table(
        folder / "imu.csv", "ax,ay,az,gx,gy,gz", TIMES_S, noise[:, :6] - [0, 0, 9.8, 0, 0, 0]
    )
    write_table(folder / "dvl.csv", "vx,vy,vz", TIMES_S, noise[:, 6:] + [1.5, 0, 0])
    write_table(folder / "gps.csv", "lat,lon", TIMES_S, way_m * M_TO_DEG + [1.0, 10.0])
    return folder


def reference_with(folder: Path, way_m: Floats) -> tuple[Floats, list[Note]]:
    """Return the rows whose position is known, and the notes on impossible ones."""
    reference = Reference(topic="gps.csv", latitude="lat", longitude="lon")
    dive = read_dive(folder_with(folder, way_m), Config(imu=IMU, dvl=DVL, reference=reference))
    assert dive.reference is not None
    notes = [one for one in dive.notes if one.code == "reference_impossible"]
    return np.flatnonzero(dive.reference.known["positions"]), notes


@pytest.mark.parametrize(
    "rows", [[60], [0], [199], [10, 11, 90, 150], [0, 1, 2], [97, 98, 99, 100, 101]]
)
@pytest.mark.parametrize("sd_m", [0.0, 2.0])
def test_positions_that_no_vehicle_reaches_are_missing(
    rows: list[int], sd_m: float, tmp_path: Path
) -> None:
    way_m = positions_m(sd_m)
    way_m[rows] += [400.0, -300.0]
    known, notes = reference_with(tmp_path, way_m)
    assert sorted(set(range(ROWS)) - set(known.tolist())) == rows
    (note,) = notes
    assert (note.count, note.severity) == (len(rows), "warning")
    largest_m = float(note.text.split("by up to ")[1].split(" m")[0])
    assert largest_m == pytest.approx(500.0, abs=12.0)


@pytest.mark.parametrize("sd_m", [0.0, 2.0, 30.0])
def test_sound_positions_stay_however_noisy_they_are(sd_m: float, tmp_path: Path) -> None:
    known, notes = reference_with(tmp_path, positions_m(sd_m))
    assert len(known) == ROWS
    assert not notes


@pytest.mark.parametrize("row", [50, 100, 150])
def test_both_sides_of_a_jump_stay(row: int, tmp_path: Path) -> None:
    way_m = positions_m(0.5)
    way_m[row:] += [400.0, -300.0]
    known, notes = reference_with(tmp_path, way_m)
    assert len(known) == ROWS
    assert not notes


def test_many_that_are_off_stay(tmp_path: Path) -> None:
    """Nobody can tell which of them are right."""
    way_m = positions_m(0.5)
    way_m[5:195:9] += [400.0, -300.0]
    known, notes = reference_with(tmp_path, way_m)
    assert len(known) == ROWS
    assert not notes


def test_a_gap_is_no_jump(tmp_path: Path) -> None:
    """In a minute under water a vehicle goes far."""
    way_m = positions_m(0.5)
    way_m[100:160] = np.nan
    way_m[160:] += [400.0, -300.0]
    known, notes = reference_with(tmp_path, way_m)
    assert len(known) == ROWS - 60
    assert not notes


def test_a_solution_is_judged_with_the_positions_that_it_has(tmp_path: Path) -> None:
    way_m = positions_m(0.5)
    way_m[60] += [400.0, -300.0]
    solution = Solution(topic="gps.csv", latitude="lat", longitude="lon")
    config = Config(
        imu=IMU,
        dvl=DVL,
        reference=Reference(ignore=True),
        filters={"baseline": Filter(aiding=("velocity",)), "onboard": Filter(solution=solution)},
    )
    dive = read_dive(folder_with(tmp_path, way_m), config)
    assert dive.solutions["onboard"].motion.known["positions"].all()
