"""Forest plots as SVG: ratios with their intervals on a logarithmic axis, the band of equal results, and a text each.

Places across are percent of the width, places down are pixels. So the text has the same size at any width.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from insdvl_replay.core.errors import visible
from insdvl_replay.core.tables import Number, finite
from insdvl_replay.evaluation.series import MARGIN
from insdvl_replay.show.document import significant

# Percent of the width: the end of labels, both ends of the axis, the start of texts.
LABEL_END, LEFT, RIGHT, TEXT = 28.0, 30.0, 64.0, 66.0
TOP, ROW, BOTTOM = 3, 17, 16  # Pixels: free above the rows, the height of a row, the height of the axis labels.
_BASELINE: Final = 4  # Pixels by which the foot of a text is below the middle of its row.
# Ticks by the upper end of the axis; the lower end is one over it.
AXES: Final = {
    2.0: (0.5, 0.7, 1.0, 1.4, 2.0),
    5.0: (0.2, 0.5, 1.0, 2.0, 5.0),
    20.0: (0.05, 0.2, 1.0, 5.0, 20.0),
    100.0: (0.01, 0.1, 1.0, 10.0, 100.0),
}
_MOST_BEYOND: Final = 0.5  # Share of the ratios that may be beyond the axis, as arrows.
_LONGEST_LABEL: Final = 20
_RAISED: Final = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class ForestRow:
    """A ratio with its interval; what is missing is not drawn."""

    label: str
    ratio: Number
    interval: tuple[float, float] | None = None
    tone: str = ""  # a verdict: its colour
    text: str = ""  # after the axis
    link: str = ""  # target of the label
    why: str = ""  # footnote
    decides: bool = False  # printed in bold


def forest(title: str, rows: Sequence[ForestRow]) -> str:
    """Draw ratios, a row each, with footnotes; as HTML."""
    reasons = list(dict.fromkeys(row.why for row in rows if row.why))
    notes = ". ".join(f"{_raised(number)}&nbsp;{unbroken(why)}" for number, why in enumerate(reasons, 1))
    footnote = f'<p class="footnote">{notes}.</p>' if notes else ""
    return f'<section class="forest"><h3>{escape(title)}</h3>{forest_svg(rows, reasons)}{footnote}</section>'


def forest_svg(rows: Sequence[ForestRow], reasons: Sequence[str] = ()) -> str:
    """Draw ratios, a row each. The number of a row's reason among ``reasons`` is behind its text."""
    end, bottom = axis_end(rows), TOP + ROW * len(rows)
    low, high = (place(ratio, end) for ratio in (1.0 / (1.0 + MARGIN), 1.0 + MARGIN))
    lines = [
        f'<svg width="100%" height="{bottom + BOTTOM}">',
        f'<rect class="within" x="{low:.2f}%" y="0" width="{high - low:.2f}%" height="{bottom}"/>',
    ]
    for tick in AXES[end]:
        across = f"{place(tick, end):.2f}%"
        style = "one" if tick == 1.0 else "grid"
        lines.append(f'<line class="{style}" x1="{across}" x2="{across}" y1="0" y2="{bottom}"/>')
        lines.append(f'<text class="tick" x="{across}" y="{bottom + 13}" text-anchor="middle">{tick:g}</text>')
    for number, row in enumerate(rows):
        middle = TOP + ROW * number + ROW / 2.0
        mark = f" {_raised(reasons.index(row.why) + 1)}" if row.why in reasons else ""
        style = f"row {tone_class(row.tone)}{' decides' if row.decides else ''}".rstrip()
        lines.append(f'<g class="{style}"><title>{_in_full(row)}</title>')
        lines += [*_label(row, middle), *_mark(row, middle, end)]
        lines.append(f'<text x="{TEXT}%" y="{middle + _BASELINE}">{escape(visible(row.text))}{mark}</text></g>')
    return "".join([*lines, "</svg>"])


def place(ratio: float, end: float) -> float:
    """Return the place of a ratio in percent of the width, on an axis up to ``end``."""
    return (LEFT + RIGHT) / 2.0 + (RIGHT - LEFT) / 2.0 * math.log(ratio) / math.log(end)


def axis_end(rows: Sequence[ForestRow]) -> float:
    """Return the upper end of the shortest axis that has at least half of the ratios."""
    ratios = [finite(row.ratio) for row in rows]
    sizes = [max(ratio, 1.0 / ratio) for ratio in ratios if 0.0 < ratio < math.inf]
    return next((end for end in AXES if sum(size > end for size in sizes) <= _MOST_BEYOND * len(sizes)), max(AXES))


def change_of_value(old: Number, new: Number, unit: str) -> str:
    """Write two values, such as ``0.107 → 0.092 m``."""
    return f"{significant(old, 3)} \N{RIGHTWARDS ARROW} {significant(new, 3)} {unit}"


def unbroken(text: str) -> str:
    """Write text as HTML whose numbers stay on one line with their percent sign."""
    return escape(visible(text), quote=False).replace(" %", "&nbsp;%")


def tone_class(verdict: str) -> str:
    """Return the class of a verdict in the style sheet."""
    return verdict.replace(" ", "-")


def _in_full(row: ForestRow) -> str:
    """Return what is shown where the pointer rests: whole name, ratio, interval, verdict."""
    ratio = "" if math.isnan(finite(row.ratio)) else f" {row.ratio:.3g}"
    interval = "" if row.interval is None else " ({:.3g} .. {:.3g})".format(*row.interval)
    return escape(visible(f"{row.label}{':' if ratio else ''}{ratio}{interval} {row.tone}".rstrip()))


def _label(row: ForestRow, middle: float) -> Iterator[str]:
    name, half = visible(row.label), _LONGEST_LABEL // 2
    short = f"{name[: half - 1]}…{name[-half:]}" if len(name) > _LONGEST_LABEL else name
    text = f'<text x="{LABEL_END}%" y="{middle + _BASELINE}" text-anchor="end">{escape(short)}</text>'
    yield f'<a href="{escape(row.link)}">{text}</a>' if row.link else text


def _mark(row: ForestRow, middle: float, end: float) -> Iterator[str]:
    """Draw a ratio as a dot on its interval, one beyond the axis as an arrow with the number."""
    ratio = math.nan if row.ratio is None else row.ratio
    if not ratio >= 0.0:
        return
    if not 1.0 / end <= ratio <= end:
        size = f"{ratio:.2g}" if ratio < 10.0 else f"{ratio:.0f}" if ratio < 1e5 else f"{ratio:.0e}"
        across, anchor, text = (RIGHT, "end", f"{size}x ▶") if ratio > 1.0 else (LEFT, "start", f"◀ {size}x")
        yield f'<text class="beyond" x="{across}%" y="{middle + _BASELINE}" text-anchor="{anchor}">{text}</text>'
        return
    if row.interval is not None and not math.isnan(sum(row.interval)):
        ends = [min(max(edge, 1.0 / end), end) for edge in row.interval]
        low, high = (place(edge, end) for edge in ends)
        yield f'<line class="interval" x1="{low:.2f}%" x2="{high:.2f}%" y1="{middle}" y2="{middle}"/>'
        for edge, shown, tip in zip(row.interval, ends, ("4-3v6z", "-4-3v6z"), strict=True):
            if edge != shown:  # the interval goes on
                yield f'<svg class="tip" x="{place(shown, end):.2f}%" y="{middle}"><path d="M0 0l{tip}"/></svg>'
    yield f'<circle cx="{place(ratio, end):.2f}%" cy="{middle}" r="3.5"/>'


def _raised(number: int) -> str:
    return str(number).translate(_RAISED)
