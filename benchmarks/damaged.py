"""How often `run` without settings comes out right on damaged logs: turned axes, signs, scales, units, late stamps.

Usage: python benchmarks/damaged.py [LOG...] [--only NAME,...]. Each log is rewritten with each damage. A variant is
right if the baseline fits (NIS/dof from 0.4 to 2.5) and drifts without the DVL as the undamaged log does, within a
factor of 1.5. It is silently wrong if it is not right and no warning says so.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ImuColumns
from insdvl_replay.core.errors import UserError
from insdvl_replay.core.misfit import LEAST_NIS, MOST_NIS, MisfitError
from insdvl_replay.core.states import DEG, STANDARD_GRAVITY_MPS2
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.automatic import FoundSettings, find_settings
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.columns.imu import in_frd
from insdvl_replay.preparation.replay import Replay, replay_log
from insdvl_replay.sim.dive import simulate_dive

Damage = Callable[[Dive], Dive]
ALIKE = 1.5


def imu(
    force: str = "frd", rate: str = "frd", force_scale: float = 1.0, rate_scale: float = 1.0
) -> Damage:
    """Return a damage of the IMU: other axes and scales."""

    def damage(dive: Dive) -> Dive:
        columns = ImuColumns(
            dive.imu.time_ns,
            in_frd(dive.imu.specific_force_b, force, "axes", force_scale),
            in_frd(dive.imu.angular_rate_b, rate, "axes", rate_scale),
        )
        return replace(dive, imu=columns)

    return damage


def dvl(rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), scale: float = 1.0) -> Damage:
    """Return a damage of the DVL's velocities: turned, or in another unit."""

    def damage(dive: Dive) -> Dive:
        assert dive.dvl.velocity_d is not None
        turned = dive.dvl.velocity_d @ mat_from_rpy(np.array(rpy_deg) * DEG) * scale
        return replace(dive, dvl=replace(dive.dvl, velocity_d=turned))

    return damage


def late(imu_s: float = 0.0, dvl_s: float = 0.0) -> Damage:
    """Return a damage of the stamps."""

    def damage(dive: Dive) -> Dive:
        columns = replace(dive.imu, time_ns=dive.imu.time_ns + int(imu_s * 1e9))
        pings = replace(dive.dvl, time_ns=dive.dvl.time_ns + int(dvl_s * 1e9))
        return replace(dive, imu=columns, dvl=pings)

    return damage


G = 1.0 / STANDARD_GRAVITY_MPS2
MILLI_G = 1000.0 / STANDARD_GRAVITY_MPS2
DEG_PER_S = 1.0 / DEG
DAMAGES: dict[str, Damage] = {
    **{
        f"axes {axes}": imu(axes, axes)
        for axes in ("+y-x+z", "-y+x+z", "-x-y+z", "flu", "-x+y-z", "+y+x-z", "+z-y+x")
    },
    **{
        f"accelerometers {axes}": imu(axes)
        for axes in ("-x-y-z", "-x+y+z", "+x-y+z", "+x+y-z", "-x-y+z")
    },
    **{f"gyros {axes}": imu(rate=axes) for axes in ("-x-y-z", "+x+y-z")},
    **{f"gyro scale {scale}": imu(rate_scale=scale) for scale in (0.6, 1.7)},
    "g": imu(force_scale=G),
    "mg": imu(force_scale=MILLI_G),
    "deg/s": imu(rate_scale=DEG_PER_S),
    "g and deg/s": imu(force_scale=G, rate_scale=DEG_PER_S),
    "mg, flu and deg/s": imu("flu", "flu", MILLI_G, DEG_PER_S),
    "half scale": imu(force_scale=0.5),
    **{f"DVL {heading}": dvl((0.0, 0.0, heading)) for heading in (90.0, -90.0, 180.0)},
    "DVL upside down": dvl((180.0, 0.0, 0.0)),
    "DVL in mm/s": dvl(scale=1000.0),
    "IMU 0.3 s late": late(imu_s=0.3),
    "DVL 0.3 s late": late(dvl_s=0.3),
    "axes, DVL 90": lambda dive: dvl((0.0, 0.0, 90.0))(imu("flu", "flu")(dive)),
}


SECOND = "second IMU is bad"


def write_second_imu(path: Path, dive: Dive, folder: Path) -> None:
    """Write a dive whose log has another IMU, too: noisy, turned, and with the gyros of one axis wrong."""
    rng = np.random.default_rng(1)
    bad = imu("+y-x+z", "+y-x-z")(dive).imu
    force, rate = (
        rng.normal(scale=scale, size=bad.specific_force_b.shape) for scale in (0.5, 0.05)
    )
    bad = ImuColumns(bad.time_ns, bad.specific_force_b + force, bad.angular_rate_b + rate)
    parts = {folder / "good.mcap": dive, folder / "bad.mcap": replace(dive, imu=bad)}
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for part, content in parts.items():
            write_dive(part, content)
            with part.open("rb") as source:
                for schema, channel, message in make_reader(source).iter_messages():
                    topic = channel.topic if content is dive else f"/spare{channel.topic}"
                    if schema is None or (content is not dive and channel.topic != "/imu"):
                        continue
                    if topic not in channels:
                        schema_id = writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                        channels[topic] = writer.register_channel(
                            topic, channel.message_encoding, schema_id
                        )
                    writer.add_message(
                        channels[topic], message.log_time, message.data, message.publish_time
                    )
            part.unlink()
        writer.finish()


