"""Hints about names: the one that was meant if any is like it, else a short list of what there is."""

import pickle
import re
from pathlib import Path

import pytest

from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import (
    ConfigError,
    LogError,
    counted_clause,
    error_context,
    listed,
    nearest,
)
from insdvl_replay.logs.formats.fields import check_path
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.read import find_roles

IMU_TYPE = "sensor_msgs/msg/Imu"
FIELDS = {
    "header": "H",
    "header.frame_id": "string",
    "angular_velocity": "V",
    "angular_velocity.x": "float64",
}
LISTED = "header (H), angular_velocity (V), angular_velocity.x (float64)"


def channel(topic: str, type_name: str, messages: int) -> LogChannel:
    return LogChannel(1, topic, type_name, "cdr", "ros2msg", messages)


def refusal(channels: list[LogChannel], config: Config | None = None) -> LogError:
    findings = find_roles("a.mcap", channels, config or Config())
    return next(finding.error for finding in findings if finding.error)


def test_only_what_is_spelled_alike_is_near() -> None:
    assert nearest("/imu/dat", ["/dvl", "/imu/data"]) == "/imu/data"
    assert nearest("/nothing", ["/depth", "/dvl", "/imu"]) is None
    assert nearest("/imu", []) is None


def test_long_lists_are_cut_and_counted() -> None:
    assert listed("abc") == "a, b, c"
    assert listed("abcdefgh", most=6) == "a, b, c, d, e, f and 2 more"


def test_topic_that_is_like_none_is_answered_with_those_there_are() -> None:
    channels = [
        channel("/depth", "a/Depth", 3),
        channel("/box/imu", IMU_TYPE, 3),
        channel("/empty", IMU_TYPE, 0),
    ]
    assert refusal(channels, Config(imu=Imu(topic="/nothing"))).hint.endswith(" /box/imu, /depth")
    assert refusal(channels, Config(imu=Imu(topic="/bix/imu"))).hint.endswith(
        'imu.topic = "/box/imu"'
    )


def test_topic_of_the_right_type_without_messages_is_named() -> None:
    error = refusal([channel("/depth", "a/Depth", 3), channel("/imu", IMU_TYPE, 0)])
    assert re.search(r"a/Depth; /imu\b", error.message)


@pytest.mark.parametrize("topic", [None, "/imu"])
def test_empty_log_is_no_matter_of_types(topic: str | None) -> None:
    error = refusal([channel("/imu", IMU_TYPE, 0)], Config(imu=Imu(topic=topic)))
    assert error.hint.endswith(" /imu")


@pytest.mark.parametrize(
    ("path", "nearest_"),
    [("angular_velocty", True), ("gyro", False)],
)
def test_field_that_is_like_none_is_answered_with_those_there_are(
    path: str, nearest_: bool
) -> None:
    with pytest.raises(LogError) as refused:
        check_path(path, FIELDS, IMU_TYPE)
    assert LISTED in refused.value.hint
    assert ("'angular_velocity'" in refused.value.hint) == nearest_


def test_key_that_is_like_none_is_answered_with_those_there_are(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("[span]\nfrom = 3.0\n")
    with pytest.raises(ConfigError) as refused:
        load_config(file=file)
    assert refused.value.hint.endswith("start_s, end_s")


def test_an_error_knows_its_places_apart_from_its_sentence() -> None:
    with pytest.raises(LogError) as raised, error_context("dive.mcap", "/imu"):
        raise LogError("has no messages", "look again")
    error = pickle.loads(pickle.dumps(raised.value))
    assert (error.where, error.what, error.hint) == (
        ("dive.mcap", "/imu"),
        "has no messages",
        "look again",
    )
    assert str(error) == error.message == "dive.mcap: /imu: has no messages"
    assert error.inside("dive.mcap") == "/imu: has no messages"


@pytest.mark.parametrize(
    ("clause", "of_one"),
    [
        (
            "gaps are longer than 1 s: longest 2 s; 3 are longer",
            "1 gap is longer than 1 s: longest 2 s; 3 are longer",
        ),
        (
            "messages repeat the values of the one before",
            "1 message repeats the values of the one before",
        ),
        (
            "velocities of 9 are not finite and count as missing",
            "1 velocity of 9 is not finite and counts as missing",
        ),
    ],
)
def test_one_is_counted_in_the_singular(clause: str, of_one: str) -> None:
    assert counted_clause(1, clause) == of_one
    assert counted_clause(2, clause) == f"2 {clause}"
