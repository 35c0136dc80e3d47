"""What the program asks of the system's memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from insdvl_replay.cli.messages import log_failure

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


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has huge pages that numpy asks for")
@pytest.mark.parametrize("wish", ["0", "1", None])
def test_numpy_asks_for_huge_pages_only_if_the_user_wants_it(wish: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "NUMPY_MADVISE_HUGEPAGE"}
    if wish is not None:
        environment["NUMPY_MADVISE_HUGEPAGE"] = wish
    result = subprocess.run([sys.executable, "-c", INSPECT, LOG], env=environment, capture_output=True, text=True)
    assert result.stdout.startswith("{"), result.stderr
    assert result.returncode == int(wish or "0")


def test_a_failure_for_want_of_memory_is_reported_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert log_failure(MemoryError("24 GiB"), 0) == 3
    assert "memory: 24 GiB; hint: " in capsys.readouterr().err
