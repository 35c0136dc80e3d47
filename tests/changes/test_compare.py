"""``compare``: two sets of stored results beside each other."""

import csv
import io
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pytest
from rich.console import Console
from small_results import content, nudged, write
from taken_apart import Document

from insdvl_replay.changes.cells import Change
from insdvl_replay.changes.comparison import (
    Comparison,
    aggregates,
    compare_results,
    find_violation,
    only_changed,
)
from insdvl_replay.changes.comparison_document import comparison_document, comparison_result
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError, ResultError
from insdvl_replay.core.quantities import PRIMARIES, SECONDARIES
from insdvl_replay.core.report import as_json
from insdvl_replay.core.tables import LAYOUTS
from insdvl_replay.document.page import page
from insdvl_replay.document.parts import DisplayTable
from insdvl_replay.document.render import render
from insdvl_replay.document.text import as_markdown, for_terminal


def compared(
    folder: Path, old: dict[str, Any], new: dict[str, Any], **selection: Any
) -> Comparison:
    """Compare two reports by way of the disk."""
    return compare_results(write(folder / "old", old), write(folder / "new", new), **selection)


def told(comparison: Comparison, **options: Any) -> str:
    """What the screen says."""
    return as_markdown(comparison_document(comparison, **options))


def words(comparison: Comparison, **where: str) -> dict[tuple[str, str, str], str]:
    """Word of each cell that is not the same, by table, row and column."""
    return {
        (change.table, change.row, change.column): change.verdict
        for change in comparison.changes
        if change.verdict != "same"
        and all(getattr(change, key) == value for key, value in where.items())
    }


def two_sets(folder: Path) -> tuple[Path, Path]:
    """Three dives before and after; a fourth is gone."""
    old, new = folder / "old", folder / "new"
    for name, rmse in (("one", 0.2), ("two", 0.5), ("three", 0.44)):
        write(old / name, content(name))
        write(new / name, content(name, rmse=rmse, window=5))
    write(old / "four", content("four"))
    return old, new


# --- Cells and rows.


def test_nothing_differs_between_a_result_and_itself(tmp_path: Path) -> None:
    comparison = compared(tmp_path, content(), content())
    assert words(comparison) == {}
    assert comparison.differences == comparison.notes == ()
    assert (comparison.worst, comparison.best) == (None, None)


def test_every_column_that_can_be_better_is_compared(tmp_path: Path) -> None:
    report = content()
    rows = {**report["tables"], "filters": list(report["filters"].values())}
    expected = {
        (layout.name, column)
        for layout in LAYOUTS
        for column in (*layout.better, *layout.words)
        if column in rows.get(layout.name, [{}])[0]
    }
    assert {table for table, _ in expected} == rows.keys()
    listed = {
        (change.table, change.column) for change in compared(tmp_path, report, report).changes
    }
    assert listed == expected


def test_each_column_is_evaluated_in_its_own_direction(tmp_path: Path) -> None:
    new = content(
        ba_x_sd=0.5, reached_s=50.0, final=0.1, mean_nis=1.0, verdict="conservative", rejected=4
    )
    assert words(compared(tmp_path, content(), new)) == {
        ("improvement", "ba_x", "sd"): "better",
        ("convergence", "ba_x", "reached_s"): "worse",
        ("convergence", "bg_z", "reached_s"): "worse",
        ("reference_error", "roll", "final"): "better",
        ("consistency", "velocity", "mean_nis"): "worse",
        ("consistency", "velocity", "rejected"): "worse",
        ("consistency", "velocity", "verdict"): "worse",
        ("filters", "aided", "consistency"): "worse",
    }


def test_units_are_those_of_the_column(tmp_path: Path) -> None:
    units = {
        (change.table, change.column): change.unit
        for change in compared(tmp_path, content(), content()).changes
        if change.row in {"ba_x", "roll", "velocity"}
    }
    assert units["improvement", "sd"] == units["convergence", "target_sd"] == "mg"
    assert units["convergence", "reached_s"] == "s"
    assert units["convergence", "improvement_pct"] == "%"
    assert units["reference_error", "rmse"] == "deg"
    assert units["consistency", "mean_nis"] == units["consistency", "verdict"] == ""


def test_counts_limits_and_words_without_rank_only_change(tmp_path: Path) -> None:
    new = content()
    new["tables"]["reference_error"][0] |= {"samples": 290, "status": "not in reference"}
    assert words(compared(tmp_path, content(), new)) == {
        ("reference_error", "roll", "samples"): "changed",
        ("reference_error", "roll", "status"): "changed",
    }


