"""Settings next to dives are found, said and refused where they are not sound; code in them never runs."""

import json
import os
import re
import shutil
import tomllib
from pathlib import Path

import pytest
from in_process import done_here

import insdvl_replay
from insdvl_replay import load_config, replay_log
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.local_settings import (
    place_of_settings,
    settings_sentences,
    with_local_settings,
)
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import Report, decode_report
from insdvl_replay.core.settings_layers import LOCAL_SETTINGS, SettingsLayers
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

VEHICLE = """
[dvl]
scale = {scale}
velocity_sd_mps = 0.004

[noise]
accel_white_mps_rts = 0.005
gyro_white_rad_rts = 1.2e-6

[evaluation]
starts = 1

[filters]
baseline.aiding = ["velocity"]
"""
CODE = '\nmine.program = ["touch", "pwned", "{dive}", "{solution}"]\n'


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("log") / "dive.mcap"
    write_dive(file, simulate_dive("figure-eight", seed=1, duration_s=45.0, imu_rate_hz=50.0))
    return file


@pytest.fixture
def archive(log: Path, tmp_path: Path) -> Path:
    """An archive with a dive, and one in a folder of its own; the settings of both are at the top."""
    for name in ("one.mcap", "tuesday/two.mcap"):
        (tmp_path / "archive" / name).parent.mkdir(exist_ok=True)
        shutil.copy(log, tmp_path / "archive" / name)
    put(tmp_path / "archive", 1.01)
    return tmp_path / "archive"


def put(folder: Path, scale: float, more: str = "") -> Path:
    file = folder / LOCAL_SETTINGS
    file.write_text(VEHICLE.format(scale=scale) + more, "utf-8")
    return file


def report_of(folder: Path) -> Report:
    return decode_report((folder / "report.json").read_bytes())


def found(archive: Path, layers: SettingsLayers = SettingsLayers()) -> list[FoundDive]:
    return with_local_settings(find_dives([str(archive)]), layers)


# --- Which file.


