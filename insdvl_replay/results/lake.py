"""The lake: the evidence of many replays as one Parquet dataset.

::

    lake/rows -> .rows_7               readers follow this link
    lake/.rows_7/joined.parquet        the rows of many replays
    lake/.rows_7/4d1f...e0.parquet     the rows of one replay that was added since

`compact` joins all files into one, in a folder of its own. When that is complete and on the disk, the link moves to it
in one step, and only then the old folder is removed. So whatever is killed, and whenever, the link leads to each row
once. Readers of Parquet datasets leave out names that begin with a dot.

Who writes holds the lock of the lake, which ends with its process. Readers need none.
"""

import fcntl
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import asdict

from insdvl_replay.core.errors import ConfigError, ResultError, TargetError, listed
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import LAKE, LakeRow
from insdvl_replay.results.folder import SETTINGS_FILE, require_parquet

if TYPE_CHECKING:
    import pyarrow as pa

ROWS: Final = "rows"  # The link.
_FOLDER: Final = re.compile(r"\.rows_(\d+)")
_NEW_LINK: Final = ".rows_new"
_LOCK: Final = ".lock"
_JOINED: Final = "joined.parquet"
_PART: Final = ".part"  # A file of one replay that is being written.
_MOST_FILES: Final = 500  # A run that leaves more files of single replays joins them.
_READ_AT_ONCE: Final = 1000  # files
_ROWS_OF_GROUP: Final = 1 << 17
_READ_TRIES: Final = 5
_OF_ITS_OWN: Final = "name a folder of its own with --lake"
_NO_LAKE: Final = "name the folder that `run --lake` wrote"
_REPLAY_AGAIN: Final = "remove it, and run its dives again with --lake"
_LONGEST_REVISION: Final = 200
_NAME_OF_COMMIT: Final = '--revision "$(git rev-parse --short HEAD)"'


def require_revision(revision: str) -> None:
    """Raise a ConfigError for a name of a version that no table could show."""
    if revision and not revision.strip():
        raise ConfigError(f"--revision {revision[:20]!r}: is blank", _NAME_OF_COMMIT)
    if len(revision) > _LONGEST_REVISION or not revision.isprintable():
        raise ConfigError(
            f"--revision {revision[:20]!r}: is not a line of at most {_LONGEST_REVISION} letters",
            _NAME_OF_COMMIT,
        )


def require_lake(lake: Path, outputs: Collection[Path]) -> None:
    """Create the folder of a lake. Raise a ConfigError if it cannot be written, or holds or will hold anything else."""
    require_parquet("--lake", "leave --lake out")
    for output in outputs:
        if output.resolve().is_relative_to(lake.resolve()):
            raise ConfigError(f"{lake}: is the folder of the results, or above it", _OF_ITS_OWN)
    try:
        if not lake.exists():
            lake.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in lake.iterdir() if not path.name.startswith("."))
        with tempfile.TemporaryFile(dir=lake):
            pass
    except OSError as error:
        raise ConfigError(f"{lake}: cannot be written: {error.strerror}", _OF_ITS_OWN) from error
    _require_link(lake)
    for name in names:
        if name != ROWS or not _is_lake(lake):
            raise ConfigError(f"{lake}: holds {name}, which is not a file of a lake", _OF_ITS_OWN)
    with _writing(lake), _locked(lake):
        if not _is_lake(lake):
            _make_first(lake)


def _is_lake(lake: Path) -> bool:
    link = lake / ROWS
    return link.is_symlink() and bool(_FOLDER.fullmatch(str(link.readlink())))


def _require_link(lake: Path) -> None:
    """Raise a ConfigError for a lake that can only be read: its link is a folder, or leads elsewhere."""
    if (lake / ROWS).is_dir() and not (lake / ROWS).is_symlink():
        raise ConfigError(
            f"{lake}: was copied without its link {ROWS}, and can only be read",
            "copy it again with `cp -a`, which keeps links",
        )
    if (lake / ROWS).is_symlink() and not _is_lake(lake):
        to = (lake / ROWS).readlink()
        raise ConfigError(
            f"{lake}: its link {ROWS} leads to {to}, and a lake with such a link can only be read",
            "copy the lake again with `cp -a`",
        )


# --- Adding replays


