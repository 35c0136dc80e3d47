"""Remote logs: fetched once and kept by their digest, or looked at by the summary at their end.

Of a long log of which no digest is listed, only the chunks are fetched that a replay can use (`remote_parts`).

A server is asked once whether a log that is kept is still the one it has. What it sends is kept only if all of it came,
nothing changed meanwhile, and the digest is the one that is wanted. Whatever a server does, a transfer ends.

Environment
-----------
XDG_CACHE_HOME : folder in which `insdvl-replay` keeps what was fetched; default ``~/.cache``.
INSDVL_REPLAY_FETCH_GB : the longest log that is fetched; default 20.
INSDVL_REPLAY_FETCH_HOURS : the longest transfer of a log; default 6.
INSDVL_REPLAY_OFFLINE=1 : nothing is fetched, as with ``--offline``.
"""

import errno
import hashlib
import json
import math
import os
import re
import shutil
import struct
import time
from base64 import b64encode
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any, Final, NamedTuple, TypeVar
from urllib.parse import quote, unquote, urlsplit, urlunsplit

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.core.errors import ConfigError, LogError, show_as
from insdvl_replay.core.extras import install_hint
from insdvl_replay.core.urls import shown_url, without_access
from insdvl_replay.logs.formats.mcap_file import HEADER_SIZE, MAGIC, log_channels, walk
from insdvl_replay.logs.formats.remote_parts import (
    LEAST_BYTES,
    LogSummary,
    Parts,
    Read,
    parts_of,
    write_parts,
)

T = TypeVar("T")
STALLED_S: float = 30.0  # without a byte from the server
ANSWERED_S: float = 60.0  # for a short answer: what a server says of a log, or a part of it
PAUSES_S: Sequence[float] = (1.0, 4.0, 16.0)  # before each try after one that failed
LONGEST_GB: Final = 20.0
LONGEST_HOURS: Final = 6.0
_LOOKED_S: Final = 0.2  # between looks whether a transfer is still wanted
SLOWEST: Final = 1000  # bytes a second, over twice this time
_CHECK: Final = "check the URL and the connection"
_FETCH: Final = "fetch it with `insdvl-replay run URL`"
_ONLINE: Final = "leave out --offline, and INSDVL_REPLAY_OFFLINE"
_LONGER: Final = "set INSDVL_REPLAY_FETCH_GB to fetch it all the same"
# What a server says of a log, on the web and in S3.
_STATE: Final = ("size", "ETag", "Last-Modified", "LastModified")
_OF_THIS_DISK: Final = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.ENOTDIR,
)
# Answers of a server on the web that pass: the request took too long, too many requests, and faults of its own.
_BUSY: Final = (408, 425, 429)
_OF_SERVER: Final = 500
# Errors of aiohttp and botocore where a connection is not made, or breaks off.
_BROKEN_OFF: Final = frozenset({"ClientConnectionError", "ClientPayloadError", "HTTPClientError"})
_LONGEST_NAME: Final = 200  # bytes of a file's name
_ABANDONED_S: Final = 86400.0  # a part that was left so long ago belongs to no other process
_FIRST_TAIL: Final = 128 << 10  # bytes of a log's end that are asked for first
_LONGEST_TAIL: Final = 512 << 10
_LONGEST_SUMMARY: Final = 64 << 20  # where its chunk indexes are needed
_FOOTER: Final = struct.Struct("<QQI")
_AS_THEY_ARE: Final = "%/:=&?~#+!$,;'@()*[]"  # characters of a URL
_ESSENTIAL: Final = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
_RECORDS: Final[dict[int, Any]] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
}


class _TooLongError(OSError):
    """More came from a server than is fetched of one log."""


class PassingError(LogError):
    """A server was not reached, was busy or broke off, and may do better when it is asked again (exit code 3)."""


class StalledError(PassingError):
    """A server did not answer, or stopped in the middle (exit code 3)."""


