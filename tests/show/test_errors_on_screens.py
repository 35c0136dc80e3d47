"""On a screen of several dives errors that are consistently overconfident are told, not only innovations."""

from msgspec.structs import replace
from test_misfit_on_screens import report

from insdvl_replay.core.report import Report
from insdvl_replay.core.words import Consistency
from insdvl_replay.show.screens import dives_screen


def dives(overconfident: int) -> list[Report]:
    """Return four dives, on some of which the errors of the baseline are too large."""
    found = []
    for number in range(4):
        rows = []
        for row in report().tables.credibility:
            word = Consistency.CONSISTENT
            if row.filter == "baseline" and number < overconfident:
                word = Consistency.OVERCONFIDENT
            rows.append(replace(row, verdict=word))
        name = f"dive_{number}"
        tables = replace(report().tables, credibility=rows)
        log = replace(report().log, name=name, sha256=name)
        found.append(replace(report(), log=log, tables=tables, imu_fingerprint=None))
    return found


def told(overconfident: int) -> list[str]:
    parts = dives_screen(dives(overconfident), "index.html")
    return [part for part in parts if isinstance(part, str) and "(NEES)" in part]


def test_errors_that_are_too_large_on_most_dives_are_told() -> None:
    assert told(1) == []
    (line,) = told(3)
    assert line.startswith(
        "errors against the reference (NEES): baseline 3 overconfident, 1 consistent; aided 4 consistent"
    )
