"""A document in LaTeX: sentences are comments, tables are for booktabs, and their numbers for siunitx.

Caption and label of each table name what the document is about, so that one paper can hold the tables of many dives.
"""

import re
from collections.abc import Collection, Sequence
from typing import Final

from insdvl_replay.core.errors import visible
from insdvl_replay.document.parts import CellText, DisplayTable, Document
from insdvl_replay.document.tables import MISSING, cell_lines
from insdvl_replay.document.text import flat, sentence_of

_PACKAGES: Final = r"% needs \usepackage{booktabs,graphicx,siunitx}"
# Makes a table smaller that is wider than the text.
_AT_MOST_A_LINE: Final = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
_ESCAPES: Final = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\N{PLUS-MINUS SIGN}": r"\ensuremath{\pm}",
    "\N{EN DASH}": "--",
    "\N{SUPERSCRIPT TWO}": r"\ensuremath{^2}",
}
_NUMBER: Final = re.compile(
    r"(?P<sign>[+-]?)(?P<whole>\d+)(?:\.(?P<decimals>\d+))?(?:e(?P<power>[+-]\d+))?(?: (?P<unit>%))?"
)
_LONGEST_LABEL: Final = 60
_LONGEST_CELL: Final = 30  # Letters; a column with more is folded.
_MOST_FLOATS: Final = 10  # LaTeX holds 18 floats at least, until a page is full of text.


def as_latex(document: Document, about: str = "") -> str:
    """Render a document: all sentences first, then a ``table`` for each table, which names what it is about."""
    parts = list(flat("latex", document))
    sentences = [f"% {visible(text)}" for part in parts if (text := sentence_of(part))]
    blocks = list[str]()
    labels = set[str]()
    for count, table in enumerate((part for part in parts if isinstance(part, DisplayTable)), 1):
        blocks += [_table(table, about, labels), *([] if count % _MOST_FLOATS else [r"\clearpage"])]
    return "\n\n".join(["\n".join([*([_PACKAGES] if blocks else []), *sentences]), *blocks]) + "\n"


def _table(table: DisplayTable, about: str, labels: set[str]) -> str:
    columns = [
        _column(letter, *cells)
        for letter, *cells in zip(table.alignment, table.header, *table.rows, strict=True)
    ]
    formats, *rows = zip(*columns, strict=True)
    head, *body = (_row(row) for row in rows)
    caption = (
        f"{table.title} ({about})"
        if table.title and about not in table.title
        else table.title or about
    )
    return "\n".join(
        [
            r"\begin{table}[htbp]",
            r"\centering",
            rf"\caption{{{_text(caption)}}}",
            rf"\label{{tab:{_label(about, table.title, labels)}}}",
            r"\footnotesize\setlength{\tabcolsep}{3pt}",
            _AT_MOST_A_LINE,
            rf"\begin{{tabular}}{{{''.join(formats)}}}",
            r"\toprule",
            head,
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}}",
            *([rf"\par {_text(table.footnote)}"] if table.footnote else []),
            r"\end{table}",
        ]
    )


def _label(about: str, title: str, labels: set[str]) -> str:
    """Return a new label; other letters of a dive's name are written by their bytes, so that no two are the same."""
    name = re.sub(
        r"[^\w.-]", lambda found: found[0].encode(errors="replace").hex(), about, flags=re.ASCII
    )
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:_LONGEST_LABEL]
    label = wanted = ":".join(filter(None, (name, slug)))
    while label in labels:
        label = f"{wanted}-{sum(known.startswith(wanted) for known in labels) + 1}"
    labels.add(label)
    return label


def _column(letter: str, head: str, *column: CellText) -> list[str]:
    """Return the format of a column, its head and its cells: for siunitx if there are numbers and no words."""
    title, *texts = (
        " ".join(" ".join(cell_lines(cell)).split()) for cell in (" ".join(head.split()), *column)
    )
    found = [_NUMBER.fullmatch(text) for text in texts if text != MISSING]
    numbers = [number for number in found if number is not None]
    if (
        letter != "r"
        or not numbers
        or len(numbers) < len(found)
        or len({number["unit"] for number in numbers}) > 1
    ):
        is_long = max(map(len, texts), default=0) > _LONGEST_CELL
        return ["p{25mm}" if letter == "l" and is_long else letter, *map(_cell, (title, *texts))]
    unit = " [%]" if numbers[0]["unit"] else ""
    missing = f"{{{MISSING * 2}}}"
    plain = (re.sub(r"e([+-])0+", r"e\1", text.removesuffix(" %")) for text in texts)
    return [
        _siunitx(numbers),
        f"{{{_text(title + unit)}}}",
        *(missing if text == MISSING else text for text in plain),
    ]


def _siunitx(numbers: Collection[re.Match[str]]) -> str:
    """Return the format of a column that leaves room for the longest parts of its numbers."""
    whole, decimals, power = (
        max(
            len((number[part] or "").lstrip("+-0") if part == "power" else number[part] or "")
            for number in numbers
        )
        for part in ("whole", "decimals", "power")
    )
    signs = {number["sign"] for number in numbers}
    sign = "+" if "+" in signs else "-" if "-" in signs else ""
    options = f"{sign}{whole}{f'.{decimals}' if decimals else ''}{f'e-{power}' if power else ''}"
    return f"S[table-format={options}{',retain-explicit-plus' if sign == '+' else ''}]"


def _row(cells: Sequence[str]) -> str:
    """Write a row; braces before what would be an option of the one above, or a command to a job runner."""
    return re.sub(r"^(?=[\[*:])", "{}", " & ".join(cells)) + r" \\"


def _cell(text: str) -> str:
    """Write a number among words with a real minus and powers of ten, other text as it is."""
    found = _NUMBER.fullmatch(text)
    if found is None:
        return _text(text)
    power = rf" \times 10^{{{int(found['power'])}}}" if found["power"] else ""
    digits = f"{found['whole']}{'.' if found['decimals'] else ''}{found['decimals'] or ''}"
    number = f"${found['sign']}{digits}{power}$" if found["sign"] or power else digits
    return number + (r"\,\%" if found["unit"] else "")


def _text(text: str) -> str:
    return "".join(_ESCAPES.get(letter, letter) for letter in visible(text)).replace("--", "-{}-")
