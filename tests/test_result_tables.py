"""The layouts of the tables hold for the rows that reports carry."""

from typing import get_args, get_type_hints

import pytest

from insdvl_replay.report.json_report import Tables
from insdvl_replay.result_tables import TABLES


def test_every_table_of_a_report_has_a_layout() -> None:
    assert [layout.name for layout in TABLES] == list(get_type_hints(Tables))


@pytest.mark.parametrize("layout", TABLES, ids=lambda layout: layout.name)
def test_a_layout_names_columns_that_its_rows_have(layout) -> None:
    columns = get_args(get_type_hints(Tables)[layout.name])[0].__struct_fields__
    assert {"log", "filter", layout.key, *layout.better} <= set(columns)
