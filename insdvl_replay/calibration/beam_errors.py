"""What single beams may be off by, which no innovation tells from how the DVL is built in.

A beam that reads a little long, or is never quite at zero, turns and stretches the velocity, and with it what is found.
Makers of DVLs give 0.2 % and 1 mm/s or more. These errors are not estimated; how far they would pull the answer counts
in its standard deviations. Source: Schmidt, "Application of state-space methods to navigation problems", 1966
("consider" parameters).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import Fit
from insdvl_replay.calibration.innovations import DiveInnovations
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import each
from insdvl_replay.geometry.beams import beam_vectors

OFFSET_SD_MPS: Final = 0.001
"""Of a beam's constant offset."""
STRETCH_SD: Final = 0.002
"""Of how much too long a beam reads."""
STEP: Final = 3.0
"""Of differences, in these standard deviations."""


def pulled_by_beams(fit: Fit, dives: Sequence[DiveInnovations]) -> Floats:
    """Return how far errors of one sd of each beam pull the answer, shape (count, 8): offsets, then stretches.

    The beams are those of the usual instrument, four at 30 deg, and err alike in all dives.

    Parameters
    ----------
    dives : sequence of DiveInnovations
        Those that were fitted, in the same order.
    """
    pull = np.zeros((fit.unknowns.count, 2 * len(beam_vectors())))
    for i, (dive, near) in enumerate(zip(dives, fit.dives, strict=True)):
        change = fit.unknowns.of_dive(fit.values, i)
        shaken = each(partial(DiveInnovations.residuals, change=change), _shaken(dive))
        moved = (np.array(list(shaken)) - near.residuals) / (STEP * near.scatter)
        pull[fit.unknowns.rows(i)] -= np.einsum("ka,kai,jka->ij", near.weights**3, near.by_motion, moved)
    pull[~fit.unknowns.is_free] = 0.0
    return np.asarray(fit.moved_by_scores @ pull)


def _shaken(dive: DiveInnovations) -> list[DiveInnovations]:
    """Let each beam err in turn by so many standard deviations, first by its offset, then by its stretch."""
    mat_bd = dive.prepared.mounting.mat_bd
    beams = beam_vectors()
    velocities = dive.prepared.velocities
    seen_mps = velocities.velocity_b @ mat_bd @ beams.T
    per_beam_b = mat_bd @ np.linalg.pinv(beams)
    errors_mps = [np.full_like(seen_mps, OFFSET_SD_MPS), STRETCH_SD * seen_mps]
    return [
        replace(
            dive,
            prepared=replace(
                dive.prepared,
                velocities=replace(
                    velocities,
                    velocity_b=velocities.velocity_b + STEP * np.outer(error_mps[:, beam], per_beam_b[:, beam]),
                ),
            ),
        )
        for error_mps in errors_mps
        for beam in range(len(beams))
    ]