def remote_name(url: str) -> Path:
    """Return the name of the file that a URL is of."""
    name = Path(unquote(urlsplit(url).path)).name
    if name.strip(".") and len(name.encode()) <= _LONGEST_NAME:
        return Path(name)
    return Path(f"dive{Path(name).suffix[:9]}")


def cache_folder() -> Path:
    """Return the folder of logs that were fetched, and of what their servers said of them."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "insdvl-replay"


def fetched(
    url: str,
    sha256: str = "",
    is_stopped: Callable[[], bool] = lambda: False,
    *,
    offline: bool = False,
    whole: bool = False,
    pauses_s: Sequence[float] | None = None,
) -> Path:
    """Return a remote log from the cache, after fetching it if it is not there or has changed.

    A log whose digest is known is used from the cache where its server cannot be asked. Offline, none is asked. Of a
    long log without a known digest, chunks that have only pictures are left out, unless the ``whole`` is wanted.
    A server that fails is asked again after each of the pauses, by default `PAUSES_S`.

    Raises
    ------
    LogError
        The log cannot be fetched whole, changes meanwhile, is too long, or has another digest.
    """
    if os.environ.get("INSDVL_REPLAY_OFFLINE", "") not in ("", "0"):
        offline = True
    path = _with_retries(
        lambda: _fetched(url, sha256, is_stopped, offline=offline, whole=whole),
        _limits().longest_s,
        is_stopped,
        pauses_s,
    )
    show_as(path, shown_url(url))
    return path


def _with_retries(
    read: Callable[[], T],
    longest_s: float,  # of all tries together
    is_stopped: Callable[[], bool] = lambda: False,
    pauses_s: Sequence[float] | None = None,
) -> T:
    """Read from a server, and again after each pause if it fails in a way that may pass."""
    if pauses_s is None:
        pauses_s = PAUSES_S
    until_s = time.monotonic() + longest_s
    tries = 0
    while True:
        try:
            return read()
        except PassingError as error:
            tries += 1
            is_last = tries > len(pauses_s)
            if is_last or is_stopped() or time.monotonic() + pauses_s[tries - 1] > until_s:
                raise _after(tries, error) from error
        _pause(pauses_s[tries - 1], is_stopped)


def _after(tries: int, error: PassingError) -> PassingError:
    """Return an error that says how often a server was asked."""
    if tries == 1:
        return error
    return type(error)(f"{error.what} (tried {tries} times)", error.hint, *error.where)


def _pause(pause_s: float, is_stopped: Callable[[], bool]) -> None:
    """Wait, as long as the log is still wanted."""
    until_s = time.monotonic() + pause_s
    while not is_stopped():
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            return
        time.sleep(min(left_s, _LOOKED_S))


@dataclass(frozen=True)
class _Kept:
    """A log in the cache, and what was said of it when it was fetched."""

    path: Path  # where it is, or would be
    is_there: bool  # whole, by its digest
    sha256: str
    state: Any  # what its server said

    @classmethod
    def of(cls, url: str, sha256: str, *, whole: bool) -> "_Kept":
        """Look for a log, by its digest if that is known; where the whole is wanted, a part is not it."""
        said = _said_before(_said(url))
        path = _logs() / (sha256 or said.sha256) / remote_name(url)
        is_there = path.is_file() and file_digest(path) == path.parent.name
        if whole and said.is_part and not sha256:
            is_there = False
        return cls(path, is_there, said.sha256, said.state)

    def is_still(self, state: Mapping[str, Any], *, is_listed: bool) -> bool:
        """Return whether it is the log of which a server says something now; a size alone shows no change."""
        is_same = self.sha256 == self.path.parent.name and self.state == state
        return self.is_there and is_same and (is_listed or len(state) > 1)


@dataclass(frozen=True)
class _Offer:
    """A log on its server, and how it may be fetched."""

    url: str
    system: Any  # of files
    path: str
    limits: "_Limits"
    is_stopped: Callable[[], bool]

    def state(self) -> dict[str, str | int]:
        """Ask the server what it says of the log now."""
        return _within(ANSWERED_S, lambda: _state(self.system, self.path))

    def copy(self, part: Path, size: str | int | None) -> None:
        """Copy it to a file."""
        is_over = Event()
        watch = _watch(size, self.limits.longest_bytes, is_over.is_set)
        try:
            _within(
                self.limits.longest_s,
                lambda: self.system.get_file(self.path, str(part), callback=watch),
                self.is_stopped,
            )
        finally:
            is_over.set()

    def reader(self, size: int) -> Read:
        """Return what reads the bytes between two places of it, where it has some size."""

        def read(start: int, end: int) -> bytes:
            end = min(end, size)
            content = _within(
                self.limits.longest_s, lambda: self._ask(start, end, size), self.is_stopped
            )
            if len(content) != end - start:
                text = f"its server sent {len(content)} bytes of {end - start}"
                raise PassingError(text, _CHECK, shown_url(self.url))
            return content

        return read

    def _ask(self, start: int, end: int, size: int) -> bytes:
        if urlsplit(self.url).scheme not in ("http", "https"):
            return bytes(self.system.cat_file(self.path, start=start, end=end))
        content, now = _tail_of_web(self.url, end - start, end)
        _require_size(self.url, size, now)
        return content


def _fetched(
    url: str,
    sha256: str,
    is_stopped: Callable[[], bool],
    *,
    offline: bool,
    whole: bool,
) -> Path:
    kept = _Kept.of(url, sha256, whole=whole)
    if offline:
        if kept.is_there:
            return kept.path
        text = "is not kept from an earlier command, and offline nothing is fetched"
        raise LogError(text, _ONLINE, shown_url(url))
    offer = _Offer(url, *_file_system(url), _limits(), is_stopped)
    try:
        with _refused(url):
            state = offer.state()
    except LogError:
        if kept.is_there and sha256:
            return kept.path
        raise
    if "size" not in state and not sha256:
        text = "its server does not say how long it is, so that a part of it could be taken for the whole"
        raise LogError(text, "list it in a manifest with its sha256", shown_url(url))
    if kept.is_still(state, is_listed=bool(sha256)):
        return kept.path
    parts = None
    with _refused(url):
        if not (sha256 or whole):
            parts = _parts_of(url, int(state["size"]))
        return _fetch(offer, state, parts, sha256)


def _fetch(
    offer: _Offer,
    state: Mapping[str, Any],
    parts: Parts | None,
    sha256: str,
) -> Path:
    """Fetch a log, or parts of it, and keep it."""
    url = offer.url
    size = int(state.get("size", 0))
    fetched_bytes = size if parts is None else parts.bytes_of_chunks
    longest_bytes = offer.limits.longest_bytes
    if fetched_bytes > longest_bytes:
        text = f"has {fetched_bytes / 1e9:.3g} GB: {_too_long(longest_bytes)}"
        raise LogError(text, _LONGER, shown_url(url))
    _make_private(_logs(), _said(url).parent)
    _remove_abandoned(_logs())
    # A transfer that is stopped may write once more while its folder is removed; then what is left goes later.
    with TemporaryDirectory(dir=_logs(), prefix=".part", ignore_cleanup_errors=True) as folder:
        part = Path(folder) / remote_name(url)
        if parts is None:
            offer.copy(part, state.get("size"))
        else:
            write_parts(part, parts, offer.reader(size))
        if offer.state() != state:
            text = "changed on its server while it was fetched; nothing was kept"
            raise LogError(text, "fetch it again", shown_url(url))
        return _store(url, part, state, sha256, is_part=parts is not None)


def _parts_of(url: str, size: int) -> Parts | None:
    """Choose the parts of a long MCAP file that are fetched; None where the whole is."""
    if size < LEAST_BYTES:
        return None
    try:
        found = _summary_of(url, _LONGEST_SUMMARY)
    except PassingError:
        raise
    except LogError:  # no MCAP file, no summary, or no ranges
        return None
    return parts_of(found)


def _store(
    url: str,
    part: Path,
    state: Mapping[str, Any],
    sha256: str,
    *,
    is_part: bool,
) -> Path:
    """Keep a log that was fetched, and what its server says of it."""
    of_whole = {} if is_part else state  # A part is shorter than its server says.
    digest = _digest_of_whole(part, of_whole, sha256, shown_url(url))
    kept = _logs() / digest / part.name
    kept.parent.mkdir(mode=0o700, exist_ok=True)
    part.chmod(0o600)
    part.replace(kept)
    part.touch(mode=0o600)
    part.write_text(json.dumps({"sha256": digest, "state": state, "is_part": is_part}))
    part.replace(_said(url))
    return kept


def folder_of_files(key: str, name: str, files: Mapping[str, Path]) -> Path:
    """Return a folder of the cache that has some files under names of their own, and nothing else.

    Parameters
    ----------
    key : str
        Stands for the content of all files and for their names.
    name : str
        Of the folder, which names the dive.
    files : mapping of str to Path
        The files in the cache, or on this machine, by their names in the folder.
    """
    folder = cache_folder() / "dives" / key / name
    if _has_files(folder, files):
        return folder
    with _refused(str(folder)):
        _make_private(folder.parent.parent, folder.parent)
        with TemporaryDirectory(dir=folder.parent, prefix=".part") as made:
            whole = Path(made) / name
            whole.mkdir()
            for file_name, file in files.items():
                shutil.copyfile(file, whole / file_name)
            if folder.exists():
                shutil.rmtree(folder)
            whole.rename(folder)
    return folder


def _has_files(folder: Path, files: Mapping[str, Path]) -> bool:
    """Return whether a folder has copies of all files."""
    for name, file in files.items():
        copy = folder / name
        if not copy.is_file() or file_digest(copy) != file_digest(file):
            return False
    return True


def _logs() -> Path:
    """Return the folder of logs."""
    return cache_folder() / "logs"


def _said(url: str) -> Path:
    """Return the file with what a server said of a log when it was fetched."""
    return cache_folder() / "urls" / f"{hashlib.sha256(url.encode()).hexdigest()}.json"


class _Said(NamedTuple):
    """What is known of a log since it was fetched."""

    sha256: str = ""
    state: Any = None
    is_part: bool = False  # without the chunks that have only pictures


def _said_before(said: Path) -> _Said:
    """Return the digest and the state of a log when it was fetched; nothing where it was not, or nobody can tell."""
    try:
        known = json.loads(said.read_bytes())
        return _Said(str(known["sha256"]), known["state"], bool(known.get("is_part")))
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return _Said()


def _make_private(*folders: Path) -> None:
    """Make folders that others on this machine may not read."""
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)


def _remove_abandoned(logs: Path) -> None:
    """Remove the parts of logs that killed processes left."""
    for left in logs.glob(".part*"):
        with suppress(OSError):  # another process removes it, too
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                shutil.rmtree(left)


def _digest_of_whole(
    part: Path,
    state: Mapping[str, Any],
    sha256: str,
    shown: str,
) -> str:
    """Return the digest of what was fetched; LogError if it is not all of the log, or another than the listed one."""
    size = part.stat().st_size
    if size != state.get("size", size):
        text = f"has {size} bytes, where its server announced {state['size']}; nothing was kept"
        raise PassingError(text, _CHECK, shown)
    digest = file_digest(part)
    if digest != (sha256 or digest):
        text = f"the SHA-256 of what was sent is {digest}; the manifest says {sha256}"
        raise LogError(text, "ask who offers it; nothing was kept", shown)
    return digest


class _Limits(NamedTuple):
    """The longest log that is fetched, and the longest transfer."""

    longest_bytes: float
    longest_s: float


def _limits() -> _Limits:
    """Return the limits that the environment sets, or the usual ones."""
    longest_gb = _limit("INSDVL_REPLAY_FETCH_GB", LONGEST_GB)
    longest_hours = _limit("INSDVL_REPLAY_FETCH_HOURS", LONGEST_HOURS)
    return _Limits(longest_gb * 1e9, longest_hours * 3600.0)


def _limit(name: str, default: float) -> float:
    text = os.environ.get(name) or str(default)
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < math.inf:
        what = f"{name}={text}: must be a number above 0"
        raise ConfigError(what, f"{name}={default:g} is the default")
    return value


def _too_long(longest_bytes: float) -> str:
    return f"logs of more than {longest_bytes / 1e9:g} GB are not fetched"


def _within(
    longest_s: float, work: Callable[[], T], is_stopped: Callable[[], bool] = lambda: False
) -> T:
    """Do work that waits for a server, in a thread that is left alone if it takes too long or is no longer wanted."""
    outcome = Future[T]()

    def require_wanted() -> None:
        if is_stopped():
            raise InterruptedError("stopped")

    def do() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    require_wanted()  # before a short transfer is over
    Thread(target=do, daemon=True).start()
    until_s = time.monotonic() + longest_s
    while not outcome.done():
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError(f"it takes longer than {longest_s:g} s")
        require_wanted()
        wait([outcome], timeout=min(left_s, _LOOKED_S))
    return outcome.result()


def _watch(size: str | int | None, longest_bytes: float, is_stopped: Callable[[], bool]) -> Any:
    """Return what fsspec calls with each piece: it ends a transfer that is too long, too slow, or no longer wanted."""
    from fsspec.callbacks import Callback

    begun_s = time.monotonic()

    class Watch(Callback):  # type: ignore[misc]
        def relative_update(self, inc: int = 1) -> None:
            super().relative_update(inc)
            elapsed_s = time.monotonic() - begun_s
            if is_stopped():
                raise InterruptedError("stopped")
            if isinstance(size, int) and self.value > size:
                raise OSError(f"its server sends more than the {size} bytes that it announced")
            if self.value > longest_bytes:
                raise _TooLongError(_too_long(longest_bytes))
            if elapsed_s > 2.0 * STALLED_S and self.value < SLOWEST * elapsed_s:
                raise TimeoutError(f"{self.value} bytes in {elapsed_s:.0f} s")

    return Watch()


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it."""
    options: dict[str, Any] = {}
    try:
        import fsspec

        if urlsplit(url).scheme in ("http", "https"):
            import aiohttp

            timeout = aiohttp.ClientTimeout(
                total=None, sock_connect=STALLED_S, sock_read=STALLED_S
            )
            options["client_kwargs"] = {"timeout": timeout, "trust_env": True}
        with _refused(url):
            system, path = fsspec.core.url_to_fs(url, skip_instance_cache=True, **options)
    except ImportError as error:
        raise ConfigError(f"{url}: {error}", install_hint("remote")) from error
    return system, path


