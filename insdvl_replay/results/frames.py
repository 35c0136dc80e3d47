"""Histories and the reference as data frames: of a replay, and read back from the replay.mcap of its result."""

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import AXES
from insdvl_replay.core.states import AXES_N, DEG, DEG_PER_HOUR, DVL_AIDING, GROUPS, MG, STATES
from insdvl_replay.core.units import name_with_unit
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs.columns.tables import Table, read_tables
from insdvl_replay.logs.columns.topics import Source
from insdvl_replay.logs.formats.recording import open_recording
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
_PLACE: Final = ["latitude_deg", "longitude_deg", "height_m"]
_BIASES: Final[Fields] = {
    "accel_bias_mg": [f"ba_{axis}_mg" for axis in AXES],
    "gyro_bias_degph": [f"bg_{axis}_degph" for axis in AXES],
}
_SIGMA: Final[Fields] = {
    name_with_unit(state.id, state.unit): [f"{state.id}_sd"] for state in STATES
}
_COLUMNS: Final = [*chain.from_iterable((_MOTION | _BIASES | _SIGMA).values())]
# The fields that are read of each type of message in a replay.mcap; of an innovation its time alone.
_FIELDS_OF_TYPE: Final[dict[str, Fields]] = {
    "NavSolution": _MOTION,
    "FilterState": _MOTION | _BIASES,
    "FilterSigma": _SIGMA,
    "Innovation": {},
}


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
    reference: ReferenceColumns | None,
    start_ns: int,
    end_ns: int,
    origin: Floats,
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
    position = frame[_PLACE].to_numpy() * [DEG, DEG, 1.0]
    frame[list(GROUPS["position"])] = north_east_down_m(
        position, np.broadcast_to(origin, position.shape)
    )
    return frame


def _motion_frame(
    time_ns: TimeNs,
    position: Floats,
    velocity_n: Floats,
    mat_nb: Floats,
) -> "pd.DataFrame":
    """Return a motion in shown units, by time."""
    import pandas as pd

    values = (position[:, :2] / DEG, position[:, 2:], velocity_n, rpy_from_mat(mat_nb) / DEG)
    names = [*chain.from_iterable(_MOTION.values())]
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
    tables = _read(folder, [f"/insdvl/{name}/" for name in names])
    return {name: _history_of(name, tables, folder) for name in names}


def _history_of(name: str, tables: Mapping[str, Table], folder: Path) -> "pd.DataFrame":
    """Join what the topics of a filter have of its states, its standard deviations and its updates."""
    state = tables.get(f"/insdvl/{name}/state")
    if state is None:
        raise ResultError(
            f"{folder / REPLAY_LOG}: has no history of {name}", "replay the log again"
        )
    frame = _topic_frame(state, _MOTION | _BIASES)
    sigma = tables.get(f"/insdvl/{name}/sigma")
    if sigma is not None:
        frame = frame.join(_topic_frame(sigma, _SIGMA))
    frame = frame.reindex(columns=_COLUMNS)
    updates_ns = [np.empty(0, np.int64)]
    for measurement in DVL_AIDING:
        innovations = tables.get(f"/insdvl/{name}/innovation/{measurement}")
        if innovations is not None:
            updates_ns.append(innovations.time_ns())
    frame.insert(0, "updated", np.isin(frame.index, np.concatenate(updates_ns)))
    return _timed(frame, int(frame.index[0]))


def read_reference(folder: Path, baseline: str) -> "pd.DataFrame":
    """Read the reference inside a replay, with metres from where the baseline starts; no rows without one."""
    of_reference = "/insdvl/reference/state"
    of_baseline = f"/insdvl/{baseline}/state"
    tables = _read(folder, [of_reference, of_baseline])
    if of_reference not in tables or of_baseline not in tables:
        return reference_frame(None, 0, 0, np.zeros(3))
    start = _topic_frame(tables[of_baseline], _MOTION).iloc[:1]
    origin = start[_PLACE].to_numpy()[0] * [DEG, DEG, 1.0]
    reference = _topic_frame(tables[of_reference], _MOTION)
    return _timed(_with_metres(reference, origin), int(start.index[0]))


def stored_reference(folder: Path, baseline: str) -> "pd.DataFrame | None":
    """Read the reference of a result that may have no histories; None without them."""
    if (folder / REPLAY_LOG).is_file():
        return read_reference(folder, baseline)
    return None


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
        if kind in _FIELDS_OF_TYPE and channel.topic.startswith(tuple(prefixes)):
            named = {field: field for field in _FIELDS_OF_TYPE[kind]}
            sources.append(
                Source(
                    "replay", channel.topic, channel.type_name, (channel,), named, "header", 0.0
                )
            )
    topics = [source.topic for source in sources]
    return dict(zip(topics, read_tables(log, sources), strict=True))


def _topic_frame(table: Table, fields: Fields) -> "pd.DataFrame":
    """Return the fields that a topic has, by time."""
    import pandas as pd

    time_ns = table.time_ns()
    parts = []
    for field, columns in fields.items():
        if field in table:
            values = table.values(field, len(columns))
            parts.append(pd.DataFrame(values, columns=columns, index=time_ns))
    return pd.concat(parts, axis=1)
