"""Worlds in which two filters differ by constants that are drawn once a dive, and what is true in each of them.

Two filters with two compasses, mountings or IMUs of the same kind are equal, since they could be exchanged; on any one
dive the one or the other is far better. In further worlds one filter is truly better, the reference is late, the
heading at the start is known more or less well, or no word should be said at all. The truth of a pair is the geometric
mean, over an ensemble of dives, of the ratio of its errors against the exact motion, from the start that a dive has.
"""

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import msgspec
import numpy as np
from scatter_filters import (
    NO_TURN,
    OtherSensors,
    Told,
    as_filter,
    baseline_of,
    turned_dvl,
    with_larger_errors,
    with_lever_arm,
    with_other_sensors,
)
from sea_worlds import Sea, SeaDvl, SeaReference, Voyage
from true_errors import TrueRatio, ratio_of_logs

from insdvl_replay.core.config import Config, Filter, Heading, InertialNoise, Vector
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    ReferenceColumns,
    SensorColumns,
    nanoseconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.evaluation.reference_errors import ReferenceErrors, reference_errors
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, rpy_from_mat
from insdvl_replay.preparation.prepared import prepare_dive, with_reference_at_imu
from insdvl_replay.preparation.run import prepared_timeline, run_one

SEED: Final = 71_000_000
OTHER: Final = OtherSensors.name
FIVE: Final = ("first", "second", "third", "fourth", "fifth")
DURATION_S: Final = 240.0
VEHICLE_STREAM: Final = 7
"""What is drawn for a vehicle is drawn apart from what is drawn for its dives."""
WITHHELD_S: Final = ((100.0, 160.0), (160.0, 220.0))
"""The spans without DVL that tell the true drift of an outage, each in a run of its own: those of the tool's test.

Earlier the filters still settle, and one that trusts its pings too much may settle sooner and drift less.
"""
SETTLED_S: Final = 60.0
"""Velocity and attitude count from this time on."""
SEA: Final = Sea(
    Voyage(1.2, 0.15, 50.0, 70.0, wave_deg=2.0),
    "tactical",
    DURATION_S,
    reference=SeaReference(rate_hz=5.0),
    imu_rate_hz=25.0,
)

WAVES: Final = replace(SEA, voyage=replace(SEA.voyage, wave_mps=0.2, wave_period_s=7.0))
"""Accelerations by which a late reference is off as much as a filter that trusts late pings."""

Kind = Literal["equal", "copy", "ensemble", "no word"]
"""Equal, since both could be exchanged; the same; what the ensemble tells; or nobody may say anything."""


class Drawn(NamedTuple):
    """One dive of a world: what its log holds, how the vehicle moved, and what each filter is told."""

    reported: Dive
    exact: Dive
    told: Mapping[str, Told] = {}
    start_turn_deg: float = 0.0
    """By which the vehicle's own heading at the start is off, where that is not what the reference says."""


Draw = Callable[[Dive, Dive, np.random.Generator], Drawn]


@dataclass(frozen=True)
class ScatterWorld:
    """Filters, a vehicle, and what is drawn for each dive.

    Attributes
    ----------
    config : Config
        The first filter is the baseline.
    draw : callable
        Gives a dive from its readings as an ordinary vehicle reports them, the exact motion, and a generator.
    primary : str
        The quantity whose truth the words are held against.
    """

    name: str
    kind: Kind
    config: Config
    draw: Draw
    primary: str = "position"
    sea: Sea = SEA
    dives_of_vehicle: int = 0
    """So many dives in a row are of one vehicle; 0 where nobody says which vehicle made a dive."""
    vehicle_log_sd: float = 0.0
    """Standard deviation, from vehicle to vehicle, of the logarithm of the factor of a filter's errors."""

    def vehicle_of(self, number: int) -> int:
        """Number the vehicle of a dive."""
        return number // self.dives_of_vehicle

    def config_of(self, number: int) -> Config:
        """Give the settings of a dive, which name its vehicle."""
        if not self.dives_of_vehicle:
            return self.config
        return self.config.of_vehicle(f"vehicle {self.vehicle_of(number)}")

    @property
    def candidates(self) -> tuple[str, ...]:
        """Names of all filters but the baseline."""
        return tuple(self.config.filters)[1:]

    @property
    def can_be_exchanged(self) -> bool:
        """Whether each dive can be made a second time with the two filters exchanged, so that no one is better."""
        return self.kind == "equal" and len(self.candidates) == 1


