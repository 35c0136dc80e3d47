"""The row types of the tables hold for what replays give, and messages of robots for the row types."""

import re
from pathlib import Path

import pytest
from row_messages import message_definition

from insdvl_replay.core.config import Config
from insdvl_replay.core.states import SENSORS
from insdvl_replay.core.tables import (
    LAYOUTS,
    TABLES,
    EvidenceRow,
    PooledRow,
    TableLayout,
    each_table,
)
from insdvl_replay.core.words import Verdict
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

MESSAGES = Path(__file__).resolve().parents[2] / "schemas" / "insdvl_msgs" / "msg"


def test_the_tables_have_these_names_keys_and_primary_columns() -> None:
    assert [(layout.name, layout.key, layout.primary) for layout in LAYOUTS] == [
        ("filters", "filter", "reference_improvement_pct"),
        ("improvement", "state", "sd"),
        ("convergence", "state", "reached_s"),
        ("reference_error", "quantity", "rmse"),
        ("consistency", "measurement", "mean_nis"),
        ("credibility", "quantity", "mean_nees"),
        ("evidence", "quantity", "ratio"),
        ("outage", "window_s", "drift_median_m"),
        ("drift", "quantity", "p50"),
        ("track_fit", "quantity", "fitted"),
        ("jumps", "filter", "jumps"),
        ("assay", "quantity", "ratio"),
        ("where", "bin", ""),
    ]


def test_every_verdict_has_a_rank() -> None:
    candidates, *_ = LAYOUTS
    assert candidates.words["verdict"] == tuple(Verdict)


def test_a_row_of_one_dive_has_no_word_and_no_interval() -> None:
    """One dive cannot tell whether the next one will be; both are in the rows over dives alone."""
    of_dive, over_dives = ({*row.__struct_fields__} for row in (EvidenceRow, PooledRow))
    assert over_dives - of_dive >= {
        "low",
        "high",
        "low_always",
        "high_always",
        "p",
        "scatter",
        "verdict",
    }
    assert of_dive >= {"baseline", "value", "ratio", "moves", "acts", "reference_noise", "role"}


_OTHERS = "|".join(("beam_", "parity", "held_out_", *SENSORS))
OF_MORE = {
    "credibility": re.compile("position"),
    "consistency": re.compile(_OTHERS),
    "evidence": re.compile(
        r"held_out_|position_crps|position_drawn_heading|drift_(10|100)s|drift_[2-8]00m"
    ),
}
"""Rows of filters with more states, with more sensors, that depend on the heading at the start, or of trajectories."""


@pytest.mark.all_starts
def test_a_replay_has_the_rows_that_its_layouts_name() -> None:
    """On 200 s there are windows of 30 s alone, and no two stretches of 300 s."""
    replay = replay_dive(simulate_dive("straight", seed=1, duration_s=200.0), Config())
    longer = {f"outage_{length}s" for length in (60, 120, 300)} | {"60", "120", "300"}
    assert replay.tables.jumps == []  # neither filter has a position that could
    assert replay.tables.assay == []  # it is of `run --assay` alone
    assert (
        replay.tables.where == []
    )  # it goes straight ahead at one speed, so that there is no rest
    for layout, rows in each_table(replay.tables):
        if layout.name in ("jumps", "assay", "where"):
            continue
        of_others = longer | {
            name
            for name in layout.rows
            if layout.name in OF_MORE and OF_MORE[layout.name].match(name)
        }
        assert {getattr(row, layout.key) for row in rows} == set(layout.rows) - of_others
        assert ("baseline" in {getattr(row, "filter") for row in rows}) == layout.baseline_too  # noqa: B009


@pytest.mark.parametrize("layout", TABLES, ids=lambda layout: layout.name)
def test_a_message_definition_is_what_the_row_type_says(layout: TableLayout) -> None:
    file = MESSAGES / f"{layout.row.__name__}.msg"
    assert file.read_text("utf-8") == message_definition(layout), "run: make schemas"


@pytest.mark.parametrize(
    ("table", "column", "unit"),
    [
        ("improvement", "sd", "mg"),
        ("improvement", "improvement_pct", "%"),
        ("improvement", "status", ""),
        ("convergence", "reached_s", "s"),
        ("convergence", "target_sd", "mg"),
        ("reference_error", "samples", ""),
        ("evidence", "value", "mg"),
        ("evidence", "ratio", ""),
        ("outage", "drift_median_m", "m"),
        ("outage", "end_velocity_mps", "m/s"),
        ("outage", "ratio_to_baseline", ""),
    ],
)
def test_a_unit_holds_for_the_physical_quantities_of_its_row(
    table: str, column: str, unit: str
) -> None:
    (layout,) = (layout for layout in LAYOUTS if layout.name == table)
    assert layout.unit_of(column, "mg") == unit
