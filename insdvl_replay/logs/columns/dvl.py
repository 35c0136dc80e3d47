"""The pings of a DVL, as beams or as velocities, and where its beams point.

Beams point from the instrument to the seabed: as the settings say, as the messages say if that can be true, else as
those of most DVLs. The velocity along a beam is that of the vehicle over ground.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Dvl
from insdvl_replay.core.dive_columns import DvlColumns, Floats, Mask, find_runs, seconds
from insdvl_replay.core.errors import ConfigError, LogError, Note, listed
from insdvl_replay.core.states import FASTEST_MPS
from insdvl_replay.core.units import VELOCITY_UNITS
from insdvl_replay.geometry import frames
from insdvl_replay.geometry.rotation import mat_from_quat
from insdvl_replay.logs.columns.beam_directions import (
    AGREES,
    CONTRADICTS,
    BeamVelocities,
    agreeing_directions,
    azimuths_and_tilts_deg,
)
from insdvl_replay.logs.columns.clean import (
    Cleaner,
    note_bursts,
    note_lost_samples,
    same_rows,
    stand_for_none,
)
from insdvl_replay.logs.columns.flags import flag_columns, marks_some
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.logs.columns.tables import Table
from insdvl_replay.logs.columns.topics import UNUSED_FLAGS
from insdvl_replay.logs.formats.fields import split_paths

Rule = tuple[str, Callable[[Floats], Mask], str]
_MOVING_MPS: Final = 0.05
# columns that no message holds as such
_SPEEDS: Final = "velocities along the beams"
_AXES: Final = "axes of the beams"
_BEAM_HINT: Final = "set dvl.beam_tilt_deg and dvl.beam_azimuth_deg from the data sheet"


@dataclass(frozen=True)
class _Directions:
    """Where the beams point."""

    vectors_d: Floats  # (beams, 3)
    look: Floats | None = None  # (3,), on average, where the messages report it


def decode_dvl(table: Table, settings: Dvl) -> tuple[DvlColumns, list[Note]]:
    """Make the columns of the DVL, of its beams where there are any, unless the settings say otherwise.

    Beams that contradict the velocity of the instrument are not used, unless the settings have their directions.
    """
    is_given = settings.kind == "beams" or _has_directions(settings)
    settings = table.source.completed(settings)
    table = _with_beam_speeds(table, settings)
    cleaner = Cleaner(table)
    note_lost_samples(cleaner)
    _note_unused_flags(table, cleaner)
    for rule in _BOTTOM_TRACK:
        cleaner.keep_where(*rule)
    beams = np.full((len(table), 0), np.nan)
    if "beam_velocity" in table:
        beams = _beam_velocity(table, cleaner)
    has_beams = np.asarray(~np.isnan(beams).all(axis=1))
    if "beams_valid" in table:
        has_beams &= table.column("beams_valid") != 0.0
    directions = None
    if _is_by_beams(table, settings, cleaner, beams[has_beams]):
        unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
        beams = _without_impossible(_without_none(beams, unit) * unit, cleaner)
        valid = np.where(has_beams[:, None], beams, np.nan)
        directions = _used_directions(table, settings, cleaner, valid, is_given)
    if directions is None:
        return _decode_velocities(table, settings, cleaner), cleaner.notes
    return _decode_beams(table, cleaner, beams, has_beams, directions), cleaner.notes


def _is_by_beams(
    table: Table,
    settings: Dvl,
    cleaner: Cleaner,
    valid: Floats,
) -> bool:
    """Return whether the beams are used: as the settings say, else where a valid one is ever there."""
    if settings.kind is not None:
        quantity = "beam_velocity" if settings.kind == "beams" else "velocity"
        if quantity not in table:
            text = f"type {table.source.type_name} has no {quantity}, but dvl.kind is '{settings.kind}'"
            raise LogError(text, f'to read it: dvl.{quantity} = "field.path"', *table.where)
        return settings.kind == "beams"
    if "beam_velocity" not in table:
        return False
    if "velocity" in table and not np.nan_to_num(valid).any():
        cleaner.note("no_beams", len(table))
        return False
    return True


def _note_unused_flags(table: Table, cleaner: Cleaner) -> None:
    """Warn of columns that may mark pings as invalid, and that no setting names."""
    if UNUSED_FLAGS not in table:
        return
    names = split_paths(table.source.fields[UNUSED_FLAGS])
    found = flag_columns(names)
    for name, flag in zip(names, table.values(UNUSED_FLAGS).T, strict=True):
        key = "invalid" if name in found.invalid else "valid"
        is_sure = name not in found.unsure
        valid = flag
        if key == "invalid":
            valid = np.where(flag == 0.0, 1.0, 0.0)
        count = marks_some(valid, is_sure=is_sure)
        if not count:
            continue
        values, counts = np.unique(flag[np.isfinite(flag)], return_counts=True)
        often = np.argsort(-counts)[:3]
        shown = listed(f"{values[i]:g} in {counts[i]}" for i in sorted(often.tolist()))
        code = "unused_flag"
        if not is_sure:
            code = "unused_flag unsure"
        if not (flag == 0.0).any():
            code = "unused_flag never_zero"  # no setting compares a flag with anything but 0
        cleaner.note(
            code,
            count,
            key=key,
            name=name,
            values=shown,
            all_count=len(flag),
        )


def _has_directions(settings: Dvl) -> bool:
    return settings.beam_tilt_deg is not None or settings.beam_azimuth_deg is not None


def _decode_velocities(table: Table, settings: Dvl, cleaner: Cleaner) -> DvlColumns:
    velocity_d = _without_impossible(_velocity_d(table, settings), cleaner)
    for rule in _VALID:
        cleaner.keep_where(*rule)
    # Of the instrument.
    cleaner.keep_where("coordinates", lambda kind: kind == 1, "coordinates")
    if "good_beams" in table and table.column("good_beams").any():
        cleaner.keep_where("good_beams", lambda n: n >= 3, "invalid good_beams")
    cleaner.keep_finite(velocity_d)
    _drop_repeats(cleaner, velocity_d)
    directions = _unused_directions(table, settings, cleaner)
    in_space = np.linalg.matrix_rank(directions.vectors_d, 0.01) == 3
    vectors_d = directions.vectors_d if in_space else None
    return DvlColumns(
        cleaner.times,
        None,
        vectors_d,
        cleaner.kept(velocity_d),
        directions.look,
        _altitude_m(table, cleaner, directions.vectors_d),
    )


def _decode_beams(
    table: Table,
    cleaner: Cleaner,
    beams_mps: Floats,
    has_beams: Mask,
    directions: _Directions,
) -> DvlColumns:
    # Along the beams.
    cleaner.keep_where("coordinates", lambda kind: kind == 0, "coordinates")
    if "beam_valid" not in table and "nortek_status" not in table:
        for rule in _VALID:
            cleaner.keep_where(*rule)
    cleaner.keep(has_beams, "invalid no_beam")
    _drop_repeats(cleaner, beams_mps)
    # An infinite velocity along a beam counts as NaN.
    finite = cleaner.kept(np.where(np.isfinite(beams_mps), beams_mps, np.nan))
    return DvlColumns(
        cleaner.times,
        finite,
        directions.vectors_d,
        look_d=directions.look,
        altitude_m=_altitude_m(table, cleaner, directions.vectors_d),
    )


def _altitude_m(table: Table, cleaner: Cleaner, vectors_d: Floats) -> Floats | None:
    """Return how far the bottom is below each ping, shape (k,), NaN where unknown; None where no message tells.

    The instrument's own value counts, else the mean over its beams.
    """
    if "altitude" in table:
        altitude_m = cleaner.kept(table.column("altitude"))
        return np.where(_is_length(altitude_m), altitude_m, np.nan)
    if "beam_ranges" not in table:
        return None
    ranges_m = cleaner.kept(table.values("beam_ranges"))
    if ranges_m.shape[1] != len(vectors_d):
        return None
    known = _is_length(ranges_m)
    below_m = np.where(known, ranges_m * vectors_d[:, 2], 0.0).sum(axis=1)
    beams = known.sum(axis=1)
    return np.where(beams > 0, below_m / np.maximum(beams, 1), np.nan)


def _is_length(values: Floats) -> Mask:
    """Return which numbers are lengths: instruments write zero, or a negative number, for none."""
    return np.asarray((values > 0.0) & (values < np.inf))


def _are_set(status: Floats, bits: tuple[int, ...]) -> Mask:
    """Find which bits are set in Nortek's status, (k, 1); none where it is no whole number of 32 bits."""
    whole = np.where((status >= 0.0) & (status < 2.0**32), status, 0.0).astype(np.int64)
    return np.asarray((whole >> np.array(bits)) & 1 == 1)


