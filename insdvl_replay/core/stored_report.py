"""A result as it is read back, of this version or another: with whatever tables, rows and columns it holds."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import Struct

from insdvl_replay.core.errors import Note

Cell = str | int | float | bool | None
Row = dict[str, Cell]


class StoredLog(Struct, frozen=True):
    """What was replayed. Of an old result, what it does not say is empty."""

    name: str
    sha256: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    duration_s: float | None = None
    channels: list[dict[str, Cell]] = []


class StoredReport(Struct, frozen=True):
    """The blocks of a report.json, with whatever rows and columns they hold."""

    tool: dict[str, Cell]
    log: StoredLog
    tables: dict[str, list[Row]]
    versions: dict[str, str] = {}
    baseline: str = ""
    filters: dict[str, Row] = {}
    notes: list[Note] = []
    config: dict[str, Any] = {}


@dataclass(frozen=True)
class StoredResult:
    """One result and where it lies.

    Attributes
    ----------
    folder : Path
        That holds the report.
    below : str
        The same, seen from the folder that was searched; ``.`` for that folder itself.
    """

    folder: Path
    below: str
    report: StoredReport

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.report.log.name


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Return nested settings by their dotted keys; lists stay whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", list(value) if isinstance(value, tuple) else value
