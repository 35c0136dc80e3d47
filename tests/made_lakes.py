"""Reports of replays for a lake."""

import hashlib
from collections.abc import Sequence

from made_reports import report
from msgspec.structs import replace

from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.results.folder import SETTINGS_FILE


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def replayed(
    dive: str = "dive",
    settings: str = "old",
    version: str = "0.1.0",
    *,
    rows: Sequence[EvidenceRow] | None = None,
    verdict: str = "better",
) -> Report:
    """Return the report of a dive with some settings, whose digests are those of their names."""
    made = report(dive)
    evidence = made.tables.evidence if rows is None else [replace(row, log=dive) for row in rows]
    return replace(
        made,
        tool=replace(
            made.tool,
            version=version,
            started_at=f"2026-01-0{1 + (settings == 'new')}T00:00:00+00:00",
        ),
        log=replace(made.log, sha256=digest(dive)),
        filters={"aided": replace(made.filters["aided"], verdict=verdict)},
        tables=replace(made.tables, evidence=evidence),
        files={SETTINGS_FILE: digest(settings)},
    )


def named(dive: str, verdict: str = "better") -> Report:
    """Return the report of a dive whose rows have its name."""
    return replayed(dive, rows=report(dive).tables.evidence, verdict=verdict)
