"""A replay on disk: the files of a result folder."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from insdvl_replay import __version__, logs
from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.quantities import WITHHELD, is_whole
from insdvl_replay.core.runtime import report_stage
from insdvl_replay.core.states import DVL_AIDING
from insdvl_replay.core.tables import ConsistencyRow, each_table
from insdvl_replay.geometry.frames import east_north_up_m, quat_enu_flu
from insdvl_replay.replay import Replay
from insdvl_replay.report.csv_tables import structs_csv
from insdvl_replay.results.dive_document import dive_page
from insdvl_replay.results.dive_figures import replay_coverage, replay_figures, replay_first_panels
from insdvl_replay.results.dive_tables import NO_REFERENCE, has_reference
from insdvl_replay.results.folder import PAGE, REFERENCE_TRAJECTORY, REPLAY_LOG, TRAJECTORY_FILE, trajectory_file
from insdvl_replay.results.histories import write_history
from insdvl_replay.results.json_report import Report, build_report, encode_report, this_tool
from insdvl_replay.results.trajectory import trajectory_of, write_trajectory
from insdvl_replay.results.viewer_layouts import viewer_layouts


def save_trajectories(replay: Replay, folder: Path) -> None:
    """Write the trajectory of each filter, and of the reference inside the replay, if its positions are known.

    All count from where the baseline starts, and all are of the IMU.

    Parameters
    ----------
    folder : Path
        Exists; its other files are left alone.
    """
    origin = replay.histories[0].position[0]
    for history in replay.histories:
        text = tum_trajectory(history.time_ns, history.position, history.mat_nb, origin)
        (folder / trajectory_file(history.filter)).write_bytes(text)
    reference = replay.dive.reference
    if reference is None:
        return
    inside = (reference.time_ns >= replay.start_ns) & (reference.time_ns <= replay.end_ns)
    text = tum_trajectory(reference.time_ns[inside], reference.position[inside], reference.mat_nb[inside], origin)
    if text:
        (folder / REFERENCE_TRAJECTORY).write_bytes(text)


def save_histories(replay: Replay, folder: Path, format_: str) -> None:
    """Write the whole history of each filter, as CSV or Parquet."""
    for history in replay.histories:
        write_history(history, folder, format_)


def tum_trajectory(time_ns: TimeNs, position: Floats, mat_nb: Floats, origin: Floats) -> bytes:
    """Write a trajectory.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    mat_nb : ndarray, shape (k, 3, 3)
        NaN where no attitude is known.
    origin : ndarray, shape (3,)
        Position from which east, north and up are counted.

    Returns
    -------
    bytes
        Times as they are, to the nanosecond; forward-port-up to east-north-up. The format knows no missing positions:
        times without one have no line. A missing attitude is NaN, which evo takes where it compares positions.
    """
    known = np.isfinite(position).all(axis=1)
    columns = np.hstack([east_north_up_m(position[known], origin), quat_enu_flu(mat_nb[known])])
    return "".join(_lines(time_ns[known].tolist(), columns.tolist())).encode()


def _lines(times_ns: Iterable[int], rows: Iterable[Iterable[float]]) -> Iterable[str]:
    for time_ns, row in zip(times_ns, rows, strict=True):
        second, nanosecond = divmod(time_ns, NS_PER_S)
        yield f"{second}.{nanosecond:09d} {' '.join(f'{number:.9g}' for number in row)}\n"


def save_replay(replay: Replay, folder: Path, *, histories: bool = True) -> None:
    """Write a replay's files into an empty folder; the same replay gives the same bytes.

    Parameters
    ----------
    folder : Path
        Exists; its other files are left alone.
    histories : bool
        Whether to write replay.mcap, by far the largest file, and the layouts for its viewers.
    """
    report_stage("writing the results")
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
    if histories:
        logs.write_replay(
            folder / REPLAY_LOG,
            dive=replay.dive,
            histories=replay.histories,
            dvl=_measured(replay.histories),
            errors=replay.errors,
            tables=replay.tables,
            notes=replay.notes,
            config_toml=settings,
            version=__version__,
        )
        for name, layout_text in viewer_layouts([history.filter for history in replay.histories]).items():
            (folder / name).write_text(layout_text, "utf-8")
    write_trajectory(folder / TRAJECTORY_FILE, trajectory_of(replay))
    (folder / "config.toml").write_text(settings, "utf-8")
    (folder / "run.log").write_text(run_log(report), "utf-8")
    report_stage("drawing the report")
    strips = replay_coverage(replay)  # before the figures, which hold much until they are drawn
    (folder / PAGE).write_bytes(
        dive_page(report, replay_first_panels(replay), replay_figures(replay), strips, settings)
    )
    (folder / "report.json").write_bytes(encode_report(report))


def _measured(histories: tuple[History, ...]) -> dict[str, tuple[TimeNs, Floats]]:
    """Return the DVL's velocity and derived acceleration as the first filter that is aided by each met them."""
    measured: dict[str, tuple[TimeNs, Floats]] = {}
    for history in histories:
        for innovations in (one for one in history.innovations if one.measurement in DVL_AIDING):
            measured.setdefault(innovations.measurement, (innovations.valid_ns, innovations.measured))
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
            yield f"filter {row.filter}: {_counts(row)}"
    for candidate in report.filters.values():
        yield candidate.verdict
    if not has_reference(report):
        yield NO_REFERENCE
    for note in report.notes:
        hint = f" (hint: {note.hint})" if note.hint else ""
        yield f"{note.severity} {note.code} [{note.count}]: {note.text}{hint}"


def _counts(row: ConsistencyRow) -> str:
    if row.measurement.startswith(WITHHELD):
        return f"{row.rejected} readings of {row.measurement.removeprefix(WITHHELD)} withheld, and compared alone"
    return f"{row.used} {row.measurement} updates, {row.rejected} rejected by the gate"
