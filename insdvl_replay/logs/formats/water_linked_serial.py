"""Sentences of Water Linked's DVLs A50 and A125 over their serial port.

Source: Water Linked, "DVL A50/A125 serial protocol", up to version 2.6, https://docs.waterlinked.com/dvl/dvl-protocol/.
"""

import re
from collections.abc import Iterator, Sequence
from typing import ClassVar, Final

import numpy as np

from insdvl_replay.core.dive_columns import (
    Array,
    Floats,
)
from insdvl_replay.geometry.frames import beam_vectors
from insdvl_replay.logs.formats.instrument_file import InstrumentTable
from insdvl_replay.logs.formats.sentences import (
    Bytes,
    Decoded,
    Sentence,
    SentenceFile,
    numbers,
)

# Cells behind the name. Velocities are m/s forward, starboard, down; a covariance is nine numbers between semicolons;
# times of validity are us since 1970, `time` is ms since the last report, `time_stamp` is s.
_LAYOUTS: Final = {
    "wrz": (
        "vx", "vy", "vz", "valid", "altitude", "fom", "covariance", "time_of_validity", "time_of_transmission",
        "time", "status",
    ),
    "wru": ("id", "velocity", "distance", "rssi", "nsd"),
    "wrp": ("time_stamp", "x", "y", "z", "std", "roll", "pitch", "yaw", "status"),
    # Of early versions, which later ones may write beside wrz.
    "wrx": ("time", "vx", "vy", "vz", "fom", "altitude", "valid", "status"),
}  # fmt: skip
_FLAGS: Final = {b"y": b"1", b"n": b"0"}
_OF_A_PING: Final = ("altitude", "fom", "status")
_BEAMS: Final = 4
_TILT_DEG: Final = 22.5
_AZIMUTH_DEG: Final = (135.0, 225.0, 315.0, 45.0)
_WORST: Final = 1e9  # m/s between beams that are not there and the velocity
_POLYNOMIAL: Final = 0x07  # of the checksum, CRC-8


def _crc_table() -> Bytes:
    """Return the checksum of each single byte."""
    table = np.arange(256)
    for _ in range(8):
        shifted = table << 1
        table[:] = np.where(table & 0x80, shifted ^ _POLYNOMIAL, shifted) & 0xFF
    return table.astype(np.uint8)


_CRC: Final = _crc_table()


