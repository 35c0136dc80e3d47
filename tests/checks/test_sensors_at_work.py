"""Sensors beside IMU and DVL that tell nothing."""

from collections.abc import Mapping

import numpy as np
import pytest

from insdvl_replay.checks.sensors import sensor_notes
from insdvl_replay.core.dive_columns import SensorColumns

SECOND = 1_000_000_000


def read(values: list[float], rate_hz: float) -> Mapping[str, SensorColumns]:
    time_ns = np.arange(len(values)) * round(SECOND / rate_hz)
    return {"depth": SensorColumns(time_ns, np.array(values)[:, None])}


@pytest.mark.parametrize(
    ("values", "rate_hz", "stuck"),
    [
        ([-10.36] * 200, 5.0, 200),
        ([-10.36] * 199 + [-10.35], 5.0, None),  # it moved
        ([-10.36] * 100, 5.0, None),  # for 20 s a vehicle may hover
        ([-10.36] * 19, 0.1, None),  # too few to say so
    ],
)
def test_a_sensor_whose_readings_are_all_the_same_is_stuck(
    values: list[float], rate_hz: float, stuck: int | None
) -> None:
    notes = sensor_notes(read(values, rate_hz), None)
    assert [note.count for note in notes] == ([] if stuck is None else [stuck])
    assert all((note.code, note.hint) == ("depth_stuck", "depth.topic names another one") for note in notes)
