"""Tests that were left out are told of in the last lines, with what brings them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from left_out import left_out

PROJECT = Path(__file__).parents[2]


def test_each_thing_that_is_missing_has_a_line() -> None:
    reasons = (
        ["Skipped: needs Chromium"]
        + ["Skipped: needs ../shared/a"] * 2
        + ["Skipped: only on the moon"]
    )
    logs, chromium, moon = left_out(reasons)
    assert logs.startswith("2 tests ")
    assert re.match(r"1 test .*Chromium .*`make extras`", chromium)
    assert re.match(r"1 test .*: only on the moon", moon)
    assert left_out([]) == []


@pytest.mark.nightly
@pytest.mark.parametrize("workers", ["0", "1"])
def test_where_there_is_neither_browser_nor_node_the_last_lines_say_so(
    workers: str, tmp_path: Path
) -> None:
    tests = [
        "tests/results/test_browser.py",
        "tests/results/test_elsewhere.py",
        "-k",
        "browser or print or foxgloves_libraries",
    ]
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "--numprocesses",
            workers,
            *tests,
        ],
        cwd=PROJECT,
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    chromium, node = sorted(done.stdout.splitlines()[-2:], key=lambda line: "node" in line)
    assert re.match(r"\d+ tests .*Chromium .*`make extras`", chromium)
    assert re.match(r"\d+ tests .*node .*`make extras`", node)
