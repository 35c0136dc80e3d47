"""What is said of trajectories that are compared with a reference: screens, notes and errors."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from as_text import Cases, spoken
from made_tracks import error_m, truth_m, write_dives, write_tum

Words = list[str]
SIDES = ["old", "new", "--reference", "truth"]


def said_of_trajectories(folder: Path) -> Cases:
    """Return what `compare --reference` says, each case on files of its own."""
    yield from _spoken(folder / "good", lambda _: None, SIDES, [*SIDES, "-q"], [*SIDES, "-v"])
    yield from _spoken(folder / "two", _third, ["old", "new", "third", "--reference", "truth"])
    yield from _spoken(folder / "one", lambda _: None, [*SIDES, "--dive", "dive_1"])
    yield from _spoken(folder / "repeats", _runs, SIDES)
    yield from _spoken(folder / "aligned", lambda _: None, [*SIDES, "--align", "yaw", "-q"])
    cases = {
        "copy": _copy,
        "noise": _noise,
        "runs": _runs,
        "short": _short,
        "clocks": _clocks,
        "axes": _axes,
        "unmatched": _unmatched,
        "frames": _frames,
        "same dive": _same_dive,
        "quaternions": _quaternions,
        "empty": _empty,
    }
    for name, change in cases.items():
        yield from _spoken(folder / name, change, [*SIDES, "-q"])
    wrong = (
        ["old", "absent", "--reference", "truth"],
        ["old", "old", "--reference", "old"],
        ["old", "new", "old"],
        ["old", "new", "--align", "yaw"],
        [*SIDES, "--all"],
        [*SIDES, "--rpe", "5 km"],
        [*SIDES, "--primary", "outage_60s"],
        [*SIDES, "--fail-on", "5%"],
        [*SIDES, "--dive", "dive_11"],
        ["old", "truth/dive_1.tum", "--reference", "truth"],
        ["old:/odom", "new", "--reference", "truth"],
    )
    yield from _spoken(folder / "wrong", lambda _: None, *wrong)


def _spoken(folder: Path, change: Callable[[Path], None], *commands: Words) -> Cases:
    write_dives(folder)
    change(folder)
    for words in commands:
        title = f"{folder.name}: compare {' '.join(words)}"
        yield title, spoken(folder, "compare", *words)


def _tracks(folder: Path, side: str, ratio: float = 0.5) -> list[tuple[Path, np.ndarray, int]]:
    """Return file, track and number of each dive."""
    found = []
    for number in range(4):
        track = truth_m(number) + ratio * error_m(number)
        found.append((folder / side / f"dive_{number}.tum", track, number))
    return found


def _third(folder: Path) -> None:
    for path, track, number in _tracks(folder, "third", 0.9):
        write_tum(path, track, number)


def _copy(folder: Path) -> None:
    shutil.rmtree(folder / "new")
    shutil.copytree(folder / "old", folder / "new")


def _noise(folder: Path) -> None:
    rng = np.random.default_rng(5)
    for path, track, number in _tracks(folder, "truth", 0.0):
        write_tum(path, track + rng.normal(0.0, 3.0, track.shape), number)


def _runs(folder: Path) -> None:
    shutil.rmtree(folder / "new")
    for run, ratio in ((1, 0.5), (2, 1.1)):
        for path, track, number in _tracks(folder, f"new/run_{run}", ratio):
            write_tum(path, track, number)


def _short(folder: Path) -> None:
    for path, track, number in _tracks(folder, "new"):
        write_tum(path, track, number, rows=slice(0, (150, 300, 400, 400)[number]))


def _clocks(folder: Path) -> None:
    for path, track, number in _tracks(folder, "new"):
        write_tum(path, track, number, late_s=7200.0)


def _axes(folder: Path) -> None:
    for path, track, number in _tracks(folder, "new"):
        write_tum(path, track[:, [1, 0, 2]] * [1.0, 1.0, -1.0], number)


def _unmatched(folder: Path) -> None:
    (folder / "new" / "dive_3.tum").unlink()
    (folder / "old" / "readme.md").write_text("no trajectory", "utf-8")
    (folder / "new" / "dive_2.tum").write_text("1 2 3\n", "utf-8")


def _frames(folder: Path) -> None:
    for side in ("old", "new"):
        for path, track, number in _tracks(folder, side):
            write_tum(path, track + np.array([400.0, 70.0, 3.0]), number)


def _same_dive(folder: Path) -> None:
    for side in ("old", "new", "truth"):
        shutil.copy(folder / side / "dive_1.tum", folder / side / "copy.tum")
        shutil.copy(folder / side / "dive_2.tum", folder / side / "other.tum")
    for path, track, number in _tracks(folder, "old", 0.9)[2:3]:
        write_tum(path.with_name("other.tum"), track, number)


def _quaternions(folder: Path) -> None:
    for path in sorted((folder / "new").iterdir()):
        lines = [line.split() for line in path.read_text("utf-8").splitlines()]
        texts = [" ".join([*words[:7], "0.5"]) for words in lines]
        texts[7] = " ".join([lines[7][0], "nan", *lines[7][2:]])
        path.write_text("\n".join(texts) + "\n", "utf-8")


def _empty(folder: Path) -> None:
    for path in (folder / "new").iterdir():
        path.write_text("", "utf-8")