@pytest.mark.parametrize("share", [1e-10, -1e-10])
@pytest.mark.parametrize("tolerance_pct", [None, 0.0])
def test_digits_that_differ_between_processors_are_no_change(
    tolerance_pct: float | None, share: float, tmp_path: Path
) -> None:
    comparison = compared(
        tmp_path, content(), nudged(content(), share), tolerance_pct=tolerance_pct
    )
    assert words(comparison) == {}
    assert find_violation(comparison, 0.0) is None


@pytest.mark.parametrize("share", [1e-8, -1e-8])
def test_eight_digits_are_a_change_where_no_tolerance_covers_them(
    share: float, tmp_path: Path
) -> None:
    comparison = compared(tmp_path, content(), nudged(content(), share), tolerance_pct=0.0)
    assert {"better", "worse", "changed"} <= set(words(comparison).values())
    assert find_violation(comparison, 0.0)


def test_a_limit_may_be_reached_but_for_digits_that_differ_between_processors(
    tmp_path: Path,
) -> None:
    comparison = compared(
        tmp_path, content(), content(ba_x_sd=1.05 * (1.0 + 1e-10)), columns=("sd",)
    )
    assert find_violation(comparison, 5.0) is None
    assert find_violation(comparison, 4.99999)


def test_a_row_on_one_side_is_new_or_gone(tmp_path: Path) -> None:
    less = content()
    del less["tables"]["improvement"][1]
    columns = ("baseline_sd", "sd", "improvement_pct", "status")
    for name, old, new, word in (
        ("lost", content(), less, "gone"),
        ("found", less, content(), "new"),
    ):
        found = words(compared(tmp_path / name, old, new))
        assert found == {("improvement", "bg_z", column): word for column in columns}


def test_a_row_in_another_unit_is_another_row(tmp_path: Path) -> None:
    new = content()
    new["tables"]["reference_error"][0] |= {"unit": "mrad", "rmse": 7.0}
    found = {
        (c.unit, c.verdict)
        for c in compared(tmp_path, content(), new).changes
        if c.column == "rmse"
    }
    assert found == {("deg", "gone"), ("mrad", "new")}


def test_a_lost_number_is_worse_and_a_found_one_better(tmp_path: Path) -> None:
    lost = content(rmse=None)
    assert words(compared(tmp_path / "a", content(), lost)) == {
        ("reference_error", "roll", "rmse"): "worse"
    }
    assert words(compared(tmp_path / "b", lost, content())) == {
        ("reference_error", "roll", "rmse"): "better"
    }
    assert words(compared(tmp_path / "c", lost, lost)) == {}


def test_tables_and_columns_that_only_a_newer_version_has_are_new_and_counted(
    tmp_path: Path,
) -> None:
    old, new = content(), content()
    del old["tables"]["consistency"]
    del old["tables"]["reference_error"][0]["final"]
    new["tables"]["weather"] = [{"log": "dive", "filter": "aided", "wind": 3.0}]
    comparison = compared(tmp_path, old, new)
    assert words(comparison, table="reference_error") == {
        ("reference_error", "roll", "final"): "new"
    }
    assert set(words(comparison, table="consistency").values()) == {"new"}
    assert [(note.code, note.count) for note in comparison.notes] == [
        ("table_on_one_side", 1),
        ("table_unknown", 1),
    ]
    assert find_violation(comparison, 0.0) is None


def test_a_table_that_is_lost_counts_as_worse(tmp_path: Path) -> None:
    new = content()
    new["tables"]["reference_error"] = []
    found = find_violation(compared(tmp_path, content(), new), 50.0)
    assert re.search(r"reference_error aided roll: rmse .*gone", found)


def test_a_row_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    new = content()
    new["tables"]["improvement"] *= 2
    with pytest.raises(
        ResultError, match=r"new/report.json: table improvement, row 3: .*aided, ba_x"
    ):
        compared(tmp_path, content(), new)


# --- Filters.


def test_filters_of_different_names_are_compared_when_named(tmp_path: Path) -> None:
    old, new = content(), content(filter="windowed", rmse=0.3)
    with pytest.raises(ConfigError, match=r"\(aided\) .* \(windowed\)") as info:
        compared(tmp_path, old, new)
    assert "--pair aided=windowed" in info.value.hint
    comparison = compared(tmp_path, old, new, filter_pairs={"aided": "windowed"})
    assert words(comparison) == {("reference_error", "roll", "rmse"): "better"}
    assert {change.filter for change in comparison.changes} == {"windowed"}


