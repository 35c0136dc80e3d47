"""Logs of MOOS as its logger writes them, of simulated dives."""

from collections.abc import Iterator

import numpy as np
from teledyne_logs import dvl_told

from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.geometry.rotation import rpy_from_mat

APPLICATIONS = {"imu": "iIMU", "dvl": "iDVL", "reference": "pNavTruth"}
VARIABLES = {
    "imu": ("ACC_X", "ACC_Y", "ACC_Z", "GYRO_X", "GYRO_Y", "GYRO_Z"),
    "dvl": ("VEL_X", "VEL_Y", "VEL_Z"),
    "reference": ("LAT", "LONG", "HEIGHT", "VN", "VE", "VD", "ROLL", "PITCH", "YAW"),
}
PREFIXES = {"imu": "IMU", "dvl": "DVL", "reference": "NAV"}
START_S = 1_704_067_200


def told_dive() -> Dive:
    """A dive with the velocities of a DVL."""
    return dvl_told().of_velocities().dive


def readings(dive: Dive) -> Iterator[tuple[int, str, Floats]]:
    """Give the time, the role and the numbers of each reading."""
    imu = dive.imu
    reference = dive.reference
    assert reference is not None
    assert dive.dvl.velocity_d is not None
    motion = [reference.position, reference.velocity_n, rpy_from_mat(reference.mat_nb)]
    tables = {
        "imu": (imu.time_ns, np.hstack([imu.specific_force_b, imu.angular_rate_b])),
        "dvl": (dive.dvl.time_ns, dive.dvl.velocity_d),
        "reference": (reference.time_ns, np.hstack(motion)),
    }
    for role, (times, numbers) in tables.items():
        for time_ns, row in zip(times.tolist(), numbers, strict=True):
            yield time_ns, role, row


def alog(dive: Dive, *, marked: bool = False, whole_times: bool = False) -> list[str]:
    """The lines of a log, each value some tens of microseconds after the one before."""
    lines = [
        "%" * 60,
        "%% LOG FILE:       ./LOG_1/LOG_1.alog",
        "%% FILE OPENED ON  Mon Jan  1 00:00:00 2024",
        f"%% LOGSTART        {START_S:20}",
        "%" * 60,
    ]
    for time_ns, role, row in sorted(readings(dive), key=lambda reading: reading[0]):
        since_start_s = time_ns / 1e9 - START_S
        for place, (name, value) in enumerate(zip(VARIABLES[role], row.tolist(), strict=True)):
            time_s = since_start_s + 2e-5 * place
            if whole_times:
                time_s += START_S
            text = f"D:{value!r}" if marked else f"{value!r}"
            variable = f"{PREFIXES[role]}_{name}"
            lines.append(f"{time_s:<15.6f} {variable:<19} {APPLICATIONS[role]:<15} {text}   ")
    return lines


def whole(lines: list[str]) -> str:
    """A file of lines, each with its end."""
    return "".join(line + "\n" for line in lines)
