"""What several tests share."""

import gc
import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import settings
from left_out import left_out
from rich.console import RenderableType

from insdvl_replay.core.processor import use_common_code

# Before numpy is imported, as commands do it: results of this process are those of the processes that it starts.
use_common_code()

from insdvl_replay.cli import screen  # noqa: E402
from insdvl_replay.core.config import Evaluation  # noqa: E402
from insdvl_replay.preparation import replay  # noqa: E402

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell lets what it starts in the background ignore Ctrl-C, and the programs that tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

_plan = replay.plan_runs
_draws = {"all": False}


def _plan_one(dive: Any, prepared: Any, config: Any) -> Any:
    """Replay from one start where nobody asks about starts: the usual 16 take four times as long."""
    plan = _plan(dive, prepared, config)
    return (
        replace(plan, starts=1)
        if plan.starts == Evaluation().starts and not _draws["all"]
        else plan
    )


replay.plan_runs = _plan_one

os.environ.pop("COLUMNS", None)  # that of the terminal in which the tests began, or of a worker
_printed = screen.printed


def _printed_unfolded(content: RenderableType) -> str:
    """Print whole sentences on one line, except on terminals, so that tests find them."""
    if sys.stdout.isatty() or "COLUMNS" in os.environ:
        return _printed(content)
    with patch.dict(os.environ, {"COLUMNS": "10000"}):
        return _printed(content)


screen.printed = _printed_unfolded


# Thousands of tests and the libraries are no garbage: looking through them again and again takes a tenth of the time.
gc.disable()


def pytest_collection_finish() -> None:
    """Collect garbage from here on, without what is there when the tests begin."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave the usual number of starts to the tests that are marked so, and to their fixtures."""
    _draws["all"] = item.get_closest_marker("all_starts") is not None


SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def snapir() -> Path:
    """Folder of real dives of the AUV Snapir, beside the project where someone has them."""
    return _shared("data/snapir", "real dives")


@pytest.fixture(scope="session")
def blueye() -> Path:
    """Folder of real dives of a Blueye X3."""
    return _shared("data/blueye_x3", "real dives")


@pytest.fixture(scope="session")
def ufmil() -> Path:
    """Folder of real runs of a SubjuGator."""
    return _shared("data/ufmil", "real dives")


@pytest.fixture(scope="session")
def ros1() -> Path:
    """Folder of a simulated vehicle's .bag, and the same as .mcap."""
    return _shared("data/ros1", "a log of ROS 1")


@pytest.fixture(scope="session")
def paper() -> Path:
    """Folder with the paper's tables."""
    return _shared("paper", "the paper's tables")


def _shared(folder: str, what: str) -> Path:
    if not (SHARED / folder).is_dir():
        pytest.skip(f"needs ../shared/{folder} ({what})")
    return SHARED / folder


def pytest_unconfigure(config: pytest.Config) -> None:
    """Say last of all which tests were left out, and what brings them; workers have no terminal."""
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        for line in left_out(report.longrepr[2] for report in terminal.stats.get("skipped", [])):
            terminal.write_line(line, yellow=True)
        if config.option.markexpr == "not nightly":
            terminal.write_line(
                "tests marked nightly were left out: `make nightly` runs them", yellow=True
            )