@pytest.mark.parametrize(
    ("pairs", "hint"),
    [
        ({"aided": "windwed"}, "windowed"),
        ({"aided": "windowed", "windowed": "aidd"}, None),
        ({"aidd": "windowed"}, "aided"),
    ],
)
def test_a_misspelt_name_in_a_pair_is_named_with_the_one_that_was_meant(
    pairs: dict[str, str], hint: str | None, tmp_path: Path
) -> None:
    old, new = content(), content(filter="windowed")
    if hint is None:  # a filter that gives its name away may get one that is new
        old["filters"] |= content(filter="windowed")["filters"]
        compared(tmp_path, old, new, filter_pairs=pairs)
        return
    with pytest.raises(ConfigError) as info:
        compared(tmp_path, old, new, filter_pairs=pairs)
    assert info.value.hint == f"did you mean {hint}?"


def test_quiet_says_that_logs_of_one_name_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for side, sha256 in (("old", "aa"), ("same", "aa"), ("new", "bb")):
        write(tmp_path / side / "dive", content(sha256=sha256))
    for side, is_said in (("same", False), ("new", True)):
        words = ["compare", str(tmp_path / "old"), str(tmp_path / side), "-q"]
        assert run_command_line(words) == 0
        printed = capsys.readouterr()
        assert ("(SHA-256)" in printed.err) == is_said
        assert "(SHA-256)" not in printed.out


def test_a_filter_on_one_side_is_noted_and_its_rows_are_new(tmp_path: Path) -> None:
    new = content()
    other = content(filter="tuned")
    new["filters"] |= other["filters"]
    for table, rows in other["tables"].items():
        new["tables"][table] += rows
    comparison = compared(tmp_path, content(), new)
    assert [(note.code, note.count) for note in comparison.notes] == [("filter_on_one_side", 1)]
    assert "--pair" not in comparison.notes[0].hint, "there is no filter to pair it with"
    assert {(change.filter, change.verdict) for change in comparison.changes} == {
        ("aided", "same"),
        ("tuned", "new"),
    }


# --- What differs beside the tables.


def test_causes_are_named_key_by_key_with_both_values(tmp_path: Path) -> None:
    new = content(window=5, sha256="other")
    new["versions"]["numpy"] = "2.5.0"
    new["tool"] |= {
        "version": "0.2.0",
        "started_at": "2026-02-02T00:00:00+00:00",
        "elapsed_s": 9.0,
    }
    new["log"] |= {"duration_s": 2.0}
    new["log"]["channels"][0]["messages"] = 90
    new["config"]["dvl"]["lever_arm_m"] = [0.0, 0.1, 0.0]
    new["notes"] = [
        {
            "code": "imu_gaps",
            "text": "the IMU pauses",
            "count": 3,
            "severity": "warning",
            "hint": "",
        }
    ]
    found = {
        (d.block, d.key): (d.old, d.new) for d in compared(tmp_path, content(), new).differences
    }
    assert found == {
        ("tool", "version"): ("0.1.0", "0.2.0"),
        ("versions", "numpy"): ("2.4.0", "2.5.0"),
        ("config", "dvl.lever_arm_m"): (None, "[0.0, 0.1, 0.0]"),
        ("config", "filters.aided.window"): ("3", "5"),
        ("log", "sha256"): ("hash of dive", "other"),
        ("log", "duration_s"): ("1.0", "2.0"),
        ("log", "channels /imu"): (
            "100 sensor_msgs/msg/Imu (imu)",
            "90 sensor_msgs/msg/Imu (imu)",
        ),
        ("notes", "imu_gaps"): (None, "3 (warning)"),
    }


def test_a_change_of_any_of_several_notes_of_one_code_is_reported(tmp_path: Path) -> None:
    old, new = content(), content()
    for side, first in ((old, 3), (new, 4)):
        side["notes"] = [
            {"code": "log_damaged", "text": "x", "count": first, "severity": "warning"},
            {"code": "log_damaged", "text": "y", "count": 1, "severity": "warning"},
        ]
    (found,) = compared(tmp_path, old, new).differences
    assert (found.key, found.old, found.new) == (
        "log_damaged",
        "3 (warning), 1 (warning)",
        "4 (warning), 1 (warning)",
    )


def test_another_log_is_reported_before_all_settings(tmp_path: Path) -> None:
    new = content(sha256="other")
    new["config"] |= {f"key{number}": number for number in range(20)}
    shown = told(compared(tmp_path, content(), new))
    assert re.search(r"\(SHA-256\).*\| key1 \| - \| 1 \|", shown, re.DOTALL)
    assert re.search(r"^11 .*--all$", shown, re.MULTILINE)
    assert "(SHA-256)" not in told(compared(tmp_path / "same", content(), content(window=5)))
    assert "(SHA-256)" not in told(compared(tmp_path / "memory", content(sha256=""), new))


