"""The worlds in which the judgement is tried: what the sensors do, what the filters are told, what befalls the log.

Each is the same figure-eight with errors drawn anew for every dive. In most of them a candidate is truly better than
the baseline, as good or worse, which `true_errors` measures; in the last four nobody can tell, since the filters are
dead or set wrong.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Acceleration, Config, Filter, Initial, Noise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors, ImuErrors
from insdvl_replay.studies.simulated_run import matched_errors

SCENARIO: Final = "figure-eight"
DURATION_S: Final = 300.0
OUTAGE_S: Final = 3600.0
SEED: Final = 1
_HARM_STREAM: Final = 9
"""Sensors and starts draw from the first streams of a dive's seed."""

Harm = Callable[[Dive, np.random.Generator], Dive]


def unharmed(dive: Dive, _: np.random.Generator) -> Dive:
    """Leave a dive as its sensors reported it."""
    return dive


@dataclass(frozen=True)
class World:
    """Sensors, filters and mishaps of a kind of dive.

    Attributes
    ----------
    config : Config
        The first filter is the baseline.
    way : mapping of str to anything
        What of `exact_dive` is not as usual.
    harm : callable
        What befalls the readings of a dive, drawn from the generator.
    dead : bool
        Whether the filters are dead or set wrong, so that nothing can be said of gain or loss.
    """

    name: str
    config: Config
    imu_errors: ImuErrors
    dvl_errors: DvlErrors
    way: Mapping[str, Any] = field(default_factory=dict)
    harm: Harm = unharmed
    dead: bool = False

    @property
    def candidates(self) -> tuple[str, ...]:
        """Names of all filters but the baseline."""
        return tuple(self.config.filters)[1:]


def dive_seed(number: int, dive: int) -> int:
    """Return the seed of one dive in the world of some number, from which it can be made again by itself."""
    return int(np.random.SeedSequence(SEED, spawn_key=(number, dive)).generate_state(1)[0])


def made_dive(number: int, seed: int) -> Dive:
    """Simulate one dive in the world of some number."""
    world = WORLDS[number]
    dive = add_errors(exact_way(number), world.imu_errors, world.dvl_errors, seed)
    return world.harm(dive, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_HARM_STREAM,))))


@cache
def exact_way(number: int) -> Dive:
    """Simulate the dive of a world with perfect sensors, once in each process."""
    return exact_dive(SCENARIO, **{"duration_s": DURATION_S, **WORLDS[number].way})


def _world(name: str, config: Config, **filters: Filter) -> World:
    """Let the sensors err exactly as the settings say; filters other than their own may be told something else."""
    errors = matched_errors(config)
    return World(name, msgspec.structs.replace(config, filters=filters) if filters else config, *errors)


def _by_velocity(**told: Any) -> Filter:
    return Filter(aiding=("velocity",), **told)


def _by_acceleration(acceleration: Acceleration, **told: Any) -> Filter:
    return Filter(aiding=("velocity", "acceleration"), acceleration=acceleration, **told)


def _scaled_noise(config: Config, factor: float) -> dict[str, float]:
    """Give a filter inertial noise whose standard deviations are larger by a factor."""
    return {key: factor * getattr(config.noise, key) for key in Noise.__struct_fields__}


def _paper() -> World:
    filters = {
        "baseline": _by_velocity(),
        "windowed": _by_acceleration(Acceleration(sd_mps2=0.103)),
        "published": _by_acceleration(Acceleration(model="published", sd_mps2=0.103)),
    }
    config = msgspec.structs.replace(load_config("levy-klein"), filters=filters)
    return World("FOG sensors, the paper's settings", config, GRADES["fog"], DvlErrors())


def _over_confident() -> World:
    """Tell the filters how noisy the sensors are, but one of them another DVL; they start as unsure as the paper's."""
    errors, dvl_errors = GRADES["fog"], DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
    told = {key: getattr(errors, key) for key in Noise.__struct_fields__}
    filters = {
        "baseline": _by_velocity(velocity_sd_mps=0.001, **told),
        "right": _by_velocity(beam_sd_mps=dvl_errors.beam_sd_mps, **told),
    }
    config = msgspec.structs.replace(load_config("levy-klein"), filters=filters)
    return World("baseline's R of 1 mm/s, truly 6", config, errors, dvl_errors)


