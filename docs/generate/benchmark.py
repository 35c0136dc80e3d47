"""The pages of the public benchmark, and the picture: candidates on the public dives.

    python docs/generate/benchmark.py [NAME]

With a name, the details of this candidate are printed. If a dive cannot be had, the pages of the others are written to
build/benchmark/pages. The folder that DATA names has logs and tables that need not be fetched.
"""

import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmark_cells import Cell, build, prepare
from benchmark_details import cell_details, checks, details, dives_table
from benchmark_dives import Place
from benchmark_finding import quote, why
from benchmark_page import (
    DETAILS,
    assay,
    by_data_set,
    changes,
    filters_table,
    matrix,
    plans,
    stamp,
    with_evidence,
    word_of,
)
from written import PROJECT, renewed

from insdvl_replay.core.errors import UserError, counted
from insdvl_replay.core.quantities import label
from insdvl_replay.document.looks import style_sheet
from insdvl_replay.evaluation.sentences import ratio_text
from insdvl_replay.show.first_screen import ForestRow, forest, interval_ends

DOCS = PROJECT / "docs"
PAGE = DOCS / "benchmark.md"
# The pages that quote what is found of the paper's method, and the one that quotes the assay.
QUOTING = (PROJECT / "README.md", DOCS / "reproduction.md")
QUOTING_ASSAY = DOCS / "verdict.md"
COMMAND = "make benchmark"
# Pixels: of the picture, and above each plot.
WIDTH = 860
ABOVE = 30
Sets = Mapping[str, Sequence[Cell]]


def page_text(page: str, sets: Sets, made: str) -> str:
    """Return docs/benchmark.md as it should be, with its date and commit."""
    parts = {
        "finding": lambda: f"{quote(sets)}\n\n{why(sets)}",
        "stamp": lambda: made,
        "matrix": lambda: matrix(sets),
        "assay": lambda: f"{assay(sets)}\n\n{plans(sets)}",
        "filters": filters_table,
        "changes": lambda: changes(sets),
    }
    return renewed(page, parts, COMMAND)


def details_text(page: str, sets: Sets, place: Place) -> str:
    """Return docs/benchmark_details.md as it should be."""
    parts = {
        "details": lambda: details(sets),
        "checks": lambda: checks(sets),
        "dives": lambda: dives_table(place.dives),
    }
    return renewed(page, parts, COMMAND)


def picture(sets: Sets) -> bytes:
    """Draw a forest plot for each data set with evidence."""
    drawn = list[str]()
    top = 0
    for name, cells in with_evidence(sets).items():
        plot = re.search(r'<svg( width="100%" height="(\d+)">.*</svg>)', forest("", _rows(cells)))
        assert plot is not None
        drawn.append(f'<text x="8" y="{top + 18}">{name}</text><svg y="{top + ABOVE}"{plot[1]}')
        top += ABOVE + int(plot[2])
    size = f'width="{WIDTH}" height="{top}" viewBox="0 0 {WIDTH} {top}"'
    title = "<title>Ratio of errors, with its interval over dives</title>"
    style = f"{title}\n<style>\n{style_sheet()}</style>"
    paper = '<rect width="100%" height="100%" fill="var(--paper)"/>'
    body = "\n".join([style, paper, '<g class="forest">', *drawn, "</g>"])
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">\n{body}\n</svg>\n'.encode()


def _rows(cells: Sequence[Cell]) -> list[ForestRow]:
    """Return the rows of a plot."""
    rows = []
    for cell in cells:
        row = cell.decisive
        if row is not None and cell.answer is not None:
            text = f"{ratio_text(row.ratio)} {word_of(cell)}, {label(row.quantity)}"
            tone = str(cell.answer.verdict)
            rows.append(
                ForestRow(cell.candidate, row.ratio, interval_ends(row), tone=tone, text=text)
            )
    return rows


def write_pages(sets: Sets, place: Place, folder: Path) -> None:
    """Write both pages and the picture; date and commit stay if nothing else is new."""
    page = folder / PAGE.name
    before = page.read_text("utf-8")
    drawing = picture(sets)
    old_stamp = re.search(r"<!-- stamp: .* -->\n(.*)\n<!-- end of stamp -->", before)
    text = before
    if old_stamp is not None:
        text = page_text(before, sets, old_stamp[1])
    if text != before or old_stamp is None or not old_stamp[1]:
        text = page_text(before, sets, stamp())
    page.write_text(text, "utf-8")
    page.with_suffix(".svg").write_bytes(drawing)
    other = folder / DETAILS
    other.write_text(details_text(other.read_text("utf-8"), sets, place), "utf-8")


def write_quotes(sets: Sets) -> None:
    """Write what other pages quote."""
    for file in QUOTING:
        quoted(file, "benchmark", quote(sets))
    quoted(QUOTING_ASSAY, "assay", assay(sets))


def quoted(file: Path, name: str, text: str) -> None:
    """Write a part of a page."""
    page = renewed(file.read_text("utf-8"), {name: lambda: text}, COMMAND)
    file.write_text(page, "utf-8")


def print_details(cells: Sequence[Cell]) -> None:
    """Print the details of some cells, those that could not be replayed with the reason."""
    for cell in cells:
        lines = [*cell_details(cell)]
        if not lines:
            lines = [f"### {cell.data_set} {cell.candidate}", *cell.reasons]
        sys.stdout.write("\n\n".join(lines) + "\n\n")


def main(candidates: str = "*") -> None:
    """Write the pages and the quotes; of one candidate, print the details."""
    place = Place(candidates=candidates)
    prepare(place)
    try:
        cells = build(place)
    except UserError as error:
        sys.exit(f"error: {error}")
    for name, reason in place.missing.items():
        sys.stdout.write(f"missing: {name}: {reason}\n")
    if candidates != "*":
        print_details(cells)
        return
    sets = by_data_set(cells)
    if not place.missing:
        write_pages(sets, place, PAGE.parent)
        write_quotes(sets)
        return
    folder = place.build / "pages"
    folder.mkdir(parents=True, exist_ok=True)
    for name in (PAGE.name, DETAILS):
        shutil.copy(PAGE.with_name(name), folder / name)
    write_pages(sets, place, folder)
    there = counted(len(place.dives) - len(place.missing), "dive")
    shown = folder.relative_to(PROJECT) if folder.is_relative_to(PROJECT) else folder
    sys.stdout.write(f"The pages of {there} are in {shown}; those in docs/ stay.\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
