"""Who plays which role in a log, in which units and axes: all that could be the IMU or the DVL is tried."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from insdvl_replay.calibration.found import Given, with_values
from insdvl_replay.checks.dvl import median_speed_mps
from insdvl_replay.checks.imu import ENOUGH, length_refusal, rate_remark
from insdvl_replay.checks.reference import is_of_dvl, says_anything
from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
)
from insdvl_replay.core.errors import LogError, Note, UserError, counted, error_context
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.core.states import DEG, FASTEST_MPS, GRAVITY_MPS2
from insdvl_replay.core.units import (
    ANGULAR_RATE_UNITS,
    SPECIFIC_FORCE_UNITS,
    VELOCITY_UNITS,
)
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import look_down
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.clock_words import clock_words, is_other_clock
from insdvl_replay.inspection.free_turns import in_body, turn_freely
from insdvl_replay.inspection.proposal import Proposal, propose_settings
from insdvl_replay.inspection.settings import Setting, with_settings
from insdvl_replay.inspection.signed_axes import axes_text
from insdvl_replay.inspection.trials import (
    CLEARLY,
    CONSISTENT,
    DEG_PER_S,
    LEAST_MPS,
    NOT_FAR_OFF,
    Hypothesis,
    Trials,
    as_reference_moves,
    rates_compared,
    rpy_of,
    thinned,
    trial_config,
)
from insdvl_replay.inspection.unit_by_size import (
    force_units,
    is_rate_in_degrees,
    nearest_force_unit,
    speed_units,
)
from insdvl_replay.inspection.unit_by_track import unit_by_track
from insdvl_replay.logs.columns.imu import FRD, decode_imu, in_frd, measured_vectors
from insdvl_replay.logs.columns.tables import Table, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.file_clocks import align_files
from insdvl_replay.logs.formats.fields import TABLE, split_paths
from insdvl_replay.logs.formats.readers import column_of
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.read import (
    Finding,
    RoleColumns,
    find_roles,
    single_references,
    sources_of,
)

SAME_MOTION: Final = 0.9  # correlation of the rates of two IMUs of one vehicle
LARGEST_APART: Final = 0.05  # share by which their scales may differ
SAME_SPEED: Final = 1.5  # factor within which median speeds of DVL and reference agree
QUARTERS_DEG: Final = frozenset({-90.0, 0.0, 90.0, 180.0})  # headings of a DVL that are tried
_NEAR: Final = 0.1  # share by which increments of gravity over a step may be off
# Settings with which a person has said where forward is.
BODY_KEYS: Final = (
    "imu.axes",
    "imu.mounting_rpy_deg",
    "dvl.mounting_rpy_deg",
    "reference.mounting_rpy_deg",
)
UNKNOWN_LATITUDE_DEG: Final = 45.0
Topics = tuple[str, ...]  # that a role reads


@dataclass(frozen=True)
class _ImuTopic:
    """A topic that could be the IMU, with its readings in its own axes."""

    topic: str
    columns: ImuColumns
    settings: Imu  # with which it was read, and no axes
    as_read: Hypothesis  # by its type and the settings
    is_rate_stated: bool = False  # whether the settings or the titles have the unit of the rates


@dataclass(frozen=True)
class _DvlTopic:
    """A topic that could be the DVL."""

    topic: str
    pings: DvlColumns
    velocities: DvlColumns  # those that the instrument computed; the pings where there are none
    unit: str = ""  # of its velocities, where it is not as proposed


@dataclass(frozen=True)
class RoleReadings:
    """What could play the roles of a log."""

    place: str
    draft: Config  # as proposed by names, types and sizes
    imus: Sequence[_ImuTopic]
    dvls: Sequence[_DvlTopic]
    reference: ReferenceColumns | None
    reference_topics: Topics = ()  # of the reference
    has_other_references: bool = False  # that can be tried in its place
    clocks: tuple[Setting, ...] = ()  # that correct the times of tables
    notes: tuple[Note, ...] = ()  # topics that were left out, with the reason
    is_alone: frozenset[str] = frozenset()  # roles for which the log has one topic


@dataclass
class _LeftOut:
    """Topics that cannot play a role, with the reason."""

    place: str
    errors: dict[str, UserError] = field(default_factory=dict)  # the first of each topic
    notes: list[Note] = field(default_factory=list)

    def add(
        self,
        role: str,
        topic: str,
        error: UserError,
    ) -> None:
        """Leave out a topic, for the first reason that there is."""
        if topic in self.errors:
            return
        self.errors[topic] = error
        reason = error.inside(self.place, topic)
        name = role.upper() if role in ("imu", "dvl") else role
        self.notes.append(
            note(
                "found_left_out",
                role=role,
                name=name,
                topic=topic,
                why=reason,
            )
        )


def read_roles(
    paths: Path | Sequence[Path],
    given: Config,
    *,
    allow_damaged: bool,
    without: Collection[Topics] = (),
) -> RoleReadings:
    """Read all topics that could be the IMU or the DVL, and the first usable reference that is not left out.

    A topic that cannot be used is left out with a note, as long as another one can. LogError where no topic is the IMU
    or the DVL.
    """
    proposal = propose_settings(paths, given, allow_damaged=allow_damaged)
    draft = with_settings(given, proposal.settings)
    log = open_recording(paths, allow_damaged=allow_damaged)
    place = str(log.path)
    left_out = _LeftOut(place)
    with log.watched():
        proposed = {finding.role: finding for finding in find_roles(place, log.channels, draft)}
        by_type = {finding.role: finding for finding in find_roles(place, log.channels, given)}
        _require_roles(proposed, given)
        align_files(log, sources_of(proposed.values()), draft)
        imu_sources = by_type["imu"].candidates or proposed["imu"].sources
        dvl_sources = by_type["dvl"].candidates or proposed["dvl"].sources
        imus = _imu_topics(log, imu_sources, draft, given, left_out)
        singles = single_references(place, log.channels, given)
        references = _References(log, draft, given, left_out, proposed["reference"].sources)
        references.wait(singles, without)
        reference = references.read_next()
        dvls = _dvl_topics(log, dvl_sources, draft, given, reference, left_out)
        _require_motion(place, dvls)
        if given.reference.topic is None:
            reference = references.independent(reference, dvls)
    is_alone = set()
    if len(imu_sources) == 1:
        is_alone.add("imu")
    if len(dvl_sources) == 1:
        is_alone.add("dvl")
    return RoleReadings(
        place=place,
        draft=references.draft,
        imus=imus,
        dvls=dvls,
        reference=reference,
        reference_topics=references.topics,
        has_other_references=bool(references.waiting),
        clocks=proposal.table_clocks,
        notes=(*left_out.notes, *_stamp_notes(proposal)),
        is_alone=frozenset(is_alone),
    )


def _require_roles(proposed: Mapping[str, Finding], given: Config) -> None:
    """Raise the error of the first role that nothing plays: the DVL, the IMU, or the reference that is named."""
    needed = ["dvl", "imu"]
    if given.reference.topic:
        needed.append("reference")
    for role in needed:
        error = proposed[role].error
        if error is not None:
            raise error


def _require_motion(place: str, dvls: Sequence[_DvlTopic]) -> None:
    speed_mps = max(median_speed_mps(dvl.pings) for dvl in dvls)
    if speed_mps < LEAST_MPS:
        text = f"the median speed of the DVL is {speed_mps:.2g} m/s, too slow to find settings"
        hint = "use a dive with turns and changes of speed, or give the settings with -c"
        raise LogError(text, hint, place)


def _topic_of_reference(reference: ReferenceColumns, dvls: Sequence[_DvlTopic]) -> str | None:
    """Return the topic of a DVL whose velocities a reference repeats; None if it is another source."""
    for dvl in dvls:
        if is_of_dvl(reference, dvl.velocities):
            return dvl.topic
    return None


class _References:
    """What could be the reference: what is proposed, then each topic by itself, which is read where others fail."""

    def __init__(
        self,
        log: Recording,
        draft: Config,
        given: Config,
        left_out: _LeftOut,
        proposed: Sequence[Source],
    ) -> None:
        self.log = log
        self.proposed_draft = draft
        # With the reference that was read last; it ignores all where none can be used.
        self.draft = draft
        self.left_out = left_out
        self.proposed = proposed
        asked = given.reference
        self.is_asked = asked.topic is not None or asked.fix is not None or draft.reference.ignore
        self.is_reduced = False  # by those that contradict the other sensors
        self.topics: Topics = ()  # of the reference that was read last
        self.waiting: list[Sequence[Source]] = []
        self.repeating: dict[str, str] = {}  # topic of a DVL whose velocities each repeats

    def wait(self, singles: Iterable[Source], without: Collection[Topics]) -> None:
        """Put what can be tried in order, each once."""
        known = set(without)
        self.is_reduced = bool(known)
        for sources in (self.proposed, *((single,) for single in singles)):
            topics = _topics_of(sources)
            if topics and topics not in known:
                self.waiting.append(sources)
                known.add(topics)

    def read_next(self) -> ReferenceColumns | None:
        """Return the next one that can be read and says anything."""
        while self.waiting:
            sources = self.waiting.pop(0)
            if sources[0].topic in self.repeating:
                continue
            draft = self.proposed_draft
            if sources is not self.proposed:
                draft = with_values(draft, "reference", topic=sources[0].topic)
            columns = RoleColumns(str(self.log.path), draft)
            try:
                columns.decode("reference", read_tables(self.log, sources))
            except UserError as error:
                self.left_out.add("reference", sources[0].topic, error)
                continue
            if columns.reference is not None and says_anything(columns.reference):
                self.draft = draft
                self.topics = _topics_of(sources)
                return columns.reference
        self.topics = ()
        self.draft = self.proposed_draft
        if self._misleads():
            self.draft = with_values(self.draft, "reference", ignore=True)
        return None

    def independent(
        self, reference: ReferenceColumns | None, dvls: Sequence[_DvlTopic]
    ) -> ReferenceColumns | None:
        """Return a reference, or the next one, whose velocities are not those of a DVL."""
        while reference is not None:
            of_dvl = _topic_of_reference(reference, dvls)
            if of_dvl is None:
                break
            self.repeating[self.topics[0]] = of_dvl
            reference = self.read_next()
        if reference is None and self.repeating:
            self.draft = with_values(self.draft, "reference", ignore=True)
        for topic, of_dvl in self.repeating.items():
            if reference is not None:
                self.left_out.notes.append(
                    note("found_left_out same_velocities", topic=topic, dvl=of_dvl)
                )
            else:
                self.left_out.notes.append(note("found_reference same_velocities", topic=of_dvl))
        return reference

    def _misleads(self) -> bool:
        """Return whether a replay would read a proposed reference that cannot be used, and that nobody asked for."""
        if self.is_asked or not self.proposed:
            return False
        return self.is_reduced or self.proposed[0].topic in self.left_out.errors


def _topics_of(sources: Sequence[Source]) -> Topics:
    return tuple(source.topic for source in sources)


def _dvl_topics(
    log: Recording,
    sources: Sequence[Source],
    draft: Config,
    given: Config,
    reference: ReferenceColumns | None,
    left_out: _LeftOut,
) -> list[_DvlTopic]:
    """Read the topics that could be the DVL; those that cannot are left out.

    Where none is left, the error of the first is raised.
    """
    dvls = []
    for source in sources:
        try:
            dvls.append(_dvl_topic(log, source, draft, given, reference))
        except UserError as error:
            left_out.add("dvl", source.topic, error)
    if not dvls:
        raise left_out.errors[sources[0].topic]
    return dvls


def _dvl_topic(
    log: Recording,
    source: Source,
    draft: Config,
    given: Config,
    reference: ReferenceColumns | None,
) -> _DvlTopic:
    """Read a topic in the unit in which its speeds are those of the reference, or of a vehicle."""
    (table,) = read_tables(log, [source])
    pings, velocities = _pings_and_velocities(log, table, draft)
    own_unit = ""
    unit = _velocity_unit(pings, velocities, reference, draft)
    if unit != (draft.dvl.velocity_unit or "m/s") and given.dvl.velocity_unit is None:
        own_unit = unit
        in_unit = with_values(draft, "dvl", velocity_unit=unit)
        pings, velocities = _pings_and_velocities(log, table, in_unit)
    return _DvlTopic(source.topic, pings, velocities, own_unit)


def _pings_and_velocities(
    log: Recording, table: Table, config: Config
) -> tuple[DvlColumns, DvlColumns]:
    """Read pings, and those with the velocities that the instrument computed, else the pings again."""
    pings = _decoded(log, table, config)
    if pings.velocity_d is None and "velocity" in table:
        with suppress(UserError):
            return pings, _decoded(log, table, with_values(config, "dvl", kind="velocity"))
    return pings, pings


def _decoded(log: Recording, table: Table, config: Config) -> DvlColumns:
    columns = RoleColumns(str(log.path), config)
    columns.decode("dvl", [table])
    return columns.dvl


def _stamp_notes(proposal: Proposal) -> Iterator[Note]:
    """Report the roles whose clocks are not the recorder's, so that the log times are used."""
    by_recorder = set()
    for setting in proposal.settings:
        if setting.name == "stamp" and setting.value == "log_time":
            by_recorder.add(setting.section)
    apart = [
        clock for clock in proposal.clocks if clock.role in by_recorder and is_other_clock(clock)
    ]
    if not apart:
        return
    said = "; ".join(clock_words(clock) for clock in apart)
    yield note(
        "found_clocks log_times",
        clocks=said,
        role=apart[0].role,
    )


