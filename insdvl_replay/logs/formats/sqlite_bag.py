"""A .db3 file, in which rosbag2 stores the messages of ROS 2 with SQLite, read without ever writing to it.

Topics and messages are rows of two tables. Definitions of the types are there since Iron; older files have none, and
those that come with the tool are taken. SQLite has no checksums: what it can find wrong in its pages is found as the
file is opened, and then nothing of it is used. Source: rosbag2_storage_sqlite3 of https://github.com/ros2/rosbag2.
"""

import os
import sqlite3
import weakref
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import quote

import numpy as np

from insdvl_replay.core.dive_columns import Integers, TimeNs
from insdvl_replay.core.errors import LogError, Note, counted_clause
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.log_file import (
    Block,
    FileBytes,
    LogChannel,
    LogFile,
    UnusableFileError,
)

_MOST_TOPICS: Final = 1 << 16
_ROWS: Final = 1 << 16  # rows of numbers that are fetched at a time
_BLOCK: Final = 4 << 20  # bytes of payloads from which messages become a block
_COLUMNS: Final = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
    "message_definitions": {"topic_type", "encoding", "encoded_message_definition"},
}
# What SQLite leaves beside a file whose writer was killed, and what makes it tidy up.
_JOURNALS: Final = {
    "-wal": ("holds messages that are not yet in it", "PRAGMA wal_checkpoint(TRUNCATE)"),
    "-journal": ("is of a change to it that broke off", "PRAGMA quick_check"),
}


class _Topic(NamedTuple):
    name: str
    type_name: str
    encoding: str


class _Definition(NamedTuple):
    """How a type is defined."""

    language: str
    text: str


