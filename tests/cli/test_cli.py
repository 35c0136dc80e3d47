"""The door: commands, options, exit codes and streams."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from insdvl_replay import __version__
from insdvl_replay.cli import run_command_line

SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs" / "straight.mcap"
DOCUMENTED = {
    "demo": ["-o, --output DIR", "--jobs N", "-v, --verbose", "--color <auto|always|never>", "-h, --help"],
    "run": [
        "LOG...", "-o, --output DIR", "-c, --config FILE", "--no-config", "--preset NAME", "--start T", "--end T",
        "--set KEY=VALUE",
        "--starts K", "--format <table|json|csv|md|latex|html>", "--table NAME",
        "--allow-damaged", "--offline", "--allow-code", "--one-dive", "--assay", "--control",
        "--tum", "--kml", "--geojson",
        "--history <csv|parquet>", "--lake DIR", "--revision NAME", "--against KEY=VALUE",
        "--fail-on worse|undecided|P%", "--strict",
        "--shard I/N", "--jobs N", "--scheduler ADDR",
        "--rerun", "--force", "-v, --verbose", "-q, --quiet", "--color <auto|always|never>", "-h, --help",
    ],
    "merge": [
        "PART...", "-o, --output DIR", "--format <table|json|csv|md|latex|html>", "--table NAME", "--strict",
        "--force", "-v, --verbose", "-q, --quiet", "--color <auto|always|never>", "-h, --help",
    ],
    "compare": [
        "OLD", "NEW...", "--reference TRUTH", "--align <none|yaw|se3|sim3>", "--axes <ned_frd|enu_flu>",
        "--reference-axes <ned_frd|enu_flu>", "--primary NAME", "--max-diff S", "--rpe DELTA", "--all-pairs",
        "--dive NAME", "--table NAME", "--column NAME", "--pair OLD=NEW", "--tolerance P%",
        "--only-changed", "--all", "--fail-on worse|undecided|P%",
        "--format <table|json|csv|md|latex|html>", "--json", "-v, --verbose", "-q, --quiet",
        "--color <auto|always|never>", "-h, --help",
    ],
    "check": [
        "GATES", "[DIVE]...", "--update", "--results DIR", "-c, --config FILE", "--no-config", "--preset NAME",
        "--set KEY=VALUE", "--allow-damaged", "--offline", "--allow-code",
        "--format <text|md|json|junit|github|html>", "--output FILE", "--summary-file FILE", "--badge FILE",
        "--only GATE", "--skip GATE", "--shard I/N", "--keep-histories", "--jobs N", "--scheduler ADDR",
        "--rerun", "-v, --verbose", "-q, --quiet", "-h, --help",
    ],
    "history": [
        "LAKE", "--quantity NAME", "--format <table|json|csv|md|latex|html>", "-v, --verbose",
        "--color <auto|always|never>", "-h, --help",
    ],
    "plan": [
        "RESULTS", "--tracks N", "--ratio R", "--format <table|json|csv|md|latex>", "-v, --verbose",
        "--color <auto|always|never>", "-h, --help",
    ],
    "inspect": [
        "LOG...", "--deep", "--propose FILE", "-c, --config FILE", "--no-config", "--preset NAME", "--set KEY=VALUE",
        "--format <table|json|csv|md|latex|html>", "--allow-damaged", "--offline", "--one-dive", "--force",
        "-v, --verbose", "--color <auto|always|never>", "-h, --help",
    ],
    "calibrate": [
        "LOG...", "-o, --output FILE", "--page FILE", "-c, --config FILE", "--no-config", "--preset NAME",
        "--set KEY=VALUE",
        "--only NAMES", "--reference", "--delays <each|one>", "--mounting <known|unknown>", "--hold-out SHARE|DIVE",
        "--even-if-worse", "--format <table|json|csv|md|latex>", "--allow-damaged", "--offline", "--allow-code",
        "--one-dive", "--force",
        "-v, --verbose", "--color <auto|always|never>", "-h, --help",
    ],
    "figure": [
        "RESULT", "KIND", "-o, --output FILE", "--format <pdf|svg|png|pgf>", "--width MM", "--states NAMES", "--force",
        "-v, --verbose", "-h, --help",
    ],
    "simulate": [
        "SCENARIO", "-o, --output LOG", "--seed N", "--duration S", "--imu GRADE", "--outage START:END",
        "--lost-beam BEAM:START:END", "--sensor NAME=SD[@HZ]", "--lever-arm X,Y,Z", "--mounting R,P,H", "--dvl-delay S",
        "--dvl-scale TIMES", "--force", "-v, --verbose", "-h, --help",
    ],
    "config": ["--preset NAME", "-c, --config, --from FILE", "--set KEY=VALUE", "-v, --verbose", "-h, --help"],
    "schema": ["NAME", "--toml", "-v, --verbose", "-h, --help"],
    "explain": ["CODE", "-v, --verbose", "-h, --help"],
    "compile": ["--key", "-v, --verbose", "-h, --help"],
    "study montecarlo": [
        "SCENARIO", "--runs N", "--seed N", "--run K", "--duration S", "--imu GRADE", "--outage START:END", "--jobs N",
        "-o, --output DIR", "--png", "-c, --config FILE", "--preset NAME", "--set KEY=VALUE",
        "--format <table|json|csv|md|latex>", "--force", "-v, --verbose",
        "--color <auto|always|never>", "-h, --help",
    ],
    "lake compact": ["LAKE", "--format <table|json|csv|md|latex>", "-v, --verbose", "-h, --help"],
}  # fmt: skip
WITH_STAND_IN = """
import pathlib, sys, time
import insdvl_replay.preparation.replay as hall
import insdvl_replay.show.result_files as disk
from insdvl_replay.cli import main

