"""Physics does not care about the clock, the compass, the names of axes or the rate of the readings."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from frames import frame
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Initial, Vector
from insdvl_replay.core.dive_columns import Dive, Floats, ImuColumns, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, BG, DEG, DV, PHI
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive

LEVER_ARM_M: Vector = (-1.8, 0.3, 0.5)
MOUNTING_RPY_DEG: Vector = (3.0, -2.0, 45.0)
CONFIG = Config(
    dvl=Dvl(lever_arm_m=LEVER_ARM_M, mounting_rpy_deg=MOUNTING_RPY_DEG),
    initial=Initial(uncertainty="settings"),
)
simulate = partial(simulate_dive, lever_arm_m=LEVER_ARM_M, mounting_rpy_deg=MOUNTING_RPY_DEG)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate("figure-eight", seed=5, duration_s=120.0)


@pytest.fixture(scope="module")
def replayed(dive: Dive) -> Replay:
    return replay_dive(dive, CONFIG)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def assert_same(history: History, expected: History) -> None:
    """Hold two histories against each other to the last bit; their times and names may differ."""
    for name in ("position", "velocity_n", "mat_nb", "accel_bias_b", "gyro_bias_b", "sd"):
        np.testing.assert_array_equal(
            getattr(history, name), getattr(expected, name), err_msg=name
        )
    for found, wanted in zip(history.innovations, expected.innovations, strict=True):
        np.testing.assert_array_equal(found.nis, wanted.nis)


def test_the_clock_does_not_matter(dive: Dive, replayed: Replay) -> None:
    later_ns = 86_400_000_000_007
    reference = reference_of(dive)
    later = replace(
        dive,
        imu=replace(dive.imu, time_ns=dive.imu.time_ns + later_ns),
        dvl=replace(dive.dvl, time_ns=dive.dvl.time_ns + later_ns),
        reference=replace(reference, time_ns=reference.time_ns + later_ns),
    )
    shifted = replay_dive(later, CONFIG)
    for history, expected in zip(shifted.histories, replayed.histories, strict=True):
        np.testing.assert_array_equal(history.time_ns, expected.time_ns + later_ns)
        assert_same(history, expected)


def test_like_filters_predict_alike(dive: Dive) -> None:
    like = Filter(aiding=("velocity", "acceleration"), acceleration=Acceleration())
    result = replay_dive(dive, Config(dvl=CONFIG.dvl, filters={"first": like, "second": like}))
    assert_same(*result.histories)
    assert set(frame(result.tables.improvement)["status"]) == {"same"}


def turned_about_down(reference: ReferenceColumns, angle: float) -> ReferenceColumns:
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return replace(
        reference, velocity_n=reference.velocity_n @ turn.T, mat_nb=turn @ reference.mat_nb
    )


def test_the_compass_does_not_matter() -> None:
    exact = exact_dive("straight", lever_arm_m=LEVER_ARM_M, mounting_rpy_deg=MOUNTING_RPY_DEG)
    turned = replace(exact, reference=turned_about_down(reference_of(exact), 90.0 * DEG))
    for before, after in zip(
        replay_dive(exact, CONFIG).histories, replay_dive(turned, CONFIG).histories, strict=True
    ):
        sd, sd_turned = before.sd[-1], after.sd[-1]
        np.testing.assert_allclose(sd_turned[DV], sd[DV][[1, 0, 2]], rtol=1e-3)
        np.testing.assert_allclose(sd_turned[PHI], sd[PHI][[1, 0, 2]], rtol=1e-3)
        np.testing.assert_allclose(sd_turned[BA], sd[BA], rtol=1e-3)
        # The heading's error turns the Earth's rate into the gyro about east, which another axis is now nearer to.
        np.testing.assert_allclose(sd_turned[BG], sd[BG], rtol=0.02)


def renamed(dive: Dive, mat: Floats) -> tuple[Dive, Config]:
    """Give the body other axes: ``vector_new = mat @ vector_b``. The vehicle, the IMU and the DVL stay as they are."""
    reference = reference_of(dive)
    imu = ImuColumns(
        dive.imu.time_ns, dive.imu.specific_force_b @ mat.T, dive.imu.angular_rate_b @ mat.T
    )
    mounting = mat @ Rotation.from_euler("xyz", MOUNTING_RPY_DEG, degrees=True).as_matrix()
    x, y, z = mat @ LEVER_ARM_M
    roll, pitch, heading = rpy_from_mat(mounting) / DEG
    dvl = Dvl(lever_arm_m=(x, y, z), mounting_rpy_deg=(roll, pitch, heading))
    config = Config(dvl=dvl, initial=CONFIG.initial)
    return replace(
        dive, imu=imu, reference=replace(reference, mat_nb=reference.mat_nb @ mat.T)
    ), config


@pytest.mark.parametrize(
    "mat",
    [
        pytest.param(
            np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
            id="x to z, y to x, z to y",
        ),
        pytest.param(np.diag([1.0, -1.0, -1.0]), id="forward-port-up"),
    ],
)
def test_the_names_of_axes_do_not_matter(dive: Dive, replayed: Replay, mat: Floats) -> None:
    result = replay_dive(*renamed(dive, mat))
    for history, expected in zip(result.histories, replayed.histories, strict=True):
        np.testing.assert_allclose(history.velocity_n, expected.velocity_n, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(history.mat_nb, expected.mat_nb @ mat.T, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(
            history.accel_bias_b, expected.accel_bias_b @ mat.T, rtol=0.0, atol=1e-9
        )
        np.testing.assert_allclose(
            history.gyro_bias_b, expected.gyro_bias_b @ mat.T, rtol=0.0, atol=1e-12
        )
        for block in (BA, BG):
            np.testing.assert_allclose(
                history.sd[:, block], expected.sd[:, block] @ np.abs(mat.T), rtol=1e-6
            )


def test_twice_as_many_readings_say_the_same() -> None:
    once, twice = (
        replay_dive(
            exact_dive(
                "figure-eight",
                duration_s=150.0,
                imu_rate_hz=rate_hz,
                lever_arm_m=LEVER_ARM_M,
                mounting_rpy_deg=MOUNTING_RPY_DEG,
            ),
            CONFIG,
        )
        for rate_hz in (100.0, 200.0)
    )
    for before, after in zip(once.histories, twice.histories, strict=True):
        np.testing.assert_allclose(after.sd, before.sd, rtol=1e-3)
        np.testing.assert_allclose(after.velocity_n, before.velocity_n, rtol=0.0, atol=1e-4)


@pytest.mark.nightly
@pytest.mark.parametrize("imu_rate_hz", [50.0, 100.0, 200.0, 400.0])
def test_every_usual_rate_is_replayed_and_more_pings_say_more(imu_rate_hz: float) -> None:
    replays = [
        replay_dive(
            simulate(
                "figure-eight",
                seed=7,
                duration_s=120.0,
                imu_rate_hz=imu_rate_hz,
                dvl_rate_hz=dvl_rate_hz,
            ),
            CONFIG,
        )
        for dvl_rate_hz in (1.0, 2.0, 5.0, 10.0)
    ]
    for replay in replays:
        for errors in replay.errors.values():
            assert np.abs(errors.velocity_error_n).max() < 0.05  # m/s
            assert np.abs(errors.attitude_error_rad).max() < 0.1 * DEG
    for fewer, more in pairwise(replays):
        for before, after in zip(fewer.histories, more.histories, strict=True):
            assert (after.sd[-1] < before.sd[-1]).all()