def dive_of(world: ScatterWorld, number: int, seed: int = SEED) -> Drawn:
    """Make a dive of a world by its number; the same numbers make the same dive."""
    of_world = zlib.crc32(world.name.encode())
    vehicle, drawn = np.random.SeedSequence((seed, of_world, number)).spawn(2)
    reported, exact = world.sea.dive(int(vehicle.generate_state(1)[0]))
    found = world.draw(reported, exact, np.random.default_rng(drawn))
    if not world.dives_of_vehicle:
        return found
    rng = np.random.default_rng((seed, of_world, VEHICLE_STREAM, world.vehicle_of(number)))
    factor = math.exp(world.vehicle_log_sd * rng.standard_normal())
    told = {
        name: msgspec.structs.replace(one, factor=factor * one.factor)
        for name, one in found.told.items()
    }
    return found._replace(told=told)


def exchanged(drawn: Drawn, name: str) -> Drawn:
    """Give the baseline of a dive the sensors of a filter, and the filter those of the baseline.

    A filter whose errors are larger by a factor keeps its sensors, and its errors are smaller by as much.
    """
    told = drawn.told[name]
    mounting = mat_from_rpy(np.array(told.mounting_rpy_deg) * DEG)
    back = Told(
        accel_bias_mps2=vector_of(-np.array(told.accel_bias_mps2)),
        gyro_bias_radps=vector_of(-np.array(told.gyro_bias_radps)),
        mounting_rpy_deg=NO_TURN if told.mounting_rpy_deg == NO_TURN else rpy_deg_of(mounting.T),
        heading_deg=-told.heading_deg,
        factor=1.0 / told.factor,
        ping_noise=told.ping_noise.exchanged if told.ping_noise else None,
    )
    return drawn._replace(
        reported=with_other_sensors(drawn.reported, told), told={**drawn.told, name: back}
    )


# --- What is drawn.


def nothing_drawn(reported: Dive, exact: Dive, _: np.random.Generator) -> Drawn:
    """Leave a dive as it is."""
    return Drawn(reported, exact)


def compasses(*names: str, sd_deg: float, white_deg: float = 0.3) -> Draw:
    """Draw a compass for the baseline and for each filter, with errors that are constant in a dive."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        of_baseline_deg, *others_deg = sd_deg * rng.standard_normal(1 + len(names))
        told = {
            name: Told(heading_deg=float(off - of_baseline_deg))
            for name, off in zip(names, others_deg, strict=True)
        }
        return Drawn(
            with_compass(reported, exact, float(of_baseline_deg), white_deg, rng), exact, told
        )

    return draw


def with_compass(
    reported: Dive, exact: Dive, off_deg: float, white_deg: float, rng: np.random.Generator
) -> Dive:
    """Add readings of a heading once a second: the true one, a constant and white noise."""
    true = reference_of(exact)
    rate_hz = round((len(true.time_ns) - 1) * NS_PER_S / float(true.time_ns[-1] - true.time_ns[0]))
    true = true.rows(np.arange(len(true.time_ns)) % rate_hz == 0)
    errors_deg = off_deg + white_deg * rng.standard_normal((len(true.time_ns), 1))
    heading = rpy_from_mat(true.mat_nb)[:, 2:] + errors_deg * DEG
    return replace(reported, sensors={"heading": SensorColumns(true.time_ns, heading)})


def mountings(name: str, *, sd_deg: float) -> Draw:
    """Draw how the DVL is mounted, and how each of two filters is told so; the baseline's error is in the readings."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        of_baseline, of_other = (
            mat_from_rpy(rpy) for rpy in sd_deg * DEG * rng.standard_normal((2, 3))
        )
        reported = replace(reported, dvl=turned_dvl(reported.dvl, rpy_deg_of(of_baseline)))
        return Drawn(
            reported, exact, {name: Told(mounting_rpy_deg=rpy_deg_of(of_other @ of_baseline.T))}
        )

    return draw


