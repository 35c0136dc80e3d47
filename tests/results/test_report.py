"""The report room: tables to bytes, and results that appear all at once or not at all."""

import csv
import io
import json
import math
import re
import shutil
from pathlib import Path

import msgspec
import pandas as pd
import pytest
from frames import frames
from made_reports import report, tables, unreferenced
from msgspec.structs import replace
from rich.console import Console

from insdvl_replay.batch.schemas import SCHEMAS, json_schema
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import Tool, decode_report
from insdvl_replay.core.report import as_json as encode_report
from insdvl_replay.core.tables import AssayRow, ConvergenceRow, WhereRow
from insdvl_replay.core.words import Reason
from insdvl_replay.document.latex import as_latex
from insdvl_replay.document.page import page
from insdvl_replay.document.parts import Block
from insdvl_replay.document.render import render
from insdvl_replay.document.tables import number, percent, table_csv
from insdvl_replay.document.text import as_markdown, for_terminal
from insdvl_replay.evaluation.answers import pooled_evidence
from insdvl_replay.evaluation.sentences import why_in_spite
from insdvl_replay.results.folder import COMPLETE, result_file, result_folder
from insdvl_replay.show.answers import Failure, verdict_in_table
from insdvl_replay.show.dive import (
    NO_REFERENCE,
    dive_document,
    headline_table,
    replay_result,
    track_fit_line,
)
from insdvl_replay.show.dives import OVERVIEWS
from insdvl_replay.show.result_files import run_log

HEADERS = {
    "improvement": "log,filter,state,unit,baseline_sd,sd,improvement_pct,status",
    "convergence": "log,filter,state,unit,target_sd,baseline_s,reached_s,improvement_pct,status,"
    "measured_target,measured_baseline_s,measured_s,measured_status",
    "reference_error": (
        "log,filter,quantity,unit,baseline_rmse,rmse,improvement_pct,baseline_final,final,samples,status"
    ),
    "consistency": "log,filter,measurement,dof,used,rejected,mean_nis,low,high,verdict,"
    "autocorrelation,autocorrelation_limit,whiteness,why",
    "credibility": (
        "log,filter,quantity,dof,samples,mean_nees,low,high,within_1sd_pct,within_3sd_pct,verdict,effective_samples,why"
    ),
    "evidence": (
        "log,filter,evidence,quantity,unit,baseline,value,ratio,moves,acts,reference_noise,samples,starts,from_s,role"
    ),
    "outage": "log,filter,window_s,windows,left_out,drift_median_m,drift_rms_m,drift_p95_m,drift_of_distance_pct,"
    "end_velocity_mps,vertical_median_m,ratio_to_baseline,windows_won_pct,nis_per_dof",
    "drift": "log,filter,quantity,unit,samples,p50,p95,rms,worst,worst_from_s,worst_to_s,"
    "final,distance_m,final_of_distance_pct",
    "track_fit": "log,filter,quantity,unit,fitted,fitted_sd",
}
"""What other people's scripts rely on."""
CONTROL = AssayRow("dive", "gyro_noise_x3", "position", "m", 1.25, 1.5, 1.2, "primary")
TURNS = WhereRow(
    log="dive",
    filter="aided",
    bin="turns",
    unit="m",
    baseline=0.1,
    value=0.12,
    rest_value=0.09,
    ratio=1.2,
    to_rest=1.3,
    windows=17,
)
WHOLE = replace(tables(), assay=[CONTROL], where=[TURNS])
"""Every table has a row."""
SCHEMA_FOLDER = Path(__file__).resolve().parents[2] / "schemas"


def test_csv_numbers_are_read_back_exactly_and_missing_ones_are_empty() -> None:
    table = tables().convergence
    data = table_csv(Block.of(ConvergenceRow, table))
    rows = list(csv.DictReader(io.StringIO(data.decode(), newline="")))
    assert b"\r" not in data
    assert [float(row["target_sd"]) for row in rows] == [row.target_sd for row in table]
    assert {row["reached_s"] for row in rows} == {"", "106.0"}
    assert rows[0]["status"] == "never"


