"""Text from elsewhere: read from small files, and shown on one line, with nothing in it that acts.

A topic may hold whatever its recorder was given. A control character can move a terminal's cursor, a line break can
begin what a job's log takes for a command, and a character that is not seen can turn the others round. Each becomes an
escape that is seen. Escapes are for eyes: a backslash stays as it is, so they are not meant to be read back.
"""

import errno
import os
import re
import stat
import unicodedata
from pathlib import Path
from typing import Final

_ACTING: Final = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
"""Categories of Unicode: control, format that is not seen (bidi, joiners), lone surrogates, breaks of lines."""
_COMMAND: Final = re.compile(r"^([^\S\n]*):(?=:)", re.MULTILINE)
_OLD_COMMAND: Final = re.compile(r"#(?=#\w*\[)")
_RUNS: Final = re.compile(r"\d+|\D+")
_MOST_BYTES: Final = 1 << 24
"""Of a text that is read: more than anybody writes by hand; a device may go on without end."""


def read_text(path: Path) -> str:
    """Read a text in UTF-8, with or without the mark that some editors put in front.

    An OSError where it cannot be read, or has more than 16 MiB; a UnicodeDecodeError where it is not UTF-8.
    """
    with path.open("rb") as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data.decode("utf-8-sig")


def read_regular(path: Path, most_bytes: int) -> bytes:
    """Read a file that others name. An OSError where it cannot be read, is no regular file, or has more bytes."""
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:  # a named pipe is not waited for
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes >> 20} MiB", str(path))
    return data


NaturalKey = tuple[tuple[bool, int, str], ...]


def natural_key(text: str) -> NaturalKey:
    """Return a key that sorts names by their letters, and the numbers in them by size: dive 2 before dive 10."""
    return tuple((not word.isdecimal(), int(word) if word.isdecimal() else 0, word) for word in _RUNS.findall(text))


def visible(text: str) -> str:
    r"""Make one line of a text.

    Returns
    -------
    str
        With ``\x1b``, ``\u202e`` or ``\U000e0001`` for what acts and is not seen, ends of lines and tabs too. What is
        such a text already stays as it is.

    Notes
    -----
    ``##[`` and ``##name[``, which job runners take for commands anywhere in a line, lose their beginning. From
    ``\u0080`` on, escapes are those of TOML, which has none of two digits.
    """
    if "##" in text:
        text = _OLD_COMMAND.sub(lambda _: "\\u0023", text)
    return text if text.isprintable() else "".join(map(_shown, text))


def visible_lines(text: str) -> str:
    """Do the same with a text of several lines, which stay lines."""
    return "\n".join(map(visible, text.split("\n")))


def without_commands(text: str) -> str:
    """Let no line of a text begin as commands to a job runner do: the first of two colons becomes an escape.

    GitHub takes a line for a command that begins with ``::``, on stdout and on stderr, after blanks too.
    """
    return _COMMAND.sub(r"\1\\u003a", text)


def is_writable(text: str) -> bool:
    """Return whether a text can be written as UTF-8: a file's name of other bytes cannot, as Python reads it."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _shown(character: str) -> str:
    if unicodedata.category(character) not in _ACTING:
        return character
    code = ord(character)
    if code < 0x80:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
