"""The report: one result as data, saved as report.json, read back, and the source of everything that is shown."""

import math
import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Annotated, Any, Final

import msgspec
from msgspec import Meta, Struct

from insdvl_replay import __version__
from insdvl_replay.core.channel import Channel
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import sources_digest

if TYPE_CHECKING:
    # Only their types are needed, and whoever looks into a log or a report must not wait for them.
    import pandas as pd

    from insdvl_replay.core.columns import Dive

NUMERICAL_PACKAGES: Final = ("numpy", "numba", "pandas", "scipy", "mcap")
"""Packages whose version may move a number."""


Files = Annotated[
    dict[str, str],
    Meta(
        description="SHA-256 of each file of the result; of report.json, without the time of day and its own. Early "
        "reports lack it"
    ),
]
"""As `file_list` writes it when all files are there."""


class ImprovementRow(Struct, frozen=True):
    """What a candidate believes of one state at the end of the dive, beside the baseline."""

    log: str
    filter: str
    state: str
    unit: str
    baseline_sd: float | None
    sd: float | None
    improvement_pct: float | None
    status: str


class ConvergenceRow(Struct, frozen=True):
    """When a candidate became, and stayed, as sure of one state as the baseline is at the end."""

    log: str
    filter: str
    state: str
    unit: str
    target_sd: float | None
    baseline_s: float | None
    reached_s: float | None
    improvement_pct: float | None
    status: str


class ReferenceErrorRow(Struct, frozen=True):
    """How far a candidate is from the reference in one quantity, beside the baseline."""

    log: str
    filter: str
    quantity: str
    unit: str
    baseline_rmse: float | None
    rmse: float | None
    improvement_pct: float | None
    baseline_final: float | None
    final: float | None
    samples: int
    status: str


class ConsistencyRow(Struct, frozen=True):
    """Whether a filter's innovations are as large as it says."""

    log: str
    filter: str
    measurement: str
    dof: int
    used: int
    rejected: int
    mean_nis: float | None
    low: float | None
    high: float | None
    verdict: str
    autocorrelation: float | None = None
    autocorrelation_limit: float | None = None
    whiteness: str = ""


class CredibilityRow(Struct, frozen=True):
    """Whether a filter's errors against the reference, or the truth, are as large as it says."""

    log: str
    filter: str
    quantity: str
    dof: int
    samples: int
    mean_nees: float | None
    low: float | None
    high: float | None
    within_1sd_pct: float | None
    within_3sd_pct: float | None
    verdict: str
    effective_samples: float | None


class Tables(Struct, frozen=True):
    """The tables, row for row as in the CSV files; null for what is missing. Early reports lack ``credibility``."""

    improvement: list[ImprovementRow]
    convergence: list[ConvergenceRow]
    reference_error: list[ReferenceErrorRow]
    consistency: list[ConsistencyRow]
    credibility: list[CredibilityRow] = []


class Candidate(Struct, frozen=True):
    """What there is to say of one candidate."""

    verdict: Annotated[str, Meta(description="one paragraph for people: believed, actual, consistent")]
    improvement: Annotated[
        str, Meta(description="borne out, not borne out, worse, none believed, no reference or not judged")
    ]
    consistency: Annotated[str, Meta(description="the gravest verdict of its measurements")]
    mean_improvement_pct: Annotated[
        float | None, Meta(description="believed; nine states, without the velocity errors")
    ]
    mean_convergence_improvement_pct: Annotated[
        float | None, Meta(description="the same nine; never and at start count 0")
    ]
    reference_improvement_pct: Annotated[float | None, Meta(description="actual; median over the compared quantities")]
    credibility: Annotated[str, Meta(description="the verdict of its errors against the reference")] = ""


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
    files: Files = {}


def build_report(
    dive: "Dive",
    config: Config,
    tables: Mapping[str, "pd.DataFrame"],
    candidates: Mapping[str, Candidate],
    notes: Sequence[Note],
    start_ns: int,
    end_ns: int,
    tool: Tool = Tool(),
) -> Report:
    """Gather a result.

    Parameters
    ----------
    dive : Dive
    config : Config
        Resolved settings.
    tables : mapping of str to DataFrame
        ``improvement``, ``convergence``, ``reference_error``, ``consistency``, ``credibility``.
    candidates : mapping of str to Candidate
        By filter name.
    notes : sequence of Note
    start_ns, end_ns : int
        Span of the replay.
    tool : Tool
        With the time of day, if that is wanted.

    Returns
    -------
    Report
    """
    rows = msgspec.convert({name: records(table) for name, table in tables.items()}, Tables)
    return Report(
        tool=tool,
        versions=package_versions(),
        log=Log(dive.name, dive.sha256, start_ns, end_ns, (end_ns - start_ns) * 1e-9, list(dive.channels)),
        baseline=config.baseline,
        filters={name: _without_nan(candidate) for name, candidate in candidates.items()},
        tables=rows,
        notes=list(notes),
        config=msgspec.to_builtins(config),
    )


@cache
def package_versions() -> dict[str, str]:
    """Give the versions of Python and of the packages that may move a number."""
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

    Returns
    -------
    Report

    Raises
    ------
    msgspec.ValidationError
        The data are something else.
    """
    return msgspec.json.decode(data, type=Report)


def records(table: "pd.DataFrame") -> list[dict[str, Any]]:
    """Turn the rows of a table into what JSON can write: None for what is missing or not finite."""
    return [{str(key): _finite_or_none(value) for key, value in row.items()} for row in table.to_dict("records")]


def _without_nan(candidate: Candidate) -> Candidate:
    return Candidate(*map(_finite_or_none, msgspec.structs.astuple(candidate)))


def _finite_or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
