"""Which dives are meant: logs, bags, folders, patterns and lists of them become one list of paths."""

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from insdvl_replay.core.dive_record import LOG_SUFFIXES
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.plain_text import NaturalKey, is_writable, natural_key, read_text
from insdvl_replay.results.folder import is_result

LIST_SUFFIX: Final = ".txt"
"""Ending of a file that lists dives, one a line."""
BAG_METADATA: Final = "metadata.yaml"
"""The file by which a bag is known. Names do not show it: dives of an archive are numbered like the parts of a bag."""

_MAGIC: Final = frozenset("*?[")


def find_dives(names: Sequence[str], beside: Path = Path(), *, results: bool = False) -> list[Path]:
    """Find the dives that are meant.

    A name is a log, .mcap, .db3 or .bag; a bag folder; a folder, which stands for every log and bag below it; a pattern
    with ``*``, ``?`` or ``**``; or a .txt file that names one of these on each line, seen from its own folder, ``#``
    begins a comment. Hidden folders are passed over. Where a folder or a pattern stands for logs that differ in their
    ending alone, they are one log before and after it was converted, and one of them is taken, .mcap first.

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
        ``*`` or ``?`` that does not exist is among them, so that it is reported like any other log that cannot be read.

    Raises
    ------
    ConfigError
        A pattern, folder or list without any dive, a list that cannot be read, or a name that no file can have or that
        is not UTF-8.
    """
    found: dict[str, Path] = {}
    for name in names:
        try:
            for dive in _meant(name, beside, results=results):
                found.setdefault(_real(dive), dive)
        except (OSError, ValueError, RuntimeError) as error:  # too long, NUL in it, links in a circle
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(f"{name}: cannot be looked for: {reason}", "check the path") from error
    for dive in found.values():
        if not is_writable(str(dive)):
            raise ConfigError(f"{dive}: its name is not UTF-8, so no result could bear it", "rename it")
    return list(found.values())


def _natural(path: Path) -> tuple[NaturalKey, ...]:
    return tuple(map(natural_key, path.parts))


def _meant(name: str, beside: Path, *, results: bool, lists: bool = True) -> list[Path]:
    path = beside / name
    if lists and path.suffix == LIST_SUFFIX and path.is_file():
        found = [dive for line in _lines(path) for dive in _meant(line, path.parent, results=results, lists=False)]
    elif path.is_dir():
        found = list(_in_folder(path, results=results))
    elif path.exists() or not _MAGIC & set(name):
        return [path]
    else:
        matches = sorted(map(Path, glob.glob(str(path), recursive=True)), key=_natural)  # noqa: PTH207  # follows `**` from any root
        found = [dive for match in _once_each(matches) for dive in _matched(match, results=results)]
    if not found:
        kinds = "logs, bags or results" if results else "logs or bags"
        raise ConfigError(f"{path}: no dive is found there", f"{kinds} are looked for; is the path seen from here?")
    return found


def _matched(path: Path, *, results: bool) -> Iterator[Path]:
    """Take from a pattern's matches what can be a dive."""
    if path.is_dir():
        yield from _in_folder(path, results=results)
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


def _in_folder(folder: Path, *, results: bool, above: frozenset[str] = frozenset()) -> Iterator[Path]:
    real = _real(folder)
    if real in above:  # a link leads back up
        return
    if is_result(folder):
        if results:
            yield folder
        return
    if (folder / BAG_METADATA).is_file():
        yield folder
        return
    logs = [path for suffix in LOG_SUFFIXES for path in folder.glob(f"*{suffix}") if path.is_file()]
    folders = [Path(entry) for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith(".")]
    for path in sorted([*_once_each(logs), *folders], key=_natural):
        if path.is_dir():
            yield from _in_folder(path, results=results, above=above | {real})
        else:
            yield path


def _lines(path: Path) -> list[str]:
    try:
        lines = read_text(path).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a list of dives: {error}", "one path a line, UTF-8") from error
    return [line.strip() for line in lines if line.strip() and not line.strip().startswith("#")]
