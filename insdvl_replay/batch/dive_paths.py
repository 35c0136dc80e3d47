"""Which dives are meant: logs, bags, folders, patterns and lists of them become one list of paths."""

import glob
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from insdvl_replay.batch.found import FoundDive, dive_of_url
from insdvl_replay.core.dive_record import LOG_SUFFIXES, TABLE_SUFFIXES
from insdvl_replay.core.errors import ConfigError, NaturalKey, natural_key, read_text
from insdvl_replay.core.path_kinds import result_hint, result_named
from insdvl_replay.results.folder import is_result

LIST_SUFFIX: Final = ".txt"
"""Ending of a file that lists dives, one a line."""
MANIFEST_SUFFIX: Final = ".toml"
"""Ending of a file that lists dives with their digests."""
BAG_METADATA: Final = "metadata.yaml"
"""The file by which a bag is known. Names do not show it: dives of an archive are numbered like the parts of a bag."""
PACKED_SUFFIX: Final = ".zstd"
"""Behind the ending of a log that is compressed as a whole."""
INSTRUMENT_SUFFIXES: Final = frozenset(
    {
        ".000",
        ".alog",
        ".bin",
        ".csv",
        ".dat",
        ".ens",
        ".json",
        ".jsonl",
        ".log",
        ".nmea",
        ".pd0",
        ".pd4",
        ".pd5",
        ".pd6",
        ".txt",
        ".ulg",
    }
)
"""Endings under which files of instruments are looked for, by their bytes: those of `known_formats.toml`."""

_LONGEST_LINE: Final = 4096  # letters of a path
# Raised of a path that is too long, has a NUL in it, or has links in a circle.
_UNUSABLE_PATH: Final = (OSError, ValueError, RuntimeError)
_NUMBER: Final = re.compile(r"[+-]?\d+\.?\d*([eE][+-]?\d+)?")
# What a line looks like that names a log or a folder: a URL, a path with a slash, or one word.
_PATHS: Final = tuple(
    map(re.compile, (r"[a-z0-9+]+://.*", r"[^,;{}$]*/[^,;{}$]*", r"[^\W\d][\w.+*?-]*"))
)


def shared_settings(dives: Sequence[FoundDive], command: str) -> Path | None:
    """Return the settings that all dives have by their manifest; those of several vehicles are a ConfigError."""
    files = {dive.settings for dive in dives}
    if len(files) > 1:
        hint = "name one file with -c, or choose dives of one vehicle: a folder, or dives.toml#TAG"
        raise ConfigError(f"{command}: the dives have different settings", hint)
    if files:
        return files.pop()
    return None


def usable_paths(dives: Sequence[FoundDive]) -> list[Path]:
    """Return the files of dives; the first that cannot be used raises its error."""
    for dive in dives:
        if dive.error is not None:
            raise dive.error
    return [dive.path for dive in dives]


def find_dives(
    names: Sequence[str], base: Path = Path(), *, results: bool = False
) -> list[FoundDive]:
    """Find the dives that are meant, in the order of the names, by name below a folder, and each once.

    Nothing is fetched or digested here; `fetch_dives` does that.

    A name is one of these:

    - a log, .mcap, .db3 or .bag, also with .zstd behind it, a table, a file of an instrument or an autopilot, or a
      bag folder;
    - a folder, which stands for every log and bag below it; tables and files of instruments in a folder without logs
      are one dive;
    - a pattern with ``*``, ``?`` or ``**``;
    - a .txt file that names one of these on each line, seen from its own folder; ``#`` begins a comment; where no
      line can be a path, it is a file like any other;
    - a .toml manifest, ``dives.toml#TAG`` for its dives with a tag;
    - a URL of a log: https, http, s3, gs or file.

    Hidden folders are left out. Where a folder or a pattern stands for logs that differ in their ending alone, they are
    one log before and after it was converted, and one of them is taken, .mcap first. Result folders are dives if
    ``results``, else they are left out with the replays in them.

    A name without ``*`` or ``?`` that does not exist is among the dives, so that it is reported like any other log that
    cannot be read; so is a folder that may not be read. A pattern, folder or list without any dive, a list that cannot
    be read, or a name that no file can have is a ConfigError.
    """
    found: dict[str, FoundDive] = {}
    for name in names:
        try:
            for dive in _meant(name, base, results=results):
                first = found.setdefault(dive.url or os.path.realpath(dive.path), dive)
                if _listed_as(first) != _listed_as(dive):
                    text = f"{dive.url or dive.path}: is listed twice, with different settings or digests"
                    raise ConfigError(text, "leave one of them out")
        except _UNUSABLE_PATH as error:
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"{name}: is not a usable path: {reason}", "check the path"
            ) from error
    return list(found.values())