class SqliteFile(LogFile):
    """A .db3 file, open for reading. It is whole, as far as SQLite can tell, or refused."""

    profile = "ros2"
    has_summary = True
    compression = ("none",)

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._require_whole()
        with self.watched(), self._refused():
            self._base = self._opened()
            found = [str(text) for (text,) in self._base.execute("PRAGMA integrity_check(1)")]
            if found != ["ok"]:
                raise self._damaged(f"SQLite says '{' '.join(' '.join(found).split())}'")
            for table in ("topics", "messages"):
                if not self._has(table):
                    what = f"is an SQLite file without the table '{table}' of a bag"
                    raise LogError(what, "give a bag of ROS 2", self.path)
            self.library = "rosbag2"
            if self._has("schema", {"ros_distro"}):  # files before Iron do not tell
                for (distro,) in self._base.execute("SELECT ros_distro FROM schema LIMIT 1"):
                    self.library = f"rosbag2 of {distro}"
            self._read()

    @property
    def notes(self) -> tuple[Note, ...]:
        """What is not there any more: messages that were there once."""
        found = self._ids.size
        announced = int(self._ids.max(initial=0))
        if announced == found:
            return ()
        missing = note(
            "log_summary numbers",
            abs(announced - found),
            name=self.path.name,
            announced=announced,
            found=found,
        )
        return (missing,)

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns."""
        return {
            channel.id: self._times[self._channel_ids == channel.id] for channel in self.channels
        }

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, some megabytes at a time."""
        is_wanted = np.isin(self._channel_ids, list(channel_ids))
        ids = ",".join(map(str, np.unique(self._topic_ids[is_wanted]).tolist()))
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({ids}) ORDER BY id"
        )
        found: dict[int, list[tuple[int, bytes]]] = {}
        size = 0
        with self._refused():
            for topic_id, time_ns, data in self._base.execute(query):
                found.setdefault(self._numbers[topic_id], []).append((time_ns, data))
                size += len(data)
                if size >= _BLOCK:
                    yield from _blocks(found)
                    found = {}
                    size = 0
            yield from _blocks(found)

    def _require_whole(self) -> None:
        """Refuse a file that is not as long as its header says, or of which the last messages are in another file."""
        header = bytes(self.file.read(0, 100))
        page = int.from_bytes(header[16:18], "big")
        pages = int.from_bytes(header[28:32], "big")
        if page == 1:
            page = 1 << 16
        size = page * pages
        if len(header) < 100 or size != len(self.file):
            raise self._damaged(f"it has {len(self.file)} bytes where its header says {size}")
        for ending, (what, statement) in _JOURNALS.items():
            companion = Path(f"{os.path.realpath(self.path)}{ending}")
            if companion.is_file():
                with companion.open("rb") as stream:
                    start = stream.read(8)
                if any(start):  # one that is done with is empty or begins with zeros
                    hint = f"keep a copy of both, then `sqlite3 {self.path} '{statement}'` merges them"
                    raise LogError(f"is not complete: {companion.name} {what}", hint, self.path)

    def _damaged(self, found: str) -> UnusableFileError:
        saved = self.path.with_name(f"saved_{self.path.name}")
        hint = (
            f"copy it again, or recover it with `sqlite3 {self.path} .recover | sqlite3 {saved}`"
        )
        return UnusableFileError(f"is damaged: {found}", hint, self.path)

    @contextmanager
    def _refused(self) -> Iterator[None]:
        """Refuse the file for what SQLite finds wrong."""
        try:
            yield
        except sqlite3.Error as error:
            self.file.require_unchanged()
            raise self._damaged(f"SQLite says '{error}'") from error

    def _opened(self) -> sqlite3.Connection:
        """Open it read-only, without running any code in it."""
        name = quote(os.fsencode(os.path.realpath(self.file.content)))
        base = sqlite3.connect(
            f"file:{name}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )
        weakref.finalize(self, base.close)
        base.text_factory = lambda text: text.decode("utf-8", "replace")
        # No row is larger than the file, whatever its table computes.
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(len(self.file), 1 << 20))
        base.execute("PRAGMA trusted_schema = OFF")
        base.execute("PRAGMA cell_size_check = ON")
        return base

    def _has(self, table: str, columns: Collection[str] = ()) -> bool:
        """Return whether a table is there with the columns that are read, none of which is computed."""
        query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ? AND sql LIKE 'CREATE TABLE%'"
        if self._base.execute(query, (table,)).fetchone() != (1,):
            return False
        # Of each column: number, name, type, whether null is refused, default, place in the key, and what it hides.
        plain = {
            name
            for _, name, *_, hidden in self._base.execute(f"PRAGMA table_xinfo({table})")
            if not hidden
        }
        return plain.issuperset(columns or _COLUMNS[table])

    def _read(self) -> None:
        """Read the topics, their definitions, and number, topic and time of each message."""
        topics = self._topics()
        definitions = self._definitions()
        self._require_sound()
        self._numbers = {topic_id: number for number, topic_id in enumerate(topics)}
        self._ids, self._topic_ids, self._times = self._messages()
        topic_ids, places, counts = np.unique(
            self._topic_ids, return_inverse=True, return_counts=True
        )
        for topic_id, count in zip(topic_ids.tolist(), counts.tolist(), strict=True):
            if topic_id not in self._numbers:
                what = f"messages are of topic {topic_id}, which is not defined"
                raise self._damaged(counted_clause(count, what))
        numbers = [self._numbers[topic_id] for topic_id in topic_ids.tolist()]
        self._channel_ids = np.array(numbers, np.int64)[places]
        found = np.bincount(self._channel_ids, minlength=len(topics)).tolist()
        self.channels = tuple(
            _channel(number, topic, definitions, found[number])
            for number, topic in enumerate(topics.values())
        )

    def _topics(self) -> dict[int, _Topic]:
        """Return the topics by their ids."""
        query = f"SELECT id, name, type, serialization_format FROM topics LIMIT {_MOST_TOPICS + 1}"
        topics: dict[int, _Topic] = {}
        for topic_id, name, type_name, encoding in self._base.execute(query):
            topics[topic_id] = _Topic(str(name), str(type_name), str(encoding))
        if len(topics) > _MOST_TOPICS:
            raise self._damaged(f"it lists more than {_MOST_TOPICS} topics")
        return topics

    def _definitions(self) -> dict[str, _Definition]:
        """Return the definitions of types by their names, as far as the file has them."""
        if not self._has("message_definitions"):
            return {}
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions: dict[str, _Definition] = {}
        for type_name, language, text in self._base.execute(query):
            # Those that the recorder did not find are empty.
            if str(text or "").strip():
                definitions[str(type_name)] = _Definition(str(language), str(text))
        return definitions

    def _require_sound(self) -> None:
        """Refuse a file with rows of messages that are none."""
        whole = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
        query = f"SELECT count(*) FROM messages WHERE NOT ({whole})"
        [wrong] = self._base.execute(query).fetchone()
        if wrong:
            raise self._damaged(counted_clause(wrong, "rows of the table 'messages' are damaged"))

    def _messages(self) -> Integers:
        """Return number, topic and time of each message, (3, k)."""
        cursor = self._base.execute("SELECT id, topic_id, timestamp FROM messages ORDER BY id")
        parts = [np.empty((3, 0), np.int64)]
        while batch := cursor.fetchmany(_ROWS):
            parts.append(np.array(batch, np.int64).T)
        return np.concatenate(parts, axis=1)


def _channel(
    number: int,
    topic: _Topic,
    definitions: Mapping[str, _Definition],
    messages: int,
) -> LogChannel:
    """Return the channel that a topic is."""
    definition = definitions.get(topic.type_name, _Definition("", ""))
    return LogChannel(
        id=number,
        topic=topic.name,
        type_name=topic.type_name,
        encoding=topic.encoding,
        schema_encoding=definition.language,
        messages=messages,
        schema_data=definition.text.encode("utf-8", "replace"),
    )


def _blocks(found: dict[int, list[tuple[int, bytes]]]) -> Iterator[Block]:
    """Put the payloads of each channel side by side."""
    for number, messages in found.items():
        times, payloads = zip(*messages, strict=True)
        time_ns = np.array(times, np.int64)
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        yield Block(
            number,
            memoryview(b"".join(payloads)),
            np.cumsum(sizes) - sizes,
            sizes,
            time_ns,
            time_ns,
        )
