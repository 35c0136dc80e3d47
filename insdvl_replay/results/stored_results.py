"""Find results on the disk and read them back, those of other versions too."""

import csv
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NoReturn, TypeVar

import msgspec

from insdvl_replay.core.errors import ConfigError, Note, ResultError, listed, looked_for
from insdvl_replay.core.notes import note
from insdvl_replay.core.path_kinds import SUMMARY, looks_like_log, replay_hint
from insdvl_replay.core.report import StoredReport, StoredResult
from insdvl_replay.core.tables import TABLES
from insdvl_replay.core.version import __version__
from insdvl_replay.core.words import GateStatus
from insdvl_replay.results.folder import COMPLETE, LABELS, NOT_JSON, Label, read_file

_Kind = TypeVar("_Kind")


def read_results(root: Path) -> tuple[list[StoredResult], list[Note]]:
    """Read every result in a place: a report.json, a result folder, or a folder of them at any depth.

    Results of studies, which have no tables of a dive, and of earlier runs are left out and counted. A place without a
    result of a dive is a ConfigError, a report that cannot be read a ResultError.
    """
    reports, notes = read_reports(root, StoredReport)
    results = []
    for file, report in reports:
        name = "."
        if root.is_dir():
            name = file.parent.relative_to(root).as_posix()
        results.append(StoredResult(file.parent, name, report))
    return results, notes


def read_one_result(root: Path, kind: type[_Kind]) -> tuple[Path, _Kind]:
    """Read the one result in a place, and return its folder and report; several are a ConfigError.

    As `Report` those of this version alone can be read, as `StoredReport` all.
    """
    ((file, report), *others), _ = read_reports(root, kind)
    if others:
        raise ConfigError(
            f"{root}: holds {len(others) + 1} results", f"name one of them, such as {file.parent}"
        )
    return file.parent, report


def read_reports(root: Path, kind: type[_Kind]) -> tuple[list[tuple[Path, _Kind]], list[Note]]:
    """Read the reports of all dives in a place, of which there must be one, and note what is left out.

    Where a run has written its summary, the dives count that it replayed, as on its page. Results beside them are of
    earlier runs, with other logs or settings.
    """
    found = sorted(_report_files(root))
    files, notes = _of_last_runs(found)
    if found and not files:
        hint = f"run it again, or name a result of an earlier run, such as {found[0].parent}"
        raise ConfigError(f"{root}: the last run into it has replayed no dive", hint)
    reports = []
    studies = 0
    for file in files:
        report = _read_report(file, kind)
        if report is None:
            studies += 1
        else:
            reports.append((file, report))
    if not reports:
        what = "holds only results of studies" if studies else "holds no result"
        raise ConfigError(
            f"{root}: {what}", "name a folder that `insdvl-replay run LOG... -o DIR` wrote"
        )
    if studies:
        notes.append(note("studies_left_out", studies).about(root))
    return reports, notes


def earlier_results(folder: Path, dives: Collection[str]) -> list[Note]:
    """Note the results in the folder of a run that are of other dives than its own."""
    left = []
    for entry in os.scandir(folder):
        is_of_run = entry.name in dives or entry.name.startswith(".")
        if not is_of_run and Path(entry.path, COMPLETE).is_file():
            left.append(entry.name)
    if left:
        return [_earlier(folder, sorted(left))]
    return []


def _earlier(folder: Path, names: Sequence[str]) -> Note:
    first = folder / names[0]
    left_out = note(
        "earlier_results",
        len(names),
        names=listed(names),
        first=first,
    )
    return left_out.about(folder)


def _of_last_runs(files: Sequence[Path]) -> tuple[list[Path], list[Note]]:
    """Leave out the reports beside a summary that does not name their dives, with a note for each such folder."""
    kept: list[Path] = []
    notes: list[Note] = []
    by_folder: dict[Path, list[Path]] = {}
    for file in files:
        by_folder.setdefault(file.parent.parent, []).append(file)
    for folder, inside in by_folder.items():
        dives = dives_of_run(folder)
        if dives is None:
            kept += inside
            continue
        kept += [file for file in inside if file.parent.name in dives]
        others = [file.parent.name for file in inside if file.parent.name not in dives]
        if others:
            notes.append(_earlier(folder, others))
    return sorted(kept), notes


def dives_of_run(folder: Path) -> set[str] | None:
    """Read the names of the dives that the last run into a folder has replayed; None without its summary.

    A dive that failed may have a result of an earlier run, which is not this run's.
    """
    try:
        text = read_file(folder / SUMMARY).decode()
    except (OSError, UnicodeDecodeError):
        return None
    table = csv.DictReader(text.splitlines())
    if not set(table.fieldnames or ()) >= {"log", "filter"}:
        return None
    dives = set()
    for row in table:
        if row.get("log") and row.get("status") != GateStatus.FAILED:
            dives.add(row["log"])
    return dives


def _report_files(root: Path) -> Iterator[Path]:
    """Return the report of each result; folders whose name begins with a dot are results that are still written."""
    with looked_for(root):
        if not root.exists():
            raise ConfigError(
                f"{root}: does not exist",
                "name a result folder, a report.json or a folder of results",
            )
    if looks_like_log(root):
        raise ConfigError(f"{root}: is a log, not a result", replay_hint(root))
    if root.is_file():
        yield root
        return
    for folder, below, names in os.walk(root, onerror=_refuse):
        below[:] = [name for name in below if not name.startswith(".")]
        if COMPLETE in names:
            yield Path(folder, COMPLETE)
            below.clear()


def _refuse(error: OSError) -> NoReturn:
    raise ResultError(
        f"{error.filename}: cannot be read: {error.strerror or error}", "check its permissions"
    ) from error


def _read_report(file: Path, kind: type[_Kind]) -> _Kind | None:
    """Read one report; None for a study."""
    label = Label()
    try:
        data = read_file(file)
        label = LABELS.decode(data)
        if label.kind is not None:
            return None
        report = msgspec.json.decode(data, type=kind)
    except OSError as error:
        _refuse(error)
    except msgspec.ValidationError as error:
        _refuse_version(file, label, error)
    except NOT_JSON as error:
        hint = "name a result folder or its report.json; a broken one is replaced by replaying its log with --force"
        raise ResultError(f"{file}: is not JSON: {error}", hint) from error
    if isinstance(report, StoredReport):
        _require_named_rows(file, report)
    return report


def _refuse_version(file: Path, label: Label, error: msgspec.ValidationError) -> NoReturn:
    """Raise a ResultError for a report that this version does not know."""
    written_by = ""
    if label.tool.get("version"):
        written_by = f" (written by version {label.tool['version']})"
    text = str(error)
    reason = f"{text[:1].lower()}{text[1:]}"
    raise ResultError(
        f"{file}: is not a report that version {__version__} can read{written_by}: {reason}",
        "replay the log again with this version, or compare with the version that wrote it",
    ) from error


def _require_named_rows(file: Path, report: StoredReport) -> None:
    """Raise a ResultError if a row of a table has no name, or the name of another."""
    for layout in TABLES:
        names = set[tuple[object, ...]]()
        for number, row in enumerate(report.tables.get(layout.name, []), 1):
            place = f"{file}: table {layout.name}, row {number}"
            for column in ("filter", layout.key):
                if column not in row:
                    raise ResultError(f"{place}: has no column {column}", "replay the log again")
            name = (row["filter"], row[layout.key], row.get("unit"))
            if name in names:
                same = f"has the same names as an earlier row: {name[0]}, {name[1]}"
                raise ResultError(f"{place}: {same}", "replay the log again")
            names.add(name)
