"""Gates: what is read from their file, and which cells pass."""

import math
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from small_results import content, nudged

from insdvl_replay.changes.cell_gates import gate_findings
from insdvl_replay.changes.findings import Checked
from insdvl_replay.changes.gate_file import CellGate, load_gates, require_known_filters
from insdvl_replay.changes.gates import together
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.words import Reason

GATE = '[[gate]]\nname = "a"\ntable = "improvement"\ncolumn = "sd"\n'


def stored(**changes: Any) -> StoredReport:
    return msgspec.convert(content(**changes), StoredReport)


def gate(**keys: Any) -> CellGate:
    return msgspec.convert({"name": "a", "table": "improvement", "column": "sd"} | keys, CellGate)


def passes(gate_: CellGate, report: StoredReport, expected: StoredReport | None = None) -> bool:
    return all(finding.passed for finding in gate_findings(gate_, report, expected))


def why(gate_: CellGate, report: StoredReport, expected: StoredReport | None = None) -> str:
    return "; ".join(
        finding.sentence
        for finding in gate_findings(gate_, report, expected)
        if not finding.passed
    )


# --- The file.


@pytest.mark.parametrize(
    ("text", "place", "value", "hint"),
    [
        ("dvies = []\n" + GATE + "max = 1", ": ", "'dvies'", "dives"),
        (GATE + "maxx = 1", ": gate 1: ", "'maxx'", "max"),
        (GATE + 'max = "1"', ": gate 1: max: ", "'1'", "min = 40"),
        (GATE + 'max = 1\nlevel = "loud"', ": gate 1: level ", "'loud'", "error, warn, off"),
        (GATE, ":1: gate 'a': ", "condition", "min, max, equals or expected"),
        (f"{GATE}equals = []", ":1: gate 'a': ", "condition", "min, max, equals or expected"),
        (GATE + "max = 1\nmin = 2", ":1: gate 'a': ", "2", "min and max"),
        (GATE + "max = nan", ": gate 1: max: ", "nan", "min = 40"),
        (GATE + "max = 1\n" + GATE + "min = 1", ": ", "'a'", ""),
        ("dives = []\n\n[[gates]]\nmax = 1", ": ", "'gates'", "gate"),
    ],
)
def test_a_slip_in_the_file_is_reported_with_place_and_key(
    text: str, place: str, value: str, hint: str, tmp_path: Path
) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as raised:
        load_gates(path)
    assert raised.value.message.startswith(f"{path}{place}")
    assert value in raised.value.message
    assert hint in raised.value.hint


@pytest.mark.parametrize(
    ("keys", "meant"),
    [
        ({"table": "improvment"}, "improvement"),
        ({"row": "ba_zz"}, "ba_z"),
        ({"table": "consistency", "column": "mean_nis", "row": "velocityx"}, "velocity_x"),
        ({"table": "credibility", "column": "mean_nees", "row": "al"}, "all"),
        ({"filter": "aidde"}, "aided"),
    ],
)
def test_a_name_that_no_result_has_is_reported_with_the_nearest(
    keys: dict[str, str], meant: str, tmp_path: Path
) -> None:
    lines = {"name": "b", "table": "improvement", "column": "sd"} | keys
    text = (
        "[[gate]]\n"
        + "".join(f'{key} = "{value}"\n' for key, value in lines.items())
        + "max = 1\n"
    )
    path = tmp_path / "gates.toml"
    path.write_text(GATE + "max = 1\n" + text)
    with pytest.raises(ConfigError) as raised:
        require_known_filters(load_gates(path), ["baseline", "aided"])
    assert raised.value.message.startswith(f"{path}:6: gate 'b': ")
    assert f"'{list(keys.values())[-1]}'" in raised.value.message
    assert meant in re.findall(r"\w+", raised.value.hint)


@pytest.mark.parametrize(
    ("table", "column", "wanted", "kind"),
    [("improvement", "sd", '"improved"', "numbers"), ("consistency", "verdict", "3", "words")],
)
def test_a_value_of_the_wrong_kind_is_refused(
    table: str, column: str, wanted: str, kind: str, tmp_path: Path
) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(
        f'[[gate]]\nname = "a"\ntable = "{table}"\ncolumn = "{column}"\nequals = {wanted}\n'
    )
    with pytest.raises(ConfigError, match=f"equals: .*'{column}' .*{table} .*{kind}"):
        load_gates(path)


