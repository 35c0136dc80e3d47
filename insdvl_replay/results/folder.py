"""Results on disk: a result is written completely or not at all, and is identified by its files and digests.

It is written in a hidden folder next to its place, and renamed when it is complete.
"""

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import ConfigError, TargetError, read_regular
from insdvl_replay.core.extras import install_hint
from insdvl_replay.core.tables import TABLES

COMPLETE: Final = "report.json"  # The file that identifies a result folder. It is written last and lists the others.
PAGE: Final = "report.html"
SETTINGS_FILE: Final = "config.toml"  # The resolved settings.
REPLAY_LOG: Final = "replay.mcap"  # The histories; checks do not write it.
TRAJECTORY_FILE: Final = "trajectory.npz"  # Every filter once a second.
REFERENCE_TRAJECTORY: Final = "reference.tum"
VEHICLE_FILE: Final = "vehicle.toml"  # Settings that were found, if nobody made them.
# Files of all tracks of a dive, by format.
MAPS: Final = {
    "kml": "tracks.kml",
    "geojson": "tracks.geojson",
}
LAYOUT_FILES: Final = ("foxglove.json", "plotjuggler.xml")  # Viewer layouts for replay.mcap.
# All files of the result of a dive.
DIVE_FILES: Final = (
    *(f"{layout.name}.csv" for layout in TABLES),
    *(REPLAY_LOG, *LAYOUT_FILES, TRAJECTORY_FILE, SETTINGS_FILE, "run.log", PAGE, COMPLETE),
)
TOOL: Final = "insdvl-replay"
# Raised when decoding bytes that are not valid JSON: cut, wrong encoding, or nested too deep.
NOT_JSON: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
# Size limit of a result file that is read into memory. Reports of long dives have some MB.
_MOST_BYTES: Final = 1 << 30
_TIME_OF_DAY: Final = ("started_at", "elapsed_s", "cpu_s")
_MARK: Final = "insdvl-replay-"  # In names of hidden folders, after the dot.
_OLD: Final = "old"  # Subfolder for the older result while the new one replaces it.
_LEFT_FOR_S: Final = 86_400.0  # A hidden folder that is unchanged for a day is from a killed run.
_NAME_A_FILE: Final = "give the name of a file"
_ANOTHER_PLACE: Final = "choose another place with -o"


class Label(msgspec.Struct):
    """The fields that identify a report: reports of dives have no kind."""

    tool: dict[str, str | float | dict[str, float] | None] = {}
    kind: str | None = None
    files: dict[str, str] = {}


LABELS: Final = msgspec.json.Decoder(Label)  # made before threads use it


def history_file(name: str, format_: str) -> str:
    """Name the file of a filter's whole history, in ``csv`` or ``parquet``."""
    return f"history_{name}.{format_}"


def trajectory_file(name: str) -> str:
    """Name the file of a filter's trajectory; no filter's name makes it that of the reference."""
    return f"filter_{name}.tum"


def read_file(path: Path) -> bytes:
    """Read a file of a result; see `read_regular`."""
    return read_regular(path, _MOST_BYTES)


# --- Digests of the files


def list_files(folder: Path) -> None:
    """Add the list of files with their SHA-256 to the report of a finished result."""
    report = folder / COMPLETE
    content = msgspec.json.decode(report.read_bytes())
    files = {path.name: _digest(path) for path in sorted(folder.iterdir()) if path != report}
    content["files"] = files | {COMPLETE: _digest_of_report(content | {"files": files})}
    report.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")


def damaged_files(folder: Path) -> list[str]:
    """Name the files of a result that changed or are missing; only the report if it lists no files."""
    content = msgspec.json.decode(read_file(folder / COMPLETE))
    files: dict[str, str] = dict(content.get("files", {}))
    of_report = files.pop(COMPLETE, "")
    damaged = [name for name, digest in files.items() if _digest(folder / name) != digest]
    content["files"] = files
    if _digest_of_report(content) == of_report:
        return damaged
    return [COMPLETE, *damaged]


def _digest(path: Path) -> str:
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest_of_report(content: dict[str, Any]) -> str:
    """Digest a report without the time of day."""
    tool = {key: value for key, value in content["tool"].items() if key not in _TIME_OF_DAY}
    return hashlib.sha256(msgspec.json.encode(content | {"tool": tool})).hexdigest()


# --- Writing


@contextmanager
def result_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a new folder to write into. It becomes the target if the block ends without an exception.

    On any exception, an interruption included, nothing of it remains, and an older result stays as it was. With
    ``force`` an older result is replaced. The report in the folder is made to list its files.
    """
    require_replaceable_folder(target, force=force)
    with _workspace(target) as workspace:
        require_replaceable_folder(target, force=force)  # an older result may have been put back
        new = workspace / "new"
        old = workspace / _OLD / target.name
        new.mkdir()
        old.parent.mkdir()
        yield new
        list_files(new)
        require_replaceable_folder(target, force=force)
        try:
            if target.exists():
                target.rename(old)
            new.rename(target)
        finally:
            if os.path.lexists(old) and not os.path.lexists(target):
                old.rename(target)


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a path to write to. It becomes the target if the block ends without an exception.

    A link to a file stays. What is no file, as a device or a named pipe, is never replaced: the bytes go into it.
    """
    require_replaceable_file(target, force=force)
    file = target.resolve()
    in_place = target.exists() and not target.is_file()
    with _workspace(Path(tempfile.gettempdir(), file.name) if in_place else file) as folder:
        path = folder / file.name
        yield path
        require_replaceable_file(target, force=force)
        if in_place:
            with path.open("rb") as source, target.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        else:
            path.replace(file)


