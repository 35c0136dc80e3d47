"""The program as a process of its own, in a session of its own, so that all that it starts can be found."""

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from insdvl_replay.results.folder import COMPLETE

PATIENCE_S = 60.0
FAREWELL_S = 5.0
"""How long processes may live on after a signal."""


def started(command: list[str], said: Path) -> subprocess.Popen[bytes]:
    """Start a command."""
    with said.open("wb") as stream:
        return subprocess.Popen(
            [sys.executable, "-m", "insdvl_replay", *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stream,
            start_new_session=True,
        )


def alive(session: int) -> list[int]:
    """Give the processes of a session that have not ended."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, _, _, its = (
                    (entry / "stat").read_text("utf-8").rpartition(")")[2].split()[:4]
                )
            except OSError:
                continue
            if int(its) == session and state not in "ZX":
                found.append(int(entry.name))
    return found


def waited(process: subprocess.Popen[bytes]) -> list[int]:
    """Wait for all processes of a session; end those that stay, and give them."""
    start_s = time.monotonic()
    while alive(process.pid) and time.monotonic() - start_s < FAREWELL_S:
        time.sleep(0.05)
    left = alive(process.pid)
    for one in left:
        os.kill(one, 9)
    return left


def half_written(results: Path) -> list[Path]:
    """Give result folders that are not whole; hidden ones are none."""
    folders = results.iterdir() if results.is_dir() else ()
    return [
        folder
        for folder in folders
        if folder.is_dir() and not folder.name.startswith(".") and not _is_whole(folder)
    ]


def _is_whole(folder: Path) -> bool:
    """Say whether a result has all files that its report names, with the digests there."""
    try:
        named = json.loads((folder / COMPLETE).read_bytes())["files"]
        found = {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
            for name in named
            if name != COMPLETE
        }
    except (OSError, ValueError, KeyError):
        return False
    return bool(found) and all(named[name] == digest for name, digest in found.items())


def hidden(folder: Path) -> list[Path]:
    """Give what was to be renamed or removed and was not."""
    return [path for path in folder.rglob(".*") if not path.name.startswith(".git")]
