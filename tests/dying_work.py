"""Work that kills the process that does it."""

import os
import signal
import time
from pathlib import Path


def die_at_first(marker: Path) -> str:
    """End the process the first time; leave a mark, so that the second time goes well."""
    if marker.suffix == ".deadly" and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return marker.name


def die_always(name: str) -> str:
    if name == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return name


def asleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds
