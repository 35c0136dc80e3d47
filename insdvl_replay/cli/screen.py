"""The terminal's width, colour and patience, as rich sees them."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType

from insdvl_replay.report.json_report import Report
from insdvl_replay.report.terminal import terminal_report

PIPED_COLUMNS = 1000
"""Wide enough that nothing is ever folded where no terminal limits the width."""


def rendered(report: Report) -> str:
    """Lay a report out for stdout."""
    return printed(terminal_report(report))


def printed(content: RenderableType) -> str:
    """Lay tables out for stdout: as wide as the terminal, or as wide as it takes."""
    console = Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else PIPED_COLUMNS)
    with console.capture() as capture:
        console.print(content)
    return "\n".join(line.rstrip() for line in capture.get().split("\n"))


@contextmanager
def patience(text: str) -> Iterator[None]:
    """Say what is waited for, on a terminal only."""
    console = Console(file=sys.stderr, highlight=False)
    if not console.is_terminal:
        yield
        return
    with console.status(text):
        yield
