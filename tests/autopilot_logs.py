"""Logs as autopilots write them, of simulated dives: DataFlash of ArduPilot and ULog of PX4, as these are published."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from instrument_logs import Told

from insdvl_replay.core.dive_columns import Floats, Integers, TimeNs
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.rotation import rpy_from_mat

Values = Sequence[Any]
Timed = tuple[int, int, bytes]
"""Nanoseconds, a number that keeps the order of what has the same time, a message."""
DVL_INTERVAL_S = 0.125
GPS_EPOCH_S = 315_964_800 - 18
WEEK_S = 604_800


@dataclass(frozen=True)
class Truth:
    """What receiver and filter of a vehicle may say, at the times of the reference."""

    time_ns: TimeNs
    position: Floats  # (k, 3), deg, deg, m
    moved_n: Floats  # (k, 3), m from the first one
    velocity_n: Floats
    rpy_deg: Floats

    @classmethod
    def of(cls, told: Told) -> "Truth":
        reference = told.dive.reference
        assert reference is not None
        latitude, longitude, height = reference.position.T
        north_m = (latitude - latitude[0]) * (meridian_radius_m(latitude[0]) + height[0])
        radius_m = (transverse_radius_m(latitude[0]) + height[0]) * np.cos(latitude)
        east_m = (longitude - longitude[0]) * radius_m
        position = np.stack([latitude / DEG, longitude / DEG, height], axis=1)
        return cls(
            reference.time_ns,
            position,
            np.stack([north_m, east_m, height[0] - height], axis=1),
            reference.velocity_n,
            rpy_from_mat(reference.mat_nb) / DEG,
        )


def whole_ms_before(time_ns: int, seconds: int = 100) -> int:
    """The start of a vehicle, in whole milliseconds."""
    return time_ns // 10**6 * 10**6 - seconds * 10**9


# --- DataFlash. Sources of the layouts: ArduPilot's LogStructure.h of each library.

# Name: number, letters, labels.
FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "UNIT": (129, "QbZ", "TimeUS,Id,Label"),
    "GPS": (130, "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "IMU": (131, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "RFRH": (132, "QI", "TimeUS,TF"),
    "RISH": (133, "HBBfBB", "LR,PG,PA,LD,AC,GC"),
    "RISI": (134, "ffffffffBB", "DVX,DVY,DVZ,DAX,DAY,DAZ,DVDT,DADT,Flags,I"),
    "VISO": (135, "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf"),
    "RBOH": (136, "ffffffffIfffH", "Q,DPX,DPY,DPZ,DAX,DAY,DAZ,DT,TS,OX,OY,OZ,D"),
    "BARO": (137, "QBffffcfIffB", "TimeUS,I,Alt,AltAMSL,Press,Temp2,Temp,CRt,SMS,Offset,GndTemp,Health"),
    "AHR2": (138, "QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
    "XKF1": (139, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "XKF4": (140, "QBcccccfffHBIHb", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE,FS,TS,SS,GPS,PI"),
    "ORGN": (141, "QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "MAG": (142, "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"),
    "IMT": (143, "QBfffffffff", "TimeUS,I,DelT,DelvT,DelaT,DelAX,DelAY,DelAZ,DelVX,DelVY,DelVZ"),
}  # fmt: skip
_PACKED = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q", "f": "f", "d": "d",
    "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B",
}  # fmt: skip


def record(name: str, *values: Any) -> bytes:
    """One record of DataFlash, of raw values."""
    number, letters, _ = FORMATS[name]
    packed = "<" + "".join(_PACKED[letter] for letter in letters)
    return bytes([0xA3, 0x95, number]) + struct.pack(packed, *values)


def format_records(names: Iterable[str] = FORMATS) -> bytes:
    """The records FMT of some kinds, as each log begins with them."""
    found = b""
    for name in names:
        number, letters, labels = FORMATS[name]
        size = 3 + struct.calcsize("<" + "".join(_PACKED[letter] for letter in letters))
        texts = [text.encode() for text in (name, letters, labels)]
        found += record("FMT", number, size, *texts)
    return found


def hundredths(values: Floats) -> list[int]:
    return [int(value) for value in np.rint(100.0 * values)]


class Dataflash:
    """A log of ArduSub of a dive."""

    def __init__(self, told: Told, start_ns: int | None = None) -> None:
        self.told = told
        self.truth = Truth.of(told)
        self.start_ns = start_ns or whole_ms_before(int(told.dive.imu.time_ns[0]))
        self._records: list[Timed] = []

    def add(self, time_ns: int, content: bytes) -> None:
        self._records.append((time_ns, len(self._records), content))

    def us(self, time_ns: int) -> int:
        return (time_ns - self.start_ns) // 1000

    def content(self) -> bytes:
        """The log, in the order of times."""
        ordered = [content for _, _, content in sorted(self._records)]
        return format_records() + b"".join(ordered)

    def add_increments(self, primary: int = 0, others: Sequence[int] = (1,)) -> None:
        """RFRH, RISH and RISI of LOG_REPLAY: increments up to the time of each frame."""
        imu = self.told.dive.imu
        step_ns = int(np.median(np.diff(imu.time_ns)))
        interval_s = float(np.float32(step_ns * 1e-9))
        head = record("RISH", 1_000_000_000 // step_ns, primary, primary, interval_s, 2, 2)
        self.add(int(imu.time_ns[0]) - step_ns, head)
        for time_ns, force, rate in zip(
            imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True
        ):
            end_ns = time_ns + step_ns // 2
            frame = record("RFRH", self.us(end_ns), 0)
            for other in others:
                frame += self._increment(0.5 * force, 0.5 * rate, interval_s, other)
            self.add(end_ns, frame + self._increment(force, rate, interval_s, primary))

    def _increment(self, force: Floats, rate: Floats, interval_s: float, instance: int) -> bytes:
        values = [*(force * interval_s), *(rate * interval_s), interval_s, interval_s]
        return record("RISI", *values, 0b1111, instance)

    def add_deltas(self) -> None:
        """IMT, with the same increments."""
        imu = self.told.dive.imu
        step_ns = int(np.median(np.diff(imu.time_ns)))
        s = step_ns * 1e-9
        for time_ns, force, rate in zip(
            imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True
        ):
            end_ns = time_ns + step_ns // 2
            self.add(end_ns, record("IMT", self.us(end_ns), 0, s, s, s, *(rate * s), *(force * s)))

    def add_samples(self, factor: float = 1.0) -> None:
        """IMU, as it is logged by default; those of a second one are half as large."""
        imu = self.told.dive.imu
        for time_ns, force, rate in zip(
            imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True
        ):
            for instance in (0, 1):
                part = factor / (1 + instance)
                values = [self.us(time_ns), instance, *(part * rate), *(part * force)]
                self.add(time_ns, record("IMU", *values, 0, 0, 30.0, 1, 1, 1000, 1000))

    def add_displacements(self, name: str = "VISO") -> None:
        """VISO or RBOH: displacements over an interval that ends at their times; a lost ping has no confidence."""
        dt = DVL_INTERVAL_S
        for time_ns, velocity in zip(
            self.told.time_ns.tolist(), self.told.velocity_d, strict=True
        ):
            end_ns = time_ns + int(dt * 0.5e9)
            confidence = 100.0 if np.isfinite(velocity).all() else 0.0
            moved = np.nan_to_num(velocity) * dt
            if name == "VISO":
                content = record("VISO", self.us(end_ns), dt, 0, 0, 0, *moved, confidence)
            else:
                ms = self.us(end_ns) // 1000
                content = record("RBOH", confidence, *moved, 0, 0, 0, dt, ms, 0, 0, 0, 0)
            self.add(end_ns, content)

    def add_fixes(self) -> None:
        """GPS, with the time of the week."""
        for time_ns, (latitude, longitude, height) in zip(
            self.truth.time_ns.tolist(), self.truth.position, strict=True
        ):
            gps_ns = time_ns - GPS_EPOCH_S * 10**9
            week, rest_ns = divmod(gps_ns, WEEK_S * 10**9)
            place = [round(latitude * 1e7), round(longitude * 1e7), round(height * 100)]
            values = [self.us(time_ns), 0, 3, rest_ns // 10**6, week, 12, 80, *place]
            self.add(time_ns, record("GPS", *values, 0.0, 0.0, 0.0, 0.0, 1))

    def add_pressure(self) -> None:
        """BARO: in the hull, and in the water."""
        for time_ns, (_, _, height) in zip(
            self.truth.time_ns.tolist(), self.truth.position, strict=True
        ):
            water_pa = 101_325.0 - 1025.0 * 9.80665 * height
            for instance, pressure in enumerate((101_325.0, water_pa)):
                values = [self.us(time_ns), instance, height, height, pressure, 0.0, 2000, 0.0]
                self.add(time_ns, record("BARO", *values, 0, 0.0, 0.0, 1))

    def add_attitude(self) -> None:
        """AHR2."""
        for time_ns, rpy in zip(self.truth.time_ns.tolist(), self.truth.rpy_deg, strict=True):
            roll, pitch, yaw = hundredths(rpy)
            angles = [roll, pitch, yaw % 36000]
            self.add(
                time_ns, record("AHR2", self.us(time_ns), *angles, 0.0, 0, 0, 1.0, 0.0, 0.0, 0.0)
            )

    def add_solution(self, stretch: float = 1.01, primary: int = 0) -> None:
        """ORGN, XKF4, and XKF1 of two cores: the primary one is stretched a little, the other one is wrong."""
        truth = self.truth
        latitude, longitude, height = truth.position[0]
        place = [round(latitude * 1e7), round(longitude * 1e7), round(height * 100)]
        first_ns = int(truth.time_ns[0])
        self.add(first_ns - 2, record("ORGN", self.us(first_ns), 0, *place))
        self.add(
            first_ns - 1, record("ORGN", self.us(first_ns), 1, 0, 0, 0)
        )  # of the vehicle's home
        for time_ns, moved, velocity, rpy in zip(
            truth.time_ns.tolist(), truth.moved_n, truth.velocity_n, truth.rpy_deg, strict=True
        ):
            self.add(time_ns, record("XKF4", self.us(time_ns), 0, *[0] * 12, primary))
            for core in (0, 1):
                right = core == primary
                roll, pitch, yaw = hundredths(rpy if right else rpy + 5.0)
                angles = [roll, pitch, yaw % 36000]
                factor = stretch if right else 3.0
                motion = [*(factor * velocity), 0.0, *(factor * moved)]
                content = record(
                    "XKF1", self.us(time_ns), core, *angles, *motion, 0, 0, 0, place[2]
                )
                self.add(time_ns, content)

    def add_compass(self) -> None:
        """MAG, of which a replay has no use."""
        for time_ns in self.truth.time_ns.tolist():
            self.add(time_ns, record("MAG", self.us(time_ns), 0, *[0] * 9, 1, 0))

    def whole(self) -> bytes:
        """A log with LOG_REPLAY and all that a vehicle has."""
        self.add_increments()
        self.add_samples(0.5)
        self.add_displacements("VISO")
        self.add_displacements("RBOH")
        self.add_fixes()
        self.add_pressure()
        self.add_attitude()
        self.add_solution()
        self.add_compass()
        return self.content()


def ardupilot(told: Told) -> bytes:
    """A log with LOG_REPLAY in which a replay has a use for every record."""
    log = Dataflash(told)
    log.add_increments()
    log.add_displacements("VISO")
    log.add_fixes()
    log.add_pressure()
    log.add_attitude()
    return log.content()


# --- ULog. Source: PX4 User Guide, "ULog File Format"; the layouts are those of px4_msgs.

ULOG_MAGIC = b"ULog\x01\x125\x01"
SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])
LAYOUTS = {
    "sensor_combined": (
        "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;int32_t accelerometer_timestamp_relative;"
        "float[3] accelerometer_m_s2;uint32_t accelerometer_integral_dt;uint8_t accelerometer_clipping;"
        "uint8_t gyro_clipping;uint8_t accel_calibration_count;uint8_t gyro_calibration_count;",
        "<Q3fIi3fI4B",
    ),
    "vehicle_imu": (
        "uint64_t timestamp;uint64_t timestamp_sample;uint32_t accel_device_id;uint32_t gyro_device_id;"
        "float[3] delta_angle;float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt;"
        "uint8_t delta_angle_clipping;uint8_t delta_velocity_clipping;uint8_t[6] _padding0;",
        "<QQII3f3fIIBB",
    ),
    "vehicle_visual_odometry": (
        "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;float[3] velocity;"
        "float[3] angular_velocity;float[3] position_variance;float[3] orientation_variance;"
        "float[3] velocity_variance;uint8_t pose_frame;uint8_t velocity_frame;uint8_t reset_counter;int8_t quality;"
        "uint8_t[4] _padding0;",
        "<QQ3f4f3f3f3f3f3f3Bb",
    ),
    "vehicle_attitude": (
        "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;float[4] delta_q_reset;uint8_t quat_reset_counter;"
        "uint8_t[7] _padding0;",
        "<QQ4f4fB",
    ),
    "sensor_gps": (
        "uint64_t timestamp;uint64_t timestamp_sample;double latitude_deg;double longitude_deg;"
        "double altitude_ellipsoid_m;uint64_t time_utc_usec;uint8_t fix_type;uint8_t[7] _padding0;",
        "<QQdddQB",
    ),
    "cpuload": ("uint64_t timestamp;float load;load_part[2] parts;char[3] name;", "<Qf2f3s"),
    "load_part": ("float share;", "<f"),
}
LAYOUTS["vehicle_odometry"] = LAYOUTS["vehicle_visual_odometry"]


def message(kind: str, content: bytes) -> bytes:
    return struct.pack("<Hc", len(content), kind.encode()) + content


class Ulog:
    """A log of PX4 of a dive."""

    def __init__(self, told: Told, start_ns: int | None = None) -> None:
        self.told = told
        self.truth = Truth.of(told)
        self.start_ns = start_ns or whole_ms_before(int(told.dive.imu.time_ns[0]))
        self._topics: list[tuple[str, int]] = []
        self._messages: list[Timed] = []

    def us(self, time_ns: int) -> int:
        return (time_ns - self.start_ns) // 1000

    def add(self, time_ns: int, name: str, *values: Any, instance: int = 0) -> None:
        key = (name, instance)
        if key not in self._topics:
            self._topics.append(key)
        packed = struct.pack(LAYOUTS[name][1], self.us(time_ns), *values)
        content = struct.pack("<H", self._topics.index(key)) + packed
        self._messages.append((time_ns, len(self._messages), message("D", content)))

    def add_raw(self, time_ns: int, content: bytes) -> None:
        self._messages.append((time_ns, len(self._messages), content))

    def definitions(self) -> bytes:
        found = ULOG_MAGIC + struct.pack("<Q", 0) + message("B", bytes(40))
        for name, (fields, _) in LAYOUTS.items():
            found += message("F", f"{name}:{fields}".encode())
        found += message("I", b"\x0echar[4] sysPX4 ")
        for number, (name, instance) in enumerate(self._topics):
            found += message("A", struct.pack("<BH", instance, number) + name.encode())
        return found

    def content(self) -> bytes:
        """The log, in the order of times."""
        ordered = [content for _, _, content in sorted(self._messages)]
        return self.definitions() + b"".join(ordered)

    def add_samples(self) -> None:
        """The topic sensor_combined, stamped at the end of its interval; vehicle_imu comes too seldom."""
        imu = self.told.dive.imu
        step_ns = int(np.median(np.diff(imu.time_ns)))
        step_us = step_ns // 1000
        for number, (time_ns, force, rate) in enumerate(
            zip(imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True)
        ):
            end_ns = time_ns + step_ns // 2
            values = [*rate, step_us, 0, *force, step_us, 0, 0, 0, 0]
            self.add(end_ns, "sensor_combined", *values)
            if number % 25 == 0:
                self._add_increment(end_ns, 0.5 * force, 0.5 * rate, step_us, 0)

    def add_increments(self) -> None:
        """The topic vehicle_imu of two IMUs; the second one is wrong."""
        imu = self.told.dive.imu
        step_ns = int(np.median(np.diff(imu.time_ns)))
        for time_ns, force, rate in zip(
            imu.time_ns.tolist(), imu.specific_force_b, imu.angular_rate_b, strict=True
        ):
            end_ns = time_ns + step_ns // 2
            self._add_increment(end_ns, force, rate, step_ns // 1000, 0)
            self._add_increment(end_ns, 0.5 * force, 0.5 * rate, step_ns // 1000, 1)

    def _add_increment(
        self, end_ns: int, force: Floats, rate: Floats, step_us: int, instance: int
    ) -> None:
        step_s = step_us * 1e-6
        values = [
            self.us(end_ns),
            1,
            2,
            *(rate * step_s),
            *(force * step_s),
            step_us,
            step_us,
            0,
            0,
        ]
        self.add(end_ns, "vehicle_imu", *values, instance=instance)

    def add_velocities(self, frame: int = 3) -> None:
        """The topic vehicle_visual_odometry; a lost ping has no numbers."""
        nothing = [np.nan] * 3
        for time_ns, velocity in zip(
            self.told.time_ns.tolist(), self.told.velocity_d, strict=True
        ):
            values = [self.us(time_ns), *nothing, *[np.nan] * 4, *velocity, *nothing * 4]
            # It is received 5 ms later.
            self.add(time_ns + 5_000_000, "vehicle_visual_odometry", *values, 0, frame, 0, 0)

    def add_fixes(self) -> None:
        """The topic sensor_gps."""
        for time_ns, (latitude, longitude, height) in zip(
            self.truth.time_ns.tolist(), self.truth.position, strict=True
        ):
            utc_us = time_ns // 1000
            values = [self.us(time_ns), latitude, longitude, height, utc_us, 3]
            self.add(time_ns, "sensor_gps", *values)

    def add_solution(self, stretch: float = 1.01) -> None:
        """The topic vehicle_odometry, of the vehicle's filter."""
        reference = self.told.dive.reference
        assert reference is not None
        nothing = [np.nan] * 3
        for time_ns, moved, velocity, rpy in zip(
            self.truth.time_ns.tolist(),
            self.truth.moved_n,
            self.truth.velocity_n,
            self.truth.rpy_deg,
            strict=True,
        ):
            quaternion = quaternion_of(rpy * DEG)
            values = [*(stretch * moved), *quaternion, *(stretch * velocity), *nothing * 4]
            self.add(time_ns, "vehicle_odometry", self.us(time_ns), *values, 1, 1, 0, 0)

    def add_loads(self) -> None:
        """The topic cpuload, of which a replay has no use."""
        for time_ns in self.truth.time_ns.tolist():
            self.add(time_ns, "cpuload", 0.5, 0.1, 0.2, b"abc")

    def whole(self) -> bytes:
        """A log with all that a vehicle has."""
        self.add_samples()
        self.add_velocities()
        self.add_fixes()
        self.add_solution()
        self.add_loads()
        self.add_raw(int(self.told.time_ns[5]), message("S", SYNC))
        self.add_raw(int(self.told.time_ns[6]), message("L", b"6" + bytes(8) + b"dive"))
        return self.content()


def px4(told: Told) -> bytes:
    """A log in which a replay has a use for every message."""
    log = Ulog(told)
    log.add_samples()
    log.add_velocities()
    log.add_fixes()
    return log.content()


def quaternion_of(rpy: Floats) -> list[float]:
    """The quaternion of roll, pitch and heading, w first."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * rpy), np.sin(0.5 * rpy)
    return [
        float(cr * cp * cy + sr * sp * sy),
        float(sr * cp * cy - cr * sp * sy),
        float(cr * sp * cy + sr * cp * sy),
        float(cr * cp * sy - sr * sp * cy),
    ]


def flipped(content: bytes, places: Integers) -> bytes:
    """Turn over a bit of some bytes."""
    array = np.frombuffer(content, np.uint8).copy()
    array[places] ^= 0x10
    return array.tobytes()
