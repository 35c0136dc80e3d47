"""Which files of OLD, NEW and TRUTH are runs of the same dive.

A folder has a file for each run. Files of the same name are of one dive, and files of one name in several folders of a
side, such as ``run_1/dive_3.tum`` and ``run_2/dive_3.tum``, are repeated runs of it.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from insdvl_replay.core.dive_record import LOG_SUFFIXES, TABLE_SUFFIXES, dive_name
from insdvl_replay.core.errors import ConfigError, Note, listed, natural_key
from insdvl_replay.core.notes import note

SUFFIXES: Final = (".tum", ".txt", *TABLE_SUFFIXES, *LOG_SUFFIXES)
_BAG: Final = "metadata.yaml"
_TOPIC: Final = ":/"


@dataclass(frozen=True)
class Given:
    """One side, as it was named: a file or a folder, and a topic of logs."""

    path: Path
    topic: str = ""

    @property
    def text(self) -> str:
        """How it is named."""
        if self.topic:
            return f"{self.path}:{self.topic}"
        return str(self.path)


@dataclass(frozen=True)
class RunFile:
    """The file of a run."""

    path: Path
    topic: str
    parts: tuple[str, ...]  # its place below the side, without the ending

    @property
    def repeat(self) -> str:
        """The folder that tells repeated runs of a dive apart."""
        return "/".join(self.parts[:-1])


@dataclass(frozen=True)
class Side:
    """All runs of one side."""

    name: str
    given: Given
    files: Sequence[RunFile]
    is_file: bool = False  # it is one file, which belongs to any dive


@dataclass(frozen=True)
class DiveFiles:
    """The files of one dive."""

    name: str
    truth: RunFile
    old: Sequence[RunFile]
    new: dict[str, list[RunFile]] = field(default_factory=dict)  # by candidate


def parse_given(text: str) -> Given:
    """Read a side: a path, or a path and a topic of logs such as ``dive.mcap:/odom``."""
    if not text:
        raise ConfigError("a side is empty", "name a folder or a file with trajectories")
    path = Path(text)
    if _TOPIC in text and not path.exists():
        place, _, topic = text.rpartition(_TOPIC)
        return Given(Path(place), f"/{topic}")
    return Given(path)


def find_side(name: str, given: Given) -> tuple[Side, list[Note]]:
    """Find the runs of a side; a ConfigError if there are none."""
    path = given.path
    if not path.exists():
        raise ConfigError(f"{path}: is not there", "check the path of the trajectories")
    if not path.is_dir() or (path / _BAG).is_file():
        file = RunFile(path, given.topic, (dive_name(path),))
        return Side(name, given, [file], is_file=True), []
    files = list[RunFile]()
    others = list[str]()
    for found in _files_below(path):
        if found.is_dir() or found.suffix.lower() in SUFFIXES:
            below = found.relative_to(path)
            files.append(RunFile(found, given.topic, (*below.parts[:-1], dive_name(found))))
        else:
            others.append(found.name)
    if not files:
        hint = f"it needs a file for each run: {', '.join(SUFFIXES)}"
        raise ConfigError(f"{path}: no trajectory is found there", hint)
    _require_one_file_each(files)
    notes = list[Note]()
    if others:
        notes.append(note("trajectory_ignored", len(others), names=listed(others)).about(path))
    return Side(name, given, files), notes


def _files_below(folder: Path) -> Iterator[Path]:
    """Yield the files and bags in a folder and below it, by name; hidden ones are left out."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: natural_key(entry.name))
    except OSError as error:
        text = f"{folder}: cannot be read: {error.strerror}"
        raise ConfigError(text, "check the path of the trajectories") from error
    for entry in entries:
        if entry.name.startswith("."):
            continue
        path = Path(entry.path)
        # A link that leads to itself is no folder, and cannot be read as a file.
        if not path.is_dir() or (path / _BAG).is_file():
            yield path
        elif not entry.is_symlink():
            yield from _files_below(path)


