"""All notes of the preparation: code, severity, sentence and hint, with fields for the values that a caller gives."""

from typing import Any, Final

from insdvl_replay.core.errors import Note
from insdvl_replay.core.words import Severity

INFO, WARNING = Severity.INFO, Severity.WARNING

# What follows a blank in a code tells two sentences of one code apart, and is not part of it.
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
    "dvl_outside_span": (INFO, "pings before the start of the replay or after its end: {count}", ""),
    "dvl_outages": (
        WARNING,
        "the DVL gives no velocity for over {held:g} s, {count} x, the longest {longest:.0f} s from {since:.0f} s "
        "after the start on; from then on gravity is taken at the height of before, since an unaided height runs away, "
        # The presets hold for so long without a velocity; see docs/equations/kalman_filter.md.
        "and standard deviations in and after it hold up to 5 min with micromechanical sensors, 1 h with tactical and "
        "2 h with fibre-optic ones",
        "--start and --end leave it out",
    ),
    # Gaps of the IMU.
    "imu_split": (
        WARNING, "{gaps}{why}; only {start:.1f} to {end:.1f} s are replayed, {left_out:.1f} s are left out", "{hint}"
    ),
    "imu_long_gaps": (WARNING, "{gaps}; they are bridged, and the filters' uncertainty grows in them", "{hint}"),
    # The start.
    "start_position_configured": (INFO, "started at the configured latitude {latitude:g} deg", ""),
    "start_position_sensor": (INFO, "position at the start by the fix {away:.2f} s away", ""),
    "start_height_configured": (INFO, "started at the configured height {height:g} m", ""),
    "start_{quantity}_far": (
        WARNING,
        "the {quantity} at the start is the reference's {away:.1f} s away from it, and is off by as much",
        "--start near the reference's {quantity}s",
    ),
    "start_latitude_contradiction": (
        WARNING,
        "initial.latitude_deg is {configured:g}, but the reference starts at {found:.4g} deg, which counts",
        "leave initial.latitude_deg out, or name another reference.topic or reference.fix",
    ),
    "start_heading_sensor": (
        INFO, "heading at the start {heading:.2f} deg, of the sensor's reading {away:.2f} s away", ""
    ),
    "start_heading_idle": (
        WARNING,
        "initial.heading_deg is {configured:g}, but the reference starts at {found:.1f} deg, which counts",
        'leave initial.heading_deg out, or initial.source = "level" to start from it',
    ),
    "start_heading_contradiction": (
        WARNING,
        "the heading of {heading:.0f} deg at the start contradicts the reference, which has {found:.0f} deg",
        "initial.heading_deg = {found:.1f}",
    ),
    "start_heading_fitted": (
        INFO,
        "a heading of {fitted.heading_deg:.2f} +- {fitted.heading_sd_deg:.2g} deg at the start, and a bias of "
        "{fitted.gyro_bias_degph:.1f} +- {fitted.gyro_bias_sd_degph:.2g} deg/h of the gyro about down, were fitted to "
        "the positions of the reference, which the tables then compare with",
        "",
    ),
    "start_attitude_sensor": (
        INFO,
        "roll {roll:.2f} deg and pitch {pitch:.2f} deg of the sensor's first attitude, {since:.2f} s into the span, at "
        "a heading of {heading:.2f} deg",
        "",
    ),
    "start_velocity_dvl": (INFO, "velocity at the start from the DVL's ping {away:.2f} s away", ""),
    "start_levelled": (
        INFO,
        "roll {rpy[0]:.2f} +- {sd[0]:.2f} deg and pitch {rpy[1]:.2f} +- {sd[1]:.2f} deg from gravity over "
        "{level.span_s:.3g} s, at a heading of {rpy[2]:g} deg",
        "",
    ),
    "start_level_unaided": (
        WARNING,
        "the DVL tells too little of the {level.span_s:.3g} s after the start to take the vehicle's own acceleration "
        "off gravity",
        "--start where the DVL sees the bottom",
    ),
    "start_tilt_contradiction": (
        WARNING,
        "the sensor's roll and pitch of {sensed[0]:.1f} and {sensed[1]:.1f} deg at the start contradict gravity, which "
        "says {measured[0]:.1f} and {measured[1]:.1f} deg",
        'heading.axes, heading.mounting_rpy_deg, or initial.source = "level"',
    ),
    # Other sensors.
    "{sensor}_silent": (
        WARNING,
        "no reading of the {sensor} for {length:.0f} of {span:.0f} s, from {since:.0f} s after the start {until}",
        "",
    ),
    "{sensor}_held_out": (
        WARNING,
        "the {sensor} is withheld, and does not aid {filters}",
        'take "{sensor}" out of evaluation.held_out',
    ),
    "depth_zero": (
        INFO,
        "depth: 0 is taken to be {surface:.3f} m above the ellipsoid, by the first reading, {late:.2f} s after the "
        "start, and the height at the start; filters that are aided by it find out",
        "depth.surface_height_m says it otherwise",
    ),
    "position_contradiction": (
        WARNING,
        "the first fix, {late:.2f} s after the start, is {away:.3g} km from it: at latitude {fix[0]:.4f} deg, "
        "longitude {fix[1]:.4f} deg",
        "position.latitude, position.longitude and position.angle_unit; or initial.latitude_deg and longitude_deg",
    ),
    # User-defined measurements.
    "user_measurement_plain": (
        WARNING,
        "the prediction of {plugin} cannot be compiled, and runs as it is: the filter takes long",
        "numbers, loops and numpy's functions of numbers can be compiled",
    ),
    "user_measurement_jacobian unwritten": (
        WARNING,
        "{plugin} leaves {left} at zero where filters.{filter} starts: its readings change nothing there",
        "H is the change of z by what the INS is off: docs/own_filter.md has columns and signs",
    ),
    "user_measurement_jacobian wrong": (
        WARNING,
        "H of {plugin} contradicts its z where filters.{filter} starts: H[{row}, {column}] is {given:.3g}, and z "
        "changes by {found:.3g}",
        "H is the change of z by what the INS is off: docs/own_filter.md has columns and signs",
    ),
    # Recorded solutions.
    "solution_turned": (
        INFO, "{key}: turned by {turn:+.2f} deg to the heading of {baseline} at its first attitude", ""
    ),
    "solution_aligned": (
        INFO,
        "{key}: its positions{origin} are laid on {baseline} at the first of them, {since:.2f} s after the start"
        "{moved}",
        "",
    ),
    "solution_lacks": (INFO, "{key} says nothing of {quantities}", ""),
    "solution_coverage": (
        WARNING,
        "{quantities} of {key} cover {percent} % of the replay; it is judged on that part, and the baseline beside it "
        "at the same instants",
        "--start and --end choose that part",
    ),
    "solution_without_covariance": (INFO, "{key} does not say how sure it is of {quantities}", ""),
}  # fmt: skip


def note(code: str, count: int = 1, severity: Any = None, **values: Any) -> Note:
    """Make a note of a code, with the values of its fields; a severity replaces that of the table."""
    usual, text, hint = NOTES[code]
    values["count"] = count
    name = code.split()[0].format(**values)
    return Note(name, text.format(**values), count, severity or usual, hint.format(**values))
