"""The observability study: which errors at the start of a dive its measurements can tell apart, and which not."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pandas as pd

from insdvl_replay.core.config import Acceleration, Config, Filter, Initial
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.history import History
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import DirectionStatus
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.observability import (
    TOLERANCE,
    ErrorDirection,
    NominalPings,
    Observability,
    analyse,
    name_unobservable,
    named_directions,
    nominal_pings,
    remaining_cov,
    whitened_rows,
)
from insdvl_replay.preparation.filters import resolve_filter
from insdvl_replay.preparation.prepared import Prepared, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import prepare_with_heading, prepared_timeline, run_one
from insdvl_replay.sim.dive import exact_dive
from insdvl_replay.sim.trajectories import SCENARIOS
from insdvl_replay.studies.observability_document import (
    observability_display,
    observability_sentences,
    singular_value_figure,
)
from insdvl_replay.studies.study_report import StudyReport, write_study

_FACTORS = np.array([state.factor for state in STATES])


def observability_tables(
    found: Mapping[str, Observability],
    directions: tuple[ErrorDirection, ...],
    prior_sd: Floats,
    left_sd: Mapping[str, Floats],
) -> dict[str, pd.DataFrame]:
    """Lay out what was found.

    Parameters
    ----------
    found : mapping of str to Observability
        By aiding.
    directions : tuple of ErrorDirection
        Those that have a name.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.
    left_sd : mapping of str to ndarray, shape (12,)
        Those after the last ping, with process noise, by aiding.

    Returns
    -------
    dict of str to DataFrame
        ``ranks``: aiding, rank, states, gap, weak (observable directions whose signal is below the noise), unnamed
        (unobservable directions without a name).
        ``directions``: aiding, direction, label, signal_to_noise, status (``unobservable``, ``weak``, ``seen``).
        ``catalogue``: direction, label, and its 12 errors in display units, the leading one 1.
        ``singular_values``: aiding, number, singular_value, left_without_noise_pct of the prior, and the direction's 12
        errors in display units, as large as the prior.
        ``states``: aiding, state, unit, prior_sd, left_sd and left_pct of the prior after the last ping, with process
        noise, and left_without_noise_pct, what would be left without of the errors at the start.
    """
    named = {aiding: name_unobservable(one, directions, prior_sd) for aiding, one in found.items()}
    return {
        "ranks": _ranks(found, named),
        "directions": _directions(found, named, directions, prior_sd),
        "catalogue": _catalogue(directions, prior_sd),
        "singular_values": _singular_values(found, prior_sd),
        "states": _states(found, prior_sd, left_sd),
    }


def _ranks(found: Mapping[str, Observability], named: Mapping[str, tuple[ErrorDirection, ...]]) -> pd.DataFrame:
    rows = [
        (
            aiding,
            one.rank,
            len(STATES),
            one.gap,
            int(np.sum(one.singular_values[: one.rank] < 1.0)),
            len(STATES) - one.rank - len(named[aiding]),
        )
        for aiding, one in found.items()
    ]
    return pd.DataFrame(rows, columns=["aiding", "rank", "states", "gap", "weak", "unnamed"])


def _directions(
    found: Mapping[str, Observability],
    named: Mapping[str, tuple[ErrorDirection, ...]],
    directions: tuple[ErrorDirection, ...],
    prior_sd: Floats,
) -> pd.DataFrame:
    rows = []
    for aiding, one in found.items():
        for direction in directions:
            response = one.response(direction.scaled(prior_sd))
            status = DirectionStatus.WEAK if response < 1.0 else DirectionStatus.SEEN
            if direction in named[aiding]:
                status = DirectionStatus.UNOBSERVABLE
            rows.append((aiding, direction.id, direction.label, response, status))
    return pd.DataFrame(rows, columns=["aiding", "direction", "label", "signal_to_noise", "status"])


def _catalogue(directions: tuple[ErrorDirection, ...], prior_sd: Floats) -> pd.DataFrame:
    rows = []
    for direction in directions:
        displayed = direction.error / _FACTORS
        leading = displayed[np.argmax(np.abs(direction.scaled(prior_sd)))]
        rows.append((direction.id, direction.label, *(displayed / leading)))
    return pd.DataFrame(rows, columns=["direction", "label", *(state.id for state in STATES)])


def _singular_values(found: Mapping[str, Observability], prior_sd: Floats) -> pd.DataFrame:
    rows = [
        (aiding, number, value, 100.0 / np.sqrt(1.0 + value**2), *(direction * prior_sd / _FACTORS))
        for aiding, one in found.items()
        for number, (value, direction) in enumerate(zip(one.singular_values, one.directions, strict=True), start=1)
    ]
    columns = ["aiding", "number", "singular_value", "left_without_noise_pct", *(state.id for state in STATES)]
    return pd.DataFrame(rows, columns=columns)


def _states(found: Mapping[str, Observability], prior_sd: Floats, left_sd: Mapping[str, Floats]) -> pd.DataFrame:
    tables = []
    for aiding, one in found.items():
        rows = pd.DataFrame([(aiding, state.id, state.unit) for state in STATES], columns=["aiding", "state", "unit"])
        rows["prior_sd"], rows["left_sd"] = prior_sd / _FACTORS, left_sd[aiding] / _FACTORS
        rows["left_pct"], rows["left_without_noise_pct"] = 100.0 * left_sd[aiding] / prior_sd, 100.0 * one.left()
        tables.append(rows)
    return pd.concat(tables, ignore_index=True)


AIDING: Final = {
    "velocity": ("velocity",),
    "published": ("published",),
    "windowed": ("windowed",),
    "velocity + published": ("velocity", "published"),
    "velocity + windowed": ("velocity", "windowed"),
}
"""What each row of the study stacks: velocities, accelerations in either model, or both."""
NO_GATE: Final = 1.0
"""Share of chi-square inside which every innovation lies."""


def study_observability(dive_or_scenario: str, config: Config, *, earth_rate: bool = True) -> StudyReport:
    """Analyse what velocities and accelerations tell about the errors at the start of a dive.

    The motion around which the errors are linearised is that of the first filter: along a scenario, with perfect
    sensors, it is the exact one. The process noise is that of the first filter, too.

    Parameters
    ----------
    dive_or_scenario : str
        Path of a log, or a name in `trajectories.SCENARIOS`.
    config : Config
        Its span cuts the dive; its initial uncertainty and its noise are the units in which errors and signals count.
    earth_rate : bool
        False: let the Earth be flat and at rest.

    Returns
    -------
    StudyReport
        Tables ``ranks``, ``directions``, ``singular_values``, ``states`` and ``catalogue``.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        There is no such log or scenario, or the settings do not fit it.
    """
    dive, config = _dive(dive_or_scenario, config)
    start = prepare_with_heading(dive, config)
    nominal, pings = _nominal(dive, start, earth_rate)
    measurements, arm_b = _measurements(start, config), start.mounting.lever_arm_b
    prior_sd = start.alignment.start.sd
    found, left_sd = {}, {}
    for name, aiding in AIDING.items():
        stack = [measurements[single] for single in aiding]
        found[name] = analyse(np.vstack([whitened_rows(pings, single, arm_b) for single in stack]), prior_sd)
        left_sd[name] = np.sqrt(np.diag(remaining_cov(pings, stack, arm_b, prior_sd)))
    start_of = (nominal.position[0], nominal.velocity_n[0], nominal.mat_nb[0])
    directions = named_directions(*start_of, earth_rate=earth_rate)
    tables = observability_tables(found, directions, prior_sd, left_sd)
    seconds_s = (start.end_ns - start.alignment.start_ns) * 1e-9
    earth = "" if earth_rate else ", Earth rate left out"
    return StudyReport(
        study="observability",
        title=f"Observability study: {dive.name}, {seconds_s:.1f} s, {len(start.velocities.time_ns)} pings{earth}",
        arguments={"dive": dive.name, "earth_rate": earth_rate},
        sentences=observability_sentences(tables, TOLERANCE),
        tables=tables,
        display=observability_display(tables),
        config=config,
        notes=dive.notes + start.notes,
    )


def save_observability(report: StudyReport, folder: Path, *, png: bool = False) -> None:
    """Write a study's files into an empty folder; the same study gives the same bytes.

    Parameters
    ----------
    report : StudyReport
        From `study_observability`.
    folder : Path
        Exists.
    png : bool
        Draw the picture as PNG, too.
    """
    figure = singular_value_figure(report.title, report.tables["singular_values"], TOLERANCE)
    write_study(report, folder, {"singular_values": figure}, png=png)


def _dive(dive_or_scenario: str, config: Config) -> tuple[Dive, Config]:
    """Read the log, or make the scenario's exact dive, whose sensors have no scale and no biases to take out."""
    path = Path(dive_or_scenario)
    if path.exists():
        return with_reference_at_imu(read_checked_dive(path, config.without_solutions()), config), config
    if dive_or_scenario not in SCENARIOS:
        raise ConfigError(f"{dive_or_scenario}: is neither a log nor a scenario", f"scenarios: {', '.join(SCENARIOS)}")
    dvl = msgspec.structs.replace(config.dvl, scale=1.0)
    unbiased = Initial()
    initial = msgspec.structs.replace(
        config.initial,
        source="reference",
        accel_bias_mg=unbiased.accel_bias_mg,
        gyro_bias_degph=unbiased.gyro_bias_degph,
    )
    dive = exact_dive(dive_or_scenario, lever_arm_m=dvl.lever_arm_m, mounting_rpy_deg=dvl.mounting_rpy_deg)
    return dive, msgspec.structs.replace(config, dvl=dvl, initial=initial)


