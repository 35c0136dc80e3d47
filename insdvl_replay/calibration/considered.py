"""Errors of beams and of the IMU that innovations do not tell from the geometry of the DVL.

A beam that reads a little long turns and stretches the velocity, and so does an IMU whose axes are not at right angles.
These errors are not corrected. Their effect on the answer counts in its standard deviations. Of the IMU's errors it is
the effect of what the innovations show, and of what they leave open: it is found as if they were estimated with the
geometry. Source: Schmidt, "Application of state-space methods to navigation problems", 1966 ("consider" parameters).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import Fit, Linearised
from insdvl_replay.calibration.innovations import DiveInnovations
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.geometry.frames import beam_vectors

OFFSET_SD_MPS: Final = 0.001
"""Of a beam's constant offset. Makers of DVLs give 1 mm/s and 0.2 % or more."""
STRETCH_SD: Final = 0.002
"""Of a beam's scale."""
IMU_SCALE_SD: Final = 1.5e-3
"""Tactical sensors have 300 to 500 ppm by their data sheets (Sensonor STIM300), smaller ones 0.1 to 0.5 %."""
IMU_MISALIGNMENT_SD: Final = 1e-3
"""rad, of each axis of a triad towards each other one, by the same data sheet."""
STEP: Final = 3.0
"""Of differences, in these standard deviations."""
BEAM_ERRORS: Final = 2 * len(beam_vectors())


def effects_of_errors(fit: Fit, dives: Sequence[DiveInnovations]) -> list[Floats]:
    """Return the change of the residuals with each error of one sd, over their scatter, shape (k, 3, 26) of each dive.

    First the offsets and the scales of the usual four beams at 30 deg, then the IMU.
    """
    found = []
    for i, (dive, near) in enumerate(zip(dives, fit.dives, strict=True)):
        change = fit.of_dive(i)
        shaken = parallel_map(partial(DiveInnovations.residuals, change=change), [*_with_beams(dive), *_with_imu(dive)])
        found.append(np.stack([(one - near.residuals) / (STEP * near.scatter) for one in shaken], axis=-1))
    return found


def beside_imu_errors(fit: Fit, effects: Sequence[Floats]) -> Fit:
    """Return the fit with derivatives that are left when the errors of the IMU are estimated beside the geometry.

    Its step leads to the answer that such an estimate would give: it is not taken, since innovations that are
    correlated for another reason look like these errors, and counts in the standard deviations.
    """
    return replace(fit, dives=tuple(map(_without_imu_errors, fit.dives, effects)))


def _without_imu_errors(near: Linearised, moved: Floats) -> Linearised:
    imu = moved[:, :, BEAM_ERRORS:]
    weighted = near.weights[:, :, None] * imu
    information = np.einsum("kai,kaj->ij", weighted, imu) + np.eye(imu.shape[2])
    alike = np.linalg.solve(information, np.einsum("kai,kaj->ij", weighted, near.by_motion))
    return replace(near, by_motion=near.by_motion - imu @ alike)


def pulled(fit: Fit, effects: Sequence[Floats]) -> Floats:
    """Return how far each error of one sd, the same in all dives, pulls the answer, shape (count, 26)."""
    pull = np.zeros((fit.unknowns.count, effects[0].shape[2]))
    for i, (near, moved) in enumerate(zip(fit.dives, effects, strict=True)):
        pull[fit.unknowns.rows(i)] -= np.einsum("ka,kai,kaj->ij", near.weights**3, near.by_motion, moved)
    pull[~fit.unknowns.is_free] = 0.0
    return np.asarray(fit.moved_by_scores @ pull)


def nis_by_errors(fit: Fit, effects: Sequence[Floats]) -> float:
    """Return how much of the sum of the NIS of all dives the errors explain that the innovations show."""
    total = 0.0
    for near, moved in zip(fit.dives, effects, strict=True):
        weighted = near.weights[:, :, None] * moved
        cov = np.linalg.inv(np.einsum("kai,kaj->ij", weighted, moved) + np.eye(moved.shape[2]))
        likeliest = cov @ np.einsum("kai,ka->i", weighted, near.scaled)
        power = (moved @ likeliest) ** 2 + np.einsum("kai,ij,kaj->ka", moved, cov, moved)
        total += float(np.sum(power * near.scatter**2))
    return total


def _with_beams(dive: DiveInnovations) -> Iterator[DiveInnovations]:
    """Let each beam err in turn by `STEP` standard deviations, first by its offset, then by its scale."""
    mat_bd, beams, velocities = dive.prepared.mounting.mat_bd, beam_vectors(), dive.prepared.velocities
    seen_mps = velocities.velocity_b @ mat_bd @ beams.T
    per_beam_b = mat_bd @ np.linalg.pinv(beams)
    for errors_mps in (np.full_like(seen_mps, OFFSET_SD_MPS), STRETCH_SD * seen_mps):
        for beam in range(len(beams)):
            moved_b = velocities.velocity_b + STEP * np.outer(errors_mps[:, beam], per_beam_b[:, beam])
            yield replace(dive, prepared=replace(dive.prepared, velocities=replace(velocities, velocity_b=moved_b)))


def _with_imu(dive: DiveInnovations) -> Iterator[DiveInnovations]:
    """Let each axis of the accelerometers read a part of each axis, then each of the gyros."""
    imu = dive.dive.imu
    for name in ("specific_force_b", "angular_rate_b"):
        for row in range(3):
            for column in range(3):
                sd = IMU_SCALE_SD if row == column else IMU_MISALIGNMENT_SD
                readings = getattr(imu, name).copy()
                readings[:, row] += STEP * sd * getattr(imu, name)[:, column]
                yield replace(dive, dive=replace(dive.dive, imu=replace(imu, **{name: readings})))
