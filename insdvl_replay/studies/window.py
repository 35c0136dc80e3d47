"""The window study: the number of velocities for the best acceleration, compared with the reference."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from insdvl_replay.core.config import Acceleration, Config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.dive_record import dive_name
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.document.parts import (
    Curve,
    DisplayTable,
    Figure,
    Panel,
    Result,
    filter_style,
)
from insdvl_replay.document.plot import limits
from insdvl_replay.document.tables import number, table_of
from insdvl_replay.evaluation.reference_errors import (
    acceleration_at,
    differentiated_over_s,
    reference_acceleration,
    vector_rmse,
)
from insdvl_replay.geometry.frames import DvlMounting
from insdvl_replay.nav.dvl import DvlVelocities, SlopeWindows, slope_windows, windowed_sum
from insdvl_replay.preparation.prepared import read_checked_dive, reference_as_configured
from insdvl_replay.preparation.run import prepare_with_heading

COMPENSATED = "compensated"
IGNORED = "ignored"
NO_ARM = "none"
"""Treatment of the lever arm between IMU and DVL; `NO_ARM` if the configuration has none."""
_ARM: Final = {
    COMPENSATED: ("With the lever arm compensated", "arm comp.", "lever arm compensated"),
    IGNORED: ("With the lever arm ignored", "arm ignored", "lever arm ignored"),
    NO_ARM: ("Without a lever arm", "no arm", "no lever arm"),
}
"""Start of a sentence, title of a column, and title of a panel."""
MIDDLE = "middle"
END = "end"
"""Time of the comparison with the reference: mean time of the window, or its last ping."""
_STYLES: Final = {MIDDLE: filter_style(1), END: filter_style(0)}
_ALONE: Final = "zero"
POOLED: Final = "*"
"""Name of the log in rows that pool several logs."""
WINDOW_COLUMNS: Final = ["log", "n", "at", "lever_arm", "rmse_mps2", "samples"]
LEFT_OUT: Final = "log_left_out"
"""Code of the note on a log that cannot be used."""
Windows = tuple[pd.DataFrame, float, tuple[Note, ...]]
"""Table of a dive, the time in s over which its reference is differentiated, and notes."""


def study_window(
    paths: Sequence[Path],
    config: Config,
    longest: int = 10,
    *,
    jobs: int = 1,
) -> Result:
    """Compare the accelerations from 2 to ``longest`` velocities with the reference of each log.

    The gap that starts a new window is that of the first filter with accelerations. With several logs, rows of log
    ``*`` pool them. A log that cannot be used is ignored, with a note. A LogError if none can be used, a ConfigError if
    two logs have the same name or the settings do not fit a log.
    """
    names = [dive_name(path) for path in paths]
    for place, name in enumerate(names):
        first = names.index(name)
        if first < place:
            text = f"{paths[first]} and {paths[place]} have the same name"
            raise ConfigError(text, "rename one of them")

    def study(path: Path) -> Windows | LogError:
        try:
            dive = read_checked_dive(path, config.without_solutions())
            return dive_windows(dive, config, longest)
        except LogError as error:
            return error

    found = list(parallel_map(study, paths, jobs))
    refused = [outcome for outcome in found if isinstance(outcome, LogError)]
    studied = [outcome for outcome in found if not isinstance(outcome, LogError)]
    if not studied:
        raise refused[0]
    windows = pd.concat([table for table, _, _ in studied], ignore_index=True)
    if len(studied) > 1:
        windows = pd.concat([pooled_windows(windows), windows], ignore_index=True)
    notes: list[Note] = []
    for _, _, dive_notes in studied:
        notes += dive_notes
    for error in refused:
        notes.append(
            note(
                LEFT_OUT,
                why=error.message,
                hint=error.hint,
            )
        )
    best = best_windows(windows)
    return Result(
        kind="window",
        title=f"Window study: {', '.join(names)}",
        sentences=tuple(_sentences(best, [span_s for _, span_s, _ in studied])),
        tables={"window": windows, "best": best},
        figures={"window": window_figure(windows)},
        notes=tuple(notes),
        config=config,
        arguments={"logs": names, "longest": longest},
        display=tuple(_display(windows, best)),
    )


def dive_windows(dive: Dive, config: Config, longest: int) -> Windows:
    """Compare the accelerations from 2 to ``longest`` velocities of one dive with its reference.

    All windows are compared at the same pings, those with a complete longest window, for a fair comparison.
    """
    if dive.reference is None or not (dive.reference.has_velocity and dive.reference.has_attitude):
        raise LogError(
            f"{dive.name}: no reference with velocity and attitude, which the study needs",
            "name its topic, such as --set reference.topic=/ins/odometry",
        )
    reference = reference_as_configured(dive.reference, dive.imu, config)
    start = prepare_with_heading(replace(dive, reference=reference), config)
    velocities = start.velocities
    max_gap_s = _longest_gap_s(config)
    time_s = seconds(velocities.time_ns, velocities.time_ns[:1])
    windows = {n: slope_windows(time_s, n, 1, max_gap_s) for n in range(2, longest + 1)}
    expected_b = _expected(windows, velocities, reference, max_gap_s)
    # A window over a long IMU gap is ignored: the lever arm's velocity is unknown.
    first = np.maximum(np.arange(len(velocities.time_ns)) - longest + 1, 0)
    in_gap = start.gaps.overlap(velocities.time_ns[first], velocities.time_ns)
    compared = windows[longest].complete & ~in_gap
    for expected in expected_b.values():
        compared &= np.isfinite(expected).all(axis=1)
    if not compared.any():
        raise LogError(
            f"{dive.name}: the {len(time_s)} pings have no window of {longest} velocities without a gap above "
            f"{max_gap_s:g} s in DVL or reference",
            f"shorten the windows, such as --longest {max(2, longest // 2)}",
        )
    rows = []
    for lever_arm, velocity_b in _velocities_at_imu(dive, velocities, start.mounting).items():
        for (at, n), expected in expected_b.items():
            slope_b = windowed_sum(windows[n].velocity_weights, velocity_b)
            rmse = vector_rmse(slope_b, expected, compared)
            rows.append((dive.name, n, at, lever_arm, rmse, int(compared.sum())))
    table = pd.DataFrame(rows, columns=WINDOW_COLUMNS)
    return table, differentiated_over_s(reference), dive.notes + start.notes


def _longest_gap_s(config: Config) -> float:
    """Return the gap that starts a new window, by the first filter with accelerations."""
    for filter_ in config.filters.values():
        if filter_.acceleration is not None:
            return filter_.acceleration.max_window_gap_s
    return Acceleration().max_window_gap_s


def _expected(
    windows: dict[int, SlopeWindows],
    velocities: DvlVelocities,
    reference: ReferenceColumns,
    max_gap_s: float,
) -> dict[tuple[str, int], Floats]:
    """Return the reference's acceleration at the middle and at the end of each window, by place and size."""
    acceleration_b = reference_acceleration(reference, max_gap_s)
    times: dict[tuple[str, int], TimeNs] = {}
    for n, window in windows.items():
        middle_ns = np.round(window.middle_s * 1e9).astype(np.int64)
        times[MIDDLE, n] = velocities.time_ns[:1] + middle_ns
    for n in windows:
        times[END, n] = velocities.time_ns
    expected_b = {}
    for key, time_ns in times.items():
        expected_b[key] = acceleration_at(time_ns, reference.time_ns, acceleration_b)
    return expected_b


