"""What a log holds, as JSON, Markdown, LaTeX and on a terminal."""

from collections.abc import Iterable, Iterator, Sequence

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from insdvl_replay.core.plain_text import visible
from insdvl_replay.inspection.display_tables import inventory_tables
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.inspection.sentences import PROPOSAL, Finding, findings, open_points, opening_lines
from insdvl_replay.report.markup import latex_page, markdown_code, markdown_page, markdown_text
from insdvl_replay.report.terminal import dressed, spoken
from insdvl_replay.results.json_report import as_json


def encode_inventory(inventory: Inventory | Sequence[Inventory]) -> bytes:
    """Write an inventory, or several as a list, as JSON, every number with its unit in the key.

    Parameters
    ----------
    inventory : Inventory or sequence of Inventory

    Returns
    -------
    bytes
    """
    return as_json(inventory)


def markdown_inventory(inventory: Inventory) -> str:
    """Dress an inventory in Markdown, the proposed settings as a block of code."""
    page = markdown_page(
        inventory.log.name, opening_lines(inventory), inventory_tables(inventory), _lines(findings(inventory))
    )
    if not inventory.configuration:
        return page
    proposal = [PROPOSAL, markdown_code(inventory.configuration, "toml")]
    return "\n\n".join([page.rstrip("\n"), *proposal, *map(markdown_text, _lines(open_points(inventory)))]) + "\n"


def latex_inventory(inventory: Inventory) -> str:
    """Dress the tables of an inventory in LaTeX, which needs booktabs; the sentences become comments."""
    opening = [*opening_lines(inventory), *_lines(findings(inventory))]
    return latex_page(inventory.log.name, opening, inventory_tables(inventory))


def terminal_inventory(inventory: Inventory) -> Group:
    """Dress an inventory for a terminal.

    Parameters
    ----------
    inventory : Inventory

    Returns
    -------
    rich.console.Group
        To be printed by a rich console, which decides about width and colour; only settings that can be copied into a
        file are lines of their own, however long.
    """
    parts: list[RenderableType] = [spoken(line) for line in opening_lines(inventory)]
    for table in inventory_tables(inventory):
        parts += [Text(), dressed(table)]
    return Group(*parts, Text(), *_hinted(findings(inventory)), *_proposal(inventory))


def _proposal(inventory: Inventory) -> Iterator[RenderableType]:
    """Print the proposed settings, and what they leave open."""
    if not inventory.configuration:
        return
    yield Text(f"\n{PROPOSAL}\n")
    for line in inventory.configuration.splitlines():
        yield Text(visible(line), no_wrap=True, overflow="ignore")
    yield Text()
    yield from _hinted(open_points(inventory))


def _hinted(found: Iterable[Finding]) -> Iterator[RenderableType]:
    for finding in found:
        yield spoken(finding.sentence)
        if finding.hint:
            yield Padding(spoken(f"hint: {finding.hint}"), (0, 0, 0, 2))


def _lines(found: Iterable[Finding]) -> list[str]:
    return [f"{finding.sentence}; hint: {finding.hint}" if finding.hint else finding.sentence for finding in found]
