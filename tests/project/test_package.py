"""The package as it is installed: what a wheel holds."""

import subprocess
import sys
import zipfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]


def test_wheel_holds_types_presets_and_message_definitions(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(PROJECT)]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    messages = (PROJECT / "schemas" / "insdvl_msgs" / "msg").glob("*.msg")
    definitions = (PROJECT / "insdvl_replay" / "logs" / "definitions").rglob("*.msg")
    wanted = {"insdvl_replay/py.typed", "insdvl_replay/presets/fog.toml", "insdvl_replay/show/page.css"}
    wanted |= {f"insdvl_replay/schemas/insdvl_msgs/msg/{path.name}" for path in messages}
    wanted |= {path.relative_to(PROJECT).as_posix() for path in definitions}
    assert wanted <= names
    assert not [name for name in names if name.startswith("tests/")]


def test_no_module_is_named_like_one_of_the_standard_library() -> None:
    names = {path.stem for path in (PROJECT / "insdvl_replay").rglob("*.py")}
    assert not (names - {"__future__", "__main__"}) & sys.stdlib_module_names
