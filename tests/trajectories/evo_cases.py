"""Trajectories whose pose errors evo has computed, and the numbers that it gave.

``python tests/trajectories/evo_cases.py`` writes `evo_numbers.json` again, with evo 1.38.1 (`pip install evo`). The
files are made by closed forms, so that they are the same wherever the tests run.
"""

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

NUMBERS: Final = Path(__file__).with_name("evo_numbers.json")
PARTS: Final = {
    "translation": "translation_part",
    "rotation": "rotation_part",
    "angle": "rotation_angle_deg",
    "full": "full_transformation",
}
STATISTICS: Final = ("rmse", "mean", "median", "std", "min", "max", "sse")


class Case(NamedTuple):
    """How evo is asked."""

    name: str
    poses: tuple[int, int]  # of the reference and of the estimate
    rates_hz: tuple[float, float]
    align: str = "none"
    delta: float = 1.0
    unit: str = "f"
    all_pairs: bool = False
    late_s: float = 0.0  # by which the stamps of the estimate are later
    places_m: float = 0.0  # far from the origin, as in UTM

    @property
    def rpe(self) -> str:
        """The length of relative errors as the command takes it."""
        return f"{self.delta:g}{self.unit}"


CASES: Final = (
    Case("same_stamps", (400, 400), (10.0, 10.0)),
    Case("sparse_estimate", (900, 150), (20.0, 3.0), delta=5.0),
    Case("sparse_reference", (120, 900), (2.0, 17.0), delta=3.0, all_pairs=True),
    Case("late_stamps", (500, 500), (10.0, 10.0), late_s=0.0097),
    Case("se3", (400, 400), (10.0, 10.0), align="se3", delta=10.0),
    Case("sim3", (400, 380), (10.0, 10.0), align="sim3", delta=10.0, all_pairs=True),
    Case("metres", (800, 800), (10.0, 10.0), delta=5.0, unit="m"),
    Case("metres_all", (800, 800), (10.0, 10.0), delta=5.0, unit="m", all_pairs=True),
    Case("metres_aligned", (800, 700), (10.0, 9.0), align="sim3", delta=20.0, unit="m"),
    Case("far_away", (300, 300), (5.0, 5.0), delta=10.0, unit="m", places_m=4.5e5),
)


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return a quaternion x, y, z, w of angles about fixed axes."""
    halves = [0.5 * angle for angle in (roll, pitch, yaw)]
    (sr, sp, sy), (cr, cp, cy) = [math.sin(h) for h in halves], [math.cos(h) for h in halves]
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _lines(case: Case, *, estimate: bool) -> Iterator[str]:
    side = int(estimate)
    late_s = case.late_s if estimate else 0.0
    for number in range(case.poses[side]):
        time_s = number / case.rates_hz[side]
        rest = time_s > 20.0 and time_s < 25.0  # the vehicle stands still for a while
        moved_s = 20.0 if rest else time_s
        x = 12.0 * math.sin(0.11 * moved_s) + 0.8 * moved_s + case.places_m
        y = 9.0 * math.cos(0.17 * moved_s) - case.places_m
        z = -2.0 + 1.5 * math.sin(0.05 * moved_s)
        roll, pitch, yaw = 0.1 * math.sin(moved_s), 0.05 * math.cos(0.7 * moved_s), 0.2 * moved_s
        if estimate:
            x += 0.02 * moved_s + 0.3 * math.sin(0.9 * moved_s)
            y += 0.2 * math.cos(1.3 * moved_s) - 0.01 * moved_s
            z += 0.1 * math.sin(0.4 * moved_s)
            yaw += 0.002 * moved_s
            roll += 0.01 * math.sin(3.0 * moved_s)
        numbers = (1700000000.0 + time_s + late_s, x, y, z, *_quaternion(roll, pitch, yaw))
        yield " ".join(f"{value:.9f}" for value in numbers)


def write_case(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write reference and estimate as TUM files."""
    paths = folder / "truth.tum", folder / "estimate.tum"
    for estimate, path in enumerate(paths):
        path.write_text("\n".join(_lines(case, estimate=bool(estimate))) + "\n", "utf-8")
    return paths


def evo_numbers(case: Case, folder: Path) -> dict[str, Any]:
    """Ask evo."""
    from evo.core import metrics, sync
    from evo.tools import file_interface

    truth, estimate = write_case(case, folder)
    reference = file_interface.read_tum_trajectory_file(str(truth))
    ours = file_interface.read_tum_trajectory_file(str(estimate))
    reference, ours = sync.associate_trajectories(reference, ours, max_diff=0.01)
    if case.align != "none":
        ours.align(reference, correct_scale=case.align == "sim3")
    unit = metrics.Unit.meters if case.unit == "m" else metrics.Unit.frames
    found: dict[str, Any] = {}
    for part, relation in PARTS.items():
        of_part = metrics.PoseRelation[relation]
        absolute = metrics.APE(of_part)
        relative = metrics.RPE(of_part, case.delta, unit, all_pairs=case.all_pairs)
        for kind, metric in (("ape", absolute), ("rpe", relative)):
            metric.process_data((reference, ours))
            numbers = metric.get_all_statistics()
            found[f"{kind}_{part}"] = {name: float(numbers[name]) for name in STATISTICS}
            found[f"{kind}_{part}"]["count"] = len(metric.error)
    return found


def main() -> None:
    """Write the numbers of all cases."""
    numbers = dict[str, Any]()
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            numbers[case.name] = evo_numbers(case, Path(folder))
    NUMBERS.write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
