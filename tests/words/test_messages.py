"""The wording of what is said on screens and in errors and notes: each sentence stands in one golden file.

The other tests ask for codes, values and keys. ``make golden`` writes the files of this folder and the screens anew.
"""

import os
import sys
import tempfile
from collections.abc import Callable
from difflib import unified_diff
from pathlib import Path

import pytest
from as_text import Cases, golden_text
from said_by_checks import said_by_checks
from said_by_commands import said_by_commands
from said_of_filters import said_of_filters
from said_of_gates import said_of_gates
from said_of_logs import said_of_logs
from said_of_own_code import said_of_own_code
from said_of_results import said_of_results
from said_of_settings import said_of_settings
from said_of_shards import said_of_shards
from said_of_trajectories import said_of_trajectories

GOLDEN = Path(__file__).parent / "golden"
AREAS: dict[str, Callable[[Path], Cases]] = {
    "checks": said_by_checks,
    "commands": said_by_commands,
    "filters": said_of_filters,
    "gates": said_of_gates,
    "logs": said_of_logs,
    "own_code": said_of_own_code,
    "results": said_of_results,
    "settings": said_of_settings,
    "shards": said_of_shards,
    "trajectories": said_of_trajectories,
}


@pytest.mark.parametrize("area", AREAS)
def test_what_is_said_is_what_was_read_and_found_good(area: str, tmp_path: Path) -> None:
    said = golden_text(AREAS[area](tmp_path), tmp_path)
    stored = (GOLDEN / f"{area}.txt").read_text("utf-8")
    moved = "\n".join(
        unified_diff(
            stored.splitlines(), said.splitlines(), "stored", "said now", lineterm="", n=2
        )
    )
    assert not moved, f"{moved}\n`make golden` stores what is said now"


def test_no_case_is_there_twice() -> None:
    for area in AREAS:
        names = [
            line
            for line in (GOLDEN / f"{area}.txt").read_text("utf-8").splitlines()
            if line.startswith("=== ")
        ]
        assert len(names) == len(set(names)), area


if __name__ == "__main__":
    os.environ["COLUMNS"] = "10000"  # as in conftest.py
    for area_, cases in AREAS.items():
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder).resolve()
            (GOLDEN / f"{area_}.txt").write_text(golden_text(cases(place), place), "utf-8")
        sys.stdout.write(f"{area_} ")
    sys.stdout.write("\n")
