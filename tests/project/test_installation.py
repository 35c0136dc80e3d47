"""From a checkout, pip, pipx and uv install a program that works without the checkout."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
INSTALLERS = ("pipx", "uv")
NEEDED = (
    "insdvl_replay",
    "schemas",
    "docs",
    "README.md",
    "LICENSE",
    "THIRD_PARTY.md",
    "pyproject.toml",
)

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a package is built of; the tools may write beside it."""
    place = tmp_path_factory.mktemp("checkout")
    for name in NEEDED:
        source = PROJECT / name
        if source.is_dir():
            shutil.copytree(source, place / name)
        else:
            shutil.copy(source, place)
    return place


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment with pipx and uv."""
    place = tmp_path_factory.mktemp("tools")
    subprocess.run([sys.executable, "-m", "venv", place], check=True)
    command = [place / "bin" / "python", "-m", "pip", "install", "--quiet", *INSTALLERS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("needs a package index, with pipx and uv")
    return place / "bin"


def works(program: Path, *command: str) -> str:
    """Run an installed program where there is no checkout, and return what it prints."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [program, *command],
            cwd=folder,
            env=environment | {"INSDVL_REPLAY_CACHE": str(Path(folder, "cache"))},
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_pip_installs_it(checkout: Path, tmp_path: Path) -> None:
    """Its packages are those of the tests, so that nothing is fetched; the demonstration needs no checkout."""
    environment = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    python = environment / "bin" / "python"
    [packages] = environment.glob("lib/python3.*/site-packages")
    (packages / "tests.pth").write_text(sysconfig.get_path("purelib"))
    command = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, checkout], check=True)
    program = environment / "bin" / "insdvl-replay"
    where = "import insdvl_replay; print(insdvl_replay.__file__)"
    assert works(python, "-P", "-c", where).startswith(str(packages))
    said = works(program, "demo")
    assert [word for word in ("BETTER", "WORSE", "NO EFFECT") if word not in said] == []
    assert works(program, "schema", "config").startswith("{")
    assert works(program, "schema", "insdvl_msgs/msg/NavSolution")


@pytest.mark.parametrize("name", INSTALLERS)
def test_tools_install_it(name: str, checkout: Path, tools: Path, tmp_path: Path) -> None:
    folders = ("PIPX_HOME", "PIPX_BIN_DIR", "PIPX_MAN_DIR", "UV_TOOL_DIR", "UV_TOOL_BIN_DIR")
    own = {folder: str(tmp_path / folder) for folder in (*folders, "UV_CACHE_DIR")}
    words = {"pipx": ["pipx", "install"], "uv": ["uv", "tool", "install"]}[name]
    environment = os.environ | own | {"PATH": f"{tools}:{os.environ['PATH']}"}
    subprocess.run(
        [tools / words[0], *words[1:], "--python", sys.executable, checkout],
        cwd=tmp_path,
        env=environment,
        check=True,
        capture_output=True,
    )
    program = tmp_path / {"pipx": "PIPX_BIN_DIR", "uv": "UV_TOOL_BIN_DIR"}[name] / "insdvl-replay"
    assert works(program, "--version").startswith("insdvl-replay ")
    assert "BETTER" in works(program, "demo")
    # What is missing is installed by the command in the hint.
    table = tmp_path / "imu.parquet"
    table.write_bytes(b"PAR1" * 100)
    command = [program, "inspect", table]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    hint = refused.stderr.partition("; hint: ")[2].strip()
    assert hint.startswith(name)
    subprocess.run(
        ["bash", "-c", hint], cwd=tmp_path, env=environment, check=True, capture_output=True
    )
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "pyarrow" not in again.stderr