# Rules of validity: a quantity that a topic may have, which of its numbers are good, and the code for the others.
_BOTTOM_TRACK: Final[tuple[Rule, ...]] = (
    ("mode", lambda mode: mode != 2, "water_track"),
    ("water_track", lambda flag: flag == 0.0, "water_track"),
    ("status", lambda status: ~(status < 0.0), "lost"),
)
_VALID: Final[tuple[Rule, ...]] = (
    ("valid", lambda flags: flags > 0.0, "invalid"),
    ("invalid", lambda flags: ~(flags != 0.0), "invalid"),
    ("velocity_var", lambda variance: ~(variance < 0.0), "invalid variance"),
    ("nortek_status", lambda status: _are_set(status, (12, 13, 14)), "invalid status"),
)


def _velocity_d(table: Table, settings: Dvl) -> Floats:
    unit = VELOCITY_UNITS[settings.velocity_unit or "m/s"]
    velocity = _without_none(table.values("velocity", 3), unit)
    if "velocity_interval_us" in table:
        interval_us = table.column("velocity_interval_us")
        velocity = velocity / np.where(interval_us > 0.0, interval_us * 1e-6, np.nan)[:, None]
    return in_frd(velocity, settings.axes or FRD, "dvl.axes", unit)


def _without_none(values: Floats, unit: float) -> Floats:
    """Return velocities in the log's unit, NaN where they are the number that stands for none."""
    # The least 16 bits in mm/s, by which instruments of Nortek and Teledyne report no velocity.
    is_none = np.abs(values * unit + 32.768) < 1e-3
    if is_none.any():
        return np.where(is_none, np.nan, values)
    return values


