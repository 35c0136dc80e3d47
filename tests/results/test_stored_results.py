"""Results found on the disk: which folders hold one, which are passed over, and how those that cannot be read end."""

import json
from pathlib import Path

import pytest
from small_results import content, write

from insdvl_replay.core.errors import ConfigError, ResultError
from insdvl_replay.results.stored_results import earlier_results, read_results

STUDY = {"kind": "montecarlo", "tool": {"name": "insdvl-replay"}}


def names_in(root: Path) -> list[tuple[str, str]]:
    return [(result.name, result.below) for result in read_results(root)[0]]


@pytest.mark.parametrize("where", ["", "report.json"])
def test_a_result_is_found_by_its_folder_and_by_its_report(where: str, tmp_path: Path) -> None:
    assert names_in(write(tmp_path / "one", content("dive")) / where) == [("dive", ".")]


def test_results_are_found_at_any_depth_in_the_order_of_their_paths(tmp_path: Path) -> None:
    write(tmp_path / "b", content("second"))
    write(tmp_path / "a" / "2026" / "x", content("first"))
    assert names_in(tmp_path) == [("first", "a/2026/x"), ("second", "b")]


def test_what_is_still_written_and_what_is_in_a_result_is_ignored(tmp_path: Path) -> None:
    write(tmp_path / ".dive-unfinished", content("unfinished"))
    write(tmp_path / "dive" / "inside", content("inside"))
    write(tmp_path / "dive", content("dive"))
    assert names_in(tmp_path) == [("dive", "dive")]


def test_studies_are_counted_and_alone_no_results(tmp_path: Path) -> None:
    write(tmp_path / "study", STUDY)
    with pytest.raises(ConfigError, match="studies"):
        read_results(tmp_path)
    write(tmp_path / "dive", content())
    results, (note,) = read_results(tmp_path)
    assert (len(results), note.code, note.count) == (1, "studies_left_out", 1)


def test_a_place_without_results_and_no_place_are_a_users_errors(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=tmp_path.name):
        read_results(tmp_path)
    with pytest.raises(ConfigError, match="elsewhere"):
        read_results(tmp_path / "elsewhere")


def test_tables_rows_and_columns_of_other_versions_are_kept(tmp_path: Path) -> None:
    report = content()
    report["tables"]["of_tomorrow"] = [{"anything": 1}]
    report["tables"]["improvement"][0]["of_tomorrow"] = 3.0
    ((result,), _) = read_results(write(tmp_path, report))
    assert result.report.tables["of_tomorrow"] == [{"anything": 1}]
    assert result.report.tables["improvement"][0]["of_tomorrow"] == 3.0


@pytest.mark.parametrize("column", ["filter", "state"])
def test_a_row_of_which_nobody_knows_what_it_is_about_is_refused(
    column: str, tmp_path: Path
) -> None:
    report = content()
    del report["tables"]["improvement"][1][column]
    with pytest.raises(ResultError, match=f"table improvement, row 2: .* {column}"):
        read_results(write(tmp_path, report))


def test_a_report_of_another_form_names_the_version_that_wrote_it(tmp_path: Path) -> None:
    report = content() | {"tables": 3}
    with pytest.raises(ResultError, match=r"0\.1\.0\): .*`object`.*`int`"):
        read_results(write(tmp_path, report))


DEEP = '{"config": {"dvl": ' + "[" * 100_000 + "]" * 100_000 + "}}"


@pytest.mark.parametrize(
    "data", [b"", b'{"log": ', b'{"kind": "\xff"}', DEEP.encode()], ids=["", "cut", "ff", "deep"]
)
def test_bytes_that_are_no_report_are_refused(data: bytes, tmp_path: Path) -> None:
    write(tmp_path, content())
    (tmp_path / "report.json").write_bytes(data)
    with pytest.raises(ResultError, match=r"report\.json: .*JSON"):
        read_results(tmp_path)


def test_a_report_is_read_as_it_was_written(tmp_path: Path) -> None:
    ((result,), notes) = read_results(write(tmp_path, content(rmse=0.25)))
    assert result.report.tables == json.loads((tmp_path / "report.json").read_text())["tables"]
    assert (result.folder, notes) == (tmp_path, [])


def test_results_beside_those_of_the_last_run_are_left_out_and_named(tmp_path: Path) -> None:
    run = tmp_path / "replay"
    for name in ("one", "two", "three", "four"):
        write(run / name, content(name))
    summary = run / "summary.csv"
    summary.write_text(
        "log,filter,status\none,aided,done\none,other,done\nthree,aided,done\nfour,,failed\n"
    )
    results, (note,) = read_results(run)
    assert [result.name for result in results] == ["one", "three"]
    assert (note.code, note.count, note.severity) == ("earlier_results", 2, "warning")
    assert note.text.endswith("2 results of earlier runs are left out: four, two")
    assert earlier_results(run, {"one", "three"}) == [note]
    assert earlier_results(run, {"one", "two", "three", "four"}) == []
    # From above, each folder of a run counts for itself; another table of that name says nothing of results.
    assert len(read_results(tmp_path)[0]) == 2
    summary.write_text("log,filter,status\none,,failed\n")
    with pytest.raises(ConfigError, match="last run into it has replayed no dive"):
        read_results(run)
    summary.write_text("time,log\n1.0,2.0\n")
    assert len(read_results(run)[0]) == 4
