"""Settings that trial runs propose: how the DVL is turned, how noisy the IMU is, and the heading at the start.

The log is replayed with what was proposed so far. Where that takes a heading or a latitude that nobody knows yet, any
will do, since a DVL's innovations hardly depend on them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.fit import CLEARLY, TriedMounting, tried_mountings
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.core.config import Config, Dvl, Initial, Noise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.errors import UserError
from insdvl_replay.core.states import BY_SENSOR, DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.consistency import CLASSES, readings_scatter, sensor_class
from insdvl_replay.evaluation.drift import UNKNOWN, TrackFit, filter_track_fit
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.imu_proposal import axes_word
from insdvl_replay.inspection.proposed_settings import Setting, with_settings
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import FIT, fitted_start
from insdvl_replay.replay import replay_dive

UNKNOWN_LATITUDE_DEG: Final = 45.0
CERTAIN_SDS: Final = 5.0
"""A scale that a track shows less surely is not worth a line."""
_GRADES: Final = ("fog", "tactical", "mems")
"""Presets from the quietest IMU to the noisiest."""
_NOISES: Final = {"accel_white_mps_rts": "m/s/sqrt(s)", "gyro_white_rad_rts": "rad/sqrt(s)"}
_ARM_OPEN: Final = "IMU to DVL, forward, starboard, down, as built; `insdvl-replay calibrate` estimates it"


@dataclass(frozen=True)
class Trial:
    """What trial runs propose, and why some could not be made.

    Attributes
    ----------
    preset : str
        The class of the IMU, whose filters are proposed too; empty where the configuration has noise of its own.
    """

    settings: tuple[Setting, ...] = ()
    preset: str = ""
    failures: tuple[UserError, ...] = ()


def trial_runs(dives: Sequence[Dive], config: Config) -> Trial:
    """Propose noise, mounting and heading.

    Parameters
    ----------
    dives : sequence of Dive
        Of one vehicle, as they were read; at least one.
    config : Config
        With what was proposed so far.
    """
    settings: list[Setting] = []
    failures: list[UserError] = []
    preset = ""
    if (config.noise, config.filters) == (Noise(), Config().filters):
        preset, found = imu_class(dives[0].imu, config.initial)
        settings += found
    if config.dvl.lever_arm_m == Dvl().lever_arm_m:
        settings.append(Setting("dvl.lever_arm_m", config.dvl.lever_arm_m, open=_ARM_OPEN))
    tried = _startable(with_settings(preset_config(preset, config), settings))
    try:
        settings += _mounting([ReadDive(with_reference_at_imu(dive, tried), tried) for dive in dives], config)
        tried = with_settings(tried, settings)
        if config.initial.heading_deg is None and tried.initial.heading_deg is not None:
            settings += _heading(dives, tried)
    except UserError as error:
        failures.append(error)
    return Trial(tuple(settings), preset, tuple(failures))


def readable(
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


def preset_config(preset: str, config: Config) -> Config:
    """Set noise and filters of a preset in a configuration; none changes nothing."""
    if not preset:
        return config
    of_class = load_config(preset)
    return msgspec.structs.replace(config, noise=of_class.noise, filters=of_class.filters)


def _startable(config: Config) -> Config:
    """Set what nobody knows yet to what will do for the innovations."""
    initial = config.initial
    return msgspec.structs.replace(
        config,
        initial=msgspec.structs.replace(
            initial,
            heading_deg=0.0 if initial.heading_deg in (None, FIT) else initial.heading_deg,
            latitude_deg=UNKNOWN_LATITUDE_DEG if initial.latitude_deg is None else initial.latitude_deg,
        ),
    )


def imu_class(imu: ImuColumns, initial: Initial) -> tuple[str, list[Setting]]:
    """Find the class of sensors that the readings of an IMU may come from, and propose its noise and biases."""
    readings = (imu.specific_force_b, imu.angular_rate_b)
    scatter = {key: readings_scatter(of_one, imu.usual_step_s) for key, of_one in zip(_NOISES, readings, strict=True)}
    classes = [sensor_class(key, value) if value > 0.0 else "" for key, value in scatter.items()]
    preset = max((name or _GRADES[-1] for name in classes), key=_GRADES.index)
    said = ", ".join(
        f"{CLASSES[key].name} scatter by {value:.2g} {_NOISES[key]} from sample to sample ({name or 'of no class'})"
        for (key, value), name in zip(scatter.items(), classes, strict=True)
    )
    of_class, default = load_config(preset), Initial()
    noise = [Setting(f"noise.{key}", getattr(of_class.noise, key)) for key in Noise.__struct_fields__]
    open_ = "an IMU that smooths its readings is noisier than they show" if preset != _GRADES[-1] else ""
    noise[0] = Setting(noise[0].key, noise[0].value, f"preset {preset}: in the usual half second, {said}", open_)
    biases = [
        Setting(f"initial.{key}", getattr(of_class.initial, key), f"preset {preset}")
        for key in ("accel_bias_sd_mg", "gyro_bias_sd_degph")
        if getattr(initial, key) == getattr(default, key)
    ]
    return preset, [*noise, *biases]


def _mounting(dives: Sequence[ReadDive], config: Config) -> Iterator[Setting]:
    """Propose how the DVL is turned, if the innovations say it clearly, and say what they said."""
    tried = tried_mountings(dives)
    configured = next((one for one in tried if one.rpy_deg == config.dvl.mounting_rpy_deg), None)
    if configured is None:
        if config.dvl.mounting_rpy_deg == Dvl().mounting_rpy_deg:  # else a person has set it to what is none of them
            yield from _axes_of_beams(tried, dives[0].dive.dvl, config)
        return
    best, second = tried[:2]
    key, others = "dvl.mounting_rpy_deg", [one for one in tried if one is not configured]
    if best is configured:
        least, next_best = "this one leaves least of the innovations", f"the next best, {_rpy(others[0])}"
        text = f"of {len(tried)} ways to lay its axes {least}; {next_best}, {_compared(others[0], best)}"
        yield Setting(key, best.rpy_deg, text)
        yield from _axes(best, second, config)
    elif best.cost < CLEARLY * configured.cost:
        text = (
            f"of {len(tried)} ways to lay its axes, as its innovations say: as configured, "
            f"{_compared(configured, best)}; the next best, {_rpy(second)}, {_compared(second, best)}"
        )
        open_ = "it could as well be the next best" if best.cost > CLEARLY * second.cost else ""
        yield Setting(key, best.rpy_deg, text, open_)
        yield from _axes(best, second, config)
    else:
        text = f"the innovations do not tell: {_rpy(best)} leaves {best.cost / configured.cost:.2f} of what this does"
        yield Setting(key, configured.rpy_deg, text, "DVL to body, roll, pitch, heading, as built")


def _axes_of_beams(tried: Sequence[TriedMounting], dvl: DvlColumns, config: Config) -> Iterator[Setting]:
    """Propose axes with which the beams look down, where they do not as it is."""
    best, second = tried[:2]
    as_read = config.dvl.axes or FRD
    axes, other = (_turned_axes(as_read, one) for one in (best, second))
    look = ", ".join(f"{part:.2f}" for part in np.array(dvl.look_d))
    text = (
        f"with {as_read} the beams look along ({look}); of {len(tried)} ways to lay its axes so that they look down, "
        f"its innovations say this one; the next best, {other}, {_compared(second, best)}"
    )
    open_ = f'it could as well be "{other}"' if best.cost > CLEARLY * second.cost else ""
    yield Setting("dvl.axes", axes, text, open_)


def _turned_axes(axes: str, mounting: TriedMounting) -> str:
    """Write axes that have a mounting along them in them."""
    as_read = in_frd(np.eye(3), axes, "dvl.axes").T
    return axes_word(np.rint(mat_from_rpy(np.array(mounting.rpy_deg) * DEG)) @ as_read)


def _axes(best: TriedMounting, second: TriedMounting, config: Config) -> Iterator[Setting]:
    """Settle axes that were open: with any others, another mounting would say the same."""
    if config.dvl.axes is not None and best.cost < CLEARLY * second.cost:
        yield Setting("dvl.axes", config.dvl.axes, "with these the mounting was tried")


def _compared(other: TriedMounting, best: TriedMounting) -> str:
    return f"{other.cost / best.cost:.2f} times as much" if best.cost > 0.0 else "as much"


def _rpy(tried: TriedMounting) -> str:
    return f"[{', '.join(f'{angle:.0f}' for angle in tried.rpy_deg)}]"


def _heading(dives: Sequence[Dive], tried: Config) -> Iterator[Setting]:
    """Let the heading at the start be fitted where a track tells it, with the DVL's scale that is seen beside it."""
    key = "initial.heading_deg"
    reference = dives[0].reference
    posed = tried.initial.source == "reference" and reference is not None and reference.has_attitude
    if posed or tried.initial.source == BY_SENSOR:
        return
    if reference is None or not reference.has_position:
        text = f'no reference tells it: all that is replayed is relative to the first heading, or it is "{BY_SENSOR}"'
        yield Setting(key, 0.0, open=text)
        return
    fitted, failed = [], []
    for dive in dives:
        try:
            fitted.append(fitted_start(with_reference_at_imu(dive, tried), tried))
        except UserError as error:
            failed.append(error.message)
    if not fitted:
        yield Setting(key, None, failed[0], "at the start, from north over east")
        return
    told = ", ".join(f"{start.heading_deg:.1f} +- {start.heading_sd_deg:.2g} deg" for start in fitted)
    text = f"by the track of the reference's positions, anew in each replay; as settings are now, {told}"
    yield Setting(key, FIT, "; ".join((text, *failed)))
    if len(dives) == 1:
        yield from _scale(_track_fit(dives[0], with_settings(tried, [Setting(key, FIT)])), tried)


