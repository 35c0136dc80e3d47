"""The search for settings leaves out topics, references and dives that it cannot use, and says which and why."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbag_messages import START_NS, Message, header, write_log, xyz

from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config import Config, Imu, Reference
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.inspection import automatic
from insdvl_replay.inspection.clock_words import clock_words, is_other_clock
from insdvl_replay.inspection.probed_topics import without_marks
from insdvl_replay.inspection.roles import RoleReadings, read_roles
from insdvl_replay.inspection.trials import thinned

END_S = 25.0
TIMES = np.arange(0.0, END_S, 0.02)
PINGS = np.arange(0.0, END_S, 0.2)
RATE_RADPS = 0.1
DVL = "marine_acoustic_msgs/msg/Dvl"
TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"


def imu(topic: str = "/imu", times: Sequence[float] = tuple(TIMES)) -> list[Message]:
    flying = {
        "linear_acceleration": xyz((0.1, 0.15, -9.8)),
        "angular_velocity": xyz((0.01, 0.0, RATE_RADPS)),
    }
    return [
        (topic, "sensor_msgs/msg/Imu", time_s, {"header": header(time_s)} | flying)
        for time_s in times
    ]


def speed_mps(time_s: float) -> float:
    return 1.0 + 0.2 * float(np.sin(time_s))


def dvl(topic: str, **values: Any) -> list[Message]:
    return [
        (
            topic,
            DVL,
            time_s,
            {
                "header": header(time_s),
                "velocity_mode": 1,
                "velocity": xyz((speed_mps(time_s), 0.05, 0.01)),
            }
            | values,
        )
        for time_s in PINGS.tolist()
    ]


def odometry(topic: str, again: int = 1, off_mps: float = 0.0) -> list[Message]:
    """Give a pose that turns with the vehicle, each so many times, 10 ms apart, and a velocity of pings."""
    found: list[Message] = []
    for time_s in PINGS.tolist():
        yaw = -RATE_RADPS * time_s
        pose = {
            "position": xyz((time_s, 0.1 * time_s, 0.0)),
            "orientation": {"z": np.sin(yaw / 2), "w": np.cos(yaw / 2)},
        }
        rng = np.random.default_rng(round(1000 * time_s))
        velocity = np.array([speed_mps(time_s), -0.05, -0.01]) + off_mps * rng.standard_normal(3)
        for number in range(again):
            at_s = time_s + 0.01 * number
            twist = {"twist": {"linear": xyz(velocity)}}
            found.append(
                (
                    topic,
                    "nav_msgs/msg/Odometry",
                    at_s,
                    {"header": header(at_s), "pose": {"pose": pose}, "twist": twist},
                )
            )
    return found


def read(folder: Path, *messages: list[Message], config: Config | None = None) -> RoleReadings:
    path = write_log(
        folder / "dive.mcap",
        sorted((row for rows in messages for row in rows), key=lambda row: row[2]),
    )
    return read_roles(path, config or Config(), allow_damaged=False)


def left_out(found: RoleReadings) -> str:
    return " ".join(note.text for note in found.notes if note.code == "found_left_out")


def test_a_dvl_that_cannot_be_read_is_left_out_and_named(tmp_path: Path) -> None:
    found = read(tmp_path, imu(), dvl("/bottom"), dvl("/a_water_track", velocity_mode=2))
    assert [dvl.topic for dvl in found.dvls] == ["/bottom"]
    assert "dvl" not in found.is_alone
    assert "/a_water_track" in left_out(found)
    assert "water track" in left_out(found)


def test_an_imu_that_cannot_be_read_is_left_out_and_named(tmp_path: Path) -> None:
    stuck = [
        (*row[:3], row[3] | {"angular_velocity_covariance": [-1.0] + [0.0] * 8})
        for row in imu("/a_no_gyro")
    ]
    found = read(tmp_path, imu(), imu("/a_few", (0.0, 1.0, 2.0)), stuck, dvl("/bottom"))
    assert [found_imu.topic for found_imu in found.imus] == ["/imu"]
    assert "/a_few" in left_out(found)


def test_an_imu_that_is_dead_is_left_out_and_named(tmp_path: Path) -> None:
    still = {"linear_acceleration": xyz((0.0, 0.0, 0.0)), "angular_velocity": xyz((0.0, 0.0, 0.0))}
    dead = [(*row[:3], row[3] | still) for row in imu("/a_dead")]
    found = read(tmp_path, imu(), dead, dvl("/bottom"))
    assert [found_imu.topic for found_imu in found.imus] == ["/imu"]
    assert "/a_dead is not used as IMU: has no specific force" in left_out(found)
    with pytest.raises(LogError, match="has no specific force"):
        read(tmp_path, dead, dvl("/bottom"))


def fixes(topic: str) -> list[Message]:
    return [
        (
            topic,
            "sensor_msgs/msg/NavSatFix",
            time_s,
            {"header": header(time_s), "latitude": 32.0 + 1e-5 * time_s, "longitude": 34.0},
        )
        for time_s in PINGS[::5].tolist()
    ]


def test_fixes_beside_dead_reckoning_of_the_dvl_are_the_reference(tmp_path: Path) -> None:
    found = read(tmp_path, imu(), dvl("/bottom"), odometry("/dvl/odom"), fixes("/gps"))
    assert found.reference is not None
    assert (found.reference_topics, found.draft.reference.topic) == (("/gps",), "/gps")
    assert not found.draft.reference.ignore
    assert "/dvl/odom is not used as reference: its velocities are those of /bottom" in left_out(
        found
    )
    # Fixes that are named belong to the solution beside them, which is the DVL's.
    named = Config(reference=Reference(fix="/gps"))
    beside = read(
        tmp_path, imu(), dvl("/bottom"), odometry("/dvl/odom"), fixes("/gps"), config=named
    )
    assert beside.reference is None
    assert beside.draft.reference.ignore


def test_references_are_tried_one_after_the_other(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "dive.mcap",
        sorted(
            [*imu(), *dvl("/bottom"), *odometry("/ins", off_mps=0.01), *fixes("/a"), *fixes("/b")],
            key=lambda row: row[2],
        ),
    )
    without: list[tuple[str, ...]] = []
    while True:
        found = read_roles(path, Config(), allow_damaged=False, without=without)
        if found.reference is None:
            break
        assert found.has_other_references == (found.reference_topics != ("/b",))
        without.append(found.reference_topics)
    assert without == [("/a",), ("/ins",), ("/b",)]
    assert found.draft.reference.ignore


def test_a_reference_that_cannot_be_read_gives_way_to_another(tmp_path: Path) -> None:
    broken = [(*row[:3], row[3] | {"header": header(0.0)}) for row in odometry("/a_broken")]
    found = read(tmp_path, imu(), dvl("/bottom"), broken, odometry("/b_good", off_mps=0.01))
    assert found.reference is not None
    assert found.draft.reference.topic == "/b_good"
    alone = read(tmp_path, imu(), dvl("/bottom"), broken)
    assert alone.reference is None
    assert alone.draft.reference.ignore or alone.draft.reference.stamp == "log_time"


def test_a_dvl_that_is_alone_and_cannot_be_read_is_the_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="water track"):
        read(tmp_path, imu(), dvl("/water", velocity_mode=2))


@pytest.mark.parametrize("again", [1, 2])
def test_dead_reckoning_of_the_dvl_is_no_reference(again: int, tmp_path: Path) -> None:
    found = read(tmp_path, imu(), dvl("/bottom"), odometry("/dvl/odom", again))
    assert found.reference is None
    assert found.draft.reference.ignore
    (note,) = [note for note in found.notes if note.code == "found_reference"]
    assert "reference.ignore" in note.hint
    independent = read(tmp_path, imu(), dvl("/bottom"), odometry("/ins", again, off_mps=0.01))
    assert independent.reference is not None
    assert not independent.draft.reference.ignore


def test_poses_that_are_published_again_count_once(tmp_path: Path) -> None:
    found = read(tmp_path, imu(), dvl("/bottom"), odometry("/ins", 3, off_mps=0.01))
    assert found.reference is not None
    assert len(found.reference.time_ns) == 3 * len(PINGS)
    assert np.count_nonzero(found.reference.known["attitudes"]) == len(PINGS)
    assert np.count_nonzero(found.reference.known["velocities"]) == len(PINGS)


# Clocks


def clock(role: str, ahead_s: float) -> Clock:
    return Clock(role, f"/{role}", "header", 100, -ahead_s, 0.001, 0, 0, 50.0, 0.0)


@pytest.mark.parametrize(
    ("role", "ahead_s", "words"),
    [
        ("imu", 17.998, "the IMU's clock is 18.00 s ahead (GPS time?)"),
        ("dvl", -5.2, "the DVL's clock is 5.20 s behind"),
        ("imu", 7200.1, "the IMU's clock is 7200.10 s ahead (local time?)"),
        ("dvl", -1.7e9, "the DVL's clock is 19675.9 days behind (time since its start?)"),
        ("reference", 36.99, "the reference's clock is 36.99 s ahead (TAI?)"),
    ],
)
def test_a_clock_that_is_off_is_described(role: str, ahead_s: float, words: str) -> None:
    assert is_other_clock(clock(role, ahead_s))
    assert clock_words(clock(role, ahead_s)) == words
    assert not is_other_clock(clock(role, 0.3))


def test_an_imu_in_gps_time_is_reported(tmp_path: Path) -> None:
    ahead = [(*row[:3], row[3] | {"header": header(row[2] + 18.0)}) for row in imu()]
    found = read(tmp_path, ahead, dvl("/bottom"))
    (note,) = [note for note in found.notes if note.code == "found_clocks"]
    assert note.text == "the IMU's clock is 18.00 s ahead (GPS time?): log times used"
    assert found.draft.imu.stamp == found.draft.dvl.stamp == "log_time"
    assert not read(tmp_path, imu(), dvl("/bottom")).notes
    assert START_NS > 0


# Several dives


def test_short_dives_and_those_that_fail_do_not_decide_for_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def roles(paths: Sequence[Path], given: Config, **_: Any) -> Any:
        tried.append(paths[0].stem)
        if paths[0].stem == "bad":
            raise LogError("no velocities")
        return RoleReadings("", given, [SimpleNamespace(columns=None)], [], None)  # type: ignore[list-item]

    def chosen(read: RoleReadings, given: Given, notes: list[Note]) -> tuple[Config, float]:
        return Config(imu=Imu(axes="flu")), 0.5

    monkeypatch.setattr(automatic, "read_roles", roles)
    monkeypatch.setattr(automatic, "with_roles", chosen)
    monkeypatch.setattr(automatic, "raise_if_span_is_empty", lambda *_: None)
    monkeypatch.setattr(automatic, "_is_short", lambda paths: paths[0].stem == "short")
    dives = [[Path("short.mcap")], [Path("bad.mcap")], [Path("good.mcap")]]
    found = automatic._first_with_roles(dives, Given(Config()), [], (), allow_damaged=False)
    assert (tried, found.paths) == (["bad", "good"], dives[2])
    assert found.config.imu.axes == "flu"
    with pytest.raises(LogError, match="no velocities"):
        automatic._first_with_roles(dives[1:2], Given(Config()), [], (), allow_damaged=False)


def test_a_dive_of_some_seconds_does_not_count_beside_others() -> None:
    def lasting(length_s: float) -> Dive:
        time_ns = START_NS + np.arange(round(10 * length_s)) * 10**8
        columns = ImuColumns(time_ns, np.zeros((len(time_ns), 3)), np.zeros((len(time_ns), 3)))
        return Dive(
            f"of_{length_s:g}_s",
            columns,
            DvlColumns(time_ns, velocity_d=np.zeros((len(time_ns), 3))),
        )

    notes: list[Note] = []
    whole, short = lasting(60.0), lasting(5.0)
    assert automatic._without_short([whole, short], notes) == [whole]
    (note,) = notes
    assert note.text.startswith("of_5_s is not used")
    assert automatic._without_short([short], notes) == [short]
    assert notes == [note]


def test_a_number_that_stands_for_none_does_not_tell_the_size_of_a_field() -> None:
    values = np.random.default_rng(1).normal(1.0, 0.1, (50, 3))
    marked = values.copy()
    marked[10:40] = 999.999
    np.testing.assert_array_equal(
        without_marks(marked), np.delete(values, np.arange(10, 40), axis=0)
    )
    assert without_marks(values) is values
    assert len(without_marks(np.full((5, 3), 2.0))) == 5


def test_a_stretch_of_a_few_samples_or_pings_is_no_dive_to_search_in() -> None:
    steps_ns = 2_000_000 * np.arange(40)
    samples = ImuColumns(steps_ns, np.tile([0.0, 0.0, -9.8], (40, 1)), np.zeros((40, 3)))
    pings = DvlColumns(np.array([0, 10**9]), velocity_d=np.ones((2, 3)))
    with pytest.raises(LogError, match="40 samples of the IMU and 2 pings of the DVL, too few"):
        thinned(Dive("", samples, pings))