def test_rows_of_stored_results_are_known_but_for_their_filters(tmp_path: Path) -> None:
    path = tmp_path / "gates.toml"
    of_filters = '[[gate]]\nname = "a"\ntable = "filters"\nrow = "mine"\ncolumn = "mean_improvement_pct"\nmin = 1\n'
    path.write_text(of_filters)
    load_gates(path)
    path.write_text(of_filters.replace("filters", "reference_error").replace("mean_i", "i"))
    with pytest.raises(ConfigError, match="quantity 'mine'"):
        load_gates(path)


def test_many_gates_are_read_in_a_time_that_grows_with_their_number(tmp_path: Path) -> None:
    """Read anew for each gate, these would take minutes."""
    gate = '[[gate]]\nname = "g{}"\ntable = "improvement"\ncolumn = "sd"\nmax = 1.0\n'
    path = tmp_path / "many.toml"
    path.write_text("".join(map(gate.format, range(3000))))
    start_s = time.process_time()
    assert load_gates(path).lines["g2999"] == 2999 * 5 + 1
    assert time.process_time() - start_s < 10.0


def test_lines_are_found_behind_comments_that_end_in_a_comma(tmp_path: Path) -> None:
    path = tmp_path / "comma.toml"
    gate = "[[gate]]\nname = 'a'\ntable = 'improvement'\ncolumn = 'sd'\nmax = 1.0\n"
    path.write_text(f"dives = [\n  'a.mcap',\n]  # one, two,\n{gate}")
    assert load_gates(path).lines["a"] == 4


@pytest.mark.parametrize(("table", "column"), [("filters", "reason"), ("filters", "sentence")])
def test_a_gate_on_prose_is_refused_with_the_columns_that_can_have_gates(
    table: str, column: str, tmp_path: Path
) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(f'[[gate]]\nname = "a"\ntable = "{table}"\ncolumn = "{column}"\nequals = ""\n')
    with pytest.raises(ConfigError, match=f"column '{column}'") as raised:
        load_gates(path)
    hinted = re.findall(r"\w+", raised.value.hint)
    assert {"verdict", "sd"} & {*hinted}
    assert not {"reason", "sentence"} & {*hinted}


def test_a_gate_may_ask_why_a_verdict_differs_from_its_interval() -> None:
    report = stored()
    keys = {"table": "consistency", "row": "velocity", "column": "why"}
    (row,) = report.tables["consistency"]
    for word, passed in ((Reason.NEAR, True), (Reason.ONE_SAMPLE, False)):
        row["why"] = str(word)
        assert passes(gate(**keys, equals=["near"]), report) == passed


def test_an_expected_value_needs_a_column_that_can_be_worse(tmp_path: Path) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(GATE.replace("sd", "unit") + 'expected = "b.json"\nmax_worse_pct = 1')
    with pytest.raises(ConfigError, match="column 'unit'"):
        load_gates(path)


# --- The cells.


@pytest.mark.parametrize(
    ("keys", "passed"),
    [
        ({"max": 1.0}, True),
        ({"max": 0.99}, False),
        ({"min": 1.0}, True),
        ({"min": 1.01}, False),
        ({"equals": 1}, True),
        ({"equals": 2.0}, False),
        ({"column": "status", "equals": "improved"}, True),
        ({"column": "status", "equals": ["same", "improved"]}, True),
        ({"column": "status", "equals": ["same", "worse"]}, False),
        ({"column": "status", "max": 1.0}, False),
        ({"row": "ba_x", "max": 1.0}, True),
        ({"row": "ba_q", "max": 1.0}, False),
        ({"filter": "other", "max": 1.0}, False),
        ({"table": "consistency", "max": 1.0}, False),
        ({"table": "filters", "column": "consistency", "equals": "consistent"}, True),
        ({"table": "filters", "row": "aided", "column": "mean_improvement_pct", "min": 51}, False),
    ],
)
def test_limits_hold_for_every_cell_that_is_meant(keys: dict[str, Any], passed: bool) -> None:
    assert passes(gate(**keys), stored()) is passed


