"""Many dives: found, replayed on several workers, known again, and not lost when workers die."""

import csv
import dataclasses
import gc
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import psutil
import pytest
from counting_work import threads_with_numpy
from dying_work import die_always, die_at_first
from in_process import done_here
from msgspec.structs import replace
from recorded_parts import write_part

import insdvl_replay
from insdvl_replay.batch import workers
from insdvl_replay.batch.dive_paths import find_dives, usable_paths
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.jobs import (
    ReplayJob,
    ReplayOptions,
    known_reports,
    log_digest,
    plan_jobs,
)
from insdvl_replay.batch.runs import replay_into, replay_jobs
from insdvl_replay.batch.workers import Submit, WorkerLostError, do_each, local_pool
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.report import as_json as encode_report
from insdvl_replay.core.report import decode_report
from insdvl_replay.core.runtime import sources_digest
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.sim.dive import simulate_dive

pytestmark = pytest.mark.all_starts
TOOL = [sys.executable, "-m", "insdvl_replay"]
CLUSTER = """
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def found_paths(names: list[str], base: Path = Path(), *, results: bool = False) -> list[Path]:
    return usable_paths(find_dives(names, base, results=results))


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six simulated dives of 20 s."""
    folder = tmp_path_factory.mktemp("archive")
    for seed in range(1, 7):
        write_dive(
            folder / f"dive_{seed}.mcap", simulate_dive("straight", seed=seed, duration_s=20.0)
        )
    return folder


@pytest.fixture(scope="module")
def results(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their results, made one after the other in one process."""
    output = tmp_path_factory.mktemp("results")
    assert (
        run_command_line(["run", "--preset", "levy-klein", str(archive), "-o", str(output)]) == 0
    )
    return output


@pytest.fixture(scope="module")
def cluster() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A dask.distributed cluster of two worker processes: its address and its own process."""
    command = [sys.executable, "-c", CLUSTER]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
        process.communicate(timeout=60)


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, which may have code of the user's: it is imported from there if somebody says so."""
    command = [*TOOL, "run", "--preset", "levy-klein", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(cwd)}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def bytes_of(output: Path) -> dict[str, bytes]:
    """Every file of a result, without the block that may differ. What a killed worker leaves is hidden."""
    files = {
        str(path.relative_to(output)): path.read_bytes()
        for path in output.rglob("*")
        if path.is_file()
    }
    files = {name: data for name, data in files.items() if not name.startswith(".")}
    for name, data in files.items():
        if name.endswith("report.json"):
            files[name] = json.dumps({**json.loads(data), "tool": None}).encode()
    return files


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120.0
    while not path.exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.005)


