"""Manifests: TOML files that list dives with their digests, licences, settings and tags.

A dive is a path relative to the manifest, or a URL. A URL needs the digest of its log, so that the
same manifest always means the same dives.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Annotated, Final
from urllib.parse import urlsplit

from msgspec import Meta, Struct

from insdvl_replay.batch.found import FoundDive, dive_of_url
from insdvl_replay.core.config_file import SECTIONS, converted, read_toml
from insdvl_replay.core.errors import ConfigError, LogError, UserError, error_context, listed
from insdvl_replay.core.path_kinds import require_kind_of_toml
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.logs.formats.remote import StalledError, fetched, file_digest

_EXAMPLE: Final = '[[dive]] path = "dive.mcap" or url = "https://..." with sha256'


class ManifestDive(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dive."""

    path: str = ""  # of a log, a bag or a folder of tables, relative to the manifest
    url: str = ""  # of a log
    # of the log, as a report has it
    sha256: Annotated[str, Meta(pattern="^([0-9a-fA-F]{64})?$")] = ""
    settings: str = ""  # a file for -c, relative to the manifest
    vehicle: str = ""  # that made it, instead of `vehicle.name` of the settings
    licence: str = ""  # for people
    faults: str = ""  # for people
    tags: tuple[str, ...] = ()


class Manifest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A list of dives."""

    dive: tuple[ManifestDive, ...]


def manifest_dives(file: Path, tag: str = "") -> list[FoundDive]:
    """Return the dives of a manifest, or those with a tag.

    Raises
    ------
    ConfigError
        The manifest is wrong, or no dive has the tag.
    """
    source = read_toml(file, _EXAMPLE, if_unreadable="name a file of dives", if_invalid=_EXAMPLE)
    require_kind_of_toml(file, source.content, "dives", SECTIONS)
    manifest = converted(source.content, Manifest, source)
    if not manifest.dive:
        raise ConfigError(f"{file}: lists no dives", _EXAMPLE)
    for number, dive in enumerate(manifest.dive, 1):
        if bool(dive.path) == bool(dive.url) or (dive.url and not dive.sha256):
            raise ConfigError(
                f"{file}: dive {number}: needs a path, or a url with its sha256", _EXAMPLE
            )
    chosen = [dive for dive in manifest.dive if not tag or tag in dive.tags]
    if not chosen:
        tags = sorted({tag for dive in manifest.dive for tag in dive.tags})
        raise ConfigError(
            f"{file}: no dive has the tag '{tag}'",
            f"its tags are {listed(tags)}" if tags else _EXAMPLE,
        )
    return [_found(dive, file) for dive in chosen]


def _found(dive: ManifestDive, file: Path) -> FoundDive:
    sha256 = dive.sha256.lower()
    settings = file.parent / dive.settings if dive.settings else None
    if dive.url:
        with error_context(file):
            return replace(dive_of_url(dive.url, sha256, settings), vehicle=dive.vehicle)
    return FoundDive(file.parent / dive.path, "", sha256, settings, dive.vehicle)


def fetch_dives(dives: Sequence[FoundDive], *, offline: bool = False) -> list[FoundDive]:
    """Fetch remote logs and compare digests; a dive that cannot be had, or is another, gets its error.

    Offline, those of earlier commands are used, and nothing is fetched.

    A server that stalled is not asked for other dives.
    """
    if not any(dive.sha256 or dive.url for dive in dives):
        return list(dives)
    stopped = Event()
    stalled = set[str]()

    def had(dive: FoundDive) -> FoundDive:
        try:
            if not dive.url:
                _require_digest(dive)
                return dive
            if urlsplit(dive.url).netloc in stalled:
                raise LogError("its server stalled before", "try again later", dive.url)
            path = fetched(dive.url, dive.sha256, stopped.is_set, offline=offline)
            return replace(dive, path=path)
        except UserError as error:
            if isinstance(error, StalledError):
                stalled.add(urlsplit(dive.url).netloc)
            return replace(dive, error=error)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            text = f"cannot be read: {reason}"
            return replace(dive, error=LogError(text, "check the path", dive.url or dive.path))

    found = parallel_map(had, dives, stop=stopped.set)
    return [dive for _, dive in zip(track_progress("fetching logs", dives), found, strict=True)]


def _require_digest(dive: FoundDive) -> None:
    """Raise LogError where a log on this machine is another than the manifest means."""
    if not dive.sha256 or not dive.path.exists():
        return
    digest = _digest(dive.path)
    if digest != dive.sha256:
        text = f"its SHA-256 is {digest}; the manifest says {dive.sha256}"
        raise LogError(text, "restore the log", dive.path)


def _digest(path: Path) -> str:
    if path.is_dir():
        return open_recording(path, allow_damaged=True).sha256()
    return file_digest(path)
