"""What can be wrong in a user's class ends in a sentence, and what compiled code goes on with is let pass."""

import itertools
import math
import re
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from own_sensors import Deep, Speed, WrongSign

from insdvl_replay.core.config import Config, Evaluation, Filter, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, SolutionColumns
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.nav.user_measurement import (
    UserMeasurement,
    UserReadings,
    checked_readings,
    load_plugin,
)
from insdvl_replay.preparation.prepared import Prepared, prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

HERE = __name__


@pytest.fixture(scope="module")
def dive() -> Dive:
    sensors = {"depth": SensorErrors(0.05, 4.0)}
    return simulate_dive(
        "lawnmower", seed=4, duration_s=20.0, grade="mems", imu_rate_hz=50.0, sensors=sensors
    )


def aided(word: str, **changes: Any) -> Config:
    mems = load_config("mems")
    mine = Filter(**({"aiding": ("velocity", f"{HERE}:{word}")} | changes))
    filters = {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    return Config(
        noise=mems.noise, initial=mems.initial, filters=filters, evaluation=Evaluation(starts=1)
    )


def notes_of(prepared: Prepared, code: str = "user_measurement_jacobian") -> list[str]:
    return [note.text for note in prepared.notes if note.code == code]


# --- Where arithmetic fails.


class OutsideAtTheStart(Speed):
    """No number at the start, as a direction at rest."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Take a root of what is negative."""
        z[0] = math.sqrt(-1.0 - ins[3] ** 2)
        H[0, 0] = 1.0


class Infinite(Speed):
    """A number divided by zero, which compiled code makes an infinite one."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Divide by zero."""
        z[0], H[0, 0] = 1.0 / (0.0 * ins[3]), 1.0


class OutsideBesideTheStart(Deep):
    """At the edge of where it is a number, since it is tried with a vehicle that does not turn."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Take the root of what is 0 at the start; and say of the height what is wrong."""
        z[0] = -ins[2] + 1e-9 * math.sqrt(ins[18])
        H[0, 14] = -1.0


TRIED = 25
"""Calls that hold H against differences where a filter starts."""


class ByZero(Speed):
    """A class of which arithmetic fails on the way."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Divide by zero at the seventh reading."""
        Speed.predict(ins, z, H)
        z[0] *= 1 / int(next(CALLS["ByZero"]) != TRIED + 7)


class Elsewhere(Speed):
    """A class with a mistake that shows up on the way."""

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Ask at the seventh reading for what is not there."""
        Speed.predict(ins, z, H)
        z[0] *= [1.0][next(CALLS["Elsewhere"]) == TRIED + 7]


CALLS = {"ByZero": itertools.count(), "Elsewhere": itertools.count()}
"""How often they were called: no compiler knows that."""


@pytest.mark.nightly
@pytest.mark.parametrize("word", ["OutsideAtTheStart", "Infinite"])
def test_a_prediction_that_has_no_number_at_the_start_is_let_pass(dive: Dive, word: str) -> None:
    """Compiled code goes on, with readings that are not used, also where no gate refuses them."""
    replay = replay_dive(dive, aided(word))
    assert np.isfinite(replay.histories[1].velocity_n).all()
    (text,) = [note.text for note in replay.notes if note.code.endswith("_not_finite")]
    assert re.fullmatch(r"filter mine .*\b100 of 100 speed .*\b1 .*", text)
    met = next(one for one in replay.histories[1].innovations if one.measurement == "speed")
    assert np.isnan(met.nis).all()
    assert not met.used.any()


def test_a_jacobian_is_held_against_the_differences_that_are_numbers(dive: Dive) -> None:
    prepared = prepare_dive(dive, aided("OutsideBesideTheStart", states=("position",)))
    (text,) = notes_of(prepared)
    assert re.search(r"H\[0, 14\] .*-1,.* 1$", text)


def test_what_runs_as_it_is_goes_on_where_its_arithmetic_fails(dive: Dive) -> None:
    replay = replay_dive(dive, aided("ByZero"))
    met = next(one for one in replay.histories[1].innovations if one.measurement == "speed")
    assert np.flatnonzero(~met.used).tolist() == [7]
    (row,) = (row for row in replay.tables.consistency if row.measurement == "speed")
    assert (row.used, row.mean_nis) == (99, pytest.approx(np.nanmean(met.nis)))
    assert row.verdict != "not finite"


def test_what_runs_as_it_is_and_raises_on_the_way_is_reported_with_its_line(dive: Dive) -> None:
    with pytest.raises(ConfigError, match=r"Elsewhere: predict\(ins, z, H\) .*\d+ .*: IndexError"):
        replay_dive(dive, aided("Elsewhere"))


# --- What warnings say.


class Deeper(WrongSign):
    """Right only where the height is not among the states."""

    name = "deeper"

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write -h, and of its change what fits in."""
        z[0] = -ins[2]
        if H.shape[1] > 14:
            H[0, 14] = 1.0


class HalfWritten(Deep):
    """Two numbers a reading, of which one is predicted."""

    def readings(self, dive: Dive) -> UserReadings:
        """Say the depth twice."""
        found = super().readings(dive)
        return UserReadings(found.time_ns, np.repeat(found.values, 2, axis=1), found.sd)


def test_warnings_of_all_filters_that_a_class_aids_are_reported(dive: Dive) -> None:
    """Whichever of them stands last."""
    config = aided("Deeper")
    mine = config.filters["mine"]
    placed = msgspec.structs.replace(mine, states=("position",))
    for filters in ({"mine": mine, "placed": placed}, {"placed": placed, "mine": mine}):
        prepared = prepare_dive(dive, msgspec.structs.replace(config, filters=filters))
        (text,) = notes_of(prepared)
        assert re.match(rf"{HERE}:Deeper .*\bH .*filters\.mine\b", text)


def test_a_component_that_is_not_predicted_is_reported(dive: Dive) -> None:
    prepared = prepare_dive(dive, aided("HalfWritten", states=("position",)))
    (text,) = notes_of(prepared)
    assert re.match(rf"{HERE}:HalfWritten .*z\[1\] .*H\[1\] .*filters\.mine\b", text)


# --- What readings are made of.


class OfSolution(Speed):
    """The speed that the vehicle says of itself."""

    def readings(self, dive: Dive) -> UserReadings:
        """Take that of the solution."""
        motion = dive.solutions["onboard"].motion
        return UserReadings(
            motion.time_ns, np.linalg.norm(motion.velocity_n, axis=1)[:, None], np.array([0.1])
        )


def test_readings_may_be_made_of_a_solution_of_the_dive(dive: Dive) -> None:
    assert dive.reference is not None
    onboard = SolutionColumns(dive.reference, None, np.empty(0, np.int64), np.empty((0, 9, 9)))
    config = aided("OfSolution")
    filters = {**config.filters, "onboard": Filter(solution=Solution(topic="/odometry"))}
    config = msgspec.structs.replace(config, filters=filters)
    replay = replay_dive(replace(dive, solutions={"onboard": onboard}), config)
    assert [history.filter for history in replay.histories] == ["baseline", "mine", "onboard"]
    assert not replay.dive.solutions


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"time_ns": None}, r"times .*\(\) .*\(3, 1\), .*\(k,\) .*\(k, s\)"),
        ({"time_ns": np.arange(3.0)}, "times .*int64"),
        ({"time_ns": np.array([1, 1, 2])}, "times .*int64"),
        ({"time_ns": np.array([2, 1, 3])}, "times .*int64"),
        ({"values": np.ones((3, 5))}, r"values .*\(3,\) .*\(3, 5\)"),
        ({"values": [["a"], ["b"], ["c"]]}, "values .*: could not convert"),
        ({"values": {"speed": 1.0}}, r"values .*: float\(\)"),
        ({"values": [[1.0], [2.0, 3.0], [4.0]]}, "values .*: setting an array"),
        ({"sd": None}, "sd .*\\b3 of 3 "),
        ({"sd": [-0.1]}, "sd .*\\b3 of 3 "),
        ({"sd": [math.nan]}, "sd .*\\b3 of 3 "),
        ({"sd": [math.inf]}, "sd .*finite"),
        ({"sd": "small"}, "sd .*: could not convert"),
        ({"sd": {0.1}}, r"sd .*: float\(\)"),
        ({"sd": [0.1, 0.1]}, r"sd .*\(2,\) .*\(3, 1\), .*\(s,\) .*\(k, s\)"),
    ],
)
def test_readings_that_are_none_are_reported(given: dict[str, Any], reason: str) -> None:
    readings = UserReadings(
        **({"time_ns": np.arange(3), "values": np.ones((3, 1)), "sd": np.array([0.1])} | given)
    )
    with pytest.raises(ValueError, match=reason):
        checked_readings(readings)


# --- Names.


class Nameless(Speed):
    """No name."""

    name = None  # type: ignore[assignment]


class Unitless(Speed):
    """A number for a unit."""

    unit = 3  # type: ignore[assignment]


class FifthBeam(Speed):
    """The name that the fifth beam of a DVL has."""

    name = "beam_5"


class Beams(Speed):
    """A word for what filters are aided by."""

    name = "beams"


class Withheld(Speed):
    """The name that a sensor has which is withheld."""

    name = "held_out_speed"


@pytest.mark.parametrize(
    ("word", "named"),
    [
        ("Nameless", "name None"),
        ("Unitless", "unit 3"),
        ("FifthBeam", "name 'beam_5'"),
        ("Beams", "name 'beams'"),
        ("Withheld", "name 'held_out_speed'"),
    ],
)
def test_names_that_cannot_be_are_reported(word: str, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        load_plugin(f"{HERE}:{word}", UserMeasurement)
