"""Read a dive, run every configured filter over it, and lay what they believe beside what is so."""

import math
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
from insdvl_replay.evaluation.believed import convergence_table, improvement_table
from insdvl_replay.evaluation.consistency import consistency_table, update_notes
from insdvl_replay.evaluation.coverage import reference_coverage_notes, reference_rate_notes, truth_coverage_notes
from insdvl_replay.evaluation.credibility import credibility_table
from insdvl_replay.evaluation.reference import ReferenceErrors, reference_error_table, reference_errors
from insdvl_replay.evaluation.state_errors import state_errors
from insdvl_replay.evaluation.verdicts import dead_filters, verdicts
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.timeline import Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.long_gaps import outage_notes
from insdvl_replay.preparation.prepared import Prepared, prepare_dive, with_reference_at_imu
from insdvl_replay.preparation.reading import read_checked_dive

MOST_COVARIANCES = 20_000
"""So many P, 23 MB of them, are kept until the errors are judged; a longer dive is judged at fewer times."""

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
    start_ns = start.alignment.start_ns
    judged_ns = _judged_ns(dive, start, config)
    histories = run_filters(dive, start, cov_ns=judged_ns)
    dive = replace(dive, imu=dive.imu.times_only())
    return_freed_memory()
    begin("judging the filters")
    errors, tables = _tables(dive, start, histories)
    candidates = [history.filter for history in histories[1:]]
    judged = verdicts(tables, config.baseline, candidates, dead_filters(histories))
    notes = dive.notes + start.notes + outage_notes(start.velocities.time_ns, start_ns, start.end_ns)
    notes += update_notes(histories)
    notes += _reference_notes(dive, config, start, histories[0], judged_ns)
    if not keep_cov:
        histories = tuple(history.without_cov() for history in histories)
    return_freed_memory()
    return Replay(dive, config, start_ns, start.end_ns, start.velocities, histories, errors, tables, judged, notes)


def _judged_ns(dive: Dive, start: Prepared, config: Config) -> TimeNs:
    """Choose the times at which P is kept and errors are judged by it: all of the reference, or evenly some of them."""
    if dive.reference is None:
        return np.empty(0, dtype=np.int64)
    inside_ns = _inside(dive.reference.time_ns, start)
    every = math.ceil(len(inside_ns) * len(config.filters) / MOST_COVARIANCES)
    return inside_ns[:: max(every, 1)]


def _inside(reference_ns: TimeNs, start: Prepared) -> TimeNs:
    """Give the times of a reference in the span of the replay."""
    return reference_ns[(reference_ns >= start.alignment.start_ns) & (reference_ns <= start.end_ns)]


def _tables(dive: Dive, start: Prepared, histories: tuple[History, ...]) -> tuple[dict[str, ReferenceErrors], Tables]:
    """Compare the filters with the reference and with each other."""
    errors, in_states = {}, {}
    if dive.reference is not None:
        errors = {history.filter: reference_errors(history, dive.reference) for history in histories}
        in_states = {
            history.filter: state_errors(history, dive.reference, dive.truth).after(start.alignment.start_ns)
            for history in histories
        }
    names = [history.filter for history in histories]
    return errors, Tables(
        improvement_table(dive.name, histories),
        convergence_table(dive.name, histories),
        reference_error_table(dive.name, histories, errors, bridged_gaps=len(start.gaps.start_ns) > 0),
        consistency_table(dive.name, histories),
        credibility_table(dive.name, names, in_states),
    )


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


def _reference_notes(
    dive: Dive, config: Config, start: Prepared, history: History, judged_ns: TimeNs
) -> tuple[Note, ...]:
    """Say what the reference cannot tell: errors that it shares, and what of the dive it does not see."""
    if dive.reference is None:
        return ()
    notes, start_ns, end_ns = [], start.alignment.start_ns, start.end_ns
    if not config.reference.independent:
        text = "the reference shares sensors with the filters: errors that they have in common are not seen"
        notes.append(Note("reference_not_independent", text))
    notes += reference_coverage_notes(dive.reference, start_ns, end_ns)
    if dive.truth is not None:
        notes += truth_coverage_notes(dive.truth, start_ns, end_ns)
    inside = _inside(dive.reference.time_ns, start)
    if left_out := len(inside) - len(judged_ns):
        text = (
            f"credibility is judged at {len(judged_ns)} of the {len(inside)} times of the reference, evenly chosen: P "
            "at all of them would fill the memory"
        )
        notes.append(Note("credibility_thinned", text, left_out))
    return (*notes, *reference_rate_notes(history, dive.reference.time_ns))
