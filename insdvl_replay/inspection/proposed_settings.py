"""Settings as they are proposed: each with what was seen, what else could be meant, and whether a person must decide.

A key whose value only a person can know stands as a comment; every other has the likeliest value, so that a proposal is
a file that can be used as it is.
"""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Final

import msgspec

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.states import SENSORS
from insdvl_replay.inspection.topic_probe import Candidate, ProbedTopic, time_paths
from insdvl_replay.logs.columns.table_reading import read_sample
from insdvl_replay.logs.columns.tables import LARGEST_JITTER_S, Table, stamp_path, stamp_unit
from insdvl_replay.logs.columns.topic_requirements import PROPOSED, Source
from insdvl_replay.logs.container.recording import Recording

_WIDTH: Final = 79
_DECIDE: Final = "decide: "


@dataclass(frozen=True)
class Setting:
    """One proposed setting.

    Attributes
    ----------
    key : str
        Section and name, such as ``imu.topic``.
    value : str, float, tuple of float or None
        None where only a person can know it.
    seen : str
        What speaks for the value.
    open : str
        What there is to decide, with the other values that could be meant; empty where what was seen settles it.
    others : tuple of str
        TOML lines that could stand in its place, each with what was seen of it behind two blanks and a hash.
    listed : tuple of str
        What there is to choose from, line by line.
    """

    key: str
    value: Any
    seen: str = ""
    open: str = ""
    others: tuple[str, ...] = ()
    listed: tuple[str, ...] = ()

    @property
    def section(self) -> str:
        """Name of the table in which it stands."""
        return self.key.partition(".")[0]

    @property
    def name(self) -> str:
        """Its name in this table."""
        return self.key.partition(".")[2]

    def of(self, config: Config) -> Any:
        """Return the value that a configuration has for this key."""
        return getattr(getattr(config, self.section), self.name)


def field_setting(key: str, candidates: Sequence[Candidate], doubt: str = "") -> Setting:
    """Propose the first of some fields, with the others as what could stand in its place."""
    first, *others = candidates
    name = key.partition(".")[2]
    lines = tuple(f'{name} = "{other.path}"  # {other}' for other in others)
    return Setting(key, first.path, str(first), doubt, lines)


def with_settings(config: Config, settings: Iterable[Setting]) -> Config:
    """Set what has a value."""
    for setting in settings:
        if setting.value is not None:
            section = msgspec.structs.replace(getattr(config, setting.section), **{setting.name: setting.value})
            config = msgspec.structs.replace(config, **{setting.section: section})
    return config


def not_yet_set(settings: Iterable[Setting], config: Config) -> list[Setting]:
    """Leave out the keys that the configuration has set already."""
    default = Config()
    return [setting for setting in settings if setting.value is None or setting.of(config) == setting.of(default)]


def undecided_keys(settings: Iterable[Setting]) -> tuple[str, ...]:
    """Name the keys about which a person must decide."""
    return tuple(setting.key for setting in _ordered(settings) if setting.open)


def settings_toml(settings: Iterable[Setting]) -> str:
    """Write settings as TOML with comments."""
    sections = groupby(_ordered(settings), lambda setting: setting.section)
    return "\n".join(
        "".join(f"{line}\n" for line in (f"[{section}]", *(line for setting in group for line in _lines(setting))))
        for section, group in sections
    )


def _ordered(settings: Iterable[Setting]) -> list[Setting]:
    """Put the latest setting of each key section by section."""
    latest = {setting.key: setting for setting in settings}
    return sorted(latest.values(), key=lambda setting: Config.__struct_fields__.index(setting.section))


def _lines(setting: Setting) -> Iterator[str]:
    if setting.seen:
        yield from comment_lines(setting.seen)
    if setting.open:
        yield from comment_lines(f"{_DECIDE}{setting.open}")
    yield from (f"#   {visible(line)}" for line in setting.listed)
    if setting.value is None:
        yield f"# {setting.name} ="
    else:
        yield f"{setting.name} = {toml_value(setting.value)}"
    for other in setting.others:
        value, _, seen = other.partition("  # ")
        yield from comment_lines(seen)
        yield f"# or {visible(value)}"


def comment_lines(text: str) -> Iterator[str]:
    """Fold a comment at words."""
    folder = textwrap.TextWrapper(_WIDTH, break_long_words=False, break_on_hyphens=False)
    folder.initial_indent, folder.subsequent_indent = "# ", "#   "
    yield from folder.wrap(visible(text))


_ENOUGH: Final = 1000
_HEADER: Final = "header.stamp"
_NAMES: Final = re.compile(r"time|stamp|clock|epoch|utc|tick|^t$|(^|_)(t_|ts$)|_([mun]s|sec)$")
_MOST_SPREAD: Final = 0.05
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
    own = {clock.role: clock for clock in clocks if clock.role in (*PROPOSED, *SENSORS)}
    return [
        Setting(f"{role}.stamp", "log_time", f"{text}; that of {clock.topic}: {_apart(clock)}")
        for role, clock in own.items()
    ]


def _clocks(log: Recording, seen: ProbedTopic) -> Iterator[tuple[Clock, str]]:
    """Return the clocks of fields that could be stamps, the likelier first, with the unit of those that are numbers."""
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
    return clock.messages < 2 or clock.spread_s < min(LARGEST_JITTER_S, _MOST_SPREAD * span_s)


def _unit(table: Table) -> str:
    numbers = table.stamp_numbers
    if numbers is None:
        return ""
    return f", read as {stamp_unit(numbers, table.columns['log_time'][:, 0])[1]},"


def _apart(clock: Clock) -> str:
    return f"log time minus stamp is {clock.log_minus_stamp_s:.3f} s in the median"
