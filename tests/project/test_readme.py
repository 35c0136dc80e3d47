"""README says what the program does."""

import re
from pathlib import Path

import numpy as np
import pictures
import pytest
import readme
import screens

NUMBER = re.compile(r"-?\d+\.\d+")


@pytest.mark.all_starts
def test_readme_has_the_means_of_the_paper() -> None:
    parts = {"paper": readme.paper}
    assert readme.written(parts) == readme.README.read_text("utf-8"), "run `make readme`"


@pytest.mark.nightly
@pytest.mark.all_starts
def test_readme_shows_what_the_program_prints() -> None:
    assert readme.written() == readme.README.read_text("utf-8"), "run `make readme`"


def test_readme_has_the_answers_of_the_first_run() -> None:
    """A nightly test holds both to what is printed."""
    text = readme.README.read_text("utf-8")
    _, _, rest = text.partition("$ insdvl-replay demo\n")
    answers, _, _ = rest.partition("```")
    assert {"BETTER", "WORSE", "NO EFFECT"} <= set(re.findall("[A-Z]+(?: [A-Z]+)*", answers))
    assert answers in (readme.PROJECT / "docs" / "first_run.md").read_text("utf-8")


@pytest.mark.nightly
def test_screens_in_the_pages_are_what_the_program_prints() -> None:
    for page, text in screens.written():
        assert text == page.read_text("utf-8"), f"{page.name}: run `make readme`"


@pytest.mark.parametrize("name", screens.PAGES, ids=lambda page: page.stem)
def test_commands_of_the_screens_have_their_output(name: Path) -> None:
    blocks = screens.SCREEN.findall(name.read_text("utf-8"))
    assert blocks
    silent = ("$ insdvl-replay simulate",)
    assert all(block.startswith(silent) or len(block.splitlines()) > 1 for block in blocks)


@pytest.mark.parametrize("name", pictures.PICTURES)
@pytest.mark.nightly
def test_pictures_are_what_the_program_draws(name: str) -> None:
    """Places may differ by the last digit that is written, a tenth of a pixel: machines round in their own ways."""
    shown, drawn = (pictures.PROJECT / name).read_text("utf-8"), pictures.PICTURES[name]().decode()
    assert NUMBER.split(shown) == NUMBER.split(drawn), "run `make pictures`"
    places = [np.array(NUMBER.findall(text), dtype=float) for text in (shown, drawn)]
    np.testing.assert_allclose(*places, atol=0.11)


@pytest.mark.nightly
def test_page_of_a_vehicle_shows_what_is_found_of_a_real_one() -> None:
    if not readme.BLUEYE.is_file():
        pytest.skip("needs ../shared/data (real logs)")
    assert readme.vehicle_page() == readme.VEHICLE.read_text("utf-8"), "run `make readme`"


@pytest.mark.nightly
@pytest.mark.all_starts
def test_readme_shows_what_the_program_makes_of_a_foreign_vehicle(ros1: readme.Path) -> None:
    assert ros1 == readme.BAG.parent
    assert readme.written({"foreign": readme.foreign}) == readme.README.read_text("utf-8"), (
        "run `make readme`"
    )
    arm = re.search(r"^lever_arm_m = \[(.+)\]$", readme.README.read_text("utf-8"), re.MULTILINE)
    assert arm
    found = np.array(arm[1].split(","), dtype=float)
    # Its launch file has x forward, y port, z up.
    np.testing.assert_allclose(found, [0.3, -0.5, 0.68], atol=0.0145)
