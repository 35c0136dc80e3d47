"""A replay as a log: histories, innovations, errors and tables, to be looked at in any viewer of ROS 2 data."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from msgspec import Struct

from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import DEG_PER_HOUR, MG, STATES
from insdvl_replay.core.table import TableLayout
from insdvl_replay.core.tables import Tables, each_table
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import MAT_FRD_FLU, east_north_up_m, quat_enu_flu
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs.writing.writer import (
    BASE_LINK,
    IMU,
    NED,
    ODOM,
    Batch,
    Column,
    InUnit,
    angles,
    missing_xyz,
    solution,
    stamp,
    stamped,
    write_log,
    xyz,
)

Sampled = tuple[TimeNs, Floats]
"""Times of validity, shape (m,), and vectors in body axes, shape (m, 3)."""

_UNIT_NAMES: Final = {"m/s": "mps", "mrad": "mrad", "mg": "mg", "deg/h": "degph"}
_LOG_LEVELS: Final = {Severity.INFO: 20, Severity.WARNING: 30}


class Errors(Protocol):
    """Estimate minus reference at the reference's times."""

    @property
    def time_ns(self) -> TimeNs:
        """Times, shape (k,)."""

    @property
    def position_error_ned_m(self) -> Floats:
        """North, east, down, shape (k, 3)."""

    @property
    def velocity_error_n(self) -> Floats:
        """North, east, down, m/s, shape (k, 3)."""

    @property
    def attitude_error_rad(self) -> Floats:
        """About level forward, level starboard and down, shape (k, 3)."""


def write_replay(
    path: Path,
    *,
    dive: Dive,
    histories: Sequence[History],
    dvl: Mapping[str, Sampled],
    errors: Mapping[str, Errors],
    tables: Tables,
    notes: Sequence[Note],
    config_toml: str,
    version: str,
) -> None:
    """Write what the filters made of a dive.

    Parameters
    ----------
    path : Path
        File to write, replaced if it exists.
    dive : Dive
        Where the replay comes from.
    histories : sequence of History
        One for each filter.
    dvl : mapping of str to Sampled
        ``velocity`` and ``acceleration``, as far as there are any.
    errors : mapping of str to Errors
        By filter, as far as there is a reference.
    config_toml : str
        The resolved configuration.
    version : str
        Of the tool.

    Raises
    ------
    LogError
        A time does not fit a ROS stamp.
    OSError
        The file cannot be written.
    """
    origin = histories[0].position[0]
    end_ns = max(int(history.time_ns[-1]) for history in histories)
    batches = [batch for history in histories for batch in _filter_batches(history, errors.get(history.filter), origin)]
    batches += [_dvl(quantity, *sampled) for quantity, sampled in dvl.items()]
    if dive.reference is not None:
        batches += _reference_batches(dive.reference, histories[0])
    for layout, rows in each_table(tables):
        batches += [_row(layout, row, end_ns) for row in rows]
    batches += [_note(dive.name, note, end_ns) for note in notes]
    metadata = {"version": version, "log": dive.name, "log_sha256": dive.sha256}
    write_log(path, batches, metadata, {"config.toml": ("application/toml", config_toml.encode())})


def _filter_batches(history: History, errors: Errors | None, origin: Floats) -> Iterator[Batch]:
    topic = f"/insdvl/{history.filter}"
    motion = history.motion()
    yield _solution(f"{topic}/state", motion) if history.is_partial else _state(f"{topic}/state", history)
    if history.believed.any():
        yield _sigma(f"{topic}/sigma", history)
    if errors is not None:
        yield _error(f"{topic}/error", errors)
    for innovations in history.innovations:
        yield _innovation(f"{topic}/innovation/{innovations.measurement}", innovations)
    if not history.is_partial:
        yield _odometry(f"{topic}/odometry", motion, origin)
        yield _fix(f"{topic}/fix", motion)
        return
    yield from _whole_odometry(f"{topic}/odometry", motion, origin)
    if motion.has_position:
        yield _fix(f"{topic}/fix", motion.rows(motion.known["positions"]))


def _state(topic: str, history: History) -> Batch:
    columns: dict[str, Column] = {
        **solution(history.position, history.velocity_n, rpy_from_mat(history.mat_nb)),
        "accel_bias_mg": InUnit(history.accel_bias_b, MG),
        "gyro_bias_degph": InUnit(history.gyro_bias_b, DEG_PER_HOUR),
    }
    return stamped(topic, "insdvl_msgs/msg/FilterState", history.time_ns, NED, columns)


def _sigma(topic: str, history: History) -> Batch:
    columns: dict[str, Column] = {
        f"{state.id}_{_UNIT_NAMES[state.unit]}": InUnit(history.sd[:, state.index], state.factor) for state in STATES
    }
    return stamped(topic, "insdvl_msgs/msg/FilterSigma", history.time_ns, NED, columns)


