"""The summary at the end of an MCAP file: what the recorder says of the whole."""

from dataclasses import dataclass, field
from typing import Any, Final

from mcap import records
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.logs.container.damage import Damage, DamageError, Span, plausible_span
from insdvl_replay.logs.container.record_form import RECORD_HEADER_SIZE
from insdvl_replay.logs.container.records import MAGIC, find_records, parsed, what_stands

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

    Attributes
    ----------
    start : int or None
        Where the summary starts, if there is one.
    end : int
        Where the records of the file end.
    checked : bool
        Whether a checksum vouches for it.
    schemas, channels : dict of int
        By id.
    chunks : dict of int to ChunkIndex
        By the place of the chunk's record.
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
    except DamageError as damage:
        return Summary(end=end, damages=[Damage(damage.offset, damage.found)])


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
