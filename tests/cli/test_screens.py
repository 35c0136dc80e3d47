"""What stands on a terminal: the answer first, in 24 lines of 80 columns, and what is left of it where there is less.

The files in ``golden`` hold the screens; ``python tests/cli/test_screens.py`` writes them anew.
"""

import csv
import io
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from contextlib import suppress
from fcntl import ioctl
from pathlib import Path

import pytest
from made_reports import report
from msgspec.structs import replace
from rich.console import Console

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.result import Report
from insdvl_replay.core.words import EvidenceVerdict, GateStatus, Prediction, Verdict
from insdvl_replay.evaluation.answers import pooled_candidate, pooled_sentence
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dives import index_page, named_result, summary_rows
from insdvl_replay.show.render import render
from insdvl_replay.show.screens import dive_screen, dives_screen, quiet_lines
from insdvl_replay.show.text import for_terminal

GOLDEN = Path(__file__).parent / "golden"
PROJECT = Path(__file__).resolve().parents[2]
ROWS = 24
# With the paper's settings, for which nothing has to be fitted.
RUN = (
    *(sys.executable, "-m", "insdvl_replay", "run"),
    *(str(PROJECT / "sample_logs" / "figure_eight.mcap"), "--preset", "levy-klein"),
)
THIRTEEN = ("best", "wide", "worse", "dead", *(f"dive {number}" for number in range(1, 10)))


def on_terminal(folder: Path, *options: str, columns: int = 80, **variables: str) -> str:
    """Run the figure-eight on a terminal of so many columns, and return what it shows; stderr is the terminal, too."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))
    command = RUN
    environment = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "COLUMNS")}
    process = subprocess.Popen(
        [*command, *options], cwd=folder, stdout=theirs, stderr=theirs,
        env=environment | {"TERM": "xterm", "PYTHONPATH": str(PROJECT)} | variables,
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    with suppress(OSError):  # the last one to write has left
        while data := os.read(ours, 1 << 16):
            shown += data
    os.close(ours)
    assert process.wait() == 0
    return shown.decode(variables.get("PYTHONIOENCODING", "utf-8")).replace("\r\n", "\n")


def screen_lines(text: str) -> list[str]:
    return text.rstrip("\n").split("\n")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the result lies already, so that a run only shows it."""
    made = tmp_path_factory.mktemp("screens")
    command = RUN
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    subprocess.run(command, cwd=made, check=True, capture_output=True, env=environment)
    return made


SCREENS = {
    "dive_80": ({}, ()),
    "dive_40": ({"columns": 40}, ()),
    "dive_120": ({"columns": 120}, ()),
    "dive_quiet": ({}, ("-q",)),
    "dive_cp1252": ({"PYTHONIOENCODING": "cp1252"}, ()),
    "dive_no_color": ({"NO_COLOR": "1"}, ()),
    "dive_table": ({}, ("--table", "track_fit")),
}


def shown(name: str, folder: Path) -> str:
    how, options = SCREENS[name]
    return on_terminal(folder, *options, **how)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", SCREENS)
def test_screen_of_a_dive_is_as_it_was_looked_at(name: str, folder: Path) -> None:
    assert shown(name, folder) == (GOLDEN / f"{name}.txt").read_text("utf-8")


@pytest.mark.parametrize("name", ["dive_80", "dive_cp1252", "dive_no_color"])
def test_screen_fits_24_lines_of_80_columns(name: str) -> None:
    lines = screen_lines(plain((GOLDEN / f"{name}.txt").read_text("utf-8")))
    assert len(lines) <= ROWS
    assert max(map(len, lines)) <= 80
    assert lines[-1].startswith("all tables")


def test_narrow_terminal_leaves_out_columns_and_folds_no_digits() -> None:
    text = (GOLDEN / "dive_40.txt").read_text("utf-8")
    assert max(len(line) for line in screen_lines(plain(text)) if "report.html" not in line) <= 40
    wide = plain((GOLDEN / "dive_80.txt").read_text("utf-8"))
    assert set(re.findall(r"\b\d\.\d\d\b", plain(text))) <= set(re.findall(r"\b\d\.\d\d\b", wide))
    assert re.search(r" 30 s +0\.86 +undecided$", plain(text), re.MULTILINE)