# --- Which dives are meant.


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Logs, a bag, a folder of numbered logs, a result and a hidden folder."""
    for name in ("b.mcap", "a.mcap", "notes.md", "2026/c.mcap", "bag/x_1.mcap", "bag/metadata.yaml",
                 "trip/trip_0.mcap", "trip/trip_1.mcap", "replay/a/replay.mcap", "replay/a/report.json",
                 ".trash/old.mcap"):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("a.mcap", "a.mcap"),
        ("absent.mcap", "absent.mcap"),
        ("notes.md", "notes.md"),
        (".", "2026/c.mcap a.mcap b.mcap bag trip/trip_0.mcap trip/trip_1.mcap"),
        ("bag", "bag"),
        ("*.mcap", "a.mcap b.mcap"),
        ("*", "2026/c.mcap a.mcap b.mcap bag trip/trip_0.mcap trip/trip_1.mcap"),
        ("**/c.mcap", "2026/c.mcap"),
    ],
)
def test_names_are_for_dives(name: str, found: str, tree: Path) -> None:
    assert [str(path.relative_to(tree)) for path in found_paths([name], tree)] == found.split()


def test_logs_of_every_kind_are_dives_and_converted_ones_once(tmp_path: Path) -> None:
    for name in (
        "x.bag",
        "x.mcap",
        "y.bag",
        "z.db3",
        "z.bag",
        "older/x.bag",
        "bag/0.db3",
        "bag/metadata.yaml",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()

    def found(name: str) -> list[str]:
        return [str(path.relative_to(tmp_path)) for path in found_paths([name], tmp_path)]

    assert found(".") == ["bag", "older/x.bag", "x.mcap", "y.bag", "z.db3"]
    assert found("?.*") == ["x.mcap", "y.bag", "z.db3"]
    assert found("*.bag") == ["x.bag", "y.bag", "z.bag"]
    assert found("x.bag") == ["x.bag"]


def test_results_are_dives_only_where_they_are_wanted(tree: Path) -> None:
    assert tree / "replay" / "a" in found_paths(["."], tree, results=True)
    with pytest.raises(ConfigError, match=r"replay: "):
        found_paths(["replay"], tree)


def test_logs_next_to_the_report_of_another_tool_are_dives(tree: Path) -> None:
    (tree / "trip" / "report.json").write_text('{"tool": {"name": "another"}}')
    assert [path.name for path in found_paths(["trip"], tree)] == ["trip_0.mcap", "trip_1.mcap"]
    (tree / "trip" / "report.json").write_text('{"tool": {"name": "insdvl-replay"}}')
    assert found_paths(["trip"], tree, results=True) == [tree / "trip"]


def test_a_list_names_dives_seen_from_its_own_folder(tree: Path) -> None:
    (tree / "2026" / "season.txt").write_text("# the good ones\n\nc.mcap\n../*.mcap\n../bag\n")
    found = found_paths(["2026/season.txt"], tree)
    assert [path.resolve() for path in found] == [
        tree / name for name in ("2026/c.mcap", "a.mcap", "b.mcap", "bag")
    ]  # fmt: skip


@pytest.mark.parametrize(
    "content",
    [
        b"wrz,0.12,-0.03,0.01,y,1.2,0.001*aa\nwru,0,0.1,1.0,-30,-90*bb\n",
        b"time,ax,ay,az\n0,1,2,3\n0.01,1,2,3\n",
        b"12/05/2024 10:00:00 0.1 0.2 0.3\n",
        b"$PNORBT1,1,2*3B\n",
        b"\0\1\2\xff",
    ],
)
def test_a_text_without_paths_is_a_file_and_no_list(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "dump.txt").write_bytes(content)
    assert found_paths(["dump.txt"], tmp_path) == [tmp_path / "dump.txt"]


@pytest.mark.parametrize(
    "line", ["dive_7", "2026/dive 7", "lost.mcap", "s3://bucket/dive.mcap", "a, 1, 2.mcap"]
)
def test_a_list_of_names_that_are_not_there_is_a_list(line: str, tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(f"{line}\n")
    assert [path.name for path in found_paths(["list.txt"], tmp_path)] == [line.rpartition("/")[2]]


@pytest.mark.parametrize("results", [False, True])
def test_a_folder_of_tables_is_a_dive_for_every_command(results: bool, tmp_path: Path) -> None:
    for name in ("dive_7/imu.csv", "archive/summary.csv", "archive/dive.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("time,ax\n0,1\n")
    assert found_paths(["dive_7"], tmp_path, results=results) == [tmp_path / "dive_7"]
    assert found_paths(["archive"], tmp_path, results=results) == [
        tmp_path / "archive" / "dive.mcap"
    ]


def test_a_dive_that_is_meant_twice_is_one(tree: Path) -> None:
    found = found_paths(["b.mcap", "*.mcap", "../" + tree.name, "bag/../b.mcap"], tree)
    assert len(found) == len({path.resolve() for path in found}) == 6
    assert found[:2] == [tree / "b.mcap", tree / "a.mcap"]


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        ("a.mcap sub/b.mcap", "a b"),
        ("mon/x.mcap tue/x.mcap tue/y.mcap", "mon_x tue_x y"),
        ("1/mon/x.mcap 2/mon/x.mcap tue/x.mcap", "1_mon_x 2_mon_x tue_x"),
    ],
)
def test_dives_that_would_share_a_name_are_reported_apart_by_their_folders(
    paths: str, names: str, tmp_path: Path
) -> None:
    assert unique_names([tmp_path / path for path in paths.split()]) == names.split()


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("..mcap", "mcap"),
        ("...mcap", "mcap"),
        (".mcap", ".mcap"),
        ("a..mcap", "a."),
        ("...", "dive"),
    ],
)
def test_no_dive_bears_the_name_of_the_folder_it_is_in(
    file: str, name: str, tmp_path: Path
) -> None:
    assert unique_names([tmp_path / file]) == [name]


def test_a_folder_keeps_what_is_behind_a_dot_in_its_name(tmp_path: Path) -> None:
    bag = tmp_path / "dive_2026.11.21"
    bag.mkdir()
    assert unique_names([bag, tmp_path / "dive_2026.mcap"]) == ["dive_2026.11.21", "dive_2026"]
    write_dive(bag / "part_0.mcap", simulate_dive("straight", seed=1, duration_s=20.0))
    assert read_dive(bag, load_config()).name == "dive_2026.11.21"
    (bag / "notes").mkdir()
    assert read_dive(bag / "notes" / "..", load_config()).name == "dive_2026.11.21"


@pytest.mark.parametrize("paths", ["x.mcap x", "mon/x.mcap tue/x.mcap tue_x.mcap"])
def test_dives_that_folders_do_not_tell_apart_are_refused(paths: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"(?m)x\.mcap .*x(\.mcap)? .*x$"):
        unique_names([tmp_path / path for path in paths.split()])


def test_two_dives_of_one_name_are_replayed_next_to_each_other(
    archive: Path, tmp_path: Path
) -> None:
    for day, seed in (("monday", 1), ("tuesday", 2)):
        (tmp_path / day).mkdir()
        shutil.copy(archive / f"dive_{seed}.mcap", tmp_path / day / "dive.mcap")
    logs = [str(tmp_path / day) for day in ("monday", "tuesday")]
    assert (
        run_command_line(["run", "--preset", "levy-klein", *logs, "-o", str(tmp_path / "out")])
        == 0
    )
    for name in ("monday_dive", "tuesday_dive"):
        assert (
            decode_report((tmp_path / "out" / name / "report.json").read_bytes()).log.name == name
        )
    rows = (tmp_path / "out" / "summary.csv").read_text().splitlines()[1:]
    assert [row.partition(",")[0] for row in rows] == ["monday_dive", "tuesday_dive"]
    assert known_reports(
        plan_jobs(find_dives(logs), tmp_path / "out", ReplayOptions(load_config("levy-klein"))),
        force=False,
    )
    assert not known_reports(
        plan_jobs(
            find_dives(logs[:1]), tmp_path / "out", ReplayOptions(load_config("levy-klein"))
        ),
        force=False,
    )


def test_a_result_that_lost_a_file_is_made_again(
    archive: Path, results: Path, tmp_path: Path
) -> None:
    shutil.copytree(results, tmp_path / "out")
    (tmp_path / "out" / "dive_2" / "report.html").unlink()
    done = done_here(
        "run", "--preset", "levy-klein", archive, "-o", "out", "--force", cwd=tmp_path
    )
    assert [line for line in done.stderr.splitlines() if line.startswith("wrote")] == [
        "wrote out/dive_2", "wrote out/summary.csv", "wrote out/answers.csv",
        "wrote out/evidence.csv", "wrote out/where.csv", "wrote out/index.html",
    ]  # fmt: skip
    assert bytes_of(tmp_path / "out") == bytes_of(results)


OWN = """
import numpy as np

