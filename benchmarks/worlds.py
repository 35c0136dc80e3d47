"""The worlds in which the judgement is tried: what the sensors do, what the filters are told, what befalls the log.

The first are the same figure-eight with errors drawn anew for every dive. In most of them a candidate is truly better
than the baseline, as good or worse, which `true_errors` measures. In some nobody can tell: the filters are dead or set
wrong, or the baseline's noise is far off. The worlds at sea (`sea_worlds`) draw motion and all errors anew; their
filters know none of them exactly.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final

import msgspec
import numpy as np
from sea_worlds import Sea, SeaDvl, SeaReference, Voyage

from insdvl_replay.core.config import Acceleration, Config, Filter, InertialNoise, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors, ImuErrors
from insdvl_replay.studies.montecarlo import matched_errors

SCENARIO: Final = "figure-eight"
DURATION_S: Final = 300.0
OUTAGE_S: Final = 3600.0
SEED: Final = 1
SEA_SEED: Final = 330_000_000
"""Of the worlds at sea; rules were tried with other seeds (`judge.py --seed`), and measured with this one."""
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
        Whether the filters are dead or set wrong, so that nothing can be said of gain or loss; also where NIS over its
        degrees of freedom of the baseline is below 0.1 or above 10.
    sea : Sea, optional
        What is drawn for each dive, in place of the four before.
    """

    name: str
    config: Config
    imu_errors: ImuErrors
    dvl_errors: DvlErrors
    way: Mapping[str, Any] = field(default_factory=dict)
    harm: Harm = unharmed
    dead: bool = False
    sea: Sea | None = None

    @property
    def candidates(self) -> tuple[str, ...]:
        """Names of all filters but the baseline."""
        return tuple(self.config.filters)[1:]


def dive_seed(number: int, dive: int, sea_seed: int = SEA_SEED) -> int:
    """Return the seed of one dive in the world of some number, from which it can be made again by itself."""
    base = sea_seed if WORLDS[number].sea else SEED
    return int(np.random.SeedSequence(base, spawn_key=(number, dive)).generate_state(1)[0])


def made_dive(number: int, seed: int) -> tuple[Dive, Dive]:
    """Simulate one dive in the world of some number: as its sensors report it, and exactly."""
    world = WORLDS[number]
    if world.sea is not None:
        return world.sea.dive(seed)
    exact = exact_way(number)
    dive = add_errors(exact, world.imu_errors, world.dvl_errors, seed)
    return world.harm(
        dive, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_HARM_STREAM,)))
    ), exact


@cache
def exact_way(number: int) -> Dive:
    """Simulate the dive of a world with perfect sensors, once in each process."""
    return exact_dive(SCENARIO, **{"duration_s": DURATION_S, **WORLDS[number].way})


def _world(name: str, config: Config, **filters: Filter) -> World:
    """Let the sensors err exactly as the settings say; filters other than their own may be told something else."""
    errors = matched_errors(config)
    return World(
        name, msgspec.structs.replace(config, filters=filters) if filters else config, *errors
    )


def _by_velocity(**told: Any) -> Filter:
    return Filter(aiding=("velocity",), **told)


def _by_acceleration(acceleration: Acceleration, **told: Any) -> Filter:
    return Filter(aiding=("velocity", "acceleration"), acceleration=acceleration, **told)


def _scaled_noise(config: Config, factor: float) -> dict[str, float]:
    """Give a filter inertial noise whose standard deviations are larger by a factor."""
    return {key: factor * getattr(config.noise, key) for key in InertialNoise.__struct_fields__}


def _paper() -> World:
    filters = {
        "baseline": _by_velocity(),
        "windowed": _by_acceleration(Acceleration(sd_mps2=0.103)),
        "published": _by_acceleration(Acceleration(model="published", sd_mps2=0.103)),
    }
    config = msgspec.structs.replace(load_config("levy-klein"), filters=filters)
    return World(
        "unfit: FOG sensors, the paper's settings", config, GRADES["fog"], DvlErrors(), dead=True
    )


