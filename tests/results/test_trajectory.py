"""Trajectories for evo: the format's definition, and the same numbers as the messages and the tables."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.show.tracks import tum_trajectory

ORIGIN = np.array([32.8 * DEG, 34.9 * DEG, -3.0])


def read(path: Path) -> Floats:
    """Read a file by the format's definition: eight numbers on every line, single spaces, times that rise."""
    lines = path.read_text("ascii").splitlines()
    rows = np.array([[float(word) for word in line.split(" ")] for line in lines])
    assert rows.shape == (len(lines), 8)
    assert np.all(np.diff(rows[:, 0]) > 0)
    return rows


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trajectories")
    log = str(folder / "dive.mcap")
    assert (
        run_command_line(["simulate", "lawnmower", "-o", log, "--duration", "120", "--seed", "3"])
        == 0
    )
    assert run_command_line(["run", log, "-o", str(folder), "--tum"]) == 0
    return folder / "dive"


@pytest.mark.parametrize("name", ["baseline", "aided"])
def test_a_filters_trajectory_is_its_odometry(name: str, result: Path) -> None:
    with (result / "replay.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = [
            message
            for *_, message in reader.iter_decoded_messages(topics=f"/insdvl/{name}/odometry")
        ]
    expected = [
        [
            message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec,
            *(getattr(message.pose.pose.position, axis) for axis in "xyz"),
            *(getattr(message.pose.pose.orientation, axis) for axis in "xyzw"),
        ]
        for message in found
    ]
    np.testing.assert_allclose(read(result / f"filter_{name}.tum"), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", ["baseline", "aided"])
def test_distances_from_the_reference_are_those_of_the_table(name: str, result: Path) -> None:
    """What evo does: pair by time, subtract, and take the root of the mean square; not aligned, horizontal.

    The tables leave out the start, where filter and reference are the same.
    """
    estimate, reference = read(result / f"filter_{name}.tum"), read(result / "reference.tum")
    _, of_estimate, of_reference = np.intersect1d(
        estimate[:, 0], reference[:, 0], return_indices=True
    )
    difference_m = (estimate[of_estimate, 1:3] - reference[of_reference, 1:3])[1:]
    table = pd.read_csv(result / "reference_error.csv").set_index("quantity")
    column = "baseline_rmse" if name == "baseline" else "rmse"
    rms_m = np.sqrt(np.mean(np.sum(difference_m**2, axis=1)))
    assert len(difference_m) == table.loc["position_h", "samples"] > 500
    assert rms_m == pytest.approx(table.loc["position_h", column], rel=1e-3)


def test_axes_are_east_north_up_and_forward_port_up() -> None:
    """A degree of latitude is 110.9 km here, one of longitude 93.6 km; heading east, rolled to starboard."""
    position = ORIGIN + np.array([[0.0, 0.0, 0.0], [1e-3 * DEG, 2e-3 * DEG, -7.0]])
    mat_nb = mat_from_rpy(np.array([[0.1, 0.0, np.pi / 2.0]] * 2))
    text = tum_trajectory(
        np.array([1_700_000_000_000_000_001, 1_700_000_000_500_000_000]), position, mat_nb, ORIGIN
    )
    first, second = text.decode().splitlines()
    assert first.startswith("1700000000.000000001 0 0 0 ")
    time_s, *numbers = map(float, second.split(" "))
    assert time_s == 1_700_000_000.5
    np.testing.assert_allclose(numbers[:3], [2 * 93.65, 110.90, -7.0], rtol=1e-3)
    forward, port = Rotation.from_quat(numbers[3:]).apply(np.eye(3)[:2])
    np.testing.assert_allclose(forward, [1.0, 0.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(port, [0.0, np.cos(0.1), np.sin(0.1)], atol=1e-8)


def test_what_is_missing_is_no_number() -> None:
    position = np.array([ORIGIN, [np.nan, np.nan, 0.0], ORIGIN])
    mat_nb = np.array([np.full((3, 3), np.nan), np.eye(3), np.eye(3)])
    lines = tum_trajectory(np.array([0, 1, 2]), position, mat_nb, ORIGIN).decode().splitlines()
    assert [line.split(" ")[0] for line in lines] == ["0.000000000", "0.000000002"]
    assert lines[0].endswith(" nan nan nan nan")
    assert "nan" not in lines[1]


def test_a_result_without_trajectories_is_replayed_when_they_are_asked_for(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "run",
        str(result.parent / "dive.mcap"),
        "-o",
        str(tmp_path),
        "--preset",
        "fog",
        "--set",
        "dvl.beam_sd_mps=0.006",
    ]
    for more, begins, expected in (
        ([], "wrote", []),
        (
            ["--tum", "--force"],
            "wrote",
            ["filter_aided.tum", "filter_baseline.tum", "reference.tum"],
        ),
        (["--tum"], "unchanged", ["filter_aided.tum", "filter_baseline.tum", "reference.tum"]),
    ):
        assert run_command_line([*arguments, *more]) == 0
        assert capsys.readouterr().err.startswith(begins)
        assert sorted(path.name for path in (tmp_path / "dive").glob("*.tum")) == expected