from insdvl_replay import UserMeasurement, UserReadings


class Down(UserMeasurement):
    name, unit = "down", "m/s"

    def readings(self, dive):
        return UserReadings(dive.reference.time_ns, dive.reference.velocity_n[:, 2:], np.array([SD]))

    @staticmethod
    def predict(ins, z, H):
        z[0], H[0, 2] = ins[5], 1.0
"""


@pytest.mark.nightly
def test_code_of_ones_own_that_was_changed_is_run_again(archive: Path, tmp_path: Path) -> None:
    """The settings are the same, and what they name is not."""
    noise = {}
    for sd in (0.1, 0.2):
        (tmp_path / "mine.py").write_text(OWN.replace("SD", str(sd)))
        aiding = 'filters.mine.aiding=["velocity","mine:Down"]'
        done = run(
            archive / "dive_1.mcap",
            "-o",
            "out",
            "--set",
            aiding,
            "--starts",
            "1",
            "--allow-code",
            cwd=tmp_path,
        )
        assert "wrote out/dive_1" in done.stderr
        code = json.loads((tmp_path / "out" / "dive_1" / "report.json").read_text())["code"]
        digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()
        assert code == {"mine:Down": {"file": str(tmp_path / "mine.py"), "sha256": digest}}
        with (tmp_path / "out" / "dive_1" / "consistency.csv").open() as stream:
            (noise[sd],) = (
                float(row["mean_nis"])
                for row in csv.DictReader(stream)
                if row["measurement"] == "down"
            )
    assert noise[0.2] < 0.5 * noise[0.1]
    for version, sd, is_kept in (("1", 0.3, False), ("1", 0.4, True), ("2", 0.4, False)):
        (tmp_path / "mine.py").write_text(OWN.replace("SD", str(sd)))
        mine = f'filters.mine={{aiding=["velocity","mine:Down"], version="{version}"}}'
        words = ("-o", "out", "--set", mine, "--starts", "1", "--allow-code", "--force")
        done = run(archive / "dive_1.mcap", *words, cwd=tmp_path)
        assert ("wrote out/dive_1" in done.stderr) is not is_kept


def test_one_bad_name_stops_no_archive(archive: Path, tmp_path: Path) -> None:
    shutil.copy(archive / "dive_1.mcap", tmp_path / "dive.mcap")
    (tmp_path / os.fsdecode(b"bad\xff.mcap")).touch()
    (tmp_path / "locked").mkdir()
    found = found_paths([str(tmp_path)])
    assert [path.name.encode(errors="replace") for path in found] == [b"bad?.mcap", b"dive.mcap"]
    assert (
        run_command_line(
            [
                "run",
                "--preset",
                "levy-klein",
                *map(str, found),
                "-o",
                str(tmp_path / "out"),
                "--starts",
                "1",
            ]
        )
        == 3
    )
    assert (tmp_path / "out" / "dive" / "report.json").is_file()
    assert "UTF-8" in (tmp_path / "out" / "summary.csv").read_text()


def test_a_folder_that_may_not_be_read_is_a_dive_that_cannot(
    tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scanned = os.scandir

    def scandir(path: Path | str) -> Any:
        if Path(path).name == "trip":
            raise PermissionError(13, "Permission denied", str(path))
        return scanned(path)

    monkeypatch.setattr(os, "scandir", scandir)
    assert tree / "trip" in found_paths(["."], tree)
    assert tree / "trip" in found_paths(["**/*.mcap"], tree)


@pytest.mark.parametrize("name", [".", "**/*.mcap"])
def test_links_between_folders_end(name: str, tmp_path: Path) -> None:
    """Each of eight folders leads to all: there are more ways through them than anybody can go."""
    folders = [tmp_path / f"{number}" for number in range(8)]
    for folder in folders:
        folder.mkdir()
        (folder / "dive.mcap").touch()
        for other in folders:
            (folder / f"to_{other.name}").symlink_to(other)
    assert len(found_paths([name], tmp_path)) == len(folders)


@pytest.mark.parametrize("name", ["*.bag", "none?.mcap", "empty", "empty.txt"])
def test_a_name_without_dives_is_an_error(name: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.txt").write_text("# nothing\n")
    with pytest.raises(ConfigError, match=re.escape(Path(name).name)):
        found_paths([name], tmp_path)


# --- What is known already.


def test_digest_of_a_log_and_a_bag_is_that_of_the_reader(archive: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    log = (archive / "dive_1.mcap").read_bytes()
    parts = [
        write_part(bag / f"{role}.mcap", lambda topic, _, role=role: topic == f"/{role}", log=log)  # type: ignore[misc]
        for role in ("imu", "dvl", "reference")
    ]
    for logs in ((archive / "dive_1.mcap",), (bag,), tuple(reversed(parts))):
        assert log_digest(task(*logs)) == read_dive(logs, load_config()).sha256


def task(*logs: Path, output: Path = Path(), **wishes: Any) -> ReplayJob:
    (planned,) = plan_jobs(
        [*map(FoundDive, logs)],
        output,
        ReplayOptions(load_config("levy-klein"), **wishes),
        one_dive=True,
    )
    return planned


def known(archive: Path, results: Path, order: ReplayOptions) -> set[str]:
    return {
        target.name
        for target in known_reports(
            plan_jobs(find_dives([str(archive)]), results, order), force=True
        )
    }


def test_results_are_known_by_log_settings_and_versions(
    archive: Path, results: Path, tmp_path: Path
) -> None:
    shutil.copytree(archive, tmp_path / "logs")
    shutil.copytree(results, tmp_path / "out")
    config = load_config("levy-klein")
    everything = {f"dive_{seed}" for seed in range(1, 7)}
    assert known(tmp_path / "logs", tmp_path / "out", ReplayOptions(config)) == everything
    assert (
        known(tmp_path / "logs", tmp_path / "out", ReplayOptions(config, allow_damaged=True))
        == everything
    )
    assert known(tmp_path / "logs", tmp_path / "out", ReplayOptions(config, control=True)) == set()
    assert (
        known(
            tmp_path / "logs",
            tmp_path / "out",
            ReplayOptions(load_config("levy-klein", overrides=["dvl.scale=1.01"])),
        )
        == set()
    )
    shutil.copy(archive / "dive_2.mcap", tmp_path / "logs" / "dive_1.mcap")
    saved = tmp_path / "out" / "dive_3" / "report.json"
    report = json.loads(saved.read_bytes())
    saved.write_text(json.dumps({**report, "tool": {**report["tool"], "version": "0.0.1"}}))
    versions = tmp_path / "out" / "dive_4" / "report.json"
    report = json.loads(versions.read_bytes())
    versions.write_text(json.dumps({**report, "versions": {**report["versions"], "numpy": "1.0"}}))
    (tmp_path / "out" / "dive_5" / "report.json").write_text("{}")
    assert known(tmp_path / "logs", tmp_path / "out", ReplayOptions(config)) == {
        "dive_2",
        "dive_6",
    }
    assert (
        known(tmp_path / "logs", tmp_path / "out", ReplayOptions(config, sources="other code"))
        == set()
    )


def test_a_worker_with_other_code_refuses(archive: Path, tmp_path: Path) -> None:
    other = task(archive / "dive_1.mcap", output=tmp_path, sources="other code")
    with pytest.raises(ConfigError, match=r"\(other code\)"):
        replay_into(other)


def test_a_result_that_another_run_has_written_meanwhile_stays(
    archive: Path, tmp_path: Path
) -> None:
    job = task(archive / "dive_1.mcap", output=tmp_path)
    job.target.mkdir()
    (job.target / "report.json").write_text('{"tool": {"name": "insdvl-replay"}}')
    with pytest.raises(ConfigError, match="dive_1: exists"):
        replay_into(job)


def test_other_sources_are_another_digest(tmp_path: Path) -> None:
    package = Path(insdvl_replay.__file__).parent
    copy = tmp_path / "insdvl_replay"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    asked = "from insdvl_replay.core.runtime import sources_digest; print(sources_digest())"

    def digest() -> str:
        return subprocess.run(
            [sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True
        ).stdout.strip()

    assert digest() == sources_digest()
    (copy / "presets" / "fog.toml").write_text("\n" + (copy / "presets" / "fog.toml").read_text())
    assert digest() not in ("", sources_digest())


def test_a_result_of_the_control_is_known(archive: Path, tmp_path: Path) -> None:
    log, output = archive / "dive_1.mcap", tmp_path / "out"
    assert (
        run_command_line(
            ["run", "--preset", "levy-klein", str(log), "--control", "-o", str(output)]
        )
        == 0
    )
    assert known_reports([task(log, output=output, control=True)], force=False)
    assert run_command_line(["run", "--preset", "levy-klein", str(log), "-o", str(output)]) == 2


def test_a_damaged_log_is_known_only_to_whom_it_is_good_enough(
    archive: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((archive / "dive_1.mcap").read_bytes()[:-200])
    arguments = ["run", "--preset", "levy-klein", str(cut), "-o", str(tmp_path / "out")]
    assert run_command_line([*arguments, "--allow-damaged"]) == 0
    assert known_reports([task(cut, output=tmp_path / "out", allow_damaged=True)], force=False)
    assert run_command_line([*arguments, "--force"]) == 3


def test_only_what_changed_is_replayed(archive: Path, results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "dive_3")
    before = bytes_of(tmp_path / "out")
    done = done_here(
        "run", "--preset", "levy-klein", archive, "-o", "out", "--format", "csv", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "[not_evaluated]" not in line]
    assert said == [
        *(f"{'wrote' if seed == 3 else 'unchanged'} out/dive_{seed}" for seed in range(1, 7)),
        "wrote out/summary.csv",
        "wrote out/answers.csv",
        "wrote out/evidence.csv",
        "wrote out/where.csv",
        "wrote out/index.html",
    ]
    assert bytes_of(tmp_path / "out") == bytes_of(results)
    assert before.items() <= bytes_of(tmp_path / "out").items()


def test_results_that_are_up_to_date_are_known_without_the_compiled_filter(
    archive: Path, results: Path
) -> None:
    """It takes half a second to load, also where the workers of a cluster do the work."""
    command = ["run", "--preset", "levy-klein", str(archive), "-o", str(results)]
    code = "import sys; from insdvl_replay.cli import run_command_line as run; "
    code += "print(run(sys.argv[1:]), 'numba' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code, *command], capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines()[-1] == "0 False", done.stderr


def test_a_changed_result_needs_force_before_any_work_is_done(
    archive: Path, results: Path, tmp_path: Path
) -> None:
    shutil.copytree(results, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "dive_1")
    changed = [archive, "-o", "out", "--set", "dvl.scale=1.01"]
    refused = done_here("run", "--preset", "levy-klein", *changed, cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("error: out/dive_2: ")
    assert not (tmp_path / "out" / "dive_1").exists()
    assert (
        done_here("run", "--preset", "levy-klein", *changed, "--force", cwd=tmp_path).returncode
        == 0
    )
    report = decode_report((tmp_path / "out" / "dive_2" / "report.json").read_bytes())
    assert report.config["dvl"]["scale"] == 1.01


@pytest.mark.parametrize(
    "data", [b'{"baseline": "\xff"}', b'{"log": ' + b"[" * 100_000], ids=["letters", "nested"]
)
def test_a_report_that_nobody_can_read_is_no_result(
    data: bytes, archive: Path, tmp_path: Path
) -> None:
    jobs = plan_jobs(
        find_dives([str(archive)]), tmp_path, ReplayOptions(load_config("levy-klein"))
    )
    jobs[0].target.mkdir()
    (jobs[0].target / "report.json").write_bytes(data)
    with pytest.raises(ConfigError, match=f"{jobs[0].target.name}: "):
        known_reports(jobs, force=True)


@pytest.mark.parametrize(
    ("settings", "wishes", "found"),
    [
        (["dvl.scale=1.01"], {}, r"with other settings: dvl\.scale 1\.0 -> 1\.01\n"),
        (
            ['filters.more.aiding=["beams"]'],
            {},
            r'settings: filters "baseline, aided" -> "baseline, aided, more"\n',
        ),
        (
            [f"dvl.{key}=0.5" for key in ("scale", "latency_s", "velocity_sd_mps", "beam_sd_mps")],
            {},
            r" and 1 more\n",
        ),
        ([], {"control": True}, r"with other settings: --control false -> true\n"),
        ([], {"sources": "other code"}, r"holds a result by another version\n"),
    ],
)
def test_the_error_on_another_result_says_what_differs(
    settings: list[str], wishes: dict[str, Any], found: str, archive: Path, results: Path
) -> None:
    options = ReplayOptions(load_config("levy-klein", overrides=settings), **wishes)
    jobs = plan_jobs([FoundDive(archive / "dive_1.mcap")], results, options)
    with pytest.raises(ConfigError, match=found) as raised:
        known_reports(jobs, force=False)
    assert "--force" in raised.value.hint
    assert "-o" in raised.value.hint


def test_the_error_on_a_result_of_another_log_says_so(archive: Path, results: Path) -> None:
    (job,) = plan_jobs(
        [FoundDive(archive / "dive_1.mcap")], results, ReplayOptions(load_config("levy-klein"))
    )
    with pytest.raises(ConfigError, match=r"dive_1: holds a result of another log\n"):
        known_reports(
            [
                dataclasses.replace(
                    job, logs=(archive / "dive_2.mcap",), name=archive / "dive_2.mcap"
                )
            ],
            force=False,
        )


def test_a_result_that_is_not_whole_is_replayed_and_reported(
    archive: Path, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(results, out)
    (out / "dive_1" / "report.html").write_bytes(b"")
    report = out / "dive_2" / "report.json"
    report.write_bytes(report.read_bytes().replace(b'"rmse": ', b'"rmse": 1'))
    with (out / "dive_3" / "replay.mcap").open("r+b") as replay:
        replay.seek(10_000)
        replay.write(bytes(1))
    arguments = ["run", "--preset", "levy-klein", str(archive), "-o", str(out)]
    assert run_command_line(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {out}/dive_1: ")
    assert re.search(r": report\.html; hint: .*--force\n$", said)
    assert run_command_line([*arguments, "--force"]) == 0
    said = capsys.readouterr().err
    for seed, name in enumerate(("report.html", "report.json", "replay.mcap"), start=1):
        assert re.search(rf"warning: {out}/dive_{seed}: .*: {name} \[result_damaged\]\n", said)
        assert f"wrote {out}/dive_{seed}\n" in said
    assert "unchanged" in said
    assert bytes_of(out) == bytes_of(results)


def test_rerun_replays_what_is_unchanged(archive: Path, tmp_path: Path) -> None:
    arguments = [
        "run",
        "--preset",
        "levy-klein",
        str(archive / "dive_1.mcap"),
        "-o",
        str(tmp_path),
    ]
    assert run_command_line(arguments) == 0
    saved = tmp_path / "dive_1" / "report.json"
    report = decode_report(saved.read_bytes())
    marked = encode_report(replace(report, tool=replace(report.tool, elapsed_s=1e6)))
    saved.write_bytes(marked)
    assert run_command_line(arguments) == 0
    assert saved.read_bytes() == marked
    assert run_command_line([*arguments, "--rerun"]) == 0
    assert saved.read_bytes() != marked


@pytest.mark.parametrize("name", ["summary.csv", "index.html"])
def test_a_file_that_bears_an_overviews_name_is_left_alone(
    name: str, archive: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("my own notes\n")
    done = done_here("run", "--preset", "levy-klein", archive, "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert f"out/{name}: exists" in done.stderr


@pytest.mark.parametrize(
    "name", ["summary.csv", "answers.csv", "evidence.csv", "where.csv", "index.html"]
)
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_no_link_or_pipe_that_bears_an_overviews_name_is_written_to(
    name: str, kind: str, archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    if kind == "link":
        (tmp_path / name).symlink_to("thesis.tex")
    else:
        os.mkfifo(tmp_path / name)
    assert (
        run_command_line(
            ["run", "--preset", "levy-klein", str(archive), "-o", str(tmp_path), "--force"]
        )
        == 2
    )
    assert re.search(rf"{name}: .*; hint: rm ", capsys.readouterr().err)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


# --- Workers.


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_item_is_done_once_and_an_exception_is_a_result(jobs: int) -> None:
    outcomes = dict(do_each(int, ["1", "x", "3"], local_pool(jobs)))
    assert (outcomes[0], outcomes[2]) == (1, 3)
    assert isinstance(outcomes[1], ValueError)


class Columns:
    """What is read of a dive."""


def test_an_error_does_not_keep_what_was_read_of_its_dive() -> None:
    read: list[weakref.ref[Columns]] = []

    def fail(_: int) -> None:
        columns = Columns()
        read.append(weakref.ref(columns))
        raise LogError("the IMU is dead", "another one")

    gc.disable()
    try:
        [(_, outcome)] = do_each(fail, [0], local_pool(1))
        assert isinstance(outcome, LogError)
        assert [reference() for reference in read] == [None]
    finally:
        gc.enable()


def test_processes_next_to_each_other_take_one_core_each(monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("OPENBLAS", "OMP", "MKL"):
        monkeypatch.delenv(f"{library}_NUM_THREADS", raising=False)
    assert dict(do_each(threads_with_numpy, [0, 1], local_pool(2))) == {0: 1, 1: 1}


@pytest.mark.nightly
def test_items_of_a_dead_worker_are_tried_again(tmp_path: Path) -> None:
    items = [tmp_path / name for name in ("a", "b", "c.deadly", "d", "e", "f")]
    outcomes = dict(do_each(die_at_first, items, local_pool(2)))
    assert outcomes == {place: item.name for place, item in enumerate(items)}


@pytest.mark.nightly
def test_only_the_item_that_kills_its_workers_is_lost() -> None:
    items = ["a", "b", "deadly", "c", "d", "e"]
    outcomes = dict(do_each(die_always, items, local_pool(2)))
    assert isinstance(outcomes.pop(2), WorkerLostError)
    assert outcomes == {place: item for place, item in enumerate(items) if item != "deadly"}


@pytest.mark.nightly
def test_a_dive_that_kills_its_workers_is_reported_by_name(archive: Path, tmp_path: Path) -> None:
    def submit(*_: object) -> NoReturn:
        raise BrokenExecutor("killed")

    @contextmanager
    def fresh(_alone: bool) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
        yield submit, 2, bool

    tasks = [task(archive / f"dive_{seed}.mcap", output=tmp_path) for seed in (1, 2)]
    first, second = replay_jobs(tasks, {}, fresh)
    assert isinstance(first.result, LogError)
    assert first.result.message.startswith(f"{archive / 'dive_1.mcap'}: ")
    assert first.result.message.endswith(": killed")
    assert isinstance(second.result, LogError)


def test_workers_end_by_themselves_after_the_last_dive(archive: Path, tmp_path: Path) -> None:
    ends = []

    def submit(*_: object) -> Future[bytes]:
        future: Future[bytes] = Future()
        future.set_exception(LogError("the IMU is dead", "another one"))
        return future

    @contextmanager
    def fresh(_alone: bool) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
        yield submit, 2, bool
        ends.append("by themselves")

    tasks = [task(archive / f"dive_{seed}.mcap", output=tmp_path) for seed in (1, 2)]
    assert len(list(replay_jobs(tasks, {}, fresh))) == 2
    assert ends == ["by themselves"]


def test_an_interruption_while_workers_are_ended_is_not_swallowed() -> None:
    def submit(work: Callable[[str], int], item: str) -> Future[int]:
        future: Future[int] = Future()
        future.set_result(work(item))
        return future

    @contextmanager
    def interrupted(_alone: bool) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
        try:
            yield submit, 1, bool
        except GeneratorExit:
            raise KeyboardInterrupt from None

    outcomes = do_each(int, ["1", "2"], interrupted)
    assert next(outcomes) == (0, 1)
    with pytest.raises(KeyboardInterrupt):
        outcomes.close()


def test_work_whose_answer_is_lost_is_done_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_ANSWERED_WITHIN_S", 0.01)

    @contextmanager
    def forgetful(alone: bool) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
        def submit(work: Callable[[str], int], item: str) -> Future[int]:
            future: Future[int] = Future()
            if alone or item != "2":
                future.set_result(work(item))
            return future

        yield submit, 3, lambda: True

    assert dict(do_each(int, ["1", "2", "3"], forgetful)) == {0: 1, 1: 2, 2: 3}


def test_a_dive_that_a_lost_worker_has_written_is_not_in_the_way(
    archive: Path, tmp_path: Path
) -> None:
    job = task(archive / "dive_1.mcap", output=tmp_path)
    report = replay_into(job)
    assert replay_into(job) == report
    other = task(archive / "dive_1.mcap", output=tmp_path / "new", control=True)
    with pytest.raises(ConfigError, match="exists"):
        replay_into(dataclasses.replace(other, target=job.target))


def test_a_worker_uses_the_noise_that_it_fits(archive: Path, tmp_path: Path) -> None:
    """Of a log that it alone can read; a second try finds its own result, with that noise."""
    options = ReplayOptions(load_config(overrides=["evaluation.starts=1"]))
    (job,) = plan_jobs([FoundDive(archive / "dive_1.mcap")], tmp_path, options)
    assert job.config.noise.fit
    written = replay_into(job)
    report = decode_report(written)
    assert "found_noise" in {note.code for note in report.notes}
    assert report.config["noise"]["fit"] == []
    assert report.config["noise"]["accel_white_mps_rts"] != job.config.noise.accel_white_mps_rts
    assert replay_into(job) == written


def test_two_processes_write_the_bytes_of_one(
    archive: Path, results: Path, tmp_path: Path
) -> None:
    command = "run", "--preset", "levy-klein", archive, "-o", "out"
    done = done_here(*command, "--jobs", "2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert bytes_of(tmp_path / "out") == bytes_of(results)
    assert done.stderr.splitlines()[-1] == "wrote out/index.html"
    again = done_here(*command, cwd=tmp_path)
    assert again.stdout == done.stdout


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Give what a process prints until its end; one that hangs is killed, and does not hang the tests."""
    try:
        return process.communicate(timeout=120)
    except subprocess.TimeoutExpired:
        process.kill()
        raise


