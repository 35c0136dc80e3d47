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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Config, Filter
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.notes import note
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
from insdvl_replay.logs.readings_csv import write_readings
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_candidate import CandidateError, CandidateStart, Solution
from insdvl_replay.preparation.candidates import failed_history, history_of_candidate
from insdvl_replay.preparation.plugins import Outage, given_dive
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.programs import UserProcesses
from insdvl_replay.preparation.run import RunPlan, Runs, drawn_part, prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude

# each lacks every third window: the time between two of them is twice as long as a window
OUTAGE_DIVES: Final = 3
LATER_NS: Final = 1000  # by which stamps are moved, and samples repeated
REPEATED_EVERY: Final = 10_000
SHOWN_DIGITS: Final = 16  # of a digest
# the longest windows of which there are so many, else the shortest
LONGEST_WINDOW_S = 60
FEWEST_WINDOWS = 6


@dataclass(frozen=True)
class GivenDive:
    """A dive over which the user's filters are run, and the baseline's run over it.

    It is the whole dive, or one of the dives of the outage test, which lack the pings of some windows.
    """

    name: str  # in the name of its file: `dive`, `outage_1`, ...
    dive: Dive  # as filters of the user's are given it
    prepared: Prepared
    baseline: History
    windows: Sequence[int] = ()  # of the outage test: the windows whose pings are absent, by row
    absent: Sequence[Outage] = ()  # first and last absent ping of each of these, ns


class UserRun(NamedTuple):
    """What one filter of the user's gave. If it failed, all but the history is empty."""

    history: History  # over the whole dive; it says why the filter failed
    drawn: DrawnErrors | None  # from random starts; None without a reference
    outages: OutageRuns | None  # its drifts and the baseline's; None where the test cannot be made
    notes: tuple[Note, ...]
    repeats: tuple[Repeat, ...] = ()  # empty where the settings ask for none
    turned: History | None = None  # from the plan's start with another heading, if it has one


def with_user_candidates(
    runs: Runs,
    dive: Dive,
    prepared: Prepared,
    plan: RunPlan,
    config: Config,
) -> Runs:
    """Add the runs of the user's filters to those of all others, which they do not change.

    A filter that fails in any run has no trajectory, and its history says why.
    """
    if not config.user_candidates:
        return runs
    baseline = runs.histories[0]
    tests = _planned_tests(dive, prepared, plan, config, baseline)
    # Processes that a program has left behind may still write into the folder, and hinder its removal.
    with tempfile.TemporaryDirectory(
        prefix="insdvl-replay-", ignore_cleanup_errors=True
    ) as folder:
        for name, settings in config.user_candidates.items():
            report_stage(f"running {name}")
            candidate = _Candidate(name, settings, Path(folder, name), plan, dive, config)
            found = candidate.tested(tests)
            runs = _with_run(runs, name, found, baseline.filter)
            if plan.starts:
                # One without errors from drawn starts, as where it failed, has those of its history.
                drawn = with_solutions(runs.drawn, [found.history], dive)
                runs = replace(runs, drawn=drawn)
            runs = _with_processes(runs, name, candidate.processes)
            # The next filter needs the room on the disk.
            shutil.rmtree(candidate.folder, ignore_errors=True)
    return runs


def _planned_tests(
    dive: Dive,
    prepared: Prepared,
    plan: RunPlan,
    config: Config,
    baseline: History,
) -> "_Tests":
    """Prepare what each filter of the user's is run over."""
    given = _given(given_dive(dive, config), prepared)
    windows = _windows(plan.windows)
    starts: tuple[Start, ...] = (prepared.alignment.start,)
    reference = dive.reference
    if plan.starts:
        starts, part, _ = drawn_part(dive, prepared, plan.starts, plan.seed)
        reference = part.reference
    return _Tests(
        whole=GivenDive("dive", given, prepared, baseline),
        starts=starts,
        reference=reference,
        windows=windows,
        outages=_outage_dives(dive, prepared, config, windows),
    )


