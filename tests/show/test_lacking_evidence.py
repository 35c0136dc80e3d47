"""An answer without evidence says what the dive lacks, and how much; warnings of several dives name their dive."""

from pathlib import Path

import pytest
from made_reports import report, tables, unreferenced
from msgspec.structs import replace

from insdvl_replay.cli.messages import MOST_FINDINGS, log_findings, log_notes
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.report import Report
from insdvl_replay.core.words import Severity, Verdict
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.show import screens
from insdvl_replay.show.answers import answers_of, lacking_evidence
from insdvl_replay.show.screens import dives_screen


def bare(name: str, duration_s: float) -> Report:
    """Give a dive without a reference, of which the outage test had no window."""
    found = report(name, replace(unreferenced(tables()), evidence=[], outage=[]))
    undecided = {
        key: replace(filter_, verdict=Verdict.UNDECIDED) for key, filter_ in found.filters.items()
    }
    return replace(found, filters=undecided, log=replace(found.log, duration_s=duration_s))


def test_a_short_dive_without_reference_says_what_it_lacks() -> None:
    (answer,) = answers_of([bare("dive", 60.0)])
    assert headline(answer) == (
        "UNDECIDED, no evidence: no reference, and too short for the outage test (needs 160 s, has 60 s)"
    )
    (both,) = answers_of([bare("one", 60.0), bare("two", 60.0)])
    assert both.reason == answer.reason


def test_the_reason_of_a_dive_that_is_not_evaluated_is_not_that_of_the_others() -> None:
    unusable = bare("three", 60.0)
    candidates = {
        name: replace(found, verdict=Verdict.NOT_EVALUATED, reason="aided diverged")
        for name, found in unusable.filters.items()
    }
    dives = [bare("one", 60.0), bare("two", 60.0), replace(unusable, filters=candidates)]
    (answer,) = answers_of(dives)
    assert (answer.verdict, answer.evaluated) == (Verdict.UNDECIDED, 2)
    assert answer.reason.startswith("no reference, and too short")


def test_the_screen_says_once_how_to_get_evidence() -> None:
    parts = dives_screen([bare("one", 60.0), bare("two", 60.0)], "index.html")
    assert str(list(parts)).count("To get evidence: name a reference") == 1


def test_a_dive_that_continues_another_names_the_option_that_joins_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    continued = note("dives_continue", begun="two", pause_s=3.0, when="after", ended="one")
    monkeypatch.setattr(screens, "distinct_dives", lambda reports: (reports, (continued,)))
    parts = dives_screen([bare("one", 60.0), bare("two", 60.0)], "index.html")
    assert f"{continued.text}; hint: {continued.hint}" in list(parts)
    assert "--one-dive" in continued.hint


def test_a_long_dive_with_gaps_lacks_another_thing() -> None:
    assert "no 30 s in which the DVL has no gap" in lacking_evidence(bare("dive", 300.0))
    with_reference = report()
    assert "no reference" not in lacking_evidence(with_reference)


def test_warnings_of_several_dives_name_their_dive(capsys: pytest.CaptureFixture[str]) -> None:
    pauses = Note("imu_gaps", "the IMU pauses", 1, Severity.WARNING)
    log_notes([pauses], verbose=False, dive="second")
    log_notes([pauses], verbose=False)
    named, alone = capsys.readouterr().err.splitlines()
    assert named.startswith("warning: second: the IMU")
    assert alone.startswith("warning: the IMU")


def test_findings_beyond_the_screen_are_counted_without_their_codes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    notes = [Note(f"found_{number}", f"finding {number}") for number in range(MOST_FINDINGS + 2)]
    log_findings(notes, Path("vehicle.toml"))
    last = capsys.readouterr().err.splitlines()[-1]
    assert "2 more" in last
    assert "found_" not in last
