"""The filter as plain Python, for a debugger, is the filter that was compiled."""

import os
import subprocess
import sys
from inspect import isfunction
from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config import Config
from insdvl_replay.core.history import History
from insdvl_replay.nav import filter as nav_filter
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

COLUMNS = ("position", "velocity_n", "mat_nb", "accel_bias_b", "gyro_bias_b", "sd")


def histories() -> tuple[History, ...]:
    dive = simulate_dive("figure-eight", seed=2, duration_s=5.0, imu_rate_hz=50.0, dvl_rate_hz=2.0)
    return replay_dive(dive, Config()).histories


def save(path: Path) -> None:
    assert isfunction(nav_filter._run), "the filter was compiled all the same"
    columns = {
        f"{history.filter}.{name}": getattr(history, name)
        for history in histories()
        for name in COLUMNS
    }
    np.savez(path, **columns)


@pytest.mark.nightly
def test_plain_python_gives_what_the_compiled_filter_gives(tmp_path: Path) -> None:
    path = tmp_path / "uncompiled.npz"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, __file__, str(path)], env=environment, check=True)
    with np.load(path) as uncompiled:
        for history in histories():
            for name in COLUMNS:
                expected = getattr(history, name)
                found = uncompiled[f"{history.filter}.{name}"]
                np.testing.assert_allclose(
                    found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max(), err_msg=name
                )


if __name__ == "__main__":
    save(Path(sys.argv[1]))
