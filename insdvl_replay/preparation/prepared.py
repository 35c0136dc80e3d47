"""Before the filters: read and check a dive, move the reference to the IMU, solve the pings, treat gaps, and align."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from msgspec.structs import replace as changed

from insdvl_replay.checks.imu import length_refusal
from insdvl_replay.checks.reference import plausibility_notes, without_frozen
from insdvl_replay.checks.reference_delay import reference_on_time, with_reference_delay
from insdvl_replay.checks.sensors import (
    contradiction_notes,
    depth_at_start_notes,
    sensor_notes,
    solution_notes,
)
from insdvl_replay.core.config import Config, Imu, Span
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note, counted, error_context
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG, DV, PHI, STATES
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.frames import DvlMounting, moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs import name_giver, read_dive
from insdvl_replay.nav.dvl import DvlBeams, DvlVelocities, dvl_beams, dvl_velocities
from insdvl_replay.nav.earth_model import HOLD_AFTER_S
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.timeline import Gaps
from insdvl_replay.nav.user_measurement import NoiseFactors
from insdvl_replay.preparation.alignment import Alignment, align
from insdvl_replay.preparation.filters import (
    ResolvedFilter,
    dvl_mounting,
    held_out_notes,
    prepare_sensors,
    resolve_filters,
)
from insdvl_replay.preparation.plugins import prepare_user_measurements, prepare_user_noise

MOST_DROPPED: Final = 0.5  # of the pings: a residual limit that drops more is a mistake
RESIDUAL_HINT: Final = (
    "set dvl.max_beam_residual_mps to several times the noise of a beam, or leave it out"
)
FEWEST_PINGS: Final = 3  # with fewer, a replay is one of the IMU alone
# of the time of the IMU by the DVL, from its first to its last velocity
LEAST_COVERED: Final = 0.5
# of the pings: sensors that do not start and stop together explain fewer
MOST_OUTSIDE: Final = 0.2
LONGEST_BRIDGE_S: Final = 3600.0  # longer gaps cannot be bridged
# where an attitude may be off by more, errors no longer add up
WIDEST_ATTITUDE_RAD: Final = np.pi / 2.0
IN_LINE: Final = np.eye(3)  # the axes of the reference are those of the IMU


@dataclass(frozen=True)
class Prepared:
    """All that the filters of one dive share."""

    velocities: DvlVelocities  # inside the span
    alignment: Alignment
    end_ns: int
    gaps: Gaps  # long gaps of the IMU inside the span, which the filters bridge
    mounting: DvlMounting
    filters: tuple[ResolvedFilter, ...]  # the first is the baseline
    beams: DvlBeams | None  # inside the span, if a filter is aided by them
    sensors: dict[str, Measurement]  # what else was read, by sensor or ``module:Class``
    notes: tuple[Note, ...]
    # of the user's, by ``module:Class``
    noise: dict[str, NoiseFactors] = field(default_factory=dict)

    @property
    def sensor_sd(self) -> dict[str, Floats]:
        """Noise of the components of one reading of each sensor, shape (s,), in its SI unit."""
        found = {}
        for name, sensor in self.sensors.items():
            variance = np.diagonal(sensor.cov, axis1=1, axis2=2)
            found[name] = np.sqrt(np.median(variance, axis=0))
        return found


class KeptDive:
    """A dive that was read to find its settings, for the one who replays it; then its columns are let go."""

    def __init__(self, dive: Dive) -> None:
        self._dive: Dive | None = dive

    def taken(self, sha256: str) -> Dive | None:
        """Give the dive away, once and if its logs still have this digest."""
        dive = self._dive
        self._dive = None
        if dive is None or dive.sha256 != sha256:
            return None
        return dive


def read_checked_dive(
    path: Path | Sequence[Path],
    config: Config,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
) -> Dive:
    """Read a dive, and note what cannot be true in its columns; LogError where the tables would be wrong."""
    dive = read_dive(path, config, allow_damaged=allow_damaged)
    paths = [path] if isinstance(path, Path) else path
    place = str(name_giver(paths))
    if (error := length_refusal(place, dive.imu)) is not None:
        raise error
    if len(dive.dvl.time_ns) < FEWEST_PINGS:
        what = f"{counted(len(dive.dvl.time_ns), 'ping')} of the DVL can be used, and a replay needs {FEWEST_PINGS}"
        raise LogError(what, "check whether its log is whole, and dvl.topic and its flags", place)
    frozen: tuple[Note, ...] = ()
    if dive.reference is not None:
        reference, frozen = without_frozen(dive.imu, dive.dvl, dive.reference)
        dive = replace(dive, reference=reference)
    # A late reference would seem to contradict the sensors in all that it says.
    dive = with_reference_delay(dive, config)
    on_time = reference_on_time(dive)
    notes = frozen + plausibility_notes(place, dive.imu, dive.dvl, on_time, config)
    notes += sensor_notes(dive.sensors, on_time, config)
    notes += solution_notes(dive.solutions, on_time, config)
    return replace(dive, name=name or dive.name, notes=(*dive.notes, *notes))


def with_reference_at_imu(dive: Dive, config: Config) -> Dive:
    """Move the reference of a dive to the IMU, and turn its attitude to the IMU's axes; one without numbers is none."""
    if dive.reference is None:
        return dive
    reference = reference_as_configured(dive.reference, dive.imu, config)
    if len(reference.time_ns):
        return replace(dive, reference=reference)
    if dive.reference.has_position or dive.reference.has_velocity:
        raise ConfigError(
            f"{dive.name}: the reference has no attitude, so reference.lever_arm_m cannot be applied",
            "--set reference.lever_arm_m=[0,0,0] (the errors then contain the lever arm)",
        )
    return replace(dive, reference=None)