def calibrated_mounting(name: str, *, of_baseline_deg: float, of_other_deg: float) -> Draw:
    """Let two filters be told a mounting about down that is off by fixed angles, both to the same side."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        side = rng.choice((-1.0, 1.0))
        before = side * of_baseline_deg
        after = side * of_other_deg
        reported = replace(reported, dvl=turned_dvl(reported.dvl, (0.0, 0.0, float(before))))
        return Drawn(
            reported, exact, {name: Told(mounting_rpy_deg=(0.0, 0.0, float(after - before)))}
        )

    return draw


def rpy_deg_of(mat: Floats) -> Vector:
    """Give roll, pitch and heading of a rotation."""
    roll, pitch, heading = rpy_from_mat(mat) / DEG
    return float(roll), float(pitch), float(heading)


def imus(name: str, *, accel_mg: float, gyro_degph: float) -> Draw:
    """Draw biases of two IMUs, besides those that both have."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        accel = accel_mg * MG * rng.standard_normal((2, 3))
        gyro = gyro_degph * DEG_PER_HOUR * rng.standard_normal((2, 3))
        of_baseline = Told(accel_bias_mps2=vector_of(accel[0]), gyro_bias_radps=vector_of(gyro[0]))
        of_other = Told(
            accel_bias_mps2=vector_of(accel[1] - accel[0]),
            gyro_bias_radps=vector_of(gyro[1] - gyro[0]),
        )
        return Drawn(
            replace(reported, imu=with_other_sensors(reported, of_baseline).imu),
            exact,
            {name: of_other},
        )

    return draw


def vector_of(column: Floats) -> Vector:
    """Give three numbers as a tuple."""
    x, y, z = map(float, column)
    return x, y, z


def factors(name: str, *, ratio: float, log_sd: float) -> Draw:
    """Draw by how much the errors of a filter are larger than the baseline's; the geometric mean is the ratio."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        factor = ratio * math.exp(log_sd * rng.standard_normal())
        return Drawn(reported, exact, {name: Told(factor=factor)})

    return draw


def first_of_several(*names: str, ratio: float, log_sd: float) -> Draw:
    """Draw factors as `factors` does, for the first filter about a ratio, and for all others about 1."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        spread = np.exp(log_sd * rng.standard_normal(len(names)))
        spread[0] *= ratio
        return Drawn(
            reported,
            exact,
            {name: Told(factor=float(by)) for name, by in zip(names, spread, strict=True)},
        )

    return draw


def shaken(name: str, *, sd_mps: float) -> Draw:
    """Let a filter give another answer whenever it is run."""
    return lambda reported, exact, _: Drawn(reported, exact, {name: Told(shake_mps=sd_mps)})


