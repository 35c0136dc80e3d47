"""The answer of `compare`: each filter, new against old, by the rule of a verdict."""

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
from insdvl_replay.changes.comparison_document import (
    answer_lines,
    comparison_document,
    comparison_result,
    lines_below,
)
from insdvl_replay.changes.matching import Pair
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.report import StoredReport, StoredResult
from insdvl_replay.core.words import ReasonCode
from insdvl_replay.document.render import render
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.show.result_files import report_of
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import DvlErrors

# By quantity: kind of evidence, and what a row of a dive may do.
QUANTITIES = {
    "position": ("track", "primary"),
    "outage_60s": ("outage", "primary"),
    "drift_60s": ("accuracy", "secondary"),
    "drift_30s": ("accuracy", "shown"),
}
FACTORS = (1.6, 1.5, 1.7, 1.55, 1.65, 1.6, 1.5, 1.7)  # eight dives that nearly agree


def result(
    name: str, factors: dict[str, float], noise: float = 0.01, **changes: Any
) -> dict[str, Any]:
    """A report whose baseline has errors of 1, and whose candidate of 0.8, times factors by quantity."""
    made = content(name, **changes)
    [row] = made["tables"]["evidence"]
    made["tables"]["evidence"] = [
        row | {"evidence": kind, "quantity": quantity, "baseline": factors.get(quantity, 1.0),
               "value": 0.8 * factors.get(quantity, 1.0), "role": role, "reference_noise": noise}
        for quantity, (kind, role) in QUANTITIES.items()
    ]  # fmt: skip
    return made


def answers(
    folder: Path, new: Sequence[dict[str, float]], scale: float = 1.0, **changes: Any
) -> list[Answer]:
    """Compare dives without a change, with small differences of their own, with the same times factors."""
    for number, factors in enumerate(new):
        own = dict.fromkeys(QUANTITIES, 1.0 + 0.1 * number)
        write(folder / "old" / f"d{number}", result(f"d{number}", own))
        changed = result(
            f"d{number}",
            {name: own[name] * factors.get(name, 1.0) for name in QUANTITIES},
            **changes,
        )
        changed["config"]["dvl"]["scale"] = scale
        write(folder / "new" / f"d{number}", changed)
    return [*compare_results(folder / "old", folder / "new").answers]


def every(factors: Sequence[float]) -> list[dict[str, float]]:
    """On each dive all quantities are multiplied by a factor."""
    return [dict.fromkeys(QUANTITIES, factor) for factor in factors]


def test_a_change_that_affects_all_filters_alike_is_found(tmp_path: Path) -> None:
    found = answers(tmp_path, every(FACTORS))
    assert [(answer.filter, answer.verdict) for answer in found] == [
        ("baseline", "worse"),
        ("aided", "worse"),
    ]
    position = found[0].rows[0]
    assert position.ratio == pytest.approx(math.prod(FACTORS) ** (1.0 / 8.0))
    assert (position.quantity, position.role, position.dives, position.dives_won) == (
        "position",
        "primary",
        8,
        0,
    )
    better = answers(tmp_path / "back", every([1.0 / factor for factor in FACTORS]))
    assert {answer.verdict for answer in better} == {"better"}


@pytest.mark.parametrize(
    ("size", "verdict"), [(0.0, "no effect"), (1e-6, "equivalent"), (0.009, "equivalent")]
)
@pytest.mark.parametrize("dives", [1, 2, 8])
def test_a_change_below_1_percent_is_equivalent(
    size: float, verdict: str, dives: int, tmp_path: Path
) -> None:
    """Even one that all dives have to the digit."""
    found = answers(tmp_path, every([1.0 + size] * dives))
    assert {answer.verdict for answer in found} == {verdict}


def test_an_error_from_zero_is_no_small_change(tmp_path: Path) -> None:
    for side, error in (("old", 0.0), ("new", 5.0)):
        made = result("dive", {"position": error})
        made["config"]["filters"] = {"aided": 3}  # as a broken report may have it
        write(tmp_path / side, made)
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert {answer.verdict for answer in found} == {"undecided"}


def test_two_dives_decide_nothing_and_the_answer_says_how_many_do(tmp_path: Path) -> None:
    found = answers(tmp_path, every([1.5, 1.6]))
    assert {answer.verdict for answer in found} == {"undecided"}
    assert lines_below(found) == ["baseline, aided: A verdict takes 3 dives."]


def test_one_dive_has_a_statement_and_no_verdict(tmp_path: Path) -> None:
    """However large the change is, the next dive may differ."""
    found = answers(tmp_path, every([2.0]))
    assert {answer.verdict for answer in found} == {"undecided"}
    assert {answer.undecided for answer in found} == {ReasonCode.ONE_DIVE}
    for line in answer_lines(found):
        assert "on this dive position 100.0 % larger; one dive cannot tell" in line.text
        assert line.tone == ""


