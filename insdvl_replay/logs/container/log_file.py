"""What a recording asks of a file that holds messages, whatever its format."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.mapped_file import Digest, MappedFile
from insdvl_replay.logs.container.records import Damage, LogChannel, Span


class LogFile(ABC):
    """A file with messages, open for reading. Damage is collected; whether it is allowed is for the recording to say.

    Attributes
    ----------
    path : Path
    channels : tuple of LogChannel
        Their ids are below 65536.
    profile : str
        What the recorder promises to follow, ``ros2`` for ROS 2.
    library : str
        What wrote the log.
    has_summary : bool
        Whether the file closes with a summary that can be believed, or is of a format that needs none.
    chunk_count : int
        How many chunks there are, if the format has any.
    compression : tuple of str
        The ways in which parts of it are compressed, ``none`` for those that are not.
    damages : collection of Damage
        The places found so far; of some formats no file with any is opened.
    """

    channels: tuple[LogChannel, ...] = ()
    profile: str
    library: str
    has_summary: bool
    chunk_count: int = 0
    compression: tuple[str, ...]
    damages: Collection[Damage] = ()

    def __init__(self, file: MappedFile) -> None:
        self.path = file.path
        self._file = file
        self._data = file.data

    @property
    def size_bytes(self) -> int:
        """How large the file is."""
        return len(self._data)

    @property
    def span_ns(self) -> Span | None:
        """First and last log time; None without messages."""
        times = [times for times in self.log_times().values() if times.size]
        return (min(int(one.min()) for one in times), max(int(one.max()) for one in times)) if times else None

    @property
    def metadata(self) -> Iterator[Any]:
        """The metadata records in the order of the file, each with a name."""
        return iter(())

    @property
    def attachments(self) -> Iterator[Any]:
        """The attachments in the order of the file, each with a name."""
        return iter(())

    @property
    @abstractmethod
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong or was passed over so far."""

    @abstractmethod
    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a part of the file at a time."""

    @abstractmethod
    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, shape (k,), ns."""

    def faults(self) -> list[LogError]:
        """Return an error for each damaged place found so far."""
        return [LogError(f"is damaged at byte {one.offset}: {one.found}", "", self.path) for one in self.damages]

    def saved_times(self) -> Iterator[TimeNs]:
        """Give the log times of all messages that can be read, some at a time; ns."""
        yield from self.log_times().values()

    def check_unopened(self) -> Iterator[None]:
        """Check, step by step, what nobody has looked at so far."""
        return iter(())

    def digest(self) -> Digest:
        """Go over all bytes of the file. It changes nothing here, so that another thread can do it meanwhile."""
        return self._file.digest(0, 0)

    def add_damages(self, digest: Digest) -> None:  # noqa: B027
        """Note wrong checksums that only a whole pass can check; most formats have none."""

    def require_unchanged(self) -> None:
        """Refuse the file if it is no longer what it was when it was opened."""
        self._file.require_unchanged()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the file if it has changed by the end since it was opened, above all if that made something fail."""
        with self._file.watched():
            yield
