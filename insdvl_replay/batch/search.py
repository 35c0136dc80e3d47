"""Replays of dives with the settings of their jobs, and a search for settings where nobody has given any.

The dives of a vehicle have one search. Those that can be replayed as they are need none; those that contradict what was
found have one of their own.
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from insdvl_replay.batch.fitted_noise import with_fitted_noise
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions, known_reports
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.batch.runs import replay_jobs
from insdvl_replay.batch.workers import Pool, WorkerLostError, cluster_pool, local_pool
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note, TargetError, UserError
from insdvl_replay.core.misfit import MISREAD, MOST_NIS, MOST_REJECTED, MisfitError
from insdvl_replay.core.notes import note
from insdvl_replay.core.quantities import is_used
from insdvl_replay.core.report import Report
from insdvl_replay.core.settings_layers import SettingsLayers
from insdvl_replay.results.lake import LakeWriter, require_lake

if TYPE_CHECKING:
    # Heavy, and often there is nothing to search.
    from insdvl_replay.calibration.found import Given

SEARCHING = "finding the settings"
SEARCHING_SINGLE = "finding the settings of single dives"
FOUND_NOTHING = "found_nothing"
# Notes of a dive that its filters could not follow.
_DIVERGED: Final = frozenset({"gate_reopened", "not_evaluated"})
SHARD: Final = "--shard"
"""The option with which settings that fit are not searched for, since they are found by all dives together."""
_HINT_FOR_SHARDS: Final = (
    "run without --shard over a few of the dives first; then use its vehicle.toml with -c for all"
)


def with_search(
    options: ReplayOptions, layers: SettingsLayers, blocked_by: str = ""
) -> ReplayOptions:
    """Let settings be found for dives that cannot be replayed as they are; what is given stays.

    An option that keeps a run from searching is named in the hint to such a dive.
    """
    return replace(options, require_fit=not blocked_by, blocked_by=blocked_by, given=layers.keys())


def without_search(options: ReplayOptions) -> ReplayOptions:
    """Refuse dives of a shard that need other settings: only all dives together could find them."""
    if not options.require_fit:
        return options
    return replace(options, blocked_by=SHARD)


def outcomes(
    dives: Sequence[ReplayJob],
    how: Replaying,
    lake: LakeWriter | None = None,  # that also gets the evidence of all dives
) -> Generator[Outcome, None, None]:
    """Replay what has changed; settings are found for dives that need some, where that is allowed."""
    yield from _added(_hinted(_parts(dives, how), how), dives, lake)


def outcomes_of_shard(
    dives: Sequence[ReplayJob],  # with the noise that all dives have together
    how: Replaying,
    lake: LakeWriter | None = None,
) -> Generator[Outcome, None, None]:
    """Replay what has changed of a shard. Other settings would have to fit dives of other shards, and are not found."""
    yield from _added(_hinted([_replays(dives, how)], how), dives, lake)


def _added(
    replays: Generator[Outcome, None, None],
    dives: Sequence[ReplayJob],
    lake: LakeWriter | None,
) -> Generator[Outcome, None, None]:
    """Yield outcomes, and add their evidence to a lake."""
    if lake is None:
        yield from replays
        return
    require_lake(lake.lake, {dive.target.parent for dive in dives})
    with closing(lake), closing(replays):
        for outcome in replays:
            if isinstance(outcome.result, Report):
                lake.add(outcome.result)
            yield outcome


def _hinted(
    parts: Sequence[Generator[Outcome, None, None]],
    how: Replaying,
) -> Generator[Outcome, None, None]:
    """Yield outcomes, with hints where other settings may help."""
    hints = _SearchHints(how.say)
    for replays in parts:
        with closing(replays):
            for outcome in replays:
                yield hints.added(outcome)


def _parts(dives: Sequence[ReplayJob], how: Replaying) -> list[Generator[Outcome, None, None]]:
    """Return the replays of dives with the settings of their jobs, then of those that may need others."""
    needing = []
    settled = []
    for dive in dives:
        if dive.options.require_fit and dive.error is None:
            needing.append(dive)
        else:
            settled.append(dive)
    parts = []
    if settled:
        parts.append(outcomes_as_planned(settled, how))
    if needing:
        parts.append(outcomes_without_settings(needing, how))
    return parts


def outcomes_as_planned(
    dives: Sequence[ReplayJob], how: Replaying
) -> Generator[Outcome, None, None]:
    """Replay dives with the settings of their jobs, and a noise that is fitted to them together."""
    yield from _replays(with_fitted_noise(dives, how), how)


def _replays(dives: Sequence[ReplayJob], how: Replaying) -> Generator[Outcome, None, None]:
    """Replay dives with the settings of their jobs; each whose noise is still open fits its own."""
    known = known_reports(dives, force=how.force, rerun=how.rerun, report_note=how.report_note)
    changed = [dive for dive in dives if dive.target not in known]
    pool = _pool(changed, how)
    if pool is not None:
        # Other processes read their logs: that is less than columns that are sent.
        for dive in changed:
            dive.forget()
    replays = replay_jobs(dives, known, pool, work=how.work, elsewhere=how.scheduler is not None)
    if not changed:
        yield from replays
        return
    text = "replay"
    if len(changed) == 1:
        text = f"replay {changed[0].name.name}"
    with how.working(text) as paused, closing(replays):
        for outcome in replays:
            with paused():
                yield outcome


def _pool(changed: Sequence[ReplayJob], how: Replaying) -> Pool | None:
    """Return who replays what has changed."""
    if how.scheduler is not None:
        return cluster_pool(how.scheduler)
    runs_code = any(dive.options.config.code for dive in changed)
    jobs = max(1, min(how.jobs, len(changed)))
    return local_pool(jobs, runs_code=runs_code and how.code_apart)


# --- The search.


@dataclass(frozen=True)
class _Earlier:
    """What an earlier search has left of a dive."""

    config: Config | None  # that it found
    report: Report | None  # of the replay with it, if that would give the same again

    @property
    def is_of_one_dive(self) -> bool:
        """Whether the dive had to have settings of its own."""
        return self.report is not None and any(note.is_own_finding for note in self.report.notes)


def outcomes_without_settings(
    dives: Sequence[ReplayJob], how: Replaying
) -> Generator[Outcome, None, None]:
    """Replay the dives of a vehicle that can be replayed as they are; find settings for the others together."""
    from insdvl_replay.calibration.found import Given

    given = Given(dives[0].options.config, dives[0].options.given)
    earlier = [_earlier_search(dive, given) for dive in dives]
    if not how.rerun and _are_known(earlier):
        yield from outcomes_as_planned(_with_earlier_settings(dives, earlier), how)
        return
    unknown = [dive for dive, left in zip(dives, earlier, strict=True) if left.report is None]
    # Results that may not be replaced stop it before any work is done.
    known_reports(unknown, force=how.force, rerun=how.rerun)
    # Settings that were found for other dives than these are found again, and replace those.
    are_ours = all(
        left.report is not None or not dive.target.exists()
        for dive, left in zip(dives, earlier, strict=True)
    )
    how = replace(how, force=how.force or are_ours)
    fitted = with_fitted_noise(dives, how)
    while fitted:
        (first,) = outcomes_as_planned(fitted[:1], replace(how, jobs=1))
        if not _settings_may_help(first):
            yield first
            yield from _outcomes_of_others(dives[1:], fitted[1:], how)
            return
        if _can_be_opened(first.job):
            yield from _outcomes_of_search(dives, fitted, first, given, how)
            return
        yield first  # a log that is broken tells nothing of the others
        dives = dives[1:]
        fitted = fitted[1:]


def _earlier_search(dive: ReplayJob, given: "Given") -> _Earlier:
    """Return what an earlier search has left in the folder of a dive."""
    from insdvl_replay.calibration.found import stored_settings

    config = stored_settings(dive.target, given)
    if config is None:
        return _Earlier(None, None)
    plain = _with_settings(dive, config)
    plain = replace(plain, options=replace(plain.options, tracks=(), history_format=""))
    return _Earlier(config, known_reports([plain], force=True).get(dive.target))


def _are_known(earlier: Sequence[_Earlier]) -> bool:
    """Return whether an earlier run found the settings of all dives: those of the first, or some of their own."""
    first = earlier[0]
    if first.report is None:
        return False
    return all(left.config == first.config or left.is_of_one_dive for left in earlier)


def _with_earlier_settings(
    dives: Sequence[ReplayJob], earlier: Sequence[_Earlier]
) -> list[ReplayJob]:
    """Return the jobs with the settings that an earlier search found, and its notes."""
    jobs = []
    for dive, left in zip(dives, earlier, strict=True):
        report = left.report or earlier[0].report
        assert left.config is not None
        assert report is not None
        notes = tuple(note for note in report.notes if note.is_finding)
        jobs.append(_with_settings(dive, left.config, notes))
    return jobs


def _with_settings(
    dive: ReplayJob,
    config: Config,
    notes: tuple[Note, ...] = (),
    vehicle: str = "",
) -> ReplayJob:
    """Return a job whose settings are taken as they are, with notes on how they were found, and vehicle.toml."""
    options = replace(
        dive.options,
        config=config,
        found=notes,
        vehicle=vehicle,
        require_fit=False,
    )
    return replace(dive, options=options)


def _outcomes_of_others(
    dives: Sequence[ReplayJob],  # as they were planned
    fitted: Sequence[ReplayJob],  # the same with a noise
    how: Replaying,
) -> Generator[Outcome, None, None]:
    """Replay the dives after one that needed no settings; find settings for those that need some."""
    if not dives:
        return
    planned = {dive.target: dive for dive in dives}
    needing = []
    for outcome in outcomes_as_planned(fitted, how):
        if _settings_may_help(outcome):
            needing.append(planned[outcome.job.target])
        else:
            yield outcome
    if needing:
        yield from outcomes_without_settings(needing, how)


def _outcomes_of_search(
    dives: Sequence[ReplayJob],  # as they were planned
    fitted: Sequence[ReplayJob],  # the same with a noise
    first: Outcome,  # of the first, which needs settings
    given: "Given",
    how: Replaying,
) -> Generator[Outcome, None, None]:
    """Replay dives with settings that are found for all of them together."""
    from insdvl_replay.inspection.automatic import find_settings

    logs = [dive.logs for dive in dives]
    try:
        with how.working(SEARCHING):
            found = find_settings(logs, given, allow_damaged=first.job.options.allow_damaged)
    except UserError as error:
        yield from _outcomes_without_search(dives, first, error, how)
        return
    settled = []
    for dive in fitted:
        known = _with_settings(dive, found.config, found.notes, found.text)
        settled.append(replace(known, found_sha256=found.digests.get(dive.logs, "")))
    yield from _outcomes_by_groups(settled, given, found.config, how)


def _outcomes_without_search(
    dives: Sequence[ReplayJob],
    first: Outcome,
    error: UserError,
    how: Replaying,
) -> Generator[Outcome, None, None]:
    """Replay dives for which no settings were found.

    Where those of the job only do not fit, they are used, with a warning. A dive that cannot be replayed at all has the
    error of the search, and the others are tried without it.
    """
    if isinstance(first.result, MisfitError):
        notes = (
            note(
                FOUND_NOTHING,
                why=error.message,
                hint=error.hint,
            ),
        )
        planned = [_with_settings(dive, dive.options.config, notes) for dive in dives]
        yield from outcomes_as_planned(planned, how)
        return
    yield replace(first, result=error)
    if dives[1:]:
        yield from outcomes_without_settings(dives[1:], how)


def _outcomes_by_groups(
    dives: Sequence[ReplayJob],
    given: "Given",
    common: Config,
    how: Replaying,
) -> Generator[Outcome, None, None]:
    """Replay the dives of a vehicle; those that contradict the first one's settings get some of their own together."""
    from insdvl_replay.inspection.automatic import find_settings, settings_of_one

    replays = outcomes_as_planned(dives, how)
    first = next(replays)
    yield first
    contradicting = []
    for outcome in replays:
        if _contradicts(outcome, first):
            contradicting.append(outcome)
        else:
            yield outcome
    if not contradicting:
        return
    others = [outcome.job for outcome in contradicting]
    logs = [dive.logs for dive in others]
    try:
        with how.working(SEARCHING_SINGLE):
            found = find_settings(logs, given, allow_damaged=first.job.options.allow_damaged)
    except UserError:
        yield from contradicting
        return
    own = []
    for outcome in contradicting:
        dive = outcome.job
        of_dive = settings_of_one(found, dive.target.name, common)
        known = _with_settings(dive, of_dive.config, of_dive.notes, of_dive.text)
        # What the common settings gave is replaced, also where nothing was there before this run.
        is_written = isinstance(outcome.result, Report)
        own.append(
            replace(
                known,
                found_sha256=found.digests.get(dive.logs, ""),
                replaces=dive.replaces or is_written,
            )
        )
    yield from _outcomes_by_groups(own, given, common, replace(how, force=True))


