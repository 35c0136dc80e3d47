"""docs/benchmark.md is what the program finds on the public dives."""

import hashlib
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import benchmark
import benchmark_cells
import benchmark_page
import pytest
from benchmark_cells import Cell, joined_reasons, plain_reason
from benchmark_details import checks
from benchmark_dives import Place, name_of
from benchmark_finding import quote
from benchmark_page import Footnotes, by_data_set, cell_text, interval_bar
from benchmark_settings import settings_of_dives, settings_text
from written import PROJECT

from insdvl_replay import read_result
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import PooledRow
from insdvl_replay.logs import write_dive
from insdvl_replay.results.stored_results import read_one_result
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.all_starts
PLACE = Place()
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
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A benchmark of two simulated dives in two data sets; two other dives are nowhere, one of them in a third set."""
    folder = tmp_path_factory.mktemp("benchmark")
    place = Place(folder / "public", folder / "build", folder / "data")
    for part in (place.public / "candidates", place.public / "settings", place.data):
        part.mkdir(parents=True)
    entries = []
    for seed, name in enumerate(("one", "two")):
        log = place.data / f"{name}.mcap"
        write_dive(log, simulate_dive("figure-eight", seed=seed, duration_s=60.0))
        digest = hashlib.sha256(log.read_bytes()).hexdigest()
        entries.append((digest, f"set_{name}", name))
    entries.append(("0" * 64, "set_two", "three"))
    entries.append(("1" * 64, "set_three", "four"))
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
def cells(place: Place) -> list[Cell]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark_cells, "JOBS", 1)
        return benchmark_cells.build(place)


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: Place) -> Iterator[Path]:
    """A folder with copies of all pages that the command writes; its benchmark is the small one."""
    folder = tmp_path / "docs"
    folder.mkdir()
    for file in (benchmark.PAGE, benchmark.DOCS / benchmark_page.DETAILS, *benchmark.QUOTING):
        shutil.copy(file, folder / file.name)
    shutil.copy(benchmark.QUOTING_ASSAY, folder)
    monkeypatch.setattr(benchmark_cells, "JOBS", 1)
    monkeypatch.setattr(benchmark, "PAGE", folder / benchmark.PAGE.name)
    quoting = tuple(folder / file.name for file in benchmark.QUOTING)
    monkeypatch.setattr(benchmark, "QUOTING", quoting)
    monkeypatch.setattr(benchmark, "QUOTING_ASSAY", folder / benchmark.QUOTING_ASSAY.name)
    monkeypatch.setattr(benchmark, "Place", partial(replace, place))
    monkeypatch.setattr(benchmark, "prepare", lambda place: None)
    yield folder
    shutil.rmtree(place.build / "pages", ignore_errors=True)


def page_of(cells: list[Cell]) -> str:
    text = benchmark.PAGE.read_text("utf-8")
    return benchmark.page_text(text, by_data_set(cells), "2026-01-01, 00000000")


def details_of(cells: list[Cell], place: Place) -> str:
    text = (benchmark.DOCS / benchmark_page.DETAILS).read_text("utf-8")
    return benchmark.details_text(text, by_data_set(cells), place)


def cell_of(cells: list[Cell], candidate: str, data_set: str) -> Cell:
    (found,) = (cell for cell in cells if (cell.candidate, cell.data_set) == (candidate, data_set))
    return found


def matrix_rows(page: str) -> dict[str, list[str]]:
    """The cells of each filter."""
    rows = {}
    for line in page.partition("<!-- matrix")[2].partition("<!-- end of matrix")[0].splitlines():
        name, *texts = (text.strip() for text in line.strip("|").split("|"))
        if name.startswith("`"):
            rows[name.strip("`")] = texts
    return rows


@pytest.mark.nightly
def test_a_cell_has_ratio_word_and_link_of_its_results(cells: list[Cell], place: Place) -> None:
    evidence = read_result(place.build / "published" / "set_one" / "one").tables["evidence"]
    cell = cell_of(cells, "published", "set_one")
    assert cell.decisive is not None
    row = evidence[evidence["quantity"] == cell.decisive.quantity].iloc[0]
    shown = matrix_rows(page_of(cells))["published"][0]
    number, link = re.match(r"\[([\d.]+)\]\(benchmark_details\.md#(.*?)\)", shown).groups()  # type: ignore[union-attr]
    assert float(number) == pytest.approx(row["ratio"], abs=0.006)
    assert "acts" in shown
    details = details_of(cells, place)
    section = details.partition(f"### {link.replace('-', ' ', 1)}\n")[2].partition("###")[0]
    assert f"`{cell.digest}`" in section
    assert f"$ {cell.command}\n" in section


def test_an_empty_cell_has_a_footnote_that_is_written_once(cells: list[Cell]) -> None:
    page = page_of(cells)
    rows = matrix_rows(page)
    assert list(rows) == ["published", "windowed_fitted", "with_depth"]
    assert len(rows["with_depth"]) == 2
    assert all(re.fullmatch("[¹²]( [¹²])?", text) for text in rows["with_depth"])
    assert page.count("the log has no topic of a known type for the depth.") == 1
    assert "| missing" not in page


def test_a_data_set_without_evidence_is_one_line_with_its_reason(cells: list[Cell]) -> None:
    page = page_of(cells)
    line = "- [set_three](benchmark_details.md#set_three), 1 dive: its log is not published in this form"
    assert page.count(line) == 1
    assert "set_three" not in page.partition("<!-- matrix")[2].partition("\n| ---")[0]


def test_a_second_build_replays_nothing_and_gives_the_same_bytes(
    cells: list[Cell], place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark_cells, "JOBS", 1)
    written = {file: file.stat().st_mtime_ns for file in place.build.rglob("report.json")}
    again = benchmark_cells.build(place)
    assert len(written) == 8
    assert {file: file.stat().st_mtime_ns for file in written} == written
    texts = page_of(cells) + details_of(cells, place)
    assert page_of(again) + details_of(again, place) == texts
    sets = by_data_set(cells)
    assert benchmark.picture(by_data_set(again)) == benchmark.picture(sets)
    assert str(place.build.parent) not in texts
    assert "| set_one | one | no link | unknown | unknown |" in texts


def test_the_command_of_a_cell_repeats_it(
    cells: list[Cell], place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = cell_of(cells, "windowed_fitted", "set_one")
    shutil.copy(place.data / "one.mcap", place.public)
    monkeypatch.chdir(place.public)
    assert cell.variables == ""
    program, *arguments = cell.command.split()
    assert program == "insdvl-replay"
    output = place.build.parent / "again"
    assert run_command_line([*arguments, "--output", str(output), "--quiet"]) == 0
    _, report = read_one_result(output, Report)
    again = replace(cell, reports={"one": report})
    assert (again.digest, again.rows) == (cell.digest, cell.rows)


def test_of_one_filter_the_details_are_printed_and_the_pages_stay(
    pages: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.read_bytes() for file in pages.iterdir()}
    benchmark.main("windowed_fitted")
    said = capsys.readouterr().out
    assert said.count("### set_one windowed_fitted") == 1
    assert "published" not in said.replace("its log is not published", "")
    assert {file: file.read_bytes() for file in pages.iterdir()} == before


def test_where_dives_are_missing_the_pages_of_the_others_are_in_the_build_folder(
    cells: list[Cell], pages: Path, place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {file: file.read_bytes() for file in pages.iterdir()}
    benchmark.main()
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "missing: three: its log is not published in this form"
    assert said[1].startswith("missing: four: ")
    assert said[2].startswith("The pages of 2 dives are in ")
    assert {file: file.read_bytes() for file in pages.iterdir()} == before
    made = (place.build / "pages" / "benchmark.md").read_text("utf-8")
    assert matrix_rows(made) == matrix_rows(page_of(cells))


def test_date_and_commit_stay_where_nothing_else_is_new(
    cells: list[Cell], pages: Path, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = pages / "benchmark.md"
    sets = by_data_set(cells)
    monkeypatch.setattr(benchmark, "stamp", lambda: "2026-01-01, 11111111")
    benchmark.write_pages(sets, place, pages)
    first = page.read_bytes()
    assert b"2026-01-01, 11111111" in first
    monkeypatch.setattr(benchmark, "stamp", lambda: "2026-02-02, 22222222")
    benchmark.write_pages(sets, place, pages)
    assert page.read_bytes() == first
    page.write_text(page.read_text("utf-8").replace("acts", "moves"), "utf-8")
    benchmark.write_pages(sets, place, pages)
    assert b"2026-02-02, 22222222" in page.read_bytes()


def test_quotes_are_written_into_other_pages(cells: list[Cell], pages: Path) -> None:
    sets = by_data_set(cells)
    benchmark.write_quotes(sets)
    said = quote(sets)
    assert said.startswith("- On one dive of set_one, the published update is ")
    for name in ("README.md", "reproduction.md"):
        assert said in (pages / name).read_text("utf-8")
    assert "| `gyro_noise_x3` |" in (pages / "verdict.md").read_text("utf-8")


def test_dives_with_one_name_and_files_with_another_filter_are_refused(
    place: Place, tmp_path: Path
) -> None:
    again = replace(place, public=shutil.copytree(place.public, tmp_path / "public"))
    candidates = again.public / "candidates"
    (candidates / "windowed_fitted.toml").rename(candidates / "mine.toml")
    cells = benchmark_cells.build(replace(again, candidates="mine"))
    assert {reason for cell in cells for reason in cell.errors.values()} >= {
        "candidates/mine.toml has no filter mine; file and filter must have the same name"
    }
    dives = again.public / "dives.toml"
    dives.write_text(dives.read_text().replace('"two"]', '"one"]'))
    with pytest.raises(ConfigError, match="more than one dive has the name one"):
        benchmark_cells.build(again)


def test_tables_are_known_by_their_digests_under_any_name(tmp_path: Path) -> None:
    """They are put into the folder of the dive, under the names of the manifest."""
    place = Place(tmp_path / "public", tmp_path / "build", tmp_path / "data")
    place.public.mkdir()
    place.data.mkdir()
    files = []
    for name in ("imu", "dvl"):
        (place.data / f"{name}_trajectory7.csv").write_text(f"{name}\n")
        digest = hashlib.sha256(f"{name}\n".encode()).hexdigest()
        url = f"https://nowhere.invalid/{name}_7.csv"
        files.append(f'{{ name = "{name}.csv", url = "{url}", sha256 = "{digest}" }}')
    (place.public / "dives.toml").write_text(
        f'[[dive]]\npath = "data/seven"\nfiles = [{", ".join(files)}]\ntags = ["vehicle", "seven"]\n'
    )
    folder = place.logs["seven"]
    assert folder == place.build / "dives" / "seven"
    assert {file.name: file.read_text() for file in folder.iterdir()} == {
        "imu.csv": "imu\n",
        "dvl.csv": "dvl\n",
    }
    assert not place.missing


def test_reasons_are_plain() -> None:
    folder = PROJECT
    assert plain_reason(f"one: {folder}/docs is a folder", "one") == "docs is a folder"
    of_class = "my:Net: readings(self, dive) fails in line 4 of examples/my.py: ValueError: the DVL has no single beams"
    of_filter = "filters.mine is aided by beams, but the DVL has velocities only"
    assert plain_reason(of_class, "one") == plain_reason(of_filter, "one")
    assert plain_reason(of_filter, "one") == "the DVL gives no velocity along single beams"


def test_reasons_that_differ_in_a_number_are_one() -> None:
    said = "too short for the outage test (needs 160 s, has {} s)"
    reasons = {said.format(25): ["a"], said.format(23): ["b"], "no reference": ["c"]}
    assert joined_reasons(reasons) == {said.format("23 to 25"): ["a", "b"], "no reference": ["c"]}


def row_with(ratio: float, low: float | None, high: float | None) -> PooledRow:
    empty = dict.fromkeys(PooledRow.__struct_fields__)
    return PooledRow(**{**empty, "ratio": ratio, "low": low, "high": high})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("row", "bar"),
    [
        (row_with(1.0, 0.99, 1.02), "·······●·······"),
        (row_with(1.0, 0.93, 1.07), "······━●━······"),
        (row_with(1.5, None, None), "·······│···●···"),
        (row_with(0.7, 0.6, 0.8), "··━●━━·│·······"),
        (row_with(24.0, 9.8, 60.0), "·······│······●"),
        (row_with(1.3, 0.4, 4.0), "━━━━━━━━━━●━━━━"),
    ],
)
def test_the_character_in_the_middle_of_a_bar_is_the_band(row: PooledRow, bar: str) -> None:
    assert interval_bar(row) == bar


def test_a_cell_names_a_quantity_that_is_not_that_of_the_others(cells: list[Cell]) -> None:
    cell = cell_of(cells, "published", "set_one")
    assert cell.decisive is not None
    assert "position" not in cell_text(cell, cell.decisive.quantity, Footnotes())
    assert ", position" in cell_text(cell, "outage_60s", Footnotes())


def test_planted_candidates_come_out_as_they_must(cells: list[Cell]) -> None:
    """A copy is proved to be one on a single dive; on one dive nothing else has a word."""
    sets = by_data_set(cells)
    for name in ("set_one", "set_two"):
        copy = cell_of(cells, "planted_copy", name)
        assert copy.answer is not None
        assert copy.answer.verdict == "no effect"
    lines = [line for line in checks(sets).splitlines() if "planted_" in line]
    assert [line.split(" | ")[-1] for line in lines] == ["yes |", "- |"] * 2


# --- What is committed.


def test_each_dive_is_named_and_its_settings_and_candidates_are_valid() -> None:
    pinned = r"https://raw\.githubusercontent\.com/[^/]+/[^/]+/[0-9a-f]{40}/"
    for dive in PLACE.dives:
        assert len(dive["tags"]) == 2
        assert dive["licence"]
        assert dive["faults"]
        urls = [dive["url"]] if "url" in dive else [file["url"] for file in dive["files"]]
        assert urls
        assert all(re.match(pinned, url) for url in urls)
        for candidate in sorted((PLACE.public / "candidates").rglob("*.toml")):
            if candidate.parent.name in ("candidates", dive["tags"][0]):
                files = [PLACE.public / dive["settings"], candidate]
                config = load_config(file=files, allow_code=True)
                assert [*config.filters] == ["baseline", candidate.stem]


def test_each_candidate_is_described() -> None:
    words = benchmark_cells.WORDS
    described = {*words["filters"], *words["planted_filters"]}
    assert described == {file.stem for file in (PLACE.public / "candidates").rglob("*.toml")}
    assert words["planted"].keys() == words["planted_filters"].keys()


def test_the_settings_of_the_snapir_differ_in_their_clocks_alone() -> None:
    """Settings of the same vehicle, by one command."""
    texts = set()
    for dive in PLACE.data_sets["snapir"]:
        file = PLACE.public / dive["settings"]
        assert file.stem == name_of(dive)
        text = file.read_text("utf-8")
        assert "make benchmark-settings" in text
        texts.add(re.sub(r"(?m)^latency_s = .*\n", "", text))
    assert len(texts) == 1


def test_the_page_is_small_and_names_no_machine() -> None:
    page = benchmark.PAGE.read_bytes() + benchmark.PAGE.with_suffix(".svg").read_bytes()
    assert len(page) < 100_000
    assert b"raw.githubusercontent.com" in page


def test_the_page_has_date_and_commit() -> None:
    text = benchmark.PAGE.read_text("utf-8")
    made = text.partition("<!-- stamp: written by make benchmark -->\n")[2]
    assert re.match(r"20\d\d-\d\d-\d\d, [0-9a-f]{8}\n", made)


def test_reasons_are_not_repeated_in_a_cell() -> None:
    for texts in matrix_rows(benchmark.PAGE.read_text("utf-8")).values():
        for text in texts:
            marks = re.findall("[⁰¹²³⁴⁵⁶⁷⁸⁹]+", text)
            assert len(marks) == len(set(marks))


@pytest.mark.nightly
def test_the_page_is_what_the_program_writes(snapir: Path) -> None:
    if shutil.which("c++") is None:
        pytest.skip("needs a compiler of C++")
    assert snapir.parent == PLACE.data
    benchmark_cells.prepare(PLACE)
    sets = by_data_set(benchmark_cells.build(PLACE))
    assert not PLACE.missing
    page = benchmark.PAGE.read_text("utf-8")
    made = page.partition("<!-- stamp: written by make benchmark -->\n")[2].partition("\n")[0]
    again = "run `make benchmark`"
    assert benchmark.page_text(page, sets, made) == page, again
    assert benchmark.picture(sets) == benchmark.PAGE.with_suffix(".svg").read_bytes(), again
    details = (benchmark.DOCS / benchmark_page.DETAILS).read_text("utf-8")
    assert benchmark.details_text(details, sets, PLACE) == details, again
    for quoting in benchmark.QUOTING:
        assert quote(sets) in quoting.read_text("utf-8"), again
    assert benchmark_page.assay(sets) in benchmark.QUOTING_ASSAY.read_text("utf-8"), again


@pytest.mark.nightly
def test_the_settings_of_the_snapir_are_what_the_command_finds(
    snapir: Path, tmp_path: Path
) -> None:
    assert snapir.parent == PLACE.data
    place = replace(PLACE, build=tmp_path)
    dives = place.data_sets["snapir"]
    folders = [place.logs[name_of(dive)] for dive in dives]
    base = load_config(file=place.public / "settings" / "snapir.toml")
    found = settings_of_dives([Path(str(folder)) for folder in folders], base)
    for dive, config in zip(dives, found, strict=True):
        stored = load_config(file=place.public / dive["settings"])
        for key, tolerance in (
            ("latency_s", 2e-4),
            ("lever_arm_m", 2e-4),
            ("mounting_rpy_deg", 2e-3),
            ("scale", 2e-5),
            ("beam_sd_mps", 1e-4),
        ):
            value = getattr(config.dvl, key)
            assert value == pytest.approx(getattr(stored.dvl, key), abs=tolerance), key
        latency_s = stored.reference.latency_s
        assert config.reference.latency_s == pytest.approx(latency_s, abs=2e-3)
        assert load_config(file=_written(tmp_path, config)) == config


def _written(folder: Path, config: Config) -> Path:
    file = folder / "settings.toml"
    file.write_text(settings_text(config), "utf-8")
    return file
