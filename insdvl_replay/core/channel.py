"""One topic of a log, and its clock, for the record: whoever reads a stored report must not wait for numpy."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """The stamps of a topic against the times at which it was recorded.

    Attributes
    ----------
    stamp : str
        Where the stamps come from, as the configuration names it.
    messages : int
        How many were read to know it.
    log_minus_stamp_s : float
        Median.
    spread_s : float
        From the 5th to the 95th percentile of log time minus stamp.
    back_steps, repeats : int
        Stamps that lie before, or at, the one before in the file.
    rate_hz : float or None
        By the stamps: those that differ, over the time between the first and the last; None where all repeat.
    """

    role: str
    topic: str
    stamp: str
    messages: int
    log_minus_stamp_s: float
    spread_s: float
    back_steps: int
    repeats: int
    rate_hz: float | None


@dataclass(frozen=True)
class Channel:
    """What a log holds on one topic, for the record.

    Attributes
    ----------
    topic, type_name, encoding : str
        As the log names them.
    role : str
        ``imu``, ``dvl``, ``reference``, ``truth``, or empty where the replay has no use for it.
    messages : int
        How many messages the log holds.
    """

    topic: str
    type_name: str
    encoding: str
    role: str
    messages: int
