"""Settings that a person has given, and those that were found beside them."""

import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from insdvl_replay.core.config import FREE, Config, flattened
from insdvl_replay.core.config_file import (
    FOUND,
    given_keys_in,
    load_config,
    render_toml,
    toml_value,
)
from insdvl_replay.core.errors import Note, UserError, visible
from insdvl_replay.preparation.prepared import KeptDive
from insdvl_replay.results.folder import VEHICLE_FILE


@dataclass(frozen=True)
class Given:
    """Settings that a person has given, which a search leaves as they are."""

    config: Config
    named: Collection[str] = ()  # keys that were given, which may have the value of the default

    @cached_property
    def keys(self) -> list[str]:
        """The keys that are given or not as by default, except for the span and the evaluation."""
        default = dict(flattened(msgspec.to_builtins(Config())))
        # What a dive without settings is replayed with, which nobody has given either.
        without = dict(flattened(msgspec.to_builtins(load_config())))
        named = set(self.named)
        if "imu" not in self.config.noise.fit:
            named |= {*FREE["imu"]}
        values = flattened(msgspec.to_builtins(self.config))
        keys = []
        for key, value in values:
            if key.startswith(("span.", "evaluation.", "noise.fit")):
                continue
            is_default = value in (default.get(key), without.get(key))
            if key in named or not is_default:
                keys.append(key)
        return keys

    def has(self, *names: str) -> bool:
        """Return whether any of some keys is given, or any key of some sections."""
        beginnings = tuple(f"{name}." for name in names)
        return any(f"{key}.".startswith(beginnings) for key in self.keys)


def with_values(config: Config, section: str, **values: Any) -> Config:
    """Set the keys of one section that have a value."""
    known = {key: value for key, value in values.items() if value is not None}
    changed = msgspec.structs.replace(getattr(config, section), **known)
    return msgspec.structs.replace(config, **{section: changed})


def comment_lines(text: str) -> list[str]:
    """Fold a comment at words."""
    return textwrap.wrap(
        visible(text),
        79,
        initial_indent="# ",
        subsequent_indent="#   ",
        break_long_words=False,
        break_on_hyphens=False,
    )


@dataclass(frozen=True)
class FoundSettings:
    """Settings with which dives can be replayed, and what was found or assumed."""

    config: Config
    notes: tuple[Note, ...]  # warnings first
    given: tuple[str, ...] = ()  # keys that a person has given, beside which the others were found
    # SHA-256 of the logs that were read, by the paths of their dive
    digests: Mapping[tuple[Path, ...], str] = field(default_factory=dict)
    kept: KeptDive | None = None  # a dive that was read alone, for its replay

    @property
    def text(self) -> str:
        """Return the settings as a file for ``-c``, which holds what differs from the defaults."""
        lines = list[str]()
        for note in self.notes:
            lines += comment_lines(note.text)
        if self.given:
            # By this a later run knows whether the settings are still those that it would find.
            lines += ["", f"[{FOUND}]", f"given = {toml_value(self.given)}"]
        return "".join(f"{line}\n" for line in lines) + (
            f"\n{render_toml(self.config, changed_only=True)}"
        )


def as_given(found: Config, given: Given) -> Config:
    """Return settings with those that are given."""
    for section in ("imu", "dvl", "reference", "initial", "noise"):
        now = getattr(given.config, section)
        values = {}
        for key in now.__struct_fields__:
            if given.has(f"{section}.{key}"):
                values[key] = getattr(now, key)
        found = with_values(found, section, **values)
    are_given = given.has("filters") or given.config.filters != Config().filters
    if not are_given:
        return found
    filters = dict(given.config.filters)
    if not given.has("filters"):
        # A search adds the solution of a log.
        for name in found.solutions:
            filters[name] = found.filters[name]
    return msgspec.structs.replace(found, filters=filters)


def stored_settings(folder: Path, given: Given) -> Config | None:
    """Return the settings that an earlier run found for the result in a folder, with the same span and evaluation.

    Those that were found beside other given ones are found again.
    """
    file = folder / VEHICLE_FILE
    if not file.is_file():
        return None
    try:
        found = load_config(file=file)
        given_before = given_keys_in(file)
    except UserError:
        return None
    config = given.config
    is_as_given = as_given(found, given) == found and found.topics == config.topics
    is_of_span = (found.span, found.evaluation) == (config.span, config.evaluation)
    if given_before == tuple(given.keys) and is_as_given and is_of_span:
        return found
    return None