def test_csv_quotes_a_name_with_a_comma() -> None:
    table = pd.DataFrame({"log": ['a,"b'], "samples": [3]})
    assert next(csv.reader(io.StringIO(table_csv(table).decode().split("\n")[1]))) == ['a,"b', "3"]


def test_mean_counts_a_missing_improvement_as_zero() -> None:
    means = report().filters["aided"]
    assert means.mean_improvement_pct == pytest.approx(3 * 20.0 / 9, abs=1e-12)
    assert means.mean_convergence_improvement_pct == pytest.approx(75.0 / 9, abs=1e-12)


def test_mean_is_missing_when_a_standard_deviation_is_not_finite() -> None:
    rows = [
        replace(row, status="not finite") if row.state == "ba_z" else row
        for row in tables().improvement
    ]
    assert (
        report(used=replace(tables(), improvement=rows)).filters["aided"].mean_improvement_pct
        is None
    )


def test_report_json_holds_the_tables_row_for_row() -> None:
    data = encode_report(report(used=WHOLE))
    document = json.loads(data, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    for name, table in frames(WHOLE).items():
        expected = [
            {
                key: None if isinstance(value, float) and math.isnan(value) else value
                for key, value in row.items()
            }
            for row in table.to_dict("records")
        ]
        assert document["tables"][name] == expected
        assert list(document["tables"][name][0]) == list(table.columns)
    assert document["notes"] == [
        {
            "code": "imu_gaps",
            "text": "the IMU pauses 3 times",
            "count": 3,
            "severity": "warning",
            "hint": "imu.max_gap_s",
        }
    ]
    assert document["log"]["duration_s"] == pytest.approx(424.0, abs=1e-9)
    assert document["config"]["filters"]["aided"]["acceleration"]["sd_mps2"] == 0.103


def test_report_survives_being_saved_and_read() -> None:
    first = encode_report(report())
    assert encode_report(report()) == first
    assert encode_report(decode_report(first)) == first
    tool = {"name": "insdvl-replay", "version": Tool().version, "cpu_s": {}}
    assert json.loads(first)["tool"] == {key: tool.get(key) for key in Tool.__struct_fields__}


def test_report_from_before_there_were_these_columns_is_still_read() -> None:
    document = json.loads(encode_report(report()))
    del document["tables"]["credibility"], document["filters"]["aided"]["credibility"]
    for row in document["tables"]["consistency"]:
        del row["autocorrelation"], row["autocorrelation_limit"], row["whiteness"]
    early = decode_report(json.dumps(document).encode())
    assert early.tables.credibility == []
    assert early.tables.consistency[0].verdict == "consistent"
    assert "Consistency" in as_markdown(dive_document(early))
    assert "Innovations" not in as_markdown(dive_document(early))
    assert NO_REFERENCE not in as_markdown(dive_document(early))
    assert b"velocity consistent; acceleration overconfident," in OVERVIEWS["summary.csv"][0](
        [early]
    )


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_schema_file_is_what_the_code_generates(name: str) -> None:
    assert (SCHEMA_FOLDER / f"{name}.schema.json").read_bytes() == json_schema(name), (
        f"run: insdvl-replay schema {name} > schemas/{name}.schema.json"
    )


def test_terminal_tables_fit_80_columns_and_are_whole_when_piped() -> None:
    for width in (80, 1000):
        console = Console(width=width, record=True, file=io.StringIO())
        console.print(for_terminal(dive_document(report())))
        text = console.export_text()
        assert max(len(line.rstrip()) for line in text.split("\n")) <= width
        assert "…" not in text
    for cell in (
        "accelerometer bias, z",
        "deg/h",
        "75.0 %",
        "overconfident",
        "not in reference",
        "accel. bias, x",
        "correlated",
    ):
        assert cell in text
    assert "6.7 % smaller sigma at the end, reached 8.3 % faster" in text


def test_tables_say_why_a_verdict_is_not_that_of_its_interval() -> None:
    made = tables()
    near, far = (
        msgspec.structs.replace(row, why=why)
        for row, why in zip(made.credibility[:2], (Reason.NEAR, ""), strict=True)
    )
    beyond = msgspec.structs.replace(made.credibility[2], why=Reason.BEYOND_3_SD)
    innovations = [
        msgspec.structs.replace(made.consistency[0], why=Reason.NEAR),
        *made.consistency[1:],
    ]
    told = msgspec.structs.replace(made, credibility=[near, far, beyond], consistency=innovations)
    text = as_markdown(dive_document(report(used=told)))
    of_near = why_in_spite(Reason.NEAR)
    of_beyond = why_in_spite(Reason.BEYOND_3_SD)
    assert f"velocity, north ({of_near}); accelerometer bias, x ({of_beyond})." in text
    assert f"baseline velocity ({of_near})." in text
    assert of_near not in as_markdown(dive_document(report()))


def test_no_gain_is_next_to_a_filter_that_is_not_evaluated() -> None:
    judged = report()
    aided = msgspec.structs.replace(judged.filters["aided"], verdict="not evaluated")
    unjudged = msgspec.structs.replace(judged, filters={"aided": aided})
    texts = [as_markdown(dive_document(made)) for made in (judged, unjudged)]
    assert ["Mean of nine states: 6.7 % smaller" in text for text in texts] == [True, False]


def test_track_fit_is_one_line_with_as_many_digits_as_its_standard_errors_bear() -> None:
    (line,) = track_fit_line(report())
    assert re.search(r"\+0\.18 ± 0\.02 %.* -0\.311 ± 0\.005 deg", line)
    of_aided = replace(
        tables(), track_fit=[replace(row, filter="baseline") for row in tables().track_fit[2:]]
    )
    (line,) = track_fit_line(report(used=of_aided))
    assert re.search(r"\+0\.18 %.* -0\.31 deg", line)
    assert list(track_fit_line(report(used=replace(tables(), track_fit=[])))) == []


def test_screen_has_the_track_fit_and_leaves_its_table_to_the_page() -> None:
    document = dive_document(report())
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(for_terminal(document))
    text = console.export_text()
    assert len(re.findall(r"\+0\.18 ± 0\.02 %.* -0\.311 ± 0\.005 deg\n", text)) == 1
    assert "Drift: how far" not in text
    assert "| 0.2000 | 0.4000 | 0.3000 | 0.5000 | 155 | 215 |" in as_markdown(document)


def test_headline_has_a_line_for_each_filter_with_what_is_known() -> None:
    [table] = headline_table(report())
    assert table.header == (
        "this run",
        "share of distance",
        "CEP50",
        "CEP95",
        "end",
        "outage 30 s: p50",
    )
    assert table.rows[0] == ("baseline", "0.20 % of 1000 m", "1 m", "2 m", "2 m", "0.5 m")
    assert table.rows[1][1] == "0.25 % of 1000 m"
    [alone] = headline_table(report(used=unreferenced(tables())))
    assert alone.header == ("this run", "outage 30 s: p50")
    assert alone.rows == (("baseline", "0.5 m"), ("aided", "0.4 m"))
    assert not list(headline_table(report(used=replace(unreferenced(tables()), outage=[]))))


def test_headline_gives_the_drift_after_60_and_120_s_where_there_are_such_windows() -> None:
    row = tables().outage[0]
    rows = [
        replace(row, window_s=f"{window_s}", windows=windows, drift_median_m=window_s / 7.0)
        for window_s, windows in ((30, 9), (60, 4), (120, 2), (300, 0))
    ]
    [table] = headline_table(report(used=replace(tables(), outage=rows)))
    assert table.header[-2:] == ("outage 60 s: p50", "120 s")
    assert [cells[-2:] for cells in table.rows] == [("8.57 m", "17.1 m"), ("-", "-")]


def test_what_a_dive_without_a_reference_cannot_say_is_said_once_and_nothing_is_left_empty() -> (
    None
):
    alone = report(used=unreferenced(tables()))
    for text in (as_markdown(dive_document(alone)), page(dive_document(alone)).decode()):
        assert text.count(NO_REFERENCE) == 1
        assert "Reference error" not in text
        assert "Credibility" not in text
    whole = as_markdown(dive_document(report()))
    assert "Reference error" in whole
    assert "Credibility" in whole
    assert run_log(alone).count(NO_REFERENCE) == 1
    assert NO_REFERENCE not in as_markdown(dive_document(report()))


def test_a_word_that_neither_decides_nor_warns_is_in_brackets_and_one_dive_has_none() -> None:
    """Three equal dives leave no doubt of any ratio."""
    together, alone = (pooled_evidence("aided", [tables().evidence] * dives) for dives in (3, 1))
    assert {row.quantity: verdict_in_table(row) for row in together} == {
        "position": "worse", "level": "better", "convergence_level": "", "drift_30s": "(better)",
    }  # fmt: skip
    assert {verdict_in_table(row) for row in alone} == {""}


def test_markdown_tables_have_one_cell_per_column() -> None:
    lines = [
        line for line in as_markdown(dive_document(report())).split("\n") if line.startswith("|")
    ]
    # Of the five pieces of evidence one has no numbers.
    assert len(lines) == 2 + 4 + 2 + 3 + 2 + 1 + 12 + 12 + 2 + 3 + 4 + 5 + 12 * 2
    assert not any("level settled" in line for line in lines)
    assert {line.count("|") for line in lines} == {6, 7, 8, 9, 10, 11}
    assert any(line.endswith(", z | mg | 1.000 | 0.8000 | - | improved |") for line in lines)


def test_latex_escapes_what_latex_would_read() -> None:
    text = as_latex(dive_document(report()))
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 12
    assert "20.0 & improved \\\\" in text
    assert r"m/s & 1.000" in text


def test_csv_of_a_report_is_cut_apart_by_its_first_column() -> None:
    text = render(replay_result(report(used=WHOLE), []), "csv")
    for name, table in frames(WHOLE).items():
        block = next(block for block in text.split("\n\n") if f"\n{name}," in block)
        assert block.split("\n")[0] == ",".join(["table", *table.columns])
        assert sum(line.startswith(f"{name},") for line in text.split("\n")) == len(table)


def test_summary_has_a_row_for_each_log_and_a_reason_for_a_failed_one() -> None:
    rows = list(
        csv.DictReader(
            io.StringIO(
                OVERVIEWS["summary.csv"][0](
                    [report("one"), Failure("two", "two.mcap: is empty")]
                ).decode()
            )
        )
    )
    assert [(row["log"], row["filter"], row["status"]) for row in rows] == [
        ("one", "aided", "done"),
        ("two", "", "failed"),
    ]
    assert (rows[0]["position_h_baseline_rmse_m"], rows[0]["position_h_rmse_m"]) == ("1.25", "1.5")
    found = [word.split()[1] for word in rows[0]["consistency_of_each"].split("; ")]
    assert found == ["consistent", "overconfident", "overconfident"]
    assert rows[1]["reason"] == "two.mcap: is empty"


def test_run_log_does_not_call_rejected_what_was_held_out() -> None:
    made = report()
    held_out = replace(
        made.tables.consistency[0], measurement="held_out_heading", used=0, rejected=2120
    )
    text = run_log(
        replace(
            made, tables=replace(made.tables, consistency=[*made.tables.consistency, held_out])
        )
    )
    assert re.search(r"filter baseline: 424 velocity .*\b0 ", text)
    assert re.search(r"filter baseline: 2120 .*heading", text)
    assert "2120 rejected" not in text


def test_run_log_names_every_channel_and_note() -> None:
    text = run_log(report())
    assert "channel /imu (sensor_msgs/msg/Imu, cdr): 42400 messages, imu\n" in text
    assert "warning imu_gaps [3]: the IMU pauses 3 times (hint: imu.max_gap_s)\n" in text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (None, "-"),
        (9.81274, "9.813"),
        (-0.0123456, "-0.01235"),
        (12345.6, "12346"),
        (1.5e-7, "1.50e-07"),
        (2e9, "2.00e+09"),
    ],
)
def test_shown_numbers_have_four_significant_digits(value: float | None, text: str) -> None:
    assert number(value) == text


