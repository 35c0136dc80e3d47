"""docs/reproduction.md is what the program gives."""

import re
from pathlib import Path

import pandas as pd
import pictures
import pytest
import reproduction
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.states import STATES
from insdvl_replay.replay import replay_log

SAMPLE = reproduction.PROJECT / "sample_logs" / "straight.mcap"


@pytest.fixture(scope="module")
def found(snapir: Path) -> reproduction.Findings:
    return reproduction.find(snapir)


@pytest.mark.nightly
@pytest.mark.all_starts
def test_page_is_what_the_program_gives(found: reproduction.Findings) -> None:
    assert reproduction.written(found) == reproduction.PAGE.read_text("utf-8"), "run `make reproduce`"


@pytest.mark.nightly
def test_page_shows_every_picture_and_each_is_there(found: reproduction.Findings) -> None:
    shown = {f"docs/{name}" for name in re.findall(r"\]\((\w+\.svg)\)", reproduction.PAGE.read_text("utf-8"))}
    assert shown == {*pictures.PICTURES, *reproduction.drawn(found)}
    assert all((reproduction.PROJECT / name).is_file() for name in shown)


def test_words_follow_from_the_numbers() -> None:
    assert reproduction.deviation(1.06, 1.0) == "**+6.0 %**"
    assert reproduction.deviation(0.96, 1.0) == "-4.0 %"
    assert reproduction.agrees(56.73, 40.7) == "**no**"
    assert reproduction.agrees(18.76, 18.4) == "yes"


def test_published_figures_are_the_papers(paper: Path) -> None:
    assert reproduction.PUBLISHED.read_text("utf-8") == (paper / "straight.csv").read_text("utf-8")


@pytest.mark.nightly
def test_reasons_given_for_the_rows_that_disagree_hold() -> None:
    text = reproduction.PAGE.read_text("utf-8")
    phi_n = STATES[3]
    aided = replay_log(SAMPLE, load_config()).histories[1]
    assert f"at its largest, {aided.sd[:, phi_n.index].max() / phi_n.factor:.2f} mrad" in text
    override = "initial.misalignment_sd_deg=[0.485,0.485,0.5]"
    assert f"`--set {override}`" in text
    rows = frame(replay_log(SAMPLE, load_config(overrides=[override])).tables.improvement).set_index("state")
    published = pd.read_csv(reproduction.PUBLISHED).set_index("state")
    for state in ("phi_n", "phi_e", "ba_x", "ba_y"):
        assert rows.loc[state, "baseline_sd"] == pytest.approx(published.loc[state, "baseline_sd"], rel=0.03)
        assert rows.loc[state, "sd"] == pytest.approx(published.loc[state, "aided_sd"], rel=0.03)
