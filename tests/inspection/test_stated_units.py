"""Units of an IMU that titles or settings state count, and are guessed by sizes only where nobody states them."""

from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.units import ANGULAR_RATE_UNITS, SPECIFIC_FORCE_UNITS
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.inspection.roles import RoleReadings, read_roles

TIMES_S = np.arange(0.0, 20.0, 0.02)
RATE_RADPS = 0.05
GRAVITY_MPS2 = 9.8


def dive(folder: Path, force: str, rate: str, title: str | None = None) -> Path:
    """Write an IMU with readings in these units, and a DVL; titles may have another unit of the rate, or none."""
    swing = np.sin(TIMES_S[:, None] + [0.0, 1.0, 2.0])
    rates = RATE_RADPS * swing / ANGULAR_RATE_UNITS[rate]
    forces = (0.1 * swing + [0.0, 0.0, -GRAVITY_MPS2]) / SPECIFIC_FORCE_UNITS[force]
    unit = f" [{rate}]" if title is None else title
    titles = [f"acc_{axis} [{force}]" for axis in "xyz"] + [f"gyro_{axis}{unit}" for axis in "xyz"]
    for name, columns, names in (
        ("imu.csv", np.column_stack([forces, rates]), titles),
        ("dvl.csv", [1.2, 0.0, 0.0] + 0.01 * swing, ["vx", "vy", "vz"]),
    ):
        header = ",".join(["time [s]", *names])
        rows = np.column_stack([TIMES_S, columns])
        np.savetxt(folder / name, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return folder


def read(folder: Path, imu: Imu | None = None) -> RoleReadings:
    return read_roles(folder, Config(imu=imu or Imu()), allow_damaged=False)


def assert_in_si(found: RoleReadings) -> None:
    columns = found.imus[0].columns
    largest_radps = np.abs(columns.angular_rate_b).max()
    assert largest_radps == pytest.approx(RATE_RADPS, rel=1e-3)
    down_mps2 = np.median(columns.specific_force_b[:, 2])
    assert down_mps2 == pytest.approx(-GRAVITY_MPS2, rel=1e-2)


@pytest.mark.parametrize("unit", ANGULAR_RATE_UNITS)
def test_the_unit_of_rates_in_titles_counts(unit: str, tmp_path: Path) -> None:
    found = read(dive(tmp_path, "m/s2", unit))
    assert found.imus[0].settings.angular_rate_unit == unit
    assert_in_si(found)


@pytest.mark.parametrize("unit", ["mrad/s", "mdeg/s", "deg/h"])
def test_the_unit_of_rates_in_the_settings_counts(unit: str, tmp_path: Path) -> None:
    given = Imu(angular_rate_unit=unit)  # type: ignore[arg-type]
    found = read(dive(tmp_path, "m/s2", unit, title=""), given)
    assert found.imus[0].settings.angular_rate_unit == unit
    assert_in_si(found)


def test_fast_rates_of_no_stated_unit_are_in_degrees(tmp_path: Path) -> None:
    found = read(dive(tmp_path, "m/s2", "deg/s", title=""))
    assert found.imus[0].settings.angular_rate_unit == "deg/s"
    assert_in_si(found)


def test_a_stated_unit_in_which_no_vehicle_turns_so_fast_is_an_error(tmp_path: Path) -> None:
    folder = dive(tmp_path, "m/s2", "deg/s", title=" [rad/s]")
    with pytest.raises(LogError, match="in the unit that is stated") as raised:
        read(folder)
    assert 'imu.angular_rate_unit = "deg/s"' in raised.value.hint
    assert_in_si(read(folder, Imu(angular_rate_unit="deg/s")))


@pytest.mark.parametrize("unit", SPECIFIC_FORCE_UNITS)
def test_the_unit_of_forces_in_titles_counts(unit: str, tmp_path: Path) -> None:
    folder = dive(tmp_path, unit, "rad/s")
    proposed = {one.key: one.value for one in propose_settings(folder, Config()).settings}
    assert proposed["imu.specific_force_unit"] == unit
    found = read(folder)
    assert found.imus[0].settings.specific_force_unit == unit
    assert found.imus[0].settings.specific_force_scale == 1.0
    assert_in_si(found)
