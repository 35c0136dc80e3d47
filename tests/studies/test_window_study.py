"""The window study: the DVL's slope against the reference's acceleration."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from insdvl_replay.batch import studies
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.evaluation.reference_errors import (
    acceleration_at,
    reference_acceleration,
    vector_rmse,
)
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs.write import write_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive
from insdvl_replay.studies import window
from insdvl_replay.studies.window import (
    WINDOW_COLUMNS,
    best_windows,
    dive_windows,
    pooled_windows,
    study_window,
)

SNAPIR = Path(__file__).parents[2] / "examples" / "snapir.toml"
PAPER = (SNAPIR, SNAPIR.with_name("paper_noise.toml"))


def body_reference(time_s: Floats, velocity_b: Floats, turn_rate: float = 0.0) -> ReferenceColumns:
    """A reference whose body velocity is given, on a vehicle that turns about down."""
    heading = turn_rate * time_s
    mat_nb = mat_from_rpy(np.stack([0 * heading, 0 * heading, heading], axis=-1))
    position = np.tile([0.5, 0.6, -20.0], (len(time_s), 1))
    velocity_n = np.einsum("kij,kj->ki", mat_nb, velocity_b)
    return ReferenceColumns(np.rint(time_s * 1e9).astype(np.int64), position, velocity_n, mat_nb)


def level_dive(velocity_b: Floats, measured_b: Floats) -> Dive:
    """A dive on a straight line: reference at 5 Hz, pings at 1 Hz, half a reference step beside it."""
    imu_ns = np.arange(0, 10_000_000_001 * 40, 20_000_000)
    imu = ImuColumns(
        imu_ns, np.tile([0.0, 0.0, -9.8], (len(imu_ns), 1)), np.zeros((len(imu_ns), 3))
    )
    reference = body_reference(np.arange(len(velocity_b)) / 5.0, velocity_b)
    ping_ns = 1_100_000_000 + 1_000_000_000 * np.arange(len(measured_b))
    return Dive("level", imu, DvlColumns(ping_ns, velocity_d=measured_b), reference)


def rmse_of(table: pd.DataFrame, at: str, lever_arm: str = "none") -> pd.Series:
    rows = table[(table["at"] == at) & (table["lever_arm"] == lever_arm)]
    return rows.set_index("n")["rmse_mps2"]


# --- The statistics.


def test_acceleration_is_the_rate_of_the_body_velocity_whatever_the_heading_does() -> None:
    time_s = np.cumsum([0.0, 0.2, 0.3, 0.2, 0.1, 0.4, 0.2])
    velocity_b = np.stack(
        [1.0 + 0.1 * time_s + 0.02 * time_s**2, -0.3 * time_s, 0 * time_s], axis=-1
    )
    acceleration_b = reference_acceleration(body_reference(time_s, velocity_b, turn_rate=0.5), 2.5)
    expected = np.stack([0.1 + 0.04 * time_s, np.full_like(time_s, -0.3), 0 * time_s], axis=-1)
    np.testing.assert_allclose(acceleration_b[1:-1], expected[1:-1], rtol=0.0, atol=1e-9)
    assert np.isnan(acceleration_b[[0, -1]]).all()


def test_no_acceleration_next_to_a_pause_or_a_missing_row() -> None:
    time_s = np.array([0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0])
    reference = body_reference(time_s, np.zeros((10, 3)))
    reference.velocity_n[8] = np.nan
    known = np.isfinite(reference_acceleration(reference, max_gap_s=2.5)).all(axis=1)
    # Row 8 itself lies between two known rows; its own velocity does not enter its central difference at even spacing.
    np.testing.assert_array_equal(
        np.delete(known, 8), np.delete([0, 1, 1, 0, 0, 1, 1, 0, 0, 0], 8).astype(bool)
    )
    assert not np.isfinite(
        reference_acceleration(body_reference(time_s[:2], np.zeros((2, 3))), 2.5)
    ).any()


def test_between_rows_the_acceleration_is_on_a_line() -> None:
    row_ns = np.array([0, 1, 2, 3], dtype=np.int64) * 1_000_000_000
    acceleration_b = np.array([[np.nan] * 3, [1.0, 2.0, 3.0], [2.0, 0.0, 3.0], [np.nan] * 3])
    found = acceleration_at(
        np.array([500, 1250, 2000, 4000], dtype=np.int64) * 1_000_000, row_ns, acceleration_b
    )
    np.testing.assert_allclose(found[1], [1.25, 1.5, 3.0], rtol=0.0, atol=1e-12)
    assert np.isnan(found[[0, 3]]).all()


def test_rmse_is_of_the_vectors_length() -> None:
    rows = np.array([True, True, False])
    estimated = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
    assert vector_rmse(estimated, np.zeros((3, 3)), rows) == pytest.approx(np.sqrt(25.0 / 2.0))
    assert np.isnan(vector_rmse(estimated, np.zeros((3, 3)), ~rows & rows))


def test_pooling_gives_each_sample_the_same_weight_and_the_best_is_the_least() -> None:
    rows = [
        ("a", 2, "middle", "none", 1.0, 1),
        ("a", 3, "middle", "none", 2.0, 1),
        ("b", 2, "middle", "none", 3.0, 3),
        ("b", 3, "middle", "none", 0.5, 3),
    ]
    table = pd.DataFrame(rows, columns=WINDOW_COLUMNS)
    pooled = pooled_windows(table)
    assert list(pooled.columns) == WINDOW_COLUMNS
    assert set(pooled["log"]) == {"*"}
    np.testing.assert_allclose(
        pooled["rmse_mps2"], [np.sqrt((1.0 + 3 * 9.0) / 4), np.sqrt((4.0 + 3 * 0.25) / 4)]
    )
    assert list(pooled["samples"]) == [4, 4]
    assert list(best_windows(table)["n"]) == [2, 3]


# --- One dive, against closed forms.


def test_noise_falls_as_the_closed_form_of_a_slope() -> None:
    rng = np.random.default_rng(5)
    sd_mps, n = 0.02, np.arange(2, 9)
    dive = level_dive(np.zeros((1990, 3)), rng.normal(0.0, sd_mps, (390, 3)))
    table, differentiated_s, _ = dive_windows(dive, load_config("levy-klein"), 8)
    expected = sd_mps * np.sqrt(3.0) * np.sqrt(12.0 / (n * (n**2 - 1.0)))
    for at in ("middle", "end"):
        np.testing.assert_allclose(rmse_of(table, at)[n], expected, rtol=0.12)
    assert differentiated_s == pytest.approx(0.4)


def test_steady_jerk_is_met_at_the_middle_and_missed_by_half_a_window_at_the_end() -> None:
    jerk = 1e-3
    reference_s, ping_s = np.arange(1990) / 5.0, 1.1 + np.arange(390)
    forward = np.array([[1.0, 0.0, 0.0]])
    dive = level_dive(
        0.5 * jerk * reference_s[:, None] ** 2 * forward,
        0.5 * jerk * ping_s[:, None] ** 2 * forward,
    )
    table, _, _ = dive_windows(dive, load_config("levy-klein"), 6)
    np.testing.assert_allclose(rmse_of(table, "middle"), 0.0, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        rmse_of(table, "end"), jerk * (np.arange(2, 7) - 1) / 2.0, rtol=0.0, atol=1e-9
    )


def test_all_windows_are_evaluated_at_the_same_pings() -> None:
    measured = np.zeros((390, 3))
    measured[200:203] = np.nan
    table, _, notes = dive_windows(
        level_dive(np.zeros((1990, 3)), measured), load_config("levy-klein"), 10
    )
    assert table["samples"].unique().tolist() == [390 - 3 - 2 * 9]
    assert "dvl_no_velocity" in {note.code for note in notes}


def test_lever_arm_matters_in_turns_and_is_compensated_by_the_gyro() -> None:
    arm = (-1.8, 0.1, 0.3)
    with_arm = load_config(overrides=[f"dvl.lever_arm_m={list(arm)}"])
    turning, _, _ = dive_windows(
        exact_dive("figure-eight", lever_arm_m=arm, dvl_rate_hz=2.0), with_arm, 4
    )
    alone, _, _ = dive_windows(
        exact_dive("figure-eight", dvl_rate_hz=2.0), load_config("levy-klein"), 4
    )
    np.testing.assert_allclose(
        rmse_of(turning, "middle", "compensated"), rmse_of(alone, "middle"), rtol=0.0, atol=1e-5
    )
    assert (rmse_of(turning, "middle", "ignored") > 0.05).all()


def test_velocities_serve_as_well_as_the_beams_they_come_from() -> None:
    dive = exact_dive("figure-eight")
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d = dive.dvl.beam_velocity_mps @ np.linalg.pinv(dive.dvl.beam_vectors_d).T
    beams, _, _ = dive_windows(dive, load_config("levy-klein"), 5)
    velocities, _, _ = dive_windows(
        replace(dive, dvl=DvlColumns(dive.dvl.time_ns, velocity_d=velocity_d)),
        load_config("levy-klein"),
        5,
    )
    np.testing.assert_allclose(beams["rmse_mps2"], velocities["rmse_mps2"], rtol=0.0, atol=1e-9)


# --- What cannot be studied.


def test_dive_without_reference_says_so() -> None:
    dive = replace(exact_dive("straight", duration_s=60.0), reference=None)
    with pytest.raises(LogError, match=r"straight: .*reference") as caught:
        dive_windows(dive, load_config("levy-klein"), 5)
    assert "reference.topic" in caught.value.hint


def test_windows_longer_than_the_dive_say_so() -> None:
    with pytest.raises(LogError, match=r" 60 .* 100 ") as caught:
        dive_windows(exact_dive("straight", duration_s=60.0), load_config("levy-klein"), 100)
    assert "--longest 50" in caught.value.hint


def test_two_logs_of_one_name_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"a/dive\.mcap .*b/dive\.mcap"):
        study_window([Path("a/dive.mcap"), Path("b/dive.mcap")], load_config("levy-klein"))


def test_pause_that_starts_a_window_is_that_of_the_filter() -> None:
    config = load_config(overrides=["filters.aided.acceleration.max_window_gap_s=0.5"])
    with pytest.raises(LogError, match=r"0\.5 s"):
        dive_windows(exact_dive("straight", duration_s=60.0), config, 3)


# --- The command.


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two logs with noise: one with beams, one that turns."""
    folder = tmp_path_factory.mktemp("logs")
    paths = []
    for scenario, seed in (("lawnmower", 1), ("figure-eight", 2)):
        path = folder / f"{scenario}.mcap"
        write_dive(path, simulate_dive(scenario, seed=seed, duration_s=360.0))
        paths.append(str(path))
    return paths


