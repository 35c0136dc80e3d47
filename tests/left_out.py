"""What tests were left out for, told in as many lines as there are things missing."""

from collections import Counter
from collections.abc import Iterable

MISSING = {
    "Chromium": "Chromium is missing; `make extras` brings it",
    "node": "node is missing, or its libraries; `make extras` brings them",
    "../shared": "they need recorded logs and published tables that are not part of the project",
    "emulate": "this processor cannot stand for others",
}
"""By the word with which the reason for leaving a test out names it."""


def left_out(reasons: Iterable[str]) -> list[str]:
    """Give a line for each thing that is missing, the most missed first.

    Parameters
    ----------
    reasons : iterable of str
        Of each test that was left out.

    Returns
    -------
    list of str
    """
    counts = Counter(_missing(reason) for reason in reasons)
    return [
        f"{count} {'test was' if count == 1 else 'tests were'} left out: {missing}"
        for missing, count in counts.most_common()
    ]


def _missing(reason: str) -> str:
    reason = reason.removeprefix("Skipped: ")
    return next((missing for word, missing in MISSING.items() if word in reason), reason)
