"""Panels as SVG: peaks survive, ticks are round, and the drawing says where the values are."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.ticker import MaxNLocator

from insdvl_replay.document.parts import Curve, Panel, filter_style
from insdvl_replay.document.plot import (
    Axis,
    envelope,
    limits,
    panel_svg,
    without_standstill,
)

NAN = float("nan")
SVG = "{http://www.w3.org/2000/svg}"


def drawn(panel: Panel) -> ET.Element:
    """The panel read by an XML parser, which knows no names without their space."""
    return ET.fromstring(
        panel_svg(panel).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    )


def places(path: str) -> np.ndarray:
    """Places of a path's points, as the standard has it: SVG 2, section 9.3."""
    words = re.findall(r"[A-Za-z]|-?(?:\d+(?:\.\d+)?|\.\d+)", path)
    found, command = [], ""
    while words:
        command = words.pop(0) if words[0].isalpha() else {"M": "L"}.get(command, command)
        if command not in "MLl":
            break
        place = float(words.pop(0)), float(words.pop(0))
        found.append(np.array(place) + (found[-1] if command == "l" else 0.0))
    return np.array(found)


def lines(panel: Panel) -> list[np.ndarray]:
    """Places of each line's points on the paper."""
    (group,) = (
        element for element in drawn(panel).iter(f"{SVG}g") if element.get("class") == "data"
    )
    across, _, _, down, left, top = map(
        float, re.findall(r"[-+.e\d]+", group.get("transform", ""))
    )
    return [
        places(path.get("d", "")) * (across, down) + (left, top)
        for path in group
        if path.get("class") in {"line filter0", "line filter1", "points rejected"}
    ]


def test_every_peak_of_a_long_series_survives() -> None:
    x = np.arange(100_000.0)
    y = np.random.default_rng(5).normal(size=len(x))
    y[[17, 50_001, 99_999]] = [50.0, -60.0, 70.0]
    rows = envelope(x, y)
    short_x, short_y = x[rows], y[rows]
    assert len(rows) <= 300
    assert (np.diff(rows) > 0).all()
    assert {50.0, -60.0, 70.0} <= set(short_y)
    for first in range(0, 100_000, 1000):
        part = y[first : first + 1000]
        near = short_y[(short_x >= first - 667) & (short_x < first + 1667)]
        assert near.min() <= part.min()
        assert near.max() >= part.max()


def test_steps_of_a_line_lead_to_its_places() -> None:
    east, north = np.random.default_rng(3).uniform(size=(2, 200))
    missing = slice(120, 130)
    north[missing] = NAN
    [path] = [
        one.get("d", "")
        for one in drawn(Panel("", "", (Curve(east, north, "filter0"),), equal=True)).iter(
            f"{SVG}path"
        )
        if one.get("class") == "line filter0"
    ]
    assert path.count("M") == path.count("l") == 2
    np.testing.assert_array_equal(
        places(path), np.rint(1e3 * np.delete([east, north], missing, axis=1).T)
    )


def test_what_is_missing_for_long_interrupts_a_line() -> None:
    x, y = np.arange(3000.0), np.sin(np.arange(3000.0))
    y[1000:2000] = NAN
    short = y[envelope(x, y)]
    assert np.isnan(short).any()
    assert np.isfinite(short[[0, -1]]).all()
    assert len(envelope(x, np.full(3000, NAN))) == 150


def test_short_series_are_left_alone() -> None:
    x = np.arange(300.0)
    np.testing.assert_array_equal(envelope(x, x**2), x)


@pytest.mark.parametrize(("curves", "most"), [(1, 300), (4, 300), (24, 50)])
def test_many_curves_share_the_points_of_a_few(curves: int, most: int) -> None:
    x = np.linspace(0.0, 1.0, 5000)
    found = lines(
        Panel("", "", tuple(Curve(x, np.sin(50.0 * x + n), "filter0") for n in range(curves)))
    )
    assert len(found) == curves
    assert all(most / 2 < len(line) <= most for line in found)


def test_values_are_read_back_to_the_printed_digits_with_their_band() -> None:
    """As `cursor.js` reads them, in seconds although the axis is in minutes."""
    rng, time_s = np.random.default_rng(6), np.arange(3600.0) + 0.1234
    for size in (1e-7, 0.37, 8.0, 1.3e5):
        y, sd = size * rng.normal(size=3600), size * rng.uniform(1.0, 2.0, 3600)
        curve = Curve(time_s / 60.0, y, "filter0", band=(-3.0 * sd, 3.0 * sd))
        svg = drawn(Panel("", "time [min]", (curve,)))
        decimals, unit = svg.get("data-x", "").split()
        assert (decimals, unit) == ("1", "60")
        scale = 10.0 ** int(svg.get("data-y", "").split()[0])
        found = {
            path.get("class"): places(path.get("d", ""))
            for path in svg.iter(f"{SVG}path")
            if path.get("d")
        }
        line, band = found["line filter0"], found["band filter0"]
        rows = np.rint(line[:, 0] / 10.0 - 0.1234).astype(int)
        assert len(rows) > 200
        np.testing.assert_array_equal(line[:, 1], np.rint(y[rows] * scale))
        there, back = np.split(band, 2)
        np.testing.assert_array_equal(
            there, np.column_stack([line[:, 0], np.rint(3.0 * sd[rows] * scale)])
        )
        np.testing.assert_array_equal(back[::-1], there * (1.0, -1.0))


