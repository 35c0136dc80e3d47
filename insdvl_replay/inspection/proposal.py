"""Settings to start from, for a log that cannot be replayed as it is.

There are three steps. Each one reads the log with the findings of the step before: the topic, fields and stamp of each
role; their units; whether their clocks agree. Trials find axes. Blockers that remain are reported too.

Each setting has the observation behind it, the alternatives, and whether a person must decide. A key whose value only
a person can know is a comment. Every other key has the likeliest value, so the proposal can be used as it is.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.checks.imu import SPIN_RADPS
from insdvl_replay.checks.reference import velocity_misfit
from insdvl_replay.core.config import Config, Imu, Initial
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note, listed
from insdvl_replay.core.states import (
    BY_SENSOR,
    SENSORS,
)
from insdvl_replay.core.units import (
    ANGULAR_RATE_UNITS,
    SPECIFIC_FORCE_BY_SIZE,
    SPECIFIC_FORCE_UNITS,
    VELOCITY_BY_SIZE,
    VELOCITY_UNITS,
)
from insdvl_replay.inspection.dry_run import (
    AS_GRAVITY_MPS2,
    DryRun,
    FieldMatch,
    ProbedTopic,
    fitting_units,
    probe_topics,
    time_paths,
)
from insdvl_replay.inspection.inventory import Blocker
from insdvl_replay.inspection.ping_flags import flag_senses
from insdvl_replay.inspection.settings import Alternative, Setting, not_yet_set, with_settings
from insdvl_replay.inspection.table_clocks import table_clock_settings
from insdvl_replay.logs.columns.flags import flag_columns
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.tables import (
    LARGEST_JITTER_S,
    clock_notes,
    read_sample,
    read_tables,
    stamp_path,
    stamp_unit,
)
from insdvl_replay.logs.columns.topics import PROPOSED, Source
from insdvl_replay.logs.formats.fields import TABLE
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.read import Finding, find_roles


def _fields(key: str, candidates: Sequence[FieldMatch], to_decide: str = "") -> Setting:
    """Propose the first of some fields, with the others as alternatives."""
    first, *others = candidates
    name = key.partition(".")[2]
    return Setting(
        key,
        first.path,
        str(first),
        to_decide,
        tuple(_instead(name, other) for other in others),
    )


def _instead(name: str, field: FieldMatch) -> Alternative:
    return Alternative(f'{name} = "{field.path}"', str(field))


# --- The clocks.

_ENOUGH: Final = 1000
_HEADER: Final = "header.stamp"
_CLOCK_NAMES: Final = re.compile(
    r"time|stamp|clock|epoch|utc|tick|^t$|(^|_)(t_|ts$)|_([mun]s|sec)$"
)
# Share of the sample's length by which a clock may wander; what counts from the message before does not run at all.
_MOST_SPREAD: Final = 0.05


def _apart(clock: Clock) -> str:
    return f"log time minus stamp is {clock.log_minus_stamp_s:.3f} s (median)"


def _stamp(log: Recording, seen: ProbedTopic, role: str) -> Iterator[Setting]:
    """Propose the stamp of a topic: a field that agrees with the recorder's clock. Tables need none."""
    if seen.is_table:
        return
    clocks: list[tuple[Clock, str]] = []
    times = sorted(time_paths(seen.known), key=lambda path: path != _HEADER)
    named = [path for path in seen.scalars if _CLOCK_NAMES.search(path.rpartition(".")[2].lower())]
    for path in (*times, *named):
        stamp = "header" if path == _HEADER else path
        source = Source("", seen.topic, seen.channel.type_name, (seen.channel,), {}, stamp, 0.0)
        with suppress(LogError):
            table = read_sample(log, source, _ENOUGH)
            clock = table.clock()
            recorded = table.columns["log_time"][:, 0]
            spread_s = min(
                LARGEST_JITTER_S, _MOST_SPREAD * float(recorded[-1] - recorded[0]) * 1e-9
            )
            if clock.messages < 2 or clock.spread_s < spread_s:
                numbers = table.stamp_numbers
                clocks.append(
                    (
                        clock,
                        "" if numbers is None else f", read as {stamp_unit(numbers, recorded)[1]},",
                    )
                )
    if not clocks:
        text = "no field of the messages agrees with the recorder's clock"
        yield Setting(f"{role}.stamp", "log_time", text)
        return
    (clock, unit), *others = clocks
    text = f"'{stamp_path(clock.stamp)}'{unit} agrees with the recorder's clock: {_apart(clock)}"
    stamps = tuple(Alternative(f'stamp = "{other.stamp}"') for other, _ in others)
    yield Setting(f"{role}.stamp", clock.stamp, text, others=stamps)


