"""Short work with the lowest versions that pyproject.toml allows; `make lowest` does it in an environment of its own.

``python tests/lowest.py list`` prints the versions; without an argument, the commands are run by this Python.
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("cluster", "figures", "remote", "tables")
COMMANDS = (
    "simulate straight --duration 120 -o dive.mcap",
    "inspect dive.mcap",
    "run dive.mcap -o results --starts 2 --history parquet",
    "figure results/dive sigma -o sigma.png --format png",
    f"calibrate {ROOT}/sample_logs/figure_eight.mcap --only arm -o arm.toml",
    f"check {ROOT}/examples/archive/gates.toml --results checked --jobs 2",
)
"""`check` also compares with the stored values of the archive."""


def lowest() -> list[str]:
    """Return the requirements of the program and its extras, each with its lowest version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = [one for extra in EXTRAS for one in project["optional-dependencies"][extra]]
    return [re.sub(r">=([\d.]+).*", r"==\1", one) for one in (*project["dependencies"], *extras)]


def main() -> int:
    """Run the commands; return how many fail."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for command in COMMANDS:
            words = [sys.executable, "-P", "-m", "insdvl_replay", *command.split()]
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
            sys.stdout.write(f"exit {done.returncode}: {command}\n")
            if done.returncode:
                failed += 1
                sys.stdout.write(done.stderr)
    return failed


if __name__ == "__main__":
    if sys.argv[1:] == ["list"]:
        sys.stdout.write("\n".join([*lowest(), ""]))
    else:
        sys.exit(main())
