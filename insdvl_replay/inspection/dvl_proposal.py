"""Settings to propose for a DVL: its topic and fields by their names, unit and axes by its size and the reference."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from insdvl_replay.checks.dvl import Fit, dvl_by_velocity
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import DvlColumns, ReferenceColumns
from insdvl_replay.core.states import VELOCITY_UNITS
from insdvl_replay.geometry.frames import MAT_FRD_FLU
from insdvl_replay.inspection.proposed_settings import Setting, field_setting, stamp_setting
from insdvl_replay.inspection.topic_probe import Candidate, ProbedTopic
from insdvl_replay.logs.container.recording import Recording

_DVL_WORDS: Final = re.compile(r"dvl|doppler|bottom")
_FLAGS: Final = re.compile(r"valid|lock|good")
_SLOWEST_MPS, _QUICKEST_MPS = 0.1, 5.0
"""Speeds over ground of a vehicle under way."""
_CLOSE: Final = 1.5
"""Factor within which a comparison with the reference decides on a unit."""
_COHERENT: Final = 0.97
_CLEARLY: Final = 0.01
_AXES_OPEN: Final = "frd, flu (port and up turned) or a signed permutation; the maker says which"


def dvl_topic(seen: Sequence[ProbedTopic]) -> ProbedTopic | None:
    """Choose the topic of a DVL: one with a velocity, best with a name that says so."""
    named = [topic for topic in seen if _DVL_WORDS.search(f"{topic.topic} {topic.channel.type_name}".lower())]
    moving = [topic for topic in seen if topic.likely("velocity") or topic.likely("beam_velocity")]
    both = [topic for topic in named if topic in moving]
    return next(iter([*both, *moving, *(topic for topic in named if topic.vectors)]), None)


def dvl_settings(log: Recording, topic: ProbedTopic) -> list[Setting]:
    """Propose topic, fields, unit and stamp of a DVL of an unknown type."""
    beams, velocities = topic.likely("beam_velocity"), topic.likely("velocity")
    if not beams and not velocities:
        velocities = topic.vectors
    settings = [Setting("dvl.topic", topic.topic)]
    if velocities:
        settings += [field_setting("dvl.velocity", velocities), Setting("dvl.kind", "velocity")]
        settings += [_unit(velocities[0]), *_valid(topic)]
    elif beams:
        settings.append(_unit(beams[0]))
    if beams:
        settings += list(_beams(topic, beams, bool(velocities)))
    return [*settings, stamp_setting(log, topic, "dvl"), *_mounting()]


def measured_dvl(dvl: DvlColumns, reference: ReferenceColumns | None, config: Config) -> list[Setting]:
    """Propose axes and unit by what the reference's velocity shows."""
    if dvl.velocity_d is None or config.dvl.axes is not None:
        return []
    as_flu = replace(dvl, velocity_d=dvl.velocity_d @ MAT_FRD_FLU)
    fits = {
        axes: fit
        for axes, columns in (("frd", dvl), ("flu", as_flu))
        if reference is not None and (fit := dvl_by_velocity(columns, reference, config)) is not None
    }
    best = max(fits, key=lambda axes: fits[axes].coherence, default="frd")
    if not fits or fits[best].coherence < _COHERENT:
        return [Setting("dvl.axes", "frd", "there is no velocity to compare with that would tell the axes", _AXES_OPEN)]
    other = min(fit.coherence for fit in fits.values())
    if fits[best].coherence - other < _CLEARLY:
        seen = f"with frd and with flu it follows the reference's velocity, coherence {other:.3f}"
        return [Setting("dvl.axes", best, seen, _AXES_OPEN), *_scale(fits[best], config)]
    seen = f"so it follows the reference's velocity, coherence {fits[best].coherence:.3f} against {other:.3f}"
    return [Setting("dvl.axes", best, seen), *_scale(fits[best], config)]


def _scale(fit: Fit, config: Config) -> Iterator[Setting]:
    unit = VELOCITY_UNITS[config.dvl.velocity_unit or "m/s"]
    for name, factor in VELOCITY_UNITS.items():
        if 1.0 / _CLOSE < fit.scale * factor / unit < _CLOSE:
            yield Setting(
                "dvl.velocity_unit", name, f"its speed is then {fit.scale * factor / unit:.3f} times the reference's"
            )


def _valid(topic: ProbedTopic) -> Iterator[Setting]:
    """Leave flags open: what a good ping is named by can only be guessed."""
    flags = [f'"{path}" (median {median:g})' for path, median in topic.scalars.items() if _FLAGS.search(path.lower())]
    if flags:
        yield Setting("dvl.valid", None, open=f"whether {' or '.join(flags)} is 0 where a ping is invalid")


def _unit(velocity: Candidate) -> Setting:
    fitting = [unit for unit, factor in VELOCITY_UNITS.items() if _SLOWEST_MPS < velocity.size * factor < _QUICKEST_MPS]
    best = next(iter(fitting), "m/s")
    what = "length of all beams' velocities" if velocity.is_beams else "speed"
    seen = f"the median {what} is {velocity.size * VELOCITY_UNITS[best]:.3g} m/s then"
    if len(fitting) == 1:
        return Setting("dvl.velocity_unit", best, f"{seen}, and in no other unit a vehicle's")
    return Setting("dvl.velocity_unit", best, seen, f"the size leaves it open: {', '.join(VELOCITY_UNITS)}")


def _beams(topic: ProbedTopic, beams: Sequence[Candidate], has_velocity: bool) -> Iterator[Setting]:
    valid = topic.likely("beam_valid")
    if has_velocity:
        # Until a person knows where the beams point, the velocity is the safer source.
        lines = [f'beam_velocity = "{beam.path}"  # {beam}' for beam in beams]
        lines += [f'beam_valid = "{flag.path}"' for flag in valid]
        text = "beams, once their angles are known, give more: kind, beam_velocity, beam_valid, beam_tilt_deg"
        yield Setting("dvl.kind", "velocity", text, others=('kind = "beams"', *lines))
        return
    yield field_setting("dvl.beam_velocity", beams)
    if valid:
        yield Setting("dvl.beam_valid", valid[0].path)
    count = beams[0].median.size
    yield Setting("dvl.beam_tilt_deg", 30.0, open="from the instrument's z axis, as the maker says")
    azimuths = tuple(45.0 + 360.0 * beam / count for beam in range(count))
    yield Setting("dvl.beam_azimuth_deg", azimuths, open="from forward towards starboard, one angle for each beam")


def _mounting() -> Iterator[Setting]:
    yield Setting("dvl.lever_arm_m", (0.0, 0.0, 0.0), open="IMU to DVL, forward, starboard, down, as built")
    yield Setting("dvl.mounting_rpy_deg", (0.0, 0.0, 0.0), open="DVL to body, roll, pitch, heading, as built")
