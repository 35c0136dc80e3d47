"""What the program asks of the system's memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

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
FAIL = """
import resource
import sys
from insdvl_replay.cli.messages import log_failure
from insdvl_replay.core.runtime import _most_mapped
most = _most_mapped() + (int(sys.argv[1]) << 20)
resource.setrlimit(resource.RLIMIT_AS, (most, most))
sys.exit(log_failure(ImportError("no segment"), 0))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has huge pages that numpy asks for")
@pytest.mark.parametrize("wish", ["0", "1", None])
def test_numpy_asks_for_huge_pages_only_if_the_user_wants_it(wish: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "NUMPY_MADVISE_HUGEPAGE"}
    if wish is not None:
        environment["NUMPY_MADVISE_HUGEPAGE"] = wish
    result = subprocess.run([sys.executable, "-c", INSPECT, LOG], env=environment, capture_output=True, text=True)
    assert result.stdout.startswith("{"), result.stderr
    assert result.returncode == int(wish or "0")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells how much address space was used")
@pytest.mark.parametrize(("room_mb", "code"), [(100, 3), (1000, 4)])
def test_a_failure_where_memory_has_ended_is_one_of_memory(room_mb: int, code: int) -> None:
    command = [sys.executable, "-c", FAIL, str(room_mb)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == code, result.stderr
    assert ("memory" in result.stderr) == (code == 3)