@pytest.mark.parametrize(
    ("keys", "passed"),
    [
        ({"max": 1.0}, False),
        ({"table": "convergence", "column": "reached_s", "max": 1e9}, False),
        ({"table": "reference_error", "row": "roll", "column": "rmse", "max": 1e9}, False),
        ({"table": "filters", "column": "mean_improvement_pct", "min": -100}, False),
        ({"table": "filters", "column": "verdict", "equals": "not evaluated"}, True),
        ({"table": "consistency", "column": "mean_nis", "max": 1e9}, True),
    ],
)
def test_no_number_of_a_filter_that_is_not_evaluated_passes(
    keys: dict[str, Any], passed: bool
) -> None:
    report = stored(filter_verdict="not evaluated")
    assert passes(gate(**keys), report) is passed


@pytest.mark.parametrize(
    "keys",
    [
        {"max": 1.0},
        {"table": "filters", "column": "verdict", "equals": "better"},
    ],
    ids=lambda keys: keys.get("table", "improvement"),
)
def test_a_gate_says_why_a_filter_is_not_evaluated(keys: dict[str, Any]) -> None:
    report = stored(filter_verdict="not evaluated")
    report.filters["aided"]["reason"] = "baseline diverged"
    assert "not evaluated (baseline diverged)" in why(gate(**keys), report)


def test_no_error_against_a_part_of_the_reference_passes() -> None:
    report = stored()
    report.tables["reference_error"][0]["status"] = "partly covered"
    limit = gate(table="reference_error", row="roll", column="rmse", max=1e9)
    assert not passes(limit, report)
    assert "(partly covered)" in why(limit, report)


def test_a_star_means_every_row() -> None:
    findings = gate_findings(gate(max=1.0), stored(bg_z_sd=1.5), None)
    assert [(finding.row, finding.passed) for finding in findings] == [
        ("ba_x", True),
        ("bg_z", False),
    ]
    assert re.fullmatch(r"aided gyro bias z sd .*1\.5 deg/h.* 1", findings[1].sentence)


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
@pytest.mark.parametrize(
    "keys", [{"max": 1e9}, {"equals": "x"}, {"expected": "b", "max_worse_pct": 1e9}]
)
def test_what_is_empty_or_not_finite_never_passes(
    value: float | None, keys: dict[str, Any]
) -> None:
    report = stored()
    report.tables["improvement"][0]["sd"] = value
    assert not passes(gate(row="ba_x", **keys), report, stored())
    told = why(gate(row="ba_x", **keys), report, stored())
    assert told.startswith("aided accelerometer bias x sd ")
    assert told.endswith("(improved)")


def test_a_missing_row_is_reported_with_its_names() -> None:
    sentence = why(gate(table="reference_error", row="rol", column="rmse", max=1), stored())
    assert "table reference_error, filter *, row rol, column rmse" in sentence


@pytest.mark.parametrize(
    ("keys", "cell", "passed"),
    [
        ({"row": "ba_x", "max_worse_pct": 10}, {"ba_x_sd": 1.1}, True),
        ({"row": "ba_x", "max_worse_pct": 10}, {"ba_x_sd": 1.11}, False),
        ({"row": "ba_x", "max_worse_pct": 10}, {"ba_x_sd": 0.1}, True),
        ({"row": "ba_x", "max_worse_abs": 0.3}, {"ba_x_sd": 1.3}, True),
        ({"row": "ba_x", "max_worse_abs": 0.3}, {"ba_x_sd": 1.31}, False),
        ({"row": "ba_x", "max_worse_pct": 10, "max_worse_abs": 0.3}, {"ba_x_sd": 1.25}, True),
        ({"row": "ba_x", "max_worse_pct": 10, "max_worse_abs": 0.3}, {"ba_x_sd": 1.35}, False),
        # A signed error: -0.2 is expected, so 0.21 is 5 % worse and 0.19 is better.
        (
            {"table": "reference_error", "column": "final", "max_worse_pct": 6},
            {"final": 0.21},
            True,
        ),
        (
            {"table": "reference_error", "column": "final", "max_worse_pct": 4},
            {"final": 0.21},
            False,
        ),
        (
            {"table": "reference_error", "column": "final", "max_worse_pct": 0},
            {"final": 0.19},
            True,
        ),
        # A mean NIS of 3.1 for three degrees of freedom is off by 1.033, one of 2.4 by 1.25.
        (
            {"table": "consistency", "column": "mean_nis", "max_worse_pct": 22},
            {"mean_nis": 2.4},
            True,
        ),
        (
            {"table": "consistency", "column": "mean_nis", "max_worse_pct": 20},
            {"mean_nis": 2.4},
            False,
        ),
        # From zero there is no percentage.
        (
            {"table": "consistency", "column": "rejected", "max_worse_pct": 1e9},
            {"rejected": 1},
            False,
        ),
        (
            {"table": "consistency", "column": "rejected", "max_worse_abs": 1},
            {"rejected": 1},
            True,
        ),
    ],
)
def test_a_value_may_be_worse_than_expected_by_so_much(
    keys: dict[str, Any], cell: dict[str, float], passed: bool
) -> None:
    assert passes(gate(expected="b", **keys), stored(**cell), stored()) is passed


