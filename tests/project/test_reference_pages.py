"""The pages of docs/reference/ are what the program says of itself."""

import pytest
import reference


@pytest.mark.nightly
@pytest.mark.parametrize("name", reference.PAGES)
def test_page_is_current(name: str) -> None:
    assert reference.PAGES[name]() == (reference.FOLDER / f"{name}.md").read_text("utf-8"), (
        "run `make reference`"
    )


def test_every_page_is_written() -> None:
    assert set(reference.PAGES) <= {path.stem for path in reference.FOLDER.iterdir()}
