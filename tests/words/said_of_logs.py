"""Logs that cannot be used, and how a replay starts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from as_text import Cases, noted, refusal

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import UserError
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats.fields import check_path
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.logs.read import find_roles
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors
from insdvl_replay.studies.window import dive_windows

IMU_TYPE = "sensor_msgs/msg/Imu"
LEVEL = ("initial.source=level", "initial.heading_deg=77", "initial.latitude_deg=-32.8")
SECOND = 1_000_000_000


def said_of_logs(folder: Path) -> Cases:
    """Return what is said of channels and fields, of logs as they are read, and as a replay begins."""
    yield from of_channels()
    yield from as_they_are_read(folder)
    yield from of_tables(folder)
    yield from as_a_replay_begins()


def channel(topic: str, type_name: str, messages: int) -> LogChannel:
    return LogChannel(1, topic, type_name, "cdr", "ros2msg", messages)


def of_channels() -> Cases:
    depth, box = channel("/depth", "a/Depth", 3), channel("/box/imu", IMU_TYPE, 3)
    none = channel("/imu", IMU_TYPE, 0)
    for name, channels, topic in (
        ("no such topic", [depth, box, none], "/nothing"),
        ("a topic that is like another", [depth, box], "/bix/imu"),
        ("a topic without messages", [depth, none], None),
        ("an empty log", [none], "/imu"),
        ("two IMUs", [box, channel("/imu", IMU_TYPE, 3)], None),
    ):
        overrides = [f"imu.topic={topic}"] if topic else []
        yield name, refusal(first_error, channels, load_config(overrides=overrides))
    fields = {
        "header": "H",
        "header.frame_id": "string",
        "angular_velocity": "V",
        "angular_velocity.x": "float64",
    }
    for path in ("angular_velocty", "gyro"):
        yield f"no field {path}", refusal(check_path, path, fields, IMU_TYPE)


def first_error(channels: list[LogChannel], config: Config) -> None:
    for finding in find_roles("a.mcap", channels, config):
        if isinstance(finding.error, UserError):
            raise finding.error


def of_tables(folder: Path) -> Cases:
    """Return what is said of tables with faults, as errors or as notes."""
    good = [f"{0.2 * i:.1f},{1 + 0.01 * i:.2f},0.1,0.2" for i in range(40)]
    head = "t,vx,vy,vz"
    for name, lines, end in (
        ("words", ["hello", "you"], "\n"),
        ("names of another width", ["t,vx,vy", *good], "\n"),
        ("rows of other widths", [head, *good[:20], *("1,2" for _ in range(9))], "\n"),
        ("text in many cells", [head, *good, *("9,none,none,none" for _ in range(9))], "\n"),
        ("a cut end", [head, *good, "8.0,1.4"], ""),
        (
            "text, two heads and a short row",
            [head, "s,m/s,m/s,m/s", *good, "8.0,1.4", "8.2,1.x,0.1,0.2"],
            "\n",
        ),
        (
            "no head, no times and empty cells",
            [line.partition(",")[2] for line in good] + [",0.1,"],
            "\n",
        ),
        (
            "decimal commas, a row without time",
            [line.replace(",", ";").replace(".", ",") for line in [head, *good, ",1,1,1"]],
            "\n",
        ),
    ):
        path = folder / "dvl.csv"
        path.write_text("\n".join(lines) + end)
        try:
            yield f"table with {name}", noted(open_recording(path).notes)
        except UserError:
            yield f"table with {name}", refusal(open_recording, path)
    for name in ("imu", "dvl"):
        (folder / f"{name}.csv").write_text("\n".join([head, *good, ""]))
    yield (
        "two tables from 0 s",
        noted(open_recording([folder / "dvl.csv", folder / "imu.csv"]).notes),
    )
    yield "tables without settings", refusal(read_dive, folder / "imu.csv", Config())
    imu = ["imu.topic=imu.csv", "imu.specific_force=vx, vy, vz", "imu.angular_rate=vx, vy, wz"]
    dvl = ["dvl.topic=imu.csv", "dvl.velocity=vx, vy, vz"]
    yield (
        "a column that is not there",
        refusal(read_dive, folder / "imu.csv", load_config(overrides=[*imu, *dvl])),
    )


def as_they_are_read(folder: Path) -> Cases:
    sensors = {"position": SensorErrors(1.0), "depth": SensorErrors(1.0, 1.0)}
    write_dive(
        folder / "dive.mcap", simulate_dive("straight", seed=1, duration_s=10.0, sensors=sensors)
    )
    write_dive(folder / "bare.mcap", simulate_dive("straight", seed=1, duration_s=10.0))
    (folder / "text.mcap").write_text("this is no log")
    (folder / "bytes.mcap").write_bytes(b"\x00\x01\x02\x03" * 30)
    (folder / "empty.mcap").touch()
    depth = 'filters.a.aiding=["velocity","depth"]'
    heading = 'filters.a.aiding=["velocity","heading"]'
    position = 'filters.a.aiding=["velocity","position"]'
    for name, overrides in (
        ("text", []),
        ("bytes", []),
        ("empty", []),
        ("nowhere", []),
        ("bare", [depth]),
        ("bare", [heading]),
        ("bare", [depth, "depth.topic=/imu"]),
        ("dive", [position, "position.angle_unit=rad"]),
        ("dive", ["imu.topic=/imo"]),
        ("dive", ["imu.angular_rate=gyroscope"]),
        ("dive", ['filters.b.solution="/nowhere"']),
        ("dive", ['filters.b.solution="/imu"']),
    ):
        said = refusal(read_dive, folder / f"{name}.mcap", load_config(overrides=overrides))
        yield f"{name}.mcap {' '.join(overrides)}".rstrip(), said


def as_a_replay_begins() -> Cases:
    dive = exact_dive("straight", duration_s=60.0, imu_rate_hz=20.0)
    noisy = simulate_dive("straight", duration_s=60.0, imu_rate_hz=20.0)
    reference, beams = dive.reference, dive.dvl.beam_velocity_mps
    assert reference is not None
    assert beams is not None
    later = replace(reference, time_ns=reference.time_ns + 1000 * SECOND)
    blind = replace(dive.dvl, beam_velocity_mps=np.full_like(beams, np.nan))
    apart = replace(dive.dvl, time_ns=dive.dvl.time_ns + 1000 * SECOND)
    plain = replace(
        dive.dvl, beam_velocity_mps=None, beam_vectors_d=None, velocity_d=np.zeros((len(beams), 3))
    )
    for name, made, overrides in (
        ("an empty span", dive, ["span.start_s=100"]),
        ("clocks that do not meet", replace(dive, dvl=apart), []),
        ("no velocity", replace(dive, dvl=blind), []),
        ("beams that disagree", noisy, ["dvl.max_beam_residual_mps=1e-9"]),
        ("no beams", replace(dive, dvl=plain), ['filters.a.aiding=["beams"]']),
        ("no reference", replace(dive, reference=None), []),
        ("a reference of another time", replace(dive, reference=later), []),
        (
            "a level start without a heading",
            replace(dive, reference=None),
            ["initial.source=level"],
        ),
    ):
        yield f"a replay of {name}", refusal(replay_dive, made, load_config(overrides=overrides))
    for overrides in (["initial.heading_deg=77"], [*LEVEL]):
        notes = prepare_dive(dive, load_config(overrides=overrides)).notes
        yield f"notes at the start {' '.join(overrides)}", noted(notes)
    yield (
        "windows without a reference",
        refusal(dive_windows, replace(dive, reference=None), load_config(), 5),
    )
    yield "windows that are too long", refusal(dive_windows, dive, load_config(), 100)