def _track_fit(dive: Dive, config: Config) -> TrackFit:
    """Hold the baseline's track against the reference's, once its heading is fitted."""
    baseline = {config.baseline: config.filters[config.baseline]}
    once = msgspec.structs.replace(config.evaluation, starts=1)
    replay = replay_dive(dive, msgspec.structs.replace(config, filters=baseline, evaluation=once))
    reference = replay.dive.reference
    return UNKNOWN if reference is None else filter_track_fit(replay.errors[config.baseline], reference)


def _scale(fit: TrackFit, tried: Config) -> Iterator[Setting]:
    if abs(fit.scale_pct) > CERTAIN_SDS * fit.scale_sd_pct:
        scale = tried.dvl.scale / (1.0 + 0.01 * fit.scale_pct)
        size = f"{abs(fit.scale_pct):.1f} % {'longer' if fit.scale_pct > 0.0 else 'shorter'}"
        text = f"the reference's track is {size} than the DVL's (sd {fit.scale_sd_pct:.1f} %): is it the DVL?"
        yield Setting("dvl.scale", tried.dvl.scale, open=text, others=(f"scale = {scale:.3f}",))


def warned(dives: Sequence[Dive]) -> Iterator[str]:
    """Repeat what was found wrong with the dives as they are read."""
    for dive in dives:
        yield from (f"{dive.name}: {note.text}" for note in dive.notes if note.severity == Severity.WARNING)
