"""The control: the baseline with its noise fitted to the dive, so that one sees what tuning alone would have given.

The fit takes the noise under which the baseline's own innovations are most likely. It knows nothing of the reference.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay import logs
from insdvl_replay.columns import Dive, Floats
from insdvl_replay.config import Config, Filter
from insdvl_replay.errors import ConfigError, Note
from insdvl_replay.evaluation.consistency import log_likelihood
from insdvl_replay.preparation import prepare_dive, with_reference_at_imu
from insdvl_replay.replay import Replay, replay_dive, run_filters

NAME = "tuned"
"""Name of the control among the filters."""
FIT_S = 1800.0
"""The fit reads this much of a dive from its first ping on, which on the way down of a deep one may be long in coming;
noise does not change so much that more would say more."""
LOWEST, HIGHEST = 1e-3, 1e3
"""Factors of the baseline's noise between which the fit looks."""
STARTS: Final = tuple(product((1.0, 0.1, 0.01), (1.0, 10.0, 100.0), (1.0, 0.3)))
"""Factors of which the likeliest is the start: innovations can have several likely causes, a quiet DVL on a restless
IMU among them, and a search from one place finds the nearest. Order as of `_keys`."""

LIKELIHOOD_DIGITS: Final = 3
"""Decimals of a log-likelihood that count. Where innovations tell nothing of a noise, its further ones differ from
processor to processor, and the search would go where they point."""


def replay_with_control(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False, name: str | None = None
) -> Replay:
    """Replay the dive in a log, with the control beside the configured filters.

    Parameters
    ----------
    path : Path or sequence of Path
    config : Config
    allow_damaged : bool
    name : str, optional
        As of `replay.replay_log`.

    Returns
    -------
    Replay

    Raises
    ------
    LogError, ConfigError
        As of `replay.replay_log` and `with_control`.
    """
    dive = logs.read_dive(path, config, allow_damaged=allow_damaged)
    config, note = with_control(dive, config)
    return replay_dive(replace(dive, name=name or dive.name, notes=(*dive.notes, note)), config)


def with_control(dive: Dive, config: Config) -> tuple[Config, Note]:
    """Add the control to the filters.

    Parameters
    ----------
    dive : Dive
    config : Config

    Returns
    -------
    Config
        With the filter ``tuned`` at the end, which repeats the result without another fit.
    Note
        The fitted values, ready to be pasted.

    Raises
    ------
    ConfigError
        A filter bears the control's name already, or the baseline is not aided by velocity.
    LogError
        The dive cannot be replayed.
    """
    baseline = config.filters[config.baseline]
    if NAME in config.filters:
        raise ConfigError(f"filter '{NAME}' is configured already", f"rename [filters.{NAME}], or leave --control out")
    if baseline.aiding != ("velocity",):
        raise ConfigError(
            f"--control tunes a baseline aided by velocity alone, found {list(baseline.aiding)}",
            "name such a filter first in the configuration",
        )
    tuned = _fitted(dive, config, baseline)
    values = {key: getattr(tuned, key) for key in _keys(config, baseline)}
    pasted = ", ".join(f"{key} = {value:.4g}" for key, value in values.items())
    text = f"noise of the control, fitted to the baseline's innovations: [filters.{NAME}] {pasted}"
    if edges := [key for key, value in values.items() if _at_the_edge(value / _value(baseline, config, key))]:
        text += f"; at the edge of what is looked at, where the innovations tell no more: {', '.join(edges)}"
    note = Note("control_fitted", text, len(values))
    return msgspec.structs.replace(config, filters={**config.filters, NAME: tuned}), note


def _keys(config: Config, baseline: Filter) -> tuple[str, str, str]:
    """Name what is fitted: the DVL's noise stands in one of two keys."""
    beams = baseline.beam_sd_mps or config.dvl.beam_sd_mps
    return "accel_white_mps_rts", "gyro_white_rad_rts", "beam_sd_mps" if beams else "velocity_sd_mps"


def _fitted(dive: Dive, config: Config, baseline: Filter) -> Filter:
    dive = with_reference_at_imu(dive, config)
    start = prepare_dive(dive, config)
    end_ns = min(start.end_ns, int(start.velocities.time_ns[0]) + int(FIT_S * 1e9))
    start = replace(start, velocities=start.velocities.within(start.alignment.start_ns, end_ns), end_ns=end_ns)
    keys = _keys(config, baseline)
    before = np.array([_value(baseline, config, key) for key in keys])

    def filter_with(logarithms: Floats) -> Filter:
        values = before * np.exp(np.clip(logarithms, np.log(LOWEST), np.log(HIGHEST)))
        return msgspec.structs.replace(baseline, **{key: float(value) for key, value in zip(keys, values, strict=True)})

    from scipy.optimize import minimize  # a third of a second, which a replay without the control must not wait

    def unlikelihood(logarithms: Floats) -> float:
        alone = msgspec.structs.replace(config, filters={NAME: filter_with(logarithms)})
        (history,) = run_filters(dive, start, alone)
        return -round(log_likelihood(history.innovations[0]), LIKELIHOOD_DIGITS)

    best = min(np.log(STARTS), key=unlikelihood)
    for step in (-2.0, 0.5):  # the second search frees what fell flat against an edge
        simplex = best + np.vstack([np.zeros(3), step * np.eye(3)])
        found = minimize(
            unlikelihood,
            best,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.1, "maxfev": 150},
        )
        best = np.clip(found.x, np.log(LOWEST), np.log(HIGHEST))
    return filter_with(best)


def _at_the_edge(factor: float) -> bool:
    return not 1.01 * LOWEST < factor < HIGHEST / 1.01


def _value(baseline: Filter, config: Config, key: str) -> float:
    own = getattr(baseline, key)
    common = getattr(config.noise, key) if hasattr(config.noise, key) else getattr(config.dvl, key)
    return float(common if own is None else own)