@dataclass
class LakeWriter:
    """Adds replays to a lake, each at once; those that replace joined rows are joined together as it is closed."""

    lake: Path
    revision: str = ""
    _of: str = ""  # the folder whose joined replays are known
    _started_at: dict[str, str] = field(default_factory=dict)  # of the joined replays
    _replacing: "list[pa.Table]" = field(default_factory=list)

    def add(self, report: Report) -> None:
        """Add the evidence of a replay, in place of the rows of the same replay."""
        self.add_rows(list(lake_rows(report, self.revision)))

    def add_rows(self, rows: Sequence[LakeRow]) -> None:
        """Add the rows of one replay."""
        if not rows:
            return
        table = _table(rows)
        with _writing(self.lake), _locked(self.lake):
            folder = _rows_folder(self.lake)
            self._know_joined(folder)
            started_at = self._started_at.get(rows[0].replay)
            if started_at is None:
                _write_one(folder, f"{rows[0].replay}.parquet", table)
            elif started_at != rows[0].started_at:
                self._replacing.append(table)

    def close(self) -> None:
        """Join what replaces joined rows, and the files of single replays if there are many."""
        with _writing(self.lake), _locked(self.lake):
            files = len(_single_files(_rows_folder(self.lake)))
            if self._replacing or files > _MOST_FILES:
                _join(self.lake, self._replacing)
        self._replacing.clear()

    def _know_joined(self, folder: Path) -> None:
        """Look up the joined replays, once in each folder."""
        if self._of == folder.name:
            return
        self._of = folder.name
        self._started_at = _joined_replays(folder)


def add_to_lake(lake: Path, report: Report, revision: str = "") -> None:
    """Add the evidence of one replay to a lake."""
    require_lake(lake, ())
    writer = LakeWriter(lake, revision)
    writer.add(report)
    writer.close()


def lake_rows(report: Report, revision: str) -> Iterator[LakeRow]:
    """Yield the rows of a replay."""
    settings_sha256 = report.files[SETTINGS_FILE]
    code_sha256 = _digest_of_code(report)
    version = report.tool.version
    identity = (report.log.sha256, settings_sha256, code_sha256, version, revision)
    replay = hashlib.sha256("\n".join(identity).encode()).hexdigest()[:32]
    for evidence in report.tables.evidence:
        yield LakeRow(
            **asdict(evidence),
            filter_verdict=report.filters[evidence.filter].verdict,
            vehicle=report.vehicle,
            replay=replay,
            log_sha256=report.log.sha256,
            settings_sha256=settings_sha256,
            code_sha256=code_sha256,
            revision=revision,
            version=version,
            started_at=report.tool.started_at or "",
        )


def _digest_of_code(report: Report) -> str:
    """Return the digest of the user's code that was run; of several files, that of their digests in order."""
    digests = sorted({file.sha256 for file in report.code.values()})
    if len(digests) > 1:
        return hashlib.sha256("\n".join(digests).encode()).hexdigest()
    return "".join(digests)


# --- Joining


@dataclass(frozen=True)
class Compacted:
    """What `compact_lake` did."""

    replays: int
    rows: int
    files_before: int
    files: int


def compact_lake(lake: Path) -> Compacted:
    """Join all files of a lake into one.

    Raises
    ------
    ConfigError
        It is no lake, or cannot be written, or pyarrow is not installed.
    ResultError
        One of its files is damaged.
    """
    require_existing(lake)
    _require_link(lake)
    with _writing(lake), _locked(lake):
        before = len(_files(_rows_folder(lake)))
        joined = _join(lake, [])
        files = len(_files(_rows_folder(lake)))
    replays = len(joined["replay"].unique())
    return Compacted(replays, joined.num_rows, before, files)


def require_existing(lake: Path) -> None:
    """Raise a ConfigError for a folder that is no lake, or if nothing can read one."""
    require_parquet("a lake", "use the CSV tables of the results")
    if not lake.is_dir():
        raise ConfigError(f"{lake}: is not a folder", _NO_LAKE)
    if not (lake / ROWS).is_dir():
        raise ConfigError(f"{lake}: is not a lake", _NO_LAKE)


def _join(lake: Path, replacing: "Sequence[pa.Table]") -> "pa.Table":
    """Write all rows into one file in a new folder, let the link lead to it, and remove the old folder."""
    import pyarrow.parquet as pq

    old = _rows_folder(lake)
    table = _all_rows(old, replacing)
    _remove_others(lake, old)
    new = lake / f".rows_{_number(old) + 1}"
    new.mkdir()
    if table.num_rows:
        file = new / _JOINED
        pq.write_table(
            table,
            file,
            compression="zstd",
            row_group_size=_ROWS_OF_GROUP,
            write_page_checksum=True,
            store_schema=False,  # text stays text, also where it is read as a dictionary here
        )
        _to_disk(file)
    _to_disk(new)
    _lead_to(lake, new)
    _remove_others(lake, new)
    return table


