"""Files without an end, links without an end, and lists that mean more than they say."""

from pathlib import Path

import pytest

from insdvl_replay.batch.dive_paths import find_dives, usable_paths
from insdvl_replay.changes.gate_file import load_gates
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs.formats.recording import bag_parts, open_recording

needs_devices = pytest.mark.skipif(
    not Path("/dev/zero").exists(), reason="needs /dev/zero (not Windows)"
)


@needs_devices
def test_settings_gates_and_lists_have_an_end() -> None:
    with pytest.raises(ConfigError, match="/dev/zero: cannot be read: File too large"):
        load_config(file=Path("/dev/zero"))
    with pytest.raises(ConfigError, match="/dev/zero: cannot be read: File too large"):
        load_gates(Path("/dev/zero"))


def test_a_mark_in_front_of_the_text_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "marked.toml").write_bytes(b"\xef\xbb\xbf[dvl]\nscale = 1.25\n")
    assert load_config(file=tmp_path / "marked.toml").dvl.scale == 1.25


def test_a_folder_that_links_to_itself_is_walked_once(tmp_path: Path) -> None:
    (tmp_path / "dive.mcap").touch()
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "other.mcap").touch()
    for name in ("a", "b", "below/c"):
        (tmp_path / name).symlink_to(tmp_path)
    found = usable_paths(find_dives([str(tmp_path)]))
    assert found == [tmp_path / "below" / "other.mcap", tmp_path / "dive.mcap"]


def test_a_log_that_links_to_itself_is_reported_as_one_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "dive.mcap").symlink_to("dive.mcap")
    (found,) = usable_paths(find_dives([str(tmp_path / "dive.mcap")]))
    with pytest.raises(LogError, match="cannot be read: Too many levels of symbolic links"):
        open_recording(found)
    with pytest.raises(LogError, match="cannot be read: Too many levels of symbolic links"):
        open_recording([found, found.with_name("later.mcap")])


WRONG = [
    ("a: [b", "lists no files"),
    (
        f"rosbag2_bagfile_information: {{relative_file_paths: [{'a' * 5000}]}}",
        "lists a+, which is not there",
    ),
]


def test_a_list_of_parts_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").touch()
    for text, reason in WRONG:
        (tmp_path / "metadata.yaml").write_text(text)
        with pytest.raises(LogError, match=rf"metadata\.yaml: ({reason})"):
            bag_parts(tmp_path)
