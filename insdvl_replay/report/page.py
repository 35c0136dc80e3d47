"""The frame of every page: one file, no network, readable without scripts, on paper, in the light and in the dark."""

from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from html import escape as html_escape
from importlib.resources import files
from typing import Final

from insdvl_replay.core.errors import visible_lines
from insdvl_replay.report.document import (
    Callout,
    Code,
    Details,
    DisplayTable,
    Document,
    Facts,
    Folded,
    Heading,
    Html,
    LinkedTable,
    Part,
    Pictures,
    Remark,
    Sentences,
    Title,
    cell_lines,
    parts_for,
)
from insdvl_replay.report.plots.panel import Figure, Panel
from insdvl_replay.report.plots.svg import panel_svg

_POINTS: Final = ("rejected",)
_SHORT: Final = 20
"""Cells with more characters are folded; the others stand on one line."""

_SIGNATURE: Final = '<meta name="generator" content="insdvl-replay">'


def page(document: Document, script: str = "") -> bytes:
    """Render a document as a page; the same document gives the same bytes.

    Parameters
    ----------
    document : sequence of Part
        With a title. Before the first heading stand links to all of them; tables that follow each other lie side by
        side where there is room.
    script : str
        What makes the page more comfortable, and what it can do without.
    """
    shown = list(parts_for("html", document))
    [title] = [part.text for part in shown if isinstance(part, Title)]
    parts = [part for part in shown if not isinstance(part, Title)]
    style = files("insdvl_replay.report").joinpath("page.css").read_text("utf-8")
    headings = [part.text for part in parts if isinstance(part, Heading)]
    links = "".join(f'<a href="#{_anchor(text)}">{escape(text)}</a>' for text in headings)
    first = next((place for place, part in enumerate(parts) if isinstance(part, Heading)), len(parts))
    nav = [f"<nav>{links}</nav>"] if links else []
    body = [f"<h1>{escape(title)}</h1>", *_laid_out(parts[:first]), *nav, *_laid_out(parts[first:])]
    head = [
        '<meta charset="utf-8">',
        _SIGNATURE,
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(script)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>",
        f"<style>\n{style}</style>",
    ]
    end = [f"<script>{script}</script>"] if script else []
    lines = ["<!doctype html>", '<html lang="en">', *head, "<body><main>", *body, "</main>", *end, "</body></html>", ""]
    return "\n".join(lines).encode()


def fragment(document: Document) -> str:
    """Render a document as a part of somebody else's page, such as a notebook, with no style of its own."""
    parts = [part for part in document if not isinstance(part, Title)]
    titles = "".join(f"<h3>{escape(part.text)}</h3>" for part in document if isinstance(part, Title))
    return f"<div>{titles}{''.join(_html(part) for part in parts)}</div>"


def is_page(data: bytes) -> bool:
    """Return whether a file is a page of ours."""
    return _SIGNATURE.encode() in data[:1000]


def _table(table: DisplayTable, links: Sequence[str] = ()) -> str:
    """Render a table; without links, its rows lead nowhere."""
    kinds = [' class="r"' if letter == "r" else "" for letter in table.alignment]
    header = "".join(f"<th{kind}>{escape(name)}</th>" for kind, name in zip(kinds, table.header, strict=True))
    rows = []
    for row, link in zip(table.rows, links or [""] * len(table.rows), strict=True):
        cells = ["<br>".join(map(escape, cell_lines(cell))) for cell in row]
        if link:
            cells[0] = f'<a href="{escape(link)}">{cells[0]}</a>'
        rows.append("".join(f"<td{_kind(cell, kind)}>{cell}</td>" for kind, cell in zip(kinds, cells, strict=True)))
    lines = "\n".join(f"<tr>{row}</tr>" for row in rows)
    footnote = f'<p class="footnote">{escape(table.footnote)}</p>' if table.footnote else ""
    return (
        f'<section class="table">{_table_title(table.title)}<div class="wide" tabindex="0"><table>'
        f"<thead><tr>{header}</tr></thead><tbody>{lines}</tbody></table></div>{footnote}</section>"
    )


def _table_title(title: str) -> str:
    if not title:
        return ""
    return _named_title(title)


