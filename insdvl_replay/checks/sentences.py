"""What the checks find: a note of what may be wrong, or an error where the tables would be wrong."""

from dataclasses import dataclass
from typing import Any, Final

from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.notes import text_of


@dataclass(frozen=True)
class Measured:
    """A remark whose hint has a value to copy that was measured: only a whole log shows it well enough."""

    remark: Note | LogError


Remark = Note | LogError | Measured

_UNIT_HINT: Final = (
    'dvl.velocity_unit = "mm/s" or "cm/s" (a wrong beam geometry cannot have so large an effect)'
)
_IGNORE: Final = "; if the reference is wrong: reference.ignore = true"

_REFUSALS: Final = {
    "imu_spinning": (
        "the median angular rate is {turning_radps:.3f} rad/s ({turning_degps:.0f} deg/s); no vehicle turns so fast "
        "for so long",
        'imu.angular_rate_unit = "deg/s"; to read another field: imu.angular_rate = "field.path"',
    ),
    "imu_too_fast": (
        "the IMU has {rate_hz:.3g} samples a second, more than any: {count} samples in {span_s:.3g} s",
        'its times are in another unit: name it, such as imu.stamp = "time [ms]", or count samples: imu.stamp = '
        '"100 Hz"',
    ),
    "imu_too_short": (
        "the IMU has {samples} in {span_s:.3g} s, too little for a dive",
        'give the whole dive; if it is whole, its times are in another unit: name it, such as imu.stamp = "time [min]"',
    ),
    "imu_zero": (
        "the {quantity} is zero in all {count} samples of the IMU",
        'to read another field: imu.{name} = "field.path"',
    ),
    "imu_no_gravity": (
        "the specific force is {size:.3f} m/s^2 (median of the quiet seconds), but gravity is {gravity:.3f} m/s^2",
        "{cure}",
    ),
    "dvl_too_fast": (
        "the largest component of a ping is {speed_mps:g} m/s (median of all pings)",
        _UNIT_HINT,
    ),
    "reference_in_radians": (
        "the reference's positions follow the DVL's track only if their angles are in radians; in degrees they move "
        "57 times too little",
        'reference.angle_unit = "rad"',
    ),
}
# Errors that say what a note says where less is wrong: its code, and their own hint.
_AS_NOTES: Final = {
    "imu_too_slow": (
        "imu_slow",
        "set imu.topic to a faster IMU; to try this one: imu.min_rate_hz = {least_hz:g}",
    ),
    "imu_gyro_unit": ("imu_gyro_scale", 'imu.angular_rate_unit = "{unit}"{ignore}'),
    "dvl_unit": ("dvl_scale", _UNIT_HINT),
}


def ignore_hint(*, by_reference: bool) -> str:
    """Return the end of a hint that leads to a replay without the reference, where it is the one that may be wrong."""
    if by_reference:
        return _IGNORE
    return ""


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
    if key in _AS_NOTES:
        code, hint = _AS_NOTES[key]
        said = text_of(code, **values)
    else:
        text, hint = _REFUSALS[key]
        said = text.format(**values)
    return LogError(said, hint.format(**values), place)


def refused(note: Note, place: str) -> LogError:
    """Return the error in a file (the place) that says what a note says."""
    return LogError(note.text, note.hint, place)
