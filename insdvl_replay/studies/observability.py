"""The observability study: which errors at the start of a dive the measurements can observe, and which not."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd

from insdvl_replay.core.config import Acceleration, Config, Filter, Initial
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.quantities import label
from insdvl_replay.core.states import STATES
from insdvl_replay.core.words import DirectionStatus
from insdvl_replay.document.parts import (
    LIMIT,
    Curve,
    DisplayTable,
    Figure,
    Panel,
    Result,
    filter_style,
)
from insdvl_replay.document.tables import (
    MISSING,
    number,
    percent,
    table_of,
)
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.observability import (
    TOLERANCE,
    ErrorDirection,
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

AIDING: Final = {
    "velocity": ("velocity",),
    "published": ("published",),
    "windowed": ("windowed",),
    "velocity + published": ("velocity", "published"),
    "velocity + windowed": ("velocity", "windowed"),
}
"""The measurements of each row of the study: velocities, accelerations in one of the models, or both."""
NO_GATE: Final = 1.0
"""Gate probability that accepts every innovation."""
_NOTHING: Final = 1e-5
"""Smaller components of a direction, in shown units with a leading 1, are not printed."""
_SMALLEST: Final = 1e-12
"""Singular values are drawn down to this share of the largest; smaller ones are rounding errors."""
_GROWN_PCT: Final = 101.0
"""Percent of the prior above which a state counts as less certain; the walk of a bias alone is below it."""


def study_observability(
    dive_or_scenario: str, config: Config, *, earth_rate: bool = True
) -> Result:
    """Analyse the observability of the errors at the start of a dive from velocities and accelerations.

    The errors are linearised around the motion of the first filter. In a scenario, with perfect sensors, this is the
    exact motion. The process noise is that of the first filter. Errors are in units of the initial uncertainty, signals
    in units of the configured noise. Without ``earth_rate`` the Earth is flat and
    at rest. A LogError or ConfigError if the log, the scenario or the settings cannot be used.
    """
    dive, config = _dive(dive_or_scenario, config)
    start = prepare_with_heading(dive, config)
    timeline = prepared_timeline(replace(dive, reference=None), start)
    baseline = replace(start.filters[0], gate_probability=NO_GATE)
    nominal = run_one(baseline, start, timeline)
    pings = nominal_pings(
        timeline, nominal, baseline.noise_density[: len(STATES)], earth_rate=earth_rate
    )
    measurements = _measurements(start, config)
    arm_b = start.mounting.lever_arm_b
    prior_sd = start.alignment.start.sd
    found = {}
    left_sd = {}
    for name, aiding in AIDING.items():
        stack = [measurements[single] for single in aiding]
        rows = [whitened_rows(pings, single, arm_b) for single in stack]
        found[name] = analyse(np.vstack(rows), prior_sd)
        left_sd[name] = np.sqrt(np.diag(remaining_cov(pings, stack, arm_b, prior_sd)))
    start_of = (nominal.position[0], nominal.velocity_n[0], nominal.mat_nb[0])
    tables = observability_tables(
        found, named_directions(*start_of, earth_rate=earth_rate), prior_sd, left_sd
    )
    seconds_s = (start.end_ns - start.alignment.start_ns) * 1e-9
    earth = "" if earth_rate else ", Earth rate left out"
    title = f"Observability study: {dive.name}, {seconds_s:.1f} s, {len(start.velocities.time_ns)} pings{earth}"
    return Result(
        kind="observability",
        title=title,
        sentences=(
            *_sentences(tables),
            f"Singular values up to {TOLERANCE:.0e} of the largest count as zero.",
        ),
        tables=tables,
        figures={
            "singular_values": singular_value_figure(title, tables["singular_values"], TOLERANCE)
        },
        notes=dive.notes + start.notes,
        config=config,
        arguments={"dive": dive.name, "earth_rate": earth_rate},
        display=tuple(_display(tables)),
    )


def _dive(dive_or_scenario: str, config: Config) -> tuple[Dive, Config]:
    """Read the log, or simulate the scenario's exact dive, with scale 1 and zero biases in the settings."""
    path = Path(dive_or_scenario)
    if path.exists():
        dive = read_checked_dive(path, config.without_solutions())
        return with_reference_at_imu(dive, config), config
    if dive_or_scenario not in SCENARIOS:
        text = f"{dive_or_scenario}: is neither a log nor a scenario"
        raise ConfigError(text, f"scenarios: {', '.join(SCENARIOS)}")
    change = msgspec.structs.replace
    unbiased = Initial()
    dvl = change(config.dvl, scale=1.0)
    biases = {"accel_bias_mg": unbiased.accel_bias_mg, "gyro_bias_degph": unbiased.gyro_bias_degph}
    dive = exact_dive(
        dive_or_scenario, lever_arm_m=dvl.lever_arm_m, mounting_rpy_deg=dvl.mounting_rpy_deg
    )
    return dive, change(
        config, dvl=dvl, initial=change(config.initial, source="reference", **biases)
    )


