"""Tables whose positions are in metres: which columns and axes are proposed, and from where they count."""

from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Dvl, Imu, Initial, Reference
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.logs import read_dive

TIMES_S = np.arange(0.0, 20.0, 0.1)
NORTH_M = 3.0 * np.sin(0.3 * TIMES_S)
EAST_M = 1.2 * TIMES_S
DOWN_M = 5.0 + 0.1 * TIMES_S
LATITUDE_DEG = 60.0
UTM_NORTH_M = 6_650_000.0
UTM_EAST_M = 597_000.0


def write_table(path: Path, titles: str, *columns: Floats) -> None:
    rows = np.column_stack([TIMES_S, *columns])
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=f"time [s],{titles}", comments="")


def dive(folder: Path, titles: str, *columns: Floats) -> Path:
    """Write an IMU, a DVL and a table of positions."""
    noise = np.random.default_rng(1).normal(0.0, 0.01, (len(TIMES_S), 9))
    write_table(
        folder / "imu.csv", "ax,ay,az,gx,gy,gz", noise[:, :2], noise[:, 2] - 9.8, noise[:, 3:6]
    )
    write_table(folder / "dvl.csv", "vx,vy,vz", 1.2 + noise[:, 6], noise[:, 7:])
    write_table(folder / "nav.csv", titles, *columns)
    return folder


def position_read(folder: Path, path: str, axes: str) -> tuple[Floats, list[str]]:
    """Return north and east, m from the initial place, and what was down; and the codes of the notes."""
    config = Config(
        imu=Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz"),
        dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz"),
        reference=Reference(topic="nav.csv", local_position=path, axes=axes),  # type: ignore[arg-type]
        initial=Initial(latitude_deg=LATITUDE_DEG, longitude_deg=5.0),
    )
    read = read_dive(folder, config)
    assert read.reference is not None
    latitude, longitude, height_m = read.reference.position.T
    start = LATITUDE_DEG * DEG
    north_m = (latitude - start) * meridian_radius_m(start)
    east_m = (longitude - 5.0 * DEG) * transverse_radius_m(start) * np.cos(start)
    return np.column_stack([north_m, east_m, -height_m]), [found.code for found in read.notes]


@pytest.mark.parametrize(
    ("titles", "path", "axes"),
    [
        ("north,east,down", "north, east, down", "ned_frd"),
        ("North [m],East [m],Down [m]", "north, east, down", "ned_frd"),
        ("down,north,east", "north, east, down", "ned_frd"),
        ("pos_n,pos_e,pos_d", "pos_n, pos_e, pos_d", "ned_frd"),
        ("PN,PE,PD", "pn, pe, pd", "ned_frd"),
        ("East,North,Up", "east, north, up", "enu_flu"),
        ("Easting (m),Northing (m),q", "easting, northing", "enu_flu"),
        ("north,east,q", "east, north", "enu_flu"),
    ],
)
def test_positions_are_proposed_by_the_directions_that_name_them(
    titles: str, path: str, axes: str, tmp_path: Path
) -> None:
    folder = dive(tmp_path, titles, NORTH_M, EAST_M, DOWN_M)
    proposed = {one.key: one.value for one in propose_settings(folder, Config()).settings}
    assert proposed["reference.topic"] == "nav.csv"
    assert proposed["reference.local_position"] == path
    assert proposed["reference.axes"] == axes


@pytest.mark.parametrize(
    "titles", ["North [m/s],East [m/s],Down [m/s]", "x,y,z", "temperature,salinity,e"]
)
def test_what_may_be_no_position_is_not_proposed(titles: str, tmp_path: Path) -> None:
    folder = dive(tmp_path, titles, NORTH_M, EAST_M, DOWN_M)
    proposed = {one.key for one in propose_settings(folder, Config()).settings}
    assert "reference.local_position" not in proposed


def test_a_latitude_goes_before_positions_in_metres(tmp_path: Path) -> None:
    folder = dive(
        tmp_path,
        "lat,lon,north,east,down",
        60.0 + NORTH_M * 1e-5,
        EAST_M * 1e-5,
        NORTH_M,
        EAST_M,
        DOWN_M,
    )
    proposed = {one.key for one in propose_settings(folder, Config()).settings}
    assert "reference.latitude" in proposed
    assert "reference.local_position" not in proposed


@pytest.mark.parametrize(
    ("path", "axes", "is_flat"),
    [
        ("n, e, d", "ned_frd", False),
        ("e, n, u", "enu_flu", False),
        ("n, e", "ned_frd", True),
        ("e, n", "enu_flu", True),
    ],
)
def test_positions_count_from_the_initial_place(
    path: str, axes: str, *, is_flat: bool, tmp_path: Path
) -> None:
    folder = dive(tmp_path, "n,e,d,u", NORTH_M, EAST_M, DOWN_M, -DOWN_M)
    found, codes = position_read(folder, path, axes)
    np.testing.assert_allclose(found[:, :2], np.column_stack([NORTH_M, EAST_M]), rtol=0, atol=1e-3)
    if is_flat:
        assert np.isnan(found[:, 2]).all()
    else:
        np.testing.assert_allclose(found[:, 2], DOWN_M, rtol=0, atol=1e-6)
    assert "reference_grid" not in codes


def test_the_unit_of_the_titles_counts(tmp_path: Path) -> None:
    folder = dive(tmp_path, "n [km],e [km],d [m]", NORTH_M * 1e-3, EAST_M * 1e-3, DOWN_M)
    found, _ = position_read(folder, "n, e, d", "ned_frd")
    np.testing.assert_allclose(
        found, np.column_stack([NORTH_M, EAST_M, DOWN_M]), rtol=0, atol=1e-3
    )


def test_positions_of_a_grid_count_from_the_first_one(tmp_path: Path) -> None:
    """Else the dive would be 6,650 km north of its initial place, where the Earth turns otherwise."""
    folder = dive(tmp_path, "e,n", UTM_EAST_M + EAST_M, UTM_NORTH_M + NORTH_M)
    found, codes = position_read(folder, "e, n", "enu_flu")
    np.testing.assert_allclose(found[:, :2], np.column_stack([NORTH_M, EAST_M]), rtol=0, atol=1e-3)
    assert codes.count("reference_grid") == 1


@pytest.mark.parametrize("count", [1, 4])
def test_a_position_has_two_or_three_numbers(count: int, tmp_path: Path) -> None:
    folder = dive(tmp_path, "a,b,c,d", NORTH_M, EAST_M, DOWN_M, DOWN_M)
    with pytest.raises(LogError, match=f"has {count} numbers"):
        position_read(folder, ", ".join("abcd"[:count]), "ned_frd")


@pytest.mark.parametrize("is_nmea", [False, True])
def test_latitudes_of_degrees_and_minutes_are_named(*, is_nmea: bool, tmp_path: Path) -> None:
    """48 deg 7.038' N is 4807.038 in the sentences of NMEA 0183; 4887 cannot be that."""
    latitude = (4807.038 if is_nmea else 4887.038) + NORTH_M * 1e-4
    folder = dive(tmp_path, "lat,lon", latitude, 1131.0 + EAST_M * 1e-4)
    config = Config(
        imu=Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz"),
        dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz"),
        reference=Reference(topic="nav.csv", latitude="lat", longitude="lon"),
    )
    with pytest.raises(LogError, match="beyond the poles") as refused:
        read_dive(folder, config)
    assert ("degrees and minutes" in refused.value.message) == is_nmea
    assert ("write them as degrees" in refused.value.hint) == is_nmea