def _velocity_unit(
    pings: DvlColumns, velocities: DvlColumns, reference: ReferenceColumns | None, draft: Config
) -> str:
    """Return the unit in which velocities, read as in the draft, are those of the reference, else of a vehicle."""
    read_in = draft.dvl.velocity_unit or "m/s"
    unit = _unit_by_speed(median_speed_mps(pings), reference, read_in)
    if unit == "m/s" == read_in and reference is not None:
        return unit_by_track(velocities, reference) or unit
    return unit


def _unit_by_speed(speed_mps: float, reference: ReferenceColumns | None, read_in: str) -> str:
    """Return the unit in which a median speed is that of the reference, else of a vehicle."""
    size = speed_mps / VELOCITY_UNITS[read_in]
    known_mps = 0.0 if reference is None else _reference_speed_mps(reference)
    if known_mps / SAME_SPEED < speed_mps < known_mps * SAME_SPEED:
        return read_in
    fitting = speed_units(size, (known_mps / SAME_SPEED, known_mps * SAME_SPEED))
    if not fitting and speed_mps > FASTEST_MPS:
        fitting = speed_units(size)
    if fitting:
        return fitting[0]
    return read_in


def _reference_speed_mps(reference: ReferenceColumns) -> float:
    """Return the median speed; 0 where no velocity is known."""
    speeds_mps = np.linalg.norm(reference.velocity_n, axis=1)
    known_mps = speeds_mps[np.isfinite(speeds_mps)]
    if not len(known_mps):
        return 0.0
    return float(np.median(known_mps))


