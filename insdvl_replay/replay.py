"""The pipeline: a log is read and checked, prepared, run through every filter, and what they believe judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from insdvl_replay.checks.sensors import contradiction_of_filter
from insdvl_replay.core.config import Config, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import report_stage, return_freed_memory
from insdvl_replay.core.tables import Candidate, Tables
from insdvl_replay.evaluation.consistency import constants_notes, settings_hints, update_notes
from insdvl_replay.evaluation.drift import jump_table
from insdvl_replay.evaluation.errors import ReferenceErrors
from insdvl_replay.evaluation.evaluate import (
    Curves,
    curves_of,
    judged_candidates,
    judged_times,
    reference_notes,
    tables_of_filters,
    with_solutions,
)
from insdvl_replay.evaluation.evidence import ReferenceNoise
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.preparation.long_gaps import outage_notes
from insdvl_replay.preparation.prepared import with_reference_at_imu
from insdvl_replay.preparation.reading import read_checked_dive
from insdvl_replay.preparation.running import (
    coasting_of,
    coasting_plan,
    prepared_timeline,
    run_filters,
    run_from_drawn_starts,
)
from insdvl_replay.preparation.solutions import read_solutions
from insdvl_replay.preparation.start_heading import prepare_with_heading


@dataclass(frozen=True)
class Replay:
    """One dive, every filter's history, and the tables.

    Attributes
    ----------
    dive : Dive
        The columns that were replayed; of the IMU the times alone, since its readings have done their work, and without
        solutions, which the histories tell.
    config : Config
        Resolved settings.
    start_ns, end_ns : int
        Span of the replay.
    velocities : DvlVelocities
        What the DVL measured, inside the span.
    histories : tuple of History
        The first is the baseline; solutions that were read stand behind the filters that were run.
    errors : dict of str to ReferenceErrors
        By filter name; empty without a reference.
    tables : Tables
        Believed, against the reference, consistent, credible: a row a filter and state.
    verdicts : dict of str to Candidate
        What there is to say of each candidate, by name.
    curves : Curves
        What of the evidence is drawn over time.
    notes : tuple of Note
        What was dropped, assumed or found odd.
    """

    dive: Dive
    config: Config
    start_ns: int
    end_ns: int
    velocities: DvlVelocities
    histories: tuple[History, ...]
    errors: dict[str, ReferenceErrors]
    tables: Tables
    verdicts: dict[str, Candidate]
    curves: Curves
    notes: tuple[Note, ...]


def replay_log(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False, name: str | None = None
) -> Replay:
    """Replay the dive in a log.

    Parameters
    ----------
    path : Path or sequence of Path
        A log, a bag folder, or several of them that are one dive.
    allow_damaged : bool
        Replay what can be believed of a damaged log; what is lost is a note.
    name : str, optional
        Of the dive, if not that of the log.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """
    # The dive is held by no name here, so that its readings can be let go once the filters have run.
    return replay_dive(_read(path, config, allow_damaged, name), config)


def _read(path: Path | Sequence[Path], config: Config, allow_damaged: bool, name: str | None) -> Dive:
    dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
    return replace(dive, name=name or dive.name)


def replay_dive(dive: Dive, config: Config, *, keep_cov: bool = False) -> Replay:
    """Run every configured filter over a dive, side by side, from the same start, and compare them.

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
    prepared = prepare_with_heading(dive, config)
    dive, solutions = replace(dive, solutions={}), dict(dive.solutions)
    span = prepared.alignment.start_ns, prepared.end_ns
    judged_ns = judged_times(dive.reference, *span, filters=len(config.filters))
    plan, timeline = coasting_plan(prepared), prepared_timeline(dive, prepared)
    histories = run_filters(prepared, timeline, cov_ns=np.union1d(judged_ns, plan.start_ns))
    read, motions, read_notes = read_solutions(solutions, config.solutions, dive.imu, histories[0], judged_ns)
    coasts = coasting_of(replace(dive, solutions=solutions), config, prepared, timeline, histories, plan)
    draws = config.evaluation
    drawn = run_from_drawn_starts(dive, prepared, draws.starts, draws.seed) if dive.reference is not None else ()
    del timeline
    histories += read
    drawn = with_solutions(drawn, histories, dive)
    dive = replace(dive, imu=dive.imu.times_only())
    return_freed_memory()
    report_stage("judging the filters")
    jumps = jump_table(dive.name, histories, motions)
    del motions
    bridged_gaps, independent = len(prepared.gaps.start_ns) > 0, config.reference.independent
    errors, tables = tables_of_filters(
        dive, histories, drawn, coasts, _noise_of(config.reference), prepared.sensor_sd, jumps,
        start_ns=span[0], bridged_gaps=bridged_gaps,
    )  # fmt: skip
    curves = curves_of(drawn, coasts)
    notes = dive.notes + prepared.notes + outage_notes(prepared.velocities.time_ns, *span) + update_notes(histories)
    notes += contradiction_of_filter(dive.sensors, dive.reference, histories[0]) + read_notes
    notes += reference_notes(dive, *span, histories[0], judged_ns, independent=independent)
    tables, judged = judged_candidates(histories, errors, tables, notes, independent=independent)
    notes += settings_hints(tables, histories[0]) + constants_notes(histories)
    if not keep_cov:
        histories = tuple(history.without_cov() for history in histories)
    return_freed_memory()
    return Replay(dive, config, *span, prepared.velocities, histories, errors, tables, judged, curves, notes)


def _noise_of(reference: Reference) -> ReferenceNoise:
    return ReferenceNoise(reference.position_sd_m, reference.velocity_sd_mps, reference.attitude_sd_deg)
