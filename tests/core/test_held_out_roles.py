"""What is held out of a dive is decided in one place, with the reason."""

import ast
from pathlib import Path

import pytest

import insdvl_replay
from insdvl_replay.core.errors import Note
from insdvl_replay.core.held_out import (
    NOTHING,
    NOTHING_PASSES,
    HeldOut,
    Why,
    held_out_name,
    held_out_sensor,
    is_never_used,
)
from insdvl_replay.core.of_reference import (
    OfReference,
    is_independent,
    sensor_is_reference,
    solution_is_reference,
)

PACKAGE = Path(insdvl_replay.__file__).parent
DEPTH = HeldOut(("depth",))
IN_OUTAGE = NOTHING.in_outages([(0, 10)])
# Parts of names, each of which one module alone may write or take off.
WRITTEN_IN = {
    "held_out_": {"core/held_out.py"},
    "_is_reference": {"core/of_reference.py"},
}
# The setting is read as a value that says what it means, and its words are checked.
SETTING_IN = {"core/config.py", "core/config_checks.py"}


@pytest.mark.parametrize(
    ("held_out", "role", "why"),
    [
        (NOTHING, "depth", None),
        (NOTHING, "reference", None),
        (DEPTH, "depth", Why.SENSOR),
        (DEPTH, "heading", None),
        (DEPTH, "dvl", None),
        (DEPTH, "reference", Why.MIXTURE),
        (DEPTH, "filters.mine.solution", Why.MIXTURE),
        (DEPTH, "truth", None),
        (IN_OUTAGE, "dvl", Why.OUTAGE),
        (IN_OUTAGE, "reference", Why.OUTAGE),
        (IN_OUTAGE, "imu", None),
        (IN_OUTAGE, "truth", None),
        (IN_OUTAGE.with_judges(), "dvl", Why.OUTAGE),
        (IN_OUTAGE.with_judges(), "reference", Why.JUDGE),
        (NOTHING.with_judges(), "truth", Why.JUDGE),
        (NOTHING.with_judges(), "filters.mine.solution", Why.JUDGE),
        (NOTHING.with_judges(), "topics.sonar", None),
        (DEPTH.with_judges(), "depth", Why.SENSOR),
    ],
)
def test_what_is_held_out_has_a_reason(held_out: HeldOut, role: str, why: Why | None) -> None:
    assert held_out.why(role) == why


def test_a_filter_predicts_what_it_is_told_and_what_is_held_out() -> None:
    aiding = ("velocity", "depth")
    assert DEPTH.given(aiding) == ("velocity",)
    assert DEPTH.met(("velocity",)) == {"velocity", "depth"}
    assert NOTHING.given(aiding) == aiding


def test_a_measurement_says_which_sensor_is_held_out() -> None:
    assert held_out_sensor(held_out_name("depth")) == "depth"
    assert held_out_sensor("depth") == ""
    assert is_never_used(NOTHING_PASSES)
    assert not is_never_used(0.0)


def test_notes_say_what_is_the_references_own() -> None:
    codes = [sensor_is_reference("position"), solution_is_reference("onboard"), "depth_stuck"]
    found = OfReference.noted(Note(code, "x") for code in codes)
    assert found == OfReference(frozenset({"position"}), frozenset({"onboard"}))


@pytest.mark.parametrize(
    ("settings", "said"),
    [({}, True), ({"reference": {}}, True), ({"reference": {"independent": False}}, False)],
)
def test_early_results_do_not_say_that_sensors_are_shared(
    settings: dict[str, dict[str, bool]], said: bool
) -> None:
    assert is_independent(settings) == said


def test_nothing_else_decides_it() -> None:
    written: dict[str, set[str]] = {part: set() for part in WRITTEN_IN}
    asked = set[str]()
    for file in sorted(PACKAGE.rglob("*.py")):
        place = file.relative_to(PACKAGE).as_posix()
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and node.value in written:
                written[node.value].add(place)
            elif isinstance(node, ast.Attribute):
                names = ast.unparse(node).split(".")
                if names[-2:] == ["evaluation", "held_out"]:
                    asked.add(place)
    assert written == WRITTEN_IN
    assert asked == SETTING_IN
