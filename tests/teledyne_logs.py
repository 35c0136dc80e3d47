"""Bytes and lines as Teledyne's DVLs write them, of simulated dives, by the tables of the Pathfinder DVL Guide.

What is written is computed as the manuals print it, apart from the reader: the matrix from ship to earth element by
element, and each field at its byte.
"""

import struct
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from instrument_logs import Told, told

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.rotation import rpy_from_mat

BEAM, INSTRUMENT, SHIP, EARTH = range(4)
MISSING = -32768


def in_hundredths(dive: Told) -> Told:
    """The same with pings at whole hundredths of a second, as the clock of the DVL has them."""
    time_ns = dive.time_ns // 10_000_000 * 10_000_000
    return replace(
        dive, time_ns=time_ns, dive=replace(dive.dive, dvl=replace(dive.dive.dvl, time_ns=time_ns))
    )


def dvl_told(alignment_deg: float = 0.0, tilt_deg: float = 30.0) -> Told:
    """A dive with a DVL that looks down, whose beam 3 is turned from the bow."""
    azimuths = [270.0, 90.0, 0.0, 180.0]
    return in_hundredths(told(tilt_deg, tuple(azimuth + alignment_deg for azimuth in azimuths)))


@dataclass(frozen=True)
class Setup:
    """How a DVL was set up."""

    coordinates: int = BEAM
    uses_tilts: bool = False
    alignment_deg: float = 0.0
    looks_up: bool = False
    is_convex: bool = True
    beam_angle: int = 2  # 30 deg; 3: in a byte of its own
    has_century: bool = True

    @property
    def transform(self) -> int:
        """The byte of the command EX."""
        return self.coordinates << 3 | (4 if self.uses_tilts else 0) | 3


@dataclass(frozen=True)
class Pose:
    """What the sensors of the DVL say: tilts from the horizon, and the depth."""

    pitch: int  # 0.01 deg
    roll: int
    heading: int
    depth_m: float

    @property
    def mat(self) -> Floats:
        """The matrix from starboard, forward, up to east, north, up."""
        tilt = np.radians(0.01 * self.pitch)
        roll = np.radians(0.01 * self.roll)
        heading = np.radians(0.01 * self.heading)
        pitch = np.arctan(np.tan(tilt) * np.cos(roll))
        ch, sh = np.cos(heading), np.sin(heading)
        cp, sp = np.cos(pitch), np.sin(pitch)
        cr, sr = np.cos(roll), np.sin(roll)
        return np.array(
            [
                [ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * cr * sp],
                [-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr],
                [-cp * sr, sp, cp * cr],
            ]
        )

    def turned(self, velocity: Floats, setup: Setup) -> Floats:
        """A velocity starboard, forward, up as the instrument turns it."""
        pose = self
        if not setup.uses_tilts:
            pose = replace(pose, pitch=0, roll=0)
        if setup.coordinates == SHIP:
            pose = replace(pose, heading=0)
        return np.asarray(pose.mat @ velocity)


def poses(dive: Told) -> list[Pose]:
    """What the sensors say at each ping: the attitude and the depth of the reference just before it."""
    reference = dive.dive.reference
    assert reference is not None
    rows = np.searchsorted(reference.time_ns, dive.time_ns, "right") - 1
    found = []
    for row in rows.tolist():
        roll, pitch, heading = rpy_from_mat(reference.mat_nb[row])
        # Some degrees more than the vehicle has, which keeps to the horizon.
        roll += 0.06
        pitch -= 0.09
        tilt = np.arctan(np.tan(pitch) / np.cos(roll))
        angles = np.rint(np.degrees([tilt, roll, heading % (2.0 * np.pi)]) * 100.0).astype(int)
        depth_m = -float(reference.position[row, 2])
        found.append(Pose(int(angles[0]), int(angles[1]), int(angles[2]) % 36_000, depth_m))
    return found


