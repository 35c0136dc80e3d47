"""What did not pass, as workflow commands that GitHub shows as annotations.

Source: GitHub's "Workflow commands for GitHub Actions". A step shows ten annotations of a level; what is beyond that is
counted in the last one.
"""

from collections.abc import Sequence
from typing import Final

from insdvl_replay.core.plain_text import visible
from insdvl_replay.gates.check_pages import check_sentence
from insdvl_replay.gates.model import CheckResult, Judgement

SHOWN: Final = 10


def github_annotations(result: CheckResult) -> str:
    """Write workflow commands.

    Parameters
    ----------
    result : CheckResult

    Returns
    -------
    str
        A line for each gate that a dive did not pass, and one that counts.
    """
    errors = [judgement for judgement in result.judgements if judgement.status in ("unusable", "failed")]
    warnings = [judgement for judgement in result.judgements if judgement.status == "warning"]
    lines = [*_commands("error", result.gates, errors), *_commands("warning", result.gates, warnings)]
    return "".join(f"{line}\n" for line in (*lines, check_sentence(result)))


def _commands(level: str, file: str, judgements: Sequence[Judgement]) -> list[str]:
    shown = judgements if len(judgements) <= SHOWN else judgements[: SHOWN - 1]
    lines = [_of_judgement(level, file, item) for item in shown]
    if hidden := len(judgements) - len(shown):
        lines.append(_command(level, file, 0, "more", f"{hidden} more gates were not passed; the log lists them"))
    return lines


def _of_judgement(level: str, file: str, item: Judgement) -> str:
    return _command(level, file, item.line, f"{item.dive}: {item.gate}", "\n".join(map(visible, item.reasons)))


def _command(level: str, file: str, line: int, title: str, message: str) -> str:
    place = f"file={_property(visible(file))}" + (f",line={line}" if line else "")
    return f"::{level} {place},title={_property(visible(title))}::{_data(message)}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
