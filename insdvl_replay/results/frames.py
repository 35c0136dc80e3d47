"""Histories and the reference as data frames: of a replay, and read back from the replay.mcap of its result."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import AXES
from insdvl_replay.core.states import AXES_N, DEG, DEG_PER_HOUR, DVL_AIDING, GROUPS, MG, STATES
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs.columns.tables import Table, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.logs.write import UNIT_NAMES
from insdvl_replay.results.folder import REPLAY_LOG

if TYPE_CHECKING:
    import pandas as pd

Fields = dict[str, list[str]]  # Columns by the field of a message that holds them.
_MOTION: Final[Fields] = {
    "latitude_deg": ["latitude_deg"],
    "longitude_deg": ["longitude_deg"],
    "height_m": ["height_m"],
    "velocity_ned_mps": [f"velocity_{axis}_mps" for axis in AXES_N],
    "roll_deg": ["roll_deg"],
    "pitch_deg": ["pitch_deg"],
    "heading_deg": ["heading_deg"],
}
_BIASES: Final[Fields] = {
    "accel_bias_mg": [f"ba_{axis}_mg" for axis in AXES],
    "gyro_bias_degph": [f"bg_{axis}_degph" for axis in AXES],
}
_SIGMA: Final[Fields] = {
    f"{state.id}_{UNIT_NAMES[state.unit]}": [f"{state.id}_sd"] for state in STATES
}
_COLUMNS: Final = [
    column for columns in (_MOTION | _BIASES | _SIGMA).values() for column in columns
]


def history_frame(history: History) -> "pd.DataFrame":
    """Return the history of a filter, a row for each time, in shown units."""
    frame = _motion_frame(history.time_ns, history.position, history.velocity_n, history.mat_nb)
    frame[_BIASES["accel_bias_mg"]] = history.accel_bias_b / MG
    frame[_BIASES["gyro_bias_degph"]] = history.gyro_bias_b / DEG_PER_HOUR
    for state in STATES:
        frame[f"{state.id}_sd"] = history.sd[:, state.index] / state.factor
    frame.insert(0, "updated", history.updated)
    return _timed(frame, int(history.time_ns[0]))


def reference_frame(
    reference: ReferenceColumns | None, start_ns: int, end_ns: int, origin: Floats
) -> "pd.DataFrame":
    """Return the reference inside a replay, a row for each of its times, with metres from an origin, (3,) rad and m."""
    if reference is None:
        reference = ReferenceColumns(
            np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3))
        )
    shown = reference.within(start_ns, end_ns)
    frame = _motion_frame(shown.time_ns, shown.position, shown.velocity_n, shown.mat_nb)
    return _timed(_with_metres(frame, origin), start_ns)


def _with_metres(frame: "pd.DataFrame", origin: Floats) -> "pd.DataFrame":
    """Add the columns of the position that a trajectory has."""
    position = frame[["latitude_deg", "longitude_deg", "height_m"]].to_numpy() * [DEG, DEG, 1.0]
    frame[list(GROUPS["position"])] = north_east_down_m(
        position, np.broadcast_to(origin, position.shape)
    )
    return frame


def _motion_frame(
    time_ns: TimeNs, position: Floats, velocity_n: Floats, mat_nb: Floats
) -> "pd.DataFrame":
    """Return a motion in shown units, by time."""
    import pandas as pd

    values = (position[:, :2] / DEG, position[:, 2:], velocity_n, rpy_from_mat(mat_nb) / DEG)
    names = [column for columns in _MOTION.values() for column in columns]
    return pd.DataFrame(np.hstack(values), columns=names, index=time_ns)


def _timed(frame: "pd.DataFrame", start_ns: int) -> "pd.DataFrame":
    """Turn the times into the first two columns."""
    time_ns = frame.index.to_numpy()
    frame.insert(0, "time_s", seconds(time_ns, start_ns))
    frame.insert(0, "time_ns", time_ns)
    return frame.reset_index(drop=True)


# --- From a result folder.


def read_histories(folder: Path, names: Sequence[str]) -> dict[str, "pd.DataFrame"]:
    """Read the histories of filters. A recorded solution has the rows in which it gives anything."""
    found = _read(folder, [f"/insdvl/{name}/" for name in names])
    frames = {}
    for name in names:
        if (state := found.get(f"/insdvl/{name}/state")) is None:
            raise ResultError(
                f"{folder / REPLAY_LOG}: has no history of {name}", "replay the log again"
            )
        frame = _topic_frame(state, _MOTION | _BIASES)
        if (sigma := found.get(f"/insdvl/{name}/sigma")) is not None:
            frame = frame.join(_topic_frame(sigma, _SIGMA))
        frame = frame.reindex(columns=_COLUMNS)
        met = [
            found[topic].time_ns()
            for kind in DVL_AIDING
            if (topic := f"/insdvl/{name}/innovation/{kind}") in found
        ]
        frame.insert(
            0, "updated", np.isin(frame.index, np.concatenate([np.empty(0, np.int64), *met]))
        )
        frames[name] = _timed(frame, int(frame.index[0]))
    return frames


def read_reference(folder: Path, baseline: str) -> "pd.DataFrame":
    """Read the reference inside a replay, with metres from where the baseline starts; no rows without one."""
    topics = ["/insdvl/reference/state", f"/insdvl/{baseline}/state"]
    state, start = map(_read(folder, topics).get, topics)
    if state is None or start is None:
        return reference_frame(None, 0, 0, np.zeros(3))
    first = _topic_frame(start, _MOTION).iloc[:1]
    origin = first[["latitude_deg", "longitude_deg", "height_m"]].to_numpy()[0] * [DEG, DEG, 1.0]
    return _timed(_with_metres(_topic_frame(state, _MOTION), origin), int(first.index[0]))


def _read(folder: Path, prefixes: Sequence[str]) -> dict[str, Table]:
    """Read some topics of a result's replay.mcap, by name."""
    path = folder / REPLAY_LOG
    if not path.is_file():
        hint = "replay the log again, or `insdvl-replay check --keep-histories`"
        raise ResultError(f"{folder}: has no {REPLAY_LOG}, which holds the histories", hint)
    log = open_recording(path)
    sources = []
    for channel in log.channels:
        kind = channel.type_name.rpartition("/")[2]
        fields = {
            "NavSolution": _MOTION,
            "FilterState": _MOTION | _BIASES,
            "FilterSigma": _SIGMA,
            "Innovation": {},
        }
        if kind in fields and channel.topic.startswith(tuple(prefixes)):
            named = {field: field for field in fields[kind]}
            sources.append(
                Source("replay", channel.topic, channel.type_name, (channel,), named, "header", 0.0)
            )
    return {
        source.topic: table
        for source, table in zip(sources, read_tables(log, sources), strict=True)
    }


def _topic_frame(table: Table, fields: Fields) -> "pd.DataFrame":
    """Return the fields that a topic has, by time."""
    import pandas as pd

    parts = [
        pd.DataFrame(table.values(field, len(columns)), columns=columns, index=table.time_ns())
        for field, columns in fields.items()
        if field in table
    ]
    return pd.concat(parts, axis=1)
