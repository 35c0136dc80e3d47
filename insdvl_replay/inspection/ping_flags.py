"""What the flags of a DVL's pings mean: by their names, and by the pings that have no velocity or one that scatters."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from insdvl_replay.inspection.dry_run import ProbedTopic
from insdvl_replay.logs.columns.flags import flag_columns, says_valid
from insdvl_replay.logs.columns.tables import read_sample
from insdvl_replay.logs.columns.topics import LOG_TIME, Source
from insdvl_replay.logs.formats.recording import Recording

_ENOUGH: Final = 100_000  # pings that are looked at


def flag_senses(
    log: Recording, topic: ProbedTopic, velocity: str, names: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Return of each flag the key that it is for, empty if that is open, and what speaks for it."""
    fields = {"velocity": velocity, "flags": ", ".join(names)}
    source = Source(
        "dvl", topic.topic, topic.channel.type_name, (topic.channel,), fields, LOG_TIME, 0.0
    )
    table = read_sample(log, source, _ENOUGH)
    found = flag_columns(names)
    senses = dict[str, tuple[str, str]]()
    for name, flag in zip(names, table.values("flags").T, strict=True):
        is_zero_bad = says_valid(flag, table.values("velocity"))
        by_name = "valid" if name in found.valid else "invalid" if name in found.invalid else ""
        by_data = {True: "valid", False: "invalid", None: ""}[is_zero_bad]
        marked = int(
            np.count_nonzero(flag == 0.0 if (by_name or by_data) == "valid" else flag != 0.0)
        )
        if marked == len(flag) or (by_name and by_data and by_name != by_data):
            senses[name] = "", ""
        elif by_data and not by_name:
            senses[name] = (
                by_data,
                f"marks the {marked} of {len(flag)} pings without a velocity, or with one that scatters",
            )
        else:
            senses[name] = by_name, f"is named so and marks {marked} of {len(flag)} pings"
    return senses
