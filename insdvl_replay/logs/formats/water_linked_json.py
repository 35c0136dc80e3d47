"""Reports of Water Linked's DVLs A50 and A125 as they send them over TCP: a JSON object a line.

Lines may be indented, may have a time of arrival in front, or may be the elements of one list. Source: Water Linked,
"DVL A50/A125 TCP JSON API", up to format json_v3.2, https://docs.waterlinked.com/dvl/dvl-json-protocol/.
"""

import math
import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from json import JSONDecoder
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.dive_columns import (
    Array,
    Floats,
)
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.instrument_file import (
    LATEST_S,
    InstrumentFile,
    InstrumentTable,
    Record,
)

Number = float | None  # null where the instrument has none


class _Transducer(msgspec.Struct):
    id: int  # 0 to 3
    velocity: Number = None  # m/s along the beam
    distance: Number = None  # m along the beam
    rssi: Number = None  # dBm
    nsd: Number = None  # dBm
    beam_valid: bool = False


class _Velocity(msgspec.Struct):
    """A report of type `velocity`, or of water track `velocity_water`; early ones have no type."""

    vx: Number  # m/s forward
    vy: Number  # starboard
    vz: Number  # down
    velocity_valid: bool
    transducers: list[_Transducer] = []
    altitude: Number = None  # m
    fom: Number = None  # m/s
    covariance: list[list[Number]] = []  # (m/s)^2, 3 by 3
    status: Number = None
    time: Number = None  # ms since the last report
    time_of_validity: Number = None  # us since 1970; early ones have none
    tracking_mode: str = "bottom"  # or water
    type: str = "velocity"


class _Position(msgspec.Struct):
    """A report of type `position_local`: the instrument's dead reckoning from its first place and heading."""

    ts: float  # s
    x: Number = None  # m
    y: Number = None
    z: Number = None
    std: Number = None  # m
    roll: Number = None  # deg
    pitch: Number = None
    yaw: Number = None
    status: Number = None


class _AnyReport(msgspec.Struct):
    type: str = ""
    vx: Number = None


