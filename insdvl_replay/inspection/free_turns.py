"""Mountings that are no quarter turns: the DVL's in the IMU by their motion, the IMU's in the body by gravity and
reference.

The trials know quarter turns only. The free fit judges these, and replaces them where another rotation is better on
windows that it was not fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.fit import AXES
from insdvl_replay.calibration.free_mounting import (
    CLEARLY,
    LEAST_BETTER,
    NEAR_QUARTER_RAD,
    FreeMounting,
    LevelDvl,
    angle_between,
    down_of,
    free_mounting,
    velocities_of,
)
from insdvl_replay.checks.dvl import velocities_b, velocity_pairs
from insdvl_replay.checks.imu import turn_to_reference
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import horizontal
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector
from insdvl_replay.inspection.trials import (
    Hypothesis,
    Trials,
    rpy_of,
    turned_about_down,
    with_cost,
)

APART_RAD: Final = 10.0 * DEG  # alternatives that are nearer are one answer
MOST_OTHERS: Final = 3  # relations of axes and scale that are fitted beside the best
# ratio of costs that the delay and the coarse noise of trials make, whatever is true
NO_WORSE: Final = 1.1
# from which gravity shows an IMU that is built in obliquely; trim of a vehicle is less
TILTED_RAD: Final = 10.0 * DEG
TURNED_RAD: Final = 3.0 * DEG  # from which the reference's attitude shows it
LEAST_SHARE: Final = 0.8  # of the mean velocity in the mean speed, of a vehicle that goes one way
SIDEWAYS_RAD: Final = 60.0 * DEG  # no vehicle goes so far from forward
_DOWN: Final = np.array([0.0, 0.0, 1.0])
_TURNS_TRIED_DEG: Final = (-45.0, -22.5, 22.5, 45.0)  # about down, which a dive must exclude


@dataclass(frozen=True)
class FreeTurn:
    """The free fit of a DVL, in the axes of one hypothesis of the IMU and of all that are this IMU turned."""

    first: Hypothesis
    level: LevelDvl

    @property
    def fit(self) -> FreeMounting:
        """The fit, without what is known of level vehicles."""
        return self.level.fit

    def turn_to(self, other: Hypothesis) -> Floats:
        """Return the rotation from the body of the first to that of another one, (3, 3)."""
        return np.asarray(other.gyro_turn @ self.first.gyro_turn.T)

    @cached_property
    def mat(self) -> Floats:
        """The likeliest rotation, (3, 3), or the quarter turn next to it."""
        mat = self.level.likeliest
        quarter = min(AXES, key=lambda quarter: angle_between(quarter, mat))
        if angle_between(quarter, mat) < NEAR_QUARTER_RAD:
            return quarter
        return mat

    def excludes(self, best: Hypothesis) -> bool:
        """Return whether the fit is better than a hypothesis, also on windows to which it was not fitted."""
        mat = self.turn_to(best).T @ mat_from_rpy(np.array(best.rpy_deg) * DEG)
        if angle_between(mat, self.mat) < NEAR_QUARTER_RAD:
            return False
        return (
            self.level.excludes(mat, self.mat)
            and self.fit.held_out_misfit(self.mat, mat) > LEAST_BETTER
        )

    def alternatives(self, best: Hypothesis) -> list[tuple[float, float, float]]:
        """Return mountings in the body of a hypothesis that fit about as well as its own, far from each other."""
        if best.relation != self.first.relation:
            return []
        turn = self.turn_to(best)
        mat = turn.T @ mat_from_rpy(np.array(best.rpy_deg) * DEG)
        turns = [
            mat_from_vector(angle_deg * DEG * self.level.down_b) for angle_deg in _TURNS_TRIED_DEG
        ]
        others = [*self.level.minima, *AXES, *(about_down @ mat for about_down in turns)]
        likely = [other for other in others if self.level.is_possible(other)]
        likely = [other for other in likely if not self.level.excludes(other, mat)]
        apart = [mat]
        for other in sorted(likely, key=self.fit.misfit):
            if all(angle_between(other, known) > APART_RAD for known in apart):
                apart.append(other)
        return [rpy_of(turn @ other) for other in apart[1:]]


def turn_freely(trials: Trials, pings: DvlColumns) -> FreeTurn | None:
    """Fit the DVL's mounting freely; the trials get the result where it excludes the best quarter turn.

    None where the dive is too short, or the mounting is given.
    """
    if not np.isfinite(trials.cost) or trials.given.has("dvl.mounting_rpy_deg"):
        return None
    best = trials.found[0]
    own = _free_turn(trials, best.relation, pings)
    if own is not None and not own.excludes(best):
        return own
    fits = [] if own is None else [own]
    for relation in _other_relations(trials, best)[:MOST_OTHERS]:
        other = _free_turn(trials, relation, pings)
        if other is not None:
            fits.append(other)
    if not fits:
        return None
    free = _likeliest(fits, trials.as_read)
    turned = with_cost(replace(free.first, rpy_deg=rpy_of(free.mat)), trials.dive, trials.config)
    most = trials.cost
    if free is own:
        # What excludes a quarter turn of the same IMU on windows of its own needs no trial that is better, too.
        most *= NO_WORSE
    if turned.cost < most:
        trials.found = [turned]
    return free


def _other_relations(trials: Trials, best: Hypothesis) -> list[object]:
    """Return other relations of axes and scale than that of the best, the likelier first."""
    relations = dict.fromkeys(one.relation for one in trials.found)
    return [relation for relation in relations if relation != best.relation]


def _likeliest(fits: Sequence[FreeTurn], as_read: Hypothesis) -> FreeTurn:
    """Return the fit that is as read if it is about as good as the best, else the first that is."""
    least = min(free.fit.cost for free in fits)
    similar = [free for free in fits if free.fit.cost < CLEARLY * least]
    for free in similar:
        if free.first.relation == as_read.relation:
            return free
    return similar[0]


def _free_turn(trials: Trials, relation: object, pings: DvlColumns) -> FreeTurn | None:
    """Fit the DVL in the axes of the first hypothesis with such a relation, the nearest to what is as read."""
    first = _first_with(relation, trials.order)
    if first is None:
        return None
    imu = first.applied(trials.dive.imu)
    dvl = pings.within(int(imu.time_ns[0]), int(imu.time_ns[-1]))
    fit = free_mounting(imu, *velocities_of(dvl), AXES)
    if fit is None:
        return None
    return FreeTurn(first, LevelDvl(fit, down_of(imu), dvl.look_d))


def _first_with(relation: object, hypotheses: Sequence[Hypothesis]) -> Hypothesis | None:
    for one in hypotheses:
        if one.relation == relation:
            return one
    return None


# --- The IMU in the body.


def in_body(
    best: Hypothesis,
    dive: Dive,
    config: Config,
    *,
    is_as_read: bool,
) -> tuple[Hypothesis, Hypothesis | None]:
    """Return a hypothesis in the axes of the vehicle: those of the reference's attitude, else level and forward.

    Where the axes are as read, but the vehicle travels sideways in them, the other axes are returned, too: only a
    person knows which of both is forward. IMU and DVL turn together, so that they fit each other as before. The dive
    has its readings in the axes of the instruments, and the settings are those with which it was read.
    """
    own = msgspec.structs.replace(config.dvl, mounting_rpy_deg=best.rpy_deg)
    config = msgspec.structs.replace(config, dvl=own)
    imu = best.applied(dive.imu)
    if dive.reference is not None:
        turn = turn_to_reference(
            imu, dive.reference, velocity_pairs(dive.dvl, dive.reference, config)
        )
        if turn is not None:
            in_reference = (
                best
                if angle_between(turn, np.eye(3)) < TURNED_RAD
                else best.with_body_turned(turn)
            )
            return in_reference, None
    level = _turn_of_axis(down_of(imu), _DOWN)
    if angle_between(level, np.eye(3)) > TILTED_RAD:
        best = best.with_body_turned(level)
    quarters = _quarters_to_travel(best, dive, config)
    if not quarters:
        return best, None
    travelling = turned_about_down(best, quarters)
    if not is_as_read:
        return travelling, None
    # Two instruments whose axes agree about forward are believed against the travel: the vehicle may sway.
    agree = angle_between(mat_from_rpy(np.array(best.rpy_deg) * DEG), np.eye(3)) < NEAR_QUARTER_RAD
    if agree:
        return (best, travelling)
    return (travelling, best)


def _turn_of_axis(axis: Floats, target: Floats) -> Floats:
    """Return the smallest rotation that brings a unit vector to another one, (3, 3)."""
    across = np.cross(axis, target)
    sine = float(np.linalg.norm(across))
    cosine = float(axis @ target)
    if sine < 1e-9:
        if cosine > 0.0:
            return np.eye(3)
        return np.diag([1.0, -1.0, -1.0])
    return np.asarray(mat_from_vector(across / sine * np.arctan2(sine, cosine)))


def _quarters_to_travel(best: Hypothesis, dive: Dive, config: Config) -> int:
    """Return by how many quarters the body turns until it goes forward; 0 where it does not go one way."""
    own = msgspec.structs.replace(config.dvl, mounting_rpy_deg=best.rpy_deg)
    _, velocity_b = velocities_b(dive.dvl, msgspec.structs.replace(config, dvl=own))
    ahead = horizontal(velocity_b)
    mean = complex(np.mean(ahead))
    angle = float(np.angle(mean))
    if abs(mean) < LEAST_SHARE * float(np.mean(np.abs(ahead))) or abs(angle) < SIDEWAYS_RAD:
        return 0
    return -round(angle / (90.0 * DEG))
