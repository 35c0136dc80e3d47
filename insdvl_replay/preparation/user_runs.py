"""The user's own filters, run: from the starts of all candidates, and on dives without the pings of some windows.

They are given what the built-in filters get, and nothing that judges them. In the DVL outage test a built-in filter
goes on from its state at the begin of each window. A filter of the user's cannot, so it runs over whole dives that lack
the pings of every third window. The baseline runs over the same dives, so that both drift in the same windows.

At last each runs again: from the same start, with all stamps a microsecond later, and with a few samples repeated.
"""

import hashlib
import math
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
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ImuColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import parallel_map, report_stage
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.evaluate import with_solutions
from insdvl_replay.evaluation.evidence import ErrorSeries, ReferenceNoise
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRun,
    OutageRuns,
    Windows,
    distance_along_m,
    drift_run,
)
from insdvl_replay.evaluation.reference_errors import DrawnErrors, drawn_errors, run_from_start
from insdvl_replay.evaluation.repeats import (
    Change,
    Repeat,
    apart_m,
    errors_of_runs,
    metres,
    share_moved,
)
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.logs import copy_log, held_back_messages, write_dive
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_candidate import CandidateError, CandidateStart, Solution
from insdvl_replay.preparation.candidates import failed_history, history_of_candidate
from insdvl_replay.preparation.notes import note
from insdvl_replay.preparation.plugins import Outage, given_dive
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.programs import DIVE_FILES, UserProcesses
from insdvl_replay.preparation.run import RunPlan, Runs, drawn_part, prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude

OUTAGE_DIVES: Final = (
    3  # each lacks every third window: the time between two of them is twice as long as a window
)
LATER_NS: Final = 1000  # by which stamps are moved, and samples repeated
REPEATED_EVERY: Final = 10_000
SHOWN_DIGITS: Final = 16  # of a digest
# the longest windows of which there are so many, else the shortest
LONGEST_WINDOW_S = 60
FEWEST_WINDOWS = 6


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
    repeats: tuple[Repeat, ...] = ()
    turned: History | None = None  # from the plan's second start


def with_user_candidates(
    runs: Runs, dive: Dive, prepared: Prepared, plan: RunPlan, config: Config
) -> Runs:
    """Add the runs of the user's filters to those of all others, which they do not change.

    A filter that fails in any run has no trajectory, and its history says why.
    """
    if not config.user_candidates:
        return runs
    whole = GivenDive(
        "dive", _given(given_dive(dive, config), prepared), prepared, runs.histories[0]
    )
    windows = _windows(plan.windows)
    part = dive
    starts: tuple[Start, ...] = (prepared.alignment.start,)
    outage_dives = _outage_dives(dive, prepared, config, windows)
    if plan.starts:
        starts, part, _ = drawn_part(dive, prepared, plan.starts, plan.seed)
    histories = list(runs.histories)
    drawn = list(runs.drawn)
    notes = list(runs.notes)
    turned = list(runs.turned)
    outages = dict[str, OutageRuns]()
    printed = dict[str, str]()
    cpu_s = dict(runs.cpu_s)
    not_repeatable = dict[str, str]()
    # What a program has started may still write into it.
    with tempfile.TemporaryDirectory(prefix="insdvl-replay-", ignore_cleanup_errors=True) as folder:
        for name, settings in config.user_candidates.items():
            report_stage(f"running {name}")
            candidate = _Candidate(name, settings, Path(folder, name), plan)
            for test in (
                whole,
                *outage_dives,
            ):  # each candidate has files of its own: it may change or remove them
                candidate.give(test, dive, config)
            try:
                found = candidate.runs(whole, starts, part, outage_dives, windows, dive, config)
            except CandidateError as error:
                found = UserRun(
                    failed_history(name, str(error), whole.baseline, whole.dive.imu), None, None, ()
                )
            finally:
                candidate.processes.stop()
            histories.append(found.history)
            turned += [] if found.turned is None else [found.turned]
            drawn += [] if found.drawn is None else [found.drawn]
            drawn = list(with_solutions(drawn, [found.history], dive)) if plan.starts else drawn
            outages |= {} if found.outages is None else {name: found.outages}
            notes += found.notes
            if off := [repeat for repeat in found.repeats if repeat.is_off]:
                not_repeatable[name] = f"{name} {off[0].text(whole.baseline.filter)}"
            cpu_s |= (
                {} if math.isnan(candidate.processes.cpu_s) else {name: candidate.processes.cpu_s}
            )
            printed |= {name: text} if (text := candidate.processes.printed) else {}
            shutil.rmtree(candidate.folder, ignore_errors=True)
    return replace(
        runs, histories=tuple(histories), drawn=tuple(drawn), notes=tuple(notes), user_outages=outages, printed=printed,
        cpu_s=cpu_s, not_repeatable=not_repeatable, turned=tuple(turned),
    )  # fmt: skip


