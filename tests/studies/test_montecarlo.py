"""The Monte Carlo study: statistics against numpy and scipy, verdicts on worlds that are known, and the command."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matched_sensors import MATCHED
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, multivariate_normal

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config, Dvl, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TruthColumns
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import BA, BG, DEG, DV, MG, PHI, STATES
from insdvl_replay.core.words import Reason
from insdvl_replay.document.paper import figure_png
from insdvl_replay.document.plot import sheet_svg
from insdvl_replay.document.render import save_result
from insdvl_replay.evaluation.credibility import nees
from insdvl_replay.evaluation.ensemble import (
    Ensemble,
    RunErrors,
    Tally,
    montecarlo_table,
    outage_table,
    run_errors,
    verdict_table,
)
from insdvl_replay.evaluation.reference_errors import motion_error
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.sim.dive import START_NS, add_errors, exact_dive
from insdvl_replay.studies.montecarlo import (
    SIGMA,
    drawn_start,
    ensemble_figure,
    make_setup,
    matched_errors,
    repeat_run,
    run_seed,
    simulated_run,
    study_montecarlo,
)

RUNS, DURATION_S = 100, 40.0


# --- Statistics.


def test_nees_is_the_squared_length_of_the_whitened_error() -> None:
    rng = np.random.default_rng(1)
    roots = (
        rng.standard_normal((5, 12, 12)) * 10.0 ** -np.arange(12)[:, None]
    )  # as far apart as SI units set them
    covs, errors = (
        roots @ np.swapaxes(roots, 1, 2),
        rng.standard_normal((5, 12)) * 10.0 ** -np.arange(12),
    )
    expected = [
        np.sum(np.linalg.solve(root, error) ** 2)
        for root, error in zip(roots, errors, strict=True)
    ]
    np.testing.assert_allclose(nees(errors, covs), expected, rtol=1e-9)


def test_nees_is_what_scipys_density_holds_in_its_exponent() -> None:
    rng = np.random.default_rng(2)
    root, error = rng.standard_normal((12, 12)), rng.standard_normal(12)
    normal = multivariate_normal(cov=root @ root.T)
    expected = 2.0 * (normal.logpdf(np.zeros(12)) - normal.logpdf(error))
    assert nees(error[None], (root @ root.T)[None])[0] == pytest.approx(expected, rel=1e-6)


def test_tally_gives_numpys_mean_and_standard_deviation() -> None:
    rng = np.random.default_rng(3)
    runs = [
        one_run(1e6 + rng.standard_normal((4, 12)), rng.random((4, 12)), rng.random(4))
        for _ in range(7)
    ]
    ensemble = tallied(runs)
    errors = np.array([run.error for run in runs])
    assert ensemble.runs == 7
    np.testing.assert_allclose(ensemble.error_mean, errors.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(ensemble.error_sd, errors.std(axis=0, ddof=1), rtol=1e-8)
    np.testing.assert_allclose(ensemble.error_rms, np.sqrt(np.mean(errors**2, axis=0)), rtol=1e-12)
    np.testing.assert_allclose(ensemble.sd, np.sqrt(np.mean([run.var for run in runs], axis=0)))
    np.testing.assert_allclose(ensemble.nees, np.mean([run.nees for run in runs], axis=0))


def one_run(error: Floats, var: Floats, nees_: Floats) -> RunErrors:
    return RunErrors("one", np.arange(len(error), dtype=float), error, var, nees_)


def tallied(runs: list[RunErrors]) -> Ensemble:
    tally = Tally(runs[0])
    for run in runs:
        tally.add(run)
    return tally.ensemble()


def test_errors_have_the_signs_of_the_error_state() -> None:
    """Estimated minus true; a bias is what is left in the readings, so a small estimate leaves a positive one."""
    truth, estimate = (
        at_one_time(velocity=1.0, heading_deg=0.0),
        at_one_time(velocity=1.5, heading_deg=1.0),
    )
    history = History(
        filter="one",
        time_ns=estimate.time_ns,
        updated=np.array([True]),
        position=estimate.position,
        velocity_n=estimate.velocity_n,
        mat_nb=estimate.mat_nb,
        accel_bias_b=np.full((1, 3), 1.0 * MG),
        gyro_bias_b=np.full((1, 3), 3e-6),
        sd=np.ones((1, 12)),
        cov_ns=estimate.time_ns,
        cov=np.eye(12)[None],
        innovations=(),
    )
    biases = TruthColumns(truth.time_ns, np.full((1, 3), 3.0 * MG), np.full((1, 3), 1e-6))
    error = run_errors(history, truth, biases).error[0]
    np.testing.assert_allclose(error[DV], 0.5, atol=0.5 * 1.1 * DEG)  # to first order
    np.testing.assert_allclose(error[PHI], [0.0, 0.0, 1.0 * DEG], atol=1e-12)
    np.testing.assert_allclose(error[BA], 2.0 * MG)
    np.testing.assert_allclose(error[BG], -2e-6)


def test_velocity_error_is_the_one_of_which_p_speaks() -> None:
    """For a turned dive, seen by neither DVL nor IMU, ``dv + v x phi = 0`` holds exactly, however far it is turned."""
    turn, true_n = (
        Rotation.from_rotvec([0.05, -0.02, 0.6]).as_matrix(),
        np.array([[1.2, -0.7, 0.3]]),
    )
    velocity_error_n, misalignment_n = motion_error(
        true_n @ turn.T, turn[None], true_n, np.eye(3)[None]
    )
    np.testing.assert_allclose(misalignment_n, [[0.05, -0.02, 0.6]], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(
        velocity_error_n, -np.cross(true_n @ turn.T, misalignment_n), rtol=0.0, atol=1e-15
    )
    unknown = np.full((1, 3, 3), np.nan)
    velocity_error_n, misalignment_n = motion_error(true_n + 0.1, turn[None], true_n, unknown)
    np.testing.assert_allclose(velocity_error_n, 0.1, rtol=0.0, atol=1e-15)
    assert np.isnan(misalignment_n).all()


def at_one_time(*, velocity: float, heading_deg: float) -> ReferenceColumns:
    heading = mat_from_rpy(np.array([[0.0, 0.0, heading_deg * DEG]]))
    return ReferenceColumns(
        np.array([START_NS]), np.zeros((1, 3)), np.full((1, 3), velocity), heading
    )


def test_ratios_and_improvements_are_those_of_the_last_ping() -> None:
    runs = [np.full((3, 12), sign * 2.0) for sign in (1.0, -1.0)]
    before = tallied([one_run(error, np.full((3, 12), 4.0), np.ones(3)) for error in runs])
    after = replace(before, filter="other", sd=before.sd / 2.0)
    table = montecarlo_table((before, after)).set_index(["filter", "state"])
    assert table.loc[("one", "dv_n"), "ratio"] == pytest.approx(1.0)
    assert table.loc[
        ("other", "dv_n"), ["ratio", "predicted_improvement_pct", "true_improvement_pct"]
    ].tolist() == (pytest.approx([2.0, 50.0, 0.0]))
    assert table.loc["one"]["predicted_improvement_pct"].isna().all()
    assert table.loc[("one", "phi_n"), "final_sd"] == pytest.approx(2000.0), "mrad"


@pytest.mark.parametrize(
    ("mean", "runs", "word"),
    [
        (12.0, 100, "consistent"),
        (13.1, 100, "consistent"),  # significant, but too small to matter
        (13.5, 100, "overconfident"),
        (13.5, 10, "consistent"),  # large, but not significant
        (10.5, 100, "conservative"),
        (30.0, 5, "insufficient data"),
        (np.nan, 100, "not finite"),
    ],
)
def test_verdict_takes_significance_and_size(mean: float, runs: int, word: str) -> None:
    shape = (3, 12)
    ensemble = Ensemble(
        "one", runs, np.arange(3.0), *(np.ones(shape) for _ in range(3)), np.full(3, mean)
    )
    (row,) = verdict_table([ensemble]).itertuples()
    assert row.verdict == word
    outside = not row.low <= mean <= row.high
    assert row.why == (Reason.NEAR if word == "consistent" and outside else "")
    assert row.low == pytest.approx(chi2(12 * runs).ppf(0.025) / runs)
    assert row.high == pytest.approx(chi2(12 * runs).ppf(0.975) / runs)


# --- Worlds.


def test_matched_velocity_noise_is_alike_on_all_axes() -> None:
    _, dvl_errors = matched_errors(Config(dvl=Dvl(velocity_sd_mps=0.05)))
    exact = exact_dive("straight", duration_s=4000.0, imu_rate_hz=2.0)
    dvl = add_errors(exact, matched_errors(Config())[0], dvl_errors, seed=1).dvl
    noise = dvl_velocities(dvl).velocity_b - dvl_velocities(exact.dvl).velocity_b
    np.testing.assert_allclose(np.cov(noise.T), 0.05**2 * np.eye(3), atol=0.05**2 * 0.1)


def test_matched_errors_are_those_of_the_first_filters_q_and_r() -> None:
    first = Filter(aiding=("velocity",), gyro_white_rad_rts=1e-3, beam_sd_mps=0.003)
    imu_errors, dvl_errors = matched_errors(
        replace_filters(MATCHED, {"first": first, **MATCHED.filters})
    )
    assert imu_errors.gyro_white_rad_rts == pytest.approx(1e-3)
    assert imu_errors.accel_white_mps_rts == pytest.approx(5e-3)
    assert imu_errors.accel_bias_sd_mps2 == pytest.approx(3.0 * MG)
    assert (
        imu_errors.accel_quantum_mps2,
        dvl_errors.beam_bias_sd_mps,
        dvl_errors.beam_scale_sd,
    ) == (0.0, 0.0, 0.0)
    assert (dvl_errors.beam_sd_mps, dvl_errors.velocity_sd_mps) == (0.003, 0.0)


def replace_filters(config: Config, filters: dict[str, Filter]) -> Config:
    return Config(noise=config.noise, initial=config.initial, dvl=config.dvl, filters=filters)


def test_start_is_off_by_what_the_configuration_says() -> None:
    world = make_setup("static", MATCHED, "matched", 2.0)
    starts = [drawn_start(world, seed) for seed in range(400)]
    assert world.exact.reference is not None
    turned = np.array([start.mat_nb for start in starts]) @ world.exact.reference.mat_nb[0].T
    misalignment = Rotation.from_matrix(turned).as_rotvec() / DEG
    velocity = (
        np.array([start.velocity_n for start in starts]) - world.exact.reference.velocity_n[0]
    )
    np.testing.assert_allclose(misalignment.std(axis=0), 0.5, rtol=0.15)
    np.testing.assert_allclose(velocity.std(axis=0), 0.1, rtol=0.15)


@pytest.fixture(scope="module")
def verdicts() -> pd.DataFrame:
    """Judge two filters on a world that is as they believe, and the same two where the IMU is far better."""
    told = study_montecarlo("figure-eight", MATCHED, runs=RUNS, duration_s=DURATION_S)[0]
    better = study_montecarlo(
        "figure-eight", load_config("levy-klein"), runs=20, duration_s=DURATION_S, imu="fog"
    )[0]
    tables = [
        told.tables["verdicts"].assign(world="told"),
        better.tables["verdicts"].assign(world="better"),
    ]
    return pd.concat(tables).set_index(["world", "filter"])


@pytest.mark.nightly
def test_verdict_changes_with_the_data_and_not_with_the_filters_name(
    verdicts: pd.DataFrame,
) -> None:
    assert verdicts["verdict"].to_dict() == {
        ("told", "baseline"): "consistent",
        ("told", "published"): "overconfident",
        ("better", "baseline"): "conservative",
        ("better", "aided"): "conservative",
    }


@pytest.mark.nightly
def test_reported_baselines_nees_is_inside_its_interval(verdicts: pd.DataFrame) -> None:
    row = verdicts.loc[("told", "baseline")]
    assert row["low"] < row["mean_nees"] < row["high"]
    assert row["inside_pct"] > 80.0


# --- The study.


@pytest.mark.nightly
def test_any_number_of_jobs_gives_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for jobs in (1, 2):
        folder = tmp_path / str(jobs)
        folder.mkdir()
        report, _ = study_montecarlo("straight", MATCHED, runs=3, duration_s=10.0, jobs=jobs)
        save_result(report, folder, png=True)
        contents.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert contents[0] == contents[1]
    assert set(contents[0]) == {
        "montecarlo.csv", "verdicts.csv", "nees.csv", "ensemble.csv", "runs.csv", "config.toml",
        "report.json", "report.html", "nees.svg", "nees.png",
        *(f"{name}_{states}.{format_}" for name in MATCHED.filters for states in ("navigation", "biases")
          for format_ in ("svg", "png")),
    }  # fmt: skip


def test_nees_is_followed_through_outages() -> None:
    time_s = np.concatenate([[0.0], np.arange(0.4, 100.0)])
    zero = np.zeros((len(time_s), 12))
    ensemble = Ensemble("one", 20, time_s, zero, zero, zero, nees=time_s)
    table = outage_table([ensemble], [(10.0, 20.0), (60.0, 90.0)])
    np.testing.assert_allclose(
        table.drop(columns="filter"),
        [[10.0, 20.0, 9.4, 19.4, 21.4, 79.4, 99.4], [60.0, 90.0, 59.4, 89.4, 91.4, np.nan, 99.4]],
    )


def test_study_has_outages_where_they_are_asked_for() -> None:
    report, _ = study_montecarlo(
        "straight", MATCHED, runs=2, duration_s=20.0, outages=[(5.0, 10.0)]
    )
    assert report.tables["outages"]["filter"].tolist() == list(MATCHED.filters)
    assert report.arguments["outages"] == [[5.0, 10.0]]
    assert "5 to 10 s" in report.title
    sd = (
        report.series["ensemble"]
        .query("filter == 'baseline' and state == 'dv_n'")
        .set_index("time_s")["sd"]
    )
    before, last, after = (float(sd[near_s:].iloc[0]) for near_s in (4.0, 9.0, 10.0))
    assert sd[5.0:10.0].is_monotonic_increasing
    assert last > 2.0 * before
    assert after < last


def test_any_run_can_be_repeated_alone() -> None:
    report, _ = study_montecarlo("straight", MATCHED, runs=3, duration_s=10.0)
    listed = report.series["runs"]
    alone = repeat_run("straight", MATCHED, 2, duration_s=10.0)
    row = listed[(listed["run"] == 2) & (listed["filter"] == "published")].iloc[0]
    again = alone.tables["run"][alone.tables["run"]["filter"] == "published"].iloc[0]
    assert (alone.arguments["run_seed"], again["mean_nees"]) == (row["seed"], row["mean_nees"])
    assert listed["seed"].nunique() == 3


def test_runs_differ_and_a_seed_gives_them_again() -> None:
    assert len({run_seed(seed, run) for seed in range(20) for run in range(1, 21)}) == 400
    world = make_setup("straight", MATCHED, "matched", 5.0)
    first, again, other = (simulated_run(world, seed)[0].error for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first[-1] != other[-1]).all()


def test_ping_without_velocity_leaves_no_hole_in_the_ensemble() -> None:
    """A ping that one run drops is a time of that run all the same."""
    picky = Config(
        noise=MATCHED.noise, initial=MATCHED.initial, dvl=Dvl(max_beam_residual_mps=0.005)
    )
    runs = [simulated_run(make_setup("straight", picky, "fog", 20.0), seed)[0] for seed in (1, 2)]
    assert [len(run.time_s) for run in runs] == [21, 21]


def test_unknown_names_are_reported_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="'matchd'") as caught:
        make_setup("straight", MATCHED, "matchd")
    assert "matched" in caught.value.hint
    with pytest.raises(ConfigError, match="'strait'"):
        make_setup("strait", MATCHED, "matched")


def test_work_is_given_back_in_order_and_ends_at_the_first_error() -> None:
    assert list(parallel_map(lambda number: number * number, range(50), jobs=4)) == [
        number * number for number in range(50)
    ]
    done = []

    def work(number: int) -> int:
        if number == 3:
            raise ValueError("three")
        time.sleep(0.01)
        done.append(number)
        return number

    with pytest.raises(ValueError, match="three"):
        list(parallel_map(work, range(1000), jobs=2))
    assert len(done) < 100


# --- Pictures.


@pytest.mark.nightly
def test_picture_is_drawn_in_shown_units_and_to_the_same_bytes() -> None:
    rng = np.random.default_rng(5)
    columns = [np.arange(30.0), *(rng.random((30, 12)) for _ in range(3))]
    figure = ensemble_figure("title", STATES[6:], *columns)
    assert sheet_svg(figure) == sheet_svg(ensemble_figure("title", STATES[6:], *columns))
    assert ET.fromstring(sheet_svg(figure)).tag.endswith("svg")
    assert figure_png(figure) == figure_png(figure)
    panel = figure.panels[0]
    assert panel.title.endswith(", x [mg]")
    curves = {curve.style: curve for curve in panel.curves}
    assert len(curves) == 3, "told without colour"
    np.testing.assert_allclose(curves[SIGMA].y, columns[1][:, 6] / MG)


# --- The command.


def test_command_writes_a_folder_once_and_prints_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "study",
        "montecarlo",
        "straight",
        "--runs",
        "2",
        "--duration",
        "5",
        "-o",
        str(tmp_path),
    ]
    assert run_command_line(arguments) == 0
    said = capsys.readouterr()
    assert re.search("^baseline: .*few", said.out, re.MULTILINE)
    assert re.search("straight, 5 s, 2 runs, .*matched, .*1", said.out)
    assert said.err.endswith(f"wrote {tmp_path / 'montecarlo-straight'}\n")
    report = json.loads((tmp_path / "montecarlo-straight" / "report.json").read_text())
    assert [row["filter"] for row in report["tables"]["verdicts"]] == ["baseline", "aided"]
    assert report["arguments"] == {
        "scenario": "straight",
        "duration_s": 5.0,
        "imu": "matched",
        "seed": 1,
        "runs": 2,
        "outages": [],
    }
    assert run_command_line(arguments) == 2
    assert "exists" in capsys.readouterr().err
    assert run_command_line([*arguments, "--force"]) == 0


@pytest.mark.parametrize("format_", ["table", "json", "csv", "md", "latex"])
def test_one_run_is_printed_in_every_format_and_writes_nothing(
    format_: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = [
        "study",
        "montecarlo",
        "straight",
        "--run",
        "7",
        "--duration",
        "5",
        "--format",
        format_,
    ]
    assert run_command_line(arguments) == 0
    printed = capsys.readouterr().out
    assert printed.endswith("\n")
    assert "aided" in printed
    assert max(map(len, printed.splitlines())) <= 80 or format_ != "table"
    assert not list(tmp_path.iterdir())


@pytest.mark.nightly
def test_interruption_leaves_nothing_and_ends_at_once(tmp_path: Path) -> None:
    arguments = [
        "study",
        "montecarlo",
        "lawnmower",
        "--runs",
        "1000",
        "--jobs",
        "2",
        "-o",
        str(tmp_path / "out"),
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "insdvl_replay", *arguments],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )
    time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30.0)
    assert process.returncode == 130
    assert said == "error: interrupted\n"
    assert not list(tmp_path.iterdir())
