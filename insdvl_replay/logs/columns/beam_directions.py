"""Where the beams of a DVL point: by the configuration, by the messages if it can be true, else as most DVLs do.

Messages tell it by unit vectors, by the poses of the beams, or by velocities that are vectors along them.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Dvl
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry import frames
from insdvl_replay.geometry.rotation import mat_from_quat
from insdvl_replay.logs.columns.cleaning import Cleaner
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.logs.columns.tables import Table

_UNIT_LENGTH_TOLERANCE: Final = 0.01
_SLANT_TOLERANCE: Final = 0.1
_CONTRADICTION: Final = 0.1
"""Both are computed from the same echoes, so that a tilt that is wrong by 3 deg already shows."""
_MOVING_MPS: Final = 0.05
_HINT: Final = "dvl.beam_tilt_deg and dvl.beam_azimuth_deg say what the instrument has"
_LARGEST: Final = 1000.0
"""m/s, or of a vector that should be of length 1."""
_SAME_LENGTH: Final = 1e-6
_SPEEDS: Final = "velocities along the beams"
_AXES: Final = "axes of the beams"
"""Columns that no message holds as such."""


def with_beam_speeds(table: Table, settings: Dvl) -> Table:
    """Give a table whose messages hold a velocity vector along each beam the axes of the beams, and speeds along them.

    A vector along a beam is its axis times the speed; an axis points down. While a beam has never moved, nothing tells
    where it points, and the table stays as it is.
    """
    if "beam_velocity_vectors" not in table:
        return table
    components = _within(table.values("beam_velocity_vectors"), _LARGEST)
    if not components.shape[1] or components.shape[1] % 3:
        return table
    vectors = components.reshape(len(table), 3, -1).transpose(0, 2, 1)
    sizes = np.linalg.norm(vectors, axis=2)
    down = in_frd(vectors.reshape(-1, 3), settings.axes or FRD, "dvl.axes")[:, 2].reshape(sizes.shape)
    axes = np.empty((vectors.shape[1], 3))
    for beam, axis in enumerate(axes):
        told = (sizes[:, beam] > _MOVING_MPS) & (down[:, beam] != 0.0)
        if not told.any():
            return table
        pointing = vectors[told, beam] * (np.sign(down[told, beam]) / sizes[told, beam])[:, None]
        axis[:] = np.median(pointing, axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    columns = {
        _SPEEDS: np.einsum("kbi,bi->kb", vectors, axes),
        _AXES: np.broadcast_to(axes.ravel(), (len(table), axes.size)),
    }
    fields = {**table.source.fields, "beam_velocity": _SPEEDS, "beam_vectors": _AXES}
    return replace(table, columns={**table.columns, **columns}, source=replace(table.source, fields=fields))


def _within(values: Floats, limit: float) -> Floats:
    """Return values, NaN where they are larger than any can be: a damaged log holds any numbers."""
    return np.where(np.abs(values) <= limit, values, np.nan)


def _told_vectors(table: Table, cleaner: Cleaner) -> Floats:
    """Return the directions that the messages tell in the log's axes, shape (beams, 3)."""
    quantity, width = ("beam_vectors", 3) if "beam_vectors" in table else ("beam_quaternions", 4)
    told = _within(cleaner.kept(table.values(quantity)), _LARGEST)
    if told.shape[1] % width:
        what = (
            f"field '{table.source.fields[quantity]}' holds {told.shape[1]} numbers, which are not {width} for a beam"
        )
        raise LogError(what, _HINT, *table.where)
    told = told.reshape(len(told), -1, width)
    if quantity == "beam_quaternions":
        told = mat_from_quat(_repaired(told))[..., 0]
    return np.asarray(np.median(told, axis=0))


def _repaired(quaternions: Floats) -> Floats:
    """Make quaternions, shape (k, beams, 4), of what the UUV Simulator writes: the axis of the turn whole, beside w.

    A quaternion whose vector part has length 1 can only be half a turn, with a w of 0.
    """
    vectors, w = quaternions[..., :3], quaternions[..., 3:]
    is_axis = (np.abs(np.linalg.norm(vectors, axis=-1, keepdims=True) - 1.0) < _SAME_LENGTH) & (np.abs(w) <= 1.0)
    sines = np.sqrt(np.clip(1.0 - w * w, 0.0, 1.0))
    return np.concatenate([np.where(is_axis, vectors * sines, vectors), w], axis=-1)