class _Candidate:
    """One filter of the user's: a program or a class."""

    def __init__(self, name: str, settings: Filter, folder: Path, plan: RunPlan) -> None:
        self.name = name
        self.plan = plan
        self.folder = folder
        self.processes = UserProcesses(settings, folder)

    def file(self, test: GivenDive) -> Path:
        """Return the file of a dive that it is given."""
        return self.folder / DIVE_FILES[self.processes.input].format(test.name)

    def give(self, test: GivenDive, dive: Dive, config: Config) -> None:
        """Write the file of a test by a dive, in the form that it reads."""
        file = self.file(test)
        if self.processes.input == "clean":
            write_dive(file, test.dive, is_compressed=False)
        elif self.processes.input == "class":
            file.write_bytes(pickle.dumps(test.dive))
        elif dive.paths:
            copy_log(file, dive.paths, held_back_messages(dive.paths, config, test.absent))

    def history(
        self,
        test: GivenDive,
        run: str,
        start: Start,
        *,
        late_ns: int = 0,
        new_process: bool = False,
    ) -> tuple[History, tuple[Note, ...], str]:
        """Run it over a dive; return its history, notes, and a digest of its solution.

        The stamps that it is given may be late. Those of its solution are taken back.
        """
        alignment = test.prepared.alignment
        given = CandidateStart(
            **{column.name: getattr(start, column.name) for column in fields(Start)},
            time_ns=alignment.start_ns + late_ns,
            dvl_lever_arm_b=test.prepared.mounting.lever_arm_b,
            position_sd_m=np.array(
                alignment.initial.position_sd_m if alignment.initial else (1.0, 1.0, 1.0)
            ),
        )
        dive_file = self.file(test)
        if not dive_file.exists():
            raise CandidateError("cannot be run: its input is the log, and the dive has no file")
        solution = _earlier(
            self.processes.run(run, dive_file, given, new_process=new_process), late_ns
        )
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
        dive: Dive,
        config: Config,
    ) -> UserRun:
        """Run it from all starts, over the dives of the outage test, and again."""
        reference = part.reference

        def from_start(
            place: int,
        ) -> tuple[History | None, DrawnErrors | None, tuple[Note, ...], str]:
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
            drawn = drawn_errors(
                [first, *(errors for _, errors, *_ in others if errors)], own_sd=own_sd
            )
        if others and all(other == digest for *_, other in others):
            notes = (
                *notes,
                note("candidate_ignores_start", len(starts), key=f"filters.{self.name}"),
            )
        turned = None
        if self.plan.heading is not None:
            turned, *_ = self.history(whole, "start_heading", self.plan.heading.start)
        has_attitude = np.isfinite(history.mat_nb).any() and np.isfinite(history.velocity_n).any()
        own = list[History]()
        outages = None
        if windows is not None and has_attitude:
            own = list(parallel_map(in_outages, outage_dives, stop=self.processes.stop))
            outages = self._outages(whole, outage_dives, own, windows)
        repeats = tuple[Repeat, ...]()
        if config.evaluation.repeats:
            first_outage = (
                (outage_dives[0], own[0], windows) if own and windows is not None else None
            )
            repeats = self._repeats(whole, history, digest, starts[0], first_outage, dive, config)
            notes = (
                *notes,
                *_notes_of(repeats, digest, f"filters.{self.name}", whole.baseline.filter),
            )
        return UserRun(history, drawn, outages, notes, repeats, turned)

    def _outages(
        self,
        whole: GivenDive,
        outage_dives: Sequence[GivenDive],
        own: Sequence[History],
        windows: Windows,
    ) -> OutageRuns:
        """Return its drifts and those of the baseline in all windows."""
        velocities = whole.prepared.velocities
        drifts = {
            name: _drifts(outage_dives, found, whole.prepared, windows)
            for name, found in (
                (whole.baseline.filter, [test.baseline for test in outage_dives]),
                (self.name, own),
            )
        }
        none = np.empty(0, np.int64)
        plan = OutagePlan(velocities.time_ns, (windows,), Windows(windows.window_s, none, none, 0))
        distance_m = distance_along_m(velocities.time_ns, velocities.velocity_b)
        return OutageRuns(plan, distance_m, drifts)

    def _repeats(
        self,
        whole: GivenDive,
        first: History,
        digest: str,  # of its solution
        start: Start,
        outage: tuple[GivenDive, History, Windows]
        | None,  # the first dive of the outage test, and its run there
        dive: Dive,
        config: Config,
    ) -> tuple[Repeat, ...]:
        """Run it again, and compare with its first run in the quantity that may decide.

        Where the reference does not give that quantity, it runs again over a dive of the outage test, too.
        """
        # The stamps of a log's messages are the vehicle's own, and are left as they are.
        changes = [Change.AGAIN] if self.processes.input == "log" else [*Change]
        found = self._again(whole, changes, start, dive, config)
        histories = {
            change: answer[0]
            for change, answer in found.items()
            if not isinstance(answer, CandidateError)
        }
        settings = config.reference
        noise = ReferenceNoise(
            settings.position_sd_m, settings.velocity_sd_mps, settings.attitude_sd_deg
        )
        quantity = config.evaluation.primary or ("position" if settings.independent else "")
        bridged_gaps = len(whole.prepared.gaps.start_ns) > 0
        series = errors_of_runs(
            [whole.baseline, first, *histories.values()],
            dive.reference,
            noise,
            quantity,
            bridged_gaps=bridged_gaps,
        )
        if not series and outage is not None and histories:
            test, own, windows = outage
            quantity = f"outage_{windows.window_s}s"
            drifting = self._again(test, list(histories), start, dive, config)
            for change, answer in drifting.items():
                if isinstance(answer, CandidateError):
                    found[change] = answer
                    del histories[change]
            drifted = [
                answer[0] for answer in drifting.values() if not isinstance(answer, CandidateError)
            ]
            series = [
                ErrorSeries(
                    "m",
                    np.array(
                        [
                            run.drift_n[-1, :2]
                            for run in _drifts([test], [one], whole.prepared, windows)
                        ]
                    ),
                )
                for one in (test.baseline, own, *drifted)
            ]
        shares = [share_moved(series[0], series[1], one) for one in series[2:]] or [math.nan] * len(
            histories
        )
        acts = dict(zip(histories, shares, strict=True))
        repeats = list[Repeat]()
        for change, answer in found.items():
            if isinstance(answer, CandidateError):
                repeats.append(Repeat(change, failure=str(answer)))
                continue
            again, again_digest = answer
            known = quantity if series else ""
            repeats.append(
                Repeat(change, again_digest == digest, apart_m(first, again), known, acts[change])
            )
        return tuple(repeats)

    def _again(
        self, test: GivenDive, changes: Sequence[Change], start: Start, dive: Dive, config: Config
    ) -> dict[Change, tuple[History, str] | CandidateError]:
        """Run it over a dive with each change, from the same start; return its histories and digests, or its errors."""

        def run(change: Change) -> tuple[History, str] | CandidateError:
            name = f"{test.name}_{change.name.lower()}"
            changed_test = replace(test, name=name, dive=_with_change(test.dive, change))
            self.give(changed_test, dive, config)
            late_ns = LATER_NS if change == Change.STAMPS else 0
            # The answer may depend on the process, as the order of sets does.
            new_process = change == Change.AGAIN
            try:
                history, _, digest = self.history(
                    replace(test, name=name),
                    f"{name}_run",
                    start,
                    late_ns=late_ns,
                    new_process=new_process,
                )
            except CandidateError as error:
                return error
            finally:
                self.file(changed_test).unlink(missing_ok=True)
            return history, digest

        return dict(zip(changes, parallel_map(run, changes, stop=self.processes.stop), strict=True))


