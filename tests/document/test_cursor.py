"""The cursor of a page in a browser: its values are those of the files, and zoom moves all panels over time alike."""

import csv
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import PROGRAM, Browser, opened_browser

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.states import DEG, STATES
from insdvl_replay.geometry.frames import north_east_down_m

pytestmark = [
    pytest.mark.skipif(PROGRAM is None, reason="needs Chromium (make extras)"),
    pytest.mark.nightly,
    pytest.mark.all_starts,
]
SAMPLE = Path(__file__).parents[2] / "sample_logs" / "figure_eight.mcap"
FILTERS = ("baseline", "aided")
FIND = 'const panels = [...document.querySelectorAll("svg.panel")];'
TIMES = (
    '.filter(s => s.querySelector(".label").textContent === "time [s]" && s.dataset.x !== "log")'
)
"""Panels over the time of the dive, other than those of convergence."""
READ = re.compile(r"^(\w+) (\S+)(?: ±(\S+))? at (\S+) s$")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("cursor")
    assert (
        run_command_line(
            ["run", str(SAMPLE), "-o", str(output), "--history", "csv", "--starts", "8"]
        )
        == 0
    )
    return output / "figure_eight"


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with opened_browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def browser(started: Browser, folder: Path) -> Iterator[Browser]:
    """A fresh page, of which nothing may complain and which may ask for nothing."""
    page = folder / "report.html"
    started.open(page, 1366)
    yield started
    assert started.complaints == []
    assert started.requests == [page.resolve().as_uri()]


