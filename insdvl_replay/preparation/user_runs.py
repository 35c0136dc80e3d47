"""The user's own filters, run: from the starts of all candidates, and on dives without the pings of some windows.

They are given what the built-in filters get, and nothing that judges them. In the DVL outage test a built-in filter
goes on from its state at the begin of each window. A filter of the user's cannot, so it runs over whole dives that lack
the pings of every third window. The baseline runs over the same dives, so that both drift in the same windows.
"""

import hashlib
import pickle
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Config, Filter
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import parallel_map, report_stage
from insdvl_replay.evaluation.evaluate import with_solutions
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRun,
    OutageRuns,
    Windows,
    distance_along_m,
    drift_run,
)
from insdvl_replay.evaluation.reference_errors import DrawnErrors, drawn_errors, run_from_start
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.logs import copy_log, held_back_messages, write_dive
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_candidate import CandidateError, CandidateStart
from insdvl_replay.preparation.candidates import failed_history, history_of_candidate
from insdvl_replay.preparation.notes import note
from insdvl_replay.preparation.plugins import Outage, given_dive
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.programs import DIVE_FILES, UserProcesses
from insdvl_replay.preparation.run import RunPlan, Runs, drawn_part, prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude

OUTAGE_DIVES: Final = 3  # each lacks every third window: the time between two of them is twice as long as a window
LONGEST_WINDOW_S, FEWEST_WINDOWS = 60, 6  # the longest windows of which there are so many, else the shortest


@dataclass(frozen=True)
class GivenDive:
    """A dive over which the user's filters are run, and the baseline's run over it."""

    name: str
    dive: Dive  # as filters of the user's are given it
    prepared: Prepared
    baseline: History
    windows: Sequence[int] = ()  # rows of the plan's windows whose pings are absent
    absent: Sequence[Outage] = ()  # these windows


class UserRun(NamedTuple):
    """What one filter of the user's gave."""

    history: History
    drawn: DrawnErrors | None  # from random starts
    outages: OutageRuns | None  # with those of the baseline
    notes: tuple[Note, ...]


def with_user_candidates(runs: Runs, dive: Dive, prepared: Prepared, plan: RunPlan, config: Config) -> Runs:
    """Add the runs of the user's filters to those of all others, which they do not change.

    A filter that fails in any run has no trajectory, and its history says why.
    """
    if not config.user_candidates:
        return runs
    whole = GivenDive("dive", _given(given_dive(dive, config), prepared), prepared, runs.histories[0])
    windows, part = _windows(plan.windows), dive
    starts: tuple[Start, ...] = (prepared.alignment.start,)
    outage_dives = _outage_dives(dive, prepared, config, windows)
    if plan.starts:
        starts, part, _ = drawn_part(dive, prepared, plan.starts, plan.seed)
    histories, drawn, notes = list(runs.histories), list(runs.drawn), list(runs.notes)
    outages, printed = dict[str, OutageRuns](), dict[str, str]()
    # What a program has started may still write into it.
    with tempfile.TemporaryDirectory(prefix="insdvl-replay-", ignore_cleanup_errors=True) as folder:
        for name, settings in config.user_candidates.items():
            report_stage(f"running {name}")
            candidate = _Candidate(name, settings, Path(folder, name), plan)
            for test in (whole, *outage_dives):  # each candidate has files of its own: it may change or remove them
                file, kind = candidate.file(test), candidate.processes.input
                if kind == "clean":
                    write_dive(file, test.dive, is_compressed=False)
                elif kind == "class":
                    file.write_bytes(pickle.dumps(test.dive))
                elif dive.paths:
                    copy_log(file, dive.paths, held_back_messages(dive.paths, config, test.absent))
            try:
                found = candidate.runs(whole, starts, part, outage_dives, windows)
            except CandidateError as error:
                found = UserRun(failed_history(name, str(error), whole.baseline, whole.dive.imu), None, None, ())
            finally:
                candidate.processes.stop()
            histories.append(found.history)
            drawn += [] if found.drawn is None else [found.drawn]
            drawn = list(with_solutions(drawn, [found.history], dive)) if plan.starts else drawn
            outages |= {} if found.outages is None else {name: found.outages}
            notes += found.notes
            printed |= {name: text} if (text := candidate.processes.printed) else {}
            shutil.rmtree(candidate.folder, ignore_errors=True)
    return replace(
        runs, histories=tuple(histories), drawn=tuple(drawn), notes=tuple(notes), user_outages=outages, printed=printed
    )