def _earlier(solution: Solution, by_ns: int) -> Solution:
    """Return a solution at earlier times."""
    cov_ns = None if solution.cov_ns is None else solution.cov_ns - by_ns
    return replace(solution, time_ns=solution.time_ns - by_ns, cov_ns=cov_ns)


def _with_change(dive: Dive, change: Change) -> Dive:
    """Return what a filter is given, with a change that means nothing: no filter that is in order moves by it."""
    if change == Change.STAMPS:
        sensors = {
            name: replace(columns, time_ns=columns.time_ns + LATER_NS)
            for name, columns in dive.sensors.items()
        }
        imu = replace(dive.imu, time_ns=dive.imu.time_ns + LATER_NS)
        dvl = replace(dive.dvl, time_ns=dive.dvl.time_ns + LATER_NS)
        return replace(dive, imu=imu, dvl=dvl, sensors=sensors)
    if change == Change.SAMPLES:
        return replace(dive, imu=with_repeated_samples(dive.imu))
    return dive


def with_repeated_samples(imu: ImuColumns) -> ImuColumns:
    """Repeat one sample in `REPEATED_EVERY`, one at least, with the same readings a microsecond later."""
    count = len(imu.time_ns)
    rows = np.arange(min(REPEATED_EVERY, count) // 2, count - 1, REPEATED_EVERY)
    rows = rows[np.diff(imu.time_ns)[rows] > LATER_NS]
    return ImuColumns(
        np.insert(imu.time_ns, rows + 1, imu.time_ns[rows] + LATER_NS),
        np.insert(imu.specific_force_b, rows + 1, imu.specific_force_b[rows], axis=0),
        np.insert(imu.angular_rate_b, rows + 1, imu.angular_rate_b[rows], axis=0),
    )


def _notes_of(repeats: Sequence[Repeat], digest: str, key: str, baseline: str) -> tuple[Note, ...]:
    """Note whether a second run gave the same answer, and how far it moves."""
    notes = list[Note]()
    moved = list[str]()
    if any(repeat.change == Change.AGAIN and repeat.is_off for repeat in repeats):
        # Whatever moves by itself moves with every change.
        repeats = [repeat for repeat in repeats if repeat.change == Change.AGAIN]
    for repeat in repeats:
        is_shown = repeat.is_off or (repeat.change == Change.AGAIN and not repeat.is_equal)
        if is_shown:
            severity = Severity.WARNING if repeat.is_off else None
            notes.append(
                note("answers_differ", severity=severity, key=key, moves=repeat.text(baseline))
            )
        elif repeat.change != Change.AGAIN and math.isfinite(repeat.moves_m):
            moved.append(f"{metres(repeat.moves_m)} {repeat.change}")
    steady = f"; its position moves by {', and by '.join(moved)}" if moved else ""
    if any(repeat.change == Change.AGAIN and repeat.is_equal for repeat in repeats):
        notes.insert(
            0, note("answers_repeat", key=key, digest=digest[:SHOWN_DIGITS], steady=steady)
        )
    return tuple(notes)


def _given(dive: Dive, prepared: Prepared) -> Dive:
    """Return what the built-in filters get of a dive, without anything that judges them."""
    start_ns = prepared.alignment.start_ns
    end_ns = prepared.end_ns
    time_ns = dive.imu.time_ns
    covering = slice(
        int(np.searchsorted(time_ns, start_ns, "right")) - 1,
        int(np.searchsorted(time_ns, end_ns)) + 1,
    )
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
    short = [
        windows
        for windows in plan.by_length
        if windows.window_s <= LONGEST_WINDOW_S and len(windows.first)
    ]
    enough = [windows for windows in short if len(windows.first) >= FEWEST_WINDOWS]
    return next(iter([*enough[::-1], *short]), None)


def _outage_dives(
    dive: Dive, prepared: Prepared, config: Config, windows: Windows | None
) -> list[GivenDive]:
    """Make dives that lack the pings of every third window, and run the baseline over them."""
    found = list[GivenDive]()
    ping_ns = prepared.velocities.time_ns
    alignment = prepared.alignment
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
        around = np.unique(
            np.concatenate([before, np.minimum(before + 1, len(dive.imu.time_ns) - 1)])
        )
        line = prepared_timeline(whole, part, dive.imu.time_ns[around])
        baseline = run_one(part.filters[0], part, line)
        found.append(
            GivenDive(f"outage_{number + 1}", _given(given, part), part, baseline, rows, absent)
        )
    return found


def _drifts(
    dives: Sequence[GivenDive], histories: Sequence[History], prepared: Prepared, windows: Windows
) -> tuple[OutageRun, ...]:
    """Return the drift of a filter in all windows, in their order, by the absent pings."""
    found = dict[int, OutageRun]()
    velocities = prepared.velocities
    arm_b = prepared.mounting.lever_arm_b
    for test, history in zip(dives, histories, strict=True):
        imu = test.dive.imu
        for row in test.windows:
            pings = slice(int(windows.first[row]), int(windows.last[row]) + 1)
            time_ns = velocities.time_ns[pings]
            since_ns = imu.time_ns - time_ns[0]
            rate_ib_b: Floats = np.column_stack(
                [
                    np.interp(time_ns - time_ns[0], since_ns, column)
                    for column in imu.angular_rate_b.T
                ]
            )
            mat_nb = interpolated_attitude(history.time_ns, history.mat_nb, time_ns)
            velocity_n = interpolated(history.time_ns, history.velocity_n, time_ns)
            rate_eb_b = rate_ib_b - earth_rate_n(prepared.alignment.start.position[0]) @ mat_nb
            measured_n = np.einsum(
                "kij,kj->ki", mat_nb, velocities.velocity_b[pings] - np.cross(rate_eb_b, arm_b)
            )
            found[row] = drift_run(time_ns, velocity_n - measured_n)
    return tuple(found[row] for row in sorted(found))
