"""Beside a baseline whose noise is far off nothing is evaluated; what the filters predict is still said."""

import re
from functools import cache

from msgspec.structs import replace

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.quantities import SETTLED
from insdvl_replay.core.report import Report, build_report
from insdvl_replay.core.words import Verdict
from insdvl_replay.document.parts import Sentences
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.show.answers import against_control, has_misfit, predicted_unchecked
from insdvl_replay.show.dives import named_result
from insdvl_replay.show.screens import dive_screen
from insdvl_replay.sim.dive import simulate_dive


@cache
def report() -> Report:
    simulated = simulate_dive("lawnmower", seed=1, duration_s=60.0, imu_rate_hz=20.0)
    config = load_config("levy-klein", overrides=["evaluation.starts=1"])
    found = replay_dive(simulated, config)
    return build_report(
        found.dive, config, found.tables, found.verdicts, found.notes, found.start_ns, found.end_ns
    )


def lines(made: Report) -> list[str]:
    parts = [part for part in dive_screen(made, "report.html") if isinstance(part, Sentences)]
    return [line if isinstance(line, str) else line.text for part in parts for line in part.lines]


def test_the_predicted_gain_is_said_and_not_checked() -> None:
    found = lines(report())
    assert found[0] == "aided against baseline: NOT EVALUATED"
    assert re.match(r"The noise variance of baseline is \d{3} times too large", found[1])
    assert "--control" in found[1]
    assert found[1].count("first") == 1, "what to do first is said once"
    assert found[2].startswith("predicted: ")
    assert found[2].endswith("Neither is checked against errors.")


def test_the_table_over_dives_names_the_noise_and_no_missing_reference() -> None:
    dives = [
        replace(report(), log=replace(report().log, name=name, sha256=name), imu_fingerprint=None)
        for name in ("a", "b")
    ]
    result = named_result(dives, ["pooled"], [])
    text = str(result.document)
    assert "aided against baseline: not evaluated: the noise variance of baseline is" in text
    assert "Accuracy takes a reference" not in text


def test_nothing_is_said_of_a_filter_that_diverged_beside_a_baseline_in_order() -> None:
    rows = [
        replace(row, mean_nis=float(row.dof)) if row.filter == "baseline" else row
        for row in report().tables.consistency
    ]
    errors = [row for row in report().tables.credibility if row.quantity not in SETTLED]
    tables = replace(report().tables, consistency=rows, credibility=errors)
    dead = replace(
        report().filters["aided"], verdict=Verdict.NOT_EVALUATED, reason="aided diverged"
    )
    made = replace(report(), tables=tables, filters={"aided": dead, "tuned": dead})
    assert has_misfit(report())
    assert not has_misfit(made)
    assert predicted_unchecked([made], "aided") == ""
    assert against_control([made], "aided") is None
