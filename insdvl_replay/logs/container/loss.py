"""What damage took from a file: how many messages, and the time in which they were, as far as the rest tells.

The summary's statistics tell how many messages there were, its chunk index when; where they are gone too, the message
indexes and the log times of the messages on both sides tell what they can. A note says so, or the error with which a
damaged log is refused.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.blocks import MESSAGE, gather, read_chunk
from insdvl_replay.logs.container.chunks import Chunk, chunk_header
from insdvl_replay.logs.container.mcap_index import Loss, McapIndex
from insdvl_replay.logs.container.records import RECORD_HEADER_SIZE, Damage, DamageError, Span, plausible_span

COPY_AGAIN: Final = "copy the log again from the recorder if it still has it"
"""What helps where messages are lost."""


def damaged_file_error(faults: Sequence[LogError], saved: Iterable[TimeNs], places: str = "damaged places") -> LogError:
    """Make the error with which a damaged log is refused: where it is damaged, and what could be saved.

    Of the faults, at least one, the first is told and the others are counted; the log times of all messages that can be
    read are given in parts, ns.
    """
    first, *others = faults
    what = f"{first.what} ({len(others)} more {places})" if others else first.what
    times = np.concatenate([np.empty(0, np.int64), *saved])
    hint = "no message in it can be read; copy it again from the recorder"
    if times.size:
        span_s = float(seconds(times.max(), int(times.min())))
        hint = f"--allow-damaged uses the {span_s:.1f} s and {times.size} messages that can be read"
    return LogError(what, hint, *first.where)


def duplicate_messages(data: memoryview, mcap_index: McapIndex) -> int:
    """Count the messages that are copies of others."""
    if not mcap_index.passed or all(chunk.kind != "unchunked" for chunk in mcap_index.chunks.values()):
        return 0
    headers = np.concatenate([np.empty(0, MESSAGE), *_headers(data, mcap_index)])
    _, first, count = np.unique(headers["log_time"], return_inverse=True, return_counts=True)
    # Few messages share their log time, and only these are compared as a whole, which takes longer.
    suspected = headers[count[first] > 1]
    return len(suspected) - len(np.unique(suspected))


def _headers(data: memoryview, mcap_index: McapIndex) -> Iterator[NDArray[Any]]:
    """Go through what stands in front of the payloads; no chunk stays open for it."""
    for chunk in mcap_index.chunks.values():
        with suppress(DamageError):
            for block in read_chunk(data, chunk).blocks.values():
                yield gather(block.buffer, block.starts, MESSAGE)


_SHOWN: Final = 3
"""Places that are told one by one."""
_SHORTEST_S: Final = 0.0005
"""What is shorter would be told as no time at all."""


def damage_note(name: str, data: memoryview, mcap_index: McapIndex) -> Note:
    """State what was found and lost in a damaged log."""
    found, missing, duplicates = losses(data, mcap_index), mcap_index.missing, duplicate_messages(data, mcap_index)
    if duplicates:
        # Copies of messages from elsewhere tell nothing of the time around them.
        found = [replace(loss, span_ns=None) for loss in found]
        missing = None if missing is None else missing + duplicates
    loss = loss_text(found, missing, is_cut=mcap_index.is_cut)
    return places_note(name, mcap_index.damages, loss)


def places_note(name: str, found: Iterable[Damage], loss: str) -> Note:
    """State in how many places a log is damaged, what was lost, and what stands in the first of them."""
    # Checksums are checked beside the reading, and what is found first is a matter of chance.
    damages = sorted(found, key=lambda damage: damage.offset)
    shown = "; ".join(f"byte {damage.offset}: {damage.found}" for damage in damages[:_SHOWN])
    more = f"; and {len(damages) - _SHOWN} more" if len(damages) > _SHOWN else ""
    places = "1 place" if len(damages) == 1 else f"{len(damages)} places"
    text = f"{name} is damaged in {places}, {loss} ({shown}{more})"
    return Note("log_damaged", text, len(damages), Severity.WARNING, COPY_AGAIN)


def loss_text(found: Sequence[Loss], missing: int | None, *, is_cut: bool) -> str:
    """State how many messages were lost and in what time, and where that is not known, why."""
    known = sum(loss.messages or 0 for loss in found)
    is_counted = missing is not None or all(loss.messages is not None for loss in found)
    count = known if missing is None else max(missing, 0)
    if is_counted and not count:
        return "no messages are lost"
    amount = str(count) if is_counted else f"at least {count}" if count else "an unknown number of"
    words = "message ({}) is lost" if is_counted and count == 1 else "messages ({}) are lost"
    is_timed = bool(found) and all(loss.span_ns is not None for loss in found)
    span_s = _covered_s([loss.span_ns for loss in found if loss.span_ns is not None])
    time = f"{span_s:.3f} s" if is_timed else f"at least {span_s:.3f} s" if span_s >= _SHORTEST_S else "an unknown time"
    return f"{amount} {words.format(time)}{_reason(is_counted, is_timed, is_cut)}"


def _reason(is_counted: bool, is_timed: bool, is_cut: bool) -> str:
    if is_counted and is_timed:
        return ""
    if is_cut:
        return "; what is left does not tell how long the recording went on"
    return "; no index that is left tells what stood there"


def _covered_s(spans: Sequence[Span]) -> float:
    """Return the time that spans cover together."""
    covered_ns = reached_ns = 0
    for first_ns, last_ns in sorted(spans):
        covered_ns += max(last_ns - max(first_ns, reached_ns), 0)
        reached_ns = max(last_ns, reached_ns)
    return covered_ns * 1e-9


def losses(data: memoryview, mcap_index: McapIndex) -> list[Loss]:
    """Find what was lost, each loss with what is known of it; they may overlap."""
    spans = _Spans(data, mcap_index)
    return [
        *mcap_index.losses.values(),
        *_of_dropped_chunks(data, mcap_index, spans),
        *_of_unknown_channels(data, mcap_index),
        *_of_passed_bytes(data, mcap_index, spans),
    ]


class _Spans:
    """The times of what can be read, to tell by them when the rest was."""

    def __init__(self, data: memoryview, mcap_index: McapIndex) -> None:
        self._data = data
        self._chunks = sorted(mcap_index.chunks.values(), key=_offset)
        self._whole = mcap_index.announced.span_ns

    def of(self, chunk: Chunk) -> Span | None:
        """Return the span of a chunk."""
        return chunk_span(self._data, chunk)

    def between(self, start: int, end: int | None) -> Span | None:
        """Return the span from the messages before some bytes to those behind them; None where an end is unknown."""
        before = self._chunks[: bisect_left(self._chunks, start, key=_offset)]
        behind = [] if end is None else self._chunks[bisect_left(self._chunks, end, key=_offset) :]
        first = next(filter(None, map(self.of, reversed(before))), None)
        last = next(filter(None, map(self.of, behind)), None)
        first_ns = first[1] if first else self._whole[0] if self._whole else None
        last_ns = last[0] if last else self._whole[1] if self._whole else None
        if first_ns is None or last_ns is None:
            return None
        return plausible_span(min(first_ns, last_ns), max(first_ns, last_ns))


def _offset(chunk: Chunk) -> int:
    return chunk.offset


def chunk_span(data: memoryview, chunk: Chunk) -> Span | None:
    """Return the log times between which the messages of a chunk are."""
    if chunk.kind == "intact":
        return _stated_span(data, chunk)
    try:
        content = read_chunk(data, chunk)
    except DamageError:
        return None
    times = content.log_times(content.blocks)
    return (int(times.min()), int(times.max())) if times.size else None


def _stated_span(data: memoryview, chunk: Chunk) -> Span | None:
    try:
        return chunk_header(data, chunk.offset, chunk.length).span_ns
    except DamageError:
        return None


def _of_dropped_chunks(data: memoryview, mcap_index: McapIndex, spans: _Spans) -> Iterator[Loss]:
    """Go through the chunks that cannot be opened, and those of the chunk index that are not found at all."""
    for chunk in mcap_index.lost:
        span = _stated_span(data, chunk) or spans.between(chunk.offset, chunk.end)
        yield Loss(chunk.counts.total() or None, span)
    met = [chunk for chunk in (*mcap_index.chunks.values(), *mcap_index.lost) if chunk.kind != "unchunked"]
    # Where bytes were put in or taken out, chunks are not where the index says, and are known by what they say.
    starts = {chunk.offset - RECORD_HEADER_SIZE for chunk in met} if mcap_index.displaced is None else set()
    identities = {_identity(data, chunk) for chunk in met}
    for start, index in mcap_index.announced.chunks.items():
        span = (index.message_start_time, index.message_end_time)
        if start not in starts and (*span, index.compressed_size) not in identities:
            yield Loss(None, plausible_span(*span))


def _identity(data: memoryview, chunk: Chunk) -> tuple[int, int, int] | None:
    """Return what no other chunk of the file has: its span and its compressed size."""
    try:
        header = chunk_header(data, chunk.offset, chunk.length)
    except DamageError:
        return None
    return header.first_ns, header.last_ns, header.compressed_size


def _of_unknown_channels(data: memoryview, mcap_index: McapIndex) -> Iterator[Loss]:
    """Go through the messages that no definition can be found for."""
    for chunk in mcap_index.chunks.values():
        unknown = [channel_id for channel_id in chunk.counts if channel_id not in mcap_index.channels]
        if unknown:
            times = read_chunk(data, chunk).log_times(unknown)
            yield Loss(times.size, plausible_span(int(times.min()), int(times.max())))


def _of_passed_bytes(data: memoryview, mcap_index: McapIndex, spans: _Spans) -> Iterator[Loss]:
    """Go through the bytes in which no record was found, and what is missing behind the last one.

    Where all messages stood in chunks that an index names, that index has told already what is missing.
    """
    if mcap_index.announced.chunks and all(chunk.kind != "unchunked" for chunk in mcap_index.chunks.values()):
        return
    for start, end in mcap_index.passed:
        yield Loss(None, spans.between(start, end))
    if mcap_index.data_end is None:
        yield Loss(None, spans.between(len(data), None))