def _nominal(dive: Dive, start: Prepared, earth_rate: bool) -> tuple[History, NominalPings]:
    """Run the first filter for the nominal motion, and let errors grow and its process noise gather around it."""
    timeline = prepared_timeline(replace(dive, reference=None), start)
    baseline = replace(start.filters[0], gate_probability=NO_GATE)
    nominal = run_one(baseline, start, timeline)
    return nominal, nominal_pings(timeline, nominal, baseline.noise_density[: len(STATES)], earth_rate=earth_rate)


def _measurements(start: Prepared, config: Config) -> dict[str, Measurement]:
    """Prepare each measurement alone."""
    prepared = {}
    for name, single in _single_aidings(config).items():
        resolved = resolve_filter(name, single, config)
        (prepared[name],) = resolved.measurements(start.velocities, start.mounting, start.gaps)
    return prepared


def _single_aidings(config: Config) -> dict[str, Filter]:
    """Make a filter of each measurement alone: the first filter's velocities, the first accelerations configured."""
    baseline = config.filters[config.baseline]
    with_acceleration = (filter_ for filter_ in config.filters.values() if filter_.acceleration is not None)
    owner = next(with_acceleration, baseline)
    acceleration = owner.acceleration or Acceleration()
    change = partial(msgspec.structs.replace, gate_probability=NO_GATE)
    return {"velocity": change(baseline, aiding=("velocity",))} | {
        model: change(owner, aiding=("acceleration",), acceleration=msgspec.structs.replace(acceleration, model=model))
        for model in ("published", "windowed")
    }