class _Candidate:
    """One filter of the user's: a program or a class."""

    def __init__(self, name: str, settings: Filter, folder: Path, plan: RunPlan) -> None:
        self.name, self.plan, self.folder = name, plan, folder
        self.processes = UserProcesses(settings, folder)

    def file(self, test: GivenDive) -> Path:
        """Return the file of a dive that it is given."""
        return self.folder / DIVE_FILES[self.processes.input].format(test.name)

    def history(self, test: GivenDive, run: str, start: Start) -> tuple[History, tuple[Note, ...], str]:
        """Run it over a dive; return its history, notes, and a digest of its solution."""
        alignment = test.prepared.alignment
        given = CandidateStart(
            **{column.name: getattr(start, column.name) for column in fields(Start)},
            time_ns=alignment.start_ns,
            dvl_lever_arm_b=test.prepared.mounting.lever_arm_b,
            position_sd_m=np.array(alignment.initial.position_sd_m if alignment.initial else (1.0, 1.0, 1.0)),
        )
        dive_file = self.file(test)
        if not dive_file.exists():
            raise CandidateError("cannot be run: its input is the log, and the dive has no file")
        solution = self.processes.run(run, dive_file, given)
        digest = hashlib.sha256()
        for column in (solution.time_ns, solution.position, solution.velocity_n, solution.mat_nb):
            digest.update(b"" if column is None else np.ascontiguousarray(column).tobytes())
        history, notes = history_of_candidate(
            self.name, solution, start, alignment.start_ns, test.dive.imu, test.prepared.velocities, test.baseline,
            self.plan.evaluated_ns,
        )  # fmt: skip
        return history, notes, digest.hexdigest()

    def runs(
        self,
        whole: GivenDive,
        starts: Sequence[Start],
        part: Dive,  # with the times of the reference at which errors are kept
        outage_dives: Sequence[GivenDive],
        windows: Windows | None,
    ) -> UserRun:
        """Run it from all starts, and over the dives of the outage test."""
        reference = part.reference

        def from_start(place: int) -> tuple[History | None, DrawnErrors | None, tuple[Note, ...], str]:
            history, notes, digest = self.history(whole, f"start_{place + 1:03d}", starts[place])
            errors = None if reference is None else run_from_start(history, reference, part.truth)
            return (None if place else history), errors, notes, digest

        def in_outages(test: GivenDive) -> History:
            return self.history(test, test.name, starts[0])[0]

        history, first, notes, digest = from_start(0)  # a mistake of its own shows at the first run
        assert history is not None
        others = list(parallel_map(from_start, range(1, len(starts)), stop=self.processes.stop))
        drawn = None
        if first is not None:
            own_sd = whole.prepared.alignment.spread_cov is None
            drawn = drawn_errors([first, *(errors for _, errors, *_ in others if errors)], own_sd=own_sd)
        if others and all(other == digest for *_, other in others):
            notes = (*notes, note("candidate_ignores_start", len(starts), key=f"filters.{self.name}"))
        has_attitude = np.isfinite(history.mat_nb).any() and np.isfinite(history.velocity_n).any()
        if windows is None or not has_attitude:
            return UserRun(history, drawn, None, notes)
        own = list(parallel_map(in_outages, outage_dives, stop=self.processes.stop))
        velocities = whole.prepared.velocities
        drifts = {
            name: _drifts(outage_dives, found, whole.prepared, windows)
            for name, found in ((whole.baseline.filter, [test.baseline for test in outage_dives]), (self.name, own))
        }
        none = np.empty(0, np.int64)
        plan = OutagePlan(velocities.time_ns, (windows,), Windows(windows.window_s, none, none, 0))
        distance_m = distance_along_m(velocities.time_ns, velocities.velocity_b)
        return UserRun(history, drawn, OutageRuns(plan, distance_m, drifts), notes)