def test_what_differs_in_many_dives_is_named_once(tmp_path: Path) -> None:
    old, new = two_sets(tmp_path)
    (difference,) = compare_results(old, new).differences
    assert (difference.key, sorted(difference.logs)) == (
        "filters.aided.window",
        ["one", "three", "two"],
    )


# --- Many dives.


def change(log: str, change_pct: float | None, word: Any) -> Change:
    return Change(
        log, "reference_error", "aided", "roll", "deg", "rmse", 1.0, None, None, change_pct, word
    )


def test_aggregates_are_those_computed_by_hand(tmp_path: Path) -> None:
    old, new = two_sets(tmp_path)
    (rmse,) = (a for a in compare_results(old, new).aggregates if a.column == "rmse")
    # 0.4 became 0.2, 0.5 and 0.44: -50 %, +25 % and +10 %.
    assert (rmse.dives, rmse.better, rmse.worse, rmse.same) == (3, 1, 2, 0)
    assert rmse.share_better_pct == pytest.approx(100.0 / 3.0, abs=1e-12)
    assert rmse.median_change_pct == pytest.approx(10.0, abs=1e-9)
    assert (rmse.worst_log, rmse.worst_word) == ("two", "worse")
    assert rmse.worst_change_pct == pytest.approx(25.0, abs=1e-9)


def test_aggregates_are_those_of_pandas() -> None:
    percents = [3.0, -7.5, 0.0, 12.25, -1.0, 4.5]
    sides = ["worse" if value > 0 else "better" if value < 0 else "same" for value in percents]
    cells = [
        change(f"dive {i}", value, word)
        for i, (value, word) in enumerate(zip(percents, sides, strict=True))
    ]
    (found,) = aggregates(cells)
    series = pd.Series(percents, index=[cell.log for cell in cells])
    assert found.median_change_pct == pytest.approx(float(series.median()), abs=1e-12)
    assert (found.worst_log, found.worst_change_pct) == (series.idxmax(), series.max())
    assert found.share_better_pct == pytest.approx(100.0 * float((series < 0).mean()), abs=1e-12)


def test_a_lost_number_is_the_worst_and_has_no_part_in_the_median() -> None:
    cells = [
        change("far", 900.0, "worse"),
        change("lost", None, "worse"),
        change("near", 2.0, "worse"),
    ]
    (found,) = aggregates(cells)
    assert (found.worst_log, found.worst_change_pct, found.median_change_pct) == (
        "lost",
        None,
        451.0,
    )


def test_rows_on_one_side_have_no_part_in_aggregates() -> None:
    assert (
        aggregates(
            [
                change("one", None, "new"),
                change("two", None, "gone"),
                change("three", None, "changed"),
            ]
        )
        == ()
    )


def test_only_changed_leaves_the_counts_alone(tmp_path: Path) -> None:
    old, new = two_sets(tmp_path)
    whole = compare_results(old, new)
    less = only_changed(whole)
    assert less.counts == whole.counts
    assert {change.verdict for change in less.changes} == {"better", "worse"}
    assert [aggregate.column for aggregate in less.aggregates] == ["rmse"]
    assert less.dives == whole.dives


def test_a_page_has_the_answers_first_and_every_cell(tmp_path: Path) -> None:
    comparison = only_changed(compare_results(*two_sets(tmp_path)))
    parts = comparison_document(comparison, values=True)
    document = Document(page(parts).decode())
    assert [text for text in document.texts["p"] if text.isupper()] == ["NO EFFECT"] * 2
    assert (
        "1 better, 2 worse; 90 of 93 values are the same up to the last printed digit"
        in document.texts["p"]
    )
    tables = [part for part in parts if isinstance(part, DisplayTable)]
    assert document.texts["h3"][-len(tables) :] == [table.title for table in tables]
    assert {cell for table in tables for row in table.rows for cell in row} <= set(
        document.texts["td"]
    )


def test_dives_in_which_nothing_moved_are_not_named(tmp_path: Path) -> None:
    old, new = two_sets(tmp_path)
    write(new / "four", content("four"))
    text = told(only_changed(compare_results(old, new)), values=True)
    question = "## filters.aided.window 3 -> 5 (in 3 of 4): did it help?"
    assert text.startswith(f"{question}\n\n4 dives, new: ")
    assert "four" not in text


