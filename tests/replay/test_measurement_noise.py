"""Adaptive and Student-t noise of the DVL, as candidates beside a filter that believes what it is told."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from contaminated_dives import CANDIDATES, clean_dive, competitors, contaminated_dive, noisier_dive

from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, seconds
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import BAD, CandidateAnswer, pooled_candidate
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.nav.kalman import (
    CEILING,
    FLOOR,
    chance_var,
    found_factor,
    outlier_factor,
    significant_factor,
)
from insdvl_replay.preparation.replay import replay_dive

DIVES, LENGTH_S, STARTS = 5, 600.0, 8
PREDICTED_VAR = 0.5
SHOCK_S = 500.0
OUTAGES_S, OUTAGE_S = (100.0, 250.0, 400.0), 60.0


def together(aiding: str, dives: Iterable[Dive]) -> dict[str, CandidateAnswer]:
    """The answer of several dives for each candidate."""
    replays = [replay_dive(dive, competitors(aiding, 1)) for dive in dives]
    found = {}
    for name in CANDIDATES:
        evidence = [
            [row for row in replay.tables.evidence if row.filter == name] for replay in replays
        ]
        found[name] = pooled_candidate(name, "baseline", evidence, len(replays))
    return found


@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_where_pings_are_contaminated_velocities_err_less(aiding: str) -> None:
    replay = replay_dive(contaminated_dive(0, 300.0, 0.2), competitors(aiding, 1))
    rows = {(row.filter, row.quantity): row for row in replay.tables.reference_error}
    for name, most in (("student-t", 0.5), ("adaptive", 0.95)):
        for quantity in ("velocity_n", "velocity_e", "velocity_d"):
            row = rows[name, quantity]
            assert row.rmse < most * row.baseline_rmse, (name, quantity)


@pytest.mark.nightly
@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_where_pings_are_contaminated_their_velocities_are_better(aiding: str) -> None:
    found = together(aiding, (contaminated_dive(seed, LENGTH_S, 0.2) for seed in range(DIVES)))
    for name, answer in found.items():
        rows = {row.quantity: row for row in answer.rows}
        for quantity in ("velocity_along", "velocity_across"):
            assert (rows[quantity].verdict, rows[quantity].dives_won) == ("better", DIVES), (
                name,
                quantity,
            )
        assert answer.verdict not in BAD, (name, headline(answer))


@pytest.mark.nightly
@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_on_clean_dives_they_are_equivalent(aiding: str) -> None:
    found = together(aiding, (clean_dive(seed, LENGTH_S) for seed in range(DIVES)))
    for name, answer in found.items():
        assert answer.verdict in (Verdict.EQUIVALENT, Verdict.NO_EFFECT), (name, headline(answer))


@pytest.mark.nightly
def test_where_the_dvl_grows_noisier_the_adaptive_filter_is_better_and_knows_how_noisy_it_is() -> (
    None
):
    """Its velocities alone drift more, the less it trusts the DVL; with the position among its states it is as near."""
    config = competitors("velocity", STARTS, ("position",))
    for seed in range(DIVES):
        ratio = {
            row.quantity: row.ratio
            for row in replay_dive(noisier_dive(seed, LENGTH_S, 3.0), config).tables.evidence
            if row.filter == "adaptive"
        }
        assert ratio["velocity_along"] < 0.95, seed
        assert ratio["position"] < 1.1, seed
        assert ratio["nis"] < 0.5, seed


@pytest.mark.nightly
def test_with_a_gate_a_dvl_that_grows_noisier_is_followed_and_not_rejected() -> None:
    config = competitors("velocity", 1)
    gated = {
        name: msgspec.structs.replace(each, gate_probability=0.99)
        for name, each in config.filters.items()
    }
    for seed in range(DIVES):
        replay = replay_dive(
            noisier_dive(seed, LENGTH_S, 3.0), msgspec.structs.replace(config, filters=gated)
        )
        plain, adaptive = (history.innovations[0] for history in replay.histories[:2])
        late = plain.time_ns > plain.time_ns[len(plain.time_ns) // 2] + 30 * NS_PER_S
        assert plain.used[late].mean() < 0.5
        assert adaptive.used[late].mean() > 0.95
        assert adaptive.nis[late].mean() / 3.0 < 1.3


@pytest.mark.nightly
@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_what_an_outage_did_to_the_velocity_is_not_taken_for_noise(aiding: str) -> None:
    """The first ping after it is off by what the INS has drifted by, and says nothing of the DVL."""
    changes = list[Floats]()
    for seed in range(DIVES):
        replay = replay_dive(dive_with_outages(seed), competitors(aiding, 1))
        plain, adaptive = (
            {one.measurement: one for one in history.innovations}
            for history in replay.histories[:2]
        )
        changes += [np.abs(adaptive[name].sd / plain[name].sd - 1.0).ravel() for name in plain]
    assert np.mean(np.concatenate(changes) > 0.02) < 0.02


@pytest.mark.nightly
@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_how_noisy_the_dvl_is_is_not_forgotten_where_a_filter_is_set_to_it_again(
    aiding: str,
) -> None:
    """After a shock of the IMU; beams had forgotten it, and NIS / dof of 4 to 8 behind it."""
    nis_per_dof = []
    for seed in range(3):
        config = competitors(aiding, 1)
        gated = msgspec.structs.replace(config.filters["adaptive"], gate_probability=0.999)
        config = msgspec.structs.replace(config, filters={**config.filters, "adaptive": gated})
        replay = replay_dive(shocked(noisier_dive(seed, LENGTH_S, 3.0)), config)
        history = replay.histories[1]
        assert len(history.reopened_ns) == 1
        met = history.innovations[0]
        time_s = seconds(met.time_ns, replay.start_ns)
        after = (time_s > SHOCK_S + 15.0) & (time_s < SHOCK_S + 45.0)
        nis_per_dof.append(float(np.mean(met.nis[after])) / met.dof)
    assert 0.7 < np.mean(nis_per_dof) < 1.4, nis_per_dof


def test_the_noise_that_is_found_is_noted() -> None:
    replay = replay_dive(noisier_dive(0, LENGTH_S, 3.0), competitors("velocity", 1))
    (note,) = (note for note in replay.notes if note.code == "constants_estimated")
    factor = replay.histories[1].innovations[0].noise_factor
    assert re.fullmatch(rf"adaptive .*velocity {np.sqrt(factor):.3g} .*", note.text)
    assert np.sqrt(factor) == pytest.approx(3.0, rel=0.15)


def shocked(dive: Dive) -> Dive:
    """Let the vehicle hit something that is not there."""
    force_b = dive.imu.specific_force_b.copy()
    first = int(np.argmax(seconds(dive.imu.time_ns, int(dive.imu.time_ns[0])) > SHOCK_S))
    force_b[first : first + 3] += (60.0, 40.0, 0.0)
    return replace(dive, imu=replace(dive.imu, specific_force_b=force_b))


def dive_with_outages(seed: int) -> Dive:
    dive = clean_dive(seed, LENGTH_S)
    assert dive.dvl.beam_velocity_mps is not None
    at_s, beams = seconds(dive.dvl.time_ns, dive.dvl.time_ns[0]), dive.dvl.beam_velocity_mps.copy()
    for start_s in OUTAGES_S:
        beams[(at_s > start_s) & (at_s < start_s + OUTAGE_S)] = np.nan
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def followed(true_var: Floats, size: int) -> Iterator[tuple[float, float]]:
    """What is found and believed of the noise of innovations whose variance is so much larger than said."""
    rng, R, found, predicted, chance = np.random.default_rng(2), np.eye(size), 1.0, 1.0, 0.0
    for var in true_var:
        z = rng.normal(scale=np.sqrt(var + PREDICTED_VAR), size=size)
        S = predicted * R + PREDICTED_VAR * np.eye(size)
        found = found_factor(found, predicted, z, S, predicted * R, 1.0)
        chance = chance_var(chance, predicted, S, predicted * R)
        predicted = significant_factor(found, chance)
        yield found, predicted


def test_a_noise_that_doubles_is_followed_within_a_window_or_two() -> None:
    found, predicted = np.transpose(list(followed(np.repeat([1.0, 2.0], 300), 3)))
    assert np.mean(found[100:300]) == pytest.approx(1.0, abs=0.15)
    assert np.mean(found[360:]) == pytest.approx(2.0, abs=0.3)
    assert np.mean(predicted[360:]) == pytest.approx(2.0, abs=0.35)
    assert found.min() > FLOOR
    assert found.max() < CEILING


@pytest.mark.parametrize("size", [1, pytest.param(3, marks=pytest.mark.nightly)])
def test_chance_is_not_predicted(size: int) -> None:
    found, predicted = np.transpose(list(followed(np.ones(100_000), size)))
    var = 2.0 * (1.0 + PREDICTED_VAR) ** 2 / size / 59.0
    assert np.std(found) == pytest.approx(np.sqrt(var), rel=0.1)
    assert np.mean(predicted != 1.0) < 0.02
    assert np.std(predicted) < 0.1 * np.std(found)


@pytest.mark.parametrize("size", [1, 3])
def test_an_innovation_as_large_as_chance_has_it_leaves_the_noise_as_it_is(size: int) -> None:
    usual = size + 3.0 * np.sqrt(2.0 * size)
    assert outlier_factor(usual, size) == 1.0
    assert outlier_factor(usual + 100.0, size) == pytest.approx((110.0 + usual) / (10.0 + usual))