def _all_rows(folder: Path, replacing: "Sequence[pa.Table]") -> "pa.Table":
    """Return the rows of a folder: joined ones first, then single replays by their time."""
    import pyarrow as pa
    import pyarrow.compute as pc

    later = [*_single_rows(folder), *map(_as_dictionaries, replacing)]
    joined = folder / _JOINED
    if joined.exists():
        table = _whole_file(joined, _texts())
        replaced = pa.array(sorted(_replays_of(later)), pa.string())
        is_replaced = pc.is_in(table["replay"].cast(pa.string()), value_set=replaced)
        later.insert(0, table.filter(pc.invert(is_replaced)))
    if not later:
        return _as_dictionaries(_table(()))
    return pa.concat_tables(later).unify_dictionaries()


def _single_rows(folder: Path) -> "Iterator[pa.Table]":
    """Yield the rows of the files of single replays, many at once, in the order of their start."""
    import pyarrow as pa

    tables = []
    for file in _single_files(folder):
        table = _whole_file(file)
        if table.num_rows:
            tables.append(table)
    tables.sort(key=_start_of)
    for first in range(0, len(tables), _READ_AT_ONCE):
        yield _as_dictionaries(pa.concat_tables(tables[first : first + _READ_AT_ONCE]))


def _start_of(table: "pa.Table") -> tuple[str, str]:
    return table["started_at"][0].as_py(), table["replay"][0].as_py()


def _replays_of(tables: "Sequence[pa.Table]") -> set[str]:
    found = set[str]()
    for table in tables:
        found.update(table["replay"].unique().to_pylist())
    return found


def _joined_replays(folder: Path) -> dict[str, str]:
    """Return when each joined replay was started, by its digest."""
    import pyarrow.parquet as pq

    if not (folder / _JOINED).exists():
        return {}
    columns = ["replay", "started_at"]
    with _reading(folder / _JOINED):
        table = pq.read_table(folder / _JOINED, columns=columns, partitioning=None)
    once = table.group_by(columns).aggregate([])
    return dict(zip(once["replay"].to_pylist(), once["started_at"].to_pylist(), strict=True))


# --- Reading


def read_lake(lake: Path, columns: Sequence[str], filters: Any = None) -> "pa.Table":
    """Return some columns of a lake, with texts as dictionaries.

    Raises
    ------
    ConfigError
        It is no lake, or pyarrow is not installed.
    ResultError
        One of its files is damaged.
    """
    require_existing(lake)
    for _ in range(_READ_TRIES):
        try:
            return _read(lake, columns, filters)
        except FileNotFoundError:  # the lake is being compacted
            continue
    raise TargetError(f"{lake}: its files change while they are read", "try again")


