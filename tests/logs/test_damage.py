"""Damaged logs: refused with the place and what could be saved, or read as far as the bytes can be believed."""

import re
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from small_logs import (
    MESSAGES,
    Message,
    changed,
    flipped,
    messages,
    records,
    small_log,
    true_messages,
)

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.recording import Recording, open_recording

CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX, ATTACHMENT = 4, 5, 6, 7, 8, 9
STATISTICS, DATA_END, FOOTER = 11, 15, 2

Harm = Callable[[bytes], bytes]


def cut_at(share: float, data: bytes) -> bytes:
    return data[: int(share * len(data))]


def cut_chunk(data: bytes) -> bytes:
    start, end = records(data, CHUNK)[5]
    return data[: (start + end) // 2]


def zero_tail(data: bytes) -> bytes:
    half = len(data) // 2
    return data[:half] + bytes(len(data) - half)


def zeros_inside(data: bytes) -> bytes:
    """Write zeros over a tenth of the file, as a disk does that lost some blocks."""
    start, size = 2 * len(data) // 5, len(data) // 10
    return changed(data, start, bytes(size))


def zeros_appended(data: bytes) -> bytes:
    return data + bytes(4096)


def in_record(kind: int, which: int, place: int, new: bytes, data: bytes) -> bytes:
    """Write over bytes of a record, counted from its header."""
    return changed(data, records(data, kind)[which][0] + place, new)


def flip_in(kind: int, which: int, place: int, data: bytes) -> bytes:
    start, end = records(data, kind)[which]
    return flipped(data, start + place if place >= 0 else end + place, 3)


def flip_payload(data: bytes) -> bytes:
    start, end = records(data, CHUNK)[3]
    return flipped(data, (start + end) // 2, 5)


def with_right_checksum(harm: Harm, data: bytes) -> bytes:
    """Harm the summary and make its checksum right again, as a wrong recorder would."""
    data = harm(data)
    footer, end = records(data, FOOTER)[0]
    start = int.from_bytes(data[footer + 9 : footer + 17], "little")
    return changed(data, end - 4, struct.pack("<I", zlib.crc32(data[start : end - 4])))


def chunk_taken_out(data: bytes) -> bytes:
    (start, _), (following, _) = records(data, CHUNK)[2:4]
    return data[:start] + data[following:]


def lying_size(size: int, data: bytes) -> bytes:
    return in_record(CHUNK, 2, 9 + 16, struct.pack("<Q", size), data)


def message_in_chunk(data: bytes) -> int:
    """Find the second message in an open chunk."""
    start, _ = records(data, CHUNK)[2]
    first = start + INSIDE - 4 + 8
    while data[first] != MESSAGE:
        first += 9 + int.from_bytes(data[first + 1 : first + 9], "little")
    return first + 9 + int.from_bytes(data[first + 1 : first + 9], "little")


def foreign_channel(data: bytes) -> bytes:
    """Let a message in an uncompressed chunk without checksum claim a channel that is nowhere defined."""
    place = message_in_chunk(data)
    return changed(data, place + 9, struct.pack("<H", 999))


def wrong_length_in_chunk(length: int, data: bytes) -> bytes:
    place = message_in_chunk(data)
    return changed(data, place + 1, struct.pack("<Q", length))


def of_no_known_kind(data: bytes) -> bytes:
    """Let two messages of a channel in an open chunk be private records; its index names both."""
    first = place = message_in_chunk(data)
    while place == first or data[place + 9 : place + 11] != data[first + 9 : first + 11]:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    return changed(changed(data, first, b"\x90"), place, b"\x90")


def nothing_but_a_start(data: bytes) -> bytes:
    return data[:8]


@dataclass(frozen=True)
class Case:
    """A kind of damage: in which container, what is said of it, and how many messages are lost at most and at least."""

    kind: str
    harm: Harm
    sentence: str
    most: int
    least: int = 0


CHUNKFUL = 60
CHUNK_S = 0.45
STEP_S = 0.01
INSIDE = 9 + 32 + 4

ALTERED = "flip without chunks"
"""Here no message is lost, and one is not what it was; no checksum tells which."""

MATRIX = {
    "cut in the middle": Case("zstd", partial(cut_at, 0.5), "closing bytes are missing", 330, 200),
    "cut in an lz4 chunk": Case("lz4", cut_chunk, "closing bytes are missing", 330, 200),
    "cut in an open chunk": Case("bare", cut_chunk, "closing bytes are missing", 330, 200),
    "cut without chunks": Case(
        "no chunks", partial(cut_at, 0.5), "closing bytes are missing", 330, 200
    ),
    "zeros at the start": Case(
        "zstd", partial(changed, place=0, new=bytes(9_000)), "the opening bytes", 180, 20
    ),
    "closing bytes missing": Case("zstd", lambda data: data[:-8], "closing bytes are missing", 0),
    "cut behind the start": Case(
        "zstd", nothing_but_a_start, "closing bytes are missing", MESSAGES, MESSAGES
    ),
    "zero tail": Case("zstd", zero_tail, "closing bytes are missing", 330, 200),
    "zeros inside": Case("zstd", zeros_inside, "kind|chunk", 3 * CHUNKFUL, 20),
    "zeros inside, without chunks": Case(
        "no chunks", zeros_inside, "kind|chunk", 3 * CHUNKFUL, 20
    ),
    "zeros appended": Case("zstd", zeros_appended, "closing bytes are missing", 0),
    "flip in a zstd chunk": Case("zstd", flip_payload, "chunk", CHUNKFUL, 20),
    "flip in an lz4 chunk": Case("lz4", flip_payload, "chunk", CHUNKFUL, 20),
    "flip in an open chunk": Case(
        "uncompressed", flip_payload, "checksum of a chunk", CHUNKFUL, 20
    ),
    "flip in a chunk's kind": Case(
        "zstd", partial(flip_in, CHUNK, 3, 0), "an index does not follow a chunk", CHUNKFUL
    ),
    ALTERED: Case(
        "no chunks", partial(flip_in, MESSAGE, 30, 200), "checksum of all messages", MESSAGES, 0
    ),
    "unknown compression": Case(
        "zstd",
        partial(in_record, CHUNK, 2, INSIDE - 4, b"brot"),
        "compressed with 'brot'",
        CHUNKFUL,
        20,
    ),
    "chunk length too long": Case(
        "zstd", partial(in_record, CHUNK, 2, 1, b"\xff\xff"), "kind|summary has a chunk", CHUNKFUL
    ),
    "chunk length too long, no summary": Case(
        "no summary", partial(in_record, CHUNK, 2, 1, b"\xff\xff"), "bytes", CHUNKFUL
    ),
    "chunk says it is huge, no summary": Case(
        "no summary", partial(lying_size, 1 << 40), "says it opens", CHUNKFUL
    ),
    "chunk says it is small": Case(
        "zstd", partial(lying_size, 10), "opens to more than 10 bytes", CHUNKFUL, 20
    ),
    "flip in an index's channel": Case(
        "zstd", partial(flip_in, INDEX, 4, 9), "do not agree with its messages", 0
    ),
    "flip in an index's length": Case(
        "zstd", partial(flip_in, INDEX, 4, 11), "says it has 344 bytes", 0
    ),
    "index points elsewhere": Case(
        "zstd", partial(flip_in, INDEX, 4, 24), "do not agree with its messages", 0
    ),
    "flip in the chunk index": Case(
        "zstd", partial(flip_in, CHUNK_INDEX, 2, 30), "checksum of the summary", 0
    ),
    "chunk index points elsewhere": Case(
        "zstd",
        partial(with_right_checksum, partial(flip_in, CHUNK_INDEX, 2, 9 + 16)),
        "summary has a chunk here, but there is none",
        0,
    ),
    "footer of another kind": Case(
        "zstd", partial(flip_in, FOOTER, 0, 0), "kind 10 are no record", 0
    ),
    "summary starts beyond the end": Case(
        "zstd", partial(in_record, FOOTER, 0, 9, b"\xff" * 8), "summary starts at byte 1844674", 0
    ),
    "end of messages of another kind": Case(
        "zstd", partial(flip_in, DATA_END, 0, 0), "kind 7 are no record", 0
    ),
    "chunk taken out": Case("zstd", chunk_taken_out, "summary", CHUNKFUL, 20),
    "message of an unknown channel": Case(
        "bare", foreign_channel, "do not agree with its messages of channel 999", 1
    ),
    "message of an unknown channel, without chunks": Case(
        "no chunks, no checksums",
        partial(in_record, MESSAGE, 40, 9, struct.pack("<H", 999)),
        "channel 999, which",
        1,
        1,
    ),
    "message too long in a chunk": Case(
        "bare", partial(wrong_length_in_chunk, 400), "in the chunk", 2, 1
    ),
    "messages of no known kind in a chunk": Case(
        "bare", of_no_known_kind, "do not agree with its messages", 2, 2
    ),
    "channel that cannot be parsed": Case(
        "no chunks, no checksums",
        partial(in_record, CHANNEL, 0, 9 + 4, b"\xff" * 4),
        "cannot be parsed",
        0,
    ),
    "statistics among the messages": Case(
        "zstd",
        partial(in_record, INDEX, 4, 0, bytes([STATISTICS])),
        "a record of kind 11 is among",
        0,
    ),
    "message too short": Case(
        "no chunks, no checksums",
        partial(in_record, MESSAGE, 40, 1, b"\x05\x00"),
        "kind|record",
        2,
        1,
    ),
    "flip in an attachment": Case(
        "zstd", partial(flip_in, ATTACHMENT, 0, -6), "checksum of an attachment", 0
    ),
}


@pytest.mark.parametrize("name", MATRIX)
def test_damage_is_refused_with_its_place_and_the_rest_is_saved(name: str, tmp_path: Path) -> None:
    case, path = MATRIX[name], tmp_path / "dive.mcap"
    path.write_bytes(case.harm(small_log(case.kind, extras=True)))
    with pytest.raises(
        LogError, match=rf"dive\.mcap: is damaged at byte \d+: .*(?:{case.sentence})"
    ) as refused:
        everything(path, allow_damaged=False)
    log, found = everything(path, allow_damaged=True)
    lost = MESSAGES - len(found)
    assert case.least <= lost <= case.most
    assert len(set(found)) == len(found)
    gone = true_messages() - set(found)
    if name == ALTERED:
        assert len(gone) == 1
        gone = set()
    else:
        assert set(found) <= true_messages()
    [note] = [note for note in log.notes if note.code == "log_damaged"]
    assert note.severity == "warning"
    assert_loss_is_told(note.text, gone)
    assert_hint(refused.value, len(found))


LOST = re.compile(r"(at least )?(\d+) messages? of (/\w+) \((\d+\.\d+) s\)")


def assert_loss_is_told(text: str, gone: set[Message]) -> None:
    """Hold what is said of the loss against what was lost: exact, or at least so much."""
    lost = {
        topic: sorted(time_ns for other, time_ns, _ in gone if other == topic)
        for topic in ("/imu", "/dvl")
    }
    if "no messages are lost" in text:
        assert not gone
        return
    told = {
        topic: (bool(least), int(count), float(span_s))
        for least, count, topic, span_s in LOST.findall(text)
    }
    assert told or "an unknown number of messages (at least " in text
    for topic, (at_least, count, reported_s) in told.items():
        assert 0 < count <= len(lost[topic])
        span_s = (lost[topic][-1] - lost[topic][0]) * 1e-9
        if not at_least:
            assert count == len(lost[topic])
            assert reported_s <= span_s + CHUNK_S + 0.4


def everything(
    path: Path, *, allow_damaged: bool
) -> tuple[Recording, list[tuple[str, int, bytes]]]:
    log = open_recording(path, allow_damaged=allow_damaged)
    found = messages(log)
    log.sha256()
    return log, found


def assert_hint(error: LogError, saved: int) -> None:
    if saved:
        assert error.hint.startswith("--allow-damaged uses the ")
        assert f" s and {saved} messages that can be read" in error.hint
    else:
        assert "no message in it can be read" in error.hint


def test_a_log_that_is_wrong_in_two_ways_is_always_refused_in_the_same_words(
    tmp_path: Path,
) -> None:
    """The checksum of a chunk and that of all messages are wrong, which are found at the same time."""
    path, said = tmp_path / "dive.mcap", set()
    path.write_bytes(flip_payload(small_log("all checksums")))
    for _ in range(10):
        with pytest.raises(LogError) as refused:
            read_dive(path, Config())
        said.add(str(refused.value))
    assert len(said) == 1


def test_a_chunk_is_reported_once_however_many_channels_its_indexes_leave_out(
    tmp_path: Path,
) -> None:
    path, data = tmp_path / "dive.mcap", small_log("zstd")
    for which in (3, 2):  # the last ones behind the first chunk become records of somebody else
        data = in_record(INDEX, which, 0, b"\x90", data)
    path.write_bytes(data)
    log, found = everything(path, allow_damaged=True)
    assert len(found) == MESSAGES
    [note] = [note for note in log.notes if note.code == "log_damaged"]
    assert "the indexes of a chunk do not agree with its messages of channel 3, 4" in note.text
    assert "no messages are lost" in note.text


def test_loss_is_reported_by_topic_in_messages_and_seconds(tmp_path: Path) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(flip_payload(small_log("zstd")))
    log, found = everything(path, allow_damaged=True)
    [note] = log.notes
    gone = true_messages() - set(found)
    told = {
        topic: (int(count), float(span_s)) for _, count, topic, span_s in LOST.findall(note.text)
    }
    for topic, (count, span_s) in told.items():
        times = sorted(time_ns for other, time_ns, _ in gone if other == topic)
        kept = np.array(sorted(time_ns for other, time_ns, _ in found if other == topic))
        around = kept[kept > times[-1]].min() - kept[kept < times[0]].max()
        assert (count, span_s) == (len(times), pytest.approx(around * 1e-9, abs=5e-4))
    assert set(told) == {topic for topic, _, _ in gone}


# Mutations

CHECKED = (
    "zstd",
    "lz4",
    "uncompressed",
    "no message index",
    "no chunk index",
    "no summary",
    "no chunks",
)
"""Kinds of containers of which every byte that matters has a checksum, so that no change can go unnoticed."""


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Harm a log as disks, networks and bugs do: change bytes, cut, fill, move, repeat."""
    size = len(data)
    place = int(rng.integers(8, size))
    length = int(rng.integers(1, 1 << int(rng.integers(1, 13))))
    other = int(rng.integers(8, size))
    return [
        lambda: flipped(data, place, int(rng.integers(8))),
        lambda: changed(data, place, rng.bytes(min(length, size - place))),
        lambda: changed(data, place, bytes(min(length, size - place))),
        lambda: changed(data, place, b"\xff" * min(8, size - place)),
        lambda: data[:place],
        lambda: data[:place] + data[place + length :],
        lambda: data[:place] + data[other : other + length] + data[place:],
        lambda: data[:place] + bytes(size - place),
    ][int(rng.integers(8))]()


def assert_told(original: Dive, path: Path) -> bool:
    """Read a harmed log both ways; tell whether it was refused."""
    for allow_damaged in (False, True):
        start_s = time.monotonic()
        try:
            dive = read_dive(path, Config(), allow_damaged=allow_damaged)
        except (LogError, ConfigError):
            refused = not allow_damaged
        else:
            refused = False
            if not same_columns(original, dive):
                assert dive.notes != original.notes
                assert any(
                    note.severity == "warning" or note.code == "unknown_records"
                    for note in dive.notes
                )
        assert time.monotonic() - start_s < 5.0
        if not allow_damaged:
            first = refused
    return first


def same_columns(one: Dive, other: Dive) -> bool:
    pairs = [
        (one.imu.time_ns, other.imu.time_ns),
        (one.imu.specific_force_b, other.imu.specific_force_b),
        (one.imu.angular_rate_b, other.imu.angular_rate_b),
        (one.dvl.time_ns, other.dvl.time_ns),
        (one.dvl.velocity_d, other.dvl.velocity_d),
    ]
    return all(np.array_equal(a, b) for a, b in pairs if a is not None and b is not None)


STATUS = Path("/proc/self/status")


def memory_kb(kind: str) -> int:
    """Of this process, now (VmRSS) or at most since `forget_peak` (VmHWM); 0 where the system does not tell."""
    if not STATUS.is_file():
        return 0
    return next(
        int(line.split()[1]) for line in STATUS.read_text().splitlines() if line.startswith(kind)
    )


def forget_peak() -> None:
    if STATUS.is_file():
        Path("/proc/self/clear_refs").write_text("5")


# A harmed number may be as large as numbers get, and its square larger.


@pytest.mark.parametrize(
    ("seed", "count"),
    [(1, 70), *(pytest.param(seed, 620, marks=pytest.mark.nightly) for seed in (2, 3, 4))],
)
def test_no_mutation_brings_a_traceback_a_hang_or_silent_change(
    seed: int, count: int, tmp_path: Path
) -> None:
    rng, path = np.random.default_rng(seed), tmp_path / "dive.mcap"
    refused, before_kb = 0, memory_kb("VmRSS")
    forget_peak()
    for i in range(count):
        data = small_log(CHECKED[i % len(CHECKED)], extras=True)
        path.write_bytes(data)
        original = read_dive(path, Config())
        harmed = mutated(data, rng)
        path.write_bytes(harmed)
        try:
            refused += assert_told(original, path)
        except BaseException as error:
            error.add_note(f"mutation {i} of a log with container '{CHECKED[i % len(CHECKED)]}'")
            raise
    assert refused > 0.8 * count
    assert memory_kb("VmHWM") - before_kb < 350 * 1024, (
        "beside the 150 MB of a program that has read nothing"
    )


def test_without_checksums_no_mutation_brings_a_traceback(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(5), tmp_path / "dive.mcap"
    for kind in 15 * ("no checksums", "bare", "no chunks, no checksums"):
        path.write_bytes(mutated(small_log(kind), rng))
        for allow_damaged in (False, True):
            try:
                read_dive(path, Config(), allow_damaged=allow_damaged)
            except (LogError, ConfigError):
                continue


@pytest.mark.parametrize("container", ["zstd", "no message index"])
def test_a_chunk_that_two_readers_lose_is_lost_once(container: str, tmp_path: Path) -> None:
    data = small_log(container)
    start, end = records(data, CHUNK)[-1]
    path = tmp_path / "dive.mcap"
    path.write_bytes(changed(data, (start + end) // 2, bytes(40)))
    part = open_recording(path, allow_damaged=True).parts[0]
    ids = [channel.id for channel in part.channels]
    first = part.blocks(ids)
    count = len(next(first))
    again = sum(len(block) for block in part.blocks(ids))
    count += sum(len(block) for block in first)
    assert count == again < MESSAGES
    assert len(part.damages) == 1