@pytest.fixture(scope="module")
def histories(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    found = {}
    for name in FILTERS:
        with (folder / f"history_{name}.csv").open(newline="") as file:
            header, *rows = csv.reader(file)
        columns = zip(*rows, strict=True)
        found[name] = {
            key: np.array(column, dtype=np.float64)
            for key, column in zip(header, columns, strict=True)
            if key != "updated"
        }
    return found


def box(browser: Browser, anchor: str) -> tuple[float, float, float, float]:
    """Left, top, width and height of the plot of a panel, scrolled into the window."""
    left, top, width, height = browser.value(
        f'(() => {{ const frame = document.querySelector("#{anchor} .frame");'
        'frame.scrollIntoView({block: "center"});'
        "const r = frame.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
    )
    return left, top, width, height


def mouse(browser: Browser, kind: str, x: float, y: float, **more: Any) -> None:
    browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


def point(browser: Browser, anchor: str, across: float = 0.5) -> None:
    left, top, width, height = box(browser, anchor)
    mouse(browser, "mouseMoved", left + across * width, top + 0.6 * height)


def drag(browser: Browser, anchor: str, begin: float, end: float) -> None:
    left, top, width, height = box(browser, anchor)
    y = top + 0.6 * height
    mouse(browser, "mousePressed", left + begin * width, y, button="left", clickCount=1)
    for across in ((begin + end) / 2.0, end):
        mouse(browser, "mouseMoved", left + across * width, y, button="left", buttons=1)
    mouse(browser, "mouseReleased", left + end * width, y, button="left", clickCount=1)


def readings(browser: Browser, anchor: str) -> list[str]:
    found: list[str] = browser.value(
        f'[...document.querySelectorAll("#{anchor} .cursor text")].map(text => text.textContent)'
    )
    return found


SIGMAS = [f"predicted-standard-deviations-{number}" for number in range(1, 13)]
ERROR = "errors-against-the-reference--3-sigma--1"
TRACK = "motion-of-the-vehicle-1"


@pytest.mark.parametrize("across", [0.013, 0.31, 0.77])
def test_values_at_the_cursor_are_those_of_the_files_to_the_printed_digits(
    across: float, browser: Browser, histories: dict[str, dict[str, np.ndarray]]
) -> None:
    point(browser, SIGMAS[4], across)
    for anchor, state in zip(SIGMAS, STATES, strict=True):
        shown = [READ.fullmatch(text) for text in readings(browser, anchor)]
        assert {found[1] for found in shown if found} == set(FILTERS)
        for found in filter(None, shown):
            name, value, _, at_s = found.groups()
            history = histories[name]
            rows = np.abs(history["time_s"] - float(at_s)) <= 0.00501
            decimals = len(value.partition(".")[2])
            assert value in {f"{sd:.{decimals}f}" for sd in history[f"{state.id}_sd"][rows]}
            assert float(at_s) == pytest.approx(394.0 * across, abs=2.7), "two pixels"


def test_the_error_has_its_sigma_from_the_same_row(
    browser: Browser, histories: dict[str, dict[str, np.ndarray]]
) -> None:
    point(browser, ERROR, 0.4)
    shown = [READ.fullmatch(text) for text in readings(browser, ERROR)]
    assert len(shown) == 2
    for found in shown:
        assert found is not None
        name, _, sigma, at_s = found.groups()
        rows = np.abs(histories[name]["time_s"] - float(at_s)) <= 0.00501
        decimals = len(sigma.partition(".")[2])
        assert sigma in {f"{3.0 * sd:.{decimals}f}" for sd in histories[name]["dv_n_sd"][rows]}


def test_dots_on_the_track_are_where_the_files_say(
    browser: Browser, histories: dict[str, dict[str, np.ndarray]]
) -> None:
    point(browser, ERROR, 0.6)
    texts = {text.split()[0]: text for text in readings(browser, TRACK)}
    assert set(texts) == {*FILTERS, "reference"}
    dots = browser.value(
        f'[...document.querySelectorAll("#{TRACK} .cursor circle")].map(c => [c.getAttribute("class"), '
        '+c.getAttribute("cx"), +c.getAttribute("cy")])'
    )
    (matrix,) = browser.value(
        f'[document.querySelector("#{TRACK} .data").getAttribute("transform")]'
    )
    scale_x, _, _, scale_y, left, top = map(float, re.findall(r"[-\d.e]+", matrix))
    origin = {
        key: histories["baseline"][key][0] for key in ("latitude_deg", "longitude_deg", "height_m")
    }
    for number, name in enumerate(FILTERS):
        shown = re.fullmatch(rf"{name} (\S+) north, (\S+) east at (\S+) s", texts[name])
        assert shown is not None
        north, east, at_s = shown.groups()
        history = histories[name]
        row = int(np.argmin(np.abs(history["time_s"] - float(at_s))))
        place = np.array([[history[key][row] for key in origin]]) * (DEG, DEG, 1.0)
        start = np.array([list(origin.values())]) * (DEG, DEG, 1.0)
        ned_m = north_east_down_m(place, start)[0]
        decimals = len(north.partition(".")[2])
        assert (north, east) == (f"{ned_m[0]:.{decimals}f}", f"{ned_m[1]:.{decimals}f}")
        x, y = next((x, y) for style, x, y in dots if style == f"filter{number}")
        assert (x - left) / scale_x == pytest.approx(float(east) * 10.0**decimals, abs=0.01)
        assert (y - top) / scale_y == pytest.approx(float(north) * 10.0**decimals, abs=0.01)


def test_a_point_of_the_track_is_a_time_of_all_panels(browser: Browser) -> None:
    point(browser, TRACK, 0.5)
    [read] = {
        text.split(" at ")[1] for text in readings(browser, TRACK) if text.startswith("aided")
    }
    at_s = [float(text.split(" at ")[1].split()[0]) for text in readings(browser, ERROR)]
    assert at_s == pytest.approx([float(read.split()[0])] * 2, abs=2.7)


def test_a_drag_zooms_all_panels_over_time_alike_and_a_double_click_restores_them(
    browser: Browser,
) -> None:
    views = (
        f'(() => {{ {FIND} return panels{TIMES}.map(s => [s.querySelector(".data").getAttribute("transform")'
        '.split(" ").filter((_, i) => i % 4 === 0).join(" ").replace(")", ""), '
        '[...s.querySelectorAll(".ticks text")].map(t => t.textContent).join(" ")].join("; ")); })()'
    )
    others = (
        f"(() => {{ {FIND} const times = panels{TIMES}; return panels.filter(s => !times.includes(s))"
        '.map(s => s.querySelector(".data").getAttribute("transform")).join(" "); })()'
    )
    before, elsewhere = browser.value(views), browser.value(others)
    assert len(before) > 25
    assert len(set(before)) == 1
    drag(browser, ERROR, 0.25, 0.5)
    zoomed = browser.value(views)
    assert len(set(zoomed)) == 1
    scale, _, ticks = re.fullmatch(r"matrix\((\S+) (\S+); (.*)", zoomed[0]).groups()  # type: ignore[union-attr]
    assert float(scale) == pytest.approx(
        4.0 * float(re.findall(r"[\d.]+", before[0])[0]), rel=0.03
    )
    assert ticks == "100 120 140 160 180"
    assert browser.value(others) == elsewhere
    assert browser.value("location.hash") == "", "a drag is no click"
    point(browser, ERROR, 0.5)
    assert all(
        float(text.split(" at ")[1].split()[0]) == pytest.approx(148.0, abs=2.7)
        for text in readings(browser, ERROR)
    )
    # At once, since a busy machine takes longer between two clicks than a hand does.
    browser.value(
        f'(() => {{ const panel = document.querySelector("#{SIGMAS[0]} svg.panel");'
        'for (const [name, detail] of [["click", 1], ["click", 2], ["dblclick", 2]])'
        "panel.dispatchEvent(new MouseEvent(name, {detail, bubbles: true, cancelable: true})); })()"
    )
    assert browser.value(views) == before
    time.sleep(0.6)
    assert browser.value("location.hash") == "", "a double click does not enlarge"


def test_a_drag_zooms_the_panels_over_logarithmic_time_alike_and_no_others(
    browser: Browser,
) -> None:
    views = f"""(() => {{ {FIND} return panels.map(s => [s.dataset.x === "log" && s.querySelector(".label").textContent,
        s.querySelector(".data").getAttribute("transform"),
        [...s.querySelectorAll(".ticks text")].map(t => t.textContent).join(" ")]); }})()"""
    before = browser.value(views)
    over_time = [view[0] == "time [s]" for view in before]
    assert over_time.count(True) == 3
    point(browser, "convergence-1", 0.3)
    assert readings(browser, TRACK) == [], "a time since a random start is none of the dive"
    assert readings(browser, "convergence-2")
    drag(browser, "convergence-1", 0.25, 0.75)
    after = browser.value(views)
    assert [was != now for was, now in zip(before, after, strict=True)] == over_time
    (zoomed,) = {
        (view[1].split()[0], view[2])
        for view, is_log in zip(after, over_time, strict=True)
        if is_log
    }
    (home,) = {
        view[1].split()[0] for view, is_log in zip(before, over_time, strict=True) if is_log
    }
    across, ticks = zoomed
    assert float(across[7:]) == pytest.approx(2.0 * float(home[7:]), rel=0.03)
    assert ticks == "5 10 20 50"
    point(browser, "convergence-1", 0.99)
    last_s = float(readings(browser, "convergence-1")[0].split(" at ")[1].split()[0])
    drag(browser, "convergence-1", 0.9, 1.0)
    closer = browser.value(views)
    assert len(closer[over_time.index(True)][2].split()) > 2, (
        "round values, linear steps between close ones"
    )
    point(browser, "convergence-1", 0.99)
    assert float(
        readings(browser, "convergence-1")[0].split(" at ")[1].split()[0]
    ) == pytest.approx(last_s, rel=0.04)
    browser.value(
        'document.querySelector("#convergence-1 svg.panel")'
        '.dispatchEvent(new MouseEvent("dblclick", {bubbles: true, cancelable: true}))'
    )
    assert browser.value(views) == before


def test_a_click_enlarges_and_the_large_panel_has_a_cursor(browser: Browser) -> None:
    left, top, width, height = box(browser, ERROR)
    for kind in ("mousePressed", "mouseReleased"):
        mouse(browser, kind, left + width / 2, top + height / 2, button="left", clickCount=1)
    assert browser.value("location.hash") == f"#{ERROR}"
    point(browser, ERROR, 0.2)
    assert len(readings(browser, ERROR)) == 2


def test_keys_move_the_cursor_and_a_finger_does_not_zoom(browser: Browser) -> None:
    browser.value(f'document.querySelector("#{ERROR} .open").focus()')
    times = []
    for key in ("ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft"):
        browser.call("Input.dispatchKeyEvent", type="keyDown", key=key)
        times.append(readings(browser, ERROR)[0].split(" at ")[1])
    assert times[0] != times[1] != times[2]
    assert times[3] == times[1]
    browser.call("Input.dispatchKeyEvent", type="keyDown", key="Escape")
    assert readings(browser, ERROR) == []
    left, top, width, height = box(browser, ERROR)
    for kind, across in (("touchStart", 0.3), ("touchMove", 0.5), ("touchMove", 0.7)):
        places = [{"x": left + across * width, "y": top + height / 2}]
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=places)
    assert len(readings(browser, ERROR)) == 2
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    assert browser.value('document.querySelectorAll(".zoomed").length') == 0


