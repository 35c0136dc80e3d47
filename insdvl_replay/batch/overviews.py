"""The files about all dives of a run, beside the folders of its results."""

import os
from collections.abc import Sequence
from pathlib import Path

from insdvl_replay.batch.jobs import ReplayJob
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import Report
from insdvl_replay.results.folder import require_replaceable_file, result_file
from insdvl_replay.results.stored_results import dives_of_run
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dives import OVERVIEWS

_BEGINNING = 1000  # bytes at the start of a file that identify an overview of this tool


def require_own_names(dives: Sequence[ReplayJob], *others: str) -> None:
    """Raise a ConfigError if a dive has the name of a file about all dives: of an overview, or another one."""
    names = {*OVERVIEWS, *others}
    for dive in dives:
        if dive.target.name in names:
            text = f"{dive.name}: its results would have the name of an overview"
            raise ConfigError(text, "rename it, or replay it alone")


def require_overviews(output: Path, *, force: bool) -> None:
    """Raise a ConfigError if an overview cannot be written; a file with its name that is none is not replaced."""
    for name, (_, beginning) in OVERVIEWS.items():
        path = output / name
        if not os.path.lexists(path):
            continue
        if path.is_symlink() or not path.is_file():
            text = f"{path}: is a link or a folder, and is not replaced"
            raise ConfigError(text, f"rm {path}")
        is_ours = beginning in path.read_bytes()[:_BEGINNING]
        require_replaceable_file(path, force=force or is_ours)


def renew_overviews(report: Report, output: Path, *, is_new: bool) -> list[Path]:
    """Write the overviews of a run of one dive over those of an earlier run, and return their paths.

    A run of one dive has none of its own. Where an earlier run into the folder has left some, they would show its dives
    as those of the last run. They stay if the dive is one of theirs and has not been replayed again.
    """
    dives = dives_of_run(output)
    if dives is None:
        return []
    if report.log.name in dives and not is_new:
        return []
    return write_overviews([report], output)


def write_overviews(reports: Sequence[Report | Failure], output: Path) -> list[Path]:
    """Write the overviews of all dives, and return their paths."""
    output.mkdir(parents=True, exist_ok=True)
    written = []
    for name, (write, _) in OVERVIEWS.items():
        with result_file(output / name, force=True) as file:
            file.write_bytes(write(reports))
        written.append(output / name)
    return written
