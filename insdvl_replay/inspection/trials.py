"""Trials of what an IMU and a DVL could be: which topics, units, axes and signs give the smallest innovations.

A trial is one run of the baseline over a stretch of the dive, with coarse noise, thinned readings and pings. It starts
level, with any heading, and needs no reference. Its cost is the robust mean square of the innovations. All trials of
a dive share the noise, so their costs can be compared.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.fit import possible_axes, robust_cost
from insdvl_replay.calibration.found import Given
from insdvl_replay.calibration.free_mounting import averaged_imu, samples_in_step
from insdvl_replay.calibration.innovations import NO_CHANGE, ReadDive
from insdvl_replay.checks.dvl import fit, velocity_pairs
from insdvl_replay.checks.imu import ENOUGH, gyro_by_attitude
from insdvl_replay.core.config import Config, Dvl, Filter, Initial, Noise
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats, ImuColumns, TimeNs, seconds
from insdvl_replay.core.errors import LogError, UserError, counted
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import horizontal
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.inspection.signed_axes import axes_text, level_axes, map_of
from insdvl_replay.logs.columns.imu import FRD, in_frd, turned_to_body

STRETCH_S: Final = 240.0
PING_STEP_S: Final = 0.5
FEWEST: Final = 3  # averaged samples, and pings, of which a stretch can be replayed
COARSE: Final = Noise(
    accel_white_mps_rts=0.01,
    gyro_white_rad_rts=2e-4,
    accel_bias_walk_mps2_rts=1e-5,
    gyro_bias_walk_radps_rts=1e-7,
)
CLEARLY: Final = 0.8  # ratio of costs below which another hypothesis is better
COHERENT: Final = 0.95
RATE_CLEARLY: Final = 0.02  # correlation with a reference by which rates fit clearly better
MOST_COMPARED: Final = 16  # hypotheses that are compared with a reference
STRANGE: Final = 0.6  # the same for single signs and other scales, which are rare
# cost of a trial that leaves nothing to find: innovations of half the coarse noise
SETTLED: Final = 0.25
# cost of a trial whose innovations are as large as the coarse noise expects
CONSISTENT: Final = 1.0
FAST_RADPS: Final = 0.6  # vehicles turn faster rarely, so that faster rates may be in deg/s
# ratio to the least cost of all IMUs above which one is not looked at further
NOT_FAR_OFF: Final = 2.0
LEAST_MPS: Final = 0.03  # slower velocities are noise of the DVL
BEST: Final = 4  # hypotheses of axes that get single signs and scales tried
# Ratios of measured to true rate that are tried; deg/s are tried by themselves.
SCALES: Final = (0.3, 0.4, 0.5, 0.6, 0.7, 0.83, 1.2, 1.44, 1.7, 2.0, 2.5, 3.3)
DEG_PER_S: Final = 1.0 / DEG


@dataclass(frozen=True)
class Hypothesis:
    """How an IMU and a DVL could be mounted and scaled, from readings in the axes of the instruments."""

    axes: str = FRD  # of the gyros
    force_axes: str = FRD
    rate_scale: float = 1.0  # measured over true
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the DVL
    cost: float = np.inf
    imu_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the IMU, beyond its axes

    def applied(self, imu: ImuColumns) -> ImuColumns:
        """Bring readings to the axes of the body."""
        in_axes = replace(
            imu,
            specific_force_b=in_frd(
                imu.specific_force_b, self.force_axes, "imu.specific_force_axes"
            ),
            angular_rate_b=in_frd(
                imu.angular_rate_b, self.axes, "imu.axes", 1.0 / self.rate_scale
            ),
        )
        return turned_to_body(in_axes, self.imu_rpy_deg)

    @property
    def gyro_turn(self) -> Floats:
        """The map from the gyros' axes to the body's, (3, 3)."""
        return mat_from_rpy(np.array(self.imu_rpy_deg) * DEG) @ map_of(self.axes)

    @property
    def relation(self) -> tuple[object, ...]:
        """What no rotation of the IMU changes: the forces' axes among the gyros', and the scale."""
        between = map_of(self.force_axes).T @ map_of(self.axes)
        return (*np.rint(between).ravel().tolist(), self.rate_scale)

    def with_body_turned(self, turn: Floats) -> "Hypothesis":
        """Turn the body's axes, (3, 3), so that IMU and DVL fit each other as before."""
        imu = turn @ mat_from_rpy(np.array(self.imu_rpy_deg) * DEG)
        dvl = turn @ mat_from_rpy(np.array(self.rpy_deg) * DEG)
        return replace(self, imu_rpy_deg=rpy_of(imu), rpy_deg=rpy_of(dvl))


