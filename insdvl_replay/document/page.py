"""A document as a page: one file, no network, readable without scripts, on paper, in the light and in the dark."""

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
    REJECTED,
    Callout,
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

_SHORT: Final = 20  # Longer cells are folded; the others are on one line.
SIGNATURE: Final = '<meta name="generator" content="insdvl-replay">'


# On a page with plots, above the first figure if it is not said before.
HOW_TO_READ: Final = (
    "Point at a plot to read its values, drag to zoom, double click to see "
    "everything again, click to enlarge."
)


def page(document: Document, *scripts: str) -> bytes:
    """Render a document with a title as a page; the same document gives the same bytes.

    Before the first heading are links to all of them. Tables that follow each other are side by side where there is
    room. ``scripts`` are files of this folder; plots bring ``cursor.js``. The page works without them.
    """
    shown = list(parts_for("html", document))
    [title] = [escape(part.text) for part in shown if isinstance(part, Title)]
    parts = [part for part in shown if not isinstance(part, Title)]
    figures = [place for place, part in enumerate(parts) if isinstance(part, Figure)]
    if figures and not any(isinstance(part, Html) and part.explains_figures for part in parts):
        parts.insert(figures[0], HOW_TO_READ)
    headings = [part.text for part in parts if isinstance(part, Heading)]
    first = next(
        (place for place, part in enumerate(parts) if isinstance(part, Heading)), len(parts)
    )
    links = "".join(f'<a href="#{_anchor(text)}">{escape(text)}</a>' for text in headings)
    nav = [f"<nav>{links}</nav>"] if links else []
    body = [f"<h1>{title}</h1>", *_in_grids(parts[:first]), *nav, *_in_grids(parts[first:])]
    plots = ["cursor.js"] if any('panel" viewBox' in part for part in body) else []
    codes = [
        files("insdvl_replay.document").joinpath(name).read_text("utf-8")
        for name in (*scripts, *plots)
    ]
    style = f"\n{style_sheet()}"
    # Nothing from the network, and only the page's own style and scripts.
    allowed = " ".join(map(_digest, codes)) or "'none'"
    policy = f"default-src 'none'; style-src {_digest(style)}; script-src {allowed}"
    lines = [
        "<!doctype html>",
        '<html lang="en">',
        '<meta charset="utf-8">',
        SIGNATURE,
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title>",
        f"<style>{style}</style>",
        "<body><main>",
        *body,
        "</main>",
        *(f"<script>{code}</script>" for code in codes),
        "</body></html>",
        "",
    ]
    return "\n".join(lines).encode()


