"""Transforms by their frames, as rosbags writes them for ROS 2 and ROS 1: one pair among many is a reference."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import other_bags
import pytest
from blocks import block_of
from rosbag_messages import Message, header, imu_messages, serialised, store_with, write_log, xyz
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Initial, Reference
from insdvl_replay.core.dive_columns import ReferenceColumns
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry.frames import east_north_up_m
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.definitions import definition_text, definitions_of
from insdvl_replay.logs.formats.fields import Element
from insdvl_replay.logs.formats.readers import BinaryReader

TYPE = "tf2_msgs/msg/TFMessage"
TIMES = 0.1 * np.arange(20)
PLACE = Initial(latitude_deg=32.8, longitude_deg=35.0)
TURNS = Rotation.from_euler(
    "ZYX", np.stack([0.3 + 0.1 * TIMES, 0.05 * TIMES, 0.02 * TIMES], axis=1)
)
WAY_M = np.stack([3.0 * TIMES, -2.0 * TIMES, 0.5 * TIMES], axis=1)
PATHS = (
    "transforms[*].transform.rotation",
    "transforms[*].transform.translation",
    "transforms[*].header.stamp",
)


def transform(parent: str, child: str, i: int, sign: float = 1.0) -> dict[str, Any]:
    x, y, z, w = TURNS[i].as_quat().tolist()
    return {
        "header": header(TIMES[i]) | {"frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": xyz(sign * WAY_M[i]),
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }


def tree(i: int) -> list[dict[str, Any]]:
    """Give the transforms of a message: the one that is meant is first, last, alone, or not there."""
    meant, arm = transform("map", "base_link", i), transform("base_link", "arm", i, 7.0)
    return [[meant], [arm, meant], [meant, transform("map", "base_tail", i, 5.0), arm], [arm], []][
        i % 5
    ]


def messages(trees: Callable[[int], list[dict[str, Any]]] = tree) -> list[Message]:
    pings = [
        (
            "/dvl",
            "geometry_msgs/msg/TwistStamped",
            t,
            {"header": header(t), "twist": {"linear": xyz((1.0, 0.1 * t, 0))}},
        )
        for t in TIMES.tolist()
    ]
    return [
        *imu_messages(),
        *pings,
        *(("/tf", TYPE, t, {"transforms": trees(i)}) for i, t in enumerate(TIMES.tolist())),
    ]


def read(path: Path, frames: tuple[str, str] | None = ("map", "base_link")) -> ReferenceColumns:
    dive = read_dive(path, Config(reference=Reference(topic="/tf", frames=frames), initial=PLACE))
    assert not {note.code for note in dive.notes} & {"messages_missing", "messages_unreadable"}
    assert dive.reference is not None
    return dive.reference


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_pair_that_is_named_is_the_reference(encoding: str, tmp_path: Path) -> None:
    log = write_log(tmp_path / "dive.mcap", messages())
    if encoding == "ros1":
        log = other_bags.ros1_mcap(tmp_path / "ros1.mcap", log.read_bytes())
    reference = read(log)
    told = np.flatnonzero(np.arange(20) % 5 < 3)
    to_flu, to_ned = (
        np.diag([1.0, -1.0, -1.0]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    )
    expected = to_ned @ TURNS[told].as_matrix() @ to_flu
    assert (reference.time_ns - reference.time_ns[0]).tolist() == np.rint(
        1e9 * TIMES[told]
    ).astype(int).tolist()
    np.testing.assert_allclose(reference.mat_nb, expected, atol=1e-12)
    place = np.array([np.deg2rad(32.8), np.deg2rad(35.0), 0.0])
    np.testing.assert_allclose(east_north_up_m(reference.position, place), WAY_M[told], atol=1e-4)


def test_a_pair_twice_in_a_message_is_two_rows(tmp_path: Path) -> None:
    def twice(i: int) -> list[dict[str, Any]]:
        later = transform("map", "base_link", min(i + 1, 19))
        return [transform("map", "base_link", i), later] if i % 2 == 0 else []

    assert len(read(write_log(tmp_path / "dive.mcap", messages(twice))).time_ns) == 20


@pytest.mark.parametrize("frames", [("map", "arm"), ("base_link", "map"), None])
def test_a_pair_that_is_not_there_is_refused_with_those_that_are(
    frames: tuple[str, str] | None, tmp_path: Path
) -> None:
    with pytest.raises(LogError) as refused:
        read(write_log(tmp_path / "dive.mcap", messages()), frames)
    what = "many frames" if frames is None else f"no transform from {frames[0]} to {frames[1]}"
    assert what in refused.value.message
    assert 'reference.frames = ["map", "base_link"]' in refused.value.hint
    assert 'reference.frames = ["base_link", "arm"]' in refused.value.hint


def test_frames_are_of_transforms_alone(tmp_path: Path) -> None:
    log = write_log(tmp_path / "dive.mcap", messages())
    config = Config(
        reference=Reference(topic="/dvl", frames=("map", "base_link"), velocity_n="twist.linear")
    )
    with pytest.raises(LogError, match="has no transforms"):
        read_dive(log, config)


def test_lengths_and_texts_of_any_size_are_refused_or_read_and_nothing_else() -> None:
    """Every word of a message in turn is made small, large and huge."""
    text = definition_text(TYPE)
    message = serialised(store_with({TYPE: text}), TYPE, {"transforms": tree(2)})
    definitions = definitions_of(TYPE, text, "cdr")
    element = Element("transforms", ("header.frame_id", "child_frame_id"), ("map", "base_link"))
    refused = 0
    for place in range(4, len(message) - 3, 4):
        for word in (0, 1, 2, 255, 65_536, 2**31 - 1, 2**32 - 1):
            harmed = message[:place] + word.to_bytes(4, "little") + message[place + 4 :]
            try:
                columns = BinaryReader(definitions, TYPE, PATHS, element=element).columns(
                    block_of([harmed])
                )
            except LogError:
                refused += 1
                continue
            rows = len(columns[""])
            assert all(len(values) == rows for values in columns.values())
            assert rows <= 3
    assert refused > 20
