"""README says what the program does."""

from pathlib import Path

import pandas as pd
import pytest
import readme

from insdvl_replay.config_file import load_config
from insdvl_replay.replay import replay_log
from insdvl_replay.states import STATES


def test_readme_shows_what_the_program_prints() -> None:
    text = (readme.PROJECT / "README.md").read_text("utf-8")
    assert readme.renewed(text) == text, "run `make readme`"


def test_published_figures_are_the_papers(paper: Path) -> None:
    assert readme.PUBLISHED.read_text("utf-8") == (paper / "straight.csv").read_text("utf-8")


def test_reasons_given_for_the_rows_that_disagree_hold() -> None:
    text = (readme.PROJECT / "README.md").read_text("utf-8")
    sample = readme.PROJECT / "sample_logs" / "straight.mcap"
    phi_n = STATES[3]
    aided = replay_log(sample, load_config()).histories[1]
    assert f"but to {aided.sd[:, phi_n.index].max() / phi_n.factor:.2f} mrad" in text
    override = "initial.misalignment_sd_deg=[0.485,0.485,0.5]"
    assert f"`--set {override}`" in text
    rows = replay_log(sample, load_config(overrides=[override])).tables["improvement"].set_index("state")
    published = pd.read_csv(readme.PUBLISHED).set_index("state")
    for state in ("phi_n", "phi_e", "ba_x", "ba_y"):
        assert rows.loc[state, "baseline_sd"] == pytest.approx(published.loc[state, "baseline_sd"], rel=0.03)
        assert rows.loc[state, "sd"] == pytest.approx(published.loc[state, "aided_sd"], rel=0.03)
