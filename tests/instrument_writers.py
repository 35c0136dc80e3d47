"""Files of instruments as tests write them, byte by byte in the published layouts, from what a dive says."""

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from io import StringIO
from operator import xor
from typing import Any

import numpy as np
import teledyne_logs
from autopilot_logs import ardupilot, px4
from instrument_logs import Told

from insdvl_replay.geometry.rotation import rpy_from_mat

Report = dict[str, Any]


@dataclass(frozen=True)
class Written:
    """A format as tests write it.

    Attributes
    ----------
    name : str
        Of a file.
    write : callable
        Gives the bytes of what a dive says.
    said : callable
        What the dive says with the numbers that the format has.
    atol_mps : float
        Half of a step of its velocities.
    has_imu : bool
        Whether the file has the IMU, too.
    is_protected : bool
        Whether a checksum stands over every number.
    """

    name: str
    write: Callable[[Told], bytes]
    said: Callable[[Told], Told]
    atol_mps: float
    has_imu: bool = False
    is_protected: bool = True


# --- Water Linked, JSON.


def velocity_reports(dive: Told) -> list[Report]:
    """What the DVL says, as format json_v3.1 has it, key by key."""
    reports = []
    for number, (time_ns, is_valid) in enumerate(zip(dive.time_ns, dive.is_valid, strict=True)):
        velocity = np.nan_to_num(dive.velocity_d[number])
        transducers = []
        for beam, speed in enumerate(dive.beams_mps[number]):
            transducers.append(
                {
                    "id": beam,
                    "velocity": float(np.nan_to_num(speed)),
                    "distance": 12.5 if np.isfinite(speed) else -1.0,
                    "rssi": -30.49,
                    "nsd": -88.73,
                    "beam_valid": bool(np.isfinite(speed)),
                }
            )
        reports.append(
            {
                "time": 106.39,
                "vx": float(velocity[0]),
                "vy": float(velocity[1]),
                "vz": float(velocity[2]),
                "fom": 0.0016,
                "covariance": [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]],
                "altitude": 11.5 if is_valid else -1.0,
                "transducers": transducers,
                "velocity_valid": is_valid,
                "status": 0,
                "format": "json_v3.1",
                "type": "velocity",
                "time_of_validity": int(time_ns) // 1000,
                "time_of_transmission": int(time_ns) // 1000 + 9000,
            }
        )
    return reports


def as_lines(reports: Sequence[Report]) -> str:
    """One report a line."""
    return "".join(json.dumps(report) + "\r\n" for report in reports)


def water_linked_json(dive: Told) -> bytes:
    """Write reports as the DVL sends them over TCP."""
    return as_lines(velocity_reports(dive)).encode()


# --- Sentences.


def crc8(body: bytes) -> int:
    """The checksum of Water Linked: polynomial 7, from 0."""
    checksum = 0
    for byte in body:
        checksum ^= byte
        for _ in range(8):
            checksum = (checksum << 1) ^ (7 if checksum & 0x80 else 0)
            checksum &= 0xFF
    return checksum


def wl(body: str) -> bytes:
    """Write a sentence of Water Linked."""
    return f"{body}*{crc8(body.encode()):02x}\r\n".encode()


def nmea(body: str) -> bytes:
    """Write a sentence of NMEA."""
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def wrz(dive: Told, number: int) -> bytes:
    """Write the velocity of a ping."""
    x, y, z = np.nan_to_num(dive.velocity_d[number])
    flag, altitude = ("y", 11.5) if dive.is_valid[number] else ("n", -1.0)
    time_us = int(dive.time_ns[number]) // 1000
    covariance = "1e-07;0;1.4;0;1.2;0;0.2;0;1e+09"
    return wl(
        f"wrz,{x:.3f},{y:.3f},{z:.3f},{flag},{altitude:.2f},0.002,{covariance},{time_us},{time_us + 9000},200.00,0"
    )


def wru(dive: Told, number: int) -> bytes:
    """Write the transducers of a ping."""
    lines = b""
    for beam, speed in enumerate(dive.beams_mps[number]):
        distance = 12.5 if np.isfinite(speed) else -1.0
        lines += wl(f"wru,{beam},{np.nan_to_num(speed):.3f},{distance:.2f},-40,-95")
    return lines


def water_linked_serial(dive: Told) -> bytes:
    """Write a velocity and four transducers for each ping."""
    return b"".join(wrz(dive, n) + wru(dive, n) for n in range(len(dive.time_ns)))


