"""docs/claims.md is what the papers and the kept results say, and a kept result is what its command gives."""

import math
import re

import published_claims as claims
import pytest
from scipy import stats

from insdvl_replay.core.config_file import load_config
from insdvl_replay.evaluation.interval import change_found, dives_needed

PAPERS = claims.load_papers()
RESULTS = claims.load_results()
COMMANDS = claims.commands(PAPERS)


def rows_of(part: str) -> list[list[str]]:
    """The rows of a part of the page, without its header."""
    page = claims.PAGE.read_text("utf-8")
    text = page.split(f"<!-- {part}: written by {claims.COMMAND} -->\n")[1]
    lines = text.split(f"<!-- end of {part} -->")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if line]


def test_the_page_is_what_is_kept() -> None:
    page = claims.PAGE.read_text("utf-8")
    assert claims.written(page, PAPERS, RESULTS) == page


def test_each_paper_has_a_row_with_the_p_of_a_sign_test() -> None:
    rows = rows_of("claims")
    assert [row[0] for row in rows] == [paper.name for paper in PAPERS]
    for paper, row in zip(PAPERS, rows, strict=True):
        if paper.tracks is None:
            assert row[3:5] == [claims.NOT_STATED, "-"]
        else:
            # All tracks on one side.
            p = stats.binomtest(paper.tracks, paper.tracks).pvalue
            assert row[3] == str(paper.tracks)
            assert float(row[4]) == pytest.approx(p, rel=0.05)


def test_what_tracks_find_is_what_plan_says() -> None:
    for paper, row in zip(PAPERS, rows_of("claims"), strict=True):
        for scatter, found in zip(claims.SCATTERS, row[5:7], strict=True):
            finds = math.nan
            if paper.tracks is not None:
                finds = change_found(scatter, paper.tracks)
            if math.isnan(finds):
                assert found in ("none", "-")
            else:
                assert found == f"{100.0 * (1.0 - finds):.0f} %"
        for scatter, needed in zip(claims.SCATTERS, row[7:9], strict=True):
            if paper.ratio is None:
                assert needed == "-"
            else:
                assert needed == str(dives_needed(scatter, paper.ratio))


def test_at_least_six_papers_state_a_number() -> None:
    assert len([paper for paper in PAPERS if re.search(r"\d+(\.\d+)? %", paper.claim)]) >= 6


def test_each_command_of_the_page_has_a_result_and_no_other_is_kept() -> None:
    assert set(RESULTS) == set(COMMANDS)
    assert [row[-1].strip("`") for row in rows_of("runs")] == list(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_settings_of_a_command_have_its_filter(command: str) -> None:
    test, data_set = COMMANDS[command]
    config = load_config(file=claims.PUBLIC / test.file, allow_code=True)
    assert test.filter in config.filters
    assert ("--allow-code" in command) == bool(config.code)
    assert f'"{data_set}"' in (claims.PUBLIC / "dives.toml").read_text("utf-8")


def test_results_are_kept_as_they_are_read(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(claims, "RESULTS", tmp_path / "results.csv")
    claims.store_results(list(RESULTS.values()))
    assert claims.load_results() == RESULTS


@pytest.mark.nightly
def test_a_command_gives_what_is_kept_of_it() -> None:
    """One row, on the eight dives of the Snapir."""
    (paper, *_) = PAPERS
    (test, *_) = paper.test
    command = claims.command_of(test, "snapir")
    found = claims.run_command(command, test.filter)
    if found is None:
        pytest.skip("needs ../shared/data (real dives)")
    kept = RESULTS[command]
    assert (found.verdict, found.quantity, found.dives) == (
        kept.verdict,
        kept.quantity,
        kept.dives,
    )
    assert found.ratio == pytest.approx(kept.ratio, rel=1e-3)
    assert found.acts == pytest.approx(kept.acts, rel=0.02)
