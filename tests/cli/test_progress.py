"""Long work says what it is doing, in order, to a listener and to a terminal, and says nothing into a pipe."""

import sys
from pathlib import Path

import pytest

from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs, replay_into
from insdvl_replay.cli.screen import progress
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.runtime import progress_listener, report_stage
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

STAGES = [
    "reading the log",
    "running the filters",
    "DVL outage test",
    "running the filters from drawn starts",
    "judging the filters",
    "writing the results",
    "drawing the report",
]


def test_a_replay_reports_each_of_its_stages(tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", simulate_dive("straight", duration_s=20.0, seed=1))
    [task] = plan_jobs([tmp_path / "dive.mcap"], tmp_path / "out", ReplayOptions(load_config()))
    told: list[str] = []
    with progress_listener(lambda stage, *_: told.append(stage)):
        replay_into(task)
    assert told == STAGES
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
