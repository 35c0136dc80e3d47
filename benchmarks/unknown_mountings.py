"""How often `run LOG` without settings finds how a simulated vehicle is built, where the truth is known.

Usage: python benchmarks/unknown_mountings.py [--seed 1] [--count 12] [--write]. Each seed draws a vehicle: the
mounting of its DVL (any rotation about down, some degrees of roll and pitch, some upside down), lever arm, delay and
scale, the axes and units of its IMU, rates, a scenario, and GPS fixes or odometry as a reference. --write puts the
table into RESULTS.md.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap_ros2.writer import Writer
from results import machine, table, write_part

from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.errors import UserError
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import north_east_m, solve_beams
from insdvl_replay.geometry.rotation import (
    mat_from_rpy,
    quat_from_mat,
    rpy_from_mat,
    vector_from_mat,
)
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.logs.columns.imu import in_frd
from insdvl_replay.preparation.prepared import read_checked_dive, with_reference_at_imu
from insdvl_replay.preparation.run import prepare_with_heading, prepared_timeline, run_one
from insdvl_replay.sim.dive import add_errors, exact_dive, late_and_long
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

SCENARIOS: Final = ("calibration", "calibration", "figure-eight")
LONGEST_S: Final = 300.0
FLU: Final = np.diag([1.0, -1.0, -1.0])
NED_TO_ENU: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
G_MPS2: Final = 9.80665
LARGEST_OFF_DEG: Final = 1.0
HEADING = "# Mountings of unknown vehicles: seeds"
COLUMNS = ("seed", "vehicle", "s", "mounting off, deg", "heading off, deg", "said", "is")

_SEPARATOR = "\n" + "=" * 80 + "\n"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_TWIST = "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular"
_TWIST_COV = (
    "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance"
)
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z"
_POSE = (
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
)
_POSE_COV = (
    "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance"
)
DEFINITIONS: Final = {
    "sensor_msgs/msg/Imu": _SEPARATOR.join([
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
        _HEADER, _TIME, _QUATERNION, _VECTOR,
    ]),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _SEPARATOR.join([
        "std_msgs/Header header\ngeometry_msgs/TwistWithCovariance twist", _HEADER, _TIME, _TWIST_COV, _TWIST, _VECTOR,
    ]),
    "nav_msgs/msg/Odometry": _SEPARATOR.join([
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist",
        _HEADER, _TIME, _POSE_COV, _POSE, _POINT, _QUATERNION, _TWIST_COV, _TWIST, _VECTOR,
    ]),
    "sensor_msgs/msg/NavSatFix": _SEPARATOR.join([
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
        "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type",
        "MSG: sensor_msgs/NavSatStatus\nint8 status\nuint16 service", _HEADER, _TIME,
    ]),
}  # fmt: skip


@dataclass(frozen=True)
class Vehicle:
    """How a vehicle is built, and what records its dive."""

    scenario: str
    grade: str
    imu_hz: float
    dvl_hz: float
    dvl_rpy_deg: tuple[float, float, float]
    arm_m: tuple[float, float, float]
    delay_s: float
    scale: float
    imu_turn: Floats  # (3, 3), from the body's axes to those of the IMU
    in_g: bool
    in_degrees: bool
    has_odometry: bool

    @classmethod
    def drawn(cls, seed: int) -> "Vehicle":
        """Draw one."""
        rng = np.random.default_rng(seed)
        axes = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
        axes[2] *= np.sign(np.linalg.det(axes))
        roll = float(rng.normal(0.0, 3.0)) + 180.0 * float(rng.random() < 0.25)
        return cls(
            scenario=str(rng.choice(SCENARIOS)),
            grade=str(rng.choice(["fog", "tactical", "mems"])),
            imu_hz=float(rng.choice([20.0, 50.0, 100.0, 200.0, 400.0, 1000.0])),
            dvl_hz=float(rng.choice([1.0, 2.0, 5.0, 10.0, 20.0])),
            dvl_rpy_deg=(roll, float(rng.normal(0.0, 3.0)), float(rng.uniform(-180.0, 180.0))),
            arm_m=(
                float(rng.uniform(-1.0, 1.0)),
                float(rng.uniform(-0.3, 0.3)),
                float(rng.uniform(-0.3, 0.3)),
            ),
            delay_s=float(rng.uniform(0.0, 0.2)),
            scale=float(rng.uniform(0.98, 1.02)),
            imu_turn=axes,
            in_g=bool(rng.random() < 0.3),
            in_degrees=bool(rng.random() < 0.3),
            has_odometry=bool(rng.random() < 0.5),
        )

    @property
    def text(self) -> str:
        """Say what matters of it."""
        rpy = ", ".join(f"{angle:.0f}" for angle in self.dvl_rpy_deg)
        units = ("g" if self.in_g else "m/s2") + (", deg/s" if self.in_degrees else ", rad/s")
        by = "odometry" if self.has_odometry else "fixes"
        return f"{self.scenario}, {self.grade}, {self.imu_hz:.0f} / {self.dvl_hz:.0f} Hz, {units}, {by}, [{rpy}] deg"

    def dive(self, seed: int) -> Dive:
        """Simulate its dive, in the axes of the body."""
        exact = exact_dive(
            self.scenario, duration_s=LONGEST_S, imu_rate_hz=self.imu_hz, dvl_rate_hz=self.dvl_hz,
            lever_arm_m=self.arm_m, mounting_rpy_deg=self.dvl_rpy_deg,
        )  # fmt: skip
        return late_and_long(
            add_errors(exact, GRADES[self.grade], DvlErrors(), seed), self.delay_s, self.scale
        )


def write_log(path: Path, dive: Dive, vehicle: Vehicle, seed: int) -> None:
    """Write a dive as such a vehicle records it."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}
        for topic, kind, time_ns, message in _messages(dive, vehicle, np.random.default_rng(seed)):
            writer.write_message(
                topic, schemas[kind], message, log_time=time_ns, publish_time=time_ns
            )
        writer.finish()


