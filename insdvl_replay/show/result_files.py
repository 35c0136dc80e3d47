"""A replay on disk: the files of a result folder."""

import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.errors import visible
from insdvl_replay.core.held_out import held_out_sensor
from insdvl_replay.core.quantities import is_whole
from insdvl_replay.core.report import (
    Report,
    as_json,
    build_report,
    this_tool,
)
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.states import DVL_AIDING
from insdvl_replay.core.tables import each_table
from insdvl_replay.core.version import __version__
from insdvl_replay.document.parts import Block
from insdvl_replay.document.tables import table_csv
from insdvl_replay.logs import write_replay
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.results.folder import (
    COMPLETE,
    LAYOUT_FILES,
    PAGE,
    REPLAY_LOG,
    SETTINGS_FILE,
    TRAJECTORY_FILE,
    history_file,
    require_parquet,
)
from insdvl_replay.results.trajectory import trajectory_of, write_trajectory
from insdvl_replay.show.answers import has_reference
from insdvl_replay.show.dive import NO_REFERENCE, dive_page
from insdvl_replay.show.plots.all_plots import first_panels, replay_figures
from insdvl_replay.show.plots.coverage import coverage_strips


def report_of(replay: Replay) -> Report:
    """Return the report of a replay."""
    return build_report(
        replay.dive, replay.config, replay.tables, replay.verdicts, replay.notes, replay.start_ns, replay.end_ns,
        this_tool(),
    )  # fmt: skip


def save_replay(replay: Replay, folder: Path, *, histories: bool = True) -> None:
    """Write a replay's files into a folder, whose other files are left alone; the same replay gives the same bytes.

    Without histories there is no replay.mcap, by far the largest file, and no layout for its viewers.
    """
    report_stage("writing the results")
    settings = render_toml(replay.config)
    report = report_of(replay)
    for layout, rows in each_table(replay.tables):
        (folder / f"{layout.name}.csv").write_bytes(table_csv(Block.of(layout.row, rows)))
    if histories:
        _save_histories_for_viewers(replay, folder, settings)
    for name, text in replay.printed.items():
        (folder / f"candidate_{name}.txt").write_text(text, "utf-8")
    write_trajectory(folder / TRAJECTORY_FILE, trajectory_of(replay))
    (folder / SETTINGS_FILE).write_text(settings, "utf-8")
    (folder / "run.log").write_text(run_log(report), "utf-8")
    report_stage("drawing the report")
    strips = coverage_strips(replay)  # before the figures, which hold much until they are drawn
    page = dive_page(report, first_panels(replay), replay_figures(replay), strips, settings)
    (folder / PAGE).write_bytes(page)
    (folder / COMPLETE).write_bytes(as_json(report))


def _save_histories_for_viewers(replay: Replay, folder: Path, settings: str) -> None:
    """Write replay.mcap, and the layouts of viewers that show it."""
    write_replay(
        folder / REPLAY_LOG,
        dive=replay.dive,
        histories=replay.histories,
        dvl=_met_velocities(replay),
        errors=replay.errors,
        tables=replay.tables,
        notes=replay.notes,
        config_toml=settings,
        version=__version__,
    )
    filters = [history.filter for history in replay.histories]
    for name, text in viewer_layouts(filters).items():
        (folder / name).write_text(text, "utf-8")


def _met_velocities(replay: Replay) -> dict[str, tuple[TimeNs, Floats]]:
    """Return the DVL's velocity and derived acceleration as the first filter that is aided by each met them."""
    met: dict[str, tuple[TimeNs, Floats]] = {}
    for history in replay.histories:
        for innovations in history.innovations:
            kind = innovations.measurement
            if kind in DVL_AIDING and kind not in met:
                met[kind] = (innovations.valid_ns, innovations.measured)
    return met


def viewer_layouts(filters: Sequence[str]) -> dict[str, str]:
    """Return the layouts of the first filter and of the one after it, by the names of their files."""
    names = {"baseline": filters[0], "aided": filters[min(1, len(filters) - 1)]}
    folder = resources.files("insdvl_replay").joinpath("show", "layouts")
    layouts = {}
    for file in LAYOUT_FILES:
        text = folder.joinpath(file).read_text("utf-8")
        layouts[file] = re.sub(r"\b(baseline|aided)\b", lambda found: names[found[1]], text)
    return layouts


def run_log(report: Report) -> str:
    """Return what was read and noticed, a line each; no time of day, so that it can be compared."""
    log = report.log
    lines = [
        f"{report.tool.name} {report.tool.version}",
        f"log {log.name}, sha256 {log.sha256 or 'none'}",
    ]
    for channel in log.channels:
        kind = f"({channel.type_name}, {channel.encoding})"
        role = channel.role or "not used"
        lines.append(f"channel {channel.topic} {kind}: {channel.messages} messages, {role}")
    lines.append(
        f"replay {log.duration_s:.3f} s, from {log.start_ns} ns to {log.end_ns} ns on the log's clock"
    )
    for row in report.tables.consistency:
        sensor = held_out_sensor(row.measurement)
        if sensor:
            lines.append(
                f"filter {row.filter}: {row.rejected} readings of {sensor} held out, used only for comparison"
            )
        elif is_whole(row.measurement):
            rejected = f"{row.rejected} rejected by the gate"
            lines.append(f"filter {row.filter}: {row.used} {row.measurement} updates, {rejected}")
    lines += [candidate.sentence for candidate in report.filters.values()]
    if not has_reference(report):
        lines.append(NO_REFERENCE)
    for note in report.notes:
        line = f"{note.severity} {note.code} [{note.count}]: {note.text}"
        if note.hint:
            line += f" (hint: {note.hint})"
        lines.append(line)
    return "".join(f"{visible(line)}\n" for line in lines)


def save_histories(replay: Replay, folder: Path, format_: str) -> None:
    """Write the whole history of each filter, as CSV with all digits, or as Parquet."""
    from insdvl_replay.results.frames import history_frame

    for history in replay.histories:
        path = folder / history_file(history.filter, format_)
        frame = history_frame(history)
        if format_ == "csv":
            path.write_bytes(table_csv(frame))
        else:
            require_parquet("--history parquet", "--history csv")
            frame.to_parquet(path, index=False)
