"""The frame of every page: one file, no network, readable without scripts, on paper, in the light and in the dark."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from html import escape as html_escape
from importlib.resources import files
from typing import Final

from insdvl_replay.core.plain_text import visible_lines
from insdvl_replay.report.display_table import ShownTable, cell_lines
from insdvl_replay.report.plots.panel import Figure
from insdvl_replay.report.plots.svg import panel_svg

_POINTS: Final = ("rejected",)
_SHORT: Final = 20
"""Cells with more characters are folded; the others stand on one line."""

_SIGNATURE: Final = '<meta name="generator" content="insdvl-replay">'


@dataclass(frozen=True)
class Lead:
    """The sentence that a reader takes away.

    Attributes
    ----------
    text : str
    tone : str
        ``good`` or ``bad``, which colours the edge beside it; empty for neither.
    """

    text: str
    tone: str = ""


@dataclass(frozen=True)
class Heading:
    """Begins a part of the page, to which the page's head leads."""

    text: str


@dataclass(frozen=True)
class Html:
    """A fragment that is HTML already."""

    text: str


@dataclass(frozen=True)
class LinkedTable:
    """A table whose rows lead somewhere: the first cell of each to its address, unless that is empty."""

    table: ShownTable
    links: tuple[str, ...]


Part = str | Lead | Heading | ShownTable | LinkedTable | Figure | Html
"""What a page is made of; plain text becomes a paragraph."""


def page(title: str, parts: Sequence[Part], script: str = "") -> bytes:
    """Dress a page.

    Parameters
    ----------
    title : str
    parts : sequence of Part
        In the order in which they are read; before the first heading stand links to all of them. Tables that follow
        each other lie side by side where there is room.
    script : str
        What makes the page more comfortable, and what it can do without.

    Returns
    -------
    bytes
        An HTML document; the same parts give the same bytes.
    """
    style = files("insdvl_replay.report").joinpath("page.css").read_text("utf-8")
    headings = [part.text for part in parts if isinstance(part, Heading)]
    links = "".join(f'<a href="#{_anchor(text)}">{escape(text)}</a>' for text in headings)
    first = next((place for place, part in enumerate(parts) if isinstance(part, Heading)), len(parts))
    nav = [f"<nav>{links}</nav>"] if links else []
    body = [f"<h1>{escape(title)}</h1>", *_dressed(parts[:first]), *nav, *_dressed(parts[first:])]
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


def is_page(data: bytes) -> bool:
    """Say whether a file is a page of ours."""
    return _SIGNATURE.encode() in data[:1000]


def table_html(table: ShownTable, links: Sequence[str] = ()) -> str:
    """Dress a table.

    Parameters
    ----------
    table : ShownTable
    links : sequence of str
        Where the first cell of each row leads; left out, or empty: nowhere.

    Returns
    -------
    str
    """
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
        f'<section class="table">{title_html(table.title)}<div class="wide" tabindex="0"><table>'
        f"<thead><tr>{header}</tr></thead><tbody>{lines}</tbody></table></div>{footnote}</section>"
    )


def title_html(title: str) -> str:
    """Dress the title of a table: what stands before its colon, or all of it, is its name."""
    name, colon, rest = title.partition(": ")
    return f"<h3><b>{escape(name + colon.rstrip())}</b>{' ' if rest else ''}{escape(rest)}</h3>"


def _kind(cell: str, kind: str) -> str:
    """Let a cell of many words fold."""
    return ' class="words"' if len(cell) > _SHORT else kind


def figure_html(figure: Figure) -> str:
    """Dress a figure: what it shows, how it is read, and its panels."""
    legend = "".join(f"<li>{_key(style)}{escape(label)}</li>" for style, label in figure.legend)
    panels = "\n".join(panel_svg(panel) for panel in figure.panels)
    content = f'<div class="panels">{panels}</div>' if panels else '<p class="footnote">nothing to draw</p>'
    return (
        f"<figure><figcaption><strong>{escape(figure.title)}</strong><span>{escape(figure.caption)}</span>"
        f'<ul class="legend">{legend}</ul></figcaption>{content}</figure>'
    )


def _dressed(parts: Sequence[Part]) -> list[str]:
    """Dress the parts one by one, and let tables that follow each other share a grid."""
    lines: list[str] = []
    in_tables = False
    for part in parts:
        if isinstance(part, ShownTable) != in_tables:
            in_tables = not in_tables
            lines.append('<div class="tables">' if in_tables else "</div>")
        lines.append(_part_html(part))
    return [*lines, "</div>"] if in_tables else lines


def _part_html(part: Part) -> str:
    match part:
        case Html(text):
            return text
        case Heading(text):
            return f'<h2 id="{_anchor(text)}">{escape(text)}</h2>'
        case Lead(text, tone):
            return f'<p class="{f"lead {tone}".rstrip()}">{escape(text)}</p>'
        case ShownTable():
            return table_html(part)
        case LinkedTable(table, links):
            return table_html(table, links)
        case Figure():
            return figure_html(part)
        case text:
            return f"<p>{escape(text)}</p>"


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
