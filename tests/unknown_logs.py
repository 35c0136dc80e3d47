"""One dive in message types of nobody: other encodings, names, units, axes and stamps, and the same in known types."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.writer import Writer as RosWriter

from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

MS = 1_000_000
G_MPS2 = 9.80665
FLU = np.array([1.0, -1.0, -1.0])
RULE = "=" * 80
HEADER = (
    f"{RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
Sample = tuple[int, int, np.ndarray, np.ndarray]
"""Time of validity and of recording in ns, specific force, angular rate."""
Ping = tuple[int, int, np.ndarray]
"""Time of validity and of recording in ns, velocity."""


def plain_dive(scenario: str, imu_rate_hz: float = 100.0) -> Dive:
    """Simulate a dive whose DVL gives velocities, with times in whole milliseconds, and without a reference."""
    dive = simulate_dive(
        scenario, seed=3, duration_s=150.0, imu_rate_hz=imu_rate_hz, grade="tactical"
    )
    beams, vectors = dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d
    assert beams is not None
    assert vectors is not None
    velocity_d = beams @ np.linalg.pinv(vectors).T
    pings = replace(dive.dvl, time_ns=dive.dvl.time_ns // MS * MS, velocity_d=velocity_d)
    return Dive(
        "plain",
        dive.imu,
        replace(pings, beam_velocity_mps=None, beam_vectors_d=None),
        dive.reference,
    )


def samples(dive: Dive) -> Iterator[Sample]:
    late_ns = np.random.default_rng(4).integers(1, 20, len(dive.imu.time_ns)) * MS
    columns = (
        dive.imu.time_ns,
        dive.imu.time_ns + late_ns,
        dive.imu.specific_force_b,
        dive.imu.angular_rate_b,
    )
    return ((int(at), int(by), force, rate) for at, by, force, rate in zip(*columns, strict=True))


def pings(dive: Dive) -> Iterator[Ping]:
    late_ns = np.random.default_rng(5).integers(30, 60, len(dive.dvl.time_ns)) * MS
    columns = (dive.dvl.time_ns, dive.dvl.time_ns + late_ns, dive.dvl.velocity_d)
    return ((int(at), int(by), velocity) for at, by, velocity in zip(*columns, strict=True))


def stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def known_types(path: Path, dive: Dive) -> None:
    write_dive(path, replace(dive, reference=None))


def nested_cdr(path: Path, dive: Dive) -> None:
    """Single numbers within a structure, and a time that is no header."""
    box = f"std_msgs/Header header\nacme_msgs/Inertial raw\nfloat32 celsius\n{RULE}\nMSG: acme_msgs/Inertial\n"
    box += (
        f"float64 acc_x\nfloat64 acc_y\nfloat64 acc_z\nfloat64 p\nfloat64 q\nfloat64 r\n{HEADER}"
    )
    track = f"builtin_interfaces/Time measured_at\nfloat64 u\nfloat64 v\nfloat64 w\nuint8 lock\n{HEADER}"
    with path.open("wb") as stream:
        writer = RosWriter(stream)
        inertial = writer.register_msgdef("acme_msgs/msg/Box", box)
        ground = writer.register_msgdef("acme_msgs/msg/Track", track)
        for at, by, force, rate in samples(dive):
            raw = dict(
                zip(("acc_x", "acc_y", "acc_z", "p", "q", "r"), (*force, *rate), strict=True)
            )
            message = {
                "header": {"stamp": stamp(at), "frame_id": "box"},
                "raw": raw,
                "celsius": 11.0,
            }
            writer.write_message("/box", inertial, message, log_time=by, publish_time=by)
        for at, by, velocity in pings(dive):
            message = {
                "measured_at": stamp(at),
                **dict(zip("uvw", velocity, strict=True)),
                "lock": 1,
            }
            writer.write_message("/dvl/track", ground, message, log_time=by, publish_time=by)
        writer.finish()


def bare_json(path: Path, dive: Dive) -> None:
    """No schema; g and deg/s in forward-port-up, lists and objects, milliseconds since 1970."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        inertial, ground = (
            writer.register_channel(topic, "json", 0) for topic in ("motion", "doppler")
        )

        def write(channel: int, by: int, message: dict[str, Any]) -> None:
            writer.add_message(channel, by, json.dumps(message).encode(), by)

        for at, by, force, rate in samples(dive):
            gyro = dict(zip("xyz", FLU * rate / DEG, strict=True))
            write(
                inertial,
                by,
                {
                    "t_ms": at // MS,
                    "accel": (FLU * force / G_MPS2).tolist(),
                    "gyro": gyro,
                    "id": "a",
                },
            )
        for at, by, velocity in pings(dive):
            write(ground, by, {"t_ms": at // MS, "vel": velocity.tolist(), "state": "bottom"})
        writer.finish()


def nameless_json(path: Path, dive: Dive) -> None:
    """Single numbers whose names say nothing."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        one, two = (writer.register_channel(topic, "json", 0) for topic in ("one", "two"))
        for at, _, force, rate in samples(dive):
            names = ("gamma", "delta", "epsilon", "zeta", "eta", "alpha")
            message = {"name": "a", **dict(zip(names, (*force, *rate), strict=True))}
            writer.add_message(one, at, json.dumps(message).encode(), at)
        for at, _, velocity in pings(dive):
            message = dict(zip(("east", "west", "south"), velocity, strict=True))
            writer.add_message(two, at, json.dumps(message).encode(), at)
        writer.finish()


def numbered_beams(path: Path, dive: Dive) -> None:
    """An IMU of a known type, and a DVL of an unknown one that gives its four beams as single numbers."""
    own, known = path.with_suffix(".own"), path.with_suffix(".known")
    azimuth = np.deg2rad([45.0, 135.0, 225.0, 315.0])
    tilt = np.deg2rad(25.0)
    vectors = np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(4, np.cos(tilt))],
        1,
    )
    with own.open("wb") as stream:
        writer = RosWriter(stream)
        names = [f"vel_beam_{beam}" for beam in (1, 2, 3, 4)]
        schema = writer.register_msgdef(
            "acme_msgs/msg/Beams", "".join(f"float64 {name}\n" for name in names)
        )
        for at, _, velocity in pings(dive):
            message = dict(zip(names, vectors @ velocity, strict=True))
            writer.write_message("/beams", schema, message, log_time=at, publish_time=at)
        writer.finish()
    known_types(known, dive)
    _copy({own: ("/beams",), known: ("/imu",)}, path)


def protobuf(path: Path, dive: Dive) -> None:
    """Structures in structures; no field keeps step with a clock but one in microseconds."""
    file = FileDescriptorProto(name="acme.proto", package="acme", syntax="proto3")

    def message(name: str, fields: dict[str, str]) -> None:
        described = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            scalar = getattr(
                FieldDescriptorProto, f"TYPE_{kind}", FieldDescriptorProto.TYPE_MESSAGE
            )
            type_name = None if scalar != FieldDescriptorProto.TYPE_MESSAGE else f".acme.{kind}"
            described.field.add(
                name=field, number=number, label=1, type=scalar, type_name=type_name
            )

    message("Triple", {"x": "DOUBLE", "y": "DOUBLE", "z": "DOUBLE"})
    message("Sensors", {"accelerations": "Triple", "rates": "Triple", "magnetic": "Triple"})
    message("Motion", {"sensor_time_us": "UINT64", "sensors": "Sensors"})
    message("Ground", {"sensor_time_us": "UINT64", "speed": "Triple", "quality": "INT32"})
    pool = DescriptorPool()
    pool.Add(file)
    motion: Any = GetMessageClass(pool.FindMessageTypeByName("acme.Motion"))
    ground: Any = GetMessageClass(pool.FindMessageTypeByName("acme.Ground"))

    def triple(vector: np.ndarray) -> dict[str, float]:
        return dict(zip("xyz", vector.tolist(), strict=True))

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        described = FileDescriptorSet(file=[file]).SerializeToString()
        schemas = (
            writer.register_schema(f"acme.{name}", "protobuf", described)
            for name in ("Motion", "Ground")
        )
        channels = [
            writer.register_channel(topic, "protobuf", schema)
            for topic, schema in zip("mg", schemas, strict=True)
        ]
        for at, by, force, rate in samples(dive):
            sensors = {
                "accelerations": triple(force),
                "rates": triple(rate),
                "magnetic": triple(force * 4.0),
            }
            data = motion(sensor_time_us=at // 1000, sensors=sensors).SerializeToString()
            writer.add_message(channels[0], by, data, by)
        for at, by, velocity in pings(dive):
            data = ground(
                sensor_time_us=at // 1000, speed=triple(velocity), quality=9
            ).SerializeToString()
            writer.add_message(channels[1], by, data, by)
        writer.finish()


def turned(path: Path, dive: Dive, turn: Callable[[np.ndarray], np.ndarray]) -> None:
    """Other axes and units, beside the reference of a known type: what data can decide."""
    box = f"std_msgs/Header header\nfloat64[3] acceleration\nfloat64[3] angular_rate\n{HEADER}"
    track = "uint64 stamp_ms\nfloat64 vx\nfloat64 vy\nfloat64 vz\n"
    own, known = path.with_suffix(".own"), path.with_suffix(".known")
    with own.open("wb") as stream:
        writer = RosWriter(stream)
        inertial = writer.register_msgdef("acme_msgs/msg/Unit", box)
        ground = writer.register_msgdef("acme_msgs/msg/Ground", track)
        for at, by, force, rate in samples(dive):
            readings = {
                "acceleration": turn(force / G_MPS2).tolist(),
                "angular_rate": turn(rate / DEG).tolist(),
            }
            message = {"header": {"stamp": stamp(at), "frame_id": ""}, **readings}
            writer.write_message("/unit", inertial, message, log_time=by, publish_time=by)
        for at, by, velocity in pings(dive):
            speeds = dict(zip(("vx", "vy", "vz"), FLU * velocity * 1000.0, strict=True))
            writer.write_message(
                "/dvl", ground, {"stamp_ms": at // MS, **speeds}, log_time=by, publish_time=by
            )
        writer.finish()
    write_dive(known, dive)
    _copy({own: ("/unit", "/dvl"), known: ("/reference",)}, path)


def _copy(topics: dict[Path, tuple[str, ...]], path: Path) -> None:
    """Write some topics of some logs into one."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for part, wanted in topics.items():
            with part.open("rb") as source:
                for schema, channel, message in make_reader(source).iter_messages(topics=wanted):
                    assert schema is not None
                    if channel.topic not in channels:
                        schema_id = writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                        channels[channel.topic] = writer.register_channel(
                            channel.topic, "cdr", schema_id
                        )
                    writer.add_message(
                        channels[channel.topic],
                        message.log_time,
                        message.data,
                        message.publish_time,
                    )
        writer.finish()


def decided(inventory: Inventory, answers: dict[str, str]) -> str:
    """Write into the printed file what a person knows, only where it says that there is something to decide."""
    assert answers.keys() <= set(inventory.decisions), "what is asked of a person must be named"
    lines, section = [], ""
    for line in inventory.configuration.splitlines():
        section = match[1] if (match := re.match(r"\[(\w+)\]", line)) else section
        name = re.match(r"(?:# )?(\w+) =", line)
        answer = answers.get(f"{section}.{name[1]}") if name else None
        lines.append(line if answer is None or name is None else f"{name[1]} = {answer}")
    return "\n".join(lines) + "\n"
