"""The pings of a DVL, as beams or as velocities.

Beams point from the instrument to the seabed; the velocity along one is that of the vehicle over ground.
"""

from typing import Final

import numpy as np

from insdvl_replay.columns import DvlColumns, Floats
from insdvl_replay.config import Dvl
from insdvl_replay.errors import ConfigError, LogError, Note
from insdvl_replay.logs.cleaning import Cleaner, Mask
from insdvl_replay.logs.decode import FRD, VELOCITY_UNITS, in_frd
from insdvl_replay.logs.tables import Table
from insdvl_replay.states import DEG

TILT_DEG: Final = 30.0
"""Angle of the beams from the DVL's z axis, where nothing tells it."""
AZIMUTH_DEG: Final = (45.0, 135.0, 225.0, 315.0)
"""Angles of the beams from forward towards starboard, where nothing tells them."""

_WATER_TRACK: Final = 2
_BEAMS_FOR_VELOCITY: Final = 3
_UNIT_LENGTH_TOLERANCE: Final = 0.01
_SLANT_TOLERANCE: Final = 0.1


def decode_dvl(table: Table, settings: Dvl) -> tuple[DvlColumns, list[Note]]:
    """Make the columns of the DVL.

    Parameters
    ----------
    table : Table
    settings : Dvl

    Returns
    -------
    DvlColumns
    list of Note

    Raises
    ------
    LogError
        No ping can be used, or the messages do not hold what the configuration asks for.
    ConfigError
        The axes are none, or the geometry does not fit the number of beams.
    """
    cleaner = Cleaner("dvl", table.time_ns())
    if "mode" in table:
        cleaner.keep(table.column("mode") != _WATER_TRACK, "water_track", "pings are water track")
    if _reads_beams(table, settings, cleaner):
        return _beams(table, settings, cleaner)
    return _velocities(table, settings, cleaner)


def _reads_beams(table: Table, settings: Dvl, cleaner: Cleaner) -> bool:
    """Decide between beams and velocities; beams where there are any, unless the configuration says otherwise."""
    kind = settings.kind
    if kind is not None:
        quantity = "beam_velocity" if kind == "beams" else "velocity"
        if quantity not in table:
            raise LogError(
                f"{table.place}: type {table.source.type_name} has no {quantity}, and dvl.kind is '{kind}'",
                f'dvl.{quantity} = "field.path" names it',
            )
        return kind == "beams"
    if "beam_velocity" not in table or "velocity" not in table:
        return "beam_velocity" in table
    if bool(_has_beams(table).any()):
        return True
    cleaner.note("no_beams", "pings, all there are, have no valid beam; their velocities are used", len(table))
    return False


def _has_beams(table: Table) -> Mask:
    """Tell which pings have a beam that counts."""
    lost = np.isnan(table.values("beam_velocity")).all(axis=1)
    if "beams_valid" in table:
        lost |= table.column("beams_valid") == 0.0
    return np.asarray(~lost)


def _velocities(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[DvlColumns, list[Note]]:
    unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    velocity_d = in_frd(table.values("velocity", 3), settings.axes or FRD, "dvl.axes", unit)
    if "good_beams" in table and table.column("good_beams").any():
        enough = table.column("good_beams") >= _BEAMS_FOR_VELOCITY
        cleaner.keep(enough, "invalid", "pings have fewer than three good beams")
    cleaner.keep_finite(velocity_d)
    _drop_repeats(table, cleaner, velocity_d)
    return DvlColumns(cleaner.times, velocity_d=cleaner.kept(velocity_d)), cleaner.notes


def _beams(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[DvlColumns, list[Note]]:
    beam_velocity_mps = table.values("beam_velocity") * VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    cleaner.keep(_has_beams(table), "invalid", "pings have no valid beam")
    _drop_repeats(table, cleaner, beam_velocity_mps)
    vectors_d = _beam_vectors(table, settings, cleaner)
    if len(vectors_d) != beam_velocity_mps.shape[1]:
        raise ConfigError(
            f"{table.place}: has {beam_velocity_mps.shape[1]} beams, and the geometry {len(vectors_d)}",
            "dvl.beam_azimuth_deg lists one angle for each beam",
        )
    # A reading along a beam that is infinite is as lost as one that is NaN.
    finite = np.where(np.isfinite(beam_velocity_mps), beam_velocity_mps, np.nan)
    return DvlColumns(cleaner.times, cleaner.kept(finite), vectors_d), cleaner.notes


def _drop_repeats(table: Table, cleaner: Cleaner, values: Floats) -> None:
    cleaner.drop_repeated_times()
    cleaner.drop_repeated_values(values)
    cleaner.require_rows(table.place)


def _beam_vectors(table: Table, settings: Dvl, cleaner: Cleaner) -> Floats:
    """Take the geometry from the configuration, from the messages if it can be true, or else the usual one."""
    configured = settings.beam_tilt_deg is not None or settings.beam_azimuth_deg is not None
    if configured or "beam_vectors" not in table:
        return _geometry(settings)
    vectors = np.median(cleaner.kept(table.values("beam_vectors", 12)), axis=0).reshape(-1, 3)
    doubt = _doubt(vectors, table, cleaner)
    if not doubt:
        return in_frd(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), settings.axes or FRD, "dvl.axes")
    cleaner.note(
        "beam_geometry",
        f"pings have beam vectors that cannot be true ({doubt}); a tilt of {TILT_DEG:g} deg and azimuths of "
        f"{', '.join(f'{azimuth:g}' for azimuth in AZIMUTH_DEG)} deg are assumed",
        cleaner.rows.size,
        "warning",
        "dvl.beam_tilt_deg and dvl.beam_azimuth_deg say what the instrument has",
    )
    return _geometry(settings)


def _geometry(settings: Dvl) -> Floats:
    tilt = DEG * (TILT_DEG if settings.beam_tilt_deg is None else settings.beam_tilt_deg)
    azimuth = DEG * np.array(settings.beam_azimuth_deg or AZIMUTH_DEG)
    down = np.full_like(azimuth, np.cos(tilt))
    return np.stack([np.cos(azimuth) * np.sin(tilt), np.sin(azimuth) * np.sin(tilt), down], axis=1)


def _doubt(vectors: Floats, table: Table, cleaner: Cleaner) -> str:
    """Say what speaks against beam vectors: their length, or altitude over range, which is the part along z."""
    lengths = np.linalg.norm(vectors, axis=1)
    if not np.all(np.abs(lengths - 1.0) < _UNIT_LENGTH_TOLERANCE):
        return f"their lengths are {', '.join(f'{length:.3f}' for length in lengths)}"
    altitude, ranges = cleaner.kept(table.column("altitude")), cleaner.kept(table.values("beam_ranges", 4))
    measured = np.isfinite(ranges).all(axis=1) & (ranges > 0.0).all(axis=1) & np.isfinite(altitude) & (altitude > 0.0)
    if not measured.any():
        return ""
    slant = float(np.median(altitude[measured, None] / ranges[measured]))
    along_z = float(np.median(vectors[:, 2]))
    if abs(slant - along_z) < _SLANT_TOLERANCE:
        return ""
    return f"their part along z is {along_z:.3f}, altitude over range is {slant:.3f}"
