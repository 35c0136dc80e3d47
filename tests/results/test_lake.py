"""``run --lake``: the evidence of many replays as one Parquet dataset."""

import ast
import hashlib
import os
import pkgutil
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import pandas as pd
import pytest
from made_lakes import digest, named, replayed
from msgspec.structs import asdict, replace

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError, ResultError
from insdvl_replay.core.quantities import ACCURACY
from insdvl_replay.core.report import CodeFile
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.logs import write_dive
from insdvl_replay.results import lake as lake_module
from insdvl_replay.results.folder import SETTINGS_FILE
from insdvl_replay.results.lake import (
    ROWS,
    LakeWriter,
    add_to_lake,
    compact_lake,
    read_lake,
    require_lake,
)
from insdvl_replay.sim.dive import simulate_dive

pa = pytest.importorskip("pyarrow", reason="needs pyarrow")
pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "lake.md"
QUERIES = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
NULL_ROW = EvidenceRow("", "aided", "accuracy", "heading", "", *[None] * 6)


def parquet_files(lake: Path) -> list[Path]:
    """Return the files that readers see."""
    return sorted((lake / ROWS).glob("[!.]*.parquet"))


def rows_of(lake: Path) -> pd.DataFrame:
    """Return all rows in an order of their own."""
    frame = pd.read_parquet(lake)
    return frame.sort_values(["replay", "quantity"]).reset_index(drop=True)


# --- One file for each replay.


def test_rows_are_those_of_the_report_and_missing_numbers_are_null(tmp_path: Path) -> None:
    made = replayed()
    add_to_lake(tmp_path, made, "v1")
    frame = pd.read_parquet(tmp_path)
    rows = pd.DataFrame([asdict(row) for row in made.tables.evidence])
    pd.testing.assert_frame_equal(frame[rows.columns], rows)
    assert frame["ratio"].isna().tolist() == [False, False, False, True, False]
    assert frame["from_s"].isna().tolist() == [True, True, False, True, True]
    expected = (
        "better", digest("dive"), digest("old"), "", "v1", "0.1.0", "2026-01-01T00:00:00+00:00",
    )  # fmt: skip
    identity = [
        "filter_verdict", "log_sha256", "settings_sha256", "code_sha256", "revision", "version", "started_at",
    ]  # fmt: skip
    assert {*frame[identity].itertuples(index=False, name=None)} == {expected}
    assert frame["replay"].nunique() == 1


def test_the_same_replay_replaces_itself_and_any_other_does_not(tmp_path: Path) -> None:
    add_to_lake(tmp_path, replayed(verdict="worse"))
    add_to_lake(tmp_path, replayed())
    (file,) = parquet_files(tmp_path)
    content = file.read_bytes()
    add_to_lake(tmp_path, replayed())
    assert [path.read_bytes() for path in parquet_files(tmp_path)] == [content], "the same bytes"
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"better"}
    code = {"own:Filter": CodeFile("own.py", digest("code"))}
    others = {
        "settings": replayed(settings="new"),
        "version": replayed(version="0.2.0"),
        "log": replayed("other dive"),
        "code": replace(replayed(), code=code),
    }
    for other in others.values():
        add_to_lake(tmp_path, other)
    add_to_lake(tmp_path, replayed(), "v2")
    frame = pd.read_parquet(tmp_path)
    assert len(frame) == 6 * len(replayed().tables.evidence)
    assert frame["replay"].nunique() == 6
    assert set(frame.loc[frame["version"] == "0.2.0", "settings_sha256"]) == {digest("old")}
    assert set(frame["code_sha256"]) == {"", digest("code")}
    assert set(frame.loc[frame["revision"] == "v2", "log"]) == {"dive"}
    of_dive = frame[(frame["log"] == "dive") & (frame["version"] == "0.1.0")]
    assert set(of_dive["settings_sha256"]) == {digest("old"), digest("new")}


def test_of_several_files_of_code_each_counts(tmp_path: Path) -> None:
    files = [CodeFile("one.py", digest("one")), CodeFile("two.py", digest("two"))]
    both = {"one:A": files[0], "two:B": files[1]}
    swapped = {"a:A": files[1], "b:B": files[0]}
    changed = {**both, "two:B": CodeFile("two.py", digest("three"))}
    for code in (both, swapped, changed):
        add_to_lake(tmp_path, replace(replayed(), code=code))
    assert pd.read_parquet(tmp_path)["code_sha256"].nunique() == 2


def test_every_file_has_one_schema(tmp_path: Path) -> None:
    from pyarrow.parquet import read_schema

    for dive, rows in {"some": None, "null": [NULL_ROW]}.items():
        add_to_lake(tmp_path, replayed(dive, rows=rows))
    first, other = [read_schema(path) for path in parquet_files(tmp_path)]
    compact_lake(tmp_path)
    (joined,) = [read_schema(path) for path in parquet_files(tmp_path)]
    assert other.equals(first, check_metadata=True)
    assert joined.equals(first, check_metadata=True)
    assert {str(kind) for kind in first.types} == {"string", "int64", "double"}


