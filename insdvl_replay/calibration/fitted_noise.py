"""Noise that nobody has given: that of the class of the IMU, fitted to the innovations of the dives' baseline.

Geometry and axes of the sensors are known here. `noise.fit` says what is free; all else stays as it is.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.calibration import Calibration
from insdvl_replay.calibration.dives import answer_of, calibrate_dives
from insdvl_replay.calibration.division import Division, beginning, bounded, middle
from insdvl_replay.calibration.found import FoundSettings, Given, as_given, with_values
from insdvl_replay.calibration.innovations import NOISE, ReadDive
from insdvl_replay.calibration.noise import DVL, GRADES, INERTIAL, imu_class, noise_class
from insdvl_replay.core.config import FREE, Config, Initial, flattened
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError, Note, UserError
from insdvl_replay.core.misfit import LEAST_NIS, MOST_NIS
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import one_stage
from insdvl_replay.evaluation.notes import beyond_the_sensor, readings_scatter
from insdvl_replay.preparation.prepared import KeptDive, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import baseline_fit, require_described

MOST_DIVES: Final = 5  # dives from which noise, and all settings of unknown logs, are found
MOST_ROUNDS: Final = 4  # in which the noise is scaled
# mean NIS/dof outside which the noise of the DVL is changed
WELL_ABOVE: Final = 0.6
WELL_BELOW: Final = 1.7
FITTED_NOTE: Final = "found_noise"
FITTING: Final = "fitting the noise"


def fit_noise_of_logs(
    logs: Sequence[Sequence[Path]],  # of one vehicle, each a dive
    config: Config,
    *,
    allow_damaged: bool = False,
    must_be_described: bool = False,  # leave out dives for which all settings have to be found
) -> FoundSettings:
    """Fit what `noise.fit` frees to the first `MOST_DIVES` dives that can be replayed.

    Without any, the settings are returned as they are: the replay of each dive says what is wrong with it.
    """
    if not config.noise.fit:
        return FoundSettings(config, ())
    alone = _with_baseline_alone(config)
    parts = list[_Parts]()
    digests = dict[tuple[Path, ...], str]()
    kept = None
    for paths in logs[:MOST_DIVES]:
        with suppress(UserError):
            # A dive alone is kept for its replay, with all that this needs.
            asked = config if len(logs) == 1 else alone
            dive = read_checked_dive(paths, asked, allow_damaged=allow_damaged)
            if len(logs) == 1:
                kept = KeptDive(dive)
                dive = _without_others(dive, alone)
            with one_stage(FITTING):
                if must_be_described:
                    require_described(dive)
                parts.append(_Parts.of(dive, alone))
            digests[tuple(paths)] = dive.sha256
            del dive
    if not parts:
        return FoundSettings(config, ())
    with one_stage(FITTING):
        found = _fit_noise(parts, config)
    return replace(found, digests=digests, kept=kept)


def _without_others(dive: Dive, config: Config) -> Dive:
    """Return a dive as it is read with some settings, without what only other filters need."""
    sensors = {name: columns for name, columns in dive.sensors.items() if name in config.sensors}
    return replace(dive, sensors=sensors, solutions={})


@dataclass(frozen=True)
class _Parts:
    """What the noise of a dive is fitted to, which is all of a short one; a day of data would say little more."""

    beginning: ReadDive  # over which the baseline runs from the dive's own start
    middle: ReadDive  # whose innovations are made likeliest
    imu_class: str

    @classmethod
    def of(cls, dive: Dive, config: Config) -> "_Parts":
        """Take them from a dive. A UserError where the baseline cannot be run."""
        whole = ReadDive(dive, config)
        began = beginning(whole)
        part = bounded(began)
        try:
            baseline_fit(part.dive, part.config)
        except UserError:
            if began is whole:
                raise
            # The reference may come later.
            began = whole
            part = bounded(whole)
            baseline_fit(part.dive, part.config)
        at_imu = replace(whole, dive=with_reference_at_imu(dive, config))
        return cls(part, _fittable_middle(at_imu), imu_class(began.imu_in_span))


def _fittable_middle(dive: ReadDive) -> ReadDive:
    """Return the middle of a long dive; its beginning where the baseline cannot be run in the middle."""
    inner = middle(dive)
    part = bounded(inner)
    if inner is dive:
        return part
    try:
        baseline_fit(part.dive, part.config)
    except UserError:
        return bounded(beginning(dive))
    return part


def _fit_noise(parts: Sequence[_Parts], config: Config) -> FoundSettings:
    """Fit what `noise.fit` frees to dives of one vehicle. The note says which noise they are replayed with."""
    alone = _with_baseline_alone(config)
    fixed: list[str] = []
    for word, keys in FREE.items():
        if word not in config.noise.fit:
            fixed += [f"{key}." for key in keys]
    values = [key for key, _ in flattened(msgspec.to_builtins(alone))]
    given = Given(alone, [key for key in values if f"{key}.".startswith(tuple(fixed))])
    preset = max((part.imu_class for part in parts), key=GRADES.index)
    found = as_given(of_class(preset, alone), given)
    notes = list[Note]()
    with suppress(UserError):  # too short a dive leaves the noise of the class
        found = _fitted(parts, found, given)
    found, better = with_biases_of_class(found, given, preset)
    if better != preset:
        preset = better
        with suppress(UserError):
            found = _fitted(parts, found, given)
    beginnings = [part.beginning for part in parts]
    found = levelled_to_dives(beginnings, found, given, found.initial, preset, notes)
    found = msgspec.structs.replace(
        with_values(config, "initial", **_values(found, "biases")),
        noise=found.noise,
        dvl=found.dvl,
    )
    return FoundSettings(found, tuple(notes))


def with_noise_of(config: Config, fitted: Config) -> Config:
    """Set what `noise.fit` frees to the values of settings whose noise is fitted."""
    free = config.noise.fit
    for word in free:
        section = FREE[word][0].partition(".")[0]
        values = _values(fitted, word)
        changed = msgspec.structs.replace(getattr(config, section), **values)
        config = msgspec.structs.replace(config, **{section: changed})
    return with_values(config, "noise", fit=())


def _values(config: Config, word: str) -> dict[str, object]:
    """Return the values of the keys that a word of `noise.fit` frees, by their names in their section."""
    values = {}
    for key in FREE[word]:
        section, name = key.split(".")
        values[name] = getattr(getattr(config, section), name)
    return values


def _with_baseline_alone(config: Config) -> Config:
    """Return the settings with the filter that the noise is fitted for."""
    baseline = config.filters[config.baseline]
    return msgspec.structs.replace(config, filters={config.baseline: baseline})


def _fitted(parts: Sequence[_Parts], config: Config, given: Given) -> Config:
    """Fit the noise to the innovations of all dives together; of one alone, the second half tests it if it is long."""
    read = [part.middle.with_settings(config) for part in parts]
    try:
        found = calibrate_dives(Division.found(read), config, [NOISE]).found
    except LogError:
        found = calibrate_dives(Division.nothing_held_out(read), config, [NOISE]).found
    return with_noise(config, answer_of(found).applied(found), given)


# --- What a search for all settings uses, too.


def of_class(preset: str, config: Config) -> Config:
    """Set the noise, the biases and the filters of a preset."""
    found = load_config(preset)
    config = msgspec.structs.replace(config, noise=found.noise, filters=found.filters)
    keys = ("accel_bias_sd_mg", "gyro_bias_sd_degph")
    return with_values(config, "initial", **{key: getattr(found.initial, key) for key in keys})


def with_noise(config: Config, found: Calibration, given: Given) -> Config:
    """Set the noise that a calibration proposes, except for what is given."""
    changed = config
    for row in found.noise_rows:
        section = "dvl" if row.parameter in DVL else "noise"
        is_kept = section == "dvl" and given.has(*FREE["dvl"])
        if row.is_proposed and not is_kept:
            changed = with_values(changed, section, **{row.parameter: row.after})
    return as_given(changed, given)


def with_biases_of_class(config: Config, given: Given, preset: str) -> tuple[Config, str]:
    """Take the biases of the class that the white noise belongs to, where it is better than that of the scatter.

    Coarse steps of the readings, and the vehicle's motion, scatter more than a good sensor.
    """
    usual = load_config(preset).noise
    fitted = {key: getattr(config.noise, key) for key in INERTIAL}
    if any(value == getattr(usual, key) for key, value in fitted.items()):
        return config, preset
    classes = [noise_class(key, value) or preset for key, value in fitted.items()]
    better = max(classes, key=GRADES.index)
    if GRADES.index(better) >= GRADES.index(preset):
        return config, preset
    return as_given(with_values(of_class(better, config), "noise", **fitted), given), better


@dataclass(frozen=True)
class _Levelling:
    """Scales noise by how large the innovations of the dives' baseline are."""

    dives: Sequence[ReadDive]
    given: Given
    started: Initial

    def size_with(self, config: Config) -> float:
        """Return the mean NIS over degrees of freedom, 1 as expected."""
        replayed = msgspec.structs.replace(config, initial=self.started)
        sizes = []
        for read in self.dives:
            size, _ = baseline_fit(read.dive, read.with_settings(replayed).config)
            sizes.append(size)
        return float(np.mean(sizes))

    def scaled(self, config: Config, *keys: str) -> tuple[Config, float]:
        """Scale some noise until the innovations are about as large as expected; return their size, too."""
        size = self.size_with(config)
        if self.given.has(*keys):
            return config, size
        for _ in range(MOST_ROUNDS):
            tried = _scaled(config, keys, np.sqrt(size))
            if WELL_ABOVE < size < WELL_BELOW or tried == config:
                break
            config = tried
            size = self.size_with(config)
        return config, size


