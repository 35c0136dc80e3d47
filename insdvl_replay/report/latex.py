"""A document as LaTeX, for a paper: sentences are comments, and tables need ``\\usepackage{booktabs}``.

Text is shown as everywhere (`errors.visible`) and cannot leave its place: no line break would end a comment.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.core.errors import visible
from insdvl_replay.report.document import (
    Callout,
    CellText,
    DisplayTable,
    Document,
    Part,
    Remark,
    Sentences,
    Title,
    cell_lines,
    parts_for,
)

_ESCAPES: Final = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}

_SIGNS: Final = {
    "\N{PLUS-MINUS SIGN}": r"\ensuremath{\pm}",
    "\N{EN DASH}": "--",
    "\N{SUPERSCRIPT TWO}": r"\ensuremath{^2}",
}
_NUMBER: Final = re.compile(r"(?P<sign>[+-]?)(?P<digits>\d+(?:\.\d+)?)(?:e(?P<power>[+-]\d+))?(?: (?P<unit>%))?")
_LONGEST_LABEL: Final = 60


def as_latex(document: Document) -> str:
    """Render a document in LaTeX: all sentences first, then one ``table`` for each table."""
    parts = list(parts_for("latex", document))
    comments = "\n".join(f"% {visible(line)}" for part in parts for line in _sentences(part))
    return "\n\n".join([comments, *(_table(part) for part in parts if isinstance(part, DisplayTable))]) + "\n"


def _sentences(part: Part) -> Iterator[str]:
    match part:
        case str(text) | Title(text) | Callout(text) | Remark(text=text):
            yield text
        case Sentences(lines):
            for line in lines:
                yield from _sentences(line)


def _table(table: DisplayTable) -> str:
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{_text(table.title)}}}",
            rf"\label{{tab:{_label(table.title)}}}",
            rf"\begin{{tabular}}{{{table.alignment}}}",
            r"\toprule",
            _row([" ".join(name.split()) for name in table.header]),
            r"\midrule",
            *map(_row, table.rows),
            r"\bottomrule",
            r"\end{tabular}",
            *([rf"\par {_text(table.footnote)}"] if table.footnote else []),
            r"\end{table}",
        ]
    )


def _label(title: str) -> str:
    """Make a label of a title: its letters and digits."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:_LONGEST_LABEL]


def _number(text: str) -> str:
    """Write a number with a real minus and powers of ten, other text as it is."""
    found = _NUMBER.fullmatch(text)
    if found is None:
        return _text(text)
    sign = {"-": "-", "+": "+"}.get(found["sign"], "")
    power = rf" \times 10^{{{int(found['power'])}}}" if found["power"] else ""
    unit = rf"\,{_text(found['unit'])}" if found["unit"] else ""
    return f"${sign}{found['digits']}{power}${unit}" if sign or power else f"{found['digits']}{unit}"


def _row(row: Sequence[CellText]) -> str:
    """Write a row; braces before what would be an option of the one above, or a command to a job runner."""
    text = " & ".join(_number(" ".join(" ".join(cell_lines(cell)).split())) for cell in row)
    return re.sub(r"^(?=[\[*:])", "{}", text) + r" \\"


def _text(text: str) -> str:
    """Escape what LaTeX would read; what its usual fonts lack is written by a command."""
    escaped = re.sub(r"[\\^~&%$#_{}]", lambda match: _ESCAPES[match.group()], visible(text))
    return "".join(_SIGNS.get(letter, letter) for letter in escaped)
