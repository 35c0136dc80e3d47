"""A document as a page: one file, no network, readable without scripts, on paper, in the light and in the dark."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from html import escape as html_escape
from importlib.resources import files
from itertools import zip_longest
from typing import Final

from insdvl_replay.core.errors import visible_lines
from insdvl_replay.document.looks import style_sheet
from insdvl_replay.document.parts import (
    POINT,
    REJECTED,
    Callout,
    CellText,
    Code,
    DisplayTable,
    Document,
    Figure,
    Heading,
    Html,
    Panel,
    Part,
    Remark,
    Sentences,
    Title,
)
from insdvl_replay.document.plot import Legend, panel_svg
from insdvl_replay.document.tables import cell_lines, parts_for

_NOT_IN_ANCHOR: Final = re.compile(r"[\W_]")  # of a heading, where it becomes a link target
_COMMAND: Final = re.compile(r"`([^`]+)`")
_DAY: Final = re.compile(r"\d{4}-\d\d-\d\d")  # would be broken at its hyphens
_SHORT: Final = 20  # Longer cells are folded; the others are on one line.
SIGNATURE: Final = '<meta name="generator" content="insdvl-replay">'


# On a page with plots, above the first figure if it is not said before.
HOW_TO_READ: Final = (
    "Point at a plot to read its values, click to enlarge it, drag to zoom, and double click to "
    "see everything again."
)


def page(document: Document, *scripts: str) -> bytes:
    """Render a document with a title as a page; the same document gives the same bytes.

    Before the first heading are links to all of them. Tables that follow each other are side by side where there is
    room. ``scripts`` are files of this folder; plots bring ``cursor.js``. The page works without them.
    """
    parts = list(parts_for("html", document))
    [title] = [part for part in parts if isinstance(part, Title)]
    parts.remove(title)
    _explain_figures(parts)
    head = escape(title.text)
    body = [f"<h1>{head}</h1>", *_body(parts)]
    names = list(scripts)
    if any('panel" viewBox' in part for part in body):
        names.append("cursor.js")
    codes = [files("insdvl_replay.document").joinpath(name).read_text("utf-8") for name in names]
    style = f"\n{style_sheet()}"
    lines = [
        "<!doctype html>",
        '<html lang="en">',
        '<meta charset="utf-8">',
        SIGNATURE,
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, codes)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{head}</title>",
        f"<style>{style}</style>",
        "<body><main>",
        *body,
        "</main>",
        *(f"<script>{code}</script>" for code in codes),
        "</body></html>",
        "",
    ]
    return "\n".join(lines).encode()


def _explain_figures(parts: list[Part]) -> None:
    """Say before the first figure how to read it, if nothing else does."""
    for part in parts:
        if isinstance(part, Html) and part.explains_figures:
            return
    for place, part in enumerate(parts):
        if isinstance(part, Figure):
            parts.insert(place, Html(f'<p class="on-screen">{HOW_TO_READ}</p>'))
            return


def _body(parts: Sequence[Part]) -> list[str]:
    """Render parts, with links to all headings before the first."""
    headings = [part for part in parts if isinstance(part, Heading)]
    if not headings:
        return _in_grids(parts)
    links = [f'<a href="#{_anchor(part.text)}">{escape(part.text)}</a>' for part in headings]
    first = parts.index(headings[0])
    nav = f"<nav>{''.join(links)}</nav>"
    return [*_in_grids(parts[:first]), nav, *_in_grids(parts[first:])]


def _policy(style: str, codes: Sequence[str]) -> str:
    """Allow nothing from the network, and only the page's own style and scripts."""
    allowed = " ".join(map(_digest, codes)) or "'none'"
    return f"default-src 'none'; style-src {_digest(style)}; script-src {allowed}"


