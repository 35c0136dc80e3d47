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
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout, suppress
from fcntl import ioctl
from pathlib import Path
from unittest.mock import patch

import pytest
from made_reports import report
from msgspec.structs import replace
from rich.console import Console

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.quantities import WITHOUT_VERDICT
from insdvl_replay.core.report import Report
from insdvl_replay.core.words import Verdict
from insdvl_replay.document.parts import Callout, Sentences
from insdvl_replay.document.render import render
from insdvl_replay.document.text import for_terminal
from insdvl_replay.show.answers import Failure
from insdvl_replay.show.dives import index_page, named_result, summary_rows
from insdvl_replay.show.screens import dive_screen, dives_screen, quiet_lines

GOLDEN = Path(__file__).parent / "golden"
PROJECT = Path(__file__).resolve().parents[2]
ROWS = 24
# With the paper's settings, for which nothing has to be fitted.
RUN = (
    *(sys.executable, "-m", "insdvl_replay", "run"),
    *(
        str(PROJECT / "sample_logs" / "figure_eight.mcap"),
        "--preset",
        "fog",
        "--set",
        "dvl.beam_sd_mps=0.006",
    ),
)
THIRTEEN = ("best", "wide", "worse", "dead", *(f"dive {number}" for number in range(1, 10)))


