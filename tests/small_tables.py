"""Small tables of one topic, as if a log had been read, for tests of what makes them clean."""

from collections.abc import Sequence

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs
from insdvl_replay.logs.columns.clean import Cleaner
from insdvl_replay.logs.columns.tables import Table
from insdvl_replay.logs.columns.topics import Source


def small_table(stamps_s: Sequence[float], log_times_s: Sequence[float] | None = None) -> Table:
    """A topic of the IMU whose messages bear these times; the recorder's clock shows the same if it shows no others."""
    source = Source("imu", "/imu", "sensor_msgs/msg/Imu", (), {}, "publish_time", 0.0)
    times = {
        "publish_time": stamps_s,
        "log_time": stamps_s if log_times_s is None else log_times_s,
    }
    return Table(
        ("dive.mcap", "/imu"),
        source,
        {name: nanoseconds(values)[:, None] for name, values in times.items()},
    )


def small_cleaner(
    stamps_s: Sequence[float], log_times_s: Sequence[float] | None = None
) -> Cleaner:
    """What cleans such a topic."""
    return Cleaner(small_table(stamps_s, log_times_s))


def nanoseconds(values_s: Sequence[float]) -> TimeNs:
    """Round to whole nanoseconds."""
    return np.round(np.asarray(values_s) * NS_PER_S).astype(np.int64)
