"""Sentences and hints of the checks, by key.

An error stops the replay where the tables would be wrong. A warning reports what may be wrong. Where a code has several
sentences, the words after the blank distinguish them.
"""

from dataclasses import dataclass
from typing import Any, Final

from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity


@dataclass(frozen=True)
class Measured:
    """A remark whose hint has a value to copy that was measured: only a whole log shows it well enough."""

    remark: Note | LogError


Remark = Note | LogError | Measured

_UNIT_HINT: Final = (
    'dvl.velocity_unit = "mm/s" or "cm/s" (a wrong beam geometry cannot have so large an effect)'
)
_SLOW: Final = "the IMU has {rate_hz:.1f} samples a second, too few to follow a vehicle's motion"
_GRAVITY: Final = (
    "the specific force is {size:.3f} m/s^2 (median of the quiet seconds), "
    "but gravity is {gravity:.3f} m/s^2"
)
_GYRO: Final = (
    "the angular rate is {scale:.3g} times the rate derived from {by}, in the whole dive"
)
_DVL_SCALE: Final = "the DVL's velocity is {scale:.3f} times the reference's, in the whole dive"
_ZERO_HINT: Final = (
    "set depth.surface_height_m, the height of depth 0 above the ellipsoid, or leave it out"
)
_IGNORE: Final = "; if the reference is wrong: reference.ignore = true"
_OTHER_FIELD: Final = 'to read another field: imu.{name} = "field.path"'

