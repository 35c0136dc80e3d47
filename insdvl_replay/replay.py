"""The pipeline: a log is read and checked, prepared, run through every candidate, and its errors judged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.checks.sensors import contradiction_of_filter
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import report_stage, return_freed_memory
from insdvl_replay.core.tables import CandidateVerdict, Tables
from insdvl_replay.evaluation.consistency import MANY_REJECTED
from insdvl_replay.evaluation.drift import jump_table
from insdvl_replay.evaluation.evaluate import Curves, curves_of, tables_of_filters
from insdvl_replay.evaluation.evidence import ReferenceNoise
from insdvl_replay.evaluation.notes import constants_notes, reference_notes, settings_hints, update_notes
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.verdicts import evaluated_candidates
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.preparation.prepared import outage_notes, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import plan_runs, prepare_with_heading, prepared_timeline, run_candidates, run_one
from insdvl_replay.preparation.user_runs import with_user_candidates


@dataclass(frozen=True)
class Replay:
    """One dive, every candidate's history, and the tables."""

    dive: Dive  # as it was replayed, without the IMU's readings and solutions, which have done their work
    config: Config
    start_ns: int
    end_ns: int
    velocities: DvlVelocities  # of the DVL, inside the span
    histories: tuple[History, ...]  # the first is the baseline; recorded solutions follow the filters that were run
    errors: dict[str, ReferenceErrors]  # by filter; empty without a reference
    tables: Tables
    verdicts: dict[str, CandidateVerdict]  # by candidate
    curves: Curves  # evidence that is drawn over time
    notes: tuple[Note, ...]  # what was dropped, assumed or found odd
    printed: Mapping[str, str] = field(default_factory=dict)  # by filters of the user's


LEAST_NIS, MOST_NIS = 0.4, 2.5  # mean NIS/dof of a baseline whose settings fit the dive
# Warnings that name a unit, axes, a sign or a scale that is wrong.
MISREAD: Final = frozenset(
    {
        "imu_gravity", "imu_upside_down", "imu_gyro_sign", "imu_gyro_scale", "imu_gyro_contradiction", "imu_gyro_axis",
        "dvl_direction", "dvl_axes", "dvl_scale", "dvl_contradiction", "track_contradiction",
    }
)  # fmt: skip


class MisfitError(LogError):
    """The settings do not fit the dive, so that its filters would say nothing."""


def replay_log(
    path: Path | Sequence[Path],
    config: Config,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
    require_fit: bool = False,
) -> Replay:
    """Replay the dive in a log, a bag folder, or several of them that are one dive.

    Parameters
    ----------
    allow_damaged : bool
        Replay what can be read of a damaged log; what is lost is a note.
    name : str, optional
        Of the dive, if not that of the log.
    require_fit : bool
        Raise a MisfitError where the readings or the baseline's innovations show that the settings are wrong.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """
    if require_fit:
        dives = [read_checked_dive(path, config, allow_damaged=allow_damaged, name=name)]
        _require_fit(dives[0], config)
        return replay_dive(dives.pop(), config)
    # No name holds the dive, so that its readings can go before the filters are compared.
    return replay_dive(read_checked_dive(path, config, allow_damaged=allow_damaged, name=name), config)


def _require_fit(dive: Dive, config: Config) -> None:
    """Raise a MisfitError if the settings do not fit. A simulated dive has the noise of the defaults, or less."""
    if misread := next((note for note in dive.notes if note.code in MISREAD), None):
        raise MisfitError(f"{dive.name}: {misread.text}", misread.hint)
    if dive.truth is None:
        raise MisfitError(f"{dive.name}: nobody has chosen the noise of its sensors", "set [noise], or use a --preset")
    size, rejected = baseline_fit(dive, config)
    if size > MOST_NIS or rejected > MANY_REJECTED:
        text = f"NIS/dof of the baseline is {size:.2g}, and it rejects {rejected:.0%} of the velocities"
        raise MisfitError(f"{dive.name}: {text}", "insdvl-replay calibrate fits geometry and noise")


def baseline_fit(dive: Dive, config: Config) -> tuple[float, float]:
    """Return NIS over degrees of freedom of the baseline's velocities, and the share that it rejects."""
    dive = with_reference_at_imu(dive, config)
    alone = msgspec.structs.replace(config, filters={config.baseline: config.filters[config.baseline]})
    prepared = prepare_with_heading(dive, alone)
    innovations = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared)).innovations[0]
    sizes = innovations.nis * innovations.weight / innovations.dof
    return float(np.mean(sizes)), float(np.mean(~innovations.used))


def replay_dive(dive: Dive, config: Config, *, keep_cov: bool = False) -> Replay:
    """Run every candidate over a dive, side by side, from the same start, and compare them.

    Parameters
    ----------
    keep_cov : bool
        Whether the histories keep P at the times at which their errors are judged.

    Raises
    ------
    LogError
        Nothing to replay in the span, or no reference to start from.
    ConfigError
        The settings do not fit the dive.
    """
    # Prepare: span, start, and what each filter measures; then random starts and windows without the DVL.
    dive = with_reference_at_imu(dive, config)
    prepared = prepare_with_heading(dive, config)
    plan = plan_runs(dive, prepared, config)

    # Run every candidate. The rest needs no readings.
    runs = with_user_candidates(run_candidates(dive, prepared, plan, config), dive, prepared, plan, config)
    (baseline, *_), histories = runs.histories, runs.histories
    dive = replace(dive, imu=dive.imu.times_only(), solutions={})
    return_freed_memory()

    # Compare them with the reference and with each other.
    report_stage("judging the filters")
    span, settings = (prepared.alignment.start_ns, prepared.end_ns), config.reference
    noise = ReferenceNoise(settings.position_sd_m, settings.velocity_sd_mps, settings.attitude_sd_deg)
    errors, tables = tables_of_filters(
        dive, histories, runs.drawn, runs.outages, runs.user_outages, noise, prepared.sensor_sd,
        jump_table(dive.name, histories, runs.motions),
        start_ns=span[0], bridged_gaps=len(prepared.gaps.start_ns) > 0,
    )  # fmt: skip
    notes = (
        *dive.notes,
        *prepared.notes,
        *outage_notes(prepared.velocities.time_ns, *span),
        *update_notes(histories),
        *contradiction_of_filter(dive.sensors, dive.reference, baseline),
        *runs.notes,
        *reference_notes(dive, *span, baseline, plan.evaluated_ns, independent=settings.independent),
    )

    # The verdict on each.
    tables, verdicts = evaluated_candidates(histories, errors, tables, notes, independent=settings.independent)
    notes += settings_hints(tables, baseline) + constants_notes(histories)
    histories = histories if keep_cov else tuple(history.without_cov() for history in histories)
    curves = curves_of(runs.drawn, runs.outages)
    return Replay(
        dive, config, *span, prepared.velocities, histories, errors, tables, verdicts, curves, notes, runs.printed
    )
