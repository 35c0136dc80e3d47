"""Sentences $DVPDL and $DVPDX of Cerulean's Tracker 650 and DVL-75, and $DVEXT of the DVL-75.

The first two tell how far the vehicle came since the last one. The third has the velocity in axes of the earth and the
attitude of the vehicle, but no clock; it is read where a file has none of the others.

Sources: Cerulean Sonar, "$DVPDL and $DVPDX: DVL Position and Angle Deltas Messages", in the documentation of the
Tracker 650, https://docs.ceruleansonar.com/c/tracker-650/, whose positions are in the axes of ArduSub,
forward-starboard-down; "$DVEXT: DVL Extended Data" and "Appendix - Coordinate Systems" in that of the DVL-75,
https://docs.ceruleansonar.com/c/dvl-75/: z is up, and all rotations but the heading are right-handed, so that the bow
is down where the pitch is positive. The quaternions of two recorded sentences agree with that to 0.1 deg. Velocities
along the beams are not read, since their directions and signs were not found.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Floats
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.earth_axes import turned_back, turned_back_note
from insdvl_replay.logs.formats.instrument_file import InstrumentTable
from insdvl_replay.logs.formats.sentences import (
    Decoded,
    Sentence,
    SentenceFile,
    numbers,
)

# Cells behind the name: us since the start of the instrument, us, rad, m, and a confidence of 0 to 100. A $DVPDX has
# some more behind them.
_LAYOUT: Final = ("time_us", "time_delta_us", "roll", "pitch", "yaw", "x", "y", "z", "confidence")
_EXTENDED: Final = "DVEXT"
_NAMES: Final = ("DVPDL", "DVPDX", _EXTENDED)
# Cells of a $DVEXT, from 0: T if it has lock on the bottom, F if not. Velocities are of no use without it.
_LOCK: Final = 0
_LOCKED: Final = {b"T": 1.0, b"F": 0.0}
_EXTENDED_CELLS: Final = {
    "roll": 3,  # deg, of the vehicle
    "pitch": 4,
    "heading": 5,
    "up": 7,  # m/s
    "altitude": 8,  # m, along the axis of the sensor
    "north": 9,  # m/s
    "east": 10,
    "elapsed": 13,  # s since the last step, which has a sentence, too
}
_LONGEST_US: Final = (
    10_000_000.0  # between two sentences; over a longer pause there is no velocity
)


class CeruleanSentences(SentenceFile):
    """A file of sentences of a DVL."""

    nothing_hint = "let the DVL send $DVPDL (its command SEND-DVPDL ON)"

    def decode(self, sentence: Sentence) -> Decoded | None:
        """Return the numbers of a sentence with a displacement or a velocity."""
        if sentence.name not in _NAMES:
            self.pass_over(sentence.name[:10])
            return None
        if sentence.name == _EXTENDED:
            return Decoded(_EXTENDED, _extended_numbers(sentence.cells))
        return Decoded(sentence.name, numbers(sentence.cells, len(_LAYOUT)))

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the displacements; of a file with several sentences, the shortest ones, which have a clock."""
        rows = self.rows()
        kinds = [name for name in _NAMES if name in rows]
        for kind in kinds[1:]:
            self.pass_over(kind, len(rows[kind]))
        if kinds == [_EXTENDED]:
            yield from self._extended(rows[_EXTENDED])
            return
        for kind in kinds[:1]:
            yield self._displacements(rows[kind])

    def _displacements(self, found: Floats) -> InstrumentTable:
        """Return the table of $DVPDL or $DVPDX."""
        known = self.with_times(found[:, 0], found[:, 1] * 1e-6)
        found = found[known]
        single = {name: found[:, place] for place, name in enumerate(_LAYOUT, 1)}
        interval_us = single["time_delta_us"]
        is_interval = (interval_us > 0.0) & (interval_us < _LONGEST_US)
        columns: dict[str, Array] = {
            "position_delta": found[:, 6:9],
            "angle_delta": found[:, 3:6],
            "time_delta_us": np.where(is_interval, interval_us, np.nan),
            "confidence": single["confidence"],
        }
        return InstrumentTable(
            topic="dvl/position_delta",
            type_name="cerulean.position_delta",
            time_ns=single["time_us"].astype(np.int64) * 1000,
            columns=columns,
        )

    def _extended(self, found: Floats) -> Iterator[InstrumentTable]:
        """Give the tables of $DVEXT: velocities, and the attitude by which they are turned back."""
        elapsed_ms = 1e3 * found[:, 2 + list(_EXTENDED_CELLS).index("elapsed")]
        time_us = self.summed_us(elapsed_ms)
        known = self.with_times(found[:, 0], time_us * 1e-6)
        found = found[known]
        time_ns = np.rint(time_us[known] * 1e3).astype(np.int64)
        single = {name: found[:, place] for place, name in enumerate(_EXTENDED_CELLS, 2)}
        velocity_n = np.column_stack([single["north"], single["east"], -single["up"]])
        rpy_deg = np.column_stack([single["roll"], -single["pitch"], single["heading"]])
        is_locked = found[:, 1] == 1.0
        velocity = np.where(is_locked[:, None], turned_back(velocity_n, rpy_deg), np.nan)
        count = int(np.count_nonzero(is_locked))
        if count:
            self.add_note(turned_back_note(self, count, in_earth=True))
            self.add_note(note("dvl_vertical_unsure", count, file=self.path.name))
        columns: dict[str, Array] = {"velocity": velocity, "altitude": single["altitude"]}
        yield InstrumentTable(
            topic="dvl/velocity",
            type_name="cerulean.extended",
            time_ns=time_ns,
            columns=columns,
        )
        roll, pitch, heading = rpy_deg.T
        yield InstrumentTable(
            topic="dvl/attitude",
            type_name="cerulean.attitude",
            time_ns=time_ns,
            columns={"roll": roll, "pitch": pitch, "heading": heading},
        )


def _extended_numbers(cells: list[bytes]) -> list[float]:
    """Return whether a $DVEXT has lock, and its numbers; a ValueError or an IndexError where they cannot be."""
    lock = _LOCKED.get(cells[_LOCK])
    if lock is None:
        raise ValueError("no lock is told")
    wanted = [cells[place] for place in _EXTENDED_CELLS.values()]
    return [lock, *numbers(wanted, len(wanted))]
