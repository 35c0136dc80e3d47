"""What makes a result worthless is a warning, so that `run --strict` fails."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from insdvl_replay.core.tables import CandidateVerdict, TrackFitRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.notes import settings_hints
from insdvl_replay.evaluation.verdicts import not_evaluated_notes


@pytest.mark.parametrize(
    ("quantity", "unit", "fitted", "severity"),
    [
        ("scale", "%", 2.0, "info"),
        ("scale", "%", -25.0, "warning"),
        ("turn", "deg", 8.0, "info"),
        ("turn", "deg", -44.0, "warning"),
    ],
)
def test_a_track_that_is_far_off_is_a_warning(
    quantity: str, unit: str, fitted: float, severity: str
) -> None:
    row = TrackFitRow("dive", "baseline", quantity, unit, fitted, 0.1)
    tables: Any = SimpleNamespace(consistency=[], track_fit=[row])
    baseline: Any = SimpleNamespace(filter="baseline", sd=np.full((2, 12), 1e-4))
    found = {note.code: note.severity for note in settings_hints(tables, baseline)}
    assert found["track_off"] == severity


def test_a_candidate_without_a_verdict_is_a_warning() -> None:
    verdicts = {
        "aided": CandidateVerdict(
            "", Verdict.NOT_EVALUATED, "", None, None, None, "", reason="baseline diverged"
        ),
        "other": CandidateVerdict("", Verdict.BETTER, "", None, None, None, ""),
    }
    (note,) = not_evaluated_notes(verdicts)
    assert (note.code, note.severity) == ("not_evaluated", "warning")
    assert "aided" in note.text
    assert note.text.endswith("baseline diverged")