def beam_vectors(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[Floats, Floats | None]:
    """Return the unit vectors of the beams in d, shape (beams, 3), and where they look if messages tell it, shape (3,).

    Note what the messages tell and cannot be true.
    """
    if _is_configured(settings) or not ("beam_vectors" in table or "beam_quaternions" in table):
        return _geometry(settings), None
    vectors = _told_vectors(table, cleaner)
    doubt = _doubt(vectors, table, cleaner)
    if not doubt:
        vectors = in_frd(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), settings.axes or FRD, "dvl.axes")
        return vectors, _look(cleaner, vectors)
    cleaner.note(
        "beam_geometry",
        f"pings have beam vectors that cannot be true ({doubt}); a tilt of {frames.TILT_DEG:g} deg and azimuths of "
        f"{', '.join(f'{azimuth:g}' for azimuth in frames.AZIMUTH_DEG)} deg are assumed",
        cleaner.rows.size,
        Severity.WARNING,
        _HINT,
    )
    return _geometry(settings), None


def beams_of_velocities(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[Floats | None, Floats | None]:
    """Return what `beam_vectors` does where only velocities are used; None for beams that give none, or in one plane.

    Where beams look is read from their poses alone.
    """
    vectors, look = _geometry(settings), None
    if "beam_vectors" in table or "beam_quaternions" in table:
        told = _told_vectors(table, cleaner)
        if len(told) and not _doubt(told, table, cleaner):
            told = in_frd(told, settings.axes or FRD, "dvl.axes")
            look = _look(cleaner, told) if "beam_quaternions" in table else None
            vectors = vectors if _is_configured(settings) else told
    return vectors if np.linalg.matrix_rank(vectors, _UNIT_LENGTH_TOLERANCE) == 3 else None, look


def _look(cleaner: Cleaner, vectors_d: Floats) -> Floats:
    """Average beams, shape (beams, 3); note it if they do not look down, so that d is not forward-starboard-down."""
    mean: Floats = vectors_d.mean(axis=0)
    if frames.look_down(mean):
        return mean
    text = "pings have beams that do not look down but along ({:.2f}, {:.2f}, {:.2f}) in the axes in use".format(*mean)
    hint = 'dvl.axes says which of its axes look forward, starboard and down, as "flu" or "+z-y+x"'
    cleaner.note("beams_not_down", text, cleaner.rows.size, Severity.WARNING, hint)
    return mean


def note_contradiction(cleaner: Cleaner, beam_velocity_mps: Floats, vectors_d: Floats, velocity_d: Floats) -> None:
    """Note beams, shape (kept, beams), that do not add up to the velocity that the instrument makes of them."""
    moving = np.isfinite(beam_velocity_mps).all(axis=1) & (np.linalg.norm(velocity_d, axis=1) > _MOVING_MPS)
    if not moving.any() or np.linalg.matrix_rank(vectors_d) < vectors_d.shape[1]:
        return
    by_beams_d = frames.solve_beams(beam_velocity_mps[moving], vectors_d)[0]
    apart_mps = np.linalg.norm(by_beams_d - velocity_d[moving], axis=1)
    part = float(np.median(apart_mps / np.linalg.norm(velocity_d[moving], axis=1)))
    if part > _CONTRADICTION:
        text = f"pings have beams that, with the geometry in use, differ by {part:.0%} from the velocity beside them"
        hint = f'{_HINT}; dvl.kind = "velocity" leaves them'
        cleaner.note("beam_contradiction", text, int(moving.sum()), Severity.WARNING, hint, first=cleaner.rows[moving])


def _is_configured(settings: Dvl) -> bool:
    return settings.beam_tilt_deg is not None or settings.beam_azimuth_deg is not None


def _geometry(settings: Dvl) -> Floats:
    """Make the configured geometry, or a Janus's where nothing is configured."""
    tilt_deg, azimuth_deg = settings.beam_tilt_deg, settings.beam_azimuth_deg
    return frames.beam_vectors(
        frames.TILT_DEG if tilt_deg is None else tilt_deg, frames.AZIMUTH_DEG if azimuth_deg is None else azimuth_deg
    )


def _doubt(vectors: Floats, table: Table, cleaner: Cleaner) -> str:
    """State what speaks against beam vectors: their length, or altitude over range, which is the part along z."""
    lengths = np.linalg.norm(vectors, axis=1)
    if not np.all(np.abs(lengths - 1.0) < _UNIT_LENGTH_TOLERANCE):
        return f"their lengths are {', '.join(f'{length:.3f}' for length in lengths)}"
    if len(vectors) > 2 and np.linalg.matrix_rank(vectors, _UNIT_LENGTH_TOLERANCE) < 3:
        return "they lie in one plane"
    if "altitude" not in table or "beam_ranges" not in table:
        return ""
    altitude, ranges = cleaner.kept(table.column("altitude")), cleaner.kept(table.values("beam_ranges", 4))
    measured = np.isfinite(ranges).all(axis=1) & (ranges > 0.0).all(axis=1) & np.isfinite(altitude) & (altitude > 0.0)
    if not measured.any():
        return ""
    slant = float(np.median(altitude[measured, None] / ranges[measured]))
    along_z = float(np.median(vectors[:, 2]))
    if abs(slant - along_z) < _SLANT_TOLERANCE:
        return ""
    return f"their part along z is {along_z:.3f}, altitude over range is {slant:.3f}"
