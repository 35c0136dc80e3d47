"""The pings of a DVL, as beams or as velocities.

Beams point where the configuration says, else where the messages do if it can be true, else where those of most DVLs
do: from the instrument to the seabed; the velocity along one is that of the vehicle over ground.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.config import Dvl
from insdvl_replay.core.dive_columns import DvlColumns, Floats, find_runs, seconds
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import FASTEST_MPS, VELOCITY_UNITS
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry import beams
from insdvl_replay.logs.columns.cleaning import Cleaner, is_few, note_bursts, note_lost_samples, same_rows
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.logs.columns.order import Mask
from insdvl_replay.logs.columns.tables import Table

_UNIT_LENGTH_TOLERANCE: Final = 0.01
_SLANT_TOLERANCE: Final = 0.1
_CONTRADICTION: Final = 0.1
"""Both are computed from the same echoes, so that a tilt that is wrong by 3 deg already shows."""
_MOVING_MPS: Final = 0.05
_HINT: Final = "dvl.beam_tilt_deg and dvl.beam_azimuth_deg say what the instrument has"


def beam_vectors(table: Table, settings: Dvl, cleaner: Cleaner) -> Floats:
    """Return the unit vectors of the beams in d, shape (beams, 3); note what the messages tell and cannot be true."""
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
        Severity.WARNING,
        _HINT,
    )
    return _geometry(settings)


def note_contradiction(cleaner: Cleaner, beam_velocity_mps: Floats, vectors_d: Floats, velocity_d: Floats) -> None:
    """Note beams, shape (kept, beams), that do not add up to the velocity that the instrument makes of them."""
    moving = np.isfinite(beam_velocity_mps).all(axis=1) & (np.linalg.norm(velocity_d, axis=1) > _MOVING_MPS)
    if not moving.any() or np.linalg.matrix_rank(vectors_d) < vectors_d.shape[1]:
        return
    by_beams_d = beams.solve_beams(beam_velocity_mps[moving], vectors_d)[0]
    apart_mps = np.linalg.norm(by_beams_d - velocity_d[moving], axis=1)
    part = float(np.median(apart_mps / np.linalg.norm(velocity_d[moving], axis=1)))
    if part > _CONTRADICTION:
        text = f"pings have beams that, with the geometry in use, differ by {part:.0%} from the velocity beside them"
        hint = f'{_HINT}; dvl.kind = "velocity" leaves them'
        cleaner.note("beam_contradiction", text, int(moving.sum()), Severity.WARNING, hint, first=cleaner.rows[moving])


def _geometry(settings: Dvl) -> Floats:
    """Make the configured geometry, or a Janus's where nothing is configured."""
    tilt_deg, azimuth_deg = settings.beam_tilt_deg, settings.beam_azimuth_deg
    return beams.beam_vectors(
        beams.TILT_DEG if tilt_deg is None else tilt_deg, beams.AZIMUTH_DEG if azimuth_deg is None else azimuth_deg
    )


def _doubt(vectors: Floats, table: Table, cleaner: Cleaner) -> str:
    """State what speaks against beam vectors: their length, or altitude over range, which is the part along z."""
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


STUCK_S: Final = 5.0
"""A DVL on a vehicle in water repeats no ping to the last digit for so long."""

_WATER_TRACK: Final = 2
_BEAM_COORDINATES: Final = 0
_INSTRUMENT_COORDINATES: Final = 1
_BEAMS_FOR_VELOCITY: Final = 3
_STUCK_PINGS: Final = 5
_VALID_HINT: Final = 'dvl.valid = "field.path", or dvl.beam_valid, names what marks good pings'


def decode_dvl(table: Table, settings: Dvl) -> tuple[DvlColumns, list[Note]]:
    """Make the columns of the DVL."""
    settings = table.source.completed(settings)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    _keep_bottom_track(table, cleaner)
    if _reads_beams(table, settings, cleaner):
        return _beams(table, settings, cleaner)
    return _velocities(table, settings, cleaner)


def _keep_bottom_track(table: Table, cleaner: Cleaner) -> None:
    if "mode" in table:
        cleaner.keep(table.column("mode") != _WATER_TRACK, "water_track", "pings are water track")
    if "water_track" in table:
        cleaner.keep(table.column("water_track") == 0.0, "water_track", "pings are water track")
    if "status" in table:
        cleaner.keep(table.column("status") >= 0.0, "lost", "pings say by their status that the bottom was lost")


def _keep_valid(table: Table, cleaner: Cleaner) -> None:
    if "valid" in table:
        cleaner.keep(np.all(table.values("valid") > 0.0, axis=1), "invalid", "pings are marked as invalid")


def _keep_coordinates(table: Table, cleaner: Cleaner, wanted: int) -> None:
    """Drop what is not given in the wanted coordinates."""
    if "coordinates" in table:
        cleaner.keep(table.column("coordinates") == wanted, "coordinates", "pings are in other coordinates")


def _reads_beams(table: Table, settings: Dvl, cleaner: Cleaner) -> bool:
    """Decide between beams and velocities; beams where there are any, unless the configuration says otherwise."""
    kind = settings.kind
    if kind is not None:
        quantity = "beam_velocity" if kind == "beams" else "velocity"
        if quantity not in table:
            raise LogError(
                f"type {table.source.type_name} has no {quantity}, and dvl.kind is '{kind}'",
                f'dvl.{quantity} = "field.path" names it',
                *table.where,
            )
        return kind == "beams"
    if "beam_velocity" not in table or "velocity" not in table:
        return "beam_velocity" in table
    if bool(_has_beams(table).any()):
        return True
    cleaner.note("no_beams", "pings, all there are, have no valid beam; their velocities are used", len(table))
    return False