@pytest.mark.nightly
def test_a_killed_worker_loses_nothing(archive: Path, results: Path, tmp_path: Path) -> None:
    command = [*TOOL, "run", "--preset", "levy-klein", str(archive), "-o", "out", "--jobs", "2"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_for(tmp_path / "out" / "dive_2", process)
        workers = [
            child
            for child in psutil.Process(process.pid).children()
            if "spawn_main" in str(child.cmdline())
        ]
        workers[0].kill()
        _, err = ended(process)
    assert process.returncode == 0, err
    assert bytes_of(tmp_path / "out") == bytes_of(results)


@pytest.mark.nightly
def test_an_interrupted_run_goes_on_where_it_stopped(
    archive: Path, results: Path, tmp_path: Path
) -> None:
    command = [*TOOL, "run", "--preset", "levy-klein", str(archive), "-o", "out", "--jobs", "2"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_for(tmp_path / "out" / "dive_1", process)
        process.send_signal(signal.SIGTERM)
        _, err = ended(process)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == "error: interrupted"
    assert "Traceback" not in err
    left = [path.name for path in (tmp_path / "out").iterdir()]
    assert "dive_1" in left
    assert not [name for name in left if name.startswith(".") or name == "summary.csv"]
    done = run(archive, "-o", "out", cwd=tmp_path)
    assert done.returncode == 0
    assert "unchanged out/dive_1" in done.stderr
    assert bytes_of(tmp_path / "out") == bytes_of(results)


@pytest.mark.nightly
def test_a_cluster_writes_the_bytes_of_one_process(
    archive: Path, results: Path, tmp_path: Path, cluster: tuple[str, subprocess.Popen[str]]
) -> None:
    done = run(archive, "-o", tmp_path / "out", "--scheduler", cluster[0], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert bytes_of(tmp_path / "out") == bytes_of(results)


@pytest.mark.nightly
def test_a_killed_worker_of_a_cluster_loses_nothing(
    archive: Path, results: Path, tmp_path: Path, cluster: tuple[str, subprocess.Popen[str]]
) -> None:
    address, of_cluster = cluster
    command = [
        *TOOL,
        "run",
        "--preset",
        "levy-klein",
        str(archive),
        "-o",
        str(tmp_path / "out"),
        "--scheduler",
        address,
    ]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_for(tmp_path / "out" / "dive_1", process)
        children = psutil.Process(of_cluster.pid).children(recursive=True)
        next(child for child in children if "spawn_main" in str(child.cmdline())).kill()
        _, err = ended(process)
    assert process.returncode == 0, err
    assert bytes_of(tmp_path / "out") == bytes_of(results)


@pytest.mark.nightly
def test_a_cluster_that_is_not_there_is_an_error(archive: Path, tmp_path: Path) -> None:
    done = run(archive, "-o", "out", "--scheduler", "tcp://127.0.0.1:9", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: --scheduler tcp://127.0.0.1:9: ")
