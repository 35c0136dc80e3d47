"""The examples of filters, measurements and noise of the user's, run as their pages say."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import NS_PER_S, Dive
from insdvl_replay.logs import write_dive
from insdvl_replay.nav.user_candidate import CandidateStart
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive

EXAMPLES = Path(__file__).parents[2] / "examples" / "candidates"
WEIGHTS = Path(__file__).resolve().parents[3] / "shared" / "data" / "beamsnet"
ARM_M = (0.5, -0.2, 0.3)


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive(
        "figure-eight", seed=3, duration_s=300.0, grade="mems", imu_rate_hz=50.0, lever_arm_m=ARM_M
    )


def replayed(dive: Dive, mine: Filter) -> Replay:
    config: Config = load_config("mems")
    filters = {"baseline": Filter(aiding=("velocity",)), "mine": mine}
    dvl = Dvl(lever_arm_m=ARM_M)
    return replay_dive(
        dive,
        msgspec.structs.replace(config, filters=filters, dvl=dvl, evaluation=Evaluation(starts=1)),
    )


# --- A filter in C++.


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> str:
    if (compiler := shutil.which("c++")) is None:
        pytest.skip("needs a compiler of C++")
    program = str(tmp_path_factory.mktemp("c++") / "error_state_filter")
    source = str(EXAMPLES / "error_state_filter.cpp")
    subprocess.run(
        [compiler, "-O1", "-Wall", "-Wextra", "-Werror", "-std=c++17", "-o", program, source],
        check=True,
    )
    return program


def test_the_filter_in_cpp_is_as_good_as_the_baseline_with_the_same_noise(
    compiled: str, dive: Dive
) -> None:
    noise = load_config("mems").noise
    densities = (
        str(noise.accel_white_mps_rts),
        str(noise.gyro_white_rad_rts),
        str(Dvl().velocity_sd_mps),
    )
    replay = replayed(
        dive, Filter(program=(compiled, "{dive}", "{start}", "{solution}", *densities))
    )
    rows = {row.quantity: row for row in replay.tables.evidence if row.filter == "mine"}
    assert rows["drift_30s"].ratio == pytest.approx(1.0, abs=0.1)
    assert rows["outage_30s"].ratio == pytest.approx(1.0, abs=0.1)
    sizes = {
        row.filter: row.mean_nees
        for row in replay.tables.credibility
        if row.quantity == "attitude"
    }
    assert sizes["mine"] == pytest.approx(sizes["baseline"], rel=0.2)


def test_the_filter_in_cpp_reports_a_file_that_it_cannot_read(
    compiled: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [compiled, "nowhere", "nowhere", "x"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (1, "cannot read nowhere\n")


# --- Noise by a schedule.


def test_scheduled_noise_is_better_where_accelerometers_shake() -> None:
    quiet = simulate_dive(
        "figure-eight", seed=3, duration_s=900.0, grade="mems", imu_rate_hz=50.0, lever_arm_m=ARM_M
    )
    since_s = (quiet.imu.time_ns - quiet.imu.time_ns[0]) / NS_PER_S
    shaking = (since_s % 100.0 > 60.0)[:, None] * np.random.default_rng(3).standard_normal(
        (len(since_s), 3)
    )
    dive = replace(
        quiet, imu=replace(quiet.imu, specific_force_b=quiet.imu.specific_force_b + 10.0 * shaking)
    )
    replay = replayed(
        dive, Filter(aiding=("velocity",), noise_factors="scheduled_noise:ByVibration")
    )
    ratios = {row.quantity: row.ratio for row in replay.tables.evidence if row.filter == "mine"}
    for quantity in ("position", "outage_60s", "drift_60s", "velocity_along", "level", "heading"):
        assert ratios[quantity] < 0.75, quantity


# --- A network.


@pytest.fixture
def weights(monkeypatch: pytest.MonkeyPatch) -> Path:
    if not WEIGHTS.is_dir():
        pytest.skip("needs ../shared/data/beamsnet (published weights)")
    monkeypatch.setenv("BEAMSNET_WEIGHTS", str(WEIGHTS / "BeamsNetV2.pkl"))
    return WEIGHTS


def test_the_network_takes_out_the_scale_that_it_was_trained_with(weights: Path) -> None:
    import beamsnet

    true = np.load(weights / "V_test.npy").T
    noise = 0.0042 * np.random.default_rng(0).standard_normal((len(true), 4))
    beams = 1.007 * true @ beamsnet.BEAMS.T + noise
    found = beamsnet.velocity(beamsnet.load_weights(weights / "BeamsNetV2.pkl"), beams)
    solved = beams[3:] @ np.linalg.pinv(beamsnet.BEAMS).T
    speeds = (
        np.linalg.norm(velocity, axis=1) for velocity in (found, solved, solved / 1.007, true[3:])
    )
    network, least_squares, scaled, exact = speeds
    rms_mps = [
        float(np.sqrt(np.mean((speed - exact) ** 2))) for speed in (network, least_squares, scaled)
    ]
    assert rms_mps[0] < 0.8 * rms_mps[1]
    assert rms_mps[2] < rms_mps[0]


@pytest.mark.nightly
def test_the_network_is_evaluated_as_a_measurement(weights: Path, dive: Dive) -> None:
    replay = replayed(dive, Filter(aiding=("beamsnet:BeamsNet",), states=()))
    assert "user_measurement_jacobian" not in {note.code for note in replay.notes}
    assert "mine" not in replay.verdicts["mine"].reason, (
        "nothing is wrong with the network's filter"
    )
    assert "beamsnet" in {row.measurement for row in replay.tables.consistency}


# --- A node of ROS 2, with a stand-in for its command.

NODE = """
import os, pathlib, signal, sys, time
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
try:
    time.sleep(60)
