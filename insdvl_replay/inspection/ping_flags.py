"""What the flags of a DVL's pings mean: by their names, and by the pings that have no velocity or one that scatters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.inspection.probed_topics import ProbedTopic
from insdvl_replay.logs.columns.flags import flag_columns, says_valid
from insdvl_replay.logs.columns.tables import read_sample
from insdvl_replay.logs.columns.topics import LOG_TIME, Source
from insdvl_replay.logs.formats.recording import Recording

_ENOUGH: Final = 100_000  # pings that are looked at


@dataclass(frozen=True)
class FlagSense:
    """What a flag of pings means."""

    key: str = ""  # of the DVL's settings that it is for: valid, invalid, or empty if that is open
    why: str = ""  # what speaks for it


def flag_senses(
    log: Recording,
    topic: ProbedTopic,
    velocity: str,
    names: Sequence[str],
) -> dict[str, FlagSense]:
    """Return what each of some flags means."""
    fields = {"velocity": velocity, "flags": ", ".join(names)}
    source = Source(
        "dvl", topic.topic, topic.channel.type_name, (topic.channel,), fields, LOG_TIME, 0.0
    )
    table = read_sample(log, source, _ENOUGH)
    named = flag_columns(names)
    senses = {}
    for name, flag in zip(names, table.values("flags").T, strict=True):
        by_name = ""
        if name in named.valid:
            by_name = "valid"
        elif name in named.invalid:
            by_name = "invalid"
        is_zero_bad = says_valid(flag, table.values("velocity"))
        by_data = {True: "valid", False: "invalid", None: ""}[is_zero_bad]
        senses[name] = _sense_of(flag, by_name, by_data)
    return senses


def _sense_of(flag: Floats, by_name: str, by_data: str) -> FlagSense:
    """Return what a flag means; that is open where name and data differ, or where no ping would be left."""
    is_marked = flag != 0.0
    if (by_name or by_data) == "valid":
        is_marked = flag == 0.0
    marked = int(np.count_nonzero(is_marked))
    is_contradicted = by_name and by_data and by_name != by_data
    if marked == len(flag) or is_contradicted:
        return FlagSense()
    if by_name:
        return FlagSense(by_name, f"is named so and marks {marked} of {len(flag)} pings")
    if by_data:
        text = f"marks the {marked} of {len(flag)} pings without a velocity, or with one that scatters"
        return FlagSense(by_data, text)
    return FlagSense()
