"""Solutions of the vehicle's own, as rosbags writes their messages and as TUM files hold them."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbag_messages import START_NS, header, imu_messages, write_log, xyz
from scipy.spatial.transform import Rotation

from insdvl_replay.core import config_file
from insdvl_replay.core.config import Clocks, Config, Filter, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, SolutionColumns
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns import reference
from insdvl_replay.logs.columns.reference import read_tum
from insdvl_replay.logs.columns.tables import rows_among

TIMES = 0.1 * np.arange(20)
ENU_OF_NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_OF_FRD = Rotation.from_euler("x", 180.0, degrees=True)
WAY_N = np.stack([3.0 * TIMES, -2.0 * TIMES, 0.5 * TIMES], axis=1)
VELOCITY_N = np.stack([1.0 + TIMES, 0.5 - TIMES, 0.1 * TIMES], axis=1)
TURNS = Rotation.from_euler(
    "ZYX", np.stack([0.3 + 0.1 * TIMES, 0.05 * TIMES, 0.02 * TIMES], axis=1)
)
"""From the body, forward-starboard-down, to north-east-down."""


def solution_of(
    folder: Path, type_name: str, messages: list[dict[str, Any]], **keys: Any
) -> tuple[SolutionColumns, Dive]:
    pings = [
        (
            "/dvl",
            "geometry_msgs/msg/TwistStamped",
            time_s,
            {"header": header(time_s), "twist": {"linear": xyz(v)}},
        )
        for time_s, v in zip(TIMES.tolist(), VELOCITY_N, strict=True)
    ]
    others = [
        ("/own", type_name, time_s, message)
        for time_s, message in zip(TIMES.tolist(), messages, strict=True)
    ]
    filters = {
        "a": Filter(aiding=("velocity",)),
        "b": Filter(solution=Solution(topic="/own", **keys)),
    }
    path = write_log(folder / "dive.mcap", [*imu_messages(), *pings, *others])
    dive = read_dive(path, Config(filters=filters, clocks=Clocks(max_disagreement_s=2e9)))
    return dive.solutions["b"], dive


def odometry(i: int, pose: Floats, twist: Floats) -> dict[str, Any]:
    """Give a message as ROS has it: east-north-up, forward-port-up, the twist in the body."""
    attitude = ENU_OF_NED * TURNS[i] * FLU_OF_FRD
    x, y, z, w = attitude.as_quat().tolist()
    velocity = attitude.inv().apply(ENU_OF_NED.apply(VELOCITY_N[i]))
    return {
        "header": header(TIMES[i]),
        "pose": {
            "pose": {
                "position": xyz(ENU_OF_NED.apply(WAY_N[i])),
                "orientation": {"x": x, "y": y, "z": z, "w": w},
            },
            "covariance": pose.ravel(),
        },
        "twist": {"twist": {"linear": xyz(velocity)}, "covariance": twist.ravel()},
    }


def full(seed: int, size: int) -> Floats:
    factor = np.random.default_rng(seed).normal(size=(size, size))
    made: Floats = 0.01 * factor @ factor.T
    return made


def test_covariances_of_odometry_are_those_of_errors_in_n(tmp_path: Path) -> None:
    """Against errors that are drawn in the message's own frames and turned by scipy."""
    pose, twist = 1e-4 * full(1, 6), 1e-2 * full(2, 6)
    solution, _ = solution_of(
        tmp_path, "nav_msgs/msg/Odometry", [odometry(i, pose, twist) for i in range(20)]
    )
    assert solution.moved_n is not None
    np.testing.assert_allclose(solution.moved_n, WAY_N, atol=1e-12)
    np.testing.assert_allclose(solution.motion.velocity_n, VELOCITY_N, atol=1e-12)
    np.testing.assert_allclose(solution.motion.mat_nb, TURNS.as_matrix(), atol=1e-12)
    rng, row = np.random.default_rng(3), 13
    errors = rng.multivariate_normal(np.zeros(6), pose, 200_000, method="cholesky")
    twists = rng.multivariate_normal(np.zeros(3), twist[:3, :3], 200_000, method="cholesky")
    turn_n, moved_n = ENU_OF_NED.inv().apply(errors[:, 3:]), ENU_OF_NED.inv().apply(errors[:, :3])
    # What the message says of the velocity, turned by an attitude that is off, less what it is.
    said_b = TURNS[row].inv().apply(VELOCITY_N[row]) + FLU_OF_FRD.apply(twists)
    velocity_n = (Rotation.from_rotvec(turn_n) * TURNS[row]).apply(said_b) - VELOCITY_N[row]
    # P speaks of the velocity without what the misalignment turns of the true one: dv = C dv_b - v x phi is that.
    drawn = np.cov(np.hstack([velocity_n, turn_n, moved_n]).T)
    scale = np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
    np.testing.assert_allclose(solution.cov[row] / scale, drawn / scale, atol=0.02)


