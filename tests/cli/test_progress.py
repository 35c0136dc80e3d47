"""Long work says what it is doing, in order, to a listener and to a terminal, and says nothing into a pipe."""

import sys
from pathlib import Path

import pytest

from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs
from insdvl_replay.batch.runs import replay_into
from insdvl_replay.cli.screen import REPLAY, Meter, Plan, progress
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.runtime import progress_listener, report_stage
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

STAGES = [
    "reading the log",
    "running the filters",
    "DVL outage test",
    "running the filters from random starts",
    "judging the filters",
    "writing the results",
    "drawing the report",
]


def test_a_replay_reports_each_of_its_stages(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulate_dive("straight", duration_s=20.0, seed=1))
    [task] = plan_jobs(
        [FoundDive(tmp_path / "dive.mcap")], tmp_path / "out", ReplayOptions(load_config("fog"))
    )
    told: list[str] = []
    with progress_listener(lambda stage, *_: told.append(stage)):
        replay_into(task)
    assert told == STAGES == list(REPLAY)
    report_stage("nobody listens any more")
    assert told == STAGES


def test_a_terminal_shows_the_stage_and_a_pipe_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for terminal, expected in ((True, "dive.mcap: writing"), (False, "")):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        monkeypatch.setenv("TERM", "xterm")
        with progress("dive.mcap"):
            report_stage("writing")
        shown = capsys.readouterr().err
        assert (expected in shown) if terminal else shown == ""


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    ("plan", "stages", "elapsed_s", "line"),
    [
        (
            REPLAY,
            [("dive", 2, 8), ("running the filters", 0, 0)],
            2.9,
            "replay 3 of 8 dives: running the filters",
        ),
        (REPLAY, [("dive", 2, 8)], 30.0, "replay 3 of 8 dives  25 %  1:30 left"),
        (
            REPLAY,
            [("dive", 2, 8), ("judging the filters", 0, 0)],
            65.0,
            "replay 3 of 8 dives: judging the filters  32 %  2:15 left",
        ),
        (
            REPLAY,
            [("dive", 0, 1), ("judging the filters", 0, 0)],
            6.0,
            "replay: judging the filters  60 %  0:04 left",
        ),
        (REPLAY, [("dive", 0, 4)], 9.0, "replay 1 of 4 dives"),
        ({}, [("run", 10, 100)], 1200.0, "replay, run 11 of 100  10 %  3:00:00 left"),
        ({}, [("fitting", 3, 4)], 3.0, "replay: fitting 3 of 4  75 %  0:01 left"),
        (
            {"a": 0.0, "b": 0.5},
            [("b", 1, 2), ("a", 0, 2), ("c", 1, 2)],
            9.0,
            "replay: c 1 of 2  75 %  0:03 left",
        ),
    ],
)
def test_percent_and_time_left_are_shown_after_three_seconds(
    plan: Plan, stages: list[tuple[str, int, int]], elapsed_s: float, line: str
) -> None:
    clock = Clock()
    meter = Meter("replay", plan, clock=clock)
    for stage in stages:
        meter.report(*stage)
    clock.now_s += elapsed_s
    assert meter.line(80) == line
    assert len(meter.line(30)) <= 30
    assert meter.line(30).endswith(line.partition("  ")[2])


def test_messages_and_tables_have_room(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with progress("replay", REPLAY) as paused:
        with paused():
            capsys.readouterr()
            sys.stdout.write("a table")
            written = capsys.readouterr()
        report_stage("reading the log")
    assert (written.out, written.err) == ("a table", "")
    assert "replay: reading the log" in capsys.readouterr().err
