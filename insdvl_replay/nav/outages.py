"""Outages of the DVL so long that an INS alone is another thing than an aided one."""

from typing import Final

import numpy as np

from insdvl_replay.columns import NS_PER_S, TimeNs, nanoseconds
from insdvl_replay.errors import Note
from insdvl_replay.nav.gravity_height import HOLD_AFTER_S

_TRUSTED: Final = "5 min with micromechanical sensors, 1 h with tactical and 2 h with fibre-optic ones"
"""How long standard deviations hold without a velocity, by the presets; see equations/kalman_filter.md."""
_HINT: Final = "--start and --end leave it out"


def outage_notes(ping_ns: TimeNs, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """Say of long outages that gravity is held in them, and beyond which length standard deviations do not hold.

    Parameters
    ----------
    ping_ns : ndarray, shape (m,)
        Times of the velocities.
    start_ns, end_ns : int
        Span of the replay.

    Returns
    -------
    tuple of Note
        One that counts the outages beyond `gravity_height.HOLD_AFTER_S`, or none.
    """
    ends_ns = np.concatenate([[start_ns], ping_ns, [end_ns]])
    length_ns = np.diff(ends_ns)
    count, longest = int(np.count_nonzero(length_ns > nanoseconds(HOLD_AFTER_S))), int(np.argmax(length_ns))
    if not count:
        return ()
    longest_s, since_s = length_ns[longest] / NS_PER_S, (ends_ns[longest] - start_ns) / NS_PER_S
    text = (
        f"the DVL gives no velocity for over {HOLD_AFTER_S:g} s, {count} x, the longest {longest_s:.0f} s from "
        f"{since_s:.0f} s after the start on; from then on gravity is taken at the height of before, since an unaided "
        f"height runs away, and standard deviations in and after it hold up to {_TRUSTED}"
    )
    return (Note("dvl_outages", text, count, "warning", _HINT),)