def test_percentages_may_fall_by_percentage_points() -> None:
    report = stored()
    report.tables["improvement"][0]["improvement_pct"] = 44.0
    narrow = gate(row="ba_x", column="improvement_pct", expected="b", max_worse_pct=5)
    assert not passes(narrow, report, stored())
    told = why(narrow, report, stored())
    assert told == "aided accelerometer bias x improvement 50 -> 44 % (-6 points, limit -5 points)"
    assert passes(msgspec.structs.replace(narrow, max_worse_pct=6.0), report, stored())


@pytest.mark.parametrize(
    ("keys", "cell", "sentence"),
    [
        (
            {"column": "rmse"},
            {"rmse": 0.9},
            "aided roll rms 0.4 -> 0.9 deg (+125 %, limit +5 % or +0.1 deg)",
        ),
        (
            {"column": "final"},
            {"final": 0.4},
            "aided roll final -0.2 -> 0.4 deg (+100 % in magnitude, limit +5 % or +0.1 deg)",
        ),
        (
            {"table": "consistency", "column": "mean_nis"},
            {"mean_nis": 6.2},
            "aided velocity mean NIS 3.1 -> 6.2 (+100 % farther from dof, limit +5 % or +0.1)",
        ),
        (
            {"table": "consistency", "column": "rejected"},
            {"rejected": 7},
            "aided velocity rejected 0 -> 7 (limit +5 % or +0.1)",
        ),
    ],
)
def test_a_failure_has_both_values_their_change_and_the_limit(
    keys: dict[str, Any], cell: dict[str, float], sentence: str
) -> None:
    meant = gate(
        **({"table": "reference_error"} | keys), expected="b", max_worse_pct=5, max_worse_abs=0.1
    )
    assert why(meant, stored(**cell), stored()) == sentence


def test_a_column_of_the_baseline_is_named_as_its_own() -> None:
    report = stored()
    report.tables["reference_error"][0]["baseline_rmse"] = 1.0
    meant = gate(table="reference_error", column="baseline_rmse", expected="b", max_worse_pct=5)
    assert why(meant, report, stored()) == "baseline roll rms 0.5 -> 1 deg (+100 %, limit +5 %)"


@pytest.mark.parametrize("lacking", ["report", "expected"])
def test_a_mean_nis_without_its_degrees_of_freedom_does_not_pass(lacking: str) -> None:
    sides = {"report": stored(), "expected": stored()}
    for row in sides[lacking].tables["consistency"]:
        del row["dof"]
    nis = gate(table="consistency", column="mean_nis", expected="b", max_worse_pct=5)
    assert "dof" in why(nis, sides["report"], sides["expected"])


def test_a_row_without_expected_values_does_not_pass() -> None:
    baseline = stored()
    baseline.tables["improvement"].clear()
    assert "aided accelerometer bias x sd " in why(
        gate(expected="b", max_worse_pct=1e9), stored(), baseline
    )


@pytest.mark.parametrize("keys", [{}, {"filter": "aided"}, {"row": "ba_x"}])
def test_an_expected_row_that_is_missing_does_not_pass(keys: dict[str, Any]) -> None:
    report = stored()
    del report.tables["improvement"][0]
    meant = gate(expected="b", max_worse_pct=1e9, **keys)
    assert passes(meant, stored(), stored())
    told = why(meant, report, stored())
    assert re.fullmatch(r"aided accelerometer bias x sd .* 1", told)
    assert passes(gate(expected="b", max_worse_pct=1e9, row="bg_z"), report, stored())