# --- The door.


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with results that can and cannot be compared."""
    write(tmp_path / "old" / "dive", content())
    write(tmp_path / "worse" / "dive", content(rmse=0.44))
    write(tmp_path / "better" / "dive", content(rmse=0.2))
    write(tmp_path / "lost" / "dive", content(rmse=None))
    write(tmp_path / "overconfident" / "dive", content(verdict="overconfident"))
    write(tmp_path / "more" / "dive", content())
    write(tmp_path / "more" / "second", content("second"))
    write(tmp_path / "other" / "one", content("one"))
    write(tmp_path / "other" / "two", content("two"))
    write(tmp_path / "stranger" / "dive", content(filter="tuned"))
    write(tmp_path / "study", {"kind": "window", "tool": {"version": "0.1.0"}})
    write(
        tmp_path / "future", {"tool": {"version": "9.0"}, "log": {"title": "dive"}, "tables": {}}
    )
    write(tmp_path / "list", [])  # type: ignore[arg-type]
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "report.json").write_text('{"tool": ')
    (tmp_path / "bytes").mkdir()
    (tmp_path / "bytes" / "report.json").write_bytes(b'{"tool": {"name": "\xff"}}')
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "code", "values"),
    [
        (["old", "old", "--fail-on", "0%"], 0, ""),
        (["old", "worse"], 0, ""),
        (
            ["old", "worse", "--fail-on", "0%"],
            1,
            r"1 .*dive, reference_error aided roll: rmse \[deg\] ",
        ),
        (["old", "worse", "--fail-on", "5%"], 1, r"0\.4000 .*0\.4400 \(\+10\.0 %\)"),
        (["old", "worse", "--fail-on", "10%"], 0, ""),
        (["old", "worse", "--fail-on", "0%", "--tolerance", "10%"], 0, ""),
        (["old", "worse", "--fail-on", "0%", "--table", "improvement"], 0, ""),
        (["old", "worse", "--fail-on", "0%", "--column", "sd"], 0, ""),
        (["old", "worse", "--fail-on", "0%", "--only-changed"], 1, "1 .*worse"),
        (["old", "better", "--fail-on", "0%"], 0, ""),
        (["old", "lost", "--fail-on", "1000%"], 1, r"0\.4000 .*- \(worse\)"),
        (["old", "overconfident", "--fail-on", "50%"], 1, r"consistent .*overconfident \(worse\)"),
        (["more", "old", "--fail-on", "0%"], 1, "1 dive .*: second"),
        (["old", "more", "--fail-on", "0%"], 0, ""),
        (["old", "worse", "--fail-on", "better"], 2, "--fail-on better: "),
        (["old", "worse", "--fail-on", "5"], 2, "--fail-on 5: "),
        (["old", "worse", "--tolerance", "1e-3"], 2, "--tolerance 1e-3: "),
        (["old", "worse", "--table", "improvment"], 2, "'improvment' .*hint: .*improvement"),
        (["old", "worse", "--column", "rms"], 2, "'rms' .*hint: .*rmse"),
        (["old", "worse", "--dive", "dibe"], 2, "'dibe' .*hint: .*dive"),
        (["old", "stranger"], 2, r"\(aided\) .*\(tuned\)"),
        (["old", "stranger", "--pair", "aided"], 2, "--pair aided: "),
        (["old", "stranger", "--pair", "aded=tuned"], 2, "'aded' .*hint: .*aided"),
        (["more", "other"], 2, "dive, second.*one, two"),
        (["old", "absent"], 2, "absent: "),
        (["old", "a" * 5000], 2, "a: "),
        (["old", "empty"], 2, "empty: "),
        (["old", "study"], 2, "study: "),
        (["old"], 2, "'NEW"),
        (["old", "broken"], 3, "broken/report.json: "),
        (["old", "bytes"], 3, "bytes/report.json: "),
        (["old", "list"], 3, "list/report.json: "),
        (["old", "future"], 3, r"\b9\.0\): .*`name`.*`\$\.log`"),
    ],
)
def test_exit_codes_and_reasons(
    arguments: Sequence[str],
    code: int,
    values: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    assert run_command_line(["compare", *arguments]) == code
    captured = capsys.readouterr()
    assert bool(captured.out) is (code in {0, 1})
    last = captured.err.rstrip("\n").split("\n")[-1]
    assert last.startswith("error: ") is (code > 0)
    assert re.search(values, last)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["old", "worse", "--fail-on", "50%"], 0),
        (["old", "worse", "--fail-on", "5%"], 1),
        (["old", "empty"], 2),
        (["old", "broken"], 3),
    ],
)
def test_exit_codes_reach_the_shell(arguments: Sequence[str], code: int, place: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "from insdvl_replay.cli import main; main()",
        "compare",
        *arguments,
    ]
    done = subprocess.run(
        command, cwd=place, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("error: ") is (code > 0)


def test_comparing_loads_neither_the_filters_nor_pandas(place: Path) -> None:
    script = """
