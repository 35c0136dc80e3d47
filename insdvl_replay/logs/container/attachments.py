"""Files inside a log, and the checks that need every byte of the log."""

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from typing import Final, NamedTuple

from zlib_ng import zlib_ng

from insdvl_replay.logs.container.damage import Damage, DamageError

_TIMES: Final = struct.Struct("<QQ")
_PIECE: Final = 1 << 20


@dataclass(frozen=True)
class Attachment:
    """A file inside a log.

    Attributes
    ----------
    data : memoryview
        Its bytes, which are read from the disk when they are looked at.
    size, crc : int
        Bytes of the record in front of its checksum, and the checksum, 0 if there is none.
    """

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    data: memoryview
    size: int
    crc: int


def attachment_at(data: memoryview, start: int, length: int) -> Attachment:
    """Find an attachment's fields; its bytes are not touched."""
    record = data[start : start + length]
    log_time_ns, create_time_ns = _TIMES.unpack_from(record)
    name, place = _text(record, start, _TIMES.size)
    media_type, place = _text(record, start, place)
    size = int.from_bytes(record[place : place + 8], "little")
    place += 8
    if place + size + 4 > length:
        raise DamageError(start, f"an attachment says it has {size} bytes; its record has {length}")
    end = place + size
    crc = int.from_bytes(record[end : end + 4], "little")
    return Attachment(name, media_type, log_time_ns, create_time_ns, record[place:end], end, crc)


def _text(record: memoryview, start: int, place: int) -> tuple[str, int]:
    end = place + 4 + int.from_bytes(record[place : place + 4], "little")
    if end > len(record):
        raise DamageError(start, f"a text of an attachment says it ends {end - len(record)} bytes behind it")
    return bytes(record[place + 4 : end]).decode("utf-8", "replace"), end


def attachment_damages(data: memoryview, places: Sequence[tuple[int, int]]) -> list[Damage]:
    """Check the checksums of attachments."""
    damages = []
    for start, length in places:
        attachment = attachment_at(data, start, length)
        if attachment.crc and zlib_ng.crc32(data[start : start + attachment.size]) != attachment.crc:
            damages.append(Damage(start, "the checksum of an attachment is not that of its bytes"))
    return damages


class Digest(NamedTuple):
    """What a pass over all bytes of a file gives.

    Attributes
    ----------
    sha256 : str
        Hexadecimal digits.
    damages : list of Damage
        Checksums that are not those of their bytes.
    """

    sha256: str
    damages: list[Damage]


def checked_digest(file: FileIO, section_end: int, section_crc: int) -> Digest:
    """Digest a log, and check the checksum of all its messages on the way."""
    sha256, crc = _digest(file, section_end if section_crc else 0)
    if crc == section_crc:
        return Digest(sha256, [])
    damage = Damage(section_end, "the checksum of all messages is not that of their bytes; some may be wrong")
    return Digest(sha256, [damage])


def _digest(file: FileIO, section_end: int) -> tuple[str, int]:
    """Read the file once in pieces, which takes no memory and leaves other threads alone."""
    digest, crc, place = hashlib.sha256(), 0, 0
    piece = bytearray(_PIECE)
    while count := file.readinto(piece):
        part = memoryview(piece)[:count]
        digest.update(part)
        if place < section_end:
            crc = zlib_ng.crc32(part[: section_end - place], crc)
        place += count
    return digest.hexdigest(), crc
