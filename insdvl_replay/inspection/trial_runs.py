"""A settings file with which a log can be run: given settings, proposed settings, and results of trial runs.

The log is replayed with the settings proposed so far. An unknown heading or latitude has any value then, since the
DVL's innovations hardly depend on them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from msgspec import Struct

from insdvl_replay import __version__
from insdvl_replay.calibration.fit import CLEARLY, TriedMounting, tried_mountings
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Initial, Noise, Topic
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ImuColumns
from insdvl_replay.core.errors import UserError, listed
from insdvl_replay.core.states import BY_SENSOR, DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.drift import filter_track_fit
from insdvl_replay.evaluation.notes import CLASSES, readings_scatter, sensor_class
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.proposal import (
    Setting,
    axes_text,
    comment_lines,
    not_yet_set,
    propose_settings,
    settings_toml,
    undecided_keys,
    with_settings,
)
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import FIT, fitted_start
from insdvl_replay.replay import replay_dive

MOST_DIVES: Final = 5  # dives that are read to try a mounting on: more would say the same again
UNKNOWN_LATITUDE_DEG: Final = 45.0
CERTAIN_SDS: Final = 5.0  # a scale that a track shows less surely is not worth a line
GRADES: Final = ("fog", "tactical", "mems")  # presets from the quietest IMU to the noisiest
_NOISES: Final = {"accel_white_mps_rts": "m/s/sqrt(s)", "gyro_white_rad_rts": "rad/sqrt(s)"}
_ARM_OPEN: Final = (
    "from IMU to DVL: forward, starboard, down; measure it, or estimate it with `insdvl-replay calibrate`"
)
_NOT_NEEDED: Final = ("dvl.valid",)  # keys of a proposal without a value with which a replay works all the same


@dataclass(frozen=True)
class SettingsFile:
    """A proposal as text that ``-c`` reads."""

    text: str
    decisions: tuple[str, ...]  # keys about which a person must decide; those without a value are comments in the text
    missing: tuple[str, ...]  # keys without a value
    failures: tuple[UserError, ...]  # what kept the log from being read, or run, with it


def settings_file(
    dives: Sequence[Path | Sequence[Path]], config: Config, *, allow_damaged: bool = False
) -> SettingsFile:
    """Propose all settings for the dives of a vehicle, at least one.

    Topics, units and axes are those of the first, the noise too; the mounting is tried on the first few together, and a
    scale is proposed for one alone.

    Raises
    ------
    LogError
        The first cannot be read at all.
    """
    first = dives[0] if isinstance(dives[0], Path) else dives[0][0]
    default = Config()
    proposal = propose_settings(dives[0], config, allow_damaged=allow_damaged)
    settings: list[Setting] = []
    # What -c, --set and --preset said, so that the file is whole; topics and filters are added below.
    for section, now in msgspec.structs.asdict(config).items():
        given = changed_keys(now, getattr(default, section)) if isinstance(now, Struct) else {}
        settings += [Setting(f"{section}.{name}", value, "as given") for name, value in given.items()]
    settings += proposal.settings
    draft = with_settings(config, settings)
    read, failures = _readable(dives[:MOST_DIVES], draft, allow_damaged=allow_damaged)
    preset, warnings = "", []
    if read:
        trial, preset, failed = trial_runs(read, draft)
        settings += not_yet_set(trial, config)
        failures += failed
        if any(setting.key == "dvl.axes" for setting in trial):  # what was wrong with the others is no longer
            read, _ = _readable(dives[:MOST_DIVES], with_settings(config, settings), allow_damaged=allow_damaged)
        notes = [(dive.name, note) for dive in read for note in dive.notes]
        warnings = [f"{name}: {note.text}" for name, note in notes if note.severity == Severity.WARNING]
    decisions = undecided_keys(settings)
    for name, topic in config.topics.items():
        own = changed_keys(topic, Topic(topic="", values=""))
        settings += [Setting(f"topics.{name}.{key}", value) for key, value in own.items()]
    filters = preset_config(preset, config).filters
    settings += filter_settings(filters, f"Preset {preset}." if preset else "") if filters != default.filters else []
    head = [
        f"insdvl-replay {__version__} inspect --propose: {listed([dive.name for dive in read] or [first.name])}",
        *(f"blocker: {failure.message}; {failure.hint}" for failure in failures),
        *(f"warning: {warning}" for warning in warnings),
        f"to decide: {', '.join(decisions) or 'nothing'}",
    ]
    text = "".join(f"{line}\n" for text in head for line in comment_lines(text))
    latest = {setting.key: setting.value for setting in settings}
    missing = [key for key, value in latest.items() if value is None and key not in _NOT_NEEDED]
    return SettingsFile(f"{text}\n{settings_toml(settings)}", decisions, tuple(missing), tuple(failures))


def _readable(
    paths: Sequence[Path | Sequence[Path]], config: Config, *, allow_damaged: bool
) -> tuple[list[Dive], list[UserError]]:
    """Read the dives as far as they can be with what was proposed."""
    dives: list[Dive] = []
    failures: list[UserError] = []
    for path in paths:
        try:
            dives.append(read_checked_dive(path, config, allow_damaged=allow_damaged))
        except UserError as error:
            failures.append(error)
    return dives, failures


def changed_keys(section: Struct, default: Struct, always: Sequence[str] = ()) -> dict[str, Any]:
    """Return the keys of a section that are not as they are by default."""
    values = {key: getattr(section, key) for key in section.__struct_fields__}
    return {key: value for key, value in values.items() if key in always or value != getattr(default, key)}


def filter_settings(filters: Mapping[str, Filter], seen: str = "") -> Iterator[Setting]:
    """Write all filters as settings."""
    for name, filter_ in filters.items():
        own = changed_keys(filter_, Filter(aiding=()))
        if filter_.acceleration is not None:
            own["acceleration"] = changed_keys(filter_.acceleration, Acceleration(), ("model", "window"))
        for key, value in own.items():
            yield Setting(f"filters.{name}.{key}", value, seen)
            seen = ""


def preset_config(preset: str, config: Config) -> Config:
    """Set noise and filters of a preset in a configuration; none changes nothing."""
    if not preset:
        return config
    found = load_config(preset)
    return msgspec.structs.replace(config, noise=found.noise, filters=found.filters)


# --- What trial runs show.


def trial_runs(dives: Sequence[Dive], config: Config) -> tuple[list[Setting], str, list[UserError]]:
    """Propose noise, mounting and heading of dives of one vehicle, and return why some could not be proposed.

    Between them is the preset of the IMU's class, whose filters are proposed too; "" where noise is configured.
    """
    settings: list[Setting] = []
    failures: list[UserError] = []
    preset, initial = "", config.initial
    if (config.noise, config.filters) == (Noise(), Config().filters):
        preset, settings = imu_class(dives[0].imu, initial)
    if config.dvl.lever_arm_m == Dvl().lever_arm_m:
        settings.append(Setting("dvl.lever_arm_m", config.dvl.lever_arm_m, open=_ARM_OPEN))
    tried = with_settings(preset_config(preset, config), settings)
    startable = msgspec.structs.replace(
        tried.initial,
        heading_deg=0.0 if initial.heading_deg in (None, FIT) else initial.heading_deg,
        latitude_deg=UNKNOWN_LATITUDE_DEG if initial.latitude_deg is None else initial.latitude_deg,
    )
    tried = msgspec.structs.replace(tried, initial=startable)
    try:
        settings += _mounting([ReadDive(with_reference_at_imu(dive, tried), tried) for dive in dives], config)
        tried = with_settings(tried, settings)
        if initial.heading_deg is None and tried.initial.heading_deg is not None:
            settings += _heading(dives, tried)
    except UserError as error:
        failures.append(error)
    return settings, preset, failures


def imu_class(imu: ImuColumns, initial: Initial) -> tuple[str, list[Setting]]:
    """Find the class of sensors that the readings of an IMU may come from, and propose its noise and biases."""
    classes, scatters = [], []
    for (key, unit), readings in zip(_NOISES.items(), (imu.specific_force_b, imu.angular_rate_b), strict=True):
        scatter = readings_scatter(readings, imu.usual_step_s)
        name = sensor_class(key, scatter) if scatter > 0.0 else ""
        classes.append(name or GRADES[-1])
        shown = name or "no class"
        scatters.append(f"{CLASSES[key].name} scatter by {scatter:.2g} {unit} from sample to sample ({shown})")
    preset = max(classes, key=GRADES.index)
    config, default = load_config(preset), Initial()
    seen = f"preset {preset}: in a typical half second, {', '.join(scatters)}"
    smooths = "an IMU that filters its readings has more noise than this" if preset != GRADES[-1] else ""
    settings = [Setting(f"noise.{key}", value) for key, value in msgspec.structs.asdict(config.noise).items()]
    settings[0] = Setting(settings[0].key, settings[0].value, seen, smooths)
    for key in ("accel_bias_sd_mg", "gyro_bias_sd_degph"):
        if getattr(initial, key) == getattr(default, key):
            settings.append(Setting(f"initial.{key}", getattr(config.initial, key), f"preset {preset}"))
    return preset, settings


def _mounting(dives: Sequence[ReadDive], config: Config) -> Iterator[Setting]:
    """Propose the mounting of the DVL, if the innovations determine it, with the reason."""
    tried = tried_mountings(dives)
    best, second = tried[:2]
    is_clear = best.cost < CLEARLY * second.cost
    key, as_read = "dvl.mounting_rpy_deg", config.dvl.axes or FRD
    configured = next((mounting for mounting in tried if mounting.rpy_deg == config.dvl.mounting_rpy_deg), None)

    def rpy(mounting: TriedMounting) -> str:
        return f"[{', '.join(f'{angle:.0f}' for angle in mounting.rpy_deg)}]"

    def compared(other: TriedMounting) -> str:
        return f"{other.cost / best.cost:.2f} times as large" if best.cost > 0.0 else "as large"

    if configured is None:
        if config.dvl.mounting_rpy_deg != Dvl().mounting_rpy_deg:
            return  # a person has set it to what is none of them
        # As it is the beams do not look down: with other axes they do.
        read_b = in_frd(np.eye(3), as_read, "dvl.axes").T
        axes, other = (
            axes_text(np.rint(mat_from_rpy(np.array(mounting.rpy_deg) * DEG)) @ read_b) for mounting in (best, second)
        )
        look = ", ".join(f"{part:.2f}" for part in np.array(dives[0].dive.dvl.look_d))
        text = (
            f"with {as_read} the beams point along ({look}); of {len(tried)} orientations with beams down, this one "
            f"has the smallest innovations; the next best, {other}: {compared(second)}"
        )
        is_close = best.cost > CLEARLY * second.cost
        yield Setting("dvl.axes", axes, text, f'"{other}" is possible too' if is_close else "")
        return
    if best is configured:
        text = (
            f"of {len(tried)} orientations this one has the smallest innovations; the next best, {rpy(second)}: "
            f"{compared(second)}"
        )
        yield Setting(key, best.rpy_deg, text)
    elif best.cost < CLEARLY * configured.cost:
        text = (
            f"of {len(tried)} orientations this one has the smallest innovations; the configured one: "
            f"{compared(configured)}; the next best, {rpy(second)}: {compared(second)}"
        )
        is_close = best.cost > CLEARLY * second.cost
        yield Setting(key, best.rpy_deg, text, "the next best is possible too" if is_close else "")
    else:
        text = (
            f"the innovations cannot decide: with {rpy(best)} they are {best.cost / configured.cost:.2f} times as large"
        )
        yield Setting(key, configured.rpy_deg, text, "DVL axes to body: roll, pitch, heading; measure them")
        return
    # Settle axes that were open: with any others, another mounting would say the same.
    if config.dvl.axes is not None and is_clear:
        yield Setting("dvl.axes", config.dvl.axes, "dvl.mounting_rpy_deg was determined with these axes")


def _heading(dives: Sequence[Dive], tried: Config) -> Iterator[Setting]:
    """Propose that the start heading is fitted where a track determines it, and the DVL's scale of that fit."""
    key, reference = "initial.heading_deg", dives[0].reference
    posed = tried.initial.source == "reference" and reference is not None and reference.has_attitude
    if posed or tried.initial.source == BY_SENSOR:
        return
    if reference is None or not reference.has_position:
        text = (
            "no reference gives the heading: the replayed track is relative to this one; "
            f'"{BY_SENSOR}" if the log has an AHRS or a compass'
        )
        yield Setting(key, 0.0, open=text)
        return
    fitted, failed = [], []
    for dive in dives:
        try:
            fitted.append(fitted_start(with_reference_at_imu(dive, tried), tried))
        except UserError as error:
            failed.append(error.message)
    if not fitted:
        yield Setting(key, None, failed[0], "heading at the start, from north over east")
        return
    headings = ", ".join(f"{start.heading_deg:.1f} +- {start.heading_sd_deg:.2g} deg" for start in fitted)
    text = f"each replay fits it to the track of the reference's positions; with these settings: {headings}"
    yield Setting(key, FIT, "; ".join((text, *failed)))
    if len(dives) > 1:
        return
    # Compare the baseline's track with the reference's, once its heading is fitted.
    config = with_settings(tried, [Setting(key, FIT)])
    once = msgspec.structs.replace(config.evaluation, starts=1)
    alone = {config.baseline: config.filters[config.baseline]}
    replay = replay_dive(dives[0], msgspec.structs.replace(config, filters=alone, evaluation=once))
    if replay.dive.reference is None:
        return
    fit = filter_track_fit(replay.errors[config.baseline], replay.dive.reference)
    if abs(fit.scale_pct) > CERTAIN_SDS * fit.scale_sd_pct:
        scale = tried.dvl.scale / (1.0 + 0.01 * fit.scale_pct)
        size = f"{abs(fit.scale_pct):.1f} % {'longer' if fit.scale_pct > 0.0 else 'shorter'}"
        text = f"the reference's track is {size} than the DVL's (sd {fit.scale_sd_pct:.1f} %): is the DVL wrong?"
        yield Setting("dvl.scale", tried.dvl.scale, open=text, others=(f"scale = {scale:.3f}",))