def _with_run(
    runs: Runs,
    name: str,
    found: UserRun,
    baseline: str,
) -> Runs:
    """Add what one filter of the user's gave. The baseline's name is for the sentence on one that is not repeatable."""
    drawn = runs.drawn
    if found.drawn is not None:
        drawn = (*drawn, found.drawn)
    turned = runs.turned
    if found.turned is not None:
        turned = (*turned, found.turned)
    outages = dict(runs.user_outages)
    if found.outages is not None:
        outages[name] = found.outages
    not_repeatable = dict(runs.not_repeatable)
    for repeat in found.repeats:
        if repeat.is_off:
            not_repeatable[name] = f"{name} {repeat.text(baseline)}"
            break
    return replace(
        runs,
        histories=(*runs.histories, found.history),
        drawn=drawn,
        turned=turned,
        user_outages=outages,
        notes=(*runs.notes, *found.notes),
        not_repeatable=not_repeatable,
    )


def _with_processes(runs: Runs, name: str, processes: UserProcesses) -> Runs:
    """Add what the processes of a filter have taken and printed."""
    cpu_s = dict(runs.cpu_s)
    if not math.isnan(processes.cpu_s):
        cpu_s[name] = processes.cpu_s
    printed = dict(runs.printed)
    text = processes.printed
    if text:
        printed[name] = text
    return replace(runs, cpu_s=cpu_s, printed=printed)


class _Tests(NamedTuple):
    """What each filter of the user's is run over."""

    whole: GivenDive
    starts: Sequence[Start]  # the dive's own, then those that are drawn
    reference: ReferenceColumns | None  # at the times at which errors from these starts are kept
    windows: Windows | None  # without the DVL; None where the dive has none
    outages: Sequence[GivenDive]  # dives without the pings of some of these windows


class _Answer(NamedTuple):
    """The run of a filter over a dive."""

    history: History
    notes: tuple[Note, ...]
    digest: str  # of its solution