def _has_beams(table: Table) -> Mask:
    """Find which pings have a beam that counts."""
    lost = np.isnan(_beam_velocity(table)).all(axis=1)
    if "beams_valid" in table:
        lost |= table.column("beams_valid") == 0.0
    return np.asarray(~lost)


def _velocities(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[DvlColumns, list[Note]]:
    velocity_d = _possible(_velocity_d(table, settings), cleaner)
    _keep_valid(table, cleaner)
    _keep_coordinates(table, cleaner, _INSTRUMENT_COORDINATES)
    if "good_beams" in table and table.column("good_beams").any():
        enough = table.column("good_beams") >= _BEAMS_FOR_VELOCITY
        cleaner.keep(enough, "invalid", "pings have fewer than three good beams")
    cleaner.keep_finite(velocity_d)
    _drop_repeats(cleaner, velocity_d)
    return DvlColumns(cleaner.times, velocity_d=cleaner.kept(velocity_d)), cleaner.notes


def _velocity_d(table: Table, settings: Dvl) -> Floats:
    unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    return in_frd(table.values("velocity", 3), settings.axes or FRD, "dvl.axes", unit)


def _beams(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[DvlColumns, list[Note]]:
    beam_velocity_mps = _possible(_beam_velocity(table) * VELOCITY_UNITS[settings.velocity_unit or "m/s"], cleaner)
    _keep_coordinates(table, cleaner, _BEAM_COORDINATES)
    if "beam_valid" not in table:
        _keep_valid(table, cleaner)
    cleaner.keep(_has_beams(table), "invalid", "pings have no valid beam")
    _drop_repeats(cleaner, beam_velocity_mps)
    vectors_d = beam_vectors(table, settings, cleaner)
    if len(vectors_d) != beam_velocity_mps.shape[1]:
        raise ConfigError(
            f"has {beam_velocity_mps.shape[1]} beams, and the geometry {len(vectors_d)}",
            "dvl.beam_azimuth_deg lists one angle for each beam",
            *table.where,
        )
    # A reading along a beam that is infinite is as lost as one that is NaN.
    finite = cleaner.kept(np.where(np.isfinite(beam_velocity_mps), beam_velocity_mps, np.nan))
    if "velocity" in table and "coordinates" not in table:
        note_contradiction(cleaner, finite, vectors_d, cleaner.kept(_velocity_d(table, settings)))
    return DvlColumns(cleaner.times, finite, vectors_d), cleaner.notes


def _beam_velocity(table: Table) -> Floats:
    """Return the velocities along the beams in the log's unit, NaN where a beam is marked as lost."""
    velocity = table.values("beam_velocity")
    if "beam_valid" not in table:
        return velocity
    valid = table.values("beam_valid")
    if valid.shape != velocity.shape:
        raise LogError(
            f"has {velocity.shape[1]} beam velocities and {valid.shape[1]} flags of their validity",
            "dvl.beam_velocity and dvl.beam_valid name as many numbers",
            *table.where,
        )
    return np.where(valid > 0.0, velocity, np.nan)


def _possible(values_mps: Floats, cleaner: Cleaner) -> Floats:
    """Take single readings that no vehicle can have had for lost; where there are many, the unit is wrong."""
    impossible = np.abs(values_mps) > FASTEST_MPS
    count = int(np.count_nonzero(impossible))
    if not count or not is_few(count, impossible.size):
        return values_mps
    text = f"readings are above {FASTEST_MPS:g} m/s, and are taken for lost"
    rows = np.flatnonzero(impossible.any(axis=1))
    cleaner.note("impossible", text, count, Severity.WARNING, _VALID_HINT, first=rows)
    return np.where(impossible, np.nan, values_mps)


def _drop_repeats(cleaner: Cleaner, values: Floats) -> None:
    zero = (values == 0.0).all(axis=1)
    if not zero.all():
        reason = "pings are exactly zero, as instruments without a lock report"
        cleaner.keep(~zero, "zero", reason, Severity.WARNING, _VALID_HINT)
    cleaner.drop_repeated_times(values)
    _note_stuck(cleaner, values)
    cleaner.drop_repeated_values(values)
    cleaner.require_rows()
    note_bursts(cleaner, np.diff(cleaner.times), "dvl.velocity_sd_mps")


def _note_stuck(cleaner: Cleaner, values: Floats) -> None:
    """Note values that stay the same for longer than any recorder repeats them; refuse a DVL that has no others."""
    times, ordered = cleaner.times, values[cleaner.rows]
    starts, ends = find_runs(same_rows(ordered[1:], ordered[:-1]))
    lengths_s = seconds(times[ends], times[starts])
    long = np.flatnonzero((lengths_s > STUCK_S) & (ends - starts >= _STUCK_PINGS))
    if not long.size:
        return
    if ends[long[0]] - starts[long[0]] == times.size - 1:
        raise LogError(
            f"the values of all {times.size} pings are the same for {lengths_s.max():.1f} s",
            "dvl.velocity or dvl.beam_velocity names other fields, dvl.topic another DVL",
            *cleaner.table.where,
        )
    count = int(np.sum(ends[long] - starts[long]))
    text = f"pings stand still to the last digit for over {STUCK_S:g} s, the longest run of {lengths_s.max():.1f} s"
    cleaner.note("stuck", text, count, Severity.WARNING, _VALID_HINT, first=cleaner.rows[starts[long]])
