"""What the files of the benchmark of trajectories hold, and how it counts words on them."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trajectory_worlds
from judged import Compared
from made_trajectories import KINDS, Sampling, Track, drawn_track, write_tum
from trajectory_sets import SETS, Repeats, SetKind, SetTruth, make_set
from trajectory_worlds import QUESTIONS, JudgedSet, Task, judged_set, page

SHORT_S = (60.0, 90.0)
NOTHING = Compared("", math.nan, math.nan, math.nan, 0, 2, "error: no file")


def made(tmp_path: Path, kind: SetKind, dives: int) -> SetTruth:
    """Make a set of short dives, the same whenever it is asked for."""
    return make_set(kind, dives, np.random.default_rng(3), tmp_path)


def positions(folder: Path) -> list[np.ndarray]:
    """Read times and positions of all files of one side, in the order of their paths."""
    return [np.loadtxt(path)[:, :4] for path in sorted(folder.rglob("*.tum"))]


def horizontal_rms(table: np.ndarray, truth: np.ndarray) -> float:
    """Compare two files with the same times."""
    assert np.array_equal(table[:, 0], truth[:, 0])
    return float(np.sqrt(np.mean(np.sum((table - truth)[:, 1:3] ** 2, axis=1))))


def word_of(word: str, ratio: float = 1.0, dives: int = 3) -> Compared:
    """Say a word with an interval of a factor 1.1 about a ratio."""
    return Compared(word, ratio, ratio / 1.1, ratio * 1.1, dives, 0, "")


def number_of(name: str) -> int:
    """Find a kind of set by its name."""
    return [kind.name for kind in SETS].index(name)


def said(kind: str, found: Compared, log_ratio: float = 0.0) -> JudgedSet:
    """Let the tool say something of three dives with the same true ratio."""
    return JudgedSet(number_of(kind), 0, 3, SetTruth((log_ratio,) * 3), found)


@pytest.mark.parametrize("error", KINDS)
def test_files_err_by_the_ratio_that_is_told(tmp_path: Path, error: str) -> None:
    kind = SetKind("", "change", (2,), 0.7, 0.2, errors=(error,), duration_s=SHORT_S)
    truth = made(tmp_path, kind, 2)
    sides = [positions(tmp_path / side) for side in ("OLD", "NEW", "TRUTH")]
    for old, new, true, log_ratio in zip(*sides, truth.log_ratios, strict=True):
        ratio = horizontal_rms(new, true) / horizontal_rms(old, true)
        assert math.log(ratio) == pytest.approx(log_ratio, abs=2e-3)
    assert truth.log_ratios[0] != truth.log_ratios[1]


def test_dives_are_of_different_days(tmp_path: Path) -> None:
    made(tmp_path, SetKind("", "equal", (2,), duration_s=SHORT_S), 2)
    first, second = positions(tmp_path / "TRUTH")
    assert second[0, 0] - first[-1, 0] > 80_000.0


def test_a_copy_differs_by_its_noise_alone(tmp_path: Path) -> None:
    made(tmp_path, SetKind("", "copy", (1,), copy_noise_m=1e-6, duration_s=SHORT_S), 1)
    (old,) = positions(tmp_path / "OLD")
    (new,) = positions(tmp_path / "NEW")
    assert 0.5e-6 < float(np.std((new - old)[:, 1:])) < 2e-6


def test_runs_that_cancel_have_the_ratio_of_their_dive(tmp_path: Path) -> None:
    repeats = Repeats(2, 0.3, is_by_run=True, old_too=False)
    kind = SetKind("", "no word", (1,), 1.0, 0.0, repeats=repeats, duration_s=SHORT_S)
    truth = made(tmp_path, kind, 1)
    (old,) = positions(tmp_path / "OLD")
    (true,) = positions(tmp_path / "TRUTH")
    logs = []
    for new in positions(tmp_path / "NEW"):
        logs.append(math.log(horizontal_rms(new, true) / horizontal_rms(old, true)))
    assert logs == pytest.approx([-0.3, 0.3], abs=5e-3)
    assert truth.log_ratios == pytest.approx([0.0])


def test_a_dive_that_lacks_a_file_is_not_compared(tmp_path: Path) -> None:
    kind = SetKind("", "equal", (3,), missing=("NEW",), duration_s=SHORT_S)
    truth = made(tmp_path, kind, 3)
    assert len(truth.log_ratios) == 2
    names = [sorted(path.name for path in (tmp_path / side).iterdir()) for side in ("OLD", "NEW")]
    assert names == [["dive_01.tum", "dive_02.tum", "dive_03.tum"], ["dive_01.tum", "dive_03.tum"]]


def test_the_noise_of_a_reference_is_as_large_as_told(tmp_path: Path) -> None:
    quiet = made(tmp_path / "quiet", SetKind("", "equal", (1,), duration_s=SHORT_S), 1)
    noisy_kind = SetKind("", "equal", (1,), noise=3.0, duration_s=SHORT_S)
    assert made(tmp_path / "noisy", noisy_kind, 1) == quiet
    (old,) = positions(tmp_path / "quiet" / "OLD")
    (true,) = positions(tmp_path / "quiet" / "TRUTH")
    (noisy,) = positions(tmp_path / "noisy" / "TRUTH")
    assert horizontal_rms(noisy, true) == pytest.approx(3.0 * horizontal_rms(old, true), rel=0.15)


def test_a_reference_may_state_its_noise(tmp_path: Path) -> None:
    kind = SetKind("", "equal", (1,), noise=3.0, is_noise_stated=True, duration_s=SHORT_S)
    made(tmp_path / "stated", kind, 1)
    made(tmp_path / "quiet", SetKind("", "equal", (1,), duration_s=SHORT_S), 1)
    table = np.genfromtxt(tmp_path / "stated" / "TRUTH" / "dive_01.csv", delimiter=",", names=True)
    (true,) = positions(tmp_path / "quiet" / "TRUTH")
    (sd_m,) = np.unique(table["x_sd"])
    assert float(np.std(table["x"] - true[:, 1])) == pytest.approx(sd_m, rel=0.15)


def test_files_are_sampled_as_told(tmp_path: Path) -> None:
    track = drawn_track(100.0, np.random.default_rng(1))
    sampling = Sampling(
        rate_hz=2.0, phase_s=0.25, end_share=0.9, hole=(0.5, 0.7), clock_s=0.0, clock_ppm=1e4
    )
    write_tum(tmp_path / "one.tum", track, None, sampling)
    times_s = np.loadtxt(tmp_path / "one.tum")[:, 0] / 1.01
    assert times_s[0] == pytest.approx(0.25)
    assert times_s[-1] == pytest.approx(89.75)
    assert float(np.diff(times_s).max()) == pytest.approx(20.0, abs=0.6)
    assert sorted(np.diff(times_s))[0] == pytest.approx(0.5)


def test_attitudes_are_those_of_the_track(tmp_path: Path) -> None:
    track: Track = drawn_track(60.0, np.random.default_rng(1))
    write_tum(tmp_path / "one.tum", track, None, Sampling(rate_hz=10.0))
    table = np.loadtxt(tmp_path / "one.tum")
    x, y, z, w = table[:, 4:].T
    forward = np.column_stack(
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)]
    )
    np.testing.assert_allclose(forward, track.mat[:, :, 0], atol=1e-6)
    # It goes where it looks, but for some drift.
    along_m = np.sum(np.diff(table[:, 1:4], axis=0) * forward[:-1], axis=1)
    assert float(along_m.mean()) / 0.1 > 0.9


@pytest.mark.parametrize(
    ("kind", "word", "log_ratio", "faults"),
    [
        ("equal: s 0.1", "better", 0.0, {"is_wrong"}),
        ("equal: s 0.1", "mixed", 0.0, {"is_wrong"}),
        ("equal: s 0.1", "equivalent", 0.0, {"is_right"}),
        ("equal: s 0.1", "undecided", 0.0, set()),
        ("changed: 0.8, s 0.1", "better", -0.22, {"is_right"}),
        ("changed: 0.8, s 0.1", "equivalent", -0.22, {"is_wrong"}),
        ("changed: 0.8, s 0.1", "worse", -0.22, {"is_wrong", "is_opposite"}),
        ("changed: 0.8, s 0.1", "mixed", -0.22, set()),
        ("copy: the same files", "no effect", 0.0, {"is_right"}),
        ("copy: the same files", "equivalent", 0.0, {"is_wrong"}),
        ("few: one or two dives", "better", -0.7, {"is_wrong"}),
        ("few: one or two dives", "undecided", -0.7, {"is_right"}),
        ("mixed: heading worse", "better", -0.7, {"is_wrong"}),
        ("mixed: heading worse", "mixed", -0.7, {"is_right"}),
    ],
)
def test_words_are_held_against_the_truth(
    kind: str, word: str, log_ratio: float, faults: set[str]
) -> None:
    one = said(kind, word_of(word, math.exp(log_ratio)), log_ratio)
    parts = ("is_wrong", "is_right", "is_opposite", "is_broken", "is_miscounted", "is_off")
    assert {part for part in parts if getattr(one, part)} == faults


def test_a_ratio_that_is_off_is_seen_and_so_are_dives_that_are_counted_twice() -> None:
    kind = "changed: 0.8, s 0.1"
    log_ratio = math.log(0.8)
    assert said(kind, word_of("better", 0.83), log_ratio).is_off
    assert not said(kind, word_of("better", 0.81), log_ratio).is_off
    assert said(kind, word_of("better", 0.8, dives=6), log_ratio).is_miscounted
    assert said(kind, word_of("better", 0.87), log_ratio).misses is False
    assert said(kind, word_of("better", 0.95), log_ratio).misses is True


def test_files_may_be_refused_with_a_sentence_and_in_no_other_way() -> None:
    kind = "clocks: NEW begins at 0 s"
    assert not said(kind, NOTHING).is_broken
    assert said(kind, NOTHING._replace(code=4)).is_broken
    assert said(kind, NOTHING._replace(stderr="Traceback (most recent call last)")).is_broken
    assert said(kind, word_of("undecided")._replace(code=1)).is_broken


def use_rule(monkeypatch: pytest.MonkeyPatch, word: Callable[[SetKind], str]) -> None:
    """Let words of the test, by the kind of set, stand in for those of the tool."""
    kinds = iter([SETS[task.kind] for task in trajectory_worlds.tasks_of(1, 1)])

    def make(kind: SetKind, dives: int, *_: object) -> SetTruth:
        return SetTruth((math.log(kind.ratio),) * (dives - bool(kind.missing)))

    def compared(*_: Path) -> Compared:
        kind = next(kinds)
        return word_of(word(kind), kind.ratio, dives=0)

    monkeypatch.setattr(trajectory_worlds, "make_set", make)
    monkeypatch.setattr(trajectory_worlds, "compared", compared)


def all_sets() -> list[JudgedSet]:
    """Judge all sets in this process."""
    return [judged_set(task) for task in trajectory_worlds.tasks_of(1, 1)]


def unmet(text: str) -> list[str]:
    """Name the rows of the table of rates that have a star."""
    rates = text.partition("The word is that")[0]
    return [line.split("|")[1].strip() for line in rates.splitlines() if " * |" in line]


def test_a_rule_that_knows_the_truth_meets_what_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    def word(kind: SetKind) -> str:
        if kind.truth == "change":
            return "better" if kind.ratio < 1.0 else "worse"
        return {
            "equal": "undecided", "copy": "no effect", "no word": "undecided", "mixed": "mixed"
        }[kind.truth]  # fmt: skip

    use_rule(monkeypatch, word)
    text, all_met = page(all_sets(), 1.0)
    # All dives are said to be 0.
    assert unmet(text) == ["all with a word, another number of dives"]
    assert not all_met


def test_a_rule_that_always_believes_in_gain_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, lambda _: "better")
    text, all_met = page(all_sets(), 1.0)
    assert not all_met
    asked = set[str]()
    for question in QUESTIONS:
        if question.part in ("is_wrong", "is_opposite") and question.asked_pct is not None:
            asked.add(question.asks)
    assert asked <= {*unmet(text)}


def test_a_rule_that_says_nothing_finds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, lambda _: "undecided")
    text, _ = page(all_sets(), 1.0)
    assert unmet(text) == [
        "true changes of 20 %, s 0.1, found",
        "true changes of 20 %, s 0.2, found",
        "copies, said anything but *no effect*",
        "repeats that hardly differ, 0.5 found",
    ]


def test_sets_have_seeds_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectory_worlds, "compared", lambda *_: NOTHING)
    kind = number_of("power: 0.8, s 0.1, 3 dives")
    first, second, again = (judged_set(Task(kind, number, 1)) for number in (0, 1, 0))
    assert first == again
    assert first.truth != second.truth