def _recorder_stamps(
    log: Recording, findings: Sequence[Finding], clocks: Sequence[Clock], config: Config
) -> Iterator[Setting]:
    """Stamp all roles by the recorder where their own clocks do not belong together."""
    stamps = {
        (source.role, source.topic): source.stamp
        for finding in findings
        for source in finding.sources
    }
    why = ""
    if any(clock.stamp != stamps.get((clock.role, clock.topic), clock.stamp) for clock in clocks):
        why = "not all stamps of the roles are times"
    elif clocks and clocks[0].role == "imu":
        try:
            clock_notes(str(log.path), clocks, config.clocks.max_disagreement_s)
        except LogError:
            why = "the clocks of the roles are unrelated"
    own = {clock.role: clock for clock in clocks if clock.role in (*PROPOSED, *SENSORS)}
    for role, clock in own.items() if why else ():
        yield Setting(f"{role}.stamp", "log_time", f"{why}; {clock.topic}: {_apart(clock)}")


# --- The IMU: topic and fields by their names, units and axes by gravity and the reference.

_STATED: Final = "the titles of the columns have this unit"
_AXES_NAMES: Final = {"+x+y+z": "frd", "+x-y-z": "flu"}
_AXES_OPEN: Final = 'frd, flu (y to port, z up) or a signed permutation such as "+x-z+y"; `run` and --propose find them'


