"""The answer of `compare`: each filter, new against old, by the tests of a verdict."""

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from small_results import content, write

from insdvl_replay.changes.answer import Answer, answers_of
from insdvl_replay.changes.comparison import compare_results
from insdvl_replay.changes.comparison_document import answer_lines
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.result import StoredReport, StoredResult
from insdvl_replay.core.states import COLUMNS
from insdvl_replay.replay import replay_dive
from insdvl_replay.results.result_files import report_of
from insdvl_replay.results.trajectory import Trajectory, write_trajectory
from insdvl_replay.show.render import render
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors

QUANTITIES = {"drift_30s": ("accuracy", "m"), "drift_60s": ("accuracy", "m"), "outage_60s": ("outage", "m")}
FACTORS = (1.6, 1.5, 1.7, 1.55, 1.65, 1.6, 1.5, 1.7)  # eight dives that nearly agree


def result(name: str, factors: dict[str, float], **changes: Any) -> dict[str, Any]:
    """A report whose baseline has errors of 1, and whose candidate of 0.8, times factors by quantity."""
    made = content(name, **changes)
    made["tables"]["evidence"] = [
        {"log": name, "filter": "aided", "evidence": kind, "quantity": quantity, "unit": unit,
         "baseline": factors.get(quantity, 1.0), "value": 0.8 * factors.get(quantity, 1.0), "ratio": 0.8, "low": 0.7,
         "high": 0.9, "effective_samples": 20.0, "starts": 16, "windows": 70, "verdict": "better"}
        for quantity, (kind, unit) in QUANTITIES.items()
    ]  # fmt: skip
    return made


def answers(folder: Path, new: Sequence[dict[str, float]], scale: float = 1.0, **changes: Any) -> list[Answer]:
    """Compare dives without a change, with small differences of their own, with the same times factors."""
    for number, factors in enumerate(new):
        own = dict.fromkeys(QUANTITIES, 1.0 + 0.1 * number)
        write(folder / "old" / f"d{number}", result(f"d{number}", own))
        changed = result(f"d{number}", {name: own[name] * factors.get(name, 1.0) for name in QUANTITIES}, **changes)
        changed["config"]["dvl"]["scale"] = scale
        write(folder / "new" / f"d{number}", changed)
    return [*compare_results(folder / "old", folder / "new").answers]


def test_a_change_that_affects_all_filters_alike_is_found(tmp_path: Path) -> None:
    found = answers(tmp_path, [dict.fromkeys(QUANTITIES, factor) for factor in FACTORS])
    assert [(answer.filter, answer.verdict) for answer in found] == [("baseline", "worse"), ("aided", "worse")]
    drift = found[0].rows[0]
    assert drift.ratio == pytest.approx(math.prod(FACTORS) ** (1.0 / 8.0))
    assert (drift.quantity, drift.dives, drift.dives_won) == ("drift_30s", 8, 0)
    better = answers(tmp_path / "back", [dict.fromkeys(QUANTITIES, 1.0 / factor) for factor in FACTORS])
    assert {answer.verdict for answer in better} == {"better"}


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.009])
@pytest.mark.parametrize("dives", [1, 2, 8])
def test_no_effect_or_one_below_1_percent_is_equivalent(size: float, dives: int, tmp_path: Path) -> None:
    """Even a change that all dives have to the digit."""
    found = answers(tmp_path, [dict.fromkeys(QUANTITIES, 1.0 + size)] * dives)
    assert {answer.verdict for answer in found} == {"equivalent"}
    assert {row.verdict for answer in found for row in answer.rows} == {"equivalent"}


def test_an_error_from_zero_is_no_small_change(tmp_path: Path) -> None:
    for side, error in (("old", 0.0), ("new", 5.0)):
        made = result("dive", {"drift_30s": error})
        made["config"]["filters"] = {"aided": 3}  # as a broken report may have it
        write(tmp_path / side, made)
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert {answer.verdict for answer in found} == {"undecided"}


def test_two_dives_decide_nothing_and_the_answer_says_how_many_do(tmp_path: Path) -> None:
    found = answers(tmp_path, [dict.fromkeys(QUANTITIES, factor) for factor in (1.5, 1.6)])
    assert {answer.verdict for answer in found} == {"undecided"}
    assert answer_lines(found)[0].text.endswith("; fewer than 3 dives; replay more dives")


