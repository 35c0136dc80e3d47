"""Small text files of the user's: settings, gates, lists."""

import errno
import os
from pathlib import Path
from typing import Final

_MOST_BYTES: Final = 1 << 24
"""More than anybody writes by hand; a device may go on without end."""


def read_text(path: Path) -> str:
    """Read a text in UTF-8, with or without the mark that some editors put in front.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str

    Raises
    ------
    OSError
        It cannot be read, or has more than 16 MiB.
    UnicodeDecodeError
        It is not UTF-8.
    """
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data.decode("utf-8-sig")