def test_an_expected_filter_that_is_missing_does_not_pass_where_it_is_meant() -> None:
    keys = {
        "table": "filters",
        "column": "mean_improvement_pct",
        "expected": "b",
        "max_worse_pct": 1e9,
    }
    both = stored()
    both.filters["other"] = both.filters["aided"]
    assert why(gate(**keys), stored(), both).startswith("other mean improvement ")
    assert passes(gate(**keys, filter="aided"), stored(), both)


@pytest.mark.parametrize(
    "keys", [{"min": 0}, {"max": 2}, {"equals": 1}, {"expected": "b", "max_worse_pct": 1e9}]
)
@pytest.mark.parametrize("value", [True, False])
def test_true_and_false_are_no_numbers(value: bool, keys: dict[str, Any]) -> None:
    report = stored()
    report.tables["improvement"][0]["sd"] = value
    assert not passes(gate(row="ba_x", **keys), report, stored())
    if "expected" in keys:
        assert not passes(gate(row="ba_x", **keys), stored(), report)


@pytest.mark.parametrize("share", [1e-10, -1e-10])
@pytest.mark.parametrize(
    "keys",
    [
        {"max": 1.0},
        {"min": 1.0},
        {"equals": 1.0},
        {"equals": [7, 1]},
        {"max_worse_pct": 0.0},
        {"max_worse_abs": 0.0},
        {"column": "improvement_pct", "min": 50.0, "max_worse_pct": 0.0},
        {"column": "improvement_pct", "max_worse_abs": 0.0},
        {"table": "reference_error", "column": "final", "max_worse_pct": 0.0},
        {"table": "consistency", "column": "mean_nis", "max_worse_pct": 0.0},
        {"table": "filters", "column": "mean_improvement_pct", "min": 50.0, "max": 50.0},
    ],
)
def test_digits_that_differ_between_processors_pass_every_gate(
    keys: dict[str, Any], share: float
) -> None:
    there = msgspec.convert(nudged(content(), share), StoredReport)
    more = {"expected": "b"} if any(key.startswith("max_worse") for key in keys) else {}
    assert passes(gate(**more, **keys), there, stored())
    further = msgspec.convert(nudged(content(), 100.0 * share), StoredReport)
    back = msgspec.convert(nudged(content(), -100.0 * share), StoredReport)
    assert not all(passes(gate(**more, **keys), report, stored()) for report in (further, back))


@pytest.mark.parametrize(
    ("keys", "sd"), [({"max_worse_pct": 5.0}, 1.05), ({"max_worse_abs": 0.05}, 1.05)]
)
def test_an_allowance_may_be_used_up_but_for_digits_that_differ_between_processors(
    keys: dict[str, Any], sd: float
) -> None:
    assert passes(
        gate(row="ba_x", expected="b", **keys), stored(ba_x_sd=sd * (1.0 + 1e-10)), stored()
    )
    assert not passes(
        gate(row="ba_x", expected="b", **keys), stored(ba_x_sd=sd * (1.0 + 1e-8)), stored()
    )


# --- Words of the outcome.


@pytest.mark.parametrize(
    ("word", "wanted", "passed"),
    [
        ("better", "better", True),
        ("equivalent", ["better", "equivalent"], True),
        ("undecided", ["better", "equivalent"], False),
        ("worse", ["better", "equivalent", "undecided"], False),
        ("better without DVL", "better", False),
        ("", ["better", "equivalent", "undecided", ""], False),
    ],
)
def test_a_gate_on_a_verdict_wants_a_word(
    word: str, wanted: str | list[str], passed: bool
) -> None:
    keys = {"table": "filters", "column": "verdict", "equals": wanted}
    assert passes(gate(**keys), stored(filter_verdict=word)) is passed


