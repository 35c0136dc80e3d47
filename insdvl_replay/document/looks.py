"""The colours and dashes of styles, which the style sheet of pages has, for all that is not drawn by it."""

import re
from functools import cache
from importlib.resources import files
from typing import Final, NamedTuple

_COLOUR: Final = re.compile(r"--(\w+): (#[0-9a-f]+);")
_RULE: Final = re.compile(r"^\.(\w+) \{ (.*) \}$", re.MULTILINE)  # of one class, on a line
_STROKE: Final = re.compile(r"stroke: var\(--(\w+)\)")
_DASHES: Final = re.compile(r"stroke-dasharray: ([^;]+)")


class Stroke(NamedTuple):
    """How the lines of a style are drawn; None where the style leaves it to others."""

    colour: str | None  # in the light, such as #c0232c
    # lengths in pixels, of dashes and gaps in turn; empty: unbroken
    dashes: tuple[float, ...] | None


def style_sheet() -> str:
    """Return the style sheet of pages and pictures."""
    return files("insdvl_replay.document").joinpath("page.css").read_text("utf-8")


@cache
def strokes() -> dict[str, Stroke]:
    """Return the stroke of each style that the style sheet names alone."""
    sheet = style_sheet()
    colours: dict[str, str] = {}
    for name, colour in _COLOUR.findall(sheet):
        colours.setdefault(name, colour)  # those in the dark follow
    found = {}
    for style, rule in _RULE.findall(sheet):
        stroke = _STROKE.search(rule)
        dashes = _DASHES.search(rule)
        found[style] = Stroke(
            None if stroke is None else colours[stroke[1]],
            None if dashes is None else _lengths(dashes[1]),
        )
    return found


def _lengths(text: str) -> tuple[float, ...]:
    if text == "none":
        return ()
    return tuple(float(length) for length in text.split())