def test_wider_terminals_show_more_and_all_show_the_verdict_first() -> None:
    narrow, wide, piped = (
        plain((GOLDEN / f"dive_{name}.txt").read_text("utf-8")).split("\n") for name in ("80", "120", "piped")
    )
    heads = [next(line for line in lines if line.startswith("evidence")).split() for lines in (narrow, wide, piped)]
    assert heads[0] == ["evidence", "ratio", "on", "this", "dive"]
    assert heads[1] == heads[2] == ["evidence", "baseline", "aided", "ratio", "on", "this", "dive", "n", "p"]
    for lines in (narrow, wide, piped):
        starts = ("aided against baseline", "predicted: ", "evidence", "this run", "all tables")
        places = [next(place for place, line in enumerate(lines) if line.startswith(start)) for start in starts]
        assert places == sorted(places)


def test_colours_are_for_terminals_unless_somebody_wants_other(folder: Path) -> None:
    assert "\x1b[" not in on_terminal(folder, NO_COLOR="1")
    assert "\x1b[" not in on_terminal(folder, "--color", "never")
    assert "\x1b[1m" in on_terminal(folder, "--color", "always", NO_COLOR="1")


def test_notes_end_with_where_to_learn_more(folder: Path) -> None:
    text = plain(on_terminal(folder, "-v"))
    notes, hint, _ = text.partition("`insdvl-replay explain CODE` tells more about a note\n")
    assert hint
    assert re.fullmatch(r"((info|warning): .*\n)+", notes)


def test_a_pipe_has_no_colours_and_folds_nothing(folder: Path) -> None:
    command = RUN
    done = subprocess.run(
        command, cwd=folder, check=True, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(PROJECT)}
    )
    assert done.stdout == plain(done.stdout)
    assert done.stdout == (GOLDEN / "dive_piped.txt").read_text("utf-8")
    assert done.stderr == "unchanged replay/figure_eight\n"


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def judged(name: str, verdict: Verdict, ratio: float = 0.8) -> Report:
    """One report of a dive of this name, with this word and a first piece of evidence of this ratio."""
    made = report(name)
    first, *others = made.tables.evidence
    word = verdict if verdict in set(EvidenceVerdict) else "better" if verdict == Verdict.MIXED else "undecided"
    rows = [replace(first, value=ratio, ratio=ratio, low=0.9 * ratio, high=1.1 * ratio, verdict=word), *others]
    aided = replace(made.filters["aided"], verdict=verdict)
    log = replace(made.log, name=name)
    return replace(made, log=log, filters={"aided": aided}, tables=replace(made.tables, evidence=rows))


def rendered(document: list[object], width: int = 80) -> str:
    console = Console(width=width, record=True, file=io.StringIO(), color_system=None)
    console.print(for_terminal(document), crop=False)  # type: ignore[arg-type]
    return "\n".join(line.rstrip() for line in console.export_text().split("\n"))


def thirteen() -> list[Report | Failure]:
    words = {"best": Verdict.BETTER, "worse": Verdict.WORSE, "dead": Verdict.NOT_EVALUATED}
    ratios = {"worse": 1.4, "wide": 123.4}
    made: list[Report | Failure] = [
        judged(name, words.get(name, Verdict.UNDECIDED), ratios.get(name, 0.8)) for name in THIRTEEN
    ]
    made[1] = Failure("wide", "wide.mcap: is empty")
    return made


def of_thirteen() -> str:
    return rendered(list(dives_screen(thirteen(), "replay/index.html")))


def test_thirteen_dives_have_a_row_each_below_what_they_say_together() -> None:
    text = of_thirteen()
    assert text == (GOLDEN / "thirteen.txt").read_text("utf-8")
    lines = screen_lines(text)
    assert lines[2].startswith("aided against baseline: undecided, drift in 30 s 0.84"), "the word comes first"
    rows = [line.split("  ")[0] for line in lines]
    assert rows.index("dive 2") < rows.index("dive 9"), "numbers stand in their order"
    assert "13 dives, 1 failed" in text