@pytest.mark.parametrize(
    "keys",
    [
        {"table": "evidence", "column": "value", "max": 1e9},
        {"table": "evidence", "column": "ratio", "max": 1e9},
        {"table": "evidence", "column": "acts", "max": 1e9},
        {"table": "evidence", "column": "moves", "max": 1e9},
        {
            "table": "filters",
            "column": "prediction",
            "equals": ["confirmed", "undecided", "not confirmed"],
        },
        {
            "table": "filters",
            "column": "verdict",
            "equals": ["better", "mixed", "equivalent", "no effect", "undecided", "worse"],
        },
        {"table": "outage", "column": "ratio_to_baseline", "max": 1e9},
        {"table": "outage", "column": "windows_won_pct", "min": 0.0},
        {"table": "drift", "column": "p95", "max": 1e9},
    ],
    ids=lambda keys: f"{keys['table']}-{keys['column']}",
)
def test_nothing_that_speaks_of_gain_passes_for_a_filter_that_is_not_evaluated(
    keys: dict[str, Any],
) -> None:
    report = stored(filter_verdict="not evaluated", prediction="undecided")
    row = {"log": "dive", "filter": "aided"}
    report.tables["outage"] = [
        row | {"window_s": "30", "ratio_to_baseline": 0.8, "windows_won_pct": 90.0}
    ]
    report.tables["drift"] = [row | {"quantity": "drift_60s", "unit": "m", "p95": 0.5}]
    assert not passes(gate(**keys), report)
    report.filters["aided"]["verdict"] = "undecided"
    assert passes(gate(**keys), report)


# --- The pooled evidence.


def pooled(
    ratios: Sequence[float],
    *others: str,
    verdicts: Sequence[str] = ("undecided",) * 9,
    levels: Sequence[float] = (),
    vehicles: Sequence[str] = ("",) * 9,
    **settings: str,
) -> StoredReport:
    """Several dives together, with these ratios of position and drift; all other candidates have the same.

    With ``levels``, they have these ratios of the level, too.
    """
    dives = []
    for number, (ratio, word) in enumerate(zip(ratios, verdicts, strict=False)):
        made = content(f"d{number}", filter_verdict=word)
        [position] = made["tables"]["evidence"]
        drift = {"evidence": "accuracy", "quantity": "drift_60s", "role": "secondary"}
        rows = [
            position | {"value": ratio, "ratio": ratio},
            position | drift | {"value": ratio, "ratio": ratio},
        ]
        if levels:
            level = {"evidence": "accuracy", "quantity": "level", "unit": "deg"}
            sizes = {"role": "secondary", "value": levels[number], "ratio": levels[number]}
            rows.append(position | level | sizes)
        made["vehicle"] = vehicles[number]
        made["tables"]["evidence"] = [
            row | {"filter": name} for name in ("aided", *others) for row in rows
        ]
        made["filters"] |= dict.fromkeys(others, made["filters"]["aided"])
        made["config"]["evaluation"] = settings
        dives.append(Checked(msgspec.convert(made, StoredReport), Path(f"d{number}")))
    found = together(dives).result
    assert isinstance(found, StoredReport)
    return found


SURELY_SMALLER = (0.70, 0.72, 0.71, 0.69)


@pytest.mark.parametrize(
    ("ratios", "passed"),
    [
        (SURELY_SMALLER, True),
        (SURELY_SMALLER[:2], False),
        (SURELY_SMALLER[:1], False),
        ((0.7, 1.2, 0.8, 1.1), False),
    ],
)
@pytest.mark.parametrize(
    "keys", [{"column": "verdict", "equals": "better"}, {"column": "p", "max": 0.01}]
)
def test_all_dives_together_pass_only_with_an_interval(
    keys: dict[str, Any], ratios: Sequence[float], passed: bool
) -> None:
    """One dive or two have neither an interval nor a p, so no limit of p can pass."""
    limit = gate(table="pooled", row="position", **keys)
    assert passes(limit, pooled(ratios)) is passed
    if len(ratios) < 3 and "max" in keys:
        assert "is empty" in why(limit, pooled(ratios))


SURELY_LARGER = (1.80, 1.82, 1.79, 1.81)
GOOD_HEADLINE = {"table": "answers", "column": "verdict", "equals": ["better", "equivalent"]}


