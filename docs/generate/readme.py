"""The parts of README.md that the program writes. `make readme` renews them; a test holds them equal."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from written import PROJECT, markdown_table, renewed

README = PROJECT / "README.md"


PAPER = {"straight": (18.76, 56.73), "figure_eight": (40.0, 54.0)}
"""Mean improvement and mean convergence in percent, as Levy and Klein give them."""


def run_sample(name: str, output: str) -> str:
    """Run ``insdvl-replay run`` on a sample log, into a pipe."""
    command = [sys.executable, "-m", "insdvl_replay", "run", f"sample_logs/{name}.mcap", "--output", output]
    done = subprocess.run(command, cwd=PROJECT, check=True, capture_output=True, text=True)
    return done.stdout.strip().replace(f"{output}/", "replay/")


def tour() -> str:
    """What is printed for the figure-eight."""
    with tempfile.TemporaryDirectory() as output:
        return (
            f"```console\n$ insdvl-replay run sample_logs/figure_eight.mcap\n{run_sample('figure_eight', output)}\n```"
        )


def paper() -> str:
    """The means of the paper beside ours."""
    rows = []
    for name, (improvement, convergence) in PAPER.items():
        with tempfile.TemporaryDirectory() as output:
            run_sample(name, output)
            ours = json.loads((Path(output) / name / "report.json").read_bytes())["filters"]["aided"]
        nearest_pct, crossing_pct = (ours[f"mean_{how}_improvement_pct"] for how in ("nearest_approach", "convergence"))
        rows.append(
            (
                f"`sample_logs/{name}.mcap`",
                f"{improvement:g} %, {ours['mean_improvement_pct']:.1f} %",
                f"{convergence:g} %, {nearest_pct:.1f} %",
                f"{crossing_pct:.1f} %",
            )
        )
    return markdown_table(
        ("", "mean improvement: paper, here", "mean convergence, nearest approach: paper, here", "crossing"), rows
    )


PARTS = {"tour": tour, "paper": paper}


def written() -> str:
    """README as it should be."""
    return renewed(README.read_text("utf-8"), PARTS, "make readme")


if __name__ == "__main__":
    README.write_text(written(), "utf-8")