def _messages(
    dive: Dive, vehicle: Vehicle, rng: np.random.Generator
) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    unknown = [-1.0, *[0.0] * 8]
    force = dive.imu.specific_force_b @ vehicle.imu_turn.T / (G_MPS2 if vehicle.in_g else 1.0)
    rate = dive.imu.angular_rate_b @ vehicle.imu_turn.T / (DEG if vehicle.in_degrees else 1.0)
    for time_ns, felt, turning in zip(
        dive.imu.time_ns.tolist(), force.tolist(), rate.tolist(), strict=True
    ):
        yield "/imu/data", "sensor_msgs/msg/Imu", time_ns, {
            "header": _header(time_ns), "orientation": _quaternion(np.eye(3)), "orientation_covariance": unknown,
            "angular_velocity": _xyz(turning), "angular_velocity_covariance": [0.0] * 9,
            "linear_acceleration": _xyz(felt), "linear_acceleration_covariance": [0.0] * 9,
        }  # fmt: skip
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d, *_ = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)
    for time_ns, velocity in zip(dive.dvl.time_ns.tolist(), velocity_d.tolist(), strict=True):
        twist = {
            "twist": {"linear": _xyz(velocity), "angular": _xyz([0.0] * 3)},
            "covariance": [0.0] * 36,
        }
        yield "/dvl/twist", "geometry_msgs/msg/TwistWithCovarianceStamped", time_ns, {
            "header": _header(time_ns), "twist": twist,
        }  # fmt: skip
    yield from _odometry(dive) if vehicle.has_odometry else _fixes(dive, rng)


def _odometry(dive: Dive) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    reference = dive.reference
    assert reference is not None
    north_m, east_m = north_east_m(
        reference.position, reference.position[0], reference.position[0]
    )
    for row, time_ns in enumerate(reference.time_ns.tolist()):
        mat = NED_TO_ENU @ reference.mat_nb[row] @ FLU
        velocity = FLU @ reference.mat_nb[row].T @ reference.velocity_n[row]
        up_m = float(reference.position[row, 2] - reference.position[0, 2])
        pose = {
            "position": _xyz([float(east_m[row]), float(north_m[row]), up_m]),
            "orientation": _quaternion(mat),
        }
        twist = {"linear": _xyz(velocity.tolist()), "angular": _xyz([0.0] * 3)}
        yield "/odometry", "nav_msgs/msg/Odometry", time_ns, {
            "header": _header(time_ns, "odom"), "child_frame_id": "base_link",
            "pose": {"pose": pose, "covariance": [0.0] * 36}, "twist": {"twist": twist, "covariance": [0.0] * 36},
        }  # fmt: skip


def _fixes(dive: Dive, rng: np.random.Generator) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    reference = dive.reference
    assert reference is not None
    for row in range(0, len(reference.time_ns), 5):
        time_ns = int(reference.time_ns[row])
        latitude, longitude, height_m = reference.position[row] + rng.normal(0.0, 0.3, 3) / [
            6.37e6,
            5.3e6,
            1.0,
        ]
        yield "/gps/fix", "sensor_msgs/msg/NavSatFix", time_ns, {
            "header": _header(time_ns, "gps"), "status": {"status": 0, "service": 1},
            "latitude": float(latitude / DEG), "longitude": float(longitude / DEG), "altitude": float(height_m),
            "position_covariance": [0.0] * 9, "position_covariance_type": 0,
        }  # fmt: skip


def _header(time_ns: int, frame: str = "") -> dict[str, Any]:
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame}


def _xyz(vector: list[float]) -> dict[str, float]:
    return dict(zip("xyz", vector, strict=True))


