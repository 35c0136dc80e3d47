"""What can be read: a log, several files that are one dive, or a bag, the folder of a recorder that split its file."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.plain_text import read_text
from insdvl_replay.logs.container.mcap_file import Log
from insdvl_replay.logs.container.parts import Parts

METADATA: Final = "metadata.yaml"
"""File in which rosbag2 lists the parts of a bag."""

_INFORMATION: Final = "rosbag2_bagfile_information"
_DEEPEST: Final = 50
_PACKED: Final = ".zstd"
"""Ending of parts that rosbag2 compressed as a whole."""


def bag_parts(path: Path) -> tuple[Path, ...]:
    """Find the files of a bag."""
    listed = _listed(path / METADATA)
    found = sorted(path.glob("*.mcap"))
    if listed is None:
        parts = tuple(found)
    else:
        parts = tuple(_unpacked(path / name) for name in listed)
        _require_all(path / METADATA, parts, found)
    for packed in sorted(path.glob(f"*.mcap{_PACKED}")):
        if packed.with_suffix("") not in parts:
            raise LogError("is compressed as a whole with zstd", f"`zstd -d {packed}` unpacks it", packed)
    if not parts:
        raise LogError("is a folder without .mcap files", "name a log, or a folder with the parts of one", path)
    return parts


def _unpacked(part: Path) -> Path:
    """Return the part that the user has unpacked, where the metadata lists it as it was packed."""
    plain = part.with_suffix("") if part.suffix == _PACKED else part
    return plain if _is_file(plain) else part


def _is_file(path: Path) -> bool:
    """Return whether a file is there; a name that cannot be one is none."""
    return os.path.isfile(path)  # noqa: PTH113  # a Path raises where the name is too long


def _require_all(metadata: Path, parts: tuple[Path, ...], found: list[Path]) -> None:
    for part in parts:
        if not _is_file(part):
            raise LogError(
                f"lists {part.name}, which is not there",
                f"copy the whole bag, or read the parts that are there: {_by_name(metadata)}",
                metadata,
            )
    for other in found:
        if other not in parts:
            raise LogError(
                f"does not list {other.name}, which lies beside the parts of the bag",
                f"move it away, or read all .mcap files of the folder: {_by_name(metadata)}",
                metadata,
            )


def _by_name(metadata: Path) -> str:
    """State how a bag is read without its list."""
    return f"{metadata.parent / '*.mcap'} --one-dive"


def _is_plain(events: Iterable[Any]) -> bool:
    """Return whether a YAML text is about as large as what it stands for: aliases multiply it."""
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    depth = 0
    for event in events:
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > _DEEPEST or isinstance(event, AliasEvent):
            return False
    return True


def _listed(metadata: Path) -> list[str] | None:
    """Read which parts the metadata names; None where there is none."""
    if not metadata.is_file():
        return None
    # Imported here, since few logs are bags and it takes a while.
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    by_name = f"read the .mcap files beside it: {_by_name(metadata)}"
    try:
        text, yaml = read_text(metadata), YAML(typ="safe", pure=True)
        if not _is_plain(yaml.parse(text)):
            raise LogError("has aliases or deep nesting, which no recorder writes", by_name, metadata)
        content: Any = yaml.load(text)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", by_name, metadata) from error
    except (YAMLError, ValueError, RecursionError) as error:  # also a day or a number that cannot be
        raise LogError("is no YAML", by_name, metadata) from error
    information = content.get(_INFORMATION) if isinstance(content, dict) else None
    names = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise LogError("lists no files", by_name, metadata)
    return names


Recording = Log | Parts
"""What can be read."""


def open_recording(path: Path | Sequence[Path], *, allow_damaged: bool = False) -> Recording:
    """Open a log, a bag, or several of them as one.

    Parameters
    ----------
    path : Path or sequence of Path
        An MCAP file, a folder of them, or several; their order does not matter.
    allow_damaged : bool
        Read what can be believed of damaged files.

    Raises
    ------
    LogError
        It cannot be read.
    """
    given = (path,) if isinstance(path, Path) else tuple(path)
    if len(given) == 1 and not given[0].is_dir():
        return Log(given[0], allow_damaged=allow_damaged)
    files = [file for one in given for file in (bag_parts(one) if one.is_dir() else (one,))]
    # A file that is named twice is read once.
    unique = {os.path.realpath(file): file for file in files}
    return Parts(name_giver(given), unique.values(), allow_damaged=allow_damaged)


def name_giver(paths: Sequence[Path]) -> Path:
    """Find after which of several paths what they hold together is named: the first by its name.

    Parameters
    ----------
    paths : sequence of Path
        At least one, in any order.
    """
    return min(paths, key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[str, int]]:
    """Sort names as people count: part 2 before part 10."""
    return [(word, int(digits or 0)) for word, digits in re.findall(r"(\D*)(\d*)", path.name)]
