"""Manifests: dives by path and by URL, with digests that must be right; a log that was fetched is not fetched again."""

import hashlib
import json
from pathlib import Path

import pytest
from remote_server import manifest
from small_logs import simulated

from insdvl_replay.batch.dive_paths import find_dives, shared_settings, usable_paths
from insdvl_replay.batch.manifest import fetch_dives
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs.formats.recording import open_recording

LOG = simulated()
SHA256 = hashlib.sha256(LOG).hexdigest()
WRONG = "0" * 64
pytestmark = pytest.mark.usefixtures("cache")


def found_paths(*names: str) -> list[Path]:
    return usable_paths(fetch_dives(find_dives(names)))


def test_paths_are_relative_to_the_manifest_and_chosen_by_tag(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
    listed = manifest(
        tmp_path,
        f'path = "a.mcap"\nsha256 = "{SHA256}"\nlicence = "CC-BY-4.0"\ntags = ["deep", "calm"]',
        'path = "b.mcap"\ntags = ["calm"]',
    )
    assert [path.name for path in found_paths(listed)] == ["a.mcap", "b.mcap"]
    assert [path.name for path in found_paths(f"{listed}#deep")] == ["a.mcap"]
    with pytest.raises(ConfigError, match="no dive has the tag 'windy'") as raised:
        find_dives([f"{listed}#windy"])
    assert raised.value.hint == "its tags are calm, deep"


def test_a_folder_has_the_digest_of_its_report(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.mcap").write_bytes(LOG)
    digest = open_recording(folder).sha256()
    assert found_paths(manifest(tmp_path, f'path = "dive"\nsha256 = "{digest}"')) == [folder]
    with pytest.raises(LogError, match=digest):
        found_paths(manifest(tmp_path, f'path = "dive"\nsha256 = "{WRONG}"'))


@pytest.mark.parametrize(
    "line",
    [
        'path = "a"\nurl = "b"',
        'url = "https://x/y.mcap"',
        "tags = []",
        'sha256 = "abc"',
        "x = 1",
        f'url = "dive.mcap"\nsha256 = "{WRONG}"',
        f'url = "http://[bad/"\nsha256 = "{WRONG}"',
        f'files = [{{ name = "a.mcap", url = "file:///a.mcap", sha256 = "{WRONG}" }}]',
        'path = "dive"\nfiles = [{ name = "a.mcap", url = "file:///a.mcap" }]',
        f'path = "dive"\nfiles = [{{ name = "../a.mcap", url = "file:///a.mcap", sha256 = "{WRONG}" }}]',
        f'path = "dive"\nfiles = [{{ name = "a.mcap", url = "a.mcap", sha256 = "{WRONG}" }}]',
        f'path = "dive"\nsha256 = "{WRONG}"\nfiles = [{{ name = "a", url = "file:///a", sha256 = "{WRONG}" }}]',
    ],
)
def test_a_wrong_entry_is_a_wrong_setting(tmp_path: Path, line: str) -> None:
    with pytest.raises(ConfigError, match=r"dives\.toml"):
        find_dives([manifest(tmp_path, line)])


def test_a_wrong_digest_ends_with_3_and_stops_no_other_dive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
    listed = manifest(
        tmp_path, f'path = "a.mcap"\nsha256 = "{WRONG}"', 'path = "b.mcap"', 'path = "c.mcap"'
    )
    assert run_command_line(["run", listed, "-o", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert f"its SHA-256 is {SHA256}" in said
    assert "2 of 3 logs failed: a, c" in said
    assert (tmp_path / "out" / "b" / "report.json").is_file()
    # A result that was there is not taken for one of the right log.
    assert run_command_line(["run", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "other")]) == 0
    listed = manifest(tmp_path, f'path = "a.mcap"\nsha256 = "{WRONG}"')
    assert run_command_line(["run", listed, "-o", str(tmp_path / "other")]) == 3


def test_each_dive_has_its_own_settings_below_those_of_c(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
        (tmp_path / f"{name}.toml").write_text("[dvl]\nscale = 1.01\nlatency_s = 0.02\n")
    (tmp_path / "b.toml").write_text("[dvl]\nscale = 1.02\n")
    (tmp_path / "c.toml").write_text("[dvl]\nlatency_s = 0.03\n")
    listed = manifest(
        tmp_path, *(f'path = "{name}.mcap"\nsettings = "{name}.toml"' for name in "ab")
    )
    command = [
        "run",
        listed,
        "-c",
        str(tmp_path / "c.toml"),
        "--starts",
        "2",
        "-q",
        "-o",
        str(tmp_path / "out"),
    ]
    assert run_command_line(command) == 0
    used = [
        json.loads((tmp_path / "out" / name / "report.json").read_bytes())["config"]
        for name in "ab"
    ]
    assert [(config["dvl"]["scale"], config["dvl"]["latency_s"]) for config in used] == [
        (1.01, 0.03),
        (1.02, 0.03),
    ]
    assert [config["evaluation"]["starts"] for config in used] == [2, 2]
    with pytest.raises(ConfigError, match="the dives have different settings"):
        shared_settings(find_dives([listed]), "calibrate")
    assert run_command_line(["calibrate", listed]) == 2


def test_the_vehicle_of_a_dive_is_that_of_its_manifest_else_of_its_settings(
    tmp_path: Path,
) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
    (tmp_path / "own.toml").write_text('[vehicle]\nname = "of settings"\n')
    listed = manifest(
        tmp_path,
        'path = "a.mcap"\nvehicle = "of manifest"\nsettings = "own.toml"',
        'path = "b.mcap"\nsettings = "own.toml"',
        'path = "c.mcap"',
    )
    output = tmp_path / "out"
    command = ["run", listed, "-o", str(output), "--starts", "1", "--no-auto"]
    assert run_command_line(command) == 0
    reports = {
        name: json.loads((output / name / "report.json").read_text()) for name in ("a", "b", "c")
    }
    vehicles = {name: report["vehicle"] for name, report in reports.items()}
    assert vehicles == {"a": "of manifest", "b": "of settings", "c": ""}
    assert reports["a"]["config"]["vehicle"] == {"name": "of manifest"}
    assert run_command_line(command) == 0
    again = json.loads((output / "a" / "report.json").read_text())
    assert again["tool"]["started_at"] == reports["a"]["tool"]["started_at"], (
        "the same vehicle is no other setting"
    )


def test_the_files_of_a_dive_are_fetched_into_one_folder(tmp_path: Path, cache: Path) -> None:
    """A folder next to the manifest is used instead, if it has these files and no others."""
    from_elsewhere = tmp_path / "elsewhere"
    from_elsewhere.mkdir()
    entry = 'path = "dive"\nfiles = [\n'
    for number, name in enumerate(("imu", "dvl")):
        (from_elsewhere / f"{name}_1.csv").write_text(f"table {number}\n")
        digest = hashlib.sha256(f"table {number}\n".encode()).hexdigest()
        url = (from_elsewhere / f"{name}_1.csv").as_uri()
        entry += f'  {{ name = "{name}.csv", url = "{url}", sha256 = "{digest}" }},\n'
    listed = manifest(tmp_path, f"{entry}]")
    (folder,) = found_paths(listed)
    assert folder.name == "dive"
    assert cache in folder.parents
    texts = {file.name: file.read_text() for file in folder.iterdir()}
    assert texts == {"imu.csv": "table 0\n", "dvl.csv": "table 1\n"}
    (folder / "dvl.csv").write_text("changed\n")
    assert found_paths(listed) == [folder]
    assert (folder / "dvl.csv").read_text() == "table 1\n"

    own = tmp_path / "dive"
    own.mkdir()
    with pytest.raises(LogError, match=r"the SHA-256 of imu\.csv is missing"):
        found_paths(listed)
    for name in ("imu", "dvl"):
        (own / f"{name}.csv").write_bytes((folder / f"{name}.csv").read_bytes())
    assert found_paths(listed) == [own]
    (own / "more.csv").write_text("")
    with pytest.raises(LogError, match=r"has more\.csv, which the manifest does not list"):
        found_paths(listed)


def test_commands_know_a_dive_of_files_by_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log_7.mcap").write_bytes(LOG)
    url = (tmp_path / "log_7.mcap").as_uri()
    entry = f'path = "seven"\nfiles = [{{ name = "x.mcap", url = "{url}", sha256 = "{SHA256}" }}]'
    listed = manifest(tmp_path, entry)
    assert run_command_line(["inspect", listed]) == 0
    assert capsys.readouterr().out.startswith("seven can be replayed")
    output = tmp_path / "out"
    assert run_command_line(["run", listed, "-o", str(output), "--starts", "1", "-q"]) == 0
    assert (output / "seven" / "report.json").is_file()


def test_a_dive_whose_file_has_another_digest_stops_no_other_dive(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(LOG)
    url = (tmp_path / "a.mcap").as_uri()
    listed = manifest(
        tmp_path,
        f'path = "dive"\nfiles = [{{ name = "x.mcap", url = "{url}", sha256 = "{WRONG}" }}]',
        'path = "b.mcap"',
    )
    lost, found = fetch_dives(find_dives([listed]))
    assert lost.error is not None
    assert SHA256 in lost.error.message
    assert found.error is None


def test_settings_that_are_not_there_end_with_2(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(LOG)
    listed = manifest(tmp_path, 'path = "a.mcap"\nsettings = "none.toml"')
    assert run_command_line(["run", listed, "-o", str(tmp_path / "out")]) == 2


def test_a_dive_is_listed_once(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(LOG)
    one, other = 'path = "a.mcap"', 'path = "a.mcap"\nsettings = "v.toml"'
    assert len(find_dives([manifest(tmp_path, one, one)])) == 1
    with pytest.raises(ConfigError, match="is listed twice, with different settings"):
        find_dives([manifest(tmp_path, one, other)])
    (tmp_path / "dives.toml").write_text("dive = []")
    with pytest.raises(ConfigError, match="lists no dives"):
        find_dives([str(tmp_path / "dives.toml")])


def test_a_change_that_no_dive_heeds_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in (
        ("a", "beam_sd_mps = 0.01"),
        ("b", "velocity_sd_mps = 0.02\nbeam_sd_mps = 0.01"),
    ):
        (tmp_path / f"{name}.mcap").write_bytes(LOG)
        (tmp_path / f"{name}.toml").write_text(f"[dvl]\n{text}\n")
    listed = manifest(
        tmp_path, *(f'path = "{name}.mcap"\nsettings = "{name}.toml"' for name in "ab")
    )
    for change, said in (
        ("velocity_sd_mps=0.5", "has no effect"),
        ("beam_sd_mps=0.01", "is the setting already"),
    ):
        assert (
            run_command_line(
                ["run", listed, "--against", f"dvl.{change}", "-o", str(tmp_path / "out")]
            )
            == 2
        )
        assert said in capsys.readouterr().err
