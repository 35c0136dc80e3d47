"""The pipeline: a log is read and checked, prepared, run through every candidate, and its errors judged."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from insdvl_replay.checks.fingerprint import imu_fingerprint
from insdvl_replay.checks.reference_delay import with_reference_delay
from insdvl_replay.checks.sensors import contradiction_of_filter
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import report_stage, return_freed_memory
from insdvl_replay.core.tables import CandidateVerdict, Tables
from insdvl_replay.evaluation.drift import jump_table
from insdvl_replay.evaluation.evaluate import Curves, curves_of, tables_of_filters
from insdvl_replay.evaluation.evidence import ReferenceNoise
from insdvl_replay.evaluation.notes import (
    constants_notes,
    reference_notes,
    settings_hints,
    update_notes,
)
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.evaluation.sentences import start_of
from insdvl_replay.evaluation.verdicts import evaluated_candidates, not_evaluated_notes
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.preparation.heading_draw import start_heading
from insdvl_replay.preparation.prepared import (
    outage_notes,
    read_checked_dive,
    with_reference_at_imu,
)
from insdvl_replay.preparation.run import (
    plan_runs,
    prepare_with_heading,
    require_fit_of,
    run_candidates,
)
from insdvl_replay.preparation.user_runs import with_user_candidates


@dataclass(frozen=True)
class Replay:
    """One dive, every candidate's history, and the tables."""

    dive: Dive  # as it was replayed, without the IMU's readings and solutions, which have done their work
    config: Config
    start_ns: int
    end_ns: int
    velocities: DvlVelocities  # of the DVL, inside the span
    # the first is the baseline; recorded solutions follow the filters that were run
    histories: tuple[History, ...]
    errors: dict[str, ReferenceErrors]  # by filter; empty without a reference
    tables: Tables
    verdicts: dict[str, CandidateVerdict]  # by candidate
    curves: Curves  # evidence that is drawn over time
    notes: tuple[Note, ...]  # what was dropped, assumed or found odd
    printed: Mapping[str, str] = field(default_factory=dict)  # by filters of the user's
    # processor seconds of one run over the dive, by filter
    cpu_s: Mapping[str, float] = field(default_factory=dict)


def nothing_kept() -> None:
    """Say that no dive was read before."""


def replay_log(
    path: Path | Sequence[Path],
    config: Config,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
    require_fit: bool = False,
    kept: Callable[[], Dive | None] = nothing_kept,
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
    kept : callable
        Gives away the dive if it was read before, with settings that are the same for reading.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """

    def read() -> Dive:
        dive = kept()
        if dive is None:
            return read_checked_dive(path, config, allow_damaged=allow_damaged, name=name)
        return replace(dive, name=name or dive.name)

    if require_fit:
        dives = [read()]
        report_stage("running the filters")
        require_fit_of(dives[0], config)
        return replay_dive(dives.pop(), config)
    # No name holds the dive, so that its readings can go before the filters are compared.
    return replay_dive(read(), config)


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
    dive = replace(dive, imu_fingerprint=imu_fingerprint(dive.imu))
    if dive.reference_delay is None:
        dive = with_reference_delay(dive, config)
    plan = plan_runs(dive, prepared, config)
    found_start = start_heading(prepared, plan.heading)
    dive = replace(dive, start_heading=found_start, imu=dive.imu.row_by_row())

    # Run every candidate. The rest needs no readings.
    runs = with_user_candidates(
        run_candidates(dive, prepared, plan, config), dive, prepared, plan, config
    )
    histories = runs.histories
    baseline, *_ = histories
    dive = replace(dive, imu=dive.imu.times_only(), solutions={})
    return_freed_memory()

    # Compare them with the reference and with each other.
    report_stage("judging the filters")
    span = (prepared.alignment.start_ns, prepared.end_ns)
    settings = config.reference
    noise = ReferenceNoise(
        settings.position_sd_m, settings.velocity_sd_mps, settings.attitude_sd_deg
    )
    errors, tables = tables_of_filters(
        dive,
        histories,
        runs.spread,
        runs.drawn,
        runs.outages,
        runs.user_outages,
        noise,
        prepared.sensor_sd,
        jump_table(dive.name, histories, runs.motions),
        start_ns=span[0],
        bridged_gaps=len(prepared.gaps.start_ns) > 0,
        independent=settings.independent,
        lost_m=config.evaluation.lost_m,
        turned=runs.turned,
    )
    notes = (
        *dive.notes,
        *prepared.notes,
        *outage_notes(prepared.velocities.time_ns, *span),
        *update_notes(histories),
        *contradiction_of_filter(dive.sensors, dive.reference, baseline),
        *runs.notes,
        *reference_notes(
            dive, *span, baseline, plan.evaluated_ns, independent=settings.independent
        ),
    )

    # The verdict on each.
    tables, verdicts = evaluated_candidates(
        histories,
        errors,
        tables,
        notes,
        primary=config.evaluation.primary,
        not_repeatable=runs.not_repeatable,
        start=start_of([found_start]),
    )
    notes += (
        not_evaluated_notes(verdicts)
        + settings_hints(tables, baseline)
        + constants_notes(histories)
    )
    if not keep_cov:
        histories = tuple(history.without_cov() for history in histories)
    curves = curves_of(runs.drawn, runs.outages)
    return Replay(
        dive,
        config,
        *span,
        prepared.velocities,
        histories,
        errors,
        tables,
        verdicts,
        curves,
        notes,
        runs.printed,
        runs.cpu_s,
    )