def test_a_logarithmic_axis_keeps_three_digits() -> None:
    y = 10.0 ** np.random.default_rng(7).uniform(-6.0, 6.0, 250)
    svg = drawn(Panel("", "", (Curve(np.arange(250.0), y, "filter0"),), y_scale="log"))
    (path,) = (path for path in svg.iter(f"{SVG}path") if path.get("class") == "line filter0")
    read = [f"{10.0 ** (count / 5000.0):.2e}" for count in places(path.get("d", ""))[:, 1]]
    assert read == [f"{value:.2e}" for value in y]


def test_one_band_is_filled_and_the_others_are_lines() -> None:
    x = np.arange(3.0)
    curves = tuple(
        Curve(x, x, filter_style(number), band=(x - 1.0, x + 1.0)) for number in range(4)
    )
    bands = [
        path
        for path in drawn(Panel("", "", curves)).iter(f"{SVG}path")
        if "band" in path.get("class", "")
    ]
    assert [path.get("class") for path in bands] == [
        "band filter0",
        *(f"band edges filter{n}" for n in (1, 2, 3)),
    ]
    assert [path.get("d", "").endswith("Z") for path in bands] == [True, False, False, False]


def test_a_track_has_times_and_marks_of_its_start_and_end() -> None:
    x, y = np.array([0.0, NAN, 30.0, 30.0]), np.array([0.0, 5.0, 0.0, 40.0])
    curve = Curve(x, y, "reference", label="reference", time=np.array([0.0, 1.0, 2.5, 4.25]))
    svg = drawn(Panel("", "", (curve,), equal=True))
    (line,) = (path for path in svg.iter(f"{SVG}path") if path.get("class") == "line reference")
    assert line.get("data-t") == "0 250 175"
    assert [text.text for text in svg.iter(f"{SVG}text") if text.get("class") == "name"] == [
        "start",
        "end",
    ]


def test_a_track_keeps_its_shape_and_loses_its_standstill() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 5000)
    x, y = (np.concatenate([f(angle), np.repeat(f(angle[-1:]), 50_000)]) for f in (np.cos, np.sin))
    rows = without_standstill(x, y, 0.01)
    short_x, short_y = x[rows], y[rows]
    assert len(short_x) < 1000
    np.testing.assert_allclose(np.hypot(short_x, short_y), 1.0, atol=1e-12)
    assert np.hypot(np.diff(short_x), np.diff(short_y)).max() < 0.03


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0.0, 10.0], (-0.5, 10.5)),
        ([4.0, 4.0], (2.0, 6.0)),
        ([0.0], (-1.0, 1.0)),
        ([NAN, np.inf], (0.0, 1.0)),
    ],
)
def test_limits_give_air_and_never_meet(
    values: list[float], expected: tuple[float, float]
) -> None:
    assert limits(np.array(values)) == pytest.approx(expected)


def test_limits_of_a_logarithmic_axis_are_powers_of_ten() -> None:
    assert limits(np.array([0.0, -1.0, 0.02, 300.0, NAN]), "log") == (0.01, 1000.0)
    assert limits(np.array([-1.0]), "log") == (1.0, 10.0)


@pytest.mark.parametrize("count", [5, 6])
def test_ticks_are_those_of_matplotlib(count: int) -> None:
    rng = np.random.default_rng(11)
    for _ in range(2000):
        low, span = rng.normal() * 10.0 ** rng.uniform(-8, 8), 10.0 ** rng.uniform(-8, 8)
        if span > 1e-6 * abs(low):
            theirs = MaxNLocator(count, steps=(1, 2, 2.5, 5, 10)).tick_values(low, low + span)
            assert_same_ticks(Axis(low, low + span, 0.0, 1.0), count, theirs)


@pytest.mark.parametrize("count", [5, 6])
def test_ticks_of_a_logarithmic_axis_are_powers_of_ten_equally_far_apart(count: int) -> None:
    rng = np.random.default_rng(12)
    for _ in range(2000):
        low, decades = 10.0 ** rng.uniform(-12, 12), rng.uniform(0.1, 20)
        axis = Axis(low, low * 10.0**decades, 0.0, 1.0, "log")
        powers = [float(np.log10(float(label))) for _, label in axis.ticks(count)]
        assert powers == pytest.approx(np.rint(powers))
        assert len(set(np.diff(powers).round(6))) <= 1
        assert min(1, int(decades)) <= len(powers) <= count
        assert decades < 2.0 or len(powers) > 1
        assert [place for place, _ in axis.ticks(count)] == pytest.approx(
            (powers - np.log10(low)) / decades
        )


