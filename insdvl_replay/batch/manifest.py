"""Manifests: TOML files that list dives with their digests, licences, settings and tags.

A dive is a path relative to the manifest, or a URL that fsspec knows. A URL needs the digest of its log, so that the
same manifest always means the same dives.
"""

from functools import partial
from pathlib import Path
from typing import Annotated, Final

from msgspec import Meta, Struct

from insdvl_replay.batch.dive_paths import FoundDive
from insdvl_replay.core.config_file import converted, read_toml
from insdvl_replay.core.errors import ConfigError, LogError, UserError, listed
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.logs.formats.remote import fetched, file_digest, remote_name

_EXAMPLE: Final = '[[dive]] path = "dive.mcap" or url = "https://..." with sha256'


class ManifestDive(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dive."""

    path: str = ""  # of a log, a bag or a folder of tables, relative to the manifest
    url: str = ""  # of a log
    sha256: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""  # of the log, as a report has it
    settings: str = ""  # a file for -c, relative to the manifest
    licence: str = ""  # for people
    faults: str = ""  # for people
    tags: tuple[str, ...] = ()


class Manifest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A list of dives."""

    dive: tuple[ManifestDive, ...]


def manifest_dives(file: Path, tag: str = "", *, fetch: bool = True) -> list[FoundDive]:
    """Return the dives of a manifest, or those with a tag; a dive that cannot be had or is another has its error.

    Without ``fetch`` a remote log is only named.

    Raises
    ------
    ConfigError
        The manifest is wrong, or no dive has the tag.
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
    found = parallel_map(partial(_found, file.parent, fetch=fetch), chosen)
    return [dive for _, dive in zip(track_progress("fetching dives", chosen), found, strict=True)]


def _found(folder: Path, dive: ManifestDive, *, fetch: bool) -> FoundDive:
    settings, path = folder / dive.settings if dive.settings else None, folder / dive.path
    try:
        if dive.url:
            path = fetched(dive.url, dive.sha256) if fetch else remote_name(dive.url)
        elif dive.sha256 and path.exists() and (digest := _digest(path)) != dive.sha256:
            raise LogError(f"its SHA-256 is {digest}; the manifest says {dive.sha256}", "restore the log", path)
    except UserError as error:
        return FoundDive(path if dive.path else remote_name(dive.url), dive.url, settings, error)
    return FoundDive(path, dive.url, settings)


def _digest(path: Path) -> str:
    return open_recording(path, allow_damaged=True).sha256() if path.is_dir() else file_digest(path)
