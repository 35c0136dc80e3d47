"""A look at dives: how closely, whether remote logs are fetched for it, and what is in each dive."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from insdvl_replay.batch.dive_paths import usable_paths
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.core.config import Config
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.inspection.survey import inspect_log, inspect_summary


class Fetch(Protocol):
    """Fetches the remote logs of dives, or finds them in the cache alone; each that cannot be had gets its error."""

    def __call__(
        self, dives: Sequence[FoundDive], *, offline: bool = False, whole: bool = False
    ) -> list[FoundDive]:
        """Return the dives, those of remote logs with their files."""


@dataclass(frozen=True)
class Look:
    """How closely dives are looked at."""

    deep: bool = False  # read all messages of each role, as settings that are proposed need
    one_dive: bool = False  # all logs are of one dive
    offline: bool = False  # open no connection
    allow_damaged: bool = False

    @property
    def needs_files(self) -> bool:
        """Whether remote logs are fetched; else the summary of each is read from its server."""
        return self.deep or self.one_dive or self.offline

    def fetched(self, found: list[FoundDive], fetch: Fetch) -> list[FoundDive]:
        """Return the dives with their files, as far as they are needed."""
        if self.needs_files:
            whole = not self.offline  # Pictures are counted, too.
            return fetch(found, offline=self.offline, whole=whole)
        files = []
        for dive in found:
            if dive.parts:
                files += fetch([dive])
            else:
                files.append(dive)
        return files


def inspect_dive(
    files: Sequence[FoundDive],  # one log, or several of one dive
    config: Config,
    look: Look,
) -> Inventory:
    """State what a dive holds and whether it can be replayed; no code of the settings is run.

    Raises
    ------
    LogError
        A file cannot be read at all.
    """
    paths = usable_paths(files)
    first = files[0]
    if first.url and not look.needs_files:
        return inspect_summary(first.url, config.without_code())
    return inspect_log(
        paths, config.without_code(), deep=look.deep, allow_damaged=look.allow_damaged
    )
