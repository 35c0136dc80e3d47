"""A heading whose error is slow, as that of an AHRS or a compass: with the state for it, and without."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, PHI
from insdvl_replay.core.words import Consistency, Reason, Severity
from insdvl_replay.nav.levelling import Start, with_more_states
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

SLOW_SD_DEG, SLOW_S, WHITE_SD_DEG = 2.0, 200.0, 0.3
AIDED = 'aiding = ["velocity", "heading"]'
FILTERS = (
    'filters.baseline={aiding = ["velocity"]}',
    f"filters.aided={{{AIDED}}}",
    f'filters.estimating={{{AIDED}, states = ["heading_bias"]}}',
)


def slow_error(seed: int, seconds: int) -> Floats:
    """A Gauss-Markov process, once a second, rad."""
    rng, kept = np.random.default_rng(seed), np.exp(-1.0 / SLOW_S)
    error = np.empty(seconds)
    error[0] = rng.standard_normal()
    for i in range(1, seconds):
        error[i] = kept * error[i - 1] + np.sqrt(1.0 - kept**2) * rng.standard_normal()
    return SLOW_SD_DEG * DEG * error


def dive_with_slow_heading(seed: int, *, is_slow: bool = True) -> Dive:
    heading = {"heading": SensorErrors(WHITE_SD_DEG, 1.0)}
    dive = simulate_dive(
        "lawnmower", seed=seed, duration_s=600.0, grade="mems", imu_rate_hz=20.0, sensors=heading
    )
    read = dive.sensors["heading"]
    error = slow_error(seed, len(read.values)) if is_slow else np.zeros(len(read.values))
    return replace(
        dive, sensors={"heading": replace(read, values=read.values + error[:, None], mat_nb=None)}
    )


def replayed(dive: Dive, told_sd_deg: float = WHITE_SD_DEG, *settings: str) -> Replay:
    told = (
        f"heading.sd_deg={told_sd_deg}",
        f"heading.bias_sd_deg={SLOW_SD_DEG}",
        f"heading.bias_time_s={SLOW_S}",
        "evaluation.starts=1",
    )
    return replay_dive(dive, load_config("mems", overrides=[*FILTERS, *told, *settings]))


def heading_nees(replay: Replay, history: History) -> Floats:
    """Squares of true errors of the heading over their variances, at the times of the truth."""
    truth = replay.dive.reference
    assert truth is not None
    _, ours, theirs = np.intersect1d(history.time_ns, truth.time_ns, return_indices=True)
    turn = history.mat_nb[ours] @ truth.mat_nb[theirs].transpose(0, 2, 1)
    error = 0.5 * (turn[:, 1, 0] - turn[:, 0, 1])
    return np.asarray((error / history.sd[ours, PHI.stop - 1]) ** 2)


@pytest.mark.nightly
def test_the_heading_is_as_sure_as_its_filter_says_where_its_slow_error_is_estimated() -> None:
    """Each dive holds some three independent values of the error: the mean over eight is within 0.4 to 1.8 in 95 %."""
    replays = [replayed(dive_with_slow_heading(seed)) for seed in range(8)]
    nees = np.array(
        [
            [heading_nees(replay, history).mean() for history in replay.histories]
            for replay in replays
        ]
    )
    _, aided, estimating = nees.mean(axis=0)
    assert 0.4 < estimating < 1.8
    assert nees[:, 1].min() > 17.0
    assert aided > 100.0 * estimating
    nis = [
        row.mean_nis
        for replay in replays
        for row in replay.tables.consistency
        if (row.filter, row.measurement) == ("estimating", "heading")
    ]
    assert np.mean(np.array(nis, dtype=np.float64)) == pytest.approx(1.0, abs=0.1)


def test_small_innovations_that_repeat_are_not_called_conservative() -> None:
    """Told 2 deg of white noise, the filter follows the error: its innovations are small, and so is nothing else."""
    replay = replayed(dive_with_slow_heading(0), SLOW_SD_DEG)
    (row,) = (
        row
        for row in replay.tables.consistency
        if (row.filter, row.measurement) == ("aided", "heading")
    )
    assert (row.mean_nis or 0.0) < 0.5
    assert (row.verdict, row.why) == (Consistency.INSUFFICIENT, Reason.ONE_SAMPLE)
    assert heading_nees(replay, replay.histories[1]).mean() > 17.0
    (note,) = (note for note in replay.notes if note.code == "heading_slow_error")
    assert (note.severity, "filter aided " in note.text) == (Severity.WARNING, True)
    assert 'filters.aided.states = ["heading_bias"]' in note.hint


def test_a_heading_with_white_noise_has_no_slow_error() -> None:
    replay = replayed(dive_with_slow_heading(0, is_slow=False))
    assert "heading_slow_error" not in {note.code for note in replay.notes}
    assert heading_nees(replay, replay.histories[1]).mean() < 3.0


def test_the_bias_is_kept_alive_by_its_noise_and_forgotten_without_readings() -> None:
    """After the last reading, at 100 s, it goes back to zero, and its standard deviation to what the settings say."""
    dive = dive_with_slow_heading(1)
    first = dive.sensors["heading"].rows(
        dive.sensors["heading"].time_ns < dive.imu.time_ns[0] + 10**11
    )
    estimating = replayed(replace(dive, sensors={"heading": first})).histories[2]
    row = next(state.index for state in estimating.states if state.id == "heading_bias")
    seconds = (estimating.time_ns - estimating.time_ns[0]) / 1e9
    after = seconds > 101.0
    value, sd = estimating.constants[after, 0], estimating.sd[after, row]
    assert abs(value[-1]) < 0.4 * abs(value[0])
    assert sd[0] < 0.8 * SLOW_SD_DEG * DEG
    assert sd[-1] == pytest.approx(SLOW_SD_DEG * DEG, rel=0.05)


def test_a_start_by_the_sensor_errs_by_its_bias() -> None:
    """What the heading errs by, the velocity that was turned by it does, too."""
    cov = np.diag(np.full(12, 1e-4))
    cov[:3, 5] = cov[5, :3] = [2e-5, -1e-5, 0.0]
    sensed = Start(np.zeros(3), np.zeros(3), np.eye(3), cov, is_heading_sensed=True)
    made = with_more_states(sensed, np.array([1.0, 0.03]), 2, heading_bias=True).cov
    bias = np.concatenate([cov[:, 5] / cov[5, 5], [0.0, 1.0]])
    expected = np.zeros((14, 14))
    expected[:12, :12], expected[12, 12] = cov, 1.0
    np.testing.assert_allclose(made, expected + 0.03**2 * np.outer(bias, bias), atol=1e-16)
    alone = with_more_states(
        replace(sensed, is_heading_sensed=False), np.array([1.0, 0.03]), 2, heading_bias=True
    ).cov
    assert not alone[:12, 13].any()
