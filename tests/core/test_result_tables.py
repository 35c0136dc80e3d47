"""The layouts of the tables hold for the rows that reports carry."""

from typing import get_args, get_type_hints

import pytest

from insdvl_replay.core.config import Config
from insdvl_replay.core.result_tables import CANDIDATES, LAYOUTS, NOT_JUDGED, TABLES
from insdvl_replay.evaluation import verdicts
from insdvl_replay.replay import replay_dive
from insdvl_replay.results.json_report import Candidate, Tables
from insdvl_replay.sim.dive import simulate_dive


def test_every_table_of_a_report_has_a_layout() -> None:
    assert [layout.name for layout in TABLES] == list(get_type_hints(Tables))


@pytest.mark.parametrize("layout", TABLES, ids=lambda layout: layout.name)
def test_a_layout_names_columns_that_its_rows_have(layout) -> None:
    columns = get_args(get_type_hints(Tables)[layout.name])[0].__struct_fields__
    assert {"log", "filter", layout.key, layout.chief, *layout.better, *layout.words} <= set(columns)


def test_the_layout_of_the_candidates_names_what_is_said_of_them() -> None:
    assert {CANDIDATES.chief, *CANDIDATES.better, *CANDIDATES.words} <= set(Candidate.__struct_fields__)


def test_every_verdict_on_an_improvement_has_a_rank() -> None:
    assert {*CANDIDATES.words["improvement"], "no reference"} == {*verdicts._CONCLUSION, NOT_JUDGED}


def test_a_replay_has_the_rows_that_its_layouts_name() -> None:
    replay = replay_dive(simulate_dive("straight", seed=1, duration_s=20.0), Config())
    for layout in TABLES:
        table = replay.tables[layout.name]
        assert set(table[layout.key]) == set(layout.rows)
        assert ("baseline" in set(table["filter"])) == layout.baseline_too


@pytest.mark.parametrize(
    ("table", "column", "unit"),
    [
        ("improvement", "sd", "mg"),
        ("improvement", "improvement_pct", "%"),
        ("improvement", "status", ""),
        ("convergence", "reached_s", "s"),
        ("convergence", "target_sd", "mg"),
        ("reference_error", "samples", ""),
    ],
)
def test_a_unit_holds_for_the_physical_quantities_of_its_row(table: str, column: str, unit: str) -> None:
    (layout,) = (layout for layout in LAYOUTS if layout.name == table)
    assert layout.unit_of(column, "mg") == unit
