"""Text from a log, a file's name or a setting never acts: bytes of every output of commands on a hostile dive."""

import csv
import io
import json
import re
import subprocess
import sys
import tomllib
import unicodedata
from pathlib import Path

import pytest
from in_process import done_here
from mcap.reader import make_reader
from mcap.writer import Writer

from insdvl_replay.changes.findings import CheckResult, GateOutcome
from insdvl_replay.changes.formats import github_annotations
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.errors import visible, visible_lines, without_commands
from insdvl_replay.document.latex import as_latex
from insdvl_replay.document.parts import (
    Code,
    DisplayTable,
    Sentences,
    Title,
)
from insdvl_replay.document.tables import rows_csv
from insdvl_replay.document.text import as_markdown

HOSTILE = (
    "\n::error file=x::pwned\x1b]0;t\x07\r\x85\u2028\u202e\u200b##[error]x<b>&|`%\\input{evil}"
)
DIVE = f"::error::=a{HOSTILE}"
LOG = Path(__file__).parents[2] / "examples" / "archive" / "dives" / "lost_beam.mcap"
ACTING = re.compile(
    "[" + "".join(re.escape(chr(code)) for code in range(0x110000)
                  if unicodedata.category(chr(code)) in ("Cc", "Cf", "Zl", "Zp") and chr(code) != "\n") + "]"
)  # fmt: skip


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dive that can be replayed, and one with two IMUs, both with hostile names all over."""
    folder = tmp_path_factory.mktemp("hostile")
    rewrite(folder / f"{DIVE}.mcap", second_imu=False)
    (folder / "two").mkdir()
    rewrite(folder / "two" / f"{DIVE}.mcap", second_imu=True)
    return folder


def rewrite(path: Path, *, second_imu: bool) -> None:
    """Copy a log, with topics and library that are hostile; the reference, of a type of that kind, is none."""
    with LOG.open("rb") as source, path.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2", library=f"tests{HOSTILE}")
        channels: dict[str, list[int]] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                is_imu = schema.name.endswith("/Imu")
                type_name = f"{schema.name}{HOSTILE}" if "truth" in channel.topic else schema.name
                known = writer.register_schema(type_name, schema.encoding, schema.data)
                topics = [f"::error::{channel.topic}{HOSTILE}", f"\t:: b{HOSTILE}"][
                    : 2 if is_imu and second_imu else 1
                ]
                channels[channel.topic] = [
                    writer.register_channel(topic, "cdr", known) for topic in topics
                ]
            for number in channels[channel.topic]:
                writer.add_message(number, message.log_time, message.data, message.publish_time)
        writer.finish()


def spoken(arguments: list[str], cwd: Path, code: int) -> tuple[str, str]:
    """Run the tool as a job does, and give its stdout and stderr."""
    done = subprocess.run(
        [sys.executable, "-m", "insdvl_replay", *arguments],
        cwd=cwd,
        capture_output=True,
        timeout=300,
    )
    assert done.returncode == code, done.stderr.decode()
    return done.stdout.decode(), done.stderr.decode()


def said(arguments: list[str], cwd: Path, code: int) -> tuple[str, str]:
    """Run the tool in this process, where a process of its own has shown already that its streams are the same."""
    done = done_here(*arguments, cwd=cwd)
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


def assert_plain(text: str) -> None:
    """Nothing acts, and no line is a command: GitHub passes over blanks before it, and finds old ones anywhere."""
    assert not (found := ACTING.search(text)), (found, text)
    assert not [line for line in text.split("\n") if line.lstrip().startswith("::")]
    assert "##[" not in text


def test_what_acts_is_shown_and_the_rest_stays() -> None:
    assert visible("a\x1b[0m\r\n\t\x00\x7f") == r"a\x1b[0m\x0d\x0a\x09\x00\x7f"
    assert visible("\x85\u2028\u202e\u200d\ufeff\udcff\U000e0001") == (
        r"\u0085\u2028\u202e\u200d\ufeff\udcff\U000e0001"
    )
    assert (
        visible("Tauchgang Größe 潜水 5\u00a0m/s² -> \\x1b")
        == "Tauchgang Größe 潜水 5\u00a0m/s² -> \\x1b"
    )
    assert visible("##[error] ##vso[task] # [a]") == r"\u0023#[error] \u0023#vso[task] # [a]"
    assert visible_lines("a\nb\r") == "a\nb\\x0d"
    for text in (HOSTILE, DIVE, "##[##["):
        assert visible(visible(text)) == visible(text)
        assert_plain(without_commands(visible(text)))


def test_only_what_begins_a_line_is_kept_from_being_a_command() -> None:
    assert without_commands("a::b\n  ::c\n:: d\n:e\n") == "a::b\n  \\u003a:c\n\\u003a: d\n:e\n"


@pytest.mark.parametrize("value", [HOSTILE, "\x7f", "\U000e0001", "##[a]", "\\u202e"])
def test_settings_are_read_back_as_they_were(value: str) -> None:
    written = f"value = {toml_value(value)}"
    assert tomllib.loads(written)["value"] == value
    assert_plain(written)


def test_cells_that_a_spreadsheet_would_run_are_words_and_numbers_stay_numbers() -> None:
    cells = (
        "=HYPERLINK(1)",
        "+a",
        "-a",
        "@a",
        "-0.5",
        "+1e-3",
        "a=b",
        "\t=1",
        -0.5,
        None,
        "two\nlines",
    )
    (row,) = csv.reader(io.StringIO(rows_csv([], [cells]).split("\n", 1)[1]))
    assert row == [
        "'=HYPERLINK(1)", "'+a", "'-a", "'@a", "-0.5", "+1e-3", "a=b", r"\x09=1", "-0.5", "", r"two\x0alines",
    ]  # fmt: skip


def test_markup_is_not_left() -> None:
    table = DisplayTable(
        HOSTILE, ("a", "b"), "ll", ((DIVE, "[x](javascript:1)"), ("[1cm]", "<i>")), HOSTILE
    )
    document = [Title(HOSTILE), HOSTILE, table, Sentences((HOSTILE,))]
    text = as_markdown(document)
    assert_plain(without_commands(text))
    assert "<" not in text.replace("<br>", "")
    assert "](" not in text
    rows = [line for line in text.split("\n") if line.startswith("| ")]
    assert [len(re.findall(r"(?<!\\)\|", row)) for row in rows] == [3, 3, 3, 3]
    latex = as_latex(document)
    assert_plain(latex)
    assert [line for line in latex.split("\n") if r"\input" in line] == [
        line for line in latex.split("\n") if line.startswith(r"% \x0a")
    ]
    assert "\n{}[1cm] & \\textless{}i\\textgreater{} \\\\\n" in latex


def test_a_block_of_code_is_not_left() -> None:
    assert as_markdown([Code('a = "```"\n', "toml")]) == '````toml\na = "```"\n````\n'


def test_annotations_are_commands_of_ours_alone() -> None:
    outcomes = (GateOutcome(DIVE, f"gate{HOSTILE}", "failed", (f"::{HOSTILE}", "b")),)
    first, last = github_annotations(CheckResult(f"gates{HOSTILE}.toml", outcomes)).splitlines()
    assert first.startswith("::error file=gates\\x0a%3A%3Aerror file=x")
    assert re.findall(r"\d+", last) == ["1", "1", "1"]
    assert not ACTING.search(first)


@pytest.mark.nightly
def test_run_and_its_folder(hostile: Path) -> None:
    dive = f"{DIVE}.mcap"
    for text in spoken(["run", dive, "-v"], hostile, 0):
        assert_plain(text)
    for format_ in ("md", "latex", "csv"):
        for text in said(["run", dive, "--format", format_, "-v"], hostile, 0):
            assert_plain(text)
    _, told = said(["run", dive, "--rerun", "-vv"], hostile, 0)
    assert len(told.splitlines()) == len(
        re.findall(
            r"^(?:info|warning|wrote|assumed|found|to repeat it|processor time|`insdvl-replay)\b",
            told,
            re.MULTILINE,
        )
    )
    result = hostile / "replay" / DIVE
    log = (result / "run.log").read_text("utf-8")
    assert_plain(log)
    assert f"channel {visible(f'::error::/imu{HOSTILE}')} (sensor_msgs/msg/Imu, cdr)" in log
    assert not ACTING.search((result / "report.html").read_text("utf-8"))
    assert json.loads((result / "report.json").read_bytes())["log"]["name"] == DIVE


def test_compare(hostile: Path) -> None:
    said(["run", f"{DIVE}.mcap", "-o", "other", "--set", "dvl.velocity_sd_mps=0.1"], hostile, 0)
    said(["run", f"{DIVE}.mcap"], hostile, 0)
    for format_ in ("table", "md", "latex", "csv"):
        arguments = [
            "compare",
            f"replay/{DIVE}",
            f"other/{DIVE}",
            "--format",
            format_,
            "--fail-on",
            "0%",
        ]
        for text in said(arguments, hostile, 1):
            assert_plain(text)


@pytest.mark.parametrize(
    "format_",
    [
        "junit",
        *(
            pytest.param(one, marks=pytest.mark.nightly)
            for one in ("text", "md", "json", "github")
        ),
    ],
)
def test_check_of_a_dive_that_fails_and_one_that_cannot_be_used(
    format_: str, hostile: Path
) -> None:
    gate = '[[gate]]\nname = "a"\ntable = "improvement"\ncolumn = "sd"\nmax = 0\n'
    (hostile / "gates.toml").write_text(gate)
    arguments = [
        "check",
        "gates.toml",
        f"two/{DIVE}.mcap",
        "--format",
        format_,
        "--summary-file",
        f"{format_}.md",
    ]
    out, told = said(arguments, hostile, 3)
    assert_plain(told)
    assert told.splitlines()[-1].startswith("error: 1 gate on 1 dive: 1 ")
    assert_plain(without_commands((hostile / f"{format_}.md").read_text("utf-8")))
    if format_ == "github":
        assert [line[:15] for line in out.splitlines() if line.lstrip().startswith("::")] == [
            "::error file=ga"
        ]
        assert not ACTING.search(out)
    elif format_ != "json":
        assert_plain(out)


@pytest.mark.parametrize(
    "format_",
    ["table", *(pytest.param(one, marks=pytest.mark.nightly) for one in ("md", "latex", "csv"))],
)
def test_inspect(format_: str, hostile: Path) -> None:
    for dive in (f"{DIVE}.mcap", f"two/{DIVE}.mcap"):
        for text in said(["inspect", dive, "--format", format_, "--deep"], hostile, 0):
            assert_plain(text)


def test_the_last_line_of_stderr_is_the_reason(hostile: Path) -> None:
    for arguments in (
        ["run", f"none{HOSTILE}.mcap"],
        ["run", "x", f"--nothing{HOSTILE}"],
        ["config", "--set", HOSTILE],
    ):
        _, told = said(arguments, hostile, 2)
        assert_plain(told)
        assert told.startswith("error: ")
        assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("dive", "reason"),
    [
        ("\udcff.mcap", r"\udcff.mcap: "),
        ("a" * 5000, "File name too long"),
        ("a\0b", r"a\x00b: "),
    ],
)
@pytest.mark.parametrize("command", ["run", "inspect"])
def test_a_name_that_no_dive_can_have_is_a_error_of_the_user(
    command: str, dive: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    # A name that is no text is a dive that cannot be used, beside others that can.
    assert run_command_line([command, dive]) == (3 if "\udcff" in dive else 2)
    told = capsys.readouterr().err
    assert reason in told
    assert told.count("\n") == 1
