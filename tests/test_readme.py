"""README says what the program does."""

import readme


def test_readme_shows_what_the_program_prints() -> None:
    assert readme.written() == readme.README.read_text("utf-8"), "run `make readme`"