def _state(system: Any, path: str) -> dict[str, str | int]:
    """Return what a server says of a log now, by one request."""
    system.invalidate_cache()
    found = system.info(path)
    state: dict[str, str | int] = {}
    for key in _STATE:
        if found.get(key) is not None:
            state[key] = found[key] if key == "size" else str(found[key])
    return state


@contextmanager
def _refused(url: str) -> Iterator[None]:
    """Turn whatever a library makes of a server or of this disk into a LogError."""
    try:
        yield
    except (LogError, ImportError):
        raise
    except Exception as error:
        cause = error.__cause__ or error
        reason = " ".join(without_access(str(cause), url).split())[:200] or type(cause).__name__
        if isinstance(error, OSError) and error.errno in _OF_THIS_DISK and error.filename:
            text = f"cannot be kept in {cache_folder()}: {error.strerror}"
            raise LogError(
                text, "make room there, or set XDG_CACHE_HOME", shown_url(url)
            ) from error
        kind = LogError
        if isinstance(cause, TimeoutError):
            kind = StalledError
        elif _may_pass(error) or _may_pass(cause):
            kind = PassingError
        hint = _LONGER if isinstance(cause, _TooLongError) else _CHECK
        raise kind(f"cannot be fetched: {reason}", hint, shown_url(url)) from error


