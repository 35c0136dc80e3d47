"""Every kind of MCAP file gives the same messages, and what is no MCAP file is refused by name."""

import hashlib
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_logs import CONTAINERS, IMU_MESSAGES, MESSAGES, messages, small_log, true_messages

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.log_file import Chunk
from insdvl_replay.logs.formats.mcap_file import McapFile, can_be_record, walk
from insdvl_replay.logs.formats.recording import open_recording


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "dive.mcap"


KINDS = [kind for kind in CONTAINERS if "checksums" not in kind and kind != "bare"]
"""Those without checksums are read in `test_damage`."""


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_container_gives_the_same_messages(kind: str, path: Path) -> None:
    path.write_bytes(small_log(kind, extras=True))
    log = open_recording(path)
    times = np.sort(np.concatenate(list(log.log_times().values())))
    assert times.tolist() == sorted(time_ns for _, time_ns, _ in true_messages())
    found = messages(log)
    assert (len(found), set(found)) == (MESSAGES, true_messages())
    assert log.sha256() == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.notes == ()
    assert {
        topic: sum(c.messages for c in log.channels if c.topic == topic)
        for topic in ("/imu", "/dvl")
    } == {
        "/imu": IMU_MESSAGES,
        "/dvl": MESSAGES - IMU_MESSAGES,
    }
    (part,) = log.parts
    [attachment], [metadata] = part.attachments, part.metadata
    assert (attachment.name, attachment.media_type, attachment.data_size) == (
        "notes.txt",
        "text/plain",
        8,
    )
    assert (metadata.name, metadata.metadata) == ("vehicle", {"name": "unknown"})
    assert part.profile == "ros2"
    assert "tests" in part.library
    assert part.has_summary == (kind != "no summary")
    packed = {"lz4": ("lz4",), "uncompressed": ("none",), "no chunks": ()}
    assert part.compression == packed.get(kind, ("zstd",))


def test_chunks_without_wanted_messages_stay_closed(path: Path) -> None:
    data = bytearray(small_log("zstd"))
    path.write_bytes(data)
    log = open_recording(path)
    assert list(log.blocks(set())) == []
    assert list(log.blocks({999})) == []


def test_who_leaves_does_not_wait_for_a_chunk_that_is_opened(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.write_bytes(small_log("zstd"))
    log, is_left, opened = open_recording(path), Event(), []

    def slowly_opened(part: McapFile, chunk: Chunk) -> tuple[memoryview, memoryview]:
        if opened:
            is_left.wait(10.0)
        opened.append(chunk.start)
        return open_chunk(part, chunk)

    open_chunk = McapFile._open
    monkeypatch.setattr(McapFile, "_open", slowly_opened)
    blocks = log.blocks({channel.id for channel in log.channels})
    next(blocks)
    blocks.close()
    assert len(opened) == 1
    is_left.set()


def test_records_of_other_kinds_between_messages_are_counted_and_make_no_chunks(
    path: Path,
) -> None:
    data = small_log("no chunks, no checksums")
    foreign, header_end = (
        b"\xf0" + (4).to_bytes(8, "little") + b"mine",
        8 + 9 + int.from_bytes(data[9:17], "little"),
    )
    parts, place = [data[:header_end]], header_end
    while data[place] != 0x0F:
        stop = place + 9 + int.from_bytes(data[place + 1 : place + 9], "little")
        parts += [data[place:stop], foreign]
        place = stop
    path.write_bytes(_without_summary(b"".join(parts) + data[place:]))
    log = open_recording(path)
    assert set(messages(log)) == true_messages()
    assert [(note.code, note.count) for note in log.notes] == [
        ("unknown_records", len(parts) // 2)
    ]
    (part,) = log.parts
    assert len(part._chunks) < 6


def _without_summary(data: bytes) -> bytes:
    """Leave the summary out, whose places are no longer right."""
    start = data.rindex(b"\x0f" + (4).to_bytes(8, "little")) + 13
    return data[:start] + b"\x02" + (20).to_bytes(8, "little") + bytes(20) + data[-8:]


def test_what_is_no_log_is_refused_by_name(path: Path, tmp_path: Path) -> None:
    cases = {
        b"": r"empty \(0 bytes\)",
        b"SQLite format 3\0....": "where its header says 0",
        b"hello world": "68 65 6c",
    }
    cases |= {
        b"a": r"only 1 byte, too few for a log",
        b"1234567": r"only 7 bytes, too few for a log",
    }
    for content, sentence in cases.items():
        path.write_bytes(content)
        with pytest.raises(LogError, match=sentence) as raised:
            open_recording(path, allow_damaged=True)
        assert raised.value.exit_code == 3
        assert raised.value.hint
    with pytest.raises(LogError, match="cannot be read: No such file"):
        open_recording(tmp_path / "absent.mcap")


@given(
    st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.tuples(st.integers(0, 255), st.binary(max_size=70)).map(
                lambda record: (
                    bytes([record[0]]) + len(record[1]).to_bytes(8, "little") + record[1]
                )
            ),
        ),
        max_size=12,
    ).map(b"".join)
)
def test_records_are_found_as_one_by_one(data: bytes) -> None:
    """Records that are alike are found together."""
    data = data + 40 * (bytes([5]) + (22).to_bytes(8, "little") + bytes(22)) + data
    expected, place = [], 0
    while place + 9 <= len(data):
        kind, length = data[place], int.from_bytes(data[place + 1 : place + 9], "little")
        if place + 9 + length > len(data) or not can_be_record(kind, length):
            break
        expected.append((kind, place, length))
        place += 9 + length
    found, others, stop, is_broken = walk(memoryview(data), len(data))
    known = [row for row in expected if row[0] < 128]
    known = known[:-1] if place < len(data) and known and known[-1][0] == 5 else known
    assert [tuple(row) for row in found.tolist()] == known
    assert (others, stop, is_broken) == (
        sum(row[0] >= 128 for row in expected),
        place,
        place < len(data),
    )
