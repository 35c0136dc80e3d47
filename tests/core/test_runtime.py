"""Compiled code is made once, ahead if wanted, by any number of processes at once, and is found where it was left."""

import ast
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numba
import pytest

from insdvl_replay.cli.screen import compiling
from insdvl_replay.core import runtime
from insdvl_replay.nav import filter as nav_filter

PROCESSES = 4
SAMPLES = Path(__file__).resolve().parents[2] / "sample_logs"


def started(cache: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "insdvl_replay", *arguments]
    environment = os.environ | {"INSDVL_REPLAY_CACHE": str(cache)}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_what_is_inlined_divides_as_numpy_does_and_is_python_where_python_calls_it() -> None:
    @runtime.inlined
    def ratio(one: float, other: float) -> float:
        return one / other

    through = numba.njit(error_model="numpy")(lambda one, other: ratio(one, other))
    assert through(1.0, 0.0) == math.inf
    with pytest.raises(ZeroDivisionError):
        ratio(1.0, 0.0)


@pytest.mark.nightly
def test_processes_that_start_at_once_compile_side_by_side_and_agree(tmp_path: Path) -> None:
    log = str(SAMPLES / "straight.mcap")
    runs = [
        started(tmp_path / "cache", "run", log, "-o", str(tmp_path / f"{i}"))
        for i in range(PROCESSES)
    ]
    for run in runs:
        _, errors = run.communicate()
        assert run.returncode == 0, errors
    tables = {
        (tmp_path / f"{i}" / "straight" / "improvement.csv").read_bytes() for i in range(PROCESSES)
    }
    assert len(tables) == 1
    again = started(tmp_path / "cache", "compile")
    assert "already" in again.communicate()[0]


@pytest.mark.nightly
def test_compile_says_where_the_code_is_and_how_long_it_took(tmp_path: Path) -> None:
    printed, errors = started(tmp_path, "compile").communicate()
    (folder,) = (path for path in tmp_path.iterdir() if any(path.rglob("*")))
    assert re.fullmatch(rf"compiled in \d+\.\d s: {re.escape(str(folder))}\n", printed), errors
    assert re.fullmatch(
        rf".*already.*: {re.escape(str(folder))}\n", started(tmp_path, "compile").communicate()[0]
    )


def test_compile_without_a_place_for_the_code_is_a_users_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    process = started(tmp_path / "file" / "cache", "compile")
    _, errors = process.communicate()
    assert process.returncode == 2
    assert str(tmp_path / "file") in errors
    assert "INSDVL_REPLAY_CACHE=" in errors


def test_where_code_cannot_be_kept_a_run_warns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compiling() == "" or "warning" not in capsys.readouterr().err
    (tmp_path / "file").touch()
    monkeypatch.setenv("INSDVL_REPLAY_CACHE", str(tmp_path / "file"))
    compiling()
    said = capsys.readouterr().err
    assert said.startswith("warning: ")
    assert f"{tmp_path}/file " in said
    assert "INSDVL_REPLAY_CACHE=" in said


# Code on a disk that is not to be relied on

SQUARES = """
import sys
from insdvl_replay.core.runtime import cache_folder, compiled

@compiled
def square(number):
    return number * number

assert square(3.0) == 9.0
print(sum(square.stats.cache_hits.values()), cache_folder())
"""


def squares(cache: Path, script: Path) -> tuple[int, str]:
    """Compile a small function in a process of its own: how often it came from the disk, and where that is."""
    if not script.exists():
        script.write_text(SQUARES)
    environment = os.environ | {"INSDVL_REPLAY_CACHE": str(cache)}
    done = subprocess.run(
        [sys.executable, script], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    hits, folder = done.stdout.split()
    return int(hits), folder


PLACE_OF_FILTER = """
from insdvl_replay.nav import filter
print(filter.__file__, filter._run._cache.cache_path)
"""


def test_code_is_found_again_wherever_the_package_is_installed(tmp_path: Path) -> None:
    """It is known by the digest of its sources: a second environment with the same ones compiles nothing."""
    package = Path(runtime.__file__).parents[1]
    shutil.copytree(package, tmp_path / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-c", PLACE_OF_FILTER]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    file, place = done.stdout.split()
    assert Path(file).is_relative_to(tmp_path)
    assert place == nav_filter._run._cache.cache_path  # type: ignore[attr-defined]


def files_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:50])


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.nightly
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("damage", [cut, empty, Path.unlink])
def test_damaged_code_is_compiled_again_and_mended(
    damage: Callable[[Path], None], which: int, tmp_path: Path
) -> None:
    cache, script = tmp_path / "cache", tmp_path / "script.py"
    assert squares(cache, script)[0] == 0
    index_and_code = files_in(cache)
    assert len(index_and_code) == 2
    damage(index_and_code[which])
    assert squares(cache, script)[0] == 0
    assert squares(cache, script)[0] == 1


def test_a_full_disk_costs_the_time_to_compile(tmp_path: Path) -> None:
    """No file can be larger than nothing."""
    script = tmp_path / "script.py"
    script.write_text(
        "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n" + SQUARES
    )
    assert squares(tmp_path / "cache", script)[0] == 0
    assert files_in(tmp_path / "cache") == []


@pytest.mark.nightly
def test_code_in_a_folder_that_cannot_be_written_is_used(tmp_path: Path) -> None:
    cache, script = tmp_path / "cache", tmp_path / "script.py"
    squares(cache, script)
    folders = [cache, *(path for path in cache.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    assert squares(cache, script)[0] == 1
    for folder in folders:
        folder.chmod(0o755)


def test_machine_code_is_known_by_all_that_it_is_made_of() -> None:
    """What compiled functions use of other modules has to be among the sources that name their folder."""
    package = Path(runtime.__file__).parents[1]
    covered = {path for pattern in runtime._COMPILED_SOURCES for path in package.glob(pattern)}
    for path in package.rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        functions = [
            node for node in tree.body if isinstance(node, ast.FunctionDef) and _is_compiled(node)
        ]
        if not functions:
            continue
        assert path in covered, path
        used = {
            name.id
            for function in functions
            for name in ast.walk(function)
            if isinstance(name, ast.Name)
        }
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and used & {alias.name for alias in node.names}:
                module = package.joinpath(*str(node.module).split(".")[1:]).with_suffix(".py")
                assert not module.is_file() or module in covered | {
                    package / "core" / "dive_columns.py"
                }, (
                    path,
                    module,
                )


def _is_compiled(function: ast.FunctionDef) -> bool:
    return any(
        isinstance(one, ast.Name) and one.id in ("compiled", "inlined")
        for one in function.decorator_list
    )