def _scaled(config: Config, keys: Sequence[str], factor: float) -> Config:
    """Scale some noise, as far as a sensor can have it."""
    for key in keys:
        section, name = key.split(".")
        value = float(f"{getattr(getattr(config, section), name) * factor:.3g}")
        if not beyond_the_sensor(name, value):
            config = with_values(config, section, **{name: value})
    return config


def _as_quiet_as_readings(config: Config, dives: Sequence[ReadDive]) -> Config:
    """Lower the noise of the IMU to the scatter of its readings, which is the most that it can be."""
    for name, field in INERTIAL.items():
        most = max(
            readings_scatter(getattr(read.dive.imu, field), read.dive.imu.usual_step_s)
            for read in dives
        )
        quieter = float(f"{min(getattr(config.noise, name), most):.3g}")
        if not beyond_the_sensor(name, quieter):
            config = with_values(config, "noise", **{name: quieter})
    return config


def levelled_to_dives(
    dives: Sequence[ReadDive],
    config: Config,
    given: Given,
    started: Initial,
    preset: str,
    notes: list[Note],
) -> Config:
    """Scale the noise of the DVL until the innovations are as large as expected, where they are not."""
    key = "velocity_sd_mps" if config.dvl.beam_sd_mps is None else "beam_sd_mps"
    levelling = _Levelling(dives, given, started)
    config, size = levelling.scaled(config, f"dvl.{key}")
    if size < LEAST_NIS and not given.has("noise"):
        # The noise of the IMU decides.
        both = (f"dvl.{key}", "noise.accel_white_mps_rts")
        config, _ = levelling.scaled(_as_quiet_as_readings(config, dives), *both)
        config, preset = with_biases_of_class(config, given, preset)
        config, size = levelling.scaled(config, *both)
    code = FITTED_NOTE
    if not LEAST_NIS < size < MOST_NIS:
        code = f"{FITTED_NOTE} unexplained"
    noise = _noise_sentence(config, given, key, preset)
    notes.append(
        note(
            code,
            noise=noise,
            size=size,
        )
    )
    return config


def _noise_sentence(
    config: Config,
    given: Given,
    dvl_key: str,
    preset: str,
) -> str:
    """Say which noise was fitted, which is that of the class, and which was given."""
    usual = load_config(preset).noise
    words = {"fitted": list[str](), "of the class": list[str](), "given": list[str]()}
    for name in INERTIAL:
        value = getattr(config.noise, name)
        source = "fitted"
        if given.has(f"noise.{name}"):
            source = "given"
        elif value == getattr(usual, name):
            source = "of the class"
        words[source].append(f"{name} {value:.3g}")
    source = "given" if given.has(f"dvl.{dvl_key}") else "fitted"
    words[source].append(f"{dvl_key} {getattr(config.dvl, dvl_key):.3g}")
    parts = [f"{', '.join(values)} ({source})" for source, values in words.items() if values]
    return f"noise fitted to these dives, class {preset}: {'; '.join(parts)}"
