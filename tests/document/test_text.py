"""Tables on a terminal: what is folded, and what is not."""

import io

from rich.console import Console

from insdvl_replay.document.page import page
from insdvl_replay.document.parts import Callout, DisplayTable, Title
from insdvl_replay.document.text import for_terminal


def lines_of(table: DisplayTable, width: int) -> list[str]:
    console = Console(width=width, record=True, file=io.StringIO(), color_system=None)
    console.print(for_terminal([table]), crop=False)
    return [line.rstrip() for line in console.export_text().split("\n")]


def test_single_words_keep_their_line_where_names_can_be_folded() -> None:
    row = ("velocity along the track", "1.00", "(equivalent)", "1.00", "(equivalent)")
    table = DisplayTable("", ("what", "a", "", "b", ""), "lrlrl", (row,))
    lines = lines_of(table, 52)
    assert max(map(len, lines)) <= 52
    assert " ".join(lines).count("(equivalent)") == 2
    assert sum(line.startswith(("velocity", "along", "the track")) for line in lines) >= 2


def test_words_are_folded_where_the_terminal_is_too_narrow_for_them() -> None:
    table = DisplayTable("", ("what", "b"), "ll", (("velocity along", "x" * 30),))
    lines = lines_of(table, 20)
    assert max(map(len, lines)) <= 20
    assert "".join(lines).count("x") == 30


def test_commands_are_code_and_days_are_not_broken_on_a_page() -> None:
    table = DisplayTable("", ("since", "what"), "ll", (("2026-01-15", "a-b"),))
    made = page([Title("made"), Callout("Use `run -c a.toml` & see"), table]).decode()
    assert "Use <code>run -c a.toml</code> &amp; see" in made
    assert '<td class="l one">2026-01-15</td><td class=l>a-b</td>' in made
