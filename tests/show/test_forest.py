"""Forest plots: where a ratio is drawn, what is beyond the axis, and what is not drawn."""

import math
import re

import pytest

from insdvl_replay.core.words import EvidenceVerdict, Settling, Verdict
from insdvl_replay.document.looks import style_sheet
from insdvl_replay.show.first_screen import (
    LEFT,
    RIGHT,
    ROW,
    ForestRow,
    axis_end,
    forest,
    place,
    tone_class,
)


def across(tag: str, attribute: str, svg: str) -> list[float]:
    """The places of all elements of a kind, in percent of the width."""
    return [float(found) for found in re.findall(rf'<{tag} [^>]*?{attribute}="([\d.]+)%"', svg)]


def test_half_and_twice_are_the_ends_of_the_axis_and_one_is_its_middle() -> None:
    svg = forest("", [ForestRow("drift", ratio, (0.5, 2.0)) for ratio in (1.0, 0.5, 2.0)])
    assert across("circle", "cx", svg) == [47.0, 30.0, 64.0]
    assert across('line class="interval"', "x1", svg) == [30.0] * 3
    assert across('line class="interval"', "x2", svg) == [64.0] * 3
    assert across('line class="one"', "x1", svg) == [47.0]
    (left,), (width,) = (
        across('rect class="within"', "x", svg),
        across('rect class="within"', "width", svg),
    )
    assert left == pytest.approx(place(1.0 / 1.05, 2.0), abs=0.01)
    assert left + width / 2.0 == pytest.approx(47.0, abs=0.01)


def test_a_ratio_beyond_the_axis_is_an_arrow_with_its_size() -> None:
    near = [ForestRow("drift", 1.0)] * 4
    svg = forest(
        "", [*near, ForestRow("outage", 50.03, (40.0, 60.0), "worse"), ForestRow("level", 0.02)]
    )
    assert re.findall(rf'class="beyond" x="({RIGHT}|{LEFT})%"[^>]*>([^<]+)<', svg) == [
        (f"{RIGHT}", "50x ▶"), (f"{LEFT}", "◀ 0.02x")
    ]  # fmt: skip
    assert svg.count("<circle") == len(near)
    assert "interval" not in svg


def test_an_interval_that_goes_on_beyond_the_axis_ends_in_a_tip() -> None:
    svg = forest("", [ForestRow("drift", 1.0, (0.4, 1.5)), ForestRow("drift", 1.0, (0.6, 1.5))])
    assert across('svg class="tip"', "x", svg) == [LEFT]


@pytest.mark.parametrize(
    ("ratios", "end"),
    [
        ([1.0, 1.1, 3.0], 2.0),
        ([1.0, 3.0, 3.1], 5.0),
        ([0.1], 20.0),
        ([1e9], 100.0),
        ([], 2.0),
        ([None], 2.0),
    ],
)
def test_the_axis_is_the_shortest_with_half_of_the_ratios(
    ratios: list[float | None], end: float
) -> None:
    assert axis_end([ForestRow("drift", ratio) for ratio in ratios]) == end


def test_what_is_missing_is_not_drawn_and_rows_share_a_footnote() -> None:
    why = "fewer than 3 dives"
    text = forest("All <dives>", [
        ForestRow("drift", 0.9, text="0.90", why=why), ForestRow("level", None, text="-"),
        ForestRow("heading", 0.8, text="0.80", why=why),
    ])  # fmt: skip
    assert text.count("<circle") == 2
    assert "interval" not in text
    assert text.count(why) == 1
    assert text.count("¹") == 3
    assert "All &lt;dives&gt;" in text


def test_a_row_names_its_verdict_and_numbers_where_the_pointer_rests() -> None:
    svg = forest(
        "",
        [
            ForestRow("one <&>", 0.8512, (0.7, 0.9), "better"),
            ForestRow("two", None, tone="not evaluated"),
        ],
    )
    assert re.findall("<title>(.*?)</title>", svg) == [
        "one &lt;&amp;&gt;: 0.851 (0.7 .. 0.9) better", "two not evaluated"
    ]  # fmt: skip


def test_a_long_name_is_shortened_in_the_middle_and_its_link_is_whole() -> None:
    name = "rosbag2_2024_05_03-12_30_11"
    svg = forest("", [ForestRow(name, 1.0, link=f"{name}/report.html")])
    assert f'<a href="{name}/report.html">' in svg
    assert f"<title>{name}: 1</title>" in svg
    assert ">rosbag2_2…3-12_30_11<" in svg


def luminance(colour: str) -> float:
    """The relative luminance of a colour such as ``#1b2330`` (WCAG 2)."""
    shares = [
        int(part * (3 - len(part)), 16) / 255.0
        for part in re.findall("..?" if len(colour) > 4 else ".", colour[1:])
    ]
    linear = [
        share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares
    ]
    return sum(
        weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear, strict=True)
    )


def test_verdicts_are_readable_in_the_light_in_the_dark_and_on_paper() -> None:
    schemes = [
        dict(re.findall(r"--(\w+): (#\w+);", block))
        for block in re.findall(r":root \{(.*?)\}", style_sheet(), re.S)
    ]
    assert len(schemes) == 3
    for scheme in schemes:
        paper = luminance(scheme["paper"])
        for name in ("ink", "soft", "red", "blue", "green", "ochre"):
            high, low = sorted((paper, luminance(scheme[name])), reverse=True)
            assert (high + 0.05) / (low + 0.05) >= 4.5, name


def test_every_word_has_a_colour() -> None:
    """A rule of the style sheet has all classes of a line in front of what they set."""
    coloured = {
        name
        for selectors in re.findall(r"^(.*?) \{ --tone: ", style_sheet(), re.M)
        for name in selectors.replace(".", "").split(", ")
    }
    assert {
        tone_class(word) for words in (Verdict, EvidenceVerdict, Settling) for word in words
    } == coloured


def test_ends_that_are_not_finite_leave_no_broken_places() -> None:
    ends = [(math.nan, 2.0), (0.0, math.inf), (-math.inf, math.nan)]
    svg = forest(
        "",
        [ForestRow("drift", 1.0, interval) for interval in ends] + [ForestRow("level", math.inf)],
    )
    places = re.findall(r'(?:x|x1|x2|cx|y)="([^"]*)"', svg)
    assert not [place for place in places if "nan" in place or "inf" in place]
    assert svg.count('class="interval"') == 1, "from one end of the axis to the other"
    assert "infx ▶" in svg
    assert "nan" not in svg, "where the pointer rests"


def test_a_heading_above_the_texts_says_what_they_are_and_moves_the_rows_down() -> None:
    rows = [ForestRow("drift", 1.0, text="1.00 4/4")]
    bare = forest("", rows)
    headed = forest("", rows, "ratio, smaller on")
    assert ">ratio, smaller on</text>" in headed
    middles = [float(re.search(r'cy="([\d.]+)"', svg)[1]) for svg in (bare, headed)]  # type: ignore[index]
    assert middles[1] - middles[0] == ROW
