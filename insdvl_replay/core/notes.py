"""What the codes of notes mean: what happened, what it does to the results, and what to do, as `notes.toml` has it."""

from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Final

import msgspec

from insdvl_replay.core.errors import ConfigError, nearest
from insdvl_replay.core.states import SENSORS

SOURCES: Final = ("imu", "dvl", "reference", "truth", *SENSORS, "solution", "topics.NAME")
"""What a ``*`` at the beginning of a code stands for."""


class Explanation(msgspec.Struct, frozen=True):
    """What a code means, in one or two short sentences each."""

    what: str  # what happened
    effect: str  # what it does to the results
    cure: str  # what to do: a command or a settings key to copy


@cache
def explanations() -> dict[str, dict[str, Explanation]]:
    """Return all explanations by subject and code; a ``*`` in a code stands for a source or a filter."""
    text = resources.files("insdvl_replay").joinpath("core", "notes.toml").read_text("utf-8")
    return msgspec.toml.decode(text, type=dict[str, dict[str, Explanation]])


def explanation(code: str) -> Explanation:
    """Return what a code means; ConfigError, with the nearest code, where it is not known."""
    known: dict[str, Explanation] = {}
    for subject in explanations().values():
        known |= subject
    if code in known:
        return known[code]
    patterns = [pattern for pattern in known if fnmatchcase(code, pattern)]
    if patterns:
        return known[max(patterns, key=len)]
    written_out: list[str] = []
    for pattern in known:
        written_out += [pattern.replace("*", source) for source in SOURCES]
    meant = nearest(code, dict.fromkeys(written_out))
    hint = f"did you mean {meant}?" if meant else "`insdvl-replay explain` lists all codes"
    raise ConfigError(f"code '{code}' is not known", hint)
