"""A file of settings with which a log can be run: what was given, what was seen, and what is left to a person."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from msgspec import Struct

from insdvl_replay import __version__
from insdvl_replay.core.config import Acceleration, Config, Filter, Topic
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.errors import UserError, listed
from insdvl_replay.inspection.proposed_settings import (
    Setting,
    comment_lines,
    not_yet_set,
    settings_toml,
    undecided_keys,
    with_settings,
)
from insdvl_replay.inspection.survey import propose_settings
from insdvl_replay.inspection.trial_runs import preset_config, readable, trial_runs, warned

MOST_DIVES: Final = 5
"""Dives that are read to try a mounting on: more would say the same again."""


@dataclass(frozen=True)
class SettingsFile:
    """A proposal as text that ``-c`` reads.

    Attributes
    ----------
    decisions : tuple of str
        Keys about which a person must decide; those of them without a value are comments in the text.
    missing : tuple of str
        Keys without a value.
    failures : tuple of UserError
        What kept the log from being read, or run, with it.
    """

    text: str
    decisions: tuple[str, ...]
    missing: tuple[str, ...]
    failures: tuple[UserError, ...]


def settings_file(
    dives: Sequence[Path | Sequence[Path]], config: Config, *, allow_damaged: bool = False
) -> SettingsFile:
    """Propose all settings for the dives of a vehicle.

    Parameters
    ----------
    dives : sequence of paths
        At least one. Topics, units and axes are those of the first, the noise too; the mounting is tried on the first
        few together, and a heading is proposed for one alone.

    Raises
    ------
    LogError
        The first cannot be read at all.
    """
    proposal = propose_settings(dives[0], config, allow_damaged=allow_damaged)
    settings = [*_given(config), *proposal.settings]
    draft = with_settings(config, settings)
    read, unread = readable(dives[:MOST_DIVES], draft, allow_damaged=allow_damaged)
    failures, preset = tuple(unread), ""
    warnings: tuple[str, ...] = ()
    if read:
        trial = trial_runs(read, draft)
        settings += not_yet_set(trial.settings, config)
        failures, preset = (*failures, *trial.failures), trial.preset
        if any(setting.key == "dvl.axes" for setting in trial.settings):  # what was wrong with the others is no longer
            read, _ = readable(dives[:MOST_DIVES], with_settings(config, settings), allow_damaged=allow_damaged)
        warnings = tuple(warned(read))
    filters = preset_config(preset, config).filters
    head = _head([dive.name for dive in read] or [_name(dives[0])], failures, warnings, undecided_keys(settings))
    parts = [
        "".join(f"{line}\n" for line in head),
        settings_toml(settings),
        _topics_toml(config.topics),
        _filters_toml(filters, preset),
    ]
    latest = {setting.key: setting for setting in settings}.values()
    missing = tuple(setting.key for setting in latest if setting.value is None and not _may_be_missing(setting.key))
    return SettingsFile("\n".join(part for part in parts if part), undecided_keys(settings), missing, failures)


def _may_be_missing(key: str) -> bool:
    """Return whether a key stands in a proposal without a value though a replay works without it."""
    return key == "dvl.valid"


def _name(dive: Path | Sequence[Path]) -> str:
    return (dive if isinstance(dive, Path) else dive[0]).name


def _head(
    names: Sequence[str], failures: Sequence[UserError], warnings: Sequence[str], decisions: Sequence[str]
) -> Iterator[str]:
    yield from comment_lines(f"insdvl-replay {__version__} inspect --propose: {listed(names)}")
    for failure in failures:
        yield from comment_lines(f"decide: stops a replay with this: {failure.message}; {failure.hint}")
    for warning in warnings:
        yield from comment_lines(f"warning: {warning}")
    yield from comment_lines(f"to decide: {', '.join(decisions) or 'nothing'}")


def _given(config: Config) -> Iterator[Setting]:
    """Take over what -c, --set and --preset said, so that the file stands for itself."""
    default = Config()
    for section in config.__struct_fields__:
        now, before = getattr(config, section), getattr(default, section)
        if not isinstance(now, Struct):
            continue  # sections by names of the user's own, written as they are
        for name in now.__struct_fields__:
            if getattr(now, name) != getattr(before, name):
                yield Setting(f"{section}.{name}", getattr(now, name), "as given")


def _topics_toml(topics: Mapping[str, Topic]) -> str:
    """Write the topics of the user's own measurements, each key that is not left out."""
    tables = []
    for name, topic in topics.items():
        given = _changed(topic, Topic(topic="", values=""))
        tables.append("\n".join([f"[topics.{name}]", *(f"{key} = {toml_value(given[key])}" for key in given)]) + "\n")
    return "\n".join(tables)


def _filters_toml(filters: Mapping[str, Filter], preset: str) -> str:
    """Write filters, each key that is not as it is by default."""
    if filters == Config().filters:
        return ""
    tables = []
    for name, filter_ in filters.items():
        changed = _changed(filter_, Filter(aiding=()))
        if filter_.acceleration is not None:
            inline = _changed(filter_.acceleration, Acceleration(), always=("model", "window"))
            parts = ", ".join(f"{key} = {toml_value(value)}" for key, value in inline.items())
            changed["acceleration"] = f"{{ {parts} }}"
        lines = (f"{key} = {value if key == 'acceleration' else toml_value(value)}" for key, value in changed.items())
        tables.append("\n".join([f"[filters.{name}]", *lines]) + "\n")
    return (f"# Preset {preset}.\n" if preset else "") + "\n".join(tables)


def _changed(section: Struct, default: Struct, always: Collection[str] = ()) -> dict[str, Any]:
    values = {key: getattr(section, key) for key in section.__struct_fields__}
    return {key: value for key, value in values.items() if key in always or value != getattr(default, key)}
