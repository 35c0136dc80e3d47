"""What is proposed of a reference: in which frame its velocity is, and which topic only has its type."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbag_messages import Message, header, write_log, xyz

from insdvl_replay.core.config import Config, Imu, Initial
from insdvl_replay.inspection.proposal import propose_settings
from insdvl_replay.inspection.settings import Setting

TIMES = np.arange(0.0, 60.0, 0.05)
RATE_RADPS, SPEED_MPS = 0.1, 1.5
YAW = 0.4 + RATE_RADPS * TIMES
"""From east over north: a circle of 15 m, forward-port-up."""


def messages(*, in_world: bool, moved: bool = True) -> list[Message]:
    """Give IMU, DVL and odometry of a circle; the twist as the type has it in the body, or in the world."""
    flying = {
        "linear_acceleration": xyz((0.0, RATE_RADPS * SPEED_MPS, 9.8)),
        "angular_velocity": xyz((0, 0, RATE_RADPS)),
    }
    found: list[Message] = []
    for time_s, yaw in zip(TIMES.tolist(), YAW.tolist(), strict=True):
        at = header(time_s)
        place = SPEED_MPS / RATE_RADPS * np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        velocity = SPEED_MPS * np.array(
            [np.cos(yaw), np.sin(yaw), 0.0] if in_world else [1.0, 0.0, 0.0]
        )
        pose = {
            "position": xyz(place if moved else place * 0),
            "orientation": {"z": np.sin(yaw / 2), "w": np.cos(yaw / 2)},
        }
        found.append(("/imu", "sensor_msgs/msg/Imu", time_s, {"header": at, **flying}))
        twist = {"twist": {"linear": xyz(velocity)}}
        found.append(
            (
                "/truth",
                "nav_msgs/msg/Odometry",
                time_s,
                {"header": at, "pose": {"pose": pose}, "twist": twist},
            )
        )
    for time_s in TIMES[::4].tolist():
        found.append(("/dvl", "geometry_msgs/msg/TwistStamped", time_s, ping(time_s)))
    return found


def ping(time_s: float) -> dict[str, Any]:
    return {
        "header": header(time_s),
        "twist": {"linear": xyz((SPEED_MPS, 1e-3 * np.sin(time_s), 0.0))},
    }


def proposed(path: Path, found: list[Message], **initial: Any) -> dict[str, Setting]:
    proposal = propose_settings(write_log(path, found), Config(initial=Initial(**initial)))
    return {setting.key: setting for setting in proposal.settings}


@pytest.mark.parametrize("in_world", [False, True])
@pytest.mark.nightly
def test_velocity_in_the_world_is_reported_by_the_positions(
    in_world: bool, tmp_path: Path
) -> None:
    settings = proposed(tmp_path / "dive.mcap", messages(in_world=in_world))
    assert ("reference.velocity_n" in settings) == in_world
    if in_world:
        assert settings["reference.velocity_n"].value == "twist.twist.linear"
        assert not settings["reference.velocity_n"].open


@pytest.mark.parametrize("in_world", [False, True])
def test_it_is_reported_even_where_a_replay_lacks_nothing(in_world: bool, tmp_path: Path) -> None:
    path = write_log(tmp_path / "dive.mcap", messages(in_world=in_world))
    config = Config(imu=Imu(axes="flu"), initial=Initial(latitude_deg=30.0))
    proposal = propose_settings(path, config)
    assert [setting.key for setting in proposal.settings] == (
        ["reference.velocity_n"] if in_world else []
    )
    assert proposal.blockers == ()


def test_without_positions_nothing_reports_in_which_frame_a_velocity_is(tmp_path: Path) -> None:
    assert "reference.velocity_n" not in proposed(
        tmp_path / "dive.mcap", messages(in_world=True, moved=False)
    )


def test_a_topic_that_only_has_the_type_of_a_reference_is_not_proposed(tmp_path: Path) -> None:
    depths: list[Message] = [
        (
            "/depth",
            "nav_msgs/msg/Odometry",
            t,
            {"header": header(t), "pose": {"pose": {"position": {"z": -t}}}},
        )
        for t in TIMES.tolist()
    ]
    settings = proposed(tmp_path / "dive.mcap", [*messages(in_world=False), *depths])
    topic = settings["reference.topic"]
    assert (topic.value, topic.open) == ("/truth", "")
    assert topic.seen.startswith("not /depth: ")


def test_between_two_that_could_be_it_a_person_decides(tmp_path: Path) -> None:
    found = messages(in_world=False)
    others = [("/other", *rest) for topic, *rest in found if topic == "/truth"]
    topic = proposed(tmp_path / "dive.mcap", [*found, *others])["reference.topic"]  # type: ignore[list-item]
    assert topic.open
    assert topic.others
