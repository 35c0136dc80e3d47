"""Parts that pages of dives and of studies share: what was lost, where a result comes from, and pictures."""

import re
from collections.abc import Iterable, Mapping
from typing import Final

from insdvl_replay.core.errors import Note
from insdvl_replay.report.display_table import ShownTable
from insdvl_replay.report.page import Html, Part, escape

_THEME: Final = {
    "#ffffff": "var(--paper)", "#000000": "var(--ink)", "#808080": "var(--soft)",
    "#b0b0b0": "var(--soft)", "#cccccc": "var(--rule)",
    "#1f77b4": "var(--blue)", "#d62728": "var(--red)", "#2ca02c": "var(--green)",
    "#ff7f0e": "var(--ochre)", "#9467bd": "var(--purple)",
}  # fmt: skip
"""The drawing program's colours, and which of the page's they become."""


def losses(notes: Iterable[Note]) -> Part:
    """Say with counts what was dropped, assumed or found odd.

    Parameters
    ----------
    notes : iterable of Note

    Returns
    -------
    ShownTable or str
        A sentence where there is nothing to say.
    """
    rows = tuple((str(note.count), note.severity, f"{note.text} [{note.code}]", note.hint) for note in notes)
    if not rows:
        return "Nothing."
    return ShownTable("Notes on reading, preparing and filtering", ("count", "", "what", "what helps"), "rlll", rows)


def facts(named: Mapping[str, str]) -> Html:
    """List facts by name."""
    pairs = "".join(f"<dt>{escape(name)}</dt><dd>{escape(fact)}</dd>" for name, fact in named.items())
    return Html(f"<dl>{pairs}</dl>")


def settings_details(settings: str) -> Html:
    """Fold the resolved configuration away; on paper it is unfolded."""
    title = "Settings, which repeat this result"
    return Html(f"<details><summary>{title}</summary><pre>{escape(settings)}</pre></details>")


def picture(name: str, svg: bytes) -> Html:
    """Put a picture into the page, in the page's colours, no wider than it was drawn and never too small to be read.

    Parameters
    ----------
    name : str
        Of the picture among those of the page.
    svg : bytes
        From `pictures.picture_bytes`.

    Returns
    -------
    Html
    """
    text = svg.decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    as_drawn = rf'\1 style="max-width: \2; min-width: calc(.7 * \2)" role="img" aria-label="{escape(name)}"'
    text = re.sub(r'(<svg [^>]*?) width="([^"]*)" height="[^"]*"', as_drawn, text)
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{re.sub('[^a-z]', '-', name)}-", text)
    for colour, variable in _THEME.items():
        text = text.replace(colour, variable)
    return Html(f'<figure class="picture">{text}</figure>')
