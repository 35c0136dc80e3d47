"""Where a candidate helped: on the screen, on pages, in files, from Python and in a comparison."""

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest
from made_reports import report as made
from made_reports import tables, unreferenced
from msgspec.structs import replace
from small_results import content, write

from insdvl_replay import api
from insdvl_replay.batch.overviews import write_overviews
from insdvl_replay.changes.comparison import compare_results
from insdvl_replay.changes.comparison_document import comparison_document, comparison_result
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.report import Report, as_json
from insdvl_replay.core.tables import WhereRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.document.page import page
from insdvl_replay.document.render import render, result_json
from insdvl_replay.evaluation.where import pooled_where
from insdvl_replay.show.dive import dive_document, replay_result, tables_named
from insdvl_replay.show.dives import index_page, named_result, overview_parts
from insdvl_replay.show.screens import dive_screen, dives_screen

SPREAD = (-0.1, 0.04, 0.1, -0.04, 0.02)
SAID = "worse in turns: 1.51 (1.34 .. 1.70); look at lever arm and delay"
TITLE = "Where: drift in 30 s by what the vehicle does"


def where_rows(log: str, spread: float) -> list[WhereRow]:
    """Straight legs as before, and turns in which the candidate drifts 1.5 times as far."""
    rows = []
    for name, ratio in (("baseline", None), ("aided", math.exp(spread))):
        for bin_, factor in (("straight", 1.0), ("turns", 1.5)):
            other = 2.5 - factor
            own = 1.0 if ratio is None else ratio * factor
            rest = 1.0 if ratio is None else ratio * other
            row = WhereRow(
                log=log, filter=name, bin=bin_, unit="m", baseline=1.0, value=own, rest_value=rest,
                ratio=ratio and own, to_rest=ratio and own / rest, windows=20,
            )  # fmt: skip
            rows.append(row)
    return rows


def dive(name: str, spread: float, verdict: str = Verdict.UNDECIDED) -> Report:
    used = replace(tables(), where=where_rows(name, spread))
    found = made(name, used)
    aided = replace(found.filters["aided"], verdict=verdict)
    return replace(found, filters={"aided": aided})


def archive(verdict: str = Verdict.UNDECIDED) -> list[Report]:
    return [dive(f"d{number}", spread, verdict) for number, spread in enumerate(SPREAD)]


def text_of(parts: Any) -> str:
    from rich.console import Console

    from insdvl_replay.document.text import for_terminal

    console = Console(width=160, record=True, file=io.StringIO())
    console.print(for_terminal(parts))
    return console.export_text()


def test_the_screen_of_many_dives_has_one_sentence_if_something_stands_out() -> None:
    lines = text_of(dives_screen(archive(), "index.html")).split("\n")
    assert [line.strip() for line in lines].count(SAID) == 1
    assert "in turns" not in text_of(dives_screen(archive()[:2], "index.html"))
    assert "in turns" not in text_of(dives_screen(archive(Verdict.NOT_EVALUATED), "index.html"))


def test_the_page_of_many_dives_has_a_panel_and_the_sentence() -> None:
    shown = index_page(archive()).decode()
    assert shown.count(f"<h3>{TITLE}") == 1
    assert SAID[1:] in shown
    panel = shown.partition(f"<h3>{TITLE}")[2].partition("</section>")[0]
    assert panel.count("<circle") == 2
    assert "row worse decides" in panel
    assert f"<h3>{TITLE}" not in index_page([made("a"), made("b")]).decode()


def test_the_page_of_one_dive_has_a_panel_without_intervals() -> None:
    found = page(dive_document(dive("d0", 0.0))).decode()
    panel = found.partition(f"<h3>{TITLE}")[2].partition("</section>")[0]
    assert panel.count("<circle") == 2
    assert "interval" not in panel
    assert f"<h3>{TITLE}" not in page(dive_document(made())).decode()
    assert "in turns" not in text_of(dive_screen(dive("d0", 0.0), "report.html"))


def test_files_python_and_tables_have_the_same_rows(tmp_path: Path) -> None:
    reports = archive()
    for found in reports:
        (tmp_path / found.log.name).mkdir()
        (tmp_path / found.log.name / "report.json").write_bytes(as_json(found))
    write_overviews(reports, tmp_path)
    stored = list(csv.DictReader((tmp_path / "where.csv").read_text().splitlines()))
    assert [(row["log"], row["bin"], row["stands_out"]) for row in stored] == [
        ("*", "straight", "False"),
        ("*", "turns", "True"),
    ]
    own = [[row for row in found.tables.where if row.filter == "aided"] for found in reports]
    expected = pooled_where(own)
    assert [float(row["to_rest_low"]) for row in stored] == [row.to_rest_low for row in expected]

    read = api.read_results(tmp_path)
    frame = read.tables["where"]
    assert frame["high"].tolist() == [row.high for row in expected]
    assert frame["stands_out"].tolist() == [False, True]
    assert SAID in str(read)
    named = json.loads(result_json(named_result(reports, ["where"], ())))["where"]
    asked = {"bin", "ratio", "low", "high", "p_adjusted", "stands_out", "dives", "windows"}
    assert all(asked <= {*row} for row in named)
    assert [row["dives"] for row in named] == [5, 5]
    assert [row["windows"] for row in named] == [100, 100]
    text = render(named_result(reports, ["where"], ()), "md")
    assert "notable" in text
    assert "1.34 .. 1.70" in text
    assert "notable" in render(replay_result(reports, overview_parts(reports)), "md")


