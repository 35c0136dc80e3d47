"""Settings to propose for an IMU: its topic and fields by their names, units and axes by gravity and the reference."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.checks.imu import SPIN_RADPS, gyro_by_attitude
from insdvl_replay.checks.plausibility import TRACK_DOUBT, UNIT_WRONG, GyroScale
from insdvl_replay.core.config import Imu
from insdvl_replay.core.dive_columns import Floats, ImuColumns, ReferenceColumns
from insdvl_replay.core.states import ANGULAR_RATE_UNITS, DEG, GRAVITY_MPS2, SPECIFIC_FORCE_UNITS
from insdvl_replay.inspection.proposed_settings import Setting, field_setting, stamp_setting
from insdvl_replay.inspection.topic_probe import Candidate, ProbedTopic
from insdvl_replay.logs.columns.imu import FRD, in_frd
from insdvl_replay.logs.container.recording import Recording

_SAME: Final = 0.1
"""Part by which a unit may differ from gravity."""
_COHERENT: Final = 0.95
_CLEARLY: Final = 0.02
_TURNED: Final = 2.0 * DEG
_FOLLOWS: Final = 0.8
_NAMES: Final = {"+x+y+z": "frd", "+x-y-z": "flu"}
_UNITS_OPEN: Final = "rad/s or deg/s, which the maker says"


def imu_topic(seen: Sequence[ProbedTopic]) -> ProbedTopic | None:
    """Choose a topic with a specific force; an angular rate beside it and the size of gravity speak for it."""
    candidates = [topic for topic in seen if topic.forces and _possible_rates(topic)]
    return max(candidates, key=lambda topic: (bool(topic.rates), bool(topic.forces[0].force_unit)), default=None)


def imu_settings(log: Recording, topic: ProbedTopic) -> list[Setting]:
    """Propose topic, fields, unit of the force and stamp of an IMU of an unknown type."""
    doubt = "" if topic.rates else "no field is named like it; this one or another"
    return [
        Setting("imu.topic", topic.topic),
        field_setting("imu.specific_force", topic.forces),
        _force_unit(topic.forces[0]),
        field_setting("imu.angular_rate", _possible_rates(topic), doubt),
        stamp_setting(log, topic, "imu"),
    ]


def _possible_rates(topic: ProbedTopic) -> list[Candidate]:
    return topic.rates or [candidate for candidate in topic.vectors if candidate not in topic.forces]


def measured_imu(
    imu: ImuColumns, settings: Imu, reference: ReferenceColumns | None, found: GyroScale | None
) -> list[Setting]:
    """Propose units and axes by what gravity and the reference show."""
    measured = list(_wrong_force_unit(imu, settings))
    if settings.axes is None and settings.specific_force_axes is None:
        measured += list(_axes(imu, reference))
    if settings.angular_rate_unit is None:
        measured += list(_rate_unit(imu, found))
    return measured


def corrected_rates(imu: ImuColumns, settings: Imu, measured: Sequence[Setting]) -> ImuColumns:
    """Bring the angular rate to the axes and the unit that were proposed."""
    values = {setting.key: setting.value for setting in measured if setting.value is not None}
    read_in = settings.angular_rate_unit or "rad/s"
    unit = ANGULAR_RATE_UNITS[values.get("imu.angular_rate_unit", read_in)] / ANGULAR_RATE_UNITS[read_in]
    rate_b = in_frd(imu.angular_rate_b, values.get("imu.axes", FRD), "imu.axes", unit)
    return replace(imu, angular_rate_b=rate_b)


def measured_scale(settings: Imu, found: GyroScale | None) -> list[Setting]:
    """Propose a scale of the gyros that the reference shows."""
    if found is None or found.tolerance > 1.0 + TRACK_DOUBT or not found.tolerance < found.off < UNIT_WRONG:
        return []
    text = f"the angular rate is {found.scale:.3g} times what {found.by} shows"
    return [Setting("imu.angular_rate_scale", round(found.scale * settings.angular_rate_scale, 3), text)]


def level_axes(force: Floats) -> list[str]:
    """List the right-handed axes in which gravity is felt upwards, as a level vehicle feels it, the likeliest first.

    The force, shape (3,), is what is read on average.
    """
    strongest = int(np.argmax(np.abs(force)))
    down = np.zeros(3)
    down[strongest] = -np.sign(force[strongest])
    level = []
    for axis in (*np.eye(3), *-np.eye(3)):
        if not axis[strongest]:
            level.append(axes_word(np.stack([axis, np.cross(down, axis), down])))
    return level


@dataclass(frozen=True)
class _Axes:
    """Axes of the angular rate and of the specific force."""

    rate: str
    force: str

    def settings(self, seen: str, open_: str, others: tuple[str, ...] = ()) -> Iterator[Setting]:
        """Return them as settings."""
        yield Setting("imu.axes", self.rate, seen, open_, others if self.rate == self.force else ())
        if self.rate != self.force:
            yield Setting("imu.specific_force_axes", self.force, "the accelerometers show the opposite of a force")

    def correlation(self, imu: ImuColumns, reference: ReferenceColumns) -> float:
        """Compare the angular rate in these axes with the reference's change of attitude; 0 where it cannot be."""
        turned = replace(imu, angular_rate_b=in_frd(imu.angular_rate_b, self.rate, "imu.axes"))
        fit = gyro_by_attitude(turned, reference)
        return fit.correlation if fit is not None else 0.0

    def follows(self, imu: ImuColumns, reference: ReferenceColumns) -> bool:
        """Return whether the rate follows the attitude about each axis about which it turns."""
        turned = replace(imu, angular_rate_b=in_frd(imu.angular_rate_b, self.rate, "imu.axes"))
        fit = gyro_by_attitude(turned, reference)
        return fit is not None and bool((fit.by_axis[fit.excursion > _TURNED] > _FOLLOWS).all())