def test_the_nearest_file_counts_and_is_said(
    archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(archive.parent)
    whole = found(archive)
    assert [place_of_settings(dive) for dive in whole] == [LOCAL_SETTINGS, f"../{LOCAL_SETTINGS}"]
    assert settings_sentences(whole) == [f"settings: archive/{LOCAL_SETTINGS}"]
    put(archive / "tuesday", 1.02)
    apart = found(archive)
    assert [place_of_settings(dive) for dive in apart] == [LOCAL_SETTINGS, LOCAL_SETTINGS]
    assert settings_sentences(apart) == [
        f"settings of 1 dive: archive/{LOCAL_SETTINGS}",
        f"settings of 1 dive: archive/tuesday/{LOCAL_SETTINGS}",
    ]
    (archive / LOCAL_SETTINGS).unlink()
    assert settings_sentences(found(archive))[1:] == [f"1 dive without {LOCAL_SETTINGS}"]


def test_what_is_named_beats_it(archive: Path, tmp_path: Path) -> None:
    named = tmp_path / "named.toml"
    named.write_text(VEHICLE.format(scale=1.03), "utf-8")
    assert [dive.settings for dive in found(archive, SettingsLayers(files=[named]))] == [None] * 2
    listed = tmp_path / "dives.toml"
    listed.write_text('[[dive]]\npath = "archive/one.mcap"\nsettings = "named.toml"\n')
    assert [dive.settings for dive in found(listed)] == [named]
    url = FoundDive(archive / "one.mcap", url="https://logs.example/one.mcap")
    assert with_local_settings([url], SettingsLayers()) == [url]


def test_links_are_followed_from_where_a_log_is_named(archive: Path, tmp_path: Path) -> None:
    """A link to a log is a dive of the folder that holds the link, and a link to a folder is that folder."""
    desk = tmp_path / "desk"
    desk.mkdir()
    (desk / "dive.mcap").symlink_to(archive / "one.mcap")
    (desk / "tuesday").symlink_to(archive / "tuesday")
    own = put(desk, 1.04)
    [dive] = found(desk / "dive.mcap")
    assert dive.settings == own.resolve()
    [behind] = found(desk / "tuesday" / "two.mcap")
    assert behind.settings == (archive / LOCAL_SETTINGS).resolve()
    own.unlink()
    own.symlink_to(archive / LOCAL_SETTINGS)
    [linked] = found(desk / "dive.mcap")
    assert linked.settings == own.parent.resolve() / LOCAL_SETTINGS
    assert SettingsLayers().load(linked.settings).dvl.scale == 1.01


# --- Commands and Python.


def test_run_uses_it_in_screen_report_and_python(archive: Path, tmp_path: Path) -> None:
    log = archive / "tuesday" / "two.mcap"
    done = done_here("run", log, "-o", "out", cwd=tmp_path)
    assert done.returncode == 0
    assert f"info: settings: archive/{LOCAL_SETTINGS}\n" in done.stderr
    report = report_of(tmp_path / "out" / "two")
    assert report.config["dvl"]["scale"] == 1.01
    [told] = [note for note in report.notes if note.code == "local_settings"]
    assert told.text.startswith(f"settings: ../{LOCAL_SETTINGS}, ")
    twin = replay_log(log)
    assert twin.report.config["dvl"]["scale"] == 1.01
    assert told in twin.report.notes
    (tmp_path / "named.toml").write_text(VEHICLE.format(scale=1.03), "utf-8")
    for options, scale in (
        (("-c", tmp_path / "named.toml"), 1.03),
        (("--no-config", "--set", "evaluation.starts=1", "--preset", "fog"), 1.0),
        (("--set", "dvl.scale=1.05"), 1.05),
    ):
        done = done_here("run", log, "-o", f"out_{scale}", *options, cwd=tmp_path)
        assert done.returncode == 0
        assert ("settings: " in done.stderr) == (scale == 1.05)
        report = report_of(tmp_path / f"out_{scale}" / "two")
        assert report.config["dvl"]["scale"] == scale
    assert replay_log(log, load_config(preset="fog", settings={"evaluation.starts": 1})).report


def test_several_files_and_a_change(archive: Path, tmp_path: Path) -> None:
    put(archive / "tuesday", 1.02)
    done = done_here("run", archive, "-o", "out", "--against", "dvl.scale=1.1", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr.count("info: settings of 1 dive: archive/") == 2
    for name, scale in (("one", 1.01), ("two", 1.02)):
        assert report_of(tmp_path / "out" / "before" / name).config["dvl"]["scale"] == scale
        assert report_of(tmp_path / "out" / "after" / name).config["dvl"]["scale"] == 1.1
    for command in ("calibrate", "study window"):
        refused = done_here(*command.split(), archive, cwd=tmp_path)
        assert refused.returncode == 2
        assert f"error: {command}: the dives have different settings; hint: " in refused.stderr
    with pytest.raises(ConfigError, match="the dives have different settings"):
        insdvl_replay.calibrate([archive / "one.mcap", archive / "tuesday" / "two.mcap"])


@pytest.mark.nightly
def test_inspect_studies_and_check_use_it(archive: Path, tmp_path: Path) -> None:
    log = archive / "one.mcap"
    for command in (["inspect"], ["study", "observability"], ["study", "window"]):
        said = done_here(*command, log, cwd=tmp_path).stderr
        assert f"info: settings: archive/{LOCAL_SETTINGS}\n" in said, command
        without = done_here(*command, log, "--no-config", "--force", cwd=tmp_path).stderr
        assert "info: settings" not in without
    gates = tmp_path / "gates.toml"
    gates.write_text(
        'dives = ["archive/one.mcap"]\n[[gate]]\nname = "a"\ntable = "outage"\n'
        'column = "drift_median_m"\nmax = 1e9\n'
    )
    done = done_here("check", gates, cwd=tmp_path)
    assert f"info: settings: archive/{LOCAL_SETTINGS}\n" in done.stderr
    assert report_of(tmp_path / "checked" / "one").config["dvl"]["scale"] == 1.01
    results = done_here("check", gates, tmp_path / "checked", cwd=tmp_path)
    assert "info: settings" not in results.stderr, "a result is not replayed"
    text = gates.read_text("utf-8")
    gates.write_text(f'config = "named.toml"\n{text}', "utf-8")
    (tmp_path / "named.toml").write_text(VEHICLE.format(scale=1.03), "utf-8")
    assert "info: settings" not in done_here("check", gates, cwd=tmp_path).stderr
    assert report_of(tmp_path / "checked" / "one").config["dvl"]["scale"] == 1.03


# --- What is refused.


def refused(archive: Path, tmp_path: Path, *options: str) -> str:
    done = done_here("run", archive / "one.mcap", "-o", "out", *options, cwd=tmp_path)
    assert done.returncode == 2
    assert not (tmp_path / "out").exists()
    lines = done.stderr.splitlines()
    assert "Traceback" not in done.stderr
    return lines[-1]


def test_code_in_it_runs_only_where_it_is_named(archive: Path, tmp_path: Path) -> None:
    file = put(archive, 1.0, CODE)
    for options in ((), ("--allow-code",)):
        said = refused(archive, tmp_path, *options)
        assert said.startswith(
            f"error: {file.resolve()}: filters.mine.program names code: touch pwned"
        )
        assert said.endswith(f"name the file: -c {file.resolve()} --allow-code")
    with pytest.raises(ConfigError, match="names code"):
        replay_log(archive / "one.mcap")
    for command in (["inspect"], ["calibrate", "--allow-code"], ["study", "window"]):
        done = done_here(*command, archive / "one.mcap", cwd=tmp_path)
        assert (done.returncode, "names code: touch pwned" in done.stderr) == (2, True)
    assert not list(tmp_path.rglob("pwned"))
    # A setting of one's own replaces what the file says, and a file that is named has the usual rule.
    out = refused(archive, tmp_path, "-c", str(file))
    assert "add --allow-code" in out
    left_out = ("--set", "filters.mine=false")
    done = done_here("run", archive / "one.mcap", "-o", "out", *left_out, cwd=tmp_path)
    assert done.returncode == 0
    named = ("-c", str(file), "--allow-code", "--force")
    assert (
        done_here("run", archive / "one.mcap", "-o", "out", *named, cwd=tmp_path).returncode == 0
    )
    assert list(tmp_path.rglob("pwned"))


def test_one_that_is_not_sound_is_one_sentence(archive: Path, tmp_path: Path) -> None:
    file = archive / LOCAL_SETTINGS
    file.write_text("[dvl\n")
    assert "is not valid TOML" in refused(archive, tmp_path)
    file.write_text("[dvl]\nscle = 1\n")
    assert f"{LOCAL_SETTINGS}: key 'dvl.scle' is not known; hint: did you" in refused(
        archive, tmp_path
    )
    file.write_text('[[gate]]\nname = "a"\n')
    assert "holds gates, not settings" in refused(archive, tmp_path)
    file.write_bytes(b"\xff\xfe")
    assert "is not UTF-8 text" in refused(archive, tmp_path)
    file.unlink()
    file.symlink_to("nowhere")
    assert "cannot be read: No such file" in refused(archive, tmp_path)
    file.unlink()
    file.symlink_to(file)
    assert "cannot be read: Too many levels of symbolic links" in refused(archive, tmp_path)
    file.unlink()
    os.mkfifo(file)
    assert refused(archive, tmp_path).endswith("or use none with --no-config")
    file.unlink()
    file.mkdir()
    said = refused(archive, tmp_path)
    assert said.startswith(f"error: {file.resolve()}: is no regular file; hint: ")
    done = done_here("run", archive / "one.mcap", "-o", "out", "--no-config", cwd=tmp_path)
    assert done.returncode == 0


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_one_that_may_not_be_read_is_one_sentence(archive: Path, tmp_path: Path) -> None:
    (archive / LOCAL_SETTINGS).chmod(0)
    assert "cannot be read: Permission denied" in refused(archive, tmp_path)


# --- For editors.


def test_files_of_settings_name_their_schema_for_editors(log: Path, tmp_path: Path) -> None:
    line = "#:schema ./insdvl-replay.schema.json"
    said = done_here("schema", "config", "--toml", cwd=tmp_path).stdout
    assert said.startswith(f"{line}\n")
    assert tomllib.loads(said) == {}
    [command] = re.findall(r"#   insdvl-replay (.*) > insdvl-replay.schema.json", said)
    schema = done_here(*command.split(), cwd=tmp_path).stdout
    assert json.loads(schema)["title"] == "insdvl-replay configuration"
    put(tmp_path, 1.0)
    # The schema next to a dive is no dive.
    shutil.copy(log, tmp_path / "dive.mcap")
    (tmp_path / "insdvl-replay.schema.json").write_text(schema)
    assert [dive.path.name for dive in find_dives([str(tmp_path)])] == ["dive.mcap"]
    assert done_here("config", cwd=tmp_path).stdout.startswith(f"{line}\n")
    done_here("calibrate", "dive.mcap", "--only", "noise", "-o", "c.toml", cwd=tmp_path)
    done_here("inspect", "dive.mcap", "--propose", "p.toml", cwd=tmp_path)
    done_here("run", "dive.mcap", "--no-config", "--starts", "1", cwd=tmp_path)
    for file in ("c.toml", "p.toml", "replay/dive/vehicle.toml"):
        text = (tmp_path / file).read_text("utf-8")
        assert text.startswith(f"{line}\n"), file
        assert text.count(line) == 1
        load_config(tmp_path / file)
    other = done_here("schema", "report", "--toml", cwd=tmp_path)
    assert (other.returncode, "hint: `insdvl-replay schema config --toml`" in other.stderr) == (
        2,
        True,
    )
