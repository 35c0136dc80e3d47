"""PD4 and PD5, ensembles of Teledyne's DVLs in one structure: Workhorse Navigator, Explorer, Pathfinder.

Source: Teledyne RD Instruments, "Pathfinder DVL Guide", 95B-6116-00, April 2018, figures 44 and 45, tables 48 (PD4) and
49 (PD5), and the signs under "Special Output Data Formats": velocities are those of the vessel over the bottom.

The time is that of the first ping, without a date. PD4 has no attitude, and neither has the angle of the beams.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Floats, Mask, TimeNs
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS
from insdvl_replay.logs.formats.checked_records import checked_records
from insdvl_replay.logs.formats.earth_axes import turned_back, turned_back_note
from insdvl_replay.logs.formats.instrument_file import InstrumentFile, InstrumentTable
from insdvl_replay.logs.formats.teledyne import (
    BOTTOM_TRACK,
    RECORD_PD0,
    VELOCITY,
    Coordinates,
    Fields,
    attitude_deg,
    metres_per_second,
    sensor_tables,
    structure,
    time_of_day_ns,
    with_z_down,
)

_HEADS: Final = (b"\x7d\x00", b"\x7d\x01")
_PD4_SIZE: Final = 45  # bytes without the sum
_PD5_SIZE: Final = 86
_FIELDS: Final[Fields] = {
    "is_pd5": ("u1", 2),
    "system": ("u1", 5),  # configuration
    "velocity": ("4<i2", 6),  # mm/s
    "range": ("4<u2", 14),  # cm
    "clock": ("4u1", 36),  # hour, minute, second, hundredth
    # Of PD5 alone.
    "depth": ("<u2", 47),  # dm
    "pitch": ("<i2", 49),  # 0.01 deg
    "roll": ("<i2", 51),
    "heading": ("<u2", 53),
}
_TILTS_USED: Final = 0x20  # a bit of the system's configuration
_DAY_NS: Final = TIME_UNITS_NS["d"]
_ENSEMBLE: Final = np.dtype([("offset", "<i8"), ("data", structure(_FIELDS, _PD5_SIZE))])
_BY_BEAMS: Final = "ensembles in beam coordinates, without the angle of the beams"
_WITHOUT_ATTITUDE: Final = "ensembles in earth coordinates, without the attitude"


class Pd4File(InstrumentFile):
    """A file of ensembles."""

    records = "ensembles"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the ensembles."""
        ensembles = self._ensembles()
        time_ns, known = time_of_day_ns(ensembles["data"]["clock"].astype(np.int64))
        for offset in ensembles["offset"][~known].tolist():
            self.lose(offset, "its time is none")
        known &= self._usable(ensembles["data"], known)
        data = ensembles["data"][known]
        time_ns = _risen(time_ns[known])
        rpy_deg = attitude_deg(data["pitch"] * 0.01, data["roll"] * 0.01, data["heading"] * 0.01)
        is_pd5 = data["is_pd5"] == 1
        rpy_deg[~is_pd5] = np.nan
        columns: dict[str, Array] = {
            "velocity": self._velocity_d(data, rpy_deg),
            "beams.range": data["range"] * 0.01,
        }
        depth_m = np.where(is_pd5, data["depth"] * 0.1, np.nan)
        yield InstrumentTable(
            VELOCITY,
            BOTTOM_TRACK,
            time_ns,
            columns,
            _DAY_NS,
        )
        for table in sensor_tables(time_ns, rpy_deg, "depth", depth_m):
            yield table._replace(period_ns=_DAY_NS)

    def _ensembles(self) -> Array:
        """Gather what is read of the ensembles."""
        gathered = bytearray()
        for records in checked_records(self, _HEADS, _PD4_SIZE):
            for record in records:
                size = len(record.content) - 2
                if size == (_PD5_SIZE if record.content[1] else _PD4_SIZE):
                    gathered += record.offset.to_bytes(8, "little")
                    gathered += record.content[:size].ljust(_PD5_SIZE, b"\0")
                else:
                    self.lose(record.offset, f"it has {size} bytes, which are too many or too few")
        return np.frombuffer(bytes(gathered), _ENSEMBLE)

    def _usable(
        self,
        data: Array,
        known: Mask,
    ) -> Mask:
        """Find the ensembles whose velocities can be brought into the vehicle's axes; the others are passed over."""
        kind = data["system"] >> 6
        by_beams = kind == Coordinates.BEAM
        lacks_attitude = (kind == Coordinates.EARTH) & (data["is_pd5"] != 1)
        for reason, unusable in ((_BY_BEAMS, by_beams), (_WITHOUT_ATTITUDE, lacks_attitude)):
            count = int(np.count_nonzero(known & unusable))
            if count and count == np.count_nonzero(known):
                raise LogError(f"has nothing but {reason}", RECORD_PD0, self.path)
            if count:
                self.pass_over(reason, count)
        return np.asarray(~by_beams & ~lacks_attitude)

    def _velocity_d(
        self,
        data: Array,
        rpy_deg: Floats,
    ) -> Floats:
        """Return velocities of the vehicle, (k, 3), in its own axes."""
        kind = data["system"] >> 6
        velocity = with_z_down(metres_per_second(data["velocity"])[:, :3])
        in_earth = kind == Coordinates.EARTH
        has_tilts = (data["system"] & _TILTS_USED) != 0
        is_turned = in_earth | ((kind == Coordinates.SHIP) & has_tilts)
        has_attitude = np.isfinite(rpy_deg[:, 0])
        levelled = int(np.count_nonzero(is_turned & ~has_attitude))
        if levelled:
            self.add_note(
                note(
                    "dvl_levelled",
                    levelled,
                    file=self.path.name,
                )
            )
        is_turned &= has_attitude
        count = int(np.count_nonzero(is_turned))
        if count:
            self.add_note(turned_back_note(self, count, in_earth=bool(in_earth.any())))
        used_deg = np.where(has_tilts[:, None], rpy_deg, 0.0)
        used_deg[:, 2] = np.where(in_earth, rpy_deg[:, 2], 0.0)
        return np.where(is_turned[:, None], turned_back(velocity, used_deg), velocity)


def _risen(time_ns: TimeNs) -> TimeNs:
    """Return times of day that go on where a day begins anew."""
    back = np.diff(time_ns, prepend=time_ns[:1]) < -_DAY_NS // 2
    return np.asarray(time_ns + _DAY_NS * np.cumsum(back))
