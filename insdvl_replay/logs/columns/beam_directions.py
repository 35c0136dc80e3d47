"""Which directions of the beams agree with the velocity that the instrument computed from them.

A velocity along a beam is the part of the instrument's velocity along the beam's direction. Both are from the same
echoes, so that directions which are right leave next to nothing, and wrong ones a part that grows with the velocity.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import AZIMUTH_DEG, beam_vectors

AGREES: Final = 0.03  # share of the velocity, for which a tilt of 30 deg is 1 deg off
CONTRADICTS: Final = 0.1  # the same for directions that a person has given: 3 deg of tilt
OPPOSITE: Final = 1.5  # share of the velocity along one axis; one of the opposite sign leaves 2
_SLOW_MPS: Final = 0.015  # slower velocities along an axis are noise of the DVL
_MOVING_MPS: Final = 0.05
_OUTLIER: Final = 5.0  # in medians of the differences
_SAME_SPEED: Final = 0.03
_CLEARLY: Final = 2.0  # ratio to the second best set of azimuths
_TILTS_DEG: Final = (20.0, 22.5, 25.0, 30.0)  # of most instruments
_CROSS_DEG: Final = (0.0, 90.0, 180.0, 270.0)


def azimuths_and_tilts_deg(vectors_d: Floats) -> tuple[list[float], list[float]]:
    """Return the azimuths from forward towards starboard, and the tilts from down, of beams, shape (beams, 3)."""
    azimuths = np.arctan2(vectors_d[:, 1], vectors_d[:, 0]) / DEG % 360.0
    tilts = np.arctan2(np.hypot(vectors_d[:, 0], vectors_d[:, 1]), vectors_d[:, 2]) / DEG
    return azimuths.tolist(), tilts.tolist()


@dataclass(frozen=True)
class BeamVelocities:
    """Velocities along the beams, and those that the instrument made of them, where it moves and has all beams."""

    along_mps: Floats  # (k, beams)
    velocity_d: Floats  # (k, 3)

    @classmethod
    def of_pings(cls, along_mps: Floats, velocity_d: Floats) -> "BeamVelocities":
        """Choose the pings that have both."""
        whole = np.isfinite(along_mps).all(axis=1) & np.isfinite(velocity_d).all(axis=1)
        speeds_mps = np.linalg.norm(np.nan_to_num(velocity_d, posinf=0.0, neginf=0.0), axis=1)
        moving = whole & (speeds_mps > _MOVING_MPS)
        return cls(along_mps[moving], velocity_d[moving])

    def __len__(self) -> int:
        """Return the number of pings."""
        return len(self.along_mps)

    def misfit(self, vectors_d: Floats) -> float:
        """Return how far the velocity by beams with directions, shape (beams, 3), is from the instrument's.

        It is a share, of roots of mean squares, without the noise, which does not grow with the velocity. It is
        infinite where the beams give no velocity.
        """
        apart = self._systematic(vectors_d)
        if apart is None:
            return np.inf
        sizes = np.linalg.norm(apart, axis=1)
        return float(np.linalg.norm(sizes)) / float(np.linalg.norm(self.velocity_d))

    def is_opposite(self, vectors_d: Floats) -> bool:
        """Return whether directions give the velocity along an axis the opposite sign."""
        apart = self._systematic(vectors_d)
        if apart is None:
            return False
        wrong_mps = np.sqrt(np.mean(apart**2, axis=0))
        usual_mps = np.sqrt(np.mean(self.velocity_d**2, axis=0))
        return bool(np.any((usual_mps > _SLOW_MPS) & (wrong_mps > OPPOSITE * usual_mps)))

    def agree(self, vectors_d: Floats, limit: float = AGREES) -> bool:
        """Return whether directions agree with the velocities."""
        return self.misfit(vectors_d) <= limit and not self.is_opposite(vectors_d)

    def has_other_axes(self, vectors_d: Floats) -> bool:
        """Return whether the velocities are as fast as the beams say, but in axes that do not turn with them.

        Such as north and east: then the velocities say nothing about the directions of the beams.
        """
        by_beams = self._by_beams(vectors_d)
        if by_beams is None:
            return False
        speeds_mps = np.linalg.norm(self.velocity_d, axis=1)
        apart = np.abs(np.linalg.norm(by_beams, axis=1) - speeds_mps) / speeds_mps
        as_turned, *_ = np.linalg.lstsq(self.velocity_d, by_beams, rcond=None)
        left = np.linalg.norm(by_beams - self.velocity_d @ as_turned) / np.linalg.norm(by_beams)
        return bool(np.median(apart) < _SAME_SPEED and left > CONTRADICTS)

    def _by_beams(self, vectors_d: Floats) -> Floats | None:
        """Return the velocities that the beams give, shape (k, 3); None where they give none."""
        if len(vectors_d) != self.along_mps.shape[1] or np.linalg.matrix_rank(vectors_d, 0.01) < 3:
            return None
        return np.asarray(self.along_mps @ np.linalg.pinv(vectors_d).T)

    def _systematic(self, vectors_d: Floats) -> Floats | None:
        """Return by what the velocities of the beams are off in proportion to the instrument's, shape (k, 3)."""
        by_beams = self._by_beams(vectors_d)
        if by_beams is None:
            return None
        apart = by_beams - self.velocity_d
        sizes = np.linalg.norm(apart, axis=1)
        usual = sizes <= _OUTLIER * float(np.median(sizes)) + 1e-9
        by_velocity, *_ = np.linalg.lstsq(self.velocity_d[usual], apart[usual], rcond=None)
        return np.asarray(self.velocity_d @ by_velocity)


