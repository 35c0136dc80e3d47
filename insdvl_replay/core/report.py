"""The report of a replay, report.json: built and written, and read back of this or another version."""

import hashlib
import importlib.util
import platform
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Meta, Struct

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_record import Channel, ImuFingerprint, ReferenceDelay, StartHeading
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import sources_digest
from insdvl_replay.core.tables import CandidateVerdict, Tables
from insdvl_replay.core.version import __version__

if TYPE_CHECKING:
    # Only types are needed: reading a stored result must not wait for these imports.
    from insdvl_replay.core.dive_columns import Dive

T = TypeVar("T")

# --- What made a report, and which files belong to it. The results of other commands say this as well.


class Tool(Struct, frozen=True):
    """Program and time of the report. Only this differs between two runs on the same input."""

    name: str = "insdvl-replay"
    version: str = __version__
    sources: Annotated[
        str | None,
        Meta(description="digest of the package's files, which change without its version"),
    ] = None
    started_at: Annotated[str | None, Meta(description="UTC, ISO 8601")] = None
    elapsed_s: float | None = None
    cpu_s: Annotated[
        dict[str, float], Meta(description="processor seconds of one run over the dive, by filter")
    ] = {}


def this_tool() -> Tool:
    """Return this program's name and version, without the time of day."""
    return Tool(sources=sources_digest())


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that may affect numbers."""
    packages = ("numpy", "numba", "pandas", "scipy", "mcap")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


Files = Annotated[
    dict[str, str],
    Meta(
        description="SHA-256 of each file of the result; of report.json, without the time of day and its own. Early "
        "reports lack it"
    ),
]
"""Names and digests, as `folder.list_files` writes them at the end."""


# --- The report of a replay, report.json.


class Log(Struct, frozen=True):
    """The log that was replayed."""

    name: str
    sha256: Annotated[
        str, Meta(description="of the log's bytes; empty for a dive that was never a file")
    ]
    start_ns: Annotated[int, Meta(description="on the log's own clock")]
    end_ns: int
    duration_s: float
    channels: list[Channel]


class CodeFile(Struct, frozen=True):
    """A file of user code that was run."""

    file: str
    sha256: str


class Report(Struct, frozen=True):
    """The result of one replay."""

    tool: Tool
    versions: Annotated[
        dict[str, str],
        Meta(description="versions of Python and of the packages that may affect numbers"),
    ]
    log: Log
    baseline: Annotated[
        str, Meta(description="name of the filter that the candidates are compared with")
    ]
    filters: Annotated[
        dict[str, CandidateVerdict],
        Meta(description="verdict and mean improvements of each candidate"),
    ]
    tables: Tables
    notes: Annotated[
        list[Note], Meta(description="notes: dropped data, assumptions and anomalies")
    ]
    config: Annotated[
        dict[str, Any], Meta(description="resolved settings, as in config.schema.json")
    ]
    code: Annotated[
        dict[str, CodeFile],
        Meta(description="user code that was run, by its name in the settings"),
    ] = {}
    reference_delay: Annotated[
        ReferenceDelay | None,
        Meta(
            description="how much later the reference's stamps are than the IMU's, beyond reference.latency_s; null in "
            "early reports, which did not look"
        ),
    ] = None
    vehicle: Annotated[
        str,
        Meta(
            description="that made the dive, as its manifest or vehicle.name says; empty: nobody said"
        ),
    ] = ""
    imu_fingerprint: Annotated[
        ImuFingerprint | None,
        Meta(
            description="digests of samples of the IMU, by which copies of a dive are known; null in early reports"
        ),
    ] = None
    start_heading: Annotated[
        StartHeading | None,
        Meta(
            description="what the heading at the start comes from, and how well it is known; null in early reports"
        ),
    ] = None
    files: Files = {}


def build_report(
    dive: "Dive",
    config: Config,
    tables: Tables,
    candidates: Mapping[str, CandidateVerdict],
    notes: Sequence[Note],
    start_ns: int,
    end_ns: int,
    tool: Tool = Tool(),
) -> Report:
    """Return the result of a replay, in which numbers that are not finite are missing.

    Parameters
    ----------
    dive : Dive
        The dive that was replayed, with what the log says of it.
    config : Config
        The resolved settings.
    tables : Tables
        The rows of all tables.
    candidates : mapping of str to CandidateVerdict
        The verdict on each candidate, by its name.
    notes : sequence of Note
        All notes of reading and replaying.
    start_ns, end_ns : int
        Start and end of the replay on the log's clock, ns.
    tool : Tool
        Program and time.
    """
    return Report(
        tool=tool,
        versions=package_versions(),
        log=Log(
            dive.name,
            dive.sha256,
            start_ns,
            end_ns,
            (end_ns - start_ns) * 1e-9,
            list(dive.channels),
        ),
        baseline=config.baseline,
        filters=_without_nan(dict(candidates), dict[str, CandidateVerdict]),
        tables=_without_nan(tables, Tables),
        notes=list(notes),
        config=msgspec.to_builtins(config),
        code={word: _code_file(word) for word in config.code},
        reference_delay=dive.reference_delay,
        vehicle=config.vehicle.name,
        imu_fingerprint=dive.imu_fingerprint,
        start_heading=dive.start_heading,
    )


def _code_file(word: str) -> CodeFile:
    """Return the file of a program, or of the module of a class."""
    module, is_class, _ = word.partition(":")
    file = getattr(sys.modules.get(module), "__file__", None) or shutil.which(word) or word
    # A class is imported by a process of its own.
    if is_class and "/" not in word and module not in sys.modules:
        try:
            file = getattr(importlib.util.find_spec(module), "origin", None) or ""
        except Exception:  # of a package that is imported on the way
            file = ""
    file = file if Path(file).is_file() else ""
    return CodeFile(file, hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else "")


def _without_nan(content: T, kind: type[T]) -> T:
    """Return the value as JSON gives it back: None for missing or not finite numbers."""
    return msgspec.json.decode(msgspec.json.encode(content), type=kind)


def as_json(content: Any) -> bytes:
    """Return JSON, indented, with a final newline. The same content gives the same bytes."""
    return msgspec.json.format(msgspec.json.encode(content)) + b"\n"


# Made once, before threads: msgspec 0.22 ends the process if two of them meet a type for the first time.
_REPORTS: Final = msgspec.json.Decoder(Report)


def decode_report(data: bytes) -> Report:
    """Read a report of this version.

    Raises
    ------
    msgspec.DecodeError
        The data are not JSON or, as a msgspec.ValidationError, not a report.
    """
    return _REPORTS.decode(data)


# --- A stored report of this or another version, with the tables, rows and columns that it has.

Cell = str | int | float | bool | None
Row = dict[str, Cell]


class StoredLog(Struct, frozen=True):
    """The log that was replayed. Fields that an old result does not have are empty."""

    name: str
    sha256: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    duration_s: float | None = None
    channels: list[dict[str, Cell]] = []


class StoredReport(Struct, frozen=True):
    """The blocks of a report.json."""

    tool: dict[str, Any]
    log: StoredLog
    tables: dict[str, list[Row]]
    versions: dict[str, str] = {}
    baseline: str = ""
    filters: dict[str, Row] = {}
    notes: list[Note] = []
    config: dict[str, Any] = {}
    reference_delay: ReferenceDelay | None = None
    vehicle: str = ""
    imu_fingerprint: ImuFingerprint | None = None


@dataclass(frozen=True)
class StoredResult:
    """One result and its folder."""

    folder: Path  # of the report
    below: str  # the folder relative to the searched folder; ``.`` for that folder
    report: StoredReport

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.report.log.name
