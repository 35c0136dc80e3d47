"""Logs of ArduPilot's vehicles, such as ArduSub (.BIN): which of their records are IMU, DVL, depth, fixes and the EKF.

Axes are forward-starboard-down and north-east-down. Times are since the start of the vehicle, which the receiver's time
of the week brings to UTC. Sources: ArduPilot/ardupilot@014a9c4, the LogStructure.h of AP_DAL, AP_InertialSensor,
AP_VisualOdom, AP_NavEKF3, AP_GPS, AP_Baro and AP_AHRS, and AP_DAL.cpp: with LOG_REPLAY, RISI has the increments of the
frame whose time is in the last RFRH, and RBOH the displacement up to its own time. VISO.dt is in seconds: so its writer
AP_VisualOdom_Logging.cpp has it, other than its multiplier says.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from insdvl_replay.core.dive_columns import Array, TimeNs
from insdvl_replay.logs.formats.dataflash import DataflashFile, Records
from insdvl_replay.logs.formats.instrument_file import LATEST_S, InstrumentTable

_US: Final = 1000  # ns
_MS: Final = 1_000_000
_TIME_LABELS: Final = {"TimeUS": _US, "TS": _MS}  # of records, the first that they have


class _Kind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Records that become a table; `ardupilot.toml` says what each entry means."""

    names: tuple[str, ...]
    topic: str
    type: str
    columns: dict[str, str]
    factors: dict[str, float] = {}


class _Timed(NamedTuple):
    """Records with their times since the start of the vehicle."""

    records: Records
    time_ns: TimeNs  # (k,)

    def chosen(self, rows: Array) -> "_Timed":
        """Return some of the records, by a mask or their numbers."""
        return _Timed(self.records.chosen(rows), self.time_ns[rows])


_ROLES: Final = msgspec.toml.decode(
    Path(__file__).with_name("ardupilot.toml").read_text("utf-8"),
    type=dict[str, list[_Kind]],
)
_SOLUTION: Final = "solution"
_ON_OTHERS: Final = ("RFRH", "RISH", "ORGN", "XKF4")  # what tells how the others are read
_IN_FRAMES: Final = ("RISI",)
_MOST_INSTRUMENTS: Final = 1 << 8
_INSTANCE_LABELS: Final = ("I", "Instance")
_HAS_VELOCITY: Final = 4  # bits of RISI's flags: which increments were measured
_HAS_ANGLE: Final = 8
_ORIGIN_OF_EKF: Final = 0  # other origins are of the vehicle's home
_LATEST_NS: Final = int(LATEST_S / 4) * 10**9  # since the start; the start is at most as late
_GPS_EPOCH_S: Final = 315_964_800  # 1980-01-06
_WEEK_S: Final = 604_800
_LEAP_S: Final = 18  # since 2017
_FIX_3D: Final = 3


