"""An evidence row shows its interval only with enough samples, and says why it is undecided."""

import pytest
from made_reports import tables
from msgspec.structs import replace

from insdvl_replay.core.tables import EvidenceRow, PooledRow
from insdvl_replay.evaluation.answers import reason_in_words
from insdvl_replay.show.answers import interval_text

ROW = replace(tables().evidence[0], verdict="undecided", p=0.5)
LATER = {"evidence": "convergence", "quantity": "convergence_velocity"}


@pytest.mark.parametrize(
    ("changes", "interval", "reason"),
    [
        ({"verdict": "better"}, "0.70 .. 0.90", ""),
        ({"low": 0.6, "high": 1.2}, "0.60 .. 1.20", ""),
        ({"effective_samples": 2.9}, "-", "fewer than 3 effective samples"),
        ({"effective_samples": 2.9, "why": "nearly all error in one stretch"}, "-", "nearly all error in one stretch"),
        ({"effective_samples": 2.9, "verdict": "better"}, "-", ""),
        ({}, "0.70 .. 0.90", "smaller, but maybe less than 5 %"),
        ({"ratio": 0.97, "low": 0.95, "high": 0.99}, "0.95 .. 0.99", "smaller, but less than 5 %"),
        ({"ratio": 1.03, "low": 1.01, "high": 1.06}, "1.01 .. 1.06", "larger, but less than 5 %"),
        ({**LATER, "ratio": 0.9, "p": 0.0, "low": 0.8, "high": 0.95}, "0.80 .. 0.95", "sooner, but less than 25 %"),
        ({**LATER, "ratio": 1.4, "low": 1.1, "high": 1.6}, "1.10 .. 1.60", "later, but maybe less than 5 %"),
        ({**LATER, "p": 0.0, "effective_samples": 5.0}, "0.70 .. 0.90", "fewer than 6 effective samples"),
        ({"ratio": None, "low": None, "high": None}, "-", ""),
    ],
)
def test_an_undecided_row_says_why(changes: dict[str, object], interval: str, reason: str) -> None:
    row: EvidenceRow = replace(ROW, **changes)
    assert (interval_text(row), reason_in_words(row)) == (interval, reason)


@pytest.mark.parametrize(
    ("dives", "p", "interval", "reason"),
    [
        (2, 0.5, "-", "fewer than 3 dives"),
        (4, 0.5, "0.70 .. 0.90", "smaller, but maybe less than 5 %"),
        (4, 0.001, "0.70 .. 0.90", "never settled on some dive"),
    ],
)
def test_a_pooled_row_says_why(dives: int, p: float, interval: str, reason: str) -> None:
    row = PooledRow("*", "aided", "accuracy", "drift_30s", "m", 1.0, 0.8, 0.8, 0.7, 0.9, dives, dives, p, "undecided")
    assert (interval_text(row), reason_in_words(row)) == (interval, reason)
