"""A DVL in a file of its own: its times are brought onto the clock of the IMU's file, where those are two clocks.

Stamps tell whether they can be of one clock. Where they are not, or the motion contradicts them, the motion tells how
the clock of the DVL's file runs, and the times of all its tables are changed before anything else is read.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from typing import Final

import msgspec

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import ImuColumns, nanoseconds, seconds
from insdvl_replay.core.errors import LogError, UserError, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import BY_SENSOR
from insdvl_replay.geometry.frames import solve_beams
from insdvl_replay.logs.columns.clock_by_motion import (
    SHORTEST_OVERLAP_S,
    FileClock,
    Rows,
    clock_by_motion,
)
from insdvl_replay.logs.columns.dvl import decode_dvl
from insdvl_replay.logs.columns.imu import decode_imu
from insdvl_replay.logs.columns.sensors import decode_sensor
from insdvl_replay.logs.columns.tables import SAME_CLOCK_S, Table, read_tables, stamp_path
from insdvl_replay.logs.columns.topics import LOG_TIME, Source, Topics, role_with
from insdvl_replay.logs.formats.log_file import LogFile
from insdvl_replay.logs.formats.recording import CHANNELS_OF_A_PART, Recording
from insdvl_replay.logs.formats.table_rows import RowsFile

LEAST_COMMON: Final = 0.1  # part of the shorter of two files of one dive that both must have seen
LARGEST_LATENCY_S: Final = 3600.0  # that `dvl.latency_s` takes
SIGNIFICANT_SDS: Final = 5.0


def align_files(log: Recording, sources: Sequence[Source], config: Config) -> None:
    """Bring the file of the DVL onto the clock of the IMU's; nothing happens where both are by one clock, or one file.

    Raises
    ------
    LogError
        The stamps cannot be of one clock, and the motion does not tell how they belong together.
    """
    by_role = {source.role: source for source in reversed(sources)}
    if log.is_aligned or "imu" not in by_role or "dvl" not in by_role:
        return
    imu_source = by_role["imu"]
    dvl_source = by_role["dvl"]
    files = _own_files(log, imu_source, dvl_source)
    largest_s = max(abs(imu_source.latency_s), abs(dvl_source.latency_s))
    is_given = largest_s > SAME_CLOCK_S
    if not files or is_given:
        return
    imu_table, dvl_table = read_tables(log, [imu_source, dvl_source])
    path = stamp_path(dvl_source.stamp)
    if path != LOG_TIME and not dvl_table.is_time_column(path):
        return
    try:
        imu = _without_latency(decode_imu(imu_table, config.imu)[0], imu_source.latency_s)
        rows = [_velocities(dvl_table, config)]
    except UserError:
        return  # whoever replays reports it
    rows += _attitudes(log, files, config)
    log.is_aligned = True
    _align(log, files, imu, rows)


def _own_files(log: Recording, imu: Source, dvl: Source) -> list[RowsFile]:
    """Return the files of the DVL, if the IMU is in none of them and their times can be changed."""
    of_imu = _places(imu)
    of_dvl = _places(dvl)
    if of_imu & of_dvl:
        return []
    files = []
    for place in sorted(of_dvl):
        part = log.parts[place]
        if not isinstance(part, RowsFile):
            return []
        files.append(part)
    return files


def _places(source: Source) -> set[int]:
    """Return which files of a recording a topic is in."""
    return {channel.id // CHANNELS_OF_A_PART for channel in source.channels}


def _without_latency(imu: ImuColumns, latency_s: float) -> ImuColumns:
    """Return samples by their stamps, as the clock of the file has them."""
    return ImuColumns(
        imu.time_ns + nanoseconds(latency_s), imu.specific_force_b, imu.angular_rate_b
    )


def _velocities(table: Table, config: Config) -> Rows:
    """Return the velocities of a DVL, by their stamps."""
    dvl = decode_dvl(table, config.dvl)[0]
    velocity_d = dvl.velocity_d
    if velocity_d is None and dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        velocity_d = solve_beams(dvl.beam_velocity_mps, dvl.beam_vectors_d)[0]
    return Rows.of_velocities(dvl.time_ns + nanoseconds(table.source.latency_s), velocity_d)


def _attitudes(log: Recording, files: Collection[LogFile], config: Config) -> Iterator[Rows]:
    """Give the attitudes that the DVL's files have, too."""
    channels = []
    for channel in log.channels:
        if log.parts[channel.id // CHANNELS_OF_A_PART] in files:
            channels.append(channel)
    topics = Topics(str(log.path), channels)
    initial = msgspec.structs.replace(config.initial, source=BY_SENSOR)
    with_attitude = msgspec.structs.replace(config, initial=initial)
    role = role_with("heading", config.heading)
    for topic in topics.candidates(role, ()):
        with suppress(UserError):  # an attitude that cannot be read tells nothing
            source = topics.source(role, topic)
            found = decode_sensor("heading", read_tables(log, [source])[0], with_attitude)[0]
            time_ns = found.time_ns + nanoseconds(source.latency_s)
            if found.mat_nb is not None:
                yield Rows.of_attitudes(time_ns, found.mat_nb)


def _align(
    log: Recording,
    files: Sequence[RowsFile],
    imu: ImuColumns,
    rows: Sequence[Rows],
) -> None:
    """Change the times of the DVL's files, if they are by another clock."""
    dvl_ns = rows[0].time_ns
    if not len(dvl_ns) or not len(imu.time_ns):
        return
    first_ns = max(int(dvl_ns[0]), int(imu.time_ns[0]))
    last_ns = min(int(dvl_ns[-1]), int(imu.time_ns[-1]))
    shorter_ns = min(int(dvl_ns[-1] - dvl_ns[0]), int(imu.time_ns[-1] - imu.time_ns[0]))
    can_be_one = last_ns - first_ns >= LEAST_COMMON * shorter_ns
    clock = clock_by_motion(imu, rows, are_stamps_likely=can_be_one)
    is_long = shorter_ns >= nanoseconds(SHORTEST_OVERLAP_S)
    if clock is None and is_long and not can_be_one:
        names = listed([file.path.name for file in files])
        apart_s = float(seconds(dvl_ns[0], int(imu.time_ns[0])))
        text = (
            f"{names} and the file of the IMU have clocks that have nothing to do with each other: the DVL begins "
            f"{apart_s:.1f} s after the IMU, by their stamps, and their motion does not tell how they belong together"
        )
        hint = "write the times of both by one clock"
        if abs(apart_s) < LARGEST_LATENCY_S:
            hint += ", or set dvl.latency_s to the s by which its stamps are ahead of the IMU's"
        raise LogError(text, hint, str(log.path))
    if clock is None:
        if is_long:
            names = listed([file.path.name for file in files])
            log.notes_on_files.append(note("file_clock_unconfirmed", len(dvl_ns), name=names))
        return
    if can_be_one and not _is_other(clock):
        return
    for file in files:
        file.change_times(clock.by_imu)
        said = note(
            "file_clock",
            len(dvl_ns),
            name=file.path.name,
            ahead_s=clock.ahead_ns * 1e-9,
            ahead_sd_s=clock.ahead_sd_s,
            drift_ppm=clock.drift * 1e6,
            drift_sd_ppm=clock.drift_sd * 1e6,
            ends_sd_s=clock.largest_sd_s,
            how=" and ".join(clock.sources),
        )
        log.notes_on_files.append(said)


def _is_other(clock: FileClock) -> bool:
    """Return whether a clock is another one; what is off by less is late, as messages are."""
    ahead_s = abs(clock.ahead_ns) * 1e-9
    return ahead_s > SAME_CLOCK_S and ahead_s > SIGNIFICANT_SDS * clock.largest_sd_s
