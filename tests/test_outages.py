"""What is said of long outages of the DVL, and the height at which gravity is taken through them."""

import numpy as np
import pytest

from insdvl_replay.nav.gravity_height import HOLD_AFTER_S, GravityHeight, followed
from insdvl_replay.nav.outages import outage_notes


def pings_ns(*spans_s: tuple[float, float]) -> np.ndarray:
    return np.concatenate([np.arange(start_s, end_s) * 1e9 for start_s, end_s in spans_s]).astype(np.int64)


@pytest.mark.parametrize(
    ("spans_s", "count", "words"),
    [
        ([(1.0, 300.0), (590.0, 2000.0)], 0, ""),
        ([(1.0, 300.0), (601.0, 2000.0)], 1, "the longest 302 s from 299 s after the start on"),
        ([(400.0, 900.0), (1300.0, 2000.0)], 2, "the longest 401 s from 899 s"),
        ([(1.0, 700.0)], 1, "the longest 1301 s from 699 s"),
    ],
)
def test_long_outages_are_told(spans_s: list[tuple[float, float]], count: int, words: str) -> None:
    notes = outage_notes(pings_ns(*spans_s), 0, 2_000_000_000_000)
    assert [(note.code, note.severity, note.count) for note in notes] == [("dvl_outages", "warning", count)] * bool(
        count
    )
    assert not notes or words in notes[0].text


def test_gravity_follows_the_height_and_is_held_without_velocities() -> None:
    gravity = followed(GravityHeight(-20.0, 0.0, 0.0), -21.0, HOLD_AFTER_S)
    assert gravity == GravityHeight(-21.0, 0.0, 0.0)
    gravity = followed(gravity, 400.0, HOLD_AFTER_S + 1.0)
    assert gravity == GravityHeight(-21.0, 421.0, 0.0)
    again = GravityHeight(gravity.height_m, gravity.drift_m, 1000.0)
    assert followed(again, 395.0, 1001.0) == GravityHeight(-26.0, 421.0, 1000.0)