@pytest.mark.parametrize(("dives", "words"), [(2, "undecided"), (3, "BETTER")])
def test_three_dives_that_agree_decide_over_dives(dives: int, words: str) -> None:
    reports = [judged(f"dive {number}", Verdict.UNDECIDED) for number in range(dives)]
    _, _, answer, *lines = screen_lines(rendered(list(dives_screen(reports, "index.html")), width=120))
    assert answer.startswith(f"aided against baseline: {words}, drift in 30 s 0.80")
    assert sum(f"{dives}/{dives}" in line for line in lines) == 1
    said = "(0.80 .. 0.80) on 3 dives" if dives == 3 else "on 2 dives: fewer than 3 dives"
    confirmed = "confirmed" if dives == 3 else "not confirmed"
    [line] = quiet_lines(reports)
    assert line == f"aided {words} drift in 30 s 0.80 {said}; predicted 6.7 % smaller sigma: {confirmed}"
    candidate = pooled_candidate("aided", "baseline", [report.tables.evidence for report in reports], dives)
    sentence = pooled_sentence(candidate)
    assert f"smaller on {dives} of {dives} dives" in sentence
    assert ("95 % interval" in sentence) == (dives == 3), "two dives have no interval that says anything"
    assert "nan" not in sentence


def test_above_twenty_dives_only_the_failed_and_the_worst_have_rows() -> None:
    many = [judged(f"dive {number}", Verdict.UNDECIDED, 0.5 + 0.01 * number) for number in range(1, 26)]
    text = rendered(list(dives_screen([*many, Failure("gone", "gone.mcap: is empty")], "index.html")))
    found = re.findall(r"^(dive \d+|gone) ", text, re.MULTILINE)
    assert found == ["dive 23", "dive 24", "dive 25", "gone"]
    assert re.search(r"\b22 ", text)
    assert len(screen_lines(text)) <= ROWS


@pytest.mark.parametrize("verdict", list(Verdict))
def test_every_word_on_a_filter_is_on_the_screen(verdict: Verdict) -> None:
    text = rendered(list(dive_screen(judged("dive", verdict), "report.html")))
    line = next(line for line in text.split("\n") if line.startswith("aided against baseline: "))
    assert line.partition(": ")[2].partition(",")[0].lower() == verdict
    assert ("predicted:" in text) == (verdict != Verdict.NOT_EVALUATED), "nothing is believed of what is not evaluated"


def test_words_come_from_the_enums() -> None:
    known = {*EvidenceVerdict, *Verdict, *Prediction, *GateStatus}
    last = [line.split("  ")[-1].lower() for line in plain((GOLDEN / "dive_80.txt").read_text()).split("\n")]
    words = {word for word in last if re.fullmatch(r"[a-z]+( [a-z]+)?", word)}
    assert words
    assert words <= known


def test_three_candidates_have_a_row_each() -> None:
    made = report()
    filters = dict.fromkeys(("aided", "windowed", "published"), made.filters["aided"])
    rows = [replace(row, filter=name) for name in filters for row in made.tables.evidence]
    several = replace(made, filters=filters, tables=replace(made.tables, evidence=rows))
    text = rendered(list(dive_screen(several, "report.html")))
    assert len(screen_lines(text)) <= ROWS
    lines = text.split("\n")
    assert [line.split()[0] for line in lines[4:7]] == list(filters)
    assert [line.split()[0] for line in lines if line.startswith(("baseline", *filters))] == [
        *filters,
        "baseline",
        *filters,
    ]


