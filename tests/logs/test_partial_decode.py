"""Messages that do not fit their schema: refused with what could be saved, or left out, counted and told."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_logs import (
    DVL_MESSAGES,
    IMU_MESSAGES,
    START_NS,
    changed,
    flipped,
    records,
    small_log,
    written,
)

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive

MESSAGE = 5
PAYLOAD = 9 + 22
FRAME_ID_SIZE = PAYLOAD + 4 + 8
HARMED = (31, 32, 300)
"""Of all messages in the order of the file; none of these is a ping."""

Harm = Callable[[bytes, int], bytes]


def big_endian(data: bytes, start: int) -> bytes:
    return flipped(data, start + PAYLOAD + 1)


def long_text(data: bytes, start: int) -> bytes:
    return changed(data, start + FRAME_ID_SIZE, (1 << 30).to_bytes(4, "little"))


def longer_text(data: bytes, start: int) -> bytes:
    """Let a text end eight bytes later than it does, so that the rest does not fit."""
    size = int.from_bytes(data[start + FRAME_ID_SIZE : start + FRAME_ID_SIZE + 4], "little")
    return changed(data, start + FRAME_ID_SIZE, (size + 8).to_bytes(4, "little"))


def harmed(harm: Harm, places: tuple[int, ...] = HARMED) -> bytes:
    data = small_log("no chunks, no checksums")
    for start, _ in (records(data, MESSAGE)[place] for place in places):
        data = harm(data, start)
    return data


@pytest.fixture
def whole(tmp_path: Path) -> Dive:
    path = tmp_path / "whole.mcap"
    path.write_bytes(written())
    return read_dive(path, Config())


@pytest.mark.parametrize("harm", [big_endian, long_text, longer_text])
def test_messages_that_do_not_fit_are_refused_or_left_out(
    harm: Harm, tmp_path: Path, whole: Dive
) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(harmed(harm))
    with pytest.raises(LogError, match=rf"{path}: /imu: .* \(2 more messages\)") as raised:
        read_dive(path, Config())
    assert (
        raised.value.hint
        == f"--allow-damaged uses the 5.0 s and {IMU_MESSAGES - 3} messages that can be read"
    )
    dive = read_dive(path, Config(), allow_damaged=True)
    rows = np.flatnonzero(~np.isin(whole.imu.time_ns, dive.imu.time_ns))
    assert rows.size == 3
    np.testing.assert_array_equal(
        dive.imu.specific_force_b, np.delete(whole.imu.specific_force_b, rows, axis=0)
    )
    assert len(dive.dvl.time_ns) == DVL_MESSAGES
    [note] = [note for note in dive.notes if note.severity == "warning"]
    assert (note.code, note.count) == ("messages_unreadable", 3)
    first_s, last_s = ((whole.imu.time_ns[row] - START_NS) * 1e-9 for row in (rows[0], rows[-1]))
    assert f"from {first_s:.3f} s to {last_s:.3f} s after the first readable one" in note.text


def test_inspect_says_that_a_replay_would_stop(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(harmed(big_endian))
    inventory = inspect_log(path, Config(), deep=True)
    [blocker] = [one for one in inventory.blockers if "big-endian" in one.message]
    assert (
        blocker.hint
        == f"--allow-damaged uses the 5.0 s and {IMU_MESSAGES - 3} messages that can be read"
    )
    assert "messages_unreadable" in {note.code for note in inventory.notes}


def test_a_topic_of_which_no_message_fits_is_refused_by_its_schema(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(harmed(big_endian, tuple(range(IMU_MESSAGES + DVL_MESSAGES))))
    with pytest.raises(LogError, match="are big-endian CDR") as raised:
        read_dive(path, Config(), allow_damaged=True)
    assert "--allow-damaged" not in raised.value.hint