def _beam_velocity(table: Table, cleaner: Cleaner) -> Floats:
    """Return the velocities along the beams in the log's unit, NaN where a beam is lost."""
    velocity = table.values("beam_velocity")
    if "beam_var" in table:
        variance = table.values("beam_var")
        if variance.shape == velocity.shape:
            velocity = np.where(variance < 0.0, np.nan, velocity)
    if "nortek_status" in table and velocity.shape[1] == 4:
        are_valid = _are_set(table.values("nortek_status", 1), (0, 1, 2, 3))
        velocity = np.where(are_valid, velocity, np.nan)
    if "beam_valid" in table:
        valid = table.values("beam_valid")
        if valid.shape != velocity.shape:
            text = f"has {velocity.shape[1]} beam velocities, but {valid.shape[1]} validity flags"
            hint = "dvl.beam_velocity and dvl.beam_valid need the same number of values"
            raise LogError(text, hint, *table.where)
        velocity = np.where(valid > 0.0, velocity, np.nan)
    lost = _are_lost(table, velocity)
    if lost.any():
        pings = np.flatnonzero(lost.any(axis=1))
        cleaner.note(
            "lost_beams",
            int(np.count_nonzero(lost)),
            pings,
        )
        velocity = np.where(lost, np.nan, velocity)
    return velocity


