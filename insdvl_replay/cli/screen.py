"""Width and colours of the terminal, and progress bars, by rich."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from rich.console import Console, RenderableType

from insdvl_replay.cli.messages import log_to_stderr
from insdvl_replay.core.errors import visible
from insdvl_replay.core.result import Result
from insdvl_replay.core.runtime import cache_problem, is_warm, progress_listener
from insdvl_replay.show.render import document as parts_of
from insdvl_replay.show.render import render
from insdvl_replay.show.text import for_terminal

if TYPE_CHECKING:
    from rich.progress import Progress

PIPED_COLUMNS = 10_000
"""Width without a terminal, so that no line is wrapped."""


def written(result: Result, format_: str) -> str:
    """Return a result in the ``--format`` asked for."""
    return printed(for_terminal(parts_of(result))) if format_ == "table" else render(result, format_)


class Colors:
    """Whether stdout has colours: by ``--color``, else on a terminal unless NO_COLOR is set."""

    wanted: bool | None = None

    @classmethod
    def system(cls) -> Literal["auto", "standard"] | None:
        """Return the colour system for rich."""
        if cls.wanted is None:
            return None if os.environ.get("NO_COLOR") else "auto"
        return "standard" if cls.wanted else None


def printed(content: RenderableType) -> str:
    """Render tables for stdout: as wide as the terminal, or unlimited without one."""
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
def progress(text: str) -> Iterator["Progress"]:
    """Show the stage of the work and its progress, on a terminal only."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=sys.stderr, highlight=False)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(visible(text), total=None)

        def show(stage: str, done: int, total: int) -> None:
            counts = f" {done} of {total}" if total else ""
            bar.update(task, description=visible(f"{text}: {stage}{counts}"), refresh=True)
            if total:
                bar.update(task, completed=done, total=total)

        with progress_listener(show):
            yield bar


def compiling() -> str:
    """Return the end of a sentence that announces the first compilation; empty if the filter is compiled.

    If compiled code cannot be stored, each run compiles again. A warning says why.
    """
    if reason := cache_problem():
        text = f"warning: compiled code cannot be stored: {reason}. Each run compiles the filter again, about 20 s"
        log_to_stderr(f"{text}; hint: INSDVL_REPLAY_CACHE=/a/folder/of/yours")
    return "" if is_warm() else "; the first run on a machine compiles the filter, about 10 s"
