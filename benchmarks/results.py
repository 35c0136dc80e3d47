"""The page of results: one part for each benchmark, each written anew by its own."""

import platform
import re
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).with_name("RESULTS.md")


def machine() -> str:
    """Describe the machine in a sentence's beginning."""
    return f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, numpy {version('numpy')}"


def table(columns: tuple[str, ...], rows: list[str]) -> list[str]:
    """Give the lines of a table of rows that are written already."""
    return [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *rows]


def write_part(part: str) -> None:
    """Put a part in the place of the older one with the same heading, or after all others.

    Parameters
    ----------
    part : str
        Begins with its heading, ``# Title``.
    """
    text = RESULTS.read_text("utf-8") if RESULTS.exists() else ""
    parts = re.split(r"^(?=# )", text, flags=re.MULTILINE)
    heading = part.partition("\n")[0]
    kept = {older.partition("\n")[0]: older.strip() for older in parts if older.strip()}
    RESULTS.write_text("\n\n".join({**kept, heading: part.strip()}.values()) + "\n", "utf-8")