def _imu_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose a topic with a specific force; an angular rate beside it and the size of gravity speak for it."""
    candidates = []
    for topic in topics:
        forces = topic.likely("specific_force")
        named = [candidate for candidate in topic.likely("angular_rate") if candidate not in forces]
        rates = named or [
            candidate for candidate in topic.likely("vector") if candidate not in forces
        ]
        if forces and rates:
            candidates.append((topic, forces, rates, bool(named)))
    if not candidates:
        return
    topic, forces, rates, is_named = max(
        candidates, key=lambda found: (found[3], bool(found[1][0].force_unit))
    )
    force = forces[0]
    yield Setting("imu.topic", topic.topic)
    yield _fields("imu.specific_force", forces)
    if force.force_unit:
        yield Setting(
            "imu.specific_force_unit", force.force_unit, "gravity has this size in this unit"
        )
    elif (unit := topic.stated_unit(force.path)) in SPECIFIC_FORCE_UNITS:
        yield Setting("imu.specific_force_unit", unit, _STATED)
    else:
        text = f"{', '.join(SPECIFIC_FORCE_BY_SIZE)}; gravity is 9.81, 1 or 1000, but the size is {force.size:.3g}"
        yield Setting("imu.specific_force_unit", "m/s2", open=text)
    yield _fields(
        "imu.angular_rate",
        rates,
        "" if is_named else "no field is named as an angular rate; check this one",
    )
    if (unit := topic.stated_unit(rates[0].path)) in ANGULAR_RATE_UNITS:
        yield Setting("imu.angular_rate_unit", unit, _STATED)
    yield Setting("imu.axes", "frd", open=_AXES_OPEN)
    yield from _stamp(log, topic, "imu")


def _measured_units(imu: ImuColumns, settings: Imu) -> Iterator[Setting]:
    """Propose units by the size of gravity, and by how fast a vehicle can turn."""
    read_in = settings.specific_force_unit or "m/s2"
    size = (
        float(np.median(np.linalg.norm(imu.specific_force_b, axis=1)))
        / SPECIFIC_FORCE_UNITS[read_in]
    )
    units = fitting_units(size, SPECIFIC_FORCE_BY_SIZE, *AS_GRAVITY_MPS2)
    if units and read_in not in units:
        yield Setting(
            "imu.specific_force_unit",
            units[0],
            f"the size is {size:.3g}, which is gravity in this unit",
        )
    if settings.angular_rate_unit is not None:
        return
    sizes = np.linalg.norm(imu.angular_rate_b, axis=1)
    median = float(np.median(sizes))
    largest = float(sizes.max())
    if median > SPIN_RADPS:
        text = f"the median is {median:.3g}, too fast for a vehicle in rad/s"
        yield Setting("imu.angular_rate_unit", "deg/s", text)
    else:
        text = f"the largest value is {largest:.3g}, possible in both units"
        yield Setting("imu.angular_rate_unit", "rad/s", text, "rad/s or deg/s, see the data sheet")


def level_axes(force: Floats) -> list[Floats]:
    """List the right-handed axes in which gravity is felt upwards, as a level vehicle feels it, the likeliest first."""
    strongest = int(np.argmax(np.abs(force)))
    down = np.zeros(3)
    down[strongest] = -np.sign(force[strongest])
    forward = [axis for axis in (*np.eye(3), *-np.eye(3)) if not axis[strongest]]
    return [np.stack([axis, np.cross(down, axis), down]) for axis in forward]


def axes_text(rows: Floats) -> str:
    """Write axes as a signed permutation: forward, starboard and down in those of the instrument, (3, 3)."""
    parts = [(int(np.argmax(np.abs(row))), float(row.sum())) for row in rows]
    text = "".join(f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}" for axis, sign in parts)
    return _AXES_NAMES.get(text, text)


# --- The DVL: topic and fields by their names, unit and axes by its size and the reference.

_DVL_WORDS: Final = re.compile(r"dvl|doppler|bottom")
_FLAGS: Final = re.compile(r"valid|lock|good")
# speeds over ground of a vehicle under way
_SLOWEST_MPS = 0.1
_QUICKEST_MPS = 5.0


def _flag_settings(log: Recording, topic: ProbedTopic, velocity: str) -> Iterator[Setting]:
    """Propose the flags of valid or invalid pings."""
    names = flag_columns(topic.scalars).names
    likely = [path for path in topic.scalars if _FLAGS.search(path.lower()) and path not in names]
    senses = flag_senses(log, topic, velocity, names) if names else {}
    for key in ("valid", "invalid"):
        chosen = {name: why for name, (sense, why) in senses.items() if sense == key}
        if chosen:
            why = "; ".join(f"'{name}' {text}" for name, text in chosen.items())
            yield Setting(f"dvl.{key}", ", ".join(chosen), why)
    open_names = [*(name for name, (sense, _) in senses.items() if not sense), *likely]
    if open_names and not any(sense for sense, _ in senses.values()):
        flags = " or ".join(f'"{name}" (median {topic.scalars[name]:g})' for name in open_names)
        yield Setting(
            "dvl.valid", None, open=f"is {flags} 0 for an invalid ping? If 0 is valid: dvl.invalid"
        )


def _dvl_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose a topic with a velocity, best with a name that is a DVL's."""
    named = [
        topic
        for topic in topics
        if _DVL_WORDS.search(f"{topic.topic} {topic.channel.type_name}".lower())
    ]
    moving = [
        topic for topic in topics if topic.likely("velocity") or topic.likely("beam_velocity")
    ]
    both = [topic for topic in named if topic in moving]
    candidates = [*both, *moving, *(topic for topic in named if topic.likely("vector"))]
    if not candidates:
        return
    topic = candidates[0]
    beams, velocities, valid = (
        topic.likely(quantity) for quantity in ("beam_velocity", "velocity", "beam_valid")
    )
    velocities = velocities if beams or velocities else topic.likely("vector")
    yield Setting("dvl.topic", topic.topic)
    if velocities:
        yield _fields("dvl.velocity", velocities)
        yield Setting("dvl.kind", "velocity")
        yield Setting("dvl.axes", "frd", open=_AXES_OPEN)
    for velocity in [*velocities, *beams][:1]:
        if (stated := topic.stated_unit(velocity.path)) in VELOCITY_UNITS:
            yield Setting("dvl.velocity_unit", stated, _STATED)
            continue
        units = fitting_units(velocity.size, VELOCITY_BY_SIZE, _SLOWEST_MPS, _QUICKEST_MPS)
        best = units[0] if units else "m/s"
        what = "length of all beams' velocities" if velocity.is_beams else "speed"
        seen = f"in this unit the median {what} is {velocity.size * VELOCITY_UNITS[best]:.3g} m/s"
        if len(units) == 1:
            yield Setting("dvl.velocity_unit", best, f"{seen}; in any other it is not a vehicle's")
        else:
            yield Setting(
                "dvl.velocity_unit",
                best,
                seen,
                f"the size fits several units: {', '.join(VELOCITY_BY_SIZE)}",
            )
    if velocities:
        yield from _flag_settings(log, topic, velocities[0].path)
    if beams and velocities:
        # Until a person knows where the beams point, the velocity is the safer source.
        ways = [Alternative('kind = "beams"')]
        ways += [_instead("beam_velocity", beam) for beam in beams]
        ways += [Alternative(f'beam_valid = "{flag.path}"') for flag in valid]
        text = "beams give more, if you know their angles: set kind, beam_velocity, beam_valid, beam_tilt_deg"
        yield Setting("dvl.kind", "velocity", text, others=tuple(ways))
    elif beams:
        count = beams[0].median.size
        azimuths = tuple(45.0 + 360.0 * beam / count for beam in range(count))
        yield _fields("dvl.beam_velocity", beams)
        yield from (Setting("dvl.beam_valid", flag.path) for flag in valid[:1])
        yield Setting(
            "dvl.beam_tilt_deg", 30.0, open="angle from the instrument's z axis, see the data sheet"
        )
        yield Setting(
            "dvl.beam_azimuth_deg",
            azimuths,
            open="angles from forward towards starboard, one for each beam",
        )
    yield from _stamp(log, topic, "dvl")
    yield Setting(
        "dvl.lever_arm_m",
        (0.0, 0.0, 0.0),
        open="from IMU to DVL: forward, starboard, down; measure it",
    )
    yield Setting(
        "dvl.mounting_rpy_deg",
        (0.0, 0.0, 0.0),
        open="DVL axes to body: roll, pitch, heading; measure them",
    )


