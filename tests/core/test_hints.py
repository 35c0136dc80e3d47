"""Hints about names: the one that was meant if any is like it, else a short list of what there is."""

import pickle
from pathlib import Path

import pytest

from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError, LogError, error_context, listed, nearest
from insdvl_replay.logs.columns.roles import find_roles
from insdvl_replay.logs.container.records import LogChannel
from insdvl_replay.logs.encoding.fields import check_path

IMU_TYPE = "sensor_msgs/msg/Imu"
FIELDS = {"header": "H", "header.frame_id": "string", "angular_velocity": "V", "angular_velocity.x": "float64"}

LISTED = (
    'its fields are header (H), angular_velocity (V), angular_velocity.x (float64); "p, q, r" sets fields side by side'
)


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
    channels = [channel("/depth", "a/Depth", 3), channel("/box/imu", IMU_TYPE, 3), channel("/empty", IMU_TYPE, 0)]
    assert refusal(channels, Config(imu=Imu(topic="/nothing"))).hint == "those with messages are /box/imu, /depth"
    assert refusal(channels, Config(imu=Imu(topic="/bix/imu"))).hint == 'the nearest is imu.topic = "/box/imu"'


def test_topic_of_the_right_type_without_messages_is_named() -> None:
    error = refusal([channel("/depth", "a/Depth", 3), channel("/imu", IMU_TYPE, 0)])
    assert error.message.endswith("it has a/Depth; /imu would be, without a single message")


@pytest.mark.parametrize("topic", [None, "/imu"])
def test_empty_log_is_no_matter_of_types(topic: str | None) -> None:
    error = refusal([channel("/imu", IMU_TYPE, 0)], Config(imu=Imu(topic=topic)))
    assert "no messages" in error.message
    assert error.hint == "was anything recorded? Announced are /imu"


@pytest.mark.parametrize(
    ("path", "hint"),
    [
        ("angular_velocty", f"the nearest one is 'angular_velocity'; {LISTED}"),
        ("gyro", LISTED),
    ],
)
def test_field_that_is_like_none_is_answered_with_those_there_are(path: str, hint: str) -> None:
    with pytest.raises(LogError) as refused:
        check_path(path, FIELDS, IMU_TYPE)
    assert refused.value.hint == hint


def test_key_that_is_like_none_is_answered_with_those_there_are(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("[span]\nfrom = 3.0\n")
    with pytest.raises(ConfigError) as refused:
        load_config(file=file)
    assert refused.value.hint == "known: start_s, end_s"


def test_an_error_knows_its_places_apart_from_its_sentence() -> None:
    with pytest.raises(LogError) as raised, error_context("dive.mcap", "/imu"):
        raise LogError("has no messages", "look again")
    error = pickle.loads(pickle.dumps(raised.value))
    assert (error.where, error.what, error.hint) == (("dive.mcap", "/imu"), "has no messages", "look again")
    assert str(error) == error.message == "dive.mcap: /imu: has no messages"
    assert error.inside("dive.mcap") == "/imu: has no messages"


@pytest.mark.parametrize(
    ("setting", "hint"),
    [
        ("evaluation.withheld=position", """--set 'evaluation.withheld=["position"]'"""),
        ("evaluation.withheld=[position]", """--set 'evaluation.withheld=["position"]'"""),
        ("filters.aided.aiding=velocity, depth", """--set 'filters.aided.aiding=["velocity", "depth"]'"""),
        ("dvl.lever_arm_m=1,-2.5,3e-1", "--set 'dvl.lever_arm_m=[1, -2.5, 3e-1]'"),
    ],
)
def test_a_list_that_lacks_its_brackets_or_quotes_is_written_as_it_should_be(setting: str, hint: str) -> None:
    with pytest.raises(ConfigError, match="needs a list") as caught:
        load_config(overrides=[setting])
    assert caught.value.hint == hint
    load_config(overrides=[hint.removeprefix("--set '").removesuffix("'")])


def test_a_list_that_a_file_lacks_is_written_as_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text('[evaluation]\nwithheld = "position"\n')
    with pytest.raises(ConfigError, match="needs a list") as caught:
        load_config(file=tmp_path / "vehicle.toml")
    assert caught.value.hint == 'write evaluation.withheld = ["position"]'


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("dvl.velocity_noise", "did you mean dvl.velocity_unit or dvl.velocity or dvl.velocity_sd_mps?"),
        ("dvl.velocity_sd_mp", "did you mean dvl.velocity_sd_mps?"),
        ("dvl.scle", "did you mean dvl.scale?"),
    ],
)
def test_a_key_that_is_no_slip_of_the_finger_may_be_any_that_begins_alike(key: str, meant: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(overrides=[f"{key}=1"])
    assert caught.value.hint == meant
