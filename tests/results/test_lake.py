"""``run --lake``: the evidence of many replays as one Parquet dataset."""

import ast
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from made_reports import report
from msgspec.structs import asdict, replace

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.quantities import ACCURACY
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.logs import write_dive
from insdvl_replay.results.folder import SETTINGS_FILE, add_to_lake
from insdvl_replay.sim.dive import simulate_dive

pytest.importorskip("pyarrow", reason="needs pyarrow")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "lake.md"
QUERIES = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
NULL_ROW = EvidenceRow("", "aided", "accuracy", "heading", "", *[None] * 6)


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def replayed(
    dive: str = "dive",
    settings: str = "old",
    version: str = "0.1.0",
    *,
    rows: Sequence[EvidenceRow] | None = None,
    verdict: str = "better",
) -> Report:
    """Return the report of a dive with some settings, whose digests are those of their names."""
    made = report(dive)
    evidence = made.tables.evidence if rows is None else [replace(row, log=dive) for row in rows]
    return replace(
        made,
        tool=replace(
            made.tool,
            version=version,
            started_at=f"2026-01-0{1 + (settings == 'new')}T00:00:00+00:00",
        ),
        log=replace(made.log, sha256=digest(dive)),
        filters={"aided": replace(made.filters["aided"], verdict=verdict)},
        tables=replace(made.tables, evidence=evidence),
        files={SETTINGS_FILE: digest(settings)},
    )


# --- One file for each replay.


def test_rows_are_those_of_the_report_and_missing_numbers_are_null(tmp_path: Path) -> None:
    made = replayed()
    add_to_lake(tmp_path, made)
    frame = pd.read_parquet(tmp_path)
    rows = pd.DataFrame([asdict(row) for row in made.tables.evidence])
    pd.testing.assert_frame_equal(frame[rows.columns], rows)
    assert frame["ratio"].isna().tolist() == [False, False, False, True, False]
    assert frame["from_s"].isna().tolist() == [True, True, False, True, True]
    expected = ("better", digest("dive"), digest("old"), "0.1.0", "2026-01-01T00:00:00+00:00")
    identity = ["filter_verdict", "log_sha256", "settings_sha256", "version", "started_at"]
    assert {*frame[identity].itertuples(index=False, name=None)} == {expected}


def test_the_same_replay_replaces_itself_and_any_other_does_not(tmp_path: Path) -> None:
    add_to_lake(tmp_path, replayed(verdict="worse"))
    add_to_lake(tmp_path, replayed())
    (file,) = tmp_path.iterdir()
    content = file.read_bytes()
    add_to_lake(tmp_path, replayed())
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [content], "the same bytes"
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"better"}
    for other in (replayed(settings="new"), replayed(version="0.2.0"), replayed("other dive")):
        add_to_lake(tmp_path, other)
    frame = pd.read_parquet(tmp_path)
    assert len(frame) == 4 * len(replayed().tables.evidence)
    assert set(frame.loc[frame["version"] == "0.2.0", "settings_sha256"]) == {digest("old")}
    of_dive = frame[(frame["log"] == "dive") & (frame["version"] == "0.1.0")]
    assert set(of_dive["settings_sha256"]) == {digest("old"), digest("new")}


def test_every_file_has_one_schema(tmp_path: Path) -> None:
    from pyarrow.parquet import read_schema

    for dive, rows in {"some": None, "null": [NULL_ROW], "none": []}.items():
        add_to_lake(tmp_path, replayed(dive, rows=rows))
    first, *others = [read_schema(path) for path in tmp_path.iterdir()]
    assert len(others) == 2
    assert all(other.equals(first, check_metadata=True) for other in others)
    assert {str(kind) for kind in first.types} == {"string", "int64", "double"}


def test_a_kill_before_the_rename_leaves_the_dataset_whole(tmp_path: Path) -> None:
    add_to_lake(tmp_path, replayed(verdict="worse"))
    code = (
        "import os, signal, sys; from pathlib import Path; import test_lake as t\n"
        "Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "t.add_to_lake(Path(sys.argv[1]), t.replayed())\n"
    )
    places = os.pathsep.join(str(Path(__file__).parents[up]) for up in (0, 1))
    killed = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": places},
        check=False,
    )
    assert killed.returncode == -signal.SIGKILL
    assert [path.name[0] for path in tmp_path.iterdir() if path.is_dir()] == ["."], (
        "it had written"
    )
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"worse"}
    add_to_lake(tmp_path, replayed())
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"better"}


def test_writers_at_the_same_time_lose_nothing(tmp_path: Path) -> None:
    made = [replayed(f"dive {number % 20}") for number in range(80)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda one: add_to_lake(tmp_path, one), made))
    assert len(pd.read_parquet(tmp_path)) == 20 * len(made[0].tables.evidence)
    assert len(list(tmp_path.iterdir())) == 20