_SENTENCES: Final = {
    # The IMU.
    "imu_spinning": (
        "the median angular rate is {turning_radps:.3f} rad/s ({turning_degps:.0f} deg/s); no vehicle turns so fast "
        "for so long",
        'imu.angular_rate_unit = "deg/s"; to read another field: imu.angular_rate = "field.path"',
    ),
    "imu_too_slow": (
        _SLOW,
        "set imu.topic to a faster IMU; to try this one: imu.min_rate_hz = {least_hz:g}",
    ),
    "imu_slow": (_SLOW, "set imu.topic to a faster IMU, if the log has one"),
    "imu_too_fast": (
        "the IMU has {rate_hz:.3g} samples a second, more than any: {count} samples in {span_s:.3g} s",
        'its times are in another unit: name it, such as imu.stamp = "time [ms]", or count samples: imu.stamp = '
        '"100 Hz"',
    ),
    "imu_too_short": (
        "the IMU has {samples} in {span_s:.3g} s, too little for a dive",
        'give the whole dive; if it is whole, its times are in another unit: name it, such as imu.stamp = "time [min]"',
    ),
    "imu_zero": ("the {quantity} is zero in all {count} samples of the IMU", _OTHER_FIELD),
    "imu_constant": ("{quantity} {axis} is {value:g} {unit} in all {count} samples", _OTHER_FIELD),
    "imu_stuck": (
        "all readings of the IMU stay the same for over 1 s, in {count} samples; first at {first_s:.1f} s, longest for "
        "{longest_s:.1f} s",
        "leave them out with --start and --end",
    ),
    "imu_no_gravity": (_GRAVITY, "{cure}"),
    "imu_gravity": (_GRAVITY + "; first at {first_s:.1f} s", "{cure}"),
    "imu_upside_down": (
        "the specific force along down is {along_down:+.3f} m/s^2 (median of the quiet seconds, first at "
        "{first_s:.1f} s), but a level vehicle has {level:.3f} m/s^2",
        'imu.axes = "flu" turns y and z; imu.specific_force_axes = "-x-y-z" changes the sign of the specific force '
        "only",
    ),
    "imu_gyro_sign": (
        _GYRO,
        'imu.axes = "flu" turns y and z; if the accelerometers have other axes, set imu.specific_force_axes '
        "too{ignore}",
    ),
    "imu_gyro_unit": (_GYRO, 'imu.angular_rate_unit = "{unit}"{ignore}'),
    "imu_gyro_scale": (_GYRO, "imu.angular_rate_scale = {setting:.3g}{ignore}"),
    "imu_gyro_contradiction": (
        "the angular rate does not agree with the change of the reference's attitude (correlation {correlation:.2f})",
        f"check imu.axes, reference.axes, imu.stamp and reference.stamp{_IGNORE}",
    ),
    "imu_turned": (
        "the IMU's axes are turned against those of the reference's attitude, by roll, pitch and heading {roll:.1f}, "
        "{pitch:.1f} and {heading:.1f} deg in the whole dive",
        "imu.mounting_rpy_deg = [{roll:.1f}, {pitch:.1f}, {heading:.1f}] if the IMU is built in obliquely; "
        "reference.mounting_rpy_deg if the reference is",
    ),
    "imu_gyro_axis": (
        "the angular rate {axis} has the opposite sign of the reference's (correlation {correlation:.2f}), but another "
        "axis agrees",
        f"check imu.axes, and the order of the fields in imu.angular_rate{_IGNORE}",
    ),
    # The DVL.
    "dvl_too_fast": (
        "the largest component of a ping is {speed_mps:g} m/s (median of all pings)",
        _UNIT_HINT,
    ),
    "dvl_zero": (
        "{count} of {pings} pings are exactly zero, the first one {first_s:.1f} s after the first ping: the DVL may "
        "have had no bottom lock",
        'to read a flag of valid pings: dvl.valid = "field.path"',
    ),
    "dvl_constant": (
        "the velocity {name} is {value:g} m/s in all {count} pings that have it",
        "to read other fields: dvl.velocity or dvl.beam_velocity",
    ),
    "dvl_direction": (
        "the DVL's velocity is turned by {turn_deg:.0f} deg against the reference's, in the whole dive",
        "dvl.mounting_rpy_deg = [{roll:g}, {pitch:g}, {heading:.0f}], or another reference.axes",
    ),
    "dvl_axes": (
        "the DVL's velocity has the opposite sign of the reference's along {axes}, in the whole dive",
        'dvl.axes = "flu" if it is "frd" now, "frd" if it is "flu"; for beams, check dvl.beam_azimuth_deg',
    ),
    "dvl_contradiction": (
        "the DVL's velocity does not agree with the reference's (coherence {coherence:.2f})",
        f"check dvl.beam_azimuth_deg, dvl.axes, reference.axes, dvl.stamp and reference.stamp{_IGNORE}",
    ),
    "dvl_unit": (_DVL_SCALE, _UNIT_HINT),
    "dvl_scale": (_DVL_SCALE, "dvl.scale = {setting:.3f}, or dvl.beam_tilt_deg"),
    "track_contradiction": (
        "the track of gyros and DVL does not fit the reference's positions with any heading or scale (coherence "
        "{coherence:.2f})",
        f"check initial.gyro_bias_degph, imu.axes and dvl.mounting_rpy_deg, or try another imu.topic{_IGNORE}",
    ),
    "dvl_direction by positions": (
        "the DVL's track fits the reference's positions with a start heading of {fitted_deg:.0f} deg, but "
        "{heading_deg:g} deg is configured",
        "initial.heading_deg = {fitted_deg:.0f}; if the heading is right, check dvl.mounting_rpy_deg",
    ),
    # The reference.
    "reference_constant": (
        "the {quantity} of the reference is the same in all its rows, while {doing}",
        "to use another reference: reference.topic and reference.fix; to use none: reference.ignore = true",
    ),
    "reference_frozen": (
        "the {quantity} of the reference stays the same in {count} rows, first at {first_s:.1f} s after its first row "
        "and for {longest_s:.1f} s at the longest, while {doing}: they count as missing",
        "to use another reference: reference.topic and reference.fix; to use none: reference.ignore = true",
    ),
    "reference_contradiction": (
        "the reference's positions and its velocity disagree (coherence {coherence:.2f})",
        "check reference.axes, reference.angle_unit and the fields reference.latitude, longitude and velocity_n",
    ),
    "reference_scale": (
        "the distance by the reference's positions is {off_pct:.2f} +- {sd_pct:.2f} % {longer} than by its velocity; "
        "one of them is wrong",
        "find the wrong one; then name another reference.fix or reference.velocity_n, since dvl.scale fits only one",
    ),
    "reference_late": (
        "the reference is {size_s:.3f} +- {sd_s:.3f} s {late} against the IMU, by its turns and accelerations",
        "reference.latency_s = {setting:.3f}",
    ),
    "reference_late in part": (
        "the reference's turns are {turns_s:+.3f} s and its changes of velocity {accelerations_s:+.3f} s later than "
        "the IMU's, so one of them is late",
        "name fields of one source: reference.topic, reference.velocity_n and reference.quaternion",
    ),
    "reference_jump": (
        "the {quantity} of the reference jump in {count} of {steps} steps, the largest by {largest:.1f} {unit} at "
        "{at_s:.1f} s after its first row",
        "jumps count as errors of the filters: choose a part without them with --start and --end",
    ),
    # Other sensors and solutions.
    "{name}_stuck": (
        "all {count} readings of the {name} sensor are the same, over {span_s:.0f} s: it is stuck, not connected, or "
        "too coarse for the vehicle's small movement",
        "to use another sensor: {name}.topic",
    ),
    "{name}_is_reference": (
        "{count} of {readings} readings of the {name} sensor are the reference's own",
        'to judge by this sensor: evaluation.held_out = ["{name}"]; filters that use it need another reference',
    ),
    "solution_{name}_is_reference": (
        "{count} of {rows} {quantity} of filters.{name}.solution are the reference's own",
        "to judge it by another reference: reference.topic and reference.fix",
    ),
    "heading_contradiction": (
        "the heading sensor disagrees with the {whose}: without the mean difference of {mean_deg:+.0f} deg, half of "
        "its {count} readings still differ by more than {spread_deg:.0f} deg",
        "check heading.angle_unit, heading.axes and heading.stamp",
    ),
    "heading_contradiction in the mean": (
        "the heading sensor differs from the reference by {mean_deg:+.1f} deg (mean of {count} readings)",
        "check heading.declination_deg, heading.mounting_rpy_deg and heading.axes; the reference may be turned too",
    ),
    "depth_contradiction": (
        "the depth changes by {scale:.3g} m for each metre that the {whose} goes down",
        "check depth.pressure_unit and depth.density_kgpm3; a field that is positive downwards is depth.depth, "
        "positive upwards depth.height",
    ),
    "depth_contradiction of its zero": (
        "the depth is {below} the reference's height (median of {count} readings)",
        _ZERO_HINT,
    ),
    "depth_contradiction at the start": (
        "the first depth, {late_s:.2f} s after the start, is {below} the start height of {height_m:.2f} m",
        f"{_ZERO_HINT}; or correct initial.height_m",
    ),
}


def ignore_hint(*, by_reference: bool) -> str:
    """Return the end of a hint that leads to a replay without the reference, where it is the one that may be wrong."""
    if by_reference:
        return _IGNORE
    return ""


def warning(key: str, count: int, **values: Any) -> Note:
    """Return a warning with its hint."""
    text, hint = _SENTENCES[key]
    known = {"count": count, **values}
    code = key.partition(" ")[0].format(**values)
    return Note(code, text.format(**known), count, Severity.WARNING, hint.format(**known))


def marked(remark: Note | LogError, *, is_measured: bool) -> Remark:
    """Mark a remark if its hint has a measured value."""
    if is_measured:
        return Measured(remark)
    return remark


def without_mark(remark: Remark) -> Note | LogError:
    """Return a remark itself, whether its hint was measured or not."""
    if isinstance(remark, Measured):
        return remark.remark
    return remark


def refusal(key: str, place: str, **values: Any) -> LogError:
    """Return an error in a file (the place)."""
    text, hint = _SENTENCES[key]
    return LogError(text.format(**values), hint.format(**values), place)