def _measurements(start: Prepared, config: Config) -> dict[str, Measurement]:
    """Prepare each measurement alone: the first filter's velocities, the first accelerations configured."""
    baseline = config.filters[config.baseline]
    with_acceleration = [one for one in config.filters.values() if one.acceleration is not None]
    owner = with_acceleration[0] if with_acceleration else baseline
    acceleration = owner.acceleration or Acceleration()
    change = partial(msgspec.structs.replace, gate_probability=NO_GATE)
    singles: dict[str, Filter] = {"velocity": change(baseline, aiding=("velocity",))}
    for model in ("published", "windowed"):
        modelled = msgspec.structs.replace(acceleration, model=model)
        singles[model] = change(owner, aiding=("acceleration",), acceleration=modelled)
    prepared = {}
    for name, single in singles.items():
        resolved = resolve_filter(name, single, config)
        (prepared[name],) = resolved.measurements(start.velocities, start.mounting, start.gaps)
    return prepared


# --- The tables.


_IDS: Final = [state.id for state in STATES]
_FACTORS: Final = np.array([state.factor for state in STATES])


def observability_tables(
    found: Mapping[str, Observability],  # by aiding
    directions: tuple[ErrorDirection, ...],  # the named ones
    prior_sd: Floats,  # (12,), of the states at the start, SI units
    left_sd: Mapping[str, Floats],  # (12,), after the last ping, with process noise, by aiding
) -> dict[str, pd.DataFrame]:
    """Return the tables of the study.

    ``ranks``: aiding, rank, states, gap, weak (observable directions whose signal is below the noise), unnamed
    (unobservable directions without a name).
    ``directions``: aiding, direction, label, signal_to_noise, status (``unobservable``, ``weak``, ``seen``).
    ``catalogue``: direction, label, and its 12 errors in shown units, the leading one 1.
    ``singular_values``: aiding, number, singular_value, left_without_noise_pct of the prior, and the direction's 12
    errors in shown units, as large as the prior.
    ``states``: aiding, state, unit, prior_sd, left_sd and left_pct of the prior after the last ping, with process
    noise, and left_without_noise_pct, the remaining part of the start errors without process noise.
    """
    ranks = []
    seen = []
    values: list[tuple[str | float, ...]] = []
    states = []
    for aiding, analysis in found.items():
        unobservable = name_unobservable(analysis, directions, prior_sd)
        weak = int(np.sum(analysis.singular_values[: analysis.rank] < 1.0))
        unnamed = len(STATES) - analysis.rank - len(unobservable)
        ranks.append((aiding, analysis.rank, len(STATES), analysis.gap, weak, unnamed))
        for direction in directions:
            response = analysis.response(direction.scaled(prior_sd))
            status = DirectionStatus.WEAK if response < 1.0 else DirectionStatus.SEEN
            if direction in unobservable:
                status = DirectionStatus.UNOBSERVABLE
            seen.append((aiding, direction.id, direction.label, response, status))
        values += _value_rows(aiding, analysis, prior_sd)
        states.append(_state_rows(aiding, analysis, prior_sd, left_sd[aiding]))
    rank_columns = ["aiding", "rank", "states", "gap", "weak", "unnamed"]
    seen_columns = ["aiding", "direction", "label", "signal_to_noise", "status"]
    value_columns = ["aiding", "number", "singular_value", "left_without_noise_pct", *_IDS]
    return {
        "ranks": pd.DataFrame(ranks, columns=rank_columns),
        "directions": pd.DataFrame(seen, columns=seen_columns),
        "catalogue": _catalogue(directions, prior_sd),
        "singular_values": pd.DataFrame(values, columns=value_columns),
        "states": pd.concat(states, ignore_index=True),
    }


def _value_rows(
    aiding: str, analysis: Observability, prior_sd: Floats
) -> Iterator[tuple[str | float, ...]]:
    """Give the singular values with their directions, as large as the prior."""
    orthogonal = zip(analysis.singular_values, analysis.directions, strict=True)
    for count, (value, vector) in enumerate(orthogonal, start=1):
        left_pct = 100.0 / np.sqrt(1.0 + value**2)
        yield (aiding, count, value, left_pct, *(vector * prior_sd / _FACTORS))


def _state_rows(
    aiding: str,
    analysis: Observability,
    prior_sd: Floats,
    left_sd: Floats,
) -> pd.DataFrame:
    """Return how certain each state is after the last ping."""
    return pd.DataFrame(
        {
            "aiding": aiding,
            "state": _IDS,
            "unit": [state.unit for state in STATES],
            "prior_sd": prior_sd / _FACTORS,
            "left_sd": left_sd / _FACTORS,
            "left_pct": 100.0 * left_sd / prior_sd,
            "left_without_noise_pct": 100.0 * analysis.left(),
        }
    )