def save_half(replay, folder, **how):
    (folder / "report.json").write_text("half")
    print("half-written", flush=True)
    time.sleep(60)

hall.replay_log = lambda path, config, **options: None
disk.save_replay = save_half
sys.argv = ["insdvl-replay", *sys.argv[1:]]
main()
"""


# With a noise that is given, nothing has to be fitted.
SETTLED = ("--preset", "fog", "--set", "dvl.beam_sd_mps=0.006")


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a simulated straight line."""
    path = tmp_path_factory.mktemp("logs") / "straight.mcap"
    assert run_command_line(["simulate", "straight", "-o", str(path), "--duration", "60"]) == 0
    return path


@pytest.fixture
def result(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[Path, str, str]:
    """Its result folder, and what was said on stdout and stderr."""
    assert run_command_line(["run", str(dive), "-o", str(tmp_path), *SETTLED]) == 0
    captured = capsys.readouterr()
    return tmp_path / "straight", captured.out, captured.err


@pytest.mark.parametrize("command", sorted(DOCUMENTED))
def test_help_shows_the_documented_options_and_an_example(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*command.split(), "-h"]) == 0
    text = capsys.readouterr().out
    shown = re.findall(
        r"^  ((?:-\w, )?--[\w-]+(?:, --from)?(?: \S+)?)(?:  |$)", text, re.MULTILINE
    )
    assert shown == [option for option in DOCUMENTED[command] if option.startswith("-")]
    assert all(
        argument in text for argument in DOCUMENTED[command] if not argument.startswith("-")
    )
    assert f"  Example:\n    insdvl-replay {command} " in text


def test_help_names_every_command_and_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["--help"]) == 0
    text = capsys.readouterr().out
    assert [line.split()[0] for line in text.split("Commands:\n")[1].strip().split("\n")] == list(
        dict.fromkeys(name.split()[0] for name in DOCUMENTED)
    )
    for code in (
        "0 done",
        "1 a limit",
        "2 usage",
        "3 a log",
        "4 internal error",
        "130 interrupted",
    ):
        assert code in text


def test_help_loads_nothing_heavy(tmp_path: Path) -> None:
    script = """
import sys
from insdvl_replay.cli import run_command_line
run_command_line(["--help"])
sys.exit(",".join({"numpy", "pandas", "numba", "scipy", "mcap", "rich", "msgspec"} & set(sys.modules)) or 0)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("command", "heavy"),
    [
        ("schema report", ""),
        ("config", ""),
        ("inspect {straight}", "numpy mcap"),
    ],
)
def test_a_command_loads_only_what_it_needs(command: str, heavy: str) -> None:
    arguments = command.format(straight=SAMPLE).split()
    script = f"""
import sys
from insdvl_replay.cli import run_command_line
run_command_line({arguments})
found = {{"numpy", "pandas", "numba", "scipy", "mcap", "matplotlib"}} & set(sys.modules)
print(*sorted(found), file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert set(done.stderr.split()) == set(heavy.split())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["--version"]) == 0
    assert capsys.readouterr().out == f"insdvl-replay {__version__}\n"