def instrument_axes(velocity_d: Floats, setup: Setup) -> Floats:
    """A velocity forward, starboard, down in x, y, z of the instrument."""
    angle = np.radians(setup.alignment_deg)
    forward, starboard, down = velocity_d
    y = np.cos(angle) * forward + np.sin(angle) * starboard
    x = -np.sin(angle) * forward + np.cos(angle) * starboard
    if setup.looks_up:
        return np.array([-x, y, down])
    return np.array([x, y, -down])


def words(velocity_mps: Floats) -> list[int]:
    """Velocities in mm/s; all are missing where one is."""
    if not np.isfinite(velocity_mps).all():
        return [MISSING] * len(velocity_mps)
    return [int(number) for number in np.rint(velocity_mps * 1000.0)]


def vessel_words(velocity_d: Floats, pose: Pose, setup: Setup) -> list[int]:
    """The velocity of the vessel in mm/s, and the error velocity."""
    if setup.coordinates == INSTRUMENT:
        axes = instrument_axes(velocity_d, setup)
    else:
        forward, starboard, down = velocity_d
        axes = np.array([starboard, forward, -down])
        if setup.coordinates == EARTH or setup.uses_tilts:
            axes = pose.turned(axes, setup)
    numbers = words(axes)
    return [*numbers, MISSING if MISSING in numbers else 3]


def summed(content: bytes) -> bytes:
    """Put the sum behind a record."""
    return content + struct.pack("<H", sum(content) & 0xFFFF)


def clock(time_ns: int) -> tuple[datetime, int]:
    """The second and the hundredths of a time."""
    seconds, ns = divmod(time_ns, 10**9)
    return datetime.fromtimestamp(seconds, UTC), ns // 10_000_000


# --- PD0.


def fixed_leader(setup: Setup) -> bytes:
    content = bytearray(59)
    system = 0x4048 | 0x02 | setup.beam_angle << 8  # 4 beams, convex, attached, 300 kHz
    if setup.looks_up:
        system |= 0x80
    if not setup.is_convex:
        system ^= 0x08
    struct.pack_into("<HBBH", content, 0, 0x0000, 50, 40, system)
    content[8] = 4
    content[25] = setup.transform
    struct.pack_into("<h", content, 26, round(100 * setup.alignment_deg))
    content[30] = 0x7D
    content[58] = 25
    return bytes(content)


