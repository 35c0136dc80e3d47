"""Whether a reference is fast enough for the dive: what a vehicle does between two of its samples is not compared."""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats, TimeNs, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG

SMALL_TURN: Final = 10.0 * DEG
"""Through a smaller turn a straight line between two samples misses less than 0.4 % of the speed, 1 - cos(5 deg)."""
LARGE_TURN: Final = 45.0 * DEG
"""Through a larger one it misses more than 7 %, 1 - cos(22.5 deg), and the turn may have come and gone unseen."""


def reference_rate_notes(history: History, reference_ns: TimeNs) -> tuple[Note, ...]:
    """Say that a reference is too slow for the dive's turns, where it is.

    Parameters
    ----------
    history : History
        Any filter's; shows the motion at the pings, and at the reference's times inside the replay.
    reference_ns : ndarray, shape (r,)
        Times of the reference.

    Returns
    -------
    tuple of Note
        One, or none. It counts the intervals with more than `SMALL_TURN`, and is a warning above `LARGE_TURN`.
    """
    since, turn, change_mps = _since_last_sample(history, reference_ns)
    turning = turn > SMALL_TURN
    if not turning.any():
        return ()
    worst = int(np.argmax(turn))
    apart_s = float(seconds(reference_ns[np.searchsorted(reference_ns, since[worst], side="right")], since[worst]))
    text = (
        f"between two samples of the reference, {apart_s:.2g} s apart, the vehicle turns by up to "
        f"{turn[worst] / DEG:.0f} deg and changes its velocity by up to {change_mps.max():.2f} m/s; errors in "
        "between are not seen"
    )
    hint = f"a reference at {turn[worst] / SMALL_TURN / apart_s:.2g} Hz would see this turn"
    count = len(np.unique(since[turning]))
    return (Note("reference_slow", text, count, "warning" if turn[worst] > LARGE_TURN else "info", hint),)


def _since_last_sample(history: History, reference_ns: TimeNs) -> tuple[TimeNs, Floats, Floats]:
    """Give the time of the last sample before each recorded time, and turn and change of velocity since then."""
    sampled = np.flatnonzero(np.isin(history.time_ns, reference_ns))
    if len(sampled) < 2:
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    rows = np.arange(sampled[0] + 1, sampled[-1] + 1)
    last = sampled[np.searchsorted(sampled, rows, side="left") - 1]
    # The trace of a rotation is 1 + 2 cos(angle).
    trace = np.einsum("kij,kij->k", history.mat_nb[rows], history.mat_nb[last])
    turn = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    change_mps = np.linalg.norm(history.velocity_n[rows] - history.velocity_n[last], axis=1)
    return history.time_ns[last], turn, change_mps