def _velocities_at_imu(
    dive: Dive, velocities: DvlVelocities, mounting: DvlMounting
) -> dict[str, Floats]:
    """Return the DVL's velocities with ``w x l`` subtracted, and with it.

    The gyro's rate includes the Earth rate, which moves a lever arm of 1 m by a constant 0.07 mm/s.
    """
    lever_arm_b = mounting.lever_arm_b
    if not lever_arm_b.any():
        return {NO_ARM: velocities.velocity_b}
    ping_s = seconds(velocities.time_ns, dive.imu.time_ns[:1])
    sample_s = seconds(dive.imu.time_ns, dive.imu.time_ns[:1])
    columns = [np.interp(ping_s, sample_s, axis) for axis in dive.imu.angular_rate_b.T]
    rate_b = np.column_stack(columns)
    return {
        COMPENSATED: velocities.velocity_b - np.cross(rate_b, lever_arm_b),
        IGNORED: velocities.velocity_b,
    }


def pooled_windows(table: pd.DataFrame) -> pd.DataFrame:
    """Pool the logs of a window study, each sample with the same weight."""
    squares = table.assign(squares=table["samples"] * table["rmse_mps2"] ** 2)
    groups = squares.groupby(["lever_arm", "at", "n"], sort=False, as_index=False)
    sums = groups[["squares", "samples"]].sum()
    pooled = sums.assign(log=POOLED, rmse_mps2=np.sqrt(sums["squares"] / sums["samples"]))
    return pooled[WINDOW_COLUMNS]