def test_without_scripts_every_panel_and_legend_is_there(started: Browser, folder: Path) -> None:
    started.open(folder / "report.html", 1366)
    count = 'document.querySelectorAll("svg.panel, ul.legend li, svg.strip, table").length'
    drawn = started.value(count)
    started.open(folder / "report.html", 1366, scripts=False)
    assert started.value(count) == drawn > 60
    assert started.complaints == []
    point(started, ERROR)
    assert readings(started, ERROR) == []


def test_a_study_is_read_like_a_dive(started: Browser, tmp_path: Path) -> None:
    arguments = ["straight", "--runs", "2", "--duration", "30", "-o", str(tmp_path)]
    assert run_command_line(["study", "montecarlo", *arguments]) == 0
    (page,) = tmp_path.rglob("report.html")
    started.open(page, 1366)
    started.value('document.querySelector(".zoom").id = "first"')
    point(started, "first", 0.6)
    with page.with_name("nees.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for found in map(READ.fullmatch, readings(started, "first")):
        assert found is not None
        name, value, _, at_s = found.groups()
        same = [
            row
            for row in rows
            if row["filter"] == name and abs(float(row["time_s"]) - float(at_s)) <= 0.000501
        ]
        decimals = len(value.partition(".")[2])
        assert value in {f"{float(row['mean_nees']):.{decimals}f}" for row in same}
    assert started.complaints == []
