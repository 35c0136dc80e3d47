"""Work whose parent or cluster is gone, and what a worker elsewhere answers for."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import psutil
import pytest

from insdvl_replay.batch import workers
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs
from insdvl_replay.batch.runs import replay_jobs
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

TOOL = [sys.executable, "-m", "insdvl_replay"]
SCHEDULER = """
import asyncio
from distributed import Scheduler

async def serve():
    async with Scheduler(host="127.0.0.1", port=0, dashboard_address=":0") as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()

asyncio.run(serve())
"""


PARENT = """
from dying_work import asleep
from insdvl_replay.batch.workers import do_each, local_pool

if __name__ == "__main__":
    for _, name in do_each(asleep, [0.0, 0.0, 600.0], local_pool(2)):
        print("done", flush=True)
"""


@pytest.mark.nightly
@pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux tells a process that its parent has ended"
)
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    tests = Path(__file__).resolve().parents[1]
    environment = os.environ | {"PYTHONPATH": f"{tests}{os.pathsep}{tests.parent}"}
    with subprocess.Popen(
        [sys.executable, str(script)], env=environment, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout
        assert [parent.stdout.readline() for _ in range(2)] == ["done\n"] * 2
        workers = psutil.Process(parent.pid).children(recursive=True)
        parent.kill()
        parent.communicate(timeout=20)  # both ends are closed as soon as nobody holds them
    _, alive = psutil.wait_procs(workers, timeout=5)
    assert not alive


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "dive.mcap"
    write_dive(path, simulate_dive("straight", seed=1, duration_s=20.0))
    return path


@pytest.fixture
def scheduler() -> Iterator[tuple[str, psutil.Process]]:
    """A scheduler without workers, and its process."""
    pytest.importorskip("distributed")
    with subprocess.Popen(
        [sys.executable, "-c", SCHEDULER], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        yield process.stdout.readline().strip(), psutil.Process(process.pid)
        process.kill()


@pytest.mark.nightly
def test_a_cluster_without_workers_is_reported(
    log: Path,
    scheduler: tuple[str, psutil.Process],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(workers, "_WORKERS_WITHIN_S", 1)
    assert (
        run_command_line(
            ["run", str(log), "-o", str(log.parent / "out"), "--scheduler", scheduler[0]]
        )
        == 2
    )
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(rf"error: --scheduler {scheduler[0]}: .*; hint: .*`dask worker`.*", line)


def test_a_worker_answers_only_for_the_bytes_that_are_meant(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is sent the whole path; and what lies there for it may be another log."""
    seen = []

    def submit(work, job):  # type: ignore[no-untyped-def]
        seen.append(job)
        write_dive(log_there, simulate_dive("straight", seed=2, duration_s=20.0))
        future: Future[bytes] = Future()
        try:
            future.set_result(work(job))
        except Exception as error:
            future.set_exception(error)
        return future

    log_there = tmp_path / "dive.mcap"
    log_there.write_bytes(log.read_bytes())
    monkeypatch.chdir(tmp_path)
    tasks = plan_jobs([FoundDive(Path("dive.mcap"))], Path("out"), ReplayOptions(Config()))
    [outcome] = replay_jobs(
        tasks, {}, lambda _alone: nullcontext((submit, 1, bool)), elsewhere=True
    )
    assert seen[0].logs == (log_there,)
    assert seen[0].target == tmp_path / "out" / "dive"
    assert isinstance(outcome.result, LogError)
    assert "SHA-256" in outcome.result.message
    assert not (tmp_path / "out").exists()


def test_a_pipe_that_was_closed_already_prints_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    opened: list[ProcessPoolExecutor] = []

    class Recorded(ProcessPoolExecutor):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            opened.append(self)

    monkeypatch.setattr(workers, "ProcessPoolExecutor", Recorded)
    with workers._processes(1, alone=False):
        report = vars(opened[0])["_call_queue"]._on_queue_feeder_error
        report(OSError(9, "Bad file descriptor"), object())
        assert not capfd.readouterr().err
        try:
            raise ValueError("another error")
        except ValueError as error:
            report(error, object())
        assert "another error" in capfd.readouterr().err