def _may_pass(error: BaseException) -> bool:
    """Return whether a server may do better when it is asked again: not where it says that it has no such log."""
    status = getattr(error, "status", None)
    if isinstance(status, int):
        return status in _BUSY or status >= _OF_SERVER
    reason = getattr(error, "reason", None)  # of urllib
    if isinstance(error, ConnectionError) or isinstance(reason, ConnectionError | TimeoutError):
        return True
    return not _BROKEN_OFF.isdisjoint(kind.__name__ for kind in type(error).__mro__)


# --- The summary at the end of a log.


def read_summary(url: str, most_bytes: int = _LONGEST_TAIL) -> LogSummary:
    """Read the summary of a remote MCAP file, by at most two requests for ranges of bytes, 512 KiB together.

    Of a longer summary than ``most_bytes``, the indexes of chunks are left out.

    Raises
    ------
    LogError
        The server sends no ranges or other bytes than it says, or the file has no summary that can be used.
    """
    return _with_retries(lambda: _summary_of(url, most_bytes), ANSWERED_S)


def _summary_of(url: str, most_bytes: int) -> LogSummary:
    """Read the summary of a remote MCAP file, with one try."""
    tail, size = _tail(url, _FIRST_TAIL)
    tail_start = size - len(tail)
    footer = len(tail) - len(MAGIC) - _FOOTER.size
    if footer < HEADER_SIZE or not tail.endswith(MAGIC):
        text = "does not end as an MCAP file; only the summary of these is read from a server"
        raise LogError(text, _FETCH, shown_url(url))
    start, offsets_start, crc = _FOOTER.unpack_from(tail, footer)
    end = tail_start + footer - HEADER_SIZE
    if not 0 < start <= end:
        raise LogError("has no summary", _FETCH, shown_url(url))
    room = most_bytes - len(tail)
    if tail_start - start > room:
        offsets = tail[max(offsets_start - tail_start, 0) : footer - HEADER_SIZE]
        return _summary(url, size, start, _essential(url, size, offsets, room))
    if start < tail_start:
        tail = _part(url, start, tail_start, size) + tail
        tail_start = start
    summary = tail[start - tail_start :]
    if crc and zlib_ng.crc32(summary[: -len(MAGIC) - 4]) != crc:
        raise LogError("the checksum of the summary is wrong", _FETCH, shown_url(url))
    return _summary(url, size, start, summary[: end - start])