@pytest.mark.parametrize(
    ("pose", "twist", "told"),
    [
        (np.zeros((6, 6)), np.zeros((6, 6)), ""),
        (np.diag([-1.0, 0, 0, 0, 0, 0]), np.diag([-1.0, 0, 0, 0, 0, 0]), ""),
        (np.diag([-1.0, 1, 1, 1, 1, 1]), np.eye(6), ""),
        (
            np.diag([1.0, 1, 1, 0, 0, 0]),
            np.eye(6),
            "p",
        ),  # without an attitude's, the body's velocity tells nothing of n
        (np.diag([1.0, 1, 1, 1, 1, 1]), np.zeros((6, 6)), "ap"),
        (np.diag([1.0, 1, 0, 1, 1, 1]), np.eye(6), "va"),
        (np.diag([np.nan, 1, 1, 1, 1, 1]), np.eye(6), "va"),
    ],
)
def test_what_is_for_no_covariance_reports_nothing(
    pose: Floats, twist: Floats, told: str, tmp_path: Path
) -> None:
    solution, dive = solution_of(
        tmp_path, "nav_msgs/msg/Odometry", [odometry(i, pose, twist) for i in range(20)]
    )
    known = np.isfinite(solution.cov).all(axis=0)
    blocks = {"v": slice(0, 3), "a": slice(3, 6), "p": slice(6, 9)}
    assert "".join(name for name, block in blocks.items() if known[block, block].all()) == told
    assert not [note for note in dive.notes if note.code == "solution_covariance"]


def growing(order: list[int]) -> list[dict[str, Any]]:
    """Give messages in some order, each with a covariance of its own."""
    poses = [(1 + i) * 1e-4 * full(1, 6) for i in range(len(TIMES))]
    return [odometry(i, poses[i], 1e-2 * full(2, 6)) for i in order]


@pytest.mark.parametrize("swapped", [False, True])
def test_of_many_messages_every_third_covariance_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped: bool
) -> None:
    """Of the messages in the file: where one came late, it stands among the others by its stamp."""
    order = list(range(20))
    if swapped:
        order[9], order[10] = 10, 9
    whole, _ = solution_of(tmp_path, "nav_msgs/msg/Odometry", growing(order))
    monkeypatch.setattr("insdvl_replay.logs.columns.tables.MOST_SAMPLED", 7)
    some, _ = solution_of(tmp_path, "nav_msgs/msg/Odometry", growing(order))
    rows = [0, 3, 6, 10 if swapped else 9, 12, 15, 18]
    np.testing.assert_array_equal(whole.cov_ns, whole.motion.time_ns)
    np.testing.assert_array_equal(some.cov_ns, whole.cov_ns[rows])
    np.testing.assert_array_equal(some.cov, whole.cov[rows])
    np.testing.assert_array_equal(some.motion.mat_nb, whole.motion.mat_nb)


def test_what_is_sampled_follows_the_rows_that_stay() -> None:
    order, places = rows_among(np.array([0, 3, 6]), np.array([6, 2, 0, 1]), 8)
    assert (order.tolist(), places.tolist()) == ([2, 0], [0, 2])


def test_matrices_that_are_no_covariances_are_counted(tmp_path: Path) -> None:
    wrong = np.eye(6)
    wrong[0, 1] = wrong[1, 0] = 2.0
    lost = np.eye(6)
    lost[0, 4] = lost[4, 0] = np.nan
    huge = 1e300 * np.eye(6)
    messages = [
        odometry(i, (wrong, lost, huge)[i % 3] if i < 7 else np.eye(6), np.eye(6))
        for i in range(20)
    ]
    solution, dive = solution_of(tmp_path, "nav_msgs/msg/Odometry", messages)
    np.testing.assert_array_equal(np.isfinite(solution.cov).all(axis=(1, 2)), np.arange(20) >= 7)
    assert [note.count for note in dive.notes if note.code == "solution_covariance"] == [7]


def test_odometry_of_px4_has_positions_where_its_frame_has_a_north(tmp_path: Path) -> None:
    def message(i: int) -> dict[str, Any]:
        x, y, z, w = TURNS[i].as_quat().tolist()
        return {
            "timestamp_sample": 12_345_678 + round(TIMES[i] * 1e6),
            "pose_frame": 2 if i == 5 else 1,
            "position": WAY_N[i],
            "q": np.array([w, x, y, z]),
            "velocity_frame": 3,
            "velocity": TURNS[i].inv().apply(VELOCITY_N[i]),
        }

    solution, _ = solution_of(
        tmp_path, "px4_msgs/msg/VehicleOdometry", [message(i) for i in range(20)]
    )
    assert solution.moved_n is not None
    assert np.flatnonzero(np.isnan(solution.moved_n).any(axis=1)).tolist() == [5]
    np.testing.assert_allclose(
        np.delete(solution.moved_n, 5, axis=0), np.delete(WAY_N, 5, axis=0), atol=1e-6
    )
    assert np.isnan(solution.cov).all()


