"""The run's log: what was read, what was noticed, in words. It holds no time of day, so that it can be compared."""

from collections.abc import Iterator

from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.tables import is_whole
from insdvl_replay.results.json_report import Report


def run_log(report: Report) -> str:
    """Write down what was replayed and every note.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        One line for each channel, filter and note.
    """
    return "".join(f"{visible(line)}\n" for line in _lines(report))


def _lines(report: Report) -> Iterator[str]:
    log = report.log
    yield f"{report.tool.name} {report.tool.version}"
    yield f"log {log.name}, sha256 {log.sha256 or 'none'}"
    for channel in log.channels:
        role = channel.role or "not used"
        yield f"channel {channel.topic} ({channel.type_name}, {channel.encoding}): {channel.messages} messages, {role}"
    yield f"replay {log.duration_s:.3f} s, from {log.start_ns} ns to {log.end_ns} ns on the log's clock"
    for row in report.tables.consistency:
        if is_whole(row.measurement):
            yield f"filter {row.filter}: {row.used} {row.measurement} updates, {row.rejected} rejected by the gate"
    for candidate in report.filters.values():
        yield candidate.verdict
    for note in report.notes:
        hint = f" (hint: {note.hint})" if note.hint else ""
        yield f"{note.severity} {note.code} [{note.count}]: {note.text}{hint}"
