"""The site: the pages of docs/, the equations, the reproduction and the changes, gathered as mkdocs wants them.

`make docs` builds it strictly. Links between pages stay. Links to other files of the project become their names, since
the site has no other files. Formulas become MathML, which browsers draw without a script or a network.
"""

import re
import shutil
import sys
from html import escape
from pathlib import Path

from written import PROJECT

SOURCES = {
    **{path: path.name for path in sorted((PROJECT / "docs").glob("*.md"))},
    **{
        path: f"equations/{path.name}"
        for path in sorted((PROJECT / "docs" / "equations").glob("*.md"))
    },
    **{
        path: f"reference/{path.name}"
        for path in sorted((PROJECT / "docs" / "reference").glob("*.md"))
    },
    PROJECT / "CHANGELOG.md": "changes.md",
}
"""Place in the site by file."""
CODE = re.compile(r"^```(\w*)\n(.*?)^```$|`[^`\n]+`|\$([^$]+)\$", re.MULTILINE | re.DOTALL)
"""Fenced blocks, code words and formulas: in code a dollar is no formula."""
LINK = re.compile(r"(!?)\[((?:[^\]\\]|\\.)*)\]\(([^)\s]+)\)")


def gather(target: Path) -> None:
    """Write the pages into a folder, which is emptied first."""
    shutil.rmtree(target, ignore_errors=True)
    for path, place in SOURCES.items():
        file = target / place
        file.parent.mkdir(parents=True, exist_ok=True)
        text = LINK.sub(lambda link, here=path: rewritten(link, here), path.read_text("utf-8"))
        file.write_text(CODE.sub(drawn, text), "utf-8")
    for picture in (PROJECT / "docs").glob("*.[sp][vn]g"):
        shutil.copy(picture, target / picture.name)
    shutil.copy(PROJECT / "docs" / "generate" / "site.css", target)


def rewritten(link: re.Match[str], page: Path) -> str:
    """Point a link to the page's place in the site; what is no page of it becomes text."""
    mark, text, address = link.groups()
    if re.match(r"[a-z]+:|#", address):
        return link[0]
    name, hash_, anchor = address.partition("#")
    linked = (page.parent / name).resolve()
    if not linked.exists():
        raise ValueError(f"{page.name}: {address} leads nowhere")
    if linked.suffix in {".svg", ".png"} and linked.parent == PROJECT / "docs":
        return f"{mark}[{text}]({up(page)}{linked.name})"
    if linked not in SOURCES:
        return f"{text} (`{linked.relative_to(PROJECT).as_posix()}`)"
    return f"{mark}[{text}]({up(page)}{SOURCES[linked]}{hash_}{anchor})"


def drawn(found: re.Match[str]) -> str:
    """Make MathML of a formula, and leave code as it is."""
    from latex2mathml.converter import convert  # only the site needs it

    language, block, formula = found.groups()
    if language == "math":
        return f'<p class="formula">{convert(block.strip(), display="block")}</p>'
    if formula:  # in a span, since Markdown takes <math> at the start of a line for a block
        return f"<span>{convert(' '.join(formula.split()))}</span>"
    if r"\|" in found[0] and not found[0].startswith("```"):  # a code word in a table
        return f"<code>{escape(found[0].strip('`')).replace(chr(92) + '|', '&#124;')}</code>"
    return found[0]


def up(page: Path) -> str:
    """Return the way from a page to the top of the site."""
    return "../" * SOURCES[page].count("/")


if __name__ == "__main__":
    gather(Path(sys.argv[1]))
