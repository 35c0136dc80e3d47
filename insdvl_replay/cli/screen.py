"""The terminal's width, colour and spinner, as rich sees them."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

from rich.console import Console, RenderableType

from insdvl_replay.cli.messages import log_to_stderr
from insdvl_replay.core.result import Result
from insdvl_replay.core.runtime import cache_problem, is_warm, progress_listener
from insdvl_replay.show.render import document as parts_of
from insdvl_replay.show.render import render
from insdvl_replay.show.text import for_terminal, spoken

PIPED_COLUMNS = 10_000
"""Wide enough that nothing is ever folded where no terminal limits the width."""


def written(result: Result, format_: str) -> str:
    """Return a result as ``--format`` asks for it."""
    return printed(for_terminal(parts_of(result))) if format_ == "table" else render(result, format_)


class Colors:
    """Whether stdout has colours: as ``--color`` wants it; without a wish, on a terminal unless NO_COLOR is set."""

    wanted: bool | None = None

    @classmethod
    def system(cls) -> Literal["auto", "standard"] | None:
        """Return what rich calls the kind of colours."""
        if cls.wanted is None:
            return None if os.environ.get("NO_COLOR") else "auto"
        return "standard" if cls.wanted else None


def printed(content: RenderableType) -> str:
    """Lay tables out for stdout: as wide as the terminal, or as wide as it takes."""
    console = Console(
        file=sys.stdout,
        highlight=False,
        width=None if sys.stdout.isatty() else PIPED_COLUMNS,
        color_system=Colors.system(),
        force_terminal=Colors.wanted or None,
    )
    with console.capture() as capture:
        console.print(content, crop=False)
    return "\n".join(line.rstrip() for line in capture.get().split("\n"))


@contextmanager
def spinner(text: str) -> Iterator[None]:
    """Report what is waited for, and how far the work is, on a terminal only."""
    console = Console(file=sys.stderr, highlight=False)
    if not console.is_terminal:
        yield
        return
    with (
        console.status(spoken(text)) as status,
        progress_listener(lambda stage, *_: status.update(spoken(f"{text}: {stage}"))),
    ):
        yield


@contextmanager
def steps_bar(text: str) -> Iterator[None]:
    """Show how far each stage of the work is, on a terminal only."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(file=sys.stderr, highlight=False)
    if not console.is_terminal:
        yield
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(text, total=None)

        def show(stage: str, done: int, total: int) -> None:
            if total:
                bar.update(task, description=f"{text}: {stage}", completed=done, total=total)

        with progress_listener(show):
            yield


def compiling() -> str:
    """Report what a first run waits for, as the end of a sentence; nothing where the filter is compiled.

    Where compiled code cannot be kept, each run waits for it, and a warning says why.
    """
    if reason := cache_problem():
        text = f"warning: compiled code cannot be kept: {reason}. Each run compiles the filter, for some 20 s"
        log_to_stderr(f"{text}; hint: INSDVL_REPLAY_CACHE=/a/folder/of/yours")
    return "" if is_warm() else "; the first run on a machine compiles the filter, which takes some ten seconds"


class DivesBar:
    """How far many dives are, on a terminal only."""

    def __init__(self, total: int) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(file=sys.stderr, highlight=False)
        columns = (
            TextColumn("replaying"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("dives, {task.fields[failed]} failed, time left"),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._bar.add_task("", total=total, failed=0)
        self._failed = 0

    def __enter__(self) -> "DivesBar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def advance(self, *, failed: bool) -> None:
        """Count one dive more."""
        self._failed += failed
        self._bar.update(self._task, advance=1, failed=self._failed)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Make room for something that is said or printed."""
        self._bar.stop()
        try:
            yield
        finally:
            self._bar.start()


@contextmanager
def progress(text: str, total: int, note: str = "") -> Iterator[Callable[[], None]]:
    """Show how much of the work is done, on a terminal only."""
    from rich.progress import Progress

    console = Console(file=sys.stderr, highlight=False)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        if note and console.is_terminal:
            console.print(note)
        task = bar.add_task(text, total=total)
        yield lambda: bar.advance(task)