def test_poses_with_covariances_and_positions_of_a_topic_of_their_own(tmp_path: Path) -> None:
    """A geographic position goes before metres from nowhere."""
    pose = [odometry(i, np.eye(6), np.eye(6)) for i in range(20)]
    messages = [{"header": one["header"], "pose": one["pose"]} for one in pose]
    solution, _ = solution_of(tmp_path, "geometry_msgs/msg/PoseWithCovarianceStamped", messages)
    assert solution.moved_n is not None
    assert np.isfinite(solution.cov[:, 3:, 3:]).all()
    assert np.isnan(solution.cov[:, :3, :3]).all()


def test_stamps_that_go_back_or_repeat_are_noted(tmp_path: Path) -> None:
    messages = [odometry(i, np.eye(6), np.eye(6)) for i in range(20)]
    messages[8], messages[9] = messages[9], messages[8]
    messages[15] = messages[14]
    solution, dive = solution_of(tmp_path, "nav_msgs/msg/Odometry", messages)
    assert {note.code for note in dive.notes} >= {"solution_out_of_order", "solution_repeats"}
    assert len(solution.motion.time_ns) == 19
    assert (np.diff(solution.motion.time_ns) > 0).all()
    assert solution.moved_n is not None
    np.testing.assert_allclose(solution.moved_n, np.delete(WAY_N, 15, axis=0), atol=1e-12)


# --- TUM files


def tum(folder: Path, *lines: str) -> Path:
    file = folder / "own.tum"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_a_tum_file_keeps_every_nanosecond_and_is_sorted(tmp_path: Path) -> None:
    file = tum(
        tmp_path,
        "# a comment",
        "",
        "1700000000.123456789 1 2 3 0 0 0 1",
        "1700000002.000000001 4 5 6 0 0 0 1",
        "1700000001.5 7 8 9 nan nan nan nan",
        "1700000001.5 0 0 0 0 0 0 1",
    )
    solution, notes = read_tum(
        file, Solution(file=str(file), latency_s=0.25), "filters.b.solution"
    )
    assert (solution.motion.time_ns + 250_000_000 - START_NS).tolist() == [
        123_456_789,
        1_500_000_000,
        2_000_000_001,
    ]
    np.testing.assert_array_equal(
        solution.moved_n, [[2.0, 1.0, -3.0], [8.0, 7.0, -9.0], [5.0, 4.0, -6.0]]
    )
    assert np.isfinite(solution.motion.mat_nb).all(axis=(1, 2)).tolist() == [True, False, True]
    assert [(note.code, note.count) for note in notes] == [
        ("solution_out_of_order", 1),
        ("solution_repeats", 1),
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1.0 2 3", "line 2 is no pose: it needs 8 numbers"),
        ("1e99999999 0 0 0 0 0 0 1", "line 2 is no pose"),
        ("inf 0 0 0 0 0 0 1", "line 2 is no pose"),
        ("1.0 0 0 0 0 0 zero 1", "line 2 is no pose"),
        ("nan 0 0 0 0 0 0 1", "line 2 is no pose"),
        ("1e30 0 0 0 0 0 0 1", "line 2 is no pose"),
    ],
)
def test_a_line_that_is_no_pose_is_reported_with_its_number(
    line: str, message: str, tmp_path: Path
) -> None:
    file = tum(tmp_path, "0.5 0 0 0 0 0 0 1", line)
    with pytest.raises(LogError) as caught:
        read_tum(file, Solution(file=str(file)), "filters.b.solution")
    assert message in caught.value.message
    assert "time x y z" in caught.value.hint


def test_a_file_without_a_number_is_refused(tmp_path: Path) -> None:
    file = tum(tmp_path, "1.0 nan nan nan nan nan nan nan", "2.0 nan nan nan nan nan nan nan")
    with pytest.raises(LogError, match="has no number in any of its 2 poses"):
        read_tum(file, Solution(file=str(file)), "filters.b.solution")


@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "large"])
def test_a_solution_is_a_regular_file_of_some_size(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device has no end, and a named pipe is waited for."""
    file = tmp_path / "solution.tum"
    if kind == "device":
        file.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    else:
        file.write_text("0.5 0 0 0 0 0 0 1\n")
        monkeypatch.setattr(reference, "MOST_BYTES", 10)
        monkeypatch.setattr(config_file, "MOST_BYTES", 10)
    with pytest.raises(LogError, match="cannot be read: "):
        read_tum(file, Solution(file=str(file)), "filters.b.solution")
    with pytest.raises(ConfigError, match="cannot be read: "):
        load_config(overrides=[f"filters.b.solution={str(file)!r}"])


def test_a_file_without_poses_or_that_has_changed_is_refused(tmp_path: Path) -> None:
    file = tum(tmp_path, "# nothing")
    with pytest.raises(LogError, match="has no line with a pose"):
        read_tum(file, Solution(file=str(file)), "filters.b.solution")
    with pytest.raises(LogError, match="has changed since the settings were read"):
        read_tum(file, Solution(file=str(file), sha256="0" * 64), "filters.b.solution")
    with pytest.raises(LogError, match="cannot be read"):
        read_tum(tmp_path / "none.tum", Solution(file="none.tum"), "filters.b.solution")
