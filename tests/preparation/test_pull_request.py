"""The example of a pull request: finite differences tell what was mended, and find what is wrong."""

import copy
import re
from pathlib import Path
from typing import Any

import judged_pull_request
import msgspec
import numpy as np
import pytest
from jacobian import assert_jacobian

from insdvl_replay import Candidate
from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, vector_from_mat
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.sim.dive import simulate_dive

PROJECT = Path(__file__).parents[2]
EXAMPLE = PROJECT / "examples" / "pull_request"
PAGE = PROJECT / "docs" / "pull_request.md"
CHANGES = ("JacobianMended", "OrderMended", "BothMended", "DecayRemoved")
FORCE_B = np.array([[0.3, -0.2, -9.7]])
RATE_B = np.array([[0.02, -0.05, 0.3]])
STEP_S = 1e-3


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))


def made(name: str) -> Any:
    import pull_request

    kind = getattr(pull_request, name)
    assert issubclass(kind, Candidate)
    made_filter = kind()
    made_filter.gravity_n = np.array([0.0, 0.0, 9.8])
    made_filter.earth_rate_n = np.zeros(3)
    return made_filter


def state() -> Any:
    import pull_request

    return pull_request.State(
        np.array([3.0, -2.0, 1.0]),
        np.array([1.5, -0.7, 0.2]),
        mat_from_rpy(np.array([0.1, -0.2, 2.0])),
        np.array([0.01, 0.02, -0.03]),
        np.array([1e-3, -2e-3, 5e-4]),
        np.diag(pull_request.START_VARIANCE),
    )


# --- The Jacobians, each against finite differences of what the filter itself does.


def assert_dvl_jacobian(own: Any) -> None:
    """Compare H with the predicted velocity at states that the filter has corrected by small errors."""
    nominal = state()

    def predicted(errors: Floats) -> Floats:
        true = copy.copy(nominal)
        own.inject(true, errors)
        velocity: Floats = own.predicted_velocity(true)
        return velocity

    assert_jacobian(own.dvl_jacobian(nominal), predicted, np.zeros(15), atol=1e-8)


def assert_dynamics(own: Any) -> None:
    """Compare I + A dt with the errors that small errors are after a step of the filter."""
    nominal = state()

    def after(errors: Floats) -> Floats:
        ends = []
        for start_errors in (np.zeros(15), errors):
            moved = copy.copy(nominal)
            own.inject(moved, start_errors)
            own.propagate(moved, FORCE_B, RATE_B, np.array([STEP_S]))
            ends.append(moved)
        without, true = ends
        turn = vector_from_mat(without.mat_nb.T @ true.mat_nb)
        differences = [
            true.position_n - without.position_n,
            true.velocity_n - without.velocity_n,
            turn,
            true.accel_bias_b - without.accel_bias_b,
            true.gyro_bias_b - without.gyro_bias_b,
        ]
        return np.concatenate(differences)

    force_b = FORCE_B - nominal.accel_bias_b
    rate_b = RATE_B - nominal.gyro_bias_b
    [dynamics] = own.dynamics(nominal.mat_nb[None], force_b, rate_b)
    # Terms of the second order in the step are at most 1e-5.
    assert_jacobian(np.eye(15) + STEP_S * dynamics, after, np.zeros(15), atol=2e-5)


@pytest.mark.parametrize("name", ["JacobianMended", "BothMended", "DecayRemoved"])
def test_the_mended_jacobian_of_the_dvl_is_right(name: str) -> None:
    assert_dvl_jacobian(made(name))


@pytest.mark.parametrize("name", ["AsItIs", "OrderMended"])
def test_the_jacobian_of_the_dvl_is_wrong_before(name: str) -> None:
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        assert_dvl_jacobian(made(name))


def test_where_the_vehicle_is_level_and_heads_north_the_wrong_jacobian_has_the_wrong_sign() -> (
    None
):
    north = state()
    north.mat_nb = np.eye(3)
    before = made("AsItIs").dvl_jacobian(north)[:, 6:9]
    after = made("JacobianMended").dvl_jacobian(north)[:, 6:9]
    np.testing.assert_array_equal(before, -after)
    assert np.abs(after).max() == 1.5


def test_the_dynamics_are_right_once_the_decay_is_removed() -> None:
    assert_dynamics(made("DecayRemoved"))


@pytest.mark.parametrize("name", ["AsItIs", "JacobianMended", "OrderMended", "BothMended"])
def test_the_dynamics_are_wrong_before(name: str) -> None:
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        assert_dynamics(made(name))


def test_without_the_decay_the_order_of_the_biases_is_still_wrong() -> None:
    own = made("DecayRemoved")
    own.order_mended = False
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        assert_dynamics(own)


# --- The other equations.


def test_the_update_is_that_of_the_information_filter() -> None:
    own = made("BothMended")
    nominal = state()
    before = nominal.cov
    jacobian = own.dvl_jacobian(nominal)
    predicted_b = own.predicted_velocity(nominal)
    wanted_b = predicted_b + np.array([0.02, -0.01, 0.03])
    difference_b, innovation_cov = own.update(nominal, wanted_b)
    np.testing.assert_allclose(difference_b, predicted_b - wanted_b, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        innovation_cov, jacobian @ before @ jacobian.T + 1e-4 * np.eye(3), rtol=1e-12
    )
    information = np.linalg.inv(before) + 1e4 * jacobian.T @ jacobian
    np.testing.assert_allclose(nominal.cov, np.linalg.inv(information), rtol=0.0, atol=1e-9)
    left_b = wanted_b - own.predicted_velocity(nominal)
    assert np.linalg.norm(left_b) < 1e-3