def test_a_gate_on_the_headline_fails_where_it_is_mixed() -> None:
    """The row of the position is better all the same, so that a gate on it passes."""
    mixed = pooled(SURELY_SMALLER, levels=SURELY_LARGER)
    assert passes(gate(table="pooled", row="position", column="verdict", equals="better"), mixed)
    for column in ("verdict", "verdict_always"):
        limit = gate(**GOOD_HEADLINE | {"column": column})
        assert not passes(limit, mixed)
        assert "mixed" in why(limit, mixed)
        assert passes(limit, pooled(SURELY_SMALLER, levels=SURELY_SMALLER)), column
    assert passes(gate(table="answers", column="reason_code", equals="warning"), mixed)


def test_the_headline_of_one_dive_is_a_statement_and_no_verdict() -> None:
    one = pooled(SURELY_SMALLER[:1])
    [row] = one.tables["answers"]
    assert (row["log"], row["verdict"], row["reason_code"]) == ("d0", "undecided", "one dive")
    assert (row["ratio"], row["low"], row["high"]) == pytest.approx(
        (0.7, math.nan, math.nan), nan_ok=True
    )
    assert not passes(gate(**GOOD_HEADLINE), one)


def test_the_headline_counts_dives_and_vehicles_as_the_rule_does() -> None:
    verdicts = ("undecided",) * 4 + ("not evaluated",)
    found = pooled((*SURELY_SMALLER, 5.0), verdicts=verdicts, vehicles=("a", "a", "b", "c", "d"))
    [row] = found.tables["answers"]
    assert (row["dives"], row["evaluated"], row["vehicles"]) == (5, 4, 3)
    [untold] = pooled(SURELY_SMALLER).tables["answers"]
    assert untold["vehicles"] == 0


def test_two_vehicles_that_contradict_each_other_are_the_reason() -> None:
    ratios = (*SURELY_SMALLER, *SURELY_LARGER)
    [row] = pooled(ratios, vehicles=("a",) * 4 + ("b",) * 4).tables["answers"]
    assert (row["verdict"], row["reason_code"]) == ("mixed", "vehicles")


def test_dives_without_an_evaluation_are_not_pooled() -> None:
    found = pooled((*SURELY_SMALLER, 5.0), verdicts=("undecided",) * 4 + ("not evaluated",))
    assert passes(gate(table="pooled", row="position", column="dives", equals=4), found)
    assert passes(gate(table="pooled", row="position", column="verdict", equals="better"), found)


def test_pooled_evidence_is_that_of_the_settings() -> None:
    """The quantity that decides, and the share of the error rate, are those of the screen of several dives."""
    usual, named = pooled(SURELY_SMALLER), pooled(SURELY_SMALLER, primary="drift_60s")
    for row, roles in (
        ("position", ("primary", "shown")),
        ("drift_60s", ("secondary", "primary")),
    ):
        for found, role in zip((usual, named), roles, strict=True):
            assert passes(gate(table="pooled", row=row, column="role", equals=role), found), (
                row,
                role,
            )
    shared, chosen = (
        pooled(SURELY_SMALLER, "second", **one) for one in ({}, {"candidate": "second"})
    )
    for found, aided_pct, second_pct in (
        (usual, 95.0, None),
        (shared, 97.5, 97.5),
        (chosen, 95.0, 95.0),
    ):
        rows = [row for row in found.tables["pooled"] if row["role"] == "primary"]
        levels = {row["filter"]: row["level_pct"] for row in rows}
        expected = {"aided": aided_pct} | ({"second": second_pct} if second_pct else {})
        assert levels == pytest.approx(expected)


def test_the_baseline_has_a_drift_of_its_own_whatever_becomes_of_a_candidate() -> None:
    report = stored(filter_verdict="not evaluated")
    report.tables["drift"] = [
        {"log": "dive", "filter": "baseline", "quantity": "drift_60s", "unit": "m", "p95": 0.5}
    ]
    assert passes(
        gate(table="drift", filter="baseline", row="drift_60s", column="p95", max=1.0), report
    )
    report.tables["track_fit"] = [
        {
            "log": "dive",
            "filter": "baseline",
            "quantity": "scale",
            "unit": "%",
            "fitted": 0.3,
            "fitted_sd": 0.02,
        }
    ]
    limit = gate(table="track_fit", row="scale", column="fitted", min=-0.2, max=0.2)
    assert re.fullmatch(r"baseline scale .*0\.3 %.*0\.2.*", why(limit, report))