def _read(lake: Path, columns: Sequence[str], filters: Any) -> "pa.Table":
    """Read all files once; a FileNotFoundError if the link leads to others meanwhile."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder = _rows_folder(lake)
    files = _files(folder)
    if not files:
        return _as_dictionaries(_table(())).select(columns)
    texts = [name for name in columns if LAKE.kinds[name] == "text"]
    try:
        table = pq.read_table(
            files,
            columns=list(columns),
            filters=filters,
            read_dictionary=texts,
            partitioning=None,  # no column comes from the name of a folder
            page_checksum_verification=True,
        )
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError) as error:
        _require_whole(files)
        raise ResultError(f"{folder}: cannot be read: {error}", _REPLAY_AGAIN) from error
    if not _has_all_values(table):
        _require_whole(files)
    if _rows_folder(lake) != folder:
        # Some of the files may have been gone before they were listed.
        raise FileNotFoundError(folder)
    return table


def _has_all_values(table: "pa.Table") -> bool:
    """Return whether all texts are there and numbers are numbers, which Arrow makes up where files differ."""
    expected = _schema()
    for name in table.column_names:
        if LAKE.kinds[name] == "text":
            if table[name].null_count:
                return False
        elif table.schema.field(name).type != expected.field(name).type:
            return False
    return True


# --- Single files


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    """Turn what Arrow says of a file into a ResultError."""
    import pyarrow as pa

    try:
        yield
    except FileNotFoundError:
        raise
    except OSError as error:
        reason = error.strerror or "it is damaged"
        raise ResultError(f"{file}: cannot be read: {reason}", _REPLAY_AGAIN) from error
    except pa.ArrowException as error:
        text = f"{file}: is damaged, or no Parquet file of a lake"
        raise ResultError(text, _REPLAY_AGAIN) from error


def _whole_file(file: Path, dictionaries: Sequence[str] = ()) -> "pa.Table":
    """Return the rows of a file, with some texts as dictionaries; a ResultError if it is none of a lake."""
    import pyarrow.parquet as pq

    options: dict[str, Any] = {"page_checksum_verification": True}
    with (
        _reading(file),
        pq.ParquetFile(file, read_dictionary=list(dictionaries), **options) as opened,
    ):
        _require_columns(file, opened.schema_arrow)
        table = opened.read()
    for name in _texts():
        if table[name].null_count:
            raise ResultError(f"{file}: has rows without {name}", _REPLAY_AGAIN)
    return table


def _require_whole(files: Sequence[Path]) -> None:
    """Raise a ResultError for the first file that is none of a lake."""
    for file in files:
        _whole_file(file)


def _require_columns(file: Path, schema: "pa.Schema") -> None:
    """Raise a ResultError if a file has other columns than this version writes."""
    import pyarrow as pa

    expected = _schema()
    lacking = [name for name in expected.names if name not in schema.names]
    others = [name for name in schema.names if name not in expected.names]
    for name in expected.names:
        if name in lacking:
            continue
        kind = schema.field(name).type
        if pa.types.is_dictionary(kind):
            kind = kind.value_type
        if kind != expected.field(name).type:
            others.append(f"{name} as {kind}")
    found = [f"lacks {name}" for name in lacking]
    found += [f"has {name}" for name in others]
    if found:
        text = f"{file}: is by another version: it {listed(found)}"
        raise ResultError(text, _REPLAY_AGAIN)


# --- Tables


def _schema() -> "pa.Schema":
    import pyarrow as pa

    types = {"text": pa.string(), "count": pa.int64(), "number": pa.float64()}
    return pa.schema([(column, types[kind]) for column, kind in LAKE.kinds.items()])


def _table(rows: Sequence[LakeRow]) -> "pa.Table":
    import pyarrow as pa

    return pa.Table.from_pylist([asdict(row) for row in rows], schema=_schema())


def _texts() -> list[str]:
    return [column for column, kind in LAKE.kinds.items() if kind == "text"]


def _as_dictionaries(table: "pa.Table") -> "pa.Table":
    """Return a table whose texts are kept once each."""
    for name in _texts():
        place = table.schema.get_field_index(name)
        table = table.set_column(place, name, table[name].dictionary_encode())
    return table


# --- Files


@contextmanager
def _locked(lake: Path) -> Iterator[None]:
    """Hold the lock of a lake, which other writers wait for."""
    with (lake / _LOCK).open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
        except OSError as error:
            text = f"{lake}: cannot be locked: {error.strerror}"
            raise TargetError(text, "put the lake on a disk that has file locks") from error
        yield


@contextmanager
def _writing(lake: Path) -> Iterator[None]:
    """Turn an error of the disk into a TargetError."""
    try:
        yield
    except OSError as error:
        text = f"{lake}: cannot be written: {error.strerror or error}"
        raise TargetError(text, _OF_ITS_OWN) from error


def _rows_folder(lake: Path) -> Path:
    """Return the folder to which the link leads."""
    if (lake / ROWS).is_symlink():
        return lake / (lake / ROWS).readlink()
    return lake / ROWS


def _number(folder: Path) -> int:
    return int(folder.name.rpartition("_")[2])


def _files(folder: Path) -> list[Path]:
    """Return the files with rows, by name; a FileNotFoundError if the folder is gone."""
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            is_shown = not entry.name.startswith(".") and entry.name.endswith(".parquet")
            if is_shown and entry.is_file():
                found.append(folder / entry.name)
    return sorted(found)


def _single_files(folder: Path) -> list[Path]:
    """Return the files of single replays."""
    return [path for path in _files(folder) if path.name != _JOINED]


def _make_first(lake: Path) -> None:
    first = lake / ".rows_1"
    first.mkdir(exist_ok=True)
    _lead_to(lake, first)


def _lead_to(lake: Path, folder: Path) -> None:
    """Let the link lead to another folder, in one step."""
    link = lake / _NEW_LINK
    link.unlink(missing_ok=True)
    link.symlink_to(folder.name)
    link.replace(lake / ROWS)
    _to_disk(lake)


def _remove_others(lake: Path, kept: Path) -> None:
    """Remove the folders to which the link does not lead, which an earlier or a killed `compact` left."""
    for path in lake.iterdir():
        if _FOLDER.fullmatch(path.name) and path.name != kept.name:
            shutil.rmtree(path)


def _write_one(folder: Path, name: str, table: "pa.Table") -> None:
    """Write the file of one replay."""
    import pyarrow.parquet as pq

    part = folder / _PART
    # Small files are read faster without dictionaries, compression and statistics.
    pq.write_table(
        table,
        part,
        use_dictionary=False,
        write_page_checksum=True,
        compression="none",
        write_statistics=False,
        store_schema=False,
    )
    _to_disk(part)
    part.replace(folder / name)


def _to_disk(path: Path) -> None:
    """Wait until the content of a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