def _error(topic: str, errors: Errors) -> Batch:
    columns = {
        "position_ned_m": errors.position_error_ned_m,
        "velocity_ned_mps": errors.velocity_error_n,
        **angles(errors.attitude_error_rad),
    }
    return stamped(topic, "insdvl_msgs/msg/FilterError", errors.time_ns, NED, columns)


def _innovation(topic: str, innovations: Innovations) -> Batch:
    columns: dict[str, Column] = {
        "unit": innovations.unit,
        "measured": _three(innovations.measured),
        "innovation": _three(innovations.innovation),
        "sd": _three(innovations.sd),
        "nis": innovations.nis,
        "used": innovations.used,
    }
    return stamped(topic, "insdvl_msgs/msg/Innovation", innovations.time_ns, IMU, columns)


def _three(components: Floats) -> Floats:
    """Return three components, shape (k, 3): NaN where there are fewer, the first where there are more."""
    lacking = np.full((len(components), max(0, 3 - components.shape[1])), np.nan)
    return components if components.shape[1] == 3 else np.hstack([components, lacking])[:, :3]


def _reference_batches(reference: ReferenceColumns, history: History) -> Iterator[Batch]:
    """Write down what the filters are held against, as they are; poses count from where the first of them starts."""
    replayed = (reference.time_ns >= history.time_ns[0]) & (reference.time_ns <= history.time_ns[-1])
    shown = reference.rows(replayed)
    yield _solution("/insdvl/reference/state", shown)
    yield from _whole_odometry("/insdvl/reference/odometry", shown, history.position[0])


def _solution(topic: str, motion: ReferenceColumns) -> Batch:
    columns = solution(motion.position, motion.velocity_n, rpy_from_mat(motion.mat_nb))
    return stamped(topic, "insdvl_msgs/msg/NavSolution", motion.time_ns, NED, columns)


def _whole_odometry(topic: str, motion: ReferenceColumns, origin: Floats) -> Iterator[Batch]:
    """Write the rows with position, height, velocity and attitude, if there are any; a pose has no part missing."""
    whole = np.logical_and.reduce(list(motion.known.values()))
    if whole.any():
        yield _odometry(topic, motion.rows(whole), origin)


def _odometry(topic: str, motion: ReferenceColumns, origin: Floats) -> Batch:
    """East-north-up and forward-port-up, the velocity in the body; zero covariances mean unknown."""
    velocity_b = np.einsum("kji,kj->ki", motion.mat_nb, motion.velocity_n)
    quat = quat_enu_flu(motion.mat_nb)
    columns: dict[str, Column] = {
        "child_frame_id": BASE_LINK,
        **xyz("pose.pose.position", east_north_up_m(motion.position, origin)),
        **{f"pose.pose.orientation.{axis}": quat[:, i] for i, axis in enumerate("xyzw")},
        **xyz("twist.twist.linear", velocity_b @ MAT_FRD_FLU),
        **missing_xyz("twist.twist.angular"),
    }
    return stamped(topic, "nav_msgs/msg/Odometry", motion.time_ns, ODOM, columns)


def _fix(topic: str, motion: ReferenceColumns) -> Batch:
    latitude_deg, longitude_deg = np.rad2deg(motion.position[:, :2]).T
    columns = {"latitude": latitude_deg, "longitude": longitude_deg, "altitude": motion.position[:, 2]}
    return stamped(topic, "sensor_msgs/msg/NavSatFix", motion.time_ns, BASE_LINK, columns)


def _dvl(quantity: str, time_ns: TimeNs, values_b: Floats) -> Batch:
    type_name, field = {
        "velocity": ("insdvl_msgs/msg/DvlVelocity", "velocity_mps"),
        "acceleration": ("insdvl_msgs/msg/DvlAcceleration", "acceleration_mps2"),
    }[quantity]
    return stamped(f"/insdvl/dvl/{quantity}", type_name, time_ns, IMU, {field: values_b})


def _row(layout: TableLayout, row: Struct, end_ns: int) -> Batch:
    """Return each row of a table as a batch of its own, since its texts are its own."""
    columns: dict[str, Column] = {}
    for name, kind in layout.kinds.items():
        value = getattr(row, name)
        columns[name] = value if value is not None else "" if kind == "text" else np.nan
    type_name = f"insdvl_msgs/msg/{layout.row.__name__}"
    return stamped(f"/insdvl/table/{layout.name}", type_name, np.array([end_ns]), NED, columns)


def _note(dive_name: str, note: Note, end_ns: int) -> Batch:
    text = f"{note.code} ({note.count}): {note.text}" + (f" hint: {note.hint}" if note.hint else "")
    columns: dict[str, Column] = {"level": _LOG_LEVELS[note.severity], "name": dive_name, "msg": text}
    time_ns = np.array([end_ns])
    return Batch("/insdvl/notes", "rcl_interfaces/msg/Log", time_ns, {**stamp("stamp", time_ns), **columns})
