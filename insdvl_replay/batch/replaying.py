"""How dives are replayed: by how many processes, what of earlier results stays, and what is shown meanwhile."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass

from insdvl_replay.batch.jobs import ReplayJob
from insdvl_replay.core.errors import Note

Paused = Callable[[], AbstractContextManager[None]]
"""Makes room for messages and tables, while a work is shown."""
Working = Callable[[str], AbstractContextManager[Paused]]
"""Shows a work by its name while it goes on."""


@contextmanager
def silently(_work: str) -> Iterator[Paused]:
    """Show nothing of a work."""
    yield nullcontext


def unheard(_said: object) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class Replaying:
    """How dives are replayed; by default in this process, and nothing is shown of it."""

    jobs: int = 1  # processes, each with a dive at a time
    scheduler: str | None = None  # address of a cluster, whose workers replay instead
    code_apart: bool = False  # users' code runs in a process of its own, which it may end
    force: bool = False  # replace results of other settings
    rerun: bool = False  # replay also what is up to date
    work: Callable[[ReplayJob], bytes] | None = None  # what replays a dive, if it is not stored
    working: Working = silently
    report_note: Callable[[Note], None] = unheard  # of results that are replaced
    say: Callable[[str], None] = unheard  # a line on settings that may not fit
