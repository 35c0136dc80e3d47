"""Versions of a candidate whose true steps are known."""

from collections.abc import Sequence

import numpy as np

from insdvl_replay.evaluation.steps import Version


def made_versions(
    seed: int,
    changes: Sequence[float],  # of each version against the first one, as a logarithm
    *,
    dives: int = 12,
    jitter: float = 0.03,  # standard deviation of a dive's logarithm from version to version
) -> list[Version]:
    """Return versions in the order of time, on the same dives."""
    rng = np.random.default_rng(seed)
    of_dives = rng.normal(-0.2, 0.3, dives)
    versions = []
    for number, change in enumerate(changes):
        logs = of_dives + change + rng.normal(0.0, jitter, dives)
        ratios = {f"dive {dive}": log for dive, log in enumerate(logs.tolist())}
        started_at = dict.fromkeys(ratios, f"2026-01-{number + 1:02d}")
        versions.append(Version(f"v{number}", ratios, dict.fromkeys(ratios, ""), started_at))
    return versions


def first_dives(versions: Sequence[Version], count: int) -> list[Version]:
    """Return the versions as they were when the archive had fewer dives, each of which all versions replay at once."""
    earlier = []
    for version in versions:
        ratios = dict(list(version.log_ratios.items())[:count])
        started_at = {dive: f"2026-01-{number + 1:02d}" for number, dive in enumerate(ratios)}
        earlier.append(Version(version.name, ratios, version.vehicles, started_at))
    return earlier