def reference_as_configured(
    reference: ReferenceColumns, imu: ImuColumns, config: Config
) -> ReferenceColumns:
    """Turn and move a reference as ``[reference]`` says."""
    mounting_rpy = np.array(config.reference.mounting_rpy_deg) * DEG
    return reference_at_imu(
        reference, imu, np.array(config.reference.lever_arm_m), mat_from_rpy(mounting_rpy)
    )


def reference_at_imu(
    reference: ReferenceColumns,
    imu: ImuColumns,
    lever_arm_b: Floats,  # (3,) IMU to the reference's point, m
    mat_br: Floats = IN_LINE,  # (3, 3) from the axes of the reference's attitude to the IMU's
) -> ReferenceColumns:
    """Turn a reference, ``C = C_r C_b^r``, and move it to the IMU: ``p_imu = p - C l``, ``v_imu = v - C (w_eb x l)``.

    Rows without an attitude lose position and velocity, rows outside the IMU's samples their velocity. Rows of which
    no number is left are left out.
    """
    mat_nb = reference.mat_nb
    if np.any(mat_br != IN_LINE):
        mat_nb = mat_nb @ mat_br.T
        reference = replace(reference, mat_nb=mat_nb)
    if np.any(lever_arm_b):
        sample_s = seconds(imu.time_ns, imu.time_ns[0])
        row_s = seconds(reference.time_ns, imu.time_ns[0])
        rate_ib_b = np.column_stack(
            [np.interp(row_s, sample_s, column, np.nan, np.nan) for column in imu.angular_rate_b.T]
        )
        latitude = np.where(np.isfinite(reference.position[:, 0]), reference.position[:, 0], 0.0)
        rate_eb_b = rate_ib_b - np.einsum("kji,kj->ki", mat_nb, earth_rate_n(latitude))
        reference = replace(
            reference,
            position=moved_position(reference.position, -(mat_nb @ lever_arm_b)),
            velocity_n=reference.velocity_n
            - np.einsum("kij,kj->ki", mat_nb, np.cross(rate_eb_b, lever_arm_b)),
        )
    known = np.any(list(reference.known.values()), axis=0)
    if known.all():
        return reference
    return reference.rows(known)