class WaterLinkedSerial(SentenceFile):
    """A file of sentences of a DVL; those of transducers are joined to the velocities beside them."""

    form: ClassVar[re.Pattern[bytes]] = re.compile(
        # Behind a beginning there is no other one, or long lines would be searched again and again.
        rb"(w[rc][a-z?!](?:[^*w]|w(?![rc][a-z?!])){0,1000}+)\*([0-9a-fA-F]{2})"
    )

    @staticmethod
    def checksums(lines: Bytes) -> Bytes:
        """Return the checksums of lines, (k,)."""
        checksums = np.zeros(len(lines), np.uint8)
        for column in lines.T:
            checksums = _CRC[checksums ^ column]
        return checksums

    def decode(self, sentence: Sentence) -> Decoded | None:
        """Return the numbers of a sentence."""
        layout = _LAYOUTS.get(sentence.name)
        if layout is None:
            self.pass_over(sentence.name[:8])
            return None
        cells = [_FLAGS.get(cell, cell) for cell in sentence.cells]
        if sentence.name == "wrz":
            place = layout.index("covariance")
            covariance = numbers(cells[place].split(b";"), 9)
            del cells[place]
            found = numbers(cells, len(layout) - 1)
            return Decoded("wrz", [*found, *covariance])
        found = numbers(cells, len(layout))
        if sentence.name == "wru" and found[0] not in range(_BEAMS):
            raise ValueError(f"a transducer is numbered {found[0]:g}")
        return Decoded(sentence.name, found)

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the velocities and the positions."""
        rows = self.rows()
        if "wrz" in rows:
            if "wrx" in rows:
                self.pass_over("wrx", len(rows["wrx"]))
            yield self._velocities(rows["wrz"], rows.get("wru"))
        elif "wrx" in rows:
            yield self._early_velocities(rows["wrx"])
        if "wrp" in rows:
            of_positions = rows["wrp"]
            columns = _columns(of_positions, _LAYOUTS["wrp"])
            time_us = columns.pop("time_stamp") * 1e6
            yield self._timed("position_local", of_positions, time_us, columns)

    def _timed(
        self,
        name: str,
        rows: Floats,
        time_us: Floats,
        columns: dict[str, Array],
    ) -> InstrumentTable:
        """Make a table of the rows that have a time."""
        known = self.with_times(rows[:, 0], time_us * 1e-6)
        kept: dict[str, Array] = {}
        for column, values in columns.items():
            kept[column] = values[known]
        return InstrumentTable(
            topic=f"dvl/{name}",
            type_name=f"waterlinked.{name}",
            time_ns=np.rint(time_us[known]).astype(np.int64) * 1000,
            columns=kept,
        )

    def _velocities(self, rows: Floats, of_transducers: Floats | None) -> InstrumentTable:
        """Make the table of velocities with their beams."""
        names = [name for name in _LAYOUTS["wrz"] if name != "covariance"]
        single = _columns(rows, names)
        velocity = rows[:, 1:4]
        columns: dict[str, Array] = {
            "velocity": velocity,
            "velocity_valid": single["valid"],
            "covariance": rows[:, 1 + len(names) :],
        }
        for name in _OF_A_PING:
            columns[name] = single[name]
        if of_transducers is not None:
            columns |= _beams_of(rows[:, 0], velocity, of_transducers)
        return self._timed("velocity", rows, single["time_of_validity"], columns)

    def _early_velocities(self, rows: Floats) -> InstrumentTable:
        """Make the table of velocities of early sentences, which have no clock."""
        single = _columns(rows, _LAYOUTS["wrx"])
        time_us = self.summed_us(single["time"])
        columns: dict[str, Array] = {
            "velocity": rows[:, 2:5],
            "velocity_valid": single["valid"],
        }
        for name in _OF_A_PING:
            columns[name] = single[name]
        return self._timed("velocity", rows, time_us, columns)


def _columns(rows: Floats, names: Sequence[str]) -> dict[str, Array]:
    """Return the columns of rows by the names of their cells; the first one is their place in the file."""
    columns: dict[str, Array] = {}
    for place, name in enumerate(names, 1):
        columns[name] = rows[:, place]
    return columns


def _beams_of(offsets: Floats, velocity: Floats, of_transducers: Floats) -> dict[str, Array]:
    """Return the columns of the beams of each velocity: of the sentences behind it, or of those in front.

    A file may begin between them: which belong together shows in how well velocities and beams agree.
    """
    behind = np.searchsorted(offsets, of_transducers[:, 0])
    vectors_d = beam_vectors(_TILT_DEG, _AZIMUTH_DEG)
    found: dict[str, Array] = {}
    least = np.inf
    for shift in (-1, 0):
        columns = _placed(behind + shift, of_transducers, len(offsets))
        apart = np.abs(columns["transducers.velocity"] - velocity @ vectors_d.T)
        known = apart[np.isfinite(apart)]
        misfit = float(np.median(known)) if known.size else _WORST
        if misfit < least:
            least = misfit
            found = columns
    return found


def _placed(pings: Array, of_transducers: Floats, count: int) -> dict[str, Array]:
    """Place sentences of transducers by their pings; of a ping with two of a transducer neither is used."""
    names = _LAYOUTS["wru"]
    beams = of_transducers[:, 1].astype(np.int64)
    inside = (pings >= 0) & (pings < count)
    seen = np.zeros((count, _BEAMS), np.int64)
    np.add.at(seen, (pings[inside], beams[inside]), 1)
    columns: dict[str, Array] = {}
    for place, name in enumerate(names[1:], 2):
        values = np.full((count, _BEAMS), np.nan)
        values[pings[inside], beams[inside]] = of_transducers[inside, place]
        columns[f"transducers.{name}"] = np.where(seen == 1, values, np.nan)
    columns["transducers.beam_valid"] = (columns["transducers.distance"] >= 0.0).astype(np.float64)
    return columns
