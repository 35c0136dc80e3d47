"""What became of the gates as JSON."""

from typing import Annotated

from msgspec import Meta, Struct

from insdvl_replay.gates.model import CheckResult, Judgement
from insdvl_replay.results.json_report import Tool, as_json, this_tool


class CheckReport(Struct, frozen=True):
    """All gates on all dives, and how many of each kind."""

    tool: Tool
    gates: Annotated[str, Meta(description="the gate file")]
    failed: int
    unusable: Annotated[int, Meta(description="the dive could not be replayed, or its result not be read")]
    warning: int
    off: int
    passed: int
    judgements: Annotated[tuple[Judgement, ...], Meta(description="failures first")]


def check_json(result: CheckResult) -> str:
    """Write JSON, indented.

    Parameters
    ----------
    result : CheckResult

    Returns
    -------
    str
    """
    report = CheckReport(
        this_tool(),
        result.gates,
        result.count("failed"),
        result.count("unusable"),
        result.count("warning"),
        result.count("off"),
        result.count("passed"),
        result.judgements,
    )
    return as_json(report).decode()