def start_headings(*, vehicle_deg: float, compass_deg: float, reference_deg: float = 0.0) -> Draw:
    """Draw the vehicle's own heading at the start, a compass, and by how much the reference's attitude is turned."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        of_vehicle_deg, of_compass_deg, of_reference_deg = (
            vehicle_deg,
            compass_deg,
            reference_deg,
        ) * rng.standard_normal(3)
        reported = with_compass(reported, exact, float(of_compass_deg), 0.3, rng)
        turn = mat_from_vector(np.array([0.0, 0.0, of_reference_deg * DEG]))
        reference = reference_of(reported)
        reported = replace(reported, reference=replace(reference, mat_nb=turn @ reference.mat_nb))
        return Drawn(reported, exact, start_turn_deg=float(of_vehicle_deg))

    return draw


def late(
    draw: Draw, *, reference_s: tuple[float, float] = (0.1, 0.3), dvl_s: float = 0.12
) -> Draw:
    """Delay the stamps of the reference, by a time that is drawn, and those of the DVL."""

    def drawn(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        found = draw(reported, exact, rng)
        reference = reference_of(found.reported)
        dvl = found.reported.dvl
        late_ns = nanoseconds(rng.uniform(*reference_s))
        reference = replace(reference, time_ns=reference.time_ns + late_ns)
        dvl = replace(dvl, time_ns=dvl.time_ns + nanoseconds(dvl_s))
        return found._replace(reported=replace(found.reported, reference=reference, dvl=dvl))

    return drawn


def reference_of(dive: Dive) -> ReferenceColumns:
    """Give the reference that every simulated dive has."""
    if dive.reference is None:
        raise ValueError("a simulated dive has a reference")
    return dive.reference


# --- What is true.


class TrueErrors(NamedTuple):
    """Root mean squares of what one filter is off by in one dive, against the exact motion."""

    position: float
    """Horizontal, over the whole dive, m."""
    outage_30s: float
    """Horizontal drift in 30 s without the DVL, m."""
    outage_60s: float
    drift_60s: float
    """The same with it."""
    velocity: float
    """Horizontal, m/s."""
    level: float
    """deg."""
    heading: float
    """deg."""


def true_errors_of(world: ScatterWorld, drawn: Drawn) -> dict[str, TrueErrors]:
    """Run every filter from the start that the vehicle has, once with all pings and once without some spans."""
    whole = histories_of(world, drawn)
    in_outages = [histories_of(world, without_pings(drawn, span_s)) for span_s in WITHHELD_S]
    reference = reference_of(drawn.exact)
    first_ns = int(drawn.exact.imu.time_ns[0])
    found = {}
    for name in world.config.filters:
        withheld = [reference_errors(histories[name], reference) for histories in in_outages]
        found[name] = _true_errors(reference_errors(whole[name], reference), withheld, first_ns)
    return found


def without_pings(drawn: Drawn, span_s: tuple[float, float]) -> Drawn:
    """Leave out the pings of a span of a dive, s since its first sample."""
    begin_s, end_s = span_s
    dvl = drawn.reported.dvl
    since_s = (dvl.time_ns - drawn.exact.imu.time_ns[0]) / NS_PER_S
    kept = (since_s < begin_s) | (since_s >= end_s)
    return drawn._replace(reported=replace(drawn.reported, dvl=dvl.rows(kept)))


def histories_of(world: ScatterWorld, drawn: Drawn) -> dict[str, History]:
    """Run every filter over a dive: the tool's own as they are set, and others with the sensors they are told."""
    config = world.config
    own = {name: filter_ for name, filter_ in config.filters.items() if not filter_.is_user_code}
    found = _runs(drawn, drawn.reported, msgspec.structs.replace(config, filters=own))
    exact = reference_of(drawn.exact)
    for name in config.filters:
        if name in own:
            continue
        told = drawn.told[name]
        dive = with_other_sensors(drawn.reported, told)
        filters = {name: baseline_of(config, told)}
        dvl = with_lever_arm(config.dvl, told)
        as_told = msgspec.structs.replace(config, filters=filters, dvl=dvl)
        (history,) = _runs(drawn, dive, as_told).values()
        found[name] = with_larger_errors(history, exact, told.factor)
    return found


def _runs(drawn: Drawn, dive: Dive, config: Config) -> dict[str, History]:
    """Run filters from the start of a dive as it was reported, turned to the vehicle's own heading."""
    reported = with_reference_at_imu(drawn.reported, config)
    alignment = prepare_dive(reported, config).alignment
    turn = mat_from_vector(np.array([0.0, 0.0, drawn.start_turn_deg * DEG]))
    start = replace(alignment.start, mat_nb=turn @ alignment.start.mat_nb)
    dive = replace(dive, reference=reported.reference)
    prepared = replace(prepare_dive(dive, config), alignment=replace(alignment, start=start))
    timeline = prepared_timeline(dive, prepared, reference_of(drawn.exact).time_ns)
    return {filter_.name: run_one(filter_, prepared, timeline) for filter_ in prepared.filters}