def _catalogue(directions: Sequence[ErrorDirection], prior_sd: Floats) -> pd.DataFrame:
    """Return the errors of the named directions."""
    rows = []
    for direction in directions:
        displayed = direction.error / _FACTORS
        leading = displayed[np.argmax(np.abs(direction.scaled(prior_sd)))]
        rows.append((direction.id, direction.label, *(displayed / leading)))
    return pd.DataFrame(rows, columns=["direction", "label", *_IDS])


# --- Screen and pictures.


def _sentences(tables: Mapping[str, pd.DataFrame]) -> Iterator[str]:
    """Yield for each aiding its rank, the unobservable directions, and the states that become less certain."""
    directions = tables["directions"]
    unobservable = directions[directions["status"] == DirectionStatus.UNOBSERVABLE]
    unseen = unobservable.groupby("aiding")["label"].agg(list)
    row: Any
    for row in tables["ranks"].itertuples():
        rank = f"{row.aiding}: rank {row.rank} of {row.states}"
        if row.weak:
            rank += f", {row.weak} of them with a signal below the noise"
        if row.rank == row.states:
            yield f"{rank}."
            continue
        if np.isfinite(row.gap):
            rank += f"; the next singular value is {row.gap:.0e} times smaller"
        names = list(unseen.get(row.aiding, []))
        if row.unnamed:
            names.append(f"{row.unnamed} without a name")
        yield f"{rank}; unobservable: {', '.join(names)}."
    for aiding, states in tables["states"].groupby("aiding", sort=False):
        less = states[states["left_pct"] > _GROWN_PCT]  # not visible in the rank
        named = zip(less["state"], less["left_pct"], strict=True)
        grown = "; ".join(f"{label(state)} ({left_pct:.0f} %)" for state, left_pct in named)
        if grown:
            yield f"{aiding}: sigma is larger after the last ping than at the start, by process noise: {grown}."
        else:
            yield f"{aiding}: after the last ping, no sigma is larger than at the start."


def _display(tables: Mapping[str, pd.DataFrame]) -> Iterator[DisplayTable]:
    """Yield the tables of the directions, the singular values, and the remaining uncertainty of each state."""

    def components(row: Mapping[str, float]) -> str:
        shown = [state for state in STATES if abs(row[state.id]) > _NOTHING]
        return ", ".join(f"{state.id} {number(row[state.id])} {state.unit}" for state in shown)

    yield table_of(
        "Named directions of error at the start",
        tables["catalogue"],
        (
            ("direction", "l", "direction"),
            ("meaning", "l", "label"),
            ("components", "l", components),
        ),
    )
    seen = tables["directions"]
    signal = (
        seen["signal_to_noise"]
        .map(number)
        .where(seen["status"] != DirectionStatus.UNOBSERVABLE, MISSING)
    )
    yield _by_aiding(
        "Signal to noise of each direction, for an error as large as the prior",
        seen.assign(text=signal),
        "direction",
        f"{MISSING}: unobservable",
    )
    values = tables["singular_values"]
    yield _by_aiding(
        "Singular values: signal to noise of twelve orthogonal directions",
        values.assign(
            text=values["singular_value"].map(number), number=values["number"].astype(str)
        ),
        "number",
    )
    states = tables["states"].assign(state=tables["states"]["state"].map(label))
    yield _by_aiding(
        "Standard deviation after the last ping in percent of the prior, with process noise",
        states.assign(text=states["left_pct"].map(percent)),
        "state",
        "Over 100 %: larger than at the start, by process noise and other errors",
    )
    yield _by_aiding(
        "Remaining part of the errors at the start, without process noise",
        states.assign(text=states["left_without_noise_pct"].map(percent)),
        "state",
    )


def _by_aiding(
    title: str,
    table: pd.DataFrame,
    key: str,
    footnote: str = "",
) -> DisplayTable:
    """Return a table of the column ``text`` with a row for each key and a column for each aiding."""
    aidings = table["aiding"].unique()
    keys = table[key].unique()
    cells = table.pivot(index=key, columns="aiding", values="text").loc[keys, aidings]
    header = ("" if key == "number" else key, *(aiding.replace("+ ", "+\n") for aiding in aidings))
    return DisplayTable(
        title, header, "l" + "r" * len(aidings), tuple(cells.itertuples(name=None)), footnote
    )


def singular_value_figure(title: str, values: pd.DataFrame, tolerance: float) -> Figure:
    """Draw the singular values of each aiding as shares of its largest, and the tolerance."""
    curves = []
    legend = []
    for count, (aiding, rows) in enumerate(values.groupby("aiding", sort=False)):
        largest = rows["singular_value"].max() or 1.0
        share = np.maximum(rows["singular_value"].to_numpy() / largest, _SMALLEST)
        curves.append(Curve(rows["number"].to_numpy(np.float64), share, filter_style(count)))
        legend.append((filter_style(count), str(aiding)))
    panel = Panel(
        "singular values, share of the largest",
        "number of the singular value",
        tuple(curves),
        levels=(tolerance,),
        y_scale="log",
        x_whole=True,
    )
    return Figure(
        title,
        "Directions below the tolerance are not observable.",
        (panel,),
        (*legend, (LIMIT, "tolerance")),
    )
