"""Several files as one log: their order, the ids of their channels, their digest, and what is said of them."""

import hashlib
from pathlib import Path

import pytest
from recorded_parts import write_part

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.recording import CHANNELS_OF_A_PART, Recording


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """The second half of a dive, then the first."""
    later = write_part(tmp_path / "a.mcap", lambda _, time_s: time_s >= 2.0)
    earlier = write_part(tmp_path / "b.mcap", lambda _, time_s: time_s < 2.0)
    return [later, earlier]


def test_what_was_recorded_first_comes_first(files: list[Path]) -> None:
    parts = Recording(files[0], files)
    assert [part.path.name for part in parts.parts] == ["b.mcap", "a.mcap"]
    first_ns = [int(block.log_time[0]) for block in parts.blocks({channel.id for channel in parts.channels})]
    assert first_ns[0] == min(first_ns)


def test_no_channel_id_occurs_twice(files: list[Path]) -> None:
    parts = Recording(files[0], files)
    assert len({channel.id for channel in parts.channels}) == len(parts.channels) == 4
    assert set(parts.log_times()) == {channel.id for channel in parts.channels}


def test_blocks_bear_the_id_of_the_channel_of_their_file(files: list[Path]) -> None:
    parts = Recording(files[0], files)
    wanted = next(channel.id for channel in parts.channels if channel.id > CHANNELS_OF_A_PART)
    assert {block.channel_id for block in parts.blocks({wanted})} == {wanted}


def test_the_digest_is_that_of_the_digests_in_the_order_of_time(files: list[Path]) -> None:
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in reversed(files)]
    expected = hashlib.sha256("".join(digests).encode()).hexdigest()
    assert Recording(files[0], files).sha256() == Recording(files[1], files[::-1]).sha256() == expected


def test_files_that_follow_one_another_are_named_and_no_more(files: list[Path]) -> None:
    (note,) = Recording(files[0], files).notes
    assert (note.code, note.count, note.text) == ("joined_files", 2, "read as one dive: b.mcap, a.mcap")


def test_files_that_overlap_are_told_with_the_longest_overlap(files: list[Path]) -> None:
    files.append(write_part(files[0].with_name("c.mcap"), lambda topic, time_s: topic != "/dvl" and time_s > 1.0))
    notes = {note.code: note for note in Recording(files[0], files).notes}
    assert notes["files_overlap"].text == "2 files begin before those before them end, by up to 2.990 s"


def test_a_file_of_nothing_is_passed_over_where_damage_is_allowed(files: list[Path]) -> None:
    empty = files[0].with_name("c.mcap")
    empty.write_bytes(b"")
    with pytest.raises(LogError, match=r"c\.mcap"):
        Recording(files[0], [*files, empty])
    parts = Recording(files[0], [*files, empty], allow_damaged=True)
    assert (len(parts.parts), len(parts.digests())) == (2, 3)
    assert [note.severity for note in parts.notes if note.code == "log_damaged"] == [Severity.WARNING]