def _axes(imu: ImuColumns, reference: ReferenceColumns | None) -> Iterator[Setting]:
    force = np.median(imu.specific_force_b, axis=0)
    if not force.any():
        yield Setting("imu.axes", None, open="the accelerometers feel nothing, so that nothing tells where down is")
        return
    strongest = int(np.argmax(np.abs(force)))
    felt = f"gravity is felt along {'+' if force[strongest] > 0.0 else '-'}{'xyz'[strongest]}"
    upright = [_Axes(axes, axes) for axes in level_axes(force)]
    opposite = [_Axes(axes, _opposite(axes)) for axes in level_axes(-force)]
    possible = [upright[0], opposite[0], *upright[1:], *opposite[1:]]
    scores = [axes.correlation(imu, reference) for axes in possible] if reference is not None else [0.0]
    best = possible[int(np.argmax(np.array(scores) > max(scores) - _CLEARLY))]
    if max(scores) > _COHERENT:
        rivals = [axes for axes, score in zip(possible, scores, strict=True) if score > max(scores) - _CLEARLY]
        if reference is not None and len(rivals) > 1:
            rivals = [axes for axes in rivals if axes.follows(imu, reference)] or rivals
            best = rivals[0]
        seen = f"{felt}, and the angular rate follows the reference's attitude, correlation {max(scores):.3f}"
        left = "" if len(rivals) == 1 or best.rate == "frd" else _alternatives(rivals[1:])
        yield from best.settings(seen, left)
    elif best.rate == "frd":
        yield from best.settings(f"{felt}, as forward-starboard-down has it", "")
    else:
        yield from best.settings(f"{felt}; a level vehicle must feel it along -z", _alternatives(possible[1:3]))


def _alternatives(others: Sequence[_Axes]) -> str:
    texts = [
        f'axes = "{axes.rate}"' + (f' with specific_force_axes = "{axes.force}"' if axes.force != axes.rate else "")
        for axes in others
    ]
    return f"the way the IMU is built in; it could also be {', or '.join(texts)}"


def _rate_unit(imu: ImuColumns, found: GyroScale | None) -> Iterator[Setting]:
    sizes = np.linalg.norm(imu.angular_rate_b, axis=1)
    median, largest = float(np.median(sizes)), float(sizes.max())
    if median > SPIN_RADPS:
        yield Setting("imu.angular_rate_unit", "deg/s", f"{median:.3g} in the median, which no vehicle does in rad/s")
        return
    for unit, factor in ANGULAR_RATE_UNITS.items():
        if found is not None and 1.0 / UNIT_WRONG < abs(found.scale) * factor < UNIT_WRONG:
            yield Setting("imu.angular_rate_unit", unit, f"in it the rate fits {found.by}, which rules the other out")
            return
    yield Setting("imu.angular_rate_unit", "rad/s", f"at most {largest:.3g} was seen, which tells no unit", _UNITS_OPEN)


def _wrong_force_unit(imu: ImuColumns, settings: Imu) -> Iterator[Setting]:
    read_in = SPECIFIC_FORCE_UNITS[settings.specific_force_unit or "m/s2"]
    size = float(np.median(np.linalg.norm(imu.specific_force_b, axis=1))) / read_in
    fitting = [unit for unit, factor in SPECIFIC_FORCE_UNITS.items() if _is_gravity(size * factor)]
    if fitting and not _is_gravity(size * read_in):
        yield Setting("imu.specific_force_unit", fitting[0], f"the size is {size:.3g}, that of gravity in this unit")


def _is_gravity(size_mps2: float) -> bool:
    return abs(size_mps2 / GRAVITY_MPS2 - 1.0) < _SAME


def _force_unit(force: Candidate) -> Setting:
    if force.force_unit:
        return Setting("imu.specific_force_unit", force.force_unit, "gravity has this size in it")
    text = f"{', '.join(SPECIFIC_FORCE_UNITS)}; gravity would be 9.81, 1 or 1000, and the size is {force.size:.3g}"
    return Setting("imu.specific_force_unit", "m/s2", open=text)


def axes_word(rows: Floats) -> str:
    """Write axes as a signed permutation: forward, starboard and down in those of the instrument, shape (3, 3)."""
    parts = [(int(np.argmax(np.abs(row))), float(row.sum())) for row in rows]
    text = "".join(f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}" for axis, sign in parts)
    return _NAMES.get(text, text)


def _opposite(axes: str) -> str:
    signs = {name: text for text, name in _NAMES.items()}.get(axes, axes)
    turned = signs.translate(str.maketrans("+-", "-+"))
    return _NAMES.get(turned, turned)