def test_a_replay_without_evidence_has_no_file(tmp_path: Path) -> None:
    add_to_lake(tmp_path, replayed(rows=[]))
    assert not parquet_files(tmp_path)


def test_a_kill_before_the_rename_leaves_the_dataset_whole(tmp_path: Path) -> None:
    add_to_lake(tmp_path, replayed(verdict="worse"))
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from made_lakes import named\n"
        "from insdvl_replay.results.lake import add_to_lake\n"
        "Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "add_to_lake(Path(sys.argv[1]), named('dive'))\n"
    )
    assert killed_in(code, tmp_path) == -signal.SIGKILL
    assert [path.name for path in (tmp_path / ROWS).glob(".*")] == [".part"], "it had written"
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"worse"}
    add_to_lake(tmp_path, replayed())
    assert set(pd.read_parquet(tmp_path)["filter_verdict"]) == {"better"}


def killed_in(code: str, lake: Path) -> int:
    """Return the exit code of Python code that kills itself."""
    places = os.pathsep.join(str(Path(__file__).parents[up]) for up in (0, 1))
    return subprocess.run(
        [sys.executable, "-c", code, str(lake)],
        env={**os.environ, "PYTHONPATH": places},
        check=False,
    ).returncode


def test_writers_at_the_same_time_lose_nothing(tmp_path: Path) -> None:
    made = [replayed(f"dive {number % 20}") for number in range(80)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda one: add_to_lake(tmp_path, one), made))
    assert len(pd.read_parquet(tmp_path)) == 20 * len(made[0].tables.evidence)
    assert len(parquet_files(tmp_path)) == 20


# --- Joined files.


@pytest.fixture
def twelve(tmp_path: Path) -> Path:
    """A lake of twelve replays."""
    for number in range(12):
        add_to_lake(tmp_path / "lake", named(f"dive {number}"))
    return tmp_path / "lake"


def test_joining_keeps_every_row(twelve: Path) -> None:
    before = rows_of(twelve)
    found = compact_lake(twelve)
    assert (found.replays, found.rows, found.files_before, found.files) == (12, 60, 12, 1)
    pd.testing.assert_frame_equal(rows_of(twelve), before)
    (first,) = parquet_files(twelve)
    content = first.read_bytes()
    add_to_lake(twelve, named("later"))
    assert len(parquet_files(twelve)) == 2
    assert pd.read_parquet(twelve)["log"].nunique() == 13
    assert compact_lake(twelve).files_before == 2
    assert compact_lake(twelve).files_before == 1
    (last,) = parquet_files(twelve)
    assert last.read_bytes() != content
    folders = [path.name for path in twelve.iterdir() if path.is_dir() and not path.is_symlink()]
    assert folders == [(twelve / ROWS).readlink().name], "older folders are gone"


def test_an_empty_lake_is_joined_and_read(tmp_path: Path) -> None:
    require_lake(tmp_path / "lake", ())
    assert compact_lake(tmp_path / "lake").rows == 0
    assert read_lake(tmp_path / "lake", ["log", "ratio"]).num_rows == 0


def test_a_joined_replay_is_added_once_and_replaced_by_a_newer_one(twelve: Path) -> None:
    compact_lake(twelve)
    (file,) = parquet_files(twelve)
    add_to_lake(twelve, named("dive 3"))
    assert parquet_files(twelve) == [file]
    writer = LakeWriter(twelve)
    for number in (3, 5):
        newer = named(f"dive {number}", verdict="worse")
        newer = replace(newer, tool=replace(newer.tool, started_at="2026-02-01T00:00:00+00:00"))
        writer.add(newer)
    assert set(pd.read_parquet(twelve)["filter_verdict"]) == {"better"}, "together, in the end"
    writer.close()
    frame = pd.read_parquet(twelve)
    assert len(frame) == 60
    changed = frame[frame["filter_verdict"] == "worse"]
    assert set(changed["log"]) == {"dive 3", "dive 5"}


def test_many_files_are_joined_without_being_asked(
    twelve: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("insdvl_replay.results.lake._MOST_FILES", 12)
    before = rows_of(twelve)
    add_to_lake(twelve, named("one more"))
    assert len(parquet_files(twelve)) == 1
    after = rows_of(twelve)
    kept = after[after["log"] != "one more"].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before)


