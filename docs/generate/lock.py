"""Write requirements.lock: what the program needs, in the versions of constraints.txt, with the digests of the wheels.

`make lock` runs this. Nothing but pip is needed: it is asked what it would install for each Python on Linux, x86_64.
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / "requirements.lock"
PYTHONS = ("3.11", "3.12", "3.13")
GLIBC = ("2_28", "2_27", "2_26", "2_24", "2_17", "2014")
HEAD = f"""# pip install --require-hashes --only-binary :all: -r requirements.lock
# Wheels for CPython {", ".join(PYTHONS)} on Linux, x86_64, with glibc 2.28 or newer. `make lock` writes this.
"""

Wheels = dict[str, set[str]]
"""SHA-256 of wheels, by ``name==version``."""


def platforms() -> list[str]:
    """Give the arguments by which pip knows the machine."""
    names = (
        f"manylinux{glibc}_x86_64" if glibc == "2014" else f"manylinux_{glibc}_x86_64"
        for glibc in GLIBC
    )
    return [word for name in names for word in ("--platform", name)]


def would_install(python: str, needed: list[str]) -> list[dict[str, Any]]:
    """Ask pip what it would install for a Python."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        command = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--dry-run",
        ]
        command += [
            "--ignore-installed",
            "--only-binary",
            ":all:",
            "--implementation",
            "cp",
            "--python-version",
            python,
        ]
        command += [
            *platforms(),
            "--target",
            str(folder / "target"),
            "--constraint",
            str(ROOT / "constraints.txt"),
        ]
        subprocess.run([*command, "--report", str(folder / "report.json"), *needed], check=True)
        return list(json.loads((folder / "report.json").read_text("utf-8"))["install"])


def wheels() -> Wheels:
    """Collect the wheels of all Pythons."""
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    found: Wheels = {}
    for python in PYTHONS:
        for one in would_install(python, needed):
            name = one["metadata"]["name"].lower().replace("_", "-").replace(".", "-")
            digest = one["download_info"]["archive_info"]["hashes"]["sha256"]
            found.setdefault(f"{name}=={one['metadata']['version']}", set()).add(digest)
    return found


def main() -> None:
    """Write the file."""
    entries = (
        " \\\n".join([pin, *(f"    --hash=sha256:{digest}" for digest in sorted(digests))])
        for pin, digests in sorted(wheels().items())
    )
    LOCK.write_text(HEAD + "\n".join(entries) + "\n", "utf-8")


if __name__ == "__main__":
    main()
