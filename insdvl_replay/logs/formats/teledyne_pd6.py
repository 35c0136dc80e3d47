"""PD6, lines of text of Teledyne's DVLs: Workhorse Navigator, Explorer, Pathfinder, Pinnacle.

Source: Teledyne RD Instruments, "Pathfinder DVL Guide", 95B-6116-00, April 2018, table 50: attitude (:SA), time and
depth (:TS), velocities over the bottom by the instrument (:BI), the ship (:BS) and the earth (:BE), with A or V for a
good or a bad one, distances (:BD), and the same over the water (:WI, :WS, :WE, :WD). They are those of the vessel.

An ensemble is one line of each kind. Its lines have no checksum.
"""

import re
from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Floats, Mask
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG
from insdvl_replay.logs.formats.earth_axes import turned_back, turned_back_note
from insdvl_replay.logs.formats.instrument_file import InstrumentFile, InstrumentTable, Record
from insdvl_replay.logs.formats.teledyne import (
    BOTTOM_TRACK,
    MISSING,
    VELOCITY,
    attitude_deg,
    clock_ns,
    metres_per_second,
    sensor_tables,
    with_z_down,
)

_NUMBER: Final = rb"\s*([+-]?\d{1,9}(?:\.\d{0,9})?)\s*"
_STATUS: Final = rb"\s*([AV])\s*"
# What is read of each kind of line: its form, and the columns of its numbers; a status has none.
_LINES: Final[dict[bytes, tuple[re.Pattern[bytes], tuple[str, ...]]]] = {
    b"SA": (re.compile(b",".join([_NUMBER] * 3)), ("pitch", "roll", "heading")),
    b"TS": (
        re.compile(rb"\s*(\d{14})\s*," + b",".join([_NUMBER] * 4) + rb",.*"),
        ("clock", "salinity", "temperature", "depth", "sound"),
    ),
    b"BI": (
        re.compile(b",".join([*[_NUMBER] * 4, _STATUS])),
        ("BI.x", "BI.y", "BI.z", "BI.error", "BI.status"),
    ),
    b"BS": (re.compile(b",".join([*[_NUMBER] * 3, _STATUS])), ("BS.x", "BS.y", "BS.z", "BS.status")),
    b"BE": (re.compile(b",".join([*[_NUMBER] * 3, _STATUS])), ("BE.x", "BE.y", "BE.z", "BE.status")),
}  # fmt: skip
_COLUMNS: Final = ("offset", *(name for _, names in _LINES.values() for name in names))
_PLACES: Final = {name: place for place, name in enumerate(_COLUMNS)}
_LINE: Final = re.compile(rb".*?:([A-Z]{2}),(.*)", re.DOTALL)
_FIRST: Final = (b"SA", b"TS")  # an ensemble begins with one of these
_MOVING_MPS: Final = 0.1
_TURNED_DEG: Final = 2.0  # more is no tilt of the vehicle


