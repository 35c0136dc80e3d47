"""The page of inputs is what the tables of the program say, and each file that is not read is told with its step."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import inputs
import numpy as np
import pytest
from typer.testing import CliRunner

from insdvl_replay.cli.app import app
from insdvl_replay.core.config import Config, Dvl, Imu
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.topics import TYPES
from insdvl_replay.logs.formats.known_formats import OTHER_FORMATS, OtherFormat, other_format

PAGE = inputs.PAGE.read_text("utf-8")
GROUPS = [types for name, types in TYPES.items() if name not in ("onboard", "solution")]


def test_page_is_current() -> None:
    assert inputs.written() == PAGE, "run `make inputs`"


def test_page_names_every_type_and_says_something_of_it() -> None:
    for known in GROUPS:
        for name, entry in known.items():
            assert f"`{name}`" in PAGE
            assert entry.about, name


def test_lines_for_arrays_write_a_dive(tmp_path: Path) -> None:
    (lines,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    subprocess.run([sys.executable, "-c", lines], cwd=tmp_path, check=True)
    imu = Imu(topic="dive.npz/imu", specific_force="acc", angular_rate="gyro")
    dive = read_dive(
        tmp_path / "dive.npz", Config(imu=imu, dvl=Dvl(topic="dive.npz/dvl", velocity="velocity"))
    )
    np.testing.assert_allclose(dive.imu.specific_force_b, np.tile([0.0, 0.0, -9.8], (1000, 1)))
    assert len(dive.dvl.time_ns) == 50


TLOG = (1_700_000_000_000_000).to_bytes(8, "big") + b"\xfd\x1c\x00\x00" + bytes(40)
FILES = [
    (known, bytes.fromhex(start) + bytes(60)) for known in OTHER_FORMATS for start in known.starts
] + [(known, TLOG) for known in OTHER_FORMATS if not known.starts]


@pytest.mark.parametrize(("known", "data"), FILES, ids=lambda value: getattr(value, "name", ""))
def test_file_that_is_not_read_is_reported_by_its_bytes_with_the_step_that_helps(
    known: OtherFormat, data: bytes, tmp_path: Path
) -> None:
    # Named like something else, where bytes alone tell.
    named_otherwise = "dive.csv" if known.any_name else "dive.mcap"
    tells = (
        known.starts and other_format(Path(named_otherwise), data) is known
    ) or ".tlog" in known.endings
    name = named_otherwise if tells else f"dive{known.endings[0]}"
    (tmp_path / name).write_bytes(data)
    with pytest.raises(LogError) as raised:
        read_dive(tmp_path / name, Config())
    assert f" {known.name}, " in raised.value.message
    assert raised.value.hint == known.step.format(path=tmp_path / name)


@pytest.mark.parametrize("command", ["run", "inspect"])
def test_commands_tell_it(command: str, tmp_path: Path) -> None:
    (tmp_path / "dive.tlog").write_bytes(TLOG)
    result: Any = CliRunner().invoke(app, [command, str(tmp_path / "dive.tlog")])
    text = " ".join((result.output + (result.stderr if result.stderr_bytes else "")).split())
    assert "a telemetry log of MAVLink" in text
    assert "LOG_REPLAY=1" in text


def test_other_bytes_are_no_known_format(tmp_path: Path) -> None:
    (tmp_path / "dive.mcap").write_bytes(b"\x00\x01\x02\x03" * 30)
    with pytest.raises(LogError, match="'00 01 02 03 "):
        read_dive(tmp_path / "dive.mcap", Config())