def _true_errors(
    whole: ReferenceErrors, in_outages: Sequence[ReferenceErrors], first_ns: int
) -> TrueErrors:
    since_s = (whole.time_ns - first_ns) / NS_PER_S
    settled = since_s >= SETTLED_S
    position_m = whole.position_error_ned_m[:, :2]
    ends = np.searchsorted(since_s, since_s + 60.0)
    begins = np.flatnonzero(ends < len(ends))
    attitude_deg = whole.attitude_error_rad[settled] / DEG
    return TrueErrors(
        position=_rms(position_m),
        outage_30s=_drift_m(in_outages, since_s, 30.0),
        outage_60s=_drift_m(in_outages, since_s, 60.0),
        drift_60s=_rms(position_m[ends[begins]] - position_m[begins]),
        velocity=_rms(whole.velocity_error_n[settled, :2]),
        level=_rms(attitude_deg[:, :2]),
        heading=_rms(attitude_deg[:, 2:]),
    )


def _drift_m(in_outages: Sequence[ReferenceErrors], since_s: Floats, length_s: float) -> float:
    """Return the rms drift over the first part of the spans without DVL."""
    drifts_m = []
    for errors, (begin_s, _) in zip(in_outages, WITHHELD_S, strict=True):
        begin, end = np.searchsorted(since_s, (begin_s, begin_s + length_s))
        position_m = errors.position_error_ned_m[:, :2]
        drifts_m.append(position_m[end] - position_m[begin])
    return _rms(np.array(drifts_m))


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def true_ratios(
    errors: list[dict[str, TrueErrors]], baseline: str, candidate: str
) -> dict[str, TrueRatio]:
    """Compare two filters over an ensemble of dives, quantity by quantity."""
    before = np.array([dive[baseline] for dive in errors])
    after = np.array([dive[candidate] for dive in errors])
    logs = np.log(after / before)
    return {
        name: ratio_of_logs(column)
        for name, column in zip(TrueErrors._fields, logs.T, strict=True)
    }


# --- The worlds.

STARTS: Final = 4
DVL_SD_MPS: Final = 0.008
"""What filters are told of the DVL, which is nearly true; the preset's 20 mm/s are far from it."""


def settings_of(
    *others: str, aiding: tuple[str, ...] = ("velocity",), sd_mps: float = DVL_SD_MPS
) -> Config:
    """Give a baseline and filters with sensors of their own; all are told the preset of the IMU's grade."""
    preset = load_config(SEA.grade)
    noise = SEA.reference
    reference = msgspec.structs.replace(
        preset.reference,
        position_sd_m=noise.position_m,
        velocity_sd_mps=noise.velocity_mps,
        attitude_sd_deg=noise.attitude_deg,
    )
    filters = {"baseline": Filter(aiding=aiding, velocity_sd_mps=sd_mps)}
    filters |= {name: as_filter(name) for name in others}
    evaluation = msgspec.structs.replace(preset.evaluation, starts=STARTS)
    heading = Heading(sd_deg=1.0)
    return msgspec.structs.replace(
        preset, filters=filters, reference=reference, evaluation=evaluation, heading=heading
    )


def _with(config: Config, **filters: Filter) -> Config:
    return msgspec.structs.replace(config, filters={**config.filters, **filters})


def _by_velocity(sd_mps: float) -> Filter:
    return Filter(aiding=("velocity",), velocity_sd_mps=sd_mps)


def _dependent(config: Config) -> Config:
    """Say that the reference was computed from the same sensors, so that the drift without the DVL counts."""
    return msgspec.structs.replace(
        config, reference=msgspec.structs.replace(config.reference, independent=False)
    )


