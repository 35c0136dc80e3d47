"""What differs between two results beside their tables: the reasons why a number may have moved."""

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from insdvl_replay.core.changes import Difference
from insdvl_replay.core.stored_result import StoredReport, StoredResult

_Pair = tuple[StoredResult, StoredResult]
BLOCKS: Final = ("tool", "versions", "config", "filters", "log", "notes")
"""In the order of what a reader asks first."""


def differences(pairs: list[_Pair]) -> tuple[Difference, ...]:
    """Name everything beside the tables that differs, once, with the dives that it concerns."""
    logs: dict[tuple[str, str, str | None, str | None], list[str]] = {}
    for old, new in pairs:
        before, after = _facts(old.report), _facts(new.report)
        for block, key in dict.fromkeys((*before, *after)):
            was, is_ = before.get((block, key)), after.get((block, key))
            if was != is_:
                logs.setdefault((block, key, was, is_), []).append(new.name)
    found = [Difference(*what, tuple(names)) for what, names in logs.items()]
    return tuple(sorted(found, key=lambda difference: BLOCKS.index(difference.block)))


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Give nested settings by their dotted keys; lists stay whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _facts(report: StoredReport) -> dict[tuple[str, str], str]:
    """Give all that may differ as text, by block and key. Times of day and of computation always differ."""
    log = report.log
    tool = {key: value for key, value in report.tool.items() if key in {"name", "version", "sources"}}
    filters = ", ".join([report.baseline, *report.filters])
    span = {"start_ns": log.start_ns, "end_ns": log.end_ns, "duration_s": log.duration_s}
    channels = {f"channels {channel.get('topic')}": _channel(channel) for channel in log.channels}
    blocks: dict[str, Mapping[str, Any]] = {
        "tool": tool,
        "versions": report.versions,
        "config": dict(flattened(report.config)),
        "filters": {"names": filters},
        "log": {"name": log.name, "sha256": log.sha256, **span, **channels},
        "notes": {note.code: f"{note.count} ({note.severity})" for note in report.notes},
    }
    return {
        (block, key): value if isinstance(value, str) else json.dumps(value)
        for block, facts in blocks.items()
        for key, value in facts.items()
        if value is not None
    }


def _channel(channel: Mapping[str, Any]) -> str:
    return f"{channel.get('messages')} {channel.get('type_name')} ({channel.get('role') or 'unused'})"
