"""The page of a calibration: the pictures show the numbers of the tables, and the file is written as others are."""

import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from browser import PROGRAM, opened_browser
from built_in import ReadDive, built_in_otherwise

from insdvl_replay.calibration.calibration import Calibration, calibrate
from insdvl_replay.calibration.certainty import correlation_matrix
from insdvl_replay.calibration.dives import answer_of
from insdvl_replay.calibration.fit import scatter_of
from insdvl_replay.calibration.innovations import LABELS
from insdvl_replay.calibration.new_settings import new_settings_table, vehicle_figure
from insdvl_replay.calibration.output import (
    DRAWN,
    calibration_figures,
    calibration_result,
    calibration_toml,
    each_alone,
)
from insdvl_replay.calibration.rows import HeldOutRow
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.document.parts import Code, DisplayTable, Figure
from insdvl_replay.document.plot import ends_of_track
from insdvl_replay.document.render import document, render


@pytest.fixture(scope="module")
def dives() -> list[ReadDive]:
    return [built_in_otherwise("figure-eight", seed, duration_s=240.0) for seed in (1, 2)]


@pytest.fixture(scope="module")
def found(dives: list[ReadDive]) -> Calibration:
    return calibrate([dive.innovations() for dive in dives], dives[0].config)


def drawn(found: Calibration, dives: list[ReadDive]) -> dict[str, Figure]:
    figures = calibration_figures(found, [dive.innovations() for dive in dives])
    return {f"{place} {figure.title}": figure for place, figure in enumerate(figures)}


@pytest.mark.nightly
def test_pictures_show_what_the_tables_say(found: Calibration, dives: list[ReadDive]) -> None:
    first, second, delays = drawn(found, dives).values()
    [between] = each_alone(found)
    for figure, row in zip((first, second), found.dives, strict=True):
        before, after = (
            np.column_stack([panel.curves[i].y for panel in figure.panels]) for i in (0, 1)
        )
        assert scatter_of(before) == pytest.approx(row.axes("before"))
        assert scatter_of(after) == pytest.approx(row.axes("after"))
    for panel, row in zip(delays.panels, found.dives, strict=True):
        cost, as_fitted = panel.curves
        assert as_fitted.x[0] == pytest.approx(row.delay_s)
        assert cost.x[np.argmin(cost.y)] == pytest.approx(row.delay_s, abs=0.05)
        assert cost.y.min() == 0.0
    by_title = {panel.title: panel for panel in between.panels}
    assert set(by_title) == {f"{LABELS[row.parameter]} [{row.unit}]" for row in found.estimated}
    for row in found.estimated:
        panel = by_title[f"{LABELS[row.parameter]} [{row.unit}]"]
        assert panel.levels == pytest.approx((row.change,))
        bars, values = panel.curves
        assert values.y.std(ddof=1) / np.sqrt(2.0) == pytest.approx(
            finite(row.between_dives_sd), rel=0.05
        )
        np.testing.assert_allclose((bars.y[::3] + bars.y[1::3]) / 2.0, values.y)


def held_out(drift_m: float, nis: float) -> tuple[HeldOutRow, ...]:
    """Two held-out dives whose drift was 0.76 m and whose NIS/dof was 0.5."""
    return tuple(HeldOutRow(name, 0.5, 0.5, 3, 0.76, drift_m, nis) for name in ("a", "b"))


