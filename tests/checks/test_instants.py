"""Which rows were recorded at one instant."""

import numpy as np
import pytest

from insdvl_replay.checks.sensors import same_instants

MS = 1_000_000


@pytest.mark.parametrize("late_ns", [0, 405_000, -405_000, 90 * MS])
def test_a_latency_that_is_the_same_for_all_hides_no_pair(late_ns: int) -> None:
    theirs = np.cumsum(np.random.default_rng(1).integers(190 * MS, 210 * MS, 100))
    lost = np.delete(np.arange(100), [3, 40, 41])
    ours, rows = same_instants(theirs[lost] + late_ns, theirs)
    assert list(ours) == list(range(97))
    assert list(rows) == list(lost)


@pytest.mark.parametrize("latency_s", [0.5, -1.3])
def test_a_latency_of_several_steps_that_is_reported_hides_no_pair(latency_s: float) -> None:
    theirs = np.cumsum(np.random.default_rng(1).integers(15 * MS, 25 * MS, 1000))
    ours = theirs[100:900] - round(latency_s * 1e9)
    assert len(same_instants(ours, theirs, latency_s)[0]) == 800
    assert len(same_instants(ours, theirs)[0]) < 80


def test_clocks_of_their_own_hardly_ever_agree() -> None:
    rng = np.random.default_rng(2)
    ours, theirs = (np.cumsum(rng.integers(190 * MS, 210 * MS, 1000)) for _ in range(2))
    assert len(same_instants(ours, theirs)[0]) < 10


def test_nothing_pairs_with_nothing() -> None:
    none = np.empty(0, dtype=np.int64)
    assert [
        len(rows) for rows in (*same_instants(none, none), *same_instants(np.arange(3), none))
    ] == [0, 0, 0, 0]