# --- The reference: topic and fields by their names, and in which frame its velocity is.

# An altitude is no height here: most vehicles mean that above the bottom.
_REFERENCE_WORDS: Final = {
    "latitude": re.compile(r"(^|[._])lat(itude)?([._]|$)"),
    "longitude": re.compile(r"(^|[._])(lon|lng|long|longitude)([._]|$)"),
    "depth": re.compile(r"(^|[._])depth([._]|$)"),
    "roll": re.compile(r"(^|[._])roll([._]|$)"),
    "pitch": re.compile(r"(^|[._])pitch([._]|$)"),
    "heading": re.compile(r"(^|[._])(heading|hdg|yaw)([._]|$)"),
}
_ALTITUDE: Final = re.compile(r"(^|[._])(alt(itude)?|height)([._]|$)")
_PLACE: Final = ("latitude", "longitude")
_ATTITUDE: Final = ("roll", "pitch", "heading")
_NORTH: Final = re.compile(r"(?i)(.*(?:v|vel|velocity)_?)(n|north)")
_EAST_AND_DOWN: Final = {"n": ("e", "d"), "north": ("east", "down")}
_FULL_CIRCLE: Final = 6.3  # no angle in radians is larger
_FITS: Final = 0.1  # share of the distance by which velocity and positions may differ
_FITS_CLEARLY: Final = 0.3
_MEANT: Final = (
    "is this a solution to start from and to compare with? Roll must be positive starboard side down, pitch bow up, "
    "heading from north over east"
)