@pytest.mark.parametrize(
    ("drift_m", "nis", "lines", "written"),
    [
        (
            0.40,
            0.9,
            ("Use the new settings: .* 0.76 -> 0.4 m", "Change the noise: .* 0.5 -> 0.9"),
            (True, True),
        ),
        (
            0.77,
            0.9,
            ("Keep your settings: .* 0.76 -> 0.77 m", "Change the noise: .* 0.5 -> 0.9"),
            (False, True),
        ),
        (
            0.40,
            4.0,
            ("Use the new settings: .* 0.76 -> 0.4 m", "Keep your noise: .* 0.5 -> 4"),
            (True, False),
        ),
        (0.763, 0.9, ("Use the new settings: .*", "Change the noise: .*"), (True, True)),
    ],
)
@pytest.mark.nightly
def test_what_is_worse_on_held_out_dives_is_not_written(
    drift_m: float,
    nis: float,
    lines: tuple[str, str],
    written: tuple[bool, bool],
    found: Calibration,
) -> None:
    assert found.proposes_noise
    tested = replace(found, held_out=held_out(drift_m, nis))
    answer = answer_of(tested)
    for line, pattern in zip(answer.lines, lines, strict=True):
        assert re.match(pattern, line.text)
    settings = tomllib.loads(calibration_toml(answer.applied(tested), [0]))
    assert ("lever_arm_m" in settings["dvl"], "beam_sd_mps" in settings["dvl"]) == written
    assert {"lever_arm_m", "beam_sd_mps"} <= tomllib.loads(calibration_toml(tested, [0]))[
        "dvl"
    ].keys()


def test_the_answer_is_first_and_without_held_out_dives_it_says_how_to_test(
    found: Calibration, dives: list[ReadDive]
) -> None:
    result = calibration_result(found, dives[0].config)
    first, second = answer_of(found).lines
    assert "--hold-out" in first.text
    assert list(document(result))[1:3] == [first, second]
    kept = calibration_result(
        replace(found, held_out=held_out(0.9, 0.9)), dives[0].config, "found.toml"
    )
    assert "--even-if-worse" in render(kept, "md")


def test_the_command_has_the_settings_that_were_given_and_is_code_on_the_page(
    found: Calibration, dives: list[ReadDive]
) -> None:
    result = calibration_result(found, dives[0].config, "new.toml", "--preset fog -c own.toml")
    command = "insdvl-replay run LOG --preset fog -c own.toml -c new.toml"
    assert f"<code>{command}</code>" in render(result, "html")
    assert "-c ..." not in render(result, "md")


def test_the_first_line_names_the_lever_arm_before_the_delay(found: Calibration) -> None:
    line = answer_of(found).lines[0].text
    names = (
        line.removeprefix("New settings: ").partition(". ")[0].replace(" and ", ", ").split(", ")
    )
    assert names[0].removeprefix("lever arm") in ("", " x", " y", " z", " x/y", " y/z", " x/z")
    assert "delay" in names[1:]


def test_the_screen_says_what_to_copy_and_the_page_shows_the_arm_first(
    found: Calibration, dives: list[ReadDive]
) -> None:
    """In this order: the settings, the picture of the vehicle, intervals, the dives, and folded their origin."""
    figures = list(drawn(found, dives).values())
    parts = document(calibration_result(found, dives[0].config, figures=figures))
    [code] = [part for part in parts if isinstance(part, Code)]
    written = tomllib.loads(calibration_toml(found, [0]))
    assert tomllib.loads(code.text) == written
    page = render(calibration_result(found, dives[0].config, figures=figures), "html")
    order = (
        "lever_arm_m",
        "Where the DVL is",
        "lever arm x",
        "What differs between",
        "formal",
        "Pictures</h2>",
    )
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    assert "formal" not in render(calibration_result(found, dives[0].config), "md")
    assert "formal" in render(calibration_result(found, dives[0].config, verbose=True), "md")


def test_a_new_arm_is_drawn_where_it_is_with_its_interval(found: Calibration) -> None:
    [figure] = vehicle_figure(found)
    above, side = figure.panels
    row = next(row for row in found.rows if row.parameter == "arm_x")
    x, y, z = found.after.lever_arm_m
    for panel, up in ((above, -y), (side, -z)):
        new = {curve.label: curve for curve in panel.curves}["DVL, new"]
        assert (new.x.tolist(), new.y.tolist()) == ([x], [up])
        bars = panel.curves[4]
        assert bars.x[1] - bars.x[0] == pytest.approx(2.0 * 1.96 * finite(row.sd))
        assert ends_of_track(panel) == {}
    table = new_settings_table("", found.rows, found.before, found.after)
    low, high = (float(end) for end in table.rows[0][3].split(" .. "))  # type: ignore[union-attr]
    assert (low + high) / 2.0 == pytest.approx(x, abs=1e-3)
    held = [msgspec.structs.replace(row, status=Estimated.HELD) for row in found.rows]
    assert list(vehicle_figure(replace(found, rows=tuple(held)))) == []


