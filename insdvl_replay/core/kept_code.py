"""Compiled code on disk, sealed with a checksum: a file that is cut, garbled or unreadable is one that is not there.

numba keeps its code as pickles, and takes for granted that they can be read and written. Where they cannot, the code is
compiled for this process, and the file is written again if that can be.
"""

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from numba.core.caching import FunctionCache, IndexDataCacheFile

_SEAL_SIZE: Final = hashlib.sha256().digest_size


def keep(dispatcher: Any, function: Callable[..., Any]) -> None:
    """Let the code of a compiled function be kept in the folder that numba is told of."""
    dispatcher._cache = _KeptCode(function)  # what `cache=True` does, with a cache of numba's own


class _KeptCode(FunctionCache):
    """The code of one function. No fault of the disk goes further than this."""

    def __init__(self: Any, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _SealedFiles(self._cache_path, self._impl.filename_base, stamp)  # type: ignore[no-untyped-call]

    def load_overload(self: Any, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except OSError:
            return None

    def save_overload(self: Any, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError:  # a full disk, above all: the next process compiles, too
            return


class _SealedFiles(IndexDataCacheFile):
    """An index and its data files, each with the checksum of the rest in front."""

    def _load_index(self: Any) -> Any:
        content = _opened(Path(self._index_path))
        version, stamp, overloads = (None, None, {}) if content is None else pickle.loads(content)
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self: Any, overloads: Any) -> None:
        self._write(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self: Any, name: str) -> Any:
        content = _opened(Path(self._data_path(name)))
        return None if content is None else pickle.loads(content)

    def _save_data(self: Any, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self: Any, path: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(path) as file:
            file.write(hashlib.sha256(content).digest() + content)


def _opened(path: Path) -> bytes | None:
    """Return what is under the seal; None where there is nothing to be trusted."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    seal, content = content[:_SEAL_SIZE], content[_SEAL_SIZE:]
    return content if hashlib.sha256(content).digest() == seal else None
