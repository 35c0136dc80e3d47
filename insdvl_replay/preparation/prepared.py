"""Before the filters: move the reference to the IMU, solve the pings, find the span, settle gaps, and align."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.checks.sensors import contradiction_notes, depth_at_start_notes
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import (
    Dive,
    Floats,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note, error_context
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.frames import DvlMounting, moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.nav.dvl import DvlBeams, DvlVelocities, dvl_beams, dvl_velocities
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.timeline import Gaps
from insdvl_replay.preparation.alignment import Alignment, align
from insdvl_replay.preparation.filters import ResolvedFilter, dvl_mounting, resolve_filters
from insdvl_replay.preparation.long_gaps import apply_gap_policy, find_gaps
from insdvl_replay.preparation.own_measurements import prepare_own_measurements
from insdvl_replay.preparation.sensors import prepare_sensors, withheld_notes
from insdvl_replay.preparation.start_by_sensors import started_by_sensors

MOST_DROPPED: Final = 0.5
"""Of the pings; where more of them are dropped, what drops them is not meant so."""
RESIDUAL_HINT: Final = "dvl.max_beam_residual_mps several times the noise of a beam, or leave it out"
IN_LINE: Final = np.eye(3)
"""The axes of the reference are those of the IMU."""


@dataclass(frozen=True)
class Prepared:
    """All that the filters of one dive share.

    Attributes
    ----------
    velocities : DvlVelocities
        What the DVL measured, inside the span.
    alignment : Alignment
        When and where the filters start.
    end_ns : int
        End of the span.
    gaps : Gaps
        The IMU's long gaps inside the span, which the filters bridge.
    filters : tuple of ResolvedFilter
        The first is the baseline.
    beams : DvlBeams or None
        Single beams inside the span, if a filter is aided by them.
    sensors : dict of str to Measurement
        What else was read, see `sensors.prepare_sensors`.
    notes : tuple of Note
        What was dropped or assumed on the way.
    """

    velocities: DvlVelocities
    alignment: Alignment
    end_ns: int
    gaps: Gaps
    mounting: DvlMounting
    filters: tuple[ResolvedFilter, ...]
    beams: DvlBeams | None
    sensors: dict[str, Measurement]
    notes: tuple[Note, ...]

    @property
    def sensor_sd(self) -> dict[str, Floats]:
        """Noise of the components of one reading of each sensor, shape (s,), in its SI unit."""
        variances = {name: np.diagonal(one.cov, axis1=1, axis2=2) for name, one in self.sensors.items()}
        return {name: np.sqrt(np.median(variance, axis=0)) for name, variance in variances.items()}


def with_reference_at_imu(dive: Dive, config: Config) -> Dive:
    """Move the reference of a dive to the IMU, where the filters are, and turn its attitude to the IMU's axes.

    A reference without any number is none. ConfigError where it is of another point than the IMU, and gives no attitude
    to say where that is.
    """
    if dive.reference is None:
        return dive
    reference = reference_as_configured(dive.reference, dive.imu, config)
    if len(reference.time_ns):
        return replace(dive, reference=reference)
    if dive.reference.has_position or dive.reference.has_velocity:
        raise ConfigError(
            f"{dive.name}: the reference gives no attitude by which reference.lever_arm_m could move it to the IMU",
            "--set reference.lever_arm_m=[0,0,0], and its errors hold the lever arm",
        )
    return replace(dive, reference=None)


def prepare_dive(dive: Dive, config: Config) -> Prepared:
    """Do everything that comes before the filters of a dive from `with_reference_at_imu`: pings, span, and alignment.

    LogError where there is nothing to replay in the span, or no reference to start from; ConfigError where the settings
    do not fit the dive; ValueError where it is what a replay keeps of it, without the readings of the IMU.
    """
    if len(dive.imu.specific_force_b) != len(dive.imu.time_ns):
        raise ValueError(f"{dive.name}: the readings of its IMU were let go; read the log anew")
    mounting = dvl_mounting(config)
    velocities, notes = _velocities(dive, mounting, config.dvl.max_beam_residual_mps)
    start_ns, end_ns = _span(dive, velocities, config)
    gaps = find_gaps(dive.imu.time_ns, config.imu)
    with error_context(dive.name):
        start_ns, end_ns, gap_notes = apply_gap_policy(gaps, config.imu, start_ns, end_ns, int(dive.imu.time_ns[0]))
        sensed = started_by_sensors(config, dive.sensors, dive.reference, start_ns, end_ns)
        config = sensed.config
        filters = resolve_filters(config)
        noise = filters[0].sensor_noise(velocities)
        alignment = align(
            dive.imu,
            velocities,
            noise,
            dive.reference,
            config.initial,
            mounting.lever_arm_b,
            sensed.start_ns,
            end_ns,
            sensed.mat_nb,
            is_fix=sensed.fix is not None,
        )
        alignment = replace(alignment, start=sensed.at_imu(alignment.start))
        sensors, sensor_notes = prepare_sensors(
            dive.sensors, config, alignment.start, alignment.start_ns, end_ns, sensed.told_ns
        )
        own, own_notes = prepare_own_measurements(
            dive, config, filters, len(sensors), alignment.start, alignment.start_ns, end_ns
        )
    inside = velocities.within(alignment.start_ns, end_ns)
    by_beams = any("beams" in filter_.aiding for filter_ in filters)
    beams = dvl_beams(dive.dvl, mounting, alignment.start_ns, end_ns) if by_beams else None
    read = _within(dive.sensors, alignment.start_ns, end_ns)
    notes += (
        gap_notes
        + sensed.notes
        + alignment.notes
        + _outside_notes(dive.name, velocities, inside)
        + sensor_notes
        + withheld_notes(config)
        + contradiction_notes(read, dive.reference, config.depth)
        + depth_at_start_notes(read, dive.reference, alignment.row, config)
        + own_notes
    )
    gaps = gaps.within(alignment.start_ns, end_ns)
    return Prepared(inside, alignment, end_ns, gaps, mounting, filters, beams, sensors | own, notes)


def _within(sensors: Mapping[str, SensorColumns], start_ns: int, end_ns: int) -> dict[str, SensorColumns]:
    """Keep the readings inside the span."""
    return {name: one.rows((one.time_ns >= start_ns) & (one.time_ns <= end_ns)) for name, one in sensors.items()}


def _velocities(dive: Dive, mounting: DvlMounting, limit_mps: float | None) -> tuple[DvlVelocities, tuple[Note, ...]]:
    """Solve the pings, and count those that gave no velocity."""
    velocities = dvl_velocities(dive.dvl, mounting, limit_mps or np.inf)
    if not len(velocities.time_ns):
        if bad := velocities.pings_with_bad_residual:
            text = f"{dive.name}: the beams of all {bad} solved pings disagree by more than {limit_mps:g} m/s"
            raise LogError(text, RESIDUAL_HINT)
        raise LogError(
            f"{dive.name}: none of the DVL's {len(dive.dvl.time_ns)} pings has a velocity",
            "three valid beams, or a finite bottom-track velocity, are needed; was the seabed in range?",
        )
    notes = []
    if lost := velocities.pings_without_velocity:
        notes.append(
            Note("dvl_no_velocity", f"pings with fewer than three valid beams or no finite velocity: {lost}", lost)
        )
    if bad := velocities.pings_with_bad_residual:
        text = f"pings whose beams disagree by more than {limit_mps:g} m/s: {bad}"
        notes.append(_residual_note(text, bad, bad + len(velocities.time_ns)))
    if three := int(np.sum(velocities.beams_used == 3)):
        notes.append(Note("dvl_three_beams", f"pings solved from three beams, without a check: {three}", three))
    return velocities, tuple(notes)


def _residual_note(text: str, bad: int, solved: int) -> Note:
    """Count the pings that their beams' residual drops; noise does not drop most."""
    if bad <= MOST_DROPPED * solved:
        return Note("dvl_bad_residual", text, bad)
    return Note("dvl_bad_residual", f"{text} of {solved}, most of them", bad, Severity.WARNING, RESIDUAL_HINT)


