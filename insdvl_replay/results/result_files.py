"""A replay on disk: the files of a result folder."""

from collections.abc import Iterator
from pathlib import Path

from insdvl_replay import __version__, logs
from insdvl_replay.core.columns import Floats, TimeNs
from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.history import History
from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.runtime import begin
from insdvl_replay.core.tables import each_table, is_whole
from insdvl_replay.replay import Replay
from insdvl_replay.report.csv_tables import structs_csv
from insdvl_replay.results.dive_document import dive_page
from insdvl_replay.results.dive_figures import replay_coverage, replay_figures
from insdvl_replay.results.folder import PAGE
from insdvl_replay.results.json_report import Report, build_report, encode_report, this_tool


def save_replay(replay: Replay, folder: Path) -> None:
    """Write a replay's files into an empty folder; the same replay gives the same bytes.

    Parameters
    ----------
    folder : Path
        Exists; its other files are left alone.
    """
    begin("writing the results")
    settings = render_toml(replay.config)
    report = build_report(
        replay.dive,
        replay.config,
        replay.tables,
        replay.verdicts,
        replay.notes,
        replay.start_ns,
        replay.end_ns,
        this_tool(),
    )
    for layout, rows in each_table(replay.tables):
        (folder / f"{layout.name}.csv").write_text(structs_csv(layout.row, rows), "utf-8")
    logs.write_replay(
        folder / "replay.mcap",
        dive=replay.dive,
        histories=replay.histories,
        dvl=_measured(replay.histories),
        errors=replay.errors,
        tables=replay.tables,
        notes=replay.notes,
        config_toml=settings,
        version=__version__,
    )
    (folder / "config.toml").write_text(settings, "utf-8")
    (folder / "run.log").write_text(run_log(report), "utf-8")
    begin("drawing the report")
    strips = replay_coverage(replay)  # before the figures, which hold much until they are drawn
    (folder / PAGE).write_bytes(dive_page(report, replay_figures(replay), strips, settings))
    (folder / "report.json").write_bytes(encode_report(report))


def _measured(histories: tuple[History, ...]) -> dict[str, tuple[TimeNs, Floats]]:
    """Give the DVL's velocity and derived acceleration as the first filter that is aided by each met them."""
    measured: dict[str, tuple[TimeNs, Floats]] = {}
    for history in histories:
        for innovations in history.innovations:
            measured.setdefault(innovations.measurement, (innovations.valid_ns, innovations.measured_b))
    return measured


def run_log(report: Report) -> str:
    """Write down what was read and noticed, a line each; no time of day, so that it can be compared."""
    return "".join(f"{visible(line)}\n" for line in _log_lines(report))


def _log_lines(report: Report) -> Iterator[str]:
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