@dataclass(frozen=True)
class _Pair:
    """Topics of an IMU and a DVL that were tried together."""

    trials: Trials
    imu: _ImuTopic
    dvl: _DvlTopic


def with_roles(read: RoleReadings, given: Given, notes: list[Note]) -> tuple[Config, float]:
    """Choose the topics of IMU and DVL by trial runs, with their units, axes and signs; return the cost of the best."""
    draft = read.draft
    pairs = _tried_pairs(read, given)
    first = pairs[0]
    free = turn_freely(first.trials, first.dvl.pings)
    _vary_likely(pairs)
    pair = pairs[0]
    trials = pair.trials
    if not np.isfinite(trials.cost):
        what = "IMU and DVL have no common time, or too few pings to try settings"
        raise LogError(what, "compare their times: insdvl-replay inspect", read.place)
    dive = Dive("", pair.imu.columns, pair.dvl.pings, reference=read.reference)
    best = as_reference_moves(trials.close, dive, draft)
    if not trials.allows(best):
        best = trials.close[0]
    in_vehicle = best
    if not given.has(*BODY_KEYS):
        is_as_read = best.axes == pair.imu.as_read.axes
        in_vehicle, sideways = in_body(best, dive, draft, is_as_read=is_as_read)
        if sideways is not None:
            notes.append(_forward_note(in_vehicle, sideways))
    if not given.has("dvl.mounting_rpy_deg"):
        _require_heading(read.place, best, trials.close)
    notes += read.notes
    others = [
        _turned_with(best, in_vehicle, rpy_deg) for rpy_deg in _rivals_of(best, trials.close)
    ]
    if free is not None and pair is first:
        others += free.alternatives(in_vehicle)
    notes.append(_imu_note(pairs, in_vehicle, read.imus))
    notes.append(dvl_note(pair.dvl.topic, in_vehicle, others))
    if pair.dvl.unit:
        notes.append(note("found_dvl unit", topic=pair.dvl.topic, unit=pair.dvl.unit))
    if read.clocks:
        times = "; ".join(
            f"{setting.key} {setting.value}, {setting.seen}" for setting in read.clocks
        )
        notes.append(note("found_clocks", times=times))
    imu = _as_configured(pair.imu, in_vehicle, given.config.imu, is_alone="imu" in read.is_alone)
    draft = msgspec.structs.replace(draft, imu=imu)
    return _with_dvl(draft, read, pair.dvl, in_vehicle), trials.cost


