"""How often `history` names a step that is not there, and one that is, on simulated versions of a filter.

Six versions have the same dives. Their ratios scatter from dive to dive, and a little from version to version. Without
a step, the archive is looked at after each version, and after each dive that all versions replay. `make judge` runs it.
"""

import math
from collections.abc import Sequence

from made_versions import first_dives, made_versions
from results import finish, machine, table

from insdvl_replay.evaluation.interval import BAND
from insdvl_replay.evaluation.steps import history_of

HISTORIES = 200
VERSIONS = 6
AT = 3  # the version that changes
ARCHIVES = (
    (8, 0.03),
    (12, 0.03),
    (20, 0.03),
    (12, 0.1),
    (20, 0.1),
)  # dives, and jitter of a version
SIZES = (0.1, 0.15, 0.2, 0.3)
ALLOWED = 1 / 20
SEEN = 0.95
SEEN_AT = (12, 0.03, 0.2)  # dives, jitter and size that must be seen


def is_ever_named(seed: int, changes: Sequence[float], dives: int, jitter: float) -> bool:
    """Return whether a step is named in any look: after each version, and after each dive from the third on."""
    versions = made_versions(seed, changes, dives=dives, jitter=jitter)
    if history_of(versions).steps:
        return True
    looks = [first_dives(versions, count) for count in range(3, dives + 1)]
    return any(history_of(look).steps for look in looks)


def is_found(seed: int, size: float, dives: int, jitter: float) -> bool:
    """Return whether a planted step is named at its version, and no other is."""
    changes = [math.log(1.0 + size) * (number >= AT) for number in range(VERSIONS)]
    versions = made_versions(seed, changes, dives=dives, jitter=jitter)
    return [step.version.name for step in history_of(versions).steps] == [f"v{AT}"]


def main() -> None:
    """Measure, print and write the page."""
    equal = [0.0] * VERSIONS
    at_edge = [0.0, *[math.log(BAND)] * (VERSIONS - 1)]
    lines = []
    all_met = True
    for dives, jitter in ARCHIVES:
        cells = [str(dives), f"{jitter:g}"]
        for changes in (equal, at_edge):
            named = sum(is_ever_named(seed, changes, dives, jitter) for seed in range(HISTORIES))
            all_met &= named <= ALLOWED * HISTORIES
            cells.append(f"{100.0 * named / HISTORIES:.1f} %")
        for size in SIZES:
            found = sum(is_found(seed, size, dives, jitter) for seed in range(HISTORIES))
            if (dives, jitter, size) == SEEN_AT:
                all_met &= found >= SEEN * HISTORIES
            cells.append(f"{100.0 * found / HISTORIES:.0f} %")
        lines.append(f"| {' | '.join(cells)} |")
    about = (
        f"{HISTORIES} histories of {VERSIONS} versions in each cell. *equal*: no version differs; *5 %*: all versions "
        "differ from the first by as much as the band. In both no step may be named, in however many looks; allowed "
        f"are {100.0 * ALLOWED:.0f} %. The others: a planted step is named at its version. {machine()}."
    )
    columns = (
        "dives",
        "scatter",
        "equal",
        "5 %",
        *(f"step of {100.0 * size:.0f} %" for size in SIZES),
    )
    part = "\n".join(["# History: steps", "", about, "", *table(columns, lines)])
    finish(part, is_whole=True, all_met=all_met)


if __name__ == "__main__":
    main()
