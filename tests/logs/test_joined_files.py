"""Several files as one log: their order, the ids of their channels, their digest, and what is said of them."""

import hashlib
from pathlib import Path

import pytest
from recorded_parts import write_part

from insdvl_replay.logs.formats.recording import CHANNELS_OF_A_PART, Recording


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """The second half of a dive, then the first."""
    later = write_part(tmp_path / "a.mcap", lambda _, time_s: time_s >= 2.0)
    earlier = write_part(tmp_path / "b.mcap", lambda _, time_s: time_s < 2.0)
    return [later, earlier]


def test_what_was_recorded_first_comes_first_and_no_channel_id_occurs_twice(
    files: list[Path],
) -> None:
    log = Recording(files[0], files)
    assert [part.path.name for part in log.parts] == ["b.mcap", "a.mcap"]
    ids = [channel.id for channel in log.channels]
    assert len(set(ids)) == len(ids) == 4
    assert set(log.log_times()) == set(ids)
    blocks = list(log.blocks(ids))
    assert int(blocks[0].log_time[0]) == min(int(block.log_time[0]) for block in blocks)
    for wanted in ids:
        assert {block.channel_id for block in log.blocks({wanted})} == {wanted}
    assert max(ids) > CHANNELS_OF_A_PART


def test_the_digest_is_that_of_the_digests_in_the_order_of_time(files: list[Path]) -> None:
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in reversed(files)]
    expected = hashlib.sha256("".join(digests).encode()).hexdigest()
    assert (
        Recording(files[0], files).sha256()
        == Recording(files[1], files[::-1]).sha256()
        == expected
    )


def test_files_that_follow_one_another_are_named_and_no_more(files: list[Path]) -> None:
    (note,) = Recording(files[0], files).notes
    assert (note.code, note.count, note.text) == (
        "joined_files",
        2,
        "read as one dive: b.mcap, a.mcap",
    )


def test_files_that_overlap_are_reported_with_the_longest_overlap(files: list[Path]) -> None:
    files.append(
        write_part(
            files[0].with_name("c.mcap"), lambda topic, time_s: topic != "/dvl" and time_s > 1.0
        )
    )
    notes = {note.code: note for note in Recording(files[0], files).notes}
    assert notes["files_overlap"].text == "2 files overlap with the file before, by up to 2.990 s"
