"""The noise of many dives that nobody has given: fitted once to the dives with the same settings, before their replays.

Results of earlier runs keep it in their `vehicle.toml`. It is fitted anew once there is another dive among them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import msgspec

from insdvl_replay.batch.jobs import ReplayJob, known_reports
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import UserError
from insdvl_replay.core.report import Report
from insdvl_replay.results.folder import VEHICLE_FILE

FITTED_NOTE: Final = "found_noise"
FITTING: Final = "fitting the noise"


def with_fitted_noise(jobs: Sequence[ReplayJob], how: Replaying) -> list[ReplayJob]:
    """Return jobs whose settings have a noise. A noise that was given stays.

    Results with a noise that was fitted to other dives may be replaced; any other in the way is a ConfigError.
    """
    fitted = dict[int, ReplayJob]()
    for place, job in enumerate(jobs):
        if place in fitted or job.error is not None or not job.options.config.noise.fit:
            continue
        same = [other for other in range(place, len(jobs)) if is_alike(jobs[other], job)]
        group = [jobs[other] for other in same]
        known = [] if how.rerun else _with_known_noise(group)
        if not known:
            group = [_replacing(job, job, how) for job in group]
            with how.working(FITTING):
                known = _with_new_noise(group)
        fitted |= dict(zip(same, known, strict=True))
    return [fitted.get(place, job) for place, job in enumerate(jobs)]


def with_own_noise(job: ReplayJob) -> ReplayJob:
    """Return a job with a noise of its own: that of its result, if an earlier try left one, else one that is fitted."""
    (found,) = _with_known_noise([job]) or _with_new_noise([job])
    return found


def with_same_noise(
    before: Sequence[ReplayJob],
    after: Sequence[ReplayJob],
    # settings of a job after the change, by those with a noise before
    changed: Callable[[ReplayJob, Config], Config],
    how: Replaying,
) -> tuple[list[ReplayJob], list[ReplayJob]]:
    """Return the jobs before and after a change, the same dives each, with a noise that is fitted before it alone."""
    known = with_fitted_noise(before, how)
    others = list[ReplayJob]()
    for planned, fitted, job in zip(before, known, after, strict=True):
        config = fitted.options.config
        if fitted.options != planned.options:
            options = replace(job.options, config=changed(job, config), found=fitted.options.found)
            stored = _stored_noise(planned)
            if stored is not None and stored != config:
                earlier = replace(job, options=replace(job.options, config=changed(job, stored)))
                job = _replacing(job, earlier, how)
            job = replace(job, options=options)
        others.append(job)
    return known, with_fitted_noise(others, how)


def _replacing(job: ReplayJob, earlier: ReplayJob, how: Replaying) -> ReplayJob:
    """Let a job replace its result if that has the same settings, but for a noise that was fitted to other dives."""
    stored = _stored_noise(earlier)
    if stored is not None:
        earlier = replace(earlier, options=replace(earlier.options, config=stored))
    # It is an error if the result may not be replaced.
    known_reports([earlier], force=how.force, rerun=how.rerun)
    return replace(job, may_replace=not earlier.options.config.noise.fit)


def is_alike(other: ReplayJob, job: ReplayJob) -> bool:
    """Return whether two dives are of one vehicle, with the same settings."""
    return other.error is None and (other.vehicle, other.options) == (job.vehicle, job.options)


def _with_new_noise(jobs: Sequence[ReplayJob]) -> list[ReplayJob]:
    """Fit the noise to dives with the same settings."""
    # heavy, and often not needed
    from insdvl_replay.calibration.fitted_noise import fit_noise_of_logs

    options = jobs[0].options
    found = fit_noise_of_logs(
        [job.logs for job in jobs],
        options.config,
        allow_damaged=options.allow_damaged,
        must_be_described=options.require_fit,
    )
    if not found.notes:
        return list(jobs)
    notes = (*options.found, *found.notes)
    fitted = list[ReplayJob]()
    for job in jobs:
        own = replace(job.options, config=found.config, found=notes, vehicle=found.text)
        digest = found.digests.get(job.logs, job.found_sha256)
        fitted.append(replace(job, options=own, found_sha256=digest))
    if found.kept is not None and _is_read_alike(jobs[0]):
        fitted = [replace(job, kept=found.kept) for job in fitted]
    return fitted


def _is_read_alike(job: ReplayJob) -> bool:
    """Return whether the replay of a dive reads it as the fit of its noise does."""
    return job.config == job.options.config and not job.options.control


def _with_known_noise(jobs: Sequence[ReplayJob]) -> list[ReplayJob]:
    """Take the noise of an earlier run over the same dives; empty if there is none, or if any dive is new."""
    config = _stored_noise(jobs[0])
    if config is None:
        return []
    known = list[ReplayJob]()
    for job in jobs:
        report = _report_with(job, config)
        if report is None:
            return []
        notes = tuple(note for note in report.notes if note.is_finding)
        known.append(replace(job, options=replace(job.options, config=config, found=notes)))
    return known


def _stored_noise(job: ReplayJob) -> Config | None:
    """Return the settings of an earlier result if they are those of a job with a fitted noise."""
    from insdvl_replay.calibration.fitted_noise import with_noise_of

    file = job.target / VEHICLE_FILE
    config = job.options.config
    if not config.noise.fit:
        return None
    try:
        found = load_config(file=file, allow_code=True) if file.is_file() else None
    except UserError:
        return None
    if found is None:
        return None
    # Span and evaluation are not part of what is known of a vehicle.
    found = msgspec.structs.replace(found, span=config.span, evaluation=config.evaluation)
    if with_noise_of(config, found) == found:
        return found
    return None


def _report_with(job: ReplayJob, config: Config) -> Report | None:
    """Return the report of an earlier replay with some fitted settings."""
    plain = replace(job.options, config=config, tracks=(), history_format="")
    report = known_reports([replace(job, options=plain)], force=True).get(job.target)
    is_fitted = report is not None and any(note.code == FITTED_NOTE for note in report.notes)
    if is_fitted:
        return report
    return None
