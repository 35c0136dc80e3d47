"""What the checks say: by its key the sentence, and the settings that help.

An error ends the work where the tables would be wrong; a warning says what may be wrong. Where a code has several
sentences, what is behind the blank tells them apart.
"""

from typing import Any, Final

from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity

Remark = Note | LogError

_UNIT_HINT: Final = 'dvl.velocity_unit = "mm/s", or "cm/s"; a wrong beam geometry is never that wrong'
_SLOW: Final = (
    "the IMU has {rate_hz:.1f} samples a second, too few for an INS to follow a vehicle's motion, from 0 s on"
)
_GRAVITY: Final = (
    "the specific force is {size:.3f} m/s^2 in the median of quiet seconds, where gravity is {gravity:.3f} m/s^2"
)
_GYRO: Final = "the angular rate is {scale:.3g} times what {by} shows, from 0 s on"
_DVL_SCALE: Final = "the DVL's velocity is {scale:.3f} times the reference's, from the first ping on"
_ZERO_HINT: Final = "depth.surface_height_m, of depth 0 above the ellipsoid, or leave it out"

_SENTENCES: Final = {
    # The IMU.
    "imu_spinning": (
        "the angular rate is {turning_radps:.3f} rad/s in the median, {turning_degps:.0f} deg/s, and no vehicle turns "
        "so fast for so long",
        'imu.angular_rate_unit = "deg/s", or imu.angular_rate = "field.path" names another field',
    ),
    "imu_too_slow": (_SLOW, "imu.topic names a faster one; imu.min_rate_hz = {least_hz:g} tries with this one"),
    "imu_slow": (_SLOW, "imu.topic names a faster one, if the log has any"),
    "imu_zero": (
        "the {quantity} is zero in all {count} samples of the IMU",
        'imu.{name} = "field.path" names another field',
    ),
    "imu_constant": (
        "{quantity} {axis} is {value:g} {unit} in all {count} samples, from 0 s on",
        'imu.{name} = "field.path" names another field',
    ),
    "imu_stuck": (
        "{count} samples of the IMU repeat all readings of the one before for over 1 s, the first at {first_s:.1f} s, "
        "the longest run of {longest_s:.1f} s",
        "--start and --end leave them out",
    ),
    "imu_no_gravity": (_GRAVITY, "{cure}"),
    "imu_gravity": (_GRAVITY + "; the first time at {first_s:.1f} s", "{cure}"),
    "imu_upside_down": (
        "the specific force along down is {along_down:+.3f} m/s^2 in the median of quiet seconds, the first time at "
        "{first_s:.1f} s, where a level vehicle has {level:.3f} m/s^2",
        'imu.axes = "flu" turns y and z; imu.specific_force_axes = "-x-y-z" turns the sign of the force alone',
    ),
    "imu_gyro_sign": (
        _GYRO,
        'imu.axes = "flu" turns y and z, and imu.specific_force_axes names those of the force where they differ',
    ),
    "imu_gyro_unit": (_GYRO, 'imu.angular_rate_unit = "{unit}"'),
    "imu_gyro_scale": (_GYRO, "imu.angular_rate_scale = {setting:.3g}"),
    "imu_gyro_contradiction": (
        "the angular rate does not follow the change of the reference's attitude, from 0 s on (correlation "
        "{correlation:.2f})",
        "imu.axes, reference.axes, or imu.stamp and reference.stamp",
    ),
    "imu_gyro_axis": (
        "the angular rate {axis} turns against the reference's attitude, from 0 s on (correlation {correlation:.2f}), "
        "while another axis follows it",
        "imu.axes, or imu.angular_rate names the fields in another order",
    ),
    # The DVL.
    "dvl_too_fast": ("the DVL's largest component is {speed_mps:g} m/s in the median of its pings", _UNIT_HINT),
    "dvl_zero": (
        "{count} of {pings} pings are exactly zero, the first {first_s:.1f} s after the first ping: the instrument may "
        "have had no lock",
        'dvl.valid = "field.path" names what marks good pings',
    ),
    "dvl_constant": (
        "the velocity {name} is {value:g} m/s in all {count} pings that have it, from the first on",
        "dvl.velocity or dvl.beam_velocity names other fields",
    ),
    "dvl_direction": (
        "the DVL's velocity is turned by {turn_deg:.0f} deg from the reference's, from the first ping on",
        "dvl.mounting_rpy_deg = [{roll:g}, {pitch:g}, {heading:.0f}], or another reference.axes",
    ),
    "dvl_axes": (
        "the DVL's velocity has the opposite sign of the reference's along {axes}, from the first ping on",
        'dvl.axes = "flu" where it is "frd" now, or the reverse; for beams, dvl.beam_azimuth_deg',
    ),
    "dvl_contradiction": (
        "the DVL's velocity does not follow the reference's, from the first ping on (coherence {coherence:.2f})",
        "dvl.beam_azimuth_deg, dvl.axes, reference.axes, or dvl.stamp and reference.stamp",
    ),
    "dvl_unit": (_DVL_SCALE, _UNIT_HINT),
    "dvl_scale": (_DVL_SCALE, "dvl.scale = {setting:.3f}, or dvl.beam_tilt_deg"),
    "track_contradiction": (
        "the track of gyros and DVL does not follow the reference's positions, whatever the heading and the scales, "
        "from the first ping on (coherence {coherence:.2f})",
        "initial.gyro_bias_degph, imu.axes, dvl.mounting_rpy_deg, or another imu.topic",
    ),
    "dvl_direction by positions": (
        "the DVL's track fits the reference's positions with a heading of {fitted_deg:.0f} deg at the start, and "
        "{heading_deg:g} deg are configured, from the first ping on",
        "initial.heading_deg = {fitted_deg:.0f}, or dvl.mounting_rpy_deg where the heading is known",
    ),
    # The reference.
    "reference_constant": (
        "the {quantity} of the reference is the same in all its rows, from the first on, while {doing}",
        "reference.topic and reference.fix name others",
    ),
    "reference_contradiction": (
        "the positions of the reference do not move as its velocity says, from the first on (coherence "
        "{coherence:.2f})",
        "reference.axes, reference.angle_unit, or the fields reference.latitude, longitude and velocity_n",
    ),
    "reference_scale": (
        "the positions of the reference go {off_pct:.2f} +- {sd_pct:.2f} % {way} than its velocity says; it cannot be "
        "right in both",
        "a DVL whose dvl.scale fits the one fails the other",
    ),
    "reference_jump": (
        "the {quantity} of the reference jump in {count} of {steps} steps, the most by {largest:.1f} {unit} at "
        "{at_s:.1f} s after the first",
        "--start and --end choose a part without jumps, which count as errors of the filters",
    ),
    # Other sensors and solutions.
    "{name}_stuck": (
        "all {count} readings of the {name} are the same, over {span_s:.0f} s: it is stuck, not connected, or too "
        "coarse for how little the vehicle moves",
        "{name}.topic names another one",
    ),
    "{name}_is_reference": (
        "{count} of {readings} readings of the {name} are the reference's own",
        'evaluation.held_out = ["{name}"] judges by them; filters aided by them need another reference',
    ),
    "solution_{name}_is_reference": (
        "{count} of {rows} {quantity} of filters.{name}.solution are the reference's",
        "reference.topic and reference.fix name what it is to be judged by",
    ),
    "heading_contradiction": (
        "the heading does not follow the {whose}'s: with the mean difference of {mean_deg:+.0f} deg taken off, half of "
        "its {count} readings are still more than {spread_deg:.0f} deg off",
        "heading.angle_unit, heading.axes or heading.stamp",
    ),
    "heading_contradiction in the mean": (
        "the heading is {mean_deg:+.1f} deg off the reference's, in the mean of {count} readings",
        "heading.declination_deg, heading.mounting_rpy_deg or heading.axes; or the reference is turned",
    ),
    "depth_contradiction": (
        "the depth changes by {scale:.3g} m for each metre that the {whose} goes down",
        "depth.pressure_unit or depth.density_kgpm3; depth.depth for what is positive downwards, else depth.height",
    ),
    "depth_contradiction of its zero": (
        "the depth is {below} the reference's height, by the median of {count} readings",
        _ZERO_HINT,
    ),
    "depth_contradiction at the start": (
        "the first depth, {late_s:.2f} s after the start, is {below} the height at the start, {height_m:.2f} m",
        f"{_ZERO_HINT}; or initial.height_m",
    ),
}


def warning(key: str, count: int, **values: Any) -> Note:
    """Return a warning; each has a hint."""
    text, hint = (part.format(count=count, **values) for part in _SENTENCES[key])
    return Note(key.partition(" ")[0].format(**values), text, count, Severity.WARNING, hint)


def refusal(key: str, place: str, **values: Any) -> LogError:
    """Return an error; the place is the file."""
    text, hint = (part.format(**values) for part in _SENTENCES[key])
    return LogError(text, hint, place)
