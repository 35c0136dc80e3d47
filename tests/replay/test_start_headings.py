"""The same compass against starts whose heading the reference knows well, or badly: no word against another."""

from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Final

import msgspec
import numpy as np
import pytest

from insdvl_replay.core.config import Config, Filter, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, SolutionColumns
from insdvl_replay.core.quantities import DRAWN_HEADING
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import HeadingSource, Role, Verdict
from insdvl_replay.evaluation.answers import CandidateAnswer, pooled_candidate
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_vector
from insdvl_replay.logs.columns.reference import no_covariances
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

DIVES: Final = 5
GOOD_DEG: Final = (0.02, 0.3, 1.0)
SETTINGS: Final = (
    'filters.baseline={aiding = ["velocity"]}',
    'filters.aided={aiding = ["velocity", "heading"]}',
    "heading.sd_deg=0.3",
    "dvl.velocity_sd_mps=0.004",
    "initial.misalignment_sd_deg=[0.5, 0.5, 3.0]",
    "evaluation.starts=1",
)


@cache
def simulated(number: int) -> Dive:
    compass = {"heading": SensorErrors(0.3, 1.0)}
    return simulate_dive(
        "lawnmower",
        seed=700 + number,
        duration_s=600.0,
        grade="tactical",
        imu_rate_hz=20.0,
        sensors=compass,
    )


def with_compass(number: int, bias_deg: float, good_deg: float) -> Dive:
    """Give a dive a compass with a bias, and a reference whose first heading errs; to which side, is drawn."""
    dive = simulated(number)
    bias_side, start_side = np.random.default_rng([number, 5]).choice([-1.0, 1.0], 2)
    read = dive.sensors["heading"]
    biased = replace(read, values=read.values + bias_side * bias_deg * DEG, mat_nb=None)
    assert dive.reference is not None
    mat_nb = dive.reference.mat_nb.copy()
    mat_nb[0] = mat_from_vector(np.array([0.0, 0.0, start_side * good_deg * DEG])) @ mat_nb[0]
    return replace(
        dive, sensors={"heading": biased}, reference=replace(dive.reference, mat_nb=mat_nb)
    )


def settings() -> Config:
    return load_config("tactical", overrides=[*SETTINGS])


def answered(bias_deg: float, good_deg: float) -> CandidateAnswer:
    replays = [
        replay_dive(with_compass(number, bias_deg, good_deg), settings())
        for number in range(DIVES)
    ]
    return pooled_candidate(
        "aided", "baseline", [replay.tables.evidence for replay in replays], DIVES
    )


def row_of(replay: Replay, quantity: str, name: str = "aided") -> EvidenceRow | None:
    rows = (
        row for row in replay.tables.evidence if (row.filter, row.quantity) == (name, quantity)
    )
    return next(rows, None)


@pytest.mark.nightly
@pytest.mark.parametrize("bias_deg", [0.3, 0.6, 1.0])
def test_no_start_makes_a_compass_better_that_another_makes_worse(bias_deg: float) -> None:
    """Where a plain word is said of one start, its opposite is not said of another."""
    words = [answered(bias_deg, good_deg).verdict for good_deg in GOOD_DEG]
    for one, other in combinations(words, 2):
        assert {one, other} != {Verdict.BETTER, Verdict.WORSE}


@pytest.mark.nightly
def test_a_compass_that_is_worse_than_a_perfect_start_and_better_than_the_vehicle_s_is_mixed() -> (
    None
):
    """With a bias of 0.8 deg it loses against a start good to 0.02 deg, and wins against one that errs by 3 deg."""
    found = answered(0.8, 0.02)
    primary, drawn = found.decisive, found.from_drawn_heading
    assert primary is not None
    assert drawn is not None
    assert primary.verdict == "worse"
    assert drawn.ratio is not None
    assert drawn.ratio < 1.0 / 1.05
    assert drawn.role == Role.SHOWN
    assert found.verdict == Verdict.MIXED
    assert f"{primary.ratio:.2f} " in headline(found)
    assert f"{drawn.ratio:.2f} " in headline(found)


def test_the_drawn_row_hardly_depends_on_how_well_the_reference_knows_the_heading() -> None:
    """From 3 deg off both filters find their heading themselves, so 0.3 deg more of the start change little."""
    values = []
    for good_deg in (0.0, 0.3):
        replay = replay_dive(with_compass(2, 0.3, good_deg), settings())
        found = row_of(replay, DRAWN_HEADING)
        assert found is not None
        values.append(np.array([found.baseline, found.value], np.float64))
    perfect, worse = values
    np.testing.assert_allclose(worse, perfect, rtol=0.25)


def test_a_replay_says_what_its_heading_comes_from_and_by_how_much_the_second_start_is_off() -> (
    None
):
    replay = replay_dive(with_compass(0, 0.3, 0.0), settings())
    found = replay.dive.start_heading
    assert found is not None
    assert found.source == HeadingSource.REFERENCE
    assert found.drawn_sd_deg == pytest.approx(3.0)
    assert abs(found.drawn_error_deg or 0.0) == pytest.approx(3.0)
    assert (
        f"start: heading of the reference ({found.sd_deg:.2g} deg)"
        in replay.verdicts["aided"].sentence
    )


# --- Others than the built-in filters.


def replayed_with(candidate: Filter, dive: Dive) -> Replay:
    config = load_config("tactical", overrides=[*SETTINGS])
    filters = {"baseline": config.filters["baseline"], "aided": candidate}
    return replay_dive(dive, msgspec.structs.replace(config, filters=filters))


def test_a_recorded_solution_is_compared_with_the_baseline_from_the_drawn_heading() -> None:
    """It cannot be run again, so its own error is the same in both rows."""
    dive = simulated(0)
    motion = dive.reference
    assert motion is not None
    off_m = np.column_stack(
        [np.full(len(motion.time_ns), 0.3), np.zeros((len(motion.time_ns), 2))]
    )
    moved = replace(motion, position=moved_position(motion.position, off_m))
    solution = SolutionColumns(moved, None, *no_covariances())
    replay = replayed_with(
        Filter(solution=Solution(align="none")), replace(dive, solutions={"aided": solution})
    )
    own, drawn = row_of(replay, "position"), row_of(replay, DRAWN_HEADING)
    assert own is not None
    assert drawn is not None
    assert own.value == pytest.approx(0.3, rel=1e-3)
    assert drawn.value == own.value
    assert own.baseline is not None
    assert drawn.baseline is not None
    assert drawn.baseline > 1.5 * own.baseline
