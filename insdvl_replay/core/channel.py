"""One topic of a log, for the record: whoever reads a stored report must not wait for numpy."""

from dataclasses import dataclass


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
