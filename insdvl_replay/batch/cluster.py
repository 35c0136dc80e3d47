"""Workers on a dask.distributed cluster, and how long it may go without an answer."""

import importlib
import logging
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from insdvl_replay.batch.workers import Pool, Workers
from insdvl_replay.core.errors import ConfigError

_REACHED_WITHIN_S: Final = 10.0
"""How long a cluster may take to answer at first."""
_LOOK_EVERY_S: Final = 2.0
_LEFT_WITHIN_S: Final = 2.0


@dataclass(frozen=True)
class Cluster:
    """A dask.distributed cluster that runs already."""

    address: str  # of its scheduler, such as ``tcp://host:8786``
    timeout_s: float  # how long it may be without a worker or an answer


def cluster_workers(cluster: Cluster) -> Workers:
    """Work on a cluster.

    Raises
    ------
    ConfigError
        dask.distributed is not installed.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise ConfigError(
            f"--scheduler {cluster.address}: dask.distributed is not installed", "pip install 'insdvl-replay[cluster]'"
        ) from error
    _silence("distributed", "tornado", "asyncio")
    return Workers(
        lambda alone: _cluster(distributed, cluster, alone=alone),
        (CancelledError, distributed.KilledWorker),
        are_elsewhere=True,
    )


def _silence(*libraries: str) -> None:
    """Keep libraries from printing, with tracebacks, what an error of ours reports in a sentence."""
    for name in [*libraries, *logging.root.manager.loggerDict]:
        if name.partition(".")[0] in libraries:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


@contextmanager
def _cluster(distributed: Any, cluster: Cluster, *, alone: bool) -> Iterator[Pool]:
    try:
        client = _client(distributed, cluster)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"--scheduler {cluster.address}: cannot be reached: {error}",
            "`dask scheduler` prints the address it listens on",
        ) from error
    health = _Health(client, cluster)
    executor = client.get_executor(pure=False)
    try:
        yield Pool(executor, 1 if alone else 2 * max(1, health.threads()), health.require, _LOOK_EVERY_S)
    finally:
        executor.shutdown(wait=False)
        client.close(timeout=_LEFT_WITHIN_S)


def _client(distributed: Any, cluster: Cluster) -> Any:
    """Connect, in a thread that nobody waits for: one that accepts and never answers would block it for ever."""
    connected: Future[Any] = Future()

    def connect() -> None:
        try:
            connected.set_result(distributed.Client(cluster.address, timeout=_REACHED_WITHIN_S, set_as_default=False))
        except Exception as error:
            connected.set_exception(error)

    threading.Thread(target=connect, daemon=True).start()
    within_s = max(cluster.timeout_s, 2.0 * _REACHED_WITHIN_S)
    if not wait([connected], within_s).done:
        raise TimeoutError(f"no answer in {within_s:g} s")
    return connected.result()


class _Health:
    """Distinguishes a cluster that takes long from one that will never be done."""

    def __init__(self, client: Any, cluster: Cluster) -> None:
        self.client = client
        self.cluster = cluster
        self.well_at_s = time.monotonic()

    def threads(self) -> int:
        """Return how many items can be done at a time; -1 where there is no answer."""
        try:
            return sum(self.client.sync(self.client.scheduler.ncores, callback_timeout=_LOOK_EVERY_S).values())
        except (OSError, TimeoutError):
            return -1

    def require(self) -> None:
        """Raise a ConfigError if there has been no worker, or no answer, for too long."""
        threads = self.threads()
        if threads > 0:
            self.well_at_s = time.monotonic()
        elif time.monotonic() - self.well_at_s > self.cluster.timeout_s:
            found = "has no workers" if threads == 0 else "does not answer"
            raise ConfigError(
                f"--scheduler {self.cluster.address}: {found}, for {self.cluster.timeout_s:g} s",
                "`dask worker` adds one; --scheduler-patience waits longer",
            )
