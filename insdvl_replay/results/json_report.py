"""The report: one result as data, saved as report.json, read back, and the source of everything that is shown."""

import hashlib
import platform
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Meta, Struct

from insdvl_replay import __version__
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_record import Channel
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import sources_digest
from insdvl_replay.core.tables import Candidate, Tables

if TYPE_CHECKING:
    # Only its type is needed, and whoever looks into a report must not wait for it.
    from insdvl_replay.core.dive_columns import Dive

T = TypeVar("T")
NUMERICAL_PACKAGES: Final = ("numpy", "numba", "pandas", "scipy", "mcap")
"""Packages whose version may move a number."""


Files = Annotated[
    dict[str, str],
    Meta(
        description="SHA-256 of each file of the result; of report.json, without the time of day and its own. Early "
        "reports lack it"
    ),
]
"""As `folder.list_files` writes it when all files are there."""


class Log(Struct, frozen=True):
    """What was replayed."""

    name: str
    sha256: Annotated[str, Meta(description="of the log's bytes; empty for a dive that was never a file")]
    start_ns: Annotated[int, Meta(description="on the log's own clock")]
    end_ns: int
    duration_s: float
    channels: list[Channel]


class Tool(Struct, frozen=True):
    """What made the report, and when: the one place where two runs on the same input may differ."""

    name: str = "insdvl-replay"
    version: str = __version__
    sources: Annotated[
        str | None, Meta(description="digest of the package's files, which change without its version")
    ] = None
    started_at: Annotated[str | None, Meta(description="UTC, ISO 8601")] = None
    elapsed_s: float | None = None


def this_tool() -> Tool:
    """Name this program as it is, without the time of day."""
    return Tool(sources=sources_digest())


class CodeFile(Struct, frozen=True):
    """A file of the user's code that was run."""

    file: str
    sha256: str


class Report(Struct, frozen=True):
    """The result of one replay."""

    tool: Tool
    versions: Annotated[dict[str, str], Meta(description="of Python and the packages that may move a number")]
    log: Log
    baseline: Annotated[str, Meta(description="name of the filter that the candidates are compared with")]
    filters: Annotated[dict[str, Candidate], Meta(description="what there is to say of each candidate")]
    tables: Tables
    notes: Annotated[list[Note], Meta(description="what was dropped, assumed or found odd")]
    config: Annotated[dict[str, Any], Meta(description="resolved settings, as in config.schema.json")]
    code: Annotated[dict[str, CodeFile], Meta(description="the user's code that was run, by its word in aiding")] = {}
    files: Files = {}


def build_report(
    dive: "Dive",
    config: Config,
    tables: Tables,
    candidates: Mapping[str, Candidate],
    notes: Sequence[Note],
    start_ns: int,
    end_ns: int,
    tool: Tool = Tool(),
) -> Report:
    """Gather a result."""
    return Report(
        tool=tool,
        versions=package_versions(),
        log=Log(dive.name, dive.sha256, start_ns, end_ns, (end_ns - start_ns) * 1e-9, list(dive.channels)),
        baseline=config.baseline,
        filters=_without_nan(dict(candidates), dict[str, Candidate]),
        tables=_without_nan(tables, Tables),
        notes=list(notes),
        config=msgspec.to_builtins(config),
        code={word: _code_file(word) for word in config.code},
    )


def _code_file(word: str) -> CodeFile:
    """Name the file from which a replay of this process has imported the code."""
    file = getattr(sys.modules.get(word.partition(":")[0]), "__file__", None) or ""
    return CodeFile(file, hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else "")


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that may move a number."""
    return {"python": platform.python_version()} | {name: version(name) for name in NUMERICAL_PACKAGES}


def encode_report(report: Report | Sequence[Report]) -> bytes:
    """Write a report, or several as one array, as JSON. The same report gives the same bytes."""
    return as_json(report)


def as_json(content: Any) -> bytes:
    """Write JSON, indented, with a final newline."""
    return msgspec.json.format(msgspec.json.encode(content)) + b"\n"


def decode_report(data: bytes) -> Report:
    """Read a report back.

    Parameters
    ----------
    data : bytes
        From `encode_report`.

    Raises
    ------
    msgspec.ValidationError
        The data are something else.
    """
    return msgspec.json.decode(data, type=Report)


def _without_nan(content: T, kind: type[T]) -> T:
    """Return what JSON would give back: None for what is missing or not finite."""
    return msgspec.json.decode(msgspec.json.encode(content), type=kind)