def test_a_copy_without_links_is_read_and_not_written(twelve: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(twelve, copy)
    assert read_lake(copy, ["log"]).num_rows == 60
    assert len(pd.read_parquet(copy)) == 60
    for write in (compact_lake, lambda lake: add_to_lake(lake, named("later"))):
        with pytest.raises(ConfigError, match="was copied without its link") as error:
            write(copy)
        assert error.value.hint.startswith("copy it again with `cp -a`")


def test_a_lake_whose_link_leads_elsewhere_is_read_and_not_written(
    twelve: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere"
    (twelve / ".rows_1").rename(elsewhere)
    (twelve / ROWS).unlink()
    (twelve / ROWS).symlink_to("../elsewhere")
    assert read_lake(twelve, ["log"]).num_rows == 60
    for write in (compact_lake, lambda lake: add_to_lake(lake, named("later"))):
        with pytest.raises(ConfigError, match=r"its link rows leads to \.\./elsewhere"):
            write(twelve)
    assert len(list(elsewhere.iterdir())) == 12


# --- Files that are none of a lake.


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:500])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def garble(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[4:400] = Random(1).randbytes(396)
    file.write_bytes(content)


def rewritten(file: Path, change: Callable[[Any], Any]) -> None:
    pq.write_table(change(pq.ParquetFile(file).read()), file)


def with_column(table: Any, name: str, values: Any) -> Any:
    place = table.schema.get_field_index(name)
    return table.set_column(place, name, values)


def drop_revision(file: Path) -> None:
    rewritten(file, lambda table: table.drop_columns(["revision"]))


def add_column(file: Path) -> None:
    rewritten(file, lambda table: table.append_column("more", table["log"]))


def write_words_for_numbers(file: Path) -> None:
    rewritten(file, lambda table: with_column(table, "ratio", table["log"]))


def lose_times(file: Path) -> None:
    def without(table: Any) -> Any:
        times = table["started_at"]
        return with_column(table, "started_at", pa.nulls(len(times), times.type))

    rewritten(file, without)


@pytest.mark.parametrize("place", [0, 11], ids=["first", "last"])
@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (cut, "is damaged"),
        (empty, "is damaged"),
        (garble, "cannot be read|is damaged"),
        (drop_revision, "lacks revision"),
        (add_column, "has more"),
        (write_words_for_numbers, "has ratio as string"),
        (lose_times, "has rows without started_at"),
    ],
)
def test_a_file_that_is_none_of_a_lake_is_named(
    twelve: Path, harm: Callable[[Path], None], said: str, place: int
) -> None:
    file = parquet_files(twelve)[place].resolve()
    harm(file)
    before = {path.name: path.read_bytes() for path in file.parent.iterdir()}
    with pytest.raises(ResultError, match=said) as error:
        compact_lake(twelve)
    assert file.name in error.value.message
    assert {path.name: path.read_bytes() for path in file.parent.iterdir()} == before
    if harm is not add_column:
        with pytest.raises(ResultError, match=said):
            read_lake(twelve, ["log", "ratio", "revision", "started_at", "replay"])


def test_a_damaged_joined_file_is_named(twelve: Path) -> None:
    compact_lake(twelve)
    [joined] = parquet_files(twelve)
    cut(joined)
    for use in (compact_lake, lambda lake: add_to_lake(lake, named("x")), read_logs):
        with pytest.raises(ResultError, match=r"joined\.parquet: is damaged"):
            use(twelve)


def read_logs(lake: Path) -> None:
    read_lake(lake, ["log"])


def test_files_of_others_and_files_without_rows_are_left_out(twelve: Path) -> None:
    folder = (twelve / ROWS).resolve()
    whole = pq.ParquetFile(parquet_files(twelve)[0]).read()
    (folder / "notes.txt").write_text("mine")
    (folder / "folder.parquet").mkdir()
    pq.write_table(whole.slice(0, 0), folder / "none.parquet")
    assert read_lake(twelve, ["log"]).num_rows == 60
    assert compact_lake(twelve).rows == 60