def velocities_alone(dive: Dive) -> Dive:
    """Return a dive whose DVL gives velocities, and that nothing marks as simulated."""
    if dive.dvl.velocity_d is None:
        from insdvl_replay.nav.dvl import dvl_velocities
        from insdvl_replay.preparation.filters import dvl_mounting

        found = dvl_velocities(dive.dvl, dvl_mounting(Config()), np.inf)
        dive = replace(dive, dvl=replace(dive.dvl, time_ns=found.time_ns, beam_velocity_mps=None, beam_vectors_d=None,
                                         look_d=None, velocity_d=found.velocity_b))  # fmt: skip
    return replace(dive, truth=None, sensors={}, solutions={}, topics={})


def run(log: Path) -> tuple[Replay, FoundSettings | None]:
    """Replay a log as `run` does without settings, from one start."""
    config = load_config(overrides=["evaluation.starts=1"])
    try:
        return replay_log(log, config, require_fit=True), None
    except UserError as error:
        try:
            found = find_settings([[log]], Given(config))
        except UserError:
            if isinstance(error, MisfitError):
                return replay_log(log, config), None
            raise
        return replay_log(log, found.config), found


def measured(replay: Replay) -> tuple[float, float]:
    """Return NIS/dof of the baseline, and its drift in 30 s without DVL, m."""
    name = replay.config.baseline
    row = next(
        row
        for row in replay.tables.consistency
        if (row.filter, row.measurement) == (name, "velocity")
    )
    drifts = [
        row.drift_median_m
        for row in replay.tables.outage
        if (row.filter, row.window_s) == (name, "30")
    ]
    return (row.mean_nis or np.nan) / row.dof, (
        drifts[0] if drifts and drifts[0] is not None else np.nan
    )


def variants(dive: Dive, folder: Path, only: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Yield each damage of a dive with its outcome: right, named or silent."""
    good = folder / f"{dive.name}.mcap"
    write_dive(good, dive)
    size, drift_m = measured(run(good)[0])
    sys.stdout.write(f"{dive.name}: undamaged NIS/dof {size:.2f}, drift in 30 s {drift_m:.3g} m\n")
    for name in (*DAMAGES, SECOND):
        if only and name not in only:
            continue
        log = folder / "damaged.mcap"
        started_s = time.process_time()
        if name == SECOND:
            write_second_imu(log, dive, folder)
        else:
            write_dive(log, DAMAGES[name](dive))
        try:
            replay, found = run(log)
        except UserError as error:
            yield name, f"stopped  {error.message}"
            continue
        now, moved_m = measured(replay)
        is_right = LEAST_NIS <= now <= MOST_NIS and not moved_m > ALIKE * drift_m
        notes = (*replay.notes, *(found.notes if found is not None else ()))
        warnings = sorted({note.code for note in notes if note.severity == "warning"})
        outcome = "right" if is_right else "named" if warnings else "silent"
        seconds = time.process_time() - started_s
        yield (
            name,
            f"{outcome:8} NIS/dof {now:.2f}, drift {moved_m:.3g} m, {seconds:.1f} s, {', '.join(warnings)}",
        )
        log.unlink()


def main() -> None:
    """Print the outcome of each variant, and how many are right and silently wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    dives = [read_with_settings(log) for log in arguments.logs] or [
        replace(
            simulate_dive("figure-eight", duration_s=400.0, seed=3, grade="mems"),
            name="figure_eight",
        ),
        replace(
            simulate_dive("calibration", duration_s=400.0, seed=4, grade="tactical"),
            name="calibration",
        ),
    ]
    outcomes: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for dive in dives:
            for name, outcome in variants(
                velocities_alone(dive),
                Path(folder),
                tuple(filter(None, arguments.only.split(","))),
            ):
                sys.stdout.write(f"  {name:24} {outcome}\n")
                outcomes.append(outcome.split()[0])
    right = outcomes.count("right")
    silent = outcomes.count("silent")
    sys.stdout.write(f"{right} of {len(outcomes)} right, {silent} silently wrong\n")


def read_with_settings(log: Path) -> Dive:
    """Read a log with the topics and axes that `run` finds for it."""
    replay, found = run(log)
    dive = read_dive(log, replay.config if found is None else found.config)
    return replace(dive, reference=dive.reference)


if __name__ == "__main__":
    main()
