"""The public Python interface: settings, a replay, and a result with data frames and a notebook view.

Use ``from insdvl_replay import load_config, replay_log, read_result``. These names are stable; all other modules may
change.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config as _load_config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.errors import ConfigError, ResultError, hint_for
from insdvl_replay.core.result import Report
from insdvl_replay.nav.user_measurement import UserMeasurement, UserReadings
from insdvl_replay.results.folder import PAGE, TRAJECTORY_FILE, result_folder
from insdvl_replay.results.stored_results import read_one_result
from insdvl_replay.show.screens import dive_screen

if TYPE_CHECKING:
    import pandas as pd

    from insdvl_replay.replay import Replay

__all__ = ["Result", "UserMeasurement", "UserReadings", "load_config", "read_result", "replay_log"]

Text = str | Path


def load_config(
    *files: Text,
    preset: str | None = None,
    settings: Mapping[str, object] | Sequence[str] = (),
    allow_code: bool = False,
) -> Config:
    """Return the resolved settings, as the command line does.

    Parameters
    ----------
    *files : str or Path
        TOML files. Later files override earlier ones.
    preset : str, optional
        ``levy-klein`` (the default), ``fog``, ``tactical`` or ``mems``.
    settings : mapping or sequence of str
        Single settings by their dotted keys: ``{"dvl.scale": 1.01}``, or ``["dvl.scale=1.01"]``. Values may be tuples,
        NumPy arrays and numbers, and paths. Nested mappings set only their own keys.
    allow_code : bool
        Allow settings that name your code, as ``module:Class``. A replay then runs this code.

    Raises
    ------
    ConfigError
        A key or value is not valid, or a setting names code without ``allow_code``.
    """
    pairs = [*_pairs(settings)] if isinstance(settings, Mapping) else list(settings)
    return _load_config(preset, [Path(file) for file in files], pairs, allow_code=allow_code)


def _pairs(settings: Mapping[str, object], within: str = "") -> Iterator[str]:
    for name, value in settings.items():
        key = f"{within}{name}"
        if isinstance(value, Mapping):
            yield from _pairs(value, f"{key}.")
        else:
            yield f"{key}={toml_value(_plain(key, value))}"


def _plain(key: str, value: object) -> object:
    """Convert NumPy values and paths to TOML values."""
    if value is None:
        raise ConfigError(f"{key}: None is not a valid value", "leave the key out to use its default")
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(key, item) for item in value]
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def replay_log(
    log: Text | Sequence[Text],
    config: Config | None = None,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
) -> "Result":
    """Replay a dive through the configured filters and return the result.

    Parameters
    ----------
    log : str, Path or sequence of them
        An MCAP file or a bag folder, or several of one dive.
    config : Config, optional
        From `load_config`. Default: the default settings.
    allow_damaged : bool
        Use the readable part of a damaged log.
    name : str, optional
        Name of the dive. Default: the name of the log.

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """
    from insdvl_replay.replay import replay_log as replayed
    from insdvl_replay.results.result_files import report_of

    path = Path(log) if isinstance(log, str | Path) else [Path(part) for part in log]
    replay = replayed(path, config or Config(), allow_damaged=allow_damaged, name=name)
    return Result(report_of(replay), _replay=replay)


def read_result(folder: Text) -> "Result":
    """Return the result in a folder that `run` or `Result.save` wrote.

    Raises
    ------
    ConfigError
        The folder holds no result, or several.
    ResultError
        The result cannot be read, or is of a version that cannot be read.
    """
    found, report = read_one_result(Path(folder), Report)
    return Result(report, folder=found)


class UnknownNameError(ConfigError, KeyError):
    """A result has no table or filter of this name; the hint lists near or all names."""

    __str__ = Exception.__str__  # a KeyError's is in quotes


class Named(dict[str, "pd.DataFrame"]):
    """Data frames by name; an unknown name raises an UnknownNameError."""

    def __init__(self, kind: str, frames: "Mapping[str, pd.DataFrame]") -> None:
        super().__init__(frames)
        self._kind = kind

    def __missing__(self, name: str) -> "pd.DataFrame":
        raise UnknownNameError(f"{self._kind} '{name}' is not known", hint_for(name, self, most=len(self)))


@dataclass(frozen=True)
class Result:
    """The result of one dive. In a notebook it shows the verdict on each candidate and the evidence."""

    report: Report  # the complete result as data
    folder: Path | None = None  # the folder that it was read from
    _replay: "Replay | None" = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """The name of the dive."""
        return self.report.log.name

    @property
    def words(self) -> dict[str, str]:
        """The verdict on each candidate: better, worse, mixed, equivalent, undecided or not evaluated."""
        return {name: str(candidate.verdict) for name, candidate in self.report.filters.items()}

    @property
    def tables(self) -> dict[str, "pd.DataFrame"]:
        """Each table as a data frame, by name, such as evidence or outage; missing values are NaN."""
        import pandas as pd
        from msgspec.structs import asdict

        from insdvl_replay.core.tables import each_table

        frames = {
            layout.name: pd.DataFrame([asdict(row) for row in rows], columns=list(layout.columns))
            for layout, rows in each_table(self.report.tables)
        }
        return Named("table", frames)

    @property
    def trajectory(self) -> "pd.DataFrame":
        """States, standard deviations and errors of all filters once a second, with columns filter and time_s."""
        import pandas as pd

        from insdvl_replay.core.states import COLUMNS
        from insdvl_replay.results.trajectory import read_trajectory, trajectory_of

        if self._replay is not None:
            found = trajectory_of(self._replay)
        else:
            read = read_trajectory((self.folder or Path()) / TRAJECTORY_FILE)
            if read is None:
                raise ResultError(f"{self.folder}: has no readable {TRAJECTORY_FILE}", "replay the log again")
            found = read
        frames = [
            pd.DataFrame(values, columns=list(COLUMNS)).assign(filter=name, time_s=found.time_s)
            for name, values in zip(found.names, found.values, strict=True)
        ]
        return pd.concat(frames, ignore_index=True)[["filter", "time_s", *COLUMNS]]

    @property
    def histories(self) -> dict[str, "pd.DataFrame"]:
        """The full history of each filter. Only a result of `replay_log` has it; see `result_files.history_frame`."""
        from insdvl_replay.results.result_files import history_frame

        if self._replay is None:
            raise ValueError(f"{self.name}: a stored result has only the trajectory. Replay its log for the histories")
        frames = {history.filter: history_frame(history) for history in self._replay.histories}
        return Named("filter", frames)

    def save(self, folder: Text, *, force: bool = False) -> Path:
        """Write the result folder, as `run` does, and return its path.

        Raises
        ------
        ConfigError
            The folder exists and ``force`` is not set.
        """
        from insdvl_replay.results.result_files import save_replay

        if self._replay is None:
            raise ValueError(f"{self.name}: is already stored in {self.folder}")
        target = Path(folder)
        with result_folder(target, force=force) as made:
            save_replay(self._replay, made)
        return target

    def __str__(self) -> str:
        """Return the screen that the command line shows."""
        import io

        from rich.console import Console

        from insdvl_replay.show.text import for_terminal

        console = Console(width=100, file=io.StringIO(), record=True)
        console.print(for_terminal(self._screen()))
        return "\n".join(line.rstrip() for line in console.export_text().rstrip().split("\n"))

    def _repr_html_(self) -> str:
        from insdvl_replay.show.page import fragment

        return fragment(self._screen())

    def _screen(self) -> list["Part"]:
        return dive_screen(self.report, str(self.folder / PAGE) if self.folder else "not saved")


if TYPE_CHECKING:
    from insdvl_replay.core.result import Part
