"""Tables and logs as trajectories."""

from pathlib import Path

import numpy as np
import pytest
from made_tracks import RATE_HZ, START_S, error_m, truth_m, write_odometry, write_tum

from insdvl_replay import compare_trajectories
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import DEG
from insdvl_replay.logs.columns.named_columns import trajectory_columns
from insdvl_replay.logs.trajectory import read_trajectory
from insdvl_replay.trajectories.comparison import TrajectoryComparison

COUNT = 400


def write_csv(path: Path, titles: str, columns: Floats) -> Path:
    lines = [titles]
    for row, values in enumerate(columns):
        cells = [f"{START_S + row / RATE_HZ:.3f}", *(f"{value:.12g}" for value in values)]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def local_columns(track_m: Floats, sd_m: float | None = None) -> Floats:
    quat = np.tile([0.0, 0.0, 0.1, 0.99498744], (len(track_m), 1))
    parts = [track_m, quat]
    if sd_m is not None:
        parts.append(np.full((len(track_m), 3), sd_m))
    return np.hstack(parts)


def compared(old: Path, new: Path, truth: Path) -> TrajectoryComparison:
    comparison: TrajectoryComparison = compare_trajectories(old, new, truth).content.data
    return comparison


@pytest.mark.parametrize(
    ("names", "fields"),
    [
        ("t x y z qx qy qz qw", {"local_position": "x, y, z", "quaternion": "qx, qy, qz, qw"}),
        (
            "time p_rs_r_x p_rs_r_y p_rs_r_z q_rs_w q_rs_x q_rs_y q_rs_z",
            {
                "local_position": "p_rs_r_x, p_rs_r_y, p_rs_r_z",
                "quaternion": "q_rs_x, q_rs_y, q_rs_z, q_rs_w",
            },
        ),
        ("time north_m east_m down_m yaw", {"local_position": "north_m, east_m, down_m"}),
        (
            "time lat lon height roll pitch yaw vn ve vd",
            {
                "latitude": "lat",
                "longitude": "lon",
                "height": "height",
                "roll": "roll",
                "pitch": "pitch",
                "heading": "yaw",
                "velocity_n": "vn, ve, vd",
            },
        ),
        ("time voltage current", {}),
    ],
)
def test_columns_are_known_by_their_names(names: str, fields: dict[str, str]) -> None:
    assert trajectory_columns(names.split()).fields == fields


def test_a_table_and_a_tum_file_are_the_same_trajectory(tmp_path: Path) -> None:
    track = truth_m(0)
    table = write_csv(
        tmp_path / "a.csv", "time [s],x [m],y [m],z [m],qx,qy,qz,qw", local_columns(track)
    )
    tum = write_tum(tmp_path / "a.tum", track, yaw=2.0 * np.arcsin(0.1))
    ours, _ = read_trajectory(table)
    theirs, _ = read_trajectory(tum)
    assert ours.moved_n is not None
    assert theirs.moved_n is not None
    assert np.array_equal(ours.motion.time_ns, theirs.motion.time_ns)
    np.testing.assert_allclose(ours.moved_n, theirs.moved_n, atol=1e-9)
    np.testing.assert_allclose(ours.motion.mat_nb, theirs.motion.mat_nb, atol=1e-8)


