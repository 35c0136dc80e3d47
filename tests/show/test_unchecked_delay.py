"""A reference whose delay could not be checked is named where velocities are compared, which cannot warn then."""

import io

import pytest
from made_reports import report
from msgspec.structs import replace
from rich.console import Console

from insdvl_replay.core.dive_record import ReferenceDelay
from insdvl_replay.core.report import Report
from insdvl_replay.core.words import DelayStatus, Role
from insdvl_replay.document.parts import Part
from insdvl_replay.document.text import for_terminal
from insdvl_replay.evaluation.evidence import role_alone
from insdvl_replay.show.answers import unchecked_delay
from insdvl_replay.show.screens import dive_screen, dives_screen

CHECKED = ReferenceDelay(0.001, 0.002, DelayStatus.DETERMINED)
LITTLE_MOTION = ReferenceDelay(None, None, DelayStatus.LITTLE_MOTION)
CONTRADICTORY = ReferenceDelay(0.3, 0.002, DelayStatus.CONTRADICTORY)


def dive(name: str, delay: ReferenceDelay | None) -> Report:
    """A dive whose rows of the drift are of velocities."""
    made = report(name)
    rows = list(made.tables.evidence)
    [first, *_] = rows
    rows.append(replace(first, evidence="accuracy", quantity="velocity_along", unit="m/s"))
    return replace(made, tables=replace(made.tables, evidence=rows), reference_delay=delay)


def text_of(document: list[Part]) -> str:
    console = Console(width=200, record=True, file=io.StringIO(), color_system=None)
    console.print(for_terminal(document), crop=False)
    return console.export_text()


def test_one_dive_says_that_the_delay_was_not_checked() -> None:
    said = "reference: delay not checked (little motion), so velocities cannot warn"
    assert said in text_of(dive_screen(dive("a", LITTLE_MOTION), "report.html"))
    assert "delay not checked" not in text_of(dive_screen(dive("a", CHECKED), "report.html"))


def test_several_dives_count_those_that_were_not_checked() -> None:
    dives = [dive("a", LITTLE_MOTION), dive("b", CHECKED), dive("c", LITTLE_MOTION)]
    said = "reference: delay not checked on 2 of 3 dives (little motion), so velocities cannot warn there"
    assert said in text_of(dives_screen(dives, "index.html"))


@pytest.mark.parametrize("delay", [CHECKED, CONTRADICTORY, None])
def test_nothing_is_said_of_a_checked_a_warned_of_or_an_early_one(
    delay: ReferenceDelay | None,
) -> None:
    assert unchecked_delay([dive("a", delay)]) == ""


def test_nothing_is_said_where_no_velocity_is_compared() -> None:
    made = dive("a", LITTLE_MOTION)
    rows = [row for row in made.tables.evidence if not row.quantity.startswith("velocity")]
    assert unchecked_delay([replace(made, tables=replace(made.tables, evidence=rows))]) == ""


@pytest.mark.parametrize(
    ("delay", "role"),
    [
        (CHECKED, Role.SECONDARY),
        (None, Role.SECONDARY),
        (LITTLE_MOTION, Role.SHOWN),
        (CONTRADICTORY, Role.SHOWN),
    ],
)
def test_a_velocity_cannot_warn_in_other_comparisons_either(
    delay: ReferenceDelay | None, role: Role
) -> None:
    assert role_alone("velocity_along", 0, independent=True, delay=delay) == role
    assert role_alone("level", 0, independent=True, delay=delay) == Role.SECONDARY
