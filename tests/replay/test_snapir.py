"""Real dives of the AUV Snapir, where someone has them: eight runs of 400 s, 650 to 890 m each."""

from pathlib import Path

import numpy as np
import pytest
from frames import frame

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import NINE
from insdvl_replay.core.tables import finite
from insdvl_replay.evaluation.answers import pooled_candidate, pooled_evidence
from insdvl_replay.preparation.replay import Replay, replay_log

CONFIG = Path(__file__).parents[2] / "examples" / "snapir.toml"
PAPER_NOISE = CONFIG.with_name("paper_noise.toml")
RUNS = ("01", "02", "05", "07", "08", "09", "11", "12")
STRAIGHT = "12"


@pytest.fixture(scope="module")
def replays(snapir: Path) -> dict[str, Replay]:
    config = load_config(file=[CONFIG, PAPER_NOISE])
    return {run: replay_log(snapir / f"snapir_{run}.mcap", config) for run in RUNS}


def position_rms_m(replays: dict[str, Replay], filter_name: str) -> Floats:
    """Horizontal position error of one filter, rms over each dive."""
    rms_m = []
    for replay in replays.values():
        rows = frame(replay.tables.reference_error).set_index(["filter", "quantity"])
        if filter_name == "baseline":
            rms_m.append(rows.loc[("windowed", "position_h"), "baseline_rmse"])
        else:
            rms_m.append(rows.loc[(filter_name, "position_h"), "rmse"])
    return np.array(rms_m, dtype=np.float64)


def test_baseline_stays_near_the_reference(replays: dict[str, Replay]) -> None:
    rms_m = position_rms_m(replays, "baseline")
    assert rms_m.max() < 3.5
    assert np.median(rms_m) < 1.3


def test_innovations_are_as_small_as_a_dvl_in_its_place_makes_them(
    replays: dict[str, Replay],
) -> None:
    """With the arm of the reference's point they were 14 to 80 times as large in all dives that turn."""
    for replay in replays.values():
        assert frame(replay.tables.consistency).iloc[0]["mean_nis"] < 0.01


def test_windowed_acceleration_leaves_the_position_as_it_was(replays: dict[str, Replay]) -> None:
    baseline_m, windowed_m = (
        np.median(position_rms_m(replays, name)) for name in ("baseline", "windowed")
    )
    assert abs(windowed_m - baseline_m) < 0.05 * baseline_m


def test_published_acceleration_makes_turning_dives_worse(replays: dict[str, Replay]) -> None:
    turning = np.array([run != STRAIGHT for run in RUNS])
    baseline_m, published_m = (position_rms_m(replays, name) for name in ("baseline", "published"))
    assert np.median(published_m[turning]) > 1.5 * np.median(baseline_m[turning])
    assert np.sum(published_m[turning] > 1.2 * baseline_m[turning]) >= 6
    assert published_m[~turning][0] == pytest.approx(baseline_m[~turning][0], rel=0.2)


def test_predicted_improvement_is_the_same_for_both_models(replays: dict[str, Replay]) -> None:
    """What the covariance says cannot tell the model that helps from the one that harms."""
    for replay in replays.values():
        rows = frame(replay.tables.improvement).set_index(["filter", "state"])["improvement_pct"]
        nine = [state.id for state in NINE]
        np.testing.assert_allclose(
            rows["published"][nine], rows["windowed"][nine], rtol=0.0, atol=1.0
        )  # percent


def test_innovations_tell_them_apart(replays: dict[str, Replay]) -> None:
    for run, replay in replays.items():
        rows = frame(replay.tables.consistency).set_index(["filter", "measurement"])["mean_nis"]
        if run != STRAIGHT:
            assert rows["published", "acceleration"] > 10.0 * rows["windowed", "acceleration"]


