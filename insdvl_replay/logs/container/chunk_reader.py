"""The chunks of a file, opened in another thread while the one before is read, and some kept open for the next look."""

from collections import deque
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from insdvl_replay.logs.container.chunk_messages import Content, content_of
from insdvl_replay.logs.container.chunks import Chunk, open_chunk, opened_size
from insdvl_replay.logs.container.damage import DamageError
from insdvl_replay.logs.container.mapped_file import MappedFile
from insdvl_replay.logs.container.scanner import McapIndex

_AHEAD: Final = 3
"""Chunks that are opened while the one before is read."""
_MOST_OPEN: Final = 256 << 20
"""Bytes that they open to together, if they are more than one."""
_KEPT: Final = 16 << 20
"""Bytes of chunks that stay open, since samples of many topics are read from the same ones."""
_SAMPLED: Final = 2
"""Chunks with which a sample begins; were more kept, a long reading would not use the same memory again and again."""


class ChunkReader:
    """Reads the chunks of a file.

    Parameters
    ----------
    index : McapIndex
        Told which chunks cannot be opened, and what is wrong inside others.

    Attributes
    ----------
    opened : set of int
        Places of the chunks that were opened so far.
    """

    def __init__(self, file: MappedFile, index: McapIndex) -> None:
        self._file = file
        self._index = index
        self._kept: dict[int, Content] = {}
        self.opened: set[int] = set()

    def contents(self, chunks: Sequence[Chunk]) -> Iterator[Content]:
        """Go through chunks; those that cannot be opened are dropped."""
        first = {chunk.offset for chunk in chunks[:_SAMPLED]}
        ahead: deque[tuple[Chunk, Future[memoryview] | Content]] = deque()
        sizes: deque[int] = deque()
        with ThreadPoolExecutor(1) as opener:
            for chunk in chunks:
                sizes.append(opened_size(self._file.data, chunk))
                while ahead and (len(ahead) > _AHEAD or sum(sizes) > _MOST_OPEN):
                    yield from self._content(*ahead.popleft(), first)
                    sizes.popleft()
                kept = self._kept.get(chunk.offset)
                ahead.append((chunk, kept or opener.submit(open_chunk, self._file.data, chunk)))
            while ahead:
                yield from self._content(*ahead.popleft(), first)

    def _content(
        self, chunk: Chunk, opened: Future[memoryview] | Content, sampled: Collection[int]
    ) -> Iterator[Content]:
        self.opened.add(chunk.offset)
        if isinstance(opened, Content):
            yield opened
            return
        try:
            content = content_of(self._file.data, chunk, opened.result())
        except DamageError as damage:
            self._index.drop_chunk(chunk, damage)
            return
        if content.damages:
            self._index.trust(chunk, content)
        if chunk.offset in sampled:
            self._keep(chunk, content)
        yield content
        end = max(start + length for start, length in [(chunk.offset, chunk.length), *chunk.indexes])
        self._file.release(chunk.offset, end)

    def _keep(self, chunk: Chunk, content: Content) -> None:
        """Keep a chunk open, and close those that were kept before it for want of room."""
        self._kept[chunk.offset] = content
        while sum(len(one.buffer) for one in self._kept.values()) > _KEPT:
            del self._kept[next(iter(self._kept))]