def _essential(
    url: str,
    size: int,
    offsets: bytes,
    room: int,
) -> bytes:
    """Read the part of a long summary that names the channels and their messages, by the offsets of its groups."""
    groups = _records(url, offsets)[Opcode.SUMMARY_OFFSET]
    essential = [group for group in groups if group.group_opcode in _ESSENTIAL]
    start = min((group.group_start for group in essential), default=0)
    end = max((group.group_start + group.group_length for group in essential), default=size)
    if end - start > room:
        text = f"its summary has {size - start} bytes, more than {_LONGEST_TAIL}"
        raise LogError(text, _FETCH, shown_url(url))
    return _part(url, start, end, size)


def _summary(
    url: str,
    size: int,
    start: int,
    content: bytes,
) -> LogSummary:
    """Read the records of a summary."""
    found = _records(url, content)
    schemas = {schema.id: schema for schema in found[Opcode.SCHEMA]}
    channels = {channel.id: channel for channel in found[Opcode.CHANNEL]}
    if not found[Opcode.STATISTICS] or not channels:
        text = "its summary does not name the channels and their messages"
        raise LogError(text, _FETCH, shown_url(url))
    statistics = found[Opcode.STATISTICS][0]
    return LogSummary(
        size,
        start,
        content,
        log_channels(channels, schemas, statistics.channel_message_counts),
        statistics,
        tuple(found[Opcode.CHUNK_INDEX]),
        tuple(found[Opcode.METADATA_INDEX]),
        tuple(found[Opcode.ATTACHMENT_INDEX]),
    )


