"""Work whose parent, cluster or scheduler is gone comes to an end."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import psutil
import pytest

from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs, replay_jobs
from insdvl_replay.batch.workers import Pool, Workers, _InThisProcess
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

TESTS = Path(__file__).resolve().parents[1]
TOOL = [sys.executable, "-m", "insdvl_replay"]
PARENT = """
import sys
from dying_work import asleep
from insdvl_replay.batch.workers import do_each
from insdvl_replay.batch.workers import local_workers

if __name__ == "__main__":
    for _, name in do_each(asleep, [0.0, 0.0, 600.0], local_workers(2)):
        print("done", flush=True)
"""
SCHEDULER = """
import asyncio
from distributed import Scheduler

async def serve():
    async with Scheduler(host="127.0.0.1", port=0, dashboard_address=":0") as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()

asyncio.run(serve())
"""


@pytest.mark.nightly
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    environment = os.environ | {"PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}"}
    with subprocess.Popen(
        [sys.executable, str(script)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout
        assert [parent.stdout.readline() for _ in range(2)] == ["done\n"] * 2
        workers = psutil.Process(parent.pid).children(recursive=True)
        assert len(workers) >= 2
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
    with subprocess.Popen([sys.executable, "-c", SCHEDULER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        yield process.stdout.readline().strip(), psutil.Process(process.pid)
        process.kill()


def started(log: Path, address: str, timeout_s: float) -> subprocess.Popen[str]:
    command = [*TOOL, "run", str(log), "-o", "out", "--scheduler", address, "--scheduler-patience", f"{timeout_s:g}"]
    return subprocess.Popen(command, cwd=log.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.nightly
def test_a_cluster_without_workers_is_told(log: Path, scheduler: tuple[str, psutil.Process]) -> None:
    process = started(log, scheduler[0], 1.0)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 2, told
    (line,) = told.splitlines()
    assert re.fullmatch(rf"error: --scheduler {scheduler[0]}: .*\b1 s; hint: .*--scheduler-patience.*", line)


@pytest.mark.nightly
@pytest.mark.parametrize("end", ["suspend", "kill"])
def test_a_scheduler_that_goes_is_told(log: Path, scheduler: tuple[str, psutil.Process], end: str) -> None:
    address, of_scheduler = scheduler
    process = started(log, address, 10.0)
    while not any(one.raddr and one.status == "ESTABLISHED" for one in psutil.Process(process.pid).net_connections()):
        assert process.poll() is None
        time.sleep(0.1)
    time.sleep(2.0)
    getattr(of_scheduler, end)()
    _, told = process.communicate(timeout=90)
    assert process.returncode == 2, told
    assert told.count("\n") == 1, told
    assert told.startswith(f"error: --scheduler {address}: ")


@pytest.mark.nightly
def test_a_scheduler_that_never_answers_is_told(log: Path, scheduler: tuple[str, psutil.Process]) -> None:
    address, of_scheduler = scheduler
    of_scheduler.suspend()
    process = started(log, address, 1.0)
    _, told = process.communicate(timeout=90)
    assert process.returncode == 2, told
    (line,) = told.splitlines()
    assert re.fullmatch(rf"error: --scheduler {address}: .*\b20 s; hint: .*`dask scheduler`.*", line)


def test_a_worker_answers_only_for_the_bytes_that_are_meant(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is sent the whole path; and what lies there for it may be another log."""
    seen = []

    class Elsewhere(_InThisProcess):
        def submit(self, fn, /, *arguments):  # type: ignore[no-untyped-def]
            seen.extend(arguments)
            write_dive(log_there, simulate_dive("straight", seed=len(seen) + 1, duration_s=20.0))
            return super().submit(fn, *arguments)

    log_there = tmp_path / "dive.mcap"
    log_there.write_bytes(log.read_bytes())
    monkeypatch.chdir(tmp_path)
    tasks = plan_jobs([Path("dive.mcap")], Path("out"), ReplayOptions(Config()))
    workers = Workers(lambda _alone: nullcontext(Pool(Elsewhere(), 1)), are_elsewhere=True)
    [outcome] = replay_jobs(tasks, {}, workers, lambda _: None)
    assert seen[0].logs == (log_there,)
    assert seen[0].target == tmp_path / "out" / "dive"
    assert isinstance(outcome.result, LogError)
    assert "SHA-256" in outcome.result.message
    assert not (tmp_path / "out").exists()
