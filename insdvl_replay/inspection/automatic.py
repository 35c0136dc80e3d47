"""Settings for dives of a vehicle that nobody has described: proposed, tried, calibrated, and reported.

The roles are proposed by names and types, and `trials` decides between topics, units, axes and signs. Then the start,
the noise and the geometry of the DVL are found, and what cannot be found gets a default. Each finding or assumption is
a note. The same settings as a file repeat the replay.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.fitted_noise import (
    MOST_DIVES,
    levelled_to_dives,
    of_class,
    with_biases_of_class,
)
from insdvl_replay.calibration.found import (
    FoundSettings,
    Given,
    as_given,
    comment_lines,
    with_values,
)
from insdvl_replay.calibration.free_mounting import angle_between
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.calibration.noise import imu_class
from insdvl_replay.checks.reference_delay import (
    LATE_NOTES,
    surely_late_s,
    with_reference_delay,
)
from insdvl_replay.core.config import Config, Filter, Initial, Solution
from insdvl_replay.core.config_file import SCHEMA_LINE, render_toml
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, ReferenceColumns, nanoseconds
from insdvl_replay.core.errors import LogError, Note, UserError, counted, listed
from insdvl_replay.core.misfit import MISREAD
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.found_geometry import GROUPS, calibrated, pings_later, with_noise_of
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.inspection.roles import (
    UNKNOWN_LATITUDE_DEG,
    Topics,
    read_roles,
    with_roles,
)
from insdvl_replay.inspection.settings import Setting, settings_toml
from insdvl_replay.inspection.trials import CONSISTENT
from insdvl_replay.logs.columns.topics import TYPES
from insdvl_replay.logs.formats.log_file import joined_bounds
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.preparation.prepared import (
    raise_if_span_is_empty,
    read_checked_dive,
    with_reference_at_imu,
)
from insdvl_replay.preparation.run import FIT, fitted_start

# Notes on a reference that does not move as DVL and gyros say.
CONTRADICTIONS: Final = frozenset(
    {"dvl_contradiction", "track_contradiction", "imu_gyro_contradiction", "reference_constant"}
)
REFERENCE_LATENCY: Final = "reference.latency_s"
LATENCY_DIGITS: Final = 3  # of a delay, s
SHORT_S: Final = 30.0  # shorter logs are the last by which settings are found
# keys of a proposal without a value with which a replay works all the same
_NOT_NEEDED: Final = ("dvl.valid",)
MOST_DIFFERENCES: Final = 4  # that are named
# Settings of the DVL that a calibration changes a little.
_CALIBRATED: Final = (*GROUPS.values(), "velocity_sd_mps", "beam_sd_mps")
CALIBRATED_RAD: Final = 5.0 * DEG  # turns of the DVL up to which are a calibration's
SCALES: Final = {"specific_force_scale": "accelerometers", "angular_rate_scale": "gyros"}
_ONBOARD: Final = "onboard"  # the name of a filter that was flown
Paths = Sequence[Path]


def settings_of_one(found: FoundSettings, name: str, common: Config) -> FoundSettings:
    """Return the settings of a dive that contradicts the common ones of its vehicle, with a note why."""
    differences = "; ".join(_differences(found.config, common)) or "another start and noise"
    own = note(
        "found_own",
        dive=name,
        differences=differences,
    )
    return replace(found, notes=(own, *found.notes))


def find_settings(
    dives: Sequence[Paths], given: Given, *, allow_damaged: bool = False
) -> FoundSettings:
    """Find settings for dives of one vehicle, except for those that are given; no code in them is run.

    Raises
    ------
    LogError
        A log cannot be read, or lacks what a replay needs.
    """
    report_stage("finding the settings")
    dives = dives[:MOST_DIVES]
    whole = given
    given = replace(given, config=given.config.without_code())
    notes: list[Note] = []
    first, dive, config, proposed_s = _first_with_reference(
        dives, given, notes, allow_damaged=allow_damaged
    )
    digests = {tuple(first): dive.sha256}
    others = [paths for paths in dives if paths != first]
    alike = []
    for paths, other in _read_alike(others, dive, config, allow_damaged=allow_damaged):
        digests[tuple(paths)] = other.sha256
        alike.append(other)
    read = [dive, *alike]
    read = _without_short(read, notes)
    read, config = _with_reference_latency(read, config, given, proposed_s, notes)
    config = _with_start(read[0], config)
    preset = imu_class(read[0].imu)
    config = as_given(of_class(preset, config), given)
    read_with_s = config.dvl.latency_s
    config = calibrated(_at_imu(read, config), config, given, notes)
    read = [pings_later(dive, config.dvl.latency_s - read_with_s) for dive in read]
    config, better = with_biases_of_class(config, given, preset)
    if better != preset and not given.has("noise"):
        preset = better
        config = with_noise_of(_at_imu(read, config), config, given)
    config, started = _with_heading(_at_imu(read, config), config, given, notes)
    first_read = [ReadDive(read[0], config)]
    config = levelled_to_dives(first_read, config, given, started, preset, notes)
    if len(read) > 1:
        names = listed([dive.name for dive in read])
        notes.append(
            note(
                "found_dives",
                dives=len(read),
                names=names,
            )
        )
    if whole.keys:
        notes.append(note("found_given", keys=listed(whole.keys)))
    config = with_flown(first, as_given(config, whole), given, notes)
    return FoundSettings(
        config,
        tuple(sorted(notes, key=lambda note: note.severity != Severity.WARNING)),
        tuple(whole.keys),
        digests,
    )


def with_flown(
    paths: Paths,
    config: Config,
    given: Given,
    notes: list[Note],
) -> Config:
    """Evaluate the filter that steered the vehicle, too, if the log has one and nobody has given filters."""
    if given.has("filters"):
        return config
    flown = []
    for channel in open_recording(paths, allow_damaged=True).channels:
        if channel.type_name in TYPES["flown"] and channel.messages:
            flown.append(channel.topic)
    if len(flown) != 1 or flown[0] == config.reference.topic:
        return config
    topic = flown[0]
    notes.append(note("found_flown", topic=topic, name=_ONBOARD))
    onboard = Filter(solution=Solution(topic=topic))
    return msgspec.structs.replace(config, filters={**config.filters, _ONBOARD: onboard})


def _at_imu(dives: Sequence[Dive], config: Config) -> list[Dive]:
    return [with_reference_at_imu(dive, config) for dive in dives]


def _read_alike(
    others: Sequence[Paths],
    first: Dive,
    config: Config,
    *,
    allow_damaged: bool,
) -> Iterator[tuple[Paths, Dive]]:
    """Read other dives that the settings of the first do not misread, with their paths.

    What they misread needs settings of its own, and would spoil these.
    """
    for paths in others:
        with suppress(UserError):  # its own replay reports it
            other = read_checked_dive(paths, config, allow_damaged=allow_damaged)
            if _misread(other) <= _misread(first):
                yield paths, other


@dataclass(frozen=True)
class _Roles:
    """A dive whose roles are found."""

    paths: Paths
    config: Config
    cost: float  # of the trial
    reference_topics: Topics
    has_other_references: bool  # that can be tried in its place


def _first_with_reference(
    dives: Sequence[Paths],
    given: Given,
    notes: list[Note],
    *,
    allow_damaged: bool,
) -> tuple[Paths, Dive, Config, float]:
    """Read the first dive that shows the roles, with the first reference that IMU and DVL do not contradict.

    The latency of the reference, s, is returned as well, as it was before the reference was found late.
    """
    reasons: dict[Topics, str] = {}  # why references are not used
    while True:
        found: list[Note] = []
        roles = _first_with_roles(dives, given, found, reasons, allow_damaged=allow_damaged)
        report_stage("reading the log")
        dive, config, why = _read_with_reference(roles, given, found, allow_damaged=allow_damaged)
        if why:
            reasons[roles.reference_topics] = why
        if not why or not roles.has_other_references:
            break
    notes += found
    is_without = config.reference.ignore
    if is_without and reasons:
        _, last = reasons.popitem()
        notes.append(note("found_reference", why=last))
    for topics, reason in reasons.items():
        notes.append(note("found_left_out contradicts", topic=topics[0], why=reason))
    return roles.paths, dive, config, roles.config.reference.latency_s


def _first_with_roles(
    dives: Sequence[Paths],
    given: Given,
    notes: list[Note],
    without: Collection[Topics],
    *,
    allow_damaged: bool,
) -> _Roles:
    """Find the roles by the first dive that shows them, short ones last, without some references.

    If none shows them, the error is that of the first dive as they are given, whose result it becomes.
    """
    failures: dict[Path, UserError] = {}
    for paths in sorted(dives, key=_is_short):
        found: list[Note] = []
        try:
            readings = read_roles(
                paths, given.config, allow_damaged=allow_damaged, without=without
            )
            raise_if_span_is_empty(readings.place, readings.imus[0].columns, given.config.span)
            config, cost = with_roles(readings, given, found)
        except UserError as error:
            failures[paths[0]] = error
            continue
        notes += found
        config = _with_latitude(as_given(config, given), readings.reference, notes)
        return _Roles(
            paths, config, cost, readings.reference_topics, readings.has_other_references
        )
    raise failures[dives[0][0]]


def _is_short(paths: Paths) -> bool:
    """Return whether a log is too short, or cannot be read, to find settings by it."""
    try:
        parts = open_recording(paths, allow_damaged=True).parts
    except UserError:
        return True
    known_ns = [part.span_ns for part in parts if part.span_ns]
    if not known_ns:
        return True
    begin_ns, end_ns = joined_bounds(known_ns)
    return end_ns - begin_ns < SHORT_S * NS_PER_S


def _without_short(read: Sequence[Dive], notes: list[Note]) -> list[Dive]:
    """Leave out dives that are too short to show anything, as long as others are left."""
    kept: list[Dive] = []
    for dive in read:
        begin_ns = max(int(dive.imu.time_ns[0]), int(dive.dvl.time_ns[0]))
        end_ns = min(int(dive.imu.time_ns[-1]), int(dive.dvl.time_ns[-1]))
        length_s = max(end_ns - begin_ns, 0) / NS_PER_S
        if length_s >= SHORT_S:
            kept.append(dive)
            continue
        left_out = note(
            "found_left_out short",
            dive=dive.name,
            length_s=length_s,
            least_s=SHORT_S,
        )
        notes.append(left_out)
    if kept:
        return kept
    del notes[len(notes) - len(read) :]
    return list(read)


def _read_with_reference(
    roles: _Roles,
    given: Given,
    notes: list[Note],
    *,
    allow_damaged: bool,
) -> tuple[Dive, Config, str]:
    """Read a dive, without its reference where that contradicts IMU and DVL, which agree; return the reason as well."""
    paths = roles.paths
    config = roles.config
    is_free = (
        roles.cost < CONSISTENT and not given.has("reference") and not config.reference.ignore
    )
    try:
        dive = read_checked_dive(paths, config, allow_damaged=allow_damaged)
    except LogError as error:
        if not is_free:
            raise
        in_radians = with_values(config, "reference", angle_unit="rad")
        without = with_values(config, "reference", ignore=True)
        with suppress(UserError):
            dive = read_checked_dive(paths, in_radians, allow_damaged=allow_damaged)
            if not _contradictions(dive):
                notes.append(note("found_reference radians"))
                return dive, in_radians, ""
        try:
            dive = read_checked_dive(paths, without, allow_damaged=allow_damaged)
        except UserError:
            raise error from None
        return dive, without, error.what
    late_s = _late_reference_s(dive, given)
    if late_s and not config.reference.ignore:
        config = with_values(
            config,
            "reference",
            latency_s=round(config.reference.latency_s + late_s, LATENCY_DIGITS),
        )
        dive = read_checked_dive(paths, config, allow_damaged=allow_damaged)
    contradictions = _contradictions(dive)
    if not contradictions or not is_free:
        return dive, config, ""
    config = with_values(config, "reference", ignore=True)
    if (
        config.initial.latitude_deg is None and dive.reference is not None
    ):  # which its position still shows
        latitude_deg = round(float(np.nanmedian(dive.reference.position[:, 0])) / DEG, 3)
        config = with_values(config, "initial", latitude_deg=latitude_deg)
    without_reference = read_checked_dive(paths, config, allow_damaged=allow_damaged)
    return without_reference, config, contradictions[0].text


def _contradictions(dive: Dive) -> list[Note]:
    """Return the notes that the reference of a dive contradicts its other sensors."""
    return [note for note in dive.notes if note.code in CONTRADICTIONS]


def _late_reference_s(dive: Dive, given: Given) -> float:
    """Return how late the reference of a dive is, s; 0 where that is given, not known or too little to matter."""
    if dive.reference_delay is None or given.has(REFERENCE_LATENCY):
        return 0.0
    return surely_late_s(dive.reference_delay) or 0.0


def _with_reference_latency(
    dives: Sequence[Dive],
    config: Config,
    given: Given,
    proposed_s: float,
    notes: list[Note],
) -> tuple[list[Dive], Config]:
    """Set the latency of the references to the mean delay of all dives, by their weights, where any of them is late.

    The first dive may have been read with another latency than the proposed one already, s.
    """
    first_s = config.reference.latency_s
    found = [dive.reference_delay for dive in dives]
    known = [one for one in found if one is not None and one.is_checked]
    delays_s = []
    weights = []
    for one in known:
        if one.delay_s is not None and one.sd_s is not None:
            delays_s.append(one.delay_s)
            weights.append(one.sd_s**-2.0)
    if given.has(REFERENCE_LATENCY) or not weights:
        return list(dives), config
    rest_s = float(np.average(delays_s, weights=weights))
    if first_s == proposed_s and not any(one.is_late for one in known):
        return list(dives), config
    latency_s = round(first_s + rest_s, LATENCY_DIGITS)
    config = with_values(config, "reference", latency_s=latency_s)
    sd_s = float(np.sum(weights)) ** -0.5
    dives_known = counted(len(known), "dive")
    notes.append(
        note(
            "found_reference_delay",
            latency_s=latency_s,
            sd_s=sd_s,
            dives=dives_known,
        )
    )
    return [_reference_later(dive, config, latency_s - first_s) for dive in dives], config


def _reference_later(dive: Dive, config: Config, latency_s: float) -> Dive:
    """Return a dive with the reference of another latency, which is subtracted from stamps as a log is read."""
    if dive.reference is None:
        return dive
    reference = replace(dive.reference, time_ns=dive.reference.time_ns - nanoseconds(latency_s))
    notes = tuple(note for note in dive.notes if note.code not in LATE_NOTES)
    return with_reference_delay(replace(dive, reference=reference, notes=notes), config)


@dataclass(frozen=True)
class SettingsFile:
    """Settings as text that ``-c`` reads, and what is open."""

    text: str
    notes: tuple[Note, ...]  # what was found or assumed
    missing: tuple[str, ...] = ()  # keys without a value, which only a person can know
    failure: UserError | None = None  # why no settings could be tried


def settings_file(
    dives: Sequence[Paths], given: Given, *, allow_damaged: bool = False
) -> SettingsFile:
    """Find settings for the dives of a vehicle; else propose what names, types and sizes show of the first.

    Raises
    ------
    LogError
        The first cannot be read at all.
    """
    try:
        found = find_settings(dives, given, allow_damaged=allow_damaged)
        return SettingsFile(SCHEMA_LINE + found.text, found.notes)
    except UserError as failure:
        return _proposed_file(dives[0], given, failure, allow_damaged=allow_damaged)


def _proposed_file(
    paths: Paths,
    given: Given,
    failure: UserError,
    *,
    allow_damaged: bool,
) -> SettingsFile:
    """Propose what names, types and sizes show, beside what is given."""
    config = given.config
    proposal = propose_settings(paths, config, allow_damaged=allow_damaged)
    settings = list(proposal.settings)
    for key in given.keys:
        if key.count(".") == 1:
            section, name = key.split(".")
            settings.append(Setting(key, getattr(getattr(config, section), name)))
    comments = comment_lines(f"blocker: {failure.message}; {failure.hint}")
    text = SCHEMA_LINE + "".join(f"{line}\n" for line in comments)
    text += f"\n{settings_toml(settings)}"
    if given.has("filters", "topics"):
        kept = Config(filters=config.filters, topics=config.topics)
        text += f"\n{render_toml(kept, changed_only=True)}"
    missing: dict[str, None] = {}  # each key once
    for setting in settings:
        if setting.value is None and setting.key not in _NOT_NEEDED:
            missing[setting.key] = None
    return SettingsFile(text, proposal.notes, tuple(missing), failure)


def _misread(dive: Dive) -> frozenset[str]:
    """Return the codes of notes that settings misread a dive."""
    return MISREAD & {note.code for note in dive.notes}


def _differences(own: Config, others: Config) -> list[str]:
    """Name the settings of the sensors that differ: scales in words, and not what a calibration changes a little."""
    words = []
    for key, sensors in SCALES.items():
        scale = getattr(own.imu, key)
        before = getattr(others.imu, key)
        if scale != before:
            words.append(f"{sensors} {scale / before:.3g} times those of the other dives")
    for section in ("imu", "dvl", "reference"):
        now = getattr(own, section)
        then = getattr(others, section)
        for key in now.__struct_fields__:
            is_calibrated = section == "dvl" and key in _CALIBRATED
            is_other = getattr(now, key) != getattr(then, key)
            if is_other and not is_calibrated and key not in SCALES:
                words.append(f"{section}.{key} = {getattr(now, key)}")
    turn = mat_from_rpy(np.array(own.dvl.mounting_rpy_deg) * DEG)
    of_others = mat_from_rpy(np.array(others.dvl.mounting_rpy_deg) * DEG)
    if angle_between(turn, of_others) > CALIBRATED_RAD:
        words.append(f"dvl.mounting_rpy_deg = {list(own.dvl.mounting_rpy_deg)}")
    return words[:MOST_DIFFERENCES]


# --- The start.


def _with_latitude(
    config: Config, reference: ReferenceColumns | None, notes: list[Note]
) -> Config:
    """Set a latitude where no reference gives one."""
    if config.initial.latitude_deg is not None or (
        reference is not None and reference.has_position
    ):
        return config
    notes.append(note("found_latitude", latitude_deg=UNKNOWN_LATITUDE_DEG))
    return with_values(config, "initial", latitude_deg=UNKNOWN_LATITUDE_DEG)


def _with_start(dive: Dive, config: Config) -> Config:
    """Start from the attitude of the reference, or level with any heading, which is found at the end."""
    reference = dive.reference
    if config.initial.source == "reference" and reference is not None and reference.has_attitude:
        return config
    if config.initial.heading_deg is None:
        config = with_values(config, "initial", heading_deg=0.0)
    return with_values(config, "initial", source="level")


def _with_heading(
    dives: Sequence[Dive],
    config: Config,
    given: Given,
    notes: list[Note],
) -> tuple[Config, Initial]:
    """Find the heading at the start: by the reference's attitude, a fit to its positions, else 0.

    A start is returned, too, with the heading and the gyro bias of a fit.
    """
    if config.initial.heading_deg is None or given.has("initial.heading_deg"):
        return config, config.initial
    for dive in dives:
        with suppress(UserError):  # a dive that moves too little says nothing of the others
            fitted = fitted_start(dive, config)
            notes.append(note("found_heading", fitted=fitted))
            bias_degph = (*config.initial.gyro_bias_degph[:2], fitted.gyro_bias_degph)
            started = with_values(
                config, "initial", heading_deg=fitted.heading_deg, gyro_bias_degph=bias_degph
            ).initial
            return with_values(config, "initial", heading_deg=FIT), started
    notes.append(note("found_heading unknown"))
    return config, config.initial