def test_shown_percentages_have_one_digit() -> None:
    assert (percent(18.449), percent(-0.3), percent(-0.03), percent(None)) == (
        "18.4 %",
        "-0.3 %",
        "0.0 %",
        "-",
    )


def write_result(
    target: Path,
    word: str,
    *,
    force: bool = False,
    interruption: type[BaseException] | None = None,
) -> None:
    with result_folder(target, force=force) as folder:
        (folder / COMPLETE).write_text(
            json.dumps({"tool": {"name": "insdvl-replay"}, "word": word})
        )
        if interruption:
            raise interruption


def word_in(target: Path) -> str:
    return str(json.loads((target / COMPLETE).read_bytes())["word"])


def write_file(target: Path, word: str, *, force: bool = False, fail: bool = False) -> None:
    with result_file(target, force=force) as path:
        path.write_text(word)
        if fail:
            raise RuntimeError


def test_folder_appears_when_complete(tmp_path: Path) -> None:
    target = tmp_path / "new" / "dive"
    with result_folder(target) as folder:
        (folder / COMPLETE).write_text('{"tool": {}}')
        assert not target.exists()
    assert json.loads((target / COMPLETE).read_bytes())["tool"] == {}
    assert list(target.parent.iterdir()) == [target]


def test_an_interrupt_while_the_hidden_folder_is_removed_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    remove, calls = shutil.rmtree, list[Path]()

    def interrupted(path: Path, **options: bool) -> None:
        calls.append(path)
        if len(calls) == 1:
            raise KeyboardInterrupt
        remove(path, **options)

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(tmp_path / "dive", "whole")
    assert [path.name for path in tmp_path.iterdir()] == ["dive"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError, SystemExit])