def coverage_notes(sample_ns: TimeNs, ping_ns: TimeNs) -> list[Note]:
    """Note pings outside the samples of an IMU, if these are more than sensors that start and stop apart explain."""
    outside = int(np.count_nonzero((ping_ns < sample_ns[0]) | (ping_ns > sample_ns[-1])))
    notes: list[Note] = []
    if outside > MOST_OUTSIDE * len(ping_ns):
        notes.append(note("dvl_outside_imu", outside, total=len(ping_ns)))
    length_s = 0.0
    if len(ping_ns):
        length_s = float(seconds(ping_ns[-1], int(ping_ns[0])))
    dive_s = float(seconds(sample_ns[-1], int(sample_ns[0])))
    if length_s < LEAST_COVERED * dive_s:
        notes.append(note("dvl_covers_little", len(ping_ns), length=length_s, dive=dive_s))
    return notes


def prepare_dive(
    dive: Dive, config: Config, *, fitted_heading_sd: float | None = None
) -> Prepared:
    """Do everything that comes before the filters of a dive from `with_reference_at_imu`, but for fitting the heading.

    LogError where the span holds nothing to replay, or no reference to start from; ConfigError where the settings do
    not fit the dive. The standard deviation, rad, is that of a heading of the settings that was fitted.
    """
    if len(dive.imu.specific_force_b) != len(dive.imu.time_ns):
        raise ValueError(f"{dive.name}: the IMU readings were released; read the log again")
    mounting = dvl_mounting(config)
    velocities = dvl_velocities(dive.dvl, mounting, config.dvl.max_beam_residual_mps or np.inf)
    notes = _ping_notes(dive, velocities, config.dvl.max_beam_residual_mps)
    start_ns, end_ns = _span(dive, velocities, config)
    gaps = find_gaps(dive.imu.time_ns, config.imu)
    with error_context(dive.name):
        start_ns, end_ns, gap_notes = apply_gap_policy(
            gaps, config.imu, start_ns, end_ns, int(dive.imu.time_ns[0])
        )
        alignment = align(dive, config, velocities, start_ns, end_ns, fitted_heading_sd)
        start = alignment.start
        start_ns = alignment.start_ns
        config = changed(config, initial=alignment.initial or config.initial)
        filters = resolve_filters(config)
        sensors, sensor_notes = prepare_sensors(
            dive.sensors, config, start, start_ns, end_ns, alignment.used_ns
        )
        own, own_notes = prepare_user_measurements(
            dive, config, filters, len(sensors), start, start_ns, end_ns
        )
        noise = prepare_user_noise(dive, config, filters)
    inside = velocities.within(start_ns, end_ns)
    if not len(inside.time_ns):
        raise LogError(
            f"{dive.name}: no DVL velocity between the start and the end of the replay",
            "compare dvl.stamp and reference.stamp with imu.stamp, or widen --start and --end",
        )
    notes += [*gap_notes, *alignment.notes]
    if outside := len(velocities.time_ns) - len(inside.time_ns):
        notes.append(note("dvl_outside_span", outside))
    notes += coverage_notes(dive.imu.time_ns, velocities.time_ns)
    in_span = {
        name: columns.rows((columns.time_ns >= start_ns) & (columns.time_ns <= end_ns))
        for name, columns in dive.sensors.items()
    }
    notes += [
        *sensor_notes,
        *held_out_notes(config),
        *contradiction_notes(in_span, dive.reference, config.depth),
        *depth_at_start_notes(in_span, dive.reference, alignment.row, config),
        *own_notes,
    ]
    beams = None
    if any("beams" in filter_.aiding for filter_ in filters):
        beams = dvl_beams(dive.dvl, mounting, start_ns, end_ns)
    return Prepared(
        velocities=inside,
        alignment=alignment,
        end_ns=end_ns,
        gaps=gaps.within(start_ns, end_ns),
        mounting=mounting,
        filters=filters,
        beams=beams,
        sensors=sensors | own,
        notes=tuple(notes),
        noise=noise,
    )