def _over_confident() -> World:
    """Tell the filters how noisy the sensors are, but one of them another DVL; they start as unsure as the paper's."""
    errors = GRADES["fog"]
    dvl_errors = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
    told = {key: getattr(errors, key) for key in InertialNoise.__struct_fields__}
    filters = {
        "baseline": _by_velocity(velocity_sd_mps=0.001, **told),
        "right": _by_velocity(beam_sd_mps=dvl_errors.beam_sd_mps, **told),
    }
    config = msgspec.structs.replace(load_config("levy-klein"), filters=filters)
    return World("unfit: baseline's R of 1 mm/s, truly 6", config, errors, dvl_errors, dead=True)


def _with_covariance_divided() -> World:
    """Divide Q and R of one filter by four, which leaves the gains. Both are nearly as sure at the start as ever."""
    initial = Initial(
        velocity_sd_mps=0.02,
        misalignment_sd_deg=(0.03, 0.03, 0.3),
        accel_bias_sd_mg=0.05,
        gyro_bias_sd_degph=0.05,
    )
    config = msgspec.structs.replace(_TACTICAL, initial=initial)
    less = _by_velocity(
        velocity_sd_mps=0.5 * config.dvl.velocity_sd_mps, **_scaled_noise(config, 0.5)
    )
    return _world("covariance divided by four", config, baseline=_by_velocity(), divided=less)


def _pings_that_lie(
    dive: Dive, rng: np.random.Generator, *, share: float = 0.01, sd_mps: float = 0.3
) -> Dive:
    """Let some pings report another velocity than that of the vehicle."""
    if dive.dvl.beam_velocity_mps is None or dive.dvl.beam_vectors_d is None:
        raise ValueError("a simulated DVL has beams")
    lies = rng.random(len(dive.dvl.time_ns)) < share
    wrong_d = lies[:, None] * rng.normal(scale=sd_mps, size=(len(lies), 3))
    beams = dive.dvl.beam_velocity_mps + wrong_d @ dive.dvl.beam_vectors_d.T
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))


