"""One filter without candidates has its errors, drift and consistency on every screen, page and table."""

import pytest
from msgspec.structs import replace

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.document.render import render
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dive import dive_document, replay_result
from insdvl_replay.show.dives import index_page, overview_parts, summary_rows
from insdvl_replay.show.result_files import report_of
from insdvl_replay.show.screens import dive_screen, dives_screen, quiet_lines
from insdvl_replay.sim.dive import simulate_dive

NAMES = (
    "position rms",
    "depth rms",
    "velocity rms",
    "drift in 60 s",
    "outage 60 s: p50",
    "NIS / dof",
)


@pytest.fixture(scope="module")
def reports() -> tuple[Report, Report]:
    """The same dive with one filter, and with a candidate next to it."""
    dive = simulate_dive("figure-eight", seed=1, duration_s=260.0)
    alone, pair = (
        [*left_out, "dvl.beam_sd_mps=0.006", "evaluation.starts=1"]
        for left_out in (["filters.aided=false"], [])
    )
    return tuple(
        report_of(replay_dive(dive, load_config("fog", overrides=given)))
        for given in (alone, pair)
    )  # type: ignore[return-value]


def test_the_errors_are_those_of_the_baseline_next_to_a_candidate(
    reports: tuple[Report, Report],
) -> None:
    alone, pair = (report.tables.reference_error for report in reports)
    assert [(row.filter, row.quantity, row.rmse, row.final, row.status) for row in alone] == [
        ("baseline", row.quantity, row.baseline_rmse, row.baseline_final, row.status)
        for row in pair
    ]
    assert {(row.baseline_rmse, row.improvement_pct) for row in alone} == {(None, None)}


def test_every_screen_and_page_has_them(reports: tuple[Report, Report]) -> None:
    report = reports[0]
    (line,) = quiet_lines([report])
    documents = (dive_screen(report, "page"), dive_document(report))
    shown = [
        render(replay_result(report, parts, []), format_)
        for parts in documents
        for format_ in ("md", "html")
    ]
    for text in (line, *shown):
        assert all(name in text for name in NAMES)
        assert "Reference error: baseline against" not in text
    assert shown[-1].index("position rms") < shown[-1].index("CEP50"), (
        "the answer is above what follows from it"
    )


def test_several_dives_have_a_row_each(reports: tuple[Report, Report]) -> None:
    parts = dives_screen([reports[0], Failure("lost", "no log")], "index.html")
    text = render(replay_result([reports[0]], parts, []), "md")
    assert all(name in text for name in NAMES[:3])
    assert "failed" in next(line for line in text.splitlines() if "lost" in line)


def test_the_page_of_several_dives_has_their_values_and_links_and_no_empty_column(
    reports: tuple[Report, Report],
) -> None:
    alone, pair = reports
    text = render(replay_result([alone], overview_parts([alone, alone]), []), "md")
    head, _, first, second = (line for line in text.splitlines() if line.startswith("|"))
    cells = dict(zip(head.split(" | "), first.split(" | "), strict=True))
    assert first == second
    position = next(
        row.rmse for row in alone.tables.reference_error if row.quantity == "position_h"
    )
    assert cells["position rms [m]"] == f"{position:.3g}"
    assert cells["consistency"] == "conservative"
    assert "verdict" not in head
    page = index_page([alone, Failure("lost", "no log")]).decode()
    assert f'<a href="{alone.log.name}/report.html">{alone.log.name}</a>' in page
    assert "no log" in page
    assert "position rms" not in index_page([pair, pair]).decode(), "these are in the evidence"


def test_the_summary_has_the_same_values_with_and_without_a_candidate(
    reports: tuple[Report, Report],
) -> None:
    alone, pair = reports
    (baseline,), (aided,) = summary_rows([alone]), summary_rows([pair])
    assert (baseline.filter, baseline.verdict, baseline.evidence, aided.filter) == (
        "baseline",
        None,
        None,
        "aided",
    )
    assert baseline.position_h_rmse_m == aided.position_h_baseline_rmse_m
    assert baseline.position_h_rmse_pct == aided.position_h_baseline_rmse_pct
    assert pair.filters["aided"].verdict == Verdict.UNDECIDED
    assert aided.verdict is None, "one dive has no verdict"
    decided = next(row for row in pair.tables.evidence if row.quantity == aided.evidence)
    assert aided.ratio == decided.ratio
    for row, report in ((baseline, alone), (aided, pair)):
        assert None not in (
            row.depth_rmse_m,
            row.velocity_rmse_mps,
            row.drift_60s_rms_m,
            row.outage_60s_drift_m,
        )
        sizes = next(found for found in report.tables.consistency if found.filter == row.filter)
        assert row.nis_per_dof == pytest.approx(finite(sizes.mean_nis) / sizes.dof)


def test_the_summary_has_the_words_that_one_dive_can_have(reports: tuple[Report, Report]) -> None:
    _, pair = reports
    unsound = replace(pair.filters["aided"], verdict=Verdict.NOT_EVALUATED)
    (aided,) = summary_rows([replace(pair, filters={"aided": unsound})])
    assert aided.verdict == Verdict.NOT_EVALUATED
    still = [replace(row, acts=1e-6) for row in pair.tables.evidence]
    (aided,) = summary_rows([replace(pair, tables=replace(pair.tables, evidence=still))])
    assert aided.verdict == Verdict.NO_EFFECT
