"""What a file holds, by its records, and by the summary at its end, in which the recorder says what the whole is."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

from mcap import records
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.logs.container.blocks import Content
from insdvl_replay.logs.container.chunks import Chunk
from insdvl_replay.logs.container.records import (
    MAGIC,
    RECORD_HEADER_SIZE,
    Damage,
    DamageError,
    Span,
    find_records,
    parsed,
    plausible_span,
    what_stands,
)


@dataclass(frozen=True)
class Loss:
    """Messages that cannot be read: how many, and the log times between which they were; None where nothing tells."""

    messages: int | None
    span_ns: Span | None


_FOOTER_SIZE: Final = RECORD_HEADER_SIZE + 20
_KINDS: Final[dict[int, Any]] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
}


@dataclass
class Summary:
    """What the end of a file tells.

    Where the summary starts, if there is one, and where the records of the file end; whether a checksum vouches for it;
    and chunks by the place of their record.
    """

    start: int | None = None
    end: int = 0
    checked: bool = False
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    statistics: records.Statistics | None = None
    chunks: dict[int, records.ChunkIndex] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)

    @property
    def message_count(self) -> int | None:
        """How many messages the statistics announce; None without statistics, or where they contradict themselves."""
        stated = self.statistics
        if stated is None or (not self.checked and sum(stated.channel_message_counts.values()) != stated.message_count):
            return None
        return int(stated.message_count)

    @property
    def span_ns(self) -> Span | None:
        """First and last log time of all messages, where the statistics can be believed."""
        stated = self.statistics
        if stated is None or self.message_count is None:
            return None
        return plausible_span(stated.message_start_time, stated.message_end_time)


def read_summary(data: memoryview) -> Summary:
    """Read and check the end of a file."""
    end = len(data) - len(MAGIC)
    if end < len(MAGIC) or bytes(data[end:]) != MAGIC:
        text = "the file ends without the closing bytes; it was cut or is still being written"
        return Summary(end=len(data), damages=[Damage(len(data), text)])
    footer_start = end - _FOOTER_SIZE
    try:
        return _read(data, footer_start, _footer(data, footer_start))
    except DamageError as error:
        return Summary(end=end, damages=[error.damage])


def _footer(data: memoryview, start: int) -> records.Footer:
    header = bytes([Opcode.FOOTER]) + (_FOOTER_SIZE - RECORD_HEADER_SIZE).to_bytes(8, "little")
    if start < len(MAGIC) or bytes(data[start : start + RECORD_HEADER_SIZE]) != header:
        raise DamageError(max(start, 0), "no footer stands in front of the closing bytes")
    footer: records.Footer = parsed(records.Footer, data, start + RECORD_HEADER_SIZE, _FOOTER_SIZE - RECORD_HEADER_SIZE)
    return footer


def _read(data: memoryview, footer_start: int, footer: records.Footer) -> Summary:
    start = footer.summary_start or footer_start
    if not len(MAGIC) <= start <= footer_start:
        raise DamageError(footer_start, f"the footer says that the summary starts at byte {start}")
    # The checksum covers the footer up to itself.
    if footer.summary_crc and zlib_ng.crc32(data[start : footer_start + _FOOTER_SIZE - 4]) != footer.summary_crc:
        raise DamageError(start, "the checksum of the summary is not that of its bytes")
    summary = Summary(start, footer_start, checked=footer.summary_crc != 0)
    if not footer.summary_start:
        return summary
    while start < footer_start:
        batch, stop = find_records(data, start, footer_start)
        if not len(batch):
            raise DamageError(start, f"in the summary, {what_stands(data, start, footer_start)}")
        for row in batch.rows():
            _take(summary, data, *row)
        start = stop
    return summary


def summary_behind(data: memoryview, start: int) -> Summary | None:
    """Read the summary where the messages end, for a file in which the footer no longer tells where that is."""
    summary = Summary(start, len(data))
    batch, _ = find_records(data, start, len(data))
    for opcode, content, length in batch.rows():
        try:
            _take(summary, data, opcode, content, length)
            if opcode == Opcode.FOOTER:
                crc = parsed(records.Footer, data, content, length).summary_crc
                summary.checked = crc == zlib_ng.crc32(data[start : content + length - 4])
                return summary if summary.checked or not crc else None
        except DamageError:
            return None
    return summary if len(batch) else None


def _take(summary: Summary, data: memoryview, opcode: int, start: int, length: int) -> None:
    """Add a record, if it is of a kind that tells something."""
    record = parsed(_KINDS[opcode], data, start, length) if opcode in _KINDS else None
    if isinstance(record, records.Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, records.Channel):
        summary.channels[record.id] = record
    elif isinstance(record, records.ChunkIndex):
        summary.chunks[record.chunk_start_offset] = record
    elif record is not None:
        summary.statistics = record


@dataclass
class McapIndex:
    """What a file holds.

    Attributes
    ----------
    chunks : dict of int to Chunk
        By their places; also the messages that stand in none.
    attachments, metadata : list of (int, int)
        Start and size of these records.
    data_end : (int, int) or None
        Where the data section ends, and the checksum of the bytes before.
    private : int
        Records of kinds that the format leaves to others.
    damages : dict of Damage to None
        Each once, in the order in which they are found.
    lost : list of Chunk
        Those that cannot be opened.
    passed : list of (int, int)
        Start and end of bytes in which no record was found.
    losses : dict of int to Loss
        Of messages inside chunks that can be opened, by the place of the chunk.
    displaced : Summary or None
        What stands behind the messages where the end of the file tells no summary.
    """

    summary: Summary
    header: records.Header | None = None
    chunks: dict[int, Chunk] = field(default_factory=dict)
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    metadata: list[tuple[int, int]] = field(default_factory=list)
    data_end: tuple[int, int] | None = None
    private: int = 0
    damages: dict[Damage, None] = field(default_factory=dict)
    lost: list[Chunk] = field(default_factory=list)
    passed: list[tuple[int, int]] = field(default_factory=list)
    losses: dict[int, Loss] = field(default_factory=dict)
    displaced: Summary | None = None

    @property
    def counts(self) -> Counter[int]:
        """Messages by channel."""
        total = Counter[int]()
        for chunk in self.chunks.values():
            total.update(chunk.counts)
        return total

    @property
    def announced(self) -> Summary:
        """What the recorder said of the whole, wherever it stands."""
        return self.displaced or self.summary

    @property
    def is_cut(self) -> bool:
        """Whether the end is gone with all that is said there of the whole."""
        return self.data_end is None and self.announced.message_count is None

    @property
    def missing(self) -> int | None:
        """How many of the announced messages are not found, where a number is announced."""
        announced = self.announced.message_count
        found = sum(count for channel_id, count in self.counts.items() if channel_id in self.channels)
        return None if announced is None else announced - found

    def add_damage(self, damage: Damage) -> None:
        """Note a damaged place, once."""
        self.damages.setdefault(damage)

    def add_chunk(self, chunk: Chunk) -> None:
        """File a chunk."""
        self.chunks[chunk.offset] = chunk

    def trust(self, chunk: Chunk, content: Content) -> None:
        """Believe the content of a chunk more than its index."""
        named = chunk.counts.total() if chunk.indexes else None
        chunk.counts = content.counts()
        for damage in content.damages:
            self.add_damage(damage)
        if content.lost_span_ns:
            missing = None if named is None else max(named - chunk.counts.total(), 0)
            self.losses.setdefault(chunk.offset, Loss(missing, content.lost_span_ns))
        if content.damages:
            chunk.indexes.clear()

    def drop_chunk(self, chunk: Chunk, damage: Damage) -> None:
        """Note a chunk that cannot be read, and do without it."""
        self.add_damage(damage)
        del self.chunks[chunk.offset]
        self.lost.append(chunk)

    def agreed(self, found: dict[int, Any], repeated: dict[int, Any]) -> dict[int, Any]:
        """Choose between definitions and their repetition in the summary."""
        for id_ in found.keys() & repeated.keys():
            if found[id_] != repeated[id_]:
                kind = type(found[id_]).__name__.lower()
                text = f"{kind} {id_} is not the same among the messages and in the summary"
                self.add_damage(Damage(self.summary.end, text))
        return found | repeated if self.announced.checked else repeated | found

    def is_verified(self, chunk: Chunk) -> bool:
        """Return whether it is known without opening a chunk what is in it."""
        named = chunk.offset - RECORD_HEADER_SIZE in self.summary.chunks
        return named and bool(chunk.indexes) and all(map(self._is_defined, chunk.counts))

    def _is_defined(self, channel_id: int) -> bool:
        channel = self.channels.get(channel_id)
        return channel is not None and (channel.schema_id == 0 or channel.schema_id in self.schemas)

    def check_channels(self) -> None:
        """Find messages of channels that no record defines."""
        for channel_id, count in self.counts.items():
            if channel_id not in self.channels:
                text = f"{count} messages are of channel {channel_id}, which is nowhere defined"
                self.add_damage(Damage(self.summary.end, text))
