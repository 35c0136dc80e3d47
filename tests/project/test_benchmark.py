"""docs/benchmark.md is what the program finds on the public dives."""

import hashlib
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import benchmark
import pytest

from insdvl_replay import read_result
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import Report
from insdvl_replay.logs import write_dive
from insdvl_replay.results.stored_results import read_one_result
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.all_starts
PLACE = benchmark.Place()
VELOCITY = 'aiding = ["velocity"]'
ACCELERATION = 'aiding = ["velocity", "acceleration"]\nacceleration = { model = "MODEL", window = 3, sd_mps2 = 0.103 }'
NOISE = """
[dvl]
beam_sd_mps = 0.006
[noise]
accel_white_mps_rts = 0.005
gyro_white_rad_rts = 1.2e-6
[initial]
accel_bias_sd_mg = 0.1
"""
CANDIDATES = {
    "published": ACCELERATION.replace("MODEL", "published"),
    "windowed_fitted": ACCELERATION.replace("MODEL", "windowed"),
    "with_depth": 'aiding = ["velocity", "depth"]',
    "planted_copy": VELOCITY,
    "planted_worse": f"{VELOCITY}\nvelocity_sd_mps = 5.0",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> benchmark.Place:
    """A benchmark of two simulated dives in two data sets; a third dive is nowhere."""
    folder = tmp_path_factory.mktemp("benchmark")
    place = benchmark.Place(folder / "public", folder / "build", folder / "data")
    for part in (place.public / "candidates", place.public / "settings", place.data):
        part.mkdir(parents=True)
    entries = []
    for seed, name in enumerate(("one", "two")):
        write_dive(
            place.data / f"{name}.mcap", simulate_dive("figure-eight", seed=seed, duration_s=60.0)
        )
        entries.append(
            (
                hashlib.sha256((place.data / f"{name}.mcap").read_bytes()).hexdigest(),
                f"set_{name}",
                name,
            )
        )
    entries.append(("0" * 64, "set_two", "three"))
    (place.public / "dives.toml").write_text(
        "".join(
            f'[[dive]]\npath = "{name}.mcap"\nsha256 = "{digest}"\n'
            f'settings = "settings/vehicle.toml"\ntags = ["{data_set}", "{name}"]\n'
            for digest, data_set, name in entries
        )
    )
    (place.public / "settings" / "vehicle.toml").write_text(
        f"{NOISE}\n[filters.baseline]\n{VELOCITY}\n"
    )
    for name, text in CANDIDATES.items():
        (place.public / "candidates" / f"{name}.toml").write_text(f"[filters.{name}]\n{text}\n")
    return place


@pytest.fixture(scope="module")
def cells(place: benchmark.Place) -> list[benchmark.Cell]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "JOBS", 1)
        return benchmark.build(place)


def page_of(cells: list[benchmark.Cell], place: benchmark.Place) -> str:
    return benchmark.written(benchmark.PAGE.read_text("utf-8"), cells, place.dives)


def rows_of(page: str) -> list[list[str]]:
    """The rows of all cells, as lists of texts."""
    lines = [
        line.strip("| ").split(" | ") for line in page.splitlines() if "`insdvl-replay run" in line
    ]
    return [[text.strip() for text in line] for line in lines]


def test_rows_are_those_of_the_results(
    cells: list[benchmark.Cell], place: benchmark.Place
) -> None:
    evidence = read_result(place.build / "planted_worse" / "set_one" / "one").tables["evidence"]
    (cell,) = (
        cell for cell in cells if (cell.candidate, cell.data_set) == ("planted_worse", "set_one")
    )
    row = evidence[evidence["quantity"] == cell.rows[0].quantity].iloc[0]
    shown = next(
        row
        for row in rows_of(page_of(cells, place))
        if "-c candidates/planted_worse.toml" in row[-1] and "#set_one" in row[-1]
    )
    assert float(shown[2]) == pytest.approx(row["ratio"], rel=0.01)
    assert shown[5:8] == ["1 dive", "undecided", "-"], "one dive has no verdict"
    assert shown[-2] == f"`{cell.digest}`"


def test_a_second_build_replays_nothing_and_gives_the_same_bytes(
    cells: list[benchmark.Cell], place: benchmark.Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "JOBS", 1)
    written = {file: file.stat().st_mtime_ns for file in place.build.rglob("report.json")}
    again = benchmark.build(place)
    assert len(written) == 8
    assert {file: file.stat().st_mtime_ns for file in written} == written
    assert page_of(again, place) == page_of(cells, place)
    assert benchmark.picture(benchmark.by_data_set(again)) == benchmark.picture(
        benchmark.by_data_set(cells)
    )
    assert str(place.build.parent) not in page_of(cells, place)
    assert "| set_one | one | no link | unknown | unknown |" in page_of(cells, place)


