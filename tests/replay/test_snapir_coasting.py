"""What withheld velocities say of filters on the real dives of the AUV Snapir, where no reference is needed."""

from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.outage_test import window_ends
from insdvl_replay.preparation.prepared import (
    prepare_dive,
    read_checked_dive,
    with_reference_at_imu,
)
from insdvl_replay.preparation.run import plan_runs, run_candidates

CONFIG = Path(__file__).parents[2] / "examples" / "snapir.toml"
RUNS = ("01", "02", "05", "07", "08", "09", "11", "12")
ARM_OF_THE_REFERENCE = "dvl.lever_arm_m=[-1.834, -0.034, 0.095]"


def drifts_m(snapir: Path, preset: str, *overrides: str) -> dict[str, Floats]:
    """Horizontal drift of each filter after a minute, in windows every 30 s of all dives."""
    files = [CONFIG, *([CONFIG.with_name("paper_noise.toml")] if preset == "levy-klein" else [])]
    config = load_config(preset, files, overrides)
    drifts: dict[str, list[Floats]] = {}
    for run in RUNS:
        dive = with_reference_at_imu(
            read_checked_dive(snapir / f"snapir_{run}.mcap", config), config
        )
        start = prepare_dive(dive, config)
        plan = plan_runs(dive, start, config, starts=0)
        coasts = run_candidates(dive, start, plan, config).outages
        for name in coasts.runs:
            drifts.setdefault(name, []).append(
                window_ends(coasts, name, plan.windows.shown).drift_m
            )
    return {name: np.concatenate(of_dives) for name, of_dives in drifts.items()}


@pytest.fixture(scope="module")
def levy_klein(snapir: Path) -> dict[str, Floats]:
    return drifts_m(snapir, "levy-klein")


@pytest.mark.nightly
def test_a_minute_without_velocities_costs_less_than_a_metre(
    levy_klein: dict[str, Floats],
) -> None:
    assert len(levy_klein["baseline"]) == 64
    assert 0.5 < np.median(levy_klein["baseline"]) < 1.0
    assert 0.5 < np.median(levy_klein["windowed"]) < 1.0


def test_published_accelerations_leave_a_filter_that_cannot_coast(
    levy_klein: dict[str, Floats],
) -> None:
    assert np.median(levy_klein["published"]) > 30.0
    assert np.mean(levy_klein["published"] > levy_klein["baseline"]) > 0.95


@pytest.mark.nightly
def test_wrong_arm_of_the_dvl_shows_without_a_reference(snapir: Path) -> None:
    right, wrong = drifts_m(snapir, "fog"), drifts_m(snapir, "fog", ARM_OF_THE_REFERENCE)
    assert np.median(wrong["baseline"]) > 3.0 * np.median(right["baseline"])