def _digest(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


def fragment(document: Document) -> str:
    """Render a document as a part of another page, such as a notebook, without a style of its own."""
    shown = parts_for("html", document)
    parts = [
        f"<h3>{escape(part.text)}</h3>" if isinstance(part, Title) else _html(part)
        for part in shown
    ]
    return f"<div>{''.join(parts)}</div>"


def escape(text: str) -> str:
    """Write text as HTML."""
    return html_escape(visible_lines(text))


# --- Parts that only pages have.


def facts(named: Mapping[str, str]) -> Html:
    """Return facts by their names."""
    pairs = "".join(
        f"<dt>{escape(name)}</dt><dd>{escape(fact)}</dd>" for name, fact in named.items()
    )
    return Html(f"<dl>{pairs}</dl>")


def settings_details(settings: str) -> Html:
    """Return the resolved configuration, folded away; on paper it is unfolded."""
    title = "All settings (they repeat this result)"
    return Html(f"<details><summary>{title}</summary><pre>{escape(settings)}</pre></details>")


def pictures(panels: Sequence[Panel]) -> str:
    """Return panels one below the other, as HTML."""
    return "".join(_zoomed(panel, f"first-{number}") for number, panel in enumerate(panels, 1))


# --- Parts as HTML.


def _in_grids(parts: Sequence[Part]) -> list[str]:
    """Render the parts one by one; tables that follow each other share a grid, and the last of equal footnotes."""
    lines: list[str] = []
    in_grid = False
    for part, after in zip_longest(parts, parts[1:]):
        if (isinstance(part, DisplayTable) and part.links is None and not part.folded) != in_grid:
            in_grid = not in_grid
            lines.append('<div class="tables">' if in_grid else "</div>")
        if in_grid and isinstance(part, DisplayTable) and isinstance(after, DisplayTable):
            part = replace(part, footnote=part.footnote if part.footnote != after.footnote else "")
        lines.append(_html(part))
    if in_grid:
        return [*lines, "</div>"]
    return lines


def _html(part: Part) -> str:
    match part:
        case Heading(text):
            return f'<h2 id="{_anchor(text)}">{escape(text)}</h2>'
        case Callout(text, tone):
            return f'<p class="{f"lead {tone}".rstrip()}">{escape(text)}</p>'
        case str(text) | Remark(text=text):
            return f"<p>{escape(text)}</p>"
        case Sentences(lines):
            return "\n".join(map(_html, lines))
        case DisplayTable(title, folded=True):
            content = f'<div class="tables">{table_html(part)}</div>'
            return f'<details class="fold"><summary>{escape(title)}</summary>{content}</details>'
        case DisplayTable():
            return table_html(part)
        case Figure():
            return _figure(part)
        case Code(text):
            return f"<pre>{escape(text)}</pre>"
        case Html(text):
            return text
    raise ValueError(f"{type(part).__name__} is no part of a page's body")


def table_html(table: DisplayTable) -> str:
    """Return a table as HTML."""
    kinds = [
        "" if letter == "r" else " class=l" for letter in table.alignment
    ]  # most cells are numbers
    header = "".join(
        f"<th{kind}>{escape(name)}</th>" for kind, name in zip(kinds, table.header, strict=True)
    )
    rows = []
    for row, link in zip(table.rows, table.links or [""] * len(table.rows), strict=True):
        cells = ["<br>".join(map(escape, cell_lines(cell))) for cell in row]
        # A cell of many words is folded.
        classes = [
            " class=words" if len(cell) > _SHORT else kind
            for kind, cell in zip(kinds, cells, strict=True)
        ]
        if link:
            cells[0] = f'<a href="{escape(link)}">{cells[0]}</a>'
        rows.append(
            "".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(classes, cells, strict=True))
        )
    lines = "\n".join(f"<tr>{row}</tr>" for row in rows)
    name, colon, rest = table.title.partition(": ")
    title = (
        f"<h3><b>{escape(name + colon.rstrip())}</b>{' ' if rest else ''}{escape(rest)}</h3>"
        if name
        else ""
    )
    footnote = f'<p class="footnote">{escape(table.footnote)}</p>' if table.footnote else ""
    return (
        f'<section class="table">{title}<div class="wide" tabindex="0"><table>'
        f"<thead><tr>{header}</tr></thead><tbody>{lines}</tbody></table></div>{footnote}</section>"
    )


def _figure(figure: Figure) -> str:
    anchor = _anchor(figure.title)
    panels = "\n".join(
        _zoomed(panel, f"{anchor}-{number}", figure.legend)
        for number, panel in enumerate(figure.panels, 1)
    )
    content = (
        f'<div class="panels">{panels}</div>'
        if panels
        else '<p class="footnote">nothing to draw</p>'
    )
    return captioned(escape(figure.title), escape(figure.caption), content, _keys(figure.legend))


def captioned(title: str, caption: str, content: str, legend: str = "") -> str:
    """Return a figure with its title and caption; all are HTML."""
    head = f"<figcaption><strong>{title}</strong><span>{caption}</span>{legend}</figcaption>"
    return f"<figure>{head}{content}</figure>"


def _keys(legend: Legend) -> str:
    return f'<ul class="legend">{"".join(f"<li>{_key(style)}{escape(label)}</li>" for style, label in legend)}</ul>'


def _key(style: str) -> str:
    """Draw the legend key of a style."""
    kind, path = ("points", "M20 5h0") if style == REJECTED else ("line", "M1 5H39")
    return f'<svg viewBox="0 0 40 10"><path class="{kind} {style}" d="{path}"/></svg>'


def _zoomed(panel: Panel, anchor: str, legend: Legend = ()) -> str:
    """Render a panel that a click enlarges to the window; a second click closes it. No script is needed.

    The legend of a track is below it: at the ends of its lines there is no room.
    """
    own = (
        [(curve.style, curve.label) for curve in panel.curves if curve.label] if panel.equal else []
    )
    return (
        f'<div class="zoom{" tall" if panel.equal and not panel.low else ""}" id="{anchor}">'
        f'<a class="open" href="#{anchor}" title="larger">{panel_svg(panel, legend)}</a>{_keys(own) if own else ""}'
        f'<a class="close" href="#{anchor}-back">back</a><i id="{anchor}-back"></i></div>'
    )


def _anchor(text: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in text.lower())
