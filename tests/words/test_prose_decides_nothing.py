"""Nothing is decided by prose: with every sentence replaced by "x", words, codes and exit codes stay what they are."""

import ast
import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest
from deciding import decided_by_prose, is_too_long_for_a_code
from decisions import COMMANDS, SLOW_COMMANDS, decisions, without_prose
from wordless import Wordless, error_of_x

import insdvl_replay
from insdvl_replay.batch.against import BothSides, Side
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions
from insdvl_replay.cli import run_command_line
from insdvl_replay.cli.against import answer_against
from insdvl_replay.core import notes
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError, LogError, UserError
from insdvl_replay.core.words import Severity
from insdvl_replay.inspection import automatic
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

WORDLESS = Path(__file__).with_name("wordless.py")
PACKAGE = Path(insdvl_replay.__file__).parent
MODULES = [file for file in sorted(PACKAGE.rglob("*.py")) if file.name != "__main__.py"]
SOURCE = '''
"""A docstring of several words."""
class Word(StrEnum):
    LATE = "late by several words"
def told(name: "a type of words", other="one of the known"):
    """Another docstring of words."""
    if name == "this is a sentence":
        return f"{name} is not one of the known"
    return re.compile("a pattern of words"), "dvl.scale = {}", f"# found in the log\\n"
'''


def write_logs(folder: Path) -> None:
    """Write a dive, the same with a DVL that is turned and reads too much, a table of it, and a file that is no log."""
    folder.mkdir()
    dive = simulate_dive(
        "figure-eight", seed=2, duration_s=90.0, imu_rate_hz=40.0, reference_rate_hz=2.0
    )
    write_dive(folder / "good.mcap", dive)
    beams = dive.dvl.beam_velocity_mps
    assert beams is not None
    turned = replace(dive.dvl, beam_velocity_mps=1.2 * np.roll(beams, 1, axis=1))
    write_dive(folder / "turned.mcap", replace(dive, dvl=turned))
    (folder / "broken.mcap").write_bytes(b"no log" * 100)
    seconds = (dive.imu.time_ns - dive.imu.time_ns[0]) * 1e-9
    columns = [seconds, dive.imu.specific_force_b, dive.imu.angular_rate_b]
    names = "time [s],force x,force y,force z,rate x,rate y,rate z"
    np.savetxt(
        folder / "table.csv", np.column_stack(columns), delimiter=",", header=names, comments=""
    )


