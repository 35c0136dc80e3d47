"""How much may become worse before a comparison fails: ``worse``, ``worse:5%`` or ``changed``."""

import re

from insdvl_replay.comparison.aggregation import loss_of, worst_of
from insdvl_replay.core.changes import Change, Comparison, Limit, Violation
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.words import ChangeWord
from insdvl_replay.evaluation.row_changes import ROUNDING, within


def parse_percentage(text: str, before: str) -> float:
    """Read a percentage such as ``0.1%``.

    Parameters
    ----------
    before : str
        What was typed before it, for the message.

    Returns
    -------
    float
        In percent.

    Raises
    ------
    ConfigError
        It is something else.
    """
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?%", text.strip())
    if match is None:
        raise ConfigError(f"{before}{text}: is not a percentage", f"write {before}0.5%")
    return float(match[1])


def parse_limit(text: str) -> Limit:
    """Read a limit.

    Parameters
    ----------
    text : str
        ``worse``, ``worse:5%`` or ``changed``.

    Raises
    ------
    ConfigError
        It is something else.
    """
    word, colon, percentage = text.partition(":")
    if word == ChangeWord.WORSE:
        return Limit(ChangeWord.WORSE, parse_percentage(percentage, "--fail-on worse:") if colon else 0.0)
    if text == ChangeWord.CHANGED:
        return Limit(ChangeWord.CHANGED)
    raise ConfigError(
        f"--fail-on {text}: is not known", "write --fail-on worse, --fail-on worse:5% or --fail-on changed"
    )


def find_violation(comparison: Comparison, limit: Limit) -> Violation | None:
    """Find what exceeds a limit.

    Returns
    -------
    Violation or None
        None where nothing does.
    """
    changes = tuple(change for change in comparison.changes if _exceeds(change, limit))
    new_ones_too = limit.word == ChangeWord.CHANGED
    dives = tuple(dive.log for dive in comparison.dives if dive.new is None or (new_ones_too and dive.old is None))
    worst = worst_of(changes)
    return Violation(limit, len(changes), worst, dives) if changes or dives else None


def _exceeds(change: Change, limit: Limit) -> bool:
    if limit.word == ChangeWord.CHANGED:
        return change.word != ChangeWord.SAME
    return not within(loss_of(change), limit.above_pct, 100.0 * ROUNDING)