class _Candidate:
    """One filter of the user's: a program or a class."""

    def __init__(
        self,
        name: str,
        settings: Filter,
        folder: Path,
        plan: RunPlan,
        dive: Dive,  # with the reference and all that was read
        config: Config,
    ) -> None:
        self.name = name
        self.plan = plan
        self.dive = dive
        self.config = config
        self.folder = folder
        self.processes = UserProcesses(settings, folder)

    def tested(self, tests: _Tests) -> UserRun:
        """Run it over all tests; one that fails in any of them has no trajectory."""
        # Each candidate has files of its own: it may change or remove them.
        for test in (tests.whole, *tests.outages):
            self.give(test)
        try:
            return self.runs(tests)
        except CandidateError as error:
            baseline = tests.whole.baseline
            history = failed_history(self.name, str(error), baseline, tests.whole.dive.imu)
            return UserRun(history, None, None, ())
        finally:
            self.processes.stop()

    def files(self, test: GivenDive) -> list[Path]:
        """Return the files of a dive that it is given."""
        files = list(self.processes.reading_files(test.name).values())
        return [self.processes.file(test.name), *files]

    def give(self, test: GivenDive) -> None:
        """Write the files of a test, in the form that it reads."""
        for word, csv_file in self.processes.reading_files(test.name).items():
            write_readings(csv_file, word, test.dive)
        if not self.processes.reads_dive:
            return
        file = self.processes.file(test.name)
        paths = self.dive.paths
        if self.processes.input == "clean":
            write_dive(file, test.dive, is_compressed=False)
        elif self.processes.input == "class":
            file.write_bytes(pickle.dumps(test.dive))
        elif paths:
            copy_log(file, paths, held_back_messages(paths, self.config, test.absent))

    def history(
        self,
        test: GivenDive,
        run: str,
        start: Start,
        *,
        late_ns: int = 0,
        new_process: bool = False,
    ) -> _Answer:
        """Run it over a dive.

        The stamps that it is given may be late. Those of its solution are taken back.
        """
        alignment = test.prepared.alignment
        if self.processes.reads_dive and not self.processes.file(test.name).exists():
            raise CandidateError("cannot be run: its input is the log, and the dive has no file")
        given = _given_start(test.prepared, start, late_ns)
        solution = self.processes.run(run, test.name, given, new_process=new_process)
        solution = _earlier(solution, late_ns)
        history, notes = history_of_candidate(
            self.name,
            solution,
            start,
            alignment.start_ns,
            test.dive.imu,
            test.prepared.velocities,
            test.baseline,
            self.plan.evaluated_ns,
        )
        return _Answer(history, notes, _digest_of(solution))

    def runs(self, tests: _Tests) -> UserRun:
        """Run it from all starts, over the dives of the outage test, and again."""
        whole = tests.whole
        key = f"filters.{self.name}"
        # A mistake of its own shows at the first run.
        first = self.history(whole, "start_001", tests.starts[0])
        history = first.history
        notes = list(first.notes)
        drawn, digests = self._from_drawn_starts(tests, history)
        if digests and set(digests) == {first.digest}:
            notes.append(note("candidate_ignores_start", len(tests.starts), key=key))
        turned = None
        if self.plan.heading is not None:
            turned = self.history(whole, "start_heading", self.plan.heading.start).history
        in_outages = list[History]()
        outages = None
        has_attitude = np.isfinite(history.mat_nb).any() and np.isfinite(history.velocity_n).any()
        if tests.windows is not None and has_attitude:
            in_outages = self._in_outages(tests)
            outages = self._outage_runs(tests, in_outages, tests.windows)
        repeats = tuple[Repeat, ...]()
        if self.config.evaluation.repeats:
            repeats = self._repeats(tests, first, in_outages)
            notes += _notes_of(repeats, first.digest, key, whole.baseline.filter)
        return UserRun(history, drawn, outages, tuple(notes), repeats, turned)

    def _from_drawn_starts(
        self, tests: _Tests, first: History
    ) -> tuple[DrawnErrors | None, list[str]]:
        """Run it from the drawn starts; return its errors from all starts, and the digests of these solutions."""
        reference = tests.reference
        truth = self.dive.truth

        def from_start(number: int) -> tuple[DrawnErrors | None, str]:
            start = tests.starts[number - 1]
            answer = self.history(tests.whole, f"start_{number:03d}", start)
            if reference is None:
                return None, answer.digest
            return run_from_start(answer.history, reference, truth), answer.digest

        numbers = range(2, len(tests.starts) + 1)
        others = list(parallel_map(from_start, numbers, stop=self.processes.stop))
        digests = [digest for _, digest in others]
        if reference is None:
            return None, digests
        errors = [run_from_start(first, reference, truth)]
        errors += [found for found, _ in others if found is not None]
        own_sd = tests.whole.prepared.alignment.spread_cov is None
        return drawn_errors(errors, own_sd=own_sd), digests

    def _in_outages(self, tests: _Tests) -> list[History]:
        """Run it over the dives of the outage test."""

        def run(test: GivenDive) -> History:
            return self.history(test, test.name, tests.starts[0]).history

        return list(parallel_map(run, tests.outages, stop=self.processes.stop))

    def _outage_runs(
        self,
        tests: _Tests,
        histories: Sequence[History],
        windows: Windows,
    ) -> OutageRuns:
        """Return its drifts and those of the baseline in all windows."""
        prepared = tests.whole.prepared
        velocities = prepared.velocities
        baselines = [test.baseline for test in tests.outages]
        drifts = {
            tests.whole.baseline.filter: _drifts(tests.outages, baselines, prepared, windows),
            self.name: _drifts(tests.outages, histories, prepared, windows),
        }
        none = np.empty(0, np.int64)
        plan = OutagePlan(velocities.time_ns, (windows,), Windows(windows.window_s, none, none, 0))
        distance_m = distance_along_m(velocities.time_ns, velocities.velocity_b)
        return OutageRuns(plan, distance_m, drifts)

    def _repeats(
        self,
        tests: _Tests,
        first: _Answer,
        in_outages: Sequence[History],  # its runs over the dives of the outage test
    ) -> tuple[Repeat, ...]:
        """Run it again, and compare with its first run in the quantity that may decide.

        Where the reference does not give that quantity, it runs again over a dive of the outage test, too.
        """
        changes = [*Change]
        if self.processes.input == "log":
            # The stamps of a log's messages are the vehicle's own, and are left as they are.
            changes = [Change.AGAIN]
        again = self._again(tests.whole, changes, tests.starts[0])
        quantity, series = self._errors_again(tests.whole, first.history, again)
        if not series and in_outages and again.answers:
            drifting = self._again(tests.outages[0], list(again.answers), tests.starts[0])
            again = again.without(drifting.failures)
            quantity, series = self._drifts_again(tests, in_outages[0], drifting)
        acts = dict.fromkeys(again.answers, math.nan)
        if series:
            of_baseline, of_first, *of_others = series
            for change, own in zip(acts, of_others, strict=True):
                acts[change] = share_moved(of_baseline, of_first, own)
        repeats = list[Repeat]()
        for change in changes:
            if change in again.failures:
                repeats.append(Repeat(change, failure=again.failures[change]))
                continue
            answer = again.answers[change]
            repeats.append(
                Repeat(
                    change,
                    is_equal=answer.digest == first.digest,
                    moves_m=apart_m(first.history, answer.history),
                    quantity=quantity if series else "",
                    acts=acts[change],
                )
            )
        return tuple(repeats)

    def _errors_again(
        self,
        whole: GivenDive,
        first: History,
        again: "_Again",
    ) -> tuple[str, list[ErrorSeries]]:
        """Return the quantity that decides by the reference, and the errors of baseline, first run, and other runs."""
        settings = self.config.reference
        noise = ReferenceNoise(
            settings.position_sd_m, settings.velocity_sd_mps, settings.attitude_sd_deg
        )
        quantity = self.config.evaluation.primary
        if not quantity and settings.independent:
            quantity = "position"
        histories = [answer.history for answer in again.answers.values()]
        series = errors_of_runs(
            [whole.baseline, first, *histories],
            self.dive.reference,
            noise,
            quantity,
            bridged_gaps=len(whole.prepared.gaps.start_ns) > 0,
        )
        return quantity, series

    def _drifts_again(
        self,
        tests: _Tests,
        first: History,
        again: "_Again",
    ) -> tuple[str, list[ErrorSeries]]:
        """Return the quantity of the outage test, and the drifts of baseline, first run, and other runs."""
        windows = tests.windows
        assert windows is not None
        test = tests.outages[0]
        histories = [test.baseline, first]
        histories += [answer.history for answer in again.answers.values()]
        series = []
        for history in histories:
            drifts = _drifts([test], [history], tests.whole.prepared, windows)
            ends_m = np.array([run.drift_n[-1, :2] for run in drifts])
            series.append(ErrorSeries("m", ends_m))
        return f"outage_{windows.window_s}s", series

    def _again(
        self,
        test: GivenDive,
        changes: Sequence[Change],
        start: Start,
    ) -> "_Again":
        """Run it over a dive with each change, from the same start."""

        def run(change: Change) -> _Answer | CandidateError:
            name = f"{test.name}_{change.name.lower()}"
            changed_test = replace(test, name=name, dive=_with_change(test.dive, change))
            self.give(changed_test)
            try:
                return self.history(
                    replace(test, name=name),
                    f"{name}_run",
                    start,
                    late_ns=LATER_NS if change == Change.STAMPS else 0,
                    # The answer may depend on the process, as the order of sets does.
                    new_process=change == Change.AGAIN,
                )
            except CandidateError as error:
                return error
            finally:
                for file in self.files(changed_test):
                    file.unlink(missing_ok=True)

        answers = dict[Change, _Answer]()
        failures = dict[Change, str]()
        found = list(parallel_map(run, changes, stop=self.processes.stop))
        for change, answer in zip(changes, found, strict=True):
            if isinstance(answer, CandidateError):
                failures[change] = str(answer)
            else:
                answers[change] = answer
        return _Again(answers, failures)


