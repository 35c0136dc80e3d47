"""``insdvl-replay compare --reference``: trajectories of any program."""

from collections.abc import Mapping, Sequence
from typing import Any

from insdvl_replay.cli.messages import log_notes, write_stdout
from insdvl_replay.core.errors import ConfigError, LimitError, require_known, visible

_WORDS = ("worse", "undecided")


def compare_with_reference(
    old: str,
    new: Sequence[str],
    reference: str,
    given: Mapping[str, Any],  # of the options; None where they are not given
    *,
    dives: Sequence[str],
    tables: Sequence[str],
    fail_on: str | None,
    format_: str,
    verbose: int,
    quiet: bool,
) -> None:
    """Compare trajectories and print the verdict."""
    from insdvl_replay.cli.screen import progress, written
    from insdvl_replay.trajectories import comparison as compared
    from insdvl_replay.trajectories import document as documents

    if fail_on is not None and fail_on not in _WORDS:
        text = f"--fail-on {fail_on}: trajectories have a verdict and no stored values"
        raise ConfigError(text, "--fail-on worse, or --fail-on undecided")
    for name in tables:
        require_known("table", name, documents.TABLES, most=len(documents.TABLES))
    options = compared.options_of(**given, dives=dives)
    with progress("comparing trajectories"):
        found = compared.compare_trajectories(old, new, reference, options)
    if tables:
        write_stdout(written(documents.named_tables(found, tables), format_))
    elif quiet and format_ == "table":
        write_stdout("".join(f"{visible(line)}\n" for line in documents.quiet_lines(found)))
    else:
        result = documents.trajectories_result(found, every_row=verbose > 0)
        write_stdout(written(result, format_))
    log_notes(found.notes, verbose=verbose > 0)
    worse = compared.find_violation(found, fail_on)
    if worse is not None:
        raise LimitError(worse)
