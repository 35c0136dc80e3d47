"""The messages of a topic that can be read, where others do not fit their schema."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.encoding.field_paths import Columns, FieldReader

_HOPELESS: Final = 1000
"""Where so many messages cannot be read, and fewer can, the schema is wrong and not the messages."""


@dataclass
class Salvage:
    """Reads what can be read of a topic, and remembers the rest.

    Attributes
    ----------
    readable : int
        Messages that were read.
    unreadable_ns : list of int
        Log times of those that cannot be, in the order of the file.
    error : LogError or None
        What is wrong with the first of them.
    """

    readable: int = 0
    unreadable_ns: list[int] = field(default_factory=list)
    error: LogError | None = None

    def read(self, reader: FieldReader, block: Block) -> Iterator[tuple[Block, Columns]]:
        """Read a block, in halves and halves of halves where some of it cannot be read.

        Parameters
        ----------
        reader : FieldReader
        block : Block

        Yields
        ------
        Block
            A part of it.
        dict of str to ndarray, shape (k, n)
            Its fields by path.

        Raises
        ------
        LogError
            Most messages cannot be read.
        """
        try:
            columns = reader.columns(block)
        except LogError as error:
            yield from self._halves(reader, block, error)
            return
        self.readable += len(block)
        yield block, columns

    def _halves(self, reader: FieldReader, block: Block, error: LogError) -> Iterator[tuple[Block, Columns]]:
        count = len(block)
        if count > 1:
            yield from self.read(reader, block.part(slice(None, count // 2)))
            yield from self.read(reader, block.part(slice(count // 2, None)))
            return
        self.error = self.error or error
        self.unreadable_ns.append(int(block.log_time[0]))
        if len(self.unreadable_ns) > max(_HOPELESS, self.readable):
            raise self.error