def _quaternion(mat: Floats) -> dict[str, float]:
    return dict(zip("xyzw", quat_from_mat(mat).tolist(), strict=True))


# --- What the search says.


@dataclass(frozen=True)
class Found:
    """How far the settings that were found are off."""

    mounting_off_deg: float  # of the DVL in the IMU
    heading_off_deg: float  # the largest of the second half
    heading_sd_deg: float
    doubts: tuple[str, ...]  # codes of the search's warnings
    text: str

    @property
    def verdict(self) -> str:
        """Say whether it is right, and whether it was said where it is not."""
        is_turned = self.mounting_off_deg > LARGEST_OFF_DEG
        is_off = self.heading_off_deg > max(LARGEST_OFF_DEG, 3.0 * self.heading_sd_deg)
        if not (is_turned or is_off):
            return "right"
        return "doubted" if {"found_dvl", "found_forward"} & {*self.doubts} else "WRONG"


def judged(log: Path, dive: Dive, vehicle: Vehicle) -> Found:
    """Search, and compare with the truth."""
    found = find_settings([[log]], Given(Config()))
    config = found.config
    imu_turn = (
        mat_from_rpy(np.array(config.imu.mounting_rpy_deg) * DEG)
        @ in_frd(np.eye(3), config.imu.axes or "frd", "imu.axes").T
    )
    between = imu_turn.T @ mat_from_rpy(np.array(config.dvl.mounting_rpy_deg) * DEG)
    true = vehicle.imu_turn @ mat_from_rpy(np.array(vehicle.dvl_rpy_deg) * DEG)
    mounting_off_deg = float(np.linalg.norm(vector_from_mat(between @ true.T))) / DEG
    heading_off_deg, sd_deg = _heading_off_deg(log, config, dive)
    doubts = tuple(note.code for note in found.notes if note.severity == Severity.WARNING)
    return Found(
        mounting_off_deg,
        heading_off_deg,
        sd_deg,
        doubts,
        "; ".join(note.text for note in found.notes),
    )


def _heading_off_deg(log: Path, config: Config, dive: Dive) -> tuple[float, float]:
    """Return how far the baseline's heading is off in the mean of the dive's second half, and its own sd."""
    read = with_reference_at_imu(read_checked_dive(log, config), config)
    prepared = prepare_with_heading(read, config)
    history = run_one(prepared.filters[0], prepared, prepared_timeline(read, prepared))
    reference = dive.reference
    assert reference is not None
    true_s = (reference.time_ns - reference.time_ns[0]) * 1e-9
    true_rad = rpy_from_mat(reference.mat_nb)[:, 2]
    our_s = (history.time_ns - reference.time_ns[0]) * 1e-9
    our_rad = rpy_from_mat(history.mat_nb)[:, 2]
    late = our_s > 0.5 * float(true_s[-1])
    off = np.exp(1j * (our_rad[late] - np.interp(our_s[late], true_s, np.unwrap(true_rad))))
    return abs(float(np.angle(np.mean(off)))) / DEG, float(history.sd[-1, 5]) / DEG


def main() -> None:
    """Print the table, and put it into the page of results if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    rows = []
    verdicts = []
    for seed in range(asked.seed, asked.seed + asked.count):
        vehicle = Vehicle.drawn(seed)
        dive = vehicle.dive(seed)
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "dive.mcap"
            write_log(log, dive, vehicle, seed)
            before_s = time.process_time()
            try:
                found = judged(log, dive, vehicle)
            except UserError as error:
                verdicts.append("refused")
                rows.append(f"| {seed} | {vehicle.text} | | | | {error.what} | refused |")
                sys.stdout.write(rows[-1] + "\n")
                continue
        spent_s = time.process_time() - before_s
        verdicts.append(found.verdict)
        said = ", ".join(found.doubts) or "found"
        rows.append(
            f"| {seed} | {vehicle.text} | {spent_s:.1f} | {found.mounting_off_deg:.2f} | "
            f"{found.heading_off_deg:.2f} (sd {found.heading_sd_deg:.2f}) | {said} | {found.verdict} |"
        )
        sys.stdout.write(rows[-1] + "\n" + (f"    {found.text}\n" if asked.verbose else ""))
        sys.stdout.flush()
    summary = ", ".join(
        f"{verdicts.count(word)} {word}" for word in ("right", "doubted", "refused", "WRONG")
    )
    sys.stdout.write(f"{summary} of {len(verdicts)}\n")
    if asked.write:
        heading = f"{HEADING} {asked.seed} to {asked.seed + asked.count - 1}"
        lines = [
            heading,
            "",
            f"{summary} of {len(verdicts)} simulated vehicles ({machine()}).",
            "",
        ]
        write_part("\n".join([*lines, *table(COLUMNS, rows)]))


if __name__ == "__main__":
    main()