def _ping_notes(dive: Dive, velocities: DvlVelocities, limit_mps: float | None) -> list[Note]:
    """Count the pings that gave no velocity; LogError if none did."""
    solved = len(velocities.time_ns)
    bad = velocities.pings_with_bad_residual
    notes = list[Note]()
    if not solved and bad:
        text = f"{dive.name}: the beams of all {bad} solved pings disagree by more than {limit_mps:g} m/s"
        raise LogError(text, RESIDUAL_HINT)
    if not solved:
        raise LogError(
            f"{dive.name}: none of the DVL's {len(dive.dvl.time_ns)} pings has a velocity",
            "a ping needs three valid beams or a finite bottom-track velocity: was the seabed in range?",
        )
    if lost := velocities.pings_without_velocity:
        notes.append(note("dvl_no_velocity", lost))
    if bad:
        key = "dvl_bad_residual"
        if bad > MOST_DROPPED * (bad + solved):
            key = "dvl_bad_residual most"
        notes.append(note(key, bad, limit=limit_mps, solved=bad + solved, hint=RESIDUAL_HINT))
    if three := int(np.sum(velocities.beams_used == 3)):
        notes.append(note("dvl_three_beams", three))
    return notes


def raise_if_span_is_empty(name: str, imu: ImuColumns, span: Span) -> None:
    """Raise a LogError if ``--start`` and ``--end`` leave nothing of a dive."""
    duration_s = float(imu.time_ns[-1] - imu.time_ns[0]) / NS_PER_S
    start_s = max(0.0, span.start_s or 0.0)
    end_s = duration_s
    if span.end_s is not None:
        end_s = min(span.end_s, duration_s)
    if start_s < end_s:
        return
    text = f"there is nothing between --start {start_s:g} s and --end {end_s:g} s"
    if start_s > duration_s:
        text = f"--start {start_s:g} s is after the end"
    elif start_s == duration_s:
        text = f"--start {start_s:g} s is at the end"
    elif end_s < 0.0:
        text = f"--end {end_s:g} s is before the start"
    elif end_s == 0.0:
        text = f"--end {end_s:g} s is at the start"
    hint = "--start and --end count seconds from the first IMU sample"
    raise LogError(f"{name}: {text}; the IMU covers 0 to {duration_s:.1f} s", hint)


def _span(dive: Dive, velocities: DvlVelocities, config: Config) -> tuple[int, int]:
    """Return the span of the replay, by IMU, DVL and configuration."""
    first_ns = int(dive.imu.time_ns[0])
    last_ns = int(dive.imu.time_ns[-1])
    start_ns = first_ns
    if config.span.start_s is not None:
        start_ns = max(first_ns, first_ns + nanoseconds(config.span.start_s))
    end_ns = last_ns
    if config.span.end_s is not None:
        end_ns = min(last_ns, first_ns + nanoseconds(config.span.end_s))
    raise_if_span_is_empty(dive.name, dive.imu, config.span)
    first_ping_ns = int(velocities.time_ns[0])
    last_ping_ns = int(velocities.time_ns[-1])
    if last_ping_ns <= start_ns or first_ping_ns > end_ns:
        span = f"{(start_ns - first_ns) * 1e-9:.1f} to {(end_ns - first_ns) * 1e-9:.1f} s"
        pings = (
            f"{(first_ping_ns - first_ns) * 1e-9:.1f} to {(last_ping_ns - first_ns) * 1e-9:.1f} s"
        )
        raise LogError(
            f"{dive.name}: IMU and DVL do not overlap in time: the replay covers {span} from the first IMU sample, "
            f"the DVL {pings}",
            "if their clocks differ: --set imu.stamp=log_time --set dvl.stamp=log_time",
        )
    return start_ns, end_ns


# --- Long gaps of the IMU, and long outages of the DVL.


def find_gaps(time_ns: TimeNs, imu: Imu) -> Gaps:
    """Find the pauses between samples that are too long to be bridged like others.

    In a gap the readings are the line between its two ends. The true force and rate are unknown there, and an error
    that lasts from end to end is the worst of them: its density ``sd^2 T`` gives the deviation ``sd T`` after a gap T.
    """
    rows = np.flatnonzero(np.diff(time_ns) > nanoseconds(imu.max_gap_s))
    start_ns = time_ns[rows]
    end_ns = time_ns[rows + 1]
    length_s = seconds(end_ns, start_ns)[:, None]
    density = np.zeros((len(rows), len(STATES)))
    density[:, DV] = imu.gap_accel_mps2**2 * length_s
    # An attitude is unknown by half a turn at most, however long the gap is.
    density[:, PHI] = np.minimum(imu.gap_rate_degps * DEG * length_s, np.pi) ** 2 / length_s
    return Gaps(start_ns, end_ns, density, imu.gap_rate_degps * DEG)