def on_terminal(folder: Path, *options: str, columns: int = 80, **variables: str) -> str:
    """Run the figure-eight on a terminal of so many columns, and return what it shows; stderr is the terminal, too."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))
    encoding = variables.get("PYTHONIOENCODING", "utf-8")
    environment = {
        name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "COLUMNS")
    }
    environment |= {"TERM": "xterm"} | variables
    with ThreadPoolExecutor(1) as reader:
        shown = reader.submit(all_of, ours)
        with (
            patch.dict(os.environ, environment, clear=True),
            chdir(folder),
            standing_at(theirs, encoding),
        ):
            code = run_command_line([*RUN[3:], *options])
        os.close(theirs)
    os.close(ours)
    assert code == 0
    return shown.result().decode(encoding).replace("\r\n", "\n")


def all_of(terminal: int) -> bytes:
    """Read a terminal until the last one to write on it has left."""
    shown = b""
    with suppress(OSError):
        while data := os.read(terminal, 1 << 16):
            shown += data
    return shown


@contextmanager
def standing_at(terminal: int, encoding: str) -> Iterator[None]:
    """Let this process read and write at a terminal, as one that is started there; one would take a second to load."""
    sys.stdout.flush()
    sys.stderr.flush()
    before = {stream: os.dup(stream) for stream in (0, 1, 2)}
    for stream in before:
        os.dup2(terminal, stream)
    try:
        with (
            open(1, "w", encoding=encoding, closefd=False) as out,
            open(2, "w", encoding=encoding, errors="backslashreplace", closefd=False) as err,
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            yield
    finally:
        for stream, elsewhere in before.items():
            os.dup2(elsewhere, stream)
            os.close(elsewhere)


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
    assert re.search(r"^position +\d\.\d\d$", plain(text), re.MULTILINE)


def test_wider_terminals_show_more_and_all_show_the_verdict_first() -> None:
    narrow, wide, piped = (
        plain((GOLDEN / f"dive_{name}.txt").read_text("utf-8")).split("\n")
        for name in ("80", "120", "piped")
    )
    heads = [
        next(line for line in lines if line.startswith("this dive")).split()
        for lines in (narrow, wide, piped)
    ]
    assert heads == [["this", "dive", "baseline", "aided", "ratio", "acts"]] * 3
    for lines in (narrow, wide, piped):
        starts = (
            "aided against baseline",
            "acts: ",
            "predicted: ",
            "this dive",
            "this run",
            "all tables",
        )
        places = [
            next(place for place, line in enumerate(lines) if line.startswith(start))
            for start in starts
        ]
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


def piped(folder: Path, **variables: str) -> "subprocess.CompletedProcess[str]":
    """Run the figure-eight where nothing is a terminal."""
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    return subprocess.run(
        RUN,
        cwd=folder,
        check=True,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=environment | {"PYTHONPATH": str(PROJECT)} | variables,
    )


def test_a_pipe_has_no_colours_and_80_columns_or_as_many_as_it_is_told(folder: Path) -> None:
    done = piped(folder)
    assert done.stdout == plain(done.stdout)
    assert done.stdout == (GOLDEN / "dive_piped.txt").read_text("utf-8")
    assert max(map(len, screen_lines(done.stdout))) == 80
    wide = screen_lines(piped(folder, COLUMNS="400").stdout)
    assert any(line.endswith("cannot tell whether the next one will be") for line in wide)
    assert done.stderr == "unchanged replay/figure_eight\n"


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def judged(
    name: str,
    ratio: float = 0.8,
    *,
    quantity: str = "position",
    level: float = 0.8,
    acts: float = 0.4,
    verdict: Verdict = Verdict.UNDECIDED,
) -> Report:
    """One report of a dive of this name; these are the ratios of what decides and of the level."""
    made = report(name)
    evidence = []
    for row in made.tables.evidence:
        if row.quantity == "position":
            kind = "outage" if quantity.startswith("outage") else "track"
            changes = {
                "evidence": kind,
                "quantity": quantity,
                "baseline": 1.0,
                "value": ratio,
                "ratio": ratio,
            }
        else:
            changes = {"ratio": level} if row.quantity == "level" else {}
        moved = {} if row.evidence in ("convergence", "consistency") else {"acts": acts}
        evidence.append(replace(row, **changes, **moved))
    aided = replace(
        made.filters["aided"],
        verdict=verdict,
        reason="a reason" if verdict in WITHOUT_VERDICT else "",
    )
    log = replace(made.log, name=name)
    return replace(
        made, log=log, filters={"aided": aided}, tables=replace(made.tables, evidence=evidence)
    )


def dives_of(verdict: Verdict) -> list[Report]:
    """Three dives that together have this verdict."""
    word = verdict.removesuffix(" without DVL")
    middle = {"better": 0.7, "mixed": 0.7, "worse": 1.4}.get(word, 1.0)
    scatter = 0.3 if verdict == Verdict.UNDECIDED else 0.01
    return [
        judged(
            f"dive {number}",
            middle + offset * scatter,
            quantity="position" if word == verdict else "outage_60s",
            level=1.4 if verdict == Verdict.MIXED else 0.8,
            acts=0.001 if verdict == Verdict.NO_EFFECT else 0.4,
            verdict=verdict if verdict in WITHOUT_VERDICT else Verdict.UNDECIDED,
        )
        for number, offset in enumerate((-1.0, 0.0, 1.0))
    ]


def rendered(document: list[object], width: int = 80) -> str:
    console = Console(width=width, record=True, file=io.StringIO(), color_system=None)
    console.print(for_terminal(document), crop=False)  # type: ignore[arg-type]
    return "\n".join(line.rstrip() for line in console.export_text().split("\n"))


def thirteen() -> list[Report | Failure]:
    made: list[Report | Failure] = [
        judged(
            name,
            1.4 if name == "worse" else 0.8,
            verdict=Verdict.NOT_EVALUATED if name == "dead" else Verdict.UNDECIDED,
        )
        for name in THIRTEEN
    ]
    made[1] = Failure("wide", "wide.mcap: is empty")
    return made


def of_thirteen() -> str:
    return rendered(list(dives_screen(thirteen(), "replay/index.html")))


def test_thirteen_dives_have_a_row_each_below_what_they_say_together() -> None:
    text = of_thirteen()
    assert text == (GOLDEN / "thirteen.txt").read_text("utf-8")
    lines = screen_lines(text)
    assert lines[2].startswith("aided against baseline: BETTER, position 0.84"), (
        "the word comes first"
    )
    rows = [line.split("  ")[0] for line in lines]
    assert rows.index("dive 2") < rows.index("dive 9"), "numbers stand in their order"
    assert "13 dives, 1 failed" in text


@pytest.mark.parametrize(
    ("dives", "said"),
    [
        (
            1,
            "on this dive position 20.0 % smaller; one dive cannot tell whether the next one will be",
        ),
        (2, "UNDECIDED, position 0.80, smaller on 2 of 2 dives"),
        (3, "BETTER, position 0.80 (0.80 .. 0.80), smaller on 3 of 3 dives"),
    ],
)
def test_three_dives_that_agree_decide(dives: int, said: str) -> None:
    reports = [judged(f"dive {number}") for number in range(dives)]
    several = list(dives_screen(reports, "index.html"))
    lines = screen_lines(
        rendered(several if dives > 1 else list(dive_screen(reports[0], "report.html")), width=120)
    )
    assert f"aided against baseline: {said}" in lines
    assert quiet_lines(reports) == [f"aided {said}"]
    confirmed = "Not confirmed: it takes 3 dives."
    if dives == 3:
        confirmed = "Confirmed: position 0.80 (0.80 .. 0.80)."
    assert (
        sum(
            line.startswith("predicted: 6.7 % smaller sigma") and confirmed in line
            for line in lines
        )
        == 1
    )
    assert not any("nan" in line for line in lines)


def test_above_twenty_dives_only_the_failed_and_the_worst_have_rows() -> None:
    many = [judged(f"dive {number}", 0.5 + 0.01 * number) for number in range(1, 26)]
    text = rendered(
        list(dives_screen([*many, Failure("gone", "gone.mcap: is empty")], "index.html"))
    )
    found = re.findall(r"^(dive \d+|gone) ", text, re.MULTILINE)
    assert found == ["dive 23", "dive 24", "dive 25", "gone"]
    assert re.search(r"\b22 ", text)
    assert len(screen_lines(text)) <= ROWS + 6


@pytest.mark.parametrize("verdict", list(Verdict))
def test_every_word_on_a_filter_is_on_the_screen(verdict: Verdict) -> None:
    text = rendered(list(dives_screen(dives_of(verdict), "index.html")), width=200)
    line = next(line for line in text.split("\n") if line.startswith("aided against baseline: "))
    assert line.partition(": ")[2].partition(",")[0] == verdict.upper()
    assert ("predicted:" in text) == (verdict not in WITHOUT_VERDICT), (
        "nothing is believed of what is not evaluated"
    )
    assert ("A reason. Settle this first." in text) == (verdict in WITHOUT_VERDICT)
    of_outages = "How well it navigates with the DVL was not measured: no position reference."
    assert (of_outages in text) == verdict.endswith("without DVL")


@pytest.mark.parametrize("verdict", list(Verdict))
def test_one_dive_has_no_verdict_but_what_is_proved_or_not_evaluated(verdict: Verdict) -> None:
    text = rendered(list(dive_screen(dives_of(verdict)[0], "report.html")), width=200)
    line = next(line for line in text.split("\n") if line.startswith("aided against baseline: "))
    proved = {
        Verdict.NO_EFFECT: "NO EFFECT, ",
        Verdict.NOT_EVALUATED: "NOT EVALUATED",
        Verdict.NOT_REPEATABLE: "NOT REPEATABLE",
    }
    assert line.partition(": ")[2].startswith(proved.get(verdict, "on this dive "))


def test_colours_are_those_of_the_word() -> None:
    """One dive has none, however small its error is."""
    for verdict in Verdict:
        together = [
            part
            for part in dives_screen(dives_of(verdict), "index.html")
            if isinstance(part, Sentences)
        ]
        [tone] = {
            line.tone for part in together for line in part.lines if isinstance(line, Callout)
        }
        bad = verdict in ("mixed", "not evaluated", "not repeatable") or verdict.startswith(
            "worse"
        )
        assert tone == ("good" if verdict.startswith("better") else "bad" if bad else "")
    alone = [
        part
        for part in dive_screen(judged("dive", 0.1), "report.html")
        if isinstance(part, Sentences)
    ]
    assert {line.tone for part in alone for line in part.lines if isinstance(line, Callout)} == {
        ""
    }


def test_no_victory_is_printed_of_one_dive() -> None:
    """The stored screens are of one dive: no word of a verdict in capitals is on them."""
    text = plain((GOLDEN / "dive_80.txt").read_text("utf-8"))
    assert "on this dive" in text
    assert not any(verdict.upper() in text for verdict in Verdict)


def test_three_candidates_have_a_row_each() -> None:
    made = report()
    filters = dict.fromkeys(("aided", "windowed", "published"), made.filters["aided"])
    rows = [replace(row, filter=name) for name in filters for row in made.tables.evidence]
    several = replace(made, filters=filters, tables=replace(made.tables, evidence=rows))
    text = rendered(list(dive_screen(several, "report.html")))
    assert len(screen_lines(text)) <= ROWS
    lines = text.split("\n")
    assert any(line.startswith("for aided: A verdict takes 3 dives") for line in lines)
    assert [line.split()[0] for line in lines if line.startswith(tuple(filters))][:3] == list(
        filters
    )
    assert [line.split()[0] for line in lines if line.startswith(("baseline", *filters))] == [
        *filters,
        "baseline",
        *filters,
    ]


def test_the_reference_keeps_its_rate_next_to_a_solution_that_says_little() -> None:
    made = report()
    little = [replace(row, samples=row.samples // 4) for row in made.tables.reference_error]
    text = rendered(
        list(
            dive_screen(
                replace(made, tables=replace(made.tables, reference_error=little)), "report.html"
            )
        )
    )
    assert "reference 1 Hz" in screen_lines(text)[0]


def test_a_prediction_in_larger_errors_is_reported_without_a_sign() -> None:
    made = report()
    lost = replace(
        made.filters["aided"], mean_improvement_pct=-66.9, mean_convergence_improvement_pct=-2.04
    )
    text = rendered(list(dive_screen(replace(made, filters={"aided": lost}), "report.html")))
    assert "predicted: 66.9 % larger sigma." in text


def test_beams_are_counted_where_no_filter_takes_velocities() -> None:
    made = report()
    velocity = made.tables.consistency[0]
    met = [(name, beam) for name in ("baseline", "aided") for beam in ("beam_1", "beam_2")]
    rows = [
        replace(velocity, filter=name, measurement=beam, used=420, rejected=4)
        for name, beam in met
    ]
    for used, said in (
        (rows, "848 beams, 8 rejected"),
        ([], "no velocities"),
        ([*rows, velocity], "424 velocities, 0"),
    ):
        tables = replace(made.tables, consistency=used)
        assert said in rendered(list(dive_screen(replace(made, tables=tables), "report.html")))


def test_one_filter_alone_has_a_row_and_a_link_for_each_dive() -> None:
    made = [judged(f"dive {number}") for number in range(2)]
    errors = [replace(row, filter="baseline") for row in made[0].tables.reference_error]
    dives = [
        replace(dive, filters={}, tables=replace(dive.tables, evidence=[], reference_error=errors))
        for dive in made
    ]
    lines = screen_lines(
        rendered(
            list(dives_screen([*dives, Failure("gone", "gone.mcap: is empty")], "index.html"))
        )
    )
    assert [line.split() for line in lines if line.startswith(("dive 1", "gone"))] == [
        ["dive", "1", "1.5", "-", "-", "-", "consistent"],
        ["gone", *"----", "failed"],
    ]
    assert index_page(dives).count(b"report.html") == 2
    assert [row.log for row in summary_rows(dives)] == ["dive 0", "dive 1"]


def test_two_candidates_fit_a_screen_though_their_sentences_fold() -> None:
    made = report()
    filters = dict.fromkeys(
        ("windowed_acceleration", "published_acceleration"), made.filters["aided"]
    )
    rows = [replace(row, filter=name) for name in filters for row in made.tables.evidence]
    wide = [
        replace(row, filter=name, quantity="velocity", verdict="overconfident")
        for name in filters
        for row in made.tables.credibility[:1]
    ]
    tables = replace(made.tables, evidence=rows, credibility=[*made.tables.credibility, *wide])
    text = rendered(
        list(dive_screen(replace(made, filters=filters, tables=tables), "report.html"))
    )
    assert (
        sum(
            line.startswith(tuple(f"{name} against" for name in filters))
            for line in text.split("\n")
        )
        == 2
    )
    assert len(screen_lines(text)) <= ROWS + 12
    assert max(map(len, screen_lines(text))) <= 80


def test_a_quiet_run_has_a_line_for_each_candidate() -> None:
    assert quiet_lines(dives_of(Verdict.NOT_EVALUATED)) == ["aided NOT EVALUATED: a reason"]
    assert quiet_lines([Failure("gone", "gone.mcap: is empty")]) == []
    [line] = quiet_lines(thirteen())
    assert re.fullmatch(
        r"aided BETTER, position 0\.84 \(0\.7\d \.\. 0\.9\d\), smaller on 10 of 11 dives", line
    )


def test_beside_each_dive_is_its_ratio_and_no_word() -> None:
    text = rendered(list(dives_screen(thirteen(), "index.html")), width=120)
    assert re.search(r"^worse +1 +1\.4 +1\.40 +40 %$", text, re.MULTILINE)
    assert re.search(r"^dead .* NOT EVALUATED ", text, re.MULTILINE)
    assert re.search(r"^wide .* failed ", text, re.MULTILINE)


def test_tables_of_several_dives_are_one_in_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, seed in (("a", "1"), ("b", "2")):
        simulate = [
            "simulate",
            "straight",
            "-o",
            f"{name}.mcap",
            "--duration",
            "40",
            "--seed",
            seed,
        ]
        assert run_command_line(simulate) == 0
    run = [
        "run",
        "a.mcap",
        "b.mcap",
        "--starts",
        "1",
        "--preset",
        "fog",
        "--set",
        "dvl.beam_sd_mps=0.006",
    ]
    capsys.readouterr()
    assert run_command_line([*run, "--table", "track_fit", "--format", "csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["log"] for row in rows] == ["a"] * (len(rows) // 2) + ["b"] * (len(rows) // 2)
    assert run_command_line([*run, "--format", "csv"]) == 0
    assert capsys.readouterr().out.count("table,log,filter,quantity,unit,fitted") == 1
    assert run_command_line([*run, "--table", "evidence", "--format", "json"]) == 0
    assert {row["log"] for row in json.loads(capsys.readouterr().out)["evidence"]} == {"a", "b"}
    capsys.readouterr()
    together = ["--table", "answers", "--table", "pooled", "--table", "summary"]
    assert run_command_line([*run, *together, "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["answers", "pooled", "summary"]
    [answer] = found["answers"]
    assert (answer["filter"], answer["dives"]) == ("aided", 2)
    headline = f"against baseline: {answer['verdict'].upper()}"
    assert run_command_line(run) == 0
    assert headline in capsys.readouterr().out
    assert run_command_line([*run, "--table", "answers", "--format", "csv"]) == 0
    assert capsys.readouterr().out == Path("replay", "answers.csv").read_text()
    assert {row["log"] for row in found["pooled"]} == {"*"}
    assert [row["log"] for row in found["summary"]] == ["a", "b"]
    assert run_command_line([*run, "--table", "summary", "--format", "csv"]) == 0
    assert capsys.readouterr().out == Path("replay", "summary.csv").read_text()
    for format_, begin in (
        ("table", "Summary: position [m]"),
        ("md", "| a | "),
        ("html", "<td class=l>a</td>"),
    ):
        assert run_command_line([*run, *together, "--format", format_]) == 0
        printed = capsys.readouterr().out
        assert begin in printed
        assert "track" not in printed.partition("<body>")[2]
    assert (
        run_command_line([*run, "--table", "track_fit", "--table", "pooled", "--format", "latex"])
        == 0
    )
    assert (
        len(
            re.findall(
                r"label{tab:(?:a|b|2-dives|322064697665|2.*dives):", capsys.readouterr().out
            )
        )
        >= 3
    )
    for table in ("answers", "pooled"):
        assert run_command_line([*run[:2], "--starts", "1", "--table", table]) == 2
        assert f"{table}: a.mcap is one dive" in capsys.readouterr().err
    for format_, begin in (
        ("md", "## 2 dives"),
        ("latex", "% 2 dives"),
        ("html", "<!doctype html>"),
    ):
        assert run_command_line([*run, "--format", format_]) == 0
        assert begin in capsys.readouterr().out
    assert run_command_line([*run, "--table", "evidense"]) == 2
    assert "evidence" in capsys.readouterr().err


def write_golden() -> Iterator[str]:
    import tempfile

    GOLDEN.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name)
        for _ in range(2):
            done = piped(made)
        (GOLDEN / "dive_piped.txt").write_text(done.stdout, "utf-8")
        for screen in SCREENS:
            (GOLDEN / f"{screen}.txt").write_text(shown(screen, made), "utf-8")
            yield screen
    (GOLDEN / "thirteen.txt").write_text(of_thirteen(), "utf-8")


if __name__ == "__main__":
    sys.stdout.write(" ".join(write_golden()))


def test_a_table_over_dives_that_one_dive_cannot_fill_says_why() -> None:
    one = [judged("good"), Failure("bad", "bad.mcap: cannot be read")]
    text = render(named_result(one, ["pooled"], ()), "md")
    assert "it takes two dives with the same candidate, and 1 dive could be replayed" in text


def test_dives_without_evidence_have_a_sentence_instead_of_an_empty_table() -> None:
    bare = [
        replace(found, tables=replace(found.tables, evidence=[]))
        for found in map(report, ("one", "two"))
    ]
    page = index_page(bare).decode()
    assert "<tbody></tbody>" not in page
    assert "aided against baseline: no evidence." in page
