"""Pages that are partly written by the program: prose by hand, numbers between markers by a command."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]


def renewed(page: str, parts: Mapping[str, Callable[[], str]], command: str) -> str:
    """Give a page with each part between its markers written anew.

    Parameters
    ----------
    page : str
        Markdown with ``<!-- NAME: written by COMMAND -->`` and ``<!-- end of NAME -->`` around each part.
    parts : mapping of str to callable
        What writes each part, by name.
    command : str
        Stands in the markers.

    Returns
    -------
    str
    """
    for name, part in parts.items():
        begin = f"<!-- {name}: written by {command} -->\n"
        end = f"<!-- end of {name} -->"
        head, rest = page.split(begin)
        _, tail = rest.split(end)
        page = f"{head}{begin}{part()}\n{end}{tail}"
    return page


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table."""
    lines = [f"| {' | '.join(header)} |", "|" + " --- |" * len(header)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])
