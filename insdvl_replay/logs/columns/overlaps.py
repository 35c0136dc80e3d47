"""Whether the files that are read as one dive hold one dive, or two that go on at the same time."""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import TimeNs
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.merging import repeated_rows
from insdvl_replay.logs.columns.order import Mask
from insdvl_replay.logs.columns.tables import RECORDER_STAMPS, Table

_FEW: Final = 0.05
"""Share of its messages that a recorder loses at most, so that another one alone has them."""


def refuse_mixture(table: Table, time_ns: TimeNs) -> None:
    """Refuse a topic of which two files hold different messages of the same time.

    Files may follow one another, fill each other's gaps, or hold the same messages, of which each recorder lost some.

    Parameters
    ----------
    table : Table
    time_ns : ndarray, shape (k,)
        Times of validity in the order of the table.

    Raises
    ------
    LogError
        The messages are those of two dives, two vehicles or two sensors.
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
                f"{table.place}: in the {(time_ns[both][-1] - time_ns[both][0]) * 1e-9:.3f} s in which the files "
                f"overlap, {own} messages of one lie among {others} others of the same topic",
                "name only files of one dive that follow one another, or replay each alone, without --one-dive",
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