def test_correlations_are_a_matrix_when_asked(found: Calibration, dives: list[ReadDive]) -> None:
    def titles(**options: bool) -> list[str]:
        parts = document(calibration_result(found, dives[0].config, **options))
        return [part.title for part in parts if isinstance(part, DisplayTable)]

    assert sum(title.startswith("Correlations") for title in titles(verbose=True)) == 1
    assert not any(title.startswith("Correlations") for title in titles())
    matrix = correlation_matrix(found.fit)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T)


@pytest.mark.parametrize("value", [0.0, math.nan, math.inf, 1e-12])
def test_a_noise_that_no_sensor_has_is_never_proposed(value: float, found: Calibration) -> None:
    row = next(row for row in found.noise_rows if row.is_proposed)
    assert not msgspec.structs.replace(row, after=value).is_proposed


@pytest.mark.nightly
def test_one_dive_differs_from_none_and_many_are_not_all_drawn(
    found: Calibration, dives: list[ReadDive]
) -> None:
    alone = calibrate([dives[0].innovations()], dives[0].config)
    innovations, _ = drawn(alone, dives[:1]).values()
    assert "figure-eight" in innovations.title
    many = calibrate([dives[0].innovations()] * (DRAWN + 1), dives[0].config, ("arm",))
    figures = list(drawn(many, [dives[0]] * (DRAWN + 1)).values())
    assert sum("figure-eight" in figure.title for figure in figures) == DRAWN
    assert len(figures[DRAWN].panels) == DRAWN


def test_outage_is_drawn_where_dives_coasted(found: Calibration, dives: list[ReadDive]) -> None:
    rows = [HeldOutRow("a", 2.0, 1.0, 3, 4.0, 1.5), HeldOutRow("b", 2.0, 1.0, 0, None, None)]
    *_, last = drawn(replace(found, held_out=tuple(rows)), dives).values()
    _, before, after = last.panels[0].curves
    assert (before.y.tolist(), after.y.tolist()) == ([4.0], [1.5])
    *_, other = drawn(replace(found, held_out=tuple(rows[1:])), dives).values()
    assert other.title != last.title


def test_a_page_is_written_and_never_over_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, html = str(tmp_path / "dive.mcap"), tmp_path / "found.html"
    assert run_command_line(["simulate", "straight", "-o", log, "--duration", "60"]) == 0
    asked = ["calibrate", log, "--page", str(html)]
    # A straight line shows nothing, and the page says so.
    assert run_command_line(asked) == 3
    text = html.read_text("utf-8")
    assert text.count("<figure>") == 2
    assert re.findall(r"(?:src|href)=\"(?!#)[^\"]*", text) == []
    capsys.readouterr()
    assert run_command_line(asked) == 2
    assert "exists" in capsys.readouterr().err
    assert run_command_line([*asked, "--force"]) == 3
    assert html.read_text("utf-8") == text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dive.mcap", "found.html"]


@pytest.mark.nightly
@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium (make extras)")
def test_a_browser_shows_it_whole(
    found: Calibration, dives: list[ReadDive], tmp_path: Path
) -> None:
    html = tmp_path / "page.html"
    held = replace(found, held_out=(HeldOutRow("a", 2.0, 1.0, 3, 4.0, 1.5),))
    result = calibration_result(
        held, dives[0].config, "found.toml", figures=list(drawn(held, dives).values())
    )
    html.write_text(render(result, "html"), "utf-8")
    with opened_browser(tmp_path / "profile") as browser:
        for width in (1200, 390):
            browser.open(html, width)
            assert browser.complaints == []
            assert browser.requests == [html.resolve().as_uri()]
            assert browser.value("document.documentElement.scrollWidth") <= width
        browser.open(html, 1200)
        panels = sum(len(figure.panels) for figure in drawn(held, dives).values())
        assert browser.value("document.querySelectorAll('svg.panel').length") == panels + 2 + 8
        browser.screenshot(tmp_path / "page.png")
        assert (tmp_path / "page.png").stat().st_size > 20_000
