"""Outages of the DVL so long that an INS alone is another thing than an aided one."""

from typing import Final

import numpy as np

from insdvl_replay.columns import NS_PER_S, TimeNs, nanoseconds
from insdvl_replay.errors import Note
from insdvl_replay.nav.gravity_height import HOLD_AFTER_S

SIGMAS_HOLD_S: Final = 1200.0
"""Standard deviations stay true for so long with micromechanical sensors; with tactical ones for twice as long, with
fibre-optic gyros for six times, see EQUATIONS.md."""


def outage_notes(ping_ns: TimeNs, start_ns: int, end_ns: int) -> tuple[Note, ...]:
    """Say of long outages when gravity is held, and beyond which length standard deviations no longer hold.

    Parameters
    ----------
    ping_ns : ndarray, shape (m,)
        Times of the velocities.
    start_ns, end_ns : int
        Span of the replay.

    Returns
    -------
    tuple of Note
        One that counts the outages beyond `gravity_height.HOLD_AFTER_S`, or none; a warning beyond `SIGMAS_HOLD_S`.
    """
    ends_ns = np.concatenate([[start_ns], ping_ns, [end_ns]])
    length_ns = np.diff(ends_ns)
    long = np.flatnonzero(length_ns > nanoseconds(HOLD_AFTER_S))
    if not len(long):
        return ()
    longest = int(np.argmax(length_ns))
    longest_s, since_s = length_ns[longest] / NS_PER_S, (ends_ns[longest] - start_ns) / NS_PER_S
    text = (
        f"the DVL gives no velocity for over {HOLD_AFTER_S:g} s ({len(long)} times, the longest {longest_s:.0f} s from "
        f"{since_s:.0f} s after the start on); after that time gravity is taken at the height of before, since an "
        "unaided height runs away"
    )
    if longest_s <= SIGMAS_HOLD_S:
        return (Note("dvl_outages", text, len(long), hint=_HINT),)
    text += (
        f"; standard deviations in and after an outage hold for {SIGMAS_HOLD_S / 60.0:.0f} min with micromechanical "
        "sensors, 40 min with tactical and 2 h with fibre-optic ones"
    )
    return (Note("dvl_outages", text, len(long), "warning", _HINT),)


_HINT: Final = "--start and --end leave it out; a metre of depth that changes in it unseen makes 0.3 ug of gravity"
