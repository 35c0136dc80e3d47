"""A document in LaTeX: sentences are comments, tables are for booktabs, and their numbers for siunitx.

Caption and label of each table name what the document is about, so that one paper can hold the tables of many dives.
"""

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

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
    sentences = []
    blocks = []
    labels = set[str]()
    tables = 0
    for part in flat("latex", document):
        if isinstance(part, DisplayTable):
            tables += 1
            blocks.append(_table(part, about, labels))
            if tables % _MOST_FLOATS == 0:
                blocks.append(r"\clearpage")
        elif text := sentence_of(part):
            sentences.append(f"% {visible(text)}")
    if tables:
        sentences.insert(0, _PACKAGES)
    return "\n\n".join(["\n".join(sentences), *blocks]) + "\n"


def _table(table: DisplayTable, about: str, labels: set[str]) -> str:
    columns = []
    for place, (letter, head) in enumerate(zip(table.alignment, table.header, strict=True)):
        texts = [_on_one_line(row[place]) for row in table.rows]
        columns.append(_column(letter, " ".join(head.split()), texts))
    formats = [column.format for column in columns]
    lines = [
        r"\begin{table}[htbp]",
        r"\centering",
        rf"\caption{{{_text(_caption(table.title, about))}}}",
        rf"\label{{tab:{_label(about, table.title, labels)}}}",
        r"\footnotesize\setlength{\tabcolsep}{3pt}",
        _AT_MOST_A_LINE,
        rf"\begin{{tabular}}{{{''.join(formats)}}}",
        r"\toprule",
        _row([column.head for column in columns]),
        r"\midrule",
    ]
    for number in range(len(table.rows)):
        lines.append(_row([column.cells[number] for column in columns]))
    lines += [r"\bottomrule", r"\end{tabular}}"]
    if table.footnote:
        lines.append(rf"\par {_text(table.footnote)}")
    lines.append(r"\end{table}")
    return "\n".join(lines)


def _on_one_line(cell: CellText) -> str:
    return " ".join(" ".join(cell_lines(cell)).split())


def _caption(title: str, about: str) -> str:
    """Return the title of a table with what it is about, if it does not say it."""
    if not title:
        return about
    if about in title:
        return title
    return f"{title} ({about})"


def _label(about: str, title: str, labels: set[str]) -> str:
    """Return a new label; other letters of a dive's name are written by their bytes, so that no two are the same."""
    name = re.sub(
        r"[^\w.-]", lambda found: found[0].encode(errors="replace").hex(), about, flags=re.ASCII
    )
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:_LONGEST_LABEL]
    wanted = ":".join(filter(None, (name, slug)))
    label = wanted
    while label in labels:
        same = [known for known in labels if known.startswith(wanted)]
        label = f"{wanted}-{len(same) + 1}"
    labels.add(label)
    return label


class _Column(NamedTuple):
    """A column as LaTeX."""

    format: str  # of ``tabular``
    head: str
    cells: list[str]


def _column(letter: str, head: str, texts: Sequence[str]) -> _Column:
    """Return a column for siunitx if there are numbers and no words, else with its words."""
    if letter == "r":
        numbers = _numbers(texts)
        if numbers:
            return _column_of_numbers(head, texts, numbers)
    if letter == "l" and any(len(text) > _LONGEST_CELL for text in texts):
        letter = "p{25mm}"
    return _Column(letter, _cell(head), [_cell(text) for text in texts])


def _numbers(texts: Sequence[str]) -> list[re.Match[str]]:
    """Return the parts of the numbers of a column, without what is missing; none if it has words or two units."""
    numbers = []
    for text in texts:
        if text != MISSING:
            number = _NUMBER.fullmatch(text)
            if number is None:
                return []
            numbers.append(number)
    units = {number["unit"] for number in numbers}
    if len(units) > 1:
        return []
    return numbers


def _column_of_numbers(
    head: str, texts: Sequence[str], numbers: Sequence[re.Match[str]]
) -> _Column:
    if numbers[0]["unit"]:
        head += " [%]"
    cells = []
    for text in texts:
        if text == MISSING:
            cells.append(f"{{{MISSING * 2}}}")
        else:
            cells.append(re.sub(r"e([+-])0+", r"e\1", text.removesuffix(" %")))
    return _Column(_siunitx(numbers), f"{{{_text(head)}}}", cells)


def _siunitx(numbers: Sequence[re.Match[str]]) -> str:
    """Return the format of a column that leaves room for the longest parts of its numbers."""
    signs = {number["sign"] for number in numbers}
    whole = max(len(number["whole"]) for number in numbers)
    decimals = max(len(number["decimals"] or "") for number in numbers)
    power = max(len((number["power"] or "").lstrip("+-0")) for number in numbers)
    room = f"{whole}"
    if decimals:
        room += f".{decimals}"
    if power:
        room += f"e-{power}"
    if "+" in signs:
        return f"S[table-format=+{room},retain-explicit-plus]"
    if "-" in signs:
        return f"S[table-format=-{room}]"
    return f"S[table-format={room}]"


def _row(cells: Sequence[str]) -> str:
    """Write a row; braces before what would be an option of the one above, or a command to a job runner."""
    return re.sub(r"^(?=[\[*:])", "{}", " & ".join(cells)) + r" \\"


def _cell(text: str) -> str:
    """Write a number among words with a real minus and powers of ten, other text as it is."""
    found = _NUMBER.fullmatch(text)
    if found is None:
        return _text(text)
    number = found["whole"]
    if found["decimals"]:
        number += f".{found['decimals']}"
    if found["power"]:
        number += rf" \times 10^{{{int(found['power'])}}}"
    if found["sign"] or found["power"]:
        number = f"${found['sign']}{number}$"
    if found["unit"]:
        number += r"\,\%"
    return number


def _text(text: str) -> str:
    letters = [_ESCAPES.get(letter, letter) for letter in visible(text)]
    return "".join(letters).replace("--", "-{}-")
