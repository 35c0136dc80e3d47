"""Parts of several shards become the results of one run, once all are there and fit together."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from insdvl_replay.batch.overviews import require_overviews
from insdvl_replay.batch.parts import INTERNAL_ERROR, PART_FILES, FailedDive, PartFile
from insdvl_replay.batch.shards import Shard
from insdvl_replay.core.dive_record import is_dive_name
from insdvl_replay.core.errors import ConfigError, ResultError, UserError, listed
from insdvl_replay.core.report import Report, Tool, decode_report, this_tool
from insdvl_replay.results.folder import (
    COMPLETE,
    NOT_JSON,
    damaged_files,
    read_file,
    require_replaceable_folder,
    result_folder,
)

_FOLDERS: Final = "name the folders that `insdvl-replay run LOG... --shard I/N -o DIR` wrote"
_ALL_ALIKE: Final = "run all shards over the same dives with the same options"

_CODES_OF_FAILED: Final = (ConfigError.exit_code, ResultError.exit_code, INTERNAL_ERROR)


class FailedDiveError(UserError):
    """A dive that a shard could not replay, with the exit code that it had there."""

    def __init__(self, failed: FailedDive) -> None:
        super().__init__(failed.reason, failed.hint)
        self.exit_code = failed.exit_code


@dataclass(frozen=True)
class Part:
    """A finished shard and the file that it left, which is beside its results."""

    file: Path
    content: PartFile

    @property
    def folder(self) -> Path:
        """The folder of its results."""
        return self.file.parent


@dataclass(frozen=True)
class MergedDive:
    """A dive in the merged results."""

    target: Path
    result: Report | FailedDiveError
    unchanged: bool = False  # it was there already


@dataclass(frozen=True)
class Merge:
    """Parts that are whole and fit together."""

    parts: Sequence[Part]
    output: Path

    @property
    def targets(self) -> list[Path]:
        """The folders of all dives in the merged results, in the order of the run."""
        return [self.output / dive.name for dive in self.parts[0].content.dives]

    def dives(self, *, force: bool = False) -> Iterator[MergedDive]:
        """Copy the results of all dives into the output, and yield them in the order of the run."""
        owners: dict[str, Part] = {}
        for part in self.parts:
            for name in (*part.content.results, *part.content.failed):
                owners[name] = part
        for target in self.targets:
            part = owners[target.name]
            failed = part.content.failed.get(target.name)
            if failed is not None:
                yield MergedDive(target, FailedDiveError(failed))
            else:
                yield _merged(part, target, force=force)


def plan_merge(folders: Sequence[Path], output: Path, *, force: bool = False) -> Merge:
    """Read the files of all shards, and require that together they are one run.

    Raises
    ------
    ConfigError
        A folder holds no finished shard, a shard is missing or there twice, shards are of different runs, or the output
        holds other files.
    ResultError
        A result is not as its shard wrote it.
    """
    parts: list[Part] = []
    for folder in folders:
        parts += _parts_in(folder)
    parts.sort(key=lambda part: part.content.shard)
    _require_all(parts)
    for part in parts[1:]:
        _require_same_run(parts[0], part)
    _require_same_noise(parts)
    _require_each_dive(parts)
    _require_this_tool(parts[0])
    merge = Merge(parts, output)
    if len(merge.targets) > 1:
        require_overviews(output, force=force)
    for part in parts:
        _require_whole(part)
    return merge


def _parts_in(folder: Path) -> list[Part]:
    """Return the finished shards of a folder."""
    if folder.is_file():
        return [Part(folder, _read_part(folder))]
    files = sorted(folder.glob(PART_FILES))
    if files:
        return [Part(file, _read_part(file)) for file in files]
    if not folder.exists():
        raise ConfigError(f"{folder}: does not exist", _FOLDERS)
    hint = f"run the shard again, which goes on where it stopped, or {_FOLDERS}"
    raise ConfigError(f"{folder}: holds no finished shard, since it has no {PART_FILES}", hint)


def _read_part(file: Path) -> PartFile:
    """Read the file of a shard."""
    try:
        part = msgspec.json.decode(read_file(file), type=PartFile)
    except (OSError, *NOT_JSON) as error:
        text = f"{file}: is not the file of a shard: {error}"
        raise ResultError(text, "copy the part again, or run the shard again") from error
    wrong = _wrong_field(part)
    if wrong:
        text = f"{file}: is not the file of a shard: its {wrong} cannot be"
        raise ResultError(text, "copy the part again, or run the shard again")
    return part


def _wrong_field(part: PartFile) -> str:
    """Name what no shard writes; empty if all can be."""
    if not part.done.is_one:
        return "shard"
    names = [dive.name for dive in part.dives]
    known = set(names)
    if len(known) < len(names) or not all(map(is_dive_name, names)):
        return "dives"
    if not {*part.results, *part.failed} <= known:
        return "dives"
    for failed in part.failed.values():
        if failed.exit_code not in _CODES_OF_FAILED:
            return "exit_code"
    return ""


def _require_all(parts: Sequence[Part]) -> None:
    """Raise a ConfigError if a shard is missing or there twice, or there are other shards among them."""
    first = parts[0]
    shards = first.content.shards
    there: dict[int, Part] = {}
    for part in parts:
        if part.content.shards != shards:
            text = f"{part.file}: is a shard of {part.content.shards}, and {first.file} one of {shards}"
            raise ConfigError(text, "run all shards with the same N of --shard I/N")
        other = there.setdefault(part.content.shard, part)
        if other is not part:
            text = f"shard {part.content.done} is there twice: {other.file} and {part.file}"
            raise ConfigError(text, "leave one of them out")
    missing = []
    for number in range(1, shards + 1):
        if number not in there:
            missing.append(str(Shard(number, shards)))
    if missing:
        hint = "name its folder too, or run it: an interrupted shard goes on where it stopped"
        raise ConfigError(f"missing, or not finished: shard {listed(missing)}", hint)


def _require_same_run(first: Part, other: Part) -> None:
    """Raise a ConfigError if two shards are of different runs."""
    both = f"{first.file} and {other.file}"
    difference = _difference(first.content, other.content)
    if difference:
        text = f"{both}: are by different versions: {difference}"
        raise ConfigError(text, "run all shards with the same version and packages")
    names = {dive.name: dive.settings for dive in first.content.dives}
    others = {dive.name: dive.settings for dive in other.content.dives}
    apart = sorted(names.keys() ^ others.keys())
    if apart:
        raise ConfigError(f"{both}: are of different dives: {listed(apart)}", _ALL_ALIKE)
    changed = [name for name, settings in names.items() if others[name] != settings]
    if changed:
        text = f"{both}: have different settings or options for {listed(changed)}"
        raise ConfigError(text, _ALL_ALIKE)


def _made_by(tool: Tool) -> str:
    """Return version and sources of a tool."""
    return f"{tool.version} ({tool.sources})"


def _difference(first: PartFile, other: PartFile) -> str:
    """Name the versions in which two parts differ; empty if they do not."""
    made = _made_by(first.tool)
    made_other = _made_by(other.tool)
    if made != made_other:
        return f"insdvl-replay {made} and {made_other}"
    words = []
    for package, version in first.versions.items():
        version_other = other.versions.get(package, "none")
        if version != version_other:
            words.append(f"{package} {version} and {version_other}")
    return listed(words)


def _require_this_tool(part: Part) -> None:
    """Raise a ConfigError if this version writes other pages than those that made the parts."""
    here = _made_by(this_tool())
    made = _made_by(part.content.tool)
    if made != here:
        text = f"{part.file}: is by insdvl-replay {made}, and this is {here}"
        raise ConfigError(text, "merge with the version that ran the shards, or run them again")


def _require_same_noise(parts: Sequence[Part]) -> None:
    """Raise a ConfigError if shards fitted different noise to the same dives."""
    fitted: dict[str, tuple[str, Part]] = {}
    for part in parts:
        for settings, noise in part.content.noise.items():
            known, other = fitted.setdefault(settings, (noise, part))
            if known != noise:
                text = f"{other.file} and {part.file}: have different noise, fitted to the first dives"
                hint = "see that all machines have the same logs, and run these shards again with --rerun"
                raise ConfigError(text, hint)


def _require_each_dive(parts: Sequence[Part]) -> None:
    """Raise a ConfigError if a dive is in no shard, or in two."""
    owners: dict[str, Part] = {}
    for part in parts:
        for name in (*part.content.results, *part.content.failed):
            other = owners.setdefault(name, part)
            if other is not part:
                text = f"{other.file} and {part.file}: both have {name}"
                raise ConfigError(text, _ALL_ALIKE)
    lost = [dive.name for dive in parts[0].content.dives if dive.name not in owners]
    if lost:
        raise ConfigError(f"{parts[0].file}: no shard has {listed(lost)}", _ALL_ALIKE)


def _require_whole(part: Part) -> None:
    """Raise a ResultError if a result of a part is not as its shard wrote it."""
    for name, digest in part.content.results.items():
        folder = part.folder / name
        try:
            report = decode_report(read_file(folder / COMPLETE))
            is_whole = report.files.get(COMPLETE) == digest and not damaged_files(folder)
        except (OSError, *NOT_JSON):
            is_whole = False
        if not is_whole:
            text = f"{folder}: is not as shard {part.content.done} wrote it"
            raise ResultError(text, "copy the part again, or run the shard again")


def _merged(part: Part, target: Path, *, force: bool) -> MergedDive:
    """Copy the result of a dive, if it is not there already."""
    source = part.folder / target.name
    report = decode_report(read_file(source / COMPLETE))
    if _is_there(report, target):
        return MergedDive(target, report, unchanged=True)
    require_replaceable_folder(target, force=force)
    with result_folder(target, force=force) as folder:
        for file in report.files:
            shutil.copyfile(source / file, folder / file)
    return MergedDive(target, decode_report(read_file(target / COMPLETE)))


def _is_there(report: Report, target: Path) -> bool:
    """Return whether a folder holds a result, whole."""
    try:
        there = decode_report(read_file(target / COMPLETE))
        return there.files == report.files and not damaged_files(target)
    except (OSError, *NOT_JSON):
        return False