@pytest.mark.parametrize(("high", "labels"), [(3, "123"), (4, "1234"), (9, "123456789")])
def test_what_is_counted_has_whole_ticks(high: int, labels: str) -> None:
    assert [label for _, label in Axis(0.9, high + 0.1, 0.0, 1.0, whole=True).ticks(12)] == list(
        labels
    )


def assert_same_ticks(axis: Axis, count: int, values: np.ndarray) -> None:
    inside = values[(values >= axis.low) & (values <= axis.high)]
    np.testing.assert_allclose(
        [place for place, _ in axis.ticks(count)], axis.place(inside), atol=1e-6
    )


def test_ticks_are_round_numbers_at_their_places() -> None:
    axis = Axis(-0.013, 0.027, 100.0, 500.0)
    for place, label in axis.ticks(5):
        assert place == pytest.approx(
            100.0 + (float(label.replace("\N{MINUS SIGN}", "-")) + 0.013) / 0.04 * 400.0
        )
    assert [label for _, label in Axis(0.0, 1.0, 0.0, 1.0).ticks(5)] == [
        "0",
        "0.2",
        "0.4",
        "0.6",
        "0.8",
        "1",
    ]
    assert [label for _, label in Axis(0.5, 1000.0, 0.0, 1.0, "log").ticks(5)] == [
        "1",
        "10",
        "100",
        "1000",
    ]
    assert [label for _, label in Axis(1e-9, 1e-8, 0.0, 1.0, "log").ticks(5)] == ["1e-9", "1e-8"]


def test_places_on_the_paper_are_where_the_values_are() -> None:
    x, y = np.array([0.0, 5.0, 10.0]), np.array([1.0, 3.0, 2.0])
    [line] = lines(Panel("title", "x", (Curve(x, y, "filter0"),)))
    np.testing.assert_allclose(
        (line[1, 0] - line[0, 0]) / (line[2, 0] - line[0, 0]), 0.5, atol=1e-3
    )
    np.testing.assert_allclose(
        (line[0, 1] - line[2, 1]) / (line[0, 1] - line[1, 1]), 0.5, atol=2e-3
    )


def test_a_unit_is_as_long_on_both_axes_of_a_track() -> None:
    x, y = np.array([0.0, 30.0, 30.0]), np.array([0.0, 0.0, 40.0])
    [line] = lines(Panel("title", "x", (Curve(x, y, "filter0"),), equal=True))
    across, down = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert down / across == pytest.approx(40.0 / 30.0, rel=2e-3)


@pytest.mark.parametrize(
    "values", [[], [NAN, NAN], [1.0, NAN], [1.0, np.inf], [1e300, -1e300], [0.0, -1.0]]
)
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_any_values_make_a_picture_without_words_for_missing_numbers(
    values: list[float], scale: str
) -> None:
    x, y = np.arange(float(len(values))), np.array(values)
    curves = (Curve(x, y, "filter0", band=(y, y), time=x), Curve(x, y, "rejected", points=True))
    text = panel_svg(Panel("title <&>", "x", curves, (0.5,), scale, equal=scale == "linear"))  # type: ignore[arg-type]
    ET.fromstring(text)
    for path in re.findall(r' d="([^"]*)"', text):
        assert re.fullmatch(r"(?:[MLlHVZh]|-?(?:\d+(?:\.\d+)?|\.\d+)| )*", path)


def test_the_same_panel_gives_the_same_characters() -> None:
    x = np.linspace(0.0, 1.0, 5000)
    panel = Panel("title", "x", (Curve(x, np.sin(9.0 * x), "filter0"),), y_scale="log")
    assert panel_svg(panel) == panel_svg(panel)


def test_six_filters_have_styles_of_their_own() -> None:
    assert len({filter_style(number) for number in range(6)}) == 6
    assert filter_style(6) == filter_style(0)


def test_a_logarithmic_time_axis_ends_with_its_values_and_gives_each_decade_the_same_room() -> (
    None
):
    x = np.array([2.0, 20.0, 200.0])
    [line] = lines(Panel("title", "x", (Curve(x, x, "filter0"),), x_scale="log"))
    assert line[:, 0] == pytest.approx([48.0, 199.0, 350.0], abs=0.1)
    labels = [
        text.text
        for text in drawn(Panel("", "", (Curve(x, x, "filter0"),), x_scale="log")).iter(
            f"{SVG}text"
        )
    ]
    assert labels[1:3] == ["10", "100"]