_BEAMS: Final = 4
_OF_A_BEAM: Final = ("velocity", "distance", "rssi", "nsd", "beam_valid")
_OF_A_POSITION: Final = ("x", "y", "z", "std", "roll", "pitch", "yaw", "status")
# Columns of velocity reports, and how many numbers they have; the first ones only give the times.
_TIMES: Final = {"offset": 1, "time_of_validity": 1, "time": 1}
_WIDTHS: Final = {
    **_TIMES, "velocity": 3, "velocity_valid": 1, "altitude": 1, "fom": 1, "status": 1, "water_track": 1,
    "covariance": 9, **{f"transducers.{name}": _BEAMS for name in _OF_A_BEAM},
}  # fmt: skip
# A report begins at the left edge; what is indented goes on with it, and so do brackets that close.
_BOUNDARY: Final = re.compile(rb"(?<![\r\n])[\r\n]+(?=[^\s}\]])")
_LIST: Final = re.compile(rb"\s*\[\s*\{")
_LARGEST_LIST: Final = 1 << 28  # bytes
_MOST_DAMAGED: Final = 1_000  # elements of a list, behind which it is not read any further
_NO_NUMBER: Final = re.compile(rb"(?<=[:,\[])\s*[+-]?(?:NaN|Infinity)(?=[\s,}\]])")
_ANY: Final = msgspec.json.Decoder(_AnyReport, strict=False)
_VELOCITY: Final = msgspec.json.Decoder(_Velocity, strict=False)
_LOCAL: Final = msgspec.json.Decoder(_Position, strict=False)
_UNREADABLE: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class WaterLinkedJson(InstrumentFile):
    """A file of JSON reports."""

    records = "reports"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the reports."""
        velocities = [np.empty((0, sum(_WIDTHS.values())))]
        positions = [np.empty((0, 1 + len(_OF_A_POSITION)))]
        for records in self._reports():
            of_velocity: list[list[float]] = []
            of_position: list[list[float]] = []
            for record in records:
                try:
                    self._decode(record, of_velocity, of_position)
                except _UNREADABLE as error:
                    self.lose(record.offset, f"a report is no JSON of the format ({error})")
            if of_velocity:
                velocities.append(np.array(of_velocity))
            if of_position:
                positions.append(np.array(of_position))
        yield self._velocity_table(np.concatenate(velocities))
        rows = np.concatenate(positions)
        columns = dict(zip(_OF_A_POSITION, rows[:, 1:].T, strict=True))
        time_ns = np.rint(rows[:, 0] * 1e9).astype(np.int64)
        yield InstrumentTable("dvl/position_local", "waterlinked.position_local", time_ns, columns)

    def _reports(self) -> Iterator[list[Record]]:
        """Give the reports: those of a list, or one a line."""
        start = bytes(self.file.read(0, 1 << 10))
        if not _LIST.match(start.removeprefix(BOM_UTF8)):
            yield from self.text_records(_BOUNDARY)
            return
        if len(self.file) > _LARGEST_LIST:
            what = f"is one list of {len(self.file)} bytes; one is read up to {_LARGEST_LIST}"
            raise LogError(what, "write one report a line", self.path)
        yield self._elements(bytes(self.file.read(0, len(self.file))))

    def _elements(self, content: bytes) -> list[Record]:
        """Return the elements of a list; behind a damaged one the search goes on."""
        text = content.decode(
            "latin-1"
        )  # a byte is a letter, so that places are those of the file
        decoder = JSONDecoder()
        found: list[Record] = []
        damaged = 0
        begin = text.find("{")
        while begin >= 0 and damaged < _MOST_DAMAGED:
            try:
                end = decoder.raw_decode(text, begin)[1]
                found.append(Record(begin, content[begin:end]))
            except (ValueError, RecursionError):
                self.lose(begin, "an element of the list is cut, or no JSON")
                end = begin + 1
                damaged += 1
            begin = text.find("{", end)
        return found

    def _decode(
        self,
        record: Record,
        velocities: list[list[float]],
        positions: list[list[float]],
    ) -> None:
        """Decode a report into a row of velocities or of positions."""
        text = record.content
        text = text[text.find(b"{") : text.rfind(b"}") + 1]
        if not text:
            self._lose_text(record)
            return
        text = _NO_NUMBER.sub(b"null", text)
        report = _ANY.decode(text)
        kind = report.type
        if not kind and report.vx is not None:
            kind = "velocity"
        if kind in ("velocity", "velocity_water"):
            row = _velocity_row(record.offset, _VELOCITY.decode(text))
            if row is None:
                self.lose(record.offset, f"transducers are not numbered from 0 to {_BEAMS - 1}")
            else:
                velocities.append(row)
        elif kind == "position_local":
            position = _LOCAL.decode(text)
            if 0.0 <= position.ts < LATEST_S:
                numbers = [_number(getattr(position, name)) for name in _OF_A_POSITION]
                positions.append([position.ts, *numbers])
            else:
                self.lose(record.offset, f"a time is {position.ts:g} s")
        else:
            self.pass_over(f"type {kind[:20]}" if kind else "without type")

    def _lose_text(self, record: Record) -> None:
        """Leave out a line without an object: the rest of a report, or the words of another program."""
        if b'"' in record.content or b"{" in record.content:
            self.lose(record.offset, "a report has no beginning or no end")
        elif record.content.strip():
            self.pass_over("other text")

    def _velocity_table(self, rows: Floats) -> InstrumentTable:
        """Make the table of velocities: rows without a time are lost."""
        ends = np.cumsum(list(_WIDTHS.values()))[:-1]
        columns: dict[str, Array] = dict(zip(_WIDTHS, np.split(rows, ends, axis=1), strict=True))
        offsets, time_us, since_last_ms = [columns.pop(name)[:, 0] for name in _TIMES]
        if len(rows) and np.isnan(time_us).all():
            time_us = self.summed_us(since_last_ms)
        known = self.with_times(offsets, time_us * 1e-6)
        kept = {name: values[known] for name, values in columns.items()}
        time_ns = np.rint(time_us[known]).astype(np.int64) * 1000
        return InstrumentTable("dvl/velocity", "waterlinked.velocity", time_ns, kept)


def _velocity_row(offset: int, report: _Velocity) -> list[float] | None:
    """Return the numbers of a report in the order of the columns; None where its transducers are not four."""
    beams = np.full((len(_OF_A_BEAM), _BEAMS), math.nan)
    beams[-1] = 0.0  # a beam that is not reported is not valid
    seen = [transducer.id for transducer in report.transducers]
    if len(set(seen)) < len(seen) or not set(seen) <= set(range(_BEAMS)):
        return None
    for transducer in report.transducers:
        numbers = [_number(getattr(transducer, name)) for name in _OF_A_BEAM]
        beams[:, transducer.id] = numbers
    is_water = report.type == "velocity_water" or report.tracking_mode == "water"
    row = [float(offset), _number(report.time_of_validity), _number(report.time)]
    row += [_number(report.vx), _number(report.vy), _number(report.vz)]
    row += [float(report.velocity_valid), _number(report.altitude), _number(report.fom)]
    row += [_number(report.status), float(is_water)]
    row += _covariance(report.covariance)
    row += beams.ravel().tolist()
    return row


def _covariance(rows: Sequence[Sequence[Number]]) -> list[float]:
    """Return the nine numbers of a covariance; they are missing where there are more or fewer."""
    numbers: list[float] = []
    for row in rows:
        numbers += map(_number, row)
    if len(numbers) != 9:
        return [math.nan] * 9
    return numbers


def _number(value: Number) -> float:
    return math.nan if value is None else float(value)