class ArdupilotFile(DataflashFile):
    """A log of a vehicle."""

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the records."""
        wanted = set(_ON_OTHERS)
        for kinds in _ROLES.values():
            for kind in kinds:
                wanted.update(kind.names)
        self._found = self.read_records(frozenset(wanted))
        self._start_ns = self._vehicle_start_ns()
        for role, kinds in _ROLES.items():
            if role == _SOLUTION:
                yield from self._solution(kinds[0])
                continue
            has_better = False
            for kind in kinds:
                instances = self._instances(kind)
                first = self._first(kind, instances)
                for instance, timed in instances.items():
                    is_main = instance == first and not has_better
                    yield self._table(kind, timed, instance, is_main=is_main)
                has_better = has_better or bool(instances)

    def _vehicle_start_ns(self) -> int:
        """Return the time of the vehicle's start since 1970, by the times of its receiver; 0 without a fix."""
        gps = self._found.get("GPS")
        if gps is None or not gps.has("TimeUS", "GMS", "GWk", "Status"):
            return 0
        fixed = gps.chosen((gps.values("Status") >= _FIX_3D) & (gps.values("GWk") > 0.0))
        if not len(fixed.rows):
            return 0
        week_s = _GPS_EPOCH_S - _LEAP_S + _WEEK_S * fixed.values("GWk")
        starts_s = week_s + 1e-3 * fixed.values("GMS") - 1e-6 * fixed.values("TimeUS")
        fixed = fixed.chosen((starts_s > 0.0) & (starts_s < 0.5 * LATEST_S))
        if not len(fixed.rows):
            return 0
        utc_ms = 1000 * (_GPS_EPOCH_S - _LEAP_S + _WEEK_S * fixed.whole("GWk"))
        utc_ms += fixed.whole("GMS")
        return _US * int(np.median(1000 * utc_ms - fixed.whole("TimeUS")))

    def _timed(self, name: str) -> _Timed | None:
        """Return the records of a name that have a time; the others are lost. None without any."""
        records = self._found.get(name)
        if records is None:
            return None
        if name in _IN_FRAMES:
            return self._in_frames(records)
        labels = [label for label in _TIME_LABELS if records.has(label)]
        if not labels:
            self.pass_over(f"{name} without a time", len(records.rows))
            return None
        units = records.whole(labels[0])
        unit_ns = _TIME_LABELS[labels[0]]
        possible = (units >= 0) & (units < _LATEST_NS // unit_ns)
        for offset in records.offsets[~possible].tolist():
            self.lose(offset, f"a record {name} has an impossible time")
        return _Timed(records.chosen(possible), unit_ns * units[possible])

    def _in_frames(self, records: Records) -> _Timed | None:
        """Give records the time of the frame in which they are; those without a frame of their own are lost."""
        frames = self._timed("RFRH")
        if frames is None:
            self.lose(int(records.offsets[0]), "records have no frame", len(records.rows))
            return None
        frame = np.searchsorted(frames.records.offsets, records.offsets) - 1
        of_instrument = (frame + 1) * _MOST_INSTRUMENTS + records.whole("I")
        own = np.unique(of_instrument, return_index=True)[1]
        own = own[frame[own] >= 0]
        for offset in np.delete(records.offsets, own).tolist():
            self.lose(offset, "a record has no frame of its own")
        return _Timed(records.chosen(own), frames.time_ns[frame[own]])

    def _instances(self, kind: _Kind) -> dict[int, _Timed]:
        """Return the records of each instrument of a kind by its number."""
        found: dict[int, _Timed] = {}
        for number, name in enumerate(kind.names):
            timed = self._timed(name)
            if timed is None:
                continue
            labels = [label for label in _INSTANCE_LABELS if timed.records.has(label)]
            if not labels:
                found[number] = timed
                continue
            numbers = timed.records.whole(labels[0])
            for instance in np.unique(numbers).tolist():
                found[instance] = timed.chosen(numbers == instance)
        return found

    def _first(self, kind: _Kind, instances: Mapping[int, _Timed]) -> int | None:
        """Return which of several instruments the vehicle used; of barometers the one that was in the water."""
        if not instances:
            return None
        header = self._found.get("RISH")
        if kind.topic.startswith("imu") and header is not None and header.has("PG"):
            primary = int(header.whole("PG")[-1])
            if primary in instances:
                return primary
        if kind.topic == "pressure":
            return max(instances, key=lambda instance: _pressure_span(instances[instance]))
        return min(instances)

    def _table(
        self,
        kind: _Kind,
        timed: _Timed,
        instance: int,
        *,
        is_main: bool,
    ) -> InstrumentTable:
        """Make a table of records; only the main one of a role has the type by which it is found."""
        records = timed.records
        columns: dict[str, Array] = {}
        for name, joined in kind.columns.items():
            labels = joined.split()
            if not records.has(*labels):
                continue
            parts = [records.values(label) * kind.factors.get(label, 1.0) for label in labels]
            columns[name] = np.stack(parts, axis=1) if parts[1:] else parts[0]
        if "flags" in columns:
            flags = records.whole("Flags")
            columns["delta_velocity"][flags & _HAS_VELOCITY == 0] = np.nan
            columns["delta_angle"][flags & _HAS_ANGLE == 0] = np.nan
        topic = kind.topic
        type_name = kind.type
        if not is_main:
            topic += f"/{instance}"
            type_name += "_other"
        return InstrumentTable(topic, type_name, timed.time_ns + self._start_ns, columns)

    def _solution(self, kind: _Kind) -> Iterator[InstrumentTable]:
        """Make the table of the EKF that was flown: of the core that was the primary one at each time."""
        timed = self._timed(kind.names[0])
        if timed is None:
            return
        if timed.records.has("C"):
            core = timed.records.whole("C")
            primary = np.full(len(core), core.min())
            states = self._found.get("XKF4")
            if states is not None and states.has("PI"):
                last = np.searchsorted(states.offsets, timed.records.offsets) - 1
                primary = states.whole("PI")[last.clip(0)]
            is_primary = core == primary
            others = int(np.count_nonzero(~is_primary))
            if others:
                self.pass_over("XKF1 of other cores", others)
            timed = timed.chosen(is_primary)
        table = self._table(kind, timed, 0, is_main=True)
        origins = self._found.get("ORGN")
        if origins is None or not origins.has("Type", "Lat", "Lng", "Alt"):
            yield table
            return
        origins = origins.chosen(origins.whole("Type") == _ORIGIN_OF_EKF)
        if len(origins.rows):
            last = np.searchsorted(origins.offsets, timed.records.offsets) - 1
            place = [origins.values(label)[last.clip(0)] for label in ("Lat", "Lng", "Alt")]
            origin = np.stack(place, axis=1)
            table = table._replace(columns={**table.columns, "origin": origin})
        yield table


def _pressure_span(timed: _Timed) -> float:
    if not timed.records.has("Press") or not len(timed.time_ns):
        return 0.0
    return float(np.nan_to_num(np.ptp(timed.records.values("Press"))))
