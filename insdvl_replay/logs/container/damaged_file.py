"""The error with which a damaged log is refused: where it is damaged, and what could be saved."""

from collections.abc import Iterable, Sequence

import numpy as np

from insdvl_replay.core.columns import TimeNs, seconds
from insdvl_replay.core.errors import LogError


def refused(complaints: Sequence[str], saved: Iterable[TimeNs], places: str = "damaged places") -> LogError:
    """Make the error.

    Parameters
    ----------
    complaints : sequence of str
        One sentence for each fault.
    saved : iterable of ndarray, shape (k,)
        Log times of all messages that can be read, ns.
    places : str
        What has the faults.

    Returns
    -------
    LogError
    """
    more = f" ({len(complaints) - 1} more {places})" if len(complaints) > 1 else ""
    times = np.concatenate([np.empty(0, np.int64), *saved])
    if not times.size:
        return LogError(f"{complaints[0]}{more}", "no message in it can be read; copy it again from the recorder")
    span_s = float(seconds(times.max(), int(times.min())))
    hint = f"--allow-damaged uses the {span_s:.1f} s and {times.size} messages that can be read"
    return LogError(f"{complaints[0]}{more}", hint)
