"""The picture of the rule in docs/verdict.md: five intervals and the band. The ratios of the dives are invented."""

import math
from collections.abc import Sequence
from html import escape

from insdvl_replay.evaluation.interval import BAND, log_ratio_interval, word_of_interval
from insdvl_replay.evaluation.sentences import ratio_text

WIDTH = 720
HEIGHT = 236
ROW = 34
TOP = 40
# Ends of the axis, and where texts begin.
LEFT = 190
RIGHT = 520
TEXT = 540
LOWEST = 0.6
HIGHEST = 1.6
DIVES = {
    "smaller on all dives": (0.78, 0.82, 0.75, 0.80, 0.84),
    "larger on all dives": (1.22, 1.31, 1.18, 1.26, 1.20),
    "nearly the same": (1.01, 0.99, 1.02, 0.98, 1.00),
    "the dives disagree": (0.72, 1.20, 0.81, 1.31, 0.93),
    "smaller, but too few dives": (0.80, 0.98, 0.86),
}
COLOURS = {
    "better": "#1a7f37",
    "worse": "#b42318",
    "equivalent": "#1f4e9c",
    "undecided": "#6b7280",
}


def across(ratio: float) -> float:
    """Return the place of a ratio on the axis, pixels."""
    share = math.log(ratio / LOWEST) / math.log(HIGHEST / LOWEST)
    return LEFT + share * (RIGHT - LEFT)


def verdict_picture() -> bytes:
    """Draw the intervals of some sets of dives, with the word of each."""
    bottom = TOP + ROW * len(DIVES)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        'font-size="13">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
        f'<rect x="{across(1.0 / BAND):.1f}" y="{TOP - 12}" width="{across(BAND) - across(1.0 / BAND):.1f}" '
        f'height="{bottom - TOP + 12}" fill="#e5e7eb"/>',
        f'<text x="{across(1.0):.1f}" y="{TOP - 18}" text-anchor="middle">band: a factor {BAND} to each side</text>',
    ]
    for ratio in (0.7, 0.8, 1.0, 1.25, 1.5):
        lines.append(
            f'<text x="{across(ratio):.1f}" y="{bottom + 18}" text-anchor="middle" fill="#4b5563">{ratio:g}</text>'
        )
    lines.append(
        f'<text x="{(LEFT + RIGHT) / 2}" y="{bottom + 36}" text-anchor="middle" fill="#4b5563">'
        "error of the candidate over that of the baseline</text>"
    )
    for number, (name, ratios) in enumerate(DIVES.items()):
        lines += _row(TOP + ROW * number + 10, name, ratios)
    return "\n".join([*lines, "</svg>", ""]).encode()


def _row(middle: float, name: str, ratios: Sequence[float]) -> list[str]:
    interval = log_ratio_interval([math.log(ratio) for ratio in ratios])
    word = word_of_interval(interval.low, interval.high)
    colour = COLOURS[word]
    low = max(interval.low, LOWEST)
    high = min(interval.high, HIGHEST)
    said = f"{word.upper()}  {ratio_text(interval.ratio)} ({ratio_text(interval.low)} .. {ratio_text(interval.high)})"
    dots = [
        f'<circle cx="{across(ratio):.1f}" cy="{middle + 8}" r="2" fill="#9ca3af"/>'
        for ratio in ratios
    ]
    return [
        f'<text x="{LEFT - 12}" y="{middle + 4}" text-anchor="end">{escape(name)}</text>',
        *dots,
        f'<line x1="{across(low):.1f}" x2="{across(high):.1f}" y1="{middle}" y2="{middle}" stroke="{colour}" '
        'stroke-width="3"/>',
        f'<circle cx="{across(interval.ratio):.1f}" cy="{middle}" r="4.5" fill="{colour}"/>',
        f'<text x="{TEXT}" y="{middle + 4}" fill="{colour}">{escape(said)}</text>',
    ]
