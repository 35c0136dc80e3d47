"""What real vehicles found themselves, beside the filters of this program."""

from pathlib import Path

import pytest

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import LogError
from insdvl_replay.preparation.replay import replay_log

EXAMPLES = Path(__file__).parents[2] / "examples"
BY_FIXES = (
    'reference.topic="/ins/fix"',
    'reference.fix="/ins/fix"',
    "reference.lever_arm_m=[0.0, 0.0, 0.0]",
    'initial.heading_deg="fit"',
)
"""The Snapir judged by its positions alone, so that attitude and velocity of the same solution can be a filter's."""


def test_the_solution_of_the_snapir_is_refused_next_to_itself(snapir: Path) -> None:
    config = load_config(
        file=EXAMPLES / "snapir.toml", overrides=["filters.onboard.solution=/ins/odometry"]
    )
    with pytest.raises(LogError, match=r"'/ins/odometry'"):
        replay_log(snapir / "snapir_01.mcap", config)


def test_the_solution_of_the_snapir_is_on_its_own_positions(snapir: Path) -> None:
    """Fixes and odometry are of one solution: what drifts apart are the digits of the fixes, and nothing is judged."""
    onboard = [
        "filters.onboard.solution=/ins/odometry",
        "filters.onboard.solution.lever_arm_m=[1.763, 0.018, 0.111]",
    ]
    config = load_config(file=EXAMPLES / "snapir.toml", overrides=[*BY_FIXES, *onboard])
    replay = replay_log(snapir / "snapir_01.mcap", config)
    drift = {(row.filter, row.quantity): row.p50 for row in replay.tables.drift}
    assert drift["onboard", "drift_60s"] < 2.5
    found = {row.filter: row for row in replay.tables.track_fit if row.quantity == "turn"}
    assert abs(found["onboard"].fitted or 0.0) < 1.0
    assert [(row.filter, row.jumps) for row in replay.tables.jumps] == [("onboard", 0)]
    assert "solution_onboard_is_reference" in {note.code for note in replay.notes}
    assert replay.verdicts["onboard"].verdict == "not evaluated"


def test_the_estimate_of_the_blueye_knows_the_satellites(blueye: Path) -> None:
    """It comes in one message with the receiver that it is to be judged by: better, and no proof of anything."""
    solution = "filters.onboard.solution=blueye.protocol.PositionEstimateTel"
    replay = replay_log(
        blueye / "auto_square.mcap",
        load_config(file=EXAMPLES / "blueye_x3.toml", overrides=[solution]),
    )
    error = {(row.filter, row.quantity): row for row in replay.tables.reference_error}
    onboard = error["onboard", "position_h"]
    assert onboard.rmse is not None
    assert 0.2 < onboard.rmse < 1.0 < (onboard.baseline_rmse or 0.0)
    assert (onboard.status, error["onboard", "heading"].status) == ("compared", "not in reference")
    assert "solution_onboard_is_reference" in {note.code for note in replay.notes}
    assert replay.verdicts["onboard"].verdict == "not evaluated"