def _digest(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


def fragment(document: Document) -> str:
    """Render a document as a part of another page, such as a notebook, without a style of its own."""
    texts = []
    for part in parts_for("html", document):
        if isinstance(part, Title):
            texts.append(f"<h3>{escape(part.text)}</h3>")
        else:
            texts.append(_html(part))
    return f"<div>{''.join(texts)}</div>"


def escape(text: str) -> str:
    """Write text as HTML."""
    return html_escape(visible_lines(text))


# --- Parts that only pages have.


def facts(named: Mapping[str, str]) -> Html:
    """Return facts by their names."""
    pairs = [f"<dt>{escape(name)}</dt><dd>{escape(fact)}</dd>" for name, fact in named.items()]
    return Html(f"<dl>{''.join(pairs)}</dl>")


def settings_details(settings: str) -> Html:
    """Return the resolved configuration, folded away; it is left out in print."""
    title = "All settings (they repeat this result)"
    return Html(f"<details><summary>{title}</summary><pre>{escape(settings)}</pre></details>")


def pictures(panels: Sequence[Panel]) -> str:
    """Return panels one below the other, as HTML."""
    texts = []
    for number, panel in enumerate(panels, 1):
        text = _zoomed(panel, f"first-{number}")
        if panel.folded:
            name, _, _ = panel.title.partition(":")  # without its axis
            text = folded(name, text)
        texts.append(text)
    return "".join(texts)


def folded(title: str, content: str) -> str:
    """Return a part of a page, as HTML, that is folded under its title; on paper it is unfolded."""
    return f'<details class="fold"><summary>{escape(title)}</summary>{content}</details>'


# --- Parts as HTML.


def _in_grids(parts: Sequence[Part]) -> list[str]:
    """Render the parts one by one; tables that follow each other share a grid, and the last of equal footnotes."""
    lines: list[str] = []
    grid: list[DisplayTable] = []
    for part in parts:
        if isinstance(part, DisplayTable) and part.links is None and not part.folded:
            grid.append(part)
        else:
            lines += _grid(grid)
            grid = []
            lines.append(_html(part))
    return lines + _grid(grid)


def _grid(tables: Sequence[DisplayTable]) -> list[str]:
    """Render tables in a grid, without a footnote that the next of them has as well."""
    if not tables:
        return []
    lines = ['<div class="tables">']
    for table, after in zip_longest(tables, tables[1:]):
        if after is not None and after.footnote == table.footnote:
            table = replace(table, footnote="")
        lines.append(table_html(table))
    return [*lines, "</div>"]


def _html(part: Part) -> str:
    match part:
        case Heading(text):
            return f'<h2 id="{_anchor(text)}">{escape(text)}</h2>'
        case Callout(text, tone):
            return f'<p class="{f"lead {tone}".rstrip()}">{_prose(text)}</p>'
        case str(text) | Remark(text=text):
            return f"<p>{_prose(text)}</p>"
        case Sentences(lines):
            return "\n".join(map(_html, lines))
        case DisplayTable(title, folded=True):
            return folded(title, f'<div class="tables">{table_html(part)}</div>')
        case DisplayTable():
            return table_html(part)
        case Figure():
            return _figure(part)
        case Code(text):
            return f"<pre>{escape(text)}</pre>"
        case Html(text):
            return text
    raise ValueError(f"{type(part).__name__} is no part of a page's body")


def _prose(text: str) -> str:
    """Write a sentence as HTML, with its commands as code."""
    return _COMMAND.sub(r"<code>\1</code>", escape(text))


def table_html(table: DisplayTable) -> str:
    """Return a table as HTML."""
    kinds = [_CELLS[letter] for letter in table.alignment]
    header = []
    for kind, name in zip(kinds, table.header, strict=True):
        header.append(f"<th{kind}>{escape(name)}</th>")
    rows = []
    for row, link in zip(table.rows, table.links or [""] * len(table.rows), strict=True):
        rows.append(f"<tr>{_cells_html(row, kinds, link)}</tr>")
    lines = "\n".join(rows)
    return (
        f'<section class="table">{_title_html(table.title)}<div class="wide" tabindex="0"><table>'
        f"<thead><tr>{''.join(header)}</tr></thead><tbody>{lines}</tbody></table></div>"
        f"{_footnote_html(table.footnote)}</section>"
    )


# The class of a cell by its alignment; most cells are numbers and have none.
_CELLS: Final = {"l": " class=l", "r": ""}


def _cells_html(row: Sequence[CellText], kinds: Sequence[str], link: str) -> str:
    """Return the cells of a row; a cell of many words is folded, and the first has the link."""
    cells: list[str] = []
    for kind, cell in zip(kinds, row, strict=True):
        text = "<br>".join(map(escape, cell_lines(cell))).replace(" %", "&nbsp;%")
        if len(text) > _SHORT:
            kind = " class=words"
        elif kind and _DAY.fullmatch(text):
            kind = ' class="l one"'
        if link and not cells:
            text = f'<a href="{escape(link)}">{text}</a>'
        cells.append(f"<td{kind}>{text}</td>")
    return "".join(cells)


def _title_html(title: str) -> str:
    """Return the title of a table, in bold up to a colon."""
    if not title:
        return ""
    name, colon, rest = title.partition(": ")
    bold = f"<b>{escape(name + colon.rstrip())}</b>"
    if rest:
        return f"<h3>{bold} {escape(rest)}</h3>"
    return f"<h3>{bold}</h3>"


def _footnote_html(footnote: str) -> str:
    if footnote:
        return f'<p class="footnote">{_prose(footnote)}</p>'
    return ""


def _figure(figure: Figure) -> str:
    anchor = _anchor(figure.title)
    panels = []
    for number, panel in enumerate(figure.panels, 1):
        panels.append(_zoomed(panel, f"{anchor}-{number}", figure.legend))
    content = '<p class="footnote">nothing to draw</p>'
    if panels:
        lines = "\n".join(panels)
        content = f'<div class="panels">{lines}</div>'
    return captioned(escape(figure.title), escape(figure.caption), content, _keys(figure.legend))


def captioned(title: str, caption: str, content: str, legend: str = "") -> str:
    """Return a figure with its title and caption; all are HTML."""
    head = f"<figcaption><strong>{title}</strong><span>{caption}</span>{legend}</figcaption>"
    return f"<figure>{head}{content}</figure>"


def _keys(legend: Legend) -> str:
    entries = [f"<li>{_key(style)}{escape(label)}</li>" for style, label in legend]
    return f'<ul class="legend">{"".join(entries)}</ul>'


def _key(style: str) -> str:
    """Draw the legend key of a style."""
    path = f'<path class="line {style}" d="M1 5H39"/>'
    if style == REJECTED or POINT in style.split():
        path = f'<path class="points {style}" d="M20 5h0"/>'
    return f'<svg viewBox="0 0 40 10">{path}</svg>'


def _zoomed(panel: Panel, anchor: str, legend: Legend = ()) -> str:
    """Render a panel that a click enlarges to the window; a second click closes it. No script is needed.

    The legend of a track is below it: at the ends of its lines there is no room.
    """
    kind = "zoom tall" if panel.is_tall else "zoom"
    keys = ""
    named = []
    for curve in panel.curves:
        if curve.label:
            style = f"{curve.style} {POINT}" if curve.points else curve.style
            named.append((style, curve.label))
    if panel.equal and named:
        keys = _keys(named)
    return (
        f'<div class="{kind}" id="{anchor}">'
        f'<a class="open" href="#{anchor}" title="larger">{panel_svg(panel, legend)}</a>{keys}'
        f'<a class="close" href="#{anchor}-back">back</a><i id="{anchor}-back"></i></div>'
    )


def _anchor(text: str) -> str:
    return _NOT_IN_ANCHOR.sub("-", text.lower())
