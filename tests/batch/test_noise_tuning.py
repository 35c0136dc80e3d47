"""The control: what the noise is, the innovations tell."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from frames import frame
from scipy import stats

from insdvl_replay.batch.noise_tuning import replay_with_tuned_baseline, with_tuned_baseline
from insdvl_replay.core.config import Config, Dvl, Filter, Noise, Reference, Span
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.history import Innovations
from insdvl_replay.evaluation.consistency import log_likelihood
from insdvl_replay.evaluation.notes import CLASSES
from insdvl_replay.logs import read_dive
from insdvl_replay.preparation.prepared import reference_at_imu
from insdvl_replay.preparation.replay import replay_dive, replay_log
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors, ImuErrors

SNAPIR = tuple(
    Path(__file__).parents[2] / "examples" / name for name in ("snapir.toml", "paper_noise.toml")
)
TRUE = {"accel_white_mps_rts": 3e-3, "gyro_white_rad_rts": 2e-5, "beam_sd_mps": 0.006}
WRONG = Config(
    noise=Noise(accel_white_mps_rts=0.05, gyro_white_rad_rts=1e-6),
    dvl=Dvl(beam_sd_mps=0.02),
    filters={"baseline": Filter(aiding=("velocity",))},
)


@pytest.fixture(scope="module")
def dive() -> Dive:
    """A dive whose noise is white and known."""
    return simulate_dive(
        "figure-eight",
        seed=5,
        imu_rate_hz=50.0,
        dvl_rate_hz=2.0,
        imu_errors=ImuErrors(
            accel_white_mps_rts=TRUE["accel_white_mps_rts"],
            gyro_white_rad_rts=TRUE["gyro_white_rad_rts"],
        ),
        dvl_errors=DvlErrors(
            beam_sd_mps=TRUE["beam_sd_mps"], beam_bias_sd_mps=0.0, beam_scale_sd=0.0
        ),
    )


def test_likelihood_is_that_of_normal_innovations() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    S = root @ root.T
    z = rng.normal(size=(4, 3))
    nis = np.einsum("ki,ij,kj->k", z, np.linalg.inv(S), z)
    times = np.arange(4)
    innovations = Innovations(
        "velocity", "m/s", ("x", "y", "z"), times, times, z, z, np.sqrt(np.diag(S)) * np.ones((4, 1)), nis,
        np.array([True, True, False, True]), np.full(4, np.linalg.slogdet(S)[1]),
        np.inf, 5, np.zeros(4, dtype=bool),
    )  # fmt: skip
    expected = stats.multivariate_normal(np.zeros(3), S).logpdf(z).sum()
    assert log_likelihood(innovations) == pytest.approx(expected, rel=1e-12)


def test_fit_finds_the_noise_that_the_dive_was_made_with(dive: Dive) -> None:
    config, (note,) = with_tuned_baseline(dive, WRONG)
    tuned = config.filters["tuned"]
    assert tuned.accel_white_mps_rts == pytest.approx(TRUE["accel_white_mps_rts"], rel=0.15)
    assert tuned.beam_sd_mps == pytest.approx(TRUE["beam_sd_mps"], rel=0.05)
    assert "[filters.tuned] accel_white_mps_rts = 0.00" in note.text
    assert "edge" not in note.text
    nis = frame(replay_dive(dive, config).tables.consistency).set_index(["filter", "measurement"])
    assert nis.loc[("tuned", "velocity"), "verdict"] == "consistent"
    assert nis.loc[("baseline", "velocity"), "verdict"] == "conservative"


def test_fit_says_where_it_met_the_edge_of_its_range(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("insdvl_replay.batch.noise_tuning.LOWEST", 0.5)
    config, (note, *_) = with_tuned_baseline(dive, WRONG)
    assert config.filters["tuned"].accel_white_mps_rts == pytest.approx(0.5 * 0.05, rel=0.01)
    assert note.text.endswith(": accel_white_mps_rts, gyro_white_rad_rts, beam_sd_mps")


def test_fit_starts_where_the_filters_do_whatever_point_the_reference_is_of(dive: Dive) -> None:
    """In a turn, in which the reference's point is faster than the IMU."""
    assert dive.reference is not None
    arm_m = (1.8, -0.4, 0.3)
    elsewhere = replace(
        dive, reference=reference_at_imu(dive.reference, dive.imu, -np.array(arm_m))
    )
    turning = msgspec.structs.replace(WRONG, span=Span(start_s=105.0, end_s=150.0))
    known = msgspec.structs.replace(turning, reference=Reference(lever_arm_m=arm_m))
    assert with_tuned_baseline(elsewhere, known)[1] == with_tuned_baseline(dive, turning)[1]


