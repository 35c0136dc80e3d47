"""The parts of README.md that the program writes. `make readme` renews them; a test holds them equal."""

import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import paper_tables
from written import PROJECT, markdown_table, renewed

from insdvl_replay.cli import run_command_line

README = PROJECT / "README.md"


SAMPLES = ("straight", "figure_eight")


BAG = PROJECT.parent / "shared" / "data" / "ros1" / "rexrov2_simulated.bag"
"""Of a vehicle that others simulated. It has no licence, so it is not in the project."""
BLUEYE = PROJECT.parent / "shared" / "data" / "blueye_x3" / "auto_square.mcap"
"""Of a real vehicle. It has no licence either."""
VEHICLE = PROJECT / "docs" / "vehicle.md"


def printed(folder: Path, *arguments: str) -> str:
    """Run the program in a folder, and return what it prints into a pipe."""
    command = [sys.executable, "-m", "insdvl_replay", *arguments]
    environment = {**os.environ, "COLUMNS": "10000", "PYTHONPATH": str(PROJECT)}
    done = subprocess.run(
        command, cwd=folder, env=environment, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def demo() -> str:
    """What is printed for the three questions of the demonstration."""
    with TemporaryDirectory() as folder:
        printed(Path(folder), "compile")
        answers, _, _ = printed(Path(folder), "demo").partition("\n\n")
    return "\n".join(["```console", "$ insdvl-replay demo", answers, "```"])


def foreign() -> str:
    """What one command makes of a bag of a vehicle of others."""
    command = "run", "rexrov2.bag", "--set", "initial.latitude_deg=38"
    with TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(BAG, folder / "rexrov2.bag")
        lines = printed(folder, *command).partition("\nthis dive")[0].splitlines()
        settings = (folder / "replay" / "rexrov2" / "vehicle.toml").read_text("utf-8").splitlines()
        arm = next(line for line in settings if "lever_arm_m" in line).partition("  #")[0]
    verdict = next(number for number, line in enumerate(lines) if line.startswith("aided against"))
    answer = lines[verdict : verdict + 2]
    call = f"$ insdvl-replay {' '.join(command)}"
    grep = "$ grep -o 'lever_arm_m[^#]*' replay/rexrov2/vehicle.toml"
    return "\n".join(["```console", call, lines[0], *answer, grep, arm, "```"])


def unknown_vehicle() -> str:
    """What `run` says of a log of a vehicle that nobody has described."""
    command = [sys.executable, "-m", "insdvl_replay", "run", BLUEYE.name]
    environment = {**os.environ, "COLUMNS": "10000", "PYTHONPATH": str(PROJECT)}
    with TemporaryDirectory() as folder:
        shutil.copy(BLUEYE, folder)
        done = subprocess.run(
            command, cwd=folder, env=environment, check=True, capture_output=True, text=True
        )
    findings = [
        line
        for line in done.stderr.splitlines()
        if line.startswith(("assumed: ", "found: ", "to repeat it: "))
    ]
    return "\n".join(["```text", *findings, "```"])


def paper() -> str:
    """The means of the paper beside ours."""
    rows = []
    for name in SAMPLES:
        course = paper_tables.read_course(name)
        with TemporaryDirectory() as output:
            arguments = ["run", str(PROJECT / "sample_logs" / f"{name}.mcap")]
            arguments += ["--preset", "levy-klein", "--output", output]
            # In this process, since nothing of what is printed is shown.
            with redirect_stdout(io.StringIO()):
                run_command_line(arguments)
            ours = json.loads((Path(output) / name / "report.json").read_bytes())["filters"][
                "aided"
            ]
        nearest_pct, crossing_pct = (
            ours[f"mean_{how}_improvement_pct"] for how in ("nearest_approach", "convergence")
        )
        rows.append(
            (
                f"`sample_logs/{name}.mcap`",
                f"{course.mean_improvement_pct:g} %, {ours['mean_improvement_pct']:.1f} %",
                f"{course.mean_convergence_pct:g} %, {nearest_pct:.1f} %",
                f"{crossing_pct:.1f} %",
            )
        )
    return markdown_table(
        (
            "",
            "mean improvement: paper, here",
            "mean convergence, nearest approach: paper, here",
            "crossing",
        ),
        rows,
    )


PARTS = {"demo": demo, "paper": paper}


def written(parts: Mapping[str, Callable[[], str]] = PARTS) -> str:
    """README as it should be."""
    return renewed(README.read_text("utf-8"), parts, "make readme")


def vehicle_page() -> str:
    """docs/vehicle.md with what is found of a log of others."""
    return renewed(VEHICLE.read_text("utf-8"), {"blueye": unknown_vehicle}, "make readme")


if __name__ == "__main__":
    README.write_text(written({**PARTS, "foreign": foreign} if BAG.is_file() else PARTS), "utf-8")
    if BLUEYE.is_file():
        VEHICLE.write_text(vehicle_page(), "utf-8")
