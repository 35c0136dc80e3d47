"""A bag: a folder in which a recorder that split its recording left several MCAP files."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.plain_text import read_text

METADATA: Final = "metadata.yaml"
"""File in which rosbag2 lists the parts of a bag."""

_INFORMATION: Final = "rosbag2_bagfile_information"
_DEEPEST: Final = 50
_PACKED: Final = ".zstd"
"""Ending of parts that rosbag2 compressed as a whole."""


def bag_parts(path: Path) -> tuple[Path, ...]:
    """Find the files of a bag.

    Parameters
    ----------
    path : Path
        A folder.

    Returns
    -------
    tuple of Path
        As the metadata lists them, else all that there are.

    Raises
    ------
    LogError
        There are none, one that is listed is not there, one that is there is not listed, or one is compressed as a
        whole.
    """
    listed = _listed(path / METADATA)
    found = sorted(path.glob("*.mcap"))
    if listed is None:
        parts = tuple(found)
    else:
        parts = tuple(_unpacked(path / name) for name in listed)
        _require_all(path / METADATA, parts, found)
    for packed in sorted(path.glob(f"*.mcap{_PACKED}")):
        if packed.with_suffix("") not in parts:
            raise LogError(f"{packed}: is compressed as a whole with zstd", f"`zstd -d {packed}` unpacks it")
    if not parts:
        raise LogError(f"{path}: is a folder without .mcap files", "name a log, or a folder with the parts of one")
    return parts


def _unpacked(part: Path) -> Path:
    """Give the part that the user has unpacked, where the metadata lists it as it was packed."""
    plain = part.with_suffix("") if part.suffix == _PACKED else part
    return plain if _is_file(plain) else part


def _is_file(path: Path) -> bool:
    """Tell whether a file is there; a name that cannot be one is none."""
    return os.path.isfile(path)  # noqa: PTH113  # a Path raises where the name is too long


def _require_all(metadata: Path, parts: tuple[Path, ...], found: list[Path]) -> None:
    for part in parts:
        if not _is_file(part):
            raise LogError(
                f"{metadata}: lists {part.name}, which is not there",
                f"copy the whole bag, or read the parts that are there: {_by_name(metadata)}",
            )
    for other in found:
        if other not in parts:
            raise LogError(
                f"{metadata}: does not list {other.name}, which lies beside the parts of the bag",
                f"move it away, or read all .mcap files of the folder: {_by_name(metadata)}",
            )


def _by_name(metadata: Path) -> str:
    """Say how a bag is read without its list."""
    return f"{metadata.parent / '*.mcap'} --one-dive"


def _is_plain(events: Iterable[Any]) -> bool:
    """Tell whether a YAML text is about as large as what it stands for: aliases multiply it."""
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
            raise LogError(f"{metadata}: has aliases or deep nesting, which no recorder writes", by_name)
        content: Any = yaml.load(text)
    except OSError as error:
        raise LogError(f"{metadata}: cannot be read: {error.strerror}", by_name) from error
    except (YAMLError, ValueError, RecursionError) as error:  # also a day or a number that cannot be
        raise LogError(f"{metadata}: is no YAML", by_name) from error
    information = content.get(_INFORMATION) if isinstance(content, dict) else None
    names = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise LogError(f"{metadata}: lists no files", by_name)
    return names
