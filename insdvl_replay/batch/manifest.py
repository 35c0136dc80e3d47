"""Manifests: TOML files that list dives with their digests, licences and tags. Remote logs are kept by their digest.

A dive is a path relative to the manifest, or a URL that fsspec knows. Nobody can tell whether a remote log is still the
same without its digest, so a URL needs one. A log that has been fetched once is not asked for again.
"""

import hashlib
import os
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final
from urllib.parse import unquote, urlsplit

from msgspec import Meta, Struct

from insdvl_replay.core.config_file import converted, read_toml
from insdvl_replay.core.errors import ConfigError, LogError, listed
from insdvl_replay.core.runtime import track_progress

_EXAMPLE: Final = '[[dive]] path = "dive.mcap" or url = "https://..." with sha256'


class ManifestDive(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dive."""

    path: str = ""  # of a log, a bag or a folder of tables, relative to the manifest
    url: str = ""  # of a log
    sha256: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""  # of the log, as a report has it
    licence: str = ""  # for people
    tags: tuple[str, ...] = ()


class Manifest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A list of dives."""

    dive: tuple[ManifestDive, ...]


def manifest_dives(file: Path, tag: str = "") -> list[Path]:
    """Return the dives of a manifest, or those with a tag, as files whose digests are right.

    Raises
    ------
    ConfigError
        The manifest is wrong, or no dive has the tag.
    LogError
        A log cannot be fetched, or its digest is another one.
    """
    source = read_toml(file, _EXAMPLE, if_unreadable="name a file of dives", if_invalid=_EXAMPLE)
    manifest = converted(source.content, Manifest, source)
    for number, dive in enumerate(manifest.dive, 1):
        if bool(dive.path) == bool(dive.url) or (dive.url and not dive.sha256):
            raise ConfigError(f"{file}: dive {number}: needs a path, or a url with its sha256", _EXAMPLE)
    chosen = [dive for dive in manifest.dive if not tag or tag in dive.tags]
    if not chosen:
        tags = sorted({tag for dive in manifest.dive for tag in dive.tags})
        raise ConfigError(f"{file}: no dive has the tag '{tag}'", f"its tags are {listed(tags)}" if tags else _EXAMPLE)
    paths = []
    for dive in track_progress("fetching dives", chosen):
        path = file.parent / dive.path if dive.path else _fetched(dive.url, dive.sha256)
        if dive.path and dive.sha256 and path.exists() and (digest := _digest(path)) != dive.sha256:
            raise LogError(f"its SHA-256 is {digest}; the manifest says {dive.sha256}", "restore the log", path)
        paths.append(path)
    return paths


def _digest(path: Path) -> str:
    if path.is_dir():
        from insdvl_replay.logs.formats.recording import open_recording  # which knows the order of the parts

        return open_recording(path, allow_damaged=True).sha256()
    with path.open("rb") as log:
        return hashlib.file_digest(log, "sha256").hexdigest()


def cache_folder() -> Path:
    """Return the folder of logs that were fetched; each is in a folder that has its digest as name."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "insdvl-replay" / "logs"


def _fetched(url: str, sha256: str) -> Path:
    """Return a remote log from the cache, after fetching it if it is not there; one with another digest is not kept."""
    kept = cache_folder() / sha256 / (Path(unquote(urlsplit(url).path)).name or "dive.mcap")
    if kept.is_file() and _digest(kept) == sha256:
        return kept
    try:
        import fsspec
    except ImportError as error:
        raise ConfigError(f"{url}: needs the package fsspec", "pip install 'insdvl-replay[remote]'") from error
    kept.parent.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=kept.parent.parent, prefix=".part") as folder:
        part = Path(folder) / kept.name
        try:
            with fsspec.open(url, "rb") as remote, part.open("wb") as target:
                shutil.copyfileobj(remote, target, 1 << 20)
        except Exception as error:  # whatever a library makes of a server
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise LogError(f"cannot be fetched: {reason}", "check the URL and the connection", url) from error
        if (digest := _digest(part)) != sha256:
            hint = "ask who offers it; nothing was kept"
            raise LogError(f"the SHA-256 of what was sent is {digest}; the manifest says {sha256}", hint, url)
        kept.parent.mkdir(exist_ok=True)
        part.replace(kept)
    return kept
