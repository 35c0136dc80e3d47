"""What a path is that was given where something else is expected: a log, a result, or a TOML file of another kind.

The rules look at names and at the top keys of TOML files, and open nothing else: they serve error messages.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import ConfigError

REPORT: Final = "report.json"  # the file that identifies a result folder
# of a run of several dives, beside their folders, which its column `log` names
SUMMARY: Final = "summary.csv"
PAGES: Final = ("report.html", "index.html")
TomlKind = Literal["settings", "gates", "dives"]

# What each kind of TOML file is for: its words in a sentence, and the command that takes it.
_CONTENT: Final[Mapping[TomlKind, str]] = {
    "settings": "settings",
    "gates": "gates",
    "dives": "a list of dives",
}
_USE: Final[Mapping[TomlKind, str]] = {
    "settings": "settings are given with -c: `insdvl-replay run LOG -c {path}`",
    "gates": "gates are checked by `insdvl-replay check {path}`",
    "dives": "dives are given as logs: `insdvl-replay run {path}`",
}


def looks_like_log(path: str | Path) -> bool:
    """Return whether a path names a log: by its ending, as a URL, or as the folder of a bag."""
    text = str(path)
    if Path(text).is_dir():
        return Path(text, "metadata.yaml").is_file()
    return "://" in text or text.lower().endswith(LOG_SUFFIXES)


def result_named(path: Path) -> Path | None:
    """Return the result folder that a path names, as a folder or by one of its files; None for another path."""
    if (path / REPORT).is_file():
        return path
    is_file_of_result = path.name == REPORT or path.name in PAGES
    if is_file_of_result and path.is_file():
        return path.parent
    return None


def replay_hint(path: str | Path) -> str:
    """Return the hint for a log where a result is expected."""
    return f"replay it first: `insdvl-replay run {path}`. To compare two settings on it: --against KEY=VALUE"


def result_hint(folder: Path) -> str:
    """Return the hint for a result where a log is expected."""
    return (
        f"name the log that was replayed. To see the result: {folder / PAGES[0]}. To compare results: "
        f"`insdvl-replay compare OLD {folder}`"
    )


def require_kind_of_toml(
    path: Path,
    content: Mapping[str, Any],
    wanted: TomlKind,
    sections: frozenset[str],
) -> None:
    """Require that a TOML file is not clearly of another kind, by its top keys.

    Parameters
    ----------
    path : Path
        The file, for the sentence.
    content : mapping
        What is in it.
    wanted : str
        The kind that is expected: ``settings``, ``gates`` or ``dives``.
    sections : frozenset of str
        The sections of the settings.

    Raises
    ------
    ConfigError
        The file is of another kind. The hint is the command that takes it.
    """
    found = _kind_of_toml(content, sections)
    if found is None or found == wanted:
        return
    raise ConfigError(
        f"{path}: holds {_CONTENT[found]}, not {_CONTENT[wanted]}", _USE[found].format(path=path)
    )


def _kind_of_toml(content: Mapping[str, Any], sections: frozenset[str]) -> TomlKind | None:
    if isinstance(content.get("gate"), list):
        return "gates"
    if isinstance(content.get("dive"), list):
        return "dives"
    is_settings = bool(content) and all(
        key in sections and isinstance(content[key], dict) for key in content
    )
    if is_settings:
        return "settings"
    return None
