"""Alignments of tracks, against scipy and against what was applied."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.evaluation.track_alignment import Align, NoAlignmentError, aligned

RNG = np.random.default_rng(4)
TRACK = np.cumsum(RNG.normal(size=(50, 3)), axis=0)
TURN = Rotation.from_euler("zyx", [1.2, -0.4, 0.7])
SHIFT = np.array([10.0, -3.0, 0.5])


def test_a_similarity_that_was_applied_is_found() -> None:
    found = aligned(TRACK, 1.7 * TURN.apply(TRACK) + SHIFT, Align.SIM3)
    assert found.scale == pytest.approx(1.7)
    np.testing.assert_allclose(found.mat, TURN.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.shift_m, SHIFT, atol=1e-10)


def test_a_rotation_is_that_of_scipy() -> None:
    noisy = TURN.apply(TRACK) + SHIFT + RNG.normal(size=TRACK.shape)
    found = aligned(TRACK, noisy, Align.SE3)
    wanted, _ = Rotation.align_vectors(noisy - noisy.mean(axis=0), TRACK - TRACK.mean(axis=0))
    np.testing.assert_allclose(found.mat, wanted.as_matrix(), atol=1e-7)
    assert found.scale == 1.0


def test_a_heading_is_the_best_of_all_headings() -> None:
    noisy = Rotation.from_euler("z", 0.9).apply(TRACK) + SHIFT + RNG.normal(size=TRACK.shape)
    found = aligned(TRACK, noisy, Align.YAW)

    def missed(heading: float) -> float:
        turned = Rotation.from_euler("z", heading).apply(TRACK - TRACK.mean(axis=0))
        return float(np.sum((turned - noisy + noisy.mean(axis=0)) ** 2))

    heading = float(np.arctan2(found.mat[1, 0], found.mat[0, 0]))
    assert found.mat[2].tolist() == [0.0, 0.0, 1.0]
    assert missed(heading) < min(missed(heading + 1e-3), missed(heading - 1e-3))
    np.testing.assert_allclose(found.moved(TRACK).mean(axis=0), noisy.mean(axis=0), atol=1e-9)


def test_missing_positions_do_not_count() -> None:
    gaps = TRACK.copy()
    gaps[::7] = np.nan
    found = aligned(gaps, TURN.apply(TRACK) + SHIFT, Align.SE3)
    np.testing.assert_allclose(found.mat, TURN.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("align", [Align.SE3, Align.SIM3])
def test_a_line_or_a_point_determines_no_rotation(align: Align) -> None:
    line = np.outer(np.arange(20.0), [1.0, 2.0, 3.0])
    for track in (line, np.zeros((20, 3)), TRACK[:2]):
        with pytest.raises(NoAlignmentError):
            aligned(track, track, align)


def test_a_point_has_no_heading() -> None:
    with pytest.raises(NoAlignmentError):
        aligned(np.zeros((20, 3)), TRACK[:20], Align.YAW)
