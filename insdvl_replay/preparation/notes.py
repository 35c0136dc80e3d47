"""All notes of the preparation: code, severity, sentence and hint, with fields for values."""

from typing import Any, Final

from insdvl_replay.core.errors import Note
from insdvl_replay.core.words import Severity

INFO = Severity.INFO
WARNING = Severity.WARNING

# The words after a blank in a key distinguish two sentences of one code. They are not part of the code.
NOTES: Final[dict[str, tuple[Severity, str, str]]] = {
    # The pings.
    "dvl_no_velocity": (INFO, "pings with fewer than three valid beams or no finite velocity: {count}", ""),
    "dvl_bad_residual": (INFO, "pings whose beams disagree by more than {limit:g} m/s: {count}", ""),
    "dvl_bad_residual most": (
        WARNING,
        "pings whose beams disagree by more than {limit:g} m/s: {count} of {solved}, most of them",
        "{hint}",
    ),
    "dvl_three_beams": (INFO, "pings solved from three beams, without a check: {count}", ""),
    "dvl_outside_imu": (
        WARNING,
        "pings before the first or after the last sample of the IMU: {count} of {total}",
        "compare dvl.stamp with imu.stamp, and look whether the log of the IMU is whole",
    ),
    "dvl_covers_little": (
        WARNING,
        "the velocities of the DVL ({count}) are within {length:.1f} s, and the samples of the IMU are in {dive:.1f} s",
        "look whether the log of the DVL is whole, or choose its part of the dive with --start and --end",
    ),
    "dvl_outside_span": (INFO, "pings before the start of the replay or after its end: {count}", ""),
    "dvl_outages": (
        WARNING,
        "DVL outages of over {held:g} s: {count}; the longest lasts {longest:.0f} s and begins {since:.0f} s after the "
        "start; meanwhile gravity is computed at the last height with DVL; "
        # The presets are valid for so long without a velocity; see docs/equations/kalman_filter.md.
        "sigma is valid for 5 min with MEMS, 1 h with tactical and 2 h with fibre-optic sensors",
        "leave the outage out with --start and --end",
    ),
    # Gaps of the IMU.
    "imu_split": (
        WARNING, "{gaps}{why}; only {start:.1f} to {end:.1f} s is replayed, {left_out:.1f} s is left out", "{hint}"
    ),
    "imu_long_gaps": (WARNING, "{gaps}; the gaps are bridged, and sigma grows in them", "{hint}"),
    # The start.
    "start_source": (
        INFO,
        "start: {attitude}, level +- {level:.2g} deg, heading +- {heading:.2g} deg; velocity of {velocity}, "
        "+- {velocity_sd:.2g} m/s",
        "",
    ),
    "start_position_configured": (INFO, "the start has the configured latitude, {latitude:g} deg", ""),
    "start_position_sensor": (INFO, "start position from the fix {away:.2f} s away", ""),
    "start_height_configured": (INFO, "the start has the configured height, {height:g} m", ""),
    "start_{quantity}_far": (
        WARNING,
        "the start {quantity} is from a row of the reference {away:.1f} s away; the vehicle may have moved since",
        "choose a --start with a {quantity} of the reference",
    ),
    "start_latitude_contradiction": (
        WARNING,
        "initial.latitude_deg is {configured:g}, but the reference starts at {found:.4g} deg, which is used",
        "leave initial.latitude_deg out, or set another reference.topic or reference.fix",
    ),
    "start_heading_sensor": (
        INFO, "start heading {heading:.2f} deg from the sensor's reading {away:.2f} s away", ""
    ),
    "start_heading_idle": (
        WARNING,
        "initial.heading_deg is {configured:g}, but the reference starts at {found:.1f} deg, which is used",
        'leave initial.heading_deg out; to start from it: initial.source = "level"',
    ),
    "start_heading_contradiction": (
        WARNING,
        "the start heading of {heading:.0f} deg contradicts the reference, which has {found:.0f} deg",
        "initial.heading_deg = {found:.1f}",
    ),
    "start_heading_fitted": (
        INFO,
        "start heading {fitted.heading_deg:.2f} +- {fitted.heading_sd_deg:.2g} deg and vertical gyro bias "
        "{fitted.gyro_bias_degph:.1f} +- {fitted.gyro_bias_sd_degph:.2g} deg/h were fitted to the reference's "
        "positions; the tables use the same positions",
        "",
    ),
    "start_attitude_sensor": (
        INFO,
        "start roll {roll:.2f} deg and pitch {pitch:.2f} deg from the sensor's first attitude, {since:.2f} s after the "
        "begin of the span; heading {heading:.2f} deg",
        "",
    ),
    "start_velocity_dvl": (INFO, "the start velocity is that of a DVL ping {away:.2f} s from the start", ""),
    "start_levelled": (
        INFO,
        "start roll {rpy[0]:.2f} +- {sd[0]:.2f} deg and pitch {rpy[1]:.2f} +- {sd[1]:.2f} deg from gravity over "
        "{level.span_s:.3g} s; heading {rpy[2]:g} deg",
        "",
    ),
    "start_level_unaided": (
        WARNING,
        "too few DVL velocities in the {level.span_s:.3g} s after the start: the vehicle's own acceleration could not "
        "be removed from the levelling",
        "choose a --start where the DVL sees the bottom",
    ),
    "start_tilt_contradiction": (
        WARNING,
        "start roll and pitch are {sensed[0]:.1f} and {sensed[1]:.1f} deg by the sensor, but {measured[0]:.1f} and "
        "{measured[1]:.1f} deg by gravity",
        'check heading.axes and heading.mounting_rpy_deg, or set initial.source = "level"',
    ),
    # Other sensors.
    "{sensor}_silent": (
        WARNING,
        "no reading of the {sensor} sensor for {length:.0f} of {span:.0f} s, from {since:.0f} s after the start "
        "{until}",
        "",
    ),
    "{sensor}_held_out": (
        WARNING,
        "the {sensor} sensor is held out, so it does not aid {filters}",
        'to use it: remove "{sensor}" from evaluation.held_out',
    ),
    "depth_zero": (
        INFO,
        "depth 0 is assumed {surface:.3f} m above the ellipsoid, by the start height and the first depth, {late:.2f} s "
        "after the start; filters with the depth sensor estimate the rest",
        "to set it: depth.surface_height_m",
    ),
    "position_contradiction": (
        WARNING,
        "the first fix, {late:.2f} s after the start, is {away:.3g} km from the start position: latitude "
        "{fix[0]:.4f} deg, longitude {fix[1]:.4f} deg",
        "check position.latitude, position.longitude and position.angle_unit, or initial.latitude_deg and "
        "longitude_deg",
    ),
    # User-defined measurements.
    "user_measurement_plain": (
        WARNING,
        "predict of {plugin} cannot be compiled: the filter is slow",
        "use numbers, loops and numpy's scalar functions, which can be compiled",
    ),
    "user_measurement_jacobian unwritten": (
        WARNING,
        "{plugin} leaves {left} at zero at the start of filters.{filter}: its readings have no effect there",
        "H is the derivative of z by the error states; columns and signs: docs/own_filter.md",
    ),
    "user_measurement_jacobian wrong": (
        WARNING,
        "H of {plugin} is not the derivative of its z at the start of filters.{filter}: H[{row}, {column}] is "
        "{given:.3g}, the derivative is {found:.3g}",
        "H is the derivative of z by the error states; columns and signs: docs/own_filter.md",
    ),
    # Filters of the user's.
    "candidate_ignores_start": (
        WARNING,
        "{key}: its runs from {count} starts gave the same solution, so it ignores its start",
        "begin from the state in {{start}}; otherwise errors of the start are no evidence on it",
    ),
    "answers_repeat": (
        INFO, "{key}: a second run gave the same answer to the last bit, SHA-256 {digest}{steady}", ""
    ),
    "answers_differ": (
        INFO,
        "{key} {moves}",
        "seed its random numbers, and leave out what depends on the clock, on threads or on the order of messages",
    ),
    # Recorded solutions.
    "solution_turned": (
        INFO, "{key}: turned by {turn:+.2f} deg, to the heading of {baseline} at its first attitude", ""
    ),
    "solution_aligned": (
        INFO,
        "{key}: the positions{origin} were aligned with {baseline} at the first one, {since:.2f} s after the start"
        "{moved}",
        "",
    ),
    "solution_lacks": (INFO, "{key} has no {quantities}: not evaluated", ""),
    "solution_coverage": (
        WARNING,
        "{quantities} of {key} cover {percent} % of the replay; solution and baseline are compared in that part",
        "to replay that part alone: --start and --end",
    ),
    "solution_without_covariance": (INFO, "{key} has no covariance of {quantities}", ""),
}  # fmt: skip


def note(code: str, count: int = 1, severity: Any = None, **values: Any) -> Note:
    """Make a note of a code, with the values of its fields; a given severity replaces that of the table."""
    usual, text, hint = NOTES[code]
    values["count"] = count
    name = code.split()[0].format(**values)
    return Note(name, text.format(**values), count, severity or usual, hint.format(**values))
