"""Text from logs, file names and settings as it can be shown anywhere: on one line, and nothing in it acts.

A topic may hold whatever its recorder was given. A control character can move a terminal's cursor, a line break can
begin what a job's log takes for a command, and a character that is not seen can turn the others round. Each becomes an
escape that is seen. Escapes are for eyes: a backslash stays as it is, so they are not meant to be read back.
"""

import re
import unicodedata
from typing import Final

_ACTING: Final = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
"""Categories of Unicode: control, format that is not seen (bidi, joiners), lone surrogates, breaks of lines."""
_COMMAND: Final = re.compile(r"^([^\S\n]*):(?=:)", re.MULTILINE)
_OLD_COMMAND: Final = re.compile(r"#(?=#\w*\[)")


def visible(text: str) -> str:
    r"""Make one line of a text.

    Parameters
    ----------
    text : str

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
    """Do the same with a text of several lines, which stay lines.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
    """
    return "\n".join(map(visible, text.split("\n")))


def without_commands(text: str) -> str:
    """Let no line begin as commands to a job runner do.

    Parameters
    ----------
    text : str
        Of any number of lines.

    Returns
    -------
    str
        The same with an escape for the first of two colons that begin a line.

    Notes
    -----
    GitHub takes a line for a command that begins with ``::``, on stdout and on stderr, after blanks too.
    """
    return _COMMAND.sub(r"\1\\u003a", text)


def is_writable(text: str) -> bool:
    """Tell whether a text can be written as UTF-8: a file's name of other bytes cannot, as Python reads it.

    Parameters
    ----------
    text : str

    Returns
    -------
    bool
    """
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