def _tried_pairs(read: RoleReadings, given: Given) -> list[_Pair]:
    """Try each IMU with each DVL, the best pair first; LogError if none has enough readings."""
    pairs: list[_Pair] = []
    too_few: list[LogError] = []
    config = trial_config(read.draft, UNKNOWN_LATITUDE_DEG)
    for imu in track_progress("trying IMUs and DVLs", read.imus):
        for dvl in read.dvls:
            try:
                stretch = thinned(Dive("", imu.columns, dvl.pings, reference=read.reference))
            except LogError as error:
                too_few.append(error)
                continue
            pairs.append(_Pair(Trials(stretch, config, imu.as_read, given), imu, dvl))
    if not pairs:
        with error_context(read.place):
            raise too_few[0]
    pairs.sort(key=lambda pair: pair.trials.cost)
    return pairs


def _vary_likely(pairs: list[_Pair]) -> None:
    """Vary the trials of the pairs that may be the best; the best is the first then."""
    best = pairs[0]
    for pair in pairs:
        least = min(other.trials.cost for other in pairs)
        is_near = pair.trials.cost <= NOT_FAR_OFF * least
        if is_near and (pair is best or least > CONSISTENT):
            pair.trials.vary()
    pairs.sort(key=lambda pair: pair.trials.cost)