def _listed_as(dive: FoundDive) -> tuple[object, ...]:
    """Return what a list says of a dive that must be the same wherever it is listed."""
    return dive.settings, dive.sha256, dive.parts


def _natural(path: Path) -> tuple[NaturalKey, ...]:
    return tuple(map(natural_key, path.parts))


def _meant(
    name: str,
    base: Path,
    *,
    results: bool,
    lists: bool = True,
) -> list[FoundDive]:
    """Return the dives that a name means: a URL, a manifest, a list, a log, a result or a folder of them."""
    if "://" in name:
        return [dive_of_url(name)]
    listing, _, tag = name.partition("#")
    manifest = base / listing
    if lists and manifest.suffix == MANIFEST_SUFFIX and manifest.is_file():
        from insdvl_replay.batch.manifest import manifest_dives

        return manifest_dives(manifest, tag)
    path = base / name
    lines = _listed(path) if lists else None
    if lines is None:
        found = [FoundDive(dive) for dive in _local(path, results=results)]
    else:
        found = []
        for line in lines:
            found += _meant(line, path.parent, results=results, lists=False)
    if not results and found in ([], [FoundDive(path)]):
        _require_no_result(path)
    if not found:
        kinds = "logs, bags or results" if results else "logs, bags or tables"
        raise ConfigError(f"{path}: no dive is found there", f"check the path: it needs {kinds}")
    return found


def _require_no_result(path: Path) -> None:
    """Raise ConfigError where a result is named in the place of a log."""
    result = result_named(path)
    if result is not None and is_result(result):
        raise ConfigError(f"{path}: is a result, not a log", result_hint(result))


def _listed(path: Path) -> list[str] | None:
    """Return the names that a list has, line by line; None where the file is no list, but data or a log."""
    if path.suffix != LIST_SUFFIX or not path.is_file() or _is_of_instrument(path):
        return None
    try:
        lines = [line.strip() for line in read_text(path).splitlines()]
    except UnicodeDecodeError:
        return None
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read as a list of dives: {error}", "one path a line, UTF-8"
        ) from error
    names = [line for line in lines if line and not line.startswith("#")]
    if not names or any(_can_be_path(name, path.parent) for name in names):
        return names
    return None


def _can_be_path(line: str, folder: Path) -> bool:
    """Return whether a line of a list can name a dive: it is there, or it looks like a path and not like data."""
    if "\0" in line or len(line) > _LONGEST_LINE:
        return False
    if os.path.exists(folder / line):  # noqa: PTH110  # a Path raises where the name is too long
        return True
    numbers = [cell for cell in re.split(r"[,;\s]+", line) if _NUMBER.fullmatch(cell)]
    if len(numbers) > 1:
        return False
    is_log = Path(line).suffix.lower() in (*LOG_SUFFIXES, *TABLE_SUFFIXES, MANIFEST_SUFFIX)
    return is_log or any(form.fullmatch(line) for form in _PATHS)


def _local(path: Path, *, results: bool) -> list[Path]:
    """Return the dives of a file, a folder or a pattern."""
    if path.is_dir():
        return list(_in_folder(path, set(), results=results))
    if path.exists() or not set("*?[") & set(str(path)):
        return [path]
    seen: set[str] = set()
    found: list[Path] = []
    for match in _once_each(sorted(set(_globbed(path)), key=_natural)):
        if match.is_dir():
            found += _in_folder(match, seen, results=results)
        elif _is_log(match) or match.suffix in TABLE_SUFFIXES or _is_of_instrument(match):
            found.append(match)
    return found


