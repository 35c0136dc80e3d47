"""User code is given no data that is held back from the filters: no pings of an outage, and no held-out sensor."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Topic
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    SensorColumns,
    SolutionColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.dive_record import Channel
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.evaluation.answers import NO_EFFECT
from insdvl_replay.logs.write import write_dive
from insdvl_replay.nav.measurements import USER, Measurement, sensor_measurement
from insdvl_replay.nav.user_measurement import UserMeasurement, UserReadings
from insdvl_replay.preparation.plugins import given_dive, in_outages
from insdvl_replay.preparation.prepared import prepare_dive, read_checked_dive
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

HERE = __name__
SD_MPS = 0.1
ARM_X, ARM_Y, ARM_Z = 0.8, -0.3, 0.4
"""IMU to DVL, m."""


def velocities(dive: Dive) -> Floats:
    """Solve the beams of the pings by least squares, shape (m, 3)."""
    assert dive.dvl.beam_vectors_d is not None
    assert dive.dvl.beam_velocity_mps is not None
    solved: Floats = dive.dvl.beam_velocity_mps @ np.linalg.pinv(dive.dvl.beam_vectors_d).T
    return solved


class Copy(UserMeasurement):
    """The DVL's velocities as they are, with the prediction and the noise that the tool has for them."""

    name, unit = "copy", "m/s"
    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Take them from the pings."""
        next(type(self).dives)
        return UserReadings(dive.dvl.time_ns, velocities(dive), np.full(3, SD_MPS))

    @staticmethod
    def predict(ins: Floats, z: Floats, H: Floats) -> None:
        """Write C' v + w x l, and [C' | C' [v x] | 0 | -[l x]]."""
        for i in range(3):
            north, east, down = ins[6 + i], ins[9 + i], ins[12 + i]
            z[i] = north * ins[3] + east * ins[4] + down * ins[5]
            H[i, 0], H[i, 1], H[i, 2] = north, east, down
            H[i, 3] = east * ins[5] - down * ins[4]
            H[i, 4] = down * ins[3] - north * ins[5]
            H[i, 5] = north * ins[4] - east * ins[3]
        z[0] += ins[19] * ARM_Z - ins[20] * ARM_Y
        z[1] += ins[20] * ARM_X - ins[18] * ARM_Z
        z[2] += ins[18] * ARM_Y - ins[19] * ARM_X
        H[0, 10], H[0, 11] = ARM_Z, -ARM_Y
        H[1, 9], H[1, 11] = -ARM_Z, ARM_X
        H[2, 9], H[2, 10] = ARM_Y, -ARM_X


# --- The DVL's own velocities.


def copied(
    duration_s: float, scenario: str = "lawnmower", seed: int = 4, starts: int = 1
) -> Replay:
    arm_m = (ARM_X, ARM_Y, ARM_Z)
    dive = simulate_dive(
        scenario,
        seed=seed,
        duration_s=duration_s,
        grade="mems",
        imu_rate_hz=25.0,
        dvl_rate_hz=2.0,
        lever_arm_m=arm_m,
    )
    mems = load_config("mems")
    filters = {"baseline": Filter(aiding=("velocity",)), "copy": Filter(aiding=(f"{HERE}:Copy",))}
    return replay_dive(
        dive,
        Config(
            noise=mems.noise, initial=mems.initial, filters=filters, evaluation=Evaluation(starts=starts),
            dvl=Dvl(lever_arm_m=arm_m, velocity_sd_mps=SD_MPS),
        ),
    )  # fmt: skip


def assert_drifts_as_the_baseline(replay: Replay, lengths: int) -> None:
    baseline, copy = replay.histories
    np.testing.assert_allclose(copy.velocity_n, baseline.velocity_n, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(copy.sd, baseline.sd, rtol=1e-9)
    rows = [row for row in replay.tables.outage if row.filter == "copy"]
    assert len(rows) == lengths
    for row in rows:
        assert row.drift_median_m > 1.0
        assert row.ratio_to_baseline == pytest.approx(1.0, rel=1e-9)


def test_the_velocities_of_the_dvl_drift_in_an_outage_as_if_the_tool_had_used_them() -> None:
    assert_drifts_as_the_baseline(copied(190.0), lengths=1)


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ["lawnmower", "figure-eight"])
@pytest.mark.parametrize("seed", [901, 902, 903])
def test_the_velocities_of_the_dvl_have_no_effect(scenario: str, seed: int) -> None:
    replay = copied(600.0, scenario, seed, starts=16)
    assert_drifts_as_the_baseline(replay, lengths=3)
    acts = [row.acts for row in replay.tables.evidence if row.acts is not None]
    assert acts
    assert max(acts) < NO_EFFECT


