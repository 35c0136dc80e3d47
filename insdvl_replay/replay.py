"""The pipeline: a log is read and checked, prepared, run through every filter, and what they believe judged."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from insdvl_replay.core.columns import Dive, TimeNs
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import begin, return_freed_memory
from insdvl_replay.core.tables import Candidate, Tables
from insdvl_replay.evaluation.consistency import update_notes
from insdvl_replay.evaluation.judging import compared_filters, judged_times, reference_notes
from insdvl_replay.evaluation.reference import ReferenceErrors
from insdvl_replay.evaluation.verdicts import dead_filters, verdicts
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.long_gaps import outage_notes
from insdvl_replay.preparation.prepared import Prepared, prepare_dive, with_reference_at_imu
from insdvl_replay.preparation.reading import read_checked_dive

WORTH_A_THREAD = 20_000
"""IMU samples from which filters run beside each other; with fewer, to start threads takes what it saves."""


@dataclass(frozen=True)
class Replay:
    """One dive, every filter's history, and the tables.

    Attributes
    ----------
    dive : Dive
        The columns that were replayed; of the IMU the times alone, since its readings have done their work.
    config : Config
        Resolved settings.
    start_ns, end_ns : int
        Span of the replay.
    velocities : DvlVelocities
        What the DVL measured, inside the span.
    histories : tuple of History
        The first is the baseline.
    errors : dict of str to ReferenceErrors
        By filter name; empty without a reference.
    tables : Tables
        Believed, against the reference, consistent, credible: a row a filter and state.
    verdicts : dict of str to Candidate
        What there is to say of each candidate, by name.
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
    notes: tuple[Note, ...]


def replay_log(
    path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False, name: str | None = None
) -> Replay:
    """Replay the dive in a log.

    Parameters
    ----------
    path : Path or sequence of Path
        An MCAP file, a bag folder, or several of them that are one dive.
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
    start = prepare_dive(dive, config)
    span = start.alignment.start_ns, start.end_ns
    judged_ns = judged_times(dive.reference, *span, filters=len(config.filters))
    histories = run_filters(dive, start, cov_ns=judged_ns)
    dive = replace(dive, imu=dive.imu.times_only())
    return_freed_memory()
    begin("judging the filters")
    errors, tables = compared_filters(dive, histories, span[0], bridged_gaps=len(start.gaps.start_ns) > 0)
    candidates = [history.filter for history in histories[1:]]
    judged = verdicts(tables, config.baseline, candidates, dead_filters(histories))
    notes = dive.notes + start.notes + outage_notes(start.velocities.time_ns, *span) + update_notes(histories)
    notes += reference_notes(dive, *span, histories[0], judged_ns, independent=config.reference.independent)
    if not keep_cov:
        histories = tuple(history.without_cov() for history in histories)
    return_freed_memory()
    return Replay(dive, config, *span, start.velocities, histories, errors, tables, judged, notes)


def run_filters(dive: Dive, start: Prepared, *, cov_ns: TimeNs | None = None) -> tuple[History, ...]:
    """Run every filter over a prepared dive, on a long one each in a thread of its own.

    Parameters
    ----------
    start : Prepared
        From `prepared.prepare_dive`.
    cov_ns : ndarray, shape (c,), optional
        Times of the reference at which the histories keep all of P.

    Returns
    -------
    tuple of History
        In the order of the configuration.
    """
    begin("running the filters")
    timeline = prepared_timeline(dive, start)
    return_freed_memory()
    run = partial(run_one, start=start, timeline=timeline, cov_ns=cov_ns)
    if len(dive.imu.time_ns) < WORTH_A_THREAD:
        return tuple(map(run, start.filters))
    with ThreadPoolExecutor() as threads:  # the compiled filter leaves the interpreter to others while it runs
        return tuple(threads.map(run, start.filters))


def run_one(filter_: ResolvedFilter, start: Prepared, timeline: Timeline, *, cov_ns: TimeNs | None = None) -> History:
    """Run one filter over the time line of a prepared dive; ``cov_ns`` as of `run_filters`."""
    return run_filter(
        filter_.name,
        timeline,
        start.alignment.start,
        filter_.noise_density,
        filter_.measurements(start.velocities, start.mounting, start.gaps),
        start.mounting.lever_arm_b,
        cov_ns=cov_ns,
    )


def prepared_timeline(dive: Dive, start: Prepared) -> Timeline:
    """Lay the readings, the pings and the reference's times of a prepared dive on one time line."""
    reference_ns = dive.reference.time_ns if dive.reference else np.empty(0, dtype=np.int64)
    return build_timeline(
        dive.imu, start.velocities.time_ns, reference_ns, start.alignment.start_ns, start.end_ns, start.gaps
    )
