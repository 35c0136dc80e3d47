"""A page as a test looks at it."""

from collections.abc import Sequence
from html.parser import HTMLParser

VOID = {"meta", "br", "path", "rect"}


class Document(HTMLParser):
    """A page taken apart: its texts by tag, its elements, and whether they are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: dict[str, list[str]] = {}
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)
            self.texts.setdefault(tag, []).append("")

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        for tag in set(self.open):
            self.texts[tag][-1] += data

    def count(self, tag: str, style: str = "") -> int:
        classes = (
            attributes.get("class", "").split(" ")
            for name, attributes in self.elements
            if name == tag
        )
        return sum(style in names or not style for names in classes)


def forest_rows(document: Document) -> list[tuple[str, list[str]]]:
    """The rows of all forest plots: their texts, and their classes."""
    classes = [
        attributes.get("class", "").split() for tag, attributes in document.elements if tag == "g"
    ]
    rows = [row for row in zip(document.texts["g"], classes, strict=True) if "row" in row[1]]
    titles = document.texts["title"][1:]
    return [
        (text.removeprefix(title), names)
        for (text, names), title in zip(rows, titles, strict=True)
    ]
