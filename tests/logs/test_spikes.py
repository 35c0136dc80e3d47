"""Single samples of an IMU that jump away and back: found, told, bridged, and of no consequence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frames import frame
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.columns.imu import find_spikes
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.sim.dive import simulate_dive

TIME_NS = np.arange(21) * 10_000_000
LEVEL = np.tile([0.0, 0.0, -9.8], (21, 1))


def spoiled(rows: list[int], values: Floats | list[float], axis: int = 0) -> Floats:
    readings = LEVEL.copy()
    readings[rows, axis] += values
    return readings


@pytest.mark.parametrize(
    ("readings", "found"),
    [
        (spoiled([3], [300.0]), [3]),
        (spoiled([3], [-21.0], axis=2), [3]),
        (spoiled([2, 4], [50.0, -50.0]), [2, 4]),
        (spoiled([3], [19.0]), []),  # a vehicle may feel that
        (spoiled([3, 4], [300.0, 280.0]), []),  # two samples are no spike
        (spoiled(list(range(3, 21)), [30.0] * 18), []),  # a step does not come back
        (spoiled([2, 3, 4], [-30.0, 60.0, -20.0]), []),  # nor does what swings
        (
            spoiled(list(range(21)), [2.0, -2.0, 1.0, 30.0, -1.0, 2.0, -2.0] * 3),
            [],
        ),  # nothing stands out of unrest
        (spoiled([0, 20], [300.0, 300.0]), [0, 20]),
        (spoiled([0, 1], [300.0, 250.0]), []),
        (spoiled(list(range(3, 21)), [300.0] + [6.0] * 17), [3]),  # on a slope
    ],
)
def test_a_spike_is_one_sample_far_from_both_of_its_neighbours(
    readings: Floats, found: list[int]
) -> None:
    assert np.flatnonzero(find_spikes(TIME_NS, readings, 20.0)).tolist() == found


def test_nothing_jumps_across_a_pause() -> None:
    paused = TIME_NS + np.where(np.arange(21) > 3, 100_000_000, 0)
    assert not find_spikes(paused, spoiled([3], [300.0]), 20.0).any()


@pytest.fixture(scope="module")
def clean() -> Dive:
    return simulate_dive(
        "straight", seed=3, duration_s=300.0, grade="tactical", reference_rate_hz=1.0
    )


def replayed(dive: Dive, folder: Path) -> Replay:
    write_dive(folder / "dive.mcap", dive)
    return replay_log(folder / "dive.mcap", load_config("tactical"))


@pytest.fixture(scope="module")
def before(clean: Dive, tmp_path_factory: pytest.TempPathFactory) -> Replay:
    return replayed(clean, tmp_path_factory.mktemp("clean"))


def with_force(dive: Dive, rows: list[int], change_mps2: float) -> Dive:
    force_b = dive.imu.specific_force_b.copy()
    force_b[rows, 0] += change_mps2
    return replace(dive, imu=replace(dive.imu, specific_force_b=force_b))


def test_a_spike_of_300_mps2_changes_next_to_nothing(
    clean: Dive, before: Replay, tmp_path: Path
) -> None:
    after = replayed(with_force(clean, [9000], 300.0), tmp_path)
    (note,) = [note for note in after.notes if note not in before.notes]
    assert (note.code, note.count, note.severity) == ("imu_spikes", 1, "warning")
    assert "the first 90.000 s after the first message" in note.text
    for filter_, rows in frame(after.tables.consistency).groupby("filter"):
        assert rows["rejected"].max() <= 0.01 * rows["used"].max(), filter_
    position = [
        frame(replay.tables.reference_error)
        .set_index("quantity")
        .loc["position_h", ["baseline_rmse", "rmse"]]
        for replay in (before, after)
    ]
    np.testing.assert_allclose(position[1].astype(float), position[0].astype(float), rtol=0.05)


def test_an_imu_that_jumps_all_the_time_is_left_as_it_is(clean: Dive, tmp_path: Path) -> None:
    shaken = with_force(clean, list(range(0, len(clean.imu.time_ns), 8)), 30.0)
    write_dive(tmp_path / "dive.mcap", shaken)
    dive = read_dive(tmp_path / "dive.mcap", load_config("tactical"))
    assert len(dive.imu.time_ns) == len(clean.imu.time_ns)


@pytest.mark.parametrize("reopen_after", [5, 0])
def test_a_filter_that_is_thrown_off_comes_back(
    clean: Dive, tmp_path: Path, reopen_after: int
) -> None:
    """What lasts for three samples is no spike: the gate locks the DVL out, and the filter opens it again."""
    write_dive(tmp_path / "dive.mcap", with_force(clean, [9000, 9001, 9002], 300.0))
    reopening = f"filters.baseline.gate_reopen_after={reopen_after}"
    # The noise of the pings as it is, since with that of the preset no baseline could be judged by.
    config = load_config("tactical", None, [reopening, "dvl.velocity_sd_mps=0.005"])
    replay = replay_log(tmp_path / "dive.mcap", config)
    (velocity,) = replay.histories[0].innovations
    rejected = np.flatnonzero(~velocity.used)
    assert len(rejected) == 5 - 1 if reopen_after else len(rejected) > 200
    notes = {note.code: note for note in replay.notes if "baseline" in note.text}
    if not reopen_after:
        assert "gate_rejects_many" in notes
        assert replay.verdicts["aided"].verdict == "not evaluated"
        return
    np.testing.assert_array_equal(np.diff(rejected), 1)
    assert np.flatnonzero(velocity.reopened).tolist() == [rejected[-1] + 1]
    assert velocity.used[velocity.reopened].all()
    assert (notes["gate_reopened"].count, notes["gate_reopened"].severity) == (1, "warning")
    assert replay.verdicts["aided"].verdict != "not evaluated"
    assert dive_speed_error(replay) < 0.1


def test_a_spike_at_the_very_start_is_found(clean: Dive, tmp_path: Path) -> None:
    replay = replayed(with_force(clean, [0], 300.0), tmp_path)
    warnings = [(note.code, note.count) for note in replay.notes if note.severity == "warning"]
    assert [found for found in warnings if found[0] != "not_evaluated"] == [("imu_spikes", 1)]


@pytest.mark.parametrize("grade", ["fog", "mems"])
def test_levels_that_took_part_of_the_error_over_are_opened_too(grade: str) -> None:
    """A jump before the first ping finds levels and biases as unsure as the velocity, and they share it.

    The levels of a reference without noise are surer, so that such a start loses fewer pings.
    """
    dive = with_force(simulate_dive("straight", seed=3, duration_s=120.0, grade=grade), [0], 300.0)
    unsure, sure = (
        replay_dive(dive, load_config(grade, None, [f"initial.uncertainty={of}"]))
        for of in ("settings", "source")
    )
    (velocity,) = unsure.histories[0].innovations
    assert 1 < velocity.reopened.sum() <= 3
    assert (~velocity.used).sum() <= 12
    (with_source,) = sure.histories[0].innovations
    assert 1 <= with_source.reopened.sum() <= 3
    assert (~with_source.used).sum() <= (~velocity.used).sum()
    assert with_source.used[-60:].all()
    assert velocity.used[-60:].all()


def test_rejections_on_both_sides_of_an_outage_are_no_run(clean: Dive) -> None:
    assert clean.dvl.beam_velocity_mps is not None
    beams = clean.dvl.beam_velocity_mps.copy()
    beams[98:100] += 1.0
    beams[100:170] = np.nan
    beams[170:173] += 30.0
    dive = replace(clean, dvl=replace(clean.dvl, beam_velocity_mps=beams))
    (velocity,) = replay_dive(dive, load_config("tactical")).histories[0].innovations
    assert (~velocity.used).sum() == 5
    assert not velocity.reopened.any()


def dive_speed_error(replay: Replay) -> float:
    """Give the error of the baseline's velocity at the end, which only the DVL can have put right."""
    assert replay.dive.reference is not None
    return float(
        np.linalg.norm(replay.histories[0].velocity_n[-1] - replay.dive.reference.velocity_n[-1])
    )


def test_opening_leaves_what_is_known_of_other_states(
    clean: Dive, before: Replay, tmp_path: Path
) -> None:
    """The biases of a filter that was thrown off and came back stay where they were."""
    after = replayed(with_force(clean, [9000, 9001, 9002], 300.0), tmp_path)
    for column, within_sd in (("accel_bias_b", 1.0), ("gyro_bias_b", 1.0)):
        ours, theirs = (getattr(replay.histories[0], column)[-1] for replay in (after, before))
        sd = (
            before.histories[0].sd[-1, 6:9]
            if column == "accel_bias_b"
            else before.histories[0].sd[-1, 9:12]
        )
        assert (np.abs(ours - theirs) < within_sd * sd).all()
    turned = before.histories[0].mat_nb[-1].T @ after.histories[0].mat_nb[-1]
    assert Rotation.from_matrix(turned).magnitude() < 3.0 * before.histories[0].sd[-1, 3:6].max()
