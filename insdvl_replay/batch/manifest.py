"""Manifests: TOML files that list dives with their digests, licences, settings and tags.

A dive is a path relative to the manifest, a URL, or a folder whose files have URLs of their own. A URL needs the
digest of its file, so that the same manifest always means the same dives.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from typing import Annotated, Final
from urllib.parse import urlsplit

from msgspec import Meta, Struct

from insdvl_replay.batch.found import DivePart, FoundDive, dive_of_url
from insdvl_replay.core.config_file import SECTIONS, converted, read_toml
from insdvl_replay.core.errors import ConfigError, LogError, UserError, error_context, listed
from insdvl_replay.core.path_kinds import require_kind_of_toml
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.logs.formats.remote import (
    PassingError,
    StalledError,
    fetched,
    file_digest,
    folder_of_files,
)

_EXAMPLE: Final = '[[dive]] path = "dive.mcap" or url = "https://..." with sha256'
_EXAMPLE_OF_FILES: Final = (
    'path = "dive_7" and files = [{ name = "imu.csv", url = "https://...", sha256 = "..." }]'
)


class ManifestFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One of several files of a dive."""

    name: Annotated[str, Meta(pattern=r"^[^./\\\0][^/\\\0]*$")]  # in the folder of the dive
    url: str
    sha256: Annotated[str, Meta(pattern="^[0-9a-fA-F]{64}$")]


class ManifestDive(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dive."""

    path: str = ""  # of a log, a bag or a folder of tables, relative to the manifest
    url: str = ""  # of a log
    # of the log, as a report has it
    sha256: Annotated[str, Meta(pattern="^([0-9a-fA-F]{64})?$")] = ""
    settings: str = ""  # a file for -c, relative to the manifest
    files: tuple[ManifestFile, ...] = ()  # of the folder `path`, where it is not there
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
        _require_folder(dive, f"{file}: dive {number}")
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


def _require_folder(dive: ManifestDive, place: str) -> None:
    """Raise ConfigError if a dive lists files, and no folder that they are in."""
    if not dive.files:
        return
    if not dive.path or dive.url or dive.sha256:
        text = f"{place}: files need the path of their folder, and neither url nor sha256"
        raise ConfigError(text, _EXAMPLE_OF_FILES)
    names = set[str]()
    for part in dive.files:
        if part.name in names:
            text = f"{place}: two of its files have the name {part.name}"
            raise ConfigError(text, _EXAMPLE_OF_FILES)
        names.add(part.name)


def _found(dive: ManifestDive, file: Path) -> FoundDive:
    sha256 = dive.sha256.lower()
    settings = file.parent / dive.settings if dive.settings else None
    parts = []
    for part in dive.files:
        with error_context(file):
            parts.append(DivePart(part.name, dive_of_url(part.url, part.sha256.lower())))
    if dive.url:
        with error_context(file):
            return replace(dive_of_url(dive.url, sha256, settings), vehicle=dive.vehicle)
    return FoundDive(
        file.parent / dive.path,
        "",
        sha256,
        settings,
        dive.vehicle,
        parts=tuple(parts),
    )


def fetch_dives(
    dives: Sequence[FoundDive],
    *,
    offline: bool = False,
    whole: bool = False,
    pauses_s: Sequence[float] | None = None,
) -> list[FoundDive]:
    """Fetch remote logs and compare digests; a dive that cannot be had, or is another, gets its error.

    Offline, those of earlier commands are used, and nothing is fetched. The ``whole`` log is fetched where its chunks
    of pictures are wanted, too.

    A server that fails is asked again, after pauses of so many seconds. One that failed each time is asked once for
    each other dive, and one that stalled is not asked for them at all.
    """
    if not any(dive.sha256 or dive.url or dive.parts for dive in dives):
        return list(dives)
    stopped = Event()
    servers = _Servers(pauses_s)

    def had(dive: FoundDive) -> FoundDive:
        try:
            if dive.parts:
                return replace(dive, path=_folder_of(dive, had))
            if not dive.url:
                _require_digest(dive)
                return dive
            path = servers.fetched(dive, stopped.is_set, offline=offline, whole=whole)
            return replace(dive, path=path)
        except UserError as error:
            return replace(dive, error=error)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            text = f"cannot be read: {reason}"
            return replace(dive, error=LogError(text, "check the path", dive.url or dive.path))

    found = parallel_map(had, dives, stop=stopped.set)
    return [dive for _, dive in zip(track_progress("fetching logs", dives), found, strict=True)]


@dataclass
class _Servers:
    """The servers of dives, and which of them have failed."""

    pauses_s: Sequence[float] | None  # before each try after one that failed
    _stalled: set[str] = field(default_factory=set)
    _failing: set[str] = field(default_factory=set)

    def fetched(
        self,
        dive: FoundDive,
        is_stopped: Callable[[], bool],
        *,
        offline: bool,
        whole: bool,
    ) -> Path:
        """Return a remote log from the cache, after fetching it if needed."""
        server = urlsplit(dive.url).netloc
        if server in self._stalled:
            raise LogError("its server stalled before", "try again later", dive.url)
        pauses = self.pauses_s
        if server in self._failing:
            pauses = ()
        try:
            path = fetched(
                dive.url,
                dive.sha256,
                is_stopped,
                offline=offline,
                whole=whole,
                pauses_s=pauses,
            )
        except StalledError:
            self._stalled.add(server)
            raise
        except PassingError:
            self._failing.add(server)
            raise
        self._failing.discard(server)
        return path


def _folder_of(dive: FoundDive, had: Callable[[FoundDive], FoundDive]) -> Path:
    """Return the folder with the files of a dive: the one that is there, else one in the cache."""
    if dive.path.exists():
        _require_files(dive)
        return dive.path
    files = {}
    lines = []
    for part in dive.parts:
        file = had(part.file)
        if file.error is not None:
            raise file.error
        files[part.name] = file.path
        lines.append(f"{part.name} {part.file.sha256}\n")
    key = hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()
    return folder_of_files(key, dive.path.name, files)


def _require_files(dive: FoundDive) -> None:
    """Raise LogError where a folder on this machine does not have the files that its manifest lists, and no others."""
    hint = "restore it, or remove it: then its files are fetched"
    others = {path.name for path in dive.path.iterdir()}
    for part in dive.parts:
        digest = "missing"
        if part.name in others:
            digest = file_digest(dive.path / part.name)
            others.remove(part.name)
        if digest != part.file.sha256:
            text = f"the SHA-256 of {part.name} is {digest}; the manifest says {part.file.sha256}"
            raise LogError(text, hint, dive.path)
    if others:
        names = listed(sorted(others))
        raise LogError(f"has {names}, which the manifest does not list", hint, dive.path)


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