finally:
    pathlib.Path("node").write_text(os.environ.get("WORKSPACE", "none"))
"""
# The true `ros2 run` waits for its node, too, and does not pass signals on to it.
ROS2 = """#!{python}
import pathlib, shutil, signal, subprocess, sys, time
words = sys.argv[1:]
if words[:2] == ["run", "robot_localization"]:
    node = subprocess.Popen([sys.executable, "-c", {node!r}])
    while node.returncode is None:
        try:
            node.wait()
        except KeyboardInterrupt:
            pass
    sys.exit(0)
if words[:2] == ["bag", "play"]:
    sys.exit(not words[-1].endswith("dive.mcap"))
signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
if words[:2] == ["bag", "record"]:
    bag = pathlib.Path(words[words.index("--output") + 1])
    bag.mkdir()
    shutil.copy({recorded!r}, bag / "bag_0.mcap")
time.sleep(60)
"""


@pytest.mark.nightly
@pytest.mark.parametrize("workspace", ["", "before", "after"])
def test_the_node_of_ros_2_is_played_to_and_recorded(
    workspace: str, dive: Dive, tmp_path: Path
) -> None:
    assert dive.reference is not None
    write_dive(tmp_path / "dive.mcap", replace(dive, reference=None))
    write_dive(tmp_path / "recorded.mcap", dive)
    (tmp_path / "ros2").write_text(
        ROS2.format(python=sys.executable, node=NODE, recorded=str(tmp_path / "recorded.mcap"))
    )
    (tmp_path / "ros2").chmod(0o755)
    start = CandidateStart(
        dive.reference.position[0],
        dive.reference.velocity_n[0],
        dive.reference.mat_nb[0],
        np.eye(12),
    )
    (tmp_path / "start.json").write_bytes(start.to_json())
    words = [sys.executable, str(EXAMPLES / "ros2_node.py"), "dive.mcap", "start.json", "solution"]
    if workspace:
        setup = tmp_path / workspace / "setup.bash"
        setup.parent.mkdir()
        setup.write_text(f"export WORKSPACE={workspace}\n")
        words.append(f"./{workspace}/setup.bash")
    subprocess.run(
        words,
        cwd=tmp_path,
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        check=True,
    )
    assert (tmp_path / "solution").read_bytes() == (tmp_path / "recorded.mcap").read_bytes()
    assert (tmp_path / "node").read_text() == (workspace or "none"), "the node itself was stopped"