def _are_lost(table: Table, velocity: Floats) -> Mask:
    """Find the beams, shape (k, beams), whose velocity is that of no echo.

    A velocity of 0 is none where the beam has no range, or where fewer beams are good than there are. A negative range
    marks a lost beam if other ranges are positive.
    """
    lost = np.zeros(velocity.shape, np.bool_)
    if "beam_ranges" in table:
        lost |= _are_without_range(table.values("beam_ranges"), velocity)
    if "good_beams" in table:
        good = table.column("good_beams")
        has_fewer = (good > 0.0) & (good < velocity.shape[1])
        lost |= (velocity == 0.0) & has_fewer[:, None]
    return lost


def _are_without_range(ranges: Floats, velocity: Floats) -> Mask:
    """Find the beams that are lost by their ranges, both of shape (k, beams); none where these are of other beams."""
    if ranges.shape != velocity.shape:
        return np.zeros(velocity.shape, np.bool_)
    has_range = ranges > 0.0
    lost = (velocity == 0.0) & ~has_range
    if np.count_nonzero(has_range) > 0.5 * has_range.size:
        lost |= np.isfinite(velocity) & (ranges < 0.0)
    return np.asarray(lost)


def _without_impossible(values_mps: Floats, cleaner: Cleaner) -> Floats:
    """Drop what no vehicle reaches, however often; most pings with different such velocities mean a wrong unit."""
    is_impossible = np.abs(values_mps) > FASTEST_MPS
    code = "impossible pings"
    if stand_for_none(values_mps[is_impossible]):
        code = "impossible marks"
    return cleaner.without_impossible(values_mps, is_impossible, code, fastest_mps=FASTEST_MPS)


def _drop_repeats(cleaner: Cleaner, values: Floats) -> None:
    """Drop pings of zero, repeated times and repeated values; refuse a DVL that has no others."""
    zero = (values == 0.0).all(axis=1)
    if not zero.all():
        cleaner.keep(~zero, "zero dropped")
    cleaner.drop_repeated_times(values)
    # Values that stay the same for longer than any recorder repeats them: five pings and five seconds.
    times = cleaner.times
    ordered = values[cleaner.rows]
    starts, ends = find_runs(same_rows(ordered[1:], ordered[:-1]))
    lengths_s = seconds(times[ends], times[starts])
    long = np.flatnonzero((lengths_s > 5.0) & (ends - starts >= 5))
    if long.size:
        if ends[long[0]] - starts[long[0]] == times.size - 1:
            text = f"the values of all {times.size} pings are the same for {lengths_s.max():.1f} s"
            hint = "to read other fields: dvl.velocity or dvl.beam_velocity; to read another DVL: dvl.topic"
            raise LogError(text, hint, *cleaner.table.where)
        count = int(np.sum(ends[long] - starts[long]))
        first = cleaner.rows[starts[long]]
        cleaner.note(
            "stuck",
            count,
            first,
            longest_s=lengths_s.max(),
        )
    cleaner.drop_repeated_values(values)
    cleaner.require_rows()
    note_bursts(cleaner, np.diff(cleaner.times), "dvl.velocity_sd_mps")


# Where the beams point.


