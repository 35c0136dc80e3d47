"""docs/reproduction.md is what the program gives."""

import re
from pathlib import Path

import numpy as np
import paper_tables
import pictures
import pytest
import reproduction
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.states import NINE, STATES
from insdvl_replay.preparation.replay import replay_log

SAMPLE = reproduction.PROJECT / "sample_logs" / "straight.mcap"


@pytest.fixture(scope="module")
def found(snapir: Path) -> reproduction.Findings:
    return reproduction.find(snapir)


@pytest.mark.nightly
@pytest.mark.all_starts
def test_page_is_what_the_program_gives(found: reproduction.Findings) -> None:
    assert reproduction.written(found) == reproduction.PAGE.read_text("utf-8"), (
        "run `make reproduce`"
    )


@pytest.mark.nightly
def test_pages_show_every_picture_and_each_is_there(found: reproduction.Findings) -> None:
    drawn = {*pictures.PICTURES, *reproduction.drawn(found)}
    shown = shown_by("reproduction.md")
    assert shown | shown_by("verdict.md") | shown_by("lake.md") == drawn
    assert set(reproduction.drawn(found)) <= shown
    assert all((reproduction.PROJECT / name).is_file() for name in drawn)


def shown_by(page: str) -> set[str]:
    """Return the drawn pictures of a page, by their paths."""
    text = reproduction.PAGE.with_name(page).read_text("utf-8")
    return {f"docs/{name}" for name in re.findall(r"\]\((\w+\.svg)\)", text)}


def test_words_follow_from_the_numbers() -> None:
    assert paper_tables.deviation(1.06, 1.0) == "**+6.0 %**"
    assert paper_tables.deviation(0.96, 1.0) == "-4.0 %"
    assert paper_tables.agrees(56.73, 40.7) == "**no**"
    assert paper_tables.agrees(18.76, 18.4) == "yes"
    assert paper_tables.points(3.0, 0.5) == "**+2.5**"
    assert paper_tables.points(1.5, np.nan) == "+1.5"


@pytest.mark.parametrize(
    ("name", "published"), [("straight", "straight.csv"), ("figure_eight", "eight.csv")]
)
def test_published_figures_are_the_papers(name: str, published: str, paper: Path) -> None:
    rows = paper_tables.FACTS.with_name(paper_tables.read_facts()[name]["rows"])
    assert rows.read_text("utf-8") == (paper / published).read_text("utf-8")


@pytest.mark.parametrize("name", ["straight", "figure_eight"])
def test_published_means_are_those_of_the_rows_where_none_counts_as_nothing(name: str) -> None:
    course = paper_tables.read_course(name)
    assert list(course.rows.index) == [state.id for state in NINE]
    rows = course.rows.fillna(0.0)
    assert rows["improvement_pct"].mean() == pytest.approx(course.mean_improvement_pct, abs=0.006)
    assert rows["convergence_improvement_pct"].mean() == pytest.approx(
        course.mean_convergence_pct, abs=0.006
    )
    reached = course.rows["reached_s"].dropna()
    sooner_pct = 100.0 * (1.0 - reached / course.duration_s)
    np.testing.assert_allclose(
        course.rows.loc[reached.index, "convergence_improvement_pct"], sooner_pct, atol=0.006
    )


def test_figure_eight_next_to_the_paper() -> None:
    """What nobody has fitted: improvements within two points; horizontal biases are far off, and six times agree."""
    log = reproduction.PROJECT / "sample_logs" / "figure_eight.mcap"
    found = paper_tables.compared("figure_eight", replay_log(log, load_config("levy-klein")))
    published = found.course.rows
    improvement = found.improvement.loc[published.index, "improvement_pct"]
    assert (improvement - published["improvement_pct"]).abs().max() < 2.0
    off_pct = 100.0 * (
        found.improvement.loc[published.index, "baseline_sd"] / published["baseline_sd"] - 1.0
    )
    assert list(off_pct.index[off_pct.abs() > 5.0]) == ["ba_x", "ba_y", "bg_x", "bg_y"]
    agreeing = [
        state
        for state in published.index
        if paper_tables.time_agrees(published.loc[state], found.convergence.loc[state])
    ]
    assert agreeing == ["phi_n", "phi_e", "phi_d", "ba_x", "ba_y", "ba_z"]


def test_without_the_eight_dives_nothing_of_them_is_replayed(tmp_path: Path) -> None:
    assert reproduction.find_at_sea(tmp_path) is None
    for number in range(7):
        (tmp_path / f"snapir_{number}.mcap").touch()
    assert reproduction.find_at_sea(tmp_path) is None


@pytest.mark.nightly
def test_reasons_given_for_the_rows_that_disagree_hold() -> None:
    text = reproduction.PAGE.read_text("utf-8")
    phi_n = STATES[3]
    aided = replay_log(SAMPLE, load_config("levy-klein")).histories[1]
    assert f"at its largest, {aided.sd[:, phi_n.index].max() / phi_n.factor:.2f} mrad" in text
    override = "initial.misalignment_sd_deg=[0.485,0.485,0.5]"
    assert f"`--preset levy-klein --set {override}`" in text
    config = load_config("levy-klein", overrides=[override])
    rows = frame(replay_log(SAMPLE, config).tables.improvement).set_index("state")
    published = paper_tables.read_course("straight").rows
    for state in ("phi_n", "phi_e", "ba_x", "ba_y"):
        assert rows.loc[state, "baseline_sd"] == pytest.approx(
            published.loc[state, "baseline_sd"], rel=0.03
        )
        assert rows.loc[state, "sd"] == pytest.approx(published.loc[state, "aided_sd"], rel=0.03)
