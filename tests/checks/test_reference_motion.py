"""References that contradict themselves: velocities that do not add up to the positions, and jumps."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from insdvl_replay.checks.reference import reference_notes
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.sim.dive import START_NS, exact_dive

SECOND = 1_000_000_000
M_TO_RAD = np.array([1.0 / 6.36e6, 1.0 / (6.38e6 * np.cos(np.radians(32.8)))])
Change = Callable[[ReferenceColumns], ReferenceColumns]


@pytest.fixture(scope="module")
def turning() -> Dive:
    return exact_dive("figure-eight", imu_rate_hz=50.0, reference_rate_hz=1.0)


@pytest.fixture(scope="module")
def straight() -> Dive:
    return exact_dive("straight", imu_rate_hz=20.0, reference_rate_hz=2.0)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def found(dive: Dive, change: Change | None = None) -> list[Note]:
    reference = change(reference_of(dive)) if change else reference_of(dive)
    return list(reference_notes(dive.imu, dive.dvl, reference))


def moved(reference: ReferenceColumns, north_east_m: Floats) -> ReferenceColumns:
    position = reference.position.copy()
    position[:, :2] += north_east_m * M_TO_RAD
    return replace(reference, position=position)


def jumped(by_m: float, at_s: float) -> Change:
    def change(reference: ReferenceColumns) -> ReferenceColumns:
        after = reference.time_ns > START_NS + round(at_s * SECOND)
        return moved(reference, np.outer(after, [0.6 * by_m, -0.8 * by_m]))

    return change


def noisy(sd_m: float, seed: int) -> Change:
    return lambda reference: moved(
        reference, sd_m * np.random.default_rng(seed).standard_normal((len(reference.time_ns), 2))
    )


def without_velocity(reference: ReferenceColumns) -> ReferenceColumns:
    return replace(reference, velocity_n=np.full_like(reference.velocity_n, np.nan))


def faster(scale: float) -> Change:
    return lambda reference: replace(reference, velocity_n=scale * reference.velocity_n)


# --- The scale.


def test_consistent_references_pass(turning: Dive, straight: Dive) -> None:
    assert found(turning) == [], "of 1 Hz, through turns at 17 deg/s"
    assert found(straight) == []
    for seed in range(10):
        assert found(straight, noisy(1.0, seed)) == []
        assert found(turning, noisy(1.0, seed)) == []


@pytest.mark.parametrize(
    ("scale", "says"), [(1.006, "0.60 +- 0.00 % "), (0.995, "0.50 +- 0.00 % ")]
)
def test_velocity_that_does_not_add_up_to_the_positions_is_reported(
    turning: Dive, scale: float, says: str
) -> None:
    (note,) = found(turning, faster(scale))
    assert (note.code, note.severity) == ("reference_scale", "warning")
    assert says in note.text


def test_standard_error_of_the_scale_is_its_scatter(straight: Dive) -> None:
    """A percent of 20 m is less than 1 m of noise, but not that of 42 legs."""
    told = [
        found(straight, lambda reference, seed=seed: noisy(1.0, seed)(faster(1.05)(reference)))
        for seed in range(20)
    ]
    notes = [note for notes in told for note in notes]
    assert len(notes) >= 15  # of some, noise of the positions may be to blame
    numbers = np.array(
        [
            [float(word) for word in re.findall(r"([\d.]+) \+- ([\d.]+) %", note.text)[0]]
            for note in notes
        ]
    )
    # Positions with 1 m at both ends of 42 legs of 21 m: neighbours share one, so that the error is less than it looks.
    assert numbers[:, 1].mean() == pytest.approx(100.0 * np.sqrt(2.0 / 42.0) / 21.0, rel=0.15)
    assert numbers[:, 0].mean() == pytest.approx(100.0 * (1.0 - 1.0 / 1.05), abs=0.2)
    assert numbers[:, 0].std() < 1.5 * numbers[:, 1].mean()


@pytest.mark.parametrize(("off_pct", "reported"), [(2.0, False), (4.2, True)])
def test_scale_is_reported_from_three_standard_errors_on(
    straight: Dive, off_pct: float, reported: bool
) -> None:
    """With 1 m of noise at both ends of 42 legs of 21 m, the standard error of the scale is 1.04 %."""
    for seed in range(4):
        notes = found(
            straight,
            lambda reference, seed=seed: noisy(1.0, seed)(
                faster(1.0 / (1.0 + off_pct / 100.0))(reference)
            ),
        )
        assert [note.code for note in notes] == (["reference_scale"] if reported else [])


@pytest.mark.parametrize("seed", range(6))
def test_noise_of_the_velocity_is_no_scale(seed: int) -> None:
    """Of a slow vehicle, a noisy velocity makes a regression on it too small."""
    slow = exact_dive("lawnmower", imu_rate_hz=1.0, reference_rate_hz=1.0)

    def change(reference: ReferenceColumns) -> ReferenceColumns:
        noise = 0.07 * np.random.default_rng(seed).standard_normal(reference.velocity_n.shape)
        return replace(reference, velocity_n=reference.velocity_n + noise)

    assert not found(slow, change)


def test_scale_within_a_third_of_a_percent_is_no_matter(turning: Dive) -> None:
    assert found(turning, faster(1.002)) == []


def test_velocities_of_another_topic_are_compared_between_their_rows(turning: Dive) -> None:
    """Positions and velocities in rows of their own, as the union of two topics has them."""
    reference = reference_of(exact_dive("figure-eight", imu_rate_hz=50.0, reference_rate_hz=5.0))
    position, velocity_n = reference.position.copy(), 1.01 * reference.velocity_n
    position[np.arange(len(position)) % 5 != 2] = np.nan
    velocity_n[np.arange(len(position)) % 5 == 2] = np.nan
    (note,) = found(
        turning, lambda _: replace(reference, position=position, velocity_n=velocity_n)
    )
    assert float(re.findall(r"([-\d.]+) \+-", note.text)[0]) == pytest.approx(0.99, abs=0.02)


# --- Jumps.


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "positions alone"])
@pytest.mark.parametrize("noise_m", [0.0, 1.0])
def test_jump_of_the_positions_is_reported(straight: Dive, velocity: bool, noise_m: float) -> None:
    def change(reference: ReferenceColumns) -> ReferenceColumns:
        changed = noisy(noise_m, 3)(jumped(20.0, 100.2)(reference))
        return changed if velocity else without_velocity(changed)

    (note,) = found(straight, change)
    assert (note.code, note.severity, note.count) == ("reference_jump", "warning", 1)
    assert re.search(r"positions .*\b1 of 848 .* 100\.5 s\b", note.text)
    (size_m,) = map(float, re.findall(r"([\d.]+) m\b", note.text))
    assert size_m == pytest.approx(20.0, abs=0.1 + 4.0 * noise_m)


def test_jump_in_a_turn_is_reported_and_the_turn_is_not(turning: Dive) -> None:
    assert found(turning, without_velocity) == []
    (note,) = found(turning, lambda reference: without_velocity(jumped(5.0, 104.5)(reference)))
    assert note.code == "reference_jump"
    assert " 105.0 s " in note.text


def test_receiver_that_comes_back_after_a_dive_has_not_jumped(straight: Dive) -> None:
    def change(reference: ReferenceColumns) -> ReferenceColumns:
        seen = (reference.time_ns < START_NS + 100 * SECOND) | (
            reference.time_ns > START_NS + 200 * SECOND
        )
        return without_velocity(reference.rows(seen))

    assert found(straight, change) == []


def turned_from(at_s: float, heading_deg: float) -> Change:
    def change(reference: ReferenceColumns) -> ReferenceColumns:
        after = reference.time_ns > START_NS + round(at_s * SECOND)
        turn = Rotation.from_euler("Z", heading_deg, degrees=True).as_matrix()
        return replace(
            reference,
            mat_nb=np.where(after[:, None, None], turn @ reference.mat_nb, reference.mat_nb),
        )

    return change


def test_heading_that_jumps_while_the_gyros_do_not_is_reported(turning: Dive) -> None:
    (note,) = found(turning, turned_from(50.5, 12.0))
    assert (note.code, note.count) == ("reference_jump", 1)
    assert re.search(r"attitudes .*\b1 of 394 .*\b12\.0 deg .*\b51\.0 s", note.text)


@pytest.mark.parametrize("scale", [0.6, 1.6645])
def test_gyros_of_a_wrong_scale_make_no_jumps(turning: Dive, scale: float) -> None:
    imu = replace(turning.imu, angular_rate_b=scale * turning.imu.angular_rate_b)
    assert found(replace(turning, imu=imu)) == []


def test_jump_is_a_note_of_the_log(tmp_path: Path, turning: Dive) -> None:
    path = tmp_path / "dive.mcap"
    write_dive(path, replace(turning, reference=jumped(20.0, 60.2)(reference_of(turning))))
    assert "reference_jump" in {note.code for note in read_checked_dive(path, Config()).notes}


# --- Real dives.


@pytest.mark.parametrize(("number", "percent"), [("11", -0.6), ("12", 0.8)])
def test_two_real_references_contradict_themselves(
    snapir: Path, number: str, percent: float
) -> None:
    path, config = snapir / f"snapir_{number}.mcap", load_config()
    (note,) = (
        note for note in read_checked_dive(path, config).notes if note.code == "reference_scale"
    )
    says = float(re.findall(r"([-\d.]+) \+-", note.text)[0]) * (
        1.0 if "longer" in note.text else -1.0
    )
    assert says == pytest.approx(percent, abs=0.06)


@pytest.mark.parametrize("number", ["01", "02", "05", "07", "08", "09"])
def test_the_other_real_references_do_not(snapir: Path, number: str) -> None:
    codes = {
        note.code
        for note in read_checked_dive(snapir / f"snapir_{number}.mcap", load_config()).notes
    }
    assert not codes & {
        "reference_scale",
        "reference_jump",
        "reference_contradiction",
        "reference_not_finite",
    }