import sys
from insdvl_replay.cli import run_command_line
run_command_line(["compare", "old", "worse"])
sys.exit(",".join({"pandas", "numba", "scipy.optimize", "scipy.stats", "mcap", "matplotlib"} & set(sys.modules)) or 0)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=place, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_json_is_read_back_as_the_comparison(tmp_path: Path) -> None:
    comparison = compare_results(*two_sets(tmp_path))
    assert msgspec.json.decode(as_json(comparison), type=Comparison) == comparison
    document = json.loads(as_json(comparison))
    # Of each dive 6 cells of the candidate, 2 x 3 of improvement, 2 x 4 of convergence, 5 of errors, 3 of
    # consistency, 3 of evidence.
    assert document["counts"] == {
        "better": 1,
        "worse": 2,
        "same": 90,
        "changed": 0,
        "new": 0,
        "gone": 0,
    }


def test_csv_has_six_parts_and_numbers_in_full(tmp_path: Path) -> None:
    old, new = two_sets(tmp_path)
    comparison = compare_results(old, new)
    parts = {}
    for block in render(comparison_result(comparison, []), "csv").split("\n\n"):
        rows = list(csv.DictReader(io.StringIO(block)))
        if rows:
            parts[rows[0]["part"]] = rows
        else:
            assert block.startswith("part,log,filter,bin,"), "these results have no windows"
    assert list(parts) == ["answer", "difference", "dive", "aggregate", "change"]
    assert [row["matched_by"] for row in parts["dive"]] == ["hash", "hash", "hash", "nothing"]
    assert len(parts["change"]) == len(comparison.changes)
    (row,) = (row for row in parts["change"] if (row["log"], row["column"]) == ("three", "rmse"))
    assert (float(row["old"]), float(row["new"]), row["verdict"]) == (0.4, 0.44, "worse")
    assert float(row["change_pct"]) == pytest.approx(10.0, abs=1e-9)


@pytest.mark.parametrize("dives", [1, 3])
def test_terminal_tables_fit_80_columns_and_are_whole_when_piped(
    dives: int, tmp_path: Path
) -> None:
    old, new = two_sets(tmp_path)
    comparison = (
        compare_results(old / "two", new / "two") if dives == 1 else compare_results(old, new)
    )
    for width in (80, 1000):
        console = Console(width=width, record=True, file=io.StringIO())
        console.print(for_terminal(comparison_document(comparison, values=True)))
        text = console.export_text()
        assert max(len(line.rstrip()) for line in text.split("\n")) <= width
        assert "…" not in text
    assert re.search(r"filters\.aided\.window 3 -> 5", text)
    assert re.search(r"aided roll: rmse \[deg\]", text)


@pytest.mark.parametrize(
    ("format_", "expected"),
    [
        ("md", "| reference_error aided roll: rmse [deg] | 0.4000 | 0.4400 | +10.0 % | worse |"),
        ("latex", "aided roll: rmse [deg] & 0.4000 & 0.4400 &"),
    ],
)
def test_pages_for_documents_hold_the_rows(
    format_: str, expected: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        run_command_line(
            ["compare", str(place / "old"), str(place / "worse"), "--format", format_]
        )
        == 0
    )
    assert expected in capsys.readouterr().out


def test_real_results_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "dive.mcap"
    assert run_command_line(["simulate", "straight", "-o", str(log), "--duration", "60"]) == 0
    noise = ["--preset", "fog", "--set", "dvl.beam_sd_mps=0.006"]
    wider = ["--set", "filters.aided.acceleration.window=5"]
    for folder, settings in (("old", noise), ("again", noise), ("new", noise + wider)):
        assert run_command_line(["run", str(log), "-o", str(tmp_path / folder), *settings]) == 0
    capsys.readouterr()
    old, again, new = (str(tmp_path / folder) for folder in ("old", "again", "new"))
    assert run_command_line(["compare", old, again, "--fail-on", "0%"]) == 0
    assert capsys.readouterr().out.startswith("same settings: ")
    assert run_command_line(["compare", old, new, "--fail-on", "0%"]) == 1
    assert re.search(r"^filters\.aided\.acceleration\.window 3 -> 5: ", capsys.readouterr().out)


def test_what_is_new_is_no_gain(tmp_path: Path) -> None:
    old = content()
    del old["tables"]["reference_error"]
    found = compared(tmp_path, old, content())
    assert found.counts["new"] > 0
    assert (found.worst, found.best) == (None, None)


# --- Verdicts that changed.