def _reference_settings(log: Recording, topics: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """Propose the topic with the most of a position, a velocity and an attitude."""
    found = [(topic, _reference_fields(topic)) for topic in topics]
    topic, fields = max(found, key=lambda pair: len(pair[1]), default=(None, {}))
    if topic is None or not fields:
        return
    yield Setting("reference.topic", topic.topic, open=_MEANT)
    yield from (Setting(f"reference.{quantity}", path) for quantity, path in fields.items())
    angles = (*_PLACE, *_ATTITUDE)
    largest = max(
        abs(topic.scalars[path]) for quantity, path in fields.items() if quantity in angles
    )
    stated = {topic.stated_unit(path) for quantity, path in fields.items() if quantity in angles}
    key = "reference.angle_unit"
    if len(stated) == 1 and stated <= {"deg", "rad"}:
        yield Setting(key, stated.pop(), _STATED)
    elif largest > _FULL_CIRCLE:
        yield Setting(key, "deg", f"an angle of {largest:.3g} cannot be in radians")
    else:
        yield Setting(key, "deg", open=f"deg or rad; the largest angle is {largest:.3g}")
    yield from _stamp(log, topic, "reference")


def _reference_fields(topic: ProbedTopic) -> dict[str, str]:
    """Find the fields of a solution; angles only where none is missing."""
    found: dict[str, str] = {}
    for quantity, words in _REFERENCE_WORDS.items():
        if paths := [path for path in topic.scalars if words.search(path.lower())]:
            found[quantity] = paths[0]
    for together in (_PLACE, _ATTITUDE):
        if not found.keys() >= set(together):
            found = {quantity: path for quantity, path in found.items() if quantity not in together}
    if not found.keys() & {*_PLACE, *_ATTITUDE}:
        return {}
    below = [
        path
        for path, median in topic.scalars.items()
        if _ALTITUDE.search(path.lower()) and median < 0.0
    ]
    if below and "latitude" in found and "depth" not in found:
        found["height"] = below[0]  # no altitude above the bottom is negative
    # Fields such as ``vn``, ``ve``, ``vd`` or ``vel_north``, ``vel_east``, ``vel_down``.
    for path in topic.scalars:
        match = _NORTH.fullmatch(path)
        names = (
            [path, *(f"{match[1]}{other}" for other in _EAST_AND_DOWN.get(match[2], ()))]
            if match
            else []
        )
        if len(names) == 3 and topic.scalars.keys() >= set(names):
            return found | {"velocity_n": ", ".join(names)}
    return found


def _measured_reference(log: Recording, source: Source, config: Config) -> Iterator[Setting]:
    """Propose that a velocity is in the axes of the world, if only that fits the positions of the topic.

    `nav_msgs/Odometry` has it in the body by definition, but Gazebo writes it in the world.
    """
    if (
        config.reference.velocity_n is not None
        or not {"velocity_b", "local_position"} <= source.fields.keys()
    ):
        return
    path = source.fields["velocity_b"]
    # The place on Earth does not matter for displacements.
    place = msgspec.structs.replace(config.initial, latitude_deg=config.initial.latitude_deg or 0.0)
    misfits = []
    try:
        table = read_tables(log, [source])[0]
        for fields in ({}, {"velocity_n": path}):
            settings = msgspec.structs.replace(
                config.reference, velocity_n=fields.get("velocity_n")
            )
            read = replace(table, source=replace(source, fields={**source.fields, **fields}))
            columns, _ = decode_reference([read], settings, place)
            misfits.append(None if columns is None else velocity_misfit(columns))
    except LogError:  # a reference that cannot be read is reported where it is used
        return
    in_body, in_world = misfits
    if (
        in_body is not None
        and in_world is not None
        and in_world <= min(_FITS, _FITS_CLEARLY * in_body)
    ):
        text = (
            f"in the axes of the world it differs by {in_world:.1%} from the displacements of the positions; in the "
            f"axes of the body, as its type defines it, by {in_body:.0%}"
        )
        yield Setting("reference.velocity_n", path, text)


# --- The whole.

# What is proposed for each role, its topic first, and what a person must name where none is found.
_ROLES: Final = (
    ("imu", _imu_settings, ("specific_force", "angular_rate")),
    ("dvl", _dvl_settings, ("velocity",)),
    ("reference", _reference_settings, ()),
)
_REFERENCE: Final = 2  # its place among the findings
_LONGEST: Final = 12  # topics that are listed at most
_DEFAULTS: Final = (
    "frd",
    "rad/s",
)  # what a known type is taken to give; only something else is worth a setting


@dataclass(frozen=True)
class Proposal:
    """Settings that nobody has made yet."""

    settings: tuple[Setting, ...]
    blockers: tuple[Blocker, ...] = ()  # what stops a replay with them too
    notes: tuple[Note, ...] = ()
    table_clocks: tuple[
        Setting, ...
    ] = ()  # those of the settings that correct the clocks of tables
    clocks: tuple[Clock, ...] = ()  # by the stamps that the roles have without the settings


def propose_settings(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False
) -> Proposal:
    """Propose what a replay lacks, by all messages of the roles.

    Raises
    ------
    LogError
        The file cannot be read, or is damaged and must not be.
    """
    log = open_recording(path, allow_damaged=allow_damaged)
    with log.watched():
        findings = find_roles(str(log.path), log.channels, config)
        seen = DryRun(log, config, deep=False)
        seen.examine(findings)
        return propose(log, findings, seen, config, whole_reference=True)


def propose(
    log: Recording,
    findings: Sequence[Finding],
    seen: DryRun,
    config: Config,
    *,
    whole_reference: bool = False,
) -> Proposal:
    """Propose what a replay lacks, by what was seen of the roles; else what settles a contradiction.

    It takes the whole reference to find in which frame its velocity is.
    """
    if not seen.blockers and not list(_start(findings, config.initial)):
        contradicted = any(note.code == "reference_contradiction" for note in seen.notes)
        sources = findings[_REFERENCE].sources if contradicted or whole_reference else ()
        return Proposal(
            tuple(
                setting
                for source in sources
                for setting in _measured_reference(log, source, config)
            )
        )
    fields, unseen = _unknown_topics(log, findings, config)
    settings = [*_choices(findings, seen), *not_yet_set(fields, config)]
    clocks: list[Setting] = []
    if any(channel.encoding == TABLE for channel in log.channels):
        clocks = not_yet_set(table_clock_settings(log, with_settings(config, settings)), config)
        settings += clocks
    whole_reference = whole_reference or seen.deep
    settings += _measured(
        log, with_settings(config, settings), settings, seen.deep, whole_reference
    )
    draft = with_settings(config, settings)
    found = find_roles(str(log.path), log.channels, draft)
    settings += _start(found, draft.initial)
    last = DryRun(log, with_settings(config, settings), deep=False)
    last.examine(found)
    notes = []
    if unseen:
        text = f"too many fields: these topics were ignored for the proposal: {listed(unseen)}"
        hint = "set the topic of each role: imu.topic, dvl.topic, reference.topic"
        notes.append(Note("topics_not_looked_at", text, len(unseen), hint=hint))
    return Proposal(
        tuple(settings), tuple(last.blockers), tuple(notes), tuple(clocks), tuple(seen.clocks)
    )


def _choices(findings: Sequence[Finding], seen: DryRun) -> Iterator[Setting]:
    """Choose between topics that could each play a role, those without warnings first; one alone that can is chosen.

    As far as settings can: none names that of the true biases.
    """
    for finding in findings:
        if finding.error and finding.candidates and finding.role in Config.__struct_fields__:
            topics = [source.topic for source in finding.candidates]
            # Those that cannot be it last, before them those with warnings.
            first, *others = sorted(
                topics, key=lambda topic: (topic in seen.refused, topic in seen.warned)
            )
            key = f"{finding.role}.topic"
            if first not in seen.refused and all(topic in seen.refused for topic in others):
                yield Setting(
                    key, first, "; ".join(f"not {topic}: {seen.refused[topic]}" for topic in others)
                )
            else:
                lines = (f"topic = {toml_value(topic)}" for topic in others)
                ways = tuple(map(Alternative, lines))
                yield Setting(key, first, open="each of these is possible", others=ways)


def _unknown_topics(
    log: Recording, findings: Sequence[Finding], config: Config
) -> tuple[list[Setting], Sequence[str]]:
    """Find topics of unknown types for the roles that no topic of a known type plays; name those not looked at."""
    wanted = {
        finding.role for finding in findings if not finding.sources and not finding.candidates
    }
    if config.initial.source != "reference":
        wanted -= {"reference"}
    if not wanted:
        return [], ()
    taken = {
        source.topic
        for finding in findings
        for source in finding.sources
        if source.role != "reference"
    }
    seen, unseen = probe_topics(
        log, [channel for channel in log.channels if channel.topic not in taken]
    )
    settings: list[Setting] = []
    for role, settings_of, needed in _ROLES:
        if role in wanted:
            named = getattr(config, role).topic
            free = [
                topic
                for topic in seen
                if role != "imu" or topic.is_table or topic.topic != config.dvl.topic
            ]
            # The topic alone that the configuration names, if the log has it. The topic of one role is no other's, but
            # a table may have the columns of several.
            candidates = [topic for topic in free if topic.topic == named] or free
            proposed = list(settings_of(log, candidates))
            settings += proposed or _listed(role, needed, candidates)
            seen = [
                topic
                for topic in seen
                if topic.is_table or not proposed or topic.topic != proposed[0].value
            ]
    return settings, unseen


def _listed(role: str, needed: Sequence[str], seen: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """List every field with numbers, that a person may choose."""
    if not seen or not needed:
        return
    often = sorted(seen, key=lambda topic: -topic.channel.messages)
    lines = []
    for topic in often[:_LONGEST]:
        lines.append(f'"{topic.topic}", {topic.channel.messages} messages')
        for candidate in topic.candidates:
            lines += [f'  "{candidate.path}"', f"    {candidate}"]
        lines += [f'  "{path}", median {median:.3g}' for path, median in topic.scalars.items()]
    if (more := len(often) - _LONGEST) > 0:
        lines.append(f"and {more} topics with fewer messages")
    text = "no topic has fields with the names of this role; all topics with numbers, and their fields:"
    yield Setting(f"{role}.topic", None, open=text, listed=tuple(lines))
    for quantity in needed:
        text = 'a field of three numbers, or three fields such as "p, q, r"'
        others: tuple[Alternative, ...] = ()
        if quantity == "velocity":
            others = (Alternative("beam_velocity =", "one number for each beam"),)
        yield Setting(f"{role}.{quantity}", None, open=text, others=others)


def _measured(
    log: Recording, config: Config, settings: Sequence[Setting], deep: bool, whole_reference: bool
) -> list[Setting]:
    """Evaluate units and clocks by what the messages show, read as proposed so far."""
    findings = find_roles(str(log.path), log.channels, config)
    seen = DryRun(log, config, deep)
    seen.examine(findings)
    imu = seen.columns.imu
    named = {setting.key for setting in settings}
    measured = not_yet_set(_recorder_stamps(log, findings, seen.clocks, config), config)
    if imu is not None:
        (source,) = findings[0].sources
        found = list(_measured_units(imu, source.completed(config.imu)))
        if "imu.angular_rate" not in named:
            # Of a known type only what is unlike it, and of which topic it holds.
            unlike = [setting for setting in found if setting.value not in _DEFAULTS]
            found = [replace(setting, seen=f"{source.topic}: {setting.seen}") for setting in unlike]
        measured += found
    for source in findings[_REFERENCE].sources if whole_reference else ():
        measured += _measured_reference(log, source, config)
    return measured


def _start(findings: Sequence[Finding], initial: Initial) -> Iterator[Setting]:
    """Name the keys without which a replay has no start, by what the type of the reference can give."""
    reference = next(finding for finding in findings if finding.role == "reference")
    if reference.candidates:
        return
    given = {quantity for source in reference.sources for quantity in source.fields}
    if not given and initial.source == "reference":
        yield Setting(
            "initial.source",
            "level",
            "no reference to start from; roll and pitch come from gravity",
        )
    posed = initial.source == BY_SENSOR or (
        initial.source == "reference" and given & {"quaternion", "roll"}
    )
    if initial.heading_deg is None and not posed:
        text = f'heading at the start, from north over east; "{BY_SENSOR}" if the log has an AHRS or a compass'
        yield Setting("initial.heading_deg", None, open=text)
    if initial.latitude_deg is None and "latitude" not in given:
        yield Setting(
            "initial.latitude_deg",
            None,
            open="for gravity and Earth rate; half a degree is accurate enough",
        )
