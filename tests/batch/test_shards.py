"""Shards of a run, each on its own, and their merge: the same bytes as one run, or a sentence that says why not."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from in_process import done_here
from remote_server import served

from insdvl_replay.batch.found import FoundDive, dive_of_url
from insdvl_replay.batch.shards import Shard
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

SHARDS = 3
QUICK = ["--set", "evaluation.starts=1"]
GIVEN = ["--preset", "levy-klein", *QUICK]
BROKEN = b"no log" * 100


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven dives of 20 s, and before them a file that is no log."""
    folder = tmp_path_factory.mktemp("archive")
    for seed in range(1, 8):
        dive = simulate_dive("straight", seed=seed, duration_s=20.0, imu_rate_hz=50.0)
        write_dive(folder / f"dive_{seed}.mcap", dive)
    (folder / "broken.mcap").write_bytes(BROKEN)
    return folder


@pytest.fixture(scope="module")
def whole(archive: Path) -> Path:
    """The results of one run, whose noise is given."""
    return one_run(archive, *GIVEN)


@pytest.fixture(scope="module")
def shards(archive: Path) -> Path:
    """The folders of its shards."""
    return all_shards(archive, *GIVEN)


@pytest.fixture
def parts(shards: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    return Path(shutil.copytree(shards, tmp_path / "parts"))


def one_run(archive: Path, *options: str | Path) -> Path:
    done = done_here("run", archive, "-o", "whole", *options, cwd=archive.parent)
    assert done.returncode == 3
    return archive.parent / "whole"


def all_shards(archive: Path, *options: str | Path) -> Path:
    for number in range(1, SHARDS + 1):
        target = f"parts/{number}"
        share = f"{number}/{SHARDS}"
        done = done_here(
            "run", archive, "-o", target, *options, "--shard", share, cwd=archive.parent
        )
        assert done.returncode == 3 * (number == 1), done.stderr
    return archive.parent / "parts"


def merged(parts: Path, *options: str) -> Any:
    folders = sorted(parts.iterdir())
    return done_here("merge", *folders, "-o", "merged", *options, cwd=parts.parent)


def bytes_of(output: Path) -> dict[str, bytes]:
    """Every file of a result; of a report without the tool, which has the time of day."""
    found = {}
    for path in output.rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            if path.name == "report.json":
                data = msgspec.json.encode({**json.loads(data), "tool": None})
            found[str(path.relative_to(output))] = data
    return found


# --- Which dives a shard has.


def names_of(shard: Shard, dives: list[FoundDive]) -> set[str]:
    return {dives[place].path.name for place in shard.places(dives)}


def test_shards_are_all_dives_once_and_of_one_size() -> None:
    dives = [FoundDive(Path(f"dives/dive_{number}.mcap")) for number in range(1, 24)]
    shares = [Shard(number, 5).places(dives) for number in range(1, 6)]
    assert sorted(place for share in shares for place in share) == list(range(23))
    assert [len(share) for share in shares] == [5, 5, 5, 4, 4]


@pytest.mark.parametrize("folder", ["/data/dives", "/share/archive", "relative"])
def test_a_share_depends_neither_on_the_order_nor_on_the_machine(folder: str) -> None:
    usual = [FoundDive(Path(f"/vehicle/dive_{number}.mcap")) for number in range(1, 12)]
    others = [FoundDive(Path(f"{folder}/dive_{number}.mcap")) for number in (3, 11, 7, 1, 9)]
    others += [FoundDive(Path(f"{folder}/dive_{number}.mcap")) for number in (10, 2, 8, 4, 6, 5)]
    for number in (1, 2, 3):
        shard = Shard(number, 3)
        assert names_of(shard, usual) == names_of(shard, others)
        assert shard.places(others) == sorted(shard.places(others))
    assert names_of(Shard(2, 3), usual) == {f"dive_{number}.mcap" for number in (2, 5, 8, 11)}


def test_dives_of_one_name_are_told_apart_by_their_folders() -> None:
    dives = [FoundDive(Path(f"/a/{day}/dive.mcap")) for day in ("tuesday", "monday")]
    assert Shard(1, 2).places(dives) == [1]
    assert Shard(2, 2).places(dives) == [0]


def test_a_remote_log_has_a_share_before_it_is_fetched() -> None:
    dives = [dive_of_url(f"https://logs.example/{name}.mcap?key=k") for name in "bca"]
    assert [Shard(number, 3).places(dives) for number in (1, 2, 3)] == [[2], [0], [1]]


# --- The same bytes as one run.


def test_merged_shards_are_one_run(whole: Path, parts: Path) -> None:
    done = merged(parts)
    assert done.returncode == 3
    assert "broken" in done.stderr.splitlines()[-1]
    assert bytes_of(parts.parent / "merged") == bytes_of(whole)
    again = merged(parts)
    assert "unchanged merged/dive_1" in again.stderr
    assert "wrote merged/dive" not in again.stderr
    assert bytes_of(parts.parent / "merged") == bytes_of(whole)


@pytest.mark.parametrize("options", [("--format", "csv"), ("--table", "pooled"), ("-q",), ("-v",)])
@pytest.mark.nightly
def test_a_merge_prints_what_a_run_prints(
    archive: Path, whole: Path, parts: Path, options: tuple[str, ...]
) -> None:
    assert whole.is_dir()
    run = done_here("run", archive, "-o", "whole", *GIVEN, *options, cwd=archive.parent)
    folders = sorted(parts.iterdir())
    command = ["merge", *folders, "-o", "elsewhere"]
    assert done_here(*command, "-q", cwd=parts.parent).returncode == 3
    done = done_here(*command, *options, cwd=parts.parent)
    assert done.returncode == run.returncode
    assert done.stdout == run.stdout.replace("whole/", "elsewhere/")


@pytest.mark.nightly
def test_shards_have_the_noise_that_one_run_fits(archive: Path, tmp_path: Path) -> None:
    logs = Path(shutil.copytree(archive, tmp_path / "logs"))
    whole = one_run(logs, *QUICK)
    assert (whole / "dive_1" / "vehicle.toml").is_file()
    parts = all_shards(logs, *QUICK)
    assert merged(parts).returncode == 3
    assert bytes_of(tmp_path / "merged") == bytes_of(whole)


@pytest.mark.nightly
def test_all_shards_may_be_in_one_folder_and_in_that_of_the_results(
    archive: Path, whole: Path, tmp_path: Path
) -> None:
    for number in (2, 1):
        share = ["--shard", f"{number}/2", "-o", "all", *GIVEN]
        done = done_here("run", archive, *share, cwd=tmp_path)
        assert done.stdout.startswith(f"shard {number}/2: 4 of 8 dives")
    done = done_here("merge", "all", "-o", "all", cwd=tmp_path)
    assert done.returncode == 3
    found = bytes_of(tmp_path / "all")
    assert found.pop("shard_1_of_2.json")
    assert found.pop("shard_2_of_2.json")
    assert found == bytes_of(whole)


def test_a_single_dive_has_no_overviews(archive: Path, tmp_path: Path) -> None:
    log = archive / "dive_1.mcap"
    done_here("run", log, "-o", "whole", *GIVEN, cwd=tmp_path)
    for number in (1, 2):
        done = done_here("run", log, "-o", "parts", *GIVEN, "--shard", f"{number}/2", cwd=tmp_path)
        assert done.returncode == 0
        assert done.stdout == f"shard {number}/2: {2 - number} of 1 dive\n"
    done = done_here("merge", "parts", "-o", "merged", cwd=tmp_path)
    assert done.returncode == 0
    assert bytes_of(tmp_path / "merged") == bytes_of(tmp_path / "whole")


@pytest.mark.nightly
def test_a_shard_fetches_its_own_logs_and_those_that_the_noise_is_fitted_to(
    archive: Path, tmp_path: Path, cache: Path
) -> None:
    logs = {f"/{path.name}": path.read_bytes() for path in sorted(archive.glob("dive_*.mcap"))}
    with served(logs) as server:
        (tmp_path / "dives.txt").write_text("".join(f"{server.url}{name}\n" for name in logs))
        for options, fetched in ((GIVEN, 1), (QUICK, 6)):
            shutil.rmtree(cache, ignore_errors=True)
            server.asked.clear()
            share = ["--shard", "7/7", "--force"]
            done = done_here("run", "dives.txt", "-o", "part", *options, *share, cwd=tmp_path)
            assert done.returncode == 0, done.stderr
            assert server.asked.count("GET") == fetched


@pytest.mark.nightly
def test_a_check_of_a_shard_has_the_noise_of_all_dives(archive: Path, tmp_path: Path) -> None:
    gate = '[[gate]]\nname = "near"\ntable = "evidence"\nrow = "position"\ncolumn = "ratio"\nmax = 9.0'
    (tmp_path / "gates.toml").write_text(f'dives = ["{archive}/dive_*.mcap"]\n{gate}\n')
    for number in (1, 2):
        share = ["--shard", f"{number}/2", "--results", "shards"]
        assert done_here("check", "gates.toml", *QUICK, *share, cwd=tmp_path).returncode == 0
    assert (
        done_here("check", "gates.toml", *QUICK, "--results", "all", cwd=tmp_path).returncode == 0
    )
    assert bytes_of(tmp_path / "shards") == bytes_of(tmp_path / "all")


# --- What a shard may not decide alone.


def test_a_dive_that_needs_other_settings_fails_with_a_way_out(tmp_path: Path) -> None:
    dive = simulate_dive("static", seed=1, duration_s=45.0, imu_rate_hz=50.0)
    write_dive(tmp_path / "still.mcap", replace(dive, truth=None))
    done = done_here("run", "still.mcap", *QUICK, "--shard", "1/1", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stdout == "shard 1/1: 1 of 1 dive, 1 failed\n"
    assert "run without --shard over a few of the dives first" in done.stderr
    given = done_here("run", "still.mcap", *GIVEN, "--no-auto", "--shard", "1/1", cwd=tmp_path)
    assert given.returncode == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--shard", "3/2"], "3/2"),
        (["--shard", "1/2", "--against", "dvl.scale=1.1"], "--against"),
        (["--shard", "1/2", "--one-dive"], "--one-dive"),
        (["--shard", "1/2", "--table", "pooled"], "--table"),
        (["--shard", "1/2", "--format", "json"], "--format"),
        (["--shard", "3/2"], "is not a part"),
        (["--shard", "1/100000"], "is not a part"),
        (["--shard", "1/" + "9" * 5000], "is not a part"),
    ],
)
def test_options_that_are_about_all_dives_are_refused(
    archive: Path, tmp_path: Path, options: list[str], said: str
) -> None:
    done = done_here("run", archive, "-o", "out", *options, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


# --- Parts that are no whole run.


def change(parts: Path, number: int, edit: Callable[[dict[str, Any]], None]) -> None:
    file = parts / str(number) / f"shard_{number}_of_{SHARDS}.json"
    content = json.loads(file.read_text("utf-8"))
    edit(content)
    file.write_text(json.dumps(content), "utf-8")


def remove_shard(parts: Path) -> None:
    shutil.rmtree(parts / "2")


def interrupt_shard(parts: Path) -> None:
    (parts / "2" / "shard_2_of_3.json").unlink()


def copy_shard(parts: Path) -> None:
    shutil.copytree(parts / "2", parts / "2b")


def cut_in_four(parts: Path) -> None:
    change(parts, 2, lambda content: content.update(shards=4))


def rename_dive(parts: Path) -> None:
    change(parts, 2, lambda content: content["dives"][1].update(name="dive_17"))
    change(
        parts,
        2,
        lambda content: content["results"].update(dive_17=content["results"].pop("dive_1")),
    )


def set_otherwise(parts: Path) -> None:
    change(parts, 2, lambda content: content["dives"][1].update(settings="f" * 16))


def make_newer(parts: Path) -> None:
    change(parts, 3, lambda content: content["tool"].update(version="9.9"))


def use_other_numpy(parts: Path) -> None:
    change(parts, 3, lambda content: content["versions"].update(numpy="1.0"))


def fit_other_noise(parts: Path) -> None:
    (settings,) = json.loads((parts / "1" / "shard_1_of_3.json").read_text())["noise"]
    change(parts, 3, lambda content: content["noise"].update({settings: "f" * 16}))


def make_all_newer(parts: Path) -> None:
    for number in (1, 2, 3):
        change(parts, number, lambda content: content["tool"].update(sources="other"))


def lose_dive(parts: Path) -> None:
    change(parts, 2, lambda content: content["results"].pop("dive_1"))


def have_dive_twice(parts: Path) -> None:
    change(parts, 1, lambda content: content["results"].update(dive_1="f"))


def cut_result(parts: Path) -> None:
    page = parts / "2" / "dive_1" / "report.html"
    page.write_bytes(page.read_bytes()[:-10])


def remove_result(parts: Path) -> None:
    shutil.rmtree(parts / "2" / "dive_1")


def replay_otherwise(parts: Path) -> None:
    """A later run with other settings has replaced a result of the shard."""
    shutil.rmtree(parts / "2" / "dive_1")
    shutil.copytree(parts / "2" / "dive_4", parts / "2" / "dive_1")


def cut_file(parts: Path) -> None:
    file = parts / "2" / "shard_2_of_3.json"
    file.write_bytes(file.read_bytes()[:100])


def climb_out(parts: Path) -> None:
    change(parts, 2, lambda content: content["dives"][1].update(name="../dive_1"))


def name_twice(parts: Path) -> None:
    change(parts, 2, lambda content: content["dives"].append(content["dives"][0]))


def be_of_many(parts: Path) -> None:
    change(parts, 2, lambda content: content.update(shards=10**13))


def be_another_kind(parts: Path) -> None:
    change(parts, 2, lambda content: content.update(kind="comparison"))


def fail_with(exit_code: int) -> Callable[[Path], None]:
    """Return what makes a dive failed, with an exit code."""

    def edit(content: dict[str, Any]) -> None:
        name, _ = content["results"].popitem()
        content["failed"][name] = {"reason": "x", "hint": "", "exit_code": exit_code}

    return lambda parts: change(parts, 2, edit)


@pytest.mark.parametrize(
    ("harm", "code", "said"),
    [
        (remove_shard, 2, " 2/3"),
        (interrupt_shard, 2, "parts/2"),
        (copy_shard, 2, "2b"),
        (cut_in_four, 2, " 4"),
        (rename_dive, 2, "dive_1, dive_17"),
        (set_otherwise, 2, "dive_1"),
        (make_newer, 2, "9.9"),
        (use_other_numpy, 2, "numpy"),
        (fit_other_noise, 2, "shard_3_of_3.json"),
        (make_all_newer, 2, "(other)"),
        (lose_dive, 2, "dive_1"),
        (have_dive_twice, 2, "dive_1"),
        (cut_result, 3, "parts/2/dive_1"),
        (remove_result, 3, "parts/2/dive_1"),
        (replay_otherwise, 3, "parts/2/dive_1"),
        (cut_file, 3, "shard_2_of_3.json"),
        (climb_out, 3, "shard_2_of_3.json"),
        (name_twice, 3, "its dives cannot be"),
        (be_of_many, 3, "its shard cannot be"),
        (be_another_kind, 3, "shard_2_of_3.json"),
        (fail_with(0), 3, "its exit_code cannot be"),
        (fail_with(77), 3, "its exit_code cannot be"),
    ],
)
def test_parts_that_are_no_whole_run_are_refused_in_a_sentence(
    parts: Path, harm: Callable[[Path], None], code: int, said: str
) -> None:
    harm(parts)
    done = merged(parts)
    assert done.returncode == code
    [line] = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert said in line
    assert "; hint: " in line
    assert not (parts.parent / "merged").exists()


def test_a_part_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    done = done_here("merge", "nowhere", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error: nowhere: ")


def test_an_interrupted_shard_goes_on_where_it_stopped(
    archive: Path, whole: Path, parts: Path
) -> None:
    interrupt_shard(parts)
    shutil.rmtree(parts / "2" / "dive_4")
    command = ["run", archive, "-o", "parts/2", *GIVEN, "--shard", "2/3"]
    done = done_here(*command, cwd=parts.parent)
    assert done.returncode == 0
    assert "unchanged parts/2/dive_1" in done.stderr
    assert "wrote parts/2/dive_4" in done.stderr
    assert merged(parts).returncode == 3
    assert bytes_of(parts.parent / "merged") == bytes_of(whole)


def test_other_results_are_replaced_by_force_alone(
    archive: Path, whole: Path, parts: Path
) -> None:
    others = done_here(
        "run",
        archive / "dive_1.mcap",
        "-o",
        "merged",
        *GIVEN,
        "--set",
        "dvl.scale=1.1",
        cwd=parts.parent,
    )
    assert others.returncode == 0
    refused = merged(parts)
    assert refused.returncode == 2
    assert "merged/dive_1" in refused.stderr
    assert merged(parts, "--force").returncode == 3
    assert bytes_of(parts.parent / "merged") == bytes_of(whole)
