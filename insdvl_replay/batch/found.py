"""A dive that is meant: a path or a URL, and what is known of it before it is read."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from insdvl_replay.core.errors import ConfigError, UserError
from insdvl_replay.core.urls import FETCHED, shown_url, url_parts


@dataclass(frozen=True)
class FoundDive:
    """A dive that is meant, and what its manifest says of it."""

    path: Path  # of a remote log, in the cache once it is fetched; before, its name alone
    url: str = ""
    sha256: str = ""  # that it must have
    settings: Path | None = None  # of this dive
    vehicle: str = ""  # that made it; empty: the settings say which
    error: UserError | None = None  # why it cannot be used
    # the files of a folder that is not there; once they are fetched, the path is a folder with them
    parts: tuple["DivePart", ...] = ()

    @property
    def name_giver(self) -> Path:
        """The path after which the dive is named: of a remote log, host and path of its URL."""
        if not self.url:
            return self.path
        place = shown_url(self.url).partition("://")[2].removesuffix("?...")
        return Path("/", *place.split("/"))


@dataclass(frozen=True)
class DivePart:
    """One of several files that are one dive, such as the table of the IMU."""

    name: str  # in the folder of the dive; a table is a topic of this name
    file: FoundDive


Fetch = Callable[[Sequence[FoundDive]], Sequence[FoundDive]]
"""Fetches the remote logs among dives; each dive that cannot be had gets its error."""


def dive_of_url(url: str, sha256: str = "", settings: Path | None = None) -> FoundDive:
    """Return the dive of a URL, by its name alone; nothing is opened.

    Raises
    ------
    ConfigError
        Logs of such URLs are not fetched.
    """
    parts = url_parts(url)
    if parts is None:
        text = f"is no URL of a log: only those of {', '.join(FETCHED)} are fetched, and no chains (::)"
        raise ConfigError(text, "fetch it with another program, and name the file", shown_url(url))
    if parts.scheme == "file":
        if parts.netloc not in ("", "localhost"):
            raise ConfigError("names another computer", "file:///the/whole/path", shown_url(url))
        return FoundDive(Path(unquote(parts.path)), "", sha256, settings)
    from insdvl_replay.logs.formats.remote import remote_name

    return FoundDive(remote_name(url), url, sha256, settings)
