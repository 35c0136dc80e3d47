"""One dive that is replayed as the command does it, and kept in memory instead of a folder."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.batch.runs import replayed
from insdvl_replay.batch.search import outcomes
from insdvl_replay.core.report import as_json

if TYPE_CHECKING:
    from insdvl_replay.preparation.replay import Replay

_NOWHERE: Final = Path(os.devnull, "dive")
"""The folder of a result that is not stored: below a file there is none, so that no earlier result is found."""


def replay_in_memory(
    logs: Sequence[Path],  # of one dive
    options: ReplayOptions,
    name: str | None = None,  # of the dive; by default that of its log
    *,
    local_settings: str = "",  # the file of settings that nobody has named, seen from the folder of the dive
) -> "Replay":
    """Replay a dive; the error of a dive that cannot be replayed is raised."""
    from insdvl_replay.logs import name_giver
    from insdvl_replay.show.result_files import report_of

    kept: list[Replay] = []

    def keep(job: ReplayJob) -> bytes:
        kept.append(replayed(job, name))
        return as_json(report_of(kept[-1]))

    job = ReplayJob(
        tuple(logs), name_giver(logs), _NOWHERE, options, local_settings=local_settings
    )
    (outcome,) = outcomes([job], Replaying(work=keep))
    if isinstance(outcome.result, Exception):
        raise outcome.result
    return kept[-1]
