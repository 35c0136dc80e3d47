"""The tuned baseline, with its noise fitted to the dive, so that one sees what tuning alone would have given.

The fit takes the noise under which the baseline's own innovations are most likely. It knows nothing of the reference.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config, Filter
from insdvl_replay.core.dive_columns import Dive, Floats, ImuColumns
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.evaluation.consistency import log_likelihood
from insdvl_replay.evaluation.notes import (
    CLASSES,
    NOISE_FAR_OFF,
    beyond_the_sensor,
    readings_scatter,
    sensor_class,
)
from insdvl_replay.preparation.filters import resolve_filter
from insdvl_replay.preparation.prepared import Prepared, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.preparation.run import prepare_with_heading, prepared_timeline, run_one

NAME = "tuned"
INERTIAL: Final = ("accel_white_mps_rts", "gyro_white_rad_rts")
FIT_S = 1800.0
"""The fit reads this much of a dive from its first ping on, which on the way down of a deep one may be long in coming;
noise does not change so much that more would say more."""
LOWEST = 1e-3
HIGHEST = 1e3
"""Factors of the baseline's noise between which the fit looks."""
STARTS: Final = tuple(product((1.0, 0.1, 0.01), (1.0, 10.0, 100.0), (1.0, 0.3)))
"""Factors of which the likeliest is the start: innovations can have several likely causes, a quiet DVL on a restless
IMU among them, and a search from one place finds the nearest."""

LIKELIHOOD_DIGITS: Final = 3
"""Decimals of a log-likelihood that count. Where innovations tell nothing of a noise, its further ones differ from
processor to processor, and the search would go where they point."""


def replay_with_tuned_baseline(
    path: Path | Sequence[Path],
    config: Config,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
) -> Replay:
    """Replay the dive in a log, with the tuned baseline beside the configured filters."""
    dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
    config, found = with_tuned_baseline(dive, config)
    dive = replace(dive, name=name or dive.name, notes=(*dive.notes, *found))
    replay = replay_dive(dive, config)
    # The control stands beside it now: nothing has to point at it.
    notes = tuple(note for note in replay.notes if note.code != NOISE_FAR_OFF)
    return replace(replay, notes=notes)


def with_tuned_baseline(dive: Dive, config: Config) -> tuple[Config, tuple[Note, ...]]:
    """Return the settings with the tuned baseline among the filters, and notes on its noise."""
    baseline = config.filters[config.baseline]
    _require_tunable(baseline, config)
    dive = with_reference_at_imu(dive, config)
    start = prepare_with_heading(dive, config)
    end_ns = min(start.end_ns, int(start.velocities.time_ns[0]) + int(FIT_S * 1e9))
    fitted_to = start.velocities.within(start.alignment.start_ns, end_ns)
    start = replace(start, velocities=fitted_to, end_ns=end_ns)
    # What is fitted, by key, as the baseline has it. The DVL's noise is in one of two keys.
    resolved = start.filters[0]
    before = {key: getattr(resolved.inertial_noise, key) for key in INERTIAL}
    before[resolved.dvl_noise.key] = resolved.dvl_noise.sd_mps
    tuned = _fitted(dive, start, config, baseline, before)
    values = {key: getattr(tuned, key) for key in before}
    imu = dive.imu.within(start.alignment.start_ns, start.end_ns)
    notes = (_fitted_note(values, before), *_out_of_class_notes(values, imu))
    return msgspec.structs.replace(config, filters={**config.filters, NAME: tuned}), notes


def _require_tunable(baseline: Filter, config: Config) -> None:
    """Raise ConfigError where there is a control already, or the baseline takes more than velocities."""
    if NAME in config.filters:
        raise ConfigError(
            f"filter '{NAME}' is configured already",
            f"rename [filters.{NAME}], or leave --control out",
        )
    if baseline.aiding != ("velocity",):
        raise ConfigError(
            f"--control tunes a baseline aided by velocity alone, found {list(baseline.aiding)}",
            "name such a filter first in the configuration",
        )


def _fitted_note(values: Mapping[str, float], before: Mapping[str, float]) -> Note:
    """Say what was fitted, and of which class that is."""
    pasted = ", ".join(f"{key} = {value:.4g}" for key, value in values.items())
    edges = []
    for key, value in values.items():
        lowest = 1.01 * LOWEST * before[key]
        highest = HIGHEST / 1.01 * before[key]
        if not lowest < value < highest:
            edges.append(key)
    classes = dict[str, str]()
    for key in INERTIAL:
        if key not in edges:
            classes[CLASSES[key].name] = sensor_class(key, values[key])
    named = [f"{sensors} of class {best}" for sensors, best in classes.items() if best]
    classes_words = ""
    if named:
        classes_words = f" ({', '.join(named)})"
    code = "control_fitted"
    if edges:
        code = "control_fitted edge"
    return note(
        code,
        len(values),
        filter=NAME,
        values=pasted,
        classes=classes_words,
        edges=", ".join(edges),
    )


def _out_of_class_notes(values: Mapping[str, float], imu: ImuColumns) -> Iterator[Note]:
    """Say which noise stands for something else than that of a sensor."""
    scatter = dict[str, float]()
    for key, values_b in zip(INERTIAL, (imu.specific_force_b, imu.angular_rate_b), strict=True):
        scatter[key] = readings_scatter(values_b, imu.usual_step_s)
    found = []
    for key, value in values.items():
        reason = beyond_the_sensor(key, value, scatter.get(key, 0.0))
        if reason:
            found.append(f"{key} = {value:.4g} is {reason}")
    if found:
        yield note(
            "control_out_of_class",
            len(found),
            reasons="; ".join(found),
        )


def _fitted(
    dive: Dive,
    start: Prepared,
    config: Config,
    baseline: Filter,
    before: Mapping[str, float],
) -> Filter:
    """Return the baseline with the likeliest noise."""

    def filter_with(logarithms: Floats) -> Filter:
        factors = np.exp(np.clip(logarithms, np.log(LOWEST), np.log(HIGHEST)))
        values = {
            key: float(value * factor)
            for (key, value), factor in zip(before.items(), factors, strict=True)
        }
        return msgspec.structs.replace(baseline, **values)

    # a third of a second, which a replay without it must not wait
    from scipy.optimize import minimize

    report_stage("running the filters")
    timeline = prepared_timeline(dive, start)

    def negative_log_likelihood(logarithms: Floats) -> float:
        tried = resolve_filter(NAME, filter_with(logarithms), config)
        history = run_one(tried, start, timeline)
        return -round(log_likelihood(history.innovations[0]), LIKELIHOOD_DIGITS)

    best = min(np.log(STARTS), key=negative_log_likelihood)
    for step in (-2.0, 0.5):  # the second search frees what fell flat against an edge
        simplex = best + np.vstack([np.zeros(3), step * np.eye(3)])
        found = minimize(
            negative_log_likelihood,
            best,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.1, "maxfev": 150},
        )
        best = np.clip(found.x, np.log(LOWEST), np.log(HIGHEST))
    return filter_with(best)