def test_one_dive_has_its_own_rows_under_the_same_name() -> None:
    found = dive("d0", 0.0)
    result = named_result([found], ["where"], tables_named(found, "where"))
    rows = json.loads(result_json(result))["where"]
    assert [(row["log"], row["filter"], row["bin"]) for row in rows] == [
        ("d0", "baseline", "straight"),
        ("d0", "baseline", "turns"),
        ("d0", "aided", "straight"),
        ("d0", "aided", "turns"),
    ]
    text = render(result, "md")
    assert f"{TITLE}, aided against baseline" in text
    assert "There is no table" not in text


@pytest.mark.parametrize("dives", [1, 3])
def test_without_a_reference_there_is_no_table_and_the_reason(dives: int) -> None:
    reports = [made(f"d{number}", unreferenced(tables())) for number in range(dives)]
    text = render(named_result(reports, ["where"], ()), "md")
    assert "There is no table where: it takes a reference, and a candidate on two dives" in text
    assert result_json(named_result(reports, ["where"], ())) == b'{\n  "where": []\n}\n'


def test_with_many_candidates_the_sentence_has_the_name() -> None:
    reports = []
    for found in archive():
        names = ("aided", "second", "third")
        evidence = found.tables.evidence
        where = found.tables.where
        many = replace(
            found.tables,
            evidence=[replace(row, filter=name) for name in names for row in evidence],
            where=[replace(row, filter=name) for name in names for row in where],
        )
        filters = dict.fromkeys(names, found.filters["aided"])
        reports.append(replace(found, tables=many, filters=filters))
    text = text_of(dives_screen(reports, "index.html"))
    lines = [line.strip() for line in text.split("\n")]
    # Three candidates share the error rate of one, so that the interval is wider.
    [second] = [line for line in lines if line.startswith("second: worse in turns: 1.51 (1.")]
    assert second != f"second: {SAID}"


def test_with_many_candidates_the_page_draws_only_what_is_notable() -> None:
    names = ("aided", "second", "third")
    for count, plots in ((2, 2), (3, 1)):
        reports = []
        for found in archive():
            evidence = found.tables.evidence
            where = [row for row in found.tables.where if row.filter == "aided"]
            others = [replace(row, ratio=1.0, to_rest=1.0) for row in where]
            own = {"aided": where} | dict.fromkeys(names[1:count], others)
            many = replace(
                found.tables,
                evidence=[replace(row, filter=name) for name in own for row in evidence],
                where=[replace(row, filter=name) for name, rows in own.items() for row in rows],
            )
            filters = dict.fromkeys(own, found.filters["aided"])
            reports.append(replace(found, tables=many, filters=filters))
        assert index_page(reports).decode().count(f"<h3>{TITLE}") == plots
        one = page(dive_document(reports[0])).decode()
        assert one.count(f"<h3>{TITLE}") == (2 if count == 2 else 0)


# --- A comparison.


def two_sides(folder: Path, windows: int = 20) -> tuple[Path, Path]:
    """Five dives; on the new side the candidate drifts 1.5 times as far in turns."""
    for number, spread in enumerate(SPREAD):
        name = f"d{number}"
        rows = where_rows(name, spread)
        before = content(name)
        before["tables"]["where"] = [
            msgspec.to_builtins(replace(row, value=1.0, rest_value=1.0)) for row in rows
        ]
        after = content(name, window=5)
        after["tables"]["where"] = [
            msgspec.to_builtins(replace(row, windows=windows)) for row in rows
        ]
        write(folder / "old" / name, before)
        write(folder / "new" / name, after)
    return folder / "old", folder / "new"


def test_a_comparison_has_the_list_where_new_over_old(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = two_sides(tmp_path)
    comparison = compare_results(old, new)
    found = {(row.filter, row.bin): row for row in comparison.where}
    assert found["aided", "turns"].stands_out
    assert not found["aided", "straight"].stands_out
    assert found["baseline", "turns"].ratio == 1.0
    assert not found["baseline", "turns"].stands_out
    assert f"aided: {SAID}" in text_of(comparison_document(comparison))
    shown = render(comparison_result(comparison, comparison_document(comparison)), "html")
    assert f"<h3>{TITLE}" in shown
    assert SAID[1:] in shown
    assert run_command_line(["compare", str(old), str(new), "--format", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)["where"]
    assert [row["bin"] for row in rows if row["stands_out"]] == ["turns"]
    frame = api.compare(old, new).tables["where"]
    assert frame["ratio"].tolist() == [row["ratio"] for row in rows]


def test_a_comparison_leaves_out_other_windows_and_results_without_any(tmp_path: Path) -> None:
    other = compare_results(*two_sides(tmp_path / "other", windows=21))
    assert other.where == ()
    old, new = two_sides(tmp_path / "early")
    for file in old.glob("*/report.json"):
        early = json.loads(file.read_text())
        del early["tables"]["where"]
        file.write_text(json.dumps(early))
    assert compare_results(old, new).where == ()
    one = compare_results(old / "d0", new / "d0")
    assert one.where == (), "one dive has no interval"
