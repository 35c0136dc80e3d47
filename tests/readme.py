"""The parts of README.md that the program writes. `make readme` renews them; a test holds them equal."""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

PROJECT = Path(__file__).resolve().parents[1]
PUBLISHED = Path(__file__).with_name("levy_klein_straight.csv")
"""Levy and Klein, both tables of the straight line."""
SD_WITHIN = 0.05
REACHED_WITHIN_S = 8.0


def printed_tables(log: str) -> str:
    """What ``insdvl-replay run`` prints for a sample log, into a pipe."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "insdvl_replay", "run", f"sample_logs/{log}", "--output", folder]
        return subprocess.run(command, cwd=PROJECT, check=True, capture_output=True, text=True).stdout.strip()


def tour() -> str:
    return f"```console\n$ insdvl-replay run sample_logs/figure_eight.mcap\n{printed_tables('figure_eight.mcap')}\n```"


def result_tables(log: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "insdvl_replay", "run", f"sample_logs/{log}", "--output", folder]
        subprocess.run(command, cwd=PROJECT, check=True, capture_output=True)
        result = Path(folder) / Path(log).stem
        return tuple(pd.read_csv(result / f"{name}.csv").set_index("state") for name in ("improvement", "convergence"))  # type: ignore[return-value]


def against_the_paper() -> str:
    """Each row of the paper's straight-line tables beside ours, and whether they agree."""
    improvement, convergence = result_tables("straight.mcap")
    lines = [
        "| state | unit | baseline: paper, here | aided: paper, here | reached [s]: paper, here | agrees |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    with PUBLISHED.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            state = row["state"]
            ours, ours_s = improvement.loc[state], convergence.loc[state]
            reached = f"{ours_s['reached_s']:.0f}" if ours_s["status"] == "reached" else str(ours_s["status"])
            lines.append(
                f"| {state} | {row['unit']} | {row['baseline_sd']}, {ours['baseline_sd']:.2f} "
                f"| {row['aided_sd']}, {ours['sd']:.2f} | {row['reached_s'] or '-'}, {reached.replace('_', ' ')} "
                f"| {agreement(row, ours, ours_s)} |"
            )
    return "\n".join(lines)


def agreement(published: dict[str, str], ours: pd.Series, ours_s: pd.Series) -> str:
    wrong = []
    for key, column in (("baseline_sd", "baseline_sd"), ("aided_sd", "sd")):
        if abs(ours[column] / float(published[key]) - 1.0) > SD_WITHIN:
            wrong.append(key.replace("_", " "))
    if published["reached_s"]:
        late = (
            ours_s["status"] != "reached" or abs(ours_s["reached_s"] - float(published["reached_s"])) > REACHED_WITHIN_S
        )
        wrong += ["time"] if late else []
    return f"not the {' nor the '.join(wrong)}" if wrong else "yes"


PARTS = {"tour": tour, "paper": against_the_paper}


def renewed(text: str) -> str:
    """README with each part between its markers written anew."""
    for name, part in PARTS.items():
        begin, end = f"<!-- {name}: written by make readme -->\n", f"\n<!-- end of {name} -->"
        head, rest = text.split(begin)
        _, tail = rest.split(end)
        text = head + begin + part() + end + tail
    return text


if __name__ == "__main__":
    readme = PROJECT / "README.md"
    readme.write_text(renewed(readme.read_text("utf-8")), "utf-8")