def _require_one_file_each(files: Sequence[RunFile]) -> None:
    """Raise a ConfigError if two files in one folder differ in their ending alone."""
    seen = dict[tuple[str, ...], RunFile]()
    for file in files:
        first = seen.setdefault(file.parts, file)
        if first is not file:
            text = f"{first.path} and {file.path.name} would both be a run of {file.parts[-1]}"
            raise ConfigError(text, "move one of them to another folder")


# --- Which runs are of one dive.


def match_sides(old: Side, new: Sequence[Side], truth: Side) -> tuple[list[DiveFiles], list[Note]]:
    """Find the dives of which the truth, OLD and at least one NEW have a file; a ConfigError if there is none."""
    truths = _dives_of(truth, old)
    by_side = {side.name: _runs_of_dives(side, truths) for side in (old, *new)}
    dives = list[DiveFiles]()
    for name, reference in truths.items():
        of_old = by_side[old.name].get(name, [])
        of_new = dict[str, list[RunFile]]()
        for side in new:
            if name in by_side[side.name]:
                of_new[side.name] = by_side[side.name][name]
        if of_old and of_new:
            dives.append(DiveFiles(name, reference, of_old, of_new))
    if not dives:
        raise _nothing_in_common(old, new, truth)
    notes = list[Note]()
    for side in (old, *new, truth):
        notes += _unmatched_notes(side, dives)
    return dives, notes


def _dives_of(truth: Side, old: Side) -> dict[str, RunFile]:
    """Return the file of the truth of each dive, by the name of the dive."""
    if not truth.is_file:
        stems = [file.parts[-1] for file in truth.files]
        names = dict[str, RunFile]()
        for file in truth.files:
            stem = file.parts[-1]
            name = stem
            if stems.count(stem) > 1:
                name = "_".join(file.parts)
            names[name] = file
        return names
    [file] = truth.files
    if old.is_file:
        return {file.parts[-1]: file}
    return dict.fromkeys((run.parts[-1] for run in old.files), file)


def _runs_of_dives(side: Side, truths: dict[str, RunFile]) -> dict[str, list[RunFile]]:
    """Return the runs of a side by the name of their dive; those of no dive are left out."""
    if side.is_file and len(truths) == 1:
        return {name: list(side.files) for name in truths}
    found = dict[str, list[RunFile]]()
    for file in side.files:
        name = _dive_of(file, truths)
        if name:
            found.setdefault(name, []).append(file)
    return found


def _dive_of(file: RunFile, truths: dict[str, RunFile]) -> str:
    """Return the dive whose place is the longest end of that of a run; else the only one of its name; else none."""
    ends = list[tuple[int, str]]()
    same = list[str]()
    for name, truth in truths.items():
        length = len(truth.parts)
        if file.parts[-length:] == truth.parts:
            ends.append((length, name))
        if file.parts[-1] in (name, truth.parts[-1]):
            same.append(name)
    if ends and max(ends)[0] > 1:
        return max(ends)[1]
    exact = [name for name in same if name == file.parts[-1]]
    if len(exact) == 1:
        return exact[0]
    if len(same) == 1:
        return same[0]
    return ""


def _unmatched_notes(side: Side, dives: Sequence[DiveFiles]) -> Iterator[Note]:
    """Note the files of a side that are in no dive."""
    used = set[Path]()
    for dive in dives:
        used.add(dive.truth.path)
        used.update(file.path for file in dive.old)
        for files in dive.new.values():
            used.update(file.path for file in files)
    left = [file.path for file in side.files if file.path not in used]
    if left:
        names = listed(str(path.relative_to(side.given.path)) for path in left)
        yield note("trajectory_unmatched", len(left), side=side.name, names=names)


def _nothing_in_common(old: Side, new: Sequence[Side], truth: Side) -> ConfigError:
    """Return the error for sides without a common dive."""
    seen = list[str]()
    for side in (old, *new, truth):
        names = list(dict.fromkeys(file.parts[-1] for file in side.files))
        seen.append(f"{side.name} has {listed(names, 3)}")
    text = f"no dive has files on all sides: {'; '.join(seen)}"
    return ConfigError(text, "files of one dive need the same name, such as old/dive_1.tum")