class Pd6File(InstrumentFile):
    """A file of lines."""

    records = "lines"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the lines."""
        self._row: dict[str, float] = {}
        parts = [np.empty((0, len(_COLUMNS)))]
        for records in self.text_records():
            rows: list[list[float]] = []
            for record in records:
                self._decode(record, rows)
            if rows:
                parts.append(np.array(rows))
        last: list[list[float]] = []
        self._end_ensemble(last)
        parts += [np.array([row]) for row in last]
        rows_of_all = np.concatenate(parts)
        ensembles = {name: rows_of_all[:, place] for name, place in _PLACES.items()}
        time_ns, known = clock_ns(_clock_fields(ensembles["clock"]))
        for offset in ensembles["offset"][~known].tolist():
            self.lose(int(offset), "its date and time are none")
        ensembles = {name: values[known] for name, values in ensembles.items()}
        time_ns = time_ns[known]
        rpy_deg = attitude_deg(ensembles["pitch"], ensembles["roll"], ensembles["heading"])
        columns: dict[str, Array] = {"velocity": self._velocity_d(ensembles, rpy_deg)}
        yield InstrumentTable(
            VELOCITY,
            BOTTOM_TRACK,
            time_ns,
            columns,
        )
        yield from sensor_tables(time_ns, rpy_deg, "depth", ensembles["depth"])

    def _decode(
        self,
        record: Record,
        rows: list[list[float]],
    ) -> None:
        """Add a line to its ensemble; the line before it may have ended one."""
        line = _LINE.fullmatch(record.content)
        if line is None:
            if record.content.strip():
                self.pass_over("lines of other text")
            return
        kind = line[1]
        if kind not in _LINES:
            self.pass_over(f"lines :{kind.decode()}")
            return
        form, names = _LINES[kind]
        found = form.fullmatch(line[2])
        if found is None:
            self.lose(record.offset, f"a line :{kind.decode()} is cut, or holds other signs")
            return
        is_next = kind == b"SA" or (kind in _FIRST and "pitch" not in self._row)
        if is_next or names[0] in self._row:
            self._end_ensemble(rows)
        self._row.setdefault("offset", float(record.offset))
        for name, text in zip(names, found.groups(), strict=True):
            number = float(text == b"A") if name.endswith(".status") else float(text)
            self._row[name] = number

    def _end_ensemble(self, rows: list[list[float]]) -> None:
        """Make a row of the lines of an ensemble."""
        row = self._row
        self._row = {}
        if not row:
            return
        if "clock" not in row:
            self.lose(int(row["offset"]), "an ensemble has no line :TS with its time")
            return
        rows.append([row.get(name, np.nan) for name in _COLUMNS])

    def _velocity_d(
        self,
        ensembles: dict[str, Floats],
        rpy_deg: Floats,
    ) -> Floats:
        """Return velocities of the vehicle, (k, 3): by the instrument, else by the ship, else by the earth."""
        by_instrument = _velocity(ensembles, "BI")
        by_ship = _velocity(ensembles, "BS")
        by_earth = _velocity(ensembles, "BE")
        self._note_turned(by_instrument, by_ship)
        velocity = by_instrument.copy()
        lacks_instrument = ~_has_line(ensembles, "BI")
        from_ship = lacks_instrument & _has_line(ensembles, "BS")
        velocity[from_ship] = by_ship[from_ship]
        count = int(np.count_nonzero(from_ship))
        if count:
            self.add_note(
                note(
                    "dvl_levelled",
                    count,
                    file=self.path.name,
                )
            )
        from_earth = lacks_instrument & ~from_ship & _has_line(ensembles, "BE")
        velocity[from_earth] = turned_back(by_earth, rpy_deg)[from_earth]
        count = int(np.count_nonzero(from_earth))
        if count:
            self.add_note(turned_back_note(self, count, in_earth=True))
        return velocity

    def _note_turned(
        self,
        by_instrument: Floats,
        by_ship: Floats,
    ) -> None:
        """Report by how much the axes of the ship are turned from those of the instrument, which are used."""
        speed_mps = np.hypot(by_instrument[:, 0], by_instrument[:, 1])
        moving = (speed_mps > _MOVING_MPS) & np.isfinite(by_ship).all(axis=1)
        if not moving.any():
            return
        ours = by_instrument[moving, 0] + 1j * by_instrument[moving, 1]
        theirs = by_ship[moving, 0] + 1j * by_ship[moving, 1]
        angle_deg = float(np.angle(np.sum(theirs * np.conj(ours)))) / DEG
        if abs(angle_deg) > _TURNED_DEG:
            count = int(np.count_nonzero(moving))
            said = note("dvl_ship_axes", count, file=self.path.name, angle_deg=round(angle_deg))
            self.add_note(said)


def _has_line(
    ensembles: dict[str, Floats],
    kind: str,
) -> Mask:
    return np.isfinite(ensembles[f"{kind}.status"])


def _velocity(
    ensembles: dict[str, Floats],
    kind: str,
) -> Floats:
    """Return velocities of one kind of line with z down, m/s, (k, 3), NaN where they are bad."""
    numbers = np.column_stack([ensembles[f"{kind}.{axis}"] for axis in "xyz"])
    numbers[ensembles[f"{kind}.status"] != 1.0] = MISSING
    return with_z_down(metres_per_second(numbers))


def _clock_fields(clock: Floats) -> Array:
    """Return year, month, day, hour, minute, second, hundredth, (k, 7), of numbers of 14 digits."""
    left = clock.astype(np.int64)
    fields = np.empty((len(clock), 7), np.int64)
    for place in range(6, -1, -1):
        fields[:, place] = left % 100
        left //= 100
    fields[:, 0] += np.where(fields[:, 0] < 80, 2000, 1900)
    return fields
