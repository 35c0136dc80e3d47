"""The table `nucleus_log.csv` that Nortek's driver writes of a Nucleus: a row for each packet, whatever its kind.

The cells that belong to packets of other kinds are empty. Source: the titles in the logger of Nortek's nucleus_driver,
https://pypi.org/project/nucleus-driver/ (version 2), and the kinds of packets in its parser.
"""

from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import Any, Final

import numpy as np
import pandas as pd

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Array,
    Floats,
)
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.instrument_file import (
    InstrumentFile,
    InstrumentTable,
    Record,
)

_XYZ: Final = ("x", "y", "z")
_BEAMS: Final = ("1", "2", "3")
_TIMES: Final = ("timeStamp", "microSeconds")  # s since 1970 or the start, and us behind it
_WATER_TRACK: Final = 190.0  # number of the kind of packet
# Of each table its columns, by their names here: the titles of their numbers. A packet belongs to a table if it has the
# first number of the first column. Units are m/s^2, rad/s, m/s, m and degrees.
_TABLES: Final[dict[str, dict[str, tuple[str, ...]]]] = {
    "imu": {
        "gyro": tuple(f"gyro.{axis}" for axis in _XYZ),
        "accelerometer": tuple(f"accelerometer.{axis}" for axis in _XYZ),
        "is_valid": ("status.isValid",),
    },
    "bottom_track": {
        "velocity": tuple(f"velocity{axis.upper()}" for axis in _XYZ),
        "velocity_valid": tuple(f"status.{axis}VelocityValid" for axis in _XYZ),
        "beam_velocity": tuple(f"velocityBeam{beam}" for beam in _BEAMS),
        "beam_valid": tuple(f"status.beam{beam}VelocityValid" for beam in _BEAMS),
        "beam_distance": tuple(f"distanceBeam{beam}" for beam in _BEAMS),
        "id": ("id",),
    },
    "ins": {
        "latitude": ("latitude",),
        "longitude": ("longitude",),
        "velocity_ned": tuple(f"velocityNed{axis.upper()}" for axis in _XYZ),
        "attitude": ("ahrsData.roll", "ahrsData.pitch", "ahrsData.heading"),
        "is_valid": ("statusIns.latLonIsValid",),
    },
}
_FLAGS: Final = {"True": "1", "False": "0"}


class NucleusTable(InstrumentFile):
    """A table of packets; those of the IMU, of bottom track and of the instrument's own solution are read."""

    records = "rows"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the packets of each kind."""
        places: dict[str, int] = {}
        parts: list[Floats] = []
        in_text = False
        for records in self.text_records():
            rows = records
            if not places:
                places = self._places(records[0])
                rows = records[1:]
            whole: list[Record] = []
            for row in rows:
                is_row = row.content.count(b",") == places["width"] - 1
                quotes = row.content.count(b'"')
                if quotes or (in_text and not is_row):
                    self.pass_over("texts")  # the answers to commands, which have several lines
                elif is_row:
                    whole.append(row)
                else:
                    self.lose(row.offset, "a row has more or fewer cells than the titles")
                in_text = in_text != bool(quotes % 2)
            if whole:
                parts.append(self._numbers(whole, places))
        if parts:
            titles = [title for title in places if title != "width"]
            yield from self._tables(np.concatenate(parts), titles)

    def _places(self, head: Record) -> dict[str, int]:
        """Return the places of the titles that are read, and under `width` how many there are."""
        titles = [
            title.strip(b' "').decode("utf-8", "replace") for title in head.content.split(b",")
        ]
        places = {"width": len(titles)}
        for title in (*_TIMES, *_titles()):
            if title in titles:
                places[title] = titles.index(title)
        missing = [title for title in _TIMES if title not in places]
        if missing:
            raise LogError(f"has no column '{missing[0]}'", "copy it again", self.path)
        return places

    def _numbers(self, rows: Sequence[Record], places: dict[str, int]) -> Floats:
        """Return the numbers of rows, (k, 1 + n): the place in the file, then those of the titles; NaN where empty."""
        wanted = {title: place for title, place in places.items() if title != "width"}
        frame: Any = pd.read_csv(
            BytesIO(b"\n".join(row.content for row in rows)), header=None, usecols=sorted(wanted.values()),
            names=range(places["width"]), dtype=str, na_filter=False, quoting=3, encoding_errors="replace",
        )  # fmt: skip
        offsets = np.array([row.offset for row in rows], np.float64)
        columns = [offsets]
        is_damaged = np.zeros(len(rows), np.bool_)
        for place in wanted.values():
            cells = frame[place].str.strip()
            numbers = pd.to_numeric(cells.replace(_FLAGS), errors="coerce")
            is_damaged |= (numbers.isna() & (cells != "")).to_numpy()
            columns.append(numbers.to_numpy(np.float64))
        for offset in offsets[is_damaged]:
            self.lose(int(offset), "a cell of a row is no number")
        return np.stack(columns, axis=1)[~is_damaged]

    def _tables(self, numbers: Floats, titles: Sequence[str]) -> Iterator[InstrumentTable]:
        """Make the tables of the packets of each kind."""
        by_title = {title: numbers[:, 1 + place] for place, title in enumerate(titles)}
        time_s = by_title["timeStamp"]
        rest_us = by_title["microSeconds"]
        is_rest = (rest_us >= 0.0) & (rest_us < 1e6)
        has_time = self.with_times(numbers[:, 0], np.where(is_rest, time_s, np.nan))
        used = ~has_time
        for name, columns in _TABLES.items():
            known = {
                column: parts for column, parts in columns.items() if set(parts) <= set(titles)
            }
            first = next(iter(columns))
            if first not in known:
                continue
            rows = has_time & np.isfinite(by_title[columns[first][0]])
            used |= rows
            found: dict[str, Array] = {}
            for column, parts in known.items():
                found[column] = np.stack([by_title[part][rows] for part in parts], axis=1)
            if "is_valid" in found:
                invalid = found.pop("is_valid")[:, 0] == 0.0
                for values in found.values():
                    values[invalid] = np.nan
            if "id" in found:
                found["water_track"] = (found.pop("id") == _WATER_TRACK).astype(np.float64)
            time_ns = time_s[rows].astype(np.int64) * NS_PER_S
            time_ns += rest_us[rows].astype(np.int64) * 1000
            yield InstrumentTable(f"nucleus/{name}", f"nucleus.{name}", time_ns, found)
        others = int(np.count_nonzero(~used))
        if others:
            self.pass_over("other packets", others)


def _titles() -> Iterator[str]:
    """Give all titles that are read."""
    for columns in _TABLES.values():
        for titles in columns.values():
            yield from titles
