"""A study and its folder; and the study of windows over logs, of which some may be unusable."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from insdvl_replay.batch.found import FoundDive
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError, Note, UserError
from insdvl_replay.document.paper import require_matplotlib
from insdvl_replay.document.parts import Result
from insdvl_replay.document.render import save_result
from insdvl_replay.results.folder import require_replaceable_folder, result_folder


@dataclass(frozen=True)
class StudyFolder:
    """Where a study is stored, and how."""

    path: Path
    force: bool = False  # replace other results
    png: bool = False  # draw the pictures as PNG, too
    # is entered while the study works
    working: Callable[[], AbstractContextManager[Any]] = nullcontext

    def keep(self, study: Callable[[], Result]) -> Result:
        """Do a study, store it and return it.

        Raises
        ------
        ConfigError
            The folder may not be replaced, or a package for PNG is missing. Both are known before the study begins.
        """
        require_replaceable_folder(self.path, force=self.force)
        if self.png:
            require_matplotlib()
        with self.working():
            result = study()
        with result_folder(self.path, force=self.force) as made:
            save_result(result, made, png=self.png)
        return result


@dataclass(frozen=True)
class WindowStudy:
    """What a study of windows gave."""

    result: Result | None  # None if no log could be had
    missing: tuple[UserError, ...]  # of the logs that could not be had
    studied: int  # logs that could
    left_out: tuple[Note, ...] = ()  # those of them that could not be used

    @property
    def exit_code(self) -> int:
        """The largest of all logs; 0 if each could be used."""
        codes = [error.exit_code for error in self.missing]
        if self.left_out:
            codes.append(LogError.exit_code)
        return max(codes, default=0)


def window_study(
    found: Sequence[FoundDive],  # after their logs were fetched
    config: Config,
    longest: int,
    folder: StudyFolder,
    failed: Callable[[UserError], None],  # is told of each log that could not be had
    *,
    jobs: int = 1,
) -> WindowStudy:
    """Study the windows of the logs that can be used, and store the result.

    Raises
    ------
    LogError
        Logs could be had, and none of them can be used.
    ConfigError
        Two logs have the same name, or the settings do not fit one.
    """
    from insdvl_replay.studies.window import LEFT_OUT, study_window

    missing = []
    paths = []
    for dive in found:
        if dive.error is None:
            paths.append(dive.path)
        else:
            failed(dive.error)
            missing.append(dive.error)
    if not paths:
        return WindowStudy(None, tuple(missing), 0)
    result = folder.keep(lambda: study_window(paths, config, longest, jobs=jobs))
    left_out = tuple(note for note in result.notes if note.code == LEFT_OUT)
    return WindowStudy(result, tuple(missing), len(paths), left_out)
