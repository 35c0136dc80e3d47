"""The window study: how many past velocities make the best acceleration, by the reference's."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from insdvl_replay.core.config import Acceleration, Config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, seconds
from insdvl_replay.core.dive_record import dive_name
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.errors import acceleration_at, differentiated_over_s, reference_acceleration, vector_rmse
from insdvl_replay.geometry.frames import DvlMounting
from insdvl_replay.nav.dvl import DvlVelocities, SlopeWindows, slope_windows, windowed_sum
from insdvl_replay.nav.timeline import Gaps
from insdvl_replay.preparation.prepared import read_checked_dive, reference_as_configured
from insdvl_replay.preparation.run import prepare_with_heading
from insdvl_replay.studies.study_report import StudyReport, write_study
from insdvl_replay.studies.window_document import window_display, window_figure, window_sentences

COMPENSATED: Final = "compensated"
IGNORED: Final = "ignored"
NO_ARM: Final = "none"
"""What was done about the lever arm between IMU and DVL; `NO_ARM` where the configuration has none."""
MIDDLE: Final = "middle"
END: Final = "end"
"""Where a slope is held against the reference: at the mean time of its window, or at its last ping, where it serves."""
POOLED: Final = "*"
"""Stands for the log in rows that pool several."""
WINDOW_COLUMNS: Final = ["log", "n", "at", "lever_arm", "rmse_mps2", "samples"]
LEFT_OUT: Final = "log_left_out"
"""Code of the note on a log that cannot be used."""


def study_window(paths: Sequence[Path], config: Config, longest: int = 10, *, jobs: int = 1) -> StudyReport:
    """Hold the accelerations from 2 to ``longest`` velocities against the reference of each log.

    Parameters
    ----------
    paths : sequence of Path
        Logs, each with a name of its own.
    config : Config
        The pause that starts a new window is that of the first filter that uses accelerations.
    longest : int
        Largest number of velocities, 2 or more.

    Returns
    -------
    StudyReport
        Table ``window``: log, n, at (``middle``, ``end``), lever_arm (``compensated``, ``ignored``, ``none``),
        rmse_mps2, samples; with several logs, rows of log ``*`` pool them. Table ``best``: those with the least error.
        A log that cannot be used is left out, with a note (``log_left_out``).

    Raises
    ------
    LogError
        None of the logs can be used, or has a reference that gives an acceleration.
    ConfigError
        Two logs share a name, or the settings do not fit a log.
    """
    _check_names(paths)
    studied, left_out = _studied(paths, config, longest, jobs)
    tables, spans_s, notes = zip(*studied, strict=True)
    windows = pd.concat(tables, ignore_index=True)
    if len(tables) > 1:
        windows = pd.concat([pooled_windows(windows), windows], ignore_index=True)
    best = best_windows(windows)
    return StudyReport(
        study="window",
        title=f"Window study: {', '.join(map(dive_name, paths))}",
        arguments={"logs": list(map(dive_name, paths)), "longest": longest},
        sentences=window_sentences(best, spans_s),
        tables={"window": windows, "best": best},
        display=window_display(windows, best),
        config=config,
        notes=(*(note for of_dive in notes for note in of_dive), *left_out),
    )


def save_window(report: StudyReport, folder: Path, *, png: bool = False) -> None:
    """Write a study's files into an empty folder; the same study gives the same bytes.

    Parameters
    ----------
    report : StudyReport
        From `study_window`.
    folder : Path
        Exists.
    png : bool
        Draw the picture as PNG, too.
    """
    write_study(report, folder, {"window": window_figure(report.tables["window"])}, png=png)


def dive_windows(dive: Dive, config: Config, longest: int) -> tuple[pd.DataFrame, float, tuple[Note, ...]]:
    """Hold the accelerations from 2 to ``longest`` velocities of one dive against its reference.

    All windows are judged at the same pings, those whose longest window is whole, so that no number of velocities has
    an easier dive than another.
    """
    reference = _reference(dive, config)
    start = prepare_with_heading(replace(dive, reference=reference), config)
    velocities = start.velocities
    max_gap_s = _max_gap_s(config)
    time_s = seconds(velocities.time_ns, velocities.time_ns[:1])
    windows = {n: slope_windows(time_s, n, 1, max_gap_s) for n in range(2, longest + 1)}
    expected_b = _expected(windows, velocities, reference, max_gap_s)
    judged = windows[longest].complete & ~_across_gaps(start.gaps, velocities, longest)
    judged &= np.all([np.isfinite(expected).all(axis=1) for expected in expected_b.values()], axis=0)
    if not judged.any():
        raise LogError(
            f"{dive.name}: none of {len(time_s)} pings ends a window of {longest} velocities without a pause above "
            f"{max_gap_s:g} s in DVL and reference",
            f"shorten the windows, such as --longest {max(2, longest // 2)}",
        )
    rows = []
    for lever_arm, velocity_b in _velocities_at_imu(dive, velocities, start.mounting).items():
        for (at, n), expected in expected_b.items():
            slope_b = windowed_sum(windows[n].velocity_weights, velocity_b)
            rows.append((dive.name, n, at, lever_arm, vector_rmse(slope_b, expected, judged), int(judged.sum())))
    return pd.DataFrame(rows, columns=WINDOW_COLUMNS), differentiated_over_s(reference), dive.notes + start.notes


def _studied(
    paths: Sequence[Path], config: Config, longest: int, jobs: int
) -> tuple[list[tuple[pd.DataFrame, float, tuple[Note, ...]]], list[Note]]:
    """Study each log, and go on where one cannot be used."""

    def study(path: Path) -> tuple[pd.DataFrame, float, tuple[Note, ...]] | LogError:
        try:
            return dive_windows(read_checked_dive(path, config.without_solutions()), config, longest)
        except LogError as error:
            return error

    found = list(parallel_map(study, paths, jobs))
    studied = [one for one in found if not isinstance(one, LogError)]
    refused = [one for one in found if isinstance(one, LogError)]
    if not studied:
        raise refused[0]
    return studied, [Note(LEFT_OUT, f"{error.message}; left out", 1, Severity.WARNING, error.hint) for error in refused]


def _check_names(paths: Sequence[Path]) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        name = dive_name(path)
        if name in seen:
            raise ConfigError(f"{seen[name]} and {path} have the same name", "rename one of them")
        seen[name] = path


def _reference(dive: Dive, config: Config) -> ReferenceColumns:
    if dive.reference is None or not (dive.reference.has_velocity and dive.reference.has_attitude):
        raise LogError(
            f"{dive.name}: there is no reference with velocity and attitude to hold accelerations against",
            "name its topic, such as --set reference.topic=/ins/odometry",
        )
    return reference_as_configured(dive.reference, dive.imu, config)


def _max_gap_s(config: Config) -> float:
    configured = (filter_.acceleration for filter_ in config.filters.values() if filter_.acceleration is not None)
    return next(configured, Acceleration()).max_window_gap_s


def _expected(
    windows: dict[int, SlopeWindows], velocities: DvlVelocities, reference: ReferenceColumns, max_gap_s: float
) -> dict[tuple[str, int], Floats]:
    """Return the reference's acceleration at the middle and at the end of each window, by place and size."""
    acceleration_b = reference_acceleration(reference, max_gap_s)
    middle_ns = {
        n: velocities.time_ns[:1] + np.round(window.middle_s * 1e9).astype(np.int64) for n, window in windows.items()
    }
    return {
        (at, n): acceleration_at(time_ns, reference.time_ns, acceleration_b)
        for at, times in ((MIDDLE, middle_ns), (END, dict.fromkeys(windows, velocities.time_ns)))
        for n, time_ns in times.items()
    }