def _named(config: Config, candidate: str) -> Config:
    """Name the candidate that the question is about, before anything is run."""
    return msgspec.structs.replace(
        config, evaluation=msgspec.structs.replace(config.evaluation, candidate=candidate)
    )


def _noisy(white_mps: float) -> Sea:
    return replace(SEA, dvl=SeaDvl(white_mps=white_mps, bias_mps=0.001, scale=0.001))


def _too_large(times: float) -> Config:
    """Tell the baseline variances of all noise that are so many times too large; the candidate is told the right ones.

    Both have nearly the same gains, but at the start.
    """
    config = settings_of(sd_mps=DVL_SD_MPS * math.sqrt(times))
    factor = math.sqrt(times)
    inertial = {
        key: factor * getattr(config.noise, key) for key in InertialNoise.__struct_fields__
    }
    baseline = msgspec.structs.replace(config.filters["baseline"], **inertial)
    filters = {"baseline": baseline, "right": _by_velocity(DVL_SD_MPS)}
    return msgspec.structs.replace(config, filters=filters)


WITH_COMPASS: Final = ("velocity", "heading")


def _two_compasses(scatter: float, sd_deg: float) -> ScatterWorld:
    config = settings_of(OTHER, aiding=WITH_COMPASS)
    return ScatterWorld(
        f"two compasses, s {scatter:g}", "equal", config, compasses(OTHER, sd_deg=sd_deg)
    )


def _two_mountings(scatter: float, sd_deg: float) -> ScatterWorld:
    return ScatterWorld(
        f"two mountings, s {scatter:g}",
        "equal",
        settings_of(OTHER),
        mountings(OTHER, sd_deg=sd_deg),
    )


def _two_imus(scatter: float, accel_mg: float, gyro_degph: float) -> ScatterWorld:
    draw = imus(OTHER, accel_mg=accel_mg, gyro_degph=gyro_degph)
    return ScatterWorld(f"two IMUs, s {scatter:g}", "equal", settings_of(OTHER), draw)


def _start_heading(
    name: str, *, told_deg: float, vehicle_deg: float = 0.0, reference_deg: float = 0.0
) -> ScatterWorld:
    """Hold a compass against none, where the heading at the start is as uncertain as the filters are told."""
    config = settings_of()
    initial = msgspec.structs.replace(
        config.initial,
        uncertainty="settings",
        misalignment_sd_deg=(0.05, 0.05, told_deg),
        velocity_sd_mps=0.02,
    )
    compass = Filter(aiding=WITH_COMPASS, velocity_sd_mps=DVL_SD_MPS)
    config = _with(msgspec.structs.replace(config, initial=initial), compass=compass)
    draw = start_headings(vehicle_deg=vehicle_deg, compass_deg=0.3, reference_deg=reference_deg)
    return ScatterWorld(name, "ensemble", config, draw)