def test_worse_in_one_thing_and_better_in_another_is_mixed(tmp_path: Path) -> None:
    new = [{"drift_30s": factor, "drift_60s": factor, "outage_60s": 1.0 / factor} for factor in FACTORS]
    found = answers(tmp_path, new)
    assert {answer.verdict for answer in found} == {"mixed"}
    assert "drift in 30 s" in answer_lines(found)[0].text
    assert "DVL outage 60 s" in answer_lines(found)[0].text


def test_a_filter_that_is_no_longer_evaluated_is_counted(tmp_path: Path) -> None:
    found = answers(tmp_path, [{}] * 4, filter_verdict="not evaluated")
    assert [(answer.lost, answer.is_harm) for answer in found] == [(4, True)] * 2
    assert "no longer evaluated in 4 of 4 dives: " in answer_lines(found)[0].text


def test_the_most_common_reason_says_why_a_filter_is_not_evaluated(tmp_path: Path) -> None:
    sentence = "aided is NOT EVALUATED against baseline: aided rejected {} of 300 pings. Settle this first. More."
    for number, rejected in enumerate((200, 200, 100)):
        made = result(f"d{number}", {}, filter_verdict="not evaluated")
        made["filters"]["aided"]["sentence"] = sentence.format(rejected)
        for side, window in (("old", 3), ("new", 5)):
            made["config"]["filters"]["aided"]["window"] = window
            made["tables"]["evidence"][0]["value"] = float(window)
            write(tmp_path / side / f"d{number}", made)
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert {answer.verdict for answer in found} == {"not evaluated"}
    assert answer_lines(found)[1].text.endswith("evaluated in only 0 of 3 dives: aided rejected 200 of 300 pings")
    assert "aided rejected 200 of 300 pings. Settle this first." in found[1].sentence


def trajectory(seed: int, position_m: float, velocity_mps: float) -> Trajectory:
    """Both filters with white errors of these sizes, once a second for an hour."""
    rng, time_s = np.random.default_rng(seed), np.arange(3600.0)
    values = np.zeros((2, len(time_s), len(COLUMNS)))
    values[:, :, COLUMNS.index("position_error_m")] = position_m * np.abs(rng.standard_normal(len(time_s)))
    values[:, :, COLUMNS.index("velocity_error_mps")] = velocity_mps * np.abs(rng.standard_normal(len(time_s)))
    return Trajectory("", ("baseline", "aided"), time_s, values)


@pytest.mark.parametrize(
    ("position", "velocity", "verdict"), [(1.0, 1.5, "worse"), (1.0, 0.5, "better"), (1.5, 0.5, "mixed")]
)
def test_one_dive_is_compared_over_its_time(position: float, velocity: float, verdict: str, tmp_path: Path) -> None:
    for seed, (side, factors) in enumerate((("old", (1.0, 1.0)), ("new", (position, velocity)))):
        folder = write(tmp_path / side, result("dive", dict.fromkeys(QUANTITIES, factors[1])))
        write_trajectory(folder / "trajectory.npz", trajectory(seed, factors[0], 0.02 * factors[1]))
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert [answer.verdict for answer in found] == [verdict] * 2
    rows = {row.quantity: row for row in found[0].rows[:2]}
    assert rows["velocity"].ratio == pytest.approx(velocity, rel=0.05)
    assert rows["velocity"].value == pytest.approx(velocity * (rows["velocity"].baseline or 0.0), rel=0.05)


def test_one_dive_without_a_trajectory_is_undecided(tmp_path: Path) -> None:
    assert {answer.verdict for answer in answers(tmp_path, [dict.fromkeys(QUANTITIES, 2.0)])} == {"undecided"}


def test_one_filter_alone_is_compared_by_its_drift_and_outages(tmp_path: Path) -> None:
    for number, factor in enumerate(FACTORS):
        for side, size in (("old", 1.0), ("new", factor)):
            made = content(f"d{number}") | {"filters": {}}
            made["tables"] = {
                "drift": [{"log": "d", "filter": "baseline", "quantity": "drift_60s", "unit": "m", "rms": size}],
                "outage": [{"log": "d", "filter": "baseline", "window_s": "60", "drift_rms_m": size}],
                "evidence": [],
                "improvement": made["tables"]["improvement"],
            }
            write(tmp_path / side / f"d{number}", made)
    (answer,) = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert (answer.filter, answer.verdict) == ("baseline", "worse")
    assert [row.quantity for row in answer.rows] == ["drift_60s", "outage_60s"]


