"""Long gaps of the IMU, bridged, split off or refused; and long outages of the DVL.

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

LONGEST_BRIDGE_S: Final = 3600.0  # through a longer gap the line between two readings says nothing
WIDEST_ATTITUDE_RAD: Final = np.pi / 2.0  # where an attitude may be off by more, errors no longer add up


def find_gaps(
    time_ns: TimeNs,  # (k,)
    imu: Imu,
) -> Gaps:
    """Find the pauses between samples that are too long to be bridged like others."""
    rows = np.flatnonzero(np.diff(time_ns) > nanoseconds(imu.max_gap_s))
    start_ns, end_ns = time_ns[rows], time_ns[rows + 1]
    length_s = seconds(end_ns, start_ns)[:, None]
    density = np.zeros((len(rows), len(STATES)))
    density[:, DV] = imu.gap_accel_mps2**2 * length_s
    # An attitude is unknown by half a turn at most, however long the gap is.
    density[:, PHI] = np.minimum(imu.gap_rate_degps * DEG * length_s, np.pi) ** 2 / length_s
    return Gaps(start_ns, end_ns, density, imu.gap_rate_degps * DEG)


def lever_arm_velocity_cov(
    gaps: Gaps,
    time_ns: TimeNs,  # (m,)
    lever_arm_b: Floats,  # (3,) IMU to DVL, m
) -> Floats:  # (m, 3, 3), m^2/s^2
    """Return the covariance of ``w x l`` at pings inside a gap, where the turn rate is unknown; zero elsewhere."""
    inside, arm = gaps.overlap(time_ns, time_ns), skew(lever_arm_b)
    return inside[:, None, None] * gaps.rate_sd_radps**2 * (arm @ arm.T)


def apply_gap_policy(
    gaps: Gaps, imu: Imu, start_ns: int, end_ns: int, origin_ns: int
) -> tuple[int, int, tuple[Note, ...]]:
    """Bridge or split at the long gaps of a span; return the span that is left, ns, with notes."""
    bridged, notes = gaps.within(start_ns, end_ns), list[Note]()
    turned_rad = bridged.rate_sd_radps * bridged.length_s  # what the vehicle may have turned, unseen
    split = bridged if imu.long_gaps == "split" else bridged.where(turned_rad > WIDEST_ATTITUDE_RAD)
    if len(split.start_ns):
        kept_ns = split.longest_stretch(start_ns, end_ns)
        from_s, to_s = ((time_ns - origin_ns) * 1e-9 for time_ns in kept_ns)
        left_out_s = (end_ns - start_ns - kept_ns[1] + kept_ns[0]) * 1e-9
        hint, why = "--set imu.long_gaps=grow bridges those in which the attitude is not lost", ""
        if imu.long_gaps == "grow":
            why = (
                f" ({imu.gap_rate_degps:g} deg/s unseen leave the attitude unknown by {turned_rad.max() / DEG:.0f} deg)"
            )
            hint = "a smaller imu.gap_rate_degps, if the vehicle cannot have turned so fast, bridges them"
        text = f"{_described(split, imu, origin_ns)}{why}; only {from_s:.1f} to {to_s:.1f} s are replayed, "
        text += f"{left_out_s:.1f} s are left out"
        notes.append(Note("imu_split", text, len(split.start_ns), Severity.WARNING, hint))
        (start_ns, end_ns), bridged = kept_ns, bridged.within(*kept_ns)
    if count := len(bridged.start_ns):
        hint, described = (
            "--set imu.long_gaps=split replays the longest part without",
            _described(bridged, imu, origin_ns),
        )
        if bridged.length_s.max() > LONGEST_BRIDGE_S:
            raise LogError(f"{described}; over {LONGEST_BRIDGE_S:g} s nothing can bridge it", hint)
        text = f"{described}; they are bridged, and the filters' uncertainty grows in them"
        notes.append(Note("imu_long_gaps", text, count, Severity.WARNING, hint))
    return start_ns, end_ns, tuple(notes)


def _described(gaps: Gaps, imu: Imu, origin_ns: int) -> str:
    count, first_s = len(gaps.start_ns), (int(gaps.start_ns[0]) - origin_ns) * 1e-9
    return (
        f"the IMU has {count} gap{'s' * (count > 1)} longer than {imu.max_gap_s:g} s, the first at {first_s:.1f} s, "
        f"the longest of {gaps.length_s.max():.1f} s, {gaps.length_s.sum():.1f} s in all"
    )


def outage_notes(
    ping_ns: TimeNs,  # (m,) of the velocities
    start_ns: int,
    end_ns: int,
) -> tuple[Note, ...]:
    """State that gravity is held in long outages of the DVL, and how long standard deviations hold in them."""
    ends_ns = np.concatenate([[start_ns], ping_ns, [end_ns]])
    length_ns = np.diff(ends_ns)
    count, longest = int(np.count_nonzero(length_ns > nanoseconds(HOLD_AFTER_S))), int(np.argmax(length_ns))
    if not count:
        return ()
    longest_s, since_s = length_ns[longest] / NS_PER_S, (ends_ns[longest] - start_ns) / NS_PER_S
    # The presets hold for so long without a velocity; see docs/equations/kalman_filter.md.
    trusted = "5 min with micromechanical sensors, 1 h with tactical and 2 h with fibre-optic ones"
    text = (
        f"the DVL gives no velocity for over {HOLD_AFTER_S:g} s, {count} x, the longest {longest_s:.0f} s from "
        f"{since_s:.0f} s after the start on; from then on gravity is taken at the height of before, since an unaided "
        f"height runs away, and standard deviations in and after it hold up to {trusted}"
    )
    return (Note("dvl_outages", text, count, Severity.WARNING, "--start and --end leave it out"),)
