"""The pages in a browser: nothing complains, nothing is asked for, and nothing is wider than the window."""

import re
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import PROGRAM, Browser, opened_browser

from insdvl_replay.cli import run_command_line

pytestmark = [
    pytest.mark.skipif(PROGRAM is None, reason="needs Chromium (make extras)"),
    pytest.mark.nightly,
    pytest.mark.all_starts,
]
PAPER = 718
"""Width of a page of A4 between margins of 1 cm, in CSS pixels."""
WIDER = """
[...document.querySelectorAll("main *")]
  .filter(e => !e.closest(".wide, svg") && e.getBoundingClientRect().right > innerWidth + 1)
  .map(e => e.tagName + " " + e.className)
"""
UNREADABLE = """
[...document.querySelectorAll("td, th, p, svg text")]
  .filter(e => e.textContent && e.getBoundingClientRect().height < 9)
  .map(e => e.textContent)
"""
CUT = """
[...document.querySelectorAll(".forest > svg")].flatMap(svg => {
  const frame = svg.getBoundingClientRect();
  const inside = r => r.left >= frame.left - 1 && r.right <= frame.right + 1 && r.bottom <= frame.bottom + 1;
  return [...svg.querySelectorAll("text")].filter(e => !inside(e.getBoundingClientRect())).map(e => e.textContent);
})
"""
EMPTY = """
[...document.querySelectorAll("svg.panel, svg.strip, .forest > svg, table")]
  .filter(e => { const r = e.getBoundingClientRect(); return r.width < 200 || r.height < 12; }).length
"""
FAINT = """
(() => {
  const channels = colour => colour.match(/[\\d.]+/g).slice(0, 3).map(Number);
  const light = colour => channels(colour)
    .map(c => c / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
  const paper = light(getComputedStyle(document.body).backgroundColor);
  const contrast = l => (Math.max(l, paper) + 0.05) / (Math.min(l, paper) + 0.05);
  const faint = (selector, property, least) => [...document.querySelectorAll(selector)]
    .filter(e => contrast(light(getComputedStyle(e)[property])) < least)
    .map(e => `${e.tagName} ${e.textContent}`);
  return [
    ...faint("p, td, th, h3, figcaption", "color", 4.5), ...faint("svg text", "fill", 4.5),
    ...faint("path.line, .interval", "stroke", 3),
  ];
})()
"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder of two dives, one of them with four filters and an outage, and three studies."""
    folder = tmp_path_factory.mktemp("pages")
    logs = [str(folder / f"{name}.mcap") for name in ("straight", "lawnmower")]
    assert run_command_line(["simulate", "straight", "-o", logs[0], "--duration", "60"]) == 0
    assert (
        run_command_line(
            ["simulate", "lawnmower", "-o", logs[1], "--duration", "90", "--outage", "30:50"]
        )
        == 0
    )
    several = [
        "--set",
        "filters.fast.aiding=['velocity']",
        "--set",
        "filters.slow.aiding=['velocity']",
    ]
    assert run_command_line(["run", *logs, "-o", str(folder / "dives"), *several]) == 0
    studies = ["-o", str(folder / "study")]
    assert (
        run_command_line(
            ["study", "montecarlo", "straight", "--runs", "2", "--duration", "30", *studies]
        )
        == 0
    )
    assert run_command_line(["study", "window", *logs, *studies]) == 0
    assert run_command_line(["study", "observability", logs[0], *studies]) == 0
    found = {
        path.parent.name if path.stem == "report" else path.stem: path
        for path in folder.rglob("*.html")
    }
    assert len(found) == 6
    return found