def _records(url: str, content: bytes) -> "defaultdict[int, list[Any]]":
    """Read the records of a summary, by their kind."""
    found = defaultdict[int, list[Any]](list)
    try:
        walked = walk(memoryview(content), len(content))
        for kind, start, length in walked.records.tolist():
            if kind in _RECORDS:
                stream = BytesIO(content[start + HEADER_SIZE : start + HEADER_SIZE + length])
                found[kind].append(_RECORDS[kind].read(ReadDataStream(stream)))
    except (McapError, struct.error, UnicodeDecodeError, EOFError) as error:
        raise LogError(f"its summary cannot be read: {error}", _FETCH, shown_url(url)) from error
    if walked.is_broken:
        raise LogError(
            "its summary cannot be read: there are bytes that are no record",
            _FETCH,
            shown_url(url),
        )
    return found


def _part(
    url: str,
    start: int,
    end: int,
    size: int,
) -> bytes:
    """Read a range of a file that had a size before."""
    content, now = _tail(url, end - start, end)
    _require_size(url, size, now)
    return content


def _require_size(url: str, size: int, now: int) -> None:
    if now != size:
        raise LogError("changed on its server while it was read", "try again", shown_url(url))


def _tail(url: str, count: int, end: int | None = None) -> tuple[bytes, int]:
    """Ask for so many bytes before a place or before the end of a remote file; return them and the file's size."""
    is_web = urlsplit(url).scheme in ("http", "https")
    tail_of = _tail_of_web if is_web else _tail_of_store
    with _refused(url):
        return _within(ANSWERED_S, lambda: tail_of(url, count, end))


