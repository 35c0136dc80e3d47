"""What several tests share."""

import signal
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell lets what it starts in the background ignore Ctrl-C, and the programs that tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def snapir() -> Path:
    """Folder of real dives of the AUV Snapir, beside the project where someone has them."""
    return _shared("data/snapir", "real dives")


@pytest.fixture(scope="session")
def paper() -> Path:
    """Folder with the paper's tables."""
    return _shared("paper", "the paper's tables")


def _shared(folder: str, what: str) -> Path:
    if not (SHARED / folder).is_dir():
        pytest.skip(f"needs ../shared/{folder} ({what})")
    return SHARED / folder