def nortek(dive: Told) -> bytes:
    """Write a $PNORBT7 for each ping."""
    lines = b""
    for time_ns, velocity in zip(dive.time_ns, dive.velocity_d, strict=True):
        x, y, z = np.nan_to_num(velocity, nan=-32.768)
        time = f"{time_ns // 10**9}.{time_ns % 10**9 // 10**5:04d}"
        lines += nmea(
            f"PNORBT7,{time},1.234,-1.234,{x:.4f},{y:.4f},{z:.4f},0.0123,12.3,12.4,12.5,12.6"
        )
    return lines


DELTA_US = 200_000
"""Between two sentences of Cerulean."""


def cerulean(dive: Told) -> bytes:
    """Write a $DVPDL for each ping: how far the vehicle came from a tenth of a second before it to one behind it."""
    lines = b""
    for time_ns, velocity, is_valid in zip(
        dive.time_ns, dive.velocity_d, dive.is_valid, strict=True
    ):
        x, y, z = np.nan_to_num(velocity) * DELTA_US * 1e-6
        time_us = int(time_ns) // 1000 + DELTA_US // 2
        confidence = 95 if is_valid else 0
        lines += nmea(
            f"DVPDL,{time_us},{DELTA_US},0.000000,0.000000,0.000000,{x:.3f},{y:.3f},{z:.3f},{confidence}"
        )
    return lines


EXTENDED_HZ = 5
"""Sentences of a DVL-75 in a second, which are the pings of `told`."""


def cerulean_extended(dive: Told) -> bytes:
    """Write a $DVEXT for each ping: velocities of the earth and the attitude, by axes forward, port, up."""
    reference = dive.dive.reference
    assert reference is not None
    rows = np.searchsorted(reference.time_ns, dive.time_ns, "right") - 1
    lines = b""
    for row, velocity, is_valid in zip(rows, dive.velocity_d, dive.is_valid, strict=True):
        roll, pitch, heading = np.degrees(rpy_from_mat(reference.mat_nb[row]))
        # Its bow is down where the pitch is positive.
        told_deg = np.round([roll, -pitch, heading % 360.0], 1)
        angles = np.radians([told_deg[0], told_deg[1], 90.0 - told_deg[2]])
        c_roll, c_pitch, c_yaw = np.cos(angles)
        s_roll, s_pitch, s_yaw = np.sin(angles)
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, c_roll, -s_roll], [0.0, s_roll, c_roll]])
        about_y = np.array([[c_pitch, 0.0, s_pitch], [0.0, 1.0, 0.0], [-s_pitch, 0.0, c_pitch]])
        about_z = np.array([[c_yaw, -s_yaw, 0.0], [s_yaw, c_yaw, 0.0], [0.0, 0.0, 1.0]])
        ahead_port_up = np.nan_to_num(velocity) * [1.0, -1.0, -1.0]
        east, north, up = about_z @ about_y @ about_x @ ahead_port_up
        lock = "T" if is_valid else "F"
        roll, pitch, heading = told_deg
        lines += nmea(
            f"DVEXT,{lock},X,0310,{roll:.1f},{pitch:.1f},{heading:.1f},0,{up:.3f},12.30,{north:.3f},{east:.3f},"
            f"0.000000000,0.000000000,{1 / EXTENDED_HZ:.3f},1.0,0.0,0.0,0.0,19,19,48,25,T,T,T,T,"
            "0.0000,0.0000,0.0000,0.0000,14.2,14.2,14.2,14.2,"
        )
    return lines


# --- Nortek Nucleus.

TITLES = [
    "sizeHeader", "id", "family", "flags.posixTime", "timeStamp", "microSeconds", "timestampPython", "isValid",
    "ahrsData.roll", "ahrsData.pitch", "ahrsData.heading", "pressure", "latitude", "longitude", "velocityNedX",
    "velocityNedY", "velocityNedZ", "status.isValid", "accelerometer.x", "accelerometer.y", "accelerometer.z",
    "gyro.x", "gyro.y", "gyro.z", "magnetometer.x", "status.beam1VelocityValid", "status.beam2VelocityValid",
    "status.beam3VelocityValid", "status.xVelocityValid", "status.yVelocityValid", "status.zVelocityValid",
    "velocityBeam1", "velocityBeam2", "velocityBeam3", "distanceBeam1", "distanceBeam2", "distanceBeam3",
    "velocityX", "velocityY", "velocityZ", "string",
]  # fmt: skip


