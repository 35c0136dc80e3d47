"""A .db3 file, in which rosbag2 stores the messages of ROS 2 with SQLite, read without ever writing to it.

Topics and messages are rows of two tables. Definitions of the types are there since Iron; in older files there are
none, and those that come with the tool are taken. SQLite has no checksums: what it can find wrong in its pages is found
as the file is opened, and then nothing of it is used.
Source: rosbag2_storage_sqlite3 of https://github.com/ros2/rosbag2, `sqlite_storage.cpp`, and `storage_sqlite3.py` of
https://gitlab.com/ternaris/rosbags.
"""

import os
import sqlite3
import weakref
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.blocks import Block, TimedBlock
from insdvl_replay.logs.container.log_file import LogFile
from insdvl_replay.logs.container.loss import COPY_AGAIN
from insdvl_replay.logs.container.mapped_file import MappedFile, UnusableFileError
from insdvl_replay.logs.container.records import LogChannel

_HEADER_SIZE: Final = 100
_MOST_TOPICS: Final = 1 << 16
_ROWS: Final = 1 << 16
"""Rows of numbers that are fetched at a time."""
_BLOCK: Final = 4 << 20
"""Bytes of payloads from which messages become a block."""
_STEPS: Final = 10_000
_FEWEST_STEPS: Final = 10_000_000
_STEPS_OF_A_BYTE: Final = 20
"""SQLite's own steps that reading may take: a file can ask for any number of them."""
_FEW: Final = 16
"""Where fewer than one row in so many is wanted, each is looked for by its number."""
_ASKED_AT_ONCE: Final = 1000
_COLUMNS: Final = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("id", "topic_id", "timestamp", "data"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
_JOURNALS: Final = {
    "-wal": ("holds messages that are not yet in it", "PRAGMA wal_checkpoint(TRUNCATE)"),
    "-journal": ("is of a change to it that broke off", "PRAGMA quick_check"),
}
"""What SQLite leaves beside a file whose writer was killed, and what makes it tidy up."""


class SqliteFile(LogFile):
    """A .db3 file, open for reading. It is whole, as far as SQLite can tell, or refused.

    Raises
    ------
    UnusableFileError
        It is damaged.
    LogError
        It is no bag, or what was written last stands in another file beside it.
    """

    profile = "ros2"
    has_summary = True
    compression = ("none",)

    def __init__(self, file: MappedFile) -> None:
        super().__init__(file)
        self._steps = 0
        self._require_whole_size()
        self._require_no_journal()
        with file.watched(), self._told():
            self._base = self._opened()
            self._require_sound()
            self.library = self._library()
            listed = self._topics()
            self._numbers = {topic_id: number for number, topic_id in enumerate(listed)}
            self._ids, self._topic_ids, self._times = self._messages()
            self._channel_ids = self._channels_of_rows()
            self.channels = tuple(self._channels(listed))

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was passed over: messages that were there once."""
        found, announced = self._ids.size, int(self._ids.max(initial=0))
        if announced == found:
            return ()
        text = f"the messages of {self.path.name} are numbered up to {announced}, and {found} are found"
        return (Note("log_summary", text, abs(announced - found), Severity.WARNING, COPY_AGAIN),)

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, shape (k,), ns."""
        return {channel.id: self._times[self._channel_ids == channel.id] for channel in self.channels}

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, some megabytes at a time."""
        wanted = np.isin(self._channel_ids, list(channel_ids))
        found: dict[int, list[tuple[int, bytes]]] = {}
        size = 0
        with self._told():
            for topic_id, time_ns, data in self._rows_of(wanted):
                found.setdefault(self._numbers[topic_id], []).append((time_ns, data))
                size += len(data)
                if size >= _BLOCK:
                    yield from _blocks(found)
                    found, size = {}, 0
            yield from _blocks(found)

    def _rows_of(self, wanted: NDArray[np.bool_]) -> Iterator[tuple[int, int, bytes]]:
        """Go through rows of the messages: the whole table, or each for itself where it would be passed for few."""
        query = "SELECT topic_id, timestamp, data FROM messages WHERE"
        if np.count_nonzero(wanted) * _FEW > wanted.size:
            ids = np.unique(self._topic_ids[wanted]).tolist()
            yield from self._asked(f"{query} topic_id IN ({','.join(map(str, ids))}) ORDER BY id")
            return
        ids = self._ids[wanted].tolist()
        for start in range(0, len(ids), _ASKED_AT_ONCE):
            names = ",".join(map(str, ids[start : start + _ASKED_AT_ONCE]))
            yield from self._asked(f"{query} id IN ({names}) ORDER BY id")

    def _require_whole_size(self) -> None:
        """Refuse a file that is not as long as its header says."""
        header = bytes(self._data[:_HEADER_SIZE])
        page, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
        size = (1 << 16 if page == 1 else page) * pages
        if len(header) < _HEADER_SIZE or size != len(self._data):
            raise self._damaged(f"it has {len(self._data)} bytes where its header says {size}")

    def _require_no_journal(self) -> None:
        """Refuse a file of which the last messages, or what they were written over, stand beside it."""
        for ending, (what, statement) in _JOURNALS.items():
            beside = Path(f"{os.path.realpath(self.path)}{ending}")
            if beside.is_file() and any(_start(beside)):
                hint = f"keep a copy of both, then `sqlite3 {self.path} '{statement}'` brings them together"
                raise LogError(f"is not complete: {beside.name} {what}", hint, self.path)

    def _damaged(self, found: str) -> UnusableFileError:
        saved = self.path.with_name(f"saved_{self.path.name}")
        hint = f"copy it again, or save what can be with `sqlite3 {self.path} .recover | sqlite3 {saved}`"
        return UnusableFileError(f"is damaged: {found}", hint, self.path)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell what SQLite finds wrong."""
        try:
            yield
        except sqlite3.Error as error:
            self._file.require_unchanged()
            raise self._damaged(f"SQLite says '{error}'") from error

    def _opened(self) -> sqlite3.Connection:
        """Open it so that nothing in it can do more than give its rows."""
        name = quote(os.fsencode(os.path.realpath(self.path)))
        base = sqlite3.connect(f"file:{name}?mode=ro&immutable=1", uri=True, check_same_thread=False)
        weakref.finalize(self, base.close)
        base.text_factory = lambda text: text.decode("utf-8", "replace")
        # No row is larger than the file, whatever its table computes.
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(len(self._data), 1 << 20))
        base.set_progress_handler(self._goes_on_too_long, _STEPS)
        base.execute("PRAGMA trusted_schema = OFF")
        base.execute("PRAGMA cell_size_check = ON")
        return base

    def _goes_on_too_long(self) -> bool:
        """Count the steps of a question, and end it if there are more than any bag needs."""
        self._steps += _STEPS
        return self._steps > max(_FEWEST_STEPS, _STEPS_OF_A_BYTE * len(self._data))

    def _asked(self, query: str, *values: object) -> sqlite3.Cursor:
        self._steps = 0
        return self._base.execute(query, values)

    def _require_sound(self) -> None:
        """Refuse a file of which the pages contradict each other, or in which the tables are no mere tables."""
        found = [str(text) for (text,) in self._asked("PRAGMA integrity_check(1)")]
        if found != ["ok"]:
            raise self._damaged(f"SQLite says '{' '.join(' '.join(found).split())}'")
        for table in ("topics", "messages"):
            if not self._has(table):
                raise LogError(
                    f"is an SQLite file without the table '{table}' of a bag", "name a bag of ROS 2", self.path
                )

    def _has(self, table: str) -> bool:
        """Return whether a table is there with the columns that are read, none of which is computed."""
        query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ? AND sql LIKE 'CREATE TABLE%'"
        if self._asked(query, table).fetchone() != (1,):
            return False
        # Of each column: number, name, type, whether null is refused, default, place in the key, and what it hides.
        plain = {name for _, name, *_, hidden in self._asked(f"PRAGMA table_xinfo({table})") if not hidden}
        return plain.issuperset(_COLUMNS[table])

    def _library(self) -> str:
        """Name what wrote it; files before Iron do not tell."""
        query = (
            "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = 'schema' AND sql LIKE '%ros_distro%'"
        )
        if self._asked(query).fetchone() == (1,):
            for (distro,) in self._asked("SELECT ros_distro FROM schema LIMIT 1"):
                return f"rosbag2 of {distro}"
        return "rosbag2"

    def _topics(self) -> dict[Any, tuple[str, str, str]]:
        """Read name, type and encoding of each topic."""
        query = f"SELECT id, name, type, serialization_format FROM topics LIMIT {_MOST_TOPICS + 1}"
        found = {id_: (str(name), str(kind), str(encoding)) for id_, name, kind, encoding in self._asked(query)}
        if len(found) > _MOST_TOPICS:
            raise self._damaged(f"it lists more than {_MOST_TOPICS} topics")
        return found

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Read encoding and text of the definitions by type; those that the recorder did not find are none."""
        if not self._has("message_definitions"):
            return {}
        rows = self._asked("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        return {str(kind): (str(encoding), str(text)) for kind, encoding, text in rows if str(text or "").strip()}

    def _channels(self, listed: dict[Any, tuple[str, str, str]]) -> Iterator[LogChannel]:
        definitions = self._definitions()
        counts = np.bincount(self._channel_ids, minlength=len(listed)).tolist()
        for number, (topic, type_name, encoding) in enumerate(listed.values()):
            schema_encoding, text = definitions.get(type_name, ("", ""))
            yield LogChannel(
                id=number,
                topic=topic,
                type_name=type_name,
                encoding=encoding,
                schema_encoding=schema_encoding,
                messages=counts[number],
                schema_data=text.encode("utf-8", "replace"),
            )

    def _messages(self) -> NDArray[np.int64]:
        """Read number, topic and time of each message, shape (3, k), in the order in which they were written."""
        whole = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
        wrong = self._asked(f"SELECT count(*) FROM messages WHERE NOT ({whole})").fetchone()[0]
        if wrong:
            raise self._damaged(f"{wrong} rows of the table 'messages' are no messages")
        rows = self._asked("SELECT id, topic_id, timestamp FROM messages ORDER BY id")
        parts = [np.empty((3, 0), np.int64)]
        while batch := rows.fetchmany(_ROWS):
            parts.append(np.array(batch, np.int64).T)
        return np.concatenate(parts, axis=1)

    def _channels_of_rows(self) -> NDArray[np.int64]:
        """Find of which channel each message is, shape (k,)."""
        topic_ids, places = np.unique(self._topic_ids, return_inverse=True)
        for id_ in topic_ids.tolist():
            if id_ not in self._numbers:
                count = int(np.count_nonzero(self._topic_ids == id_))
                raise self._damaged(f"{count} messages are of topic {id_}, which it does not list")
        return np.array([self._numbers[id_] for id_ in topic_ids.tolist()], np.int64)[places]


def _start(path: Path) -> bytes:
    """Read the first bytes of a journal; one that is done with is empty or begins with zeros."""
    with path.open("rb") as stream:
        return stream.read(8)


def _blocks(found: dict[int, list[tuple[int, bytes]]]) -> Iterator[TimedBlock]:
    """Put the payloads of each channel side by side."""
    for number, messages in found.items():
        times, payloads = zip(*messages, strict=True)
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        starts = np.cumsum(sizes) - sizes
        yield TimedBlock(number, memoryview(b"".join(payloads)), starts, sizes, np.array(times, np.int64))