def _require_heading(place: str, best: Hypothesis, close: Sequence[Hypothesis]) -> None:
    """Raise a LogError where the DVL fits the IMU as well with any heading."""
    headings_deg = set()
    for one in close:
        if (one.axes, one.force_axes) == (best.axes, best.force_axes):
            headings_deg.add(one.rpy_deg[2])
    if headings_deg >= QUARTERS_DEG:
        what = "the vehicle moves too little to find the mounting of the DVL: all headings fit as well"
        hint = "use a dive with turns and changes of speed, or give the settings with -c"
        raise LogError(what, hint, place)


def _with_dvl(
    draft: Config,
    read: RoleReadings,
    dvl: _DvlTopic,
    best: Hypothesis,
) -> Config:
    """Write the topic, the unit and the mounting of the DVL as settings."""
    if "dvl" not in read.is_alone:
        draft = with_values(draft, "dvl", topic=dvl.topic)
    if dvl.unit:
        draft = with_values(draft, "dvl", velocity_unit=dvl.unit)
    looks = dvl.pings.look_d
    if looks is None or look_down(looks) or any(angle % 90.0 for angle in best.rpy_deg):
        return with_values(draft, "dvl", mounting_rpy_deg=best.rpy_deg)
    # The beams point down in other axes.
    read_b = in_frd(np.eye(3), draft.dvl.axes or FRD, "dvl.axes").T
    turn = np.rint(mat_from_rpy(np.array(best.rpy_deg) * DEG))
    return with_values(draft, "dvl", axes=axes_text(turn @ read_b))


def _rivals_of(best: Hypothesis, close: Sequence[Hypothesis]) -> list[tuple[float, float, float]]:
    """Return other mountings of the DVL that are as good with the same axes of the IMU."""
    same = [one for one in close if (one.axes, one.force_axes) == (best.axes, best.force_axes)]
    return list(dict.fromkeys(one.rpy_deg for one in same if one.rpy_deg != best.rpy_deg))


