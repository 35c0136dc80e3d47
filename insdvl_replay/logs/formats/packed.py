"""Files that are compressed as a whole with zstd, as rosbag2 does with ``compression_mode: FILE``.

They are unpacked piece by piece into a temporary file, which is removed with the last reader of it. Source: RFC 8878,
"Zstandard Compression and the application/zstd Media Type".
"""

import errno
import os
import tempfile
from functools import lru_cache
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Final

import zstandard

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.log_file import (
    Damage,
    Digest,
    FileBytes,
    UnusableFileError,
)

_USUAL: Final = 1 << 30  # bytes to which any file may open
_MOST_COMPRESSED: Final = 64  # a larger one only if it is compressed less densely than this
_PIECE: Final = 1 << 17  # as the blocks of zstd
_LONGEST_HEAD: Final = 18  # bytes
_KEPT: Final = 4  # unpacked files that stay, since a command opens a log several times


class _Copy:
    """An unpacked file."""

    def __init__(self) -> None:
        descriptor, name = tempfile.mkstemp(prefix="insdvl_replay_", suffix=".unpacked")
        os.close(descriptor)
        self.path = Path(name)
        self.damages: tuple[Damage, ...] = ()
        # Worker processes run such finalizers at their end, and only those of their own objects.
        Finalize(self, _remove, (name,), exitpriority=0)


def _remove(name: str) -> None:
    """Remove an unpacked file."""
    Path(name).unlink(missing_ok=True)


class UnpackedBytes(FileBytes):
    """The bytes to which a compressed file opens; its name, digest and changes are those of the compressed one."""

    def __init__(self, packed: FileBytes) -> None:
        now = packed.path.stat()
        self._copy = _unpacked(packed.path, now.st_size, now.st_mtime_ns, now.st_ino)
        self.damages = self._copy.damages
        super().__init__(self._copy.path)
        self._packed = packed
        self.content = self._copy.path
        self.path = packed.path

    def digest(self, section_end: int = 0, section_crc: int = 0) -> Digest:
        """Go over all bytes: the digest is that of the compressed ones, the checksum that of the others."""
        damages = super().digest(section_end, section_crc).damages
        return Digest(self._packed.digest().sha256, damages)

    def require_unchanged(self) -> None:
        """Refuse the compressed file if it has changed since it was opened."""
        self._packed.require_unchanged()


@lru_cache(_KEPT)
def _unpacked(
    path: Path,
    size: int,
    _mtime_ns: int,
    _inode: int,
) -> _Copy:
    """Unpack a file; what is damaged in it is kept with the copy, which then ends there."""
    most = max(_USUAL, _MOST_COMPRESSED * size)
    copy = _Copy()
    try:
        with path.open("rb") as packed, copy.path.open("wb") as stream:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            written = 0
            try:
                while piece := reader.read(_PIECE):
                    written += len(piece)
                    if written > most:
                        raise _too_large(path, size, most)
                    stream.write(piece)
            except zstandard.ZstdError as error:
                what = f"the compressed bytes cannot be unpacked any further ({error})"
                copy.damages = (Damage(packed.tell(), what),)
            if not copy.damages:
                copy.damages = _lacking(path, written)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        folder = tempfile.gettempdir()
        what = f"is compressed, and there is no room in {folder} to unpack it"
        raise LogError(what, "set TMPDIR to a folder with room", path) from error
    if not written and not copy.damages:
        raise UnusableFileError("is compressed and empty", "copy it again", path)
    if not written:
        what = f"is compressed and cannot be unpacked: {copy.damages[0].found}"
        raise UnusableFileError(what, "copy it again", path)
    return copy


def _lacking(path: Path, written: int) -> tuple[Damage, ...]:
    """Return the damage of a file that ends before what it opens to does."""
    with path.open("rb") as packed:
        start = packed.read(_LONGEST_HEAD)
        size = packed.seek(0, os.SEEK_END)
    try:
        announced = zstandard.frame_content_size(start)
    except zstandard.ZstdError:
        return (Damage(size, "it ends within its head"),)
    if written < announced:
        what = f"it opens to {written} bytes, but {announced} were announced"
        return (Damage(size, what),)
    if not written and announced:
        return (Damage(size, "it ends within its first block"),)
    return ()


def _too_large(path: Path, size: int, most: int) -> LogError:
    """Return the error for a file that opens to more than can be believed."""
    what = f"opens to more than {most} bytes, the most that a compressed file of {size} bytes may"
    return LogError(what, f"if that is right, unpack it: `zstd -d {path}`", path)
