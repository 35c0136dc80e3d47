"""What `benchmarks/misfit_worlds.py` tells the baseline, and how it counts."""

import math

import pytest
from misfit_worlds import GYROS, MISFITS, TACTICAL, Misfit, Named, config_of, named_on, row_of
from worlds import WORLDS


def named(*, is_named: bool) -> Named:
    return Named(1.0, (1.0, 20.0), is_named, is_named)


def test_all_worlds_are_known_and_the_baseline_alone_is_told_another_noise() -> None:
    by_name = {world.name: world.config for world in WORLDS}
    for misfit in MISFITS:
        config = by_name[misfit.world]
        told = config_of(misfit, config)
        baseline = told.filters["baseline"]
        assert told.filters["copy"] == baseline
        assert told.reference.attitude_sd_deg > 0.0
        assert told.noise == config.noise
        for key in misfit.noises:
            expected = misfit.times * getattr(config.noise, key)
            assert math.isclose(getattr(baseline, key), expected)


@pytest.mark.parametrize(
    ("misfit", "count", "is_met"),
    [
        (Misfit(TACTICAL, "sound"), 0, True),
        (Misfit(TACTICAL, "sound"), 12, False),
        (Misfit(TACTICAL, "gyros", GYROS, 0.1, is_asked=True), 24, True),
        (Misfit(TACTICAL, "gyros", GYROS, 0.1, is_asked=True), 2, False),
        (Misfit(TACTICAL, "gyros", GYROS, 10.0), 0, True),
    ],
)
def test_sound_baselines_must_not_be_named_and_others_must(
    misfit: Misfit, count: int, is_met: bool
) -> None:
    found = [named(is_named=number < count) for number in range(24)]
    row = row_of(misfit, found)
    assert row.is_met == is_met
    assert f"{count} of 24" in row.text


def test_process_noise_that_is_too_small_is_named_by_the_errors_of_one_dive() -> None:
    (place,) = (
        number
        for number, misfit in enumerate(MISFITS)
        if (misfit.world, misfit.about) == (TACTICAL, "all, 7 times too small")
    )
    found = named_on(place, 0)
    assert found.is_named
    assert found.by_errors
    assert 0.1 < found.nis < 10.0
