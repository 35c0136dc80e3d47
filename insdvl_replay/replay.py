"""The pipeline: a log is read and checked, prepared, run through every candidate, and its errors judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from insdvl_replay.checks.sensors import contradiction_of_filter
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import report_stage, return_freed_memory
from insdvl_replay.core.tables import Candidate, Tables
from insdvl_replay.evaluation.drift import jump_table
from insdvl_replay.evaluation.evaluate import Curves, curves_of, tables_of_filters
from insdvl_replay.evaluation.evidence import ReferenceNoise
from insdvl_replay.evaluation.notes import constants_notes, reference_notes, settings_hints, update_notes
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.verdicts import judged_candidates
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.preparation.prepared import outage_notes, read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import plan_runs, prepare_with_heading, run_candidates


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
    verdicts: dict[str, Candidate]  # by candidate
    curves: Curves  # evidence that is drawn over time
    notes: tuple[Note, ...]  # what was dropped, assumed or found odd


def replay_log(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False, name: str | None = None
) -> Replay:
    """Replay the dive in a log, a bag folder, or several of them that are one dive.

    Parameters
    ----------
    allow_damaged : bool
        Replay what can be read of a damaged log; what is lost is a note.
    name : str, optional
        Of the dive, if not that of the log.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """
    return replay_dive(_read(path, config, allow_damaged, name), config)


def _read(path: Path | Sequence[Path], config: Config, allow_damaged: bool, name: str | None) -> Dive:
    dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
    return replace(dive, name=name or dive.name)


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
    dive = with_reference_at_imu(dive, config)
    prepared = prepare_with_heading(dive, config)  # span, start, and what each filter measures
    plan = plan_runs(dive, prepared, config)  # drawn starts, windows without the DVL, times at which errors are judged
    runs = run_candidates(dive, prepared, plan, config)
    dive = replace(dive, imu=dive.imu.times_only(), solutions={})  # the rest needs no readings
    return_freed_memory()

    report_stage("judging the filters")
    span, independent = (prepared.alignment.start_ns, prepared.end_ns), config.reference.independent
    noise = ReferenceNoise(
        config.reference.position_sd_m, config.reference.velocity_sd_mps, config.reference.attitude_sd_deg
    )
    errors, tables = tables_of_filters(
        dive, runs.histories, runs.drawn, runs.outages, noise, prepared.sensor_sd,
        jump_table(dive.name, runs.histories, runs.motions),
        start_ns=span[0], bridged_gaps=len(prepared.gaps.start_ns) > 0,
    )  # fmt: skip
    baseline = runs.histories[0]
    notes = (
        *dive.notes,
        *prepared.notes,
        *outage_notes(prepared.velocities.time_ns, *span),
        *update_notes(runs.histories),
        *contradiction_of_filter(dive.sensors, dive.reference, baseline),
        *runs.notes,
        *reference_notes(dive, *span, baseline, plan.judged_ns, independent=independent),
    )
    tables, verdicts = judged_candidates(runs.histories, errors, tables, notes, independent=independent)
    notes += settings_hints(tables, baseline) + constants_notes(runs.histories)
    histories = runs.histories if keep_cov else tuple(history.without_cov() for history in runs.histories)
    curves = curves_of(runs.drawn, runs.outages)
    return Replay(dive, config, *span, prepared.velocities, histories, errors, tables, verdicts, curves, notes)
