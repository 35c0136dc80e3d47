"""What a vehicle may have done in the long gaps of its IMU, and what is done with them: bridged, split off, or refused.

In a gap the readings are the line between its two ends. The true force and rate are unknown there, and an error that
lasts from end to end is the worst of them: its density ``sd^2 T`` gives after a gap of T the deviation ``sd T``.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs, nanoseconds, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG, DV, PHI, STATES
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.earth_model import HOLD_AFTER_S
from insdvl_replay.nav.timeline import Gaps

LONGEST_BRIDGE_S: Final = 3600.0
"""Through a longer gap the line between two readings says nothing; the dive has to be split there."""
WIDEST_ATTITUDE_RAD: Final = np.pi / 2.0
"""Where an attitude may be off by more, errors no longer add up and no filter is honest: the dive is split there."""


def find_gaps(time_ns: TimeNs, imu: Imu) -> Gaps:
    """Find the pauses between samples, at times of shape (k,), that are too long to be bridged like others."""
    rows = np.flatnonzero(np.diff(time_ns) > nanoseconds(imu.max_gap_s))
    start_ns, end_ns = time_ns[rows], time_ns[rows + 1]
    length_s = seconds(end_ns, start_ns)[:, None]
    density = np.zeros((len(rows), len(STATES)))
    density[:, DV] = imu.gap_accel_mps2**2 * length_s
    # No attitude is less known than by half a turn, however long nobody looked.
    density[:, PHI] = np.minimum(imu.gap_rate_degps * DEG * length_s, np.pi) ** 2 / length_s
    return Gaps(start_ns, end_ns, density, imu.gap_rate_degps * DEG)


def lever_arm_velocity_cov(gaps: Gaps, time_ns: TimeNs, lever_arm_b: Floats) -> Floats:
    """Return the covariance of ``w x l`` at pings inside a gap, where the turn rate is unknown; zero elsewhere.

    Parameters
    ----------
    time_ns : ndarray, shape (m,)
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    inside = gaps.overlap(time_ns, time_ns)
    arm = skew(lever_arm_b)
    return inside[:, None, None] * gaps.rate_sd_radps**2 * (arm @ arm.T)


def apply_gap_policy(
    gaps: Gaps, imu: Imu, start_ns: int, end_ns: int, origin_ns: int
) -> tuple[int, int, tuple[Note, ...]]:
    """Bridge or split at the long gaps of a span; return the span that is left, ns, with notes."""
    inside = gaps.within(start_ns, end_ns)
    if not len(inside.start_ns):
        return start_ns, end_ns, ()
    split_at = (
        inside if imu.long_gaps == "split" else inside.where(_unobserved_rotation_rad(inside) > WIDEST_ATTITUDE_RAD)
    )
    notes: tuple[Note, ...] = ()
    if len(split_at.start_ns):
        kept_ns = split_at.longest_stretch(start_ns, end_ns)
        notes = (_split_note(split_at, imu, (start_ns, end_ns), kept_ns, origin_ns),)
        (start_ns, end_ns), inside = kept_ns, inside.within(*kept_ns)
    if not len(inside.start_ns):
        return start_ns, end_ns, notes
    found = _found(inside, imu, origin_ns)
    split = "--set imu.long_gaps=split replays the longest part without"
    if inside.length_s.max() > LONGEST_BRIDGE_S:
        raise LogError(f"{found}; over {LONGEST_BRIDGE_S:g} s nothing can bridge it", split)
    text = f"{found}; they are bridged, and the filters' uncertainty grows in them"
    return start_ns, end_ns, (*notes, Note("imu_long_gaps", text, len(inside.start_ns), Severity.WARNING, split))


def _unobserved_rotation_rad(gaps: Gaps) -> Floats:
    """Return the deviation of what a vehicle may have turned in each gap."""
    return np.asarray(gaps.rate_sd_radps * gaps.length_s)


def _split_note(gaps: Gaps, imu: Imu, span_ns: tuple[int, int], kept_ns: tuple[int, int], origin_ns: int) -> Note:
    """State what is left of a dive that is split, and which setting bridges its gaps."""
    from_s, to_s = ((time_ns - origin_ns) * 1e-9 for time_ns in kept_ns)
    left_out_s = (span_ns[1] - span_ns[0] - kept_ns[1] + kept_ns[0]) * 1e-9
    hint, why = "--set imu.long_gaps=grow bridges those in which the attitude is not lost", ""
    if imu.long_gaps == "grow":
        widest_deg = float(_unobserved_rotation_rad(gaps).max()) / DEG
        why = f" ({imu.gap_rate_degps:g} deg/s unseen leave the attitude unknown by {widest_deg:.0f} deg)"
        hint = "a smaller imu.gap_rate_degps, if the vehicle cannot have turned so fast, bridges them"
    text = f"{_found(gaps, imu, origin_ns)}{why}; only {from_s:.1f} to {to_s:.1f} s are replayed, "
    return Note("imu_split", f"{text}{left_out_s:.1f} s are left out", len(gaps.start_ns), Severity.WARNING, hint)


def _found(gaps: Gaps, imu: Imu, origin_ns: int) -> str:
    longest_s, first_s = float(gaps.length_s.max()), (int(gaps.start_ns[0]) - origin_ns) * 1e-9
    return (
        f"the IMU has {_counted(len(gaps.start_ns))} longer than {imu.max_gap_s:g} s, the first at {first_s:.1f} s, "
        f"the longest of {longest_s:.1f} s, {gaps.length_s.sum():.1f} s in all"
    )


def _counted(gaps: int) -> str:
    return "1 gap" if gaps == 1 else f"{gaps} gaps"


_TRUSTED: Final = "5 min with micromechanical sensors, 1 h with tactical and 2 h with fibre-optic ones"
"""How long standard deviations hold without a velocity, by the presets; see equations/kalman_filter.md."""
_HINT: Final = "--start and --end leave it out"


def outage_notes(ping_ns: TimeNs, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """State of long outages that gravity is held in them, and beyond which length standard deviations do not hold.

    The times of the velocities have shape (m,); one note counts the outages beyond `local_earth.HOLD_AFTER_S`.
    """
    ends_ns = np.concatenate([[start_ns], ping_ns, [end_ns]])
    length_ns = np.diff(ends_ns)
    count, longest = int(np.count_nonzero(length_ns > nanoseconds(HOLD_AFTER_S))), int(np.argmax(length_ns))
    if not count:
        return ()
    longest_s, since_s = length_ns[longest] / NS_PER_S, (ends_ns[longest] - start_ns) / NS_PER_S
    text = (
        f"the DVL gives no velocity for over {HOLD_AFTER_S:g} s, {count} x, the longest {longest_s:.0f} s from "
        f"{since_s:.0f} s after the start on; from then on gravity is taken at the height of before, since an unaided "
        f"height runs away, and standard deviations in and after it hold up to {_TRUSTED}"
    )
    return (Note("dvl_outages", text, count, Severity.WARNING, _HINT),)