@contextmanager
def _workspace(target: Path) -> Iterator[Path]:
    """Yield a hidden folder next to the target and remove it at the end; missing parent folders are created."""
    made = [parent for parent in target.parents if not parent.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(target.parent)
        folder = Path(tempfile.mkdtemp(prefix=f".{_MARK}", dir=target.parent))
        try:
            yield folder
        finally:
            try:
                shutil.rmtree(folder, ignore_errors=True)
            except BaseException:  # an interrupt, which must not leave half of it
                shutil.rmtree(folder, ignore_errors=True)
                raise
            for parent in made:
                with suppress(OSError):  # no longer empty, or never made
                    parent.rmdir()
    except OSError as error:
        raise TargetError(
            f"{target}: cannot be written: {error.strerror or error}", _ANOTHER_PLACE
        ) from error


def _remove_leftovers(folder: Path) -> None:
    """Remove folders of killed runs; put an older result back if its place is empty."""
    for path in folder.glob(f".{_MARK}*"):
        with suppress(OSError):
            newest_s = max(file.lstat().st_mtime for file in (path, *path.rglob("*")))
            if time.time() - newest_s > _LEFT_FOR_S:
                for result in (path / _OLD).glob("*"):
                    if not os.path.lexists(folder / result.name):
                        result.rename(folder / result.name)
                shutil.rmtree(path, ignore_errors=True)


# --- What is there already


def require_replaceable_folder(target: Path, *, force: bool = False) -> None:
    """Raise a TargetError if a result must not be written to a folder.

    With ``force`` an older result may be replaced, if the folder holds its files alone. Anything else that bears the
    name may not: it is somebody's work.
    """
    try:
        target.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:  # such as too long a name
        raise TargetError(
            f"{target}: cannot be written: {error.strerror}", _ANOTHER_PLACE
        ) from error
    own = _files_of_result(target)
    if own is None:
        raise TargetError(
            f"{target}: exists and is not a result folder", "choose another folder with -o"
        )
    if not force:
        raise TargetError(
            f"{target}: exists", "choose another folder with -o, or replace it with --force"
        )
    foreign = sorted(
        path.name for path in target.iterdir() if path.name not in own or path.is_dir()
    )
    if foreign:
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        raise TargetError(
            f"{target}: is not replaced, because {foreign[0]}{more} is not a file of its result",
            "move it elsewhere, or name another folder for the results",
        )


def require_replaceable_file(target: Path, *, force: bool = False) -> None:
    """Raise a TargetError if a file cannot be written, or exists and may not be replaced."""
    try:
        exists = target.exists()
        if not exists and target.is_symlink():
            raise TargetError(
                f"{target}: is a link to {target.readlink()}, which does not exist", f"rm {target}"
            )
        if not exists and not target.parent.is_dir():
            raise TargetError(
                f"{target}: the folder {target.parent} does not exist", f"mkdir -p {target.parent}"
            )
        if target.is_dir():
            raise TargetError(
                f"{target}: is a {'link to a ' * target.is_symlink()}folder", _NAME_A_FILE
            )
        if target.is_block_device():
            raise TargetError(f"{target}: is a disk", _NAME_A_FILE)
        if target.is_file() and not force:
            raise TargetError(
                f"{target}: exists", "choose another name, or replace it with --force"
            )
    except OSError as error:
        raise TargetError(
            f"{target}: cannot be written: {error.strerror}", _NAME_A_FILE
        ) from error


def is_result(folder: Path) -> bool:
    """Return whether a folder holds a result, so that its replay.mcap is not a dive.

    A damaged report counts; one that names another tool does not: it may be next to logs.
    """
    if not (folder / COMPLETE).is_file():
        return False
    try:
        label = LABELS.decode((folder / COMPLETE).read_bytes())
    except (OSError, *NOT_JSON):
        return True
    return label.tool.get("name", TOOL) == TOOL


def _files_of_result(folder: Path) -> Collection[str] | None:
    """Name the files that a result may have; None if there is no result.

    A report that was damaged does not list them: a folder with all files of a dive's result is one nevertheless.
    """
    try:
        label = LABELS.decode(read_file(folder / COMPLETE))
    except (OSError, *NOT_JSON):
        label = Label()
    if label.tool.get("name") == TOOL:
        return {COMPLETE, *(label.files or DIVE_FILES)}
    # Checks do not write these.
    needed = set(DIVE_FILES) - {REPLAY_LOG, *LAYOUT_FILES, TRAJECTORY_FILE}
    if all((folder / name).is_file() for name in needed):
        return DIVE_FILES
    return None


# --- Parquet


def require_parquet(option: str, otherwise: str) -> None:
    """Raise a ConfigError where nothing can write Parquet."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"{option} needs pyarrow", f"{install_hint('tables')}, or {otherwise}"
        ) from error
