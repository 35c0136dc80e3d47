"""The table of states: rows, names and units, held against scipy's constants."""

import numpy as np
import pytest
import scipy.constants

from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, MRAD, NINE, PHI, STATES


def test_units_are_those_of_scipy() -> None:
    assert pytest.approx(scipy.constants.degree, rel=1e-15) == DEG
    assert pytest.approx(scipy.constants.milli, rel=1e-15) == MRAD
    assert pytest.approx(scipy.constants.milli * scipy.constants.g, rel=1e-15) == MG
    assert pytest.approx(scipy.constants.degree / scipy.constants.hour, rel=1e-15) == DEG_PER_HOUR


def test_every_row_of_the_error_state_has_one_state() -> None:
    assert [state.index for state in STATES] == list(range(12))
    assert len({state.id for state in STATES}) == len({state.label for state in STATES}) == 12
    rows = np.arange(12)
    for block, prefix in ((DV, "dv"), (PHI, "phi"), (BA, "ba"), (BG, "bg")):
        assert {STATES[row].id.partition("_")[0] for row in rows[block]} == {prefix}


@pytest.mark.parametrize(
    ("block", "unit", "factor"),
    [
        (DV, "m/s", 1.0),
        (PHI, "mrad", MRAD),
        (BA, "mg", MG),
        (BG, "deg/h", DEG_PER_HOUR),
    ],
)
def test_a_block_shares_its_units(block: slice, unit: str, factor: float) -> None:
    assert {(state.unit, state.factor) for state in STATES[block]} == {(unit, factor)}


def test_the_nine_are_all_but_the_velocity_errors() -> None:
    assert [state.id for state in NINE] == [
        "phi_n", "phi_e", "phi_d", "ba_x", "ba_y", "ba_z", "bg_x", "bg_y", "bg_z",
    ]  # fmt: skip
