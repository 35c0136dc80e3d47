"""The messages of a chunk, found without touching each of them.

The index records behind a chunk tell which channels have messages in it, so that others stay closed. Inside an open
chunk the records themselves are followed, and the index must agree with them.
Source: the MCAP specification, https://mcap.dev/spec.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.columns import TimeNs
from insdvl_replay.logs.damage import Damage, DamageError, Span, plausible_span
from insdvl_replay.logs.message_index import index_entries
from insdvl_replay.logs.packed import Chunk, chunk_header, open_chunk
from insdvl_replay.logs.records import (
    MESSAGE_FIELDS_SIZE,
    Records,
    find_records,
    go_on,
    is_broken,
    what_stands,
)

_MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)


@dataclass(frozen=True)
class Content:
    """The records of an open chunk.

    Attributes
    ----------
    buffer : memoryview
        Bytes of the open chunk.
    messages : ndarray, shape (k,)
        Where in the buffer the message records start.
    headers : ndarray, shape (k,)
        What stands in front of their payloads.
    others : list of (int, int, int)
        Kind, start and size of the content of every other record.
    damages : list of Damage
        What is wrong although the chunk can be read.
    lost_span_ns : (int, int) or None
        Log times between which messages are lost, where bytes of the chunk are no record.
    """

    buffer: memoryview
    messages: NDArray[np.int64]
    headers: NDArray[Any]
    others: list[tuple[int, int, int]]
    damages: list[Damage]
    lost_span_ns: Span | None = None

    def counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        ids, counts = np.unique(self.headers["channel_id"], return_counts=True)
        return Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))


@dataclass(frozen=True)
class Block:
    """The messages of one channel in one chunk, in the order of the file.

    Attributes
    ----------
    channel_id : int
        Their channel.
    buffer : memoryview
        Bytes of the open chunk.
    offsets, sizes : ndarray, shape (k,)
        Where in the buffer each message's payload starts, and how many bytes it has.
    log_time, publish_time : ndarray, shape (k,)
        ns
    sequence : ndarray, shape (k,)
        As the recorder counted.
    """

    channel_id: int
    buffer: memoryview
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]
    log_time: TimeNs
    publish_time: TimeNs
    sequence: NDArray[np.int64]


def gather(buffer: memoryview | NDArray[np.uint8], offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy a structure from many places of a buffer.

    Parameters
    ----------
    buffer : memoryview or ndarray of uint8
    offsets : ndarray, shape (k,)
        Where each structure starts; each must end within the buffer.
    dtype : numpy.dtype

    Returns
    -------
    ndarray, shape (k,), of `dtype`
    """
    if not offsets.size:
        return np.empty(0, dtype)
    places = len(buffer) - dtype.itemsize + 1
    windows = np.ndarray((places,), dtype=(np.void, dtype.itemsize), buffer=buffer, strides=(1,))
    return windows[offsets].view(dtype)


def read_chunk(data: memoryview, chunk: Chunk) -> Content:
    """Open a chunk and find its records.

    Parameters
    ----------
    data : memoryview
        The file.
    chunk : Chunk

    Returns
    -------
    Content
        Where bytes are no record it goes on at the next one; an index that disagrees is not believed. Both are damages.

    Raises
    ------
    DamageError
        Nothing in the chunk can be believed.
    """
    buffer = open_chunk(data, chunk)
    batches, passed = _batches(buffer)
    messages = np.concatenate([batch.starts[batch.opcodes == Opcode.MESSAGE] for batch in batches])
    others = [row for batch in batches for row in batch.where(batch.opcodes != Opcode.MESSAGE).rows()]
    headers = gather(buffer, messages, _MESSAGE)
    damages = [Damage(chunk.offset, f"in the chunk, {stop} bytes on, {reason}") for stop, _, reason in passed]
    holes = [(start, stop) for start, stop, _ in passed] + [(len(buffer),) * 2] * (chunk.kind == "cut")
    span_ns = _lost_span(data, chunk, messages, headers["log_time"], holes) if holes else None
    content = Content(buffer, messages, headers, others, damages, span_ns)
    if chunk.indexes and chunk.kind == "whole":
        damages += _index_damages(data, chunk, content)
    return content


