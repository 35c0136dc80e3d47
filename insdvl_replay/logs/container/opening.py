"""Which format a file is of, by its first bytes: names tell nothing."""

from pathlib import Path
from typing import Final

from insdvl_replay.logs.container.log_file import LogFile
from insdvl_replay.logs.container.mapped_file import MappedFile
from insdvl_replay.logs.container.mcap_file import McapFile

_SQLITE: Final = b"SQLite format 3\0"
_BAG: Final = b"#ROSBAG V2.0\n"


def open_log_file(path: Path) -> LogFile:
    """Open a file for reading; what reads the bags of ROS is not loaded before there is one.

    Raises
    ------
    UnusableFileError
        Nothing of it can be used.
    LogError
        It cannot be opened.
    """
    file = MappedFile(path)
    if bytes(file.data[: len(_SQLITE)]) == _SQLITE:
        from insdvl_replay.logs.container.sqlite_file import SqliteFile

        return SqliteFile(file)
    if bytes(file.data[: len(_BAG)]) == _BAG:
        from insdvl_replay.logs.container.bag_file import BagFile

        return BagFile(file)
    return McapFile(file)