@pytest.mark.parametrize(
    ("position", "others", "verdict"),
    [
        (0.7, 1.6, "mixed"),
        (1.6, 0.7, "worse"),
        (0.7, 0.7, "better"),
        (1.0, 1.6, "undecided"),
        (1.0, 0.7, "undecided"),
    ],
)
def test_other_quantities_can_warn_and_cannot_win(
    position: float, others: float, verdict: str, tmp_path: Path
) -> None:
    """Position decides: it scatters by 10 % in each case, so around 1 it is undecided whatever the others say."""
    scatter = (0.9, 1.1, 0.95, 1.05, 1.0, 1.08, 0.92, 1.0)
    new = [
        dict.fromkeys(QUANTITIES, others * (0.99 + 0.02 * (number % 2)))
        | {"position": position * own}
        for number, own in enumerate(scatter)
    ]
    found = answers(tmp_path, new)
    assert {answer.verdict for answer in found} == {verdict}
    for line in answer_lines(found):
        assert f" position {position:.2f} (" in line.text or position == 1.0
        contradicts = verdict != "better"
        assert ("without the DVL " in line.text) is contradicts
        assert ("drift in 60 s" in line.text) is contradicts
        assert "drift in 30 s" not in line.text, "it is only shown"


def test_the_settings_name_another_primary_quantity(tmp_path: Path) -> None:
    for number, factor in enumerate(FACTORS):
        for side, size in (("old", 1.0), ("new", factor)):
            made = result(
                f"d{number}", {"drift_60s": 1.0 / size, "position": size, "outage_60s": 1.0 / size}
            )
            made["config"]["evaluation"] = {"primary": "drift_60s"}
            write(tmp_path / side / f"d{number}", made)
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert {(answer.primary, answer.verdict) for answer in found} == {("drift_60s", "better")}


def test_filters_are_not_equal_by_the_noise_of_the_reference(tmp_path: Path) -> None:
    """Where noise is most of the error, an equal error says nothing of the filters."""
    small = (1.02, 0.985, 1.01, 0.99, 1.02, 0.985, 1.01, 0.99)
    for noise, verdict in ((0.1, "equivalent"), (0.6, "undecided")):
        for number, factor in enumerate(small):
            for side, size in (("old", 1.0), ("new", factor)):
                made = result(f"d{number}", dict.fromkeys(QUANTITIES, size), noise)
                write(tmp_path / f"{noise}" / side / f"d{number}", made)
        baseline, _ = compare_results(
            tmp_path / f"{noise}" / "old", tmp_path / f"{noise}" / "new"
        ).answers
        assert baseline.verdict == verdict
    assert baseline.undecided == ReasonCode.NOISE


def test_a_filter_that_is_no_longer_evaluated_is_counted(tmp_path: Path) -> None:
    found = answers(tmp_path, [{}] * 4, filter_verdict="not evaluated")
    assert [(answer.lost, answer.is_harm) for answer in found] == [(4, True)] * 2
    assert answer_lines(found)[0].text.endswith("; no longer evaluated in 4 of 4 dives")
    assert "baseline, aided: not evaluated: " in lines_below(found)[-1]


def test_the_most_common_reason_says_why_a_filter_is_not_evaluated(tmp_path: Path) -> None:
    reason = "aided rejected {} of 300 pings"
    for number, rejected in enumerate((200, 200, 100)):
        made = result(
            f"d{number}", {}, filter_verdict="not evaluated", reason=reason.format(rejected)
        )
        for side, window in (("old", 3), ("new", 5)):
            made["config"]["filters"]["aided"]["window"] = window
            made["tables"]["evidence"][0]["value"] = float(window)
            write(tmp_path / side / f"d{number}", made)
    found = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert {answer.verdict for answer in found} == {"not evaluated"}
    assert answer_lines(found)[1].text.endswith("evaluated in only 0 of 3 dives")
    reasons = ["baseline, aided: not evaluated: aided rejected 200 of 300 pings"]
    assert lines_below(found) == reasons


def test_one_filter_alone_is_compared_by_its_position_its_drift_and_its_outages(
    tmp_path: Path,
) -> None:
    for number, factor in enumerate(FACTORS):
        for side, size in (("old", 1.0), ("new", factor)):
            made = content(f"d{number}") | {"filters": {}}
            row = {"log": "d", "filter": "baseline"}
            made["tables"] = {
                "drift": [
                    row | {"quantity": name, "unit": "m", "rms": size}
                    for name in ("position_h", "drift_60s")
                ],
                "outage": [row | {"window_s": "60", "windows": 2, "drift_rms_m": size}],
                "evidence": [],
                "improvement": made["tables"]["improvement"],
            }
            write(tmp_path / side / f"d{number}", made)
    (answer,) = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert (answer.filter, answer.primary, answer.verdict) == ("baseline", "position", "worse")
    assert {row.quantity: row.role for row in answer.rows} == {
        "position": "primary", "outage_60s": "secondary", "drift_60s": "secondary",
    }  # fmt: skip


