"""``run --against``: one command replays before and after a change of settings, and says whether it helped."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

ONE_START = ["--starts", "1"]
# With a noise that is given, nothing has to be fitted.
SETTLED = [*ONE_START, "--preset", "levy-klein"]


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three dives of 60 s."""
    folder = tmp_path_factory.mktemp("dives")
    for seed in range(1, 4):
        write_dive(
            folder / f"dive_{seed}.mcap", simulate_dive("figure-eight", seed=seed, duration_s=60.0)
        )
    return folder


@pytest.fixture(scope="module")
def results(dives: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``--against dvl.scale=1.1`` wrote."""
    output = tmp_path_factory.mktemp("results")
    assert (
        run_command_line(
            ["run", str(dives), "-o", str(output), *SETTLED, "--against", "dvl.scale=1.1"]
        )
        == 0
    )
    return output


def against(dives: Path, results: Path, *arguments: str) -> int:
    return run_command_line(["run", str(dives), "-o", str(results), *SETTLED, *arguments])


@pytest.mark.nightly
def test_it_prints_what_compare_prints(
    dives: Path, results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sides = str(results / "before"), str(results / "after")
    assert against(dives, results, "--against", "dvl.scale=1.1") == 0
    title, verdicts, *_ = capsys.readouterr().out.split("\n\n")
    question, counts = title.splitlines()[:2]
    assert question == "dvl.scale 1.0 -> 1.1: did it help?"
    assert counts.startswith("3 dives, ")
    words = [line.split() for line in verdicts.splitlines()]
    assert [word[0] for word in words if word[0] in ("baseline", "aided")] == ["baseline", "aided"]
    for options in (["-q"], ["--format", "json"], ["--format", "csv"]):
        assert against(dives, results, "--against", "dvl.scale=1.1", *options) == 0
        shown = capsys.readouterr().out
        assert run_command_line(["compare", *sides, *options]) == 0
        assert shown == capsys.readouterr().out
    assert {path.name for path in results.iterdir()} == {"before", "after"}


@pytest.mark.nightly
def test_several_are_one_change_of_any_section(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = {
        "filters.aided.acceleration.window": "5",
        "noise.accel_white_mps_rts": "0.01",
        "imu.min_rate_hz": "10.0",
    }
    options = [word for key, value in keys.items() for word in ("--against", f"{key}={value}")]
    assert (
        against(dives / "dive_1.mcap", tmp_path, *options, "--jobs", "2", "--format", "json") == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert {
        item["key"]: item["new"] for item in found["differences"] if item["block"] == "config"
    } == keys
    assert [answer["dives"] for answer in found["answers"]] == [1, 1]


def test_exit_codes_are_those_of_compare(
    dives: Path, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert against(dives, results, "--against", "dvl.scale=1.1", "-q", "--fail-on", "0%") == 1
    assert "worst: " in capsys.readouterr().err
    (tmp_path / "broken.mcap").write_text("no log")
    broken = [str(dives / "dive_1.mcap"), str(tmp_path / "broken.mcap")]
    command = ["run", *broken, "-o", str(results), *SETTLED, "--against", "dvl.scale=1.1"]
    assert run_command_line(command) == 3
    printed = capsys.readouterr()
    assert "\ndive_1, new: " in printed.out, "the others are compared"
    assert printed.err.count("broken.mcap") == 1


@pytest.mark.nightly
@pytest.mark.parametrize("option", [["--against", "dvl.scale=1.1"], ["--control"]])
def test_where_settings_are_needed_the_hint_says_how_they_are_found(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulated = simulate_dive("figure-eight", seed=1, duration_s=60.0)
    logs = {
        "simulated": simulated,
        "real": replace(simulated, truth=None),
        "alone": replace(simulated, reference=None),
    }
    (tmp_path / "vehicle.toml").write_text("[dvl]\n")
    said = dict[str, str]()
    for name, dive in logs.items():
        write_dive(tmp_path / f"{name}.mcap", dive)
        for settings in ([], ["-c", str(tmp_path / "vehicle.toml")]):
            output = tmp_path / f"{name}{len(settings)}"
            run_command_line(
                [
                    "run",
                    str(tmp_path / f"{name}.mcap"),
                    "-o",
                    str(output),
                    *ONE_START,
                    *settings,
                    *option,
                ]
            )
            said[output.name] = capsys.readouterr().err
    hint = f"run without {option[0]} first; then use its vehicle.toml with -c"
    assert {name for name, text in said.items() if hint in text} == {"real0", "alone0"}
    assert f"hint: these settings may not fit real: {hint}\n" in said["real0"]
    assert f"; or {hint}\n" in said["alone0"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--against", "dvl.scale=1.0"], "--against dvl.scale=1.0: is the setting already"),
        (["--against", "dvl.scle=1.1"], "--against dvl.scle=1.1: key 'dvl.scle' is not known"),
        (["--against", "dvl.scale"], "hint: for example --against dvl.scale=1.01"),
        (
            ["--set", "dvl.beam_sd_mps=0.01", "--against", "dvl.velocity_sd_mps=0.006"],
            "has no effect, since dvl.beam_sd_mps = 0.01 decides",
        ),
        (["--against", "dvl.scale=1.2"], "with other settings: dvl.scale 1.1 -> 1.2"),
        (
            ["--against", "dvl.scale=1.1", "--table", "evidence"],
            "--against: does not work with --table",
        ),
        (["--against", "dvl.scale=1.1", "--fail-on", "five"], "or --fail-on worse"),
        (["--fail-on", "worse"], "--fail-on: works with --against only"),
    ],
)
def test_mistakes_are_found_before_any_replay(
    arguments: list[str], said: str, dives: Path, results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert against(dives, results, *arguments) == 2
    assert said in capsys.readouterr().err
