"""A log becomes a dive."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from insdvl_replay.core.channel import Channel
from insdvl_replay.core.columns import Dive
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_names import dive_name
from insdvl_replay.core.runtime import begin
from insdvl_replay.logs.columns.clocks import clock_notes
from insdvl_replay.logs.columns.decode import decode_imu, decode_truth
from insdvl_replay.logs.columns.pings import decode_dvl
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.roles import Roles, assign_roles
from insdvl_replay.logs.columns.table_notes import count_notes, left_out_notes, schema_notes, stamp_notes
from insdvl_replay.logs.columns.table_reading import read_tables
from insdvl_replay.logs.container.channel import LogChannel
from insdvl_replay.logs.container.recording import open_recording


def read_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> Dive:
    """Read everything that is needed to replay a dive.

    Parameters
    ----------
    path : Path or sequence of Path
        An MCAP file, a folder with the parts of one recording, or several of them that are one dive.
    config : Config
        Names topics, fields, units and axes where the types do not tell them.
    allow_damaged : bool
        Read what can be believed of a damaged log; what is lost is a note.

    Returns
    -------
    Dive
        Clean columns; every loss is a note. Whether they can be so is not asked, and the span of the configuration is
        not applied.

    Raises
    ------
    LogError
        The file cannot be read, changes meanwhile or is damaged, has no IMU or DVL, is not clear about which topic is
        which, or mixes clocks.
    ConfigError
        The axes or the beam geometry of the configuration cannot be.
    """
    begin("reading the log")
    import insdvl_replay.logs.container.record_loops  # noqa: F401  all records are walked here: with the compiled loops

    log = open_recording(path, allow_damaged=allow_damaged)
    place = str(log.path)
    roles = assign_roles(place, log.channels, config)
    with log.watched(), ThreadPoolExecutor(1) as checker:
        digests = checker.submit(log.digests)
        tables = read_tables(log, roles.sources)
        log.check_unopened()
        sha256 = log.sha256(digests.result())
    notes = [*log.notes, *schema_notes(roles.sources), *count_notes(tables)]
    notes += [*left_out_notes(tables), *stamp_notes(tables)]
    notes += clock_notes(place, [table.clock() for table in tables], config.clocks.max_disagreement_s)
    # The raw columns of a long dive are large, and let go one by one.
    imu, imu_notes = decode_imu(tables.pop(0), config.imu)
    dvl, dvl_notes = decode_dvl(tables.pop(0), config.dvl)
    truth, truth_notes = decode_truth(tables.pop()) if roles.truth else (None, [])
    reference, reference_notes = decode_reference(tables, config.reference)
    notes += [*imu_notes, *dvl_notes, *reference_notes, *truth_notes]
    return Dive(
        name=dive_name(log.path),
        imu=imu,
        dvl=dvl,
        reference=reference,
        truth=truth,
        sha256=sha256,
        channels=_channels(log.channels, roles),
        notes=tuple(notes),
    )


def _channels(channels: Sequence[LogChannel], roles: Roles) -> tuple[Channel, ...]:
    """List the topics, each once, with their roles."""
    role_of = {source.topic: source.role for source in reversed(roles.sources)}
    by_topic: dict[str, list[LogChannel]] = {}
    for channel in channels:
        by_topic.setdefault(channel.topic, []).append(channel)
    return tuple(
        Channel(
            topic=topic,
            type_name=same[0].type_name,
            encoding=same[0].encoding,
            role=role_of.get(topic, ""),
            messages=sum(channel.messages for channel in same),
        )
        for topic, same in sorted(by_topic.items())
    )
