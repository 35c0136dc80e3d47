"""A dive as a log, as a vehicle's recorder would have written it, and a replay as a log for viewers of ROS 2 data.

What is computed here for a dive is the same on every processor: matrices are solved by formulae, since LAPACK sums in
another order on each, and what goes through a library's arcs is rounded, since their last bits differ. The same input
gives the same bytes: an MCAP file with the profile ``ros2``, indexed and compressed, with the messages of all topics in
the order of their times of validity. The mcap library frames all records; the messages of a chunk are serialised column
by column. Source: https://mcap.dev/spec.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Array,
    Dive,
    DvlColumns,
    Floats,
    Integers,
    ReferenceColumns,
    SensorColumns,
    TimeNs,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG_PER_HOUR, MG, STANDARD_GRAVITY_MPS2, STATES
from insdvl_replay.core.tables import Tables, each_table
from insdvl_replay.core.units import name_with_unit
from insdvl_replay.core.version import __version__
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import MAT_FRD_FLU, east_north_up_m, quat_enu_flu
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, turned
from insdvl_replay.logs.formats.definitions import Definitions, definition_text, parse_definitions
from insdvl_replay.logs.formats.fields import layout_for_texts
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.mcap_file import HEADER_SIZE
from insdvl_replay.logs.formats.recording import open_recording

LIBRARY: Final = "insdvl-replay"
NEVER: Final = np.empty(0, np.int64)
# A chunk is full with the message that exceeds this, before compression.
CHUNK_BYTES: Final = 1024 * 1024
FRAMES: Final = {
    "ned": "north-east-down at the vehicle",
    "imu": "the body: forward-starboard-down at the IMU",
    "dvl": "the DVL: forward-starboard-down of the instrument",
    "odom": "east-north-up at the first position",
    "base_link": "the body with the axes forward-port-up",
}
"""What the names in ``frame_id`` mean."""
NED, IMU, DVL, ODOM, BASE_LINK = FRAMES
_STAMP_POLICY: Final = "log_time = publish_time = header.stamp = time of validity"
# No profile at all is the one value that every release of rosbag2 reads.
_QOS: Final = {"offered_qos_profiles": ""}
_LATEST_NS: Final = (2**31 - 1) * NS_PER_S
_RECORD_HEAD: Final = [
    ("opcode", "u1"),
    ("length", "<u8"),
    ("channel", "<u2"),
    ("sequence", "<u4"),
    ("log_time", "<u8"),
    ("publish_time", "<u8"),
]


Column = Array | str | float | tuple[float, ...]
"""Values of one field: an array with one row per message, or what all messages share."""


@dataclass(frozen=True)
class Batch:
    """Messages of one topic whose strings are the same."""

    topic: str
    type_name: str
    time_ns: TimeNs  # (k,), never decreasing
    columns: Mapping[str, Column]  # by the path of the field; other fields stay zero


def stamped(
    topic: str,
    type_name: str,
    time_ns: TimeNs,
    frame: str,
    columns: Mapping[str, Column],
) -> Batch:
    """Make a batch of messages that begin with a header, whose frame is one of `FRAMES`."""
    header = {**stamp("header.stamp", time_ns), "header.frame_id": frame}
    return Batch(topic, type_name, time_ns, {**header, **columns})


def stamp(path: str, time_ns: TimeNs) -> dict[str, Column]:
    """Fill the builtin_interfaces/Time at a path."""
    seconds, nanoseconds = np.divmod(time_ns, NS_PER_S)
    return {
        f"{path}.sec": seconds.astype(np.int32),
        f"{path}.nanosec": nanoseconds.astype(np.uint32),
    }


def components(path: str, vectors: Floats | float, names: str = "xyz") -> dict[str, Column]:
    """Fill the components at a path with the columns of vectors, or all with one number."""
    if isinstance(vectors, float):
        return {f"{path}.{name}": vectors for name in names}
    columns = zip(names, vectors.T, strict=True)
    return {f"{path}.{name}": column for name, column in columns}


@cache
def _definitions(type_name: str) -> Definitions:
    return parse_definitions(type_name, definition_text(type_name))


class _Messages:
    """The messages of a batch as records of a channel."""

    def __init__(self, batch: Batch, channel: int) -> None:
        self.batch = batch
        self.channel = channel
        self._texts = {
            path: value.encode() for path, value in batch.columns.items() if isinstance(value, str)
        }
        self._layout = layout_for_texts(
            _definitions(batch.type_name), batch.type_name, self._texts
        )
        self._dtype = np.dtype([*_RECORD_HEAD, ("message", f"V{self._layout.size}")])
        self.size = self._dtype.itemsize

    def records(self, rows: slice) -> list[bytes]:
        """Return the records of some messages."""
        time_ns = self.batch.time_ns[rows]
        records = np.zeros(len(time_ns), self._dtype)
        records["opcode"] = Opcode.MESSAGE
        records["length"] = self.size - HEADER_SIZE
        records["channel"] = self.channel
        records["log_time"] = records["publish_time"] = time_ns
        messages = self._layout.new_messages(len(time_ns))
        for path, column in self.batch.columns.items():
            value: Any = self._texts.get(path, column)
            messages[path] = value[rows] if isinstance(value, np.ndarray) else value
        records["message"] = messages.view(f"V{self._layout.size}")
        as_bytes: list[bytes] = records.view(f"V{self.size}").tolist()
        return as_bytes


class _ColumnIndex(MessageIndex):
    """A message index whose entries, times and offsets, are the rows of an array."""

    def write(self, stream: RecordBuilder) -> None:
        """Write it as the library does, all entries at once."""
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(self.records) * 16)
        stream.write(np.asarray(self.records, "<u8").tobytes())
        stream.finish_record()  # type: ignore[no-untyped-call]


def write_log(
    path: Path,
    batches: Sequence[Batch],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]] | None = None,
    compression: CompressionType = CompressionType.ZSTD,
) -> None:
    """Write messages to a log, which appears under its name when it is complete.

    Attachments are media type and content by name. A `LogError` where a time does not fit a ROS stamp.
    """
    for batch in batches:
        if np.any(np.diff(batch.time_ns) < 0):
            raise ValueError(f"the times of {batch.topic} decrease")
        for time in batch.time_ns[:1].tolist() + batch.time_ns[-1:].tolist():
            if not 0 <= time <= _LATEST_NS:
                raise LogError(
                    f"{batch.topic}: time {time} ns does not fit a ROS stamp, which counts 0 to 2147483647 s",
                    "choose another clock, for example --set imu.stamp=log_time --set dvl.stamp=log_time",
                )
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as stream:
            writer = Writer(stream, compression=compression)
            writer.start("ros2", LIBRARY)
            frames = {f"frame.{name}": meaning for name, meaning in FRAMES.items()}
            writer.add_metadata("insdvl_replay", {**metadata, **frames, "stamps": _STAMP_POLICY})
            schemas: dict[str, int] = {}
            channels: dict[str, int] = {}
            for topic, type_name in {batch.topic: batch.type_name for batch in batches}.items():
                if type_name not in schemas:
                    text = definition_text(type_name).encode()
                    schemas[type_name] = writer.register_schema(type_name, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schemas[type_name], _QOS)
            _write_messages(writer, [_Messages(batch, channels[batch.topic]) for batch in batches])
            for name, (media_type, content) in (attachments or {}).items():
                writer.add_attachment(0, 0, name, media_type, content)
            writer.finish()  # type: ignore[no-untyped-call]
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


def copy_log(path: Path, logs: Sequence[Path], held_back: Mapping[str, TimeNs | None]) -> None:
    """Copy the messages of a log to MCAP, without those at some log times, or with None all, of some topics."""
    log = open_recording(logs, allow_damaged=True)
    kept: dict[int, LogChannel] = {}
    absent_ns: dict[int, TimeNs] = {}
    for channel in log.channels:
        held_back_ns = held_back.get(channel.topic, NEVER)
        if held_back_ns is not None:
            kept[channel.id] = channel
            absent_ns[channel.id] = held_back_ns
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(_profile_of(kept.values()), LIBRARY)
        ids = _register(writer, kept)
        for block in log.blocks(kept):
            is_absent = np.isin(block.log_time, absent_ns[block.channel_id])
            present = block.part(np.flatnonzero(~is_absent))
            places = zip(present.offsets.tolist(), present.sizes.tolist(), strict=True)
            times = zip(present.log_time.tolist(), present.publish_time.tolist(), strict=True)
            for (offset, size), (log_ns, publish_ns) in zip(places, times, strict=True):
                data = bytes(block.buffer[offset : offset + size])
                writer.add_message(ids[block.channel_id], log_ns, data, publish_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def _profile_of(channels: Iterable[LogChannel]) -> str:
    """Return what a log with some channels promises to follow."""
    encodings = {channel.encoding for channel in channels}
    if "cdr" in encodings:
        return "ros2"
    if "ros1" in encodings:
        return "ros1"
    return ""


def _register(writer: Writer, channels: Mapping[int, LogChannel]) -> dict[int, int]:
    """Register channels with their schemas; return the new ids by the ones they have."""
    schemas: dict[tuple[str, str, bytes], int] = {}
    ids: dict[int, int] = {}
    for channel in channels.values():
        schema = (channel.type_name, channel.schema_encoding, channel.schema_data)
        if schema not in schemas:
            schemas[schema] = writer.register_schema(*schema) if any(schema) else 0
        ids[channel.id] = writer.register_channel(
            channel.topic, channel.encoding, schemas[schema], dict(channel.metadata)
        )
    return ids


def _write_messages(writer: Writer, batches: Sequence[_Messages]) -> None:
    """Write the messages of all batches in the order of their times, chunk by chunk.

    The library adds one message after another; its chunk and its statistics are filled here with many at once.
    """
    chunk = vars(writer)["_Writer__chunk_builder"]
    statistics = vars(writer)["_Writer__statistics"]
    time_ns = np.concatenate([messages.batch.time_ns for messages in batches])
    counts = [len(messages.batch.time_ns) for messages in batches]
    batch_of = np.repeat(np.arange(len(batches), dtype=np.int32), counts)
    order = np.argsort(time_ns, kind="stable")
    time_ns = time_ns[order]
    batch_of = batch_of[order]
    channel = np.array([messages.channel for messages in batches])[batch_of]
    ends = np.cumsum(np.array([messages.size for messages in batches])[batch_of])
    for number, rows in _by_channel(channel):
        statistics.channel_message_counts[number] = len(rows)
    if len(time_ns):
        statistics.message_count = len(time_ns)
        statistics.message_start_time = int(time_ns[0])
        statistics.message_end_time = int(time_ns[-1])

    begin = 0
    start = 0
    done = np.zeros(len(batches), np.int64)
    while begin < len(ends):
        head = chunk.count  # of the first chunk, the schemas and channels
        last = int(np.searchsorted(ends, start - head + CHUNK_BYTES, side="right"))
        end = min(last + 1, len(ends))
        own = np.bincount(batch_of[begin:end], minlength=len(batches))
        records = _records_in_order(batches, batch_of[begin:end], done, done + own)
        chunk.record_writer.write(b"".join(records))
        offsets = np.append(start, ends[begin : end - 1]) - start + head
        for number, rows in _by_channel(channel[begin:end]):
            entries: Any = np.stack([time_ns[begin:end][rows], offsets[rows]], axis=1)
            chunk.message_indices[number] = _ColumnIndex(number, entries)
        chunk.num_messages = end - begin
        chunk.message_start_time = int(time_ns[begin])
        chunk.message_end_time = int(time_ns[end - 1])
        writer.flush()  # type: ignore[no-untyped-call]
        begin = end
        start = int(ends[end - 1])
        done = done + own


def _records_in_order(
    batches: Sequence[_Messages],
    batch_of: Array,
    first: Integers,
    behind: Integers,
) -> list[bytes]:
    """Return messages in the order of their batches, (k,), of each batch those from the first to one behind the last.

    The messages of a batch are serialised together and then dealt out.
    """
    records: list[bytes] = []
    for number in np.flatnonzero(behind > first).tolist():
        records += batches[number].records(slice(first[number], behind[number]))
    places = np.argsort(np.argsort(batch_of, kind="stable")).tolist()
    return [records[place] for place in places]


def _by_channel(channel: Integers) -> list[tuple[int, NDArray[np.intp]]]:
    """Return the channels in the order of their first messages, each with the rows of all its messages."""
    numbers, first = np.unique(channel, return_index=True)
    in_order = numbers[np.argsort(first)].tolist()
    return [(number, np.flatnonzero(channel == number)) for number in in_order]


# --- Dives and replays.

# Above a flat seabed, unless a dive has altitudes. The ranges of the beams follow from it, and no filter uses it.
ALTITUDE_M: Final = 20.0
# Decimals of what the instrument makes of its beams, m/s and rad: far below their noise.
VELOCITY_DIGITS: Final = 6
ANGLE_DIGITS: Final = 9  # decimals of the reference's angles, rad
_ATMOSPHERE_PA: Final = 101325.0
_SEA_WATER_KGPM3: Final = 1025.0
_BEAMS_FOR_VELOCITY: Final = 3
_UNKNOWN_VARIANCE: Final = -1.0
_DVL_MESSAGES: Final = {
    "velocity": ("insdvl_msgs/msg/DvlVelocity", "velocity_mps"),
    "acceleration": ("insdvl_msgs/msg/DvlAcceleration", "acceleration_mps2"),
}
_LOG_LEVELS: Final = {Severity.INFO: 20, Severity.WARNING: 30}


def angles(rpy: Floats) -> dict[str, Column]:
    """Fill roll, pitch and heading, (k, 3), rad."""
    roll_deg, pitch_deg, heading_deg = np.rad2deg(rpy).T
    return {"roll_deg": roll_deg, "pitch_deg": pitch_deg, "heading_deg": heading_deg}


def solution(position: Floats, velocity_n: Floats, rpy: Floats) -> dict[str, Column]:
    """Fill the fields that insdvl_msgs/NavSolution and FilterState share, of (k, 3) each; positions in rad and m."""
    latitude_deg, longitude_deg = np.rad2deg(position[:, :2]).T
    columns: dict[str, Column] = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg}
    return {**columns, "height_m": position[:, 2], "velocity_ned_mps": velocity_n, **angles(rpy)}


def write_dive(path: Path, dive: Dive, *, is_compressed: bool = True) -> None:
    """Write a dive as a ROS 2 log; a DVL has four beams or velocities, else it is a ValueError."""
    imu: dict[str, Column] = {
        "orientation_covariance": (_UNKNOWN_VARIANCE, *[0.0] * 8),
        **components("angular_velocity", dive.imu.angular_rate_b),
        **components("linear_acceleration", dive.imu.specific_force_b),
    }
    batches = [
        stamped("/imu", "sensor_msgs/msg/Imu", dive.imu.time_ns, IMU, imu),
        _dvl_batch(dive.dvl),
    ]
    if dive.reference is not None:
        rpy = np.round(rpy_from_mat(dive.reference.mat_nb), ANGLE_DIGITS)
        columns = solution(dive.reference.position, dive.reference.velocity_n, rpy)
        batches.append(
            stamped(
                "/reference", "insdvl_msgs/msg/NavSolution", dive.reference.time_ns, NED, columns
            )
        )
    if dive.truth is not None:
        columns = {
            "accel_bias_mps2": dive.truth.accel_bias_b,
            "gyro_bias_radps": dive.truth.gyro_bias_b,
        }
        batches.append(
            stamped(
                "/truth/biases", "insdvl_msgs/msg/SensorBiases", dive.truth.time_ns, IMU, columns
            )
        )
    for name, sensor in dive.sensors.items():
        batches.append(_sensor_batch(name, sensor))
    compression = CompressionType.ZSTD if is_compressed else CompressionType.NONE
    write_log(path, batches, {"version": __version__, "dive": dive.name}, compression=compression)


def _sensor_batch(name: str, sensor: SensorColumns) -> Batch:
    """Return the messages of a sensor: a pressure, an attitude, level where it is not known, or a fix."""
    values = sensor.values
    mat_nb = sensor.mat_nb
    columns: dict[str, Column]
    if name == "depth":
        pressure_pa = _ATMOSPHERE_PA + _SEA_WATER_KGPM3 * STANDARD_GRAVITY_MPS2 * values[:, 0]
        # Exact to a hundredth of a millimetre of water.
        columns = {"fluid_pressure": np.round(pressure_pa, 1), "variance": 0.0}
        return stamped("/pressure", "sensor_msgs/msg/FluidPressure", sensor.time_ns, IMU, columns)
    if name == "heading":
        if mat_nb is None:
            mat_nb = mat_from_rpy(np.concatenate([np.zeros((len(values), 2)), values], axis=1))
        quat = np.round(quat_enu_flu(mat_nb), 12)
        columns = components("quaternion", quat, "xyzw")
        return stamped(
            "/ahrs", "geometry_msgs/msg/QuaternionStamped", sensor.time_ns, BASE_LINK, columns
        )
    latitude_deg, longitude_deg = np.round(np.rad2deg(values[:, :2]), 10).T  # 11 um
    columns = {
        "latitude": latitude_deg,
        "longitude": longitude_deg,
        "altitude": np.round(values[:, 2], 4),
    }
    return stamped("/gnss", "sensor_msgs/msg/NavSatFix", sensor.time_ns, BASE_LINK, columns)


def _dvl_batch(dvl: DvlColumns) -> Batch:
    if dvl.beam_velocity_mps is None or dvl.beam_vectors_d is None:
        if dvl.velocity_d is None:
            raise ValueError("the DVL has neither beams nor velocities")
        twist = {
            **components("twist.twist.linear", dvl.velocity_d),
            **components("twist.twist.angular", np.nan),
        }
        return stamped(
            "/dvl", "geometry_msgs/msg/TwistWithCovarianceStamped", dvl.time_ns, DVL, twist
        )
    vectors_d = dvl.beam_vectors_d
    good = np.isfinite(dvl.beam_velocity_mps)
    if vectors_d.shape != (4, 3):
        raise ValueError(
            f"marine_acoustic_msgs/Dvl has 4 beams, found vectors of shape {vectors_d.shape}"
        )
    good_beams = good.sum(axis=1)
    any_good = good_beams > 0
    velocity_d = np.round(_velocity_from_beams(dvl.beam_velocity_mps, vectors_d), VELOCITY_DIGITS)
    forward = velocity_d[:, 0]
    starboard = velocity_d[:, 1]
    altitude_m = np.full(len(good), ALTITUDE_M)
    if dvl.altitude_m is not None:
        altitude_m = dvl.altitude_m
    columns: dict[str, Column] = {
        "velocity_mode": 1,  # bottom track
        **components("velocity", velocity_d),
        "velocity_covar": (_UNKNOWN_VARIANCE,) * 9,
        "altitude": np.where(any_good, altitude_m, np.nan),
        "course_gnd": np.round(np.arctan2(starboard, forward), VELOCITY_DIGITS),
        "speed_gnd": np.round(np.sqrt(forward * forward + starboard * starboard), VELOCITY_DIGITS),
        "num_good_beams": good_beams,
        "sound_speed": np.nan,
        "beam_ranges_valid": any_good,
        "beam_velocities_valid": any_good,
        "range": np.where(good, altitude_m[:, None] / vectors_d[:, 2], np.nan),
        "range_covar": (_UNKNOWN_VARIANCE,) * 4,
        "beam_quality": (np.nan,) * 4,
        "beam_velocity": dvl.beam_velocity_mps,
        "beam_velocity_covar": (_UNKNOWN_VARIANCE,) * 4,
    }
    for beam, (x, y, z) in enumerate(vectors_d.tolist()):
        path = f"beam_unit_vec[{beam}]"
        columns |= {f"{path}.x": x, f"{path}.y": y, f"{path}.z": z}
    return stamped("/dvl", "marine_acoustic_msgs/msg/Dvl", dvl.time_ns, DVL, columns)


def _velocity_from_beams(beam_velocity_mps: Floats, beam_vectors_d: Floats) -> Floats:
    """Solve the beams for the velocity by least squares, as the instrument would; NaN with fewer than three beams.

    The normal matrix N is symmetric, so that its adjugate has the cross products of its columns as its rows.
    """
    good = np.isfinite(beam_velocity_mps)
    normal = np.zeros((len(good), 3, 3))
    projected = np.zeros((len(good), 3))
    for beam, vector in enumerate(beam_vectors_d):
        normal += np.where(good[:, beam, None, None], vector[:, None] * vector, 0.0)
        projected += np.where(good[:, beam, None], beam_velocity_mps[:, beam, None] * vector, 0.0)
    x = normal[:, 0]
    y = normal[:, 1]
    z = normal[:, 2]
    adjugate = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    determinant = turned(adjugate[:, :1], x)
    enough = good.sum(axis=1, keepdims=True) >= _BEAMS_FOR_VELOCITY
    velocity_d = np.full_like(projected, np.nan)
    return np.divide(turned(adjugate, projected), determinant, out=velocity_d, where=enough)


def write_replay(
    path: Path,
    *,
    dive: Dive,
    histories: Sequence[History],
    # Velocity and acceleration in body axes, (m,) and (m, 3).
    dvl: Mapping[str, tuple[TimeNs, Floats]],
    # By filter, estimate minus reference: time_ns, (k,), and errors of (k, 3).
    errors: Mapping[str, Any],
    tables: Tables,
    notes: Sequence[Note],
    config_toml: str,
    version: str,
) -> None:
    """Write what the filters made of a dive; a `LogError` where a time does not fit a ROS stamp."""
    origin = histories[0].position[0]
    batches: list[Batch] = []
    for history in histories:
        batches += _filter_batches(history, errors.get(history.filter), origin)
    for quantity, (type_name, column) in _DVL_MESSAGES.items():
        if quantity in dvl:
            time_ns, values_b = dvl[quantity]
            topic = f"/insdvl/dvl/{quantity}"
            batches.append(stamped(topic, type_name, time_ns, IMU, {column: values_b}))
    if dive.reference is not None:
        # As the log has it, inside the replay; poses count from where the first filter starts.
        shown = dive.reference.within(int(histories[0].time_ns[0]), int(histories[0].time_ns[-1]))
        batches += _motion_batches("/insdvl/reference", shown, origin)
    end_ns = np.array([max(int(history.time_ns[-1]) for history in histories)])
    batches += _table_batches(tables, end_ns)
    batches += [_note_batch(note, dive.name, end_ns) for note in notes]
    metadata = {"version": version, "log": dive.name, "log_sha256": dive.sha256}
    write_log(path, batches, metadata, {"config.toml": ("application/toml", config_toml.encode())})


def _table_batches(tables: Tables, time_ns: TimeNs) -> Iterator[Batch]:
    """Give the rows of the tables at one time, each as a batch, since its texts are its own."""
    for layout, rows in each_table(tables):
        topic = f"/insdvl/table/{layout.name}"
        type_name = f"insdvl_msgs/msg/{layout.row.__name__}"
        for row in rows:
            columns: dict[str, Column] = {}
            for name, kind in layout.kinds.items():
                columns[name] = getattr(row, name)
                if columns[name] is None:
                    columns[name] = "" if kind == "text" else np.nan
            yield stamped(topic, type_name, time_ns, NED, columns)


def _note_batch(note: Note, dive: str, time_ns: TimeNs) -> Batch:
    """Return a note as a message at a time."""
    text = f"{note.code} ({note.count}): {note.text}"
    if note.hint:
        text += f" hint: {note.hint}"
    columns: dict[str, Column] = {
        **stamp("stamp", time_ns),
        "level": _LOG_LEVELS[note.severity],
        "name": dive,
        "msg": text,
    }
    return Batch("/insdvl/notes", "rcl_interfaces/msg/Log", time_ns, columns)


def _filter_batches(history: History, errors: Any, origin: Floats) -> list[Batch]:
    topic = f"/insdvl/{history.filter}"
    batches = []
    motion = history.motion()
    odometry = []
    if history.is_partial:
        state, *odometry = _motion_batches(topic, motion, origin)
        batches.append(state)
        if motion.has_position:
            odometry.append(_fix_batch(topic, motion.rows(motion.known["positions"])))
    else:
        columns: dict[str, Column] = {
            **solution(history.position, history.velocity_n, rpy_from_mat(history.mat_nb)),
            "accel_bias_mg": history.accel_bias_b / MG,
            "gyro_bias_degph": history.gyro_bias_b / DEG_PER_HOUR,
        }
        batches.append(
            stamped(f"{topic}/state", "insdvl_msgs/msg/FilterState", history.time_ns, NED, columns)
        )
        odometry = [_odometry_batch(topic, motion, origin), _fix_batch(topic, motion)]
    if history.predicted.any():
        columns = {
            name_with_unit(state.id, state.unit): history.sd[:, state.index] / state.factor
            for state in STATES
        }
        batches.append(
            stamped(f"{topic}/sigma", "insdvl_msgs/msg/FilterSigma", history.time_ns, NED, columns)
        )
    if errors is not None:
        columns = {
            "position_ned_m": errors.position_error_ned_m,
            "velocity_ned_mps": errors.velocity_error_n,
            **angles(errors.attitude_error_rad),
        }
        batches.append(
            stamped(f"{topic}/error", "insdvl_msgs/msg/FilterError", errors.time_ns, NED, columns)
        )
    for innovations in history.innovations:
        columns = {"unit": innovations.unit, "nis": innovations.nis, "used": innovations.used}
        for name in ("measured", "innovation", "sd"):
            # Three components: NaN where there are fewer, the first where there are more.
            values: Floats = getattr(innovations, name)
            lacking = np.full((len(values), max(0, 3 - values.shape[1])), np.nan)
            columns[name] = values if values.shape[1] == 3 else np.hstack([values, lacking])[:, :3]
        name = f"{topic}/innovation/{innovations.measurement}"
        batches.append(
            stamped(name, "insdvl_msgs/msg/Innovation", innovations.time_ns, IMU, columns)
        )
    return batches + odometry


def _motion_batches(topic: str, motion: ReferenceColumns, origin: Floats) -> list[Batch]:
    """Return a solution as it is, and its rows without missing parts as poses, if there are any."""
    columns = solution(motion.position, motion.velocity_n, rpy_from_mat(motion.mat_nb))
    batches = [
        stamped(f"{topic}/state", "insdvl_msgs/msg/NavSolution", motion.time_ns, NED, columns)
    ]
    whole = np.logical_and.reduce(list(motion.known.values()))
    if whole.any():
        return [*batches, _odometry_batch(topic, motion.rows(whole), origin)]
    return batches


def _odometry_batch(topic: str, motion: ReferenceColumns, origin: Floats) -> Batch:
    """Return poses, east-north-up and forward-port-up, with the velocity in the body; covariances of 0 are unknown."""
    velocity_b = np.einsum("kji,kj->ki", motion.mat_nb, motion.velocity_n)
    columns: dict[str, Column] = {
        "child_frame_id": BASE_LINK,
        **components("pose.pose.position", east_north_up_m(motion.position, origin)),
        **components("pose.pose.orientation", quat_enu_flu(motion.mat_nb), "xyzw"),
        **components("twist.twist.linear", velocity_b @ MAT_FRD_FLU),
        **components("twist.twist.angular", np.nan),
    }
    return stamped(f"{topic}/odometry", "nav_msgs/msg/Odometry", motion.time_ns, ODOM, columns)


def _fix_batch(topic: str, motion: ReferenceColumns) -> Batch:
    latitude_deg, longitude_deg = np.rad2deg(motion.position[:, :2]).T
    columns: dict[str, Column] = {"latitude": latitude_deg, "longitude": longitude_deg}
    columns["altitude"] = motion.position[:, 2]
    return stamped(f"{topic}/fix", "sensor_msgs/msg/NavSatFix", motion.time_ns, BASE_LINK, columns)