def test_the_command_of_a_cell_repeats_it(
    cells: list[benchmark.Cell], place: benchmark.Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    (cell,) = (
        cell for cell in cells if (cell.candidate, cell.data_set) == ("windowed_fitted", "set_one")
    )
    shutil.copy(place.data / "one.mcap", place.public)
    monkeypatch.chdir(place.public)
    assert cell.variables == ""
    program, *arguments = cell.command.split()
    assert program == "insdvl-replay"
    assert (
        run_command_line([*arguments, "--output", str(place.build.parent / "again"), "--quiet"])
        == 0
    )
    _, report = read_one_result(place.build.parent / "again", Report)
    again = replace(cell, reports={"one": report})
    assert (again.digest, again.rows) == (cell.digest, cell.rows)


def test_missing_cells_have_a_reason(cells: list[benchmark.Cell], place: benchmark.Place) -> None:
    page = page_of(cells, place)
    reasons = {(row[0], row[-1].partition("#")[2][:7]): row[-3] for row in rows_of(page)}
    assert all(
        "depth" in reasons["`with_depth`", data_set] for data_set in ("", "set_one", "set_two")
    )
    nowhere = "its log is not published in this form"
    assert (
        reasons["`windowed_fitted`", "set_two"]
        == f"not evaluated on 1 of 2 dives (three): {nowhere}"
    )
    assert reasons["`published`", ""].endswith(f"not evaluated on 1 of 3 dives: {nowhere}")


@pytest.mark.parametrize("candidates", ["windowed_fitted", "*"])
def test_rows_of_one_filter_or_of_fewer_dives_are_printed_and_the_page_stays(
    candidates: str,
    cells: list[benchmark.Cell],
    place: benchmark.Place,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "page.md"
    page.write_text(page_of(cells, place).replace("`published`", "`another`"))
    monkeypatch.setattr(benchmark, "JOBS", 1)
    monkeypatch.setattr(benchmark, "PAGE", page)
    monkeypatch.setattr(benchmark, "QUOTING", ())
    monkeypatch.setattr(benchmark, "Place", partial(replace, place))
    monkeypatch.setattr(benchmark, "prepare", lambda place: None)
    before = page.read_bytes()
    benchmark.main(candidates)
    said = capsys.readouterr().out
    assert {row[0] for row in rows_of(said)} == {
        "`windowed_fitted`" if candidates != "*" else "`published`"
    }
    assert len(rows_of(said)) == 3
    assert "The page stays as it is, since 1 dive of it cannot be had: three." in said
    assert page.read_bytes() == before


def test_dives_with_one_name_and_files_with_another_filter_are_refused(
    place: benchmark.Place, tmp_path: Path
) -> None:
    again = replace(place, public=shutil.copytree(place.public, tmp_path / "public"))
    candidates = again.public / "candidates"
    (candidates / "windowed_fitted.toml").rename(candidates / "mine.toml")
    cells = benchmark.build(replace(again, candidates="mine"))
    assert {reason for cell in cells for reason in cell.reasons.values()} >= {
        "candidates/mine.toml has no filter mine; file and filter must have the same name"
    }
    dives = again.public / "dives.toml"
    dives.write_text(dives.read_text().replace('"two"]', '"one"]'))
    with pytest.raises(ConfigError, match="more than one dive has the name one"):
        benchmark.build(again)


def test_reasons_are_plain() -> None:
    assert (
        benchmark.plain_reason(f"one: {benchmark.PROJECT}/docs is a folder", "one")
        == "docs is a folder"
    )
    of_class = "my:Net: readings(self, dive) fails in line 4 of examples/my.py: ValueError: the DVL has no single beams"
    of_filter = "filters.mine is aided by beams, but the DVL has velocities only"
    assert benchmark.plain_reason(of_class, "one") == benchmark.plain_reason(of_filter, "one")
    assert (
        benchmark.plain_reason(of_filter, "one") == "the DVL gives no velocity along single beams"
    )


def test_planted_candidates_come_out_as_they_must(
    cells: list[benchmark.Cell], place: benchmark.Place
) -> None:
    """A copy is proved to be one on a single dive, and of two dives the worst filter is only the last."""
    verdicts = {(cell.candidate, cell.data_set): cell.verdict for cell in cells if cell.answer}
    assert {verdicts["planted_copy", name] for name in ("set_one", "set_two", benchmark.ALL)} == {
        "no effect"
    }
    for ranked in benchmark.by_data_set(cells).values():
        assert [cell.candidate for cell in ranked if cell.answer][-1] == "planted_worse"
    copies = [row for row in rows_of(page_of(cells, place)) if row[0] == "`planted_copy`"]
    assert [row[6:8] for row in copies] == [["no effect", "yes"]] * 3


# --- What is committed.


def test_each_dive_is_named_and_its_settings_and_candidates_are_valid() -> None:
    for dive in PLACE.dives:
        assert len(dive["tags"]) == 2
        assert dive["licence"]
        assert dive["faults"]
        assert "path" in dive or re.match(
            r"https://raw\.githubusercontent\.com/[^/]+/[^/]+/[0-9a-f]{40}/", dive["url"]
        )
        for candidate in sorted((PLACE.public / "candidates").rglob("*.toml")):
            if candidate.parent.name in ("candidates", dive["tags"][0]):
                config = load_config(
                    file=[PLACE.public / dive["settings"], candidate], allow_code=True
                )
                assert [*config.filters] == ["baseline", candidate.stem]


def test_the_page_is_small_and_names_no_machine() -> None:
    page = benchmark.PAGE.read_bytes() + benchmark.PICTURE.read_bytes()
    assert len(page) < 200_000
    assert b"raw.githubusercontent.com" in page


@pytest.mark.nightly
def test_the_page_is_what_the_program_writes(snapir: Path) -> None:
    if shutil.which("c++") is None:
        pytest.skip("needs a compiler of C++")
    assert snapir.parent == PLACE.data
    benchmark.prepare(PLACE)
    cells = benchmark.build(PLACE)
    assert page_of(cells, PLACE) == benchmark.PAGE.read_text("utf-8"), "run `make benchmark`"
    candidates = benchmark.by_data_set(
        cell for cell in cells if cell.candidate not in benchmark.WORDS["planted"]
    )
    assert benchmark.picture(candidates) == benchmark.PICTURE.read_bytes(), "run `make benchmark`"
    for page in benchmark.QUOTING:
        assert benchmark.quote(candidates) in page.read_text("utf-8"), "run `make benchmark`"