def _with_beam_speeds(table: Table, settings: Dvl) -> Table:
    """Give a table whose messages hold a velocity vector along each beam the axes of the beams, and speeds along them.

    A vector along a beam is its axis times the speed; an axis points down. While a beam has never moved, nothing tells
    where it points, and the table stays as it is.
    """
    if "beam_velocity_vectors" not in table:
        return table
    parts = _limited(table.values("beam_velocity_vectors"))
    if not parts.shape[1] or parts.shape[1] % 3:
        return table
    vectors = parts.reshape(len(table), 3, -1).transpose(0, 2, 1)
    sizes = np.linalg.norm(vectors, axis=2)
    turned = in_frd(vectors.reshape(-1, 3), settings.axes or FRD, "dvl.axes")
    down = turned[:, 2].reshape(sizes.shape)
    axes = np.empty((vectors.shape[1], 3))
    for beam, axis in enumerate(axes):
        moves = (sizes[:, beam] > _MOVING_MPS) & (down[:, beam] != 0.0)
        if not moves.any():
            return table
        pointing = (
            vectors[moves, beam] * (np.sign(down[moves, beam]) / sizes[moves, beam])[:, None]
        )
        axis[:] = np.median(pointing, axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    columns = {
        _SPEEDS: np.einsum("kbi,bi->kb", vectors, axes),
        _AXES: np.broadcast_to(axes.ravel(), (len(table), axes.size)),
    }
    fields = {**table.source.fields, "beam_velocity": _SPEEDS, "beam_vectors": _AXES}
    source = replace(table.source, fields=fields)
    return replace(table, columns={**table.columns, **columns}, source=source)


def _limited(values: Floats) -> Floats:
    """Return velocities or unit vectors, NaN where they are larger than any can be: a damaged log holds any numbers."""
    return np.where(np.abs(values) <= 1000.0, values, np.nan)


def _reported_vectors(table: Table, cleaner: Cleaner) -> Floats:
    """Return the directions that the messages tell in the log's axes, shape (beams, 3)."""
    if "beam_vectors" in table:
        vectors = _numbers_of_beams(table, cleaner, "beam_vectors", 3)
    else:
        vectors = _axes_of(_numbers_of_beams(table, cleaner, "beam_quaternions", 4))
    return np.asarray(np.median(vectors, axis=0))


def _numbers_of_beams(
    table: Table,
    cleaner: Cleaner,
    quantity: str,
    width: int,
) -> Floats:
    """Return so many numbers of each beam, shape (k, beams, width)."""
    numbers = _limited(cleaner.kept(table.values(quantity)))
    if numbers.shape[1] % width:
        field = table.source.fields[quantity]
        text = (
            f"field '{field}' holds {numbers.shape[1]} numbers, which are not {width} for a beam"
        )
        raise LogError(text, _BEAM_HINT, *table.where)
    return numbers.reshape(len(numbers), -1, width)


def _axes_of(quaternions: Floats) -> Floats:
    """Return the x axes of beams by their attitudes, (k, beams, 4), shape (k, beams, 3)."""
    # The UUV Simulator writes the axis of the turn whole, beside w: a quaternion whose vector part has length 1 can
    # only be half a turn, with a w of 0.
    axis = quaternions[..., :3]
    w = quaternions[..., 3:]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    whole = (np.abs(length - 1.0) < 1e-6) & (np.abs(w) <= 1.0)
    sines = np.sqrt(np.clip(1.0 - w * w, 0.0, 1.0))
    vector = np.where(whole, axis * sines, axis)
    return np.asarray(mat_from_quat(np.concatenate([vector, w], axis=-1))[..., 0])


def _usual_directions(settings: Dvl) -> Floats:
    """Return the directions by the settings and the type, else those of most DVLs, shape (beams, 3)."""
    return frames.beam_vectors(
        frames.TILT_DEG if settings.beam_tilt_deg is None else settings.beam_tilt_deg,
        frames.AZIMUTH_DEG if settings.beam_azimuth_deg is None else settings.beam_azimuth_deg,
    )


def _are_reported(table: Table) -> bool:
    return "beam_vectors" in table or "beam_quaternions" in table


def _unused_directions(table: Table, settings: Dvl, cleaner: Cleaner) -> _Directions:
    """Return where beams point that are not used. Poses alone tell where they look."""
    usual_d = _usual_directions(settings)
    if not _are_reported(table):
        return _Directions(usual_d)
    reported = _reported_vectors(table, cleaner)
    if not len(reported) or _vector_fault(reported, table, cleaner):
        return _Directions(usual_d)
    reported = in_frd(reported, settings.axes or FRD, "dvl.axes")
    look = reported.mean(axis=0) if "beam_quaternions" in table else None
    _note_look(cleaner, look)
    return _Directions(usual_d if _has_directions(settings) else reported, look)


def _used_directions(
    table: Table,
    settings: Dvl,
    cleaner: Cleaner,
    beams_mps: Floats,
    is_given: bool,
) -> _Directions | None:
    """Return where the beams that are used point; None if they contradict the velocity of the instrument.

    Directions that are given, or that the type of the messages has, go before those in the messages, and these before
    those of most DVLs. Where they contradict the velocity, others are looked for that agree with it.
    """
    cleaner.require_rows()
    reported, fault = _directions_in_messages(table, settings, cleaner)
    usable = None if fault else reported
    in_use = _usual_directions(settings) if usable is None else usable
    beams = beams_mps.shape[1]
    pings = _compared_pings(table, settings, cleaner, beams_mps)
    if pings is not None and is_given:
        _note_given_contradiction(cleaner, pings, in_use)
    elif pings is not None and not pings.agree(in_use):
        why = fault or _contradiction(pings, in_use)
        other = agreeing_directions(pings, reported, _slant(table, cleaner))
        if other is not None:
            code = "beam_geometry other" if fault else "beam_directions"
            _note_other_directions(cleaner, other, code, why)
            return _Directions(other)
        if len(in_use) != beams or not pings.has_other_axes(in_use):
            _note_unused_beams(cleaner, why)
            return None
        _note_contradiction(cleaner, pings, in_use)
    _require_directions(table, in_use, beams)
    if fault:
        _note_fault(cleaner, fault, in_use, are_compared=pings is not None)
    look = None if usable is None else usable.mean(axis=0)
    _note_look(cleaner, look)
    return _Directions(in_use, look)


def _note_fault(
    cleaner: Cleaner,
    fault: str,
    in_use: Floats,
    *,
    are_compared: bool,
) -> None:
    """Report directions in the messages that cannot be, and those that are used."""
    code = "beam_geometry"
    if are_compared:
        code = "beam_geometry compared"
    cleaner.note(
        code,
        cleaner.rows.size,
        fault=fault,
        directions=_words(in_use),
    )


def _note_given_contradiction(cleaner: Cleaner, pings: BeamVelocities, vectors_d: Floats) -> None:
    """Report given directions that contradict the velocity; they are used all the same."""
    if not pings.agree(vectors_d, CONTRADICTS) and np.isfinite(pings.misfit(vectors_d)):
        _note_contradiction(cleaner, pings, vectors_d)


def _require_directions(table: Table, vectors_d: Floats, beams: int) -> None:
    if len(vectors_d) != beams:
        text = f"has {beams} beams, but the geometry has {len(vectors_d)}"
        hint = "set one angle for each beam in dvl.beam_azimuth_deg"
        raise ConfigError(text, hint, *table.where)


def _directions_in_messages(
    table: Table, settings: Dvl, cleaner: Cleaner
) -> tuple[Floats | None, str]:
    """Return the directions in the messages, (beams, 3), None where there are none, and what is wrong with them."""
    if not _are_reported(table) or _has_directions(settings):
        return None, ""
    raw = _reported_vectors(table, cleaner)
    fault = _vector_fault(raw, table, cleaner)
    lengths = np.linalg.norm(raw, axis=1, keepdims=True)
    if not len(raw) or not np.all(lengths > 0.0):
        return None, fault
    return in_frd(raw / lengths, settings.axes or FRD, "dvl.axes"), fault


def _note_other_directions(
    cleaner: Cleaner,
    vectors_d: Floats,
    code: str,
    why: str,
) -> None:
    """Report directions that are used instead of those in the messages."""
    cleaner.note(
        code,
        cleaner.rows.size,
        why=why,
        directions=_words(vectors_d),
        keys=_keys(vectors_d),
    )


def _note_unused_beams(cleaner: Cleaner, why: str) -> None:
    """Report beams that no directions bring to the velocity of the instrument."""
    cleaner.note(
        "beams_unused",
        cleaner.rows.size,
        why=why,
    )


def _words(vectors_d: Floats) -> str:
    """Write directions as words."""
    azimuths_deg, tilts_deg = azimuths_and_tilts_deg(vectors_d)
    azimuths = ", ".join(f"{azimuth:.3g}" for azimuth in azimuths_deg)
    return f"a tilt of {float(np.median(tilts_deg)):.3g} deg and azimuths of {azimuths} deg"


def _keys(vectors_d: Floats) -> str:
    """Write directions as settings."""
    azimuths_deg, tilts_deg = azimuths_and_tilts_deg(vectors_d)
    azimuths = ", ".join(f"{azimuth:.4g}" for azimuth in azimuths_deg)
    return f"dvl.beam_tilt_deg = {float(np.median(tilts_deg)):.4g}, dvl.beam_azimuth_deg = [{azimuths}]"


def _note_look(cleaner: Cleaner, look: Floats | None) -> None:
    if look is None or frames.look_down(look):
        return
    cleaner.note(
        "beams_not_down",
        cleaner.rows.size,
        along=look,
    )


def _compared_pings(
    table: Table,
    settings: Dvl,
    cleaner: Cleaner,
    beams_mps: Floats,
) -> BeamVelocities | None:
    """Return the pings whose beams can be compared with the instrument's own velocity; None without any."""
    if "velocity" not in table or "coordinates" in table:
        return None
    velocity_d = cleaner.kept(_velocity_d(table, settings))
    pings = BeamVelocities.of_pings(cleaner.kept(beams_mps), velocity_d)
    if len(pings):
        return pings
    return None


def _contradiction(pings: BeamVelocities, vectors_d: Floats) -> str:
    """State how far beams are from the velocity."""
    beams = pings.along_mps.shape[1]
    if len(vectors_d) != beams:
        return f"there are {beams} of them, but the geometry has {len(vectors_d)}"
    if not np.isfinite(pings.misfit(vectors_d)):
        return "they are in one plane"
    if pings.misfit(vectors_d) <= AGREES:
        return "with their directions the velocity has the opposite sign along an axis"
    return f"with their directions they differ by {pings.misfit(vectors_d):.0%} from it"


def _note_contradiction(cleaner: Cleaner, pings: BeamVelocities, vectors_d: Floats) -> None:
    """Note beams that are used although they do not add up to the velocity that the instrument makes of them."""
    cleaner.note(
        "beam_contradiction",
        len(pings),
        why=_contradiction(pings, vectors_d),
    )


def _slant(table: Table, cleaner: Cleaner) -> float | None:
    """Return altitude over range in the median of pings and beams, the cosine of the tilt; None where it is unknown."""
    if "altitude" not in table or "beam_ranges" not in table:
        return None
    altitude = cleaner.kept(table.column("altitude"))
    ranges = cleaner.kept(table.values("beam_ranges"))
    measured = (np.isfinite(ranges) & (ranges > 0.0)).all(axis=1)
    measured &= np.isfinite(altitude) & (altitude > 0.0)
    if not measured.any():
        return None
    return float(np.median(altitude[measured, None] / ranges[measured]))


def _vector_fault(vectors: Floats, table: Table, cleaner: Cleaner) -> str:
    """Return what is wrong with beam vectors: their length, or their z component (it is altitude over range)."""
    if not len(vectors):
        return "there are none"
    lengths = np.linalg.norm(vectors, axis=1)
    if not np.all(np.abs(lengths - 1.0) < 0.01):
        return f"their lengths are {', '.join(f'{length:.3f}' for length in lengths)}"
    if len(vectors) > 2 and np.linalg.matrix_rank(vectors, 0.01) < 3:
        return "they are in one plane"
    slant = _slant(table, cleaner)
    along_z = float(np.median(vectors[:, 2]))
    if slant is not None and abs(slant - along_z) >= 0.1:
        return f"their z component is {along_z:.3f}, but altitude over range is {slant:.3f}"
    return ""