# --- Whether other settings help.


def _settings_may_help(outcome: Outcome) -> bool:
    """Return whether other settings may help: not where the result cannot be written, or where the process ends."""
    error = outcome.result
    return isinstance(error, UserError) and not isinstance(error, WorkerLostError | TargetError)


def _contradicts(outcome: Outcome, first: Outcome) -> bool:
    """Return whether the settings that fit the first dive of a vehicle do not fit another one."""
    if not isinstance(first.result, Report):
        return False
    if not isinstance(outcome.result, Report):
        return _settings_may_help(outcome)
    if _misread(outcome.result) - _misread(first.result):
        return True
    if _has_diverged(outcome.result) and not _has_diverged(first.result):
        return True
    return _nis_per_dof(outcome.result) > MOST_NIS >= _nis_per_dof(first.result)


def _misread(report: Report) -> frozenset[str]:
    """Return the codes of notes that settings misread a dive."""
    return MISREAD.intersection(note.code for note in report.notes)


def _has_diverged(report: Report) -> bool:
    """Return whether the baseline was set to the DVL again so often that no candidate has a verdict.

    A candidate that diverges alone says nothing of the settings: the baseline then rejects few velocities.
    """
    codes = {note.code for note in report.notes}
    return codes >= _DIVERGED and _rejected_by_baseline(report) > MOST_REJECTED


