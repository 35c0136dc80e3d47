"""What the parser of the command line finds wrong, as a sentence and a hint like those of all other errors."""

import re
from collections.abc import Sequence
from typing import Final

from insdvl_replay.core.errors import nearest

_IN_OUR_WORDS: Final = (
    (r"Usage: .*", "missing command"),
    (r": Value error, ", ": "),
    (r"Input should be greater than or equal to", "has to be at least"),
    (r"Input should be less than or equal to", "has to be at most"),
    (r"Input should be greater than", "has to be above"),
    (r"Input should be less than", "has to be below"),
    (r"Input should be a valid integer.*", "needs a whole number"),
    (r"Input should be a valid number.*", "needs a number"),
)
"""Parts of sentences of typer and of what it checks values by, which changed from version to version."""


def usage_explained(sentence: str, command: str, option: str = "", possible: Sequence[str] = ()) -> tuple[str, str]:
    """Return sentence and hint.

    Parameters
    ----------
    sentence : str
        The parser's own, of several lines perhaps.
    command : str
        As it was typed, such as ``insdvl-replay run``.
    option : str
        That is not known, if it is an option.
    possible : sequence of str
        Options that the parser thinks of.
    """
    told = " ".join(sentence.split())
    for pattern, words in _IN_OUR_WORDS:
        told = re.sub(pattern, words, told)
    hint = f"`{command} --help` shows what it takes"
    if option:
        told = re.sub(r" \(Possible options: .*\)| Did you mean .*\?", "", told)
        meant = nearest(option, possible)
        hint = f"did you mean {meant}?" if meant else hint
    elif suggested := re.search(r"\. Did you mean '([^']+)'\?$", told):
        told, hint = told[: suggested.start()], f"did you mean {suggested[1]}?"
    elif choices := re.search(r"\.? Choose from: ", told):
        told, hint = told[: choices.start()], f"one of: {told[choices.end() :]}"
    return told[:1].lower() + told[1:].rstrip("."), hint