def test_centimetres_in_a_title_and_names_of_axes_are_read(tmp_path: Path) -> None:
    track = truth_m(0)
    ned = track[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    table = write_csv(tmp_path / "a.csv", "time [s],north,east,down", ned)
    ours, _ = read_trajectory(table)
    theirs, _ = read_trajectory(write_tum(tmp_path / "a.tum", track))
    assert ours.moved_n is not None
    assert theirs.moved_n is not None
    np.testing.assert_allclose(ours.moved_n, theirs.moved_n, atol=1e-8)


def test_standard_deviations_give_nees_and_a_score(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    titles = "time [s],x,y,z,qx,qy,qz,qw,x_sd,y_sd,z_sd"
    track = truth_m(0)
    write_tum(tmp_path / "truth.tum", track)
    noise = rng.normal(0.0, 0.5, (COUNT, 3))
    old = write_csv(tmp_path / "old.csv", titles, local_columns(track + noise, 0.5))
    new = write_csv(tmp_path / "new.csv", titles, local_columns(track + noise, 0.05))
    comparison = compared(old, new, tmp_path / "truth.tum")
    rows = {row.filter: row for row in comparison.credibility if row.quantity == "position"}
    assert rows["old"].mean_nees == pytest.approx(3.0, rel=0.15)
    assert rows["new"].mean_nees == pytest.approx(300.0, rel=0.15)
    assert (rows["old"].verdict, rows["new"].verdict) == ("consistent", "overconfident")
    [score] = [row for row in comparison.evidence if row.quantity == "position_crps"]
    assert score.ratio is not None
    assert score.ratio > 1.1


def test_positions_on_earth_against_metres_begin_at_the_reference(tmp_path: Path) -> None:
    track = truth_m(0)
    truth = write_tum(tmp_path / "truth.tum", track)
    radius_m = 6_371_000.0
    paths = list[Path]()
    for name, ratio in (("old", 1.0), ("new", 0.5)):
        moved = track + ratio * error_m(0)
        latitude = 0.0 + moved[:, 1] / (radius_m * DEG)
        longitude = 8.0 + moved[:, 0] / (radius_m * DEG)
        columns = np.column_stack([latitude, longitude, moved[:, 2]])
        titles = "time [s],latitude [deg],longitude [deg],height [m]"
        paths.append(write_csv(tmp_path / f"{name}.csv", titles, columns))
    comparison = compared(*paths, truth)
    texts = [note.text for note in comparison.notes if note.code == "trajectory_origin"]
    assert [text.partition(" ")[0] for text in texts] == ["old", "new"]
    [row] = [row for row in comparison.evidence if row.quantity == "position"]
    # The Earth is no sphere, so that positions are off by up to a percent of the track.
    assert row.baseline is not None
    assert row.baseline < 4.0


def test_angles_that_may_be_radians_are_noted(tmp_path: Path) -> None:
    columns = np.column_stack([truth_m(0), np.zeros((COUNT, 2)), np.full(COUNT, 1.2)])
    table = write_csv(tmp_path / "a.csv", "time [s],x,y,z,roll,pitch,yaw", columns)
    _, notes = read_trajectory(table)
    assert "trajectory_angle_unit" in [note.code for note in notes]
    table = write_csv(
        tmp_path / "b.csv", "time [s],x,y,z,roll [rad],pitch [rad],yaw [rad]", columns
    )
    found, notes = read_trajectory(table)
    assert "trajectory_angle_unit" not in [note.code for note in notes]
    assert np.arctan2(*found.motion.mat_nb[0, 1::-1, 0]) == pytest.approx(1.2)


def test_quaternions_of_another_length_and_missing_positions_are_noted(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("1.0 0 0 0 0 0 0 0.5\n2.0 nan 0 0 0 0 0 1\n3.0 0 0 0 0 0 0 1\n", "utf-8")
    _, notes = read_trajectory(path)
    assert [note.code for note in notes] == ["tum_without_position", "quaternion_length"]


def test_nanoseconds_in_a_tum_file_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("1403636580838555648 0 0 0 0 0 0 1\n", "utf-8")
    with pytest.raises(LogError, match="no number of seconds"):
        read_trajectory(path)


def test_a_table_without_a_trajectory_names_its_columns(tmp_path: Path) -> None:
    table = write_csv(tmp_path / "a.csv", "time [s],volts", np.ones((50, 1)))
    with pytest.raises(LogError, match="time, volts"):
        read_trajectory(table)


@pytest.mark.parametrize(
    "line",
    [
        "1.5 1 2 3 0 0 0 1",
        "1700000000.000000001 1 2 3 0 0 0 1",
        "1.5e0 1 2 3 0 0 0 1",
        " 7 1 2 3 0 0 0 1",
        "1.5,1,2,3,0,0,0,1",
        "-1.25 1 2 3 0 0 0 1",
    ],
)
def test_times_are_exact_however_they_are_written(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(f"# comment\n{line}\n\n", "utf-8")
    found, _ = read_trajectory(path)
    whole, _, fraction = line.replace(",", " ").split()[0].partition(".")
    if "e" in fraction:
        fraction = fraction.partition("e")[0]
    wanted = int(whole) * 10**9 + (-1 if whole.startswith("-") else 1) * int(
        fraction.ljust(9, "0")
    )
    assert found.motion.time_ns.tolist() == [wanted]


# --- Topics of logs.


@pytest.mark.nightly
def test_topics_of_logs_are_compared_dive_by_dive(tmp_path: Path) -> None:
    for number in range(3):
        write_odometry(tmp_path / "dives" / f"dive_{number}.mcap", number)
    dives = tmp_path / "dives"
    found = compare_trajectories(f"{dives}:/odom_old", f"{dives}:/odom_new", f"{dives}:/truth")
    comparison: TrajectoryComparison = found.content.data
    [answer] = comparison.answers
    row = answer.decisive
    assert row is not None
    assert (answer.filter, answer.baseline, answer.dives) == ("odom_new", "odom_old", 3)
    assert row.ratio == pytest.approx(0.5, rel=1e-9)
    assert {row.filter for row in comparison.credibility} == {"odom_new", "odom_old"}


def test_a_log_with_several_trajectories_needs_a_topic(tmp_path: Path) -> None:
    path = write_odometry(tmp_path / "dive.mcap", 0)
    with pytest.raises(LogError, match="several trajectories") as refusal:
        read_trajectory(path)
    assert refusal.value.hint.endswith("dive.mcap:/odom_old")
    with pytest.raises(LogError, match="/odom_ne"):
        read_trajectory(path, "/odom_ne")