def best_windows(table: pd.DataFrame) -> pd.DataFrame:
    """Find the number of velocities with the least error, for each log, place and lever arm."""
    least = table.groupby(["log", "lever_arm", "at"], sort=False)["rmse_mps2"].idxmin()
    return table.loc[least].reset_index(drop=True)


# --- Screen and pictures.


def _sentences(best: pd.DataFrame, differentiated_s: Sequence[float]) -> Iterator[str]:
    """Yield the best window at its middle and at its end, and the resolution of the reference."""
    for arm, rows in best[best["log"] == best["log"].iloc[0]].groupby("lever_arm", sort=False):
        middle = rows[rows["at"] == MIDDLE].iloc[0]
        end = rows[rows["at"] == END].iloc[0]
        yield (
            f"{_ARM[str(arm)][0]}, {middle['n']} velocities give the best acceleration at the middle of their window, "
            f"{number(middle['rmse_mps2'])} m/s^2 rms, and {end['n']} at its end, {number(end['rmse_mps2'])} m/s^2 "
            f"rms."
        )
    shortest_s = min(differentiated_s)
    longest_s = max(differentiated_s)
    over = f"{shortest_s:.3g} to {longest_s:.3g} s"
    if longest_s - shortest_s < 0.01:
        over = f"{shortest_s:.3g} s"
    yield f"The reference's acceleration is a difference of velocities over {over}. It misses faster changes."


def _display(windows: pd.DataFrame, best: pd.DataFrame) -> Iterator[DisplayTable]:
    """Yield the tables of errors by number of velocities, and of the best windows of each log."""
    first = windows[windows["log"] == windows["log"].iloc[0]]
    cells = first.pivot(index="n", columns=["lever_arm", "at"], values="rmse_mps2").map(number)
    kinds = list(first[["lever_arm", "at"]].drop_duplicates().itertuples(index=False, name=None))
    yield DisplayTable(
        f"Acceleration from n velocities against the reference's, rms [m/s^2], {first['samples'].iloc[0]} pings",
        ("n", *(f"{at},\n{_ARM[arm][1]}" for arm, at in kinds)),
        "r" * (1 + len(kinds)),
        tuple((str(n), *texts) for n, *texts in cells[kinds].itertuples(name=None)),
    )
    yield table_of(
        "Number of velocities with the smallest error",
        best,
        (
            ("log", "l", "log"),
            ("at", "l", "at"),
            ("lever arm", "l", "lever_arm"),
            ("n", "r", "n"),
            ("rms [m/s^2]", "r", "rmse_mps2"),
            ("pings", "r", "samples"),
        ),
        "log *: all logs together" if best["log"].iloc[0] == POOLED else "",
    )


def window_figure(windows: pd.DataFrame) -> Figure:
    """Draw the error at the middle and at the end of windows, one panel for each treatment of the lever arm."""
    first_log = windows["log"].iloc[0]
    panels = []
    for arm, of_arm in windows.groupby("lever_arm", sort=False):
        curves: list[Curve] = []
        by_log = list(of_arm.groupby(["log", "at"], sort=False))
        for (log, at), rows in reversed(by_log):  # the first log is on top
            curves += _curves(rows, str(at), "" if log == first_log else str(log))
        panels.append(
            Panel(
                f"rms error [m/s²], {_ARM[str(arm)][2]}",
                "number of velocities n",
                tuple(curves),
                y_scale="log",
                y_limits=limits(windows["rmse_mps2"].to_numpy(), "log"),
                x_whole=True,
            )
        )
    legend = [(style, f"{at} of the window") for at, style in _STYLES.items()]
    if windows["log"].nunique() > 1:
        legend.append((_ALONE, "single logs"))
    caption = "The dots mark the number of velocities with the smallest error."
    return Figure(
        "Acceleration errors by the number of velocities", caption, tuple(panels), tuple(legend)
    )


def _curves(rows: pd.DataFrame, at: str, single_log: str) -> Iterator[Curve]:
    """Give the curve of a log, and of the first log, which is shown without its name, the dot at the best window."""
    style = _STYLES[at]
    n = rows["n"].to_numpy(np.float64)
    rmse = rows["rmse_mps2"].to_numpy()
    name = f"{at} of the window"
    if single_log:
        yield Curve(n, rmse, f"{style} {_ALONE}", name=f"{name}, {single_log}")
        return
    yield Curve(n, rmse, style, name=name)
    least = int(rmse.argmin())
    yield Curve(n[[least]], rmse[[least]], style, points=True, name="")