def variable_leader(time_ns: int, number: int, pose: Pose, setup: Setup) -> bytes:
    second, hundredths = clock(time_ns)
    fields = (second.month, second.day, second.hour, second.minute, second.second, hundredths)
    content = bytearray(65 if setup.has_century else 57)
    struct.pack_into("<HH", content, 0, 0x0080, number & 0xFFFF)
    struct.pack_into("7B", content, 4, second.year % 100, *fields)
    content[11] = number >> 16
    struct.pack_into("<HH", content, 14, 1500, round(10 * pose.depth_m))
    struct.pack_into("<Hhh", content, 18, pose.heading, pose.pitch, pose.roll)
    struct.pack_into("<Hh", content, 24, 35, 1234)
    if setup.has_century:
        struct.pack_into("<I", content, 48, round(pose.depth_m * 1025.0 * 9.80665 / 10.0))
        struct.pack_into("8B", content, 57, second.year // 100, second.year % 100, *fields)
    return bytes(content)


def bottom_track(numbers: list[int]) -> bytes:
    content = bytearray(85)
    struct.pack_into("<HH", content, 0, 0x0600, 1)
    ranges_cm = [0 if number == MISSING else 70_000 for number in numbers]
    struct.pack_into("<4H", content, 16, *(value & 0xFFFF for value in ranges_cm))
    struct.pack_into("<4h", content, 24, *numbers)
    struct.pack_into("4B4B4B", content, 32, *[200] * 4, *[90] * 4, *[100] * 4)
    struct.pack_into("<4h", content, 50, *[MISSING] * 4)  # over the water
    struct.pack_into("4B", content, 77, *(value >> 16 for value in ranges_cm))
    return bytes(content)


def pd0_ensemble(types: list[bytes]) -> bytes:
    offset = 6 + 2 * len(types)
    offsets = []
    for content in types:
        offsets.append(offset)
        offset += len(content)
    head = struct.pack(f"<2sHBB{len(types)}H", b"\x7f\x7f", offset, 0, len(types), *offsets)
    return summed(head + b"".join(types))


def pd0(dive: Told, setup: Setup = Setup()) -> list[bytes]:
    """The ensembles of a dive."""
    ensembles = []
    pings = zip(dive.time_ns.tolist(), dive.velocity_d, dive.beams_mps, poses(dive), strict=True)
    for number, (time_ns, velocity_d, beams_mps, pose) in enumerate(pings, 1):
        if setup.coordinates == BEAM:
            numbers = [words(beam)[0] for beam in beams_mps[:, None]]
        else:
            # Those of the bottom, as the instrument sees it.
            numbers = []
            for value in vessel_words(velocity_d, pose, setup):
                numbers.append(value if value == MISSING else -value)
        profile = struct.pack("<H", 0x0100) + bytes(40)
        types = [
            fixed_leader(setup),
            variable_leader(time_ns, number, pose, setup),
            profile,
            bottom_track(numbers),
        ]
        ensembles.append(pd0_ensemble(types))
    return ensembles


# --- PD4 and PD5.


def pd45(dive: Told, setup: Setup, *, is_pd5: bool) -> list[bytes]:
    """The ensembles of a dive in the one structure or in the other."""
    ensembles = []
    pings = zip(dive.time_ns.tolist(), dive.velocity_d, poses(dive), strict=True)
    for time_ns, velocity_d, pose in pings:
        second, hundredths = clock(time_ns)
        numbers = vessel_words(velocity_d, pose, setup)
        content = bytearray(86 if is_pd5 else 45)
        struct.pack_into("<BBH", content, 0, 0x7D, int(is_pd5), len(content))
        content[4] = setup.coordinates << 6 | (0x20 if setup.uses_tilts else 0) | 0x13
        struct.pack_into("<4h4H", content, 5, *numbers, *[1234] * 4)
        struct.pack_into("<4h", content, 22, *[MISSING] * 4)
        struct.pack_into("4B", content, 35, second.hour, second.minute, second.second, hundredths)
        struct.pack_into("<Hh", content, 41, 1500, 1234)
        if is_pd5:
            struct.pack_into("<BH", content, 45, 35, round(10 * pose.depth_m))
            struct.pack_into("<hhH", content, 48, pose.pitch, pose.roll, pose.heading)
        ensembles.append(summed(bytes(content)))
    return ensembles


# --- PD6.


def pd6(dive: Told, setups: list[Setup], *, has_others: bool = True) -> list[str]:
    """The lines of each ensemble of a dive, with velocities in some coordinates; others are those of the water."""
    names = {INSTRUMENT: "BI", SHIP: "BS", EARTH: "BE"}
    ensembles = []
    pings = zip(dive.time_ns.tolist(), dive.velocity_d, poses(dive), strict=True)
    for time_ns, velocity_d, pose in pings:
        second, hundredths = clock(time_ns)
        lines = [
            f":SA,{pose.pitch / 100:+6.2f},{pose.roll / 100:+6.2f},{pose.heading / 100:6.2f}",
            f":TS,{second:%y%m%d%H%M%S}{hundredths:02},35.0,+12.3,{pose.depth_m:6.1f},1500.0,  0",
        ]
        if has_others:
            lines.append(":WI,-32768,-32768,-32768,-32768,V")
        for setup in setups:
            numbers = vessel_words(velocity_d, pose, setup)
            status = "V" if MISSING in numbers else "A"
            if setup.coordinates != INSTRUMENT:
                numbers = numbers[:3]
            shown = ",".join(f"{number:+6d}" for number in numbers)
            lines.append(f":{names[setup.coordinates]},{shown},{status}")
        if has_others:
            lines.append(":BD,       +0.00,       +0.00,       +0.00,  12.34,  0.00")
        ensembles.append("".join(line + "\r\n" for line in lines))
    return ensembles