def test_changed_verdicts_are_said_after_the_answers(tmp_path: Path) -> None:
    old, new = (
        content(filter_verdict="undecided", prediction="undecided"),
        content(filter_verdict="better", prediction="confirmed"),
    )
    lines = told(compared(tmp_path, old, new)).split("\n\n")
    assert lines[4:6] == [
        "aided against the baseline is now better, was undecided",
        "the predicted improvement of aided is now confirmed, was undecided",
    ]
    assert "is now" not in told(compared(tmp_path / "same", content(), content(rmse=0.5)))


def test_changed_verdicts_of_several_dives_are_said_once_with_their_dives(tmp_path: Path) -> None:
    for name, word in (("one", "worse"), ("two", "worse"), ("three", "better")):
        write(tmp_path / "old" / name, content(name))
        write(tmp_path / "new" / name, content(name, filter_verdict=word, prediction="undecided"))
    write(tmp_path / "old" / "four", content("four", prediction="undecided"))
    write(tmp_path / "new" / "four", content("four", prediction="undecided"))
    lines = [
        line
        for line in told(compare_results(tmp_path / "old", tmp_path / "new")).split("\n\n")
        if "now" in line
    ]
    assert lines == [
        "aided against the baseline is now worse, was better (2 of 4 dives: one, two)",
        "the predicted improvement of aided is now undecided, was confirmed (3 of 4 dives: one, three and 1 more)",
    ]


def test_a_verdict_that_an_early_report_lacks_has_not_changed(tmp_path: Path) -> None:
    early = content()
    del early["filters"]["aided"]["prediction"]
    assert "is now" not in told(compared(tmp_path, early, content()))


# --- In brief.


def in_brief(folder: Path) -> str:
    old, new = two_sets(folder)
    comparison = only_changed(compare_results(old, new))
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(for_terminal(comparison_document(comparison)))
    return console.export_text()


def test_in_brief_settings_come_first_then_answers_and_then_verdicts_that_changed(
    tmp_path: Path,
) -> None:
    old, new = content(), content(window=5)
    old["filters"]["aided"]["verdict"], new["filters"]["aided"]["verdict"] = "undecided", "worse"
    comparison = only_changed(compared(tmp_path, old, new))
    lines = told(comparison).split("\n\n")
    assert lines[0] == "## filters.aided.window 3 -> 5: did it help?"
    assert lines[1].startswith("dive, new: ")
    assert [line.split()[0] for line in lines[2:4]] == ["baseline", "aided"]
    assert re.fullmatch(r"aided .*worse.* undecided", lines[4])


def test_the_settings_of_a_filter_on_one_side_are_its_name(tmp_path: Path) -> None:
    new = content(window=5)
    new["config"]["filters"]["tuned"] = {
        "aiding": ["velocity"],
        "gate_probability": 0.9,
        "window": 3,
    }
    comparison = only_changed(compared(tmp_path, content(), new))
    question = "## filters.aided.window 3 -> 5 and 1 more setting: did they help?"
    assert told(comparison).startswith(question)
    assert "filter tuned only in the new results" in told(comparison)
    assert "gate_probability" not in told(comparison)


def test_in_brief_the_same_is_left_out_and_the_rest_counted(tmp_path: Path) -> None:
    text = in_brief(tmp_path)
    assert "gone: four" in text
    assert "1 better, 2 worse; " not in text, "counts of values tell nothing of the change"
    old, new = tmp_path / "old", tmp_path / "new"
    assert "1 better, 2 worse; " in told(compare_results(old, new), values=True)
    assert len(text.strip().split("\n")) <= 40


def evidence_row(value: float) -> dict[str, Any]:
    [row] = content()["tables"]["evidence"]
    return row | {
        "evidence": "accuracy",
        "quantity": "drift_30s",
        "value": value,
        "ratio": value,
        "role": "shown",
    }


def test_in_brief_evidence_that_moved_has_old_and_new(tmp_path: Path) -> None:
    old, new = content(), content()
    old["tables"]["evidence"], new["tables"]["evidence"] = [evidence_row(0.8)], [evidence_row(0.6)]
    comparison = only_changed(compared(tmp_path, old, new))
    assert "| aided | drift in 30 s | m | 0.8000 | 0.6000 | -25.0 % |" in told(comparison)


