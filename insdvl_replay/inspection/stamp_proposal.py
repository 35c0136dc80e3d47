"""Which field of an unknown type is the time of validity: one that keeps step with the recorder's clock."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Final

from insdvl_replay.core.clock import Clock
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.proposed_settings import Setting
from insdvl_replay.inspection.topic_probe import ProbedTopic
from insdvl_replay.inspection.vectors import time_paths
from insdvl_replay.logs.columns.clocks import LARGEST_JITTER_S, stamp_unit
from insdvl_replay.logs.columns.table_reading import read_sample
from insdvl_replay.logs.columns.tables import Table, stamp_path
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.recording import Recording

_ENOUGH: Final = 1000
_HEADER: Final = "header.stamp"
_NAMES: Final = re.compile(r"time|stamp|clock|epoch|utc|tick|^t$|(^|_)(t_|ts$)|_([mun]s|sec)$")
_STRAY: Final = 0.05
"""Share of the sample's length by which a clock may wander; what counts from the message before does not run at all."""


def stamp_setting(log: Recording, seen: ProbedTopic, role: str) -> Setting:
    """Propose what stamps the messages of a topic."""
    key, clocks = f"{role}.stamp", list(_clocks(log, seen))
    if not clocks:
        return Setting(key, "log_time", "no field of the messages keeps step with the recorder's clock")
    (clock, unit), *others = clocks
    text = f"'{stamp_path(clock.stamp)}'{unit} keeps step with the recorder's clock: {_apart(clock)}"
    return Setting(key, clock.stamp, text, others=tuple(f'stamp = "{other.stamp}"' for other, _ in others))


def recorder_stamps(clocks: Sequence[Clock], text: str) -> list[Setting]:
    """Propose the recorder's clock for all roles."""
    own = {clock.role: clock for clock in clocks if clock.role in ("imu", "dvl", "reference")}
    return [
        Setting(f"{role}.stamp", "log_time", f"{text}; that of {clock.topic}: {_apart(clock)}")
        for role, clock in own.items()
    ]


def _clocks(log: Recording, seen: ProbedTopic) -> Iterator[tuple[Clock, str]]:
    """Give the clocks of fields that could be stamps, the likelier first, with the unit of those that are numbers."""
    times = sorted(time_paths(seen.known), key=lambda path: path != _HEADER)
    named = [path for path in seen.scalars if _NAMES.search(path.rpartition(".")[2].lower())]
    for path in (*times, *named):
        stamp = "header" if path == _HEADER else path
        source = Source("", seen.topic, seen.channel.type_name, (seen.channel,), {}, stamp, 0.0)
        with suppress(LogError):
            table = read_sample(log, source, _ENOUGH)
            clock = table.clock()
            if _keeps_step(clock, table):
                yield clock, _unit(table)


def _keeps_step(clock: Clock, table: Table) -> bool:
    recorded = table.columns["log_time"][:, 0]
    span_s = float(recorded[-1] - recorded[0]) * 1e-9
    return clock.messages < 2 or clock.spread_s < min(LARGEST_JITTER_S, _STRAY * span_s)


def _unit(table: Table) -> str:
    numbers = table.stamp_numbers
    if numbers is None:
        return ""
    return f", read as {stamp_unit(numbers, table.columns['log_time'][:, 0])[1]},"


def _apart(clock: Clock) -> str:
    return f"log time minus stamp is {clock.log_minus_stamp_s:.3f} s in the median"