# --- The command.


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dive of 60 s, and a log that cannot be read."""
    folder = tmp_path_factory.mktemp("dives")
    write_dive(folder / "dive.mcap", simulate_dive("figure-eight", seed=1, duration_s=60.0))
    (folder / "broken.mcap").write_bytes(b"no log")
    return folder


def test_unchanged_dives_are_written_and_failed_ones_are_not(dives: Path, tmp_path: Path) -> None:
    results, lake = tmp_path / "results", tmp_path / "deep" / "lake"
    arguments = ["run", str(dives), "-o", str(results), "-q", "--starts", "1"]
    assert run_command_line([*arguments, "--lake", str(lake)]) == 3
    first = {path.name: path.read_bytes() for path in lake.iterdir()}
    frame = pd.read_parquet(lake)
    assert set(frame["log"]) == {"dive"}
    assert set(frame["settings_sha256"]) == {
        hashlib.sha256((results / "dive" / SETTINGS_FILE).read_bytes()).hexdigest()
    }
    shutil.rmtree(lake)
    assert run_command_line([*arguments, "--lake", str(lake)]) == 3
    assert {path.name: path.read_bytes() for path in lake.iterdir()} == first
    assert len(frame) == len(pd.read_csv(results / "dive" / "evidence.csv"))


def test_both_sides_of_a_change_are_in_it(dives: Path, tmp_path: Path) -> None:
    lake, sides = tmp_path / "lake", tmp_path / "sides"
    change = ["--against", "dvl.scale=1.1", "--lake", str(lake)]
    assert (
        run_command_line(
            ["run", str(dives / "dive.mcap"), "-o", str(sides), "-q", "--starts", "1", *change]
        )
        == 0
    )
    digests = [
        hashlib.sha256((sides / side / "dive" / SETTINGS_FILE).read_bytes()).hexdigest()
        for side in ("before", "after")
    ]
    assert set(pd.read_parquet(lake)["settings_sha256"]) == set(digests)


def refused(arguments: Sequence[str | Path], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the last line of a run that is refused before any replay."""
    command = ["run", "no_log_is_read.mcap", *map(str, arguments)]
    Path("no_log_is_read.mcap").write_bytes(b"")
    assert run_command_line(command) == 2
    assert not Path("replay", "no_log_is_read").exists()
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_folder_that_cannot_be_a_lake_is_refused_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    Path("full").mkdir()
    pd.DataFrame({"x": [1.0]}).to_parquet("full/mine.parquet")
    before = Path("full/mine.parquet").read_bytes()
    assert "file: cannot be written: Not a directory" in refused(["--lake", "file"], capsys)
    assert "file/lake: cannot be written: Not a directory" in refused(
        ["--lake", "file/lake"], capsys
    )
    assert "full: holds mine.parquet, which is not a file of a lake" in refused(
        ["--lake", "full"], capsys
    )
    for place in ("replay", "."):
        assert f"{place}: is the folder of the results, or above it" in refused(
            ["--lake", place], capsys
        )
    assert "replay/after: is the folder" in refused(
        ["--lake", "replay/after", "--against", "dvl.scale=1.1"], capsys
    )
    assert Path("file").read_text() == "mine"
    assert [path.read_bytes() for path in Path("full").iterdir()] == [before]


def test_a_folder_that_nobody_may_write_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def forbid(**_: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.TemporaryFile", forbid)  # root may write anywhere
    assert "lake: cannot be written: Permission denied" in refused(["--lake", "lake"], capsys)


def test_it_needs_pyarrow_and_says_so_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert "--lake needs pyarrow; hint: pip install 'pyarrow>=17'" in refused(
        ["--lake", "lake"], capsys
    )
    assert not Path("lake").exists()


# --- The queries of the page.


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose lake has 10,000 rows: 500 dives with two settings and ten rows each."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "lake").mkdir()
    for number in range(1000):
        dive, is_new = f"dive {number // 2}", bool(number % 2)
        rows = [
            EvidenceRow(
                dive, "aided", "accuracy", quantity, "m", 1.0, 0.8,
                0.9 - 0.1 * (is_new and quantity == "drift_30s") + 0.3 * (number in (7, 8)),
            )
            for quantity in ("position", "outage_30s", *ACCURACY)
        ]  # fmt: skip
        version = "0.2.0" if number >= 900 else "0.1.0"
        made = replayed(dive, "new" if is_new else "old", version, rows=rows, verdict="undecided")
        add_to_lake(folder / "lake", made)
    return folder


def answer(query: str) -> tuple[Any, float]:
    """Return the value of the last line of a query, and the shortest of three times in seconds."""
    *statements, last = ast.parse(query).body
    assert isinstance(last, ast.Expr)
    names, times_s = dict[str, Any](), []
    for _ in range(3):
        start_s = time.perf_counter()
        exec(compile(ast.Module(statements, []), str(PAGE), "exec"), names)
        value = eval(compile(ast.Expression(last.value), str(PAGE), "eval"), names)
        times_s.append(time.perf_counter() - start_s)
    return value, min(times_s)


@pytest.mark.nightly
def test_queries_of_the_page_answer_within_a_second(
    archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(archive)
    assert len(pd.read_parquet("lake")) == 10_000
    (drift, drift_s), (worse, worse_s), (moved, moved_s) = map(answer, QUERIES)
    assert drift["count"].to_dict() == {"0.1.0": 900, "0.2.0": 100}
    assert drift["median"].to_dict() == pytest.approx({"0.1.0": 0.9, "0.2.0": 0.85})
    assert sorted(worse[["log", "settings_sha256"]].itertuples(index=False, name=None)) == [
        ("dive 3", digest("new")), ("dive 4", digest("old")),
    ]  # fmt: skip
    by_quantity = moved.groupby("quantity")["log"].unique().map(set).to_dict()
    assert by_quantity.pop("drift_30s") == {f"dive {number}" for number in range(500)}
    assert all(dives == {"dive 3", "dive 4"} for dives in by_quantity.values())
    assert len(by_quantity) == 9
    clean = moved[~moved["log"].isin(["dive 3", "dive 4"])]
    assert clean["ratio_old"].to_numpy() == pytest.approx(0.9)
    assert clean["ratio_new"].to_numpy() == pytest.approx(0.8)
    assert max(drift_s, worse_s, moved_s) < 1.0
