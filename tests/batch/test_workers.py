"""Workers that are told to end."""

import multiprocessing
import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import pytest

from insdvl_replay.batch import workers


def begun_while_a_signal_waits() -> None:
    """Begin as a worker does whose parent ended it while it started."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    os.kill(os.getpid(), signal.SIGTERM)
    workers._begin()


class Ended:
    """What a worker lets go at the moment at which it is ended."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.0)


def let_go_and_work_on() -> None:
    Ended()
    time.sleep(30.0)


def test_a_worker_that_is_ended_while_it_lets_an_object_go_says_nothing_and_ends(
    capfd: pytest.CaptureFixture[str],
) -> None:
    before = set(multiprocessing.active_children())
    with workers._processes(1) as pool:
        done = pool.executor.submit(let_go_and_work_on)
        (worker,) = set(multiprocessing.active_children()) - before
        with pytest.raises(BrokenProcessPool):
            done.result(timeout=60.0)
    worker.join(60.0)
    assert worker.exitcode == 1, "by itself, and not by the alarm"
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signals that wait, as POSIX has them")
def test_a_worker_that_is_ended_while_it_begins_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    spawned = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(1, spawned, begun_while_a_signal_waits) as executor,
        pytest.raises(BrokenProcessPool),
    ):
        executor.submit(int).result(timeout=60.0)
    assert capfd.readouterr().err == ""