def test_fit_reads_the_dive_from_its_first_ping_on(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a deep dive, on whose way down the bottom is out of reach for longer than the fit reads."""
    monkeypatch.setattr("insdvl_replay.batch.noise_tuning.FIT_S", 120.0)
    assert dive.dvl.beam_velocity_mps is not None
    late = slice(300, None)
    reached = replace(
        dive.dvl,
        time_ns=dive.dvl.time_ns[late],
        beam_velocity_mps=dive.dvl.beam_velocity_mps[late],
    )
    config, _ = with_tuned_baseline(replace(dive, dvl=reached), WRONG)
    assert config.filters["tuned"].beam_sd_mps == pytest.approx(TRUE["beam_sd_mps"], rel=0.1)


def test_control_needs_its_name_and_a_baseline_aided_by_velocity(dive: Dive) -> None:
    for filters in (
        {"baseline": Filter(aiding=("velocity",)), "tuned": Filter(aiding=("velocity",))},
        {"baseline": load_config().filters["aided"]},
    ):
        with pytest.raises(ConfigError):
            with_tuned_baseline(dive, Config(filters=filters))


def warnings(notes: tuple[Note, ...]) -> list[Note]:
    return [note for note in notes if note.severity == "warning"]


@pytest.mark.nightly
@pytest.mark.parametrize("preset", ["levy-klein", "own"])
@pytest.mark.parametrize("grade", GRADES)
def test_simulated_imus_are_fitted_within_their_class(grade: str, preset: str) -> None:
    dive = simulate_dive("figure-eight", grade=grade, duration_s=300.0)
    config, notes = with_tuned_baseline(dive, load_config(grade if preset == "own" else preset))
    assert not warnings(notes)
    tuned = config.filters["tuned"]
    for key in ("accel_white_mps_rts", "gyro_white_rad_rts"):
        assert getattr(tuned, key) < CLASSES[key].worst[grade]
    assert f"gyros of class {grade}" in notes[0].text


def test_what_a_wrong_lever_arm_does_is_not_called_noise_of_a_sensor(dive: Dive) -> None:
    """The DVL is at the IMU; in a turn at 3 deg/s an arm of 3 m is 16 cm/s off."""
    turning = msgspec.structs.replace(WRONG, span=Span(start_s=100.0, end_s=250.0))
    wrong = msgspec.structs.replace(
        turning, dvl=msgspec.structs.replace(WRONG.dvl, lever_arm_m=(3.0, 0.0, 0.0))
    )
    assert not warnings(with_tuned_baseline(dive, turning)[1])
    (note,) = warnings(with_tuned_baseline(dive, wrong)[1])
    assert note.code == "control_out_of_class"
    assert "dvl.lever_arm_m" in note.hint


@pytest.mark.nightly
def test_control_makes_real_dives_consistent_and_its_settings_repeat_it(
    snapir: Path, tmp_path: Path
) -> None:
    config = load_config(file=SNAPIR)
    for run in ("02", "05", "12"):
        replay = replay_with_tuned_baseline(snapir / f"snapir_{run}.mcap", config)
        rows = frame(replay.tables.consistency).set_index(["filter", "measurement"])
        assert 0.8 < rows.loc[("tuned", "velocity"), "mean_nis"] / 3.0 < 1.25
        # What gyro and DVL alone disagree by while the vehicle goes straight is 6 to 13 mm/s in these dives; from ping
        # to ping it is less.
        assert 0.002 < (replay.config.filters["tuned"].velocity_sd_mps or 0.0) < 0.013
    (tmp_path / "again.toml").write_text(render_toml(replay.config))
    again = replay_log(snapir / "snapir_12.mcap", load_config(file=tmp_path / "again.toml"))
    assert frame(again.tables.consistency).equals(frame(replay.tables.consistency))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("wrong", "suspect"),
    [
        ((), ""),
        (("dvl.mounting_rpy_deg=[0.0, 0.0, 20.0]",), "gyro_white_rad_rts = "),
        (("dvl.lever_arm_m=[5.0, 0.0, 0.0]",), "gyro_white_rad_rts = "),
        (('dvl.latency_of_dives_s=[["snapir_02", 0.5]]',), "accel_white_mps_rts = "),
    ],
)
def test_wrong_geometry_of_a_real_dive_is_not_called_noise_of_a_sensor(
    snapir: Path, wrong: tuple[str, ...], suspect: str
) -> None:
    config = load_config(file=SNAPIR, overrides=wrong)
    notes = warnings(with_tuned_baseline(read_dive(snapir / "snapir_02.mcap", config), config)[1])
    assert [note.code for note in notes] == (["control_out_of_class"] if suspect else [])
    assert all(suspect in note.text for note in notes)
