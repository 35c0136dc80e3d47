"""Adaptive and Student-t noise of the DVL, as candidates beside a filter that believes what it is told."""

from collections.abc import Iterator

import numpy as np
import pytest
from contaminated_dives import CANDIDATES, competitors, contaminated_dive

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.words import Judgement
from insdvl_replay.nav.measurement_noise import CEILING, FLOOR, believed_factor, found_factor, outlier_factor
from insdvl_replay.replay import replay_dive

DIVES, LENGTH_S, STARTS = 5, 600.0, 8
PREDICTED_VAR = 0.5


def words(aiding: str, off_by_mps: float) -> list[Judgement | None]:
    """Words on both candidates in some dives."""
    dives = (contaminated_dive(seed, LENGTH_S, off_by_mps) for seed in range(DIVES))
    replays = (replay_dive(dive, competitors(aiding, STARTS)) for dive in dives)
    return [each.verdicts[name].improvement for each in replays for name in CANDIDATES]


@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_where_pings_are_contaminated_they_are_better(aiding: str) -> None:
    assert words(aiding, 0.2) == [Judgement.BETTER] * DIVES * len(CANDIDATES)


@pytest.mark.parametrize("aiding", ["velocity", "beams"])
def test_on_clean_dives_they_are_equivalent(aiding: str) -> None:
    assert words(aiding, 0.0) == [Judgement.EQUIVALENT] * DIVES * len(CANDIDATES)


def followed(true_var: Floats, size: int) -> Iterator[tuple[float, float]]:
    """What is found and believed of the noise of innovations whose variance is so much larger than said."""
    rng, R, found, believed = np.random.default_rng(2), np.eye(size), 1.0, 1.0
    for var in true_var:
        z = rng.normal(scale=np.sqrt(var + PREDICTED_VAR), size=size)
        S = believed * R + PREDICTED_VAR * np.eye(size)
        found = found_factor(found, believed, z, S, believed * R)
        believed = believed_factor(found, believed, S, believed * R)
        yield found, believed


def test_a_noise_that_doubles_is_followed_within_a_window_or_two() -> None:
    found, believed = np.transpose(list(followed(np.repeat([1.0, 2.0], 300), 3)))
    assert np.mean(found[100:300]) == pytest.approx(1.0, abs=0.15)
    assert np.mean(found[360:]) == pytest.approx(2.0, abs=0.3)
    assert np.mean(believed[360:]) == pytest.approx(2.0, abs=0.35)
    assert found.min() > FLOOR
    assert found.max() < CEILING


@pytest.mark.parametrize("size", [1, 3])
def test_chance_is_not_believed(size: int) -> None:
    found, believed = np.transpose(list(followed(np.ones(100_000), size)))
    var = 2.0 * (1.0 + PREDICTED_VAR) ** 2 / size / 59.0
    assert np.std(found) == pytest.approx(np.sqrt(var), rel=0.1)
    assert np.mean(believed != 1.0) < 0.02
    assert np.std(believed) < 0.1 * np.std(found)


@pytest.mark.parametrize("size", [1, 3])
def test_an_innovation_as_large_as_chance_has_it_leaves_the_noise_as_it_is(size: int) -> None:
    usual = size + 3.0 * np.sqrt(2.0 * size)
    assert outlier_factor(usual, size) == 1.0
    assert outlier_factor(usual + 100.0, size) == pytest.approx((110.0 + usual) / (10.0 + usual))
