"""README says what the program does."""

import re

import numpy as np
import pictures
import pytest
import readme

NUMBER = re.compile(r"-?\d+\.\d+")


def test_readme_shows_what_the_program_prints() -> None:
    assert readme.written() == readme.README.read_text("utf-8"), "run `make readme`"


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_pictures_are_what_the_program_draws(name: str) -> None:
    """Places may differ by the last digit that is written, a tenth of a pixel: machines round in their own ways."""
    shown, drawn = (pictures.PROJECT / name).read_text("utf-8"), pictures.PICTURES[name]().decode()
    assert NUMBER.split(shown) == NUMBER.split(drawn), "run `make pictures`"
    places = [np.array(NUMBER.findall(text), dtype=float) for text in (shown, drawn)]
    np.testing.assert_allclose(*places, atol=0.11)
