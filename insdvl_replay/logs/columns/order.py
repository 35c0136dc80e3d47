"""The order of a topic's messages: by their stamps, as far as the recorder's clock does not contradict these.

Messages that overtake each other on their way, or parts of a log that are joined in another order, are only put in
their places. A stamp that jumps while the log time goes on is wrong, and would put its message where it does not
belong.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, find_runs, nanoseconds, seconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.tables import RECORDER_STAMPS, SAME_CLOCK_S, Table
from insdvl_replay.logs.encoding.fields import Columns

FEW_PLACES: Final = 5
"""Messages do not overtake more others than this."""
LEAP_S: Final = 3600.0
"""Stamps that run ahead of the log time by more at once are those of a clock that was set, or of none."""

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Order:
    """In which order the rows of a topic are true.

    Attributes
    ----------
    rows : ndarray, shape (kept,)
        In the order of time, without those that are stamped wrongly.
    late : ndarray, shape (late,)
        Rows that came after later ones, and were put in their places.
    wrong : ndarray, shape (wrong,)
        Rows whose stamps the recorder's clock contradicts, as they were recorded.
    late_s : float
        How far a late row lies behind the latest before it, at most.
    jump_s : float
        By how much, at most, log time minus stamp differs from before to after some wrong stamps, which is what the
        clock of the stamps jumped for good.
    """

    rows: Rows
    late: Rows
    wrong: Rows
    late_s: float
    jump_s: float


def find_order(time_ns: TimeNs, log_time_ns: TimeNs) -> Order:
    """Order messages by their stamps, leaving out those that cannot have been made when they are stamped.

    The largest number of messages whose stamps rise with the log time are right. A run of others is put among them if
    it is off by `FEW_PLACES` and `SAME_CLOCK_S` at most, and is wrong else. Where the stamps leap ahead by `LEAP_S`,
    only the longest part without a leap is right. Both times have shape (k,), in the order of the file.
    """
    if np.all(time_ns[1:] >= time_ns[:-1]) and not _is_there_a_leap(time_ns, log_time_ns):
        nothing = np.empty(0, np.int64)
        return Order(np.arange(time_ns.size), nothing, nothing, 0.0, 0.0)
    recorded = np.lexsort((time_ns, log_time_ns))
    bad, jump_s = _contradictions(time_ns[recorded], log_time_ns[recorded])
    wrong, kept = recorded[bad], np.sort(recorded[~bad])
    latest_ns = np.maximum.accumulate(time_ns[kept])
    is_late = time_ns[kept] < latest_ns
    return Order(
        rows=kept[np.argsort(time_ns[kept], kind="stable")],
        late=kept[is_late],
        wrong=wrong,
        late_s=float(seconds(latest_ns, time_ns[kept]).max(initial=0.0)),
        jump_s=jump_s,
    )


def _contradictions(stamp_ns: TimeNs, log_time_ns: TimeNs) -> tuple[Mask, float]:
    """Find, for messages as they were recorded, which stamps are wrong, and how far their clock jumps for good."""
    rising = _rising(stamp_ns)
    others, bad = np.flatnonzero(~rising), ~rising
    starts = np.flatnonzero(np.diff(others, prepend=-2) > 1)
    places = np.cumsum(rising, dtype=np.int64)[others]
    far = np.logical_or.reduceat(_is_far(stamp_ns[others], stamp_ns[rising], places), starts)
    bad[others] = np.repeat(far, np.diff(starts, append=others.size))
    bad[~bad] = _is_before_or_after_a_leap(stamp_ns[~bad], log_time_ns[~bad])
    start, end = find_runs(bad)
    inside = (start > 0) & (end < bad.size)
    behind_ns = log_time_ns - stamp_ns
    jumps_s = seconds(behind_ns[end[inside]], behind_ns[start[inside] - 1])
    return bad, float(np.abs(jumps_s).max(initial=0.0))


def _is_far(other_ns: TimeNs, rising_ns: TimeNs, places: Rows) -> Mask:
    """Find which stamps belong far from the places among the rising ones at which they were recorded."""
    before_ns = rising_ns[np.maximum(places - 1, 0)]
    after_ns = rising_ns[np.minimum(places, rising_ns.size - 1)]
    off_s = np.maximum(seconds(before_ns, other_ns), seconds(other_ns, after_ns))
    off = np.abs(np.searchsorted(rising_ns, other_ns) - places)
    return np.asarray((off_s > SAME_CLOCK_S) | (off > FEW_PLACES))


def _leaps(stamp_ns: TimeNs, log_time_ns: TimeNs) -> Mask:
    """Find which messages but the first are stamped long after the one before, though recorded soon after it."""
    return np.asarray(np.diff(stamp_ns - log_time_ns) > nanoseconds(LEAP_S))


def _is_there_a_leap(stamp_ns: TimeNs, log_time_ns: TimeNs) -> bool:
    """Return whether there is a leap; the extremes mostly tell that there is none."""
    ahead_ns = stamp_ns - log_time_ns
    can = bool(ahead_ns.size) and int(ahead_ns.max()) - int(ahead_ns.min()) > nanoseconds(LEAP_S)
    return can and bool(_leaps(stamp_ns, log_time_ns).any())


def _is_before_or_after_a_leap(stamp_ns: TimeNs, log_time_ns: TimeNs) -> Mask:
    """Find which messages are not of the longest part without a leap, such as those before a clock was set."""
    part = np.concatenate([[0], np.cumsum(_leaps(stamp_ns, log_time_ns))])
    return np.asarray(part != np.bincount(part).argmax())


def _rising(values: TimeNs) -> Mask:
    """Mark a longest subsequence that never falls."""
    rising: Mask = (values == np.maximum.accumulate(values)) & (values == np.minimum.accumulate(values[::-1])[::-1])
    # What is above all before it and below all behind it is part of any; the others are few in a log that is sound.
    loose = np.flatnonzero(~rising)
    lowest_ends: list[int] = []
    ends_at: list[int] = []
    before = np.full(loose.size, -1, np.int64)
    for i, value in enumerate(values[loose].tolist()):
        length = bisect_right(lowest_ends, value)
        before[i] = ends_at[length - 1] if length else -1
        lowest_ends[length : length + 1] = [value]
        ends_at[length : length + 1] = [i]
    last = ends_at[-1] if ends_at else -1
    while last >= 0:
        rising[loose[last]] = True
        last = int(before[last])
    return rising


def merge_channels(columns: Columns, runs: Sequence[tuple[int, int]]) -> tuple[Columns, NDArray[np.int64], Rows | None]:
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
    rows : ndarray, shape (kept,), or None
        Which messages these are; None where all are of one channel. Left out are those that another channel holds too,
        with the same log time and the same values.
    """
    if len({channel_id for channel_id, _ in runs}) < 2:
        return columns, np.empty(0, np.int64), None
    channel_ids = np.repeat(*np.transpose(runs))
    reached, order = _reached(columns["log_time"][:, 0], channel_ids), np.arange(channel_ids.size)
    if np.any(reached[1:] < reached[:-1]):
        order = np.argsort(reached, kind="stable")
        columns = {path: values[order] for path, values in columns.items()}
        channel_ids = channel_ids[order]
    repeated = repeated_rows(columns, channel_ids)
    if not repeated.any():
        return columns, channel_ids, order
    kept = {path: values[~repeated] for path, values in columns.items()}
    return kept, channel_ids[~repeated], order[~repeated]


def _reached(log_time: TimeNs, channel_ids: NDArray[np.int64]) -> TimeNs:
    """Return the latest log time of each channel yet: sorted by it, no message moves against others of its channel."""
    reached = np.empty_like(log_time)
    for channel_id in np.unique(channel_ids):
        rows = channel_ids == channel_id
        reached[rows] = np.maximum.accumulate(log_time[rows])
    return reached


def repeated_rows(columns: Columns, origin: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Find which messages are as the one before, which is of another origin: another channel or file; shape (k,)."""
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
    """Find which messages no other file has, where those are marked that are as the one before."""
    alone = ~repeated
    alone[:-1] &= ~repeated[1:]
    return alone


def _shared_span(time_ns: TimeNs, own: Mask) -> Mask:
    """Find which messages lie in the time of a file and in that of all others together."""
    first_ns = max(time_ns[own][0], time_ns[~own][0])
    last_ns = min(time_ns[own][-1], time_ns[~own][-1])
    return np.asarray((time_ns >= first_ns) & (time_ns <= last_ns))