def _rejected_by_baseline(report: Report) -> float:
    """Return the share of the velocities that the gate of the baseline rejects; 0 without any."""
    for row in report.tables.consistency:
        if row.filter == report.baseline and is_used(row.measurement):
            return row.rejected / max(row.used + row.rejected, 1)
    return 0.0


def _nis_per_dof(report: Report) -> float:
    """Return how large the innovations of the baseline are; 1 is expected."""
    from insdvl_replay.show.dive import values_of

    return values_of(report, report.baseline)["nis_per_dof"]


class _SearchHints:
    """Hints to dives of a run that searches for no settings, because of one of its options."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._is_said = False

    def added(self, outcome: Outcome) -> Outcome:
        """Return an outcome whose error has the hint, if other settings may help; of several misfits one is said."""
        option = outcome.job.options.blocked_by
        if not option:
            return outcome
        hint = f"run without {option} first; then use its vehicle.toml with -c"
        if option == SHARD:
            hint = _HINT_FOR_SHARDS
        found = outcome.result
        if isinstance(found, Report):
            is_refused = outcome.job.options.require_fit  # where its settings misfit
            if not (is_refused or self._is_said) and _may_misfit(found):
                self._say(f"hint: these settings may not fit {found.log.name}: {hint}")
                self._is_said = True
            return outcome
        if _settings_may_help(outcome) and _can_be_opened(outcome.job):
            return replace(outcome, result=_with_hint(found, hint))
        return outcome


def _with_hint(error: Exception, hint: str) -> Exception:
    """Return an error with another hint beside its own."""
    assert isinstance(error, UserError)
    hints = [text for text in (error.hint, hint) if text]
    return type(error)(error.what, "; or ".join(hints), *error.where)


def _may_misfit(report: Report) -> bool:
    """Return whether the settings of a replay may be wrong.

    As for `require_fit_of`, nobody has chosen the noise of the sensors of a dive that is not simulated.
    """
    is_simulated = any(channel.role == "truth" for channel in report.log.channels)
    return not is_simulated or bool(_misread(report)) or _nis_per_dof(report) > MOST_NIS


def _can_be_opened(job: ReplayJob) -> bool:
    """Return whether the logs of a dive can be opened at all; else no settings help."""
    from insdvl_replay.logs.formats.recording import open_recording

    with suppress(OSError, UserError):
        open_recording(job.logs, allow_damaged=True)
        return True
    return False