def test_folder_leaves_nothing_behind_and_the_old_one_alone(
    tmp_path: Path, interruption: type[BaseException]
) -> None:
    target = tmp_path / "dive"
    write_result(target, "old")
    with pytest.raises(interruption):
        write_result(target, "half", force=True, interruption=interruption)
    assert list(tmp_path.iterdir()) == [target]
    assert word_in(target) == "old"


def test_folder_is_replaced_only_when_asked_to(tmp_path: Path) -> None:
    target = tmp_path / "dive"
    write_result(target, "old")
    with pytest.raises(ConfigError, match="dive: exists"):
        write_result(target, "new")
    write_result(target, "new", force=True)
    assert word_in(target) == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_folder_that_is_no_result_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(ConfigError, match="thesis: "):
        write_result(tmp_path / "thesis", "new", force=True)
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"


def test_folder_under_a_file_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="file"):
        write_result(tmp_path / "file" / "dive", "new")


def test_file_is_replaced_only_when_asked_to_and_complete(tmp_path: Path) -> None:
    target = tmp_path / "dive.mcap"
    target.write_text("old")
    with pytest.raises(ConfigError, match=r"dive\.mcap: exists"):
        write_file(target, "new")
    with pytest.raises(RuntimeError):
        write_file(target, "half", force=True, fail=True)
    assert target.read_text() == "old"
    write_file(target, "new", force=True)
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]
