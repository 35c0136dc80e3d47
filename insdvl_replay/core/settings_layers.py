"""Settings as a person gives them to a command or to Python: a preset, files and single keys, or all ready-made."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import given_keys, load_config

LOCAL_SETTINGS: Final = "insdvl-replay.toml"
"""Name of a file of settings that is used for all dives in its folder and below it, although nobody names it."""


def _unheard(_sentence: str) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class LoadedSettings:
    """The settings of several dives."""

    by_file: Mapping[Path | None, Config]  # of a dive's own; None of dives without one

    @property
    def usual(self) -> Config:
        """Those of dives without a file of their own; if there are no such dives, those of the first."""
        if None in self.by_file:
            return self.by_file[None]
        [first, *_] = self.by_file.values()
        return first


@dataclass(frozen=True)
class SettingsLayers:
    """Layers of settings; later ones override earlier ones."""

    preset: str | None = None
    files: Sequence[Path] = ()
    overrides: Sequence[str] = ()  # ``section.key=value``
    allow_code: bool = False
    ready: Config | None = None  # made before, which no layer changes

    def load(
        self,
        own: Path | None = None,  # the file of a dive's own settings, below the other files
        *,
        against: Sequence[str] = (),  # keys of a change, above all others
        report: Callable[[str], None] = _unheard,  # is told of filters that a file replaces
    ) -> Config:
        """Return the resolved settings; those that are ready-made as they are.

        Code that the `LOCAL_SETTINGS` of a dive name is not allowed in any case: whoever wrote the dives may have put
        it there.

        Raises
        ------
        ConfigError
            A layer is wrong, or names code that is not allowed.
        """
        if self.ready is not None:
            return self.ready
        unnamed = None
        if own is not None and own.name == LOCAL_SETTINGS:
            unnamed = own
        return load_config(
            self.preset,
            self.files_with(own),
            self.overrides,
            against=against,
            allow_code=self.allow_code,
            unnamed=unnamed,
            report=report,
        )

    def load_each(
        self,
        files: Iterable[Path | None],  # of dives' own settings; None of dives without one
        *,
        report: Callable[[str], None] = _unheard,
    ) -> "LoadedSettings":
        """Return the resolved settings by the file of a dive's own.

        Raises
        ------
        ConfigError
            As for `load`.
        """
        configs = {}
        for own in dict.fromkeys(files) or [None]:
            configs[own] = self.load(own, report=report)
        return LoadedSettings(configs)

    def files_with(self, own: Path | None) -> list[Path]:
        """Return the files that are read, for a dive that has one of its own or none."""
        if own is None:
            return [*self.files]
        return [own, *self.files]

    def keys(self, own: Path | None = None) -> frozenset[str]:
        """Name the keys that are given, also those with the value of the default; ready-made settings name none.

        Raises
        ------
        ConfigError
            A file cannot be read, is not TOML or holds no settings, or an override is not ``section.key=value``.
        """
        if self.ready is not None:
            return frozenset()
        return given_keys(self.preset, self.files_with(own), self.overrides)