def test_every_ping_and_reference_time_is_used_or_counted(replays: dict[str, Replay]) -> None:
    for replay in replays.values():
        dropped = sum(note.count for note in replay.notes if note.code == "dvl_outside_span")
        assert len(replay.velocities.time_ns) + dropped == 400
        rows = frame(replay.tables.reference_error).set_index(["filter", "quantity"])
        assert replay.dive.reference is not None
        assert (
            rows.loc[("windowed", "position_h"), "samples"]
            == len(replay.dive.reference.time_ns) - 1
        )
        assert (rows["status"] == "compared").all()


def test_with_the_papers_noise_nothing_is_evaluated(replays: dict[str, Replay]) -> None:
    """Its innovations are hundreds of times smaller than this noise says, so the baseline is none that was tuned."""
    for run, replay in replays.items():
        for name in ("windowed", "published"):
            found = replay.verdicts[name]
            assert (found.verdict, found.prediction) == ("not evaluated", "undecided"), run
            assert "times too large" in found.reason
        if run != STRAIGHT:
            assert 35.0 < finite(replay.verdicts["windowed"].mean_improvement_pct) < 42.0


def test_the_rows_of_the_dives_tell_the_models_apart(replays: dict[str, Replay]) -> None:
    """Withheld from the published model, the DVL is missed: it coasts ten times as far off, and no dive says else."""
    pooled = {}
    for name in ("windowed", "published"):
        evidence = [
            [row for row in replay.tables.evidence if row.filter == name]
            for replay in replays.values()
        ]
        predicted_pct = [replay.verdicts[name].mean_improvement_pct for replay in replays.values()]
        pooled[name] = pooled_candidate(
            name, "baseline", evidence, len(RUNS), predicted_pct, primary="outage_60s"
        )
    rows = {
        (name, row.quantity): row for name, candidate in pooled.items() for row in candidate.rows
    }
    for quantity in ("outage_30s", "outage_60s", "outage_120s"):
        published = rows["published", quantity]
        assert (published.verdict, published.dives_won) == ("worse", 0)
        assert finite(published.low) > 10.0
        assert 0.8 < finite(rows["windowed", quantity].ratio) < 1.1
    for quantity in ("drift_60s", "velocity_along", "velocity_across", "position"):
        windowed = rows["windowed", quantity]
        assert windowed.verdict == "equivalent"
        assert finite(windowed.acts) < 0.05, "it hardly moves them"


@pytest.fixture(scope="module")
def fitted(snapir: Path) -> dict[str, Replay]:
    """With the example's own settings: the geometry and the noise that `calibrate` found."""
    config = load_config(file=CONFIG, overrides=["evaluation.starts=1"])
    return {run: replay_log(snapir / f"snapir_{run}.mcap", config) for run in RUNS}


@pytest.mark.nightly
def test_the_example_is_as_noisy_as_it_says_along_each_axis(fitted: dict[str, Replay]) -> None:
    for run, replay in fitted.items():
        for row in replay.tables.consistency:
            if row.filter == "baseline" and row.measurement.startswith("velocity"):
                assert 0.4 < finite(row.mean_nis) / row.dof < 1.6, (run, row.measurement)


@pytest.mark.nightly
def test_the_example_keeps_the_depth(fitted: dict[str, Replay]) -> None:
    """After 400 s without a depth sensor: what a pitch of the mounting is off by shows here alone."""
    for run, replay in fitted.items():
        reference, history = replay.dive.reference, replay.histories[0]
        assert reference is not None
        height_m = np.interp(history.time_ns[-1], reference.time_ns, reference.position[:, 2])
        assert abs(history.position[-1, 2] - height_m) < 0.6, run


def test_with_fitted_noise_neither_model_of_the_acceleration_matters(
    fitted: dict[str, Replay],
) -> None:
    for name in ("windowed", "published"):
        evidence = [
            [row for row in replay.tables.evidence if row.filter == name]
            for replay in fitted.values()
        ]
        rows = {row.quantity: row for row in pooled_evidence(name, evidence)}
        assert finite(rows["outage_60s"].ratio) == pytest.approx(1.0, abs=0.1)