def agreeing_directions(
    pings: BeamVelocities, reported: Floats | None, slant: float | None
) -> Floats | None:
    """Return other directions than those in use that agree with the velocities, shape (beams, 3); None without any.

    Those that the messages report come first, with other tilts: the sine and the cosine of one may be swapped, and the
    slant, altitude over range, shows it. Then come the usual azimuths in each order, of which one has to be clearly the
    best.
    """
    for vectors_d in _reported_with_tilts(reported, slant):
        if pings.agree(vectors_d):
            return vectors_d
    if pings.along_mps.shape[1] != len(AZIMUTH_DEG):
        return None
    best: list[tuple[float, Floats]] = []  # of each set of azimuths
    for azimuths_deg in (*permutations(AZIMUTH_DEG), *permutations(_CROSS_DEG)):
        tried = [beam_vectors(tilt_deg, azimuths_deg) for tilt_deg in _tilts_deg(slant)]
        misfits = [pings.misfit(vectors_d) for vectors_d in tried]
        nearest = int(np.argmin(misfits))
        best.append((misfits[nearest], tried[nearest]))
    best.sort(key=lambda found: found[0])
    misfit, vectors_d = best[0]
    second, _ = best[1]
    is_clear = second > max(AGREES, _CLEARLY * misfit)
    if is_clear and pings.agree(vectors_d):
        return vectors_d
    return None


def _tilts_deg(slant: float | None) -> Sequence[float]:
    if slant is None or not 0.0 < slant < 1.0:
        return _TILTS_DEG
    return (float(np.arccos(slant)) / DEG, *_TILTS_DEG)


def _reported_with_tilts(reported: Floats | None, slant: float | None) -> Iterator[Floats]:
    if reported is None:
        return
    azimuths_deg, tilts_deg = azimuths_and_tilts_deg(reported)
    swapped_deg = [90.0 - float(np.median(tilts_deg))]
    for tilt_deg in (*swapped_deg, *_tilts_deg(slant)):
        vectors_d = beam_vectors(tilt_deg, azimuths_deg)
        if np.linalg.matrix_rank(vectors_d, 0.01) == 3:
            yield vectors_d
