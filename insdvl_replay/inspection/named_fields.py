"""Settings for topics of unknown types, by the names and sizes of their fields."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.units import (
    ANGULAR_RATE_UNITS,
    LENGTH_UNITS,
    SPECIFIC_FORCE_UNITS,
    VELOCITY_UNITS,
)
from insdvl_replay.inspection.clock_words import apart
from insdvl_replay.inspection.ping_flags import flag_senses
from insdvl_replay.inspection.probed_topics import (
    FieldMatch,
    ProbedTopic,
    time_paths,
)
from insdvl_replay.inspection.settings import Alternative, Setting
from insdvl_replay.inspection.unit_by_size import (
    FORCE_UNITS,
    SPEED_UNITS,
    force_units,
    speed_units,
)
from insdvl_replay.logs.columns.flags import flag_columns
from insdvl_replay.logs.columns.named_columns import (
    ATTITUDE,
    PLACE,
    positions_by_direction,
    reference_columns,
    velocity_columns,
)
from insdvl_replay.logs.columns.tables import (
    LARGEST_JITTER_S,
    Table,
    read_sample,
    stamp_path,
    stamp_unit,
)
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.recording import Recording

_STATED: Final = "the titles of the columns have this unit"
_AXES_OPEN: Final = 'frd, flu (y to port, z up) or a signed permutation such as "+x-z+y"; `run` and --propose find them'


def _fields(key: str, candidates: Sequence[FieldMatch], to_decide: str = "") -> Setting:
    """Propose the first of some fields, with the others as alternatives."""
    first, *others = candidates
    name = key.partition(".")[2]
    ways = tuple(_instead(name, other) for other in others)
    return Setting(key, first.path, str(first), to_decide, ways)


def _instead(name: str, field: FieldMatch) -> Alternative:
    return Alternative(f'{name} = "{field.path}"', str(field))


# --- The stamp: a field that agrees with the recorder's clock.

_ENOUGH: Final = 1000
_HEADER: Final = "header.stamp"
_CLOCK_NAMES: Final = re.compile(
    r"time|stamp|clock|epoch|utc|tick|^t$|(^|_)(t_|ts$)|_([mun]s|sec)$"
)
# Share of the sample's length by which a clock may wander; what counts from the message before does not run at all.
_MOST_SPREAD: Final = 0.05


@dataclass(frozen=True)
class _Stamp:
    """A field that could be the stamp, in the first messages."""

    table: Table
    clock: Clock

    @property
    def is_clock(self) -> bool:
        """Whether it runs with the recorder's clock."""
        recorded_ns = self.table.columns["log_time"]
        length_s = float(recorded_ns[-1, 0] - recorded_ns[0, 0]) * 1e-9
        largest_s = min(LARGEST_JITTER_S, _MOST_SPREAD * length_s)
        return self.clock.messages < 2 or self.clock.spread_s < largest_s

    @property
    def read_as(self) -> str:
        """The unit of plain numbers, as a clause."""
        numbers = self.table.stamp_numbers
        if numbers is None:
            return ""
        _, unit = stamp_unit(numbers, self.table.columns["log_time"][:, 0])
        return f", read as {unit},"


def _stamp_setting(log: Recording, topic: ProbedTopic, role: str) -> Iterator[Setting]:
    """Propose the stamp of a topic. Tables need none."""
    if topic.is_table:
        return
    agreeing = _agreeing_stamps(log, topic)
    if not agreeing:
        text = "no field of the messages agrees with the recorder's clock"
        yield Setting(f"{role}.stamp", "log_time", text)
        return
    first, *others = agreeing
    path = stamp_path(first.clock.stamp)
    text = f"'{path}'{first.read_as} agrees with the recorder's clock: {apart(first.clock)}"
    ways = tuple(Alternative(f'stamp = "{other.clock.stamp}"') for other in others)
    yield Setting(f"{role}.stamp", first.clock.stamp, text, others=ways)


