"""The files of a result as its report lists them, each with a digest, so that it is known whether all are whole.

The report lists itself, too: its digest is that of what it says, without the time of day and without that digest.
"""

import hashlib
from pathlib import Path
from typing import Any, Final

import msgspec

REPORT: Final = "report.json"
"""The file that holds the list."""
_TIME_OF_DAY: Final = ("started_at", "elapsed_s")


def list_files(folder: Path) -> None:
    """Write into the report of a finished result which files it has, and the SHA-256 of each."""
    report = folder / REPORT
    content = msgspec.json.decode(report.read_bytes())
    files = {path.name: _digest(path) for path in sorted(folder.iterdir()) if path != report}
    content["files"] = files | {REPORT: _digest_of_report(content | {"files": files})}
    report.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")


def damaged_files(folder: Path) -> list[str]:
    """Name the files of a result that are not as they were written, or not there; every byte is read.

    Parameters
    ----------
    folder : Path
        A result.

    Returns
    -------
    list of str
        Empty if all are whole. The report alone if it lists no files.
    """
    content = msgspec.json.decode((folder / REPORT).read_bytes())
    files: dict[str, str] = dict(content.get("files", {}))
    of_report = files.pop(REPORT, "")
    damaged = [name for name, digest in files.items() if not _is_whole(folder / name, digest)]
    content["files"] = files
    return damaged if _digest_of_report(content) == of_report else [REPORT, *damaged]


def _is_whole(path: Path, digest: str) -> bool:
    return path.is_file() and _digest(path) == digest


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest_of_report(content: dict[str, Any]) -> str:
    tool = {key: value for key, value in content["tool"].items() if key not in _TIME_OF_DAY}
    return hashlib.sha256(msgspec.json.encode(content | {"tool": tool})).hexdigest()
