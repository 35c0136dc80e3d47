"""The public names for Python: settings, a replay, a result that shows itself in a notebook and holds data frames.

They are reached as ``from insdvl_replay import load_config, replay_log, read_result`` and stay as they are; all below
them may move.
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
from insdvl_replay.show.dive import dive_screen

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
    """Resolve settings, as the command line does.

    Parameters
    ----------
    *files : str or Path
        TOML, later ones on top of earlier ones.
    preset : str, optional
        ``levy-klein`` (the default), ``fog``, ``tactical`` or ``mems``.
    settings : mapping or sequence of str
        Single settings by their dotted keys: ``{"dvl.scale": 1.01}``, or ``["dvl.scale=1.01"]``. Lists may be tuples or
        arrays, numbers NumPy's, and files paths; a mapping sets the keys in it and leaves others as they are.
    allow_code : bool
        The settings may name your code, as ``module:Class``. A replay with them runs it.

    Raises
    ------
    ConfigError
        A key is not known, its value cannot be, or it names code without ``allow_code``.
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
    """Make of what is NumPy's, or a path, what TOML has: NumPy writes its own name into a number's."""
    if value is None:
        raise ConfigError(f"{key}: None is no value", "leave the key out, and its default holds")
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
    """Replay a dive through the configured filters.

    Parameters
    ----------
    log : str, Path or sequence of them
        An MCAP file, a bag folder, or several that are one dive.
    config : Config, optional
        From `load_config`; left out: the default settings.
    allow_damaged : bool
        Use what can be read of a damaged log.
    name : str, optional
        Of the dive, if not that of the log.

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
    """Read a result folder that `run` or `Result.save` wrote.

    Raises
    ------
    ConfigError
        There is none, or several.
    ResultError
        It cannot be read, or is of a version that this one cannot read.
    """
    found, report = read_one_result(Path(folder), Report)
    return Result(report, folder=found)


class UnknownNameError(ConfigError, KeyError):
    """A result has nothing of a name; the hint is the nearest name, or those there are."""

    __str__ = Exception.__str__  # a KeyError's is in quotes


class Named(dict[str, "pd.DataFrame"]):
    """Data frames by name; what is not among them is an UnknownNameError."""

    def __init__(self, kind: str, frames: "Mapping[str, pd.DataFrame]") -> None:
        super().__init__(frames)
        self._kind = kind

    def __missing__(self, name: str) -> "pd.DataFrame":
        raise UnknownNameError(f"{self._kind} '{name}' is not known", hint_for(name, self, most=len(self)))


@dataclass(frozen=True)
class Result:
    """One dive, replayed or read back. In a notebook it shows the word on each filter and the evidence for it."""

    report: Report  # all of it as data
    folder: Path | None = None  # where it is, if it was read
    _replay: "Replay | None" = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of the dive."""
        return self.report.log.name

    @property
    def words(self) -> dict[str, str]:
        """The word on each candidate: better, worse, mixed, equivalent, undecided or not evaluated."""
        return {name: str(candidate.verdict) for name, candidate in self.report.filters.items()}

    @property
    def tables(self) -> dict[str, "pd.DataFrame"]:
        """Each table as a data frame, by its name, such as evidence or outage; NaN for what is missing."""
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
        """All filters once a second: states, standard deviations and errors, with columns filter and time_s."""
        import pandas as pd

        from insdvl_replay.core.states import COLUMNS
        from insdvl_replay.results.trajectory import read_trajectory, trajectory_of

        if self._replay is not None:
            found = trajectory_of(self._replay)
        else:
            read = read_trajectory((self.folder or Path()) / TRAJECTORY_FILE)
            if read is None:
                raise ResultError(f"{self.folder}: has no {TRAJECTORY_FILE} that can be read", "replay the log again")
            found = read
        frames = [
            pd.DataFrame(values, columns=list(COLUMNS)).assign(filter=name, time_s=found.time_s)
            for name, values in zip(found.names, found.values, strict=True)
        ]
        return pd.concat(frames, ignore_index=True)[["filter", "time_s", *COLUMNS]]

    @property
    def histories(self) -> dict[str, "pd.DataFrame"]:
        """The whole history of each filter, of a replay that was not read back; see `result_files.history_frame`."""
        from insdvl_replay.results.result_files import history_frame

        if self._replay is None:
            raise ValueError(f"{self.name}: was read back, which has the trajectory alone; replay its log")
        frames = {history.filter: history_frame(history) for history in self._replay.histories}
        return Named("filter", frames)

    def save(self, folder: Text, *, force: bool = False) -> Path:
        """Write the result folder, as `run` does, and return its path.

        Raises
        ------
        ConfigError
            It exists and must not be replaced.
        """
        from insdvl_replay.results.result_files import save_replay

        if self._replay is None:
            raise ValueError(f"{self.name}: was read from {self.folder}, where it lies already")
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
