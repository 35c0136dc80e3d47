"""A solution of the vehicle's own through the command line: its files, its page, comparisons, gates, a second run."""

import csv
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from vehicles_own import off, truth_of, write_odometry, write_tum

from insdvl_replay.cli import run_command_line
from insdvl_replay.logs.write import write_dive
from insdvl_replay.sim.dive import simulate_dive

SETTINGS = """
[dvl]
velocity_sd_mps = 0.005
[evaluation]
starts = 4
[filters.baseline]
aiding = ["velocity"]
[filters.onboard]
solution = "flown.tum"
[filters.odometry]
solution = "/odometry"
[filters.aided]
aiding = ["velocity", "acceleration"]
acceleration = { window = 3 }
"""
GATES = """
[[gate]]
name = "the vehicle does not jump"
table = "jumps"
filter = "onboard"
column = "jumps"
max = 0
[[gate]]
name = "its heading is right"
table = "reference_error"
filter = "odometry"
row = "heading"
column = "rmse"
max = 0.5
[[gate]]
name = "it is no worse"
table = "filters"
filter = "odometry"
column = "verdict"
equals = "better"
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    dive = simulate_dive("figure-eight", seed=1, duration_s=120.0, grade="mems")
    write_dive(folder / "dive.mcap", dive)
    told = truth_of(dive)
    rows, rng = len(told.time_ns), np.random.default_rng(1)
    velocity_n, turn_n = rng.normal(0.0, 0.01, (rows, 3)), rng.normal(0.0, 1e-3, (rows, 3))
    drift_n = np.cumsum(rng.normal(0.0, 2e-3, (rows, 3)), axis=0)
    wrong = off(told, velocity_n=velocity_n, turn_n=turn_n, moved_n=drift_n)
    jumped = off(
        wrong, moved_n=np.where(np.arange(rows)[:, None] > rows // 2, [3.0, 0.0, 0.0], 0.0)
    )
    covs = {
        name: np.tile(1e-2 * np.eye(6), (rows, 1, 1))
        for name in ("pose.covariance", "twist.covariance")
    }
    write_odometry(folder / "odometry.mcap", wrong, covs)
    write_tum(folder / "flown.tum", jumped)
    (folder / "settings.toml").write_text(SETTINGS)
    (folder / "gates.toml").write_text(GATES)
    assert run(folder, "result") == 0
    return folder


def run(place: Path, target: str, *options: str) -> int:
    logs = [str(place / "dive.mcap"), str(place / "odometry.mcap")]
    settings = ["--preset", "mems", "-c", str(place / "settings.toml"), "-o", str(place / target)]
    return run_command_line(["run", *logs, "--one-dive", *settings, *options])


def table(place: Path, name: str) -> list[dict[str, str]]:
    with (place / "result" / "dive" / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_solutions_are_behind_the_filters_that_were_run(place: Path) -> None:
    report: dict[str, Any] = json.loads((place / "result" / "dive" / "report.json").read_text())
    assert list(report["filters"]) == ["aided", "onboard", "odometry"]
    assert report["filters"]["onboard"]["mean_improvement_pct"] is None
    assert [(row["filter"], row["jumps"]) for row in table(place, "jumps")] == [
        ("onboard", "1"),
        ("odometry", "0"),
    ]
    assert Counter(row["filter"] for row in table(place, "improvement")) == {
        "aided": 12,
        "odometry": 6,
    }
    empty = [row for row in table(place, "reference_error") if row["status"] == "not in solution"]
    assert {row["filter"] for row in empty} == {"onboard"}
    assert {row[column] for row in empty for column in ("rmse", "baseline_rmse", "final")} == {""}


def test_others_tools_read_what_it_has_and_nothing_else(place: Path) -> None:
    with (place / "result" / "dive" / "replay.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [
            (channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()
        ]
    topics = Counter(topic for topic, _ in messages)
    own = {
        topic.removeprefix("/insdvl/onboard/")
        for topic in topics
        if topic.startswith("/insdvl/onboard/")
    }
    assert own == {"state", "error", "fix"}
    whole = {
        topic.removeprefix("/insdvl/odometry/")
        for topic in topics
        if topic.startswith("/insdvl/odometry/")
    }
    assert whole == {"state", "sigma", "error", "odometry", "fix"}
    poses = [
        decoded.pose.pose for topic, decoded in messages if topic == "/insdvl/odometry/odometry"
    ]
    assert all(np.isfinite([pose.position.x, pose.orientation.w]).all() for pose in poses)


def test_the_page_shows_it(place: Path) -> None:
    page = (place / "result" / "dive" / "report.html").read_text()
    assert re.search(r">Jumps\b", page)
    assert page.count("onboard") > 10
    assert ">nan<" not in page.lower()


def test_gates_hold_it(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run_command_line(["check", str(place / "gates.toml"), str(place / "result" / "dive")]) == 1
    )
    shown = capsys.readouterr().out
    assert "onboard jumps is 1, required: at most 0\n" in shown
    assert re.search(r"its heading is right: .*\b1 of 1\b", shown)


def test_it_is_compared_and_run_again_only_if_the_file_is_another(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(place, "result") == 0
    assert "unchanged" in "".join(capsys.readouterr())
    onboard = place / "flown.tum"
    lines = onboard.read_text().splitlines()
    onboard.write_text("\n".join(lines[: len(lines) // 2]) + "\n")
    assert run(place, "result") == 2  # made with other settings: not replaced unasked
    assert run(place, "other") == 0
    capsys.readouterr()
    assert (
        run_command_line(
            ["compare", str(place / "result"), str(place / "other"), "--table", "jumps"]
        )
        == 0
    )
    shown = capsys.readouterr().out
    assert "filters.onboard.solution.sha256" in shown
    assert "onboard" in shown
    onboard.write_text("\n".join(lines) + "\n")