def _turned_with(
    first: Hypothesis, body: Hypothesis, rpy_deg: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Turn a mounting of the DVL as the body of one hypothesis was turned to that of another one."""
    turn = body.gyro_turn @ first.gyro_turn.T
    return rpy_of(turn @ mat_from_rpy(np.array(rpy_deg) * DEG))


def _as_configured(
    imu: _ImuTopic,
    best: Hypothesis,
    given: Imu,
    *,
    is_alone: bool,
) -> Imu:
    """Write a hypothesis as settings of the IMU; what is by type and as read is left out."""
    settings = imu.settings
    values: dict[str, Any] = {"axes": best.axes, "specific_force_axes": best.force_axes}
    if (best.axes, best.force_axes) == (imu.as_read.axes, imu.as_read.force_axes):
        values = {"axes": given.axes, "specific_force_axes": given.specific_force_axes}
    elif best.axes == best.force_axes:
        values["specific_force_axes"] = None
    unit, scale = _rate_unit(imu, best)
    if unit:
        values["angular_rate_unit"] = unit
    if scale != 1.0:
        values["angular_rate_scale"] = float(f"{settings.angular_rate_scale * scale:.4g}")
    values["mounting_rpy_deg"] = best.imu_rpy_deg
    if is_alone and given.topic is None and settings.specific_force is None:
        values["topic"] = None
    return msgspec.structs.replace(settings, **values)


def _rate_unit(imu: _ImuTopic, best: Hypothesis) -> tuple[str, float]:
    """Return deg/s where rates of no stated unit are nearer to these than to rad/s, and the scale in this unit."""
    is_in_radians = imu.settings.angular_rate_unit in (None, "rad/s")
    is_open = is_in_radians and not imu.is_rate_stated
    if is_open and best.rate_scale > np.sqrt(DEG_PER_S):
        return "deg/s", best.rate_scale / DEG_PER_S
    return "", best.rate_scale


def _imu_topics(
    log: Recording,
    sources: Sequence[Source],
    draft: Config,
    given: Config,
    left_out: _LeftOut,
) -> list[_ImuTopic]:
    """Read the topics that could be the IMU; those that cannot are left out.

    Where none is left, the error of the first is raised.
    """
    imus = []
    for source in sources:
        try:
            imus.append(_imu_topic(log, source, draft, given))
        except UserError as error:
            left_out.add("imu", source.topic, error)
    if not imus and sources:
        raise left_out.errors[sources[0].topic]
    if not imus:
        raise LogError("has no readings of an IMU", "", left_out.place)
    return imus


def _increment_s(table: Table, size: float, known: Imu) -> float | None:
    """Return the step of the samples where readings of a size are increments of gravity over it; None for others."""
    if known.increment_s is not None or len(table) <= ENOUGH:
        return None
    step_s = float(np.median(np.diff(np.sort(table.time_ns())))) / NS_PER_S
    if step_s > 0.0 and abs(size / (GRAVITY_MPS2 * step_s) - 1.0) < _NEAR:
        return float(f"{step_s:.4g}")
    return None


def _imu_topic(
    log: Recording,
    source: Source,
    draft: Config,
    given: Config,
) -> _ImuTopic:
    """Read a topic in SI units, by the size of gravity and of the rates; LogError where it cannot be the IMU."""
    (table,) = read_tables(log, [source])
    is_meant = draft.imu.topic in (None, source.topic)
    own = draft.imu if is_meant else msgspec.structs.replace(Imu(), stamp=draft.imu.stamp)
    known = source.completed(own)
    as_read = Hypothesis(
        known.axes or FRD,
        known.specific_force_axes or known.axes or FRD,
        imu_rpy_deg=own.mounting_rpy_deg,
    )
    force = measured_vectors(table, "specific_force", "force", known)
    rate = measured_vectors(table, "angular_rate", "rate", known)
    sizes = np.linalg.norm(force, axis=1)
    size = _median(sizes[sizes > 0.0])
    place = str(log.path)
    if np.isnan(size):
        raise LogError(
            "has no specific force: all readings are 0 or missing", "", place, source.topic
        )
    turning = _median(np.linalg.norm(rate, axis=1))
    values: dict[str, Any] = {"topic": source.topic, "axes": FRD, "specific_force_axes": FRD}
    values["mounting_rpy_deg"] = Imu().mounting_rpy_deg
    values |= _force_scale(table, size, known)
    if "increment_s" in values:
        turning /= values["increment_s"]
    is_given = is_meant and given.imu.angular_rate_unit is not None
    is_rate_stated = is_given or _titles_have_rate_unit(source)
    if is_rate_stated:
        with error_context(place, source.topic):
            _require_possible_rate(turning / known.angular_rate_scale, known)
    elif is_rate_in_degrees(turning):
        values["angular_rate_unit"] = "deg/s"
    settings = msgspec.structs.replace(own, **values)
    columns, _ = decode_imu(table, settings)
    _require_usable(place, source.topic, columns, settings)
    return _ImuTopic(source.topic, columns, settings, as_read, is_rate_stated)


def _require_usable(place: str, topic: str, columns: ImuColumns, settings: Imu) -> None:
    """Raise a LogError where readings are too few, too slow or too short for trials."""
    if len(columns.time_ns) < ENOUGH:
        what = f"has {counted(len(columns.time_ns), 'sample')}, too few to try settings"
        raise LogError(what, "", place, topic)
    refused = rate_remark(place, columns, settings)
    if isinstance(refused, LogError):
        raise refused
    error = length_refusal(place, columns)
    if error is not None:
        raise error


def _titles_have_rate_unit(source: Source) -> bool:
    """Return whether the titles of a table state the unit of the angular rate."""
    channel = source.channels[0]
    if channel.encoding != TABLE:
        return False
    first = split_paths(source.fields["angular_rate"])[0]
    return channel.metadata.get(column_of(channel, first)) in ANGULAR_RATE_UNITS


def _require_possible_rate(median: float, known: Imu) -> None:
    """Raise a LogError where a median rate is too fast for a vehicle in the unit that is stated."""
    median_radps = median * ANGULAR_RATE_UNITS[known.angular_rate_unit or "rad/s"]
    if not is_rate_in_degrees(median_radps):
        return
    what = f"the median angular rate is {median_radps:.3g} rad/s in the unit that is stated, too fast for a vehicle"
    hint = 'name the unit that the gyros have, such as imu.angular_rate_unit = "deg/s"'
    raise LogError(what, hint)


def _median(values: Floats) -> float:
    """Return the median of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    if len(finite):
        return float(np.median(finite))
    return np.nan


def _force_scale(table: Table, size: float, known: Imu) -> dict[str, Any]:
    """Return the settings by which a median size of readings is that of gravity: a unit, an increment, or a scale."""
    unit = known.specific_force_unit or "m/s2"
    fitting = force_units(size, unit)
    if fitting and unit not in fitting:
        return {"specific_force_unit": fitting[0]}
    step_s = _increment_s(table, size, known)
    if step_s is not None:
        return {"increment_s": step_s}
    if fitting or not size > 0.0:
        return {}
    near = nearest_force_unit(size, unit)
    ratio = size * SPECIFIC_FORCE_UNITS[near] / GRAVITY_MPS2
    scale = {"specific_force_scale": float(f"{ratio:.4g}")}
    if near == unit:
        return scale
    return {"specific_force_unit": near, **scale}


def _imu_note(pairs: Sequence[_Pair], best: Hypothesis, imus: Sequence[_ImuTopic]) -> Note:
    """Report the topic of the IMU, its axes, units and scales, and which others are as good."""
    imu = pairs[0].imu
    parts = [f"IMU {imu.topic}"]
    rivals = _costs_of_others(pairs)
    if rivals:
        ratios = ", ".join(f"{topic} {ratio:.3g} times" for topic, ratio in rivals.items())
        parts.append(f"innovations of others: {ratios}")
    parts += _axes_words(imu, best)
    parts += _unit_words(imu, best)
    for other in imus:
        if other is not imu:
            parts += _other_rates(imu, other)
    is_rivalled = any(ratio * CLEARLY < 1.0 for ratio in rivals.values())
    severity = Severity.INFO
    if is_rivalled or _is_unusual(imu, best):
        severity = Severity.WARNING
    return note(
        "found_imu",
        severity=severity,
        findings="; ".join(parts),
    )


def _costs_of_others(pairs: Sequence[_Pair]) -> dict[str, float]:
    """Return by topic of each other IMU the least cost of its trials, over that of the best."""
    best = pairs[0]
    ratios: dict[str, float] = {}
    for pair in reversed(pairs):
        if pair.imu is not best.imu:
            ratios[pair.imu.topic] = pair.trials.cost / best.trials.cost
    return ratios


def _axes_words(imu: _ImuTopic, best: Hypothesis) -> Iterator[str]:
    """State the axes of an IMU, where they are not as read."""
    as_read = imu.as_read
    if (best.axes, best.force_axes) != (as_read.axes, as_read.force_axes):
        of_forces = ""
        if best.force_axes != best.axes:
            of_forces = f", of forces {best.force_axes}"
        yield f"axes {best.axes}{of_forces}"
    if any(best.imu_rpy_deg):
        yield f"built in with roll, pitch, heading {_rpy(best.imu_rpy_deg)} deg"


def _unit_words(imu: _ImuTopic, best: Hypothesis) -> Iterator[str]:
    """State in which units an IMU reads, and its scales."""
    settings = imu.settings
    found_unit, _ = _rate_unit(imu, best)
    unit = found_unit or settings.angular_rate_unit or "rad/s"
    if unit != "rad/s":
        yield f"rates in {unit}"
    scale = _gyro_scale(imu, best)
    if scale != 1.0:
        yield f"gyros read {scale:.3g} times the true rate"
    if settings.specific_force_unit is not None:
        yield f"forces in {settings.specific_force_unit}"
    if settings.increment_s is not None:
        yield f"readings are increments over {settings.increment_s} s"
    if settings.specific_force_scale != 1.0:
        yield f"accelerometers read {settings.specific_force_scale:.3g} times gravity"


def _is_unusual(imu: _ImuTopic, best: Hypothesis) -> bool:
    """Return whether an IMU reads increments, or something else than the truth."""
    settings = imu.settings
    is_scaled = _gyro_scale(imu, best) != 1.0 or settings.specific_force_scale != 1.0
    return is_scaled or settings.increment_s is not None


def _gyro_scale(imu: _ImuTopic, best: Hypothesis) -> float:
    """Return what the gyros read over the true rate, in their unit."""
    _, scale = _rate_unit(imu, best)
    return scale * imu.settings.angular_rate_scale


def _other_rates(imu: _ImuTopic, other: _ImuTopic) -> Iterator[str]:
    """State how much more the gyros of another IMU of the same vehicle read, where that differs."""
    ratio, correlation = rates_compared(imu.columns, other.columns)
    ratio *= other.settings.angular_rate_scale / imu.settings.angular_rate_scale
    if correlation > SAME_MOTION and abs(ratio - 1.0) > LARGEST_APART:
        yield f"the gyros of {other.topic} read {ratio:.3g} times as much"


def dvl_note(
    topic: str, best: Hypothesis, others_deg: Sequence[tuple[float, float, float]]
) -> Note:
    """Report the mounting of the DVL, and which others are as good."""
    rpy = _rpy(best.rpy_deg)
    # Rotations that differ in the last bits are the same text, and are named once.
    others = list[str]()
    for other_deg in sorted(others_deg):
        other = _rpy(other_deg)
        if other not in (rpy, *others):
            others.append(other)
    if others:
        return note(
            "found_dvl open",
            topic=topic,
            rpy=rpy,
            others=" or ".join(others),
        )
    return note(
        "found_dvl",
        topic=topic,
        rpy=rpy,
    )


def _forward_note(best: Hypothesis, other: Hypothesis) -> Note:
    """Report axes in which a vehicle goes forward or sideways, since the log has no attitude that decides."""
    return note(
        "found_forward",
        used=_built_in(best),
        other=_built_in(other),
    )


def _built_in(one: Hypothesis) -> str:
    """Return the settings of a hypothesis that say how IMU and DVL are built in."""
    imu_rpy = f", imu.mounting_rpy_deg = {_rpy(one.imu_rpy_deg)}" if any(one.imu_rpy_deg) else ""
    return f'imu.axes = "{one.axes}"{imu_rpy} with dvl.mounting_rpy_deg = {_rpy(one.rpy_deg)}'


def _rpy(rpy_deg: Sequence[float]) -> str:
    return f"[{', '.join(f'{angle:.4g}' for angle in rpy_deg)}]"
