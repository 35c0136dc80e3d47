"""A lake for the page on it: six versions of a filter on twelve dives, of which the fourth version is 20 % worse.

The ratios are drawn, not replayed, so that the page has the same dates and numbers each time.
"""

import hashlib
from pathlib import Path

import numpy as np

from insdvl_replay.core.tables import LakeRow
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.results.lake import LakeWriter, require_lake

DIVES = 12
FACTORS = {"v1.0": 1.0, "v1.1": 1.0, "v1.2": 1.0, "v1.3": 1.2, "v1.4": 1.2, "v1.5": 1.2}


def write_example_lake(lake: Path) -> None:
    """Write the lake into a folder that is made."""
    require_lake(lake, ())
    rng = np.random.default_rng(3)
    of_dives = rng.normal(-0.2, 0.25, DIVES)
    for number, (revision, factor) in enumerate(FACTORS.items()):
        writer = LakeWriter(lake)
        ratios = factor * np.exp(of_dives + rng.normal(0.0, 0.02, DIVES))
        for dive, ratio in enumerate(ratios.tolist()):
            writer.add_rows([_row(dive, revision, ratio, number)])
        writer.close()


def _row(dive: int, revision: str, ratio: float, number: int) -> LakeRow:
    return LakeRow(
        log=f"dive_{dive + 1:02d}",
        filter="aided",
        evidence="track",
        quantity="position",
        unit="m",
        baseline=1.0,
        value=ratio,
        ratio=ratio,
        role=Role.PRIMARY,
        filter_verdict=Verdict.UNDECIDED,
        vehicle="",
        replay=_digest(f"{dive} {revision}")[:32],
        log_sha256=_digest(f"dive {dive}"),
        settings_sha256=_digest("settings"),
        code_sha256=_digest("new code" if FACTORS[revision] > 1.0 else "code"),
        revision=revision,
        version="0.1.0",
        started_at=f"2026-0{number + 1}-15T02:00:{dive:02d}+00:00",
    )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