def _with_covariance_divided() -> World:
    """Divide Q and R of one filter by four, which leaves the gains. Both are nearly as sure at the start as ever."""
    initial = Initial(
        velocity_sd_mps=0.02, misalignment_sd_deg=(0.03, 0.03, 0.3), accel_bias_sd_mg=0.05, gyro_bias_sd_degph=0.05
    )
    config = msgspec.structs.replace(_TACTICAL, initial=initial)
    less = _by_velocity(velocity_sd_mps=0.5 * config.dvl.velocity_sd_mps, **_scaled_noise(config, 0.5))
    return _world("covariance divided by four", config, baseline=_by_velocity(), divided=less)


def _pings_that_lie(dive: Dive, rng: np.random.Generator, *, share: float = 0.01, sd_mps: float = 0.3) -> Dive:
    """Let some pings report another velocity than that of the vehicle."""
    if dive.dvl.beam_velocity_mps is None or dive.dvl.beam_vectors_d is None:
        raise ValueError("a simulated DVL has beams")
    lies = rng.random(len(dive.dvl.time_ns)) < share
    wrong_d = lies[:, None] * rng.normal(scale=sd_mps, size=(len(lies), 3))
    beams = dive.dvl.beam_velocity_mps + wrong_d @ dive.dvl.beam_vectors_d.T
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def _knock(dive: Dive, rng: np.random.Generator, *, samples: int = 3, force_mps2: float = 300.0) -> Dive:
    """Knock at the IMU for some samples: a single one would be taken out as it is read."""
    force_b = dive.imu.specific_force_b.copy()
    first = int(rng.integers(len(force_b) // 10, len(force_b) // 2))
    force_b[first : first + samples, 0] = force_mps2
    return replace(dive, imu=replace(dive.imu, specific_force_b=force_b))


def _in_millimetres(dive: Dive, _: np.random.Generator) -> Dive:
    if dive.dvl.beam_velocity_mps is None:
        raise ValueError("a simulated DVL has beams")
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=1000.0 * dive.dvl.beam_velocity_mps))


_FOG, _TACTICAL, _MEMS = (load_config(preset) for preset in ("fog", "tactical", "mems"))
_GATE: Final = {"gate_probability": 0.99999}
_SHUT: Final = {**_GATE, "gate_reopen_after": 0}

WORLDS: Final[tuple[World, ...]] = (
    _world("FOG sensors as the preset says", _FOG),
    _paper(),
    _world("tactical sensors as the preset says", _TACTICAL),
    _world(
        "candidate's R of 60 mm/s, truly 20",
        _TACTICAL,
        baseline=_by_velocity(),
        wrong=_by_velocity(velocity_sd_mps=0.06),
    ),
    _world(
        "baseline's R of 200 mm/s, truly 20",
        _TACTICAL,
        baseline=_by_velocity(velocity_sd_mps=0.2),
        right=_by_velocity(),
    ),
    _over_confident(),
    _world(
        "baseline's Q 50 times too small",
        _TACTICAL,
        baseline=_by_velocity(**_scaled_noise(_TACTICAL, 50.0**-0.5)),
        right=_by_velocity(),
    ),
    _world(
        "baseline's Q 50 times too large",
        _TACTICAL,
        baseline=_by_velocity(**_scaled_noise(_TACTICAL, 50.0**0.5)),
        right=_by_velocity(),
    ),
    _with_covariance_divided(),
    _world(
        "R of 18 mm/s for 22, truly 20",
        _MEMS,
        baseline=_by_velocity(velocity_sd_mps=0.022),
        other=_by_velocity(velocity_sd_mps=0.018),
    ),
    replace(
        _world("a gate against 1 % of outliers", _TACTICAL, baseline=_by_velocity(), gated=_by_velocity(**_GATE)),
        harm=_pings_that_lie,
    ),
    replace(
        _world(
            "dead: a knock, and gates that stay shut",
            _TACTICAL,
            baseline=_by_velocity(**_SHUT),
            aided=_by_acceleration(Acceleration(), **_SHUT),
        ),
        harm=_knock,
        dead=True,
    ),
    replace(
        _world("dead: an outage of an hour", _TACTICAL),
        way={
            "duration_s": DURATION_S + OUTAGE_S,
            "imu_rate_hz": 25.0,
            "reference_rate_hz": 1.0,
            "outages": [(DURATION_S / 2.0, DURATION_S / 2.0 + OUTAGE_S)],
        },
        dead=True,
    ),
    replace(_world("dead: a DVL turned by 90 deg", _TACTICAL), way={"mounting_rpy_deg": (0.0, 0.0, 90.0)}, dead=True),
    replace(_world("dead: a DVL in mm/s", _TACTICAL), harm=_in_millimetres, dead=True),
)
