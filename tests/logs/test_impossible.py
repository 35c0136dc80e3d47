"""Readings that cannot be are missing, however many there are, and their values are named."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from insdvl_replay.core.config import Config, Depth, Dvl, Evaluation, Filter, Imu, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive

ROWS = 100
CONFIG = Config(
    imu=Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz"),
    dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz"),
    reference=Reference(
        topic="fix.csv", latitude="lat", longitude="lon", height="height", velocity_n="vn, ve, vd", roll="roll",
        pitch="pitch", heading="yaw",
    ),
    depth=Depth(topic="fix.csv", depth="depth"),
    filters={"baseline": Filter(aiding=("velocity",)), "aided": Filter(aiding=("velocity", "depth"))},
    evaluation=Evaluation(starts=1),
)  # fmt: skip
TITLES = {
    "imu": "t,ax,ay,az,gx,gy,gz",
    "dvl": "t,vx,vy,vz",
    "fix": "t,lat,lon,height,vn,ve,vd,roll,pitch,yaw,depth",
}
USUAL = {
    "imu": [0.0, 0.0, -9.8, 0.0, 0.0, 0.0],
    "dvl": [1.0, 0.1, 0.0],
    "fix": [57.0, 10.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 30.0, 5.0],
}


def dive_with(
    folder: Path, table: str, column: int, rows: NDArray[np.int64], values: list[float]
) -> Dive:
    """Read a dive of tables in which some cells are replaced."""
    rng = np.random.default_rng(1)
    for name, usual in USUAL.items():
        cells = rng.normal(usual, 0.001, (ROWS, len(usual)))
        if name == table:
            cells[rows, column] = np.resize(values, len(rows))
        lines = [
            ",".join([f"{0.1 * row:.1f}", *map(repr, numbers)])
            for row, numbers in enumerate(cells.tolist())
        ]
        (folder / f"{name}.csv").write_text("\n".join([TITLES[name], *lines, ""]))
    return read_dive(folder, CONFIG)


@pytest.mark.parametrize(
    ("table", "column", "value", "code", "shown"),
    [
        ("dvl", 0, 999.999, "dvl_impossible", "above 20 m/s (999.999)"),
        ("dvl", 2, -327.68, "dvl_impossible", "above 20 m/s (327.68)"),
        (
            "imu",
            2,
            -9999.0,
            "imu_impossible",
            "above 50 g or 2000 deg/s, or zero in all six readings (9999)",
        ),
        ("fix", 0, 91.0, "reference_impossible", "beyond the poles, in degrees (91)"),
        ("fix", 1, -999.0, "reference_impossible", 'mean "no value" (999)'),
        (
            "fix",
            2,
            -9999.0,
            "reference_impossible",
            "heights are of no water on Earth, in metres (9999)",
        ),
        ("fix", 4, 99.99, "reference_impossible", "above 20 m/s (99.99)"),
        ("fix", 8, 9999.0, "reference_impossible", 'mean "no value" (9999)'),
        ("fix", 9, 99999.0, "depth_impossible", "of no water on Earth, in metres (99999)"),
    ],
)
@pytest.mark.parametrize("count", [8, 60])
def test_a_number_that_stands_for_none_is_missing(
    tmp_path: Path, table: str, column: int, value: float, code: str, shown: str, count: int
) -> None:
    rows = np.random.default_rng(count).permutation(ROWS)[:count]
    dive = dive_with(tmp_path, table, column, rows, [value])
    (note,) = [note for note in dive.notes if note.code == code]
    assert (note.count, note.severity) == (count, "warning")
    assert shown in note.text
    assert np.abs(dive.dvl.velocity_d).max() < 2.0
    assert np.abs(dive.imu.specific_force_b).max() < 20.0
    assert dive.reference is not None
    known = dive.reference.known
    lost = {"dvl": len(dive.dvl.time_ns), "imu": len(dive.imu.time_ns)}.get(table)
    if table == "fix":
        lost = len(dive.sensors["depth"].time_ns) if column == 9 else min(
            [*(int(np.count_nonzero(known[name])) for name in ("positions", "velocities", "attitudes")),
             int(np.isfinite(dive.reference.position[:, 2]).sum())]
        )  # fmt: skip
    assert lost == ROWS - count


def test_different_impossible_velocities_are_missing_unless_they_are_most(tmp_path: Path) -> None:
    some = dive_with(tmp_path, "dvl", 0, np.arange(0, 80, 2), [21.0, 35.0, 400.0])
    (note,) = [note for note in some.notes if note.code == "dvl_impossible"]
    assert (note.count, len(some.dvl.time_ns)) == (40, 60)
    assert "(21 to 400)" in note.text
    assert "dvl.velocity_unit" in note.hint
    most = dive_with(tmp_path, "dvl", 0, np.arange(60), [1000.0, 1001.0, 999.0])
    assert len(most.dvl.time_ns) == ROWS  # for the check of the unit
    with pytest.raises(LogError, match=r"no message of 100 can be used.*\(999\)"):
        dive_with(tmp_path, "dvl", 0, np.arange(ROWS), [999.0])
