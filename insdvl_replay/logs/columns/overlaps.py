"""Messages of one topic from several channels or files: merged, each once, and refused where they are of two dives."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import TimeNs
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.order import Mask
from insdvl_replay.logs.columns.tables import RECORDER_STAMPS, Table
from insdvl_replay.logs.encoding.field_paths import Columns


def merge_channels(columns: Columns, runs: Sequence[tuple[int, int]]) -> tuple[Columns, NDArray[np.int64], int]:
    """Merge the messages of several channels, each of which stays in its own order, and leave out repetitions.

    Parameters
    ----------
    columns : dict of str to ndarray, shape (k, n)
        With ``log_time``, ns.
    runs : sequence of (int, int)
        From the first message on: a channel, and how many messages in a row are of it.

    Returns
    -------
    columns : dict of str to ndarray, shape (kept, n)
    channel_ids : ndarray, shape (kept,)
        Of each message; empty where all are of one.
    duplicates : int
        Messages that another channel holds too, with the same log time and the same values.
    """
    if len({channel_id for channel_id, _ in runs}) < 2:
        return columns, np.empty(0, np.int64), 0
    channel_ids = np.repeat(*np.transpose(runs))
    reached = _reached(columns["log_time"][:, 0], channel_ids)
    if np.any(reached[1:] < reached[:-1]):
        order = np.argsort(reached, kind="stable")
        columns = {path: values[order] for path, values in columns.items()}
        channel_ids = channel_ids[order]
    repeated = repeated_rows(columns, channel_ids)
    if not repeated.any():
        return columns, channel_ids, 0
    kept = {path: values[~repeated] for path, values in columns.items()}
    return kept, channel_ids[~repeated], int(np.count_nonzero(repeated))


def _reached(log_time: TimeNs, channel_ids: NDArray[np.int64]) -> TimeNs:
    """Give the latest log time of each channel so far: sorted by it, no message moves against others of its channel."""
    reached = np.empty_like(log_time)
    for channel_id in np.unique(channel_ids):
        rows = channel_ids == channel_id
        reached[rows] = np.maximum.accumulate(log_time[rows])
    return reached


def repeated_rows(columns: Columns, origin: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which messages are as the one before, which is of another origin.

    Parameters
    ----------
    columns : dict of str to ndarray, shape (k, n)
        With ``log_time``, ns; NaN is as NaN.
    origin : ndarray, shape (k,)
        The channel or file of each message.

    Returns
    -------
    ndarray of bool, shape (k,)
    """
    repeated = np.zeros(origin.size, np.bool_)
    log_time = columns["log_time"][:, 0]
    rows = 1 + np.flatnonzero((log_time[1:] == log_time[:-1]) & (origin[1:] != origin[:-1]))
    same = np.ones(rows.size, np.bool_)
    for values in columns.values():
        same &= np.all((values[rows] == values[rows - 1]) | _both_missing(values[rows], values[rows - 1]), axis=1)
    repeated[rows] = same
    return repeated


def _both_missing(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.isnan(one) & np.isnan(other)


_FEW: Final = 0.05
"""Share of its messages that a recorder loses at most, so that another one alone has them."""


def raise_if_two_dives(table: Table, time_ns: TimeNs) -> None:
    """Refuse a topic of which two files hold different messages of the same time.

    Files may follow one another, fill each other's gaps, or hold the same messages, of which each recorder lost some.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        Times of validity in the order of the table.
    """
    files = table.files
    if files is None:
        return
    order = np.lexsort((files, time_ns))
    files, time_ns = files[order], time_ns[order]
    values = {path: column[order] for path, column in table.columns.items() if path not in RECORDER_STAMPS}
    alone = _alone(repeated_rows(values | {"log_time": time_ns[:, None]}, files))
    for file in np.unique(files).tolist():
        both = _shared_span(time_ns, files == file)
        own, others = (int(np.count_nonzero(rows & both & alone)) for rows in (files == file, files != file))
        if min(own, others) > max(1.0, _FEW * np.count_nonzero(both)):
            raise LogError(
                f"in the {(time_ns[both][-1] - time_ns[both][0]) * 1e-9:.3f} s in which the files "
                f"overlap, {own} messages of one lie among {others} others of the same topic",
                "name only files of one dive that follow one another, or replay each alone, without --one-dive",
                *table.where,
            )


def _alone(repeated: Mask) -> Mask:
    """Tell which messages no other file has, where those are marked that are as the one before."""
    alone = ~repeated
    alone[:-1] &= ~repeated[1:]
    return alone


def _shared_span(time_ns: TimeNs, own: Mask) -> Mask:
    """Tell which messages lie in the time of a file and in that of all others together."""
    first_ns = max(time_ns[own][0], time_ns[~own][0])
    last_ns = min(time_ns[own][-1], time_ns[~own][-1])
    return np.asarray((time_ns >= first_ns) & (time_ns <= last_ns))
