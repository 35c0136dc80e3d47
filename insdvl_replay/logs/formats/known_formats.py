"""One door for all files: what a file is by its first bytes, and what reads it.

`known_formats.toml` lists the formats that are read, `other_formats.toml` those that are not, with the step that helps.
"""

import re
from functools import cached_property
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from insdvl_replay.core.dive_record import LOG_SUFFIXES, TABLE_SUFFIXES

START: Final = 4096  # bytes by which a file is known
_MOST_FILES: Final = 1000  # of a folder that are looked at for a hint
TEXT_SUFFIXES: Final = (".txt", ".dat", ".asc")  # of texts that may be tables


class Format(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """A format that is read; `known_formats.toml` says what each entry means."""

    begins: str
    reader: str
    name: str = ""
    endings: tuple[str, ...] = ()
    example: str = ""
    holds: str = ""
    lacks: str = ""
    is_dvl: bool = False
    is_dive: bool = False

    @cached_property
    def _pattern(self) -> re.Pattern[bytes]:
        return re.compile(self.begins.encode("latin-1"))

    def begins_as(self, start: bytes) -> bool:
        """Return whether the first bytes of a file are those of the format."""
        return self._pattern.search(start) is not None

    def open(self, file: Any) -> Any:
        """Read a file with the reader of the format, which is loaded here."""
        module, _, name = self.reader.partition(".")
        reader = import_module(f"insdvl_replay.logs.formats.{module}")
        return getattr(reader, name)(file)


class OtherFormat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A format that is not read; `other_formats.toml` says what each entry means."""

    name: str
    starts: tuple[str, ...]
    endings: tuple[str, ...]
    step: str
    any_name: bool = False


FORMATS: Final = msgspec.toml.decode(
    Path(__file__).with_name("known_formats.toml").read_text("utf-8"),
    type=dict[str, list[Format]],
)["format"]
OTHER_FORMATS: Final = msgspec.toml.decode(
    Path(__file__).with_name("other_formats.toml").read_text("utf-8"),
    type=dict[str, list[OtherFormat]],
)["format"]


def known_format(start: bytes) -> Format | None:
    """Return the format of a file by its first bytes; None where no format begins so."""
    for known in FORMATS:
        if known.begins_as(start):
            return known
    return None


def instrument_format(path: Path) -> Format | None:
    """Return the format of a file of an instrument or a vehicle; None for any other, also one that cannot be read."""
    ending = path.suffix.lower()
    if not any(ending in known.endings for known in FORMATS):
        return None
    try:
        # A pipe that nobody writes to would be waited for without end.
        if not path.is_file():
            return None
        with path.open("rb") as file:
            start = file.read(START)
    except OSError:
        return None
    known = known_format(start)
    if known is None or not known.name:
        return None
    return known


def dvl_next_to(log: Path) -> Path | None:
    """Return the only file of a DVL alone that lies beside the only log of a folder; None where it is not so."""
    logs = _logs_in(log.parent)
    if len(logs) != 1 or logs[0].name != log.name:
        return None
    found: list[Path] = []
    for path in _files_in(log.parent):
        known = instrument_format(path)
        if known is not None and known.is_dvl:
            found.append(path)
    if len(found) != 1:
        return None
    return found[0]


def log_next_to(file: Path) -> Path | None:
    """Return the only log of a recorder that lies beside a file; None where there is none, or more than one."""
    logs = _logs_in(file.parent)
    if len(logs) != 1 or logs[0].name == file.name:
        return None
    return logs[0]


def _logs_in(folder: Path) -> list[Path]:
    return [path for path in _files_in(folder) if path.suffix in LOG_SUFFIXES]


def _files_in(folder: Path) -> list[Path]:
    """Return the first thousand files of a folder; none of one that cannot be listed, or is not there."""
    try:
        return list(islice(folder.iterdir(), _MOST_FILES))
    except OSError:
        return []


def other_format(path: Path, start: bytes) -> OtherFormat | None:
    """Return the format of a file by its first 16 bytes, of several by the ending of its name too; else by this."""
    ending = path.suffix.lower()
    alike = [known for known in OTHER_FORMATS if _begins_as(known, start)]
    for known in alike:
        if ending in known.endings:
            return known
    if alike:
        return alike[-1]
    if _is_telemetry(start):
        ending = ".tlog"
    for known in OTHER_FORMATS:
        # An ending that belongs to bytes which are not there tells nothing.
        if not known.starts and ending in known.endings:
            return known
    return None


def _begins_as(known: OtherFormat, start: bytes) -> bool:
    return start.startswith(tuple(map(bytes.fromhex, known.starts)))


def _is_telemetry(start: bytes) -> bool:
    """Return whether bytes begin with a message of MAVLink behind its time, as ground stations record them."""
    if len(start) <= 8 or start[8] not in (0xFD, 0xFE):
        return False
    # In microseconds, from 2001 to 2096, the larger bytes first.
    return 10**15 < int.from_bytes(start[:8]) < 4 * 10**15


def may_be_table(path: Path, start: bytes) -> bool:
    """Return whether a file is named as a table, or as a text that may be one, and begins as a text."""
    ending = path.suffix.lower()
    if ending in TEXT_SUFFIXES:
        return all(byte >= 0x20 or byte in b"\t\n\r" for byte in start)
    return ending in TABLE_SUFFIXES
