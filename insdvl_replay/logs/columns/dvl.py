"""The pings of a DVL, as beams or as velocities.

Beams point from the instrument to the seabed, `beam_directions` knows where; the velocity along one is that of the
vehicle over ground.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.config import Dvl
from insdvl_replay.core.dive_columns import DvlColumns, Floats, find_runs, seconds
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import FASTEST_MPS, VELOCITY_UNITS
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.beam_directions import (
    beam_vectors,
    beams_of_velocities,
    note_contradiction,
    with_beam_speeds,
)
from insdvl_replay.logs.columns.cleaning import Cleaner, is_few, note_bursts, note_lost_samples, same_rows
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.logs.columns.order import Mask
from insdvl_replay.logs.columns.tables import Table

STUCK_S: Final = 5.0
"""A DVL on a vehicle in water repeats no ping to the last digit for so long."""

_WATER_TRACK: Final = 2
_BEAM_COORDINATES: Final = 0
_INSTRUMENT_COORDINATES: Final = 1
_BEAMS_FOR_VELOCITY: Final = 3
_STUCK_PINGS: Final = 5
_NO_VELOCITY_MPS: Final = -32.768
"""The least number of 16 bits in mm/s, with which instruments of Nortek and Teledyne say that they have no velocity."""
_SAME_MPS: Final = 1e-3
_NORTEK_BEAM_BITS: Final = (0, 1, 2, 3)
_NORTEK_XYZ_BITS: Final = (12, 13, 14)
_VALID_HINT: Final = 'dvl.valid = "field.path", or dvl.beam_valid, names what marks good pings'


def decode_dvl(table: Table, settings: Dvl) -> tuple[DvlColumns, list[Note]]:
    """Make the columns of the DVL."""
    settings = table.source.completed(settings)
    table = with_beam_speeds(table, settings)
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
        found = ~(table.column("status") < 0.0)
        cleaner.keep(found, "lost", "pings say by their status or altitude that the bottom was lost")


def _keep_valid(table: Table, cleaner: Cleaner) -> None:
    if "valid" in table:
        cleaner.keep(np.all(table.values("valid") > 0.0, axis=1), "invalid", "pings are marked as invalid")
    if "velocity_var" in table:
        cleaner.keep(
            ~(table.column("velocity_var") < 0.0), "invalid", "pings have a negative variance, as invalid ones"
        )
    if "nortek_status" in table:
        valid = np.asarray(_are_set(table, _NORTEK_XYZ_BITS).all(axis=1))
        cleaner.keep(valid, "invalid", "pings are invalid by the bits of their status")


def _are_set(table: Table, bits: tuple[int, ...]) -> Mask:
    """Find which bits are set in Nortek's status, shape (k, bits)."""
    return np.asarray((_whole(table.column("nortek_status"))[:, None] >> np.array(bits)) & 1 == 1)


def _whole(numbers: Floats) -> NDArray[np.int64]:
    """Return the whole numbers of 32 bits that a field holds, 0 where it holds something else."""
    return np.where((numbers >= 0.0) & (numbers < 2.0**32), numbers, 0.0).astype(np.int64)


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
    if bool((_has_beams(table) & np.any(np.nan_to_num(_beam_velocity(table)) != 0.0, axis=1)).any()):
        return True
    cleaner.note("no_beams", "pings, all there are, have no valid beam with a velocity; theirs are used", len(table))
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
    vectors_d, look_d = beams_of_velocities(table, settings, cleaner)
    return DvlColumns(cleaner.times, None, vectors_d, cleaner.kept(velocity_d), look_d), cleaner.notes


def _velocity_d(table: Table, settings: Dvl) -> Floats:
    unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    velocity = _told(table.values("velocity", 3), unit)
    if "velocity_interval_us" in table:
        interval_us = table.column("velocity_interval_us")
        velocity = velocity / np.where(interval_us > 0.0, interval_us * 1e-6, np.nan)[:, None]
    return in_frd(velocity, settings.axes or FRD, "dvl.axes", unit)


def _told(values: Floats, unit: float) -> Floats:
    """Return velocities in the log's unit, NaN where they are the number that stands for none."""
    is_none = np.abs(values * unit - _NO_VELOCITY_MPS) < _SAME_MPS
    return np.where(is_none, np.nan, values) if is_none.any() else values


def _beams(table: Table, settings: Dvl, cleaner: Cleaner) -> tuple[DvlColumns, list[Note]]:
    unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    beam_velocity_mps = _possible(_told(_beam_velocity(table), unit) * unit, cleaner)
    _keep_coordinates(table, cleaner, _BEAM_COORDINATES)
    if "beam_valid" not in table and "nortek_status" not in table:
        _keep_valid(table, cleaner)
    cleaner.keep(_has_beams(table), "invalid", "pings have no valid beam")
    _drop_repeats(cleaner, beam_velocity_mps)
    vectors_d, look_d = beam_vectors(table, settings, cleaner)
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
    return DvlColumns(cleaner.times, finite, vectors_d, look_d=look_d), cleaner.notes


def _beam_velocity(table: Table) -> Floats:
    """Return the velocities along the beams in the log's unit, NaN where a beam is marked as lost."""
    velocity = table.values("beam_velocity")
    if "beam_var" in table and (variance := table.values("beam_var")).shape == velocity.shape:
        velocity = np.where(variance < 0.0, np.nan, velocity)
    if "nortek_status" in table and velocity.shape[1] == len(_NORTEK_BEAM_BITS):
        velocity = np.where(_are_set(table, _NORTEK_BEAM_BITS), velocity, np.nan)
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
