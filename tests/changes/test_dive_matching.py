"""Which old result belongs to which new one."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest
from small_results import content, write

from insdvl_replay.changes.comparison import compare_results
from insdvl_replay.core.errors import ConfigError, ResultError


def matched(old: Path, new: Path) -> list[tuple[str, str | None, str | None, str]]:
    """Dive, old and new folder seen from their roots, and how they were matched."""
    comparison = compare_results(old, new)
    return [
        (
            dive.log,
            dive.old and Path(dive.old).relative_to(old).as_posix(),
            dive.new and Path(dive.new).relative_to(new).as_posix(),
            dive.matched_by,
        )
        for dive in comparison.dives
    ]


def test_a_renamed_log_is_known_by_its_hash_and_an_edited_one_by_its_name(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    write(old / "north", content("north", sha256="aa"))
    write(old / "south", content("south", sha256="bb"))
    write(new / "day1" / "north_1", content("north_1", sha256="aa"))
    write(new / "day2" / "south", content("south", sha256="cc"))
    assert matched(old, new) == [
        ("north_1", "north", "day1/north_1", "hash"),
        ("south", "south", "day2/south", "name"),
    ]


def test_the_hash_goes_before_the_name(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    for folder, (first, second) in ((old, ("aa", "bb")), (new, ("bb", "aa"))):
        write(folder / "one", content("one", sha256=first))
        write(folder / "two", content("two", sha256=second))
    assert matched(old, new) == [("one", "two", "one", "hash"), ("two", "one", "two", "hash")]


def test_results_of_one_log_are_reported_apart_by_their_place(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    for root in (old, new):
        for setting in ("fog", "mems"):
            write(root / setting / "dive", content("dive", sha256="aa"))
    assert matched(old, new) == [
        ("dive", "fog/dive", "fog/dive", "hash"),
        ("dive", "mems/dive", "mems/dive", "hash"),
    ]


def test_dives_without_a_file_have_no_hash_in_common(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    for root, names in ((old, ("one", "two")), (new, ("two", "three"))):
        for name in names:
            write(root / name, content(name, sha256=""))
    assert matched(old, new) == [
        ("two", "two", "two", "name"),
        ("one", "one", None, "nothing"),
        ("three", None, "three", "nothing"),
    ]


def test_several_results_that_could_belong_together_are_refused(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    write(old / "dive", content("dive"))
    write(old / "other", content("other"))
    write(new / "fog" / "dive", content("dive"))
    write(new / "mems" / "dive", content("dive"))
    write(new / "other", content("other"))
    with pytest.raises(ConfigError, match=r"dive: .*old/dive, .*fog/dive"):
        compare_results(old, new)


def test_two_single_results_are_compared_whatever_they_are(tmp_path: Path) -> None:
    old, new = write(tmp_path / "a", content("a")), write(tmp_path / "b", content("b"))
    assert matched(old, new) == [("b", ".", ".", "choice")]
    differing = {
        difference.key for difference in compare_results(old, new / "report.json").differences
    }
    assert {"name", "sha256"} <= differing


def test_no_dive_on_both_sides_is_refused(tmp_path: Path) -> None:
    for root, names in (("old", "ab"), ("new", "cd")):
        for name in names:
            write(tmp_path / root / name, content(name))
    with pytest.raises(ConfigError, match=r"a, b\) .* \(c, d"):
        compare_results(tmp_path / "old", tmp_path / "new")


def test_a_folder_that_cannot_be_read_is_not_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for root in ("old", "new"):
        write(tmp_path / root / "dive", content())
    (tmp_path / "new" / "locked").mkdir()
    scan = os.scandir

    def guarded(folder: str) -> Any:
        if str(folder).endswith("locked"):
            raise PermissionError(errno.EACCES, "Permission denied", folder)
        return scan(folder)

    monkeypatch.setattr(os, "scandir", guarded)
    with pytest.raises(ResultError, match=r"locked: .*Permission"):
        compare_results(tmp_path / "old", tmp_path / "new")


def test_studies_and_results_that_are_still_written_are_left_out(tmp_path: Path) -> None:
    for root in ("old", "new"):
        write(tmp_path / root / "dive", content())
        write(
            tmp_path / root / "window-dive",
            {"tool": {"version": "0.1.0"}, "kind": "window", "tables": {}},
        )
        write(tmp_path / root / ".dive-k2j3" / "new", content())
    comparison = compare_results(tmp_path / "old", tmp_path / "new")
    assert [dive.log for dive in comparison.dives] == ["dive"]
    assert [(note.code, note.count) for note in comparison.notes] == [("studies_left_out", 1)] * 2