class _Again(NamedTuple):
    """Further runs of a filter, by what was changed."""

    answers: Mapping[Change, _Answer]
    failures: Mapping[Change, str]  # of the runs that gave nothing: why

    def without(self, failures: Mapping[Change, str]) -> "_Again":
        """Count more runs as failed."""
        answers = {change: own for change, own in self.answers.items() if change not in failures}
        return _Again(answers, {**self.failures, **failures})


def _given_start(prepared: Prepared, start: Start, late_ns: int) -> CandidateStart:
    """Return the start as a filter of the user's is given it."""
    alignment = prepared.alignment
    position_sd_m = (1.0, 1.0, 1.0)
    if alignment.initial is not None:
        position_sd_m = alignment.initial.position_sd_m
    return CandidateStart(
        **{column.name: getattr(start, column.name) for column in fields(Start)},
        time_ns=alignment.start_ns + late_ns,
        dvl_lever_arm_b=prepared.mounting.lever_arm_b,
        position_sd_m=np.array(position_sd_m),
    )


def _digest_of(solution: Solution) -> str:
    """Return a digest of the trajectory of a solution."""
    digest = hashlib.sha256()
    for column in (solution.time_ns, solution.position, solution.velocity_n, solution.mat_nb):
        if column is not None:
            digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()