# In pixels; what is folded has none.
HEIGHTS_OF_FOLDED_TABLES = (
    "Array.from(document.querySelectorAll('.fold table'), one => one.checkVisibility({ contentVisibilityAuto: true }) "
    "? one.getBoundingClientRect().height : 0)"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with opened_browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.mark.parametrize(
    ("look", "width"),
    [("light", 400), ("light", 1366), ("dark", 400), ("dark", 1366), ("print", PAPER)],
)
@pytest.mark.parametrize(
    "name",
    ["straight", "lawnmower", "index", "montecarlo-straight", "window", "observability-straight"],
)
def test_page_is_whole_and_readable(
    name: str, look: str, width: int, pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages[name], width, dark=look == "dark")
    if look == "print":
        browser.call("Emulation.setEmulatedMedia", media="print")
    assert browser.complaints == []
    assert browser.requests == [pages[name].resolve().as_uri()]
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert browser.value(WIDER) == []
    if look != "print":  # three panels in a row have small letters, and what is folded is left out
        assert browser.value(UNREADABLE) == []
        assert browser.value(EMPTY) == 0
    assert browser.value(CUT) == []
    assert browser.value(FAINT) == []
    browser.call("Emulation.setEmulatedMedia", media="")


def test_dark_and_light_differ(pages: dict[str, Path], browser: Browser) -> None:
    colours = []
    for dark in (False, True):
        browser.open(pages["straight"], 800, dark=dark)
        colours.append(browser.value("getComputedStyle(document.body).backgroundColor"))
    assert colours == ["rgb(255, 255, 255)", "rgb(18, 22, 29)"]


def test_every_plot_of_a_dive_is_drawn(pages: dict[str, Path], browser: Browser) -> None:
    browser.open(pages["lawnmower"], 1280)
    assert (
        browser.value('document.querySelectorAll("svg.panel").length')
        == 3 + 12 + 9 + 3 + 5 + 4 + 3
    )
    assert browser.value('document.querySelectorAll("svg.strip").length') == 7
    lines = "e => Math.max(e.getBoundingClientRect().width, e.getBoundingClientRect().height) > 60"
    drawn = (
        f'[...document.querySelectorAll("svg.panel")].every(p => '
        f'[...p.querySelectorAll("path.line")].some({lines}))'
    )
    assert browser.value(drawn)


def test_a_click_sorts_by_number_and_what_is_missing_is_last(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["index"], 1280)
    column = '[...document.querySelector("tbody").rows].map(row => parseFloat(row.cells[4].textContent))'
    for ascending in (True, False):
        browser.value('document.querySelectorAll("th button")[4].click()')
        shown = browser.value(column)
        assert shown == sorted(shown, reverse=not ascending)
        assert len(set(shown)) > 2
    assert (
        browser.value('document.querySelectorAll("th")[4].getAttribute("aria-sort")')
        == "descending"
    )


def test_without_scripts_the_index_is_a_table(pages: dict[str, Path], browser: Browser) -> None:
    browser.open(pages["index"], 1280, scripts=False)
    assert browser.complaints == []
    assert browser.value('document.querySelectorAll("th button").length') == 0
    assert browser.value('document.querySelector("tbody").rows.length') == 6


ON_FIRST_SCREEN = """
(() => {
  const isOpen = e => e.closest("details:not([open])") === null;
  const bottom = selector => Math.max(...[...document.querySelectorAll(selector)]
    .filter(isOpen).map(e => e.getBoundingClientRect().bottom));
  return {
    sections: document.querySelectorAll(".candidate").length, evidence: bottom(".candidate"),
    pictures: bottom(".aside svg.panel"),
    titles: [...document.querySelectorAll(".aside svg.panel")].map(e => e.getAttribute("aria-label")),
  };
})()
"""


def test_verdicts_evidence_error_and_track_are_on_the_first_screen(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["straight"], 1366)
    shown = browser.value(ON_FIRST_SCREEN)
    assert shown["sections"] == 3
    about = [re.split("[,:[]", title)[0].strip() for title in shown["titles"]]
    # The error vectors are in a section that is closed until somebody asks for them.
    assert about == ["horizontal position error", "track", "error vectors"]
    assert shown["evidence"] < 768
    assert shown["pictures"] < 768


def test_three_candidates_over_two_dives_are_on_the_first_screen(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["index"], 1366)
    shown = browser.value(ON_FIRST_SCREEN)
    assert shown["sections"] == 3
    assert shown["evidence"] < 768


def test_plots_of_many_dives_are_one_below_the_other_on_a_telephone(
    pages: dict[str, Path], browser: Browser
) -> None:
    lefts = '[...document.querySelectorAll(".candidate > *")].map(e => Math.round(e.getBoundingClientRect().left))'
    for width, columns in ((400, 1), (1366, 3)):
        browser.open(pages["index"], width)
        assert len(set(browser.value(lefts))) == columns


WIDEST_CELLS = """
(() => {
  const cells = [
    "velocity settled", "(undecided)", "m/s", "0.0007757", "0.0007891", "0.956", "0.000", "2.09e+08", "39",
    "0.0001", "",
  ];
  const evidence = [...document.querySelectorAll(".tables .wide")].slice(0, 2);
  const rows = evidence.flatMap(table => [...table.querySelectorAll("tbody tr")]);
  rows.forEach(row => [...row.children].forEach((cell, n) => cell.textContent = cells[n]));
  return evidence.map(e => e.scrollWidth - e.clientWidth);
})()
"""


@pytest.mark.parametrize("width", [1100, 1200, 1366])
def test_no_digit_of_the_evidence_is_behind_an_edge(
    width: int, pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["straight"], width)
    assert browser.value(WIDEST_CELLS) == [0, 0]


def test_a_click_shows_a_picture_alone_and_another_leads_back(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["straight"], 1280, scripts=False)
    width = 'document.querySelector("#first-1 svg").getBoundingClientRect().width'
    before = browser.value(width)
    browser.call("Page.navigate", url=f"{pages['straight'].resolve().as_uri()}#first-1")
    assert browser.value(width) > 2.0 * before
    assert (
        browser.value('getComputedStyle(document.querySelector("#first-1 .close")).display')
        == "block"
    )
    browser.call("Page.navigate", url=f"{pages['straight'].resolve().as_uri()}#first-1-back")
    assert browser.value(width) == before


def test_a_dive_prints_on_white_with_what_is_folded_and_what_it_was_set_to(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.open(pages["straight"], 1280, dark=True)
    dark = {"name": "prefers-color-scheme", "value": "dark"}
    browser.call("Emulation.setEmulatedMedia", media="print", features=[dark])
    assert browser.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert "filters.fast.aiding" in browser.value('document.querySelector("main > pre").innerText')
    heights = browser.value(HEIGHTS_OF_FOLDED_TABLES)
    assert len(heights) > 5
    assert min(heights) > 30.0
    printed = b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert len(printed) < 2_000_000, "dashes outside of the panels are not in it"
    assert 1 <= len(re.findall(rb"/Type\s*/Page[^s]", printed)) <= 18, (
        "with the tables of four filters"
    )
    browser.call("Emulation.setEmulatedMedia", media="", features=[dark])
