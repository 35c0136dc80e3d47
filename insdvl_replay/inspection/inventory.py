"""What a log holds and whether it can be replayed, as data.

Times count from the log's first message, on the recorder's clock.
"""

from dataclasses import dataclass, field
from typing import Any

from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import Note
from insdvl_replay.core.words import Reading


@dataclass(frozen=True)
class LogFacts:
    """The file itself.

    Attributes
    ----------
    parts : int
        Files of which it consists; more than one for a bag.
    profile, library : str
        As the recorder signed it.
    compression : tuple of str
        Ways in which chunks are compressed; ``none`` for those that are not. Empty without chunks.
    has_summary : bool
        Whether the file closes with a summary.
    start_utc : str or None
        Log time of the first message, ISO 8601; None without messages, or where it lies behind 2262.
    duration_s : float
        From the first to the last message.
    metadata, attachments : tuple of str
        Their names.
    """

    name: str
    parts: int
    size_bytes: int
    profile: str
    library: str
    compression: tuple[str, ...]
    chunks: int
    messages: int
    has_summary: bool
    start_utc: str | None
    duration_s: float
    metadata: tuple[str, ...]
    attachments: tuple[str, ...]


@dataclass(frozen=True)
class TopicFacts:
    """One topic, by the log times of its messages.

    Attributes
    ----------
    topic, type_name, encoding, schema_encoding : str
        As the log names them.
    role : str
        What a replay takes from it; empty for nothing.
    channels : int
        How many channels of the log carry the topic.
    start_s, end_s : float or None
        First and last message; None without messages.
    rate_hz : float or None
        Messages per second between them; None for fewer than two.
    longest_gap_s : float or None
        Longest pause between two messages.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    role: str
    channels: int
    messages: int
    start_s: float | None
    end_s: float | None
    rate_hz: float | None
    longest_gap_s: float | None


@dataclass(frozen=True)
class RoleFacts:
    """Who plays a role, and why.

    Attributes
    ----------
    topic : str or None
        None where nobody does.
    candidates : tuple of str
        Topics between which the configuration has to choose.
    fields : dict of str to str
        Path of the field by the quantity that is read from it.
    """

    role: str
    topic: str | None
    reason: str
    candidates: tuple[str, ...]
    fields: dict[str, str]


@dataclass(frozen=True)
class PingFacts:
    """How many messages of the DVL are pings of their own, and how many beams these have.

    Attributes
    ----------
    messages, repeats : int
        All that were read, and those that repeat the one before.
    pings : int
        Those that can be used.
    four_or_more, three, fewer : int
        Pings by their beams; all 0 where the DVL reports velocities only.
    rate_hz : float or None
        One over the median time between pings.
    """

    messages: int
    repeats: int
    pings: int
    four_or_more: int
    three: int
    fewer: int
    rate_hz: float | None


@dataclass(frozen=True)
class ReferenceFacts:
    """What the reference gives, and over how much of the IMU's span.

    Attributes
    ----------
    position_pct, velocity_pct, attitude_pct : float
        Part of the IMU's span from the first to the last row that has the quantity.
    """

    rows: int
    position_pct: float
    velocity_pct: float
    attitude_pct: float


@dataclass(frozen=True)
class Obstacle:
    """What would stop a replay: the error that ``run`` would end with."""

    message: str
    hint: str


@dataclass(frozen=True)
class Inventory:
    """All that is known of a log.

    Attributes
    ----------
    reading : {'sample', 'whole'}
        How much of the messages was read to know it.
    conventions : dict of str to dict of str to value
        By topic, for those that play a role or could: keys of the configuration that the type settles if it does not.
    reference : ReferenceFacts or None
        These two only where the messages were read whole.
    obstacles : tuple of Obstacle
        Empty where nothing was found that would stop a replay.
    configuration : str
        TOML to start from where something stops a replay; empty where nothing does.
    decisions : tuple of str
        Keys of this configuration about which a person must decide.
    remaining : tuple of Obstacle
        What stops a replay with this configuration too, besides decisions that have no value yet.
    """

    log: LogFacts
    reading: Reading
    topics: tuple[TopicFacts, ...]
    roles: tuple[RoleFacts, ...]
    conventions: dict[str, dict[str, Any]] = field(default_factory=dict)
    clocks: tuple[Clock, ...] = ()
    pings: PingFacts | None = None
    reference: ReferenceFacts | None = None
    obstacles: tuple[Obstacle, ...] = ()
    notes: tuple[Note, ...] = field(default=())
    configuration: str = ""
    decisions: tuple[str, ...] = ()
    remaining: tuple[Obstacle, ...] = ()