def _batches(buffer: memoryview) -> tuple[list[Records], list[tuple[int, int, str]]]:
    """Find the records of a chunk, and where bytes between them are none: from where to where, and why."""
    batches: list[Records] = []
    passed: list[tuple[int, int, str]] = []
    place, end = 0, len(buffer)
    while place < end or not batches:
        batch, stop = find_records(buffer, place, end)
        if is_broken(batch, stop, end):
            broken, reason = stop, what_stands(buffer, stop, end)
            batch, stop = go_on(buffer, batch, stop, end)
            passed.append((broken, stop, reason))
        batches.append(batch)
        place = stop
    return batches, passed


def _lost_span(
    data: memoryview,
    chunk: Chunk,
    messages: NDArray[np.int64],
    log_time: TimeNs,
    holes: list[tuple[int, int]],
) -> Span | None:
    """Give the log times between which messages are lost: those of the messages on both sides, else of the chunk."""
    before = np.searchsorted(messages, holes[0][0])
    behind = np.searchsorted(messages, holes[-1][1])
    whole = chunk_header(data, chunk.offset, chunk.length).span_ns if chunk.kind != "loose" else None
    first_ns = int(log_time[before - 1]) if before else whole and whole[0]
    last_ns = int(log_time[behind]) if behind < len(messages) else whole and whole[1]
    if first_ns is None or last_ns is None:
        return None
    return plausible_span(min(first_ns, last_ns), max(first_ns, last_ns))


def _index_damages(data: memoryview, chunk: Chunk, content: Content) -> list[Damage]:
    """Compare the index of a chunk with the messages in it."""
    headers = content.headers
    unnamed = np.ones(headers.size, np.bool_)
    for offset, length in chunk.indexes:
        try:
            channel_id, entries = index_entries(data, offset, length)
        except DamageError as damage:
            return [Damage(damage.offset, damage.found)]
        mine = headers["channel_id"] == channel_id
        if not _names_all(entries, content.messages[mine], headers["log_time"][mine]):
            text = f"an index does not name the {np.count_nonzero(mine)} messages of channel {channel_id} in its chunk"
            return [Damage(offset, text)]
        unnamed &= ~mine
    if unnamed.any():
        channel_id = int(headers["channel_id"][unnamed][0])
        text = f"no index of a chunk names the {np.count_nonzero(unnamed)} messages of channel {channel_id} in it"
        return [Damage(chunk.offset, text)]
    return []


def _names_all(entries: NDArray[Any], places: NDArray[np.int64], log_time: TimeNs) -> bool:
    """Tell whether entries name all messages; some recorders name one more that they did not write any more."""
    if np.array_equal(entries["start"], places) and np.array_equal(entries["log_time"], log_time):
        return True
    if entries.size > places.size + 1 or not places.size:
        return not entries.size
    nearest = np.minimum(np.searchsorted(places, entries["start"]), places.size - 1)
    right = (places[nearest] == entries["start"]) & (log_time[nearest] == entries["log_time"])
    named = np.zeros(places.size, np.bool_)
    named[nearest[right]] = True
    return bool(named.all())


def blocks_of(content: Content, channel_ids: Collection[int]) -> Iterator[Block]:
    """Part the messages of a chunk by their channels.

    Parameters
    ----------
    content : Content
    channel_ids : collection of int
        The wanted channels.

    Yields
    ------
    Block
        One for each wanted channel that has messages in the chunk.
    """
    found = np.ascontiguousarray(content.headers["channel_id"])
    for channel_id in sorted(channel_ids):
        rows = np.flatnonzero(found == channel_id)
        if rows.size:
            headers = content.headers.take(rows)  # tenfold as fast as to index structures
            yield Block(
                channel_id=channel_id,
                buffer=content.buffer,
                offsets=content.messages[rows] + _MESSAGE.itemsize,
                sizes=headers["length"] - MESSAGE_FIELDS_SIZE,
                log_time=np.ascontiguousarray(headers["log_time"]),
                publish_time=np.ascontiguousarray(headers["publish_time"]),
                sequence=headers["sequence"].astype(np.int64),
            )
