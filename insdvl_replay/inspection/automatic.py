"""Settings for dives of a vehicle that nobody has described: proposed, tried, calibrated, and reported.

The roles are proposed by names and types, and `trials` decides between topics, units, axes and signs. Then the start,
the noise and the geometry of the DVL are found, and what cannot be found gets a default. Each finding or assumption is
a note. The same settings as a file repeat the replay.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from insdvl_replay.calibration.answer import answer_of
from insdvl_replay.calibration.calibration import Calibration
from insdvl_replay.calibration.dives import calibrate_dives
from insdvl_replay.calibration.innovations import LABELS, NOISE, ReadDive, with_dvl
from insdvl_replay.calibration.noise import INERTIAL
from insdvl_replay.checks.dvl import median_speed_mps
from insdvl_replay.checks.imu import imu_remarks
from insdvl_replay.core.config import Config, Dvl, Imu, Initial, Noise
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, DvlColumns, ImuColumns, ReferenceColumns, nanoseconds
from insdvl_replay.core.errors import LogError, Note, UserError, listed
from insdvl_replay.core.result import flattened
from insdvl_replay.core.runtime import report_stage, track_progress
from insdvl_replay.core.states import DEG, FASTEST_MPS, GRAVITY_MPS2, SPECIFIC_FORCE_UNITS, VELOCITY_UNITS
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.notes import beyond_the_sensor, readings_scatter, sensor_class
from insdvl_replay.geometry.frames import look_down
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.dry_run import AS_GRAVITY_MPS2, fitting_units
from insdvl_replay.inspection.proposal import (
    Setting,
    axes_text,
    comment_lines,
    propose_settings,
    settings_toml,
    with_settings,
)
from insdvl_replay.inspection.trials import (
    CLEARLY,
    DEG_PER_S,
    LEAST_MPS,
    NOT_FAR_OFF,
    Hypothesis,
    Trials,
    as_reference_moves,
    rates_compared,
    thinned,
    trial_config,
)
from insdvl_replay.logs.columns.imu import FRD, decode_imu, in_frd, measured_vectors
from insdvl_replay.logs.columns.tables import read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.recording import Recording, open_recording
from insdvl_replay.logs.read import RoleColumns, find_roles
from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import FIT, LEAST_NIS, MOST_NIS, baseline_fit, fitted_start
from insdvl_replay.results.folder import VEHICLE_FILE

MOST_DIVES: Final = 5  # dives from which the settings are found
UNKNOWN_LATITUDE_DEG: Final = 45.0
GRADES: Final = ("fog", "tactical", "mems")  # presets from the quietest IMU to the noisiest
# What a calibration finds, by the settings that it replaces.
GROUPS: Final = {"arm": "lever_arm_m", "mounting": "mounting_rpy_deg", "delay": "latency_s", "scale": "scale"}
FITTED_SHARE: Final = 0.5  # of a dive alone; the rest tests what was found
SAME_MOTION: Final = 0.9  # correlation of the rates of two IMUs of one vehicle
LARGEST_APART: Final = 0.05  # share by which their scales may differ
MOST_ROUNDS: Final = 4  # in which it is changed
WELL_ABOVE, WELL_BELOW = 0.6, 1.7  # mean NIS/dof outside which the noise of the DVL is changed
SPEEDS_MPS: Final = (0.1, 5.0)  # over ground of a vehicle under way
SAME_SPEED: Final = 1.5  # factor within which median speeds of DVL and reference agree
SPINNING_RADPS: Final = 1.0
_NOT_NEEDED: Final = ("dvl.valid",)  # keys of a proposal without a value with which a replay works all the same
Paths = Sequence[Path]


@dataclass(frozen=True)
class FoundSettings:
    """Settings with which dives can be replayed, and what was found or assumed."""

    config: Config
    notes: tuple[Note, ...]  # warnings first

    @property
    def text(self) -> str:
        """Return the settings as a file for ``-c``, which holds what differs from the defaults."""
        comments = [line for note in self.notes for line in comment_lines(note.text)]
        return "".join(f"{line}\n" for line in comments) + f"\n{render_toml(self.config, changed_only=True)}"


def find_settings(dives: Sequence[Paths], given: Config, *, allow_damaged: bool = False) -> FoundSettings:
    """Find settings for dives of one vehicle, except for those that are given, which are as they are not by default.

    Raises
    ------
    LogError
        A log cannot be read, or lacks what a replay needs.
    """
    report_stage("finding the settings")
    dives = dives[:MOST_DIVES]
    notes: list[Note] = []
    readings = _read(dives[0], given, allow_damaged=allow_damaged)
    config = _as_given(_with_roles(readings, given, notes), given)
    config = _with_latitude(config, readings.reference, notes)
    del readings
    report_stage("reading the log")
    read = [read_checked_dive(dives[0], config, allow_damaged=allow_damaged)]
    for paths in dives[1:]:
        with suppress(UserError):  # its own replay reports it
            read.append(read_checked_dive(paths, config, allow_damaged=allow_damaged))
    config = _with_start(read[0], config)
    preset = imu_class(read[0].imu)
    config = _as_given(_of_class(preset, config), given)
    read_with_s = config.dvl.latency_s
    at_imu = [with_reference_at_imu(dive, config) for dive in read]
    config = _calibrated(at_imu, config, given, notes)
    config, preset = _with_fitted_class(at_imu, config, given, preset)
    read = [_later(dive, config.dvl.latency_s - read_with_s) for dive in read]
    config, started = _with_heading([with_reference_at_imu(dive, config) for dive in read], config, notes)
    config = _levelled(read[0], config, given, started, preset, notes)
    if len(read) > 1:
        names = listed([dive.name for dive in read])
        notes.append(_note("found_dives", f"settings of one vehicle, found from {len(read)} dives together: {names}"))
    if keys := _given_keys(given):
        notes.append(_note("found_given", f"as given: {listed(keys)}"))
    return FoundSettings(config, tuple(sorted(notes, key=lambda note: note.severity != Severity.WARNING)))


@dataclass(frozen=True)
class SettingsFile:
    """Settings as text that ``-c`` reads, and what is open."""

    text: str
    notes: tuple[Note, ...]  # what was found or assumed
    missing: tuple[str, ...] = ()  # keys without a value, which only a person can know
    failure: UserError | None = None  # why no settings could be tried


def settings_file(dives: Sequence[Paths], given: Config, *, allow_damaged: bool = False) -> SettingsFile:
    """Find settings for the dives of a vehicle; else propose what names, types and sizes show of the first.

    Raises
    ------
    LogError
        The first cannot be read at all.
    """
    try:
        found = find_settings(dives, given, allow_damaged=allow_damaged)
        return SettingsFile(found.text, found.notes)
    except UserError as failure:
        proposal = propose_settings(dives[0], given, allow_damaged=allow_damaged)
        keys = (key.split(".") for key in _given_keys(given) if key.count(".") == 1)
        settings = [Setting(f"{section}.{key}", getattr(getattr(given, section), key)) for section, key in keys]
        settings += proposal.settings
        comments = comment_lines(f"blocker: {failure.message}; {failure.hint}")
        text = "".join(f"{line}\n" for line in comments) + f"\n{settings_toml(settings)}"
        missing = [setting.key for setting in settings if setting.value is None and setting.key not in _NOT_NEEDED]
        return SettingsFile(text, proposal.notes, tuple(dict.fromkeys(missing)), failure)


def _given_keys(given: Config) -> list[str]:
    """Name what is not as it is by default."""
    default = dict(flattened(msgspec.to_builtins(Config())))
    return [key for key, value in flattened(msgspec.to_builtins(given)) if value != default.get(key)]


def _as_given(found: Config, given: Config) -> Config:
    """Return settings with those that are given."""
    default = Config()
    for section in ("imu", "dvl", "reference", "initial", "noise"):
        now, before = getattr(given, section), getattr(default, section)
        values = {key: getattr(now, key) for key in now.__struct_fields__ if getattr(now, key) != getattr(before, key)}
        found = _set(found, section, **{key: value for key, value in values.items() if value is not None})
    return found if given.filters == default.filters else msgspec.structs.replace(found, filters=given.filters)


def _later(dive: Dive, latency_s: float) -> Dive:
    """Return a dive with the pings of another latency, which is subtracted from stamps as a log is read."""
    time_ns = dive.dvl.time_ns - nanoseconds(latency_s)
    return replace(dive, dvl=replace(dive.dvl, time_ns=time_ns))


def _note(code: str, text: str, hint: str = "", *, warn: bool = False) -> Note:
    return Note(code, text, 1, Severity.WARNING if warn else Severity.INFO, hint)


def _set(config: Config, section: str, **values: Any) -> Config:
    return with_settings(config, [Setting(f"{section}.{key}", value) for key, value in values.items()])


def stored_settings(folder: Path, given: Config) -> Config | None:
    """Return the settings that an earlier run found for the result in a folder, with the same span and evaluation.

    Those that were found beside given ones are found again.
    """
    asked = msgspec.structs.replace(Config(), span=given.span, evaluation=given.evaluation)
    if given != asked or not (folder / VEHICLE_FILE).is_file():
        return None
    try:
        found = load_config(file=folder / VEHICLE_FILE)
    except UserError:
        return None
    return found if (found.span, found.evaluation) == (given.span, given.evaluation) else None


# --- Who plays which role, in which units and axes.


@dataclass(frozen=True)
class _ImuTopic:
    """A topic that could be the IMU, with its readings in its own axes."""

    topic: str
    columns: ImuColumns
    settings: Imu  # with which it was read, and no axes
    as_read: Hypothesis  # by its type and the settings


@dataclass(frozen=True)
class _Readings:
    """What could play the roles of a log."""

    place: str
    draft: Config  # as proposed by names, types and sizes
    imus: list[_ImuTopic]
    pings: dict[str, DvlColumns]  # by topic
    reference: ReferenceColumns | None


def _read(paths: Paths, given: Config, *, allow_damaged: bool) -> _Readings:
    """Read all topics that could be the IMU or the DVL, and the proposed reference; LogError where there is none."""
    proposal = propose_settings(paths, given, allow_damaged=allow_damaged)
    draft = with_settings(given, proposal.settings)
    log = open_recording(paths, allow_damaged=allow_damaged)
    place = str(log.path)
    with log.watched():
        proposed = {finding.role: finding for finding in find_roles(place, log.channels, draft)}
        by_type = {finding.role: finding for finding in find_roles(place, log.channels, given)}
        for role in ("dvl", "imu"):
            if (error := proposed[role].error) is not None:
                raise error
        refused: list[LogError] = []
        imus = list(_imu_topics(log, by_type["imu"].candidates or proposed["imu"].sources, draft, refused))
        if not imus:
            raise refused[0] if refused else LogError("has no readings of an IMU", "", place)
        columns = RoleColumns(place, draft)
        if proposed["reference"].sources:
            with suppress(UserError):
                columns.decode("reference", read_tables(log, proposed["reference"].sources))
        reference = columns.reference
        pings: dict[str, DvlColumns] = {}
        for source in by_type["dvl"].candidates or proposed["dvl"].sources:
            (table,) = read_tables(log, [source])
            columns = RoleColumns(place, draft)
            columns.decode("dvl", [table])
            unit = _velocity_unit(median_speed_mps(columns.dvl), reference, draft)
            if unit != (draft.dvl.velocity_unit or "m/s") and given.dvl.velocity_unit is None:
                draft = _set(draft, "dvl", velocity_unit=unit)
                columns = RoleColumns(place, draft)
                columns.decode("dvl", [table])
            pings[source.topic] = columns.dvl
    if (speed_mps := max(map(median_speed_mps, pings.values()))) < LEAST_MPS:
        text = f"the median speed of the DVL is {speed_mps:.2g} m/s, too slow to find settings"
        raise LogError(text, "use a dive with turns and changes of speed, or give the settings with -c", place)
    return _Readings(place, draft, imus, pings, reference)


def _velocity_unit(speed_mps: float, reference: ReferenceColumns | None, draft: Config) -> str:
    """Return the unit in which a median speed, read as in the draft, is that of the reference, else of a vehicle."""
    read_in = draft.dvl.velocity_unit or "m/s"
    size = speed_mps / VELOCITY_UNITS[read_in]
    speeds_mps = np.zeros(0) if reference is None else np.linalg.norm(reference.velocity_n, axis=1)
    known_mps = float(np.median(speeds_mps[np.isfinite(speeds_mps)])) if np.isfinite(speeds_mps).any() else 0.0
    fitting = fitting_units(size, VELOCITY_UNITS, known_mps / SAME_SPEED, known_mps * SAME_SPEED)
    if not fitting and speed_mps > FASTEST_MPS:
        fitting = fitting_units(size, VELOCITY_UNITS, *SPEEDS_MPS)
    return fitting[0] if fitting else read_in


def _with_roles(read: _Readings, config: Config, notes: list[Note]) -> Config:
    """Choose the topics of IMU and DVL by trial runs, with their units, axes and signs."""
    place, draft, imus, pings = read.place, read.draft, read.imus, read.pings
    tried: list[tuple[Trials, _ImuTopic, str]] = []
    for imu in track_progress("trying IMUs and DVLs", imus):
        for topic, dvl in pings.items():
            dive = Dive("", imu.columns, dvl, reference=read.reference)
            trials = Trials(thinned(dive), trial_config(draft, UNKNOWN_LATITUDE_DEG), imu.as_read)
            tried.append((trials, imu, topic))
    tried.sort(key=lambda found: found[0].cost)
    for trials, *_ in tried:
        if trials.cost <= NOT_FAR_OFF * min(found.cost for found, *_ in tried):
            trials.vary()
    tried.sort(key=lambda found: found[0].cost)
    trials, imu, dvl_topic = tried[0]
    if not np.isfinite(trials.cost):
        raise LogError(
            "IMU and DVL have no common time, or too few pings to try settings",
            "compare their times: insdvl-replay inspect",
            place,
        )
    dive = Dive("", imu.columns, pings[dvl_topic], reference=read.reference)
    best = as_reference_moves(trials.close, dive, draft)
    looks = pings[dvl_topic].look_d
    notes += _role_notes(tried, best, imus)
    draft = msgspec.structs.replace(draft, imu=_as_configured(imu, best, config.imu, is_alone=len(imus) == 1))
    if len(pings) > 1:
        draft = _set(draft, "dvl", topic=dvl_topic)
    if looks is None or look_down(looks):
        return _set(draft, "dvl", mounting_rpy_deg=best.rpy_deg)
    # The beams point down in other axes.
    read_b = in_frd(np.eye(3), draft.dvl.axes or FRD, "dvl.axes").T
    turn = np.rint(mat_from_rpy(np.array(best.rpy_deg) * DEG))
    return _set(draft, "dvl", axes=axes_text(turn @ read_b))


def _as_configured(imu: _ImuTopic, best: Hypothesis, given: Imu, *, is_alone: bool) -> Imu:
    """Write a hypothesis as settings of the IMU; what is by type and as read is left out."""
    settings = imu.settings
    values: dict[str, Any] = {"axes": best.axes, "specific_force_axes": best.force_axes}
    if (best.axes, best.force_axes) == (imu.as_read.axes, imu.as_read.force_axes):
        values = {"axes": given.axes, "specific_force_axes": given.specific_force_axes}
    elif best.axes == best.force_axes:
        values["specific_force_axes"] = None
    unit, scale = _rate_unit(best)
    if unit:
        values["angular_rate_unit"] = unit
    if scale != 1.0:
        values["angular_rate_scale"] = float(f"{settings.angular_rate_scale * scale:.4g}")
    if is_alone and given.topic is None and settings.specific_force is None:
        values["topic"] = None
    return msgspec.structs.replace(settings, **values)


def _rate_unit(best: Hypothesis) -> tuple[str, float]:
    """Return deg/s where the rates are nearer to these than to rad/s, and the scale in this unit."""
    if best.rate_scale > np.sqrt(DEG_PER_S):
        return "deg/s", best.rate_scale / DEG_PER_S
    return "", best.rate_scale


def _imu_topics(
    log: Recording, sources: Sequence[Source], draft: Config, refused: list[LogError]
) -> Iterator[_ImuTopic]:
    """Read the topics that could be the IMU in SI units, by the size of gravity and of the rates."""
    for source in sources:
        (table,) = read_tables(log, [source])
        is_proposed = source.topic == draft.imu.topic
        own = draft.imu if is_proposed else msgspec.structs.replace(Imu(), stamp=draft.imu.stamp)
        known = source.completed(own)
        as_read = Hypothesis(known.axes or FRD, known.specific_force_axes or known.axes or FRD)
        force, rate = (
            measured_vectors(table, "specific_force", "force"),
            measured_vectors(table, "angular_rate", "rate"),
        )
        sizes = np.linalg.norm(force, axis=1)
        size = float(np.median(sizes[np.isfinite(sizes) & (sizes > 0.0)])) if (sizes > 0.0).any() else np.nan
        rates = np.linalg.norm(rate, axis=1)
        turning = float(np.median(rates[np.isfinite(rates)])) if np.isfinite(rates).any() else np.nan
        values: dict[str, Any] = {"topic": source.topic, "axes": FRD, "specific_force_axes": FRD}
        unit = known.specific_force_unit or "m/s2"
        fitting = fitting_units(size, SPECIFIC_FORCE_UNITS, *AS_GRAVITY_MPS2)
        if fitting and unit not in fitting:
            values["specific_force_unit"] = fitting[0]
        elif not fitting and size > 0.0:
            near = min(
                (unit, *SPECIFIC_FORCE_UNITS),
                key=lambda name: abs(np.log(size * SPECIFIC_FORCE_UNITS[name] / GRAVITY_MPS2)),
            )
            ratio = size * SPECIFIC_FORCE_UNITS[near] / GRAVITY_MPS2
            if near != unit:
                values["specific_force_unit"] = near
            values["specific_force_scale"] = float(f"{ratio:.4g}")
        if turning > SPINNING_RADPS and known.angular_rate_unit != "deg/s":
            values["angular_rate_unit"] = "deg/s"
        settings = msgspec.structs.replace(own, **values)
        try:
            columns, _ = decode_imu(table, settings)
        except LogError as error:
            refused.append(error)
            continue
        remarks = imu_remarks(
            str(log.path), columns, None, msgspec.structs.replace(settings, min_rate_hz=own.min_rate_hz)
        )
        stops = [remark for remark in remarks if isinstance(remark, LogError) and remark.what.startswith("the IMU has")]
        refused += stops
        if not stops:
            yield _ImuTopic(source.topic, columns, settings, as_read)


def _role_notes(
    tried: Sequence[tuple[Trials, _ImuTopic, str]], best: Hypothesis, imus: Sequence[_ImuTopic]
) -> Iterator[Note]:
    """Report the topics and axes that were chosen, and which others are as good."""
    trials, imu, dvl_topic = tried[0]
    parts, warn = [f"IMU {imu.topic}"], False
    others = {found.topic: run.cost / trials.cost for run, found, _ in reversed(tried[1:]) if found is not imu}
    if others:
        parts.append(
            "innovations of others: " + ", ".join(f"{topic} {ratio:.3g} times" for topic, ratio in others.items())
        )
        warn = min(others.values()) * CLEARLY < 1.0
    if (best.axes, best.force_axes) != (imu.as_read.axes, imu.as_read.force_axes):
        parts.append(f"axes {best.axes}" + (f", of forces {best.force_axes}" if best.force_axes != best.axes else ""))
    settings, (unit, scale) = imu.settings, _rate_unit(best)
    scale *= settings.angular_rate_scale
    if unit or settings.angular_rate_unit == "deg/s":
        parts.append("rates in deg/s")
    if scale != 1.0:
        parts.append(f"gyros read {scale:.3g} times the true rate")
        warn = True
    if settings.specific_force_unit is not None:
        parts.append(f"forces in {settings.specific_force_unit}")
    if settings.specific_force_scale != 1.0:
        parts.append(f"accelerometers read {settings.specific_force_scale:.3g} times gravity")
        warn = True
    for other in imus:
        ratio, correlation = (1.0, 0.0) if other is imu else rates_compared(imu.columns, other.columns)
        ratio *= other.settings.angular_rate_scale / settings.angular_rate_scale
        if correlation > SAME_MOTION and abs(ratio - 1.0) > LARGEST_APART:
            parts.append(f"the gyros of {other.topic} read {ratio:.3g} times as much")
    yield _note("found_imu", "; ".join(parts), 'to use another: imu.topic = "/topic"', warn=warn)
    rivals = [one for one in trials.close if one.rpy_deg != best.rpy_deg]
    apart = {one.rpy_deg for one in rivals if one.axes == best.axes and one.force_axes == best.force_axes}
    text = f"DVL {dvl_topic}, mounting {_rpy(best.rpy_deg)} deg"
    if apart:
        text += f"; also possible: {' or '.join(map(_rpy, sorted(apart)))}"
    yield _note("found_dvl", text, "to change it: dvl.mounting_rpy_deg", warn=bool(apart))


def _rpy(rpy_deg: Sequence[float]) -> str:
    return f"[{', '.join(f'{angle:.4g}' for angle in rpy_deg)}]"


# --- The class of the IMU.


def imu_class(imu: ImuColumns) -> str:
    """Return the preset of the class of sensors that the readings of an IMU may come from, by their scatter."""
    names = []
    for key, field in INERTIAL.items():
        scatter = readings_scatter(getattr(imu, field), imu.usual_step_s)
        names.append((scatter > 0.0 and sensor_class(key, scatter)) or GRADES[-1])
    return max(names, key=GRADES.index)


def _of_class(preset: str, config: Config) -> Config:
    """Set the noise, the biases and the filters of a preset."""
    found = load_config(preset)
    config = msgspec.structs.replace(config, noise=found.noise, filters=found.filters)
    biases = {key: getattr(found.initial, key) for key in ("accel_bias_sd_mg", "gyro_bias_sd_degph")}
    return _set(config, "initial", **biases)


# --- The start.


def _with_latitude(config: Config, reference: ReferenceColumns | None, notes: list[Note]) -> Config:
    """Set a latitude where no reference gives one."""
    if config.initial.latitude_deg is not None or (reference is not None and reference.has_position):
        return config
    text = (
        f"latitude {UNKNOWN_LATITUDE_DEG:g} deg, since the log has none: this costs up to 11 deg of heading in an hour "
        "(26 deg south of the equator)"
    )
    notes.append(_note("found_latitude", text, "to set it: initial.latitude_deg", warn=True))
    return _set(config, "initial", latitude_deg=UNKNOWN_LATITUDE_DEG)


def _with_start(dive: Dive, config: Config) -> Config:
    """Start from the attitude of the reference, or level with any heading, which is found at the end."""
    reference = dive.reference
    if config.initial.source == "reference" and reference is not None and reference.has_attitude:
        return config
    if config.initial.heading_deg is None:
        config = _set(config, "initial", heading_deg=0.0)
    return _set(config, "initial", source="level")


def _with_heading(dives: Sequence[Dive], config: Config, notes: list[Note]) -> tuple[Config, Initial]:
    """Find the heading at the start: by the reference's attitude, a fit to its positions, else 0.

    The start of the first dive is returned, too, with the heading and the gyro bias of a fit.
    """
    reference = dives[0].reference
    if config.initial.source == "reference" or config.initial.heading_deg != 0.0:
        return config, config.initial
    if reference is not None and reference.has_position:
        try:
            fitted = fitted_start(dives[0], config)
        except UserError:
            pass
        else:
            text = (
                f"start heading {fitted.heading_deg:.1f} +- {fitted.heading_sd_deg:.2g} deg, fitted to the positions "
                "of the reference in each dive"
            )
            notes.append(_note("found_heading", text, "to set it: initial.heading_deg"))
            bias_degph = (*config.initial.gyro_bias_degph[:2], fitted.gyro_bias_degph)
            started = _set(config, "initial", heading_deg=fitted.heading_deg, gyro_bias_degph=bias_degph).initial
            return _set(config, "initial", heading_deg=FIT), started
    text = "start heading 0, since nothing in the log gives it: tracks and headings are relative to the start"
    notes.append(_note("found_heading", text, "to set it: initial.heading_deg", warn=True))
    return config, config.initial


# --- Geometry and noise.


def _calibrated(dives: Sequence[Dive], config: Config, given: Config, notes: list[Note]) -> Config:
    """Apply the calibration that is better on the held-out part; what is given is not calibrated."""
    read = [ReadDive(dive, config) for dive in dives]
    groups = [group for group, key in GROUPS.items() if getattr(given.dvl, key) == getattr(Dvl(), key)]
    groups += [NOISE] if given.noise == Noise() else []
    if not groups:
        return config
    try:
        found = calibrate_dives(_parts(read), config, groups, hold_out=["0.3"], windows_s=("60", "30")).found
    except UserError as error:
        notes.append(_note("found_calibration", f"the geometry of the DVL was not calibrated: {error.what}", warn=True))
        return config
    answer = answer_of(found)
    if not any(row.windows for row in found.held_out):
        # Nothing shows the drift: the innovations of the rest decide, of each part of a dive alone by the other.
        if len(read) == 1:
            other = calibrate_dives(_parts(read)[::-1], config, groups, hold_out=["0.3"], windows_s=("60",)).found
            found = replace(found, held_out=(*found.held_out, *other.held_out))
        before, after = _mean_nis(found)
        answer = replace(answer, keeps_geometry=bool(found.estimated) and after > before)
    better = answer.applied(found)
    if found.estimated and not answer.keeps_geometry:
        # What was held out has shown that it helps; all together know it best.
        whole = calibrate_dives(read, config, groups).found
        better = answer_of(whole).applied(whole)
    changes = [
        f"{LABELS[row.parameter]} {row.change:+.3g} {row.unit}" for row in better.estimated if row.change is not None
    ]
    tested = _drift_sentence(found)
    if answer.keeps_geometry:
        notes.append(_note("found_calibration", f"calibration of the DVL not applied: {tested}", warn=True))
    elif changes:
        notes.append(_note("found_calibration", f"calibrated: {', '.join(changes)}; {tested}"))
        config = with_dvl(config, better.after.rounded())
    else:
        text = "the DVL's lever arm, mounting and delay cannot be determined: taken as 0"
        notes.append(_note("found_calibration", text, "a dive with turns and changes of speed shows them", warn=True))
    if answer.keeps_geometry and NOISE in groups:
        # A noise belongs to the geometry with which it was fitted.
        found = calibrate_dives(_parts(read), config, [NOISE], hold_out=["0.3"]).found
        better = answer_of(found).applied(found)
    return _as_given(_with_noise(config, better), given)


def _with_noise(config: Config, found: Calibration) -> Config:
    for row in found.noise_rows:
        if row.is_proposed:
            section = "dvl" if row.parameter in ("velocity_sd_mps", "beam_sd_mps") else "noise"
            config = _set(config, section, **{row.parameter: row.after})
    return config


def _with_fitted_class(dives: Sequence[Dive], config: Config, given: Config, preset: str) -> tuple[Config, str]:
    """Take the biases of the class that fitted white noise belongs to, where it is better than that of the scatter.

    Coarse steps of the readings, and the vehicle's motion, scatter more than a good sensor.
    """
    usual = load_config(preset).noise
    fitted = {key: getattr(config.noise, key) for key in INERTIAL}
    if any(value == getattr(usual, key) for key, value in fitted.items()):
        return config, preset
    classes = [sensor_class(key, value) or preset for key, value in fitted.items()]
    better = max(classes, key=GRADES.index)
    if GRADES.index(better) >= GRADES.index(preset) or given.noise != Noise():
        return config, preset
    config = _as_given(_set(_of_class(better, config), "noise", **fitted), given)
    again = calibrate_dives([ReadDive(dive, config) for dive in dives], config, [NOISE]).found
    return _as_given(_with_noise(config, answer_of(again).applied(again)), given), better


def _parts(read: Sequence[ReadDive]) -> list[ReadDive]:
    """Return the dives to calibrate; one alone is divided, and its last part is the one that is held out."""
    if len(read) > 1:
        return list(read)
    (dive,) = read
    span, time_ns = dive.config.span, dive.dive.imu.time_ns
    length_s = float(time_ns[-1] - time_ns[0]) / NS_PER_S
    from_s, to_s = span.start_s or 0.0, min(span.end_s or np.inf, length_s)
    divide_s = from_s + FITTED_SHARE * (to_s - from_s)
    spans = [msgspec.structs.replace(span, end_s=divide_s), msgspec.structs.replace(span, start_s=divide_s)]
    return [dive.with_config(msgspec.structs.replace(dive.config, span=part)) for part in spans]


def _drift_sentence(found: Calibration) -> str:
    """Say what the calibration does to the drift of what was held out, else to its NIS."""
    pairs = [(row.drift_before_m, row.drift_after_m) for row in found.held_out]
    if pairs and all(before and after for before, after in pairs):
        before_m, after_m = np.exp(np.mean(np.log(np.array(pairs, float)), axis=0)).tolist()
        return f"drift without DVL on what was held out {before_m:.3g} -> {after_m:.3g} m"
    before, after = _mean_nis(found)
    return f"NIS/dof on what was held out {before:.2g} -> {after:.2g}"


def _mean_nis(found: Calibration) -> tuple[float, float]:
    rows = [(row.nis_per_dof_before, row.nis_per_dof_after) for row in found.held_out]
    before, after = np.exp(np.mean(np.log(np.array(rows, float)), axis=0)).tolist()
    return before, after


def _levelled(dive: Dive, config: Config, given: Config, started: Initial, preset: str, notes: list[Note]) -> Config:
    """Scale the noise of the DVL until the innovations are as large as expected, where they are not."""
    key = "velocity_sd_mps" if config.dvl.beam_sd_mps is None else "beam_sd_mps"

    def size_with(tried: Config) -> float:
        return baseline_fit(dive, msgspec.structs.replace(tried, initial=started))[0]

    before = config
    first = size = size_with(config)
    # Where the noise of the DVL explains nothing more, that of the accelerometers between two pings is lowered, too.
    for scaled in ([("dvl", key)], [("dvl", key), ("noise", "accel_white_mps_rts")]):
        for _ in range(MOST_ROUNDS if _is_free(scaled, given) else 0):
            if WELL_ABOVE < size < WELL_BELOW or (len(scaled) > 1 and size > 1.0):
                break
            tried = config
            for section, name in scaled:
                value = float(f"{getattr(getattr(config, section), name) * np.sqrt(size):.3g}")
                if not beyond_the_sensor(name, value):
                    tried = _set(tried, section, **{name: value})
            if tried == config:
                break
            config, size = tried, size_with(tried)
    text = f"noise of preset {preset}, the class of this IMU"
    fitted = [name for name in INERTIAL if getattr(load_config(preset).noise, name) != getattr(config.noise, name)]
    if fitted:
        values = (f"{name} {getattr(config.noise, name):.3g}" for name in fitted)
        text += f"; fitted to the innovations: {', '.join(values)}"
    old_mps, new_mps = getattr(before.dvl, key), getattr(config.dvl, key)
    if old_mps != new_mps:
        text += f"; {key} {old_mps:.3g} -> {new_mps:.3g}, since NIS/dof was {first:.2g}"
    is_fitting = LEAST_NIS < size < MOST_NIS
    if not is_fitting:
        text += f"; NIS/dof is still {size:.2g}, which no noise of these sensors explains"
    notes.append(_note("found_noise", text, warn=not is_fitting))
    return config


def _is_free(keys: Sequence[tuple[str, str]], given: Config) -> bool:
    default = Config()
    return all(getattr(getattr(given, at), key) == getattr(getattr(default, at), key) for at, key in keys)