# --- The command.


def test_the_first_lines_are_the_settings_that_differ_and_the_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answers(tmp_path, [dict.fromkeys(QUANTITIES, factor) for factor in FACTORS], scale=1.02)
    old, new = str(tmp_path / "old"), str(tmp_path / "new")
    assert run_command_line(["compare", old, new]) == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first.startswith("dvl.scale 1.0 -> 1.02: 8 dives, ")
    assert [line.split()[:2] for line in lines[1 if lines[0].startswith("/") else 0 :][:2]] == [
        ["baseline", "WORSE"], ["aided", "WORSE"],
    ]  # fmt: skip
    assert run_command_line(["compare", old, new, "-q"]) == 0
    quiet = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in quiet] == [["baseline", "WORSE"], ["aided", "WORSE"]]


def test_fail_on_worse_fails_on_the_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worse, better = ([dict.fromkeys(QUANTITIES, factor**sign) for factor in FACTORS] for sign in (1, -1))
    for name, new, code in (("worse", worse, 1), ("better", better, 0), ("same", [{}] * 8, 0)):
        answers(tmp_path / name, new)
        sides = str(tmp_path / name / "old"), str(tmp_path / name / "new")
        assert run_command_line(["compare", *sides, "-q", "--fail-on", "worse"]) == code
        assert ("is WORSE than before" in capsys.readouterr().err) is bool(code)


def test_a_page_has_a_forest_plot_of_each_filter(tmp_path: Path) -> None:
    from insdvl_replay.changes.comparison_document import comparison_document, comparison_result

    answers(tmp_path, [dict.fromkeys(QUANTITIES, factor) for factor in FACTORS])
    found = compare_results(tmp_path / "old", tmp_path / "new")
    page = render(comparison_result(found, comparison_document(found)), "html")
    assert page.count('<section class="candidate worse">') == 2
    assert page.count('<section class="forest">') == 4, "the evidence, and the dives one by one, of each filter"
    assert "larger in 8 of 8" not in page, "the line of the screen is not repeated"
    assert "Ratio: error of the new result over that of the old one, with" in page


# --- How often the answer is right, on simulated dives.

WORLD_DIVES, GROUPS, TOGETHER = 24, 60, 8
EXACT_DVL = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)


def simulated(folder: Path, dvl: DvlErrors = EXACT_DVL, *settings: str) -> list[StoredResult]:
    """Replay dives with errors drawn anew, each from one start."""
    config = load_config(overrides=["evaluation.starts=1", *settings])
    found = []
    for number in range(WORLD_DIVES):
        dive = simulate_dive("figure-eight", seed=1 + number, dvl_errors=dvl, duration_s=200.0)
        report = report_of(replay_dive(dataclasses.replace(dive, name=f"d{number}"), config))
        stored = msgspec.json.decode(msgspec.json.encode(report), type=StoredReport)
        found.append(StoredResult(folder, f"d{number}", stored))
    return found


@pytest.mark.nightly
def test_equal_changes_are_seldom_better_or_worse_and_harm_is_found(tmp_path: Path) -> None:
    """Errors of the scale of the same size and opposite sign are an equal change: it moves every value by several %."""
    old = simulated(tmp_path)
    noisy = simulated(tmp_path, dataclasses.replace(EXACT_DVL, beam_sd_mps=2.0 * EXACT_DVL.beam_sd_mps))
    short, long, scaled = (simulated(tmp_path, EXACT_DVL, f"dvl.scale={scale}") for scale in (0.998, 1.002, 1.02))
    rng = np.random.default_rng(1)

    def words(old: list[StoredResult], new: list[StoredResult], groups: int) -> list[Counter[str]]:
        """Count the answers for both filters over groups of dives that are drawn at random."""
        counts = [Counter[str](), Counter[str]()]
        for _ in range(groups):
            drawn = rng.choice(WORLD_DIVES, TOGETHER, replace=False)
            for count, answer in zip(counts, answers_of([(old[i], new[i]) for i in drawn]), strict=True):
                count[answer.verdict] += 1
        return counts

    for count in words(short, long, GROUPS):
        assert sum(count[word] for word in ("better", "worse", "mixed")) <= 1, count
    for harmed in (noisy, scaled):
        for count in words(old, harmed, 20):
            assert count["worse"] >= 19, count
    assert {answer.verdict for answer in answers_of(list(zip(old, old, strict=True)))} == {"equivalent"}