def test_a_reader_whose_folder_is_joined_meanwhile_reads_again(
    twelve: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    list_files = lake_module._files
    was_joined = False

    def some_files(folder: Path) -> list[Path]:
        nonlocal was_joined
        found = list_files(folder)
        if was_joined:
            return found
        # The joining has removed all but two files, which are opened before they go.
        was_joined = True
        kept = twelve / ".kept"
        shutil.copytree(folder, kept)
        compact_lake(twelve)
        return [kept / path.name for path in found[:2]]

    monkeypatch.setattr(lake_module, "_files", some_files)
    assert read_lake(twelve, ["log"]).num_rows == 60


def test_columns_and_rows_are_read_with_texts_as_dictionaries(twelve: Path) -> None:
    for _ in range(2):
        table = read_lake(twelve, ["log", "ratio"], [("log", "in", ["dive 1", "dive 2"])])
        assert table.num_rows == 10
        assert str(table.schema.field("log").type).startswith("dictionary")
        compact_lake(twelve)


class KilledError(BaseException):
    """In place of a kill, after which nothing tidies up."""


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize(
    "step",
    [
        "pathlib.Path.mkdir",
        "pyarrow.parquet.write_table",
        "os.fsync",
        "pathlib.Path.symlink_to",
        "pathlib.Path.replace",
        "shutil.rmtree",
    ],
)
def test_a_kill_at_each_step_of_joining_keeps_each_row_once(
    step: str, after: bool, twelve: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = rows_of(twelve)
    module, _, name = step.rpartition(".")
    real = pkgutil.resolve_name(step if module != "pathlib.Path" else f"pathlib:Path.{name}")

    def killed(*given: Any, **options: Any) -> None:
        if after:
            real(*given, **options)
        raise KilledError

    with monkeypatch.context() as patched:
        patched.setattr(step, killed)
        with pytest.raises(KilledError):
            compact_lake(twelve)
    pd.testing.assert_frame_equal(rows_of(twelve), before)
    add_to_lake(twelve, named("dive 12"))
    compact_lake(twelve)
    frame = rows_of(twelve)
    assert len(frame) == 65
    kept = frame[frame["log"] != "dive 12"].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before)


def test_a_reader_meanwhile_sees_each_row_once_or_an_error(twelve: Path) -> None:
    seen = set[int]()
    with ThreadPoolExecutor(1) as pool:
        joining = pool.submit(lambda: [compact_lake(twelve) for _ in range(40)])
        while not joining.done():
            with suppress(FileNotFoundError):
                seen.add(len(pd.read_parquet(twelve)))
        joining.result()
    assert seen <= {60}
    assert len(pd.read_parquet(twelve)) == 60


def killed_at_random(lake: Path, seed: int) -> None:
    """Kill writers and `compact` after a random time, and compare the rows; a moment again by its seed."""
    random = Random(seed)
    code = (
        "import sys; from pathlib import Path\n"
        "from made_lakes import named\n"
        "from insdvl_replay.results.lake import add_to_lake, compact_lake\n"
        "print('begun', flush=True)\n"
        "lake = Path(sys.argv[1])\n"
        "for turn in range(1000):\n"
        "    compact_lake(lake)\n"
        "    add_to_lake(lake, named(f'dive {turn % 12}', verdict='worse' if turn % 2 else 'better'))\n"
    )
    before = rows_of(lake)
    places = os.pathsep.join(str(Path(__file__).parents[up]) for up in (0, 1))
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(lake)],
        env={**os.environ, "PYTHONPATH": places},
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(random.uniform(0.0, 0.3))
    process.kill()
    process.communicate()
    pd.testing.assert_frame_equal(rows_of(lake), before, obj=f"rows after a kill, seed {seed}")


@pytest.mark.nightly
def test_a_kill_at_a_random_moment_keeps_each_row_once(twelve: Path) -> None:
    killed_at_random(twelve, seed=0)


@pytest.mark.nightly
def test_many_kills_at_random_moments_keep_each_row_once(twelve: Path) -> None:
    for seed in range(1, 61):
        killed_at_random(twelve, seed)


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
    first = {path.name: path.read_bytes() for path in parquet_files(lake)}
    frame = pd.read_parquet(lake)
    assert set(frame["log"]) == {"dive"}
    assert set(frame["settings_sha256"]) == {
        hashlib.sha256((results / "dive" / SETTINGS_FILE).read_bytes()).hexdigest()
    }
    shutil.rmtree(lake)
    assert run_command_line([*arguments, "--lake", str(lake)]) == 3
    assert {path.name: path.read_bytes() for path in parquet_files(lake)} == first
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


def test_a_name_of_a_version_is_one_short_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("two\nlines", 201 * "x"):
        said = refused(["--lake", "lake", "--revision", name], capsys)
        assert "is not a line of at most 200 letters" in said
    assert "--revision '  ': is blank" in refused(["--lake", "lake", "--revision", "  "], capsys)
    assert not Path("lake").exists()


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
    require_lake(folder / "lake", ())
    writer = LakeWriter(folder / "lake")
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
        writer.add(made)
    writer.close()
    return folder


def answer(query: str) -> tuple[Any, float]:
    """Return the value of the last line of a query, and the least processor time of three, in seconds."""
    *statements, last = ast.parse(query).body
    assert isinstance(last, ast.Expr)
    names, times_s = dict[str, Any](), []
    for _ in range(3):
        start_s = time.process_time()
        exec(compile(ast.Module(statements, []), str(PAGE), "exec"), names)
        value = eval(compile(ast.Expression(last.value), str(PAGE), "eval"), names)
        times_s.append(time.process_time() - start_s)
    return value, min(times_s)


@pytest.mark.nightly
def test_queries_of_the_page_answer_by_a_second_of_processor_time(
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
