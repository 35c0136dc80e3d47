"""Messages of ULog files (.ulg): each has its size and kind in front, and the layouts are in the file.

There is no checksum. A message of data counts where it has the size of its topic, any other where another one follows.
Behind damage the reading goes on at the next message of data. Source: PX4 User Guide, "ULog File Format" v1.16,
https://docs.px4.io/v1.16/en/dev_log/ulog_file_format.html.
"""

import re
import struct
from collections.abc import Set as AbstractSet
from typing import Any, Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Array
from insdvl_replay.core.errors import counted_clause
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.instrument_file import LATEST_S, InstrumentFile
from insdvl_replay.logs.formats.ulog_layouts import LONGEST, Layouts

Messages = dict[tuple[str, int], Array]
"""Rows, (k,), structured, by topic and instance."""
_HEADER: Final = 16  # bytes
_PIECE: Final = 1 << 22
_DATA: Final = ord("D")
_SUBSCRIPTION: Final = ord("A")
# Kinds of messages but those of data, and how long they are: None where that differs.
_SIZES: Final = {"B": 40, "F": None, "I": None, "M": None, "P": None, "Q": None, "A": None, "R": 2, "L": None,
                 "C": None, "S": 8, "O": 2}  # fmt: skip
_FLAGS: Final = struct.Struct(
    "<8x8s3Q"
)  # behind the head of the message B: flags, and where data were appended
_LATEST_US: Final = int(LATEST_S / 4) * 10**6  # since the start of the vehicle


class _Topic(NamedTuple):
    """A topic as it was subscribed to."""

    name: str
    instance: int
    dtype: np.dtype[Any] | None  # None where its layout is not known
    parts: list[Array]  # its messages


def single_counts(rows: Array) -> set[str]:
    """Return which fields of messages are one number without a sign each, as times and kinds are."""
    return {label for label in rows.dtype.names or () if rows.dtype[label].kind == "u"}


