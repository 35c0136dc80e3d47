"""APE and RPE against evo: by day against numbers that it gave, by night against evo itself."""

import json
from pathlib import Path
from typing import Any

import pytest
from evo_cases import CASES, NUMBERS, STATISTICS, Case, evo_numbers, write_case

from insdvl_replay import compare_trajectories

TOLERANCE = 1e-9


def our_numbers(case: Case, folder: Path) -> dict[str, Any]:
    truth, estimate = write_case(case, folder)
    # The verdict needs two trajectories; errors of the second are those of evo.
    other = folder / "other.tum"
    lines = estimate.read_text("utf-8").splitlines()
    other.write_text("\n".join(lines[::2]) + "\n", "utf-8")
    found = compare_trajectories(
        other, estimate, truth, align=case.align, rpe=case.rpe, all_pairs=case.all_pairs
    )
    rows = found.tables["trajectory_errors"]
    own = rows[rows["filter"] == "estimate"]
    return {row["quantity"]: dict(row) for _, row in own.iterrows()}


def assert_same(case: Case, ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert ours.keys() == theirs.keys()
    for quantity, numbers in theirs.items():
        assert ours[quantity]["poses"] == numbers["count"], (case.name, quantity)
        for name in STATISTICS:
            wanted = pytest.approx(numbers[name], rel=TOLERANCE, abs=TOLERANCE)
            assert ours[quantity][name] == wanted, (case.name, quantity, name)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_pose_errors_are_those_of_evo(case: Case, tmp_path: Path) -> None:
    stored = json.loads(NUMBERS.read_text("utf-8"))
    assert_same(case, our_numbers(case, tmp_path), stored[case.name])


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_stored_numbers_are_those_of_the_installed_evo(case: Case, tmp_path: Path) -> None:
    pytest.importorskip("evo", reason="evo is not installed: pip install evo")
    assert_same(case, our_numbers(case, tmp_path), evo_numbers(case, tmp_path))