def _possible_turn(gaps: Gaps) -> Floats:
    """Return how far the vehicle may turn in each gap, rad."""
    return np.asarray(gaps.rate_sd_radps * gaps.length_s)


def gaps_that_split(gaps: Gaps, imu: Imu) -> Gaps:
    """Return the gaps that are not bridged: the dive is replayed on one side of them."""
    if imu.long_gaps == "split":
        return gaps
    return gaps.where(_possible_turn(gaps) > WIDEST_ATTITUDE_RAD)


def apply_gap_policy(
    gaps: Gaps,
    imu: Imu,
    start_ns: int,
    end_ns: int,
    origin_ns: int,
) -> tuple[int, int, tuple[Note, ...]]:
    """Bridge or split at the long gaps of a span; return the span that is left, ns, with notes."""
    bridged = gaps.within(start_ns, end_ns)
    notes = list[Note]()
    split = gaps_that_split(bridged, imu)
    if len(split.start_ns):
        kept_start_ns, kept_end_ns = split.longest_stretch(start_ns, end_ns)
        hint = "to bridge shorter gaps: --set imu.long_gaps=grow"
        why = ""
        if imu.long_gaps == "grow":
            unknown_deg = _possible_turn(bridged).max() / DEG
            why = f" (at {imu.gap_rate_degps:g} deg/s the attitude may change by {unknown_deg:.0f} deg in a gap)"
            hint = "if the vehicle cannot turn so fast, set a smaller imu.gap_rate_degps to bridge the gaps"
        notes.append(
            note(
                "imu_split",
                len(split.start_ns),
                gaps=_described(split, imu, origin_ns),
                start=(kept_start_ns - origin_ns) * 1e-9,
                end=(kept_end_ns - origin_ns) * 1e-9,
                left_out=(end_ns - start_ns - kept_end_ns + kept_start_ns) * 1e-9,
                why=why,
                hint=hint,
            )
        )
        start_ns = kept_start_ns
        end_ns = kept_end_ns
        bridged = bridged.within(start_ns, end_ns)
    if count := len(bridged.start_ns):
        found = _described(bridged, imu, origin_ns)
        hint = "to replay the longest part without gaps: --set imu.long_gaps=split"
        if bridged.length_s.max() > LONGEST_BRIDGE_S:
            raise LogError(
                f"{found}; a gap of over {LONGEST_BRIDGE_S:g} s cannot be bridged",
                hint,
            )
        notes.append(note("imu_long_gaps", count, gaps=found, hint=hint))
    return start_ns, end_ns, tuple(notes)


def _described(gaps: Gaps, imu: Imu, origin_ns: int) -> str:
    count = len(gaps.start_ns)
    first_s = (int(gaps.start_ns[0]) - origin_ns) * 1e-9
    return (
        f"the IMU has {counted(count, 'gap')} longer than {imu.max_gap_s:g} s: first at {first_s:.1f} s, "
        f"longest {gaps.length_s.max():.1f} s, total {gaps.length_s.sum():.1f} s"
    )


def outage_notes(ping_ns: TimeNs, start_ns: int, end_ns: int) -> list[Note]:
    """Note long outages of the DVL, in which gravity is held."""
    ends_ns = np.concatenate([[start_ns], ping_ns, [end_ns]])
    length_ns = np.diff(ends_ns)
    count = int(np.count_nonzero(length_ns > nanoseconds(HOLD_AFTER_S)))
    longest = int(np.argmax(length_ns))
    if not count:
        return []
    longest_s = length_ns[longest] / NS_PER_S
    since_s = (ends_ns[longest] - start_ns) / NS_PER_S
    return [note("dvl_outages", count, held=HOLD_AFTER_S, longest=longest_s, since=since_s)]
