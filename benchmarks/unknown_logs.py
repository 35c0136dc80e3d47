"""What `run LOG` without settings says of real logs, and what it costs.

Usage: python benchmarks/unknown_logs.py [LOG...]. By default these are all logs with IMU and DVL in ../shared/data.
Each is one process of its own; times are seconds of processor time, with the compiled code in the cache.
"""

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from results import machine, table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FOLDERS = ("snapir", "blueye_x3", "ufmil", "ros1", "stanford_auv", "cougars")
COLUMNS = ("log", "s", "NIS/dof", "verdict", "assumed")


def row_of(log: Path) -> tuple[str, bool]:
    """Run one log; return its row, and whether it ended with a verdict on filters that fit."""
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "insdvl_replay", "run", str(log), "-o", folder, "-q"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        name = f"{log.parent.name}/{log.name}"
        if done.returncode:
            return (
                f"| {name} | {spent_s:.1f} | - | {done.stderr.strip().splitlines()[-1]} | |",
                False,
            )
        (path,) = Path(folder).glob("*/report.json")
        report = json.loads(path.read_text())
    consistency = report["tables"]["consistency"]
    row = next(
        row
        for row in consistency
        if (row["filter"], row["measurement"]) == (report["baseline"], "velocity")
    )
    size = row["mean_nis"] / row["dof"]
    words = ", ".join(candidate["verdict"] for candidate in report["filters"].values())
    notes = [note for note in report["notes"] if note["code"].startswith("found_")]
    assumed = "; ".join(note["text"] for note in notes if note["severity"] == "warning")
    is_judged = 0.4 <= size <= 2.5 and "not evaluated" not in words
    return f"| {name} | {spent_s:.1f} | {size:.2f} | {words} | {assumed} |", is_judged


def main() -> None:
    """Print the table."""
    logs = [Path(argument) for argument in sys.argv[1:]]
    logs = logs or [
        log
        for folder in FOLDERS
        for ending in ("*.mcap", "*.bag")
        for log in (DATA / folder).glob(ending)
    ]
    found = [row_of(log) for log in sorted(logs)]
    sys.stdout.write("\n".join(table(COLUMNS, [row for row, _ in found])) + "\n")
    judged = sum(is_judged for _, is_judged in found)
    sys.stdout.write(
        f"{judged} of {len(found)} end with NIS/dof from 0.4 to 2.5 and a verdict ({machine()})\n"
    )


if __name__ == "__main__":
    main()