def _agreeing_stamps(log: Recording, topic: ProbedTopic) -> list[_Stamp]:
    """Find the fields that agree with the recorder's clock: the header first, then times, then numbers."""
    paths = sorted(time_paths(topic.known), key=lambda path: path != _HEADER)
    for path in topic.scalars:
        name = path.rpartition(".")[2].lower()
        if _CLOCK_NAMES.search(name):
            paths.append(path)
    agreeing = []
    for path in paths:
        stamp = "header" if path == _HEADER else path
        source = Source("", topic.topic, topic.channel.type_name, (topic.channel,), {}, stamp, 0.0)
        try:
            table = read_sample(log, source, _ENOUGH)
            found = _Stamp(table, table.clock())
        except LogError:  # its numbers are no times
            continue
        if found.is_clock:
            agreeing.append(found)
    return agreeing


# --- The IMU: an angular rate beside a specific force, which the size of gravity shows.


@dataclass(frozen=True)
class _ImuFields:
    """The fields of a topic that could be an IMU, the likeliest first."""

    topic: ProbedTopic
    forces: Sequence[FieldMatch]
    rates: Sequence[FieldMatch]
    are_rates_named: bool  # else they are vectors of any name

    @property
    def likeness(self) -> tuple[bool, bool]:
        """What speaks for the topic, the strongest first."""
        return self.are_rates_named, bool(self.forces[0].force_unit)


def imu_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose a topic with a specific force; an angular rate beside it and the size of gravity speak for it."""
    candidates = []
    for topic in topics:
        fields = _imu_fields(topic)
        if fields.forces and fields.rates:
            candidates.append(fields)
    if not candidates:
        return
    best = max(candidates, key=lambda fields: fields.likeness)
    topic = best.topic
    yield Setting("imu.topic", topic.topic)
    yield _fields("imu.specific_force", best.forces)
    yield _force_unit(topic, best.forces[0])
    to_decide = "no field is named as an angular rate; check this one"
    if best.are_rates_named:
        to_decide = ""
    yield _fields("imu.angular_rate", best.rates, to_decide)
    stated = topic.stated_unit(best.rates[0].path)
    if stated in ANGULAR_RATE_UNITS:
        yield Setting("imu.angular_rate_unit", stated, _STATED)
    yield Setting("imu.axes", "frd", open=_AXES_OPEN)
    yield from _stamp_setting(log, topic, "imu")


def _imu_fields(topic: ProbedTopic) -> _ImuFields:
    forces = topic.likely("specific_force")
    rates = [field for field in topic.likely("angular_rate") if field not in forces]
    if rates:
        return _ImuFields(topic, forces, rates, are_rates_named=True)
    vectors = [field for field in topic.likely("vector") if field not in forces]
    return _ImuFields(topic, forces, vectors, are_rates_named=False)


def _force_unit(topic: ProbedTopic, force: FieldMatch) -> Setting:
    """Propose the unit of a specific force by the size of gravity, else as a table states it.

    Where gravity has its size in the unit that is stated, this one counts: 980 may be cm/s2 or, nearly, mg.
    """
    key = "imu.specific_force_unit"
    stated = topic.stated_unit(force.path)
    is_known = stated in SPECIFIC_FORCE_UNITS
    if force.force_unit and not (is_known and stated in force_units(force.size, stated)):
        return Setting(key, force.force_unit, "gravity has this size in this unit")
    if is_known:
        return Setting(key, stated, _STATED)
    text = (
        f"{', '.join(FORCE_UNITS)}; gravity is 9.81, 1 or 1000, but the size is {force.size:.3g}"
    )
    return Setting(key, "m/s2", open=text)


# --- The DVL: topic and fields by their names, its unit by the size of velocities.

_DVL_WORDS: Final = re.compile(r"dvl|doppler|bottom")
_FLAGS: Final = re.compile(r"valid|lock|good")


def dvl_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose a topic with a velocity, best with a name that is a DVL's."""
    topic = max(topics, key=_dvl_likeness, default=None)
    if topic is None or not _dvl_likeness(topic):
        return
    beams = topic.likely("beam_velocity")
    velocities = topic.likely("velocity")
    if not beams and not velocities:
        velocities = topic.likely("vector")
    yield Setting("dvl.topic", topic.topic)
    if velocities:
        yield _fields("dvl.velocity", velocities)
        yield Setting("dvl.kind", "velocity")
        yield Setting("dvl.axes", "frd", open=_AXES_OPEN)
        yield _velocity_unit(topic, velocities[0])
        yield from _flag_settings(log, topic, velocities[0].path)
    else:
        yield _velocity_unit(topic, beams[0])
    valid = topic.likely("beam_valid")
    if beams and velocities:
        yield _beams_instead(beams, valid)
    elif beams:
        yield from _beam_settings(beams, valid)
    yield from _stamp_setting(log, topic, "dvl")
    at_imu = (0.0, 0.0, 0.0)
    arm = "from IMU to DVL: forward, starboard, down; measure it"
    yield Setting("dvl.lever_arm_m", at_imu, open=arm)
    mounting = "DVL axes to body: roll, pitch, heading; measure them"
    yield Setting("dvl.mounting_rpy_deg", at_imu, open=mounting)