WORLDS: Final[tuple[ScatterWorld, ...]] = (
    # Equal pairs.
    _two_compasses(0.1, 0.027),
    _two_compasses(0.2, 0.06),
    _two_compasses(0.5, 0.22),
    _two_mountings(0.1, 0.03),
    _two_mountings(0.2, 0.07),
    _two_mountings(0.5, 0.25),
    _two_imus(0.1, 0.4, 1.1),
    _two_imus(0.2, 0.7, 2.0),
    _two_imus(0.5, 2.0, 6.5),
    ScatterWorld(
        "five compasses, none differs",
        "equal",
        settings_of(*FIVE, aiding=WITH_COMPASS),
        compasses(*FIVE, sd_deg=0.07),
    ),
    ScatterWorld(
        "two IMUs, the reference of the same sensors",
        "equal",
        _dependent(settings_of(OTHER)),
        imus(OTHER, accel_mg=6.0, gyro_degph=40.0),
        primary="outage_30s",
    ),
    ScatterWorld(
        "vehicles that differ, equal on average",
        "equal",
        settings_of(OTHER),
        factors(OTHER, ratio=1.0, log_sd=0.1),
        dives_of_vehicle=2,
        vehicle_log_sd=0.2,
    ),
    ScatterWorld(
        "equal on average, s 0.3",
        "equal",
        settings_of(OTHER),
        factors(OTHER, ratio=1.0, log_sd=0.3),
    ),
    # True changes.
    ScatterWorld(
        "errors times 0.8, s 0.1",
        "ensemble",
        settings_of(OTHER),
        factors(OTHER, ratio=0.8, log_sd=0.1),
    ),
    ScatterWorld(
        "errors times 0.8, s 0.2",
        "ensemble",
        settings_of(OTHER),
        factors(OTHER, ratio=0.8, log_sd=0.2),
    ),
    ScatterWorld(
        "five at once, the first is named and 0.8 of the baseline",
        "ensemble",
        _named(settings_of(*FIVE), FIVE[0]),
        first_of_several(*FIVE, ratio=0.8, log_sd=0.1),
    ),
    ScatterWorld(
        "errors times 1.25, s 0.2",
        "ensemble",
        settings_of(OTHER),
        factors(OTHER, ratio=1.25, log_sd=0.2),
    ),
    ScatterWorld(
        "a mounting known to 0.8 deg, before to 1",
        "ensemble",
        settings_of(OTHER),
        calibrated_mounting(OTHER, of_baseline_deg=1.0, of_other_deg=0.8),
    ),
    ScatterWorld(
        "a mounting known to 0.45 deg, before to 0.6",
        "ensemble",
        settings_of(OTHER),
        calibrated_mounting(OTHER, of_baseline_deg=0.6, of_other_deg=0.45),
    ),
    ScatterWorld(
        "baseline's R of 125 mm/s, truly 50",
        "ensemble",
        _with(settings_of(sd_mps=0.125), right=_by_velocity(0.05)),
        nothing_drawn,
        sea=_noisy(0.05),
    ),
    # The heading at the start: the reference's is nearly exact, and the vehicle's own is worse, or both are wrong.
    _start_heading("a compass, start heading good to 0.02 deg", told_deg=0.02, vehicle_deg=0.02),
    _start_heading("a compass, start heading good to 0.3 deg", told_deg=0.3, vehicle_deg=0.3),
    _start_heading("a compass, start heading good to 1 deg", told_deg=1.0, vehicle_deg=1.0),
    _start_heading(
        "a compass, the reference's heading good to 1 deg", told_deg=1.0, reference_deg=1.0
    ),
    # Late stamps of reference and DVL.
    ScatterWorld(
        "late: R of 2 mm/s, truly 7",
        "ensemble",
        _with(settings_of(), small=_by_velocity(0.002)),
        late(nothing_drawn),
        sea=WAVES,
    ),
    ScatterWorld(
        "late: R of 5 mm/s, truly 100, the reference of the same sensors",
        "ensemble",
        _dependent(_with(settings_of(sd_mps=0.11), small=_by_velocity(0.005))),
        late(nothing_drawn),
        primary="outage_60s",
        sea=_noisy(0.1),
    ),
    ScatterWorld(
        "late: two compasses, s 0.2",
        "equal",
        settings_of(OTHER, aiding=WITH_COMPASS),
        late(compasses(OTHER, sd_deg=0.07)),
    ),
    # No difference, and none that could be told.
    ScatterWorld(
        "a copy", "copy", _with(settings_of(), copy=_by_velocity(DVL_SD_MPS)), nothing_drawn
    ),
    ScatterWorld(
        "a copy that is a class", "copy", settings_of(OTHER), factors(OTHER, ratio=1.0, log_sd=0.0)
    ),
    ScatterWorld(
        "baseline's noise 800 times too large",
        "no word",
        _too_large(800.0),
        nothing_drawn,
    ),
    ScatterWorld(
        "another answer each time", "no word", settings_of(OTHER), shaken(OTHER, sd_mps=0.03)
    ),
)
