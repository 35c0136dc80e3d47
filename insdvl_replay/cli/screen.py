"""Width and colours of the terminal, and progress, by rich."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

from rich.console import Console, RenderableType
from rich.text import Text

from insdvl_replay.cli.messages import log_info, log_notes, log_to_stderr
from insdvl_replay.core.errors import Note, visible
from insdvl_replay.core.runtime import (
    LEAST_TO_COMPILE_BYTES,
    cache_problem,
    is_warm,
    progress_listener,
    require_memory,
)
from insdvl_replay.document.parts import Result
from insdvl_replay.document.render import document as parts_of
from insdvl_replay.document.render import render
from insdvl_replay.document.text import for_terminal

if TYPE_CHECKING:
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.replaying import Paused, Replaying


def written(result: Result, format_: str) -> str:
    """Return a result in the ``--format`` asked for."""
    if format_ == "table":
        return printed(for_terminal(parts_of(result)))
    return render(result, format_)


class Colors:
    """Whether stdout has colours: by ``--color``, else on a terminal unless NO_COLOR is set."""

    wanted: bool | None = None

    @classmethod
    def system(cls) -> Literal["auto", "standard"] | None:
        """Return the colour system for rich."""
        if cls.wanted is None:
            if os.environ.get("NO_COLOR"):
                return None
            return "auto"
        if cls.wanted:
            return "standard"
        return None


def printed(content: RenderableType) -> str:
    """Render tables for stdout: as wide as the terminal, or as COLUMNS; without both 80 columns wide."""
    console = Console(
        file=sys.stdout,
        highlight=False,
        color_system=Colors.system(),
        force_terminal=Colors.wanted or None,
    )
    with console.capture() as capture:
        console.print(content, crop=False)
    return "\n".join(line.rstrip() for line in capture.get().split("\n"))


# --- Progress: stage, percent and time left, on the last line of a terminal.

Plan = Mapping[str, float]
"""Stages of a work in their order, with the share of the work that is done when each begins."""
REPLAY: Final[Plan] = {
    "reading the log": 0.0,
    "running the filters": 0.1,
    "DVL outage test": 0.13,
    "running the filters from random starts": 0.16,
    "judging the filters": 0.6,
    "writing the results": 0.85,
    "drawing the report": 0.92,
}
CALIBRATION: Final[Plan] = {
    "reading": 0.0,
    "trying mountings": 0.05,
    "trying mountings with arm and delay": 0.1,
    "searching the delay": 0.15,
    "fitting the innovations": 0.25,
    "fitting the reference": 0.7,
    "testing on held-out dives": 0.9,
}
COUNTED: Final = {
    "dive": "{text} {number} of {total} dives",
    "run": "{text}, run {number} of {total}",
}
"""Stages that contain the others, and how they are counted."""
SHORT_S: Final = 3.0
"""After it, percent and time left are shown."""


class Meter:
    """How far a work is, by the stages that it reports."""

    def __init__(
        self,
        text: str,
        plan: Plan,
        remark: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._text = text
        self._plan = plan
        self._remark = remark
        self._clock = clock
        self._start_s = clock()
        self._head = text
        self._stage = ""
        self._done = 0
        self._total = 1
        self._share = 0.0

    def report(
        self,
        stage: str,
        done: int,
        total: int,
    ) -> None:
        """Take note of a stage, and of its steps if it has some."""
        part = 0.0
        if stage in COUNTED:
            self._done = done
            self._total = total
            self._stage = ""
            if total > 1:
                self._head = COUNTED[stage].format(
                    text=self._text, number=min(done + 1, total), total=total
                )
        else:
            self._stage = f": {stage} {done} of {total}" if total else f": {stage}"
            if stage in self._plan or not self._plan:
                begin = self._plan.get(stage, 0.0)
                end = min((share for share in self._plan.values() if share > begin), default=1.0)
                part = begin + (end - begin) * (done / total if total else 0.0)
        self._share = max(self._share, (self._done + part) / self._total)

    def line(self, columns: int) -> str:
        """Write the line; after three seconds with percent and time left."""
        elapsed_s = self._clock() - self._start_s
        rest = ""
        if elapsed_s >= SHORT_S and 0.0 < self._share < 1.0:
            left_s = round(elapsed_s * (1.0 - self._share) / self._share)
            hours = f"{left_s // 3600}:{left_s // 60 % 60:02d}" if left_s >= 3600 else ""
            minutes = f"{left_s // 60}"
            rest = f"  {100.0 * self._share:.0f} %  {hours or minutes}:{left_s % 60:02d} left"
        return f"{visible(f'{self._head}{self._remark}{self._stage}')[: max(columns - len(rest) - 1, 0)]}{rest}"


@contextmanager
def progress(
    text: str, plan: Plan = MappingProxyType({}), remark: str = ""
) -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Show how far the work is, on a terminal only; what is yielded makes room for messages and tables."""
    console = Console(file=sys.stderr, highlight=False)
    meter = Meter(text, plan, remark)
    if not console.is_terminal:
        yield nullcontext
        return
    from rich.live import Live

    def line() -> Text:
        return Text(meter.line(console.width), no_wrap=True)

    def show(stage: str, done: int, total: int) -> None:
        meter.report(stage, done, total)
        live.refresh()

    @contextmanager
    def paused() -> Iterator[None]:
        live.stop()
        yield
        live.start()

    with (
        Live(get_renderable=line, console=console, transient=True) as live,
        progress_listener(show),
    ):
        yield paused


def log_settings(dives: "Sequence[FoundDive]", *, quiet: bool = False) -> None:
    """Say which files of settings are used that nobody has named."""
    if quiet:
        return
    from insdvl_replay.batch.local_settings import settings_sentences

    for sentence in settings_sentences(dives):
        log_info(sentence)


def fetch_with_progress(
    dives: "Sequence[FoundDive]", *, offline: bool = False, whole: bool = False
) -> "list[FoundDive]":
    """Fetch the remote logs of dives, and show the progress; each dive that cannot be had has its error."""
    from insdvl_replay.batch.manifest import fetch_dives

    is_remote = any(dive.url or dive.parts for dive in dives)
    with progress("fetching logs") if is_remote else nullcontext():
        return fetch_dives(dives, offline=offline, whole=whole)


def replaying(
    jobs: int,
    scheduler: str | None,
    *,
    force: bool,
    rerun: bool,
    quiet: bool,
) -> "Replaying":
    """Return how a command replays dives, and shows its progress."""
    from insdvl_replay.batch.replaying import Replaying

    def while_working(text: str) -> "AbstractContextManager[Paused]":
        return progress(text, REPLAY, compiling())

    def report_note(note: Note) -> None:
        log_notes([note], verbose=True)

    def say(line: str) -> None:
        if not quiet:
            log_to_stderr(line)

    return Replaying(
        jobs=jobs,
        scheduler=scheduler,
        code_apart=True,
        force=force,
        rerun=rerun,
        working=while_working,
        report_note=report_note,
        say=say,
    )


def compiling() -> str:
    """Return the end of a text that announces the first compilation; empty if the filter is compiled.

    If compiled code cannot be stored, each run compiles again. A warning says why.
    """
    if reason := cache_problem():
        text = f"warning: compiled code cannot be stored: {reason}. Each run compiles the filter again, about 20 s"
        log_to_stderr(f"{text}; hint: INSDVL_REPLAY_CACHE=/a/folder/of/yours")
    if is_warm():
        return ""
    require_memory(LEAST_TO_COMPILE_BYTES)
    return ", the first run compiles the filter (10 s)"
