"""Flags of pings in tables: which columns they are, what they mean, and that none is left out in silence."""

from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.flags import flag_columns, marks_some, says_valid

COUNT = 60
BAD = np.arange(COUNT) % 5 == 2
IMU = Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz")
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")
CODES = [str(int(not bad)) for bad in BAD]


def velocities(how: str) -> np.ndarray:
    """Velocities of which every fifth is wrong in a way."""
    time_s = np.arange(COUNT)
    true = np.column_stack(
        [1.0 + 0.1 * np.sin(0.1 * time_s), 0.1 * np.cos(0.1 * time_s), 0.01 * np.sin(time_s)]
    )
    wrong = {
        "missing": np.nan,
        "zero": 0.0,
        "sentinel": -32.768,
        "scattered": true[BAD] + [0.15, -0.1, 0.0],
    }
    true[BAD] = wrong.get(how, true[BAD])
    return true


def dive(folder: Path, title: str, cells: list[str], how: str = "scattered") -> Path:
    """Write a folder of tables whose DVL has a column beside its velocity."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(2)
    imu = np.column_stack(
        [0.02 * np.arange(3000), rng.normal([0, 0, -9.8, 0, 0, 0], 0.01, (3000, 6))]
    )
    np.savetxt(folder / "imu.csv", imu, "%.6f", ",", header="time,ax,ay,az,gx,gy,gz", comments="")
    rows = zip(range(COUNT), velocities(how).tolist(), cells, strict=True)
    lines = [f"{i},{v[0]},{v[1]},{v[2]},{cell}".replace("nan", "") for i, v, cell in rows]
    (folder / "dvl.csv").write_text("\n".join([f"time,vx,vy,vz,{title}", *lines, ""]))
    return folder


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "valid") for name in ("valid", "is_valid", "bottom_lock", "bt_lock", "vel_valid", "velocityValid")),
        *((name, "valid") for name in ("status.xvelocityvalid", "isvalid", "dvl_valid_flag", "data_ok", "lock")),
        *((name, "invalid") for name in ("invalid", "is_bad", "bt_lost", "no_lock", "not_valid")),
        *((name, "unsure") for name in ("status", "dvl_status", "quality", "flag", "bt_quality", "error")),
        *((name, "") for name in ("gps_valid", "imu_status", "fix_quality", "beam_1_valid", "b2_lock", "vx")),
    ],
)  # fmt: skip
def test_columns_of_flags_are_known_by_name(name: str, kind: str) -> None:
    found = flag_columns(["vx", name])
    assert found.names == ((name,) if kind else ())
    assert not kind or getattr(found, kind) == (name,)


@pytest.mark.parametrize("how", ["missing", "zero", "sentinel", "scattered"])
def test_pings_say_what_a_status_means(how: str) -> None:
    good = np.where(BAD, 0.0, 1.0)
    assert says_valid(good, velocities(how)) is True
    assert says_valid(3.0 * BAD, velocities(how)) is False
    assert says_valid(np.roll(good, 1), velocities("none")) is None
    assert says_valid(np.ones(COUNT), velocities(how)) is None


def test_a_flag_says_nothing_where_all_pings_have_the_same() -> None:
    assert marks_some(np.ones(9), is_sure=True) == marks_some(np.zeros(9), is_sure=False) == 0
    assert marks_some(np.array([1.0, 0.0, np.nan, 1.0]), is_sure=True) == 2
    assert marks_some(np.array([2.0, 1.0, 1.0, 1.0]), is_sure=False) == 1
    assert marks_some(np.linspace(0.1, 99.9, 50), is_sure=False) == 0


@pytest.mark.parametrize(
    ("title", "cells", "key"),
    [
        ("valid", CODES, "valid"),
        ("Is Valid", [{"1": "true", "0": "false"}[code] for code in CODES], "valid"),
        ("Bottom Lock", [{"1": "yes", "0": "no"}[code] for code in CODES], "valid"),
        ("Status", CODES, "valid"),
        ("status", [{"1": "0", "0": "7"}[code] for code in CODES], "invalid"),
        ("invalid", [{"1": "FALSE", "0": "TRUE"}[code] for code in CODES], "invalid"),
        ("status", [{"1": "A", "0": "V"}[code] for code in CODES], "valid"),
    ],
)
def test_flags_are_proposed_and_leave_their_pings_out(
    tmp_path: Path, title: str, cells: list[str], key: str
) -> None:
    folder = dive(tmp_path / "dive", title, cells)
    name = title.lower().replace(" ", "_")
    found = {setting.key: setting.value for setting in propose_settings(folder, Config()).settings}
    assert found[f"dvl.{key}"] == name
    read = read_dive(
        folder, Config(imu=IMU, dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz", **{key: name}))
    )
    np.testing.assert_array_equal(read.dvl.time_ns, 10**9 * np.flatnonzero(~BAD))
    assert "dvl_unused_flag" not in {note.code for note in read.notes}


@pytest.mark.parametrize("title", ["valid", "status"])
def test_a_flag_that_no_setting_names_is_a_warning(tmp_path: Path, title: str) -> None:
    (note,) = (
        note
        for note in read_dive(
            dive(tmp_path / "dive", title, CODES, "none"), Config(imu=IMU, dvl=DVL)
        ).notes
        if note.code == "dvl_unused_flag"
    )
    assert (note.count, note.severity) == (np.count_nonzero(BAD), "warning")
    assert f'dvl.valid = "{title}"' in note.hint


def test_a_flag_that_is_never_0_has_to_be_written_anew(tmp_path: Path) -> None:
    """Settings compare a flag with 0 alone, so that naming this one would leave no ping out."""
    quality = [{"1": "95", "0": "3"}[code] for code in CODES]
    read = read_dive(dive(tmp_path / "dive", "quality", quality), Config(imu=IMU, dvl=DVL))
    (note,) = (note for note in read.notes if note.code == "dvl_unused_flag")
    assert note.count == np.count_nonzero(BAD)
    assert note.hint == "write a column that is 0 where a ping is bad, and name it as dvl.valid"


def test_a_status_that_nothing_explains_is_open(tmp_path: Path) -> None:
    settings = propose_settings(
        dive(tmp_path / "dive", "status", CODES, "none"), Config()
    ).settings
    (open_one,) = (setting for setting in settings if setting.key == "dvl.valid")
    assert open_one.value is None
    assert '"status"' in open_one.open