def _dvl_likeness(topic: ProbedTopic) -> int:
    """Return how much speaks for a DVL: its name and fields, its fields, its name and any vector, or nothing."""
    name = f"{topic.topic} {topic.channel.type_name}".lower()
    is_named = _DVL_WORDS.search(name) is not None
    if topic.likely("velocity") or topic.likely("beam_velocity"):
        return 3 if is_named else 2
    if is_named and topic.likely("vector"):
        return 1
    return 0


def _velocity_unit(topic: ProbedTopic, field: FieldMatch) -> Setting:
    """Propose the unit of a velocity as a table states it, else by the speeds of vehicles."""
    key = "dvl.velocity_unit"
    stated = topic.stated_unit(field.path)
    if stated in VELOCITY_UNITS:
        return Setting(key, stated, _STATED)
    units = speed_units(field.size)
    best = units[0] if units else "m/s"
    what = "length of all beams' velocities" if field.is_beams else "speed"
    size_mps = field.size * VELOCITY_UNITS[best]
    seen = f"in this unit the median {what} is {size_mps:.3g} m/s"
    if len(units) == 1:
        return Setting(key, best, f"{seen}; in any other it is not a vehicle's")
    return Setting(key, best, seen, f"the size fits several units: {', '.join(SPEED_UNITS)}")


def _flag_settings(log: Recording, topic: ProbedTopic, velocity: str) -> Iterator[Setting]:
    """Propose the flags of valid or invalid pings."""
    names = flag_columns(topic.scalars).names
    senses = flag_senses(log, topic, velocity, names) if names else {}
    is_settled = False
    for key in ("valid", "invalid"):
        chosen = {name: sense.why for name, sense in senses.items() if sense.key == key}
        if chosen:
            why = "; ".join(f"'{name}' {text}" for name, text in chosen.items())
            yield Setting(f"dvl.{key}", ", ".join(chosen), why)
            is_settled = True
    if is_settled:
        return
    likely = [path for path in topic.scalars if _FLAGS.search(path.lower()) and path not in names]
    flags = [f'"{name}" (median {topic.scalars[name]:g})' for name in (*senses, *likely)]
    if flags:
        text = f"is {' or '.join(flags)} 0 for an invalid ping? If 0 is valid: dvl.invalid"
        yield Setting("dvl.valid", None, open=text)


def _beams_instead(beams: Sequence[FieldMatch], valid: Sequence[FieldMatch]) -> Setting:
    """Propose the velocity, with the beams as alternative: a person must know where these point."""
    ways = [Alternative('kind = "beams"')]
    ways += [_instead("beam_velocity", beam) for beam in beams]
    ways += [Alternative(f'beam_valid = "{flag.path}"') for flag in valid]
    text = "beams give more, if you know their angles: set kind, beam_velocity, beam_valid, beam_tilt_deg"
    return Setting("dvl.kind", "velocity", text, others=tuple(ways))