def _span(dive: Dive, velocities: DvlVelocities, config: Config) -> tuple[int, int]:
    """Return the span that the IMU covers, the DVL reaches and the configuration wants."""
    first_ns, last_ns = int(dive.imu.time_ns[0]), int(dive.imu.time_ns[-1])
    start_s, end_s = config.span.start_s, config.span.end_s
    start_ns = first_ns if start_s is None else max(first_ns, first_ns + nanoseconds(start_s))
    end_ns = last_ns if end_s is None else min(last_ns, first_ns + nanoseconds(end_s))
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
    return (Note("dvl_outside_span", f"pings before the start of the replay or after its end: {outside}", outside),)


def reference_as_configured(reference: ReferenceColumns, imu: ImuColumns, config: Config) -> ReferenceColumns:
    """Turn and move a reference as ``[reference]`` says; see `reference_at_imu`."""
    mounting_rpy = np.array(config.reference.mounting_rpy_deg) * DEG
    return reference_at_imu(reference, imu, np.array(config.reference.lever_arm_m), mat_from_rpy(mounting_rpy))


def reference_at_imu(
    reference: ReferenceColumns, imu: ImuColumns, lever_arm_b: Floats, mat_br: Floats = IN_LINE
) -> ReferenceColumns:
    """Turn a reference, ``C = C_r C_b^r``, and move it to the IMU: ``p_imu = p - C l``, ``v_imu = v - C (w_eb x l)``.

    Parameters
    ----------
    reference : ReferenceColumns
        r rows.
    imu : ImuColumns
        Gives the angular rate, linear between samples.
    lever_arm_b : ndarray, shape (3,)
        IMU to the reference's point, m.
    mat_br : ndarray, shape (3, 3)
        From the axes of the reference's attitude to the IMU's.

    Returns
    -------
    ReferenceColumns
        Rows without an attitude lose their position and velocity, rows outside the IMU's samples their velocity. Rows
        of which no number is left are left out. With no lever arm and no turn, and numbers in all rows, the reference
        itself.
    """
    if np.any(mat_br != IN_LINE):
        reference = replace(reference, mat_nb=reference.mat_nb @ mat_br.T)
    moved = _moved(reference, imu, lever_arm_b) if np.any(lever_arm_b) else reference
    said = np.any(list(moved.known.values()), axis=0)
    return moved if said.all() else moved.rows(said)


def _moved(reference: ReferenceColumns, imu: ImuColumns, lever_arm_b: Floats) -> ReferenceColumns:
    arm_n = reference.mat_nb @ lever_arm_b
    arm_velocity_n = np.einsum("kij,kj->ki", reference.mat_nb, np.cross(_rate_eb_b(reference, imu), lever_arm_b))
    return replace(
        reference,
        position=moved_position(reference.position, -arm_n),
        velocity_n=reference.velocity_n - arm_velocity_n,
    )


def _rate_eb_b(reference: ReferenceColumns, imu: ImuColumns) -> Floats:
    sample_s, row_s = seconds(imu.time_ns, imu.time_ns[0]), seconds(reference.time_ns, imu.time_ns[0])
    columns = [np.interp(row_s, sample_s, column, np.nan, np.nan) for column in imu.angular_rate_b.T]
    latitude = np.where(np.isfinite(reference.position[:, 0]), reference.position[:, 0], 0.0)
    rate_ie_b = np.einsum("kji,kj->ki", reference.mat_nb, earth_rate_n(latitude))
    rate_eb_b: Floats = np.column_stack(columns) - rate_ie_b
    return rate_eb_b
