"""Filters that are not evaluated, by closed forms."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.quantities import REFERENCE_QUANTITIES
from insdvl_replay.core.tables import ReferenceErrorRow
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.verdicts import far_off

seconds = np.arange(1, 401)
every_second = np.arange(400)


def said(drifts_mps: Any, pings_s: Any, status: str = "compared") -> str:
    """Ask about a filter that drifts north so fast in each of 400 s, 1000 m long, with pings at these seconds."""
    north_m = np.cumsum(np.broadcast_to(drifts_mps, 400).astype(float))
    position_m = np.column_stack([north_m, np.zeros((400, 2))])
    nothing = np.zeros((400, 3))
    errors = {
        "aided": ReferenceErrors(
            seconds * NS_PER_S, position_m, nothing, nothing, 1000.0, position_m
        )
    }
    velocities = SimpleNamespace(
        measurement="velocity", time_ns=np.asarray(pings_s, np.int64) * NS_PER_S
    )
    of_one: Any = SimpleNamespace(
        filter="aided", time_ns=np.zeros(1, np.int64), innovations=(velocities,)
    )
    rows = [ReferenceErrorRow("dive", "aided", name, unit, 1.0, 1.0, 0.0, 1.0, 1.0, 9, status)
            for name, unit in REFERENCE_QUANTITIES.items()]  # fmt: skip
    tables: Any = SimpleNamespace(reference_error=rows)
    return far_off(of_one, of_one, errors, tables.reference_error)


def test_error_that_is_gained_next_to_the_dvl_is_far_off() -> None:
    # The root mean square of 1, 2, ..., 400 m is 231 m.
    assert re.match(r".* aided .*23\.1 %", said(1.0, every_second))
    assert said(0.8, every_second) == ""
    assert said(1.0, every_second, "partly covered") == ""


@pytest.mark.parametrize(("begun_s", "ended_s"), [(100, 220), (0, 120), (280, 400)])
def test_error_that_is_gained_in_an_outage_is_nobodys_error(begun_s: int, ended_s: int) -> None:
    pings_s = every_second[(every_second <= begun_s) | (every_second >= ended_s)][begun_s == 0 :]
    drifts = np.where((seconds > begun_s) & (seconds <= ended_s), 10.0, 0.1)
    assert said(drifts, pings_s) == ""
    assert said(drifts, every_second) != ""


def test_where_the_dvl_is_silent_for_most_of_the_time_all_of_the_error_counts() -> None:
    assert said(1.0, every_second[(every_second < 90) | (every_second > 300)]) != ""


def test_without_a_ping_all_of_the_error_counts() -> None:
    assert re.match(r".* aided .*23\.1 %", said(1.0, []))