def _named_title(title: str) -> str:
    """Render the title of a table: what stands before its colon, or all of it, is its name."""
    name, colon, rest = title.partition(": ")
    return f"<h3><b>{escape(name + colon.rstrip())}</b>{' ' if rest else ''}{escape(rest)}</h3>"


def _kind(cell: str, kind: str) -> str:
    """Let a cell of many words fold."""
    return ' class="words"' if len(cell) > _SHORT else kind


def _figure(figure: Figure) -> str:
    """Render a figure: what it shows, how it is read, and its panels."""
    legend = "".join(f"<li>{_key(style)}{escape(label)}</li>" for style, label in figure.legend)
    panels = "\n".join(
        _zoomed(panel, f"{_anchor(figure.title)}-{number}") for number, panel in enumerate(figure.panels, 1)
    )
    content = f'<div class="panels">{panels}</div>' if panels else '<p class="footnote">nothing to draw</p>'
    return (
        f"<figure><figcaption><strong>{escape(figure.title)}</strong><span>{escape(figure.caption)}</span>"
        f'<ul class="legend">{legend}</ul></figcaption>{content}</figure>'
    )


def _zoomed(panel: Panel, anchor: str) -> str:
    """Render a panel that a click shows alone, as large as the window; another leads back. No script is needed."""
    return (
        f'<div class="zoom{" tall" if panel.equal and not panel.low else ""}" id="{anchor}">'
        f'<a class="open" href="#{anchor}" title="larger">{panel_svg(panel)}</a>'
        f'<a class="close" href="#{anchor}-back">back</a><i id="{anchor}-back"></i></div>'
    )


def _pictures(part: Pictures) -> str:
    shown = "\n".join(
        f"<div>{one}</div>" if isinstance(one, str) else _zoomed(one, f"first-{number}")
        for number, one in enumerate(part.shown, 1)
    )
    return f'<div class="first">{shown}</div><p class="footnote">{escape(part.caption)}</p>'


def _folded(part: Folded) -> str:
    tables = "\n".join(map(_table, part.tables))
    return f'<details class="fold"><summary>{escape(part.title)}</summary><div class="tables">{tables}</div></details>'


def _laid_out(parts: Sequence[Part]) -> list[str]:
    """Render the parts one by one, and let tables that follow each other share a grid."""
    lines: list[str] = []
    in_tables = False
    for part in parts:
        if isinstance(part, DisplayTable) != in_tables:
            in_tables = not in_tables
            lines.append('<div class="tables">' if in_tables else "</div>")
        lines.append(_html(part))
    return [*lines, "</div>"] if in_tables else lines


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
    return _block(part)


def _block(part: Part) -> str:
    match part:
        case DisplayTable():
            return _table(part)
        case LinkedTable(table, links):
            return _table(table, links)
        case Figure() | Folded() | Pictures():
            return _drawn(part)
        case Facts(named):
            pairs = "".join(f"<dt>{escape(name)}</dt><dd>{escape(fact)}</dd>" for name, fact in named.items())
            return f"<dl>{pairs}</dl>"
        case Details(title, text):
            return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
        case Code(text):
            return f"<pre>{escape(text)}</pre>"
        case Html(text):
            return text
    raise ValueError(f"{type(part).__name__} is no part of a page's body")


def _drawn(part: Figure | Folded | Pictures) -> str:
    match part:
        case Figure():
            return _figure(part)
        case Folded():
            return _folded(part)
    return _pictures(part)


def escape(text: str) -> str:
    """Write text as HTML."""
    return html_escape(visible_lines(text))


def _key(style: str) -> str:
    """Draw what stands for a style in a legend."""
    if style in _POINTS:
        return f'<svg viewBox="0 0 40 10"><path class="points {style}" d="M20 5h0"/></svg>'
    return f'<svg viewBox="0 0 40 10"><path class="line {style}" d="M1 5H39"/></svg>'


def _anchor(text: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in text.lower())


def _policy(script: str) -> str:
    """Forbid everything from elsewhere, and every script but the page's own."""
    own = f"; script-src 'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" if script else ""
    return f"default-src 'none'; style-src 'unsafe-inline'{own}"
