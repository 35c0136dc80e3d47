"""PD0, ensembles of Teledyne's DVLs and ADCPs with bottom track: Workhorse, Explorer, Pathfinder, Pinnacle, Tasman.

Sources: Teledyne RD Instruments, "Pathfinder DVL Guide", 95B-6116-00, April 2018: the signs under "Special Output Data
Formats"; "WorkHorse Commands and Output Data Format" for the angle of the beams in byte 59, and for the command EA: the
angle by which beam 3 is turned clockwise from the bow. `teledyne_ensembles` has the layout.

Velocities of PD0 are those of the bottom, as the instrument sees it: the vehicle's have the opposite sign. Along a beam
it is positive where the bottom comes nearer, which is the vehicle's own velocity in the direction of the beam.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Array, Floats, Mask
from insdvl_replay.core.notes import note
from insdvl_replay.geometry.frames import TILT_DEG, beam_vectors
from insdvl_replay.logs.formats.checked_records import checked_records
from insdvl_replay.logs.formats.earth_axes import turned_back, turned_back_note
from insdvl_replay.logs.formats.instrument_file import InstrumentFile, InstrumentTable, Record
from insdvl_replay.logs.formats.teledyne import (
    BOTTOM_TRACK,
    VELOCITY,
    Coordinates,
    attitude_deg,
    clock_ns,
    metres_per_second,
    sensor_tables,
    with_z_down,
)
from insdvl_replay.logs.formats.teledyne_ensembles import (
    BOTTOM,
    ENSEMBLE,
    FEWEST,
    data_of,
    ensemble_bytes,
)

_UP: Final = 0x80  # bits of the system's configuration
_CONVEX: Final = 0x08
_BEAM_ANGLES_DEG: Final = (15.0, 20.0, 30.0)  # by bits 8 and 9 of it; other ones are in byte 59
_TILTS_USED: Final = 0x04  # a bit of the transform
_AZIMUTHS_DEG: Final = (270.0, 90.0, 0.0, 180.0)  # from beam 3, of an instrument that looks down


class Pd0File(InstrumentFile):
    """A file of ensembles."""

    records = "ensembles"

    def tables(self) -> Iterator[InstrumentTable]:
        """Decode the ensembles."""
        parts = [np.empty(0, ENSEMBLE)]
        for records in checked_records(self, [b"\x7f\x7f"], FEWEST):
            parts.append(self._ensembles(records))
        ensembles = np.concatenate(parts)
        time_ns, known = clock_ns(_clock_fields(ensembles["variable"]))
        for offset in ensembles["offset"][~known].tolist():
            self.lose(offset, "its date and time are none")
        time_ns = time_ns[known]
        ensembles = ensembles[known]
        variable = ensembles["variable"]
        rpy_deg = attitude_deg(
            variable["pitch"] * 0.01, variable["roll"] * 0.01, variable["heading"] * 0.01
        )
        columns = self._velocity_columns(ensembles, rpy_deg)
        yield InstrumentTable(VELOCITY, BOTTOM_TRACK, time_ns, columns)
        depth = "depth"
        values = variable["depth"] * 0.1
        if variable["pressure"].any():
            depth = "pressure"
            values = variable["pressure"] * 10.0
        yield from sensor_tables(time_ns, rpy_deg, depth, values)

    def _ensembles(self, records: list[Record]) -> Array:
        """Gather what is read of some ensembles."""
        gathered = bytearray()
        for record in records:
            found = data_of(record.content)
            if found is None:
                self.lose(record.offset, "its types of data are not where its header says")
            elif BOTTOM not in found:
                self.pass_over("ensembles without bottom track")
            else:
                gathered += ensemble_bytes(record.offset, found)
        return np.frombuffer(bytes(gathered), ENSEMBLE)

    def _velocity_columns(self, ensembles: Array, rpy_deg: Floats) -> dict[str, Array]:
        """Return the columns of the bottom track: of the vehicle's velocity, and of its beams, where there are any."""
        fixed = ensembles["fixed"]
        bottom = ensembles["bottom"]
        kind = (fixed["transform"] >> 3) & 3
        is_by_beams = kind == Coordinates.BEAM
        velocity_mps = metres_per_second(bottom["velocity"])
        range_m = (bottom["range"] + 65536.0 * bottom["range_msb"]) * 0.01
        columns: dict[str, Array] = {"beams.range": range_m}
        for name in ("correlation", "amplitude", "percent_good"):
            columns[f"beams.{name}"] = bottom[name].astype(np.float64)
        self._note_alignment(fixed[kind <= Coordinates.INSTRUMENT])
        if is_by_beams.any():
            columns["beams.velocity"] = np.where(is_by_beams[:, None], velocity_mps, np.nan)
            columns["beams.vectors"] = self._beam_vectors(fixed, is_by_beams)
        if not is_by_beams.all():
            velocity_d = self._velocity_d(fixed, -velocity_mps[:, :3], rpy_deg)
            columns["velocity"] = np.where(is_by_beams[:, None], np.nan, velocity_d)
        return columns

    def _velocity_d(
        self,
        fixed: Array,
        axes_mps: Floats,
        rpy_deg: Floats,
    ) -> Floats:
        """Return velocities of the vehicle, (k, 3), in its own axes, of those in the axes of the ensembles."""
        kind = (fixed["transform"] >> 3) & 3
        by_instrument = kind == Coordinates.INSTRUMENT
        looks_up = (fixed["system"] & _UP) != 0
        axes_mps = axes_mps.copy()
        axes_mps[by_instrument & looks_up] *= [-1.0, 1.0, -1.0]
        velocity = with_z_down(axes_mps)
        # From the axes of beam 3 to those of the bow.
        about_z_deg = np.zeros_like(rpy_deg)
        about_z_deg[:, 2] = -0.01 * fixed["alignment"]
        turned_d = turned_back(velocity, about_z_deg)
        velocity = np.where(by_instrument[:, None], turned_d, velocity)
        # What the instrument has turned is turned back with the attitude that it used.
        has_tilts = (fixed["transform"] & _TILTS_USED) != 0
        in_earth = kind == Coordinates.EARTH
        used_deg = np.where(has_tilts[:, None], rpy_deg, 0.0)
        used_deg[:, 2] = np.where(in_earth, rpy_deg[:, 2], 0.0)
        is_turned = in_earth | ((kind == Coordinates.SHIP) & has_tilts)
        self._note_turned(fixed, is_turned, is_turned & in_earth)
        return np.where(is_turned[:, None], turned_back(velocity, used_deg), velocity)

    def _note_turned(
        self,
        fixed: Array,
        is_turned: Mask,
        in_earth: Mask,
    ) -> None:
        """Report velocities that the instrument has turned, and where its tilts may be those of other axes."""
        count = int(np.count_nonzero(is_turned))
        if not count:
            return
        self.add_note(turned_back_note(self, count, in_earth=bool(in_earth.any())))
        if fixed["alignment"][is_turned].any():
            self.add_note(note("dvl_tilts_aligned", count, file=self.path.name))

    def _note_alignment(self, fixed: Array) -> None:
        """Report that beam 3 is not forward."""
        is_off = fixed["alignment"] != 0
        count = int(np.count_nonzero(is_off))
        if count:
            angle_deg = 0.01 * float(np.median(fixed["alignment"][is_off]))
            self.add_note(note("dvl_alignment", count, file=self.path.name, angle_deg=angle_deg))

    def _beam_vectors(self, fixed: Array, is_by_beams: Mask) -> Floats:
        """Return the directions of the beams in the vehicle's axes, beam by beam, (k, 12)."""
        angles_deg = np.array([*_BEAM_ANGLES_DEG, 0.0])[(fixed["system"] >> 8) & 3]
        angles_deg = np.where(angles_deg == 0.0, fixed["beam_angle"], angles_deg)
        unknown = (angles_deg < 5.0) | (angles_deg > 60.0)
        angles_deg[unknown] = TILT_DEG
        count = int(np.count_nonzero(unknown & is_by_beams))
        if count:
            self.add_note(note("dvl_beam_angle", count, file=self.path.name, angle_deg=TILT_DEG))
        vectors = np.empty((len(fixed), 4, 3))
        settings = np.column_stack(
            [angles_deg, fixed["alignment"], fixed["system"] & _UP, fixed["system"] & _CONVEX]
        )
        alike, rows = np.unique(settings, axis=0, return_inverse=True)
        for number, (angle_deg, alignment, up, convex) in enumerate(alike.tolist()):
            azimuths_deg = np.array(_AZIMUTHS_DEG)
            if up:
                azimuths_deg = -azimuths_deg
            if not convex:
                azimuths_deg = azimuths_deg + 180.0
            directions = beam_vectors(angle_deg, (azimuths_deg + 0.01 * alignment).tolist())
            if up:
                directions[:, 2] *= -1.0
            vectors[rows.ravel() == number] = directions
        return vectors.reshape(len(fixed), 12)


def _clock_fields(variable: Array) -> Array:
    """Return year, month, day, hour, minute, second, hundredth, (k, 7); the clock with a century goes before."""
    clock = variable["clock"].astype(np.int64)
    clock[:, 0] += np.where(clock[:, 0] < 80, 2000, 1900)
    y2k = variable["y2k_clock"].astype(np.int64)
    has_century = (y2k[:, 0] >= 19) & (y2k[:, 0] <= 21)
    whole = y2k[:, 1:].copy()
    whole[:, 0] += 100 * y2k[:, 0]
    return np.where(has_century[:, None], whole, clock)
