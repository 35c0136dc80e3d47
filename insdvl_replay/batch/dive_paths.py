"""Which dives are meant: logs, bags, folders, patterns and lists of them become one list of paths."""

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.plain_text import NaturalKey, natural_key, read_text
from insdvl_replay.results.folder import is_result

LIST_SUFFIX: Final = ".txt"
"""Ending of a file that lists dives, one a line."""
BAG_METADATA: Final = "metadata.yaml"
"""The file by which a bag is known. Names do not show it: dives of an archive are numbered like the parts of a bag."""

_MAGIC: Final = frozenset("*?[")
_NO_DIVES: Final = frozenset(("/proc", "/sys"))
"""Folders that a walk does not enter: what is in them is no file, and has no end."""
_MOST_FOLDERS: Final = 100_000
"""That a walk enters, as many as an archive of all dives of a fleet has."""


def find_dives(names: Sequence[str], beside: Path = Path(), *, results: bool = False) -> list[Path]:
    """Find the dives that are meant.

    A name is a log, .mcap, .db3 or .bag; a bag folder; a folder, which stands for every log and bag below it; a pattern
    with ``*``, ``?`` or ``**``; or a .txt file that names one of these on each line, seen from its own folder, ``#``
    begins a comment. Hidden folders, /proc and /sys are left out, and ``**`` follows no links. Where a folder or a
    pattern stands for logs that differ in their ending alone, they are one log before and after it was converted, and
    one of them is taken, .mcap first.

    Parameters
    ----------
    beside : Path
        Folder from which relative names are seen.
    results : bool
        Result folders are dives, too. Otherwise they are passed over, with the replays in them.

    Returns
    -------
    list of Path
        In the order of the names, and by name below a folder; each once, however often it is meant. A name without
        ``*`` or ``?`` that does not exist is among them, so that it is reported like any other log that cannot be read;
        so is a folder that may not be read.

    Raises
    ------
    ConfigError
        A pattern, folder or list without any dive, a list that cannot be read, or a name that no file can have.
    """
    found: dict[str, Path] = {}
    for name in names:
        try:
            for dive in _meant(name, beside, results=results):
                found.setdefault(_real(dive), dive)
        except (OSError, ValueError, RuntimeError) as error:  # too long, NUL in it, links in a circle
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(f"{name}: cannot be looked for: {reason}", "check the path") from error
    return list(found.values())


def _natural(path: Path) -> tuple[NaturalKey, ...]:
    return tuple(map(natural_key, path.parts))


def _meant(name: str, beside: Path, *, results: bool, lists: bool = True) -> list[Path]:
    path, seen = beside / name, set[str]()
    if lists and path.suffix == LIST_SUFFIX and path.is_file():
        found = [dive for line in _lines(path) for dive in _meant(line, path.parent, results=results, lists=False)]
    elif path.is_dir():
        found = list(_in_folder(path, seen, results=results))
    elif path.exists() or not _MAGIC & set(name):
        return [path]
    else:
        matches = sorted(set(_globbed(path, seen)), key=_natural)
        seen.clear()
        found = [dive for match in _once_each(matches) for dive in _matched(match, seen, results=results)]
    if not found:
        kinds = "logs, bags or results" if results else "logs or bags"
        raise ConfigError(f"{path}: no dive is found there", f"{kinds} are looked for; is the path seen from here?")
    return found


def _globbed(pattern: Path, seen: set[str]) -> Iterator[Path]:
    """Find what a pattern is like; for ``**`` stand a folder and all below it."""
    if "**" not in pattern.parts:
        yield from map(Path, glob.glob(str(pattern)))  # noqa: PTH207  # of a pattern from any root
        return
    at = pattern.parts.index("**")
    rest = pattern.parts[at + 1 :]
    for above in glob.glob(str(Path(*pattern.parts[:at]))):  # noqa: PTH207
        if not rest:
            yield Path(above)
            continue
        unread = list[OSError]()
        for folder, below, _ in os.walk(above, onerror=unread.append):
            below[:] = (
                [name for name in below if not name.startswith(".")] if _enters(_real(Path(folder)), seen) else []
            )
            yield from _globbed(Path(glob.escape(folder), *rest), seen)
        yield from (Path(error.filename) for error in unread)


def _enters(real: str, seen: set[str]) -> bool:
    """Return whether a walk goes into a folder, which it does once."""
    if real in seen or real in _NO_DIVES or not _NO_DIVES.isdisjoint(map(str, Path(real).parents)):
        return False
    seen.add(real)
    if len(seen) > _MOST_FOLDERS:
        raise ValueError(f"there are more than {_MOST_FOLDERS} folders below it")
    return True


def _matched(path: Path, seen: set[str], *, results: bool) -> Iterator[Path]:
    """Take from a pattern's matches what can be a dive."""
    if path.is_dir():
        yield from _in_folder(path, seen, results=results)
    elif path.suffix in LOG_SUFFIXES:
        yield path


def _once_each(paths: Sequence[Path]) -> list[Path]:
    """Leave out the logs that stand there converted, too."""
    there = set(paths)
    better = {suffix: LOG_SUFFIXES[:place] for place, suffix in enumerate(LOG_SUFFIXES)}
    return [path for path in paths if there.isdisjoint(map(path.with_suffix, better.get(path.suffix, ())))]


def _real(path: Path) -> str:
    """Follow links; one that leads to itself stays as it is, and is reported when it is read."""
    return os.path.realpath(path)


def _in_folder(folder: Path, seen: set[str], *, results: bool) -> Iterator[Path]:
    if not _enters(_real(folder), seen):
        return
    try:
        if is_result(folder):
            if results:
                yield folder
            return
        if (folder / BAG_METADATA).is_file():
            yield folder
            return
        logs = [path for suffix in LOG_SUFFIXES for path in folder.glob(f"*{suffix}") if path.is_file()]
        folders = [Path(entry) for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith(".")]
    except PermissionError:
        yield folder  # as a dive that cannot be read
        return
    for path in sorted([*_once_each(logs), *folders], key=_natural):
        if path.is_dir():
            yield from _in_folder(path, seen, results=results)
        else:
            yield path


def _lines(path: Path) -> list[str]:
    try:
        lines = read_text(path).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a list of dives: {error}", "one path a line, UTF-8") from error
    return [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]