def _tail_of_store(url: str, count: int, end: int | None) -> tuple[bytes, int]:
    system, path = _file_system(url)
    size = int(system.info(path)["size"])
    stop = size if end is None else end
    return bytes(system.cat_file(path, start=max(stop - count, 0), end=stop)), size


def _tail_of_web(url: str, count: int, end: int | None) -> tuple[bytes, int]:
    from urllib.error import HTTPError
    from urllib.request import (
        HTTPDefaultErrorHandler,
        HTTPErrorProcessor,
        HTTPHandler,
        HTTPRedirectHandler,
        HTTPSHandler,
        OpenerDirector,
        ProxyHandler,
        Request,
    )

    opener = OpenerDirector()  # without handlers of other schemes, to which a server may redirect
    for handler in (
        ProxyHandler, HTTPHandler, HTTPSHandler, HTTPDefaultErrorHandler, HTTPRedirectHandler, HTTPErrorProcessor,
    ):  # fmt: skip
        opener.add_handler(handler())
    parts = urlsplit(url)
    login, _, host = parts.netloc.rpartition("@")
    headers = {"Accept-Encoding": "identity"}
    headers["Range"] = f"bytes=-{count}" if end is None else f"bytes={end - count}-{end - 1}"
    asked = quote(urlunsplit(parts._replace(netloc=host, fragment="")), safe=_AS_THEY_ARE)
    request = Request(asked, headers=headers)
    if login:
        request.add_unredirected_header(
            "Authorization", f"Basic {b64encode(unquote(login).encode()).decode()}"
        )
    try:
        opened = opener.open(request, timeout=STALLED_S)
    except HTTPError as error:
        error.close()  # it holds the connection
        raise
    with opened as answer:
        if answer.status != 206:  # a part of the content; a server without ranges sends all
            raise LogError("its server does not send parts of files", _FETCH, shown_url(url))
        numbers = re.findall(r"\d+", answer.headers["Content-Range"] or "")
        if len(numbers) != 3:  # first, last, and all
            raise LogError("its server does not say which part it sent", _FETCH, shown_url(url))
        first, last, size = map(int, numbers)
        content = answer.read(count + 1)
        if not len(content) == last - first + 1 <= count or last + 1 != (end or size):
            raise LogError(
                "its server sent other bytes than those asked for", _CHECK, shown_url(url)
            )
        return content, size
