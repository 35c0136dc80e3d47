"""The hall: read a dive, run every configured filter over it, and lay what they believe beside what is so."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from insdvl_replay import __version__, logs
from insdvl_replay.columns import Dive, Floats, TimeNs
from insdvl_replay.config import Config
from insdvl_replay.config_file import render_toml
from insdvl_replay.errors import LogError, Note, about
from insdvl_replay.evaluation.believed import convergence_table, improvement_table, mean_over_nine
from insdvl_replay.evaluation.consistency import chi_square_quantile, consistency_table, update_notes
from insdvl_replay.evaluation.reference import ReferenceErrors, reference_error_table, reference_errors
from insdvl_replay.evaluation.verdicts import Verdict, verdicts
from insdvl_replay.history import History
from insdvl_replay.nav.aiding import filter_measurements, filter_noise
from insdvl_replay.nav.alignment import Alignment, align
from insdvl_replay.nav.dvl import DvlVelocities, dvl_velocities
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.gaps import find_gaps, settle_gaps
from insdvl_replay.nav.lever_arm import reference_at_imu
from insdvl_replay.nav.timeline import build_timeline
from insdvl_replay.report.csv_tables import table_csv
from insdvl_replay.report.json_report import Candidate, build_report, encode_report
from insdvl_replay.report.run_log import run_log
from insdvl_replay.rotation import mat_from_rpy
from insdvl_replay.states import DEG


@dataclass(frozen=True)
class Replay:
    """One dive, every filter's history, and the tables.

    Attributes
    ----------
    dive : Dive
        The columns that were replayed.
    config : Config
        Resolved settings.
    start_ns, end_ns : int
        Span of the replay.
    velocities : DvlVelocities
        What the DVL measured, inside the span.
    histories : tuple of History
        The first is the baseline.
    errors : dict of str to ReferenceErrors
        By filter name; empty without a reference.
    tables : dict of str to DataFrame
        ``improvement``, ``convergence``, ``reference_error``, ``consistency``.
    verdicts : tuple of Verdict
        One for each candidate.
    notes : tuple of Note
        What was dropped, assumed or found odd.
    """

    dive: Dive
    config: Config
    start_ns: int
    end_ns: int
    velocities: DvlVelocities
    histories: tuple[History, ...]
    errors: dict[str, ReferenceErrors]
    tables: dict[str, pd.DataFrame]
    verdicts: tuple[Verdict, ...]
    notes: tuple[Note, ...]


def replay_log(path: Path, config: Config, *, allow_damaged: bool = False) -> Replay:
    """Replay the dive in a log.

    Parameters
    ----------
    path : Path
        An MCAP file.
    config : Config
    allow_damaged : bool
        Replay what can be believed of a damaged log; what is lost is a note.

    Returns
    -------
    Replay

    Raises
    ------
    LogError
        The log cannot be used.
    ConfigError
        The settings do not fit the log.
    """
    return replay_dive(logs.read_dive(path, config, allow_damaged=allow_damaged), config)


def replay_dive(dive: Dive, config: Config, *, keep_cov: bool = False) -> Replay:
    """Run every configured filter over a dive, side by side, from the same start, and compare them.

    Parameters
    ----------
    dive : Dive
    config : Config
    keep_cov : bool
        Whether the histories keep all of P.

    Returns
    -------
    Replay

    Raises
    ------
    LogError
        Nothing to replay in the span, or no reference to start from.
    ConfigError
        The settings do not fit the dive.
    """
    if dive.reference is not None:
        lever_arm_b = np.array(config.reference.lever_arm_m)
        dive = replace(dive, reference=reference_at_imu(dive.reference, dive.imu, lever_arm_b))
    inside, alignment, end_ns, notes = prepare_dive(dive, config)
    histories = _run_filters(dive, inside, alignment, end_ns, config, keep_cov)
    notes += update_notes(histories)
    reference = dive.reference
    errors = {history.filter: reference_errors(history, reference) for history in histories} if reference else {}
    tables = {
        "improvement": improvement_table(dive.name, histories),
        "convergence": convergence_table(dive.name, histories),
        "reference_error": reference_error_table(dive.name, histories, errors),
        "consistency": consistency_table(dive.name, histories),
    }
    judged = verdicts(tables, config.baseline, [history.filter for history in histories[1:]])
    notes = dive.notes + notes + _reference_notes(dive, config)
    return Replay(dive, config, alignment.start_ns, end_ns, inside, histories, errors, tables, judged, notes)


def _reference_notes(dive: Dive, config: Config) -> tuple[Note, ...]:
    if dive.reference is None or config.reference.independent:
        return ()
    text = "the reference shares sensors with the filters: errors that they have in common are not seen"
    return (Note("reference_not_independent", text),)


def prepare_dive(dive: Dive, config: Config) -> tuple[DvlVelocities, Alignment, int, tuple[Note, ...]]:
    """Do everything that comes before the filters: solve the pings, find the span, and align.

    Parameters
    ----------
    dive : Dive
    config : Config

    Returns
    -------
    DvlVelocities
        Inside the span.
    Alignment
    int
        End of the span, ns.
    tuple of Note

    Raises
    ------
    LogError, ConfigError
        As of `replay_dive`.
    """
    velocities, notes = _velocities(dive, config)
    start_ns, end_ns = _span(dive, velocities, config)
    lever_arm_b = np.array(config.dvl.lever_arm_m)
    with about(dive.name):
        start_ns, end_ns, gap_notes = settle_gaps(
            find_gaps(dive.imu.time_ns, config.imu), config.imu, start_ns, end_ns, int(dive.imu.time_ns[0])
        )
        alignment = align(dive.imu, velocities, dive.reference, config.initial, lever_arm_b, start_ns, end_ns)
    inside = velocities.within(alignment.start_ns, end_ns)
    notes += gap_notes + alignment.notes
    return inside, alignment, end_ns, notes + _outside_notes(dive.name, velocities, inside)


def _velocities(dive: Dive, config: Config) -> tuple[DvlVelocities, tuple[Note, ...]]:
    """Solve the pings, and count those that gave no velocity."""
    velocities = dvl_velocities(
        dive.dvl,
        mat_from_rpy(np.array(config.dvl.mounting_rpy_deg) * DEG),
        config.dvl.scale,
        config.dvl.max_beam_residual_mps or np.inf,
    )
    if not len(velocities.time_ns):
        raise LogError(
            f"{dive.name}: none of the DVL's {len(dive.dvl.time_ns)} pings has a velocity",
            "three valid beams, or a finite bottom-track velocity, are needed; was the seabed in range?",
        )
    notes = []
    if lost := velocities.pings_without_velocity:
        notes.append(
            Note("dvl_no_velocity", f"{lost} pings have fewer than three valid beams or no finite velocity", lost)
        )
    if bad := velocities.pings_with_bad_residual:
        limit = config.dvl.max_beam_residual_mps
        notes.append(Note("dvl_bad_residual", f"{bad} pings have beams that disagree by more than {limit:g} m/s", bad))
    if three := int(np.sum(velocities.beams_used == 3)):
        notes.append(Note("dvl_three_beams", f"{three} pings are solved from three beams, without a check", three))
    return velocities, tuple(notes)


def _span(dive: Dive, velocities: DvlVelocities, config: Config) -> tuple[int, int]:
    """Give the span that the IMU covers, the DVL reaches and the configuration wants."""
    first_ns, last_ns = int(dive.imu.time_ns[0]), int(dive.imu.time_ns[-1])
    start_s, end_s = config.span.start_s, config.span.end_s
    start_ns = first_ns if start_s is None else max(first_ns, first_ns + round(start_s * 1e9))
    end_ns = last_ns if end_s is None else min(last_ns, first_ns + round(end_s * 1e9))
    if start_ns >= end_ns:
        duration_s = (last_ns - first_ns) * 1e-9
        wanted_end_s = duration_s if end_s is None else end_s
        raise LogError(
            f"{dive.name}: nothing lies between --start {start_s or 0:g} s and --end {wanted_end_s:g} s; "
            f"the IMU covers 0 to {duration_s:.1f} s",
            "--start and --end count seconds from the first IMU sample",
        )
    if velocities.time_ns[-1] <= start_ns or velocities.time_ns[0] > end_ns:
        before_s, after_s = ((int(velocities.time_ns[row]) - first_ns) * 1e-9 for row in (0, -1))
        raise LogError(
            f"{dive.name}: IMU and DVL do not overlap in time: the replay covers {(start_ns - first_ns) * 1e-9:.1f} to "
            f"{(end_ns - first_ns) * 1e-9:.1f} s from the first IMU sample, the DVL {before_s:.1f} to {after_s:.1f} s",
            "are both stamped by the same clock? try --set imu.stamp=log_time --set dvl.stamp=log_time",
        )
    return start_ns, end_ns


def _outside_notes(name: str, velocities: DvlVelocities, inside: DvlVelocities) -> tuple[Note, ...]:
    if not len(inside.time_ns):
        raise LogError(
            f"{name}: no DVL velocity lies between the start of the replay and its end",
            "check dvl.stamp and reference.stamp against imu.stamp, or widen --start and --end",
        )
    outside = len(velocities.time_ns) - len(inside.time_ns)
    if not outside:
        return ()
    return (Note("dvl_outside_span", f"{outside} pings lie before the start of the replay or after its end", outside),)


def _run_filters(
    dive: Dive, velocities: DvlVelocities, alignment: Alignment, end_ns: int, config: Config, keep_cov: bool
) -> tuple[History, ...]:
    reference_ns = dive.reference.time_ns if dive.reference else np.empty(0, dtype=np.int64)
    gaps = find_gaps(dive.imu.time_ns, config.imu)
    timeline = build_timeline(dive.imu, velocities.time_ns, reference_ns, alignment.start_ns, end_ns, gaps)
    return tuple(
        run_filter(
            name,
            timeline,
            alignment.start,
            filter_noise(filter_, config),
            filter_measurements(filter_, velocities, config, chi_square_quantile(filter_.gate_probability, 3), gaps),
            np.array(config.dvl.lever_arm_m),
            keep_cov=keep_cov,
        )
        for name, filter_ in config.filters.items()
    )


def save_replay(replay: Replay, folder: Path) -> None:
    """Write a replay's files into an empty folder; the same replay gives the same bytes.

    Parameters
    ----------
    replay : Replay
    folder : Path
        Exists; its other files are left alone.
    """
    settings = render_toml(replay.config)
    report = build_report(
        replay.dive,
        replay.config,
        replay.tables,
        {verdict.filter: _candidate(verdict, replay.tables) for verdict in replay.verdicts},
        replay.notes,
        replay.start_ns,
        replay.end_ns,
    )
    for name, table in replay.tables.items():
        (folder / f"{name}.csv").write_bytes(table_csv(table))
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
    (folder / "report.json").write_bytes(encode_report(report))


def _candidate(verdict: Verdict, tables: dict[str, pd.DataFrame]) -> Candidate:
    return Candidate(
        verdict=verdict.sentence,
        improvement=verdict.improvement,
        consistency=verdict.consistency,
        mean_improvement_pct=verdict.believed_pct,
        mean_convergence_improvement_pct=mean_over_nine(tables["convergence"], verdict.filter),
        reference_improvement_pct=verdict.actual_pct,
    )


def _measured(histories: tuple[History, ...]) -> dict[str, tuple[TimeNs, Floats]]:
    """Give the DVL's velocity and derived acceleration as the first filter that is aided by each met them."""
    measured: dict[str, tuple[TimeNs, Floats]] = {}
    for history in histories:
        for innovations in history.innovations:
            measured.setdefault(innovations.measurement, (innovations.valid_ns, innovations.measured_b))
    return measured
