"""Evidence of whole replays: by the start that the dive had, in the numbers of the other tables, and bounded."""

import math
from functools import cache

import pytest

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.tables import EvidenceRow, finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive

# A copy of the baseline, one with the noise of its DVL a hundredth larger, and one with it twenty times larger.
CANDIDATES = (
    'filters.copy.aiding=["velocity"]',
    'filters.near.aiding=["velocity"]',
    "filters.near.velocity_sd_mps=0.00505",
    'filters.far.aiding=["velocity"]',
    "filters.far.velocity_sd_mps=0.1",
    "filters.baseline.velocity_sd_mps=0.005",
    "filters.copy.velocity_sd_mps=0.005",
)


@cache
def replayed(starts: int = 1, primary: str = "") -> Replay:
    dive = simulate_dive("figure-eight", seed=1, duration_s=260.0)
    named = [f"evaluation.primary={primary}"] if primary else []
    config = load_config("fog", overrides=[*CANDIDATES, *named, f"evaluation.starts={starts}"])
    return replay_dive(dive, config)


def rows_of(replay: Replay, name: str) -> dict[str, EvidenceRow]:
    return {row.quantity: row for row in replay.tables.evidence if row.filter == name}


def measured(replay: Replay, name: str) -> dict[str, EvidenceRow]:
    """Return the rows that compare two runs."""
    return {
        quantity: row for quantity, row in rows_of(replay, name).items() if row.acts is not None
    }


def test_the_baseline_is_fit_to_judge_by() -> None:
    sizes = [
        row
        for row in replayed().tables.consistency
        if row.filter == "baseline" and row.measurement == "velocity"
    ]
    assert [0.5 < finite(row.mean_nis) / row.dof < 2.0 for row in sizes] == [True]


def test_drawn_starts_belong_to_convergence_alone() -> None:
    for name in ("copy", "far", "aided"):
        one, several = (rows_of(replayed(starts), name) for starts in (1, 4))
        kept = {
            quantity: row for quantity, row in several.items() if row.evidence != "convergence"
        }
        assert kept == one
        assert len(several) > len(one)


def test_values_are_those_of_the_other_tables() -> None:
    replay = replayed()
    rows = rows_of(replay, "far")
    errors = {row.quantity: row for row in replay.tables.reference_error if row.filter == "far"}
    position = errors["position_h"]
    assert (rows["position"].baseline, rows["position"].value) == pytest.approx(
        (position.baseline_rmse, position.rmse)
    )
    ends = abs(finite(position.baseline_final)), abs(finite(position.final))
    assert (rows["position_end"].baseline, rows["position_end"].value) == pytest.approx(ends)
    outages = {row.filter: row for row in replay.tables.outage if row.window_s == "60"}
    found = rows["outage_60s"]
    assert (found.baseline, found.value) == pytest.approx(
        (outages["baseline"].drift_rms_m, outages["far"].drift_rms_m)
    )
    assert found.samples == outages["far"].windows
    for row in rows.values():
        if row.evidence not in ("consistency", "prediction"):
            assert row.ratio == pytest.approx(finite(row.value) / finite(row.baseline))
    score = rows["prediction"]
    densities = math.exp(-finite(score.baseline)), math.exp(-finite(score.value))
    assert score.ratio == pytest.approx(densities[0] / densities[1]), (
        "the values are minus logarithms of densities"
    )


@pytest.mark.parametrize("name", ["copy", "near", "far", "aided"])
def test_no_ratio_differs_from_one_by_more_than_the_candidate_acts(name: str) -> None:
    rows = measured(replayed(), name)
    kinds = {row.evidence for row in rows.values()}
    assert kinds == {"track", "outage", "accuracy"}
    for row in rows.values():
        assert abs(finite(row.ratio) - 1.0) <= finite(row.acts) * (1.0 + 1e-9), row.quantity


def test_a_copy_of_the_baseline_has_no_effect() -> None:
    replay = replayed()
    assert {(row.ratio, row.acts) for row in measured(replay, "copy").values()} == {(1.0, 0.0)}
    found = replay.verdicts["copy"]
    assert found.verdict == Verdict.NO_EFFECT
    assert "NO EFFECT, identical" in found.sentence


def test_a_change_of_a_hundredth_is_proved_small_and_one_of_twenty_is_not() -> None:
    replay = replayed()
    near, far = (
        max(finite(row.acts) for row in measured(replay, name).values())
        for name in ("near", "far")
    )
    assert 0.0 < near < 1.0 - 1.0 / 1.05 < far
    assert replay.verdicts["near"].verdict in (Verdict.NO_EFFECT, Verdict.EQUIVALENT)
    found = replay.verdicts["far"]
    assert found.verdict == Verdict.UNDECIDED
    assert "one dive cannot tell" in found.sentence


def test_errors_in_time_begin_when_the_baseline_has_settled() -> None:
    """Drift and position are of the whole dive; half of the dive is left out at most."""
    rows = measured(replayed(), "far")
    begins = {quantity: row.from_s for quantity, row in rows.items() if row.from_s is not None}
    assert begins
    assert set(begins) <= {"velocity_along", "velocity_across", "level", "heading"}
    assert all(0.0 < finite(from_s) <= 130.0 for from_s in begins.values())
    longest = rows["position"].samples
    for quantity, from_s in begins.items():
        assert rows[quantity].samples == pytest.approx(
            longest * (1.0 - finite(from_s) / 260.0), abs=2
        )


def test_settings_name_the_quantity_that_decides() -> None:
    assert replayed().verdicts["far"].primary == "position"
    found = replayed(primary="outage_30s").verdicts["far"]
    assert found.primary == "outage_30s"
    assert "on this dive DVL outage 30 s" in found.sentence


def test_reference_that_shares_sensors_leaves_the_decision_to_the_outage() -> None:
    dive = simulate_dive("figure-eight", seed=1, duration_s=260.0)
    overrides = [*CANDIDATES, "evaluation.starts=1", "reference.independent=false"]
    found = replay_dive(dive, load_config("fog", overrides=overrides))
    assert found.verdicts["far"].primary == "outage_60s"
    roles = {quantity: row.role for quantity, row in rows_of(found, "far").items()}
    assert roles["position"] == "shown"
    assert math.isfinite(finite(rows_of(found, "far")["position"].ratio)), (
        "it is shown all the same"
    )
    assert roles["outage_60s"] == "primary"
