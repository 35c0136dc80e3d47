"""Whether 95 % intervals of a mean NEES hold the truth, on dives of which the filter knows all but what was drawn."""

import numpy as np
import pytest
from nees_intervals import held_alone, is_held, judged, matched_dives

from insdvl_replay.core.quantities import CREDIBILITY_GROUPS

DIVES = 60
LEAST = 0.85


@pytest.mark.nightly
@pytest.mark.parametrize("preset", ["tactical", "mems"])
def test_intervals_of_mean_nees_hold_the_truth(preset: str) -> None:
    dives = list(matched_dives(preset, DIVES))
    rows = [judged(errors) for errors in dives]
    held = {quantity: np.mean([is_held(row[quantity]) for row in rows]) for quantity in rows[0]}
    for quantity in (
        "velocity_n",
        "velocity_e",
        "velocity_d",
        "roll",
        "pitch",
        *CREDIBILITY_GROUPS,
    ):
        assert held[quantity] >= LEAST, quantity
    assert np.mean(list(held.values())) >= LEAST
    # It is not the errors of these few dives that make it so: alone they would show more samples than there are.
    alone = np.mean([held_alone(errors, "velocity_e") for errors in dives])
    assert alone < 0.8, "fast noise over a slow heading error"