class UlogFile(InstrumentFile):
    """A file of such messages; a class for what their topics mean has `tables`."""

    records = "messages"

    def read_messages(self, wanted: AbstractSet[str]) -> Messages:
        """Return the messages of some topics that have a possible time; the others are passed over."""
        self._wanted = wanted
        self._layouts = Layouts()
        self._topics: dict[int, _Topic] = {}
        self._dropouts_ms: list[int] = []
        starts = [_HEADER, *self._appended()]
        for start, end in zip(starts, [*starts[1:], len(self.file)], strict=True):
            self._read(start, end)
        if self._dropouts_ms:
            count = len(self._dropouts_ms)
            lost_s = sum(self._dropouts_ms) / 1000
            self.add_note(note("recorder_dropouts", count, file=self.path.name, lost_s=lost_s))
        return self._messages()

    def _appended(self) -> list[int]:
        """Return where data were appended to the file, whose last message before them may be cut."""
        start = bytes(self.file.read(_HEADER, _HEADER + 3 + _FLAGS.size))
        if len(start) < 3 + _FLAGS.size or start[2] != ord("B"):
            return []
        flags, *offsets = _FLAGS.unpack_from(start, 3)
        if not flags[0] & 1:
            return []
        places: list[int] = []
        for offset in offsets:
            if offset and not max([_HEADER, *places]) < offset < len(self.file):
                self.lose(_HEADER, f"data are said to be appended at byte {offset}")
            elif offset:
                places.append(offset)
        return places

    def _read(self, start: int, end: int) -> None:
        """Read the messages of a part of the file."""
        while start < end:
            data = bytes(self.file.read(start, min(start + _PIECE + 2 * LONGEST, end)))
            is_last = start + len(data) == end
            start += self._read_piece(start, data, len(data) if is_last else _PIECE)

    def _read_piece(
        self,
        start: int,
        data: bytes,
        end: int,
    ) -> int:
        """Read the messages that begin before some place of a piece; return where the next one does."""
        places: dict[int, list[int]] = {}
        at = 0
        while at < end:
            stop = self._stop(data, at)
            if stop and data[at + 2] == _DATA:
                places.setdefault(data[at + 3] | data[at + 4] << 8, []).append(at)
                at = stop
            elif stop and self._is_sound(data, at, stop):
                self._read_other(start + at, chr(data[at + 2]), data[at + 3 : stop])
                at = stop
            else:
                begin = at
                at = self._next(data, at + 1, end)
                what = counted_clause(at - begin, "bytes are no message of a known topic")
                self.lose(start + begin, what, 1 + (at - begin) // 256)
        array = np.frombuffer(data, np.uint8)
        for number, found in places.items():
            topic = self._topics[number]
            if topic.dtype is None or topic.name not in self._wanted:
                self.pass_over(topic.name, len(found))
                continue
            bytes_at = np.array(found)[:, None] + np.arange(5, 5 + topic.dtype.itemsize)
            topic.parts.append(array[bytes_at].view(topic.dtype)[:, 0])
        return at

    def _is_sound(
        self,
        data: bytes,
        at: int,
        stop: int,
    ) -> bool:
        """Return whether a message that is none of data is one: a subscription to a layout, or what one follows."""
        if (
            data[at + 2] == _SUBSCRIPTION
            and data[at + 6 : stop].decode("latin-1") in self._layouts
        ):
            return True
        return stop == len(data) or self._stop(data, stop) > 0

    def _stop(self, data: bytes, at: int) -> int:
        """Return where the message at a place ends; 0 where there can be none."""
        if at + 3 > len(data):
            return 0
        size = data[at] | data[at + 1] << 8
        stop = at + 3 + size
        if stop > len(data):
            return 0
        if data[at + 2] != _DATA:
            expected = _SIZES.get(chr(data[at + 2]), -1)
            return stop if expected in (None, size) else 0
        topic = self._topics.get(data[at + 3] | data[at + 4] << 8) if size > 2 else None
        if topic is None or (topic.dtype is not None and topic.dtype.itemsize != size - 2):
            return 0
        return stop

    def _next(
        self,
        data: bytes,
        at: int,
        end: int,
    ) -> int:
        """Return where the next message of data begins, behind damage."""
        heads: list[bytes] = []
        for number, topic in self._topics.items():
            if topic.dtype is not None:
                heads.append(struct.pack("<HcH", topic.dtype.itemsize + 2, b"D", number))
        if not heads:
            return end
        found = re.compile(b"|".join(map(re.escape, heads))).search(data, at)
        return end if found is None else min(found.start(), end)

    def _read_other(
        self,
        offset: int,
        kind: str,
        content: bytes,
    ) -> None:
        """Read a message that is none of data: a layout, a subscription, a dropout."""
        if kind == "F":
            self._layouts.add(content)
        elif kind == "A" and len(content) > 3:
            name = content[3:].decode("ascii", "replace")
            number = content[1] | content[2] << 8
            topic = _Topic(name, content[0], self._layouts.subscribed(name), [])
            known = self._topics.setdefault(number, topic)
            if known[:3] != topic[:3]:
                self.lose(offset, f"{name} has the number of {known.name}")
        elif kind == "O":
            self._dropouts_ms.append(content[0] | content[1] << 8)

    def _messages(self) -> Messages:
        """Return the messages of all topics and instances that have a possible time."""
        found: Messages = {}
        for topic in self._topics.values():
            if not topic.parts or topic.dtype is None:
                continue
            rows = np.concatenate(topic.parts)
            if "timestamp" not in single_counts(rows):
                self.pass_over(f"{topic.name} without a time", len(rows))
                continue
            possible = rows["timestamp"] < _LATEST_US
            late = int(np.count_nonzero(~possible))
            if late:
                clause = f"messages of {topic.name} have impossible times"
                self.lose(0, counted_clause(late, clause), late)
            found[topic.name, topic.instance] = rows[possible]
        return found