def _earlier(solution: Solution, by_ns: int) -> Solution:
    """Return a solution at earlier times."""
    earlier = replace(solution, time_ns=solution.time_ns - by_ns)
    if solution.cov_ns is None:
        return earlier
    return replace(earlier, cov_ns=solution.cov_ns - by_ns)


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


def _notes_of(
    repeats: Sequence[Repeat],
    digest: str,
    key: str,
    baseline: str,
) -> tuple[Note, ...]:
    """Note whether a second run gave the same answer, and how far it moves."""
    [again] = [repeat for repeat in repeats if repeat.change == Change.AGAIN]
    others = [repeat for repeat in repeats if repeat.change != Change.AGAIN]
    if again.is_off:
        # Whatever moves by itself moves with every change.
        others = []
    notes = list[Note]()
    if again.is_equal:
        steady = _steady(others)
        shown = digest[:SHOWN_DIGITS]
        notes.append(note("answers_repeat", key=key, digest=shown, steady=steady))
    differing = [repeat for repeat in others if repeat.is_off]
    if again.is_off or not again.is_equal:
        differing.insert(0, again)
    for repeat in differing:
        severity = Severity.WARNING if repeat.is_off else None
        moves = repeat.text(baseline)
        notes.append(note("answers_differ", severity=severity, key=key, moves=moves))
    return tuple(notes)


def _steady(repeats: Sequence[Repeat]) -> str:
    """Say how far the position moves by changes that do not matter; empty where that is not known."""
    moved = []
    for repeat in repeats:
        if not repeat.is_off and math.isfinite(repeat.moves_m):
            moved.append(f"{metres(repeat.moves_m)} {repeat.when}")
    if not moved:
        return ""
    return f"; its position moves by {', and by '.join(moved)}"


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
    if not short:
        return None
    for windows in reversed(short):
        if len(windows.first) >= FEWEST_WINDOWS:
            return windows
    return short[0]


def _outage_dives(
    dive: Dive,
    prepared: Prepared,
    config: Config,
    windows: Windows | None,
) -> list[GivenDive]:
    """Make dives that lack the pings of every third window, and run the baseline over them."""
    if windows is None:
        return []
    found = list[GivenDive]()
    ping_ns = prepared.velocities.time_ns
    alignment = prepared.alignment
    filters = {config.baseline: config.filters[config.baseline]}
    settings = changed(config, initial=alignment.initial or config.initial, filters=filters)
    for number in range(min(OUTAGE_DIVES, len(windows.first))):
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
    dives: Sequence[GivenDive],
    histories: Sequence[History],
    prepared: Prepared,
    windows: Windows,
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
            since_ns = time_ns - time_ns[0]
            imu_since_ns = imu.time_ns - time_ns[0]
            rate_ib_b: Floats = np.column_stack(
                [np.interp(since_ns, imu_since_ns, column) for column in imu.angular_rate_b.T]
            )
            mat_nb = interpolated_attitude(history.time_ns, history.mat_nb, time_ns)
            velocity_n = interpolated(history.time_ns, history.velocity_n, time_ns)
            rate_eb_b = rate_ib_b - earth_rate_n(prepared.alignment.start.position[0]) @ mat_nb
            measured_n = np.einsum(
                "kij,kj->ki", mat_nb, velocities.velocity_b[pings] - np.cross(rate_eb_b, arm_b)
            )
            found[row] = drift_run(time_ns, velocity_n - measured_n)
    return tuple(found[row] for row in sorted(found))
