"""Files of other formats: what they are, by their first bytes, and the step that makes of them a log that is read.

Sources: ArduPilot's AP_Logger (LogStructure.h), PX4's ULog file format, Teledyne's PD0, PD4 and PD6 output, Nortek's
integrator's guides, MAVLink's telemetry logs, and the formats' own specifications.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final


@dataclass(frozen=True)
class OtherFormat:
    """A format that is not read.

    Attributes
    ----------
    name : str
        What it is, for a sentence that begins with "is".
    starts : tuple of bytes
        Each file begins with one of these; none where the ending of its name is all that tells.
    endings : tuple of str
        Of its name.
    step : str
        What helps.
    """

    name: str
    starts: tuple[bytes, ...]
    endings: tuple[str, ...]
    step: str


_ARRAYS: Final = "`insdvl_replay.logs.write_dive` writes a log of arrays; docs/inputs.md has the lines"
_DRIVER: Final = "record the messages of a driver beside it, or write its velocities as geometry_msgs/TwistStamped"
_UNPACK: Final = "unpack it, and name what was in it"

OTHER_FORMATS: Final = (
    OtherFormat(
        "a log of ArduPilot (.BIN)",
        (b"\xa3\x95\x80",),
        (".bin",),
        "with LOG_REPLAY=1 it has the exact inputs of the filter on board; clydemcqueen/dive_to_bag writes a bag of it",
    ),
    OtherFormat(
        "a log of ArduPilot as text",
        (b"FMT, ",),
        (".log",),
        "take the .BIN that it was made of; clydemcqueen/dive_to_bag writes a bag of that",
    ),
    OtherFormat(
        "a log of PX4 (ULog)",
        (b"ULog\x01\x12\x35",),
        (".ulg",),
        "`ulog2rosbag` of pyulog writes a bag with px4_msgs, which are known",
    ),
    OtherFormat(
        "a telemetry log of MAVLink (.tlog)",
        (),
        (".tlog",),
        "its IMU is too slow to replay; take the vehicle's .BIN (LOG_REPLAY=1), of which clydemcqueen/dive_to_bag "
        "writes a bag, with the DVL of this file",
    ),
    OtherFormat("output of a Teledyne DVL or ADCP (PD0)", (b"\x7f\x7f",), (".pd0",), _DRIVER),
    OtherFormat("output of a Teledyne DVL (PD4 or PD5)", (b"\x7d\x00", b"\x7d\x01"), (".pd4", ".pd5"), _DRIVER),
    OtherFormat("output of a Teledyne DVL (PD6)", (b":SA,", b":TS,", b":BI,", b":BS,"), (".pd6",), _DRIVER),
    OtherFormat("output of a Nortek instrument (AD2CP, or a Nucleus)", (b"\xa5\x0a",), (".ad2cp", ".nucleus"), _DRIVER),
    OtherFormat("sentences of NMEA", (b"$P", b"$G"), (".nmea",), _DRIVER),
    OtherFormat("a log of LCM", (b"\xed\xa1\xda\x01",), (".lcm", ".lcmlog"), _ARRAYS),
    OtherFormat("a log of DUNE (IMC)", (b"\x54\xfe", b"\xfe\x54"), (".lsf",), _ARRAYS),
    OtherFormat("a file of HDF5", (b"\x89HDF\r\n\x1a\n",), (".h5", ".hdf5"), _ARRAYS),
    OtherFormat("a file of MATLAB", (b"MATLAB ",), (".mat",), _ARRAYS),
    OtherFormat("JSON, as Water Linked's DVLs send it", (b'{"',), (".json", ".jsonl"), _ARRAYS),
    OtherFormat("compressed with gzip", (b"\x1f\x8b",), (".gz", ".tgz"), _UNPACK),
    OtherFormat("compressed with lz4", (b"\x04\x22\x4d\x18",), (".lz4",), _UNPACK),
    OtherFormat("an archive of zip", (b"PK\x03\x04",), (".zip",), _UNPACK),
    OtherFormat("a table as text", (), (".csv", ".tsv", ".txt", ".dat"), _ARRAYS),
)
"""The first that fits is meant; the endings of names count where no first bytes fit."""

_MAVLINK: Final = (0xFD, 0xFE)
_EARLIEST_US, _LATEST_US = 10**15, 4 * 10**15
"""From 2001 to 2096, counted from 1970."""


def other_format(path: Path, start: bytes) -> OtherFormat | None:
    """Find the format of a file by its first 16 bytes, else by the ending of its name."""
    for known in OTHER_FORMATS:
        if any(start.startswith(magic) for magic in known.starts):
            return known
    # Each message behind its time in microseconds, the larger bytes first.
    if len(start) > 8 and start[8] in _MAVLINK and _EARLIEST_US < int.from_bytes(start[:8]) < _LATEST_US:
        return next(known for known in OTHER_FORMATS if ".tlog" in known.endings)
    ending = path.suffix.lower()
    # An ending that belongs to bytes which are not there tells nothing.
    return next((known for known in OTHER_FORMATS if not known.starts and ending in known.endings), None)