@pytest.mark.all_starts
def test_run_writes_the_folder_and_keeps_results_apart_from_talk(
    result: tuple[Path, str, str],
) -> None:
    folder, out, err = result
    for name in ("improvement.csv", "convergence.csv", "reference_error.csv", "consistency.csv", "report.json",
                 "replay.mcap", "config.toml", "run.log"):  # fmt: skip
        assert (folder / name).stat().st_size > 0, name
    assert re.match(r"straight: [0-9]+ s, [0-9]+ .*\b0 .*\b5 Hz.*\b16 ", out)
    assert out.endswith(f": -v   page: {folder}/report.html\n")
    assert "…" not in out
    assert err.split("\n")[-2] == f"wrote {folder}"
    assert sorted(path.name for path in folder.parent.iterdir()) == ["straight"]


def test_only_the_block_tool_differs_between_two_runs(
    result: tuple[Path, str, str], dive: Path, tmp_path: Path
) -> None:
    first, _, _ = result
    assert run_command_line(["run", str(dive), "-o", str(tmp_path / "again"), *SETTLED]) == 0
    second = tmp_path / "again" / "straight"
    names = sorted(path.name for path in first.iterdir())
    assert names == sorted(path.name for path in second.iterdir())
    for name in names:
        ours, theirs = ((folder / name).read_bytes() for folder in (first, second))
        if name == "report.json":
            ours, theirs = (
                json.dumps({**json.loads(data), "tool": None}).encode() for data in (ours, theirs)
            )
        assert ours == theirs, name


def test_the_saved_configuration_reproduces_the_result(
    result: tuple[Path, str, str], dive: Path, tmp_path: Path
) -> None:
    first, _, _ = result
    second = tmp_path / "again"
    assert (
        run_command_line(["run", str(dive), "-o", str(second), "-c", str(first / "config.toml")])
        == 0
    )
    assert (second / "straight" / "improvement.csv").read_bytes() == (
        first / "improvement.csv"
    ).read_bytes()


@pytest.mark.parametrize(
    ("format_", "start"),
    [
        ("csv", "table,log,filter,state"),
        ("md", "## straight: "),
        ("latex", "% needs "),
        ("html", "<!doctype html>"),
    ],
)
def test_other_formats(
    format_: str, start: str, dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(dive), "-o", str(tmp_path), "--format", format_]
    assert run_command_line([*command, *SETTLED]) == 0
    assert capsys.readouterr().out.startswith(start)


def test_json_on_stdout_is_the_saved_report(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(dive), "-o", str(tmp_path), "--format", "json"]
    assert run_command_line([*command, *SETTLED]) == 0
    assert capsys.readouterr().out == (tmp_path / "straight" / "report.json").read_text()


