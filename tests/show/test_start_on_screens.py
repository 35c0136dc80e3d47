"""What the heading at the start comes from stands once on every screen that has an answer."""

import io
from functools import cache

import pytest
from msgspec.structs import replace
from rich.console import Console

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_record import StartHeading
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Report, build_report
from insdvl_replay.core.words import HeadingSource
from insdvl_replay.document.tables import number
from insdvl_replay.document.text import for_terminal
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.show.dives import index_page, summary_rows
from insdvl_replay.show.screens import dive_screen, dives_screen
from insdvl_replay.sim.dive import simulate_dive

NOTE = "start: attitude of the reference, level +- 0.02 deg, heading +- 0.06 deg"


@cache
def report() -> Report:
    simulated = simulate_dive(
        "lawnmower", seed=1, duration_s=60.0, grade="tactical", imu_rate_hz=20.0
    )
    config = load_config(
        "tactical", overrides=["evaluation.starts=1", "dvl.velocity_sd_mps=0.004"]
    )
    found = replay_dive(simulated, config)
    return build_report(
        found.dive, config, found.tables, found.verdicts, found.notes, found.start_ns, found.end_ns
    )


def dive(
    name: str, source: HeadingSource = HeadingSource.REFERENCE, sd_deg: float = 0.06
) -> Report:
    made = report()
    log = replace(made.log, name=name, sha256=name)
    return replace(
        made, log=log, notes=[], imu_fingerprint=None, start_heading=StartHeading(source, sd_deg)
    )


def starts(document: list[object]) -> list[str]:
    console = Console(width=200, record=True, file=io.StringIO(), color_system=None)
    console.print(for_terminal(document), crop=False)  # type: ignore[arg-type]
    return [
        line.strip() for line in console.export_text().split("\n") if line.startswith("start: ")
    ]


def test_several_dives_name_their_starts_once() -> None:
    dives = [dive("a"), dive("b"), dive("c", HeadingSource.SENSOR, 2.0)]
    (line,) = starts(list(dives_screen(dives, "index.html")))
    assert (
        line
        == "start: heading of the reference (0.06 deg) on 2 dives, heading of the sensor (2 deg) on 1 dive"
    )


@pytest.mark.parametrize("is_noted", [True, False])
def test_one_dive_names_its_start_in_a_line(is_noted: bool) -> None:
    notes = [Note("start_source", NOTE)] if is_noted else []
    (line,) = starts(list(dive_screen(replace(dive("a"), notes=notes), "report.html")))
    assert line == "start: heading of the reference (0.06 deg)"


def test_early_reports_do_not_know_their_start() -> None:
    early = [replace(dive(name), start_heading=None) for name in "abc"]
    assert starts(list(dives_screen(early, "index.html"))) == []


def candidate_twice(name: str) -> Report:
    """Return a dive with a second candidate, which has the results of the first."""
    made = dive(name)
    (first,) = made.filters
    again = replace(
        made.tables,
        evidence=[
            *made.tables.evidence,
            *(replace(row, filter="again") for row in made.tables.evidence if row.filter == first),
        ],
    )
    return replace(made, filters={**made.filters, "again": made.filters[first]}, tables=again)


def test_a_page_of_several_candidates_names_their_common_start_once() -> None:
    page = index_page([candidate_twice(name) for name in "abc"]).decode()
    assert page.count('class="candidate ') == 2
    assert page.lower().count("start: heading of the reference (0.06 deg)") == 1
    assert page.count("as uncertain as [initial]: level") == 1


def test_a_page_has_the_error_of_a_candidate_without_a_verdict() -> None:
    made = dive("a")
    (name,) = made.filters
    found = {row.filter: row for row in summary_rows([made, dive("b")])}
    assert found[name].verdict is None
    assert found[name].position_h_rmse_m is not None
    text = number(found[name].position_h_rmse_m)
    assert f"<td>{text}</td>" in index_page([made, dive("b")]).decode()