@pytest.mark.parametrize(
    "commands",
    [COMMANDS, pytest.param(COMMANDS | SLOW_COMMANDS, marks=pytest.mark.nightly)],
    ids=["some commands", "all commands"],
)
def test_nothing_is_decided_by_prose(commands: dict[str, str], tmp_path: Path) -> None:
    write_logs(tmp_path / "said")
    write_logs(tmp_path / "wordless")
    done = subprocess.run(
        [sys.executable, WORDLESS, tmp_path / "wordless", json.dumps(commands)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    said = json.loads(json.dumps(decisions(tmp_path / "said", commands)))
    # The logs give exit codes of each kind, a verdict, and a filter that is not evaluated.
    assert {said[name]["exit code"] for name in commands} == {0, 1, 2, 3}
    assert said["before/good/report.json"]["filters"]["aided"]["verdict"] == "undecided"
    assert said["far_off/good/report.json"]["filters"]["aided"]["verdict"] == "not evaluated"
    assert told["replaced"] > 1000
    assert told["decisions"].keys() == said.keys()
    for name, decided in said.items():
        assert told["decisions"][name] == decided, name


def test_words_of_results_keys_and_patterns_are_no_sentences() -> None:
    wordless = Wordless()
    code = ast.unparse(wordless.visit(ast.parse(SOURCE)))
    assert wordless.replaced == [
        "one of the known",
        "this is a sentence",
        "{} is not one of the known",
        "# found in the log\n",
    ]
    for kept in ("docstring of several", "late by several", "a type of words", "a pattern of"):
        assert kept in code
    assert "if name == 'x':\n        return 'x'" in code
    assert "'dvl.scale = {}', '# x\\n'" in code


# --- What no command shows: paths of errors, and stored words that are sentences.


@pytest.mark.parametrize("module", MODULES, ids=lambda file: file.relative_to(PACKAGE).as_posix())
def test_no_code_asks_a_sentence(module: Path) -> None:
    assert decided_by_prose(module.read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ('hint = LONGER if "are not fetched" in reason else CHECK', True),
        ('is_late = note.text == "the reference is late"', True),
        ('why = text.removeprefix("it was not evaluated")', True),
        ('if text.endswith(("ok", "it shares its sensors")):\n    pass', True),
        ('_ASK = ("math domain error", "expected ")\nis_math = text.startswith(_ASK)', True),
        ('_SAID = {"it is too long": 1}\nis_said = text in _SAID', True),
        ("try:\n    go()\nexcept OSError as error:\n    late = 'late' in str(error)", True),
        ("try:\n    go()\nexcept UserError as error:\n    late = error.what == late", True),
        ("try:\n    go()\nexcept E as error:\n    re.search('late', str(error))", True),
        ("try:\n    go()\nexcept E as error:\n    late = error.errno == 2", False),
        ("try:\n    go()\nexcept E as error:\n    text = f'{error.what}: {error}'", False),
        ('is_mine = word.startswith("filters.")', False),
        ('_TEXT = {1: "it is too long"}\nis_known = number in _TEXT', False),
        ('sentence = "it is late, and early" + late', False),
    ],
)
def test_code_that_asks_a_sentence_is_found(code: str, found: bool) -> None:
    assert (decided_by_prose(code) != []) == found


def words_of_results() -> Iterator[tuple[str, str]]:
    """Yield each member of an enumeration of the package that is text, and its value."""
    for file in MODULES:
        name = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
        module = importlib.import_module(name.removesuffix(".__init__"))
        for kind in vars(module).values():
            if isinstance(kind, type) and issubclass(kind, StrEnum) and kind.__module__ == name:
                for member in kind:
                    yield f"{kind.__name__}.{member.name}", member.value


def test_stored_words_are_no_sentences() -> None:
    """A sentence in an enumeration is stored with results, and would be compared there."""
    known = dict(words_of_results())
    assert known["Verdict.BETTER"] == "better"
    assert known["ReasonCode.NOISE"] == "noise of the reference"
    assert [name for name, value in known.items() if is_too_long_for_a_code(value)] == []


@pytest.mark.parametrize(
    "sentence",
    [
        "one dive cannot tell whether the next one will be",
        "within 10 % of the expected value",
        "when all stamps move by 1 us",
    ],
)
def test_a_stored_sentence_is_found(sentence: str) -> None:
    assert is_too_long_for_a_code(sentence)


def test_sentences_are_left_out_of_results() -> None:
    found = {"notes": [{"code": "a", "text": "one"}], "reason": "two", "verdict": "three"}
    assert without_prose(found) == {"notes": [{"code": "a"}], "verdict": "three"}


# --- What no result tells.


@pytest.fixture
def errors_of_x(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have each error of the user's say "x"."""
    monkeypatch.setattr(UserError, "__init__", error_of_x(UserError.__init__))


@pytest.mark.usefixtures("errors_of_x")
def test_no_settings_are_searched_for_a_result_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def searched(*_: object, **__: object) -> None:
        pytest.fail("settings were searched")

    monkeypatch.setattr(automatic, "find_settings", searched)
    write_logs(tmp_path / "logs")
    (tmp_path / "file").write_text("in the way")
    command = ["run", str(tmp_path / "logs" / "good.mcap"), "-o", str(tmp_path / "file" / "below")]
    assert run_command_line([*command, "--starts", "1", "--set", "noise.fit=[]"]) == 2


@pytest.mark.usefixtures("errors_of_x")
def test_a_change_that_fails_twice_has_the_larger_exit_code() -> None:
    log = Path("dive.mcap")
    job = ReplayJob((log,), log, Path("out/dive"), ReplayOptions(load_config()))

    def replays() -> Iterator[Outcome]:
        yield Outcome(job, ConfigError("no settings"))
        yield Outcome(job, LogError("no log"))

    sides = BothSides(Side(Path("before"), [job]), Side(Path("after"), [job]))
    code = answer_against(sides, replays(), None, "table", 0, quiet=True)  # type: ignore[arg-type]
    assert code == LogError.exit_code


@pytest.mark.parametrize("deep", [False, True])
def test_a_hint_with_a_measured_value_is_given_of_the_whole_log_alone(
    deep: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_logs(tmp_path / "logs")
    of_x = notes.Sentence(Severity.WARNING, "x", "x")
    monkeypatch.setattr(notes, "_sentence", lambda code, word: of_x)
    found = inspect_log(tmp_path / "logs" / "turned.mcap", load_config(), deep=deep).notes
    (hint,) = (note.hint for note in found if note.code == "dvl_scale")
    assert ("--deep" in hint) != deep
    assert (hint == "x") == deep