def test_in_brief_two_runs_of_eight_dives_fit_40_lines(tmp_path: Path) -> None:
    """One setting of one filter changed: position is better, and every quantity that can warn is worse."""
    names = [
        quantity for layout in LAYOUTS if layout.name == "evidence" for quantity in layout.rows
    ]
    warning = [quantity for kind in SECONDARIES.values() for quantity in kind]
    roles = dict.fromkeys(warning, "secondary") | dict.fromkeys(PRIMARIES, "primary")
    for number in range(8):
        for side, factor, window in (("old", 1.0, 3), ("new", 0.8, 5)):
            made = content(f"dive_{number}", window=window)
            made["tables"]["evidence"] = [
                evidence_row(factor if name == "position" else 1.0 / factor)
                | {"log": f"dive_{number}", "quantity": name, "role": roles.get(name, "shown")}
                for name in names
            ]
            write(tmp_path / side / f"dive_{number}", made)
    comparison = only_changed(compare_results(tmp_path / "old", tmp_path / "new"))
    assert comparison.answers[1].verdict == "mixed"
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(for_terminal(comparison_document(comparison)))
    lines = console.export_text().strip().split("\n")
    assert len(names) > 20
    assert len(lines) <= 40
    rows = (
        1 + len(SECONDARIES) + 1
    )  # the one that decides, one of each kind that can warn, and the prediction
    assert sum(line.startswith("aided ") for line in lines) == 1 + rows


def test_in_brief_the_distance_of_a_nis_from_1_is_shown(tmp_path: Path) -> None:
    """A smaller NIS of a conservative filter is the worse one."""
    old, new = content(), content()
    row = evidence_row(0.002) | {
        "evidence": "consistency",
        "quantity": "nis",
        "unit": "",
        "ratio": 1.0,
    }
    old["tables"]["evidence"], new["tables"]["evidence"] = (
        [row],
        [row | {"value": 0.001, "ratio": 1.1}],
    )
    comparison = only_changed(compared(tmp_path, old, new))
    [line] = [line for line in told(comparison).split("\n") if "NIS distance from 1" in line]
    assert line.endswith("| +10.0 % |")


@pytest.mark.parametrize(
    ("old", "new", "word"), [(0.002, 0.001, "worse"), (0.5, 0.8, "better"), (2.0, 1.5, "better")]
)
def test_means_of_consistency_are_better_the_nearer_they_are_to_one(
    old: float, new: float, word: str, tmp_path: Path
) -> None:
    before, after = content(), content()
    for made, value in ((before, old), (after, new)):
        made["tables"]["evidence"] = [
            evidence_row(value)
            | {"evidence": "consistency", "quantity": "nis", "unit": "", "ratio": 1.0}
        ]
    assert (
        words(compared(tmp_path, before, after), table="evidence")["evidence", "nis", "value"]
        == word
    )


def long_names(tmp_path: Path) -> Comparison:
    """Two results whose values have names that are wider than 80 columns."""
    old, new = content(), content()
    for side, value in ((old, 0.8), (new, 0.6)):
        side["tables"]["evidence"] = [
            evidence_row(value) | {"filter": "aided_by_a_filter_with_a_name_of_many_words"}
        ]
    return compared(tmp_path, old, new)


@pytest.mark.parametrize("is_terminal", [False, True])
def test_all_values_have_a_line_each_in_a_pipe_and_fit_a_terminal(
    tmp_path: Path, is_terminal: bool
) -> None:
    document = comparison_document(long_names(tmp_path), values=True)
    console = Console(
        width=80,
        file=io.StringIO(),
        record=True,
        force_terminal=is_terminal,
        color_system=None,
    )
    console.print(for_terminal(document), crop=False)
    lines = console.export_text().split("\n")
    name = "evidence aided_by_a_filter_with_a_name_of_many_words drift in 30 s: ratio"
    [found] = [line for line in lines if "many_words" in line and ": ratio" in line] or [""]
    assert found.startswith(name) != is_terminal
    if is_terminal:
        assert max(len(line.rstrip()) for line in lines) <= 80


def test_a_page_has_all_evidence_and_names_no_option(tmp_path: Path) -> None:
    names = ["drift_30s", "drift_60s", "position", "depth"]
    for number in range(3):
        for side, factor in (("old", 1.0), ("new", 0.8)):
            made = content(f"dive_{number}")
            made["tables"]["evidence"] = [
                evidence_row(factor) | {"log": f"dive_{number}", "quantity": name}
                for name in names
            ]
            write(tmp_path / side / f"dive_{number}", made)
    comparison = only_changed(compare_results(tmp_path / "old", tmp_path / "new"))
    document = comparison_document(comparison)
    screen = as_markdown(document)
    shown = page(document).decode()
    assert "--all" in screen
    assert not re.search(r"(?<![\w-])(--[a-z]+|-v)\b(?![^<]*[;:{])", shown.partition("<body>")[2])
    assert "new result against old result" in shown
    for name in ("drift in 30 s", "drift in 60 s", "position", "depth"):
        assert f"<td class=l>{name}</td>" in shown