def _given(dive: Dive, prepared: Prepared) -> Dive:
    """Return what the built-in filters get of a dive, without anything that judges them."""
    start_ns, end_ns, time_ns = prepared.alignment.start_ns, prepared.end_ns, dive.imu.time_ns
    covering = slice(int(np.searchsorted(time_ns, start_ns, "right")) - 1, int(np.searchsorted(time_ns, end_ns)) + 1)
    velocities = prepared.velocities
    return Dive(
        dive.name,
        dive.imu.rows(covering),
        DvlColumns(velocities.time_ns, velocity_d=velocities.velocity_b),
        sensors={name: columns.within(start_ns, end_ns) for name, columns in dive.sensors.items()},
    )


# --- The DVL outage test.


def _windows(plan: OutagePlan) -> Windows | None:
    """Choose the windows of one length; None where a dive has none."""
    short = [windows for windows in plan.by_length if windows.window_s <= LONGEST_WINDOW_S and len(windows.first)]
    enough = [windows for windows in short if len(windows.first) >= FEWEST_WINDOWS]
    return next(iter([*enough[::-1], *short]), None)


def _outage_dives(dive: Dive, prepared: Prepared, config: Config, windows: Windows | None) -> list[GivenDive]:
    """Make dives that lack the pings of every third window, and run the baseline over them."""
    found, ping_ns, alignment = list[GivenDive](), prepared.velocities.time_ns, prepared.alignment
    filters = {config.baseline: config.filters[config.baseline]}
    settings = changed(config, initial=alignment.initial or config.initial, filters=filters)
    for number in range(0 if windows is None else min(OUTAGE_DIVES, len(windows.first))):
        assert windows is not None
        rows = range(number, len(windows.first), OUTAGE_DIVES)
        spans = [(int(windows.first[row]), int(windows.last[row])) for row in rows]
        absent = [(int(ping_ns[first]), int(ping_ns[last])) for first, last in spans]
        given = given_dive(dive, config, absent)
        whole = replace(given, reference=given.reference or dive.reference, sensors=dive.sensors)
        part = replace(prepare_dive(whole, settings), alignment=alignment, end_ns=prepared.end_ns)
        # Known at the samples around each absent ping, where the filter has a node in any case.
        absent_ns = np.concatenate([ping_ns[first + 1 : last + 1] for first, last in spans])
        before = np.searchsorted(dive.imu.time_ns, absent_ns, "right") - 1
        around = np.unique(np.concatenate([before, np.minimum(before + 1, len(dive.imu.time_ns) - 1)]))
        line = prepared_timeline(whole, part, dive.imu.time_ns[around])
        baseline = run_one(part.filters[0], part, line)
        found.append(GivenDive(f"outage_{number + 1}", _given(given, part), part, baseline, rows, absent))
    return found


def _drifts(
    dives: Sequence[GivenDive], histories: Sequence[History], prepared: Prepared, windows: Windows
) -> tuple[OutageRun, ...]:
    """Return the drift of a filter in all windows, in their order, by the absent pings."""
    found, velocities, arm_b = dict[int, OutageRun](), prepared.velocities, prepared.mounting.lever_arm_b
    for test, history in zip(dives, histories, strict=True):
        imu = test.dive.imu
        for row in test.windows:
            pings = slice(int(windows.first[row]), int(windows.last[row]) + 1)
            time_ns = velocities.time_ns[pings]
            since_ns = imu.time_ns - time_ns[0]
            rate_ib_b: Floats = np.column_stack(
                [np.interp(time_ns - time_ns[0], since_ns, column) for column in imu.angular_rate_b.T]
            )
            mat_nb = interpolated_attitude(history.time_ns, history.mat_nb, time_ns)
            velocity_n = interpolated(history.time_ns, history.velocity_n, time_ns)
            rate_eb_b = rate_ib_b - earth_rate_n(prepared.alignment.start.position[0]) @ mat_nb
            measured_n = np.einsum("kij,kj->ki", mat_nb, velocities.velocity_b[pings] - np.cross(rate_eb_b, arm_b))
            found[row] = drift_run(time_ns, velocity_n - measured_n)
    return tuple(found[row] for row in sorted(found))