def test_the_reference_keeps_its_rate_next_to_a_solution_that_says_little() -> None:
    made = report()
    little = [replace(row, samples=row.samples // 4) for row in made.tables.reference_error]
    text = rendered(
        list(dive_screen(replace(made, tables=replace(made.tables, reference_error=little)), "report.html"))
    )
    assert "reference 1 Hz" in screen_lines(text)[0]


def test_a_prediction_in_larger_errors_is_reported_without_a_sign() -> None:
    made = report()
    lost = replace(made.filters["aided"], mean_improvement_pct=-66.9, mean_convergence_improvement_pct=-2.04)
    text = rendered(list(dive_screen(replace(made, filters={"aided": lost}), "report.html")))
    assert re.search(r" 66\.9 % larger .* 2\.0 % slower ", " ".join(text.split()))


def test_beams_are_counted_where_no_filter_takes_velocities() -> None:
    made = report()
    velocity = made.tables.consistency[0]
    met = [(name, beam) for name in ("baseline", "aided") for beam in ("beam_1", "beam_2")]
    rows = [replace(velocity, filter=name, measurement=beam, used=420, rejected=4) for name, beam in met]
    for used, said in (
        (rows, "848 beams, 8 rejected"),
        ([], "no velocities"),
        ([*rows, velocity], "424 velocities, 0"),
    ):
        tables = replace(made.tables, consistency=used)
        assert said in rendered(list(dive_screen(replace(made, tables=tables), "report.html")))


def test_one_filter_alone_has_a_row_and_a_link_for_each_dive() -> None:
    made = [judged(f"dive {number}", Verdict.BETTER) for number in range(2)]
    errors = [replace(row, filter="baseline") for row in made[0].tables.reference_error]
    dives = [
        replace(dive, filters={}, tables=replace(dive.tables, evidence=[], reference_error=errors)) for dive in made
    ]
    lines = screen_lines(rendered(list(dives_screen([*dives, Failure("gone", "gone.mcap: is empty")], "index.html"))))
    assert [line.split() for line in lines if line.startswith(("dive 1", "gone"))] == [
        ["dive", "1", "1.5", "-", "-", "-", "consistent"],
        ["gone", *"----", "failed"],
    ]
    assert index_page(dives).count(b"report.html") == 2
    assert [row.log for row in summary_rows(dives)] == ["dive 0", "dive 1"]


def test_two_candidates_fit_a_screen_though_their_sentences_fold() -> None:
    made = report()
    filters = dict.fromkeys(("windowed_acceleration", "published_acceleration"), made.filters["aided"])
    quantities = ("drift_30s", "drift_60s", "velocity_along")
    rows = [
        replace(row, filter=name, quantity=quantity)
        for name in filters
        for quantity in quantities
        for row in made.tables.evidence
    ]
    wide = [
        replace(row, filter=name, quantity="velocity", verdict="overconfident")
        for name in filters
        for row in made.tables.credibility[:1]
    ]
    tables = replace(made.tables, evidence=rows, credibility=[*made.tables.credibility, *wide])
    text = rendered(list(dive_screen(replace(made, filters=filters, tables=tables), "report.html")))
    assert sum(line.startswith(tuple(f"{name} against" for name in filters)) for line in text.split("\n")) == 2
    assert len(screen_lines(text)) <= ROWS + 3
    assert text.count("ratios: over 16 random starts") == 1


def test_a_quiet_run_has_a_line_for_each_candidate() -> None:
    words = {Verdict.BETTER: "BETTER drift in 30 s 0.80 (0.72 .. 0.88)", Verdict.NOT_EVALUATED: "NOT EVALUATED"}
    for verdict, said in words.items():
        [line] = quiet_lines([judged("dive", verdict)])
        assert line.startswith(f"aided {said} on dive")
    assert quiet_lines([Failure("gone", "gone.mcap: is empty")]) == []
    assert quiet_lines(thirteen()) == [
        "aided undecided drift in 30 s 0.84 (0.75 .. 0.94) on 11 of 12 dives: smaller, but maybe less than 5 %; "
        "predicted 6.7 % smaller sigma: confirmed"
    ]


def test_beside_the_ratio_of_a_dive_is_its_own_verdict_and_that_of_the_dive_if_it_differs() -> None:
    dives = [judged(f"dive {number}", Verdict.UNDECIDED) for number in range(3)]
    worse = judged("dive 3", Verdict.WORSE)
    first, *others = worse.tables.evidence
    outage = replace(first, evidence="outage", quantity="outage_30s", ratio=1.4, low=1.26, high=1.54)
    rows = [replace(first, verdict="undecided", ratio=0.8, low=0.5, high=1.2), outage, *others]
    worse = replace(worse, tables=replace(worse.tables, evidence=rows))
    text = rendered(list(dives_screen([*dives, worse], "index.html")), width=120)
    assert re.search(
        r"^dive 3 .* 0\.80  0\.50 \.\. 1\.20  undecided +WORSE by DVL outage 30 s 1\.40 \(1", text, re.MULTILINE
    )
    assert "dive by dive, by all evidence: aided 3 undecided, 1 WORSE" in text


def test_tables_of_several_dives_are_one_in_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        assert run_command_line(["simulate", "straight", "-o", f"{name}.mcap", "--duration", "40"]) == 0
    run = ["run", "a.mcap", "b.mcap", "--starts", "1"]
    capsys.readouterr()
    assert run_command_line([*run, "--table", "track_fit", "--format", "csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["log"] for row in rows] == ["a"] * (len(rows) // 2) + ["b"] * (len(rows) // 2)
    assert run_command_line([*run, "--format", "csv"]) == 0
    assert capsys.readouterr().out.count("table,log,filter,quantity,unit,fitted") == 1
    assert run_command_line([*run, "--table", "evidence", "--format", "json"]) == 0
    assert {row["log"] for row in json.loads(capsys.readouterr().out)["evidence"]} == {"a", "b"}
    capsys.readouterr()
    assert run_command_line([*run, "--table", "pooled", "--table", "summary", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["pooled", "summary"]
    assert {row["log"] for row in found["pooled"]} == {"*"}
    assert [row["log"] for row in found["summary"]] == ["a", "b"]
    assert run_command_line([*run, "--table", "summary", "--format", "csv"]) == 0
    assert capsys.readouterr().out == Path("replay", "summary.csv").read_text()
    for format_, begin in (("table", "Summary: position [m]"), ("md", "| a | "), ("html", "<td class=l>a</td>")):
        assert run_command_line([*run, "--table", "summary", "--table", "pooled", "--format", format_]) == 0
        printed = capsys.readouterr().out
        assert begin in printed
        assert "track" not in printed.partition("<body>")[2]
    assert run_command_line([*run, "--table", "track_fit", "--table", "pooled", "--format", "latex"]) == 0
    assert len(re.findall(r"label{tab:(?:a|b|2-dives|322064697665|2.*dives):", capsys.readouterr().out)) >= 3
    assert run_command_line([*run[:2], "--starts", "1", "--table", "pooled"]) == 2
    assert "pooled: a.mcap is one dive" in capsys.readouterr().err
    for format_, begin in (("md", "## 2 dives"), ("latex", "% 2 dives"), ("html", "<!doctype html>")):
        assert run_command_line([*run, "--format", format_]) == 0
        assert begin in capsys.readouterr().out
    assert run_command_line([*run, "--table", "evidense"]) == 2
    assert "evidence" in capsys.readouterr().err


def write_golden() -> Iterator[str]:
    import tempfile

    GOLDEN.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        command = RUN
        environment = os.environ | {"PYTHONPATH": str(PROJECT)}
        for _ in range(2):
            done = subprocess.run(command, cwd=made, check=True, capture_output=True, text=True, env=environment)
        (GOLDEN / "dive_piped.txt").write_text(done.stdout, "utf-8")
        for screen in SCREENS:
            (GOLDEN / f"{screen}.txt").write_text(shown(screen, made), "utf-8")
            yield screen
    (GOLDEN / "thirteen.txt").write_text(of_thirteen(), "utf-8")


if __name__ == "__main__":
    sys.stdout.write(" ".join(write_golden()))


def test_a_table_over_dives_that_one_dive_cannot_fill_says_why() -> None:
    one = [judged("good", Verdict.BETTER), Failure("bad", "bad.mcap: cannot be read")]
    text = render(named_result(one, ["pooled"], ()), "md")
    assert "it takes two dives with the same candidate, and 1 dive could be replayed" in text


def test_dives_without_evidence_have_a_sentence_instead_of_an_empty_table() -> None:
    bare = [replace(found, tables=replace(found.tables, evidence=[])) for found in map(report, ("one", "two"))]
    page = index_page(bare).decode()
    assert "<tbody></tbody>" not in page
    assert "aided against baseline: no evidence." in page
