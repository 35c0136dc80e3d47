"""What damage took from a file: how many messages, and the time in which they were, as far as the rest tells.

The summary's statistics tell how many messages there were, its chunk index when; where they are gone too, the message
indexes and the log times of the messages on both sides tell what they can.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.errors import Note
from insdvl_replay.logs.container.blocks import MESSAGE, gather
from insdvl_replay.logs.container.chunk_messages import read_chunk
from insdvl_replay.logs.container.chunks import Chunk, chunk_header
from insdvl_replay.logs.container.damage import COPY_AGAIN, DamageError, Loss, Span, plausible_span
from insdvl_replay.logs.container.records import RECORD_HEADER_SIZE
from insdvl_replay.logs.container.scanner import Anatomy


def repeated_messages(data: memoryview, anatomy: Anatomy) -> int:
    """Count the messages that are copies of others.

    Parameters
    ----------
    data : memoryview
        The file.
    anatomy : Anatomy

    Returns
    -------
    int
        0 where every byte is part of a record, or all messages stand in chunks: these are copied as a whole or not
        readable.
    """
    if not anatomy.passed or all(chunk.kind != "loose" for chunk in anatomy.chunks.values()):
        return 0
    headers = np.concatenate([np.empty(0, MESSAGE), *_headers(data, anatomy)])
    _, first, count = np.unique(headers["log_time"], return_inverse=True, return_counts=True)
    # Few messages share their log time, and only these are compared as a whole, which takes longer.
    suspected = headers[count[first] > 1]
    return len(suspected) - len(np.unique(suspected))


def _headers(data: memoryview, anatomy: Anatomy) -> Iterator[NDArray[Any]]:
    """Go through what stands in front of the payloads; no chunk stays open for it."""
    for chunk in anatomy.chunks.values():
        with suppress(DamageError):
            for block in read_chunk(data, chunk).blocks.values():
                yield gather(block.buffer, block.starts, MESSAGE)


_SHOWN: Final = 3
"""Places that are told one by one."""
_SHORTEST_S: Final = 0.0005
"""What is shorter would be told as no time at all."""


def damage_note(name: str, data: memoryview, anatomy: Anatomy) -> Note:
    """Say what was found and lost in a damaged log.

    Parameters
    ----------
    name : str
        Of the log.
    data : memoryview
        The file.
    anatomy : Anatomy
        With at least one damage.

    Returns
    -------
    Note
        A warning, ``log_damaged``.
    """
    # Checksums are checked beside the reading, and what is found first is a matter of chance.
    damages = sorted(anatomy.damages, key=lambda damage: damage.offset)
    shown = "; ".join(f"byte {damage.offset}: {damage.found}" for damage in damages[:_SHOWN])
    more = f"; and {len(damages) - _SHOWN} more" if len(damages) > _SHOWN else ""
    places = "1 place" if len(damages) == 1 else f"{len(damages)} places"
    found, missing, repeats = losses(data, anatomy), anatomy.missing, repeated_messages(data, anatomy)
    if repeats:
        # Copies of messages from elsewhere tell nothing of the time around them.
        found = [replace(loss, span_ns=None) for loss in found]
        missing = None if missing is None else missing + repeats
    loss = told_loss(found, missing, is_cut=anatomy.is_cut)
    text = f"{name} is damaged in {places}, {loss} ({shown}{more})"
    return Note("log_damaged", text, len(damages), "warning", COPY_AGAIN)


def told_loss(found: Sequence[Loss], missing: int | None, *, is_cut: bool) -> str:
    """Say how many messages were lost and in what time, and where that is not known, why.

    Parameters
    ----------
    found : sequence of Loss
    missing : int or None
        How many of the messages that the log announces are not found; None where it announces none.
    is_cut : bool
        Whether the end of the log is gone with all that is said there of the whole.

    Returns
    -------
    str
    """
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
    """Give the time that spans cover together."""
    covered_ns = reached_ns = 0
    for first_ns, last_ns in sorted(spans):
        covered_ns += max(last_ns - max(first_ns, reached_ns), 0)
        reached_ns = max(last_ns, reached_ns)
    return covered_ns * 1e-9


def losses(data: memoryview, anatomy: Anatomy) -> list[Loss]:
    """Find what was lost, each loss with what is known of it; they may overlap.

    Parameters
    ----------
    data : memoryview
        The file.
    anatomy : Anatomy

    Returns
    -------
    list of Loss
    """
    spans = _Spans(data, anatomy)
    return [
        *anatomy.losses.values(),
        *_of_lost_chunks(data, anatomy, spans),
        *_of_unknown_channels(data, anatomy),
        *_of_passed_bytes(data, anatomy, spans),
    ]


class _Spans:
    """The times of what can be read, to tell by them when the rest was."""

    def __init__(self, data: memoryview, anatomy: Anatomy) -> None:
        self._data = data
        self._chunks = sorted(anatomy.chunks.values(), key=_offset)
        self._whole = anatomy.announced.span_ns

    def of(self, chunk: Chunk) -> Span | None:
        """Give the span of a chunk."""
        return chunk_span(self._data, chunk)

    def between(self, start: int, end: int | None) -> Span | None:
        """Give the span from the messages before some bytes to those behind them; None where an end is unknown."""
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
    """Give the log times between which the messages of a chunk are.

    Parameters
    ----------
    data : memoryview
        The file.
    chunk : Chunk

    Returns
    -------
    (int, int) or None
        As a whole chunk says itself, and as the messages say where they stand in none or the chunk is cut.
    """
    if chunk.kind == "whole":
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


def _of_lost_chunks(data: memoryview, anatomy: Anatomy, spans: _Spans) -> Iterator[Loss]:
    """Go through the chunks that cannot be opened, and those of the chunk index that are not found at all."""
    for chunk in anatomy.lost:
        span = _stated_span(data, chunk) or spans.between(chunk.offset, chunk.offset + chunk.length)
        yield Loss(chunk.counts.total() or None, span)
    met = [chunk for chunk in (*anatomy.chunks.values(), *anatomy.lost) if chunk.kind != "loose"]
    # Where bytes were put in or taken out, chunks are not where the index says, and are known by what they say.
    starts = {chunk.offset - RECORD_HEADER_SIZE for chunk in met} if anatomy.displaced is None else set()
    identities = {_identity(data, chunk) for chunk in met}
    for start, index in anatomy.announced.chunks.items():
        span = (index.message_start_time, index.message_end_time)
        if start not in starts and (*span, index.compressed_size) not in identities:
            yield Loss(None, plausible_span(*span))


def _identity(data: memoryview, chunk: Chunk) -> tuple[int, int, int] | None:
    """Give what no other chunk of the file has: its span and its packed size."""
    try:
        header = chunk_header(data, chunk.offset, chunk.length)
    except DamageError:
        return None
    return header.first_ns, header.last_ns, header.packed_size


def _of_unknown_channels(data: memoryview, anatomy: Anatomy) -> Iterator[Loss]:
    """Go through the messages that no definition can be found for."""
    for chunk in anatomy.chunks.values():
        unknown = [channel_id for channel_id in chunk.counts if channel_id not in anatomy.channels]
        if unknown:
            times = read_chunk(data, chunk).log_times(unknown)
            yield Loss(times.size, plausible_span(int(times.min()), int(times.max())))


def _of_passed_bytes(data: memoryview, anatomy: Anatomy, spans: _Spans) -> Iterator[Loss]:
    """Go through the bytes in which no record was found, and what is missing behind the last one.

    Where all messages stood in chunks that an index names, that index has told already what is missing.
    """
    if anatomy.announced.chunks and all(chunk.kind != "loose" for chunk in anatomy.chunks.values()):
        return
    for start, end in anatomy.passed:
        yield Loss(None, spans.between(start, end))
    if anatomy.data_end is None:
        yield Loss(None, spans.between(len(data), None))