def test_noise_is_that_of_each_source_in_its_axes() -> None:
    import pull_request

    mat_nb = state().mat_nb
    shaping = np.zeros((15, 12))
    shaping[3:6, 0:3] = -mat_nb
    shaping[6:9, 3:6] = -np.eye(3)
    shaping[9:15, 6:12] = np.eye(6)
    sd = np.array([0.05, 0.05, 0.1, 0.01, 0.01, 0.02, *[0.001] * 3, *[0.0001] * 3])
    [found] = pull_request.shaped_noise(pull_request.OLD_NOISE, mat_nb[None])
    np.testing.assert_allclose(found, shaping @ np.diag(sd**2) @ shaping.T, rtol=0.0, atol=1e-16)


def test_rotations_are_those_of_the_package() -> None:
    import pull_request

    angles = np.array([[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [0.3, -0.4, 1.2]])
    found = pull_request.exp(angles)
    for own, angle in zip(found, angles, strict=True):
        np.testing.assert_allclose(own, mat_from_vector(angle), rtol=0.0, atol=1e-14)


# --- The filters in the tool.


def replayed(changes: tuple[str, ...]) -> Replay:
    """Replay a short simulated dive through some of the filters."""
    dive = simulate_dive("figure-eight", seed=3, duration_s=150.0, grade="fog", imu_rate_hz=20.0)
    config: Config = load_config("fog")
    filters = {"baseline": Filter(aiding=("velocity",))}
    for name in changes:
        filters[name] = Filter(candidate=f"pull_request:{name}")
    evaluation = Evaluation(starts=1, repeats=False)
    dvl = Dvl(velocity_sd_mps=0.0045)  # as small as the simulated one
    return replay_dive(
        dive,
        msgspec.structs.replace(config, filters=filters, dvl=dvl, evaluation=evaluation),
    )


def rms_m(replay: Replay) -> dict[str, float]:
    """Return the rms error of the horizontal position by filter."""
    found = {}
    for row in replay.tables.reference_error:
        if row.quantity == "position_h":
            found[row.filter] = row.rmse
            found["baseline"] = row.baseline_rmse
    return found


@pytest.mark.nightly
def test_on_a_simulated_dive_the_jacobian_helps_and_the_tuned_filter_is_as_good_as_the_built_in() -> (
    None
):
    replay = replayed(("AsItIs", "JacobianMended", "Tuned"))
    errors_m = rms_m(replay)
    assert errors_m["JacobianMended"] < 0.2 * errors_m["AsItIs"]
    assert errors_m["Tuned"] < 0.5 * errors_m["JacobianMended"]
    assert errors_m["Tuned"] < 1.1 * errors_m["baseline"]
    with_innovations = {row.filter for row in replay.tables.consistency}
    assert with_innovations == {"baseline", "AsItIs", "JacobianMended", "Tuned"}


def test_the_command_of_the_page_changes_each_filter_of_the_settings() -> None:
    settings = load_config(file=EXAMPLE / "filters.toml", allow_code=True)
    own = {name: found for name, found in settings.filters.items() if found.candidate}
    tuned = load_config(file=EXAMPLE / "tuned.toml", allow_code=True)
    assert tuned.filters["tuned"].candidate == "pull_request:DecayRemoved"
    assert {found.candidate for found in own.values()} == {"pull_request:AsItIs"}
    assert settings.evaluation.primary == "position"
    changes = re.findall(
        r"--against filters\.(\w+)\.candidate=pull_request:(\w+)", PAGE.read_text("utf-8")
    )
    assert [name for name, _ in changes] == [*own, "tuned"]
    assert tuple(kind for _, kind in changes) == (*CHANGES, "Tuned")
    written_by = judged_pull_request.CHANGES | judged_pull_request.TUNED
    assert dict(changes) == written_by


@pytest.mark.nightly
def test_the_page_has_the_errors_of_the_real_dives(snapir: Path) -> None:
    cells = {}
    for line in PAGE.read_text("utf-8").splitlines():
        found = re.match(r"\| (snapir_\d+) \| ([\d. |]+) \|$", line)
        if found:
            cells[found[1]] = [float(cell) for cell in found[2].split(" | ")]
    assert len(cells) == 8
    config = load_config(file=[PROJECT / "examples" / "snapir.toml"])
    filters = {"baseline": config.filters["baseline"]}
    names = ("AsItIs", *CHANGES, "Tuned")
    for name in names:
        filters[name] = Filter(candidate=f"pull_request:{name}")
    evaluation = Evaluation(starts=1, repeats=False, primary="position")
    config = msgspec.structs.replace(config, filters=filters, evaluation=evaluation)
    for dive in ("snapir_01", "snapir_02"):
        errors_m = rms_m(replay_log(snapir / f"{dive}.mcap", config))
        found_m = [errors_m[name] for name in (*names, "baseline")]
        np.testing.assert_allclose(found_m, cells[dive], rtol=0.01, atol=0.01)
