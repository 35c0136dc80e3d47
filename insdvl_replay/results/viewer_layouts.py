"""Layouts for viewers of replay.mcap, with the names of a result's own filters."""

import re
from collections.abc import Sequence
from importlib import resources
from typing import Final

from insdvl_replay.results.folder import LAYOUT_FILES

_NAMES: Final = re.compile(r"\b(baseline|aided)\b")
"""The filters for which the layouts are drawn."""


def viewer_layouts(filters: Sequence[str]) -> dict[str, str]:
    """Return the layouts of the first filter and of the one after it, by the names of their files."""
    names = {"baseline": filters[0], "aided": filters[min(1, len(filters) - 1)]}
    folder = resources.files("insdvl_replay").joinpath("results", "layouts")
    drawn = {file: folder.joinpath(file).read_text("utf-8") for file in LAYOUT_FILES}
    return {file: _NAMES.sub(lambda found: names[found[1]], text) for file, text in drawn.items()}
