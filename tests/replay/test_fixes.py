"""Fixes of the position: what good ones gain and bad ones cost, and that a correction of the position is no drift."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Config, Depth, Evaluation, Filter, Position
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, SensorColumns
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.evaluation.sentences import paragraph
from insdvl_replay.evaluation.verdicts import trust_sentence
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.studies.montecarlo import matched_errors

VELOCITY = Filter(aiding=("velocity",))
FOG = changed(
    load_config("fog"),
    evaluation=Evaluation(starts=1),
    position=Position(sd_m=1.0),
    depth=Depth(sd_m=0.05),
    filters={"baseline": VELOCITY, "candidate": Filter(aiding=("velocity", "position"))},
)
NOISY = changed(FOG, dvl=changed(FOG.dvl, velocity_sd_mps=0.1))
"""Told the truth about a DVL so noisy that a few minutes of its velocities need fixes."""


@pytest.fixture(scope="module")
def exact() -> Dive:
    return exact_dive("figure-eight", duration_s=240.0, imu_rate_hz=20.0, reference_rate_hz=1.0)


def survey(exact: Dive, config: Config, seed: int, bad_share: float = 0.0) -> Dive:
    """A dive with a fix every 5 s, a share of them 15 m off on each axis, and with a depth."""
    rng, reference = np.random.default_rng(seed), exact.reference
    assert reference is not None
    rows = np.arange(2, len(reference.time_ns), 5)
    sd_m = np.where(rng.random((len(rows), 1)) < bad_share, 15.0, 1.0)
    off_m = np.hstack([sd_m * rng.standard_normal((len(rows), 2)), np.zeros((len(rows), 1))])
    fixes = SensorColumns(
        reference.time_ns[rows], moved_position(reference.position[rows], off_m)[:, :2]
    )
    depths = SensorColumns(
        fixes.time_ns, -reference.position[rows, 2:] + 0.05 * rng.standard_normal((len(rows), 1))
    )
    dive = add_errors(exact, *matched_errors(config), seed)
    return replace(dive, sensors={"position": fixes, "depth": depths})


def evidence(replay: Replay) -> dict[str, EvidenceRow]:
    return {row.quantity: row for row in replay.tables.evidence}


def test_with_corrections_taken_back_a_filter_moves_as_one_without_position_states(
    exact: Dive,
) -> None:
    """Position states smooth the track and change no velocity: all that is left of their corrections is rounding."""
    config = changed(
        FOG, filters={"baseline": VELOCITY, "candidate": changed(VELOCITY, states=("position",))}
    )
    replay = replay_dive(
        survey(exact, config, 1), changed(config, evaluation=Evaluation(starts=8))
    )
    baseline, candidate = replay.histories
    assert not len(baseline.corrected)
    corrected_m = north_east_down_m(candidate.position, candidate.dead_reckoned)
    assert np.abs(corrected_m).max() > 0.01
    np.testing.assert_allclose(
        north_east_down_m(candidate.dead_reckoned, baseline.position), 0.0, atol=1e-3
    )
    rows = evidence(replay)
    for quantity in ("drift_30s", "drift_60s", "drift_100m"):
        assert rows[quantity].ratio == pytest.approx(1.0, abs=2e-3)
    assert rows["position"].ratio != pytest.approx(1.0, abs=2e-3)


@pytest.fixture(scope="module")
def good(exact: Dive) -> list[Replay]:
    return [replay_dive(survey(exact, NOISY, seed), NOISY) for seed in range(8)]


def test_good_fixes_are_better_by_position_over_several_dives(good: list[Replay]) -> None:
    for replay in good:
        row = evidence(replay)["position"]
        assert (row.evidence, row.role) == ("track", "primary")
        assert replay.verdicts["candidate"].verdict == "undecided", "one dive has no verdict"
    found = pooled_candidate(
        "candidate", "baseline", [replay.tables.evidence for replay in good], len(good)
    )
    assert (found.primary, found.verdict) == ("position", "better")


def test_track_has_the_numbers_of_the_reference_errors_and_of_the_distance(
    good: list[Replay],
) -> None:
    rows, errors = evidence(good[0]), good[0].errors
    off_m = [
        np.hypot(*errors[name].position_error_ned_m[:, :2].T) for name in ("baseline", "candidate")
    ]
    for quantity, values in (
        ("position", [np.sqrt(np.mean(of_one**2)) for of_one in off_m]),
        ("position_end", [of_one[-1] for of_one in off_m]),
        (
            "depth",
            [np.sqrt(np.mean(one.position_error_ned_m[:, 2] ** 2)) for one in errors.values()],
        ),
    ):
        assert (rows[quantity].baseline, rows[quantity].value) == pytest.approx(values)
    of_way = 100.0 / errors["baseline"].distance_m
    assert rows["position_pct"].value == pytest.approx(of_way * (rows["position"].value or 0.0))
    assert rows["position_end_pct"].value == pytest.approx(
        of_way * (rows["position_end"].value or 0.0)
    )
    assert (rows["position_pct"].unit, rows["position"].unit) == ("%", "m")


@pytest.mark.all_starts
def test_bad_fixes_have_a_larger_error_or_are_not_evaluated_and_their_nis_is_reported(
    exact: Dive,
) -> None:
    """Of filters that start as uncertain as the settings say: bad fixes hardly move one that knows its start."""
    config = changed(FOG, initial=changed(FOG.initial, uncertainty="settings"))
    replays = [
        replay_dive(survey(exact, config, seed, bad_share=0.2), config) for seed in range(2)
    ]
    for replay in replays:
        assert (evidence(replay)["position"].ratio or 0.0) > 1.5
        assert replay.verdicts["candidate"].verdict in {"undecided", "not evaluated"}
        (fixes,) = (row for row in replay.tables.consistency if row.measurement == "position")
        assert (fixes.mean_nis or 0.0) > 10.0 * fixes.dof
        consistency_words = trust_sentence(replay.tables, "candidate", "baseline")
        assert f", position {(fixes.mean_nis or 0.0) / fixes.dof:.3g}." in consistency_words
        assert "candidate: velocity " in consistency_words


def test_track_is_evaluated_by_fixes_and_depths_that_are_held_out(exact: Dive) -> None:
    """Without a reference they tell as much as it would but for their own noise."""
    config = changed(
        NOISY,
        evaluation=Evaluation(starts=1, held_out=("position", "depth")),
        filters={"baseline": VELOCITY, "candidate": changed(VELOCITY, states=("position",))},
    )
    dive = survey(exact, config, 1)
    assert dive.reference is not None
    known = evidence(replay_dive(dive, config))
    start = dive.reference.rows(np.arange(len(dive.reference.time_ns)) < 2)
    told = evidence(replay_dive(replace(dive, reference=start, truth=None), config))
    assert told["held_out_position"].ratio == pytest.approx(1.0, abs=1e-3), (
        "corrections are no drift here, either"
    )
    for quantity, noise_m in (("position", np.sqrt(2.0)), ("depth", 0.05)):
        expected = np.hypot(known[quantity].value or 0.0, noise_m)
        assert told[quantity].value == pytest.approx(expected, rel=0.15)


@pytest.mark.nightly
def test_real_dives_with_position_states_are_not_worse(snapir: Path) -> None:
    """With noise as the dives show it; a filter that smooths its track ends nearer, and drifted more by its steps."""
    file = Path(__file__).parents[2] / "examples" / "snapir.toml"
    overrides = (
        "noise.accel_white_mps_rts=4.35e-4",
        "noise.gyro_white_rad_rts=4.42e-6",
        "dvl.velocity_sd_mps=4.29e-3",
    )
    config = changed(
        load_config(None, file, overrides),
        evaluation=Evaluation(starts=1),
        filters={"baseline": VELOCITY, "candidate": changed(VELOCITY, states=("position",))},
    )
    rows = [replay_log(path, config).tables.evidence for path in sorted(snapir.glob("*.mcap"))]
    found = pooled_candidate("candidate", "baseline", rows, len(rows))
    assert not found.verdict.startswith(("worse", "mixed")), paragraph(found)
    (drift,) = (row for row in found.rows if row.quantity == "drift_30s")
    assert drift.ratio == pytest.approx(1.0, abs=1e-3)