def test_command_writes_the_same_bytes_twice(
    simulated: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        assert (
            run_command_line(
                [
                    "study",
                    "window",
                    *simulated,
                    "-o",
                    str(tmp_path / name),
                    "--longest",
                    "6",
                    "--png",
                ]
            )
            == 0
        )
    assert capsys.readouterr().out
    folders = [tmp_path / name / "window" for name in ("one", "two")]
    names = {path.name for path in folders[0].iterdir()}
    assert names == {
        "window.csv",
        "best.csv",
        "window.svg",
        "window.png",
        "config.toml",
        "report.json",
        "report.html",
    }
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()
    table = pd.read_csv(folders[0] / "window.csv")
    assert list(table.columns) == ["log", "n", "at", "lever_arm", "rmse_mps2", "samples"]
    assert set(table["log"]) == {"*", "lawnmower", "figure-eight"}
    assert msgspec.json.decode((folders[0] / "report.json").read_bytes())["kind"] == "window"


def test_log_that_cannot_be_used_does_not_stop_the_others(
    simulated: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no log at all")
    arguments = [
        "study",
        "window",
        str(broken),
        *simulated,
        "-o",
        str(tmp_path),
        "--longest",
        "4",
        "--format",
        "json",
    ]
    assert run_command_line(arguments) == 3
    printed = capsys.readouterr()
    assert {row["log"] for row in msgspec.json.decode(printed.out)["tables"]["best"]} == {
        "*",
        "lawnmower",
        "figure-eight",
    }
    (left_out,) = (
        note
        for note in msgspec.json.decode(printed.out)["notes"]
        if note["code"] == "log_left_out"
    )
    assert "broken.mcap" in left_out["text"]
    assert printed.err.splitlines()[-1].startswith("error: 1 of 3 ")


def test_no_log_that_can_be_used_is_the_first_ones_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no log at all")
    assert run_command_line(["study", "window", str(broken), "-o", str(tmp_path / "study")]) == 3
    assert "broken.mcap" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


def test_interrupted_command_leaves_nothing(
    simulated: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(studies, "save_result", interrupted)
    assert (
        run_command_line(["study", "window", simulated[0], "-o", str(tmp_path / "study")]) == 130
    )
    assert list(tmp_path.iterdir()) == []


# --- Real dives.


@pytest.fixture(scope="module")
def real(snapir: Path) -> dict[str, pd.DataFrame]:
    config: Config = load_config(file=PAPER)
    report = study_window(sorted(snapir.glob("*.mcap")), config, 10)
    return dict(report.tables)


@pytest.mark.nightly
def test_real_dives_fall_and_rise_with_the_window(real: dict[str, pd.DataFrame]) -> None:
    pooled = real["window"][real["window"]["log"] == "*"]
    middle = rmse_of(pooled, "middle", "compensated")
    best = int(middle.idxmin())
    assert best == 3
    assert middle[2] > 2.0 * middle[best]
    assert middle[10] > 2.0 * middle[best]


def best_of(snapir: Path, *overrides: str) -> pd.DataFrame:
    config = load_config(file=PAPER, overrides=overrides)
    return (
        study_window(sorted(snapir.glob("*.mcap")), config, 10)
        .tables["best"]
        .set_index(["log", "lever_arm", "at"])
    )


def test_real_dives_are_further_off_at_the_end_and_without_lever_arm(
    real: dict[str, pd.DataFrame],
) -> None:
    best = real["best"].set_index(["log", "lever_arm", "at"])
    rmse = best["rmse_mps2"].unstack("at").xs("compensated", level="lever_arm")
    assert (rmse["middle"] < rmse["end"]).all()
    pooled = best["rmse_mps2"].xs("*")
    assert pooled["ignored", "middle"] > 1.05 * pooled["compensated", "middle"]


@pytest.mark.nightly
def test_best_window_at_the_end_depends_on_the_point_of_the_vehicle(snapir: Path) -> None:
    """At the point of the reference, 1.8 m ahead of the IMU, all of the arm is the DVL's."""
    best = best_of(
        snapir, "dvl.lever_arm_m=[-1.834, -0.034, 0.095]", "reference.lever_arm_m=[0, 0, 0]"
    )
    assert best.loc[("*", "compensated", "middle"), "n"] == 3
    assert best.loc[("*", "compensated", "end"), "n"] == 6
    pooled = best["rmse_mps2"].xs("*")
    assert pooled["ignored", "middle"] > 1.5 * pooled["compensated", "middle"]


@pytest.mark.nightly
def test_finer_reference_of_real_dives_prefers_two_velocities(
    snapir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which window is best depends on how a reference of 1 Hz is differentiated: here by a spline, to its full band."""

    def spline_velocity(reference: ReferenceColumns, _: float) -> Floats:
        return np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)

    def spline_rate(time_ns: TimeNs, row_ns: TimeNs, velocity_b: Floats) -> Floats:
        row_s, time_s = seconds(row_ns, row_ns[0]), seconds(time_ns, row_ns[0])
        inside = (time_s > 3.0) & (time_s < row_s[-1] - 3.0)
        return np.where(inside[:, None], CubicSpline(row_s, velocity_b)(time_s, 1), np.nan)

    monkeypatch.setattr(window, "reference_acceleration", spline_velocity)
    monkeypatch.setattr(window, "acceleration_at", spline_rate)
    report = study_window(sorted(snapir.glob("*.mcap")), load_config(file=PAPER), 5)
    best = report.tables["best"].set_index(["log", "lever_arm", "at"])["n"]
    assert best["*", "compensated", "middle"] == 2