def test_a_bad_log_does_not_stop_the_others(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not a log")
    output = tmp_path / "out"
    assert run_command_line(["run", str(bad), str(dive), "-o", str(output), *SETTLED]) == 3
    assert sorted(path.name for path in output.iterdir()) == [
        "answers.csv",
        "evidence.csv",
        "index.html",
        "straight",
        "summary.csv",
        "where.csv",
    ]
    lines = (output / "summary.csv").read_text().split("\n")
    assert lines[1].startswith("bad,,")
    assert lines[2].startswith("straight,aided,")
    last = capsys.readouterr().err.split("\n")[-2]
    assert re.match(r"error: 1 of 2 .*: bad; .*bad\.mcap: ", last)


def test_strict_turns_warnings_into_exit_3_and_keeps_the_result(
    dive: Path, tmp_path: Path
) -> None:
    arguments = ["run", str(dive), "-o", str(tmp_path), "--set", "imu.max_gap_s=0.001"]
    arguments += SETTLED
    assert run_command_line(arguments) == 0
    assert run_command_line([*arguments, "--strict", "--force"]) == 3
    assert (tmp_path / "straight" / "report.json").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        ("", 2, "--help"),
        ("rn", 2, "'rn'.*; hint: .* run"),
        ("study", 2, "insdvl-replay study --help"),
        ("run DIVE --tabel drift", 2, "--tabel.*; hint: .*--table"),
        ("run DIVE --starts 0", 2, "'--starts': .*1.*; hint: .*insdvl-replay run --help"),
        ("run DIVE --starts few", 2, "'--starts': .*; hint: .*insdvl-replay run --help"),
        ("run", 2, "insdvl-replay run --help"),
        ("run DIVE --format xml", 2, "'--format': 'xml'"),
        ("run DIVE --preset phog", 2, "'phog'.*; hint: .*fog"),
        ("run DIVE --set dvl.scle=1", 2, "'dvl.scle'.*; hint: .*dvl.scale"),
        ("run DIVE --set scale", 2, "--set scale: .*; hint: .*--set dvl.scale=1.01"),
        ("run DIVE -c absent.toml", 2, "absent.toml: .*; hint: .*-c"),
        ("run absent.mcap", 3, "absent.mcap"),
        ("inspect text.mcap", 3, "text.mcap: "),
        ("inspect DIVE --set imu.topik=/imu", 2, "'imu.topik'.*; hint: .*imu.topic"),
        ("run text.mcap", 3, "text.mcap"),
        ("run DIVE -o taken", 2, "taken/straight: .*; hint: .*--force"),
        ("run DIVE -o text.mcap", 2, "text.mcap/straight: .*; hint: .*-o"),
        ("config --preset phog", 2, "'phog'.*; hint: .*fog"),
        ("schema rapport", 2, "'rapport'.*; hint: .*report"),
        ("simulate spiral -o new.mcap", 2, "'spiral'.*; hint: .*straight"),
        ("simulate static -o text.mcap", 2, "text.mcap: .*; hint: .*--force"),
        ("simulate static -o new.mcap --outage 60", 2, "--outage 60.*; hint: .*60:90"),
        (
            "simulate static -o new.mcap --lost-beam x:1:2",
            2,
            "--lost-beam x:1:2.*; hint: .*2:120:180",
        ),
        ("simulate static -o new.mcap --imu quantum", 2, "'quantum'.*; hint: .*fog"),
        ("simulate static -o new.mcap --sensor depht=1", 2, "--sensor 'depht'.*; hint: .*depth"),
        ("simulate static -o new.mcap --sensor depth=1 --sensor depth=2", 2, "--sensor depth=2: "),
        ("simulate static", 2, "insdvl-replay simulate --help"),
    ],
)
def test_wrong_uses_end_with_a_code_a_reason_and_a_hint(
    arguments: str,
    code: int,
    named: str,
    dive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.mcap").write_text("this is no log")
    (tmp_path / "taken" / "straight").mkdir(parents=True)
    (tmp_path / "taken" / "straight" / "report.json").write_text(
        '{"tool": {"name": "insdvl-replay"}}'
    )
    before = sorted(tmp_path.rglob("*"))
    assert (
        run_command_line([str(dive) if word == "DIVE" else word for word in arguments.split()])
        == code
    )
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.strip().split("\n")
    assert line.startswith("error: ")
    assert line.count("; hint: ") == 1
    assert re.search(named, line)
    assert sorted(tmp_path.rglob("*")) == before


INTERRUPTED_AS_IT_IS_IMPORTED = """
import signal, sys
from insdvl_replay.cli import main

class Finder:
    def find_spec(self, name, path, target=None):
        if name == "insdvl_replay.nav.filter":
            signal.raise_signal(signal.SIGNAL)

sys.meta_path.insert(0, Finder())
sys.argv = ["insdvl-replay", "run", "LOG"]
main()
"""


@pytest.mark.parametrize("signal_", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.nightly)])
def test_an_interruption_during_an_import_is_an_interruption(
    signal_: str, dive: Path, tmp_path: Path
) -> None:
    script = INTERRUPTED_AS_IT_IS_IMPORTED.replace("LOG", str(dive)).replace("SIGNAL", signal_)
    command = [sys.executable, "-c", script]
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=20.0, check=False, cwd=tmp_path
    )
    assert (result.returncode, result.stderr) == (130, "error: interrupted\n")


STOPPED_IN_EXEC = """
from insdvl_replay import cli

def interrupted(_):
    try:
        exec("raise KeyboardInterrupt")
    except KeyboardInterrupt:
        return cli.INTERRUPTED

cli.run_command_line = interrupted
cli.main()
"""