def _knock(
    dive: Dive, rng: np.random.Generator, *, samples: int = 3, force_mps2: float = 300.0
) -> Dive:
    """Knock at the IMU for some samples: a single one would be taken out as it is read."""
    force_b = dive.imu.specific_force_b.copy()
    first = int(rng.integers(len(force_b) // 10, len(force_b) // 2))
    force_b[first : first + samples, 0] = force_mps2
    return replace(dive, imu=replace(dive.imu, specific_force_b=force_b))


def _in_millimetres(dive: Dive, _: np.random.Generator) -> Dive:
    if dive.dvl.beam_velocity_mps is None:
        raise ValueError("a simulated DVL has beams")
    return replace(
        dive, dvl=replace(dive.dvl, beam_velocity_mps=1000.0 * dive.dvl.beam_velocity_mps)
    )


_FOG, _TACTICAL, _MEMS = (load_config(preset) for preset in ("fog", "tactical", "mems"))
_GATE: Final = {"gate_probability": 0.99999}
_SHUT: Final = {**_GATE, "gate_reopen_after": 0}


def _noise(preset: str, **times: float) -> dict[str, float]:
    """Give a filter some of a preset's inertial noise, each so many times as large."""
    noise = load_config(preset).noise
    return {key: factor * getattr(noise, key) for key, factor in times.items()}


def _at_sea(name: str, sea: Sea, sd_mps: float = 0.01, **others: Filter) -> World:
    """Tell the filters the preset of the sensors' grade, a noise of the DVL that fits, and how noisy the reference is.

    The first filter is the baseline, which is told nothing else.
    """
    preset = load_config(sea.grade)
    filters = {"baseline": _by_velocity(), **others}
    noise = sea.reference
    config = msgspec.structs.replace(
        preset,
        filters=filters,
        dvl=msgspec.structs.replace(preset.dvl, velocity_sd_mps=sd_mps),
        evaluation=msgspec.structs.replace(preset.evaluation, starts=SEA_STARTS),
        reference=msgspec.structs.replace(
            preset.reference,
            position_sd_m=noise.position_m,
            velocity_sd_mps=noise.velocity_mps,
            attitude_sd_deg=noise.attitude_deg,
        ),
    )
    return World(f"sea: {name}", config, ImuErrors(), DvlErrors(), sea=sea)


SEA_STARTS: Final = 4
"""Drawn starts tell how soon filters settle, and nothing of what is judged here."""

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
    replace(
        _world(
            "unfit: baseline's R of 200 mm/s, truly 20",
            _TACTICAL,
            baseline=_by_velocity(velocity_sd_mps=0.2),
            right=_by_velocity(),
        ),
        dead=True,
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
        _world(
            "a gate against 1 % of outliers",
            _TACTICAL,
            baseline=_by_velocity(),
            gated=_by_velocity(**_GATE),
        ),
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
    replace(
        _world("dead: a DVL turned by 90 deg", _TACTICAL),
        way={"mounting_rpy_deg": (0.0, 0.0, 90.0)},
        dead=True,
    ),
    replace(_world("dead: a DVL in mm/s", _TACTICAL), harm=_in_millimetres, dead=True),
    # Worlds at sea: the baseline is set nearly right, and copies, like ones and worse ones stand beside it.
    _at_sea(
        "MEMS in waves, 200 s",
        Sea(
            Voyage(1.2, 0.2, 25.0, 60.0, wave_deg=4.0, wave_mps=0.2, wave_period_s=6.0),
            "mems",
            200.0,
        ),
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0105),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
    _at_sea(
        "hover, tactical, 400 s",
        Sea(Voyage(0.0, 0.08, 40.0, 15.0, wave_deg=1.0), "tactical", 400.0),
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0095),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
    _at_sea(
        "FOG, a DVL whose errors stay, 600 s",
        Sea(
            Voyage(1.5, 0.1, 60.0, 70.0),
            "fog",
            600.0,
            SeaDvl(correlated_mps=0.008, correlated_s=20.0),
        ),
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0103),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
    _at_sea(
        "tactical, one outage of 120 s in 480 s",
        Sea(Voyage(1.0, 0.1, 40.0, 60.0), "tactical", 480.0, outage_s=(240.0, 360.0)),
        alike1=_by_velocity(velocity_sd_mps=0.012),
        alike2=_by_velocity(dvl_noise="adaptive"),
        alike3=_by_velocity(**_noise("tactical", gyro_white_rad_rts=1.1)),
        alike4=_by_velocity(**_noise("tactical", accel_white_mps_rts=0.9)),
        alike5=_by_velocity(**_noise("tactical", gyro_white_rad_rts=1.2, accel_white_mps_rts=1.4)),
        alike6=_by_acceleration(Acceleration()),
    ),
    _at_sea(
        "MEMS, the bottom lost now and then, 900 s",
        Sea(
            Voyage(1.0, 0.2, 50.0, 60.0, wave_deg=2.0),
            "mems",
            900.0,
            SeaDvl(lost_spans=8),
            imu_rate_hz=40.0,
        ),
        sd_mps=0.012,
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0123),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
    _at_sea(
        "tactical in swell, a noisy reference of 1 Hz, 600 s",
        Sea(
            Voyage(1.2, 0.1, 60.0, 60.0, wave_deg=3.0, wave_mps=0.3, wave_period_s=10.0),
            "tactical",
            600.0,
            reference=SeaReference(0.3, 0.03, 0.1, 1.0),
        ),
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0105),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
    _at_sea(
        "tactical survey of 2 h",
        Sea(
            Voyage(1.5, 0.05, 240.0, 80.0),
            "tactical",
            7200.0,
            SeaDvl(lost_spans=20),
            SeaReference(rate_hz=0.5),
            20.0,
        ),
        copy=_by_velocity(),
        alike=_by_velocity(velocity_sd_mps=0.0105),
        wide=_by_velocity(velocity_sd_mps=0.05),
        worse=_by_velocity(velocity_sd_mps=0.2),
    ),
)
