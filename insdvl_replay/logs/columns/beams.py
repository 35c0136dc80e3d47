"""Where the beams of a DVL point: by the configuration, by the messages if it can be true, or as most of them do."""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.config import Dvl
from insdvl_replay.geometry import beams
from insdvl_replay.logs.columns.cleaning import Cleaner
from insdvl_replay.logs.columns.decode import FRD, in_frd
from insdvl_replay.logs.columns.tables import Table

_UNIT_LENGTH_TOLERANCE: Final = 0.01
_SLANT_TOLERANCE: Final = 0.1
_CONTRADICTION: Final = 0.1
"""Both are computed from the same echoes, so that a tilt that is wrong by 3 deg already shows."""
_MOVING_MPS: Final = 0.05
_HINT: Final = "dvl.beam_tilt_deg and dvl.beam_azimuth_deg say what the instrument has"


def beam_vectors(table: Table, settings: Dvl, cleaner: Cleaner) -> Floats:
    """Give the unit vectors of the beams.

    Parameters
    ----------
    table : Table
    settings : Dvl
        Completed by the conventions of the type.
    cleaner : Cleaner
        Takes a note where the messages tell what cannot be true.

    Returns
    -------
    ndarray, shape (beams, 3)
        In d.

    Raises
    ------
    LogError
        The messages do not hold vectors where they should.
    """
    configured = settings.beam_tilt_deg is not None or settings.beam_azimuth_deg is not None
    if configured or "beam_vectors" not in table:
        return _geometry(settings)
    vectors = np.median(cleaner.kept(table.values("beam_vectors", 12)), axis=0).reshape(-1, 3)
    doubt = _doubt(vectors, table, cleaner)
    if not doubt:
        return in_frd(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), settings.axes or FRD, "dvl.axes")
    cleaner.note(
        "beam_geometry",
        f"pings have beam vectors that cannot be true ({doubt}); a tilt of {beams.TILT_DEG:g} deg and azimuths of "
        f"{', '.join(f'{azimuth:g}' for azimuth in beams.AZIMUTH_DEG)} deg are assumed",
        cleaner.rows.size,
        "warning",
        _HINT,
    )
    return _geometry(settings)


def note_contradiction(cleaner: Cleaner, beam_velocity_mps: Floats, vectors_d: Floats, velocity_d: Floats) -> None:
    """Note beams that do not add up to the velocity that the instrument itself computed from them.

    Parameters
    ----------
    cleaner : Cleaner
    beam_velocity_mps : ndarray, shape (kept, beams)
    vectors_d : ndarray, shape (beams, 3)
    velocity_d : ndarray, shape (kept, 3)
        The instrument's.
    """
    moving = np.isfinite(beam_velocity_mps).all(axis=1) & (np.linalg.norm(velocity_d, axis=1) > _MOVING_MPS)
    if not moving.any() or np.linalg.matrix_rank(vectors_d) < vectors_d.shape[1]:
        return
    by_beams_d = beams.solve_beams(beam_velocity_mps[moving], vectors_d)[0]
    apart_mps = np.linalg.norm(by_beams_d - velocity_d[moving], axis=1)
    part = float(np.median(apart_mps / np.linalg.norm(velocity_d[moving], axis=1)))
    if part > _CONTRADICTION:
        text = f"pings have beams that, with the geometry in use, differ by {part:.0%} from the velocity beside them"
        hint = f'{_HINT}; dvl.kind = "velocity" leaves them'
        cleaner.note("beam_contradiction", text, int(moving.sum()), "warning", hint, first=cleaner.rows[moving])


def _geometry(settings: Dvl) -> Floats:
    """Make the configured geometry, or a Janus's where nothing is configured."""
    tilt_deg, azimuth_deg = settings.beam_tilt_deg, settings.beam_azimuth_deg
    return beams.beam_vectors(
        beams.TILT_DEG if tilt_deg is None else tilt_deg, beams.AZIMUTH_DEG if azimuth_deg is None else azimuth_deg
    )


def _doubt(vectors: Floats, table: Table, cleaner: Cleaner) -> str:
    """Say what speaks against beam vectors: their length, or altitude over range, which is the part along z."""
    lengths = np.linalg.norm(vectors, axis=1)
    if not np.all(np.abs(lengths - 1.0) < _UNIT_LENGTH_TOLERANCE):
        return f"their lengths are {', '.join(f'{length:.3f}' for length in lengths)}"
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