def _beam_settings(beams: Sequence[FieldMatch], valid: Sequence[FieldMatch]) -> Iterator[Setting]:
    """Propose the beams of a DVL that gives no velocity."""
    yield _fields("dvl.beam_velocity", beams)
    for flag in valid[:1]:
        yield Setting("dvl.beam_valid", flag.path)
    tilt = "angle from the instrument's z axis, see the data sheet"
    yield Setting("dvl.beam_tilt_deg", 30.0, open=tilt)
    count = beams[0].median.size
    azimuths = tuple(45.0 + 360.0 * beam / count for beam in range(count))
    azimuth = "angles from forward towards starboard, one for each beam"
    yield Setting("dvl.beam_azimuth_deg", azimuths, open=azimuth)


# --- The reference: topic and fields by their names.

_ALTITUDE: Final = re.compile(r"(^|[._])(alt(itude)?|height)([._]|$)")
_FULL_CIRCLE: Final = 6.3  # no angle in radians is larger
_MEANT: Final = (
    "is this a solution to start from and to compare with? Roll must be positive starboard side down, pitch bow up, "
    "heading from north over east"
)


def reference_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose the topic with the most of a position, a velocity and an attitude."""
    best: ProbedTopic | None = None
    fields: dict[str, str] = {}
    for topic in topics:
        found = _reference_fields(topic)
        if len(found) > len(fields):
            best = topic
            fields = found
    if best is None:
        return
    yield Setting("reference.topic", best.topic, open=_MEANT)
    for quantity, path in fields.items():
        yield Setting(f"reference.{quantity}", path)
    angles = [fields[quantity] for quantity in (*PLACE, *ATTITUDE) if quantity in fields]
    if angles:
        yield _angle_unit(best, angles)
    yield from _stamp_setting(log, best, "reference")


def _angle_unit(topic: ProbedTopic, angles: Sequence[str]) -> Setting:
    """Propose the unit of angles, by their paths, as a table states it, else by their size."""
    key = "reference.angle_unit"
    stated = {topic.stated_unit(path) for path in angles}
    if len(stated) == 1 and stated <= {"deg", "rad"}:
        return Setting(key, stated.pop(), _STATED)
    largest = max(abs(topic.scalars[path]) for path in angles)
    if largest > _FULL_CIRCLE:
        return Setting(key, "deg", f"an angle of {largest:.3g} cannot be in radians")
    return Setting(key, "deg", open=f"deg or rad; the largest angle is {largest:.3g}")


def _reference_fields(topic: ProbedTopic) -> dict[str, str]:
    """Find the fields of a solution, by quantity; none where it has neither a place nor an attitude."""
    found = reference_columns(topic.scalars)
    for together in (PLACE, ATTITUDE):
        if not found.keys() >= set(together):
            found = {
                quantity: path for quantity, path in found.items() if quantity not in together
            }
    if "latitude" not in found:
        found |= _positions_in_metres(topic)
    if not found.keys() & {*PLACE, *ATTITUDE, "local_position"}:
        return {}
    if "latitude" in found and "depth" not in found:
        height = _negative_altitude(topic)
        if height is not None:
            found["height"] = height
    velocity = velocity_columns(topic.scalars)
    # The velocities are named north, east and down: `axes` would turn them, too.
    if velocity is not None and found.get("axes") != "enu_flu":
        found["velocity_n"] = velocity
    return found


def _positions_in_metres(topic: ProbedTopic) -> dict[str, str]:
    """Find positions that are named by directions, and the axes that these are; none that are in another unit."""
    by_direction = positions_by_direction(topic.scalars)
    if by_direction is None:
        return {}
    path, axes = by_direction
    stated = topic.stated_unit(path)
    if stated and stated not in LENGTH_UNITS:
        return {}
    return {"local_position": path, "axes": axes}


def _negative_altitude(topic: ProbedTopic) -> str | None:
    """Return an altitude that is a height: none above the bottom is negative."""
    for path, median in topic.scalars.items():
        if _ALTITUDE.search(path.lower()) and median < 0.0:
            return path
    return None
