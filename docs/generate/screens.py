"""The screens in the pages of docs/: each command is run, and what it prints is written below it.

`make readme` renews them; a nightly test holds them equal. The commands of all pages run in one folder, in the order of
the pages, so that one page reads the files that an earlier page wrote.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from example_lake import write_example_lake
from written import PROJECT

PAGES = tuple(
    PROJECT / "docs" / f"{name}.md"
    for name in (
        "first_run",
        "vehicle",
        "calibration",
        "verdict",
        "comparing",
        "own_filter",
        "lake",
        "trajectories",
    )
)
SCREEN = re.compile(
    r"(?<=<!-- screen: written by make readme -->\n)```console\n(.*?)```\n(?=<!-- end of screen -->)",
    re.DOTALL,
)


def screen(block: str, folder: Path) -> str:
    """Run the commands of a block, and return the block with what they print on stdout."""
    commands = re.findall(r"^\$ (.*?[^\\])$", block, re.MULTILINE | re.DOTALL)
    environment = os.environ | {
        "COLUMNS": "10000",  # each sentence on one line, which Markdown readers scroll
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    parts = []
    for command in commands:
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode not in {0, 1}:
            raise ValueError(f"{command}: exit code {done.returncode}: {done.stderr}")
        shown = "\n".join(line.rstrip() for line in done.stdout.strip("\n").splitlines())
        parts.append(f"$ {command}\n{shown}".rstrip("\n"))
    return "```console\n" + "\n".join(parts) + "\n```\n"


def written() -> Iterator[tuple[Path, str]]:
    """Yield each page with its screens as they should be."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for below in ("sample_logs", "examples"):
            (folder / below).symlink_to(PROJECT / below)
        write_example_lake(folder / "lake")
        for page in PAGES:
            yield page, SCREEN.sub(lambda block: screen(block[1], folder), page.read_text("utf-8"))


if __name__ == "__main__":
    for page, text in list(written()):
        page.write_text(text, "utf-8")
