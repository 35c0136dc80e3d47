"""Units of tables: the title of a column says in which unit it is read, unless a setting does."""

from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Depth, Dvl, Imu, Reference
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.units import (
    ANGULAR_RATE_UNITS,
    PRESSURE_UNITS,
    SPECIFIC_FORCE_UNITS,
    VELOCITY_UNITS,
    unit_of,
)
from insdvl_replay.logs import read_dive

COUNT = 40
IMU = Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz")
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")


def table(path: Path, titles: list[str], values: list[float]) -> None:
    """Write a table with these values in each row, but for a small step by which no two rows are the same."""
    rows = [[0.1 * i, *(value * (1.0 + 1e-6 * i) for value in values)] for i in range(COUNT)]
    lines = [",".join(["t", *titles]), *(",".join(map(repr, row)) for row in rows), ""]
    path.write_text("\n".join(lines))


def dive(folder: Path, force: str = "", rate: str = "", velocity: str = "") -> Path:
    """Write an IMU and a DVL whose numbers are 2, in the units of these endings of titles."""
    table(
        folder / "imu.csv",
        [f"a{x}{force}" for x in "xyz"] + [f"g{x}{rate}" for x in "xyz"],
        [2.0] * 6,
    )
    table(folder / "dvl.csv", [f"v{x}{velocity}" for x in "xyz"], [2.0] * 3)
    return folder


@pytest.mark.parametrize(
    ("title", "unit"),
    [
        ("v (kn)", "kn"), ("v [Knots]", "kn"), ("v_kts", "kn"), ("v [ft/s]", "ft/s"), ("v (fps)", "ft/s"),
        ("v [meters per minute]", "m/min"), ("v [m min-1]", "m/min"),
        ("v [km/h]", "km/h"), ("v [mm/s]", "mm/s"), ("v [cm/s]", "cm/s"), ("v_mps", "m/s"), ("v (m s-1)", "m/s"),
        ("v (m s^-1)", "m/s"), ("w [deg/h]", "deg/h"), ("w [°/hr]", "deg/h"), ("w (dps)", "deg/s"),
        ("w [deg/sec]", "deg/s"),
        ("w [degrees/second]", "deg/s"), ("w (radians per second)", "rad/s"), ("a [mg]", "mg"), ("a [µg]", "ug"),
        ("a [m/s²]", "m/s2"), ("a (m*s^-2)", "m/s2"), ("a (G)", "g"), ("p [kPa]", "kPa"), ("p [psi]", "psi"),
        ("lat [°]", "deg"), ("h [feet]", "ft"), ("Time (days)", "d"), ("Time [hours]", "h"), ("Time (UTC)", ""),
        ("Time (HH:MM:SS)", ""), ("v (forward)", ""), ("v", ""), ("v [yd/s]", "yd/s"),
    ],
)  # fmt: skip
def test_titles_spell_units_in_many_ways(title: str, unit: str) -> None:
    assert unit_of(title) == unit


@pytest.mark.parametrize(
    ("section", "key", "units"),
    [
        (Imu, "specific_force_unit", SPECIFIC_FORCE_UNITS),
        (Imu, "angular_rate_unit", ANGULAR_RATE_UNITS),
        (Dvl, "velocity_unit", VELOCITY_UNITS),
        (Depth, "pressure_unit", PRESSURE_UNITS),
    ],
)
def test_settings_take_all_units_that_titles_may_have(
    section: type, key: str, units: dict[str, float]
) -> None:
    options = [
        part for part in get_args(get_type_hints(section)[key]) if get_origin(part) is Literal
    ]
    assert [get_args(option) for option in options] == [tuple(units)]


@pytest.mark.parametrize(
    ("titles", "factors"),
    [
        (
            {"force": " [mg]", "rate": " [deg/h]", "velocity": " (kn)"},
            (9.80665e-3, np.pi / 648_000, 0.514444444),
        ),
        (
            {"force": " [ug]", "rate": " [dps]", "velocity": " [ft/s]"},
            (9.80665e-6, np.pi / 180, 0.3048),
        ),
        ({"velocity": " [km/h]"}, (1.0, 1.0, 1.0 / 3.6)),
        ({"velocity": "_mmps"}, (1.0, 1.0, 1e-3)),
    ],
)
def test_units_in_titles_count_where_settings_name_the_columns(
    tmp_path: Path, titles: dict[str, str], factors: tuple[float, float, float]
) -> None:
    velocity = ", ".join(f"v{x}{titles['velocity']}" for x in "xyz")  # a title names a column, too
    found = read_dive(
        dive(tmp_path, **titles), Config(imu=IMU, dvl=Dvl(topic="dvl.csv", velocity=velocity))
    )
    assert found.dvl.velocity_d is not None
    columns = (found.imu.specific_force_b, found.imu.angular_rate_b, found.dvl.velocity_d)
    for readings, factor in zip(columns, factors, strict=True):
        np.testing.assert_allclose(readings[0], 2.0 * factor, rtol=1e-8)


def test_a_unit_in_the_settings_counts_more_than_the_title(tmp_path: Path) -> None:
    settings = Config(
        imu=IMU, dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz", velocity_unit="m/s")
    )
    found = read_dive(dive(tmp_path, velocity=" [yd/s]"), settings)
    assert found.dvl.velocity_d is not None
    assert found.dvl.velocity_d[0, 0] == 2.0


def test_angles_of_one_table_may_have_several_units(tmp_path: Path) -> None:
    titles = [
        "lat [rad]",
        "lon [deg]",
        "depth [ft]",
        "vn (kn)",
        "ve (kn)",
        "vd (kn)",
        "roll",
        "pitch",
        "yaw [rad]",
    ]
    table(dive(tmp_path) / "nav.csv", titles, [0.5, 30.0, 10.0, 2.0, 2.0, 2.0, 0.0, 0.0, 1.5])
    reference = Reference(
        topic="nav.csv", latitude="lat", longitude="lon", depth="depth", velocity_n="vn, ve, vd", roll="roll",
        pitch="pitch", heading="yaw",
    )  # fmt: skip
    found = read_dive(tmp_path, Config(imu=IMU, dvl=DVL, reference=reference)).reference
    assert found is not None
    np.testing.assert_allclose(found.position[0], [0.5, np.radians(30.0), -3.048], rtol=1e-12)
    np.testing.assert_allclose(found.velocity_n[0], 2.0 * 1852.0 / 3600.0, rtol=1e-12)
    np.testing.assert_allclose(found.mat_nb[0, 1, 0], np.sin(1.5), rtol=1e-12)


@pytest.mark.parametrize("unit", ["yd/s", "deg", "furlong"])
def test_an_unknown_unit_that_is_used_is_an_error_with_the_known_ones(
    tmp_path: Path, unit: str
) -> None:
    with pytest.raises(LogError, match=rf"'vx' of dvl\.csv is in '{unit}'") as raised:
        read_dive(dive(tmp_path, velocity=f" [{unit}]"), Config(imu=IMU, dvl=DVL))
    assert "km/h, kn, ft/s" in raised.value.hint
    assert "dvl.velocity_unit" in raised.value.hint
