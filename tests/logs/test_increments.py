"""An IMU that gives increments over an interval is that of the rates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl_replay.checks.imu import imu_remarks
from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.roles import read_roles
from insdvl_replay.logs import read_dive

STEP_S, COUNT = 0.02, 400
FORCE, RATE = "ax, ay, az", "gx, gy, gz"
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")


def readings() -> np.ndarray:
    """Specific force and angular rate of a vehicle that rolls a little."""
    return np.random.default_rng(5).normal([0.0, 0.0, -9.8, 0.0, 0.0, 0.05], 0.02, (COUNT, 6))


def dive(folder: Path, factor: float, units: tuple[str, str] = ("", ""), dt: str = "") -> Path:
    """Write tables of readings times a factor, which may have the column of an interval."""
    folder.mkdir(exist_ok=True)
    time_s = STEP_S * np.arange(COUNT)
    titles = ",".join(
        ["t", *(f"a{x}{units[0]}" for x in "xyz"), *(f"g{x}{units[1]}" for x in "xyz")]
    )
    columns = [time_s, readings() * factor, np.full(COUNT, STEP_S * (1e3 if "ms" in dt else 1.0))][
        : 3 if dt else 2
    ]
    form = {"fmt": "%.17g", "delimiter": ",", "comments": ""}
    np.savetxt(
        folder / "imu.csv", np.column_stack(columns), header=f"{titles},{dt}".strip(","), **form
    )  # type: ignore[call-overload]
    rng = np.random.default_rng(6)
    pings = np.column_stack([time_s[::20], rng.normal([1.0, 0.0, 0.0], 0.1, (COUNT // 20, 3))])
    np.savetxt(folder / "dvl.csv", pings, header="t,vx,vy,vz", **form)  # type: ignore[call-overload]
    return folder


def imu(**settings: Any) -> Imu:
    return Imu(topic="imu.csv", specific_force=FORCE, angular_rate=RATE, **settings)


@pytest.mark.parametrize(
    ("units", "dt", "increment_s"),
    [
        (("", ""), "", STEP_S),
        ((" [m/s]", " [rad]"), "", STEP_S),
        (("", ""), "dt", "dt"),
        (("", ""), "dt [ms]", "dt"),
    ],
)
def test_increments_are_the_rates(
    tmp_path: Path, units: tuple[str, str], dt: str, increment_s: float | str
) -> None:
    rates = read_dive(dive(tmp_path / "rates", 1.0), Config(imu=imu(), dvl=DVL)).imu
    folder = dive(tmp_path / "increments", STEP_S, units, dt)
    found = read_dive(folder, Config(imu=imu(increment_s=increment_s), dvl=DVL)).imu
    np.testing.assert_array_equal(found.time_ns, rates.time_ns)
    np.testing.assert_allclose(found.specific_force_b, rates.specific_force_b, rtol=1e-12)
    np.testing.assert_allclose(found.angular_rate_b, rates.angular_rate_b, rtol=1e-12)


def test_increments_in_degrees_are_rates_in_radians(tmp_path: Path) -> None:
    folder = dive(tmp_path / "dive", STEP_S, (" [m/s]", " [deg]"))
    found = read_dive(folder, Config(imu=imu(increment_s=STEP_S), dvl=DVL)).imu
    np.testing.assert_allclose(found.angular_rate_b, np.radians(readings()[:, 3:]), rtol=1e-12)


def test_a_unit_of_increments_names_the_key_of_their_interval(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is in 'm/s'") as raised:
        read_dive(
            dive(tmp_path / "dive", STEP_S, (" [m/s]", " [rad]")), Config(imu=imu(), dvl=DVL)
        )
    assert "imu.increment_s" in raised.value.hint


def test_increments_that_are_read_as_rates_are_named(tmp_path: Path) -> None:
    folder = dive(tmp_path / "dive", STEP_S)
    found = read_dive(folder, Config(imu=imu(), dvl=DVL)).imu
    hints = [
        remark.hint
        for remark in imu_remarks("dive", found, None, imu())
        if isinstance(remark, LogError)
    ]
    assert hints == ["it is 0.02 times gravity: increments over 0.02 s? imu.increment_s = 0.02"]


def test_increments_are_found_by_the_size_of_gravity(tmp_path: Path) -> None:
    read = read_roles(dive(tmp_path / "dive", STEP_S), Config(), allow_damaged=False)
    assert [found.settings.increment_s for found in read.imus] == [STEP_S]
    np.testing.assert_allclose(
        read.imus[0].columns.specific_force_b, readings()[:, :3], rtol=1e-12
    )
