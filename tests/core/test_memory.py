"""What the program asks of the system's memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from insdvl_replay.cli.messages import log_failure
from insdvl_replay.core import runtime
from insdvl_replay.core.errors import read_regular

LOG = Path(__file__).resolve().parents[2] / "sample_logs" / "straight.mcap"
INSPECT = """
import sys
from contextlib import suppress
from insdvl_replay.cli import main
sys.argv = ["insdvl-replay", "inspect", "--format", "json", sys.argv[1]]
with suppress(SystemExit):
    main()
from numpy._core.multiarray import _get_madvise_hugepage
sys.exit(int(_get_madvise_hugepage()))
"""


@pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux has huge pages that numpy asks for"
)
@pytest.mark.parametrize("wish", ["0", "1", None])
@pytest.mark.nightly
def test_numpy_asks_for_huge_pages_only_if_the_user_wants_it(wish: str | None) -> None:
    environment = {
        name: value for name, value in os.environ.items() if name != "NUMPY_MADVISE_HUGEPAGE"
    }
    if wish is not None:
        environment["NUMPY_MADVISE_HUGEPAGE"] = wish
    result = subprocess.run(
        [sys.executable, "-c", INSPECT, LOG], env=environment, capture_output=True, text=True
    )
    assert result.stdout.startswith("{"), result.stderr
    assert result.returncode == int(wish or "0")


def test_a_failure_for_want_of_memory_is_reported_as_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert log_failure(MemoryError("24 GiB"), 0) == 3
    assert "memory: 24 GiB; hint: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "is_lack"),
    [
        (MemoryError(), True),
        (SystemError("error return without exception set"), True),
        (ImportError("failed to map segment from shared object"), True),
        (OSError("Could not find/load shared object file"), True),
        (RuntimeError("can't start new thread"), True),
        (FileNotFoundError(2, "No such file or directory"), False),
        (KeyError("x"), False),
    ],
)
def test_errors_of_libraries_at_the_limit_are_a_lack_of_memory(
    error: Exception, is_lack: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime, "_most_taken", lambda: 500 << 20)
    monkeypatch.setattr(runtime, "memory_limit", lambda: 700 << 20)
    assert runtime.is_out_of_memory(error) is is_lack
    monkeypatch.setattr(runtime, "memory_limit", lambda: 2000 << 20)
    assert runtime.is_out_of_memory(error) is isinstance(error, MemoryError)
    monkeypatch.setattr(runtime, "memory_limit", lambda: None)
    assert runtime.is_out_of_memory(error) is isinstance(error, MemoryError)


def within(megabytes: int, *words: str, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a limit of its memory."""
    command = f'ulimit -v {megabytes * 1000}; exec "$@"'
    words = ("sh", "-c", command, "sh", sys.executable, "-m", "insdvl_replay", *words)
    return subprocess.run(words, env=os.environ | more, capture_output=True, text=True)


@pytest.mark.skipif(sys.platform != "linux", reason="macOS does not hold the limit")
def test_a_limit_that_is_too_low_for_the_libraries_is_said_before_they_are_loaded() -> None:
    done = within(400, "inspect", str(LOG))
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith(
        "error: there is not enough memory within the limit of 410 MB: at least "
    )
    assert "ulimit -v" in done.stderr


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="macOS does not hold the limit")
@pytest.mark.parametrize("command", ["run", "compile"])
def test_a_compiler_without_memory_is_said(command: str, tmp_path: Path) -> None:
    words = ["run", str(LOG), "-o", str(tmp_path / "out")] if command == "run" else ["compile"]
    done = within(700, *words, INSDVL_REPLAY_CACHE=str(tmp_path / "cache"))
    assert done.returncode == 3
    assert done.stderr.rpartition("error: ")[2].startswith("there is not enough memory")
    assert not (tmp_path / "out").exists()


def test_a_small_file_is_read_with_little_memory(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc")
    assert read_regular(tmp_path / "x", 1 << 62) == b"abc"
