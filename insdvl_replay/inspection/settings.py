"""Proposed settings, with the observation behind each: set in a configuration, or written as TOML with comments."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from insdvl_replay.calibration.found import comment_lines, with_values
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.errors import visible


@dataclass(frozen=True)
class Alternative:
    """What else a person may choose."""

    line: str  # of TOML
    seen: str = ""  # what speaks for it


@dataclass(frozen=True)
class Setting:
    """One proposed setting."""

    key: str  # section and name, such as ``imu.topic``
    value: Any  # None where only a person can know it
    seen: str = ""  # what speaks for the value
    open: str = ""  # what there is to decide; empty where what was seen settles it
    others: tuple[Alternative, ...] = ()
    listed: tuple[str, ...] = ()  # what there is to choose from, line by line

    @property
    def section(self) -> str:
        """Name of its table."""
        return self.key.rpartition(".")[0]

    @property
    def name(self) -> str:
        """Its name in this table."""
        return self.key.rpartition(".")[2]


def with_settings(config: Config, settings: Iterable[Setting]) -> Config:
    """Set what has a value."""
    for setting in settings:
        config = with_values(config, setting.section, **{setting.name: setting.value})
    return config


def not_yet_set(settings: Iterable[Setting], config: Config) -> list[Setting]:
    """Leave out the keys that the configuration has set already."""
    kept = []
    default = Config()
    for setting in settings:
        is_set = _value(config, setting) != _value(default, setting)
        if setting.value is None or not is_set:
            kept.append(setting)
    return kept


def _value(config: Config, setting: Setting) -> object:
    section = getattr(config, setting.section)
    return getattr(section, setting.name)


def ordered(settings: Iterable[Setting]) -> list[Setting]:
    """Return the latest setting of each key, section by section."""
    latest = {setting.key: setting for setting in settings}
    return sorted(
        latest.values(),
        key=lambda setting: Config.__struct_fields__.index(setting.key.partition(".")[0]),
    )


def undecided_keys(settings: Iterable[Setting]) -> tuple[str, ...]:
    """Name the keys about which a person must decide."""
    return tuple(setting.key for setting in ordered(settings) if setting.open)


def settings_toml(settings: Iterable[Setting]) -> str:
    """Write settings as TOML with comments."""
    sections = []
    for section, group in groupby(ordered(settings), lambda setting: setting.section):
        lines = [f"[{section}]"]
        for setting in group:
            lines += _lines_of(setting)
        sections.append("".join(f"{line}\n" for line in lines))
    return "\n".join(sections)


def _lines_of(setting: Setting) -> list[str]:
    """Write a setting, with what was seen and what there is to decide in comments."""
    lines = comment_lines(setting.seen)
    if setting.open:
        lines += comment_lines(f"decide: {setting.open}")
    lines += [f"#   {visible(line)}" for line in setting.listed]
    if setting.value is None:
        lines.append(f"# {setting.name} =")
    else:
        lines.append(f"{setting.name} = {toml_value(setting.value)}")
    for other in setting.others:
        lines += comment_lines(other.seen)
        lines.append(f"# or {visible(other.line)}")
    return lines
