"""Settings as a person gives them to a command or to Python: a preset, files and single keys, or all ready-made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import given_keys, load_config


def _unheard(_sentence: str) -> None:
    """Say nothing."""


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

        Raises
        ------
        ConfigError
            A layer is wrong, or names code that is not allowed.
        """
        if self.ready is not None:
            return self.ready
        return load_config(
            self.preset,
            self.files_with(own),
            self.overrides,
            against=against,
            allow_code=self.allow_code,
            report=report,
        )

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