@pytest.mark.parametrize(("windows", "verdict"), [(2, "worse without DVL"), (1, "undecided")])
def test_without_a_reference_of_its_own_outages_with_two_windows_decide(
    windows: int, verdict: str, tmp_path: Path
) -> None:
    for number, factor in enumerate(FACTORS):
        for side, size in (("old", 1.0), ("new", factor)):
            made = content(f"d{number}") | {"filters": {}}
            made["config"]["reference"] = {"independent": False}
            row = {"log": "d", "filter": "baseline"}
            made["tables"] = {
                "drift": [row | {"quantity": "position_h", "unit": "m", "rms": size}],
                "outage": [row | {"window_s": "60", "windows": windows, "drift_rms_m": size}],
                "evidence": [],
                "improvement": made["tables"]["improvement"],
            }
            write(tmp_path / side / f"d{number}", made)
    (answer,) = compare_results(tmp_path / "old", tmp_path / "new").answers
    assert answer.verdict == verdict


# --- The command.


def test_the_first_lines_are_the_settings_that_differ_and_the_answers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answers(tmp_path, every(FACTORS), scale=1.02)
    old, new = str(tmp_path / "old"), str(tmp_path / "new")
    assert run_command_line(["compare", old, new]) == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "dvl.scale 1.0 -> 1.02: did it help?"
    assert lines[0].startswith("8 dives, new: ")
    words = [["baseline", "WORSE"], ["aided", "WORSE"]]
    assert [line.split()[:2] for line in lines if "WORSE" in line] == words
    assert run_command_line(["compare", old, new, "-q"]) == 0
    quiet = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in quiet] == [["baseline", "WORSE"], ["aided", "WORSE"]]


def test_fail_on_worse_fails_on_the_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    worse, better = (every([factor**sign for factor in FACTORS]) for sign in (1, -1))
    for name, new, code in (("worse", worse, 1), ("better", better, 0), ("same", [{}] * 8, 0)):
        answers(tmp_path / name, new)
        sides = str(tmp_path / name / "old"), str(tmp_path / name / "new")
        assert run_command_line(["compare", *sides, "-q", "--fail-on", "worse"]) == code
        assert (
            "baseline against before: WORSE, position 1.60" in capsys.readouterr().err
        ) is bool(code)


def test_a_page_has_a_forest_plot_of_each_filter(tmp_path: Path) -> None:
    answers(tmp_path, every(FACTORS))
    found = compare_results(tmp_path / "old", tmp_path / "new")
    page = render(comparison_result(found, comparison_document(found)), "html")
    assert page.count('<section class="candidate worse">') == 2
    assert page.count('<section class="forest">') == 4, (
        "the evidence, and the dives one by one, of each filter"
    )
    assert "larger in 8 of 8" not in page, "the line of the screen is not repeated"
    assert "Ratio: error of the new result over that of the old one, with" in page


# --- How often the answer is right, on simulated dives.

WORLD_DIVES, GROUPS, TOGETHER = 24, 60, 8
EXACT_DVL = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)


def simulated(folder: Path, dvl: DvlErrors = EXACT_DVL, *settings: str) -> list[StoredResult]:
    """Replay dives with errors drawn anew, each from one start."""
    config = load_config(
        "fog", overrides=["evaluation.starts=1", "dvl.beam_sd_mps=0.006", *settings]
    )
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
    noisy = simulated(
        tmp_path, dataclasses.replace(EXACT_DVL, beam_sd_mps=2.0 * EXACT_DVL.beam_sd_mps)
    )
    short, long, scaled = (
        simulated(tmp_path, EXACT_DVL, f"dvl.scale={scale}") for scale in (0.998, 1.002, 1.02)
    )
    rng = np.random.default_rng(1)

    def words(old: list[StoredResult], new: list[StoredResult], groups: int) -> list[Counter[str]]:
        """Count the answers for both filters over groups of dives that are drawn at random."""
        counts = [Counter[str](), Counter[str]()]
        for _ in range(groups):
            drawn = rng.choice(WORLD_DIVES, TOGETHER, replace=False)
            for count, answer in zip(
                counts, answers_of([Pair(old[i], new[i]) for i in drawn]), strict=True
            ):
                count[answer.verdict] += 1
        return counts

    for count in words(short, long, GROUPS):
        assert sum(count[word] for word in ("better", "worse", "mixed")) <= 1, count
    for harmed in (noisy, scaled):
        for count in words(old, harmed, 20):
            assert count["worse"] >= 19, count
    assert {answer.verdict for answer in answers_of([Pair(one, one) for one in old])} == {
        "no effect"
    }
