"""A look at dives: what is in each, and the settings that are proposed for all of them."""

from collections.abc import Sequence

from insdvl_replay.batch.dive_paths import usable_paths
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.core.config import Config
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.inspection.survey import inspect_log, inspect_summary


def inspect_dive(
    files: Sequence[FoundDive],  # one log, or several of one dive
    config: Config,
    *,
    deep: bool = False,  # read all messages of each role
    allow_damaged: bool = False,
    is_fetched: bool = True,  # else of a remote log the summary alone is read
) -> Inventory:
    """State what a dive holds and whether it can be replayed; no code of the settings is run.

    Raises
    ------
    LogError
        A file cannot be read at all.
    """
    paths = usable_paths(files)
    first = files[0]
    if first.url and not is_fetched:
        return inspect_summary(first.url, config.without_code())
    return inspect_log(paths, config.without_code(), deep=deep, allow_damaged=allow_damaged)
