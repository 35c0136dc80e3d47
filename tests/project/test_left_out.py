"""Tests that were left out are told of in the last lines, with what brings them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from left_out import left_out

PROJECT = Path(__file__).parents[2]


def test_each_thing_that_is_missing_has_a_line() -> None:
    reasons = ["Skipped: needs Chromium"] + ["Skipped: needs ../shared/a"] * 2 + ["Skipped: only on the moon"]
    assert left_out(reasons) == [
        "2 tests were left out: they need recorded logs and published tables that are not part of the project",
        "1 test was left out: Chromium is missing; `make extras` brings it",
        "1 test was left out: only on the moon",
    ]
    assert left_out([]) == []


@pytest.mark.nightly
@pytest.mark.parametrize("workers", ["0", "1"])
def test_where_there_is_neither_browser_nor_node_the_last_lines_say_so(workers: str, tmp_path: Path) -> None:
    tests = [
        "tests/results/test_browser.py",
        "tests/results/test_elsewhere.py",
        "-k",
        "browser or print or foxgloves_libraries",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--numprocesses", workers, *tests],
        cwd=PROJECT,
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert sorted(line.partition(" ")[2] for line in done.stdout.splitlines()[-2:]) == [
        "tests were left out: Chromium is missing; `make extras` brings it",
        "tests were left out: node is missing, or its libraries; `make extras` brings them",
    ]