def test_an_interruption_within_exec_is_130_under_python_m(tmp_path: Path) -> None:
    """Python would end with the signal: it remembers that an `exec` was interrupted, whoever caught it."""
    (tmp_path / "stopped.py").write_text(STOPPED_IN_EXEC, "utf-8")
    ended = subprocess.run(
        [sys.executable, "-m", "stopped"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (130, "error: interrupted\n")


@pytest.mark.parametrize(
    "signal_", [pytest.param(signal.SIGINT, marks=pytest.mark.nightly), signal.SIGTERM]
)
def test_an_interruption_leaves_nothing_half_written(
    signal_: signal.Signals, dive: Path, tmp_path: Path
) -> None:
    command = [
        sys.executable,
        "-c",
        WITH_STAND_IN,
        "run",
        str(dive),
        "--preset",
        "fog",
        "-o",
        "out",
    ]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "half-written\n"
        process.send_signal(signal_)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == "error: interrupted\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("flags", "traceback"), [([], False), (["-v"], False), (["-vv"], True)])
def test_our_error_is_exit_4_and_shows_its_place_only_when_asked(
    flags: list[str],
    traceback: bool,
    dive: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(path: Path, config: object, **_: object) -> None:
        raise ZeroDivisionError("a slip")

    monkeypatch.setattr("insdvl_replay.preparation.replay.replay_log", fail)
    assert run_command_line(["run", str(dive), "-o", str(tmp_path), *flags]) == 4
    err = capsys.readouterr().err
    assert ("Traceback" in err) is traceback
    assert re.search(r"error: internal error: ZeroDivisionError: a slip; hint: ", err)


@pytest.mark.nightly
def test_a_reader_that_goes_away_ends_the_printing_not_the_work(
    dive: Path, tmp_path: Path
) -> None:
    command = [
        sys.executable,
        "-c",
        "from insdvl_replay.cli import main; main()",
        "run",
        str(dive),
        *SETTLED,
        "--starts",
        "1",
    ]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        err = process.stderr.read()
    assert process.returncode == 0, err
    assert err.endswith("wrote replay/straight\n")
    assert (tmp_path / "replay" / "straight" / "report.json").is_file()


def test_simulate_replaces_a_log_only_when_asked_to(tmp_path: Path) -> None:
    log = tmp_path / "dive.mcap"
    arguments = ["simulate", "static", "-o", str(log), "--duration", "10"]
    assert run_command_line(arguments) == 0
    first = log.read_bytes()
    assert run_command_line([*arguments, "--seed", "2"]) == 2
    assert log.read_bytes() == first
    assert run_command_line([*arguments, "--seed", "2", "--force"]) == 0
    assert log.read_bytes() != first
    assert run_command_line([*arguments, "--force"]) == 0
    assert log.read_bytes() == first


def test_schema_prints_message_definitions(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["schema", "insdvl_msgs/msg/NavSolution"]) == 0
    assert "std_msgs/Header header" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("redirection", "reason"),
    [
        (">/dev/full", "error: stdout: "),
        ("2>/dev/full", ""),
        (">/dev/full 2>/dev/full", ""),
        (">&- 2>&-", ""),
    ],
)
@pytest.mark.parametrize(
    "command",
    [
        "--help",
        *(
            pytest.param(one, marks=pytest.mark.nightly)
            for one in ("config", "run {log} -o {out}")
        ),
    ],
)
def test_streams_that_are_full_or_closed_end_the_printing_but_not_the_work(
    command: str, redirection: str, reason: str, tmp_path: Path
) -> None:
    log = SAMPLE.parents[1] / "examples" / "archive" / "dives" / "lost_beam.mcap"
    words = (
        f"{sys.executable} -m insdvl_replay {command.format(log=log, out=tmp_path)} {redirection}"
    )
    done = subprocess.run(
        words, shell=True, capture_output=True, text=True, timeout=120, check=False
    )
    is_lost = redirection.startswith(">/dev/full")
    assert done.returncode == (2 if is_lost else 0)
    assert "Traceback" not in done.stderr
    assert (done.stderr.splitlines() or [""])[-1].startswith(reason)
    assert bool(done.stdout) == redirection.startswith("2>")
    assert (tmp_path / "lost_beam").exists() == command.startswith("run")


def test_a_trace_that_nobody_can_read_does_not_change_the_exit_code(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("this is no log")
    words = f"{sys.executable} -m insdvl_replay run text.mcap -vv 2>/dev/full"
    done = subprocess.run(
        words, shell=True, cwd=tmp_path, capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 3


@pytest.mark.parametrize(
    ("option", "meant"),
    [
        ("--json", "--format json"),
        ("--always", "--color always"),
        ("--ouput", "--output"),
        ("--jsn", ""),
        ("--x", ""),
    ],
)
def test_an_unknown_option_is_answered_with_what_was_meant_or_not_at_all(
    option: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(["run", "dive.mcap", option]) == 2
    hint = capsys.readouterr().err.partition("; hint: ")[2]
    assert hint.startswith(f"did you mean {meant}?" if meant else "`insdvl-replay run --help`")