def _across_gaps(gaps: Gaps, velocities: DvlVelocities, longest: int) -> NDArray[np.bool_]:
    """Find which pings end a window over a long gap of the IMU, in which the lever arm's velocity is unknown."""
    first = np.maximum(np.arange(len(velocities.time_ns)) - longest + 1, 0)
    return gaps.overlap(velocities.time_ns[first], velocities.time_ns)


def _velocities_at_imu(dive: Dive, velocities: DvlVelocities, mounting: DvlMounting) -> dict[str, Floats]:
    """Take ``w x l`` out of the DVL's velocities, and leave it in.

    The gyro's rate stands for that against the Earth: the Earth's own moves a lever arm of a metre by 0.07 mm/s, and
    steadily.
    """
    lever_arm_b = mounting.lever_arm_b
    if not lever_arm_b.any():
        return {NO_ARM: velocities.velocity_b}
    ping_s, sample_s = (seconds(time_ns, dive.imu.time_ns[:1]) for time_ns in (velocities.time_ns, dive.imu.time_ns))
    rate_b = np.column_stack([np.interp(ping_s, sample_s, axis) for axis in dive.imu.angular_rate_b.T])
    return {
        COMPENSATED: velocities.velocity_b - np.cross(rate_b, lever_arm_b),
        IGNORED: velocities.velocity_b,
    }


def pooled_windows(table: pd.DataFrame) -> pd.DataFrame:
    """Pool the logs of a window study, each sample with the same weight."""
    squares = table.assign(squares=table["samples"] * table["rmse_mps2"] ** 2)
    sums = squares.groupby(["lever_arm", "at", "n"], sort=False, as_index=False)[["squares", "samples"]].sum()
    return sums.assign(log=POOLED, rmse_mps2=np.sqrt(sums["squares"] / sums["samples"]))[WINDOW_COLUMNS]


def best_windows(table: pd.DataFrame) -> pd.DataFrame:
    """Find the number of velocities with the least error, for each log, place and lever arm."""
    least = table.groupby(["log", "lever_arm", "at"], sort=False)["rmse_mps2"].idxmin()
    return table.loc[least].reset_index(drop=True)