# --- Readings in outages.

OUTAGES_S = (
    (4.0, 6.0),
    (6.0, 7.5),
    (9.0, 10.0),
    (13.0, 14.0),
    (17.0, 18.0),
    (21.0, 22.0),
    (25.0, 27.0),
)
"""The second is too near to the first, so that it is in a group of its own."""


def outages_of(dive: Dive) -> tuple[tuple[int, int], ...]:
    begin_ns = int(dive.imu.time_ns[0])
    return tuple(
        (begin_ns + int(a * NS_PER_S), begin_ns + int(b * NS_PER_S)) for a, b in OUTAGES_S
    )


@pytest.fixture(scope="module")
def dive() -> Dive:
    sensors = {
        "depth": SensorErrors(0.05, 4.0),
        "heading": SensorErrors(1.0, 4.0),
        "position": SensorErrors(1.0, 1.0),
    }
    return simulate_dive(
        "lawnmower", seed=4, duration_s=30.0, imu_rate_hz=20.0, dvl_rate_hz=5.0, sensors=sensors
    )


class Held(Copy):
    """What was measured last, every 100 ms: data from before an outage, in it."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Look back."""
        next(type(self).dives)
        time_ns = np.arange(dive.dvl.time_ns[0], dive.imu.time_ns[-1], NS_PER_S // 10)
        row = np.searchsorted(dive.dvl.time_ns, time_ns, side="right") - 1
        return UserReadings(time_ns, velocities(dive)[row], np.full(3, SD_MPS))


class Smoothed(Held):
    """The mean of the last few."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Look back a bit further, and be the less sure the older that is."""
        held = super().readings(dive)
        mean = np.stack(
            [
                held.values[max(0, row - 8) : row + 1].mean(axis=0)
                for row in range(len(held.values))
            ]
        )
        last_ns = dive.dvl.time_ns[
            np.searchsorted(dive.dvl.time_ns, held.time_ns, side="right") - 1
        ]
        return UserReadings(
            held.time_ns, mean, SD_MPS + 0.1 * seconds(held.time_ns, last_ns)[:, None] * np.ones(3)
        )


class Interpolated(Copy):
    """On the line from the last velocity before an outage to the first one after it."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Look ahead."""
        next(type(self).dives)
        time_ns = np.arange(dive.dvl.time_ns[0], dive.imu.time_ns[-1], NS_PER_S // 10)
        at_s, ping_s = (
            seconds(times, dive.dvl.time_ns[0]) for times in (time_ns, dive.dvl.time_ns)
        )
        columns = [np.interp(at_s, ping_s, column) for column in velocities(dive).T]
        return UserReadings(time_ns, np.column_stack(columns), np.full(3, SD_MPS))


class Bridged(Interpolated):
    """On the line across short pauses alone."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Look ahead, but not far."""
        found = super().readings(dive)
        after = np.searchsorted(dive.dvl.time_ns, found.time_ns).clip(1, len(dive.dvl.time_ns) - 1)
        near = dive.dvl.time_ns[after] - dive.dvl.time_ns[after - 1] < 1.5 * NS_PER_S
        near &= found.time_ns <= dive.dvl.time_ns[-1]
        return UserReadings(found.time_ns[near], found.values[near], found.sd)


class Remembering(Copy):
    """The mean of all so far."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Look back to the start."""
        next(type(self).dives)
        values = velocities(dive)
        mean = np.cumsum(values, axis=0) / np.arange(1, len(values) + 1)[:, None]
        time_ns = np.arange(dive.dvl.time_ns[0], dive.imu.time_ns[-1], NS_PER_S // 10)
        row = np.searchsorted(dive.dvl.time_ns, time_ns, side="right") - 1
        return UserReadings(time_ns, mean[row], np.full(3, SD_MPS))


class Caching(Held):
    """Readings that an object makes once."""

    dives = count()

    def readings(self, dive: Dive) -> UserReadings:
        """Make them the first time."""
        if not hasattr(self, "made"):
            self.made = super().readings(dive)
        return self.made


def measured_in_outages(
    word: str, dive: Dive, config: Config
) -> Iterator[tuple[tuple[int, int], Measurement]]:
    """Yield each outage with the readings of all of its group."""
    whole = sensor_measurement(
        "copy", "m/s", USER + 3, np.zeros(1, np.int64), np.zeros((1, 3)), np.ones(3), axes="xyz"
    )  # type: ignore[arg-type]
    whole = replace(whole, sensor=7, holds_height=True)
    for outages, sensors, _ in in_outages(dive, config, {word: whole}, {}, outages_of(dive)):
        found = sensors[word]
        assert (found.kind, found.sensor, found.holds_height) == (USER + 3, 7, True)
        yield from ((outage, found) for outage in outages)


def ended(dive: Dive, before_ns: int, end_ns: int) -> Dive:
    """A dive that ends with an outage of the DVL, by hand."""
    pings, samples = dive.dvl.time_ns <= before_ns, dive.imu.time_ns <= end_ns
    assert dive.dvl.beam_velocity_mps is not None
    imu = replace(dive.imu, time_ns=dive.imu.time_ns[samples])
    dvl = replace(
        dive.dvl,
        time_ns=dive.dvl.time_ns[pings],
        beam_velocity_mps=dive.dvl.beam_velocity_mps[pings],
    )
    return replace(dive, imu=imu, dvl=dvl)


@pytest.mark.parametrize(
    ("user_code", "calls"),
    [
        (Copy, 5),
        (Held, 5),
        (Smoothed, 5),
        (Caching, 5),
        (Interpolated, 8),
        (Bridged, 8),
        (Remembering, 8),
    ],
)
def test_readings_in_an_outage_are_those_of_a_dive_that_ends_with_it(
    dive: Dive, monkeypatch: pytest.MonkeyPatch, user_code: type[Copy], calls: int
) -> None:
    """Seven outages take a call for the one alone, and four for the six in one group, if the code allows."""
    monkeypatch.setattr("insdvl_replay.preparation.plugins.APART_NS", 2 * NS_PER_S)
    monkeypatch.setattr(user_code, "dives", count())
    found = dict(measured_in_outages(f"{HERE}:{user_code.__name__}", dive, Config()))
    assert next(user_code.dives) == calls
    assert set(found) == set(outages_of(dive))
    for (before_ns, end_ns), measurement in found.items():
        expected = user_code().readings(ended(dive, before_ns, end_ns))
        inside = (expected.time_ns > before_ns) & (expected.time_ns <= end_ns)
        rows = (measurement.valid_ns > before_ns) & (measurement.valid_ns <= end_ns)
        assert inside.any() == (user_code not in (Copy, Bridged))
        np.testing.assert_array_equal(measurement.valid_ns[rows], expected.time_ns[inside])
        np.testing.assert_allclose(
            measurement.values[rows], expected.values[inside], rtol=0.0, atol=1e-12
        )
        sd = np.broadcast_to(expected.sd, expected.values.shape)[inside]
        np.testing.assert_allclose(
            np.sqrt(np.diagonal(measurement.cov[rows], axis1=1, axis2=2)), sd, rtol=1e-12
        )


class Beside(Copy):
    """A class that needs the onboard solution."""

    def readings(self, dive: Dive) -> UserReadings:
        """Take the readings of the pings, where there is the solution."""
        assert len(dive.solutions["mine"].motion.time_ns)
        return super().readings(dive)


def test_a_recorded_solution_is_there_in_outages_too() -> None:
    dive = simulate_dive("lawnmower", seed=4, duration_s=170.0, imu_rate_hz=20.0, dvl_rate_hz=2.0)
    assert dive.reference is not None
    solution = SolutionColumns(
        dive.reference, None, dive.reference.time_ns[:0], np.empty((0, 9, 9))
    )
    filters = {
        "baseline": Filter(aiding=("velocity",)),
        "beside": Filter(aiding=(f"{HERE}:Beside",)),
        "mine": Filter(solution="/mine"),
    }
    config = Config(filters=filters, evaluation=Evaluation(starts=1))
    replay = replay_dive(replace(dive, solutions={"mine": solution}), config)
    assert "beside" in {row.filter for row in replay.tables.outage}


class Failing(Copy):
    """A class that cannot do without pings."""

    def readings(self, dive: Dive) -> UserReadings:
        """Ask for one in every second."""
        if np.diff(dive.dvl.time_ns, append=dive.imu.time_ns[-1]).max() > 0.9 * NS_PER_S:
            raise ValueError("too long a pause")
        return super().readings(dive)


class Narrow(Copy):
    """A class whose readings have another shape in an outage."""

    def readings(self, dive: Dive) -> UserReadings:
        """Give the first component."""
        found = super().readings(dive)
        return UserReadings(found.time_ns, found.values[:, :1], found.sd[:1])


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("Failing", r"outage.*Failing: readings\(self, dive\) .*too long a pause"),
        ("Narrow", r"outage.*Narrow .*\b1 .*\b3 "),
    ],
)
def test_what_goes_wrong_in_an_outage_is_reported_as_such(
    dive: Dive, word: str, reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        dict(measured_in_outages(f"{HERE}:{word}", dive, Config()))


# --- What user code is given.


RAW = {
    "pings": ("/dvl", "speed_gnd"),
    "samples": ("/imu", "linear_acceleration.x"),
    "gauge": ("/pressure", "fluid_pressure"),
}
"""Topics that the replay itself reads, and a field of each."""


def columns_like(time_ns: TimeNs) -> SensorColumns:
    return SensorColumns(time_ns, np.zeros((len(time_ns), 1)))


def with_topics(dive: Dive) -> tuple[Dive, dict[str, Topic]]:
    """Add an onboard solution, and topics of all roles."""
    assert dive.reference is not None
    time_ns = dive.reference.time_ns
    solution = SolutionColumns(
        dive.reference,
        np.zeros((len(time_ns), 3)),
        time_ns[::5],
        np.zeros((len(time_ns[::5]), 9, 9)),
    )
    declared = {
        sensor: Topic(topic=f"/raw/{sensor}", values="x", sensor=sensor)
        for sensor in ("dvl", "depth")
    }
    by_role = {
        role.partition(".")[0]: Topic(topic=f"/{role}", values="x")
        for role in ("reference", "filters.mine.solution")
    }
    topics = {
        **declared,
        **by_role,
        "ping": Topic(topic="/dvl", values="x"),
        "free": Topic(topic="/usbl", values="x"),
    }
    roles = {
        "/dvl": "dvl",
        "/reference": "reference",
        "/filters.mine.solution": "filters.mine.solution",
    }
    channels = tuple(Channel(topic, "", "cdr", role, 1) for topic, role in roles.items())
    columns = {name: columns_like(time_ns) for name in topics}
    return replace(dive, solutions={"mine": solution}, topics=columns, channels=channels), topics


def test_in_an_outage_nothing_is_given_that_the_dvl_had_a_part_in(dive: Dive) -> None:
    dive, topics = with_topics(dive)
    outages = outages_of(dive)[:1]
    ((before_ns, end_ns),) = outages
    given = given_dive(dive, Config(topics=topics), outages, end_ns)
    assert given.reference is not None
    solution = given.solutions["mine"]
    assert solution.moved_n is not None
    assert len(solution.moved_n) == len(solution.motion.time_ns)
    assert len(solution.cov) == len(solution.cov_ns)
    of_dvl = [given.dvl.time_ns, given.reference.time_ns, solution.motion.time_ns, solution.cov_ns]
    of_dvl += [given.topics[name].time_ns for name in ("dvl", "ping", "reference", "filters")]
    others = [given.imu.time_ns, *(one.time_ns for one in given.sensors.values())]
    others += [given.topics[name].time_ns for name in ("free", "depth")]
    for time_ns in of_dvl:
        assert before_ns - NS_PER_S < time_ns[-1] <= before_ns
    for time_ns in others:
        assert end_ns - 2 * NS_PER_S < time_ns[-1] <= end_ns
        assert time_ns[-1] > before_ns


def test_the_topic_of_the_dvl_in_a_log_counts_as_its_pings(dive: Dive, tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", dive)
    topics = {name: Topic(topic=topic, values=field) for name, (topic, field) in RAW.items()}
    config = Config(topics=topics, evaluation=Evaluation(held_out=("depth",)))
    read = read_checked_dive(tmp_path / "dive.mcap", config)
    given = given_dive(read, config, outages_of(dive)[:1])
    assert set(given.topics) == {"pings", "samples"}
    assert len(read.topics["pings"].time_ns) - len(given.topics["pings"].time_ns) == 10
    assert len(read.topics["samples"].time_ns) == len(given.topics["samples"].time_ns)


def test_after_an_outage_the_pings_are_there_again(dive: Dive) -> None:
    outages = outages_of(dive)[2:4]
    given = given_dive(dive, Config(), outages)
    absent = np.setdiff1d(dive.dvl.time_ns, given.dvl.time_ns)
    held_back = [
        (dive.dvl.time_ns > before_ns) & (dive.dvl.time_ns <= end_ns)
        for before_ns, end_ns in outages
    ]
    np.testing.assert_array_equal(absent, dive.dvl.time_ns[np.any(held_back, axis=0)])
    assert len(absent) == 10


class OfSensor(Copy):
    """Readings that are made of a sensor."""

    sensor = "depth"

    def readings(self, dive: Dive) -> UserReadings:
        """Take its numbers."""
        columns = dive.sensors[self.sensor]
        return UserReadings(columns.time_ns, columns.values, np.ones(1))


class OfHeading(OfSensor):
    """The compass."""

    sensor = "heading"


class OfPosition(OfSensor):
    """The fixes."""

    sensor = "position"


@pytest.mark.parametrize(
    ("word", "sensor"),
    [("OfSensor", "depth"), ("OfHeading", "heading"), ("OfPosition", "position")],
)
def test_a_held_out_sensor_is_not_in_the_dive(dive: Dive, word: str, sensor: str) -> None:
    filters = {
        "baseline": Filter(aiding=("velocity",)),
        "mine": Filter(aiding=("velocity", f"{HERE}:{word}")),
    }
    config = Config(filters=filters, evaluation=Evaluation(starts=1, held_out=(sensor,)))
    with pytest.raises(
        ConfigError, match=rf"{word}: readings\(self, dive\) .*KeyError: '{sensor}'"
    ) as refusal:
        prepare_dive(dive, config)
    assert sensor in str(refusal.value.hint)


def test_nothing_is_given_that_a_held_out_sensor_had_a_part_in(dive: Dive) -> None:
    dive, topics = with_topics(dive)
    given = given_dive(dive, Config(topics=topics, evaluation=Evaluation(held_out=("depth",))))
    assert set(given.sensors) == {"heading", "position"}
    assert set(given.topics) == {"dvl", "ping", "free"}
    assert (given.reference, given.solutions) == (None, {})
    np.testing.assert_array_equal(given.dvl.time_ns, dive.dvl.time_ns)
    np.testing.assert_array_equal(given.imu.time_ns, dive.imu.time_ns)


def test_without_anything_held_back_the_dive_is_given_as_it_is(dive: Dive) -> None:
    assert given_dive(dive, Config()) is dive


def test_whose_data_a_topic_carries_is_a_setting(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('[topics.pings]\ntopic = "/raw"\nvalues = "x,y,z"\nsensor = "dvl"\n')
    config = load_config(file=file)
    assert config.topics["pings"].sensor == "dvl"
    file.write_text(render_toml(config))
    assert load_config(file=file) == config
    file.write_text('[topics.pings]\ntopic = "/raw"\nvalues = "x"\nsensor = "sonar"\n')
    with pytest.raises(ConfigError, match=r"topics\.pings\.sensor.*sonar"):
        load_config(file=file)
