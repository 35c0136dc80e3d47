"""What a shard leaves for the merge: a file beside its results, which says what was asked for and what became of it."""

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, Literal

import msgspec
from msgspec import Struct

from insdvl_replay.batch.found import Fetch, FoundDive
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions, plan_jobs
from insdvl_replay.batch.overviews import require_own_names
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.batch.search import outcomes_of_shard
from insdvl_replay.batch.shards import Shard, Share, parse_shard, plan_share, with_noise_of_all
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError, UserError, counted
from insdvl_replay.core.report import Report, Tool, as_json, package_versions, this_tool
from insdvl_replay.core.runtime import is_out_of_memory
from insdvl_replay.document.parts import Block, Result
from insdvl_replay.results.folder import COMPLETE, result_file
from insdvl_replay.results.lake import LakeWriter

PART_FILES: Final = "shard_*_of_*.json"
INTERNAL_ERROR: Final = 4
_DIGITS: Final = 16  # of a digest of settings


class PlannedDive(Struct, frozen=True):
    """A dive of the whole run, which may be that of another shard."""

    name: str
    settings: str  # digest of the settings and options that were given


class FailedDive(Struct, frozen=True):
    """Why a dive has no result."""

    reason: str
    hint: str
    exit_code: int


class PartFile(Struct, frozen=True, kw_only=True):
    """What a finished shard has done."""

    kind: Literal["shard"] = "shard"
    tool: Tool
    versions: dict[str, str]  # of Python and packages
    shard: int  # from 1
    shards: int
    dives: list[PlannedDive]  # of the whole run, in its order
    # digest of the settings with a fitted noise, by that of the given ones
    noise: dict[str, str]
    results: dict[str, str]  # digest of the report, by dive
    failed: dict[str, FailedDive]

    @property
    def done(self) -> Shard:
        """The shard that is done."""
        return Shard(self.shard, self.shards)

    @property
    def sentence(self) -> str:
        """What the shard has done, in a line."""
        own = len(self.results) + len(self.failed)
        text = f"shard {self.done}: {own} of {counted(len(self.dives), 'dive')}"
        if self.failed:
            return f"{text}, {len(self.failed)} failed"
        return text


def plan_shard_run(
    shard: str,  # such as ``2/4``
    found: Sequence[FoundDive],  # all dives
    output: Path,
    options: ReplayOptions,
    configs: Mapping[Path | None, Config],  # by the file of a dive's own settings
    fetch: Fetch,
) -> "ShardRun":
    """Plan the replays of those dives of a run that are of a shard.

    Raises
    ------
    ConfigError
        The shard is not of the form ``2/4``.
    """
    meant = parse_shard(shard)
    plan = partial(plan_jobs, output=output, options=options, configs=configs)
    share = plan_share(meant, found, frozenset(meant.places(found)), fetch, plan)
    return ShardRun(share, output)


def part_file(folder: Path, shard: Shard) -> Path:
    """Return the place of the file that a shard writes beside its results."""
    return folder / f"shard_{shard.number}_of_{shard.shards}.json"


@dataclass
class ShardRun:
    """A shard that is replayed, and what became of its dives."""

    share: Share
    folder: Path  # of its results
    _noise: dict[str, str] = field(default_factory=dict)
    _results: dict[str, str] = field(default_factory=dict)
    _failed: dict[str, FailedDive] = field(default_factory=dict)

    @property
    def targets(self) -> list[Path]:
        """The folders of the results of the shard."""
        return [job.target for job in self.share.own_jobs]

    @property
    def file(self) -> Path:
        """The file that says that the shard is done."""
        return part_file(self.folder, self.share.shard)

    def outcomes(
        self,
        how: Replaying,
        lake: LakeWriter | None = None,
    ) -> Generator[Outcome, None, None]:
        """Replay the dives of the shard, and keep what became of them."""
        planned = self.share.own_jobs
        require_own_names(self.share.jobs, self.file.name)
        fitted = with_noise_of_all(self.share, how)
        for job, known in zip(planned, fitted, strict=True):
            self._noise[_settings_digest(job)] = _settings_digest(known)
        with closing(outcomes_of_shard(fitted, how, lake)) as replays:
            for outcome in replays:
                self._keep(outcome)
                yield outcome

    def _keep(self, outcome: Outcome) -> None:
        """Keep what became of a dive."""
        name = outcome.job.target.name
        if isinstance(outcome.result, Report):
            self._results[name] = outcome.result.files[COMPLETE]
        else:
            self._failed[name] = _failed(outcome.result)

    def write(self) -> PartFile:
        """Write the file by which `merge` knows that the shard is done."""
        dives = []
        for job in self.share.jobs:
            dives.append(PlannedDive(job.target.name, _settings_digest(job)))
        shard = self.share.shard
        part = PartFile(
            tool=this_tool(),
            versions=package_versions(),
            shard=shard.number,
            shards=shard.shards,
            dives=dives,
            noise=self._noise,
            results=self._results,
            failed=self._failed,
        )
        self.folder.mkdir(parents=True, exist_ok=True)
        with result_file(self.file, force=True) as file:
            file.write_bytes(as_json(part))
        return part


def _failed(error: Exception) -> FailedDive:
    """Return why a dive has no result, with the exit code that a run of all dives has for it."""
    if isinstance(error, UserError):
        return FailedDive(str(error), error.hint, error.exit_code)
    if is_out_of_memory(error):
        return FailedDive(str(error), "", LogError.exit_code)
    return FailedDive(str(error), "", INTERNAL_ERROR)


def _settings_digest(job: ReplayJob) -> str:
    """Digest the settings of a replay, and its options that change a result."""
    options = job.options
    asked = {
        "config": job.config,
        "allow_damaged": options.allow_damaged,
        "control": options.control,
        "assay": options.assay,
        "tracks": options.tracks,
        "histories": options.histories,
        "history_format": options.history_format,
        "require_fit": options.require_fit,
    }
    return hashlib.sha256(msgspec.json.encode(asked)).hexdigest()[:_DIGITS]


def replay_shard(run: ShardRun, *, force: bool = False) -> PartFile:
    """Replay the dives of a shard in this process, and write its file."""
    for _ in run.outcomes(Replaying(force=force)):
        pass
    return run.write()


def shard_result(part: PartFile) -> Result:
    """Return what a shard has done: table shard has its dives in their order, and why one failed."""
    rows = []
    for dive in part.dives:
        if dive.name in part.results:
            rows.append((dive.name, "done", ""))
        elif dive.name in part.failed:
            rows.append((dive.name, "failed", part.failed[dive.name].reason))
    table = Block(("dive", "status", "reason"), rows)
    return Result("shard", f"Shard {part.done}", [part.sentence], {"shard": table})
