"""A signal ends the work wherever it comes: within an import, in what compiled code calls, before the work."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import signal, sys, time
from insdvl_replay.core.interrupts import handle_signals, interruptible, was_interrupted

def interrupt():
    signal.raise_signal(signal.SIGINT)

class InAFinalizer:
    def __del__(self):
        interrupt()

def cleaned_up():
    try:
        interrupt()
    finally:
        time.sleep(0.06)
        print("cleaned up")

def converted():
    try:
        interrupt()
    except BaseException:
        raise SystemError from None

handle_signals()
BEFORE
try:
    with interruptible():
        WORK
        time.sleep(0.5)
        print("went on")
except KeyboardInterrupt:
    print("interrupted")
except SystemError:
    print("interrupted" if was_interrupted() else "failed")
AFTER
"""
OPTIONAL_PART = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
    print("imported")
except BaseException:
    raise ImportError
"""


@pytest.mark.parametrize(
    ("at", "code", "printed"),
    [
        ("WORK", "interrupt()", ["interrupted"]),
        ("WORK", "import optional_part", ["imported", "interrupted"]),
        ("WORK", "InAFinalizer()", ["interrupted"]),
        ("WORK", "cleaned_up()", ["cleaned up", "interrupted"]),
        ("WORK", "converted()", ["interrupted"]),
        ("BEFORE", "interrupt()", ["interrupted"]),
        ("AFTER", "interrupt()", ["went on"]),
    ],
)
def test_an_interrupt_ends_the_work_and_nothing_else(
    at: str, code: str, printed: list[str], tmp_path: Path
) -> None:
    (tmp_path / "optional_part.py").write_text(OPTIONAL_PART)
    script = (
        SCRIPT.replace(at, code).replace("BEFORE", "").replace("WORK", "pass").replace("AFTER", "")
    )
    if at == "AFTER":
        script = script.replace("0.5", "0.0")
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.stdout.split("\n")[:-1], done.stderr, done.returncode) == (printed, "", 0)