def _globbed(pattern: Path) -> Iterator[Path]:
    """Yield what a pattern is like; ``**`` stands for a folder and all below it, and follows no links."""
    if "**" not in pattern.parts:
        yield from map(Path, glob.glob(str(pattern)))  # noqa: PTH207  # of a pattern from any root
        return
    at = pattern.parts.index("**")
    rest = pattern.parts[at + 1 :]
    for above in glob.glob(str(Path(*pattern.parts[:at]))):  # noqa: PTH207
        unread: list[OSError] = []
        for folder, below, _ in os.walk(above, onerror=unread.append):
            below[:] = [name for name in below if not name.startswith(".")] if rest else []
            yield from _globbed(Path(glob.escape(folder), *rest)) if rest else [Path(folder)]
        yield from (Path(error.filename) for error in unread)


def _once_each(paths: Sequence[Path]) -> list[Path]:
    """Leave out the logs that are there converted, too."""
    there = set(paths)
    better = {suffix: LOG_SUFFIXES[:place] for place, suffix in enumerate(LOG_SUFFIXES)}
    return [
        path
        for path in paths
        if there.isdisjoint(map(path.with_suffix, better.get(path.suffix, ())))
    ]


def _has_dives(folder: Path) -> bool:
    """Return whether a folder is a result, or holds logs, bags or results."""
    if is_result(folder):
        return True
    for path in folder.rglob("*"):
        if (
            _is_log(path)
            or path.name == BAG_METADATA
            or _is_vehicles_log(path)
            or (path.is_dir() and is_result(path))
        ):
            return True
    return False


def _in_folder(folder: Path, seen: set[str], *, results: bool) -> Iterator[Path]:
    """Yield the dives in a folder and below it. Links are followed, and each folder is entered once."""
    real = os.path.realpath(folder)
    if real in seen:
        return
    seen.add(real)
    try:
        if is_result(folder):
            if results:
                yield folder
            return
        if (folder / BAG_METADATA).is_file():
            yield folder
            return
        logs = _logs_in(folder)
        folders = _folders_in(folder)
        is_dive = _is_of_tables(folder, logs, folders)
    except PermissionError:
        yield folder  # as a dive that cannot be read
        return
    if is_dive:
        yield folder
    for path in sorted([*_once_each(logs), *folders], key=_natural):
        if path.is_dir():
            yield from _in_folder(path, seen, results=results)
        else:
            yield path


def _logs_in(folder: Path) -> list[Path]:
    logs = list[Path]()
    for suffix in LOG_SUFFIXES:
        for path in folder.glob(f"*{suffix}"):
            if path.is_file():
                logs.append(path)
        for path in folder.glob(f"*{suffix}{PACKED_SUFFIX}"):
            # One that the user has unpacked is read so.
            if path.is_file() and path.with_suffix("") not in logs:
                logs.append(path)
    logs += filter(_is_vehicles_log, folder.iterdir())
    return logs


def _is_log(path: Path) -> bool:
    """Return whether a file is named as a log, which may be compressed as a whole."""
    if path.suffix == PACKED_SUFFIX:
        return path.with_suffix("").suffix in LOG_SUFFIXES
    return path.suffix in LOG_SUFFIXES


def _is_of_instrument(path: Path, *, is_dive: bool | None = None) -> bool:
    """Return whether a file is what an instrument or an autopilot wrote, or such a file that is a dive of its own."""
    if path.suffix.lower() not in INSTRUMENT_SUFFIXES:
        return False
    # It is loaded late, since it takes longer than the look at a folder.
    from insdvl_replay.logs.formats.known_formats import instrument_format

    known = instrument_format(path)
    return known is not None and is_dive in (None, known.is_dive)


def _is_vehicles_log(path: Path) -> bool:
    """Return whether a file is what an autopilot recorded of a dive."""
    return _is_of_instrument(path, is_dive=True)


def _is_part_of_dive(path: Path) -> bool:
    """Return whether a file is a table, or what an instrument wrote."""
    return path.suffix.lower() in TABLE_SUFFIXES or _is_of_instrument(path)


def _folders_in(folder: Path) -> list[Path]:
    """Return the folders in a folder but for hidden ones."""
    folders = list[Path]()
    for entry in os.scandir(folder):
        is_hidden = entry.name.startswith(".")
        if entry.is_dir() and not is_hidden:
            folders.append(Path(entry))
    return folders


def _is_of_tables(folder: Path, logs: Sequence[Path], folders: Sequence[Path]) -> bool:
    """Return whether a folder is a dive of tables or of instruments. In an archive such files lie beside the dives."""
    if logs or not any(map(_is_part_of_dive, folder.iterdir())):
        return False
    return not any(map(_has_dives, folders))