def packets(dive: Told) -> list[Report]:
    """What the Nucleus says, packet by packet, in the order of time."""
    found: list[tuple[int, Report]] = []
    imu = dive.dive.imu
    for time_ns, force, rate in zip(
        imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True
    ):
        packet: Report = {"id": 130, "status.isValid": True}
        for place, axis in enumerate("xyz"):
            packet[f"accelerometer.{axis}"] = float(force[place])
            packet[f"gyro.{axis}"] = float(rate[place])
        found.append((time_ns, packet))
    for time_ns, velocity in zip(dive.time_ns.tolist(), dive.velocity_d, strict=True):
        packet = {"id": 180}
        for place, axis in enumerate("xyz"):
            is_valid = bool(np.isfinite(velocity[place]))
            packet[f"status.{axis}VelocityValid"] = is_valid
            packet[f"velocity{axis.upper()}"] = float(np.nan_to_num(velocity[place], nan=-32.768))
            packet[f"status.beam{place + 1}VelocityValid"] = False
            packet[f"velocityBeam{place + 1}"] = -32.768
            packet[f"distanceBeam{place + 1}"] = 0.0
        found.append((time_ns, packet))
    found.sort(key=lambda pair: pair[0])
    rows = []
    for time_ns, packet in found:
        seconds, rest_ns = divmod(time_ns, 10**9)
        head = {"sizeHeader": 10, "family": 32, "flags.posixTime": True}
        times = {"timeStamp": seconds, "microSeconds": rest_ns // 1000}
        rows.append({**head, **times, "timestampPython": seconds + 0.5, **packet})
    return rows


def as_table(rows: Sequence[Report], titles: Sequence[str] = TITLES) -> bytes:
    """Write packets as the logger of the driver does."""
    text = StringIO(newline="")
    writer = csv.DictWriter(text, titles)
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def nucleus(dive: Told) -> bytes:
    """Write the table of a Nucleus."""
    return as_table(packets(dive))


# --- Teledyne; the beams of these DVLs point elsewhere than those of a dive without a maker.

_PD6 = [teledyne_logs.Setup(teledyne_logs.INSTRUMENT)]
_IN_SHIP = teledyne_logs.Setup(teledyne_logs.SHIP)


def beams_of_teledyne(_: Told) -> Told:
    """What a DVL with Teledyne's beams says."""
    return teledyne_logs.dvl_told()


def velocities_of_teledyne(_: Told) -> Told:
    """What a DVL with Teledyne's beams makes of them."""
    return teledyne_logs.dvl_told().of_velocities()


def pd0(dive: Told) -> bytes:
    return b"".join(teledyne_logs.pd0(beams_of_teledyne(dive)))


def pd4(dive: Told) -> bytes:
    told = velocities_of_teledyne(dive)
    return b"".join(teledyne_logs.pd45(told, _IN_SHIP, is_pd5=False))


def pd5(dive: Told) -> bytes:
    told = velocities_of_teledyne(dive)
    return b"".join(teledyne_logs.pd45(told, _IN_SHIP, is_pd5=True))


def pd6(dive: Told) -> bytes:
    told = velocities_of_teledyne(dive)
    return "".join(teledyne_logs.pd6(told, _PD6, has_others=False)).encode()


# A sum does not tell bytes that have changed places from others, and PD6 has none.
FORMATS = {
    "water_linked_json": Written(
        "dvl.json", water_linked_json, lambda dive: dive, 1e-12, is_protected=False
    ),
    "water_linked_serial": Written("dvl.txt", water_linked_serial, lambda dive: dive, 0.000501),
    "nortek": Written("dvl.nmea", nortek, Told.of_velocities, 0.0000501),
    "cerulean": Written("dvl.log", cerulean, Told.of_velocities, 0.00251),
    "nucleus": Written(
        "nucleus_log.csv", nucleus, Told.single, 1e-12, has_imu=True, is_protected=False
    ),
    "ardupilot": Written(
        "00000042.BIN", ardupilot, Told.of_velocities, 2e-7, has_imu=True, is_protected=False
    ),
    "px4": Written("log_7.ulg", px4, Told.of_velocities, 2e-7, has_imu=True, is_protected=False),
    "pd0": Written("dvl.pd0", pd0, beams_of_teledyne, 0.000501, is_protected=False),
    "pd4": Written("dvl.pd4", pd4, velocities_of_teledyne, 0.000501, is_protected=False),
    "pd5": Written("dvl.pd5", pd5, velocities_of_teledyne, 0.000501, is_protected=False),
    "pd6": Written("dvl.pd6", pd6, velocities_of_teledyne, 0.000501, is_protected=False),
}