def thinned(dive: Dive) -> Dive:
    """Return the liveliest stretch of a dive, with averaged IMU readings and fewer pings.

    A LogError where there are too few of them.
    """
    imu = dive.imu
    dvl = dive.dvl
    blocks = len(imu.time_ns) // samples_in_step(imu)
    if blocks < FEWEST or len(dvl.time_ns) < FEWEST:
        found = f"{counted(len(imu.time_ns), 'sample')} of the IMU and {counted(len(dvl.time_ns), 'ping')} of the DVL"
        raise LogError(f"has {found}, too few to find settings", "use a longer part of the dive")
    apart = np.append(
        True, np.diff((dvl.time_ns - dvl.time_ns[0]) // int(PING_STEP_S * NS_PER_S)) > 0
    )
    imu = averaged_imu(imu)
    dvl = dvl.rows(apart)
    first_ns = max(imu.time_ns[0], dvl.time_ns[0])
    last_ns = min(imu.time_ns[-1], dvl.time_ns[-1])
    length_ns = int(STRETCH_S * NS_PER_S)
    if last_ns - first_ns > length_ns:
        first_ns = _liveliest_ns(imu, np.arange(first_ns, last_ns - length_ns, length_ns // 4))
        last_ns = first_ns + length_ns
    return replace(
        dive, imu=imu.within(first_ns, last_ns), dvl=dvl.within(first_ns, last_ns), reference=None
    )


def _liveliest_ns(imu: ImuColumns, starts_ns: TimeNs) -> int:
    """Return the start of the stretch in which the vehicle turns and surges most."""
    force = imu.specific_force_b
    rate = imu.angular_rate_b
    turning = np.linalg.norm(rate - np.median(rate, axis=0), axis=1)
    surging = np.linalg.norm(force - np.median(force, axis=0), axis=1)
    lively = np.cumsum(
        turning / max(np.mean(turning), 1e-9) + surging / max(np.mean(surging), 1e-9)
    )
    ends_ns = starts_ns + int(STRETCH_S * NS_PER_S)
    before = lively[np.searchsorted(imu.time_ns, starts_ns) - 1]
    after = lively[np.searchsorted(imu.time_ns, ends_ns) - 1]
    return int(starts_ns[np.argmax(after - before)])


def trial_config(config: Config, latitude_deg: float) -> Config:
    """Return the settings of trials: level start, coarse noise, the DVL as it is read."""
    return msgspec.structs.replace(
        config,
        dvl=msgspec.structs.replace(
            config.dvl,
            lever_arm_m=Dvl().lever_arm_m,
            mounting_rpy_deg=Dvl().mounting_rpy_deg,
            velocity_sd_mps=0.03,
            beam_sd_mps=None,
            latency_s=0.0,
            latency_of_dives_s=(),
        ),
        noise=COARSE,
        initial=Initial(
            source="level",
            heading_deg=0.0,
            latitude_deg=latitude_deg,
            accel_bias_sd_mg=20.0,
            gyro_bias_sd_degph=200.0,
        ),
        span=Config().span,
        filters={"baseline": Filter(aiding=("velocity",))},
        evaluation=Config().evaluation,
        topics={},
    )


def with_cost(tried: Hypothesis, dive: Dive, config: Config) -> Hypothesis:
    """Run one trial."""
    dvl = msgspec.structs.replace(config.dvl, mounting_rpy_deg=tried.rpy_deg)
    read = ReadDive(
        replace(dive, imu=tried.applied(dive.imu)), msgspec.structs.replace(config, dvl=dvl)
    )
    try:
        residuals = read.innovations().residuals(NO_CHANGE)
    except UserError:
        return replace(tried, cost=np.inf)
    return replace(tried, cost=robust_cost(residuals) / residuals.size)


class Trials:
    """All trials of one thinned dive, whose readings are in the axes of the instruments."""

    def __init__(
        self,
        dive: Dive,
        config: Config,
        as_read: Hypothesis,
        given: Given,
    ) -> None:
        self.dive = dive
        self.config = config
        self.as_read = as_read
        self.given = given
        self.found = [as_read]
        # Of hypotheses that are one vehicle turned about down, the first is nearest to what is as read.
        self.order: list[Hypothesis] = [as_read]
        self.mountings: list[tuple[float, float, float]] | None = None
        if given.has("dvl.mounting_rpy_deg"):
            self.mountings = [given.config.dvl.mounting_rpy_deg]
        if not (len(dive.imu.time_ns) and len(dive.dvl.time_ns)):
            return
        fastest_radps = float(np.quantile(np.linalg.norm(dive.imu.angular_rate_b, axis=1), 0.99))
        ways = list(mounted(dive, as_read, self.mountings))
        self.order = ways
        if fastest_radps > FAST_RADPS:
            self.order = [*ways, *(replace(one, rate_scale=DEG_PER_S) for one in ways)]
        self.found = self._tried(self.order) or self.found

    @property
    def cost(self) -> float:
        """The least cost so far."""
        return self.found[0].cost

    @property
    def close(self) -> list[Hypothesis]:
        """Return those that are about as good as the best, the nearest to what is as read first.

        IMU and DVL turned together about down are the same vehicle, whatever their costs are.
        """
        costs: dict[object, float] = {}
        vehicles = [_vehicle(one) for one in self.found]
        for vehicle, one in zip(vehicles, self.found, strict=True):
            costs[vehicle] = min(one.cost, costs.get(vehicle, np.inf))
        close = []
        for vehicle, one in zip(vehicles, self.found, strict=True):
            if costs[vehicle] * CLEARLY <= self.cost:
                close.append(one)
        return sorted(close or self.found[:1], key=self._oddity)

    def _oddity(self, one: Hypothesis) -> tuple[bool, ...]:
        """Return how far a hypothesis is from what is as read, the strangest difference first."""
        as_read = self.as_read
        roll_deg, _, heading_deg = one.rpy_deg
        is_opposite = (one.axes == one.force_axes) != (as_read.axes == as_read.force_axes)
        return is_opposite, one.axes != as_read.axes, roll_deg != 0.0, heading_deg != 0.0

    def allows(self, one: Hypothesis) -> bool:
        """Return whether a hypothesis agrees with the axes, the scale and the mounting that are given."""
        imu = self.given.config.imu
        force_axes = imu.specific_force_axes or imu.axes
        if imu.axes is not None and one.axes != axes_text(map_of(imu.axes)):
            return False
        if force_axes is not None and one.force_axes != axes_text(map_of(force_axes)):
            return False
        is_scaled = self.given.has("imu.angular_rate_unit", "imu.angular_rate_scale")
        if is_scaled and one.rate_scale != 1.0:
            return False
        if not self.given.has("dvl.mounting_rpy_deg"):
            return True
        return _turn(one.rpy_deg) == _turn(self.given.config.dvl.mounting_rpy_deg)

    def _tried(self, hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
        allowed = list(filter(self.allows, hypotheses))
        costs = list(
            parallel_map(lambda hypothesis: with_cost(hypothesis, self.dive, self.config), allowed)
        )
        return sorted(costs, key=lambda hypothesis: hypothesis.cost)

    def _distinct(self, most: int) -> list[Hypothesis]:
        """Return the best hypotheses that are not the same dive, turned about down."""
        distinct: list[Hypothesis] = []
        for one in self.found:
            if all(abs(one.cost - other.cost) > 1e-3 * other.cost for other in distinct):
                distinct.append(one)
        return distinct[:most]

    def _signed(self, rate_scale: float) -> Iterator[Hypothesis]:
        """Yield all signs of the axes of the IMU as read, or of the first that is level, with each mounting."""
        level = list(mounted(self.dive, self.as_read, self.mountings))
        first = replace(level[0], rate_scale=rate_scale)
        for rpy_deg in dict.fromkeys(one.rpy_deg for one in level):
            for other in signed_rates(replace(first, rpy_deg=rpy_deg)):
                yield from (other, *signed_forces(other))

    def _accept(self, others: Iterable[Hypothesis]) -> None:
        """Try strange hypotheses, and keep them where they are much better."""
        tried = self._tried(others)
        if tried and tried[0].cost < STRANGE * self.cost:
            self.found = [*tried, *self.found]

    def vary(self) -> None:
        """Try single axes with another sign, and other scales."""
        if self.cost < SETTLED or not np.isfinite(self.cost):
            return
        others: list[Hypothesis] = []
        if self.cost > CONSISTENT:
            for scale in {one.rate_scale for one in self.found}:
                others += self._signed(scale)
        for one in self._distinct(BEST):
            others += scaled(one)
        self._accept(others)
        best = self.found[0]
        self._accept([*signed_rates(best), *signed_forces(best), *scaled(best)])
        if self.found[0].rate_scale not in (1.0, DEG_PER_S):
            self._refine_scale()

    def _refine_scale(self) -> None:
        """Refine the scale of the gyros, where another than that as read was better; then it may show the axes."""
        step = 0.1
        for _ in range(3):
            best = self.found[0]
            factors = np.exp(np.array([-1.5, -0.75, 0.75, 1.5]) * step)
            self._keep(
                replace(best, rate_scale=float(best.rate_scale * factor)) for factor in factors
            )
            step /= 3.0
        scale = self.found[0].rate_scale
        ways = mounted(self.dive, self.as_read, self.mountings)
        self._keep(replace(one, rate_scale=scale) for one in ways)

    def _keep(self, others: Iterable[Hypothesis]) -> None:
        """Try hypotheses, and keep all."""
        found = [*self._tried(others), *self.found]
        self.found = sorted(found, key=lambda hypothesis: hypothesis.cost)


def mounted(
    dive: Dive, as_read: Hypothesis, mountings: Sequence[tuple[float, float, float]] | None = None
) -> Iterator[Hypothesis]:
    """Yield the axes in which a level vehicle feels gravity, with each mounting of a DVL that looks down or up.

    Mountings that are given are the only ones.
    """
    force = np.median(dive.imu.specific_force_b, axis=0)
    if mountings is None:
        looks_known = dive.dvl.look_d is not None
        turns = [turn for turn in possible_axes(dive.dvl) if looks_known or turn[2, 2]]
        mountings = sorted(map(rpy_of, turns), key=lambda rpy_deg: (rpy_deg[0], abs(rpy_deg[2])))
    ways: list[tuple[str, str]] = []
    for sign in (1.0, -1.0):
        ways += [(axes_text(axes), axes_text(sign * axes)) for axes in level_axes(sign * force)]
    if np.linalg.det(map_of(as_read.axes)) < 0.0:  # left-handed, which a reference has shown
        ways.append((as_read.axes, as_read.force_axes))
    # Together with the mountings, one turn about down says the same as another: as read comes first.
    ways.sort(key=lambda way: way != (as_read.axes, as_read.force_axes))
    for axes, force_axes in ways:
        for rpy_deg in mountings:
            yield Hypothesis(axes, force_axes, 1.0, rpy_deg, imu_rpy_deg=as_read.imu_rpy_deg)


def rpy_of(turn: Floats) -> tuple[float, float, float]:
    """Return roll, pitch and heading of a rotation, deg, to the hundredth."""
    roll, pitch, heading = np.round(rpy_from_mat(turn) / DEG, 2).tolist()
    return roll + 0.0, pitch + 0.0, heading + 0.0


def signed_rates(one: Hypothesis) -> Iterator[Hypothesis]:
    """Yield a hypothesis with each sign of the gyros."""
    for signs in product((1.0, -1.0), repeat=3):
        yield replace(one, axes=axes_text(np.diag(signs) @ map_of(one.axes)))


def signed_forces(one: Hypothesis) -> Iterator[Hypothesis]:
    """Yield a hypothesis with other signs of the level accelerometers."""
    for x, y in ((-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)):
        yield replace(one, force_axes=axes_text(np.diag([x, y, 1.0]) @ map_of(one.force_axes)))


def scaled(one: Hypothesis) -> Iterator[Hypothesis]:
    """Yield a hypothesis with other scales of the gyros."""
    yield from (replace(one, rate_scale=one.rate_scale * scale) for scale in SCALES)


def _turn(rpy_deg: Sequence[float]) -> tuple[int, ...]:
    """Return a rotation that can be compared, row by row, in hundredths."""
    return tuple(
        np.rint(100.0 * mat_from_rpy(np.array(rpy_deg) * DEG)).astype(int).ravel().tolist()
    )


def _vehicle(hypothesis: Hypothesis) -> tuple[object, ...]:
    """Return the same for hypotheses that differ by a turn about down."""
    built_in = replace(hypothesis, rate_scale=1.0, cost=np.inf)
    return *_built_in_alike(built_in), hypothesis.rate_scale


# Trials are many, with other scales and costs, of a few ways to be built in.
@lru_cache(maxsize=4096)
def _built_in_alike(hypothesis: Hypothesis) -> tuple[object, ...]:
    """Return the same for ways to be built in that differ by a turn about down."""
    keys = []
    for quarters in range(4):
        one = turned_about_down(hypothesis, quarters)
        keys.append((one.axes, one.force_axes, _turn(one.rpy_deg)))
    return min(keys)


def turned_about_down(hypothesis: Hypothesis, quarters: int) -> Hypothesis:
    """Turn IMU and DVL together, so that the cost stays: by quarters of a circle towards starboard."""
    turn = np.rint(mat_from_rpy(np.array([0.0, 0.0, 90.0 * quarters]) * DEG))
    if any(hypothesis.imu_rpy_deg):
        return hypothesis.with_body_turned(turn)
    return replace(
        hypothesis,
        axes=axes_text(turn @ map_of(hypothesis.axes)),
        force_axes=axes_text(turn @ map_of(hypothesis.force_axes)),
        rpy_deg=rpy_of(turn @ mat_from_rpy(np.array(hypothesis.rpy_deg) * DEG)),
    )


def as_reference_moves(close: Sequence[Hypothesis], dive: Dive, config: Config) -> Hypothesis:
    """Return the first hypothesis whose DVL and gyros follow the reference, turned about down until they do.

    The dive has its readings in the axes of the instruments.
    """
    if dive.reference is None:
        return close[0]
    turned = []
    follows = []
    for one in close[:MOST_COMPARED]:
        dvl = msgspec.structs.replace(config.dvl, mounting_rpy_deg=one.rpy_deg)
        quarters = _quarters_to_reference(dive, msgspec.structs.replace(config, dvl=dvl))
        turned.append(turned_about_down(one, quarters) if quarters % 4 else one)
        found = gyro_by_attitude(turned[-1].applied(dive.imu), dive.reference)
        follows.append(0.0 if found is None else found.correlation)
    return turned[int(np.argmax(np.array(follows) > max(follows) - RATE_CLEARLY))]


def _quarters_to_reference(dive: Dive, config: Config) -> int:
    """Return by how many quarters the body has to turn for the DVL to measure as the reference moves; 0 if unknown."""
    if dive.reference is None:
        return 0
    measured, true = map(horizontal, velocity_pairs(dive.dvl, dive.reference, config))
    if len(true) < ENOUGH:
        return 0
    moving = np.abs(true) >= max(float(np.median(np.abs(true))), LEAST_MPS)
    found = fit(measured[moving], true[moving])
    if found.coherence < COHERENT:
        return 0
    return -round(found.turn / (90.0 * DEG))


def rates_compared(imu: ImuColumns, other: ImuColumns) -> tuple[float, float]:
    """Return how much larger the rates of another IMU are, and their correlation, whatever its axes are."""
    at_s = seconds(imu.time_ns, imu.time_ns[0])
    other_s = seconds(other.time_ns, imu.time_ns[0])
    inside = (at_s >= other_s[0]) & (at_s <= other_s[-1])
    ours = imu.angular_rate_b[inside]
    theirs = np.column_stack(
        [np.interp(at_s[inside], other_s, column) for column in other.angular_rate_b.T]
    )
    ours = ours - ours.mean(axis=0)
    theirs = theirs - theirs.mean(axis=0)
    turn, *_ = np.linalg.lstsq(ours, theirs, rcond=None)
    explained = float(np.sum((ours @ turn) ** 2) / max(np.sum(theirs**2), 1e-30))
    main = np.linalg.svd(turn, compute_uv=False)
    return float(np.median(main)), float(np.sqrt(explained))
